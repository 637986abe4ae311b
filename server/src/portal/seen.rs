//! What is seen from a room beside all portals, as rays find it: such cells of the octree are
//! drawn with the room, too.
//!
//! In: rooms, a caster, and which cells lie in which room by their triangles ([`super::members`]).
//! Out: the cells to add. Borders of rooms run in the middle of what the raster cannot see
//! through: of walls, of cupboards as high as a person, of the niches below windows. Part of a
//! surface behind such a border is seen from before it, and its triangles may lie in the room
//! behind alone.
//!
//! Every ray goes through the portals as culling does, from all rooms of its eye through every
//! portal that it passes. If the surface it ends at is drawn with none of the rooms on its way, it
//! is added to the last of them before the surface. Where one is found there are mostly more: rays
//! from around its eye to around what it saw look for them, and from around those again (adaptive
//! border sampling of Wonka et al., Guided Visibility Sampling, 2006, with random rays). Most such
//! surfaces are drawn all the same, as their cell lies in several rooms; where one of these is
//! seen beside all portals, others may not be drawn, and so rays look beside these, too, from each
//! place where that happens. Gaps too narrow for any of these rays are looked through the other
//! way round ([`super::joints`]). Sampling proves nothing of surfaces that no ray met;
//! `ldi-server rooms --check` counts with other rays what is left.

use super::check::{is_clear, random_poses};
use super::columns::Columns;
use super::joints::{gaps, rays_through};
use super::leaks::Random;
use super::storeys::is_free;
use crate::render::{Caster, CellSet, Hit, Ray};
use glam::DVec3;
use ldi_protocol::Pose;
use ldi_protocol::rooms::{CellId, Rooms};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Eyes per m² of the rooms' boxes, within bounds. More: rarer places are found, and planning
/// takes longer: the clinic, at the upper bound, some twenty seconds. With half of them, and twice
/// the rays, one place in willow_garage's cavities was not found.
const EYES_PER_M2: f64 = 200.0;
/// See [`EYES_PER_M2`].
const EYES: [f64; 2] = [1_000.0, 400_000.0];
/// Bundles of rays per eye, in random directions; each takes a packet of the caster, which costs
/// less than as many single rays.
const BUNDLES: usize = 4;
/// Rays along a side of a bundle, and the angle between neighbours as its tangent: 1.5 degrees.
/// Less: bundles see the same twice where what shows is wide; more: they are no packets any more.
const BUNDLE: (u32, f64) = (8, 0.026);
/// Eyes around one that saw a cell beside all portals, and rays from each.
const LOOK_BESIDE: (usize, usize) = (32, 32);
/// So many sights of a cell from a room are looked beside of: it may be seen through several slits.
const SIGHTS_OF_CELL: usize = 8;
/// So many of a room from a place in another, of cells that are drawn all the same. More: rarer
/// places are found, and sorting takes longer.
const SIGHTS_OF_ROOM: usize = 4;
/// Side of such a place, metres: an open border is as long as an arena, and what is seen through
/// one part of it says nothing of others. Of two places of bleach and three of the clinic, found
/// by a check, places of 1 m and 4 sights each find two and one in 20 and 57 s; 64 sights from
/// anywhere none in 11 and 46; 4 m and 64 sights one of bleach's in 23; 0.5 m and 2 two and one in
/// 68 and 134.
const PLACE_M: f64 = 1.0;
/// Most rounds of looking beside; on the clinic and bleach, of which eight in ten pairs are found
/// so, the last bring next to nothing.
const ROUNDS: usize = 12;
/// How far beside, at most: eyes, metres, and what they see, as a share of its distance.
const BESIDE: (f64, f64) = (1.0, 0.5);
/// How far at least, as a share of that: what is there may be a slit or a wall, so all scales
/// between are alike.
const CLOSEST: f64 = 0.01;
/// Eyes stay at the heights of eyes.
const FLAT: DVec3 = DVec3::new(1.0, 0.25, 1.0);
/// Lines through each narrow gap, and as many more through one where something is seen beside all
/// portals. Of the clinic, on two busy cores: 16 lines find 19 pairs of cell and room in 7 s, 64
/// find 30 in
/// 19. The more lines for few gaps cost next to nothing.
const LINES: usize = 64;
/// See [`LINES`].
const LINES_AGAIN: usize = 512;
/// Numbers of tasks about gaps are from here on; those of others are lower.
const IN_GAPS: u64 = 1 << 60;
/// Not that of any check: those go up to 1,000.
const SEED: u64 = 0x5ee;

