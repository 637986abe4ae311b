//! One simulated walker: a connection and a cache as the client has them, a frame every sixtieth
//! of a second, and no picture.
//!
//! At each frame the walker says where it is, as `ldi-client walk --pace realtime` does, and looks
//! what of its view is at hand. A chunk's latency runs from the frame that first misses it until
//! the cache holds it, decoded.

use super::track::{FPS, Track};
use hdrhistogram::Histogram;
use ldi_client::stream::{ConnectConfig, ConnectError, Connection, Stats};
use ldi_protocol::{OutputCamera, index::Index};
use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};
use tokio::{
    sync::mpsc::{UnboundedReceiver, unbounded_channel},
    time::sleep_until,
};

/// Longest latency that is told apart: an hour.
const MAX_US: u64 = 3_600_000_000;

/// Latencies of both kinds of chunks, microseconds; all walkers write into one.
#[derive(Debug)]
pub struct Latencies {
    /// Cells, bundles and textures of what is drawn as geometry.
    pub near: Histogram<u64>,
    /// Layers of images.
    pub far: Histogram<u64>,
    /// Both, of chunks first missed at least a second after the walker came in.
    pub settled: [Histogram<u64>; 2],
}

impl Default for Latencies {
    fn default() -> Self {
        // Three digits: 22 µs of 22 ms. The bounds are valid ones.
        let new = || Histogram::new_with_bounds(1, MAX_US, 3).expect("valid bounds");
        Self { near: new(), far: new(), settled: [new(), new()] }
    }
}

impl Latencies {
    fn record(&mut self, far: bool, settled: bool, waited: Duration) {
        let us = waited.as_micros() as u64;
        if far { &mut self.far } else { &mut self.near }.saturating_record(us);
        if settled {
            self.settled[usize::from(far)].saturating_record(us);
        }
    }
}

/// What all walkers share.
#[derive(Debug)]
pub struct Course {
    /// Of the probing connection; the same for all.
    pub index: Arc<Index>,
    /// Which chunks are layers of images.
    pub far: Vec<bool>,
    /// Of the picture that nobody draws.
    pub camera: OutputCamera,
    /// Where latencies go.
    pub latencies: Mutex<Latencies>,
    /// When the run began; seconds of [`Outcome::by_second`] count from here.
    pub start: Instant,
    /// When everyone stops.
    pub end: Instant,
}

impl Course {
    fn latencies(&self) -> MutexGuard<'_, Latencies> {
        self.latencies.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Frames and bytes within one second of the run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Second {
    /// Frames that were due and looked at.
    pub frames: u64,
    /// Those of which something was missing.
    pub incomplete: u64,
    /// Received on the wire.
    pub bytes: u64,
}

/// What became of a walker.
#[derive(Debug, Default)]
pub struct Outcome {
    /// Why it never came in.
    pub refused: Option<ConnectError>,
    /// Why it left before the end.
    pub lost: Option<String>,
    /// Time between coming in and the end.
    pub seconds: f64,
    /// Time until the manifest was there.
    pub connect_ms: f64,
    /// Frames looked at.
    pub frames: u64,
    /// Those of which something was missing.
    pub incomplete: u64,
    /// The same without the walker's first second.
    pub settled_frames: u64,
    /// See above.
    pub settled_incomplete: u64,
    /// Frames that this program was too late for: the machine is too slow for so many walkers.
    pub skipped: u64,
    /// Chunks that some view needed, each once.
    pub first_needed: u64,
    /// Those that were at hand before.
    pub in_advance: u64,
    /// Chunks that the view no longer needed before they came; their latency counts until then.
    pub left_behind: u64,
    /// Chunks still missing at the end; their latency counts until then.
    pub unfinished: u64,
    /// Of the connection.
    pub stats: Stats,
    /// Decoded bytes held at most.
    pub cache_peak_bytes: u64,
    /// By second of the run.
    pub by_second: Vec<Second>,
}

struct Walker<'a> {
    course: &'a Course,
    connection: Connection,
    came_in: Instant,
    /// Chunks that the view misses, since when.
    missing: HashMap<u32, Instant>,
    ever_needed: Vec<bool>,
    bytes_seen: u64,
    out: Outcome,
}

