//! Chooses the start pose when none is given. The walk volume contains no walls or furniture, so
//! candidates are tested by what their pictures show.
//!
//! In: candidate poses, their pictures, and the direction with the most room. Out: the next pose to
//! look at, until a picture shows enough. Pure.

use super::walker;
use crate::frame::Frame;
use ldi_protocol::{Pose, volume::WalkVolume};

/// Number of tones of a picture that shows enough. Smaller: views of a bare wall are accepted;
/// larger: more candidates are looked at. A judgement.
const ENOUGH: usize = 12;
/// A tone counts if one in this many pixels has it, so that edges do not count. A judgement.
const SHARE: usize = 500;

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
    use glam::DVec3;

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
    fn rare_tones_do_not_count() {
        let mut wall = vec![0xffd2_c2ac; 5000];
        wall[7] = 0xff00_0000;
        assert_eq!(tones(&wall), 1);
        assert_eq!(tones(&picture(9).colour), 9);
        assert_eq!(tones(&[]), 0);
    }
}
