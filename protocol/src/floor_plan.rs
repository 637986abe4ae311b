//! Floor plans: horizontal sections of the scene as rasters, one per storey, or one relief of open
//! ground.
//!
//! A plan is made by the build and shown by the client's map, by the server's page and by
//! `inspect --plan`. So that all three look the same, the colours are here.

use crate::bounds::Aabb;
use serde::{Deserialize, Serialize};

/// Most plans of a dataset.
pub const MAX_PLANS: usize = 32;
/// Most cells along a side: the largest texture that every graphics card takes.
pub const MAX_SIDE: u32 = 4096;
/// Most cells of all plans together, one byte each.
pub const MAX_CELLS: usize = 1 << 22;

/// Value of a cell without floor and without walls.
pub const OPEN: u8 = 0;
/// Value of a cell with a surface at the height of the section.
pub const WALL: u8 = 1;
/// Value of a cell inside of a wall or another solid.
pub const SOLID: u8 = 2;
/// Value of a cell in an enclosed space that cannot be entered.
pub const CLOSED: u8 = 3;
/// Smallest value of a cell with floor: at [`FloorPlan::ground_m`]. Each further value is
/// [`FloorPlan::step_m`] higher.
pub const FLOOR: u8 = 4;

/// Directions that [`FloorPlan::open_yaw_deg`] tries.
const DIRECTIONS: usize = 64;
/// Free views are compared up to this length, metres.
const LONGEST_VIEW_M: f64 = 60.0;
/// Most contour lines of a relief.
const MOST_CONTOURS: f64 = 14.0;

/// A horizontal section of the scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FloorPlan {
    /// Height of the storey's floor, metres. Of a relief: the mean height of the ground.
    pub floor_m: f64,
    /// Height of the lowest floor in [`FloorPlan::cells`], metres.
    pub ground_m: f64,
    /// Height of a step of the floors' values, metres.
    pub step_m: f64,
    /// Smallest x and z of the raster, metres.
    pub corner: [f64; 2],
    /// Edge of a cell, metres.
    pub pitch_m: f64,
    /// Cells along x and along z.
    pub size: [u32; 2],
    /// Whether the plan shows open ground without storeys.
    pub relief: bool,
    /// Values of the cells, row by row along x: [`OPEN`], [`WALL`], [`SOLID`], [`CLOSED`], or
    /// [`FLOOR`] and above.
    pub cells: Vec<u8>,
}

