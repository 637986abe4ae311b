//! The packets in transit in one direction of a simulated link.

use super::simulated_link::{Direction, Fate, LinkCounts, LinkSpec, SimulatedLink};
use std::{cmp::Reverse, collections::BinaryHeap, time::Duration};

/// Largest number of packets in transit. Packets beyond are dropped and counted.
pub(super) const MAX_WAITING: usize = 1 << 16;

/// A packet with its time of arrival. The number keeps the order of packets that arrive together.
#[derive(Debug)]
struct Waiting<P> {
    at: Duration,
    number: u64,
    packet: P,
}

impl<P> PartialEq for Waiting<P> {
    fn eq(&self, other: &Self) -> bool {
        (self.at, self.number) == (other.at, other.number)
    }
}
impl<P> Eq for Waiting<P> {}
impl<P> PartialOrd for Waiting<P> {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl<P> Ord for Waiting<P> {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.at, self.number).cmp(&(other.at, other.number))
    }
}

/// A [`SimulatedLink`] with the packets in transit, of any type. Times are non-decreasing.
#[derive(Debug)]
pub struct PacketQueue<P> {
    link: SimulatedLink,
    waiting: BinaryHeap<Reverse<Waiting<P>>>,
    next: u64,
}

impl<P: Clone> PacketQueue<P> {
    /// An idle link.
    pub fn new(spec: LinkSpec, direction: Direction) -> Self {
        Self { link: SimulatedLink::new(spec, direction), waiting: BinaryHeap::new(), next: 0 }
    }

    /// Sends a packet of `bytes` (without [`HEADER_BYTES`](super::HEADER_BYTES)) at `now`.
    pub fn send(&mut self, now: Duration, bytes: usize, packet: P) {
        let (at, again) = match self.link.send(now, bytes) {
            Fate::Arrives(at) => (at, None),
            Fate::ArrivesTwice(at, again) => (at, Some(again)),
            Fate::Lost | Fate::Dropped => return,
        };
        if self.waiting.len() >= MAX_WAITING {
            return self.link.take_back(bytes);
        }
        if let Some(again) = again {
            self.hold(again, packet.clone());
        }
        self.hold(at, packet);
    }

    fn hold(&mut self, at: Duration, packet: P) {
        self.waiting.push(Reverse(Waiting { at, number: self.next, packet }));
        self.next += 1;
    }

    /// When the next packet arrives.
    pub fn next_at(&self) -> Option<Duration> {
        self.waiting.peek().map(|w| w.0.at)
    }

    /// The next packet that has arrived by now.
    pub fn arrived(&mut self, now: Duration) -> Option<P> {
        if self.next_at()? > now {
            return None;
        }
        self.waiting.pop().map(|w| w.0.packet)
    }

    /// Packet counts so far.
    pub fn counts(&self) -> LinkCounts {
        self.link.counts()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lane_gives_packets_out_in_the_order_of_arrival() {
        let spec = "rate=8mbit,delay=10ms".parse().expect("a link");
        let mut packets = PacketQueue::new(spec, Direction::Down);
        let ms = Duration::from_millis;
        // 972 bytes and 28 of headers take 1 ms.
        (0..3).for_each(|i| packets.send(ms(0), 972, i));
        assert_eq!(packets.next_at(), Some(ms(11)));
        assert!(packets.arrived(ms(10)).is_none());
        let mut out = Vec::new();
        while let Some(p) = packets.arrived(ms(12)) {
            out.push(p);
        }
        assert_eq!((out, packets.next_at()), (vec![0, 1], Some(ms(13))));
    }

    #[test]
    fn what_cannot_be_held_is_dropped_and_counted() {
        let mut packets =
            PacketQueue::new(LinkSpec { delay: Duration::from_secs(1), ..LinkSpec::default() }, Direction::Up);
        (0..MAX_WAITING + 3).for_each(|_| packets.send(Duration::ZERO, 10, ()));
        let c = packets.counts();
        assert_eq!((c.sent, c.delivered, c.dropped), (MAX_WAITING as u64 + 3, MAX_WAITING as u64, 3));
        assert_eq!(c.bytes, 10 * MAX_WAITING as u64);
    }
}
