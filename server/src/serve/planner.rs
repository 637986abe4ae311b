//! What to send next to one walker: a pure state machine, no sockets, no clock of its own.
//!
//! In: poses, and what the client says it wants, dropped or still holds. Out: one chunk after another, most urgent first,
//! and changes of mind about chunks on their way. Time comes in as `now`, so that a walk replays exactly.
//!
//! The planner keeps a model of the client's cache, one state per chunk: absent, on its way, held. Nothing that is held
//! or on its way is sent again, unless the client says that it dropped it or asks for it.
//!
//! The order ([`Urgency`]) follows Aliaga and Lastra 1999, section 6, with two rings in between:
//! 1. what the client asked for;
//! 2. what the view needs;
//! 3. what sharpens the view;
//! 4. what the predicted views need: the last two poses carried on for [`HORIZONS_S`];
//! 5. what is around: first a turn on the spot in steps of [`TURN_STEP_DEG`], nearest direction first (a head turns faster than
//!    feet walk, and a turn needs cells that no distance would bring), then near to far.
//!
//! Lists 4 and 5 are made only when everything before is on its way, 5 only when the walker has moved: a chunk that the client
//! evicted is not pushed again for standing still, so that the two cannot work against each other for ever.

mod ahead;

pub use ahead::{HORIZONS_S, TURN_STEP_DEG};

use glam::DVec3;
use ldi_protocol::{
    Pose,
    index::Index,
    need::Needed,
    wire::{PoseDatagram, Urgency},
};
use std::{collections::BTreeMap, sync::Arc, time::Duration};

/// Largest believable speed, m/s; a faster one is a jump and predicts nothing.
const MAX_SPEED_M_S: f64 = 15.0;
/// Largest believable turn, degrees per second.
const MAX_TURN_DEG_S: f64 = 400.0;
/// The views of a pose: what `select` and the drawn cells give. A trait, so that tests can state views directly.
pub trait Views: Send + Sync {
    /// What this pose needs.
    fn needed(&self, pose: &Pose) -> Needed;
}

/// What one walker may take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlannerConfig {
    /// Decoded bytes of the client's cache.
    pub cache_bytes: u64,
    /// Radius of the near-to-far ring, metres.
    pub prefetch_m: f64,
    /// Shortest time between two plans. Shorter: fresher plans, more work; a frame of the walker takes about 16 ms.
    pub replan_interval: Duration,
    /// Chunks on their way that the view does not wait for.
    pub max_background: usize,
    /// Chunks on their way in all.
    pub max_flying: usize,
}