/// What is seen from a room beside all portals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Seen {
    /// A cell of the octree that would not be drawn.
    Cell(u32, CellId),
    /// A room, of cells that are drawn all the same: the room that is seen, the one that sees it,
    /// and the place in it, in steps of [`PLACE_M`].
    Room(CellId, CellId, [i32; 3]),
}

impl Seen {
    /// The cell of the octree and the room that sees it.
    fn pair(self) -> Option<(u32, CellId)> {
        match self {
            Self::Cell(cell, room) => Some((cell, room)),
            Self::Room(..) => None,
        }
    }

    /// Of how many sights of it rays look beside.
    fn sights(&self) -> usize {
        match self {
            Self::Cell(..) => SIGHTS_OF_CELL,
            Self::Room(..) => SIGHTS_OF_ROOM,
        }
    }
}

/// Where something was seen beside all portals.
#[derive(Debug, Clone, Copy)]
struct Sight {
    seen: Seen,
    eye: DVec3,
    surface: DVec3,
}

/// What sights are judged by.
struct Judge<'a> {
    caster: &'a Caster,
    rooms: &'a Rooms,
    columns: Columns<'a>,
    lies_in: &'a (dyn Fn(u32, CellId) -> bool + Sync),
}

/// Pairs of a cell of the octree and a room that sees it beside all portals, sorted, each once.
/// `lies_in`: whether a cell lies in a room.
pub(super) fn seen_beside(
    caster: &Caster,
    rooms: &Rooms,
    lies_in: &(dyn Fn(u32, CellId) -> bool + Sync),
) -> Vec<(u32, CellId)> {
    let area_m2: f64 = rooms.cells().iter().flat_map(|c| &c.boxes).map(|b| b.size().x * b.size().z).sum();
    let eyes = random_poses(caster, rooms, (area_m2 * EYES_PER_M2).clamp(EYES[0], EYES[1]) as usize, SEED);
    let judge = Judge { caster, rooms, columns: Columns::new(rooms), lies_in };
    let all_around = |(n, pose): (usize, &Pose)| {
        let mut random = random_of(n as u64);
        let rays: Vec<Ray> = (0..BUNDLES).flat_map(|_| bundle(pose.position, random.direction())).collect();
        judge.sights(&rays)
    };
    let seen = eyes.par_iter().enumerate().flat_map_iter(all_around).collect();
    let mut pairs = judge.look_beside(seen);
    pairs.extend(judge.through_gaps());
    pairs.into_iter().collect()
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

impl Judge<'_> {
    /// The cells of some sights, and of all that are found from around their eyes, with the rooms
    /// that see them.
    fn look_beside(&self, mut sights: Vec<Sight>) -> BTreeSet<(u32, CellId)> {
        let mut count: BTreeMap<Seen, usize> = BTreeMap::new();
        for round in 1..=ROUNDS as u64 {
            sights.retain(|sight| {
                let of_this = count.entry(sight.seen).or_default();
                *of_this += 1;
                *of_this <= sight.seen.sights()
            });
            let beside = |(n, sight): (usize, &Sight)| {
                let mut random = random_of(round << 32 | n as u64);
                self.sights(&rays_beside(self.caster, sight, &mut random))
            };
            sights = sights.par_iter().enumerate().flat_map_iter(beside).collect();
        }
        let seen = count.into_keys().chain(sights.into_iter().map(|sight| sight.seen));
        seen.filter_map(Seen::pair).collect()
    }

    /// The cells that are seen through gaps too narrow for rays from scattered eyes
    /// ([`super::joints`]), with the rooms that see them.
    fn through_gaps(&self) -> BTreeSet<(u32, CellId)> {
        let gaps = gaps(self.caster, |triangle| random_of(IN_GAPS | u64::from(triangle)));
        let in_gap = |(n, gap): (usize, &DVec3)| {
            let mut random = random_of(IN_GAPS << 1 | n as u64);
            let mut through = |lines| self.sights(&rays_through(self.caster, &self.columns, *gap, lines, &mut random));
            let mut sights = through(LINES);
            if !sights.is_empty() {
                sights.extend(through(LINES_AGAIN));
            }
            sights
        };
        gaps.par_iter().enumerate().flat_map_iter(in_gap).filter_map(|sight| sight.seen.pair()).collect()
    }

    /// What these rays see beside all portals.
    fn sights(&self, rays: &[Ray]) -> Vec<Sight> {
        let mut hits = vec![None; rays.len()];
        self.caster.trace_batch(rays, &CellSet::all(), &mut hits);
        // Rays come in groups from one eye.
        let (mut eye, mut start) = (DVec3::NAN, Vec::new());
        let beside = |(ray, hit): (&Ray, &Option<Hit>)| {
            let hit = (*hit)?;
            if ray.origin != eye {
                (eye, start) = (ray.origin, self.rooms.cells_near(ray.origin, self.rooms.margin_m()));
            }
            let seen = self.beside_portals(&start, ray, &hit)?;
            Some(Sight { seen, eye: ray.origin, surface: ray.at(hit.t) })
        };
        rays.iter().zip(&hits).filter_map(beside).collect()
    }

    /// What a ray hits, if it is in none of the rooms that the ray enters, before or after, or
    /// would be drawn with none. A cell counts as seen from the last room entered before it.
    fn beside_portals(&self, start: &[CellId], ray: &Ray, hit: &Hit) -> Option<Seen> {
        let (cell, surface) = (self.caster.cell_of(hit.triangle), ray.at(hit.t));
        let first = *start.first()?;
        let mut on_way: Vec<(f64, CellId)> = start.iter().map(|room| (0.0, *room)).collect();
        let (mut at, mut last) = (0, (0.0, first));
        let (mut is_drawn, mut is_entered) = (false, false);
        while let Some(&(from, room)) = on_way.get(at) {
            is_drawn = is_drawn || (self.lies_in)(cell, room);
            is_entered = is_entered || self.columns.is_near(surface, room);
            if is_drawn && is_entered {
                return None;
            }
            if from >= last.0 && from <= hit.t {
                last = (from, room);
            }
            for number in self.rooms.portals_of(room) {
                let portal = &self.rooms.portals()[*number as usize];
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
        if !is_drawn {
            return Some(Seen::Cell(cell, last.1));
        }
        let place = (ray.origin / PLACE_M).floor().as_ivec3().to_array();
        Some(Seen::Room(*self.columns.cells_near(surface).first()?, first, place))
    }
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

    /// Before the wall between two rooms, 2.2 m high; their border runs in the middle of it.
    fn cupboard() -> Aabb {
        of([4.2, 0.0, 0.0], [4.99, 2.2, 4.0])
    }

    /// Two rooms of 2.8 m, west and east. `between`: what stands between them.
    fn two_rooms(between: &[Aabb]) -> (Caster, Rooms, usize) {
        let mut boxes = vec![
            of([-0.2, -0.2, -0.2], [10.2, 0.0, 4.2]),
            of([-0.2, 2.8, -0.2], [10.2, 3.0, 4.2]),
            of([-0.2, 0.0, -0.2], [10.2, 2.8, 0.0]),
            of([-0.2, 0.0, 4.0], [10.2, 2.8, 4.2]),
            of([-0.2, 0.0, 0.0], [0.0, 2.8, 4.0]),
            of([10.0, 0.0, 0.0], [10.2, 2.8, 4.0]),
        ];
        boxes.extend(between);
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
    fn wall_at(caster: &Caster, up: f64, z: f64) -> (u32, Sight) {
        let eye = DVec3::new(2.0, 1.6, 2.0);
        let ray = Ray::new(eye, DVec3::new(5.0, up, z) - eye);
        let hit = caster.trace(&ray, &CellSet::all()).expect("a wall");
        assert!((ray.at(hit.t).x - 5.0).abs() < 1e-6, "above the cupboard: {}", ray.at(hit.t));
        let cell = caster.cell_of(hit.triangle);
        (cell, Sight { seen: Seen::Cell(cell, Some(0)), eye, surface: ray.at(hit.t) })
    }

    /// The cupboard and a wall in strips of 0.2 m.
    fn strips() -> Vec<Aabb> {
        let strip = |z: f64| of([5.0, 0.0, z], [5.2, 2.8, z + 0.2]);
        std::iter::once(cupboard()).chain((0..20).map(|k| strip(f64::from(k) * 0.2))).collect()
    }

    #[test]
    fn a_wall_above_a_cupboard_is_drawn_with_the_room_before_it() {
        let (caster, rooms, cells) = two_rooms(&[cupboard(), of([5.0, 0.0, 0.0], [5.2, 2.8, 4.0])]);
        let (wall, _) = wall_at(&caster, 2.5, 2.0);
        let pairs = seen_beside(&caster, &rooms, &|cell, room| cell != wall || room == Some(1));
        assert_eq!(pairs, [(wall, Some(0))], "seen from the west, and nothing else is");
        let [west, east, _] = &cells_of_rooms(&caster, &rooms, cells)[..] else { panic!("three") };
        assert!(west.contains(&wall) && east.contains(&wall));
    }

    #[test]
    fn what_is_seen_beside_what_is_seen_is_found_from_one_sight() {
        let (caster, rooms, _) = two_rooms(&strips());
        let walls: BTreeSet<(u32, CellId)> =
            (0..20).map(|k| (wall_at(&caster, 2.5, f64::from(k) * 0.2 + 0.1).0, Some(0))).collect();
        assert!(walls.len() >= 4, "strips share {} cells", walls.len());
        let lies_in = |cell: u32, room: CellId| !walls.contains(&(cell, Some(0))) || room == Some(1);
        let (_, one) = wall_at(&caster, 2.5, 0.1);
        let judge = Judge { caster: &caster, rooms: &rooms, columns: Columns::new(&rooms), lies_in: &lies_in };
        assert_eq!(judge.look_beside(vec![one]), walls);
        assert!(judge.look_beside(vec![]).is_empty());
    }

    #[test]
    fn sight_into_a_room_that_is_drawn_leads_to_what_is_not() {
        let (caster, rooms, _) = two_rooms(&strips());
        let ((near, Sight { eye, surface, .. }), (far, _)) = (wall_at(&caster, 2.5, 0.1), wall_at(&caster, 2.5, 1.5));
        assert_ne!(near, far);
        let lies_in = |cell: u32, room: CellId| cell != far || room == Some(1);
        let judge = Judge { caster: &caster, rooms: &rooms, columns: Columns::new(&rooms), lies_in: &lies_in };
        let sights = judge.sights(&[Ray::new(eye, surface - eye)]);
        assert_eq!(sights.iter().map(|s| s.seen).collect::<Vec<_>>(), [Seen::Room(Some(1), Some(0), [2, 1, 2])]);
        assert_eq!(judge.look_beside(sights), BTreeSet::from([(far, Some(0))]));
    }

    #[test]
    fn what_shows_through_a_tenth_of_a_millimetre_is_found() {
        // A thin wall up to a height, and from another one to the ceiling.
        let seen_through = |gap_m: f64| {
            let wall = |y: [f64; 2]| of([4.7, y[0], 0.0], [4.701, y[1], 4.0]);
            let (caster, rooms, _) = two_rooms(&[wall([0.0, 1.5]), wall([1.5 + gap_m, 2.8])]);
            let far = caster.trace(&Ray::new(DVec3::new(8.0, 1.5, 2.0), DVec3::X), &CellSet::all()).expect("a wall");
            let far = caster.cell_of(far.triangle);
            let lies_in = |cell: u32, room: CellId| cell != far || room == Some(1);
            let judge = Judge { caster: &caster, rooms: &rooms, columns: Columns::new(&rooms), lies_in: &lies_in };
            (judge.through_gaps(), far)
        };
        let (seen, far) = seen_through(1e-4);
        assert_eq!(seen, BTreeSet::from([(far, Some(0))]));
        assert_eq!(seen_through(-1e-2).0, BTreeSet::new(), "closed");
    }
}
