//! The decoder: verifies and decodes chunks on its own threads, most urgent first.
//!
//! Decoding an image takes long, so that order matters: in a single queue, a cell that the view
//! lacks would wait behind images that no view needs yet. Chunks that the view waits for have their
//! own queue, sorted by urgency. While it is full, reading stops, and QUIC's flow control stops the
//! server. Chunks sent ahead follow, first those that the view has come to need. If too many of
//! them wait, the rest is abandoned and the server is told, so that they never occupy the streams
//! that the view needs.

use super::{decode_backlog::DecodeBacklog, disk_chunks::DiskChunks, stats::Collector};
use crate::cache::{Cache, Inserted};
use ldi_protocol::wire::Urgency;
use std::{
    collections::VecDeque,
    io,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicUsize, Ordering::Relaxed},
    },
    thread::JoinHandle,
    time::Instant,
};
use tokio::sync::{Semaphore, mpsc};

/// Queue places per thread for chunks that the view waits for. Together with the open streams they
/// bound the memory of undecoded chunks.
const PRESSING: usize = 8;
/// Bytes of complete chunks that may wait for a queue place before no further stream is accepted.
/// Bytes still to be received must not count: the server may have suspended that chunk in favour of
/// one that would then wait forever.
const WAITING_BYTES: usize = 32 << 20;
/// Bytes of chunks sent ahead that may wait, per connection. Larger: more memory; smaller: on a
/// fast connection more chunks are abandoned and sent again at the start.
const AHEAD_BYTES: usize = 32 << 20;
/// Number of chunks sent ahead that are searched for one that the view needs.
const LOOK_THROUGH: usize = 512;

/// What is wrong with a chunk that arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Damage {
    /// Its bytes do not match its hash.
    Bytes(u32),
    /// They match, but cannot be decoded.
    Content(u32),
}

/// The destination of one connection's chunks.
#[derive(Debug)]
pub(super) struct DecodeTarget {
    pub cache: Arc<Cache>,
    pub stats: Arc<Collector>,
    /// Receives what is wrong with chunks that arrived.
    pub damaged: mpsc::UnboundedSender<Damage>,
    /// See [`super::ConnectConfig::arrivals`].
    pub arrivals: Option<mpsc::UnboundedSender<(u32, Instant)>>,
    /// Bytes of waiting chunks that were sent ahead.
    pub ahead_bytes: AtomicUsize,
    /// Bytes of chunks that wait for a queue place.
    pub waiting_bytes: AtomicUsize,
    /// Backlog and rate of decoding.
    pub backlog: DecodeBacklog,
    /// Chunks on disk.
    pub disk_chunks: Option<Arc<DiskChunks>>,
    /// Abandoned chunks that the server has not been told about.
    pub abandoned: Mutex<Vec<u32>>,
}

impl DecodeTarget {
    /// Whether no further stream is accepted until a chunk has found a queue place.
    pub fn is_full(&self) -> bool {
        self.waiting_bytes.load(Relaxed) > WAITING_BYTES
    }

    /// Takes the abandoned chunks that the server should send again: those that the view needs now,
    /// or all once the backlog is small. Earlier, they would arrive and be abandoned again.
    pub fn take_abandoned(&self) -> Vec<u32> {
        let mut abandoned = self.abandoned.lock().unwrap_or_else(PoisonError::into_inner);
        if self.ahead_bytes.load(Relaxed) <= AHEAD_BYTES / 4 {
            return std::mem::take(&mut abandoned);
        }
        abandoned.extract_if(.., |c| self.cache.is_pinned(*c)).collect()
    }
}

/// A received chunk, or one to be read from disk.
#[derive(Debug)]
pub(super) struct DecodeJob {
    pub chunk: u32,
    pub urgency: Urgency,
    /// The chunk's bytes; None if it was claimed on disk and is to be read.
    pub bytes: Option<Vec<u8>>,
    pub target: Arc<DecodeTarget>,
}

#[derive(Debug, Default)]
struct Waiting {
    pressing: Vec<DecodeJob>,
    ahead: VecDeque<DecodeJob>,
    closed: bool,
}

