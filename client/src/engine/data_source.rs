//! Where a walk gets its data: the one door between the engine and the network.

use crate::{
    cache::{Cache, Incomplete},
    resident::Resident,
    stream::{Connection, Stats},
};
use ldi_protocol::{Pose, index::Index, ldi::Ldi, mesh::CellGeometry, need::Needed, texture::Texture, tree::Brood};
use std::{sync::Arc, time::Duration};

/// A line that is down for so long is not waited for any more: a server that is started again is up
/// by then.
pub const LOST_FOR: Duration = Duration::from_secs(30);

/// What came over the line so far.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Traffic {
    /// Seconds since the start of the connection; of several in a row those with one.
    pub elapsed_s: f64,
    /// Bytes received since then, the dataset's index included.
    pub bytes: u64,
    /// Bytes that no frame used: prefetched, stale, twice, or damaged.
    pub wasted_bytes: u64,
    /// Rate over the busiest seconds, Mbit/s: 99 of 100 seconds were below.
    pub mbit_per_s_p99_1s: f64,
    /// Largest sum of decoded bytes that the cache held.
    pub cache_peak_bytes: u64,
    /// Chunks that came damaged until they were given up.
    pub damaged_chunks: usize,
    /// Chunks received, or read from the disk.
    pub chunks: u64,
}

impl Traffic {
    /// What the statistics of a connection, or of several with one cache, say.
    pub fn of(stats: &Stats, cache: &Cache) -> Self {
        Self {
            elapsed_s: stats.elapsed.as_secs_f64(),
            bytes: stats.bytes_total,
            wasted_bytes: stats.wasted_bytes,
            mbit_per_s_p99_1s: stats.mbit_per_s_p99_1s,
            cache_peak_bytes: cache.usage().peak_bytes,
            damaged_chunks: cache.damaged(),
            chunks: stats.chunks + stats.disk_chunks,
        }
    }
}

/// A source of chunks: a connection with its cache, or memory in tests.
pub trait DataSource: Resident {
    /// The dataset's index, as far as it is here; a frame asks once.
    fn index(&self) -> &Index;

    /// Name of the dataset: hexadecimal BLAKE3 of its manifest.
    fn dataset_hash(&self) -> String;

    /// Says where the walker is and what the view needs, so that it stays or is sent; returns at once.
    fn update_view(&self, pose: &Pose, needed: &Needed);

    /// Asks for chunks by number; returns at once.
    fn request(&self, chunks: &[u32]);

    /// Waits until all of `chunks` are resident, at most `patience`.
    ///
    /// # Errors
    ///
    /// What is missing and why. Unless the connection is gone, a frame can be drawn without it.
    fn wait_for(&self, chunks: &[u32], patience: Duration) -> Result<(), Incomplete>;

    /// Why nothing comes any more: there has been no connection for `patience`, or connecting again
    /// does not help.
    fn lost_reason(&self, patience: Duration) -> Option<String>;

    /// Whether a chunk is resident, decoded.
    fn holds(&self, chunk: u32) -> bool;

    /// Counters since the connection was opened.
    fn traffic(&self) -> Traffic;

    /// Decoded bytes that are held at most.
    fn cap_bytes(&self) -> u64 {
        u64::MAX
    }
}

impl Resident for Connection {
    fn cell(&self, cell: u32) -> Option<Arc<CellGeometry>> {
        self.cache().cell(cell)
    }
    fn bundle(&self, chunk: u32) -> Option<Arc<CellGeometry>> {
        self.cache().bundle(chunk)
    }
    fn texture(&self, texture: u32) -> Option<Arc<Texture>> {
        self.cache().texture(texture)
    }
    fn ldi(&self, image: u32) -> Option<Arc<Ldi>> {
        self.cache().ldi(image)
    }
    fn brood(&self, chunk: u32) -> Option<Arc<Brood>> {
        self.cache().brood(chunk)
    }
}

impl DataSource for Connection {
    fn index(&self) -> &Index {
        Self::index(self)
    }
    fn dataset_hash(&self) -> String {
        self.dataset().to_string()
    }
    fn update_view(&self, pose: &Pose, needed: &Needed) {
        Self::update_view(self, pose, needed);
    }
    fn request(&self, chunks: &[u32]) {
        self.request(chunks);
    }
    fn wait_for(&self, chunks: &[u32], patience: Duration) -> Result<(), Incomplete> {
        self.wait_until_complete(chunks, patience)
    }
    fn lost_reason(&self, _: Duration) -> Option<String> {
        self.cache().disconnected()
    }
    fn holds(&self, chunk: u32) -> bool {
        self.cache().holds(chunk)
    }
    fn cap_bytes(&self) -> u64 {
        self.cache().usage().cap_bytes
    }
    fn traffic(&self) -> Traffic {
        Traffic::of(&self.stats(), self.cache())
    }
}
