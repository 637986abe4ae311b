//! A network link as arithmetic: what becomes of each packet, given when it is sent. No sockets, no clock, no threads.
//!
//! In: `rate=20mbit,delay=20ms,jitter=5ms,loss=2%,dup=1%,blackout=10s:2s,queue=100ms,seed=1` ([`LinkSpec`]), and packets with their times. Out: per packet
//! a time of arrival, or why it never arrives ([`Fate`]). [`super::simulated_socket`] puts two of these, one per direction, between QUIC and the wire.
//!
//! ```text
//!            queue: drops what would wait too long      wire: loses at random, delays
//!   sent ──▶ ▤▤▤▤▤▤ ──▶ one packet at a time, at `rate` ──▶ ·  ·   ·  ·──▶ arrived
//! ```
//!
//! - A packet takes (bytes + [`HEADER_BYTES`]) / rate to pass, after those before it have. One that would have to wait longer than `queue` until
//!   its turn is dropped at the tail.
//! - Then it is lost with probability `loss`; a lost packet has used its share of the rate, as on a radio link. During a `blackout` all are lost.
//! - Then it takes `delay`, and up to `jitter` more, evenly spread. Packets overtake each other only by that.
//! - With probability `dup` it arrives twice, the second time with a lateness of its own.
//!
//! The fate of the n-th packet of a direction draws on a hash of (seed, direction, n) and nothing else, so that the same packets at the same times
//! have the same fates, and a change in one packet's time does not shift the luck of those after it.

use std::{fmt, str::FromStr, time::Duration};

/// IPv4 and UDP headers, which a link carries beside what is counted as a packet's bytes.
pub const HEADER_BYTES: usize = 28;
/// Slowest rate, bits per second: below it a single packet takes more than a second.
const MIN_RATE_BIT_S: f64 = 8_000.0;
/// Fastest rate: above it the arithmetic is no limit on anything that runs here.
const MAX_RATE_BIT_S: f64 = 1e12;
/// Longest delay, jitter and queue: QUIC gives up long before.
const MAX_TIME: Duration = Duration::from_secs(60);

/// What lies between client and server, the same in both directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkSpec {
    /// Bits per second, IP and UDP headers included. None: as fast as can be.
    pub rate_bit_s: Option<f64>,
    /// One way.
    pub delay: Duration,
    /// Longest addition to `delay`; more than the time between two packets lets them overtake each other.
    pub jitter: Duration,
    /// Share of packets lost at random, 0 to 1.
    pub loss: f64,
    /// Share of packets that arrive twice, 0 to 1.
    pub duplicates: f64,
    /// From when on, since the link began, and for how long every packet is lost.
    pub blackout: Option<(Duration, Duration)>,
    /// Longest wait before the link. Without a rate nobody waits.
    pub queue: Duration,
    /// Another seed, other packets lost.
    pub seed: u64,
}

impl Default for LinkSpec {
    fn default() -> Self {
        Self {
            rate_bit_s: None,
            delay: Duration::ZERO,
            jitter: Duration::ZERO,
            loss: 0.0,
            duplicates: 0.0,
            blackout: None,
            queue: Duration::from_millis(100),
            seed: 1,
        }
    }
}

/// A `--link` that is none.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0}; for example rate=20mbit,delay=20ms,jitter=5ms,loss=2%,dup=1%,blackout=10s:2s,queue=100ms,seed=1, each of them optional"
)]
pub struct LinkError(String);

impl FromStr for LinkSpec {
    type Err = LinkError;

