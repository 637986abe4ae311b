//! What is seen from a room beside all portals, as rays find it: such cells of the octree are drawn with the room, too.
//!
//! In: rooms, a caster, and which cells lie in which room by their triangles ([`super::members`]). Out: the cells to add. Borders of rooms run in the middle of what the raster cannot see through:
//! of walls, of cupboards as high as a person, of the niches below windows. Part of a surface behind such a border is seen from before it, and its triangles may lie in the room behind alone.
//!
//! Every ray goes through the portals as culling does, from all rooms of its eye through every portal that it passes. If the surface it ends at is drawn with none of the rooms on
//! its way, it is added to the last of them before the surface. Sampling proves nothing of surfaces that no ray met; `ldi-server rooms --check` counts with other rays what is left.

use super::check::random_poses;
use super::leaks::Random;
use crate::render::{Caster, CellSet, Hit, Ray};
use glam::DVec3;
use ldi_protocol::rooms::{CellId, Rooms};
use rayon::prelude::*;

/// Eyes per m² of the rooms' boxes, within bounds. More: rarer places are found, and planning takes longer: the clinic, at the upper bound, some ten seconds. With a third of them bleach kept
/// seven poses of 100,000 with something left out instead of four.
const EYES_PER_M2: f64 = 100.0;
/// See [`EYES_PER_M2`].
const EYES: [f64; 2] = [1_000.0, 200_000.0];
/// Rays per eye, in all directions: some 18 degrees apart.
const RAYS: usize = 128;
/// Not that of any check.
const SEED: u64 = 0x5ee;

/// Pairs of a cell of the octree and a room that sees it beside all portals, sorted, each once. `lies_in`: whether a cell lies in a room.
pub(super) fn seen_beside(
    caster: &Caster,
    rooms: &Rooms,
    lies_in: &(dyn Fn(u32, CellId) -> bool + Sync),
) -> Vec<(u32, CellId)> {
    let area_m2: f64 = rooms.cells().iter().flat_map(|c| &c.boxes).map(|b| b.size().x * b.size().z).sum();
    let eyes = random_poses(caster, rooms, (area_m2 * EYES_PER_M2).clamp(EYES[0], EYES[1]) as usize, SEED);
    let of_eye = |(n, eye): (usize, &DVec3)| {
        let mut random = Random(SEED.wrapping_add(n as u64).wrapping_mul(0x2545_f491_4f6c_dd1d));
        let start = rooms.cells_near(*eye, rooms.margin_m());
        let rays: Vec<Ray> = (0..RAYS)
            .map(|_| {
                let (up, angle) = (2.0 * random.unit() - 1.0, std::f64::consts::TAU * random.unit());
                let around = (1.0f64 - up * up).sqrt();
                Ray::new(*eye, DVec3::new(angle.cos() * around, up, angle.sin() * around))
            })
            .collect();
        let mut hits = vec![None; RAYS];
        caster.trace_batch(&rays, &CellSet::all(), &mut hits);
        let beside = |(ray, hit): (&Ray, &Option<Hit>)| {
            let hit = (*hit)?;
            let cell = caster.cell_of(hit.triangle);
            last_before(rooms, &start, ray, hit.t, &|room| lies_in(cell, room)).map(|room| (cell, room))
        };
        rays.iter().zip(&hits).filter_map(beside).collect::<Vec<_>>()
    };
    let eyes: Vec<DVec3> = eyes.into_iter().map(|p| p.position).collect();
    let mut found: Vec<(u32, CellId)> = eyes.par_iter().enumerate().flat_map_iter(of_eye).collect();
    found.sort_unstable();
    found.dedup();
    found
}

/// The last room that a ray enters before `t`; None if some room on its way, before or after, draws what it hits.
fn last_before(rooms: &Rooms, start: &[CellId], ray: &Ray, t: f64, draws: &dyn Fn(CellId) -> bool) -> Option<CellId> {
    let mut on_way: Vec<(f64, CellId)> = start.iter().map(|room| (0.0, *room)).collect();
    let (mut at, mut last) = (0, (0.0, *start.first()?));
    while let Some(&(from, room)) = on_way.get(at) {
        if draws(room) {
            return None;
        }
        if from >= last.0 && from <= t {
            last = (from, room);
        }
        for number in rooms.portals_of(room) {
            let portal = &rooms.portals()[*number as usize];
            let side = usize::from(portal.cells[0] != room);
            let beyond = portal.cells[1 - side];
            let entered = || portal.crossed(side, ray.origin, ray.direction).filter(|t| *t > from);
            if on_way.iter().all(|(_, r)| *r != beyond)
                && let Some(t) = entered()
            {
                on_way.push((t, beyond));
            }
        }
        at += 1;
    }
    Some(last.1)
}

#[cfg(test)]
mod tests {
    use super::super::cells_of_rooms;
    use super::*;
    use crate::octree::{Clusters, Octree};
    use crate::placement::test_scenes::{block, scene_of};
    use ldi_protocol::Aabb;
    use ldi_protocol::rooms::Cell;
    use std::sync::Arc;

    #[test]
    fn a_wall_above_a_cupboard_is_drawn_with_the_room_before_it() {
        let of = |a: [f64; 3], b: [f64; 3]| Aabb { min: DVec3::from(a), max: DVec3::from(b) };
        // Two rooms of 2.8 m; before the wall between them a cupboard of 2.2 m, in the middle of which their border runs.
        let boxes = [
            of([-0.2, -0.2, -0.2], [10.2, 0.0, 4.2]),
            of([-0.2, 2.8, -0.2], [10.2, 3.0, 4.2]),
            of([-0.2, 0.0, -0.2], [10.2, 2.8, 0.0]),
            of([-0.2, 0.0, 4.0], [10.2, 2.8, 4.2]),
            of([-0.2, 0.0, 0.0], [0.0, 2.8, 4.0]),
            of([10.0, 0.0, 0.0], [10.2, 2.8, 4.0]),
            of([5.0, 0.0, 0.0], [5.2, 2.8, 4.0]),
            of([4.2, 0.0, 0.0], [4.99, 2.2, 4.0]),
        ];
        let scene = Arc::new(scene_of(&boxes.each_ref().map(block)));
        let clusters = Clusters::build(&scene);
        let octree = Octree::build(&scene, &clusters, 1);
        let caster = Caster::new(scene, &clusters, &octree);
        let room =
            |name: &str, x: [f64; 2]| Cell { name: name.into(), boxes: vec![of([x[0], -0.1, -0.1], [x[1], 2.9, 4.1])] };
        let rooms = Rooms::new(0.15, vec![room("west", [-0.1, 4.7]), room("east", [4.7, 10.1])], vec![]).unwrap();
        let up = Ray::new(DVec3::new(2.0, 1.6, 2.0), DVec3::new(3.0, 0.9, 0.0));
        let hit = caster.trace(&up, &CellSet::all()).expect("a wall");
        assert!((up.at(hit.t).x - 5.0).abs() < 1e-6, "above the cupboard: {}", up.at(hit.t));
        let wall = caster.cell_of(hit.triangle);
        let pairs = seen_beside(&caster, &rooms, &|cell, room| cell != wall || room == Some(1));
        assert_eq!(pairs, [(wall, Some(0))], "seen from the west, and nothing else is");
        let [west, east, _] = &cells_of_rooms(&caster, &rooms, octree.cells.len())[..] else { panic!("three") };
        assert!(west.contains(&wall) && east.contains(&wall));
    }
}
