//! The offer to newcomers: a dataset, and the token that they must show.
//!
//! A reload replaces the offer as a whole. Walkers inside keep the one that they came in with.

use super::{plan, source::Served};
use bytes::Bytes;
use ldi_protocol::index::ChunkHash;
use std::{sync::OnceLock, time::Instant};

/// See the module.
#[derive(Debug)]
pub struct Offer {
    /// The dataset.
    pub served: Served,
    /// Hash of the token; None: everyone may come in.
    token: Option<blake3::Hash>,
    /// Fingerprint of the certificate that will replace the server's.
    pub next_certificate: Option<ChunkHash>,
    since: Instant,
    plan: OnceLock<Bytes>,
}

impl Offer {
    /// A new one, from now on.
    pub fn new(served: Served, token: Option<&str>, next_certificate: Option<blake3::Hash>) -> Self {
        let token = token.map(|t| blake3::hash(t.as_bytes()));
        let next_certificate = next_certificate.map(|h| ChunkHash(*h.as_bytes()));
        Self { served, token, next_certificate, since: Instant::now(), plan: OnceLock::new() }
    }

    /// Whether whoever shows this may come in. Comparing hashes takes the same time wherever they
    /// differ.
    pub fn admits(&self, shown: Option<&[u8]>) -> bool {
        self.token.is_none_or(|token| shown.is_some_and(|s| blake3::hash(s) == token))
    }

    /// Whether the dataset can be read, as its first chunk and page show.
    pub fn is_readable(&self) -> bool {
        let has_chunks = !self.served.index().chunks.is_empty();
        let (first, rest) = self.served.pages();
        let page = first.iter().chain(rest).next();
        page.is_none_or(|p| self.served.page(*p).is_some()) && (!has_chunks || self.served.chunk(0).is_some())
    }

    /// Seconds since the dataset was opened.
    pub fn age_s(&self) -> u64 {
        self.since.elapsed().as_secs()
    }

    /// The dataset's plan as JSON; made when first asked for.
    pub fn plan(&self) -> Bytes {
        self.plan.get_or_init(|| plan::to_json(&self.served).into()).clone()
    }
}
