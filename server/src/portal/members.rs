//! Which cells of the octree lie in which room.
//!
//! In: rooms, a caster over a scene. Out: per room, and last for the outside, the cells that are
//! drawn with it. What may be seen from within a room of what stands in that room is in one of its
//! cells:
//! - A triangle lies in every room that its box touches, and outside if its box is not covered by
//!   rooms' boxes.
//! - Borders of rooms may be off by the rooms' margin. So a triangle also lies in each room within
//!   the margin of one of its corners or its middle, along an axis, if no surface of another
//!   object is between: a wall's face that the raster put on the wrong side is free toward its
//!   room, the bookcase behind it is not.
//!
//! A cell lies in the rooms of its triangles, and in those from which rays see it beside all
//! portals ([`super::seen`]).

use super::seen::seen_beside;
use crate::render::{Caster, CellSet, Ray};
use glam::DVec3;
use ldi_protocol::Aabb;
use ldi_protocol::rooms::{CellId, Rooms};
use rayon::prelude::*;

/// Pieces thinner than this are no part that sticks out, metres: boxes that touch are computed in
/// different ways.
const SLACK_M: f64 = 1e-4;
/// Pieces of a box that are looked at before it counts as sticking out. More would be exacter in
/// rooms of hundreds of boxes; it is not needed for correctness.
const MOST_PIECES: usize = 2_000;
/// Surfaces of the same object that a probe passes: the two faces of a board and some more.
const MOST_PASSED: usize = 8;

/// Per room the cells that lie in it, ascending; the outside's come last.
pub fn cells_of_rooms(caster: &Caster, rooms: &Rooms, cells: usize) -> Vec<Vec<u32>> {
    let mut of_cell: Vec<Vec<u32>> = vec![Vec::new(); cells];
    for t in 0..caster.triangle_count() {
        of_cell[caster.cell_of(t) as usize].push(t);
    }
    let bounds: Vec<Aabb> = rooms.cells().iter().map(|c| c.bounds()).collect();
    let members = Members { caster, rooms };
    let found: Vec<Vec<usize>> = of_cell.par_iter().map(|triangles| members.rooms_of(triangles, &bounds)).collect();
    let slot = |room: CellId| room.map_or(rooms.cells().len(), |r| r as usize);
    let seen = seen_beside(caster, rooms, &|cell, room| found[cell as usize].contains(&slot(room)));
    let mut out = vec![Vec::new(); rooms.cells().len() + 1];
    for (cell, of) in (0u32..).zip(found) {
        of.into_iter().for_each(|room| out[room].push(cell));
    }
    seen.into_iter().for_each(|(cell, room)| out[slot(room)].push(cell));
    out.iter_mut().for_each(|cells| cells.sort_unstable());
    out
}

struct Members<'a> {
    caster: &'a Caster,
    rooms: &'a Rooms,
}

