//! When to send ahead of need: as late as the link and the client's decoding allow, as what is
//! sent later is guessed better.
//!
//! Chunks are brought one after another, soonest first (earliest deadline first, which is late for
//! none if any order is: Jackson 1955). Chunk i is at hand after
//!
//! ```text
//!   ready_i = round trip + max over j <= i of (bytes on the way and of 0 ..= j) / rate, and the decoding from j on
//! ```
//!
//! where chunks before i count with their probability: of several ways that a walk may take it
//! takes one.
//!
//! The round trip counts whole: the pose is half of one old, and the chunk takes half of one.
//! Nothing has to be sent as long as every chunk would still be ready [`GUARD_S`] and
//! [`GUARD_SHARE`] of its transfer before its time; the first one goes as soon as that no longer
//! holds for any chunk behind it.

use super::forecast::Expected;
use std::time::Duration;

/// Slack that is kept, seconds: timers, frames and guesses of times are coarse. Larger: fewer late
/// chunks, more that are never used.
const GUARD_S: f64 = 0.2;
/// Slack that is kept, as a share of the time that bringing takes: rates are measured, and change.
const GUARD_SHARE: f64 = 0.2;
/// Believed rates before any was measured, bytes per second: 20 Mbit/s. Too low: more is sent
/// ahead at the beginning; too high: it comes late.
const UNKNOWN_RATE: f64 = 2.5e6;
/// Slowest believed rates: so that no time becomes infinite.
const SLOWEST: f64 = 10e3;

/// What the link carries and the client decodes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Capacity {
    /// Delivered on a busy link, bytes per second. None: not known yet.
    pub bytes_per_s: Option<f64>,
    /// Round trip.
    pub round_trip: Duration,
    /// Stored bytes that the client decodes per second. None: not known, or not worth counting.
    pub decoded_per_s: Option<f64>,
    /// Stored bytes that wait for decoding at the client.
    pub waiting_bytes: u64,
}

impl Capacity {
    /// Whether plans made for the other one are to be made again: by more than a quarter, or a
    /// tenth of a second.
    pub(super) fn differs(&self, new: &Self) -> bool {
        let apart = |a: f64, b: f64| a.max(b) > 1.25 * a.min(b);
        apart(self.rate(), new.rate())
            || apart(self.decoding_s(1e6), new.decoding_s(1e6))
            || (self.decoding_s(self.waiting_bytes as f64) - new.decoding_s(new.waiting_bytes as f64)).abs() > 0.1
            || self.round_trip.abs_diff(new.round_trip) > Duration::from_millis(25)
    }

    fn rate(&self) -> f64 {
        self.bytes_per_s.unwrap_or(UNKNOWN_RATE).max(SLOWEST)
    }

    /// Seconds that decoding takes.
    fn decoding_s(&self, bytes: f64) -> f64 {
        self.decoded_per_s.map_or(0.0, |r| bytes / r.max(SLOWEST))
    }

    /// How far ahead it is worth looking: the time in which `bytes` more would be brought, with
    /// the slack that is kept.
    pub(super) fn horizon_s(&self, bytes: u64) -> f64 {
        let brought = bytes as f64 / self.rate();
        let decoded = self.decoding_s((self.waiting_bytes + bytes) as f64);
        self.round_trip.as_secs_f64() + GUARD_S + brought.max(decoded) * (1.0 + GUARD_SHARE)
    }
}

