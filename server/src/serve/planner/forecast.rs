//! What a walker may need soon: guesses of poses, each with a time and a probability, and the
//! chunks of their views.
//!
//! In: a [`Motion`]. Out: chunks with the time in which they are needed and how likely that is
//! ([`Expected`]).
//!
//! Three kinds of guesses, after how people walk:
//! - **on**: it goes on as it goes, velocity and turn rate kept, less likely the farther ahead:
//!   people stop, and paths bend;
//! - **turn**: it turns on the spot at [`QUICK_TURN_DEG_S`] to either side, from now on. A head
//!   turns faster than feet walk, and needs no run-up. Geometry around it is expected at once,
//!   whichever way it looks: heads turn faster still, and it takes next to no bytes where images
//!   show what is far. That goes for the few degrees, too, in which so little is in view that all
//!   of it is drawn;
//! - **off**: from where it stands or turns it walks off, straight ahead of where it looks then.
//!
//! In a dataset with rooms there are two things more, both by the way on foot ([`ways`]):
//! - guesses of places that no straight way through doors leads to are left out: nobody walks
//!   through walls;
//! - **doors**: it goes through one of the doors that can be reached, and looks into what lies
//!   beyond.
//!
//! Where it will be is uncertain by [`SPREAD`] of the way: guesses to both sides of the way carry
//! part of its probability. A chunk counts at the earliest guess that needs it; probabilities of
//! guesses that need it too are not added up, as the guesses are not exclusive.

use super::motion::Motion;
use super::{Views, ways};
use ldi_protocol::{
    Pose,
    index::{ChunkKind, Index},
    rooms::Rooms,
    select::yaws_of_placements,
    wire::Urgency,
};
use std::{collections::HashMap, sync::Arc};

/// How fast a head is believed to turn to look elsewhere, degrees per second. Path walkers of this
/// project turn at 120, players faster, but few begin right now: faster beliefs send more
/// directions ahead (docs/adr/0032-forecasts.md).
pub const QUICK_TURN_DEG_S: f64 = 80.0;
/// Walking speed of somebody who stands and will walk, m/s.
const WALK_M_S: f64 = 1.4;
/// Mean time for which a motion goes on, seconds: walking, and turning. These and the numbers
/// below were chosen by walks in virtual time on two scenes (docs/benchmarks/streaming.md), not
/// measured on people. Larger: what lies far along the way is sent ahead more; smaller: less, and
/// later.
const KEEPS_WALKING_S: f64 = 1.0;
/// See [`KEEPS_WALKING_S`].
const KEEPS_TURNING_S: f64 = 2.0;
/// How likely a turn is to begin while the eye goes on, to one of both sides.
const TURNS: f64 = 0.5;
/// How likely the walker sets off before it stops turning.
const SETS_OFF: f64 = 0.5;
/// Sideways uncertainty of a place ahead, as a share of the way to it: it grows with time.
const SPREAD: f64 = 0.4;
/// Probability of a place beside the way, relative to one on it.
const BESIDE: f64 = 0.4;
/// Probability of the door straight ahead; of one behind the walker it is 0. Of those that look
/// alike, the nearer one is likelier ([`KEEPS_TO_DOOR_S`]).
const DOORS: f64 = 0.5;
/// Mean time for which somebody keeps going to a door, seconds.
const KEEPS_TO_DOOR_S: f64 = 3.0;
/// Step of guesses in angle, degrees: below half the smallest field of view (54), so that no
/// direction in between is left out.
const STEP_DEG: f64 = 12.0;
/// The same in such steps where only geometry is looked for, to spare work: 36 degrees.
const GEOMETRY_STEP: i32 = 3;
/// Times of guesses ahead, seconds.
const TIMES_S: [f64; 10] = [0.08, 0.16, 0.3, 0.45, 0.65, 0.9, 1.25, 1.75, 2.5, 3.5];

/// A chunk that may be needed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Its number.
    pub chunk: u32,
    /// Seconds from the newest pose until a view needs it, if one does.
    pub in_s: f64,
    /// How likely one does, 0 to 1.
    pub probability: f64,
    /// [`Urgency::Predicted`] on the way that the walker goes, else [`Urgency::Around`].
    pub urgency: Urgency,
}

/// Foresees what a walker needs. A trait, so that simulations can put hindsight in its place.
pub trait Foresight: Send {
    /// Chunks that may be needed within `within_s` seconds after the newest pose, at places at
    /// most `reach_m` away; each once, in any order. Only those that are `absent` matter.
    fn expect(&mut self, motion: &Motion, within_s: f64, reach_m: f64, absent: &dyn Fn(u32) -> bool) -> Vec<Expected>;
}

