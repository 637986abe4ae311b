//! What to send next to one walker: a pure state machine, no sockets, no clock of its own.
//!
//! In: poses, and what the client says it wants, dropped or still holds. Out: one chunk after
//! another, most urgent first, and changes of mind about chunks on their way. Time comes in as
//! `now`, so that a walk replays exactly.
//!
//! The planner keeps a model of the client's cache, one state per chunk: absent, on its way, held.
//! Nothing that is held or on its way is sent again, unless the client says that it dropped it or
//! asks for it.
//!
//! The order ([`Urgency`]):
//! 1. what the client asked for;
//! 2. what the view needs;
//! 3. what sharpens the view;
//! 4. what it may need soon ([`Forecast`]), soonest first, where what is likely counts as sooner.
//!
//! Of list 4 nothing is sent while something of 1 to 3 is missing, and not before it has to be
//! ([`schedule`]): the later, the better the guess. A chunk that the client evicted is not sent
//! ahead of need again before the walker has moved: the two could work against each other for
//! ever.

mod ahead;
mod forecast;
mod motion;
mod schedule;
mod ways;

pub use forecast::{Expected, Foresight, QUICK_TURN_DEG_S};
pub use motion::Motion;
pub use schedule::Capacity;

use forecast::Forecast;
use ldi_protocol::{
    Pose,
    camera::apart_deg,
    index::Index,
    need::Needed,
    wire::{PoseDatagram, Urgency},
};
use std::{collections::BTreeMap, sync::Arc, time::Duration};

/// A walker who moved so far, metres, or turned so far, degrees, is elsewhere: chunks that were
/// evicted may be sent ahead again.
const ELSEWHERE: (f64, f64) = (0.5, 30.0);
/// The views of a pose: what `select` and the drawn cells give. A trait, so that tests can state
/// views directly.
pub trait Views: Send + Sync {
    /// What this pose needs.
    fn needed(&self, pose: &Pose) -> Needed;

    /// What of that is absent, per pose: for many poses of which most need nothing more. May name
    /// a little more, as poses that are guessed stand for those around them.
    fn lacking(&self, poses: &[Pose], absent: &dyn Fn(u32) -> bool) -> Vec<Vec<u32>> {
        let of_pose = |pose: &Pose| {
            let Needed { now, fine, .. } = self.needed(pose);
            now.into_iter().chain(fine).filter(|c| absent(*c)).collect()
        };
        poses.iter().map(of_pose).collect()
    }
}

/// What one walker may take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlannerConfig {
    /// Decoded bytes of the client's cache.
    pub cache_bytes: u64,
    /// How far from the eye needs are foreseen, metres; 0: not at all.
    pub prefetch_m: f64,
    /// Bytes that a chunk in time is worth: a chunk of so many bytes is sent ahead if it is as
    /// likely to be needed as not. Larger: fewer frames lack something; smaller: fewer bytes are
    /// sent in vain.
    pub ahead_worth: u64,
    /// Shortest time between two plans. Shorter: fresher plans, more work; a frame of the walker
    /// takes about 16 ms.
    pub replan_interval: Duration,
    /// Chunks on their way to the transport that the view does not wait for.
    pub max_background: usize,
    /// Chunks on their way to the transport in all.
    pub max_flying: usize,
}

