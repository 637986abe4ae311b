//! What is seen from a room beside all portals, as rays find it: such cells of the octree are drawn with the room, too.
//!
//! In: rooms, a caster, and which cells lie in which room by their triangles ([`super::members`]). Out: the cells to add. Borders of rooms run in the middle of what the raster cannot see through:
//! of walls, of cupboards as high as a person, of the niches below windows. Part of a surface behind such a border is seen from before it, and its triangles may lie in the room behind alone.
//!
//! Every ray goes through the portals as culling does, from all rooms of its eye through every portal that it passes. If the surface it ends at is drawn with none of the rooms on
//! its way, it is added to the last of them before the surface. Where one is found there are mostly more: rays from around its eye to around what it saw look for them, and from around those
//! again (adaptive border sampling of Wonka et al., Guided Visibility Sampling, 2006, with random rays). Sampling proves nothing of surfaces that no ray met; `ldi-server rooms --check` counts
//! with other rays what is left.

use super::check::{is_clear, random_poses};
use super::leaks::Random;
use super::storeys::is_free;
use crate::render::{Caster, CellSet, Hit, Ray};
use glam::DVec3;
use ldi_protocol::Pose;
use ldi_protocol::rooms::{CellId, Rooms};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Eyes per m² of the rooms' boxes, within bounds. More: rarer places are found, and planning takes longer: the clinic, at the upper bound, some twenty seconds. With half of them, and twice the
/// rays, one place in willow_garage's cavities was not found.
const EYES_PER_M2: f64 = 200.0;
/// See [`EYES_PER_M2`].
const EYES: [f64; 2] = [1_000.0, 400_000.0];
/// Bundles of rays per eye, in random directions; each takes a packet of the caster, which costs less than as many single rays.
const BUNDLES: usize = 4;
/// Rays along a side of a bundle, and the angle between neighbours as its tangent: 1.5 degrees. Less: bundles see the same twice
/// where what shows is wide; more: they are no packets any more.
const BUNDLE: (u32, f64) = (8, 0.026);
/// Eyes around one that saw a cell beside all portals, and rays from each.
const LOOK_BESIDE: (usize, usize) = (32, 32);
/// So many of a pair's sights are looked beside of: it may be seen through several slits.
const SIGHTS_PER_PAIR: usize = 8;
/// Most rounds of looking beside; on the clinic and bleach, of which eight in ten pairs are found so, the last bring next to nothing.
const ROUNDS: usize = 12;
/// How far beside, at most: eyes, metres, and what they see, as a share of its distance.
const BESIDE: (f64, f64) = (1.0, 0.5);
/// How far at least, as a share of that: what is there may be a slit or a wall, so all scales between are alike.
const CLOSEST: f64 = 0.01;
/// Eyes stay at the heights of eyes.
const FLAT: DVec3 = DVec3::new(1.0, 0.25, 1.0);
/// Not that of any check.
const SEED: u64 = 0x5ee;

/// Where a cell was seen beside all portals.
#[derive(Debug, Clone, Copy)]
struct Sight {
    /// The cell of the octree, and the room that sees it.
    pair: (u32, CellId),
    eye: DVec3,
    surface: DVec3,
}

/// Pairs of a cell of the octree and a room that sees it beside all portals, sorted, each once. `lies_in`: whether a cell lies in a room.
pub(super) fn seen_beside(
    caster: &Caster,
    rooms: &Rooms,
    lies_in: &(dyn Fn(u32, CellId) -> bool + Sync),
) -> Vec<(u32, CellId)> {
    let area_m2: f64 = rooms.cells().iter().flat_map(|c| &c.boxes).map(|b| b.size().x * b.size().z).sum();
    let eyes = random_poses(caster, rooms, (area_m2 * EYES_PER_M2).clamp(EYES[0], EYES[1]) as usize, SEED);
    let all_around = |(n, pose): (usize, &Pose)| {
        let mut random = random_of(n as u64);
        let rays: Vec<Ray> = (0..BUNDLES).flat_map(|_| bundle(pose.position, random.direction())).collect();
        sights(caster, rooms, lies_in, &rays)
    };
    let seen = eyes.par_iter().enumerate().flat_map_iter(all_around).collect();
    look_beside(caster, rooms, lies_in, seen).into_iter().collect()
}

