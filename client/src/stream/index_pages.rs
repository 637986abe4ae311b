//! The pages of a manifest as they arrive.
//!
//! A few of them are enough for a first picture ([`ldi_protocol::manifest::early`]) and come first; the session takes in the rest while pictures are drawn.

use super::{ConnectError, disk::DiskCache};
use ldi_protocol::{
    index::Index,
    manifest::{self, PageEntry, Root},
    wire::{StreamHeader, StreamKind, Welcome},
};

/// What there is of a manifest.
#[derive(Debug)]
pub(super) struct IndexPages {
    root: Root,
    /// As it came, for the disk.
    root_bytes: Vec<u8>,
    pages: Vec<Option<Vec<u8>>>,
}

fn protocol(e: impl std::fmt::Display) -> ConnectError {
    ConnectError::Protocol(e.to_string())
}

impl IndexPages {
    /// None of those that this root lists.
    pub fn new(root_bytes: Vec<u8>, welcome: &Welcome) -> Result<Self, ConnectError> {
        let root = manifest::decode_root(&root_bytes).map_err(protocol)?;
        if root.hash != welcome.dataset || root.pages.len() != welcome.pages as usize {
            return Err(protocol("the manifest is not the one announced"));
        }
        Ok(Self { pages: vec![None; root.pages.len()], root, root_bytes })
    }

    /// Stored bytes of all.
    pub fn stored_bytes(&self) -> u64 {
        self.root.pages.iter().map(|p| u64::from(p.stored_bytes)).sum()
    }

    /// What a stream has to be to bring one of them.
    pub fn listed(&self) -> Vec<PageEntry> {
        self.root.pages.clone()
    }

    /// Takes one in; its stream was one of those [listed](is_listed).
    pub fn take(&mut self, number: u32, bytes: Vec<u8>) {
        if let Some(page) = self.pages.get_mut(number as usize) {
            *page = Some(bytes);
        }
    }

    /// Whether all are here.
    pub fn are_whole(&self) -> bool {
        self.pages.iter().all(Option::is_some)
    }

    /// The index for a first picture, if there is enough for it.
    pub fn early(&self) -> Result<Option<Index>, ConnectError> {
        manifest::early(&self.root, &self.pages).map_err(protocol)
    }

    /// The whole index; kept on the disk as well.
    pub fn assemble(self, disk: Option<&DiskCache>) -> Result<Index, ConnectError> {
        let pages: Vec<Vec<u8>> = self.pages.into_iter().map(Option::unwrap_or_default).collect();
        let index = manifest::assemble(&self.root, &pages).map_err(protocol)?;
        if let Some(disk) = disk {
            self.root.pages.iter().zip(&pages).for_each(|(entry, page)| disk.store(&entry.hash, page));
            // Last: what has a root has its pages.
            disk.store_root(&self.root.hash, &self.root_bytes);
        }
        Ok(index)
    }
}

/// Whether a stream brings a page that is listed, as it is listed.
pub(super) fn is_listed(listed: &[PageEntry], header: &StreamHeader) -> bool {
    let entry = listed.get(header.number as usize).filter(|_| header.kind == StreamKind::Page);
    entry.is_some_and(|p| p.stored_bytes == header.bytes)
}
