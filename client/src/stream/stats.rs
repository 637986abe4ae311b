//! Statistics of received data, and of its use.

use super::{simulated_link::LinkCounts, simulated_socket::SimulatedSocket};
use std::{
    sync::{Arc, Mutex, OnceLock, PoisonError},
    time::{Duration, Instant},
};

/// Interval at which the received bytes are sampled, the precision of rates over one second.
pub(super) const SAMPLE_EVERY: Duration = Duration::from_millis(100);
/// Largest number of samples.
const MAX_SAMPLES: usize = 864_000;
/// Samples in a one-second window.
const WINDOW: usize = 10;

/// A chunk's arrival.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// Time since the connection began.
    pub at: Duration,
    /// Chunk number.
    pub chunk: u32,
    /// Stored bytes.
    pub bytes: u32,
    /// The reason for sending it.
    pub urgency: ldi_protocol::wire::Urgency,
}

/// Statistics of a connection.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Stats {
    /// Time since the connection began.
    pub elapsed: Duration,
    /// Received UDP payload, including handshake, pages, chunks and retransmissions.
    pub bytes_total: u64,
    /// Bytes sent on the wire.
    pub bytes_sent: u64,
    /// Stored bytes of chunks received whole, right and for the first time.
    pub chunk_bytes: u64,
    /// How many they were.
    pub chunks: u64,
    /// Stored bytes received in vain: duplicates, damaged chunks, streams that broke off.
    pub lost_bytes: u64,
    /// Chunks with a wrong hash.
    pub damaged: u64,
    /// Chunks that were already held.
    pub duplicates: u64,
    /// Streams that the server reset.
    pub broken_off: u64,
    /// Chunks sent ahead that were abandoned because of the decode backlog.
    pub abandoned: u64,
    /// Chunks read from disk.
    pub disk_chunks: u64,
    /// Stored bytes of chunks read from disk.
    pub disk_bytes: u64,
    /// [`Stats::lost_bytes`], plus chunks that no frame used.
    pub wasted_bytes: u64,
    /// Mean rate of the connection.
    pub mbit_per_s_mean: f64,
    /// 99th percentile over windows of one second, one per tenth of a second.
    pub mbit_per_s_p99_1s: f64,
    /// Round trip, milliseconds.
    pub rtt_ms: f64,
    /// Sent packets that were lost.
    pub lost_packets: u64,
    /// Packet counts of [`super::ConnectConfig::link`], up and down; None without a link.
    pub link: Option<[LinkCounts; 2]>,
}

impl Stats {
    /// Combines the statistics of two connections with one cache. `useful_bytes` as in
    /// [`Collector::snapshot`], of both.
    pub fn and_then(&self, next: &Self, useful_bytes: u64) -> Self {
        let (elapsed, bytes_total) = (self.elapsed + next.elapsed, self.bytes_total + next.bytes_total);
        let (chunk_bytes, lost_bytes) = (self.chunk_bytes + next.chunk_bytes, self.lost_bytes + next.lost_bytes);
        let mut link = self.link.or(next.link);
        if let (Some(both), Some(_), Some(next)) = (&mut link, self.link, next.link) {
            both.iter_mut().zip(next).for_each(|(a, b)| *a += b);
        }
        Self {
            elapsed,
            bytes_total,
            bytes_sent: self.bytes_sent + next.bytes_sent,
            chunk_bytes,
            chunks: self.chunks + next.chunks,
            lost_bytes,
            damaged: self.damaged + next.damaged,
            duplicates: self.duplicates + next.duplicates,
            broken_off: self.broken_off + next.broken_off,
            abandoned: self.abandoned + next.abandoned,
            disk_chunks: self.disk_chunks + next.disk_chunks,
            disk_bytes: self.disk_bytes + next.disk_bytes,
            wasted_bytes: chunk_bytes.saturating_sub(useful_bytes) + lost_bytes,
            mbit_per_s_mean: bytes_total as f64 * 8e-6 / elapsed.as_secs_f64().max(1e-9),
            mbit_per_s_p99_1s: self.mbit_per_s_p99_1s.max(next.mbit_per_s_p99_1s),
            rtt_ms: next.rtt_ms,
            lost_packets: self.lost_packets + next.lost_packets,
            link,
        }
    }
}

