//! What no view needs yet: the lists of the predicted views and of the surroundings.

use super::{List, Planner};
use ldi_protocol::{
    Pose,
    need::{Needed, PREFETCH_SHARE, Reach, near_to_far},
    wire::Urgency,
};

/// How far ahead the walk is carried on, seconds. The first covers a round trip and the decoding, the second the time in which
/// a first layer arrives on a slow link; farther guesses miss more often than they hit.
pub const HORIZONS_S: [f64; 2] = [0.4, 1.0];
/// Step of the turn on the spot, degrees: below half the smallest field of view (54), so that no direction in between
/// is left out.
pub const TURN_STEP_DEG: f64 = 25.0;
/// Below these the walker stands, and there is nothing to predict.
const MIN_SPEED_M_S: f64 = 0.05;
/// See [`MIN_SPEED_M_S`].
const MIN_TURN_DEG_S: f64 = 1.0;
/// The rings around the walker are made again after this much movement, metres. Smaller: more work per walker; larger: the
/// order is that of an older place.
const AROUND_STEP_M: f64 = 0.5;

impl Planner {
    pub(super) fn plan_predicted(&mut self) {
        self.predicted = true;
        let Some(m) = self.motion.filter(|_| self.config.prefetch_m > 0.0) else { return };
        let here = m.newest.pose;
        let mut poses = Vec::new();
        if m.velocity_m_s.length() > MIN_SPEED_M_S || m.turn_deg_s.abs() > MIN_TURN_DEG_S {
            poses.extend(HORIZONS_S.map(|t| Pose {
                position: here.position + m.velocity_m_s * t,
                yaw_deg: here.yaw_deg + m.turn_deg_s * t,
                pitch_deg: here.pitch_deg,
            }));
        }
        let list = self.within_share(self.views_of(&poses).into_iter());
        self.lists[Urgency::Predicted as usize] = List::new(list);
    }

    pub(super) fn plan_around(&mut self) {
        let Some(m) = self.motion.filter(|_| self.config.prefetch_m > 0.0) else { return };
        let here = m.newest.pose;
        if self.around_at.is_some_and(|at| at.distance(here.position) < AROUND_STEP_M) {
            return;
        }
        self.around_at = Some(here.position);
        let steps = (180.0 / TURN_STEP_DEG).ceil() as i32;
        let ahead = if m.turn_deg_s < 0.0 { -1.0 } else { 1.0 };
        let turned = |by: f64| Pose { yaw_deg: here.yaw_deg + by * TURN_STEP_DEG, ..here };
        let poses: Vec<Pose> =
            (1..=steps).flat_map(|i| [ahead, -ahead].map(|side| turned(side * f64::from(i)))).collect();
        let reach = Reach { radius_m: self.config.prefetch_m, decoded_bytes: self.share() };
        let near = near_to_far(&self.index, here.position, reach);
        let list = self.within_share(self.views_of(&poses).into_iter().chain(near));
        self.lists[Urgency::Around as usize] = List::new(list);
        self.changed = true;
    }

    /// Chunks of several views. No gap in any of them comes before sharpness in one.
    fn views_of(&self, poses: &[Pose]) -> Vec<u32> {
        let views: Vec<Needed> = poses.iter().map(|p| self.views.needed(p)).collect();
        views.iter().flat_map(|v| &v.now).chain(views.iter().flat_map(|v| &v.fine)).copied().collect()
    }

    fn share(&self) -> u64 {
        (self.config.cache_bytes as f64 * PREFETCH_SHARE) as u64
    }

    /// Each number once, in order, up to the share of the cache that may be filled unasked.
    fn within_share(&self, chunks: impl Iterator<Item = u32>) -> Vec<u32> {
        let mut seen = vec![false; self.index.chunks.len()];
        let mut left = self.share();
        let mut out = Vec::new();
        for c in chunks {
            let Some(entry) = self.index.chunks.get(c as usize) else { continue };
            if std::mem::replace(&mut seen[c as usize], true) {
                continue;
            }
            let Some(rest) = left.checked_sub(u64::from(entry.decoded_bytes)) else { break };
            left = rest;
            out.push(c);
        }
        out
    }
}