impl Default for PlannerConfig {
    fn default() -> Self {
        Self {
            cache_bytes: 1 << 30,
            prefetch_m: 10.0,
            ahead_worth: 2_500_000,
            replan_interval: Duration::from_millis(25),
            max_background: 8,
            max_flying: 20,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ChunkState {
    Absent,
    Flying,
    Held,
}

/// A chunk to be sent now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Order {
    /// Its number.
    pub chunk: u32,
    /// Its place in the order.
    pub urgency: Urgency,
}

/// A change of mind about a chunk on its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// It matters more or less than before.
    Reprioritize(Order),
    /// No view in sight needs it any more: stop, unless it is nearly there.
    Stale(u32),
}

/// A list that is walked through once; what is held is skipped.
#[derive(Debug, Default)]
struct List {
    chunks: Vec<u32>,
    at: usize,
}

impl List {
    fn new(chunks: Vec<u32>) -> Self {
        Self { chunks, at: 0 }
    }
}

/// The plan of one walker.
pub struct Planner {
    index: Arc<Index>,
    views: Arc<dyn Views>,
    foresight: Box<dyn Foresight>,
    config: PlannerConfig,
    capacity: Capacity,
    held: Vec<ChunkState>,
    flying: BTreeMap<u32, Urgency>,
    flying_background: usize,
    /// Stored bytes of those.
    flying_bytes: u64,
    motion: Option<Motion>,
    /// The pose of the lists below is older than the newest one.
    stale_plan: bool,
    planned_at: Option<Duration>,
    /// Asked, now, fine.
    lists: [List; PRESSING],
    /// What may be needed soon, soonest first, and when that was foreseen; [`Planner::ahead`]
    /// skips what is held.
    expected: Vec<Expected>,
    foreseen_at: Option<Duration>,
    /// When the pose was planned for that this was foreseen from.
    foreseen_from: Duration,
    /// When the next one of them has to go, if nothing else happens.
    due_at: Option<Duration>,
    /// Chunks that wait in the list of what the client asked for: a number waits once, so the
    /// index bounds the list.
    asked: Vec<bool>,
    /// Asked for while on their way, to be told by [`Planner::turns`].
    promoted: Vec<u32>,
    /// Whether the lists changed since [`Planner::turns`] looked.
    changed: bool,
    /// Where the walker is, in steps of [`ELSEWHERE`]: counted up, and where it was counted.
    place: (u32, Option<Pose>),
    /// Per chunk: the place where the client dropped it.
    dropped_at: Vec<u32>,
}

/// Lists of what the view waits for.
const PRESSING: usize = 3;

impl Planner {
    /// A client that holds nothing.
    pub fn new(index: Arc<Index>, views: Arc<dyn Views>, config: PlannerConfig) -> Self {
        let foresight = Box::new(Forecast { index: index.clone(), views: views.clone() });
        Self::with_foresight(index, views, foresight, config)
    }

    /// One that foresees otherwise.
    pub fn with_foresight(
        index: Arc<Index>,
        views: Arc<dyn Views>,
        foresight: Box<dyn Foresight>,
        config: PlannerConfig,
    ) -> Self {
        let chunks = index.chunks.len();
        Self {
            index,
            views,
            foresight,
            config,
            capacity: Capacity::default(),
            held: vec![ChunkState::Absent; chunks],
            flying: BTreeMap::new(),
            flying_background: 0,
            flying_bytes: 0,
            motion: None,
            stale_plan: false,
            planned_at: None,
            lists: Default::default(),
            expected: Vec::new(),
            foreseen_at: None,
            foreseen_from: Duration::ZERO,
            due_at: None,
            asked: vec![false; chunks],
            promoted: Vec::new(),
            changed: false,
            place: (1, None),
            dropped_at: vec![0; chunks],
        }
    }

    /// A pose arrived. Older ones than the newest are ignored; returns whether this one counts.
    pub fn pose(&mut self, datagram: PoseDatagram) -> bool {
        let Some(old) = self.motion else {
            self.motion = Some(Motion::standing(datagram));
            self.stale_plan = true;
            return true;
        };
        if !datagram.is_newer_than(old.newest.sequence) {
            return false;
        }
        self.motion = Some(old.then(datagram));
        // The same pose again (a client repeats its last one in case it was lost) changes nothing.
        self.stale_plan |= old.pose() != datagram.pose;
        true
    }

    /// The same poses need something else from now on.
    pub fn views_changed(&mut self) {
        self.stale_plan = true;
        self.foreseen_at = None;
    }

    /// What the link carries and the client decodes now.
    pub fn capacity(&mut self, capacity: Capacity) {
        if self.capacity.differs(&capacity) {
            self.capacity = capacity;
            self.due_at = None;
        }
    }

    /// The newest pose.
    pub fn newest_pose(&self) -> Option<Pose> {
        self.motion.map(|m| m.pose())
    }

