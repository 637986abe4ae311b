//! The rate that a link delivers, from acknowledgements: what the planner needs to know when to
//! send ahead.
//!
//! A controller around the one that is configured counts acknowledged bytes in windows of a round
//! trip, at least [`WINDOW`]. In a window in which the connection had more to send than it might,
//! the count is what the link delivers; in others it is what there was to send, and the link may
//! deliver more. The rate is the largest of the last [`MEMORY`]: the filter of BBR (Cardwell et
//! al. 2016), without its packet marks.

use quinn::congestion::{Controller, ControllerFactory, ControllerMetrics};
use quinn_proto::RttEstimator;
use std::{
    any::Any,
    collections::VecDeque,
    sync::Arc,
    time::{Duration, Instant},
};

/// Shortest window. Shorter: bursts of acknowledgements look like rates; longer: short transfers
/// never fill one.
const WINDOW: Duration = Duration::from_millis(25);
/// How long a rate is believed. Longer: slower to notice that a link got worse; shorter: pauses
/// are taken for it.
const MEMORY: Duration = Duration::from_secs(2);

/// Counts acknowledged bytes; time comes in.
#[derive(Debug, Clone, Default)]
pub struct Meter {
    window: Option<Open>,
    /// Full windows with more to send than was allowed: end and rate.
    rates: VecDeque<(Duration, f64)>,
    /// The last known rate, for when nothing was sent for long.
    last: Option<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Open {
    since: Duration,
    /// When something was acknowledged last.
    latest: Duration,
    bytes: u64,
    limited: bool,
}

impl Meter {
    /// Bytes were acknowledged. `had_less`: the connection had nothing more to send.
    pub fn acknowledged(&mut self, now: Duration, bytes: u64, had_less: bool, round_trip: Duration) {
        let window = WINDOW.max(round_trip);
        let new = Open { since: now, latest: now, bytes: 0, limited: had_less };
        // What begins a window was sent before it, and a pause is in none.
        let Some(open) = self.window.as_mut().filter(|o| now.saturating_sub(o.latest) < window) else {
            self.window = Some(new);
            return;
        };
        open.bytes += bytes;
        open.latest = now;
        open.limited |= had_less;
        let lasted = now.saturating_sub(open.since);
        if lasted < window {
            return;
        }
        let rate = open.bytes as f64 / lasted.as_secs_f64();
        let counts = !open.limited || self.last.is_none_or(|l| rate > l);
        self.window = Some(new);
        if counts {
            self.rates.push_back((now, rate));
            while self.rates.front().is_some_and(|(at, _)| now.saturating_sub(*at) > MEMORY) {
                self.rates.pop_front();
            }
            self.last = self.rates.iter().map(|r| r.1).reduce(f64::max);
        }
    }

    /// Bytes per second; None before the first window was full.
    pub fn bytes_per_s(&self) -> Option<f64> {
        self.last
    }
}

/// A controller with a meter around it.
pub(super) struct Metered {
    inner: Box<dyn Controller>,
    meter: Meter,
    start: Instant,
}

impl Metered {
    /// The meter of a connection whose controllers [`MeteredConfig`] made.
    pub fn rate_of(connection: &quinn::Connection) -> Option<f64> {
        let state = connection.congestion_state().into_any().downcast::<Self>().ok()?;
        state.meter.bytes_per_s()
    }
}

impl Controller for Metered {
    fn on_sent(&mut self, now: Instant, bytes: u64, last_packet_number: u64) {
        self.inner.on_sent(now, bytes, last_packet_number);
    }
    fn on_ack(&mut self, now: Instant, sent: Instant, bytes: u64, app_limited: bool, rtt: &RttEstimator) {
        self.meter.acknowledged(now.saturating_duration_since(self.start), bytes, app_limited, rtt.get());
        self.inner.on_ack(now, sent, bytes, app_limited, rtt);
    }
    fn on_end_acks(&mut self, now: Instant, in_flight: u64, app_limited: bool, largest: Option<u64>) {
        self.inner.on_end_acks(now, in_flight, app_limited, largest);
    }
    fn on_congestion_event(&mut self, now: Instant, sent: Instant, persistent: bool, lost_bytes: u64) {
        self.inner.on_congestion_event(now, sent, persistent, lost_bytes);
    }
    fn on_mtu_update(&mut self, new_mtu: u16) {
        self.inner.on_mtu_update(new_mtu);
    }
    fn window(&self) -> u64 {
        self.inner.window()
    }
    fn metrics(&self) -> ControllerMetrics {
        self.inner.metrics()
    }
    fn clone_box(&self) -> Box<dyn Controller> {
        Box::new(Self { inner: self.inner.clone_box(), meter: self.meter.clone(), start: self.start })
    }
    fn initial_window(&self) -> u64 {
        self.inner.initial_window()
    }
    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}

/// Makes metered controllers of another kind.
pub(super) struct MeteredConfig<F>(pub Arc<F>);

impl<F: ControllerFactory> ControllerFactory for MeteredConfig<F> {
    fn build(self: Arc<Self>, now: Instant, current_mtu: u16) -> Box<dyn Controller> {
        Box::new(Metered { inner: self.0.clone().build(now, current_mtu), meter: Meter::default(), start: now })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(n: u64) -> Duration {
        Duration::from_millis(n)
    }

    /// `n` acknowledgements of 1,000 bytes, one per millisecond from `from` on: a megabyte per
    /// second.
    fn steady(m: &mut Meter, from: u64, n: u64, had_less: bool) {
        (from..from + n).for_each(|t| m.acknowledged(ms(t), 1000, had_less, ms(10)));
    }

    #[test]
    fn a_busy_link_is_measured_and_a_pause_changes_nothing() {
        let mut m = Meter::default();
        steady(&mut m, 0, 20, false);
        assert_eq!(m.bytes_per_s(), None, "not long enough");
        steady(&mut m, 20, 200, false);
        assert!((m.bytes_per_s().unwrap() - 1e6).abs() < 1e4);
        // A trickle, as there was no more to send, then nothing for long, then a short burst.
        (1..600).for_each(|i| m.acknowledged(ms(220 + 10 * i), 1000, true, ms(10)));
        steady(&mut m, 20_000, 40, false);
        assert!((m.bytes_per_s().unwrap() - 1e6).abs() < 1e4);
    }

    #[test]
    fn a_slower_link_is_noticed_within_the_memory_and_a_faster_one_at_once() {
        let mut m = Meter::default();
        steady(&mut m, 0, 500, false);
        (0..300).for_each(|i| m.acknowledged(ms(500 + 10 * i), 1000, false, ms(10)));
        assert!((m.bytes_per_s().unwrap() - 1e5).abs() < 1e4, "{:?}", m.bytes_per_s());
        // Even where there was no more to send.
        steady(&mut m, 3500, 100, true);
        assert!(m.bytes_per_s().unwrap() > 0.9e6, "{:?}", m.bytes_per_s());
    }
}
