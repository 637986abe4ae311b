//! Admission: which connections are let in, and how many of them from one peer.
//!
//! A connection passes three stages. Each has limits of its own, so that whoever has proven less
//! takes nothing from whoever has proven more:
//!
//! 1. **unproven**: the address may be forged. [`UNPROVEN`] such handshakes run at a time;
//!    everybody else is asked to prove the address first (QUIC's Retry), for which no state is
//!    kept.
//! 2. **candidate**: the address is proven, version and token are not. Candidates have a share of
//!    their own, and a short life; the oldest gives way to a newcomer.
//! 3. **walker**: the first message was right. Walkers alone count against `max_connections` and
//!    `max_connections_per_address`, and only a walker who breaks rules has its peer shut out.
//!
//! Time comes in.

use super::limits::{Allowance, TokenBucket};
use std::{
    collections::HashMap,
    net::{IpAddr, Ipv6Addr},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore};

/// Handshakes at a time whose address is unproven. Larger: a flood of forged addresses costs more
/// signatures; smaller: clients pay a round trip more when several come at once.
const UNPROVEN: usize = 32;
/// A peer's share of candidates, as a fraction of its walkers; [`MIN_OF_PEER`] at least.
const CANDIDATES_PER_WALKER: f64 = 0.25;
/// Least share of one peer. Smaller: a class that comes at once waits for a second.
const MIN_OF_PEER: usize = 16;
/// Least share of all peers together.
const MIN_CANDIDATES: usize = 64;
/// A candidate younger than this gives way to nobody. Longer: connections that prove nothing keep
/// newcomers out for longer; shorter: handshakes over slow links are cut.
const SAFE: Duration = Duration::from_secs(1);
/// Candidates of one peer per second that may fail, by a wrong token or no first message.
/// Larger: guesses cost more handshakes; smaller: newcomers of the same peer wait behind them.
const FAILURES_PER_SECOND: f64 = 50.0;
/// Candidates of one peer that may fail at once.
const FAILURES: f64 = 100.0;
/// Walkers of one peer that may break a rule at once before nobody else is let in from there.
/// Fewer: one broken program shuts out its whole address; more: floods come again more often.
const STRIKES: f64 = 20.0;
/// How many of these are forgiven per second, and so how often one more is let in.
const FORGIVEN_PER_SECOND: f64 = 0.2;
/// Refusals per second and peer; those beyond are not sent.
const REFUSALS_PER_SECOND: f64 = 10.0;
/// Peers beyond which those are forgotten of whom there is nothing to remember.
const REMEMBERED: usize = 1024;
/// Time over which a peer's bytes may come at once.
const BYTES_BURST: Duration = Duration::from_millis(100);

/// Whose limits a connection counts against: an IPv4 address, or the /64 network of an IPv6
/// address, as every subscriber has all addresses of one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Peer(IpAddr);

impl From<IpAddr> for Peer {
    fn from(address: IpAddr) -> Self {
        Self(match address.to_canonical() {
            IpAddr::V6(v6) => Ipv6Addr::from_bits(v6.to_bits() & !u128::from(u64::MAX)).into(),
            v4 => v4,
        })
    }
}

/// Why nobody is let in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Closed {
    /// There are as many walkers as may be, in all or of this peer.
    #[error("no room")]
    Full,
    /// Too many walkers of this peer broke a rule.
    #[error("too many connections from there broke a rule")]
    Barred,
    /// As many candidates of this peer wait, or failed just now, as may.
    #[error("too many connections from there that show no token or send no first message")]
    Crowded,
}

/// The answer to a connection that is not let in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refusal {
    /// Why.
    pub closed: Closed,
    /// Whether to send it. A client that hears nothing asks again after its own timer.
    pub said: bool,
}

/// Counts connections by stage and peer.
#[derive(Debug)]
pub struct Admission {
    walkers: usize,
    walkers_of_peer: usize,
    /// None: no limit.
    bytes_per_s: Option<f64>,
    unproven: Arc<Semaphore>,
    known: Mutex<Known>,
}

#[derive(Debug, Default)]
struct Known {
    walkers: usize,
    /// Oldest first.
    candidates: Vec<Waiting>,
    next: u64,
    peers: HashMap<Peer, Record>,
}