#[derive(Debug, Default)]
struct Inner {
    stats: Stats,
    arrivals: Vec<Arrival>,
    /// Received bytes at multiples of [`SAMPLE_EVERY`].
    samples: Vec<u64>,
}

/// Collects statistics from the tasks and threads of a connection.
#[derive(Debug)]
pub(super) struct Collector {
    start: Instant,
    /// Set once the connection is open.
    wire: OnceLock<quinn::Connection>,
    link: OnceLock<Arc<SimulatedSocket>>,
    inner: Mutex<Inner>,
}

impl Collector {
    pub fn new() -> Self {
        Self { start: Instant::now(), wire: OnceLock::new(), link: OnceLock::new(), inner: Mutex::default() }
    }
    fn with<T>(&self, f: impl FnOnce(&mut Inner) -> T) -> T {
        f(&mut self.inner.lock().unwrap_or_else(PoisonError::into_inner))
    }
    pub fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }
    pub fn arrived(&self, chunk: u32, bytes: u32, urgency: ldi_protocol::wire::Urgency) {
        let at = self.elapsed();
        self.with(|i| {
            i.stats.chunks += 1;
            i.stats.chunk_bytes += u64::from(bytes);
            if i.arrivals.len() < MAX_SAMPLES {
                i.arrivals.push(Arrival { at, chunk, bytes, urgency });
            }
        });
    }
    pub fn duplicate(&self, bytes: u64) {
        self.with(|i| {
            i.stats.duplicates += 1;
            i.stats.lost_bytes += bytes;
        });
    }
    pub fn damaged(&self, bytes: u64) {
        self.with(|i| {
            i.stats.damaged += 1;
            i.stats.lost_bytes += bytes;
        });
    }
    pub fn broken_off(&self, bytes: u64) {
        self.with(|i| {
            i.stats.broken_off += 1;
            i.stats.lost_bytes += bytes;
        });
    }
    pub fn abandoned(&self, bytes: u64) {
        self.with(|i| {
            i.stats.abandoned += 1;
            i.stats.lost_bytes += bytes;
        });
    }
    pub fn read_from_disk(&self, bytes: u64) {
        self.with(|i| {
            i.stats.disk_chunks += 1;
            i.stats.disk_bytes += bytes;
        });
    }
    /// Undoes the count of a chunk read from disk that was already held, or damaged.
    pub fn not_read_from_disk(&self, bytes: u64) {
        self.with(|i| {
            i.stats.disk_chunks -= 1;
            i.stats.disk_bytes -= bytes;
        });
    }
    /// Undoes the count of an arrival that was already held, or could not be decoded.
    pub fn take_back(&self, bytes: u32) {
        self.with(|i| {
            i.stats.chunks -= 1;
            i.stats.chunk_bytes -= u64::from(bytes);
        });
    }
    /// Sets the connection whose bytes are counted, and its link.
    pub fn watch(&self, connection: quinn::Connection, link: Option<Arc<SimulatedSocket>>) {
        let _ = self.wire.set(connection);
        if let Some(link) = link {
            let _ = self.link.set(link);
        }
    }
    /// Samples the received bytes; called every [`SAMPLE_EVERY`].
    pub fn tick(&self) {
        let bytes = self.received();
        self.with(|i| {
            if i.samples.len() < MAX_SAMPLES {
                i.samples.push(bytes);
            }
        });
    }
    /// Received bytes so far.
    pub fn received(&self) -> u64 {
        self.wire.get().map_or(0, |c| c.stats().udp_rx.bytes)
    }
    /// Round trip, milliseconds.
    pub fn rtt_ms(&self) -> f64 {
        self.wire.get().map_or(0.0, |c| c.rtt().as_secs_f64() * 1e3)
    }
    pub fn arrivals(&self) -> Vec<Arrival> {
        self.with(|i| i.arrivals.clone())
    }
    /// A snapshot of the statistics. `useful_bytes`: stored bytes of chunks that frames used.
    pub fn snapshot(&self, useful_bytes: u64) -> Stats {
        let elapsed = self.elapsed();
        self.with(|i| {
            let mut s = i.stats.clone();
            s.elapsed = elapsed;
            if let Some(wire) = self.wire.get().map(quinn::Connection::stats) {
                s.bytes_total = wire.udp_rx.bytes;
                s.bytes_sent = wire.udp_tx.bytes;
                s.rtt_ms = wire.path.rtt.as_secs_f64() * 1e3;
                s.lost_packets = wire.path.lost_packets;
            }
            s.link = self.link.get().map(|l| l.counts());
            s.wasted_bytes = s.chunk_bytes.saturating_sub(useful_bytes) + s.lost_bytes;
            s.mbit_per_s_mean = s.bytes_total as f64 * 8e-6 / elapsed.as_secs_f64().max(1e-9);
            s.mbit_per_s_p99_1s = p99_of_windows(&i.samples);
            s
        })
    }
}

