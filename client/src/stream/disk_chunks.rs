//! The chunks of one index that lie on disk, and which of them are being read.

use super::disk::DiskCache;
use crate::cache::Cache;
use ldi_protocol::wire::Urgency;
use std::sync::{
    Arc,
    atomic::{AtomicU8, AtomicUsize, Ordering::Relaxed},
};

const ELSEWHERE: u8 = 0;
const HERE: u8 = 1;
const BEING_READ: u8 = 2;

/// State of the chunks of one index on disk.
#[derive(Debug)]
pub(super) struct DiskChunks {
    disk: Arc<DiskCache>,
    /// Holds the index.
    cache: Arc<Cache>,
    /// State of each chunk.
    states: Vec<AtomicU8>,
    pub reading_ahead: AtomicUsize,
}

impl DiskChunks {
    /// Lists the chunks on disk.
    pub fn new(disk: Arc<DiskCache>, cache: Arc<Cache>) -> Self {
        let states = cache.index().chunks.iter().map(|_| AtomicU8::new(ELSEWHERE)).collect();
        let disk_chunks = Self { disk, cache, states, reading_ahead: AtomicUsize::new(0) };
        disk_chunks.refresh();
        disk_chunks
    }

    /// Checks again for chunks that were absent, or not part of the index.
    pub fn refresh(&self) {
        for (entry, state) in self.cache.index().chunks.iter().zip(&self.states) {
            if state.load(Relaxed) == ELSEWHERE && self.disk.has(&entry.hash, entry.stored_bytes) {
                state.store(HERE, Relaxed);
            }
        }
    }

    /// Numbers of the chunks on disk, ascending.
    pub fn chunk_numbers(&self) -> Vec<u32> {
        (0u32..).zip(&self.states).filter(|(_, s)| s.load(Relaxed) != ELSEWHERE).map(|(c, _)| c).collect()
    }

    /// Whether a chunk is on disk.
    pub fn holds(&self, chunk: u32) -> bool {
        self.states.get(chunk as usize).is_some_and(|s| s.load(Relaxed) != ELSEWHERE)
    }

    /// Claims a chunk for reading. False if it is absent or already being read.
    pub fn claim(&self, chunk: u32) -> bool {
        let Some(state) = self.states.get(chunk as usize) else { return false };
        state.compare_exchange(HERE, BEING_READ, Relaxed, Relaxed).is_ok()
    }

    /// Reads a claimed chunk. None if it is damaged or gone.
    pub fn read(&self, chunk: u32) -> Option<Vec<u8>> {
        let entry = self.cache.index().chunks.get(chunk as usize)?;
        self.disk.load(&entry.hash, entry.stored_bytes)
    }

    /// Releases a claimed chunk. `sound`: whether it could be decoded; otherwise it counts as
    /// absent.
    pub fn release(&self, chunk: u32, urgency: Urgency, sound: bool) {
        if let Some(state) = self.states.get(chunk as usize) {
            state.store(if sound { HERE } else { ELSEWHERE }, Relaxed);
        }
        if !urgency.is_pressing() {
            self.reading_ahead.fetch_sub(1, Relaxed);
        }
    }

    /// Stores a received chunk.
    pub fn store(&self, chunk: u32, bytes: &[u8]) {
        let Some(entry) = self.cache.index().chunks.get(chunk as usize) else { return };
        self.disk.store(&entry.hash, bytes);
        if self.disk.has(&entry.hash, entry.stored_bytes) {
            let _ = self.states[chunk as usize].compare_exchange(ELSEWHERE, HERE, Relaxed, Relaxed);
        }
    }
}