/// The pairs of some sights, and of all that are found from around their eyes.
fn look_beside(
    caster: &Caster,
    rooms: &Rooms,
    lies_in: &(dyn Fn(u32, CellId) -> bool + Sync),
    mut seen: Vec<Sight>,
) -> BTreeSet<(u32, CellId)> {
    let mut sights_of: BTreeMap<(u32, CellId), usize> = BTreeMap::new();
    for round in 1..=ROUNDS as u64 {
        seen.retain(|sight| {
            let of_pair = sights_of.entry(sight.pair).or_default();
            *of_pair += 1;
            *of_pair <= SIGHTS_PER_PAIR
        });
        let beside = |(n, sight): (usize, &Sight)| {
            let mut random = random_of(round << 32 | n as u64);
            sights(caster, rooms, lies_in, &rays_beside(caster, sight, &mut random))
        };
        seen = seen.par_iter().enumerate().flat_map_iter(beside).collect();
    }
    sights_of.into_keys().chain(seen.into_iter().map(|sight| sight.pair)).collect()
}

/// Rays around a direction.
fn bundle(eye: DVec3, along: DVec3) -> impl Iterator<Item = Ray> {
    let (u, v) = along.any_orthonormal_pair();
    let (side, apart) = BUNDLE;
    let at = move |k: u32| (f64::from(k) - f64::from(side - 1) * 0.5) * apart;
    (0..side * side).map(move |k| Ray::new(eye, (along + u * at(k % side) + v * at(k / side)).normalize()))
}

/// Random numbers of one of many threads' tasks, the same whichever runs first.
fn random_of(task: u64) -> Random {
    Random(SEED.wrapping_add(task).wrapping_mul(0x2545_f491_4f6c_dd1d))
}

/// Rays from around an eye to around what it saw.
fn rays_beside(caster: &Caster, sight: &Sight, random: &mut Random) -> Vec<Ray> {
    let far = sight.eye.distance(sight.surface);
    let mut apart = |most: f64| random.direction() * most * CLOSEST.powf(random.unit());
    let mut rays = Vec::new();
    for _ in 0..LOOK_BESIDE.0 {
        let eye = sight.eye + apart(BESIDE.0) * FLAT;
        if is_free(caster, sight.eye, eye) && is_clear(caster, eye) {
            let surfaces = (0..LOOK_BESIDE.1).map(|_| sight.surface + apart(BESIDE.1 * far));
            rays.extend(surfaces.filter(|s| *s != eye).map(|s| Ray::new(eye, s - eye)));
        }
    }
    rays
}