/// Walks a track until the end of the course.
pub async fn walk(course: Arc<Course>, mut config: ConnectConfig, track: Track) -> Outcome {
    let (sender, mut arrivals) = unbounded_channel();
    config.arrivals = Some(sender);
    let begin = Instant::now();
    let connection = match Connection::open(config).await {
        Ok(c) => c,
        Err(e) => return Outcome { refused: Some(e), ..Outcome::default() },
    };
    let came_in = Instant::now();
    let out = Outcome { connect_ms: (came_in - begin).as_secs_f64() * 1e3, ..Outcome::default() };
    let ever_needed = vec![false; course.index.chunks.len()];
    let missing = HashMap::new();
    let mut walker = Walker { course: &course, connection, came_in, missing, ever_needed, bytes_seen: 0, out };
    let mut frame = 0usize;
    loop {
        let due = came_in + Duration::from_secs_f64(frame as f64 / FPS);
        if due >= course.end {
            break;
        }
        walker.until(due, &mut arrivals).await;
        if let Some(reason) = walker.connection.lost() {
            walker.out.lost = Some(reason);
            break;
        }
        walker.frame(frame, &track);
        // Frames that are over before they begin are left out and counted.
        let now = (came_in.elapsed().as_secs_f64() * FPS) as usize;
        walker.out.skipped += now.saturating_sub(frame + 1) as u64;
        frame = now.max(frame + 1);
    }
    walker.finish()
}

impl Walker<'_> {
    /// Takes note of arrivals until it is time.
    async fn until(&mut self, due: Instant, arrivals: &mut UnboundedReceiver<(u32, Instant)>) {
        let time = sleep_until(due.into());
        tokio::pin!(time);
        loop {
            tokio::select! {
                biased;
                Some((chunk, at)) = arrivals.recv() => self.arrived(chunk, at),
                () = &mut time => return,
            }
        }
    }

    fn arrived(&mut self, chunk: u32, at: Instant) {
        if let Some(since) = self.missing.remove(&chunk) {
            self.record(chunk, since, at);
        }
    }

    fn record(&self, chunk: u32, since: Instant, until: Instant) {
        let far = self.course.far.get(chunk as usize).copied().unwrap_or(false);
        let settled = since - self.came_in >= Duration::from_secs(1);
        self.course.latencies().record(far, settled, until.saturating_duration_since(since));
    }

    fn frame(&mut self, frame: usize, track: &Track) {
        let needed = track.needed(frame, &self.course.index, &self.course.camera);
        self.connection.update_view(&track.pose(frame), &needed);
        let cache = self.connection.cache();
        let now = Instant::now();
        let missing = cache.missing(needed.all());
        cache.count_used(needed.all());
        for chunk in needed.all() {
            if let Some(seen @ false) = self.ever_needed.get_mut(chunk as usize) {
                *seen = true;
                self.out.first_needed += 1;
                self.out.in_advance += u64::from(!missing.contains(&chunk));
            }
        }
        // What the view no longer needs has been waited for in vain.
        let behind: Vec<u32> = self.missing.keys().copied().filter(|c| !missing.contains(c)).collect();
        for chunk in behind {
            // Held ones say so themselves, with the time.
            if !self.connection.cache().holds(chunk)
                && let Some(since) = self.missing.remove(&chunk)
            {
                self.out.left_behind += 1;
                self.record(chunk, since, now);
            }
        }
        let incomplete = u64::from(!missing.is_empty());
        for chunk in missing {
            self.missing.entry(chunk).or_insert(now);
        }
        self.out.frames += 1;
        self.out.incomplete += incomplete;
        if now - self.came_in >= Duration::from_secs(1) {
            self.out.settled_frames += 1;
            self.out.settled_incomplete += incomplete;
        }
        let bytes = if frame.is_multiple_of(6) { self.new_bytes() } else { 0 };
        let second = self.second(now);
        second.frames += 1;
        second.incomplete += incomplete;
        second.bytes += bytes;
    }

    fn new_bytes(&mut self) -> u64 {
        let bytes = self.connection.stats().bytes_total;
        bytes - std::mem::replace(&mut self.bytes_seen, bytes)
    }

    fn second(&mut self, now: Instant) -> &mut Second {
        let at = now.saturating_duration_since(self.course.start).as_secs() as usize;
        if self.out.by_second.len() <= at {
            self.out.by_second.resize(at + 1, Second::default());
        }
        &mut self.out.by_second[at]
    }

    fn finish(mut self) -> Outcome {
        let now = Instant::now();
        for (chunk, since) in std::mem::take(&mut self.missing) {
            self.out.unfinished += 1;
            self.record(chunk, since, now);
        }
        self.out.seconds = (now - self.came_in).as_secs_f64();
        self.out.stats = self.connection.stats();
        self.out.cache_peak_bytes = self.connection.cache().usage().peak_bytes;
        self.out
    }
}