impl Default for PlannerConfig {
    fn default() -> Self {
        Self {
            cache_bytes: 1 << 30,
            prefetch_m: 10.0,
            replan_interval: Duration::from_millis(25),
            max_background: 4,
            max_flying: 12,
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

#[derive(Debug, Clone, Copy)]
struct Motion {
    newest: PoseDatagram,
    velocity_m_s: DVec3,
    turn_deg_s: f64,
}

/// The plan of one walker.
pub struct Planner {
    index: Arc<Index>,
    views: Arc<dyn Views>,
    config: PlannerConfig,
    held: Vec<ChunkState>,
    flying: BTreeMap<u32, Urgency>,
    flying_background: usize,
    motion: Option<Motion>,
    /// The pose of the lists below is older than the newest one.
    stale_plan: bool,
    planned_at: Option<Duration>,
    lists: [List; Urgency::ALL.len()],
    /// Chunks that wait in the list of what the client asked for: a number waits once, so the index bounds the list.
    asked: Vec<bool>,
    /// Asked for while on their way, to be told by [`Planner::turns`].
    promoted: Vec<u32>,
    /// Whether the predicted list belongs to the current plan.
    predicted: bool,
    /// Whether the lists changed since [`Planner::turns`] looked.
    changed: bool,
    /// Where the around list was made.
    around_at: Option<DVec3>,
}

impl Planner {
    /// A client that holds nothing.
    pub fn new(index: Arc<Index>, views: Arc<dyn Views>, config: PlannerConfig) -> Self {
        let held = vec![ChunkState::Absent; index.chunks.len()];
        Self {
            asked: vec![false; index.chunks.len()],
            index,
            views,
            config,
            held,
            flying: BTreeMap::new(),
            flying_background: 0,
            motion: None,
            stale_plan: false,
            planned_at: None,
            lists: Default::default(),
            promoted: Vec::new(),
            predicted: true,
            changed: false,
            around_at: None,
        }
    }

    /// A pose arrived. Older ones than the newest are ignored; returns whether this one counts.
    pub fn pose(&mut self, datagram: PoseDatagram) -> bool {
        let Some(old) = self.motion else {
            self.motion = Some(Motion { newest: datagram, velocity_m_s: DVec3::ZERO, turn_deg_s: 0.0 });
            self.stale_plan = true;
            return true;
        };
        if !datagram.is_newer_than(old.newest.sequence) {
            return false;
        }
        let dt = datagram.sent_us.saturating_sub(old.newest.sent_us) as f64 * 1e-6;
        let (a, b) = (old.newest.pose, datagram.pose);
        let moved = (b.position - a.position) / dt.max(1e-3);
        let turned = ((b.yaw_deg - a.yaw_deg + 180.0).rem_euclid(360.0) - 180.0) / dt.max(1e-3);
        let jump = dt <= 0.0 || moved.length() > MAX_SPEED_M_S || turned.abs() > MAX_TURN_DEG_S;
        self.motion = Some(Motion {
            newest: datagram,
            velocity_m_s: if jump { DVec3::ZERO } else { moved },
            turn_deg_s: if jump { 0.0 } else { turned },
        });
        // The same pose again (a client repeats its last one in case it was lost) changes nothing.
        self.stale_plan |= a != b;
        true
    }

    /// The newest pose.
    pub fn newest_pose(&self) -> Option<Pose> {
        self.motion.map(|m| m.newest.pose)
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
        }
    }

    /// The next chunk to send; it counts as on its way from now on. None: nothing to do until something changes or
    /// [`Planner::wake_at`].
    pub fn next(&mut self, now: Duration) -> Option<Order> {
        self.replan(now);
        if self.flying.len() >= self.config.max_flying {
            return None;
        }
        for urgency in Urgency::ALL {
            if !urgency.is_pressing() && self.flying_background >= self.config.max_background {
                return None;
            }
            match urgency {
                Urgency::Predicted if !self.predicted => self.plan_predicted(),
                Urgency::Around => self.plan_around(),
                _ => {}
            }
            let list = &mut self.lists[urgency as usize];
            while let Some(&chunk) = list.chunks.get(list.at) {
                list.at += 1;
                if urgency == Urgency::Asked {
                    self.asked[chunk as usize] = false;
                }
                if self.held[chunk as usize] == ChunkState::Absent {
                    self.held[chunk as usize] = ChunkState::Flying;
                    self.flying.insert(chunk, urgency);
                    self.flying_background += usize::from(!urgency.is_pressing());
                    return Some(Order { chunk, urgency });
                }
            }
        }
        None
    }

    /// Makes a new plan when the walker moved and the last plan is old enough.
    fn replan(&mut self, now: Duration) {
        if self.stale_plan && self.wake_at().is_none_or(|t| now >= t) {
            self.plan_view(now);
        }
    }

    /// When [`Planner::next`] should be called again although nothing arrived.
    pub fn wake_at(&self) -> Option<Duration> {
        let planned_at = self.planned_at.filter(|_| self.stale_plan)?;
        Some(planned_at + self.config.replan_interval)
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
        let urgency_in_plan =
            |chunk: u32| Urgency::ALL.into_iter().find(|u| self.lists[*u as usize].chunks.contains(&chunk));
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
        let needed = self.views.needed(&motion.newest.pose);
        self.lists[Urgency::Now as usize] = List::new([needed.base, needed.now].concat());
        self.lists[Urgency::Fine as usize] = List::new(needed.fine);
        // The old predicted list stays until the next one is made: what flies for it is not stale yet.
        self.predicted = false;
        self.stale_plan = false;
        self.changed = true;
        self.planned_at = Some(now);
    }

    /// What must hold after every step: flying states and the table of flying chunks agree, and so do the counts.
    pub fn check(&self) -> Result<(), String> {
        let states = self.held.iter().filter(|h| **h == ChunkState::Flying).count();
        if states != self.flying.len() {
            return Err(format!("{states} states are flying, {} chunks are", self.flying.len()));
        }
        let background = self.flying.values().filter(|u| !u.is_pressing()).count();
        if background != self.flying_background {
            return Err(format!("{background} in the background, counted {}", self.flying_background));
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
