//! What one client may take from the others: connections and bytes per address, messages per second; and who is let in no more for a while.

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

/// What may pass per second, of bytes or of anything else, by whoever shares it: who takes more waits. Time comes in.
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

/// Counts the open connections, and those that broke a rule.
#[derive(Debug)]
pub struct Door {
    total: usize,
    per_address: usize,
    /// None: as many as can be.
    bytes_per_s: Option<f64>,
    known: Mutex<Known>,
}

#[derive(Debug, Default)]
struct Known {
    inside: usize,
    addresses: HashMap<IpAddr, Address>,
}

/// What is known of an address: who is in from there, and what was done.
#[derive(Debug)]
struct Address {
    connections: usize,
    allowance: Option<Arc<Allowance>>,
    /// Strikes that are left.
    patience: TokenBucket,
    /// Refusals that are left: beyond them nothing is said.
    refusals: TokenBucket,
}

/// So many connections of an address may break a rule at once before nobody else is let in from there. Fewer: one broken program shuts out its whole address; more: those who
/// come again and again cost a handshake each.
const STRIKES: f64 = 20.0;
/// How many of these are forgiven per second, and so how often one more is let in.
const FORGIVEN_PER_SECOND: f64 = 0.2;
/// Refusals per second and address; who comes again sooner hears nothing and waits for its own timer.
const REFUSALS_PER_SECOND: f64 = 10.0;
/// Addresses beyond which those are forgotten that have nothing to their name.
const REMEMBERED: usize = 1024;
/// Time over which an address's bytes may come at once.
const BYTES_BURST: Duration = Duration::from_millis(100);

/// Why nobody is let in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Closed {
    /// As many are inside as may be, or as many of this address.
    #[error("no room")]
    Full,
    /// Too many of this address broke a rule.
    #[error("too many connections from there broke a rule")]
    Barred,
}

/// Nobody comes in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refusal {
    /// Why.
    pub closed: Closed,
    /// Whether to say so: who asks too often is not answered.
    pub said: bool,
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
        Arc::new(Self { total, per_address, bytes_per_s, known: Mutex::default() })
    }

    /// Takes a place.
    ///
    /// # Errors
    /// There is none, or not for this address.
    pub fn enter(self: &Arc<Self>, address: IpAddr, now: Duration) -> Result<Place, Refusal> {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if known.addresses.len() >= REMEMBERED.max(2 * self.total) {
            known.addresses.retain(|_, a| a.is_worth_knowing(now));
        }
        let full = known.inside >= self.total;
        let here = known.addresses.entry(address).or_insert_with(|| Address::new(self.bytes_per_s));
        let closed = if here.patience.level(now) < 1.0 {
            Closed::Barred
        } else if full || here.connections >= self.per_address {
            Closed::Full
        } else {
            here.connections += 1;
            let allowance = here.allowance.clone();
            known.inside += 1;
            return Ok(Place { door: self.clone(), address, allowance });
        };
        Err(Refusal { closed, said: here.refusals.take(now) })
    }

    /// How many are inside.
    pub fn inside(&self) -> usize {
        self.known.lock().unwrap_or_else(PoisonError::into_inner).inside
    }
}

impl Address {
    fn new(bytes_per_s: Option<f64>) -> Self {
        Self {
            connections: 0,
            allowance: bytes_per_s.map(|b| Arc::new(Allowance::new(b, BYTES_BURST))),
            patience: TokenBucket::new(FORGIVEN_PER_SECOND, STRIKES),
            refusals: TokenBucket::new(REFUSALS_PER_SECOND, REFUSALS_PER_SECOND),
        }
    }

    fn is_worth_knowing(&mut self, now: Duration) -> bool {
        self.connections > 0 || self.patience.level(now) < STRIKES
    }
}