    /// The client asks for chunks, held or not. Returns the numbers that do not exist.
    pub fn want(&mut self, chunks: &[u32]) -> Vec<u32> {
        let mut unknown = Vec::new();
        let asked = &mut self.lists[Urgency::Asked as usize];
        asked.chunks.drain(..asked.at);
        asked.at = 0;
        for &c in chunks {
            match self.held.get_mut(c as usize) {
                None => unknown.push(c),
                Some(ChunkState::Flying) => {
                    let old = self.flying.insert(c, Urgency::Asked);
                    self.flying_background -= usize::from(old.is_some_and(|u| !u.is_pressing()));
                    if old != Some(Urgency::Asked) {
                        self.promoted.push(c);
                    }
                }
                Some(state) => {
                    *state = ChunkState::Absent;
                    if !std::mem::replace(&mut self.asked[c as usize], true) {
                        asked.chunks.push(c);
                    }
                }
            }
        }
        unknown
    }

    /// The client no longer holds these.
    pub fn dropped(&mut self, chunks: &[u32]) {
        for &c in chunks {
            if let Some(state @ ChunkState::Held) = self.held.get_mut(c as usize) {
                *state = ChunkState::Absent;
                self.dropped_at[c as usize] = self.place.0;
            }
        }
        self.stale_plan = true;
    }

    /// The client holds these from before.
    pub fn have(&mut self, chunks: &[u32]) {
        for &c in chunks {
            if let Some(state @ ChunkState::Absent) = self.held.get_mut(c as usize) {
                *state = ChunkState::Held;
            }
        }
    }

    /// All bytes of a chunk were handed to the transport.
    pub fn sent(&mut self, chunk: u32) {
        self.land(chunk, ChunkState::Held);
    }

    /// A chunk was not sent to its end.
    pub fn aborted(&mut self, chunk: u32) {
        self.land(chunk, ChunkState::Absent);
        // Its list has passed it by.
        self.stale_plan = true;
    }

    /// A chunk went out by another door (a request of its own).
    pub fn sent_elsewhere(&mut self, chunk: u32) {
        if let Some(state @ ChunkState::Absent) = self.held.get_mut(chunk as usize) {
            *state = ChunkState::Held;
        }
    }

    fn land(&mut self, chunk: u32, state: ChunkState) {
        if let Some(urgency) = self.flying.remove(&chunk) {
            self.held[chunk as usize] = state;
            self.flying_background -= usize::from(!urgency.is_pressing());
            self.flying_bytes -= self.bytes(chunk);
            self.due_at = None;
        }
    }

    fn bytes(&self, chunk: u32) -> u64 {
        u64::from(self.index.chunks[chunk as usize].stored_bytes)
    }

    fn send(&mut self, chunk: u32, urgency: Urgency) -> Order {
        self.held[chunk as usize] = ChunkState::Flying;
        self.flying.insert(chunk, urgency);
        self.flying_background += usize::from(!urgency.is_pressing());
        self.flying_bytes += self.bytes(chunk);
        Order { chunk, urgency }
    }

    /// The next chunk to send; it counts as on its way from now on. None: nothing to do until
    /// something changes or [`Planner::wake_at`].
    pub fn next(&mut self, now: Duration) -> Option<Order> {
        if self.stale_plan && self.replan_at().is_none_or(|t| now >= t) {
            self.plan_view(now);
        }
        if self.flying.len() >= self.config.max_flying {
            return None;
        }
        for (number, urgency) in Urgency::ALL.into_iter().enumerate().take(PRESSING) {
            while let Some(&chunk) = self.lists[number].chunks.get(self.lists[number].at) {
                self.lists[number].at += 1;
                if urgency == Urgency::Asked {
                    self.asked[chunk as usize] = false;
                }
                if self.held[chunk as usize] == ChunkState::Absent {
                    return Some(self.send(chunk, urgency));
                }
            }
        }
        self.ahead(now)
    }

    fn replan_at(&self) -> Option<Duration> {
        let planned_at = self.planned_at.filter(|_| self.stale_plan)?;
        Some(planned_at + self.config.replan_interval)
    }

