//! The disk cache as one connection uses it: which chunks lie there, which are being read, what is to be read next.
//!
//! The server counts what lies here as held and never sends it, so that the client brings it by itself: what a view lacks at once, before all else, and
//! what lies around the eye in advance, as decoding takes tens of milliseconds. Reading and decoding happen on the decoding threads. A file that turns out to be
//! damaged or gone is told to the server as dropped, and comes from there.

use super::{
    decoder::{DecodeJob, DecodePool, DecodeTarget},
    disk::DiskCache,
};
use crate::cache::Cache;
use ldi_protocol::wire::Urgency;
use std::sync::{
    Arc,
    atomic::{AtomicU8, AtomicUsize, Ordering::Relaxed},
};

/// Chunks around the eye that are being read, at most. More: they are chosen too early; fewer: the threads run dry between two looks.
const AHEAD: usize = 32;

const ELSEWHERE: u8 = 0;
const HERE: u8 = 1;
const BEING_READ: u8 = 2;

/// Chunks of one index that lie on disk.
#[derive(Debug)]
pub(super) struct DiskChunks {
    disk: Arc<DiskCache>,
    /// Knows the index.
    cache: Arc<Cache>,
    /// One per chunk.
    states: Vec<AtomicU8>,
    reading_ahead: AtomicUsize,
}

impl DiskChunks {
    /// Looks what is there.
    pub fn new(disk: Arc<DiskCache>, cache: Arc<Cache>) -> Self {
        let states = cache.index().chunks.iter().map(|_| AtomicU8::new(ELSEWHERE)).collect();
        let disk_chunks = Self { disk, cache, states, reading_ahead: AtomicUsize::new(0) };
        disk_chunks.refresh();
        disk_chunks
    }

    /// Looks for what was not there, or not known.
    pub fn refresh(&self) {
        for (entry, state) in self.cache.index().chunks.iter().zip(&self.states) {
            if state.load(Relaxed) == ELSEWHERE && self.disk.has(&entry.hash, entry.stored_bytes) {
                state.store(HERE, Relaxed);
            }
        }
    }

    /// Numbers of the chunks that lie here, ascending.
    pub fn chunk_numbers(&self) -> Vec<u32> {
        (0u32..).zip(&self.states).filter(|(_, s)| s.load(Relaxed) != ELSEWHERE).map(|(c, _)| c).collect()
    }

    /// Whether a chunk lies here.
    pub fn holds(&self, chunk: u32) -> bool {
        self.states.get(chunk as usize).is_some_and(|s| s.load(Relaxed) != ELSEWHERE)
    }

    /// Takes a chunk for reading. False: it is not here, or somebody reads it already.
    fn claim(&self, chunk: u32) -> bool {
        let Some(state) = self.states.get(chunk as usize) else { return false };
        state.compare_exchange(HERE, BEING_READ, Relaxed, Relaxed).is_ok()
    }

    /// Reads a chunk that was taken. None: it is damaged or gone, and no longer here.
    pub fn read(&self, chunk: u32) -> Option<Vec<u8>> {
        let entry = self.cache.index().chunks.get(chunk as usize)?;
        self.disk.load(&entry.hash, entry.stored_bytes)
    }

    /// What was taken has been read, and decoded if it was sound.
    pub fn release(&self, chunk: u32, urgency: Urgency, sound: bool) {
        if let Some(state) = self.states.get(chunk as usize) {
            state.store(if sound { HERE } else { ELSEWHERE }, Relaxed);
        }
        if !urgency.is_pressing() {
            self.reading_ahead.fetch_sub(1, Relaxed);
        }
    }

    /// Keeps a chunk that came over the network.
    pub fn store(&self, chunk: u32, bytes: &[u8]) {
        let Some(entry) = self.cache.index().chunks.get(chunk as usize) else { return };
        self.disk.store(&entry.hash, bytes);
        if self.disk.has(&entry.hash, entry.stored_bytes) {
            let _ = self.states[chunk as usize].compare_exchange(ELSEWHERE, HERE, Relaxed, Relaxed);
        }
    }
}

/// Brings chunks from the shelf to the cache.
#[derive(Debug, Clone)]
pub(super) struct DiskLoader {
    pub disk_chunks: Arc<DiskChunks>,
    pub target: Arc<DecodeTarget>,
    pub pool: Arc<DecodePool>,
}

impl DiskLoader {
    /// Brings what a view lacks.
    pub fn load_needed(&self, chunks: impl Iterator<Item = u32>) {
        let lacking: Vec<u32> = chunks.filter(|c| self.disk_chunks.holds(*c)).collect();
        self.target.cache.missing(lacking).into_iter().for_each(|c| self.load(c, Urgency::Now));
    }

    /// Brings what lies around, the first ones first, as far as the threads keep up.
    pub fn load_around(&self, chunks: &[u32]) {
        let room = |s: &DiskChunks| AHEAD.saturating_sub(s.reading_ahead.load(Relaxed));
        let here = chunks.iter().copied().filter(|c| self.disk_chunks.holds(*c));
        let lacking = self.target.cache.missing(here);
        for chunk in lacking.into_iter().take(room(&self.disk_chunks)) {
            self.load(chunk, Urgency::Around);
        }
    }

    fn load(&self, chunk: u32, urgency: Urgency) {
        if self.disk_chunks.claim(chunk) {
            if !urgency.is_pressing() {
                self.disk_chunks.reading_ahead.fetch_add(1, Relaxed);
            }
            self.pool.read(DecodeJob { chunk, urgency, bytes: None, target: self.target.clone() });
        }
    }
}