/// The foresight of a real server.
pub(super) struct Forecast {
    pub index: Arc<Index>,
    pub views: Arc<dyn Views>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Guess {
    pose: Pose,
    in_s: f64,
    probability: f64,
    urgency: Urgency,
    /// By a turn of the head alone: geometry is needed at once, whatever `in_s`.
    turned: bool,
}

impl Foresight for Forecast {
    fn expect(&mut self, motion: &Motion, within_s: f64, reach_m: f64, absent: &dyn Fn(u32) -> bool) -> Vec<Expected> {
        let here = motion.pose();
        let mut found: HashMap<u32, Expected> = HashMap::new();
        let mut guesses = guesses(motion, within_s);
        guesses.extend(turned_to_others(&self.index, &here));
        guesses.retain(|g| g.pose.position.distance(here.position) <= reach_m);
        if let Some(rooms) = &self.index.rooms {
            guesses.retain(|g| ways::leads(&rooms.rooms, here.position, g.pose.position));
            guesses.extend(through_doors(&rooms.rooms, motion, within_s, reach_m));
        }
        let poses: Vec<Pose> = guesses.iter().map(|g| g.pose).collect();
        for (g, lacking) in guesses.iter().zip(self.views.lacking(&poses, absent)) {
            for chunk in lacking {
                let geometry = matches!(
                    self.index.chunks[chunk as usize].kind,
                    ChunkKind::Cell | ChunkKind::Levels | ChunkKind::Bundle
                );
                let in_s = if g.turned && geometry { 0.0 } else { g.in_s };
                if in_s > within_s {
                    continue;
                }
                let new = Expected { chunk, in_s, probability: g.probability, urgency: g.urgency };
                let entry = found.entry(chunk).or_insert(new);
                if rank_s(&new) < rank_s(entry) {
                    *entry = new;
                }
            }
        }
        found.into_values().collect()
    }
}

/// Mean time until a chunk is needed, were its chance to come again and again: what is likely
/// comes before what is only possible.
pub(super) fn rank_s(e: &Expected) -> f64 {
    e.in_s / e.probability.max(1e-3)
}

/// Guesses of what comes within a time, and of turns of the head whenever.
fn guesses(motion: &Motion, within_s: f64) -> Vec<Guess> {
    let here = motion.pose();
    let (walks, turns) = (motion.walks(), motion.turns());
    let mut out = Vec::new();
    let mut put = |pose: Pose, in_s: f64, probability: f64, urgency| {
        if in_s <= within_s {
            out.push(Guess { pose, in_s, probability, urgency, turned: false });
        }
    };
    let turned = |pose: Pose, by: f64| Pose { yaw_deg: pose.yaw_deg + by, ..pose };
    if walks || turns {
        let keeps_s = if turns { KEEPS_TURNING_S } else { KEEPS_WALKING_S };
        for (t, in_s) in times() {
            let by = (motion.turn_deg_s * t).clamp(-180.0, 180.0);
            let pose = turned(Pose { position: here.position + motion.velocity_m_s * t, ..here }, by);
            let probability = (-t / keeps_s).exp();
            put(pose, in_s, probability, Urgency::Predicted);
            if walks {
                let aside = motion.velocity_m_s.cross(glam::DVec3::Y) * (t * SPREAD);
                for side in [aside, -aside] {
                    let beside = Pose { position: pose.position + side, ..pose };
                    put(beside, in_s, probability * BESIDE, Urgency::Around);
                }
            }
        }
    }
    if !walks {
        for (t, in_s) in times() {
            let by = if turns { motion.turn_deg_s * t.min(0.3) } else { 0.0 };
            let looks = turned(here, by);
            let position = here.position + looks.basis().forward * (WALK_M_S * t);
            put(Pose { position, ..looks }, in_s, SETS_OFF * (-t / KEEPS_WALKING_S).exp(), Urgency::Around);
        }
    }
    let steps = (180.0 / STEP_DEG) as i32;
    for i in 1..=steps {
        let by = STEP_DEG * f64::from(i);
        // Half a step earlier, as what is needed here was not needed a step before.
        let in_s = (by - STEP_DEG / 2.0) / QUICK_TURN_DEG_S;
        if in_s > within_s && i % GEOMETRY_STEP != 0 {
            continue;
        }
        out.extend([by, -by].map(|by| turn(turned(here, by), in_s, in_s)));
    }
    out
}

/// A turn of the head that takes so long, if there is one; after `in_s` images are needed.
fn turn(pose: Pose, takes_s: f64, in_s: f64) -> Guess {
    let probability = TURNS * (-takes_s / KEEPS_TURNING_S).exp();
    Guess { pose, in_s, probability, urgency: Urgency::Around, turned: true }
}

/// Turns of the head to where the grid point names another placement, which may draw cells that no
/// other direction needs: only geometry is looked for, as steps of a turn find the images.
fn turned_to_others(index: &Index, here: &Pose) -> impl Iterator<Item = Guess> {
    yaws_of_placements(index, here).into_iter().map(|yaw_deg| {
        let by = (yaw_deg - here.yaw_deg + 180.0).rem_euclid(360.0) - 180.0;
        turn(Pose { yaw_deg, ..*here }, by.abs() / QUICK_TURN_DEG_S, f64::INFINITY)
    })
}

/// Poses in the doors that can be reached, looking into the room beyond.
fn through_doors(rooms: &Rooms, motion: &Motion, within_s: f64, reach_m: f64) -> Vec<Guess> {
    let here = motion.pose();
    let speed = motion.velocity_m_s.length().max(WALK_M_S);
    let heading = if motion.walks() { motion.velocity_m_s } else { here.basis().forward };
    let heading = heading.with_y(0.0).normalize_or_zero();
    let guess = |door: ways::Door| {
        let in_s = door.distance_m / speed;
        let ahead = 0.5 + 0.5 * heading.dot(door.toward);
        let probability = DOORS * ahead * (-in_s / KEEPS_TO_DOOR_S).exp();
        let yaw_deg = f64::atan2(-door.into.x, -door.into.z).to_degrees();
        Guess {
            pose: Pose { position: door.place, yaw_deg, pitch_deg: 0.0 },
            in_s,
            probability,
            urgency: Urgency::Around,
            turned: false,
        }
    };
    ways::doors(rooms, here.position, reach_m.min(within_s * speed)).into_iter().map(guess).collect()
}

/// Times of guesses, and the time at which what is needed there comes into need: half way from the
/// guess before.
fn times() -> impl Iterator<Item = (f64, f64)> {
    let before = std::iter::once(0.0).chain(TIMES_S);
    TIMES_S.into_iter().zip(before).map(|(t, before)| (t, (t + before) / 2.0))
}
