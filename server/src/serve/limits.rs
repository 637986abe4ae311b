//! What one client may take from the others: connections per address, messages per second.

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

/// Counts the open connections.
#[derive(Debug)]
pub struct Door {
    total: usize,
    per_address: usize,
    open: Mutex<HashMap<IpAddr, usize>>,
}

/// A place inside; given back when dropped.
#[derive(Debug)]
pub struct Place {
    door: Arc<Door>,
    address: IpAddr,
}

impl Door {
    /// A door with room for `total`, and for `per_address` from one address.
    pub fn new(total: usize, per_address: usize) -> Arc<Self> {
        Arc::new(Self { total, per_address, open: Mutex::default() })
    }
    /// Takes a place; None when there is none left.
    pub fn enter(self: &Arc<Self>, address: IpAddr) -> Option<Place> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if open.values().sum::<usize>() >= self.total {
            return None;
        }
        let here = open.entry(address).or_default();
        if *here >= self.per_address {
            return None;
        }
        *here += 1;
        Some(Place { door: self.clone(), address })
    }
    /// How many are inside.
    pub fn inside(&self) -> usize {
        self.open.lock().unwrap_or_else(PoisonError::into_inner).values().sum()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut open = self.door.open.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(here) = open.get_mut(&self.address) {
            *here -= 1;
            if *here == 0 {
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
        let door = Door::new(3, 2);
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
}
