//! Where the server's bytes come from: the dataset on disk, or one in memory in tests.

use crate::store::{Dataset, StoreError};
use bytes::Bytes;
use ldi_protocol::{
    index::{ChunkHash, Index},
    manifest,
    select::CellGroups,
};
use std::{
    collections::{BTreeSet, HashMap},
    sync::{Arc, Mutex, PoisonError},
};

/// A dataset that can be served. All bytes are handed out as stored, and only if they are intact.
pub trait ChunkSource: Send + Sync + 'static {
    /// The decoded manifest.
    fn index(&self) -> &Arc<Index>;
    /// The manifest's root, at most [`ldi_protocol::wire::MAX_ROOT_BYTES`].
    fn root(&self) -> &[u8];
    /// Number of pages.
    fn pages(&self) -> u32;
    /// A page.
    ///
    /// # Errors
    /// If there is none of this number, or it cannot be read as it was written.
    fn page(&self, number: u32) -> Result<Bytes, StoreError>;
    /// A chunk.
    ///
    /// # Errors
    /// If there is none of this number, or it cannot be read as it was written.
    fn chunk(&self, number: u32) -> Result<Bytes, StoreError>;
}

impl ChunkSource for Dataset {
    fn index(&self) -> &Arc<Index> {
        self.index()
    }
    fn root(&self) -> &[u8] {
        self.manifest_root()
    }
    fn pages(&self) -> u32 {
        self.pages()
    }
    fn page(&self, number: u32) -> Result<Bytes, StoreError> {
        self.page(number)
    }
    fn chunk(&self, number: u32) -> Result<Bytes, StoreError> {
        self.chunk(number)
    }
}

/// What one server process serves: the source, its name, and the way from names to numbers.
pub struct Served {
    source: Arc<dyn ChunkSource>,
    hash: ChunkHash,
    numbers: HashMap<ChunkHash, u32>,
    groups: Arc<CellGroups>,
    /// Pages in the order of sending, and how many of them are enough for a first picture.
    pages: (Vec<u32>, usize),
    /// Pages and chunks that could not be read, so that each is logged once.
    unreadable: Mutex<BTreeSet<(bool, u32)>>,
}

impl Served {
    /// Looks through the source once.
    pub fn new(source: Arc<dyn ChunkSource>) -> Self {
        let numbers = source.index().chunks.iter().enumerate().map(|(i, c)| (c.hash, i as u32)).collect();
        let hash = ChunkHash(*blake3::hash(source.root()).as_bytes());
        let all = || ((0..source.pages()).collect(), source.pages() as usize);
        let tree = source.index().tree.as_ref();
        let pages = manifest::decode_root(source.root()).map_or_else(|_| all(), |root| root.sending_order(tree));
        let groups = Arc::new(CellGroups::of(&source.index().cells));
        Self { source, hash, numbers, groups, pages, unreadable: Mutex::default() }
    }
    /// BLAKE3 of the manifest's root.
    pub fn hash(&self) -> ChunkHash {
        self.hash
    }
    /// The decoded manifest.
    pub fn index(&self) -> &Arc<Index> {
        self.source.index()
    }
    /// Groups of the index's cells.
    pub fn groups(&self) -> &Arc<CellGroups> {
        &self.groups
    }
    /// The manifest's root.
    pub fn root(&self) -> &[u8] {
        self.source.root()
    }
    /// Numbers of the pages in the order of sending: those that are enough for a first picture,
    /// and the rest.
    pub fn pages(&self) -> (&[u32], &[u32]) {
        self.pages.0.split_at(self.pages.1)
    }
    /// The number of a chunk by its name.
    pub fn number_of(&self, name: &ChunkHash) -> Option<u32> {
        self.numbers.get(name).copied()
    }
    /// A chunk's bytes; None if there is none of this number, or it cannot be read, which is
    /// logged.
    pub fn chunk(&self, number: u32) -> Option<Bytes> {
        self.source.chunk(number).map_err(|e| self.log_unreadable((false, number), &e)).ok()
    }
    /// Whether a chunk exists and its bytes match its hash.
    pub fn is_intact(&self, number: u32) -> bool {
        let entry = self.index().chunks.get(number as usize);
        entry.zip(self.chunk(number)).is_some_and(|(entry, bytes)| blake3::hash(&bytes).as_bytes() == &entry.hash.0)
    }
    /// A page's bytes; None as with chunks.
    pub fn page(&self, number: u32) -> Option<Bytes> {
        self.source.page(number).map_err(|e| self.log_unreadable((true, number), &e)).ok()
    }

    fn log_unreadable(&self, which: (bool, u32), error: &StoreError) {
        metrics::counter!("ldi_unreadable_total").increment(1);
        // A client may ask for any number, which is no fault of the dataset.
        let is_fault = !matches!(error, StoreError::NoSuch { .. });
        let mut logged = self.unreadable.lock().unwrap_or_else(PoisonError::into_inner);
        if is_fault && logged.insert(which) {
            tracing::error!("{error}");
        }
    }
}

impl std::fmt::Debug for Served {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Served").field("hash", &self.hash).finish_non_exhaustive()
    }
}