impl FloorPlan {
    /// Checks the ranges of all fields.
    ///
    /// # Errors
    /// The first rule that is broken.
    pub fn check(&self) -> Result<(), &'static str> {
        let numbers = [self.floor_m, self.ground_m, self.step_m, self.corner[0], self.corner[1], self.pitch_m];
        if numbers.iter().any(|n| !n.is_finite()) || self.step_m <= 0.0 || self.pitch_m <= 0.0 {
            return Err("numbers out of range");
        }
        if cell_count(self.size) != Some(self.cells.len()) {
            return Err("another number of cells than its size says");
        }
        Ok(())
    }

    /// Smallest and largest x and z, metres: `[x0, z0, x1, z1]`.
    pub fn area(&self) -> [f64; 4] {
        let [x, z] = self.corner;
        let [w, h] = self.size.map(|n| f64::from(n) * self.pitch_m);
        [x, z, x + w, z + h]
    }

    /// Column and row of the cell at (x, z); None outside of the raster.
    pub fn cell_at(&self, x: f64, z: f64) -> Option<[u32; 2]> {
        let at = |v: f64, axis: usize| {
            let cell = ((v - self.corner[axis]) / self.pitch_m).floor();
            (cell >= 0.0 && cell < f64::from(self.size[axis])).then_some(cell as u32)
        };
        Some([at(x, 0)?, at(z, 1)?])
    }

    /// Value at (x, z); [`OPEN`] outside of the raster.
    pub fn value_at(&self, x: f64, z: f64) -> u8 {
        self.cell_at(x, z).map_or(OPEN, |c| self.value(c))
    }

    fn value(&self, [i, k]: [u32; 2]) -> u8 {
        self.cells.get(k as usize * self.size[0] as usize + i as usize).copied().unwrap_or(OPEN)
    }

    /// Height of the floor at (x, z), metres.
    pub fn floor_at(&self, x: f64, z: f64) -> Option<f64> {
        let step = self.value_at(x, z).checked_sub(FLOOR)?;
        Some(self.ground_m + f64::from(step) * self.step_m)
    }

    /// The place nearest to (x, z) with floor, no wall within `body_m`, and `allowed`. None if
    /// there is none within `reach_m`.
    pub fn place_near(
        &self,
        [x, z]: [f64; 2],
        reach_m: f64,
        body_m: f64,
        allowed: impl Fn([f64; 2]) -> bool,
    ) -> Option<[f64; 2]> {
        // Candidates lie on rings around the point, a cell or a tenth of a metre apart.
        let step_m = self.pitch_m.max(0.1);
        let rings = (reach_m / step_m).floor().clamp(0.0, 500.0) as u32;
        let is_free = |p: &[f64; 2]| self.value_at(p[0], p[1]) >= FLOOR && self.is_clear(*p, body_m) && allowed(*p);
        (0..=rings).find_map(|ring| {
            let radius = f64::from(ring) * step_m;
            let places = (f64::from(ring) * std::f64::consts::TAU).ceil().max(1.0);
            (0..places as u32)
                .map(|n| {
                    let (sin, cos) = (f64::from(n) / places * std::f64::consts::TAU).sin_cos();
                    [x + radius * cos, z + radius * sin]
                })
                .find(is_free)
        })
    }

    /// Whether no wall lies within `body_m` of a place.
    fn is_clear(&self, [x, z]: [f64; 2], body_m: f64) -> bool {
        let cells = (body_m / self.pitch_m).ceil().clamp(0.0, 64.0) as i32;
        (-cells..=cells).all(|k| {
            (-cells..=cells).all(|i| {
                let (dx, dz) = (f64::from(i) * self.pitch_m, f64::from(k) * self.pitch_m);
                dx.hypot(dz) > body_m || !matches!(self.value_at(x + dx, z + dz), WALL | SOLID)
            })
        })
    }

    /// Length of the free view from (x, z) in the direction of a yaw, metres: to the next wall or
    /// the raster's border.
    pub fn view_m(&self, [x, z]: [f64; 2], yaw_deg: f64) -> f64 {
        let (sin, cos) = yaw_deg.to_radians().sin_cos();
        // Half cells, so that no wall is passed between two places that are looked at.
        let step_m = self.pitch_m * 0.5;
        let most = (LONGEST_VIEW_M / step_m).min(4.0 * f64::from(MAX_SIDE)) as u32;
        let is_free = |n: &u32| {
            let far = f64::from(*n) * step_m;
            let (x, z) = (x - sin * far, z - cos * far);
            self.cell_at(x, z).is_some() && !matches!(self.value_at(x, z), WALL | SOLID)
        };
        (1..=most).take_while(is_free).count() as f64 * step_m
    }

    /// The yaw with the longest free view from (x, z), degrees in -180 to 180. Neighbouring
    /// directions count too, so that no gap between two walls wins.
    pub fn open_yaw_deg(&self, place: [f64; 2]) -> f64 {
        let yaw_of = |n: usize| n as f64 * 360.0 / DIRECTIONS as f64;
        let far: Vec<f64> = (0..DIRECTIONS).map(|n| self.view_m(place, yaw_of(n))).collect();
        let around = |n: usize| {
            let at = |off: usize| far[(n + DIRECTIONS + off - 2) % DIRECTIONS];
            at(0).min(at(4)) + at(1).min(at(3)) + at(2)
        };
        let best = (0..DIRECTIONS).rev().max_by(|a, b| around(*a).total_cmp(&around(*b))).unwrap_or(0);
        (yaw_of(best) + 180.0).rem_euclid(360.0) - 180.0
    }

    /// The plan with cells `factor` times as long. Walls win, then solids, then the highest value,
    /// so that lines stay visible.
    #[must_use]
    pub fn coarser(&self, factor: u32) -> Self {
        let factor = factor.max(1);
        let size = self.size.map(|n| n.div_ceil(factor));
        let rank = |v: u8| match v {
            WALL => 300,
            SOLID => 299,
            v => i32::from(v),
        };
        let mut cells = vec![OPEN; size[0] as usize * size[1] as usize];
        for (row, k) in self.cells.chunks_exact(self.size[0] as usize).zip(0..) {
            let out = &mut cells[(k / factor * size[0]) as usize..][..size[0] as usize];
            for (part, out) in row.chunks(factor as usize).zip(out) {
                *out = part.iter().copied().fold(*out, |a, b| if rank(b) > rank(a) { b } else { a });
            }
        }
        Self { pitch_m: self.pitch_m * f64::from(factor), size, cells, ..*self }
    }

    /// The part of the raster that holds anything, metres: `[x0, z0, x1, z1]`.
    pub fn content(&self) -> [f64; 4] {
        let (mut low, mut high) = ([u32::MAX; 2], [0; 2]);
        for (n, _) in (0u32..).zip(&self.cells).filter(|(_, v)| **v != OPEN) {
            for (axis, at) in [n % self.size[0], n / self.size[0]].into_iter().enumerate() {
                (low[axis], high[axis]) = (low[axis].min(at), high[axis].max(at + 1));
            }
        }
        if low[0] > high[0] {
            return self.area();
        }
        let at = |n: u32, axis: usize| self.corner[axis] + f64::from(n) * self.pitch_m;
        [at(low[0], 0), at(low[1], 1), at(high[0], 0), at(high[1], 1)]
    }

    /// Distance of the contour lines of a relief, metres.
    pub fn contour_m(&self) -> f64 {
        let highest = self.cells.iter().copied().max().unwrap_or(0).saturating_sub(FLOOR);
        let range_m = f64::from(highest) * self.step_m;
        let wanted = (range_m / MOST_CONTOURS).max(0.1);
        let power = 10f64.powf(wanted.log10().floor());
        [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|m| *m >= wanted).unwrap_or(wanted)
    }

    /// Colours of the cells, row by row: sRGB and opacity.
    pub fn picture(&self) -> Vec<[u8; 4]> {
        let width = self.size[0] as usize;
        let contour = self.contour_m();
        let highest = f64::from(self.cells.iter().copied().max().unwrap_or(0).saturating_sub(FLOOR).max(1));
        let height_m = |v: u8| f64::from(v - FLOOR) * self.step_m;
        let mix = |a: [f64; 3], b: [f64; 3], t: f64| {
            let [r, g, b] = [0, 1, 2].map(|c| (a[c] + (b[c] - a[c]) * t).round() as u8);
            [r, g, b, 255]
        };
        let colour = |n: usize, v: u8| match v {
            OPEN => [0, 0, 0, 0],
            WALL => [33, 40, 48, 255],
            SOLID => [84, 94, 105, 255],
            CLOSED => [188, 194, 199, 255],
            v if self.relief => {
                let line = |o: Option<usize>| {
                    let other = o.and_then(|o| self.cells.get(o)).filter(|o| **o >= FLOOR);
                    other.is_some_and(|o| (height_m(*o) / contour).floor() != (height_m(v) / contour).floor())
                };
                let tone = f64::from(v - FLOOR) / highest;
                match line((n % width + 1 < width).then_some(n + 1)) || line(Some(n + width)) {
                    true => [150, 132, 100, 255],
                    false if tone < 0.5 => mix([205.0, 224.0, 196.0], [240.0, 236.0, 208.0], tone * 2.0),
                    false => mix([240.0, 236.0, 208.0], [226.0, 204.0, 174.0], tone * 2.0 - 1.0),
                }
            }
            // Floors beside the storey's own, as on stairs, are darker the farther off they are.
            v => {
                let off_m = (self.ground_m + height_m(v) - self.floor_m).abs();
                let tone = ((off_m - 0.3) / 3.0).clamp(0.0, 1.0);
                mix([250.0, 248.0, 242.0], [170.0, 190.0, 206.0], tone)
            }
        };
        self.cells.iter().enumerate().map(|(n, v)| colour(n, *v)).collect()
    }

    /// Whether a box, such as that of a room, is cut by the section.
    pub fn cuts(&self, b: &Aabb) -> bool {
        self.relief || (b.min.y < self.floor_m + SECTION_M && self.floor_m + SECTION_M < b.max.y)
    }
}

