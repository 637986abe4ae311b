//! Congestion control that tells losses by chance from losses by congestion: after TCP Veno (Fu
//! and Liew 2003, IEEE JSAC 21(2)).
//!
//! Radio links lose packets at random. NewReno and CUBIC take each loss for a full queue and
//! shrink until almost nothing flows: over 25 Mbit/s, 80 ms round trip and 2% loss they carry a
//! twentieth. Here a loss counts as congestion only
//!
//! - when a queue stands: the shortest round trip of the last round exceeds the shortest ever by
//!   [`standing`]; then the window shrinks as theirs does, so that others on the same link get
//!   their share;
//! - or when more than [`HEAVY`] of a round trip's packets are lost: queues can be too short to be
//!   seen.
//!
//! What we changed: the increase. Veno adds a packet per round trip, or half of one when a queue
//! stands. Here a window without a queue grows by a [`GROWTH`]th per round trip, as walks end
//! before a packet per round trip has filled a long link; with a queue it is one packet. Slow
//! start ends when a queue stands, not only at a loss.

use quinn::congestion::{Controller, ControllerFactory};
use quinn_proto::RttEstimator;
use std::{
    any::Any,
    sync::Arc,
    time::{Duration, Instant},
};

/// The window after congestion, in tenths: CUBIC's (RFC 9438).
const SHRINK_TENTHS: u64 = 7;
/// Share of a round's packets beyond which losses are congestion whatever the delay says. Larger:
/// more packets thrown away before a short queue; smaller: bad radio links stop the flow.
const HEAVY: f64 = 0.1;
/// At least so many packets must be lost for [`HEAVY`]: a few say nothing about a share.
const HEAVY_PACKETS: u64 = 4;
/// The part of a window that is added per round trip while no queue stands. Larger: overshoots;
/// smaller: slow after a change of the link.
const GROWTH: u64 = 16;
/// Bounds of the delay that is called a queue. Smaller: late timers pass for queues; larger: short
/// queues are not seen, and others that share them starve.
const STANDING: (Duration, Duration) = (Duration::from_millis(1), Duration::from_millis(5));
/// Window at the start, bytes: ten packets (RFC 9002).
const INITIAL: u64 = 14_720;

/// The delay beyond the shortest round trip that is called a queue: a quarter, within bounds.
fn standing(shortest: Duration) -> Duration {
    (shortest / 4).clamp(STANDING.0, STANDING.1)
}

/// Makes controllers.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct VenoConfig;

impl ControllerFactory for VenoConfig {
    fn build(self: Arc<Self>, now: Instant, current_mtu: u16) -> Box<dyn Controller> {
        Box::new(Veno::new(now, current_mtu))
    }
}

/// One round trip: from a moment until the first packet sent after it is acknowledged.
#[derive(Debug, Clone, Copy)]
struct Round {
    started: Instant,
    shortest: Option<Duration>,
    acked: u64,
    lost: u64,
}

impl Round {
    fn new(started: Instant) -> Self {
        Self { started, shortest: None, acked: 0, lost: 0 }
    }
}

/// See the module.
#[derive(Debug, Clone)]
pub(super) struct Veno {
    mtu: u64,
    window: u64,
    threshold: u64,
    /// Packets sent before have been answered for.
    recovery_started: Instant,
    /// Acknowledged since the last step of the window.
    credit: u64,
    round: Round,
    /// Shortest round trip of the last round, and of all.
    last_shortest: Option<Duration>,
    shortest: Option<Duration>,
}

impl Veno {
    fn new(now: Instant, mtu: u16) -> Self {
        Self {
            mtu: u64::from(mtu),
            window: INITIAL,
            threshold: u64::MAX,
            recovery_started: now,
            credit: 0,
            round: Round::new(now),
            last_shortest: None,
            shortest: None,
        }
    }

    fn least(&self) -> u64 {
        2 * self.mtu
    }

    /// Whether packets wait somewhere on the way.
    fn queue_stands(&self) -> bool {
        let recent = [self.last_shortest, self.round.shortest].into_iter().flatten().min();
        recent.zip(self.shortest).is_some_and(|(recent, shortest)| recent > shortest + standing(shortest))
    }

    fn acked(&mut self, now: Instant, sent: Instant, bytes: u64, app_limited: bool) {
        let trip = now.saturating_duration_since(sent);
        self.shortest = Some(self.shortest.map_or(trip, |s| s.min(trip)));
        self.round.shortest = Some(self.round.shortest.map_or(trip, |s| s.min(trip)));
        self.round.acked += bytes;
        if sent >= self.round.started {
            self.last_shortest = self.round.shortest;
            self.round = Round::new(now);
        }
        if app_limited || sent <= self.recovery_started {
            return;
        }
        let stands = self.queue_stands();
        if self.window < self.threshold && !stands {
            self.window += bytes;
            return;
        }
        self.threshold = self.threshold.min(self.window);
        self.credit += bytes;
        // One packet per so many acknowledged bytes.
        let each = if stands { self.window } else { (GROWTH * self.mtu).min(self.window) };
        if self.credit >= each {
            self.credit -= each;
            self.window += self.mtu;
        }
    }

    fn lost(&mut self, now: Instant, sent: Instant, persistent: bool, bytes: u64) {
        self.round.lost += bytes;
        if persistent {
            self.window = self.least();
            self.threshold = u64::MAX;
            self.recovery_started = now;
            return;
        }
        let of = (self.round.acked + self.round.lost).max(self.window / 2);
        let heavy = self.round.lost >= HEAVY_PACKETS * self.mtu && self.round.lost as f64 > HEAVY * of as f64;
        // A marked packet (no bytes lost) is congestion by definition.
        if sent <= self.recovery_started || !(heavy || bytes == 0 || self.queue_stands()) {
            return;
        }
        self.recovery_started = now;
        self.window = (self.window * SHRINK_TENTHS / 10).max(self.least());
        self.threshold = self.window;
        self.credit = 0;
    }
}

impl Controller for Veno {
    fn on_ack(&mut self, now: Instant, sent: Instant, bytes: u64, app_limited: bool, _: &RttEstimator) {
        self.acked(now, sent, bytes, app_limited);
    }
    fn on_congestion_event(&mut self, now: Instant, sent: Instant, persistent: bool, lost_bytes: u64) {
        self.lost(now, sent, persistent, lost_bytes);
    }
    fn on_mtu_update(&mut self, new_mtu: u16) {
        self.mtu = u64::from(new_mtu);
        self.window = self.window.max(self.least());
    }
    fn window(&self) -> u64 {
        self.window
    }
    fn clone_box(&self) -> Box<dyn Controller> {
        Box::new(self.clone())
    }
    fn initial_window(&self) -> u64 {
        INITIAL
    }
    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}

#[cfg(test)]
#[path = "veno_test.rs"]
mod tests;