/// A candidate in the list.
#[derive(Debug)]
struct Waiting {
    number: u64,
    peer: Peer,
    since: Duration,
    displaced: Arc<Notify>,
}

/// What is known of a peer.
#[derive(Debug)]
struct Record {
    walkers: usize,
    candidates: usize,
    allowance: Option<Arc<Allowance>>,
    /// Strikes that are left.
    patience: TokenBucket,
    /// Failures of candidates that are left.
    failures: TokenBucket,
    /// Refusals that are left.
    refusals: TokenBucket,
}

/// A connection at a proven address that has not been admitted yet.
#[derive(Debug)]
pub struct Candidate {
    admission: Arc<Admission>,
    number: u64,
    peer: Peer,
    displaced: Arc<Notify>,
}

/// An admitted walker's place; given back when dropped.
#[derive(Debug)]
pub struct Place {
    admission: Arc<Admission>,
    peer: Peer,
    /// Shared by all walkers of the peer; None: no limit.
    pub allowance: Option<Arc<Allowance>>,
}

impl Admission {
    /// Room for so many walkers in all and of one peer, which share `bytes_per_s` (0: no limit).
    pub fn new(walkers: usize, walkers_of_peer: usize, bytes_per_s: f64) -> Arc<Self> {
        let bytes_per_s = (bytes_per_s > 0.0).then_some(bytes_per_s);
        let unproven = Arc::new(Semaphore::new(UNPROVEN));
        Arc::new(Self { walkers, walkers_of_peer, bytes_per_s, unproven, known: Mutex::default() })
    }

    /// A permit for a handshake with an address that is unproven. None: ask for a proof first, as
    /// many run, or the server or this peer's share is getting full.
    pub fn unproven(&self, peer: Peer, now: Duration) -> Option<OwnedSemaphorePermit> {
        let mut known = self.known();
        let few = 4 * known.candidates.len() <= self.candidates() && 2 * known.walkers <= self.walkers;
        let clean = known.peers.get_mut(&peer).is_none_or(|record| {
            record.patience.level(now) >= STRIKES
                && record.failures.level(now) >= FAILURES
                && 4 * record.candidates <= self.candidates_of_peer()
                && 2 * record.walkers <= self.walkers_of_peer
        });
        (few && clean).then(|| self.unproven.clone().try_acquire_owned().ok()).flatten()
    }

    /// Lists a connection whose address is proven as a candidate, in place of an older one if the
    /// share is taken.
    ///
    /// # Errors
    /// Nobody is let in, or not from this peer.
    pub fn candidate(self: &Arc<Self>, peer: Peer, now: Duration) -> Result<Candidate, Refusal> {
        let mut known = self.known();
        if known.peers.len() >= REMEMBERED.max(2 * self.walkers) {
            known.peers.retain(|_, r| r.is_worth_knowing(now));
        }
        let full = known.walkers >= self.walkers;
        let record = known.peers.entry(peer).or_insert_with(|| Record::new(self.bytes_per_s));
        let refused = |record: &mut Record, closed| Err(Refusal { closed, said: record.refusals.take(now) });
        if record.patience.level(now) < 1.0 {
            return refused(record, Closed::Barred);
        }
        if full || record.walkers >= self.walkers_of_peer {
            return refused(record, Closed::Full);
        }
        // Not said: a client that hears nothing asks again, and a refused one gives up.
        let crowded = Err(Refusal { closed: Closed::Crowded, said: false });
        if record.failures.level(now) < 1.0 {
            return crowded;
        }
        if let Some(crowd) = self.full_share(&known, peer) {
            let oldest = known.candidates.iter().position(|w| w.peer == crowd);
            match oldest.filter(|at| known.candidates[*at].since + SAFE <= now) {
                Some(at) => known.remove(at).displaced.notify_one(),
                None => return crowded,
            }
        }
        let number = known.next;
        let displaced = Arc::new(Notify::new());
        known.next += 1;
        known.candidates.push(Waiting { number, peer, since: now, displaced: displaced.clone() });
        known.record(peer, |r| r.candidates += 1);
        Ok(Candidate { admission: self.clone(), number, peer, displaced })
    }

    /// How many walkers are inside.
    #[cfg(test)]
    pub fn inside(&self) -> usize {
        self.known().walkers
    }

