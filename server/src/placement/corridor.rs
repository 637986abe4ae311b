//! Eyes near a path: a walk volume of no more than a walk needs (guided tours, inspections, what is looked at first).
//!
//! In: the runs of a walk volume. Out: those that an eye of the path may reach, and why the others were left out.

use glam::{DVec2, DVec3};
use ldi_protocol::path::Walk;
use std::collections::BTreeMap;

/// Poses nearer to the last one than this say nothing new, metres.
const STEP_M: f64 = 0.05;

/// The places within some distance of a path, to the sides as well as up and down.
#[derive(Debug, Clone, PartialEq)]
pub struct Corridor {
    eyes: Vec<DVec3>,
    within_m: f64,
}

/// How the columns of a walk volume lie; see [`WalkVolume::new`](ldi_protocol::volume::WalkVolume::new).
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

    /// Leaves the runs that come within reach of the path. What is cut, by reason: runs too far away, and places of the path without any run.
    pub(super) fn cut(&self, runs: &mut [Vec<[u16; 2]>], columns: &Columns) -> BTreeMap<String, u64> {
        let all = runs.iter().map(Vec::len).sum::<usize>();
        let mut kept: Vec<Vec<[u16; 2]>> = vec![Vec::new(); runs.len()];
        let mut astray = 0;
        for eye in &self.eyes {
            let mut near = false;
            for column in self.columns_around(*eye, columns) {
                for run in runs.get(column).into_iter().flatten() {
                    let [low, high] = run.map(|l| columns.origin.y + f64::from(l) * columns.layer_m);
                    if eye.y < low - self.within_m || eye.y > high + self.within_m {
                        continue;
                    }
                    near = true;
                    if !kept[column].contains(run) {
                        kept[column].push(*run);
                    }
                }
            }
            astray += u64::from(!near);
        }
        kept.iter_mut().for_each(|column| column.sort_unstable());
        let left_out = all - kept.iter().map(Vec::len).sum::<usize>();
        runs.clone_from_slice(&kept);
        let reasons =
            [("eye positions too far from the path", left_out as u64), ("places of the path without a floor", astray)];
        reasons.into_iter().filter(|(_, n)| *n > 0).map(|(why, n)| (why.into(), n)).collect()
    }

    /// Columns whose squares come within reach of an eye, to the sides.
    fn columns_around(&self, eye: DVec3, columns: &Columns) -> impl Iterator<Item = usize> {
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
                (place.distance(nearest) <= within_m).then_some((k * count[0] + i) as usize)
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
    fn storeys() -> Vec<Vec<[u16; 2]>> {
        vec![vec![[11, 20], [41, 50]]; 1600]
    }

    #[test]
    fn runs_stay_where_brute_force_finds_the_path_near() {
        let (corridor, mut runs) = (around("[[-3, 1.6, -2], [4, 1.6, 5], [4, 4.6, 5]]", 1.3), storeys());
        let cut = corridor.cut(&mut runs, &COLUMNS);
        for (column, kept) in runs.iter().enumerate() {
            let low = DVec3::new((column % 40) as f64 * 0.5 - 10.0, 0.0, (column / 40) as f64 * 0.5 - 10.0);
            for run in [[11, 20], [41, 50]] {
                let (y0, y1) = (f64::from(run[0]) * 0.1, f64::from(run[1]) * 0.1);
                let near = corridor.eyes.iter().any(|e| {
                    let p = e.clamp(low.with_y(y0), (low + 0.5).with_y(y1));
                    (p.y - e.y).abs() <= 1.3 && DVec2::new(p.x - e.x, p.z - e.z).length() <= 1.3
                });
                assert_eq!(kept.contains(&run), near, "column {column}, run {run:?}");
            }
        }
        let left: usize = runs.iter().map(Vec::len).sum();
        assert_eq!(cut.into_values().collect::<Vec<_>>(), [3200 - left as u64]);
        // Some of the upper storey: only where the path climbs.
        let upper = runs.iter().filter(|r| r.contains(&[41, 50])).count();
        assert!(upper > 10 && upper < 40 && left > 100, "{upper} of {left}");
    }

    #[test]
    fn places_without_a_floor_are_counted() {
        let mut runs = storeys();
        let cut = around("[[0, 1.6, 0], [0, 1.6, 0.01]]", 0.5).cut(&mut runs, &COLUMNS);
        assert!(!cut.contains_key("places of the path without a floor"), "{cut:?}");
        let mut runs = storeys();
        let cut = around("[[0, 20, 0], [900, 1.6, 0]]", 0.5).cut(&mut runs, &COLUMNS);
        assert!(cut["places of the path without a floor"] > 100, "{cut:?}");
        assert!(runs.iter().all(Vec::is_empty));
    }
}
