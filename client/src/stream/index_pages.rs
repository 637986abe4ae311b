//! The pages of a manifest as they arrive.
//!
//! The pages that a first picture needs ([`ldi_protocol::manifest::early`]) arrive first; the
//! session receives the rest while pictures are drawn.

use super::{ConnectError, disk::DiskCache};
use ldi_protocol::{
    index::Index,
    manifest::{self, PageEntry, Root},
    wire::{StreamHeader, StreamKind, Welcome},
};

/// The received part of a manifest.
#[derive(Debug)]
pub(super) struct IndexPages {
    root: Root,
    /// The root's bytes, for the disk cache.
    root_bytes: Vec<u8>,
    pages: Vec<Option<Vec<u8>>>,
}

fn protocol(e: impl std::fmt::Display) -> ConnectError {
    ConnectError::Protocol(e.to_string())
}

impl IndexPages {
    /// A manifest without pages, from its root.
    pub fn new(root_bytes: Vec<u8>, welcome: &Welcome) -> Result<Self, ConnectError> {
        let root = manifest::decode_root(&root_bytes).map_err(protocol)?;
        if root.hash != welcome.dataset || root.pages.len() != welcome.pages as usize {
            return Err(protocol("the manifest is not the one announced"));
        }
        Ok(Self { pages: vec![None; root.pages.len()], root, root_bytes })
    }

    /// Stored bytes of all pages.
    pub fn stored_bytes(&self) -> u64 {
        self.root.pages.iter().map(|p| u64::from(p.stored_bytes)).sum()
    }

    /// The pages that a stream may bring.
    pub fn listed(&self) -> Vec<PageEntry> {
        self.root.pages.clone()
    }

    /// Adds a page whose stream was [listed](is_listed).
    pub fn take(&mut self, number: u32, bytes: Vec<u8>) {
        if let Some(page) = self.pages.get_mut(number as usize) {
            *page = Some(bytes);
        }
    }

    /// Whether all pages have arrived.
    pub fn are_whole(&self) -> bool {
        self.pages.iter().all(Option::is_some)
    }

    /// The partial index for a first picture, if its pages have arrived.
    pub fn early(&self) -> Result<Option<Index>, ConnectError> {
        manifest::early(&self.root, &self.pages).map_err(protocol)
    }

    /// Assembles the complete index, and stores the pages on disk.
    pub fn assemble(self, disk: Option<&DiskCache>) -> Result<Index, ConnectError> {
        let pages: Vec<Vec<u8>> = self.pages.into_iter().map(Option::unwrap_or_default).collect();
        let index = manifest::assemble(&self.root, &pages).map_err(protocol)?;
        if let Some(disk) = disk {
            self.root.pages.iter().zip(&pages).for_each(|(entry, page)| disk.store(&entry.hash, page));
            // The root is stored last, so that its pages always exist.
            disk.store_root(&self.root.hash, &self.root_bytes);
        }
        Ok(index)
    }
}

/// Whether a stream brings a listed page with the listed length.
pub(super) fn is_listed(listed: &[PageEntry], header: &StreamHeader) -> bool {
    let entry = listed.get(header.number as usize).filter(|_| header.kind == StreamKind::Page);
    entry.is_some_and(|p| p.stored_bytes == header.bytes)
}
