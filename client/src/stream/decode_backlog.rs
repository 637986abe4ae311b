//! The decode backlog and decode rate of a connection, which the server needs in order to send no
//! more ahead than can be decoded.

use ldi_protocol::wire::ClientMessage;
use std::{
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    time::Duration,
};

/// Stored bytes over which the rate is averaged, about two images. Larger: a slower machine is
/// noticed later; smaller: one cheap texture looks like a fast machine.
const OVER_BYTES: f64 = 2e6;
/// Smallest change of the backlog that is sent.
const TELL_BYTES: u32 = 64 * 1024;

#[derive(Debug, Default)]
struct Recent {
    bytes: f64,
    seconds: f64,
    /// Backlog and rate that were sent last.
    last_sent: Option<(u32, u32)>,
}

/// The decode backlog of one connection. Updated by the decoding threads, sent by the session.
#[derive(Debug, Default)]
pub(super) struct DecodeBacklog {
    waiting: AtomicU64,
    recent: Mutex<Recent>,
}

impl DecodeBacklog {
    /// Adds a chunk of `bytes` stored bytes.
    pub fn arrived(&self, bytes: usize) {
        self.waiting.fetch_add(bytes as u64, Relaxed);
    }

    /// Removes an abandoned chunk.
    pub fn remove(&self, bytes: usize) {
        self.waiting.fetch_sub(bytes as u64, Relaxed);
    }

    /// Removes a decoded chunk, and records its time on one thread.
    pub fn record_decoded(&self, bytes: usize, took: Duration) {
        self.remove(bytes);
        let mut r = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        let forget = (-(bytes as f64) / OVER_BYTES).exp();
        r.bytes = r.bytes * forget + bytes as f64;
        r.seconds = r.seconds * forget + took.as_secs_f64();
    }

    /// The message for the server, if the backlog or the rate has changed. `threads`: decoding
    /// threads.
    pub fn update_message(&self, threads: usize) -> Option<ClientMessage> {
        let mut r = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        let waiting_bytes = u32::try_from(self.waiting.load(Relaxed)).unwrap_or(u32::MAX);
        let rate = if r.seconds > 0.0 { r.bytes / r.seconds * threads as f64 } else { 0.0 };
        // Saturating conversion.
        let bytes_per_s = rate as u32;
        let known = |(waiting, rate): (u32, u32)| {
            waiting.abs_diff(waiting_bytes) < TELL_BYTES && rate.abs_diff(bytes_per_s) <= rate / 8
        };
        if r.last_sent.is_some_and(known) || (r.last_sent.is_none() && waiting_bytes == 0 && bytes_per_s == 0) {
            return None;
        }
        r.last_sent = Some((waiting_bytes, bytes_per_s));
        Some(ClientMessage::Decoding { waiting_bytes, bytes_per_s })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_waits_and_how_fast_it_goes_is_told_when_it_is_news() {
        let b = DecodeBacklog::default();
        assert_eq!(b.update_message(1), None, "nothing came");
        b.arrived(3_000_000);
        b.arrived(1_000_000);
        let news = |waiting_bytes, bytes_per_s| Some(ClientMessage::Decoding { waiting_bytes, bytes_per_s });
        assert_eq!(b.update_message(1), news(4_000_000, 0));
        b.record_decoded(3_000_000, Duration::from_millis(300));
        assert_eq!(b.update_message(2), news(1_000_000, 20_000_000), "two threads of 10 MB/s");
        assert_eq!(b.update_message(2), None, "told");
        b.remove(10_000);
        assert_eq!(b.update_message(2), None, "hardly anything");
        b.remove(990_000);
        assert_eq!(b.update_message(2), news(0, 20_000_000));
        // The machine becomes slower: after a few megabytes the rate has adapted.
        (0..60).for_each(|_| {
            b.arrived(100_000);
            b.record_decoded(100_000, Duration::from_millis(100));
        });
        let Some(ClientMessage::Decoding { bytes_per_s, .. }) = b.update_message(1) else { panic!("news") };
        assert!((900_000..1_400_000).contains(&bytes_per_s), "{bytes_per_s} of 1,000,000");
    }
}