impl Waiting {
    /// The most urgent job; among equals the oldest.
    fn claim(&mut self) -> Option<DecodeJob> {
        if let Some(at) = (0..self.pressing.len()).min_by_key(|i| self.pressing[*i].urgency) {
            return Some(self.pressing.remove(at));
        }
        let needed = self.ahead.iter().take(LOOK_THROUGH).position(|j| j.target.cache.is_pinned(j.chunk));
        self.ahead.remove(needed.unwrap_or(0))
    }
}

#[derive(Debug)]
struct Queue {
    waiting: Mutex<Waiting>,
    arrived: Condvar,
    /// Places for urgent chunks, waiting or being decoded.
    places: Semaphore,
}

impl Queue {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Body of a decoding thread.
    fn work(&self) {
        loop {
            let mut waiting = self.lock();
            let job = loop {
                if waiting.closed {
                    return;
                }
                match waiting.claim() {
                    Some(job) => break job,
                    None => waiting = self.arrived.wait(waiting).unwrap_or_else(PoisonError::into_inner),
                }
            };
            drop(waiting);
            let Some(bytes) = &job.bytes else {
                read(&job);
                continue;
            };
            let begin = Instant::now();
            decode(&job, bytes);
            job.target.backlog.record_decoded(bytes.len(), begin.elapsed());
            if job.urgency.is_pressing() {
                self.places.add_permits(1);
            } else {
                job.target.ahead_bytes.fetch_sub(bytes.len(), Relaxed);
            }
            // Writing to disk comes last, so that the view does not wait for it.
            if let Some(disk_chunks) = &job.target.disk_chunks
                && job.target.cache.holds(job.chunk)
            {
                disk_chunks.store(job.chunk, bytes);
            }
        }
    }
}

/// Decoding threads, for one connection or several. Dropping the last handle ends them and waits
/// for them.
#[derive(Debug)]
pub struct DecodePool {
    queue: Arc<Queue>,
    threads: Vec<JoinHandle<()>>,
}

impl DecodePool {
    /// Starts `count` threads, at least one.
    ///
    /// # Errors
    /// If the system has no more threads.
    pub fn new(count: usize) -> io::Result<Self> {
        let count = count.max(1);
        let places = Semaphore::new(PRESSING * count);
        let queue = Arc::new(Queue { waiting: Mutex::default(), arrived: Condvar::new(), places });
        let mut pool = Self { queue, threads: Vec::new() };
        for i in 0..count {
            let queue = pool.queue.clone();
            pool.threads.push(std::thread::Builder::new().name(format!("ldi-decode-{i}")).spawn(move || queue.work())?);
        }
        Ok(pool)
    }

    /// Number of threads.
    pub(super) fn threads(&self) -> usize {
        self.threads.len()
    }

    /// Queues a chunk. Waits for a place if the view needs the chunk; abandons it if it was sent
    /// ahead and there is none.
    pub(super) async fn send(&self, job: DecodeJob) {
        let bytes = job.bytes.as_ref().map_or(0, Vec::len);
        job.target.backlog.arrived(bytes);
        if job.urgency.is_pressing() {
            job.target.waiting_bytes.fetch_add(bytes, Relaxed);
            // The semaphore is never closed.
            if let Ok(place) = self.queue.places.acquire().await {
                place.forget();
            }
            job.target.waiting_bytes.fetch_sub(bytes, Relaxed);
            self.queue.lock().pressing.push(job);
        } else {
            let target = job.target.clone();
            if target.ahead_bytes.fetch_add(bytes, Relaxed) + bytes > AHEAD_BYTES && !target.cache.is_pinned(job.chunk)
            {
                target.ahead_bytes.fetch_sub(bytes, Relaxed);
                target.backlog.remove(bytes);
                target.stats.abandoned(bytes as u64);
                return target.abandoned.lock().unwrap_or_else(PoisonError::into_inner).push(job.chunk);
            }
            self.queue.lock().ahead.push_back(job);
        }
        self.queue.arrived.notify_one();
    }

    /// Queues a chunk to be read from disk. It takes no place and no memory until then; the index
    /// bounds their number.
    pub(super) fn read(&self, job: DecodeJob) {
        let mut waiting = self.queue.lock();
        match job.urgency.is_pressing() {
            true => waiting.pressing.push(job),
            false => waiting.ahead.push_back(job),
        }
        drop(waiting);
        self.queue.arrived.notify_one();
    }
}

