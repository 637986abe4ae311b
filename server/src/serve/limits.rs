//! What one client may take from the others: connections and bytes per address, messages per second.

use std::{
    collections::HashMap,
    net::IpAddr,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

/// A bucket that fills at a steady rate: short bursts pass, a steady excess does not. Time comes in.
#[derive(Debug, Clone)]
pub struct TokenBucket {
    per_second: f64,
    capacity: f64,
    level: f64,
    at: Duration,
}

impl TokenBucket {
    /// Full at time 0.
    pub fn new(per_second: f64, capacity: f64) -> Self {
        Self { per_second, capacity, level: capacity, at: Duration::ZERO }
    }
    /// Takes one, if there is one.
    pub fn take(&mut self, now: Duration) -> bool {
        let passed = now.saturating_sub(self.at).as_secs_f64();
        self.at = self.at.max(now);
        self.level = (self.level + passed * self.per_second).min(self.capacity);
        if self.level < 1.0 {
            return false;
        }
        self.level -= 1.0;
        true
    }
}

/// Bytes per second that all connections of an address share. Time comes in.
#[derive(Debug)]
pub struct Allowance {
    bytes_per_s: f64,
    /// When all that was taken so far will have passed.
    passed_at: Mutex<Duration>,
}

impl Allowance {
    /// As much may go at once as passes in this time: pauses are not saved up.
    const BURST: Duration = Duration::from_millis(100);

    fn new(bytes_per_s: f64) -> Self {
        Self { bytes_per_s, passed_at: Mutex::new(Duration::ZERO) }
    }

    /// Counts bytes that were sent.
    pub fn sent(&self, now: Duration, bytes: usize) {
        let mut passed_at = self.passed_at.lock().unwrap_or_else(PoisonError::into_inner);
        *passed_at = (*passed_at).max(now) + Duration::from_secs_f64(bytes as f64 / self.bytes_per_s);
    }

    /// When more may be sent.
    pub fn next_at(&self) -> Duration {
        self.passed_at.lock().unwrap_or_else(PoisonError::into_inner).saturating_sub(Self::BURST)
    }
}

/// Counts the open connections.
#[derive(Debug)]
pub struct Door {
    total: usize,
    per_address: usize,
    /// None: as many as can be.
    bytes_per_s: Option<f64>,
    open: Mutex<HashMap<IpAddr, Inside>>,
}

/// Who is in from one address.
#[derive(Debug, Default)]
struct Inside {
    connections: usize,
    allowance: Option<Arc<Allowance>>,
}

/// A place inside; given back when dropped.
#[derive(Debug)]
pub struct Place {
    door: Arc<Door>,
    address: IpAddr,
    /// What it shares with all others of its address; None: no limit.
    pub allowance: Option<Arc<Allowance>>,
}

impl Door {
    /// A door with room for `total`, and for `per_address` from one address, which share `bytes_per_s` (0: no limit).
    pub fn new(total: usize, per_address: usize, bytes_per_s: f64) -> Arc<Self> {
        let bytes_per_s = (bytes_per_s > 0.0).then_some(bytes_per_s);
        Arc::new(Self { total, per_address, bytes_per_s, open: Mutex::default() })
    }
    /// Takes a place; None when there is none left.
    pub fn enter(self: &Arc<Self>, address: IpAddr) -> Option<Place> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if open.values().map(|i| i.connections).sum::<usize>() >= self.total {
            return None;
        }
        let here = open.entry(address).or_default();
        if here.connections >= self.per_address {
            return None;
        }
        here.connections += 1;
        if here.allowance.is_none() {
            here.allowance = self.bytes_per_s.map(|b| Arc::new(Allowance::new(b)));
        }
        Some(Place { door: self.clone(), address, allowance: here.allowance.clone() })
    }
    /// How many are inside.
    pub fn inside(&self) -> usize {
        self.open.lock().unwrap_or_else(PoisonError::into_inner).values().map(|i| i.connections).sum()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut open = self.door.open.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(here) = open.get_mut(&self.address) {
            here.connections -= 1;
            if here.connections == 0 {
                open.remove(&self.address);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_passes_and_a_steady_excess_does_not() {
        let mut b = TokenBucket::new(10.0, 5.0);
        let taken = |b: &mut TokenBucket, ms: u64| (0..100).filter(|_| b.take(Duration::from_millis(ms))).count();
        assert_eq!(taken(&mut b, 0), 5);
        assert_eq!(taken(&mut b, 200), 2);
        assert_eq!(taken(&mut b, 100), 0, "time going back fills nothing");
        assert_eq!(taken(&mut b, 60_000), 5);
    }

    #[test]
    fn places_are_counted_and_given_back() {
        let door = Door::new(3, 2, 0.0);
        let (a, b) = (IpAddr::from([127, 0, 0, 1]), IpAddr::from([10, 0, 0, 1]));
        let first = door.enter(a).unwrap();
        let _second = door.enter(a).unwrap();
        assert!(door.enter(a).is_none(), "two from one address");
        let _third = door.enter(b).unwrap();
        assert!(door.enter(b).is_none(), "three in all");
        drop(first);
        assert!(door.enter(b).is_some());
        assert_eq!(door.inside(), 2);
    }

    #[test]
    fn connections_of_an_address_share_its_bytes_and_a_pause_is_not_saved_up() {
        let door = Door::new(9, 9, 1e6);
        let (a, b) = (IpAddr::from([127, 0, 0, 1]), IpAddr::from([10, 0, 0, 1]));
        let places = [a, a, b].map(|address| door.enter(address).expect("room"));
        let limit = |place: usize| places[place].allowance.as_ref().expect("limited");
        let sent = |place: usize, ms: u64, bytes: usize| {
            limit(place).sent(Duration::from_millis(ms), bytes);
            limit(place).next_at().as_millis()
        };
        // A hundred milliseconds' worth goes at once, by whichever connection; then a kilobyte per millisecond.
        assert_eq!([sent(0, 1000, 60_000), sent(1, 1000, 40_000), sent(0, 1000, 50_000)], [960, 1000, 1050]);
        assert_eq!(
            (limit(1).next_at().as_millis(), limit(2).next_at().as_millis()),
            (1050, 0),
            "another address has its own"
        );
        assert_eq!([sent(0, 9000, 100_000), sent(1, 9000, 1_000)], [9000, 9001]);
        assert!(Door::new(9, 9, 0.0).enter(a).expect("room").allowance.is_none());
    }
}
