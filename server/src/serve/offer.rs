//! The offers to newcomers: datasets by name, and the token that they must show.
//!
//! A reload replaces the offers as a whole. Walkers inside keep the one that they came in with.

use super::{
    plan,
    source::{ChunkSource, Served},
};
use bytes::Bytes;
use ldi_protocol::{index::ChunkHash, said::escaped};
use std::{
    collections::BTreeMap,
    sync::{Arc, OnceLock},
    time::Instant,
};

/// Datasets by the names under which they are served.
pub type NamedSources = BTreeMap<String, Arc<dyn ChunkSource>>;

/// Names in a refusal: more are not told.
const TOLD_NAMES: usize = 12;

/// All that newcomers may ask for.
#[derive(Debug)]
pub struct Offers {
    /// One at least.
    by_name: BTreeMap<String, Arc<Offer>>,
    /// Hash of the token; None: everyone may come in.
    token: Option<blake3::Hash>,
    /// Fingerprint of the certificate that will replace the server's.
    pub next_certificate: Option<ChunkHash>,
}

/// Why nothing is offered to somebody.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum NotOffered {
    /// Nothing of that name.
    #[error("there is no dataset '{name}' here; ask for one of: {there}")]
    Unknown {
        /// As asked for, escaped.
        name: String,
        /// What there is.
        there: String,
    },
    /// No name was given.
    #[error("there are several datasets here; connect to HOST/NAME with one of: {there}")]
    Several {
        /// What there is.
        there: String,
    },
}

impl Offers {
    /// New ones, from now on.
    pub fn new(datasets: NamedSources, token: Option<&str>, next_certificate: Option<blake3::Hash>) -> Self {
        let offer = |(name, source)| {
            let offer = Offer::new(name, Served::new(source));
            (offer.name.clone(), Arc::new(offer))
        };
        Self {
            by_name: datasets.into_iter().map(offer).collect(),
            token: token.map(|t| blake3::hash(t.as_bytes())),
            next_certificate: next_certificate.map(|h| ChunkHash(*h.as_bytes())),
        }
    }

    /// Whether whoever shows this may come in. Comparing hashes takes the same time wherever they
    /// differ.
    pub fn admits(&self, shown: Option<&[u8]>) -> bool {
        self.token.is_none_or(|token| shown.is_some_and(|s| blake3::hash(s) == token))
    }

    /// Whether newcomers must show a token.
    pub fn ask_for_token(&self) -> bool {
        self.token.is_some()
    }

    /// The dataset of a name; without a name the only one.
    ///
    /// # Errors
    /// There is none of that name, or there are several and no name.
    pub fn of(&self, name: Option<&str>) -> Result<Arc<Offer>, NotOffered> {
        let there = || {
            let told: Vec<&str> = self.by_name.keys().take(TOLD_NAMES).map(String::as_str).collect();
            let more = if self.by_name.len() > TOLD_NAMES { ", ..." } else { "" };
            told.join(", ") + more
        };
        match (name, self.only()) {
            (None, Some(only)) => Ok(only),
            (None, None) => Err(NotOffered::Several { there: there() }),
            (Some(name), _) => {
                let found = self.by_name.get(name).cloned();
                found.ok_or_else(|| NotOffered::Unknown { name: escaped(name).into_owned(), there: there() })
            }
        }
    }

    /// The dataset, if there is one only.
    pub fn only(&self) -> Option<Arc<Offer>> {
        (self.by_name.len() == 1).then(|| self.by_name.values().next().cloned()).flatten()
    }

    /// All, by name.
    pub fn all(&self) -> impl Iterator<Item = &Arc<Offer>> {
        self.by_name.values()
    }
}

/// A dataset that newcomers may ask for.
#[derive(Debug)]
pub struct Offer {
    /// The name under which it is served.
    pub name: String,
    /// The dataset.
    pub served: Served,
    since: Instant,
    plan: OnceLock<Bytes>,
}

impl Offer {
    fn new(name: String, served: Served) -> Self {
        Self { name, served, since: Instant::now(), plan: OnceLock::new() }
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