impl Drop for DecodePool {
    fn drop(&mut self) {
        self.queue.lock().closed = true;
        self.queue.arrived.notify_all();
        for t in self.threads.drain(..) {
            let _ = t.join();
        }
    }
}

/// Reads a chunk from disk and decodes it.
fn read(job: &DecodeJob) {
    let DecodeTarget { cache, stats, disk_chunks, arrivals, abandoned, .. } = &*job.target;
    let Some(disk_chunks) = disk_chunks else { return };
    let bytes = disk_chunks.read(job.chunk);
    let read = bytes.as_ref().map_or(0, |b| b.len() as u64);
    // Counted before it is visible to those who wait for the chunk.
    stats.read_from_disk(read);
    let taken = bytes.and_then(|bytes| cache.insert(job.chunk, &bytes).ok());
    if taken == Some(Inserted::Held) {
        // The chunk's use does not count as use of received bytes.
        cache.count_elsewhere(job.chunk);
        if let Some(arrivals) = arrivals {
            let _ = arrivals.send((job.chunk, Instant::now()));
        }
    } else {
        stats.not_read_from_disk(read);
    }
    disk_chunks.release(job.chunk, job.urgency, taken.is_some());
    if taken.is_none() {
        abandoned.lock().unwrap_or_else(PoisonError::into_inner).push(job.chunk);
    }
}