impl Place {
    /// Whoever had it broke a rule. Returns whether nobody else is let in from there now.
    pub fn strike(&self, now: Duration) -> bool {
        let mut known = self.door.known.lock().unwrap_or_else(PoisonError::into_inner);
        known.addresses.get_mut(&self.address).is_some_and(|here| {
            here.patience.take(now);
            here.patience.level(now) < 1.0
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut known = self.door.known.lock().unwrap_or_else(PoisonError::into_inner);
        known.inside -= 1;
        if let Some(here) = known.addresses.get_mut(&self.address) {
            here.connections -= 1;
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

    const A: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);
    const B: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(10, 0, 0, 1));

    fn at(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn enter(door: &Arc<Door>, address: IpAddr, ms: u64) -> Result<Place, Closed> {
        door.enter(address, at(ms)).map_err(|refusal| refusal.closed)
    }

    #[test]
    fn places_are_counted_and_given_back() {
        let door = Door::new(3, 2, 0.0);
        let first = enter(&door, A, 0).unwrap();
        let _second = enter(&door, A, 0).unwrap();
        assert_eq!(enter(&door, A, 0).unwrap_err(), Closed::Full, "two from one address");
        let _third = enter(&door, B, 0).unwrap();
        assert_eq!(enter(&door, B, 0).unwrap_err(), Closed::Full, "three in all");
        drop(first);
        assert!(enter(&door, B, 0).is_ok());
        assert_eq!(door.inside(), 2);
    }

    #[test]
    fn connections_of_an_address_share_its_bytes_and_a_pause_is_not_saved_up() {
        let door = Door::new(9, 9, 1e6);
        let places = [A, A, B].map(|address| enter(&door, address, 0).expect("room"));
        let limit = |place: usize| places[place].allowance.as_ref().expect("limited");
        let sent = |place: usize, ms: u64, bytes: usize| {
            limit(place).take(at(ms), bytes);
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
        assert!(enter(&Door::new(9, 9, 0.0), A, 0).expect("room").allowance.is_none());
    }

    #[test]
    fn what_is_taken_from_an_allowance_passes_when_what_was_taken_before_has() {
        let own = Allowance::new(1e6, at(100));
        let takes = |ms, amount| own.take(at(ms), amount).as_millis();
        assert_eq!([takes(1000, 300_000), takes(1000, 300_000), takes(1000, 1)], [900, 1200, 1500]);
        assert_eq!(takes(3000, 1), 2900);
    }

    #[test]
    fn an_address_whose_connections_break_rules_is_let_in_now_and_then_only() {
        let door = Door::new(99, 99, 0.0);
        let inside = enter(&door, A, 0).expect("room");
        for strike in 1..STRIKES as u64 {
            assert!(!enter(&door, A, 0).expect("patience").strike(at(0)), "after {strike}");
        }
        assert!(enter(&door, A, 0).expect("patience").strike(at(0)), "that was the last");
        assert_eq!(enter(&door, A, 4_900).unwrap_err(), Closed::Barred);
        assert!(enter(&door, B, 4_900).is_ok(), "others are not concerned");
        assert_eq!(door.inside(), 1, "whoever is in stays in");
        // One per five seconds; those who behave cost nothing.
        let behaves = enter(&door, A, 5_100).expect("one is forgiven");
        assert!(behaves.allowance.is_none() && enter(&door, A, 5_100).expect("still one").strike(at(5_100)));
        assert_eq!(enter(&door, A, 5_200).unwrap_err(), Closed::Barred);
        drop((inside, behaves));
        assert_eq!(enter(&door, A, 5_200).unwrap_err(), Closed::Barred, "that nobody is in is not forgotten for");
        let again = (0..99).filter(|_| enter(&door, A, 200_000).is_ok_and(|place| !place.strike(at(200_000)))).count();
        assert_eq!(again, STRIKES as usize - 1, "after a while all is forgiven");
    }

    #[test]
    fn who_is_refused_again_and_again_is_not_answered() {
        let door = Door::new(1, 1, 0.0);
        let _inside = enter(&door, A, 0).expect("room");
        let said = |ms| (0..50).filter(|_| door.enter(B, at(ms)).expect_err("full").said).count();
        assert_eq!([said(0), said(500)], [10, 5]);
    }

    #[test]
    fn addresses_with_nothing_to_their_name_are_forgotten() {
        let door = Door::new(9, 9, 0.0);
        let known = || door.known.lock().expect("no panic").addresses.len();
        let numbered = |n: u32| IpAddr::from(n.to_be_bytes());
        let bad = enter(&door, A, 0).expect("room");
        bad.strike(at(0));
        drop(bad);
        let _inside = enter(&door, B, 0).expect("room");
        for n in 0..3 * REMEMBERED as u32 {
            drop(enter(&door, numbered(n), 0));
            assert!(known() <= REMEMBERED);
        }
        let known = door.known.lock().expect("no panic");
        assert!(known.addresses.contains_key(&A) && known.addresses.contains_key(&B));
    }
}
