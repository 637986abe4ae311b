//! Eyes near a path: a walk volume of no more than a walk needs (guided tours, inspections, what
//! is looked at first).
//!
//! In: the runs of a walk volume. Out: those that an eye of the path may reach.

use glam::{DVec2, DVec3};
use ldi_protocol::path::Walk;
use std::collections::HashMap;

/// Poses nearer to the last one than this say nothing new, metres.
const STEP_M: f64 = 0.05;

/// The places within some distance of a path, to the sides as well as up and down.
#[derive(Debug, Clone, PartialEq)]
pub struct Corridor {
    eyes: Vec<DVec3>,
    within_m: f64,
}

/// Runs of layers per column (place along x and z), sorted and disjoint.
pub(super) type Runs = HashMap<[u32; 2], Vec<[u16; 2]>>;

/// How the columns of a walk volume lie; see
/// [`WalkVolume::new`](ldi_protocol::volume::WalkVolume::new).
#[derive(Debug, Clone, Copy)]
pub(super) struct Columns {
    pub origin: DVec3,
    pub pitch_m: f64,
    pub layer_m: f64,
    /// Along x and z.
    pub count: [u32; 2],
}

impl Corridor {
    /// Around a walk; `within_m` above 0.
    pub fn around(walk: &Walk, within_m: f64) -> Self {
        let mut eyes: Vec<DVec3> = walk.poses.iter().map(|p| p.pose.position).collect();
        eyes.dedup_by(|next, last| next.distance(*last) < STEP_M);
        Self { eyes, within_m }
    }

    /// How far from the path eyes may be, metres.
    pub fn within_m(&self) -> f64 {
        self.within_m
    }

    /// Eyes of the path, thinned.
    pub(super) fn eyes(&self) -> &[DVec3] {
        &self.eyes
    }

    /// Leaves the runs that come within reach of the path, and returns how many do not.
    pub(super) fn cut(&self, runs: &mut Runs, columns: &Columns) -> u64 {
        let all = runs.values().map(Vec::len).sum::<usize>();
        let mut kept = Runs::default();
        for eye in &self.eyes {
            for place in self.columns_around(*eye, columns) {
                for run in runs.get(&place).into_iter().flatten() {
                    let [low, high] = run.map(|l| columns.origin.y + f64::from(l) * columns.layer_m);
                    if eye.y < low - self.within_m || eye.y > high + self.within_m {
                        continue;
                    }
                    let there = kept.entry(place).or_default();
                    if !there.contains(run) {
                        there.push(*run);
                    }
                }
            }
        }
        kept.values_mut().for_each(|column| column.sort_unstable());
        let left_out = all - kept.values().map(Vec::len).sum::<usize>();
        *runs = kept;
        left_out as u64
    }

    /// Columns whose squares come within reach of an eye, to the sides.
    fn columns_around(&self, eye: DVec3, columns: &Columns) -> impl Iterator<Item = [u32; 2]> {
        let &Columns { origin, pitch_m, count, .. } = columns;
        let place = DVec2::new(eye.x - origin.x, eye.z - origin.z);
        let within_m = self.within_m;
        let span = move |x: f64, n: u32| {
            let cell = |x: f64| ((x / pitch_m).floor().max(0.0) as u32).min(n);
            cell(x - within_m)..(cell(x + within_m) + 1).min(n)
        };
        span(place.y, count[1]).flat_map(move |k| span(place.x, count[0]).map(move |i| [i, k])).filter_map(
            move |[i, k]| {
                let low = DVec2::new(f64::from(i), f64::from(k)) * pitch_m;
                let nearest = place.clamp(low, low + pitch_m);
                (place.distance(nearest) <= within_m).then_some([i, k])
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: Columns =
        Columns { origin: DVec3::new(-10.0, 0.0, -10.0), pitch_m: 0.5, layer_m: 0.1, count: [40, 40] };

    fn around(waypoints: &str, within_m: f64) -> Corridor {
        Corridor::around(&ldi_protocol::path::parse(&format!(r#"{{"waypoints": {waypoints}}}"#)).unwrap(), within_m)
    }

    /// Two storeys everywhere: eyes at 1.1 to 2 m and at 4.1 to 5 m.
    fn storeys() -> Runs {
        (0..1600).map(|c| ([c % 40, c / 40], vec![[11, 20], [41, 50]])).collect()
    }

    #[test]
    fn runs_stay_where_brute_force_finds_the_path_near() {
        let (corridor, mut runs) = (around("[[-3, 1.6, -2], [4, 1.6, 5], [4, 4.6, 5]]", 1.3), storeys());
        let cut = corridor.cut(&mut runs, &COLUMNS);
        for [i, k] in storeys().into_keys() {
            let kept = runs.get(&[i, k]).cloned().unwrap_or_default();
            let low = DVec3::new(f64::from(i) * 0.5 - 10.0, 0.0, f64::from(k) * 0.5 - 10.0);
            for run in [[11, 20], [41, 50]] {
                let (y0, y1) = (f64::from(run[0]) * 0.1, f64::from(run[1]) * 0.1);
                let near = corridor.eyes.iter().any(|e| {
                    let p = e.clamp(low.with_y(y0), (low + 0.5).with_y(y1));
                    (p.y - e.y).abs() <= 1.3 && DVec2::new(p.x - e.x, p.z - e.z).length() <= 1.3
                });
                assert_eq!(kept.contains(&run), near, "column {i} {k}, run {run:?}");
            }
        }
        let left: usize = runs.values().map(Vec::len).sum();
        assert_eq!(cut, 3200 - left as u64);
        // Some of the upper storey: only where the path climbs.
        let upper = runs.values().filter(|r| r.contains(&[41, 50])).count();
        assert!(upper > 10 && upper < 40 && left > 100, "{upper} of {left}");
    }

    #[test]
    fn nothing_stays_of_what_the_path_does_not_reach() {
        let mut runs = storeys();
        assert_eq!(around("[[0, 20, 0], [900, 1.6, 0]]", 0.5).cut(&mut runs, &COLUMNS), 3200);
        assert!(runs.is_empty());
    }
}
