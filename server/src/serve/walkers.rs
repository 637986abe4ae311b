//! Who is connected: for the server's page, the metrics, and the numbers of walkers.

use ldi_protocol::Pose;
use serde::Serialize;
use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
};

/// What one walker was sent. Shared by the tasks of its connection.
#[derive(Debug, Default)]
pub struct Counters {
    bytes: AtomicU64,
    chunks: AtomicU64,
    stale: AtomicU64,
}

impl Counters {
    /// Bytes of chunks and pages handed to the transport.
    pub fn sent_bytes(&self, n: usize) {
        self.bytes.fetch_add(n as u64, Relaxed);
        metrics::counter!("ldi_chunk_bytes_total").increment(n as u64);
    }
    /// A chunk is out.
    pub fn sent_chunk(&self) {
        self.chunks.fetch_add(1, Relaxed);
        metrics::counter!("ldi_chunks_total").increment(1);
    }
    /// A chunk was given up because the walker moved on.
    pub fn stale(&self) {
        self.stale.fetch_add(1, Relaxed);
        metrics::counter!("ldi_stale_streams_total").increment(1);
    }
}

/// A connected walker, as the page shows it.
#[derive(Debug, Clone, Serialize)]
pub struct WalkerView {
    /// Its number.
    pub id: u64,
    /// What it calls itself.
    pub name: String,
    /// World position, metres; None before the first pose.
    pub position: Option<[f64; 3]>,
    /// Degrees.
    pub yaw_deg: f64,
    /// Degrees.
    pub pitch_deg: f64,
    /// Chunks sent.
    pub chunks: u64,
    /// Bytes sent.
    pub bytes: u64,
    /// Streams given up.
    pub stale: u64,
    /// Milliseconds.
    pub rtt_ms: f64,
}

#[derive(Debug)]
struct Walker {
    name: String,
    pose: Option<Pose>,
    rtt_ms: f64,
    counters: Arc<Counters>,
}

/// All connected walkers.
#[derive(Debug, Default)]
pub struct Walkers {
    next: AtomicU64,
    connected: Mutex<BTreeMap<u64, Walker>>,
}

/// A walker's entry; removed when dropped.
#[derive(Debug)]
pub struct Entry {
    walkers: Arc<Walkers>,
    /// Its number, from 1.
    pub id: u64,
    /// What it was sent.
    pub counters: Arc<Counters>,
}

impl Walkers {
    /// A walker came in.
    pub fn enter(self: &Arc<Self>, name: &str) -> Entry {
        let id = self.next.fetch_add(1, Relaxed) + 1;
        let counters = Arc::<Counters>::default();
        let name = name.chars().filter(|c| !c.is_control()).take(64).collect();
        let walker = Walker { name, pose: None, rtt_ms: 0.0, counters: counters.clone() };
        self.connected.lock().unwrap_or_else(PoisonError::into_inner).insert(id, walker);
        metrics::gauge!("ldi_walkers").increment(1.0);
        Entry { walkers: self.clone(), id, counters }
    }
    /// Everyone, by number.
    pub fn views(&self) -> Vec<WalkerView> {
        let connected = self.connected.lock().unwrap_or_else(PoisonError::into_inner);
        connected
            .iter()
            .map(|(&id, w)| WalkerView {
                id,
                name: w.name.clone(),
                position: w.pose.map(|p| p.position.to_array()),
                yaw_deg: w.pose.map_or(0.0, |p| p.yaw_deg),
                pitch_deg: w.pose.map_or(0.0, |p| p.pitch_deg),
                chunks: w.counters.chunks.load(Relaxed),
                bytes: w.counters.bytes.load(Relaxed),
                stale: w.counters.stale.load(Relaxed),
                rtt_ms: w.rtt_ms,
            })
            .collect()
    }
}

impl Entry {
    /// Where the walker is now.
    pub fn moved(&self, pose: Pose, rtt_ms: f64) {
        let mut connected = self.walkers.connected.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(w) = connected.get_mut(&self.id) {
            w.pose = Some(pose);
            w.rtt_ms = rtt_ms;
        }
    }
}

impl Drop for Entry {
    fn drop(&mut self) {
        self.walkers.connected.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.id);
        metrics::gauge!("ldi_walkers").decrement(1.0);
    }
}