/// Height of the section above the floor, metres: it meets walls, doors and windows and passes
/// above tables and seats.
pub const SECTION_M: f64 = 1.2;

/// Number of cells of a raster; None if a side is out of range.
pub(crate) fn cell_count(size: [u32; 2]) -> Option<usize> {
    let fits = size.iter().all(|n| (1..=MAX_SIDE).contains(n));
    fits.then(|| size[0] as usize * size[1] as usize).filter(|n| *n <= MAX_CELLS)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A hall of 8 x 4 m with a wall along x = 3 that leaves a gap of a metre at its upper end.
    pub(crate) fn hall() -> FloorPlan {
        let [w, h] = [80u32, 40];
        let cells = (0..w * h)
            .map(|n| {
                let (i, k) = (n % w, n / w);
                let rim = i == 0 || k == 0 || i == w - 1 || k == h - 1;
                if rim || (i == 30 && k >= 10) { WALL } else { FLOOR }
            })
            .collect();
        FloorPlan {
            floor_m: 0.0,
            ground_m: 0.0,
            step_m: 0.25,
            corner: [10.0, -2.0],
            pitch_m: 0.1,
            size: [w, h],
            relief: false,
            cells,
        }
    }

    #[test]
    fn a_place_keeps_clear_of_walls_and_is_near() {
        let plan = hall();
        let near = |x, z, reach_m| plan.place_near([x, z], reach_m, 0.3, |_| true);
        assert_eq!(near(11.0, 0.0, 1.0), Some([11.0, 0.0]));
        let [x, z] = near(13.05, 1.0, 1.0).expect("a place beside the wall");
        assert!((x - 13.05).hypot(z - 1.0) < 0.55 && (x - 13.05).abs() > 0.3, "{x} {z}");
        assert_eq!(near(8.0, 0.0, 1.0), None);
        assert!(near(8.0, 0.0, 3.0).is_some());
        assert_eq!(plan.place_near([11.0, 0.0], 5.0, 0.3, |_| false), None);
    }

    #[test]
    fn the_open_direction_is_the_longest_view() {
        let plan = hall();
        // Right of the wall the hall goes on to +X, yaw -90, and farthest into its corners.
        assert!((plan.open_yaw_deg([13.5, 0.5]) + 90.0).abs() < 40.0);
        // Left of it, below the gap, the longest views lead along the wall or through the gap.
        assert!(plan.view_m([11.0, 0.0], -90.0) < 2.0 && plan.view_m([11.0, -1.5], -90.0) > 6.0);
        assert!((plan.view_m([17.0, 0.0], 90.0) - 3.9).abs() < 0.11);
    }

    #[test]
    fn rules_are_checked_and_colours_tell_walls_from_floors() {
        let plan = hall();
        assert_eq!(plan.check(), Ok(()));
        let broken: [fn(&mut FloorPlan); 5] = [
            |p| p.pitch_m = 0.0,
            |p| p.step_m = f64::NAN,
            |p| p.size = [81, 40],
            |p| p.size = [0, 40],
            |p| p.size = [MAX_SIDE + 1, 1],
        ];
        for spoil in broken {
            let mut plan = hall();
            spoil(&mut plan);
            assert!(plan.check().is_err(), "{plan:?}");
        }
        let picture = plan.picture();
        assert!(picture[0][..3].iter().all(|c| *c < 60) && picture[81][..3].iter().all(|c| *c > 200));
    }

    #[test]
    fn a_coarser_plan_keeps_its_walls() {
        let plan = hall();
        let coarse = plan.coarser(7);
        assert_eq!((coarse.size, coarse.check()), ([12, 6], Ok(())));
        for k in 0..40u32 {
            for i in 0..80u32 {
                let (fine, coarse) = (plan.value([i, k]), coarse.value([i / 7, k / 7]));
                assert!(fine != WALL || coarse == WALL, "{i} {k}");
            }
        }
        assert_eq!(coarse.value([2, 2]), FLOOR);
        assert_eq!(plan.content(), plan.area());
    }

    #[test]
    fn a_relief_has_contours_at_round_heights() {
        let mut plan = hall();
        plan.relief = true;
        plan.cells = (0..80 * 40).map(|n| FLOOR + (n % 80) as u8).collect();
        assert_eq!(plan.contour_m(), 2.0);
        let picture = plan.picture();
        let lines = picture[..80].iter().filter(|c| **c == [150, 132, 100, 255]).count();
        assert_eq!(lines, 9, "heights from 0 to 19.75 m");
    }
}
