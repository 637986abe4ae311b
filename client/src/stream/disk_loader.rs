//! The disk loader: loads chunks from disk to the cache.
//!
//! The server counts chunks on disk as held and never sends them. The loader loads those that a
//! view lacks at once, and those around the eye in advance, because decoding takes long. Reading
//! and decoding happen on the decoding threads. A damaged or missing file is reported to the server
//! as dropped, which then sends the chunk.

use super::{
    decoder::{DecodeJob, DecodePool, DecodeTarget},
    disk_chunks::DiskChunks,
};
use ldi_protocol::wire::Urgency;
use std::sync::{Arc, atomic::Ordering::Relaxed};

/// Largest number of chunks around the eye that are being loaded. Larger: they are chosen too
/// early; smaller: threads become idle between two updates.
const AHEAD: usize = 32;

/// Loads chunks from disk to the cache.
#[derive(Debug, Clone)]
pub(super) struct DiskLoader {
    pub disk_chunks: Arc<DiskChunks>,
    pub target: Arc<DecodeTarget>,
    pub pool: Arc<DecodePool>,
}

impl DiskLoader {
    /// Loads the chunks that a view lacks.
    pub fn load_needed(&self, chunks: impl Iterator<Item = u32>) {
        let lacking: Vec<u32> = chunks.filter(|c| self.disk_chunks.holds(*c)).collect();
        self.target.cache.missing(lacking).into_iter().for_each(|c| self.load(c, Urgency::Now));
    }

    /// Loads chunks around the eye, the first ones first, as far as the threads keep up.
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
