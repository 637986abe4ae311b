//! Who is connected: for the server's page, the metrics, and the numbers of walkers.

use ldi_protocol::{
    Pose,
    said::escaped,
    wire::{MAX_NAME_CHARS, MAX_OTHERS, Other},
};
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
    /// Chunks and bytes sent so far.
    pub fn sent(&self) -> (u64, u64) {
        (self.chunks.load(Relaxed), self.bytes.load(Relaxed))
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
    /// The name that it gave, escaped and cut.
    pub name: String,
    /// The name of the dataset that it walks in.
    pub dataset: String,
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
    dataset: String,
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
    /// Its name as it is shown.
    pub name: String,
    /// What it was sent.
    pub counters: Arc<Counters>,
}

impl Walkers {
    /// A walker came into a dataset.
    pub fn enter(self: &Arc<Self>, name: &str, dataset: &str) -> Entry {
        let id = self.next.fetch_add(1, Relaxed) + 1;
        let counters = Arc::<Counters>::default();
        let name: String = escaped(name).chars().take(MAX_NAME_CHARS).collect();
        let (dataset, counters_kept) = (dataset.to_owned(), counters.clone());
        let walker = Walker { name: name.clone(), dataset, pose: None, rtt_ms: 0.0, counters: counters_kept };
        self.connected.lock().unwrap_or_else(PoisonError::into_inner).insert(id, walker);
        metrics::gauge!("ldi_walkers").increment(1.0);
        Entry { walkers: self.clone(), id, name, counters }
    }
    /// Everyone in a dataset, or in any, by number.
    pub fn views(&self, dataset: Option<&str>) -> Vec<WalkerView> {
        let connected = self.connected.lock().unwrap_or_else(PoisonError::into_inner);
        connected
            .iter()
            .filter(|(_, w)| dataset.is_none_or(|d| d == w.dataset))
            .map(|(&id, w)| WalkerView {
                id,
                name: w.name.clone(),
                dataset: w.dataset.clone(),
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
    /// Where all others in a walker's dataset are, those nearest to it: at most [`MAX_OTHERS`], by
    /// number.
    pub fn others(&self, than: u64) -> Vec<Other> {
        let connected = self.connected.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(own) = connected.get(&than) else { return Vec::new() };
        let here = own.pose.map(|p| p.position);
        let far = |p: &Pose| here.map_or(0.0, |h| h.distance_squared(p.position));
        let rest = connected.iter().filter(|(id, w)| **id != than && w.dataset == own.dataset);
        let mut rest: Vec<(u64, &str, Pose)> =
            rest.filter_map(|(id, w)| w.pose.map(|p| (*id, w.name.as_str(), p))).collect();
        rest.sort_by(|a, b| far(&a.2).total_cmp(&far(&b.2)));
        rest.truncate(MAX_OTHERS);
        rest.sort_by_key(|(id, ..)| *id);
        let told = |(walker, name, pose): (u64, &str, Pose)| Other {
            walker,
            name: name.to_owned(),
            position: pose.position.to_array(),
            // A walker may say any finite yaw, and must not spoil the others' message with one
            // beyond f32.
            yaw_deg: pose.yaw_deg.rem_euclid(360.0) as f32,
        };
        rest.into_iter().map(told).collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use ldi_protocol::wire;

    #[test]
    fn the_nearest_others_are_told_by_number_and_never_oneself() {
        let all = Arc::<Walkers>::default();
        let at = |x: f64| Pose { position: DVec3::new(x, 0.0, 0.0), yaw_deg: 10.0, pitch_deg: 0.0 };
        let entries: Vec<Entry> = (0..MAX_OTHERS + 3).map(|i| all.enter(&format!("{i}\n"), "house")).collect();
        let elsewhere = all.enter("elsewhere", "museum");
        elsewhere.moved(at(-1.0), 1.0);
        let me = entries[0].id;
        assert!(all.others(me).is_empty(), "nobody has said yet where it is");
        // The later, the nearer, but for the last, which does not say.
        entries.iter().rev().skip(1).enumerate().for_each(|(i, e)| e.moved(at(i as f64), 1.0));
        entries[0].moved(at(-1.0), 1.0);
        let told = all.others(me);
        let numbers: Vec<u64> = told.iter().map(|o| o.walker).collect();
        let expected: Vec<u64> = entries[2..entries.len() - 1].iter().map(|e| e.id).collect();
        assert_eq!((numbers.len(), numbers), (MAX_OTHERS, expected), "all but the farthest");
        assert_eq!((told[0].name.as_str(), told[0].position, told[0].yaw_deg), (r"2\n", [63.0, 0.0, 0.0], 10.0));
        // Whatever finite pose and name somebody has, the others' message can be sent.
        entries[5].moved(Pose { yaw_deg: -1e300, ..at(0.5) }, 1.0);
        let long = all.enter(&"\u{10348}".repeat(1_000), "house");
        long.moved(at(0.0), 1.0);
        assert!(wire::encode(&wire::ServerMessage::Others { walkers: all.others(me) }).is_ok());
        let datasets = |d: Option<&str>| all.views(d).len();
        assert_eq!((datasets(Some("museum")), datasets(None)), (1, MAX_OTHERS + 5));
        drop((entries, long));
        assert!(all.others(elsewhere.id).is_empty());
    }
}