fn decode(job: &DecodeJob, chunk_bytes: &[u8]) {
    let DecodeTarget { cache, stats, damaged, arrivals, .. } = &*job.target;
    let Some(entry) = cache.index().chunks.get(job.chunk as usize) else { return };
    let bytes = chunk_bytes.len() as u64;
    if blake3::hash(chunk_bytes).as_bytes() != &entry.hash.0 {
        stats.damaged(bytes);
        let _ = damaged.send(Damage::Bytes(job.chunk));
        return;
    }
    // Counted before it is visible to those who wait for the chunk.
    stats.arrived(job.chunk, entry.stored_bytes, job.urgency);
    match cache.insert(job.chunk, chunk_bytes) {
        // A refused chunk counts as received and unused.
        Ok(Inserted::NoRoom) => {}
        Ok(Inserted::Held) => {
            if let Some(arrivals) = arrivals {
                let _ = arrivals.send((job.chunk, Instant::now()));
            }
        }
        Ok(Inserted::Duplicate) => {
            stats.take_back(entry.stored_bytes);
            stats.duplicate(bytes);
        }
        Err(e) => {
            // The hash is correct, so that a retry would bring the same bytes.
            stats.take_back(entry.stored_bytes);
            stats.damaged(bytes);
            cache.mark_damaged(job.chunk);
            let _ = damaged.send(Damage::Content(job.chunk));
            tracing::warn!(chunk = job.chunk, "given up: {e}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cache::fixture::{FIRST_CELL, LDI, street};

    /// Chunks of a street whose far half is an image; none of them can be decoded.
    fn target() -> (Arc<DecodeTarget>, mpsc::UnboundedReceiver<Damage>) {
        let (damaged, damage) = mpsc::unbounded_channel();
        let cache = Arc::new(Cache::new(Arc::new(street(60, 8).index), 1 << 30));
        let stats = Arc::new(Collector::new());
        (
            Arc::new(DecodeTarget {
                cache,
                stats,
                damaged,
                arrivals: None,
                ahead_bytes: AtomicUsize::new(0),
                waiting_bytes: AtomicUsize::new(0),
                backlog: DecodeBacklog::default(),
                disk_chunks: None,
                abandoned: Mutex::default(),
            }),
            damage,
        )
    }

    fn job(target: &Arc<DecodeTarget>, chunk: u32, urgency: Urgency) -> DecodeJob {
        DecodeJob { chunk, urgency, bytes: Some(vec![0; 10]), target: target.clone() }
    }

    #[test]
    fn what_the_view_waits_for_comes_first_whatever_came_before() {
        let (target, _damage) = target();
        let mut waiting = Waiting::default();
        let now = |chunk| job(&target, chunk, Urgency::Now);
        waiting.ahead.extend([10, 11, 12].map(|c| job(&target, c, Urgency::Around)));
        waiting.pressing.extend([job(&target, 20, Urgency::Fine), now(21), now(22)]);
        // The view has come to need a chunk that was sent ahead.
        target.cache.pin([11]);
        let order: Vec<u32> = std::iter::from_fn(|| waiting.claim()).map(|j| j.chunk).collect();
        assert_eq!(order, [21, 22, 20, 11, 10, 12]);
    }

    /// Without threads: nothing leaves the queue.
    fn idle() -> DecodePool {
        let queue = Queue { waiting: Mutex::default(), arrived: Condvar::new(), places: Semaphore::new(PRESSING) };
        DecodePool { queue: Arc::new(queue), threads: Vec::new() }
    }

    #[tokio::test]
    async fn whole_chunks_that_wait_for_a_place_are_bounded_by_bytes() {
        const MORE: usize = 6;
        let (target, _damage) = target();
        let pool = Arc::new(idle());
        let big = |chunk| DecodeJob { bytes: Some(vec![0; WAITING_BYTES / 4]), ..job(&target, chunk, Urgency::Now) };
        for chunk in 0..PRESSING as u32 {
            pool.send(big(FIRST_CELL + chunk)).await;
        }
        assert!(!target.is_full(), "what has a place counts by number");
        let mut full = Vec::new();
        let mut tasks = tokio::task::JoinSet::new();
        for chunk in 0..MORE as u32 {
            let (pool, job) = (pool.clone(), big(FIRST_CELL + 20 + chunk));
            tasks.spawn(async move { pool.send(job).await });
            tokio::task::yield_now().await;
            full.push(target.is_full());
        }
        assert_eq!(full, [false, false, false, false, true, true], "beyond four quarters");
        assert_eq!(pool.queue.lock().pressing.len(), PRESSING);
        // Two chunks are decoded: two others get their places, and streams are accepted again.
        pool.queue.places.add_permits(2);
        for _ in 0..2 {
            tasks.join_next().await;
        }
        assert!(!target.is_full());
        pool.queue.places.add_permits(MORE);
        tasks.join_all().await;
        assert_eq!(target.waiting_bytes.load(Relaxed), 0);
        assert_eq!(pool.queue.lock().pressing.len(), PRESSING + MORE);
    }

    #[tokio::test]
    async fn too_much_sent_ahead_is_given_up_and_told_and_what_the_view_needs_is_not() {
        let (target, _damage) = target();
        let pool = idle();
        let big = |chunk| DecodeJob { bytes: Some(vec![0; AHEAD_BYTES / 4]), ..job(&target, chunk, Urgency::Around) };
        for chunk in 0..6 {
            pool.send(big(FIRST_CELL + chunk)).await;
        }
        target.cache.pin([LDI[0]]);
        pool.send(big(LDI[0])).await;
        pool.send(job(&target, LDI[1], Urgency::Now)).await;
        {
            let waiting = pool.queue.lock();
            assert_eq!((waiting.ahead.len(), waiting.pressing.len()), (4 + 1, 1));
        }
        assert_eq!(target.stats.snapshot(0).lost_bytes, AHEAD_BYTES as u64 / 2);
        assert!(target.take_abandoned().is_empty(), "it would come again at once");
        target.cache.pin([FIRST_CELL + 5]);
        assert_eq!(target.take_abandoned(), [FIRST_CELL + 5], "the view has come to need it");
        target.ahead_bytes.store(0, Relaxed);
        assert_eq!(target.take_abandoned(), [FIRST_CELL + 4]);
        assert!(target.take_abandoned().is_empty(), "once");
    }

    #[test]
    fn threads_decode_and_end_with_the_pool() {
        let (target, mut damage) = target();
        let pool = DecodePool::new(2).expect("threads");
        let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime");
        runtime.block_on(async {
            for chunk in 0..40 {
                let urgency = if chunk % 2 == 0 { Urgency::Now } else { Urgency::Around };
                pool.send(job(&target, FIRST_CELL + chunk, urgency)).await;
            }
        });
        // Their bytes do not match the index: each is reported as damaged, or was abandoned.
        let mut damaged = 0;
        let until = Instant::now() + std::time::Duration::from_secs(20);
        while target.stats.snapshot(0).damaged + target.stats.snapshot(0).abandoned < 40 && Instant::now() < until {
            std::thread::yield_now();
        }
        while damage.try_recv().is_ok() {
            damaged += 1;
        }
        assert!(damaged >= 20, "all that the view waits for: {damaged}");
        drop(pool);
    }
}
