//! Chunks on their way to one client: the most urgent first, one after another.
//!
//! What the transport has taken is out of our hands: a stream that waits in it keeps the priority
//! that it came with, and what is as urgent shares the link with it, so that all of them end late.
//! So little is handed over ([`UNSENT_S`]), all of it in one order, and what waits here is
//! reordered or dropped at no cost.

use super::{limits::Allowance, meter::Metered, walkers::Counters};
use bytes::{Buf, Bytes};
use ldi_protocol::wire::{StreamHeader, Urgency, code};
use quinn::{Connection, SendStream, VarInt, WriteError};
use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};
use tokio::{sync::mpsc, time::sleep_until};

/// Bytes handed to the transport at a time. Larger: fewer wake-ups; smaller: the first of several
/// chunks is noticed to be out sooner.
const SLICE: usize = 64 * 1024;
/// A stale chunk that began and has at most this left is finished all the same: what was sent of
/// it would be wasted.
pub const FINISH_BELOW: usize = 32 * 1024;
/// How often the send window follows the congestion window.
const WINDOW_INTERVAL: Duration = Duration::from_millis(5);
/// What may wait in the transport beyond the congestion window: the link's bytes in this time,
/// seconds. Longer: what is urgent waits longer; shorter: the link is idle while the next slice is
/// fetched.
const UNSENT_S: f64 = 0.01;
/// The same in bytes, at least.
const MIN_UNSENT: u64 = 32 * 1024;

/// The same while the congestion window grows, at least: it grows only while the connection has
/// more to send than it may, also between two acknowledgements.
const GROWING_UNSENT: u64 = 256 * 1024;
/// A window grows if it became larger by this factor in a round trip.
const GROWN: f64 = 1.25;

/// Unacknowledged bytes that a connection may have: its congestion window and a little that waits.
pub fn send_window(congestion_window: u64, bytes_per_s: Option<f64>) -> u64 {
    let of_rate = bytes_per_s.unwrap_or(0.0) * UNSENT_S;
    congestion_window + MIN_UNSENT.max(of_rate as u64)
}

/// What is to be done.
#[derive(Debug)]
pub enum Task {
    /// Send this chunk.
    Send(StreamHeader, Bytes),
    /// It matters more or less than before.
    Reprioritize(u32, Urgency),
    /// Nobody needs it any more: stop, unless it is nearly there.
    Stop(u32),
}

/// How a chunk ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// All bytes are with the transport.
    Sent,
    /// Given up by us: stale.
    Stale,
    /// The client stopped the stream: it holds the chunk already, or does not want it. It can ask
    /// for it again.
    Refused,
    /// The connection is gone.
    Failed,
}

/// Where chunks of a session go: its connection, and the bytes per second that its address may
/// have.
#[derive(Debug, Clone)]
pub struct Outlet {
    /// QUIC.
    pub connection: Connection,
    /// None: no limit.
    pub allowance: Option<Arc<Allowance>>,
    /// When the server's time began, the same for all sessions.
    pub epoch: Instant,
}

impl Outlet {
    /// Waits until more may be sent.
    pub async fn turn(&self) {
        if let Some(allowance) = &self.allowance {
            sleep_until((self.epoch + allowance.next_at()).into()).await;
        }
    }

    /// Counts bytes that were sent.
    pub fn sent(&self, bytes: usize) {
        if let Some(allowance) = &self.allowance {
            allowance.take(self.epoch.elapsed(), bytes);
        }
    }
}

/// A chunk or page on its way.
#[derive(Debug)]
struct Push {
    header: StreamHeader,
    /// None: not begun.
    stream: Option<SendStream>,
    /// What is left.
    head: Bytes,
    body: Bytes,
}

impl Push {
    fn new(header: StreamHeader, body: Bytes) -> Self {
        Self { header, stream: None, head: Bytes::new(), body }
    }

    /// Hands the next slice over; how it ended, if it did. Cancel-safe: it either writes or does
    /// not.
    async fn advance(&mut self, outlet: &Outlet, counters: &Counters) -> Option<Ended> {
        let stream = match &mut self.stream {
            Some(stream) => stream,
            none => match outlet.connection.open_uni().await {
                Ok(stream) => {
                    self.head = Bytes::copy_from_slice(&self.header.encode());
                    none.insert(stream)
                }
                Err(_) => return Some(Ended::Failed),
            },
        };
        let mut slices = [self.head.clone(), self.body.slice(..self.body.len().min(SLICE))];
        outlet.turn().await;
        let written = match stream.write_chunks(&mut slices).await {
            Ok(written) => written.bytes,
            Err(WriteError::Stopped(_)) => return Some(Ended::Refused),
            Err(_) => return Some(Ended::Failed),
        };
        let of_head = written.min(self.head.len());
        self.head.advance(of_head);
        self.body.advance(written - of_head);
        outlet.sent(written);
        counters.sent_bytes(written - of_head);
        if !self.body.is_empty() {
            return None;
        }
        counters.sent_chunk();
        Some(stream.finish().map_or(Ended::Failed, |()| Ended::Sent))
    }
}