/// What these rays see beside all portals.
fn sights(caster: &Caster, rooms: &Rooms, lies_in: &(dyn Fn(u32, CellId) -> bool + Sync), rays: &[Ray]) -> Vec<Sight> {
    let mut hits = vec![None; rays.len()];
    caster.trace_batch(rays, &CellSet::all(), &mut hits);
    // Rays come in groups from one eye.
    let (mut eye, mut start) = (DVec3::NAN, Vec::new());
    let beside = |(ray, hit): (&Ray, &Option<Hit>)| {
        let hit = (*hit)?;
        let cell = caster.cell_of(hit.triangle);
        if ray.origin != eye {
            (eye, start) = (ray.origin, rooms.cells_near(ray.origin, rooms.margin_m()));
        }
        let room = last_before(rooms, &start, ray, hit.t, &|room| lies_in(cell, room))?;
        Some(Sight { pair: (cell, room), eye: ray.origin, surface: ray.at(hit.t) })
    };
    rays.iter().zip(&hits).filter_map(beside).collect()
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

    fn of(a: [f64; 3], b: [f64; 3]) -> Aabb {
        Aabb { min: DVec3::from(a), max: DVec3::from(b) }
    }

    /// Two rooms of 2.8 m, west and east, and before the wall between them a cupboard of 2.2 m, in the middle of which their border runs. `walls`: what the wall consists of.
    fn two_rooms(walls: &[Aabb]) -> (Caster, Rooms, usize) {
        let mut boxes = vec![
            of([-0.2, -0.2, -0.2], [10.2, 0.0, 4.2]),
            of([-0.2, 2.8, -0.2], [10.2, 3.0, 4.2]),
            of([-0.2, 0.0, -0.2], [10.2, 2.8, 0.0]),
            of([-0.2, 0.0, 4.0], [10.2, 2.8, 4.2]),
            of([-0.2, 0.0, 0.0], [0.0, 2.8, 4.0]),
            of([10.0, 0.0, 0.0], [10.2, 2.8, 4.0]),
            of([4.2, 0.0, 0.0], [4.99, 2.2, 4.0]),
        ];
        boxes.extend(walls);
        let scene = Arc::new(scene_of(&boxes.iter().map(block).collect::<Vec<_>>()));
        let clusters = Clusters::build(&scene);
        let octree = Octree::build(&scene, &clusters, 1);
        let caster = Caster::new(scene, &clusters, &octree);
        let room =
            |name: &str, x: [f64; 2]| Cell { name: name.into(), boxes: vec![of([x[0], -0.1, -0.1], [x[1], 2.9, 4.1])] };
        let rooms = Rooms::new(0.15, vec![room("west", [-0.1, 4.7]), room("east", [4.7, 10.1])], vec![]).unwrap();
        (caster, rooms, octree.cells.len())
    }

    /// The cell of the wall that is seen there, above the cupboard, from the middle of the west.
    fn wall_at(caster: &Caster, up: f64, z: f64) -> Sight {
        let eye = DVec3::new(2.0, 1.6, 2.0);
        let ray = Ray::new(eye, DVec3::new(5.0, up, z) - eye);
        let hit = caster.trace(&ray, &CellSet::all()).expect("a wall");
        assert!((ray.at(hit.t).x - 5.0).abs() < 1e-6, "above the cupboard: {}", ray.at(hit.t));
        Sight { pair: (caster.cell_of(hit.triangle), Some(0)), eye, surface: ray.at(hit.t) }
    }

    #[test]
    fn a_wall_above_a_cupboard_is_drawn_with_the_room_before_it() {
        let (caster, rooms, cells) = two_rooms(&[of([5.0, 0.0, 0.0], [5.2, 2.8, 4.0])]);
        let (wall, _) = wall_at(&caster, 2.5, 2.0).pair;
        let pairs = seen_beside(&caster, &rooms, &|cell, room| cell != wall || room == Some(1));
        assert_eq!(pairs, [(wall, Some(0))], "seen from the west, and nothing else is");
        let [west, east, _] = &cells_of_rooms(&caster, &rooms, cells)[..] else { panic!("three") };
        assert!(west.contains(&wall) && east.contains(&wall));
    }

    #[test]
    fn what_is_seen_beside_what_is_seen_is_found_from_one_sight() {
        let strips: Vec<Aabb> =
            (0..20).map(|k| f64::from(k) * 0.2).map(|z| of([5.0, 0.0, z], [5.2, 2.8, z + 0.2])).collect();
        let (caster, rooms, _) = two_rooms(&strips);
        let walls: BTreeSet<(u32, CellId)> =
            (0..20).map(|k| wall_at(&caster, 2.5, f64::from(k) * 0.2 + 0.1).pair).collect();
        assert!(walls.len() >= 4, "strips share {} cells", walls.len());
        let lies_in = |cell: u32, room: CellId| !walls.contains(&(cell, Some(0))) || room == Some(1);
        let one = wall_at(&caster, 2.5, 0.1);
        assert_eq!(look_beside(&caster, &rooms, &lies_in, vec![one]), walls);
        assert!(look_beside(&caster, &rooms, &lies_in, vec![]).is_empty());
    }
}