/// 99th percentile (nearest rank) of the rate over all windows of one second, Mbit/s; or the mean
/// of a shorter time.
fn p99_of_windows(samples: &[u64]) -> f64 {
    let window = WINDOW.min(samples.len().saturating_sub(1));
    if window == 0 {
        return 0.0;
    }
    let mut bytes: Vec<u64> = samples.windows(window + 1).map(|w| w[window] - w[0]).collect();
    bytes.sort_unstable();
    let rank = (bytes.len() as f64 * 0.99).ceil() as usize;
    let seconds = window as f64 * SAMPLE_EVERY.as_secs_f64();
    bytes[rank.clamp(1, bytes.len()) - 1] as f64 * 8e-6 / seconds
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_of_a_steady_stream_and_of_a_burst() {
        // 125,000 bytes per tenth of a second: 10 Mbit/s.
        let steady: Vec<u64> = (0..100).map(|i| i * 125_000).collect();
        assert!((p99_of_windows(&steady) - 10.0).abs() < 1e-9);
        // One burst of 1 MB within 10 s: 8 Mbit in the ten windows that hold it, of 90.
        let burst: Vec<u64> = (0..100).map(|i| if i < 50 { 0 } else { 1_000_000 }).collect();
        assert!((p99_of_windows(&burst) - 8.0).abs() < 1e-9);
        assert_eq!(p99_of_windows(&[]), 0.0);
        assert_eq!(p99_of_windows(&[5]), 0.0);
    }

    #[test]
    fn one_connection_after_the_other() {
        let of = |chunk_bytes, wasted_bytes, seconds| Stats {
            elapsed: Duration::from_secs(seconds),
            bytes_total: chunk_bytes + 10,
            chunk_bytes,
            wasted_bytes,
            mbit_per_s_p99_1s: chunk_bytes as f64,
            ..Stats::default()
        };
        // 70 of 100 bytes were useful; then 20 more came, and frames used them and 10 of those
        // before.
        let both = of(100, 30, 3).and_then(&of(20, 0, 1), 100);
        assert_eq!((both.chunk_bytes, both.wasted_bytes, both.bytes_total), (120, 20, 140));
        assert_eq!((both.elapsed.as_secs(), both.mbit_per_s_p99_1s), (4, 100.0));
        assert!((both.mbit_per_s_mean - 140.0 * 8e-6 / 4.0).abs() < 1e-12);
        assert_eq!(Stats::default().and_then(&both, 100), both);
    }

    #[test]
    fn waste_is_what_no_frame_used() {
        use ldi_protocol::wire::Urgency;
        let c = Collector::new();
        c.arrived(0, 100, Urgency::Now);
        c.arrived(1, 50, Urgency::Around);
        c.broken_off(7);
        let s = c.snapshot(100);
        assert_eq!((s.chunk_bytes, s.chunks, s.wasted_bytes), (150, 2, 57));
        assert_eq!(c.arrivals().len(), 2);
    }
}
