//! Foresight of other servers, to compare with: one that knows the walk, and one that sends
//! whatever there is room for.

use super::rehearsal::Script;
use ldi_protocol::{
    Pose,
    index::Index,
    need::{PREFETCH_SHARE, Reach, near_to_far},
    wire::Urgency,
};
use ldi_server::serve::planner::{Expected, Foresight, Motion, Views};
use std::{collections::BTreeMap, sync::Arc};

/// Knows when each chunk is needed.
#[derive(Debug)]
pub struct Hindsight {
    /// Per chunk: the times at which it comes into view, seconds, ascending.
    entries: BTreeMap<u32, Vec<f64>>,
}

impl Hindsight {
    /// Looks through a walk.
    pub fn new(script: &Script) -> Self {
        let mut entries: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
        for ((t, _), needed) in script.poses.iter().zip(&script.needs) {
            needed.all().for_each(|c| entries.entry(c).or_default().push(*t));
        }
        Self { entries }
    }
}

impl Foresight for Hindsight {
    fn expect(&mut self, motion: &Motion, _within_s: f64, _reach_m: f64, _: &dyn Fn(u32) -> bool) -> Vec<Expected> {
        let now = motion.newest.sent_us as f64 * 1e-6;
        let next = |(chunk, times): (&u32, &Vec<f64>)| {
            let t = times.get(times.partition_point(|t| *t < now - 1e-6))?;
            Some(Expected { chunk: *chunk, in_s: t - now, probability: 1.0, urgency: Urgency::Predicted })
        };
        let mut all: Vec<Expected> = self.entries.iter().filter_map(next).collect();
        // Nothing gained by waiting: what is sent will be used. The order stays.
        all.iter_mut().for_each(|e| e.in_s *= 1e-6);
        all
    }
}

/// Fills three quarters of the client's cache, whatever the link, at once.
pub struct Everything {
    /// Of the dataset.
    pub index: Arc<Index>,
    /// What poses need.
    pub views: Arc<dyn Views>,
    /// Decoded bytes of the client's cache.
    pub cache_bytes: u64,
}

impl Foresight for Everything {
    fn expect(&mut self, motion: &Motion, _within_s: f64, reach_m: f64, _: &dyn Fn(u32) -> bool) -> Vec<Expected> {
        let here = motion.pose();
        let turned = |by: f64| Pose { yaw_deg: here.yaw_deg + by, ..here };
        let ahead = [0.4, 1.0]
            .map(|t| Pose { position: here.position + motion.velocity_m_s * t, ..turned(motion.turn_deg_s * t) });
        let around = (1..=8).flat_map(|i| [1.0, -1.0].map(|side| turned(side * 25.0 * f64::from(i))));
        let of = |poses: Vec<Pose>| {
            let views: Vec<_> = poses.iter().map(|p| self.views.needed(p)).collect();
            views.iter().flat_map(|v| &v.now).chain(views.iter().flat_map(|v| &v.fine)).copied().collect::<Vec<u32>>()
        };
        let reach = Reach { radius_m: reach_m, decoded_bytes: (self.cache_bytes as f64 * PREFETCH_SHARE) as u64 };
        let lists = [of(ahead.to_vec()), of(around.collect()), near_to_far(&self.index, here.position, reach)];
        let mut seen = vec![false; self.index.chunks.len()];
        let once = lists.concat().into_iter().filter(|c| !std::mem::replace(&mut seen[*c as usize], true));
        // Due at once, in this order.
        let expected =
            |(i, chunk)| Expected { chunk, in_s: i as f64 * 1e-9, probability: 1.0, urgency: Urgency::Around };
        once.enumerate().map(expected).collect()
    }
}