/// Whether a congestion window grows fast, as after the start.
#[derive(Debug, Default)]
struct Growth {
    /// When the last round trip began, and the window then.
    since: Option<(Duration, u64)>,
    stopped: bool,
}

impl Growth {
    /// Called with the window of now, again and again. True before the first round trip is over.
    fn goes_on(&mut self, now: Duration, round_trip: Duration, window: u64) -> bool {
        let (since, before) = *self.since.get_or_insert((now, window));
        if now - since >= round_trip {
            self.stopped = (window as f64) < before as f64 * GROWN;
            self.since = Some((now, window));
        }
        !self.stopped
    }
}

/// Carries chunks until the tasks end; tells how each ended. `most`: of unacknowledged bytes.
pub async fn carry(
    outlet: Outlet,
    most: u64,
    mut tasks: mpsc::UnboundedReceiver<Task>,
    ended: mpsc::UnboundedSender<(u32, Ended)>,
    counters: Arc<Counters>,
) {
    let mut queue = Queue::default();
    let mut window_at: Option<Instant> = None;
    let mut growth = Growth::default();
    loop {
        if window_at.is_none_or(|at| at.elapsed() >= WINDOW_INTERVAL) {
            window_at = Some(Instant::now());
            let path = outlet.connection.stats().path;
            let window = match growth.goes_on(outlet.epoch.elapsed(), path.rtt, path.cwnd) {
                true => path.cwnd + path.cwnd.max(GROWING_UNSENT),
                false => send_window(path.cwnd, Metered::rate_of(&outlet.connection)),
            };
            outlet.connection.set_send_window(window.min(most));
        }
        let done = tokio::select! {
            biased;
            task = tasks.recv() => match task {
                Some(task) => queue.take(task, &counters).map(|chunk| (chunk, Ended::Stale)),
                None => return,
            },
            done = queue.advance(&outlet, &counters) => done,
        };
        if let Some(done) = done
            && ended.send(done).is_err()
        {
            return;
        }
    }
}

/// Chunks by urgency, then as they came.
#[derive(Debug, Default)]
struct Queue {
    pushes: BTreeMap<(Urgency, u64), Push>,
    came: u64,
}

impl Queue {
    /// The chunk that was given up, if one was.
    fn take(&mut self, task: Task, counters: &Counters) -> Option<u32> {
        let key_of = |number: u32| self.pushes.iter().find(|(_, p)| p.header.number == number).map(|(key, _)| *key);
        match task {
            Task::Send(header, body) => {
                self.pushes.insert((header.urgency, self.came), Push::new(header, body));
                self.came += 1;
            }
            Task::Reprioritize(number, urgency) => {
                let key = key_of(number)?;
                let mut push = self.pushes.remove(&key)?;
                // The client decodes in this order, too; what began has told another one.
                push.header.urgency = urgency;
                self.pushes.insert((urgency, key.1), push);
            }
            Task::Stop(number) => {
                let key = key_of(number)?;
                let push = self.pushes.get(&key)?;
                if push.stream.is_some() && push.body.len() <= FINISH_BELOW {
                    return None;
                }
                let push = self.pushes.remove(&key)?;
                if let Some(mut stream) = push.stream {
                    let _ = stream.reset(VarInt::from_u32(code::STALE));
                }
                counters.stale();
                return Some(number);
            }
        }
        None
    }

    /// Hands a slice of the first one over; which it was and how it ended, if it did. Pending
    /// while there is none.
    async fn advance(&mut self, outlet: &Outlet, counters: &Counters) -> Option<(u32, Ended)> {
        let Some(mut first) = self.pushes.first_entry() else { return std::future::pending().await };
        let push = first.get_mut();
        let done = (push.header.number, push.advance(outlet, counters).await?);
        first.remove();
        Some(done)
    }
}

/// Sends header and bytes beside the queue. It ends when the transport has them; the stream, or
/// none if it did not get there.
pub async fn push_beside(
    outlet: &Outlet,
    header: StreamHeader,
    bytes: Bytes,
    counters: &Counters,
) -> Option<SendStream> {
    let mut push = Push::new(header, bytes);
    loop {
        match push.advance(outlet, counters).await {
            None => {}
            Some(Ended::Sent) => return push.stream,
            Some(_) => return None,
        }
    }
}

/// The same, but it ends when the client has everything: for what has to be there before anything
/// else fills the link's queues.
pub async fn push_through(outlet: &Outlet, header: StreamHeader, bytes: Bytes, counters: &Counters) {
    if let Some(stream) = push_beside(outlet, header, bytes, counters).await {
        let _ = stream.stopped().await;
    }
}

#[cfg(test)]
#[path = "push_test.rs"]
mod tests;
