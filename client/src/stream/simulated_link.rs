//! A simulated network link as pure arithmetic: the fate of each packet, given its send time. No
//! sockets, no clock, no threads.
//!
//! In: `rate=20mbit,delay=20ms,jitter=5ms,loss=2%,dup=1%,blackout=10s:2s,queue=100ms,seed=1`
//! ([`LinkSpec`]), and packets with their times. Out: per packet a time of arrival, or the reason
//! why it does not arrive ([`Fate`]). [`super::simulated_socket`] places two of these, one per
//! direction, between QUIC and the network.
//!
//! ```text
//!            queue: drops what would wait too long      wire: loses at random, delays
//!   sent ──▶ ▤▤▤▤▤▤ ──▶ one packet at a time, at `rate` ──▶ ·  ·   ·  ·──▶ arrived
//! ```
//!
//! - A packet takes (bytes + [`HEADER_BYTES`]) / rate to pass, after those before it. A packet that
//!   would have to wait longer than `queue` is dropped.
//! - Then it is lost with probability `loss`; a lost packet has used its share of the rate, as on a
//!   radio link. During a `blackout` all packets are lost.
//! - Then it takes `delay`, and up to `jitter` more, uniformly distributed. Only jitter reorders
//!   packets.
//! - With probability `dup` it arrives twice, the second time with its own jitter.
//!
//! The fate of the n-th packet of a direction depends on a hash of (seed, direction, n) alone, so
//! that the same packets at the same times have the same fates, and a change in one packet's time
//! does not affect the random numbers of later ones.

use std::{fmt, str::FromStr, time::Duration};

/// Bytes of IPv4 and UDP headers, which a link carries in addition to a packet's bytes.
pub const HEADER_BYTES: usize = 28;
/// Slowest rate, bits per second.
const MIN_RATE_BIT_S: f64 = 8_000.0;
/// Fastest rate, bits per second.
const MAX_RATE_BIT_S: f64 = 1e12;
/// Longest delay, jitter and queue, below QUIC's timeout.
const MAX_TIME: Duration = Duration::from_secs(60);

/// The link between client and server, the same in both directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkSpec {
    /// Bits per second, including IP and UDP headers. None: unlimited.
    pub rate_bit_s: Option<f64>,
    /// One-way delay.
    pub delay: Duration,
    /// Largest addition to `delay`. Reorders packets if it exceeds the time between two of them.
    pub jitter: Duration,
    /// Share of packets lost at random, 0 to 1.
    pub loss: f64,
    /// Share of packets that arrive twice, 0 to 1.
    pub duplicates: f64,
    /// Start, since the link began, and length of the time in which every packet is lost.
    pub blackout: Option<(Duration, Duration)>,
    /// Longest wait before the link; without a rate there is none.
    pub queue: Duration,
    /// Seed of the random numbers.
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

/// An invalid `--link`.
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
    /// Writes the specification in the form that is parsed.
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

/// A non-negative number with one of these units.
fn number_and_unit(text: &str, units: &[(&str, f64)]) -> Option<f64> {
    let lower = text.to_ascii_lowercase();
    let (number, factor) = units.iter().find_map(|(unit, factor)| Some((lower.strip_suffix(unit)?, factor)))?;
    let number: f64 = number.trim_end().parse().ok()?;
    (number.is_finite() && number >= 0.0).then_some(number * factor)
}

fn time(text: &str) -> Option<Duration> {
    moment(text).filter(|t| *t <= MAX_TIME)
}

/// A time of at most a day.
fn moment(text: &str) -> Option<Duration> {
    // Longer unit names first, as all of them end in "s".
    let seconds = number_and_unit(text, &[("ms", 1e-3), ("us", 1e-6), ("s", 1.0)])?;
    (seconds <= 86_400.0).then(|| Duration::from_secs_f64(seconds))
}

/// Direction of packets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Client to server.
    Up,
    /// Server to client.
    Down,
}

/// The fate of a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// It arrives at this time.
    Arrives(Duration),
    /// It arrives at both times, in either order.
    ArrivesTwice(Duration, Duration),
    /// It is lost on the way.
    Lost,
    /// It is dropped because the queue is full.
    Dropped,
}

/// Counts of a direction's packets. Sent is the sum of delivered, lost and dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct LinkCounts {
    /// Packets sent.
    pub sent: u64,
    /// Packets that arrived or will.
    pub delivered: u64,
    /// Delivered packets that arrived twice.
    pub doubled: u64,
    /// Packets lost at random or in a blackout.
    pub lost: u64,
    /// Packets dropped at the queue.
    pub dropped: u64,
    /// Payload bytes delivered.
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

/// One direction of a link. Times are non-decreasing.
#[derive(Debug)]
pub struct SimulatedLink {
    spec: LinkSpec,
    direction: Direction,
    /// Time at which the last accepted packet has passed.
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
            // Rounded up to nanoseconds, so that the rate is never exceeded.
            let ns = (((bytes + HEADER_BYTES) * 8) as f64 * 1e9 / rate).ceil();
            self.free_at = start + Duration::from_nanos(ns as u64);
        } else {
            self.free_at = start;
        }
        let draw = |draw| uniform(self.spec.seed, self.direction, number, draw);
        // A packet is on the wire once its last bit has passed.
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

    /// Counts a packet as dropped that could not be held until its arrival.
    pub(super) fn take_back(&mut self, bytes: usize) {
        self.counts.delivered -= 1;
        self.counts.bytes -= bytes as u64;
        self.counts.dropped += 1;
    }

    /// Counts so far.
    pub fn counts(&self) -> LinkCounts {
        self.counts
    }
}

/// A number in [0, 1), by hash: the mixing function of SplitMix64 (Steele, Lea and Flood 2014) over
/// the mixed parts.
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