    fn from_str(text: &str) -> Result<Self, LinkError> {
        let mut spec = Self::default();
        let mut seen: Vec<&str> = Vec::new();
        for part in text.split(',').map(str::trim) {
            let Some((key, value)) = part.split_once('=').map(|(k, v)| (k.trim(), v.trim())) else {
                return Err(LinkError(format!("\"{part}\" is not KEY=VALUE")));
            };
            if seen.contains(&key) {
                return Err(LinkError(format!("{key} is given twice")));
            }
            seen.push(key);
            let wrong = |expected: &str| LinkError(format!("{key}={value}: {expected}"));
            let time = || time(value).ok_or_else(|| wrong("a time of 0 to 60 s with its unit: us, ms or s"));
            match key {
                "rate" => {
                    let rate = number_and_unit(value, &[("kbit", 1e3), ("mbit", 1e6), ("gbit", 1e9), ("bit", 1.0)])
                        .filter(|r| (MIN_RATE_BIT_S..=MAX_RATE_BIT_S).contains(r));
                    let expected = "a rate of 8kbit to 1000gbit with its unit: bit, kbit, mbit or gbit per second";
                    spec.rate_bit_s = Some(rate.ok_or_else(|| wrong(expected))?);
                }
                "delay" => spec.delay = time()?,
                "jitter" => spec.jitter = time()?,
                "queue" => spec.queue = time()?,
                "loss" | "dup" => {
                    let share = number_and_unit(value, &[("%", 0.01)]).filter(|l| (0.0..=1.0).contains(l));
                    let field = if key == "loss" { &mut spec.loss } else { &mut spec.duplicates };
                    *field = share.ok_or_else(|| wrong("a share of 0% to 100%, with the sign"))?;
                }
                "blackout" => {
                    let times = value.split_once(':').and_then(|(a, b)| Some((moment(a.trim())?, moment(b.trim())?)));
                    let expected = "START:LENGTH, times of 0 to 24 h with their units: us, ms or s";
                    spec.blackout = Some(times.ok_or_else(|| wrong(expected))?);
                }
                "seed" => spec.seed = value.parse().map_err(|_| wrong("a whole number of 0 or more"))?,
                _ => {
                    return Err(LinkError(format!(
                        "\"{key}\" is none of rate, delay, jitter, loss, dup, blackout, queue, seed"
                    )));
                }
            }
        }
        Ok(spec)
    }
}

impl fmt::Display for LinkSpec {
    /// As it can be read again.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(rate) = self.rate_bit_s {
            write!(f, "rate={}kbit,", rate / 1e3)?;
        }
        let ms = |d: Duration| d.as_secs_f64() * 1e3;
        write!(f, "delay={}ms,jitter={}ms,", ms(self.delay), ms(self.jitter))?;
        write!(f, "loss={}%,", self.loss * 100.0)?;
        if self.duplicates > 0.0 {
            write!(f, "dup={}%,", self.duplicates * 100.0)?;
        }
        if let Some((start, length)) = self.blackout {
            write!(f, "blackout={}ms:{}ms,", ms(start), ms(length))?;
        }
        write!(f, "queue={}ms,seed={}", ms(self.queue), self.seed)
    }
}

/// A number that is not negative, with one of these units.
fn number_and_unit(text: &str, units: &[(&str, f64)]) -> Option<f64> {
    let lower = text.to_ascii_lowercase();
    let (number, factor) = units.iter().find_map(|(unit, factor)| Some((lower.strip_suffix(unit)?, factor)))?;
    let number: f64 = number.trim_end().parse().ok()?;
    (number.is_finite() && number >= 0.0).then_some(number * factor)
}

fn time(text: &str) -> Option<Duration> {
    moment(text).filter(|t| *t <= MAX_TIME)
}

/// A time within a day.
fn moment(text: &str) -> Option<Duration> {
    // The longer units first: every one of them ends in "s".
    let seconds = number_and_unit(text, &[("ms", 1e-3), ("us", 1e-6), ("s", 1.0)])?;
    (seconds <= 86_400.0).then(|| Duration::from_secs_f64(seconds))
}

/// Which way packets go.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// From the client.
    Up,
    /// To the client.
    Down,
}