/// Seconds until the first of `soonest_first` has to go, so that it and all behind it are in time;
/// 0 or less: now. None: nothing is expected. `elapsed_s`: age of the expectations. `bytes`:
/// stored bytes of a chunk. `on_the_way`: stored bytes that go before.
pub(super) fn slack_s(
    soonest_first: &[Expected],
    elapsed_s: f64,
    capacity: &Capacity,
    on_the_way: u64,
    bytes: impl Fn(u32) -> u64,
) -> Option<f64> {
    let mut sent = on_the_way as f64;
    let mut decoded_s = capacity.decoding_s(capacity.waiting_bytes as f64).max(sent / capacity.rate());
    decoded_s += capacity.decoding_s(sent);
    let mut least: Option<f64> = None;
    for e in soonest_first {
        let own = bytes(e.chunk) as f64;
        let done_s = decoded_s.max((sent + own) / capacity.rate()) + capacity.decoding_s(own);
        let ready_s = capacity.round_trip.as_secs_f64() + done_s * (1.0 + GUARD_SHARE) + GUARD_S;
        let slack = e.in_s - elapsed_s - ready_s;
        least = Some(least.map_or(slack, |l| l.min(slack)));
        // Those behind it wait for it only if it goes, and of several ways that a walk may take it
        // takes one.
        sent += own * e.probability;
        decoded_s = decoded_s.max(sent / capacity.rate()) + capacity.decoding_s(own * e.probability);
    }
    least
}

#[cfg(test)]
mod tests {
    use super::*;
    use ldi_protocol::wire::Urgency;

    fn expected(chunk: u32, in_s: f64) -> Expected {
        Expected { chunk, in_s, probability: 1.0, urgency: Urgency::Predicted }
    }

    const LINK: Capacity = Capacity {
        bytes_per_s: Some(1e6),
        round_trip: Duration::from_millis(100),
        decoded_per_s: None,
        waiting_bytes: 0,
    };

    #[test]
    fn one_chunk_waits_until_just_before_its_time() {
        // 200 kB at 1 MB/s: 0.2 s and some more as guard, a round trip of 0.1 s.
        let brought = 0.2 * (1.0 + GUARD_SHARE);
        let slack = |in_s, elapsed| slack_s(&[expected(0, in_s)], elapsed, &LINK, 0, |_| 200_000).unwrap();
        assert!((slack(2.0, 0.0) - (2.0 - 0.1 - brought - GUARD_S)).abs() < 1e-9);
        assert!((slack(2.0, 0.5) - (1.5 - 0.1 - brought - GUARD_S)).abs() < 1e-9, "half a second later");
        assert!(slack(0.3, 0.0) < 0.0);
        assert_eq!(slack_s(&[], 0.0, &LINK, 0, |_| 0), None);
    }

    /// Small chunks before a large one go early, so that the large one is in time: against trying
    /// every start on a grid of times.
    #[test]
    fn the_first_goes_early_for_those_behind_it() {
        let list = [expected(0, 1.9), expected(1, 2.0), expected(2, 2.1)];
        let sizes = [50_000u64, 50_000, 1_000_000];
        let slack = slack_s(&list, 0.0, &LINK, 0, |c| sizes[c as usize]).unwrap();
        let late = |start: f64| {
            let mut at = 0.0;
            list.iter().zip(sizes).any(|(e, bytes)| {
                at += bytes as f64 / 1e6;
                start + 0.1 + at * (1.0 + GUARD_SHARE) + GUARD_S > e.in_s
            })
        };
        let latest = (0..3000).map(|i| f64::from(i) * 1e-3).take_while(|s| !late(*s)).last().unwrap();
        assert!((slack - latest).abs() < 2e-3, "{slack} against {latest}");
        assert!(slack < 0.5, "far less than the first one's own time");
    }

    #[test]
    fn decoding_counts_where_it_is_the_slower() {
        let slow = Capacity { decoded_per_s: Some(0.5e6), ..LINK };
        let list = [expected(0, 3.0), expected(1, 3.0)];
        let slack = |c: &Capacity, on_the_way| slack_s(&list, 0.0, c, on_the_way, |_| 100_000).unwrap();
        // 0.1 s for the first to come, then 0.2 s of decoding each.
        assert!((slack(&slow, 0) - (3.0 - 0.1 - 0.5 * (1.0 + GUARD_SHARE) - GUARD_S)).abs() < 1e-9);
        let behind = Capacity { waiting_bytes: 500_000, ..slow };
        assert!((slack(&slow, 0) - slack(&behind, 0) - 0.9 * (1.0 + GUARD_SHARE)).abs() < 1e-9, "a second of it");
        assert!(slack(&LINK, 400_000) < slack(&LINK, 0));
        assert!(slow.horizon_s(1_000_000) > LINK.horizon_s(1_000_000));
    }
}