impl Members<'_> {
    /// Rooms of some triangles; the number after the last room is the outside.
    fn rooms_of(&self, triangles: &[u32], bounds: &[Aabb]) -> Vec<usize> {
        let outside = bounds.len();
        let margin = self.rooms.margin_m();
        let corners: Vec<[DVec3; 3]> = triangles.iter().map(|t| self.caster.corners_world(*t)).collect();
        let all = Aabb::from_points(corners.iter().flatten().copied());
        let around = all.inflated(margin);
        // Boxes of rooms that matter, by room.
        let near: Vec<(usize, Aabb)> = (0..outside)
            .filter(|r| bounds[*r].intersects(&around))
            .flat_map(|r| self.rooms.cells()[r].boxes.iter().map(move |b| (r, *b)))
            .filter(|(_, b)| b.intersects(&around))
            .collect();
        let boxes: Vec<Aabb> = near.iter().map(|(_, b)| *b).collect();
        let mut candidates: Vec<usize> = near.iter().map(|(r, _)| *r).collect();
        candidates.dedup();
        if !is_covered(&around, &boxes) {
            candidates.push(outside);
        }
        if candidates.len() <= 1 {
            return candidates;
        }
        let mut held = vec![false; outside + 1];
        for (triangle, corners) in triangles.iter().zip(&corners) {
            if candidates.iter().all(|r| held[*r]) {
                break;
            }
            let b = Aabb::from_points(corners.iter().copied());
            near.iter().filter(|(_, o)| o.intersects(&b)).for_each(|(r, _)| held[*r] = true);
            held[outside] = held[outside] || !is_covered(&b, &boxes);
            let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
            let inner = corners.map(|c| c.lerp(middle, 0.05));
            for from in inner.into_iter().chain([middle]) {
                for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                    for toward in [axis, -axis] {
                        let to = from + toward * margin;
                        let room = near.iter().find(|(_, o)| o.contains(to)).map_or(outside, |(r, _)| *r);
                        if !held[room] && self.is_free(*triangle, from, toward * margin) {
                            held[room] = true;
                        }
                    }
                }
            }
        }
        candidates.retain(|r| held[*r]);
        candidates
    }

    /// Whether nothing but the triangle's own object lies on a way.
    fn is_free(&self, triangle: u32, from: DVec3, way: DVec3) -> bool {
        let own = self.caster.source(triangle);
        // From a little behind the surface, so that what lies in one plane with it is met.
        let behind = way.normalize_or_zero() * 0.01;
        let mut ray = Ray { origin: from - behind, direction: way + behind, t_min: 0.0, t_max: 1.0 };
        for _ in 0..MOST_PASSED {
            let Some(hit) = self.caster.trace(&ray, &CellSet::all()) else { return true };
            let met = self.caster.source(hit.triangle);
            if met.instance != own.instance {
                return false;
            }
            ray.t_min = hit.t + 1e-6;
        }
        true
    }
}

/// Whether boxes together cover a box.
fn is_covered(b: &Aabb, boxes: &[Aabb]) -> bool {
    let mut open = vec![(*b, 0usize)];
    let mut looked_at = 0;
    while let Some((piece, from)) = open.pop() {
        looked_at += 1;
        let next = (from..boxes.len()).find(|i| boxes[*i].intersects(&piece));
        let Some(at) = next.filter(|_| looked_at <= MOST_PIECES) else { return false };
        let (o, mut rest) = (boxes[at], piece);
        for axis in 0..3 {
            if o.min[axis] - rest.min[axis] > SLACK_M {
                let mut below = rest;
                below.max[axis] = o.min[axis];
                open.push((below, at + 1));
            }
            rest.min[axis] = rest.min[axis].max(o.min[axis]);
            if rest.max[axis] - o.max[axis] > SLACK_M {
                let mut above = rest;
                above.min[axis] = o.max[axis];
                open.push((above, at + 1));
            }
            rest.max[axis] = rest.max[axis].min(o.max[axis]);
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn unit_box(at: [u8; 3], size: [u8; 3]) -> Aabb {
        let min = DVec3::from_array(at.map(f64::from));
        Aabb { min, max: min + DVec3::from_array(size.map(f64::from)) }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(500))]
        /// Boxes on a grid of units: brute force over the units.
        #[test]
        fn a_box_is_covered_if_each_of_its_units_is(
            boxes in prop::collection::vec((prop::array::uniform3(0u8..5), prop::array::uniform3(1u8..5)), 0..12),
            at in prop::array::uniform3(0u8..5),
            size in prop::array::uniform3(1u8..4),
        ) {
            let boxes: Vec<Aabb> = boxes.into_iter().map(|(a, s)| unit_box(a, s)).collect();
            let b = unit_box(at, size);
            let mut all = true;
            for x in 0..size[0] { for y in 0..size[1] { for z in 0..size[2] {
                let middle = b.min + DVec3::new(f64::from(x), f64::from(y), f64::from(z)) + 0.5;
                all &= boxes.iter().any(|o| o.contains(middle));
            }}}
            prop_assert_eq!(is_covered(&b, &boxes), all);
        }
    }
}
