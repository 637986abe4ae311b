//! Verifies and decodes chunks on threads of their own.

use super::stats::Collector;
use crate::cache::{Cache, Inserted};
use ldi_protocol::wire::Urgency;
use std::{
    io,
    sync::{Arc, Mutex, PoisonError},
    thread::JoinHandle,
};
use tokio::sync::mpsc;

/// Chunks that wait for a thread. With the streams being read they bound the memory of what is not decoded yet.
const QUEUE: usize = 8;

/// A chunk as it arrived.
#[derive(Debug)]
pub(super) struct Job {
    pub chunk: u32,
    pub urgency: Urgency,
    pub bytes: Vec<u8>,
}

/// The threads; they end when the queue's sender is dropped.
#[derive(Debug)]
pub(super) struct Decoders {
    threads: Vec<JoinHandle<()>>,
}

impl Decoders {
    /// Starts `count` threads. Numbers of chunks whose hash is wrong go to `damaged`.
    pub fn start(
        count: usize,
        cache: &Arc<Cache>,
        stats: &Arc<Collector>,
        damaged: &mpsc::UnboundedSender<u32>,
    ) -> io::Result<(Self, mpsc::Sender<Job>)> {
        let (sender, receiver) = mpsc::channel::<Job>(QUEUE);
        let receiver = Arc::new(Mutex::new(receiver));
        let mut threads = Vec::new();
        for i in 0..count.max(1) {
            let (receiver, cache, stats, damaged) = (receiver.clone(), cache.clone(), stats.clone(), damaged.clone());
            threads.push(std::thread::Builder::new().name(format!("ldi-decode-{i}")).spawn(move || {
                loop {
                    // The lock is held while waiting: the next job goes to whoever holds it, the others queue behind.
                    let job = receiver.lock().unwrap_or_else(PoisonError::into_inner).blocking_recv();
                    let Some(job) = job else { return };
                    decode(&cache, &stats, &damaged, &job);
                }
            })?);
        }
        Ok((Self { threads }, sender))
    }

    /// Waits for the threads. Drop the queue's sender first.
    pub fn join(self) {
        for t in self.threads {
            let _ = t.join();
        }
    }
}

fn decode(cache: &Cache, stats: &Collector, damaged: &mpsc::UnboundedSender<u32>, job: &Job) {
    let Some(entry) = cache.index().chunks.get(job.chunk as usize) else { return };
    let bytes = job.bytes.len() as u64;
    if blake3::hash(&job.bytes).as_bytes() != &entry.hash.0 {
        stats.damaged(bytes);
        let _ = damaged.send(job.chunk);
        return;
    }
    // Counted first: who waits for the chunk may look at the statistics as soon as it is there.
    stats.arrived(job.chunk, entry.stored_bytes, job.urgency);
    match cache.insert(job.chunk, &job.bytes) {
        // Refused for want of room is received all the same; no frame uses it.
        Ok(Inserted::Held | Inserted::NoRoom) => {}
        Ok(Inserted::Duplicate) => {
            stats.take_back(entry.stored_bytes);
            stats.duplicate(bytes);
        }
        Err(e) => {
            // The hash is right, so asking again would bring the same bytes.
            stats.take_back(entry.stored_bytes);
            stats.damaged(bytes);
            cache.mark_damaged(job.chunk);
            tracing::warn!(chunk = job.chunk, "given up: {e}");
        }
    }
}