/// What becomes of a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// It arrives at this time.
    Arrives(Duration),
    /// It arrives at both of these times, in either order.
    ArrivesTwice(Duration, Duration),
    /// It is lost on the way.
    Lost,
    /// It is dropped: too much waits already.
    Dropped,
}

/// What became of all packets of a direction. Sent is the sum of those delivered, lost and dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct LinkCounts {
    /// Handed to the link.
    pub sent: u64,
    /// Arrived, or on the wire.
    pub delivered: u64,
    /// Those of them that arrived twice.
    pub doubled: u64,
    /// Lost at random, or in a black-out.
    pub lost: u64,
    /// Dropped at the tail of the queue.
    pub dropped: u64,
    /// Payload bytes of those delivered.
    pub bytes: u64,
}

impl std::ops::AddAssign for LinkCounts {
    fn add_assign(&mut self, other: Self) {
        self.sent += other.sent;
        self.delivered += other.delivered;
        self.doubled += other.doubled;
        self.lost += other.lost;
        self.dropped += other.dropped;
        self.bytes += other.bytes;
    }
}

/// One direction of a link. Time comes in and never goes back.
#[derive(Debug)]
pub struct SimulatedLink {
    spec: LinkSpec,
    direction: Direction,
    /// When the last packet that was let in has passed.
    free_at: Duration,
    counts: LinkCounts,
}

impl SimulatedLink {
    /// An idle link.
    pub fn new(spec: LinkSpec, direction: Direction) -> Self {
        Self { spec, direction, free_at: Duration::ZERO, counts: LinkCounts::default() }
    }

    /// Sends a packet of `bytes` (without [`HEADER_BYTES`]) at `now`.
    pub fn send(&mut self, now: Duration, bytes: usize) -> Fate {
        let number = self.counts.sent;
        self.counts.sent += 1;
        let start = self.free_at.max(now);
        if let Some(rate) = self.spec.rate_bit_s {
            if start - now > self.spec.queue {
                self.counts.dropped += 1;
                return Fate::Dropped;
            }
            // Rounded up to whole nanoseconds, so that the rate is never exceeded.
            let ns = (((bytes + HEADER_BYTES) * 8) as f64 * 1e9 / rate).ceil();
            self.free_at = start + Duration::from_nanos(ns as u64);
        } else {
            self.free_at = start;
        }
        let draw = |draw| uniform(self.spec.seed, self.direction, number, draw);
        // On the wire when its last bit has passed.
        let dark = |(start, length)| (start..start + length).contains(&self.free_at);
        if draw(0) < self.spec.loss || self.spec.blackout.is_some_and(dark) {
            self.counts.lost += 1;
            return Fate::Lost;
        }
        self.counts.delivered += 1;
        self.counts.bytes += bytes as u64;
        let at = |late| self.free_at + self.spec.delay + self.spec.jitter.mul_f64(late);
        if draw(2) < self.spec.duplicates {
            self.counts.doubled += 1;
            return Fate::ArrivesTwice(at(draw(1)), at(draw(3)));
        }
        Fate::Arrives(at(draw(1)))
    }

    /// A packet that was to arrive could not be held: it counts as dropped.
    pub(super) fn take_back(&mut self, bytes: usize) {
        self.counts.delivered -= 1;
        self.counts.bytes -= bytes as u64;
        self.counts.dropped += 1;
    }

    /// What became of the packets so far.
    pub fn counts(&self) -> LinkCounts {
        self.counts
    }
}

/// A number in [0, 1), by hash: the mixing function of SplitMix64 (Steele, Lea and Flood 2014) over the mixed parts.
fn uniform(seed: u64, direction: Direction, packet: u64, draw: u64) -> f64 {
    let mix = |z: u64| {
        let z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    };
    let hash = mix(mix(mix(seed) ^ (direction as u64 * 4 + draw)) ^ packet);
    (hash >> 11) as f64 * (-53f64).exp2()
}

#[cfg(test)]
#[path = "simulated_link_test.rs"]
mod tests;
