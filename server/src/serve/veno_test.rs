use super::*;
use std::collections::VecDeque;

const MTU: u64 = 1_250;
const MS: Duration = Duration::from_millis(1);

/// What a run did in its measured part.
struct Run {
    arrived: u64,
    dropped: u64,
    smallest_window: u64,
    largest_window: u64,
}

/// A link of `rate` packets per millisecond, a queue of `queue` packets, 40 ms each way, that
/// loses every `every`th packet; always something to send. Time is virtual, in milliseconds; the
/// last `measured_ms` of `total_ms` count.
fn run(rate: u64, queue: u64, every: u64, total_ms: u32, measured_ms: u32) -> Run {
    let start = Instant::now();
    let mut c = Veno::new(start, MTU as u16);
    // (time sent, time the sender hears of it, whether it arrived)
    let mut flying: VecDeque<(u32, u32, bool)> = VecDeque::new();
    let (mut waiting, mut number, mut in_flight) = (VecDeque::new(), 0u64, 0u64);
    let mut out = Run { arrived: 0, dropped: 0, smallest_window: u64::MAX, largest_window: 0 };
    let mut tokens = 0.0;
    for ms in 0..total_ms {
        let measured = ms >= total_ms - measured_ms;
        let now = start + MS * ms;
        while flying.front().is_some_and(|f| f.1 <= ms) {
            let Some((sent, _, arrived)) = flying.pop_front() else { break };
            in_flight -= MTU;
            if arrived {
                c.acked(now, start + MS * sent, MTU, false);
            } else {
                c.lost(now, start + MS * sent, false, MTU);
            }
        }
        // Paced: a window per round trip, at most a quarter more.
        tokens = (tokens + c.window as f64 * 1.25 / 80.0 / MTU as f64).min(16.0);
        while tokens >= 1.0 && in_flight + MTU <= c.window {
            tokens -= 1.0;
            in_flight += MTU;
            number += 1;
            if waiting.len() as u64 >= queue {
                out.dropped += u64::from(measured);
                flying.push_back((ms, ms + 80 + (queue / rate) as u32, false));
            } else {
                waiting.push_back((ms, number));
            }
        }
        for _ in 0..rate {
            let Some((sent, n)) = waiting.pop_front() else { break };
            let arrived = every == 0 || n % every != 0;
            out.arrived += u64::from(arrived && measured);
            flying.push_back((sent, ms + 80, arrived));
        }
        flying.make_contiguous().sort_by_key(|f| f.1);
        if measured {
            out.smallest_window = out.smallest_window.min(c.window);
            out.largest_window = out.largest_window.max(c.window);
        }
    }
    out
}

#[test]
fn a_clean_link_is_filled_and_its_queue_hardly_overflows() {
    // 20 Mbit/s; the queue holds 100 ms.
    let r = run(2, 200, 0, 30_000, 20_000);
    assert!(r.arrived > 37_000, "{} of 40000", r.arrived);
    assert!(r.dropped < r.arrived / 100, "{} dropped", r.dropped);
}

#[test]
fn random_loss_hardly_slows_it() {
    let r = run(2, 200, 50, 30_000, 20_000);
    // What is lost by chance has used the link all the same: 98 of 100 is the most.
    assert!(r.arrived > 32_000, "{} of 39200", r.arrived);
    assert!(r.dropped < r.arrived / 50, "{} dropped", r.dropped);
}

#[test]
fn a_short_queue_is_noticed_by_its_losses() {
    // 5 packets, 2.5 ms: no delay tells.
    let r = run(2, 5, 0, 30_000, 20_000);
    assert!(r.arrived > 20_000, "{} of 40000", r.arrived);
    assert!(r.dropped < r.arrived / 5, "{} dropped of {}", r.dropped, r.arrived);
    assert!(r.largest_window < 3 * 160 * MTU && r.smallest_window > 20 * MTU);
}

/// With so many round trips of `trip` behind it.
fn settled(trip: Duration, queued: Duration) -> (Veno, Instant) {
    let mut now = Instant::now();
    let mut c = Veno::new(now, MTU as u16);
    c.acked(now + trip, now, MTU, true);
    for _ in 0..4 {
        let sent = now + trip;
        now = sent + trip + queued;
        c.acked(now, sent, MTU, true);
    }
    (c, now)
}

#[test]
fn a_loss_counts_only_when_a_queue_stands() {
    let (mut quiet, now) = settled(MS * 80, MS * 3);
    let before = quiet.window;
    quiet.lost(now, now - MS * 80, false, MTU);
    assert_eq!(quiet.window, before, "by chance");
    let (mut queued, now) = settled(MS * 80, MS * 30);
    queued.lost(now, now - MS * 80, false, MTU);
    assert_eq!(queued.window, before * 7 / 10);
    queued.lost(now, now - MS * 81, false, MTU);
    assert_eq!(queued.window, before * 7 / 10, "once per round trip");
}

#[test]
fn marks_heavy_losses_and_silence_always_count() {
    let (c, now) = settled(MS * 80, Duration::ZERO);
    let after = |bytes, persistent| {
        let mut c = c.clone();
        c.lost(now, now - MS * 80, persistent, bytes);
        c.window
    };
    assert_eq!(after(0, false), c.window * 7 / 10);
    assert_eq!(after(5 * MTU, false), c.window * 7 / 10);
    assert_eq!(after(3 * MTU, false), c.window);
    assert_eq!(after(20 * MTU, true), 2 * MTU);
}
