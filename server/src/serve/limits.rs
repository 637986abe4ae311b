//! Rate limits: how many messages or bytes pass per second.

use std::{
    sync::{Mutex, PoisonError},
    time::Duration,
};

/// A bucket that fills at a steady rate: short bursts pass, a steady excess does not. Time comes
/// in.
#[derive(Debug, Clone)]
pub struct TokenBucket {
    per_second: f64,
    capacity: f64,
    level: f64,
    at: Duration,
}

impl TokenBucket {
    /// Full at time 0, and so at any time before the first is taken.
    pub fn new(per_second: f64, capacity: f64) -> Self {
        Self { per_second, capacity, level: capacity, at: Duration::ZERO }
    }

    /// What is in it.
    pub fn level(&mut self, now: Duration) -> f64 {
        let passed = now.saturating_sub(self.at).as_secs_f64();
        self.at = self.at.max(now);
        self.level = (self.level + passed * self.per_second).min(self.capacity);
        self.level
    }

    /// Takes one, if there is one.
    pub fn take(&mut self, now: Duration) -> bool {
        let is_one = self.level(now) >= 1.0;
        self.level -= f64::from(u8::from(is_one));
        is_one
    }
}

/// What may pass per second, of bytes or of anything else, by whoever shares it: who takes more
/// waits. Time comes in.
#[derive(Debug)]
pub struct Allowance {
    per_second: f64,
    /// As much may pass at once as passes in this time: longer pauses are not saved up.
    burst: Duration,
    /// When all that was taken so far will have passed.
    passed_at: Mutex<Duration>,
}

impl Allowance {
    /// Nothing taken yet.
    pub fn new(per_second: f64, burst: Duration) -> Self {
        Self { per_second, burst, passed_at: Mutex::new(Duration::ZERO) }
    }

    /// Takes so much, and tells when it may pass.
    pub fn take(&self, now: Duration, amount: usize) -> Duration {
        let mut passed_at = self.passed_at.lock().unwrap_or_else(PoisonError::into_inner);
        let free_at = (*passed_at).max(now);
        *passed_at = free_at + Duration::from_secs_f64(amount as f64 / self.per_second);
        free_at.saturating_sub(self.burst)
    }

    /// When more may pass.
    pub fn next_at(&self) -> Duration {
        self.passed_at.lock().unwrap_or_else(PoisonError::into_inner).saturating_sub(self.burst)
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

    fn at(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn what_is_taken_from_an_allowance_passes_when_what_was_taken_before_has() {
        let own = Allowance::new(1e6, at(100));
        let takes = |ms, amount| own.take(at(ms), amount).as_millis();
        assert_eq!([takes(1000, 300_000), takes(1000, 300_000), takes(1000, 1)], [900, 1200, 1500]);
        assert_eq!(takes(3000, 1), 2900);
    }
}
