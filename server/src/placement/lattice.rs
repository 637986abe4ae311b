//! The solution grid (Aliaga and Lastra 1999, sections 3.2 and 3.2.2; rows A2 and A4).
//!
//! In: the model's bounds. Out: points on an integer lattice, each with its level. Level 0 is a
//! cubic grid of spacing r0 with at least three points along each axis, inflated by two points on
//! each of the six sides. Subdivision alternates:
//!
//! ```text
//!   even point, level 2k, spacing r:    itself, 6 at r/2 along the axes, 8 at r/2 along all three     -> 15 points, level 2k+1
//!   odd point, level 2k+1:              itself and the 12 at two half steps                           -> 13 points, level 2k+2
//! ```
//!
//! What we changed. The 12 complementary points are new only around points whose coordinates are
//! all even in half steps; around the points added by an odd level they fall on points that exist.
//! There the missing points of the denser grid lie one half step away (four around an edge's
//! middle, six around a cube's centre), and they are added too: otherwise subdividing such a point
//! would change nothing and refinement would not end.

use glam::{DVec3, I64Vec3};
use ldi_protocol::Aabb;
use std::collections::BTreeMap;

/// Deepest level. Level 2k has spacing r0 / 2^k, so coordinates are counted in r0 / 2^(DEEPEST /
/// 2).
pub(super) const DEEPEST: u8 = 20;
/// Units of the lattice per r0.
const UNITS: i64 = 1 << (DEEPEST / 2);

/// A grid point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct LatticePoint {
    /// Place, in units of r0 / 2^(DEEPEST / 2) from the origin.
    pub place: I64Vec3,
    /// Level.
    pub level: u8,
}

/// The grid.
#[derive(Debug, Clone)]
pub(super) struct Lattice {
    origin: DVec3,
    /// Spacing r0 of level 0, metres.
    pub spacing_m: f64,
    /// In the order of creation; positions never change.
    pub points: Vec<LatticePoint>,
    at: BTreeMap<[i64; 3], u32>,
}

impl Lattice {
    /// Level 0: spans `model` with spacing `spacing_m`, at least 3 x 3 x 3 points centred on it,
    /// and two more on each side.
    pub fn new(model: &Aabb, spacing_m: f64) -> Self {
        let size = model.size();
        let count = size.to_array().map(|s| ((s / spacing_m).ceil() as i64 + 1).max(3));
        let span = DVec3::from_array(count.map(|n| (n - 1) as f64 * spacing_m));
        let mut lattice =
            Self { origin: model.centre() - span * 0.5, spacing_m, points: Vec::new(), at: BTreeMap::new() };
        for x in -2..count[0] + 2 {
            for y in -2..count[1] + 2 {
                for z in -2..count[2] + 2 {
                    lattice.raise(I64Vec3::new(x, y, z) * UNITS, 0);
                }
            }
        }
        lattice
    }

    /// World position of a point.
    pub fn position(&self, point: usize) -> DVec3 {
        self.origin + self.points[point].place.as_dvec3() * (self.spacing_m / UNITS as f64)
    }

    /// Distance between neighbours of a level, metres: r0 / 2^k at level 2k, and the half step r0
    /// / 2^(k+1) at level 2k + 1.
    pub fn spacing_of(&self, level: u8) -> f64 {
        self.spacing_m / f64::from(1u32 << level.div_ceil(2))
    }

    /// The paper's star-shape radius: spheres of diameter 4 r at even, 6 r at odd levels.
    pub fn paper_radius(&self, level: u8) -> f64 {
        self.spacing_of(level) * if level.is_multiple_of(2) { 2.0 } else { 3.0 }
    }

    /// Creates a point, or raises it to a level.
    fn raise(&mut self, place: I64Vec3, level: u8) -> u32 {
        let next = self.points.len() as u32;
        let at = *self.at.entry(place.to_array()).or_insert(next);
        if at == next {
            self.points.push(LatticePoint { place, level });
        } else {
            let p = &mut self.points[at as usize];
            p.level = p.level.max(level);
        }
        at
    }

    /// Subdivides a point by one level; then, if `graded`, its neighbours as the neighbour rule
    /// asks, which reverse frusta need and view cells do not. False: at the deepest level already.
    pub fn subdivide(&mut self, point: u32, graded: bool) -> bool {
        if self.points[point as usize].level >= DEEPEST {
            return false;
        }
        let mut touched = self.split(point);
        if !graded {
            return true;
        }
        while let Some(p) = touched.pop() {
            for q in self.too_coarse_beside(p) {
                touched.extend(self.split(q));
                touched.push(p);
            }
        }
        true
    }

