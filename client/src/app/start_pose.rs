//! Chooses the start pose when none is given. The walk volume contains no walls or furniture, so
//! candidates are tested by what their pictures show.
//!
//! In: candidate poses, their pictures, and the direction with the most room. Out: the next pose to
//! look at, until a picture shows enough. Pure.

use super::walker;
use crate::frame::Frame;
use glam::DVec3;
use ldi_protocol::{Pose, volume::WalkVolume};
use std::fmt;

/// Number of tones of a picture that shows enough. Smaller: views of a bare wall are accepted;
/// larger: more candidates are looked at. A judgement.
const ENOUGH: usize = 12;
/// A tone counts if one in this many pixels has it, so that edges do not count. A judgement.
const SHARE: usize = 500;

/// Distance by which a given start may be moved without a word, metres: eyes settle on the floor.
const UNNOTICED_M: f64 = 0.1;

/// A given start pose that the walker could not take.
#[derive(Debug, Clone, PartialEq)]
pub struct MovedStart {
    /// Distance between both places, metres.
    pub by_m: f64,
    /// The place that was taken.
    pub to: DVec3,
    /// Why.
    pub reason: String,
}

impl MovedStart {
    /// None if the walker stands at the given place.
    pub fn between(given: DVec3, to: DVec3, volume: Option<&WalkVolume>) -> Option<Self> {
        let by_m = given.distance(to);
        if by_m <= UNNOTICED_M {
            return None;
        }
        let heights: Vec<[f64; 2]> = volume.map(|v| v.heights(given.x, given.z).collect()).unwrap_or_default();
        let reason = match heights[..] {
            [] => "nobody can stand at the given place (M shows where)".to_owned(),
            _ => {
                let all: Vec<String> = heights.iter().map(|[low, high]| format!("{low:.2} to {high:.2}")).collect();
                format!("eyes are at heights of {} m there", all.join(", or "))
            }
        };
        Some(Self { by_m, to, reason })
    }
}

impl fmt::Display for MovedStart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let DVec3 { x, y, z } = self.to;
        write!(f, "the start was moved {:.1} m, to {x:.2},{y:.2},{z:.2}: {}", self.by_m, self.reason)
    }
}

/// The search for a start pose.
pub(super) struct StartPoseSearch {
    /// Remaining candidates; the next one last.
    left: Vec<Pose>,
    /// Whether the direction of the current candidate has been chosen.
    turned: bool,
    /// The best pose so far, and its number of tones.
    best: Option<(usize, Pose)>,
    /// Whether the search is over.
    done: bool,
}

impl StartPoseSearch {
    /// Starts the search. Also returns the first candidate.
    pub fn new(volume: &WalkVolume) -> (Self, Option<Pose>) {
        let mut left = walker::starts(volume);
        left.reverse();
        let first = left.pop();
        (Self { left, turned: false, best: None, done: false }, first)
    }

    /// Evaluates the complete picture of a pose. `yaw_deg` computes the direction with the most
    /// room. Returns the next pose to look at; None if the current one is chosen.
    pub fn on_picture(&mut self, pose: &Pose, frame: &Frame, yaw_deg: impl FnOnce() -> f64) -> Option<Pose> {
        if !std::mem::replace(&mut self.turned, true) {
            let turned = Pose { yaw_deg: yaw_deg(), ..*pose };
            if turned != *pose {
                return Some(turned);
            }
        }
        let tones = tones(&frame.colour);
        if self.best.as_ref().is_none_or(|b| tones > b.0) {
            self.best = Some((tones, *pose));
        }
        let next = match tones < ENOUGH {
            true => self.left.pop(),
            false => None,
        };
        if next.is_some() {
            self.turned = false;
            return next;
        }
        self.done = true;
        self.best.map(|b| b.1).filter(|best| best != pose)
    }

    /// Whether the start pose is chosen.
    pub fn is_done(&self) -> bool {
        self.done
    }
}

/// Number of colours, of 16 levels per channel, that enough pixels have.
fn tones(colour: &[u32]) -> usize {
    let mut count = vec![0usize; 1 << 12];
    for c in colour {
        count[((c >> 4 & 0xf) | (c >> 8 & 0xf0) | (c >> 12 & 0xf00)) as usize] += 1;
    }
    count.into_iter().filter(|n| *n > 0 && n * SHARE >= colour.len()).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(tones: u32) -> Frame {
        Frame {
            width: 100,
            height: 1,
            colour: (0..100).map(|i| 0xff00_0000 | ((i % tones) * 16)).collect(),
            ..Frame::default()
        }
    }

    fn at(x: f64, yaw_deg: f64) -> Pose {
        Pose { position: DVec3::new(x, 0.0, 0.0), yaw_deg, pitch_deg: 0.0 }
    }

    #[test]
    fn places_are_tried_until_one_shows_something() {
        let start_search =
            || StartPoseSearch { left: vec![at(3.0, 0.0), at(2.0, 0.0)], turned: false, best: None, done: false };
        let mut s = start_search();
        assert_eq!(s.on_picture(&at(1.0, 0.0), &picture(1), || 90.0), Some(at(1.0, 90.0)), "turns first");
        assert!(!s.is_done());
        assert_eq!(s.on_picture(&at(1.0, 90.0), &picture(2), || panic!("once")), Some(at(2.0, 0.0)), "a wall");
        assert_eq!(
            s.on_picture(&at(2.0, 0.0), &picture(15), || 0.0),
            None,
            "looks there already, and there is something"
        );
        assert!(s.is_done());
        // All candidates show walls: the best one is chosen.
        let mut s = start_search();
        let walls = [(1.0, 3, Some(at(2.0, 0.0))), (2.0, 4, Some(at(3.0, 0.0))), (3.0, 2, Some(at(2.0, 0.0)))];
        for (x, tones, next) in walls {
            assert!(!s.is_done());
            assert_eq!(s.on_picture(&at(x, 0.0), &picture(tones), || 0.0), next);
        }
        assert!(s.is_done());
    }

    #[test]
    fn a_start_that_was_moved_says_how_far_and_why() {
        // A floor of 1 x 1 m with eyes at 1.1 to 2.0 m.
        let cut = ldi_protocol::Aabb { min: DVec3::ZERO, max: DVec3::new(1.0, 0.0, 1.0) };
        let runs = vec![vec![[11, 20]]; 4];
        let volume = WalkVolume::new(DVec3::ZERO, 0.5, 0.1, [2, 2], &runs, &cut).expect("a volume");
        let moved = |given: [f64; 3], to: [f64; 3]| MovedStart::between(given.into(), to.into(), Some(&volume));
        assert_eq!(moved([0.3, 1.6, 0.3], [0.3, 1.55, 0.3]), None, "settled on the floor");
        let beside = moved([5.0, 1.6, 0.3], [1.0, 1.6, 0.3]).expect("moved").to_string();
        assert!(beside.contains("4.0 m") && beside.contains("1.00,1.60,0.30"), "{beside}");
        assert!(beside.contains("nobody can stand"), "{beside}");
        let below = moved([0.3, 9.0, 0.3], [0.3, 1.6, 0.3]).expect("moved").to_string();
        assert!(below.contains("7.4 m") && below.contains("heights of 1."), "{below}");
    }

    #[test]
    fn rare_tones_do_not_count() {
        let mut wall = vec![0xffd2_c2ac; 5000];
        wall[7] = 0xff00_0000;
        assert_eq!(tones(&wall), 1);
        assert_eq!(tones(&picture(9).colour), 9);
        assert_eq!(tones(&[]), 0);
    }
}