    /// The peer of which a candidate has to give way to one more of `peer`.
    fn full_share(&self, known: &Known, peer: Peer) -> Option<Peer> {
        if known.peers.get(&peer).is_some_and(|r| r.candidates >= self.candidates_of_peer()) {
            return Some(peer);
        }
        let largest = || known.peers.iter().max_by_key(|(_, r)| r.candidates).map(|(peer, _)| *peer);
        (known.candidates.len() >= self.candidates()).then(largest).flatten()
    }

    fn candidates(&self) -> usize {
        ((self.walkers as f64 * CANDIDATES_PER_WALKER) as usize).max(MIN_CANDIDATES)
    }

    fn candidates_of_peer(&self) -> usize {
        ((self.walkers_of_peer as f64 * CANDIDATES_PER_WALKER) as usize).max(MIN_OF_PEER)
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        // Every change is complete before anything can panic.
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Known {
    fn remove(&mut self, at: usize) -> Waiting {
        let waiting = self.candidates.remove(at);
        self.record(waiting.peer, |r| r.candidates -= 1);
        waiting
    }

    fn record(&mut self, peer: Peer, change: impl FnOnce(&mut Record)) {
        if let Some(record) = self.peers.get_mut(&peer) {
            change(record);
        }
    }
}

impl Record {
    fn new(bytes_per_s: Option<f64>) -> Self {
        Self {
            walkers: 0,
            candidates: 0,
            allowance: bytes_per_s.map(|b| Arc::new(Allowance::new(b, BYTES_BURST))),
            patience: TokenBucket::new(FORGIVEN_PER_SECOND, STRIKES),
            failures: TokenBucket::new(FAILURES_PER_SECOND, FAILURES),
            refusals: TokenBucket::new(REFUSALS_PER_SECOND, REFUSALS_PER_SECOND),
        }
    }

    fn is_worth_knowing(&mut self, now: Duration) -> bool {
        self.walkers > 0
            || self.candidates > 0
            || self.patience.level(now) < STRIKES
            || self.failures.level(now) < FAILURES
    }
}

impl Candidate {
    /// Completes when a newcomer takes the place.
    pub async fn displaced(&self) {
        self.displaced.notified().await;
    }

    /// The first message was wrong, or none came.
    pub fn failed(&self, now: Duration) {
        self.admission.known().record(self.peer, |record| {
            record.failures.take(now);
        });
    }

    /// The first message was right: the candidate becomes a walker.
    ///
    /// # Errors
    /// Others were faster, and there is no room.
    pub fn admit(self, now: Duration) -> Result<Place, Closed> {
        let admission = self.admission.clone();
        let mut known = admission.known();
        let full = known.walkers >= admission.walkers;
        // A candidate's record is kept, so there is one.
        let record = known.peers.entry(self.peer).or_insert_with(|| Record::new(admission.bytes_per_s));
        if record.patience.level(now) < 1.0 {
            return Err(Closed::Barred);
        }
        if full || record.walkers >= admission.walkers_of_peer {
            return Err(Closed::Full);
        }
        record.walkers += 1;
        let allowance = record.allowance.clone();
        known.walkers += 1;
        drop(known);
        Ok(Place { admission, peer: self.peer, allowance })
    }
}

impl Drop for Candidate {
    fn drop(&mut self) {
        let mut known = self.admission.known();
        if let Some(at) = known.candidates.iter().position(|w| w.number == self.number) {
            known.remove(at);
        }
    }
}

impl Place {
    /// The walker broke a rule. Returns whether nobody else is let in from there now.
    pub fn strike(&self, now: Duration) -> bool {
        let mut barred = false;
        self.admission.known().record(self.peer, |record| {
            record.patience.take(now);
            barred = record.patience.level(now) < 1.0;
        });
        barred
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut known = self.admission.known();
        known.walkers -= 1;
        known.record(self.peer, |r| r.walkers -= 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peer(address: &str) -> Peer {
        address.parse::<IpAddr>().expect("an address").into()
    }

    fn at(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn a() -> Peer {
        peer("127.0.0.1")
    }

    fn b() -> Peer {
        peer("10.0.0.1")
    }

    fn enter(admission: &Arc<Admission>, peer: Peer, ms: u64) -> Result<Place, Closed> {
        admission.candidate(peer, at(ms)).map_err(|refusal| refusal.closed)?.admit(at(ms))
    }

    #[test]
    fn limits_are_per_ipv4_address_and_per_ipv6_network() {
        assert_eq!(peer("2001:db8:1:2::1"), peer("2001:db8:1:2:ffff:ffff:ffff:ffff"));
        assert_ne!(peer("2001:db8:1:2::1"), peer("2001:db8:1:3::1"));
        assert_eq!(peer("::ffff:10.0.0.1"), peer("10.0.0.1"));
        assert_ne!(peer("10.0.0.1"), peer("10.0.0.2"));
        assert_ne!(peer("::ffff:10.0.0.1"), peer("::ffff:10.0.0.2"));
    }

    #[test]
    fn places_are_counted_and_given_back() {
        let admission = Admission::new(3, 2, 0.0);
        let first = enter(&admission, a(), 0).unwrap();
        let _second = enter(&admission, a(), 0).unwrap();
        assert_eq!(enter(&admission, a(), 0).unwrap_err(), Closed::Full, "two of one peer");
        let _third = enter(&admission, b(), 0).unwrap();
        assert_eq!(enter(&admission, b(), 0).unwrap_err(), Closed::Full, "three in all");
        drop(first);
        assert!(enter(&admission, b(), 0).is_ok());
        assert_eq!(admission.inside(), 2);
    }

    #[test]
    fn a_candidate_that_comes_late_finds_no_room() {
        let admission = Admission::new(9, 1, 0.0);
        let late = admission.candidate(a(), at(0)).unwrap();
        let _inside = enter(&admission, a(), 0).unwrap();
        assert_eq!(late.admit(at(0)).unwrap_err(), Closed::Full);
    }

    #[test]
    fn the_oldest_candidate_of_a_peer_gives_way_once_it_is_not_young() {
        let admission = Admission::new(400, 8, 0.0);
        let silent: Vec<Candidate> =
            (0..MIN_OF_PEER as u64).map(|i| admission.candidate(a(), at(i)).unwrap()).collect();
        let newcomer = |ms| admission.candidate(a(), at(ms));
        assert_eq!(newcomer(999).unwrap_err(), Refusal { closed: Closed::Crowded, said: false });
        let others = admission.candidate(b(), at(999)).unwrap();
        let place = newcomer(1_000).unwrap().admit(at(1_000)).expect("walkers' places are free");
        let is_displaced = |c: &Candidate| admission.known().candidates.iter().all(|w| w.number != c.number);
        assert_eq!(silent.iter().filter(|c| is_displaced(c)).count(), 1);
        assert!(is_displaced(&silent[0]) && !is_displaced(&others));
        let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime");
        runtime.block_on(silent[0].displaced());
        drop((place, silent, others));
        let known = admission.known();
        assert!(known.candidates.is_empty() && known.peers.values().all(|r| r.candidates == 0));
    }

    #[test]
    fn where_all_peers_together_are_too_many_the_largest_gives_way() {
        let admission = Admission::new(8, 400, 0.0);
        let crowd: Vec<Candidate> =
            (0..MIN_CANDIDATES as u64).map(|_| admission.candidate(a(), at(0)).unwrap()).collect();
        assert_eq!(admission.candidate(b(), at(500)).unwrap_err().closed, Closed::Crowded);
        let _other = admission.candidate(b(), at(2_000)).unwrap();
        assert_eq!(admission.known().peers[&a()].candidates, crowd.len() - 1);
    }

    #[test]
    fn candidates_that_fail_are_slowed_and_shut_out_nobody() {
        let admission = Admission::new(99, 99, 0.0);
        let fail = |ms| admission.candidate(a(), at(ms)).map(|c| c.failed(at(ms)));
        assert_eq!((0..1000).filter(|_| fail(0).is_ok()).count(), FAILURES as usize);
        assert!(enter(&admission, b(), 0).is_ok(), "others are not concerned");
        assert!(enter(&admission, a(), 125).is_ok(), "an eighth of a second later there is room");
        assert_eq!((0..1000).filter(|_| fail(1_000).is_ok()).count(), FAILURES_PER_SECOND as usize);
    }

    #[test]
    fn only_few_handshakes_are_unproven_and_none_where_it_gets_full() {
        let admission = Admission::new(400, 8, 0.0);
        let permits: Vec<_> = (0..100).filter_map(|_| admission.unproven(a(), at(0))).collect();
        assert_eq!(permits.len(), UNPROVEN);
        assert!(admission.known().peers.is_empty(), "an unproven address leaves nothing");
        drop(permits);
        let waiting: Vec<_> = (0..5).map(|_| admission.candidate(a(), at(0)).unwrap()).collect();
        assert!(admission.unproven(a(), at(0)).is_none() && admission.unproven(b(), at(0)).is_some());
        drop(waiting);
        admission.candidate(a(), at(0)).unwrap().failed(at(0));
        assert!(admission.unproven(a(), at(0)).is_none() && admission.unproven(b(), at(0)).is_some());
    }

    #[test]
    fn walkers_of_a_peer_share_its_bytes_and_a_pause_is_not_saved_up() {
        let admission = Admission::new(9, 9, 1e6);
        let places = [a(), a(), b()].map(|peer| enter(&admission, peer, 0).expect("room"));
        let limit = |place: usize| places[place].allowance.as_ref().expect("limited");
        let sent = |place: usize, ms: u64, bytes: usize| {
            limit(place).take(at(ms), bytes);
            limit(place).next_at().as_millis()
        };
        // A hundred milliseconds' worth goes at once, by either connection; then a kilobyte per
        // millisecond.
        let all = [sent(0, 1000, 60_000), sent(1, 1000, 40_000), sent(0, 1000, 50_000)];
        assert_eq!(all, [960, 1000, 1050]);
        let next = (limit(1).next_at().as_millis(), limit(2).next_at().as_millis());
        assert_eq!(next, (1050, 0), "another peer has its own");
        assert_eq!([sent(0, 9000, 100_000), sent(1, 9000, 1_000)], [9000, 9001]);
        assert!(enter(&Admission::new(9, 9, 0.0), a(), 0).expect("room").allowance.is_none());
    }

    #[test]
    fn a_peer_whose_walkers_break_rules_is_let_in_now_and_then_only() {
        let admission = Admission::new(99, 99, 0.0);
        let inside = enter(&admission, a(), 0).expect("room");
        for strike in 1..STRIKES as u64 {
            assert!(!enter(&admission, a(), 0).expect("patience").strike(at(0)), "after {strike}");
        }
        assert!(enter(&admission, a(), 0).expect("patience").strike(at(0)), "that was the last");
        assert_eq!(enter(&admission, a(), 4_900).unwrap_err(), Closed::Barred);
        assert!(enter(&admission, b(), 4_900).is_ok(), "others are not concerned");
        assert_eq!(admission.inside(), 1, "whoever is in stays in");
        drop(inside);
        // One per five seconds; those who behave cost nothing.
        let behaves = enter(&admission, a(), 5_100).expect("one is forgiven");
        assert!(behaves.allowance.is_none());
        assert!(enter(&admission, a(), 5_100).expect("still one").strike(at(5_100)));
        assert_eq!(enter(&admission, a(), 5_200).unwrap_err(), Closed::Barred);
        drop(behaves);
        assert_eq!(enter(&admission, a(), 5_200).unwrap_err(), Closed::Barred, "remembered");
        let late = |_: &u64| enter(&admission, a(), 200_000).is_ok_and(|place| !place.strike(at(200_000)));
        assert_eq!((0..99).filter(late).count(), STRIKES as usize - 1, "after a while all is forgiven");
    }

    #[test]
    fn who_is_refused_again_and_again_is_not_answered() {
        let admission = Admission::new(1, 1, 0.0);
        let _inside = enter(&admission, a(), 0).expect("room");
        let said = |ms| (0..50).filter(|_| admission.candidate(b(), at(ms)).expect_err("full").said).count();
        assert_eq!([said(0), said(500)], [10, 5]);
    }

    #[test]
    fn peers_of_whom_there_is_nothing_to_remember_are_forgotten() {
        let admission = Admission::new(9, 9, 0.0);
        let numbered = |n: u32| Peer::from(IpAddr::from(n.to_be_bytes()));
        enter(&admission, a(), 0).expect("room").strike(at(0));
        let _inside = enter(&admission, b(), 0).expect("room");
        for n in 0..3 * REMEMBERED as u32 {
            drop(enter(&admission, numbered(n), 0));
            assert!(admission.known().peers.len() <= REMEMBERED);
        }
        let known = admission.known();
        assert!(known.peers.contains_key(&a()) && known.peers.contains_key(&b()));
    }
}