    /// The points that a subdivision of `point` makes or raises.
    fn split(&mut self, point: u32) -> Vec<u32> {
        let LatticePoint { place, level } = self.points[point as usize];
        let half = half_step(level);
        let mut places = vec![place];
        if level.is_multiple_of(2) {
            places.extend(OFFSETS.iter().filter(|o| o.abs().element_sum() != 2).map(|o| place + *o * half));
        } else {
            places.extend(OFFSETS.iter().filter(|o| o.abs().element_sum() == 2).map(|o| place + *o * half));
            let odd = |o: I64Vec3| (place + o * half).to_array().iter().filter(|c| (*c / half) % 2 != 0).count();
            if odd(I64Vec3::ZERO) != 0 {
                let missing = OFFSETS.iter().filter(|o| o.abs().element_sum() == 1 && odd(**o) == 2);
                places.extend(missing.map(|o| place + *o * half));
            }
        }
        places.into_iter().map(|p| self.raise(p, level + 1)).collect()
    }

    /// Neighbours of a point that are more than one level coarser, coarsest first.
    fn too_coarse_beside(&self, point: u32) -> Vec<u32> {
        let LatticePoint { place, level } = self.points[point as usize];
        let mut out = Vec::new();
        for coarse in 0..level.saturating_sub(1) {
            let reach = reach(coarse);
            let step = half_step(coarse) * if coarse.is_multiple_of(2) { 2 } else { 1 };
            let low = (place - reach).to_array().map(|c| c.div_euclid(step) * step);
            let along = |a: usize| (low[a]..=place[a] + reach).step_by(step as usize);
            for x in along(0) {
                for y in along(1) {
                    for z in along(2) {
                        let Some(&q) = self.at.get(&[x, y, z]) else { continue };
                        let near = (I64Vec3::new(x, y, z) - place).abs().max_element() <= reach;
                        if near && self.points[q as usize].level == coarse {
                            out.push(q);
                        }
                    }
                }
            }
        }
        out
    }

    /// Checks the neighbour rule: points within a coarse point's spacing are at most one level
    /// finer.
    #[cfg(test)]
    pub fn check(&self) {
        for (i, p) in self.points.iter().enumerate() {
            assert_eq!(self.at[&p.place.to_array()], i as u32);
            for q in &self.points {
                let near = (p.place - q.place).abs().max_element() <= reach(q.level);
                assert!(!near || p.level <= q.level + 1, "{p:?} beside {q:?}");
            }
        }
    }
}

/// Half the spacing of the even level that `level` belongs to, in units.
fn half_step(level: u8) -> i64 {
    (UNITS >> (level / 2)) / 2
}

/// How far the neighbourhood of a point of this level reaches, in units: its spacing.
fn reach(level: u8) -> i64 {
    UNITS >> level.div_ceil(2)
}

/// The 26 neighbours.
static OFFSETS: std::sync::LazyLock<Vec<I64Vec3>> = std::sync::LazyLock::new(|| {
    (0..27i64).filter(|i| *i != 13).map(|i| I64Vec3::new(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1)).collect()
});

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cube() -> Lattice {
        Lattice::new(&Aabb { min: DVec3::ZERO, max: DVec3::splat(2.0) }, 1.0)
    }

    #[test]
    fn level_0_is_three_cubed_inflated_by_two() {
        let l = cube();
        assert_eq!(l.points.len(), 7 * 7 * 7);
        let flat = Lattice::new(&Aabb { min: DVec3::ZERO, max: DVec3::new(8.0, 0.1, 4.0) }, 4.0);
        assert_eq!(flat.points.len(), 7 * 7 * 7, "three points along the flat axes too");
        let b = Aabb::from_points((0..flat.points.len()).map(|i| flat.position(i)));
        assert!(b.contains(DVec3::splat(-8.0).with_x(-8.0)) && b.size() == DVec3::splat(24.0));
    }

    #[test]
    fn even_gives_15_and_odd_gives_13() {
        let mut l = cube();
        let centre = l.at[&[UNITS, UNITS, UNITS]];
        let before = l.points.len();
        let made = l.split(centre);
        assert_eq!((made.len(), l.points.len() - before), (15, 14), "the centre exists already");
        assert_eq!(l.split(centre).len(), 13);
    }

    #[test]
    fn two_levels_return_to_the_denser_cubic_grid() {
        // Subdivide everything twice: inside, all points of the grid of half spacing exist, all at
        // level 2.
        let mut l = cube();
        for level in 0..2 {
            for p in 0..l.points.len() as u32 {
                if l.points[p as usize].level == level {
                    l.subdivide(p, true);
                }
            }
        }
        for i in 0..27i64 {
            let place = I64Vec3::new(i % 3, i / 3 % 3, i / 9) * (UNITS / 2) + UNITS;
            let at = l.at.get(&place.to_array()).expect("a point of the denser grid");
            assert_eq!(l.points[*at as usize].level, 2);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn neighbours_differ_by_at_most_one_level(picks in prop::collection::vec(any::<prop::sample::Index>(), 1..6)) {
            let mut l = Lattice::new(&Aabb { min: DVec3::ZERO, max: DVec3::splat(2.0) }, 1.0);
            for pick in picks {
                let mut p = pick.index(l.points.len()) as u32;
                // Keep going down near the same place, to force a steep gradient.
                for _ in 0..3 {
                    prop_assert!(l.subdivide(p, true));
                    p = (p + 1) % l.points.len() as u32;
                }
            }
            l.check();
        }
    }
}
