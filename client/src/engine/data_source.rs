//! The source of a walk's data: the interface between the engine and the network.

use crate::{
    cache::{Cache, Incomplete},
    resident::Resident,
    stream::{Connection, Stats},
};
use ldi_protocol::{Pose, index::Index, ldi::Ldi, mesh::CellGeometry, need::Needed, texture::Texture, tree::Brood};
use std::{sync::Arc, time::Duration};

/// Time without a connection after which a walk ends. A restarted server is up again by then.
pub const LOST_FOR: Duration = Duration::from_secs(30);

/// How long a frame of `--pace wait` waits for its chunks before it is drawn without them. Longer
/// than a complete view takes over a slow connection. A walk ends if no chunk at all arrives in
/// that time.
pub(super) const PATIENCE: Duration = Duration::from_secs(180);

/// Counters of received data.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Traffic {
    /// Connected seconds since the first connection.
    pub elapsed_s: f64,
    /// Bytes received since then, the dataset's index included.
    pub bytes: u64,
    /// Received bytes that no frame used: prefetched, outdated, duplicate or damaged.
    pub wasted_bytes: u64,
    /// 99th percentile of the rate over windows of one second, Mbit/s.
    pub mbit_per_s_p99_1s: f64,
    /// Largest number of decoded bytes in the cache.
    pub cache_peak_bytes: u64,
    /// Chunks given up because they arrived damaged.
    pub damaged_chunks: usize,
    /// Chunks received, or read from the disk.
    pub chunks: u64,
}

impl Traffic {
    /// Combines the statistics of all connections that share one cache.
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
    /// The dataset's index, as far as it has arrived. A frame reads it once.
    fn index(&self) -> &Index;

    /// Name of the dataset: hexadecimal BLAKE3 of its manifest.
    fn dataset_hash(&self) -> String;

    /// Reports the eye's pose and the chunks that the view needs. Returns at once.
    fn update_view(&self, pose: &Pose, needed: &Needed);

    /// Requests chunks by number. Returns at once.
    fn request(&self, chunks: &[u32]);

    /// Waits until all of `chunks` are resident, at most `patience`.
    ///
    /// # Errors
    ///
    /// Names the missing chunks and the reason. Without `Incomplete::Disconnected` a frame can
    /// still be drawn.
    fn wait_for(&self, chunks: &[u32], patience: Duration) -> Result<(), Incomplete>;

    /// The reason why no more data will arrive: there has been no connection for `patience`, or
    /// reconnecting cannot help.
    fn lost_reason(&self, patience: Duration) -> Option<String>;

    /// Whether a chunk is resident, decoded.
    fn holds(&self, chunk: u32) -> bool;

    /// Counters since the connection was opened.
    fn traffic(&self) -> Traffic;

    /// Largest number of decoded bytes that may be held.
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
