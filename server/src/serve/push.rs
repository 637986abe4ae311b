//! Sends one chunk on one stream, in slices, and changes its mind while it does.

use super::{limits::Allowance, walkers::Counters};
use bytes::Bytes;
use ldi_protocol::wire::{StreamHeader, Urgency, code};
use quinn::{Connection, SendStream, VarInt, WriteError};
use std::{sync::Arc, time::Instant};
use tokio::{sync::watch, time::sleep_until};

/// Bytes handed to the transport at a time. Larger: a change of priority waits longer; smaller: more wake-ups.
const SLICE: usize = 64 * 1024;
/// A stale chunk with less than this left is finished all the same: what was sent of it would be wasted.
const FINISH_BELOW: usize = 32 * 1024;

/// A chunk of fewer bytes is out when the transport has it, urgent or not: it takes no part of the send window worth naming, and waiting for a hundred of them to be
/// acknowledged, a few at a time, takes seconds on a long link.
pub const SMALL: usize = 16 * 1024;

/// What the planner thinks of a chunk on its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Go on, this urgently.
    Send(Urgency),
    /// Stop, unless it is nearly there.
    Stop,
}

/// How a push ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// All bytes are with the transport.
    Sent,
    /// Reset by us: stale.
    Stale,
    /// The client stopped the stream: it holds the chunk already, or does not want it. It can ask for it again.
    Refused,
    /// The connection is gone.
    Failed,
}

/// Where chunks of a session go: its connection, and the bytes per second that its address may have.
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
            allowance.sent(self.epoch.elapsed(), bytes);
        }
    }
}

/// Strict priorities of the transport: higher goes first.
fn priority(urgency: Urgency) -> i32 {
    -(urgency as i32)
}

/// Sends header and bytes. Pressing chunks and small ones end as soon as the transport has them; large ones in the background when the client
/// has them, so that what nobody waits for never fills the send window that an urgent chunk needs.
pub async fn push(
    outlet: Outlet,
    header: StreamHeader,
    bytes: Bytes,
    verdict: watch::Receiver<Verdict>,
    counters: &Counters,
) -> Ended {
    let small = bytes.len() < SMALL;
    match transfer(outlet, header, bytes, verdict, counters).await {
        Ok((stream, urgency)) => {
            if !urgency.is_pressing() && !small {
                acknowledged(stream).await;
            }
            counters.sent_chunk();
            Ended::Sent
        }
        Err(ended) => ended,
    }
}

/// The same, but it always ends when the client has everything: for what has to be there before anything else fills the link's queues.
pub async fn push_through(outlet: Outlet, header: StreamHeader, bytes: Bytes, counters: &Counters) {
    let (_keep, verdict) = watch::channel(Verdict::Send(header.urgency));
    if let Ok((stream, _)) = transfer(outlet, header, bytes, verdict, counters).await {
        acknowledged(stream).await;
        counters.sent_chunk();
    }
}

/// Hands header and bytes to the transport. The stream, and how urgent it was in the end; or how else it ended.
async fn transfer(
    outlet: Outlet,
    header: StreamHeader,
    bytes: Bytes,
    mut verdict: watch::Receiver<Verdict>,
    counters: &Counters,
) -> Result<(SendStream, Urgency), Ended> {
    let Ok(mut stream) = outlet.connection.open_uni().await else { return Err(Ended::Failed) };
    let _ = stream.set_priority(priority(header.urgency));
    let mut urgency = header.urgency;
    if stream.write_all(&header.encode()).await.is_err() {
        return Err(Ended::Failed);
    }
    let mut left = bytes;
    while !left.is_empty() {
        let mut slice = [left.slice(..left.len().min(SLICE))];
        tokio::select! {
            biased;
            Ok(()) = verdict.changed() => match *verdict.borrow_and_update() {
                Verdict::Send(u) => {
                    urgency = u;
                    let _ = stream.set_priority(priority(u));
                }
                Verdict::Stop if left.len() > FINISH_BELOW => {
                    let _ = stream.reset(VarInt::from_u32(code::STALE));
                    counters.stale();
                    return Err(Ended::Stale);
                }
                Verdict::Stop => {}
            },
            // Cancel-safe: it either writes or does not.
            written = async { outlet.turn().await; stream.write_chunks(&mut slice).await } => match written {
                Ok(w) => {
                    outlet.sent(w.bytes);
                    counters.sent_bytes(w.bytes);
                    let _ = left.split_to(w.bytes);
                }
                Err(WriteError::Stopped(_)) => return Err(Ended::Refused),
                Err(_) => return Err(Ended::Failed),
            },
        }
    }
    stream.finish().map(|()| (stream, urgency)).map_err(|_| Ended::Failed)
}

async fn acknowledged(stream: SendStream) {
    let _ = stream.stopped().await;
}