    /// When [`Planner::next`] should be called again although nothing arrived.
    pub fn wake_at(&self) -> Option<Duration> {
        [self.replan_at(), self.due_at.filter(|t| *t < Duration::MAX)].into_iter().flatten().min()
    }

    /// Compares the chunks on their way with the current plan. Call after [`Planner::next`].
    pub fn turns(&mut self) -> Vec<Turn> {
        let mut turns: Vec<Turn> = std::mem::take(&mut self.promoted)
            .into_iter()
            .map(|chunk| Turn::Reprioritize(Order { chunk, urgency: Urgency::Asked }))
            .collect();
        if !std::mem::take(&mut self.changed) {
            return turns;
        }
        let urgency_in_plan = |chunk: u32| {
            let mut pressing = Urgency::ALL.into_iter().zip(&self.lists);
            let found = pressing.find(|(_, l)| l.chunks.contains(&chunk)).map(|(u, _)| u);
            found.or_else(|| self.expected.iter().find(|e| e.chunk == chunk).map(|e| e.urgency))
        };
        for (&chunk, &urgency) in &self.flying {
            match urgency_in_plan(chunk) {
                // What was asked for stays asked for, until it is there.
                _ if urgency == Urgency::Asked => {}
                Some(new) if new != urgency => turns.push(Turn::Reprioritize(Order { chunk, urgency: new })),
                Some(_) => {}
                None => turns.push(Turn::Stale(chunk)),
            }
        }
        for t in &turns {
            if let Turn::Reprioritize(order) = t {
                let old = self.flying.insert(order.chunk, order.urgency);
                self.flying_background -= usize::from(old.is_some_and(|u| !u.is_pressing()));
                self.flying_background += usize::from(!order.urgency.is_pressing());
            }
        }
        turns
    }

    /// Chunks on their way.
    pub fn flying(&self) -> usize {
        self.flying.len()
    }

    /// Chunks that the client is believed to hold.
    pub fn held_chunks(&self) -> usize {
        self.held.iter().filter(|h| **h == ChunkState::Held).count()
    }

    fn plan_view(&mut self, now: Duration) {
        let Some(motion) = self.motion else { return };
        let pose = motion.pose();
        let needed = self.views.needed(&pose);
        self.lists[Urgency::Now as usize] = List::new([needed.base, needed.now].concat());
        self.lists[Urgency::Fine as usize] = List::new(needed.fine);
        // The old expectations stay until the next ones are made: what flies for them is not stale
        // yet.
        self.stale_plan = false;
        self.changed = true;
        self.planned_at = Some(now);
        self.due_at = None;
        let (count, counted_at) = &mut self.place;
        let elsewhere = |at: &Pose| {
            at.position.distance(pose.position) >= ELSEWHERE.0
                || apart_deg(at.yaw_deg, pose.yaw_deg).abs() >= ELSEWHERE.1
        };
        if counted_at.as_ref().is_none_or(elsewhere) {
            *count += 1;
            *counted_at = Some(pose);
        }
    }

    /// What must hold after every step: flying states and the table of flying chunks agree, and so
    /// do the counts.
    pub fn check(&self) -> Result<(), String> {
        let states = self.held.iter().filter(|h| **h == ChunkState::Flying).count();
        if states != self.flying.len() {
            return Err(format!("{states} states are flying, {} chunks are", self.flying.len()));
        }
        let background = self.flying.values().filter(|u| !u.is_pressing()).count();
        if background != self.flying_background {
            return Err(format!("{background} in the background, counted {}", self.flying_background));
        }
        let bytes: u64 = self.flying.keys().map(|c| self.bytes(*c)).sum();
        if bytes != self.flying_bytes {
            return Err(format!("{bytes} bytes on their way, counted {}", self.flying_bytes));
        }
        if self.flying.len() > self.config.max_flying {
            return Err(format!("{} on their way, at most {}", self.flying.len(), self.config.max_flying));
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "planner/planner_test.rs"]
mod tests;
