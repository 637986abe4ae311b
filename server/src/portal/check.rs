//! Does portal culling miss what is seen? Ray casts over the scene are the judge.

use super::columns::Columns;
use super::leaks::Random;
use super::storeys::is_free;
use crate::render::{Caster, CellSet, Ray};
use glam::DVec3;
use ldi_protocol::camera::{Frustum, ViewBasis};
use ldi_protocol::portal_view::{VISITS_PER_VIEW, portal_view_within};
use ldi_protocol::rooms::Rooms;
use ldi_protocol::{Aabb, OutputCamera, Pose};
use rayon::prelude::*;
use serde::Serialize;
use std::ops::Range;

/// Result of [`check_sight`].
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct SightCheck {
    /// Views that were judged.
    pub poses: u64,
    /// Views in which a pixel shows a surface of a cell that culling left out.
    pub poses_with_a_miss: u64,
    /// Rays that hit a surface.
    pub rays: u64,
    /// Rays whose surface lies in no cell that culling reports.
    pub missed_rays: u64,
    /// Views in which a surface is seen that would not be drawn.
    pub poses_left_out: u64,
    /// Rays that hit such a surface: no room that its cell of the octree lies in is reported with
    /// a cone that reaches that cell.
    pub left_out_rays: u64,
    /// Those of these rays that go through a joint of the model: between surfaces that are less
    /// than [`JOINT_M`] apart.
    pub left_out_rays_in_joints: u64,
    /// Cells reported per view, mean; the outside counts as one.
    pub cells_reported_mean: f64,
    /// Cells that rays reach per view, mean.
    pub cells_reached_mean: f64,
    /// Views in which everything counts as seen, as culling would take too many steps.
    pub everything_seen: u64,
    /// Portals clipped per view, mean.
    pub portals_clipped_mean: f64,
    /// Time of the culling alone per view, microseconds, mean.
    pub cull_us_mean: f64,
    /// Some of the misses, surfaces that would not be drawn first.
    pub worst: Vec<Miss>,
}

/// A surface that is seen and that culling misses.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Miss {
    /// The eye, metres.
    pub eye: DVec3,
    /// The surface, metres.
    pub surface: DVec3,
    /// Names of the cells there.
    pub cells: String,
    /// Whether it would not be drawn.
    pub left_out: bool,
    /// Whether it would not be drawn and shows through a joint of the model.
    pub in_joint: bool,
}

/// A gap narrower than this, metres, is a joint: surfaces that touch, but for how their corners
/// were rounded. At 1 m it is a seventh of a pixel of 320x200.
pub const JOINT_M: f64 = 0.5e-3;

/// Whether what a ray hits at `t` is seen through a joint: there is a direction in which rays
/// beside it, [`JOINT_M`] apart from each other, end before.
fn is_in_joint(caster: &Caster, ray: &Ray, t: f64) -> bool {
    let (u, v) = ray.direction.any_orthonormal_pair();
    let ends_before = |beside: DVec3| {
        // A thousandth short of it, so that what is askew there does not end them itself.
        let shifted = Ray { origin: ray.origin + beside, t_max: t * (1.0 - 1e-3), ..*ray };
        caster.occluded(&shifted, &CellSet::all())
    };
    (0..DIRECTIONS).any(|k| {
        let angle = f64::from(k) * std::f64::consts::PI / f64::from(DIRECTIONS);
        let half = (u * angle.cos() + v * angle.sin()) * (0.5 * JOINT_M);
        ends_before(half) && ends_before(-half)
    })
}

/// Most misses that are written out.
const MOST_WORST: usize = 20;

/// Judges culling from these poses by one ray per pixel. A cell counts as reported if any within
/// the rooms' margin of the surface is: walls stand in two rooms. A surface counts as drawn if its
/// cell of the octree is, as a frame draws it where the budget allows all that is seen. `cells`:
/// bounds of the octree's cells, which `caster` knows; `members`: those of them that lie in each
/// room, as [`cells_of_rooms`](super::members::cells_of_rooms) has them. `judged` is called after
/// each pose, from any thread.
pub fn check_sight(
    caster: &Caster,
    cells: &[Aabb],
    rooms: &Rooms,
    members: &[Vec<u32>],
    poses: &[Pose],
    camera: &OutputCamera,
    judged: &(dyn Fn() + Sync),
) -> SightCheck {
    let mut rooms_of = vec![Vec::new(); cells.len()];
    for (room, held) in (0u32..).zip(members) {
        let id = ((room as usize) < rooms.cells().len()).then_some(room);
        held.iter().for_each(|cell| rooms_of[*cell as usize].push(id));
    }
    let columns = Columns::new(rooms);
    let one = |pose: &Pose| {
        let basis = ViewBasis::from_yaw_pitch(pose.yaw_deg, pose.pitch_deg);
        let frustum = Frustum::new(pose.position, &basis, camera.half_tan_x(), camera.half_tan_y());
        let start = std::time::Instant::now();
        let start_cells = rooms.cells_near(pose.position, rooms.margin_m());
        let view = portal_view_within(rooms, &frustum, &start_cells, &|_| true, VISITS_PER_VIEW);
        let mut found = SightCheck {
            poses: 1,
            cells_reported_mean: view.cells.len() as f64,
            portals_clipped_mean: view.clipped as f64,
            everything_seen: u64::from(view.everything),
            cull_us_mean: start.elapsed().as_secs_f64() * 1e6,
            ..SightCheck::default()
        };
        let mut reached = std::collections::BTreeSet::new();
        let reaches =
            |room, b: &Aabb| view.cells.iter().any(|c| c.cell == room && c.cones.iter().any(|k| k.may_intersect(b)));
        let mut drawn: Vec<Option<bool>> = vec![None; cells.len()];
        let mut is_drawn = |cell: u32| {
            let n = cell as usize;
            *drawn[n].get_or_insert_with(|| rooms_of[n].iter().any(|room| reaches(*room, &cells[n])))
        };
        let mut hits = vec![None; (TILE * TILE) as usize];
        for tile in tiles(camera) {
            let ray = |[u, v]: [u32; 2]| camera.ray(&basis, f64::from(u) + 0.5, f64::from(v) + 0.5);
            let rays: Vec<Ray> = tile.map(|pixel| Ray::new(pose.position, ray(pixel))).collect();
            let hits = &mut hits[..rays.len()];
            caster.trace_batch(&rays, &CellSet::all(), hits);
            for (ray, hit) in rays.iter().zip(hits.iter()) {
                let Some(hit) = hit else { continue };
                let p = ray.at(hit.t);
                found.rays += 1;
                let near = columns.cells_near(p);
                if let &[only] = &near[..] {
                    reached.insert(only);
                }
                let missed = !near.iter().any(|c| view.sees(*c));
                let left_out = !is_drawn(caster.cell_of(hit.triangle));
                found.missed_rays += u64::from(missed);
                if left_out && found.left_out_rays == 0 {
                    // Worse than a miss that shows nowhere.
                    found.worst.clear();
                }
                found.left_out_rays += u64::from(left_out);
                let in_joint = left_out && is_in_joint(caster, ray, hit.t);
                found.left_out_rays_in_joints += u64::from(in_joint);
                if (missed || left_out) && found.worst.is_empty() {
                    let names: Vec<&str> = near.iter().map(|c| rooms.name(*c)).collect();
                    found.worst.push(Miss {
                        eye: pose.position,
                        surface: p,
                        cells: names.join(", "),
                        left_out,
                        in_joint,
                    });
                }
            }
        }
        found.cells_reached_mean = reached.len() as f64;
        found.poses_with_a_miss = u64::from(found.missed_rays > 0);
        found.poses_left_out = u64::from(found.left_out_rays > 0);
        judged();
        found
    };
    let all: Vec<SightCheck> = poses.par_iter().map(one).collect();
    let mut sum = SightCheck::default();
    for f in all {
        sum.poses += f.poses;
        sum.poses_with_a_miss += f.poses_with_a_miss;
        sum.rays += f.rays;
        sum.missed_rays += f.missed_rays;
        sum.poses_left_out += f.poses_left_out;
        sum.left_out_rays += f.left_out_rays;
        sum.left_out_rays_in_joints += f.left_out_rays_in_joints;
        sum.everything_seen += f.everything_seen;
        sum.cells_reported_mean += f.cells_reported_mean;
        sum.cells_reached_mean += f.cells_reached_mean;
        sum.portals_clipped_mean += f.portals_clipped_mean;
        sum.cull_us_mean += f.cull_us_mean;
        sum.worst.extend(f.worst);
    }
    sum.worst.sort_by_key(|w| !w.left_out);
    sum.worst.truncate(MOST_WORST);
    let n = poses.len().max(1) as f64;
    sum.cells_reported_mean /= n;
    sum.cells_reached_mean /= n;
    sum.portals_clipped_mean /= n;
    sum.cull_us_mean /= n;
    sum
}

/// Side of a tile, pixels: its rays make one packet for the caster.
const TILE: u32 = 8;

/// All pixels of a picture, tile by tile.
fn tiles(camera: &OutputCamera) -> impl Iterator<Item = impl Iterator<Item = [u32; 2]>> {
    let (width, height) = (camera.width, camera.height);
    let starts = |side: u32| (0..side).step_by(TILE as usize);
    starts(height).flat_map(move |v0| starts(width).map(move |u0| (u0, v0))).map(move |(u0, v0)| {
        let rows = v0..height.min(v0 + TILE);
        rows.flat_map(move |v| (u0..width.min(u0 + TILE)).map(move |u| [u, v]))
    })
}

/// Heights of eyes above the bottom of a room's box, which is 0.1 m below its floor, metres.
pub(super) const EYES_ABOVE_M: Range<f64> = 1.2..2.1;
/// Half of the width of a person, metres.
const HALF_A_PERSON_M: f64 = 0.25;
/// How far beside an eye room to stand is looked for, metres: eyes lean over tables and around
/// corners, and those close to walls are the hard ones.
const BESIDE_M: [f64; 3] = [0.15, 0.3, 0.45];
/// Directions that are tried, in plan around an eye or across a ray: sheets of a wall, and joints,
/// are met by some of them whichever way they run.
const DIRECTIONS: u32 = 8;

/// Whether somebody whose eye is there has room to stand, at most 0.45 m beside it: not in the
/// cavity of a hollow wall.
pub(super) fn stands_in_the_open(caster: &Caster, eye: DVec3) -> bool {
    let around = || {
        (0..DIRECTIONS).map(|k| {
            let angle = f64::from(k) * std::f64::consts::TAU / f64::from(DIRECTIONS);
            DVec3::new(angle.cos(), 0.0, angle.sin())
        })
    };
    let fits = |at: DVec3| around().all(|d| is_free(caster, at, at + d * HALF_A_PERSON_M));
    let beside = BESIDE_M.into_iter().flat_map(|m| around().map(move |d| eye + d * m));
    fits(eye) || beside.filter(|at| is_free(caster, eye, *at)).any(fits)
}

/// Whether nothing is within 0.1 m of an eye, beside and above.
pub(super) fn is_clear(caster: &Caster, eye: DVec3) -> bool {
    [DVec3::X, DVec3::NEG_X, DVec3::Z, DVec3::NEG_Z, DVec3::Y].iter().all(|d| is_free(caster, eye, eye + 0.1 * *d))
}

/// Whether something to stand on is below an eye, at most 0.1 m farther than the highest eyes are
/// above the bottom of a room's box.
pub(super) fn has_floor(caster: &Caster, eye: DVec3) -> bool {
    !is_free(caster, eye, eye - 2.2 * DVec3::Y)
}

/// Poses at eye height in free places of the rooms: 1.1 to 2 m above the floor of a box, something
/// below, 0.1 m clear of all around, and beside them room for a person.
pub fn random_poses(caster: &Caster, rooms: &Rooms, count: usize, seed: u64) -> Vec<Pose> {
    let boxes: Vec<_> = rooms.cells().iter().flat_map(|c| &c.boxes).collect();
    let area: Vec<f64> = boxes
        .iter()
        .scan(0.0, |sum, b| {
            *sum += b.size().x * b.size().z;
            Some(*sum)
        })
        .collect();
    let Some(total) = area.last() else { return Vec::new() };
    let mut r = Random(seed);
    let mut poses = Vec::with_capacity(count);
    for _ in 0..count.saturating_mul(50) {
        if poses.len() == count {
            break;
        }
        let at = r.unit() * total;
        let b = boxes[area.partition_point(|a| *a <= at).min(boxes.len() - 1)];
        let (u, w, h) = (r.unit(), r.unit(), r.unit());
        let above = EYES_ABOVE_M.start + (EYES_ABOVE_M.end - EYES_ABOVE_M.start) * h;
        let eye = DVec3::new(b.min.x + b.size().x * u, b.min.y + above, b.min.z + b.size().z * w);
        if !has_floor(caster, eye) {
            continue;
        }
        let (yaw_deg, pitch_deg) = (360.0 * r.unit(), 120.0 * r.unit() - 60.0);
        if is_clear(caster, eye) && b.contains(eye) && stands_in_the_open(caster, eye) {
            poses.push(Pose { position: eye, yaw_deg, pitch_deg });
        }
    }
    poses
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::test_scenes::{block, scene_of};
    use std::sync::Arc;

    #[test]
    fn tiles_hold_every_pixel_once() {
        let camera = OutputCamera { width: 21, height: 9, fov_deg: 60.0 };
        let mut pixels: Vec<[u32; 2]> = tiles(&camera).flatten().collect();
        assert!(pixels[..64].iter().all(|p| p.iter().all(|n| *n < 8)));
        pixels.sort_unstable();
        assert!(pixels.into_iter().eq((0..21).flat_map(|u| (0..9).map(move |v| [u, v]))));
    }

    #[test]
    fn a_joint_is_narrower_than_half_a_millimetre() {
        // Two blocks, one over the other or beside it, the gap between them, and a wall behind.
        let of = |a: [f64; 3], b: [f64; 3]| Aabb { min: DVec3::from(a), max: DVec3::from(b) };
        let seen = |gap: f64, blocks: [Aabb; 2]| {
            let walls = [blocks[0], blocks[1], of([3.0, -5.0, -5.0], [3.2, 5.0, 5.0])];
            let caster = Caster::of_scene(Arc::new(scene_of(&walls.each_ref().map(block))), false);
            let ray = Ray::new(DVec3::new(0.0, 0.5 * gap, 0.5 * gap), DVec3::X);
            let hit = caster.trace(&ray, &CellSet::all()).expect("the wall");
            assert!((hit.t - 3.0).abs() < 1e-4, "through the gap of {gap}: {}", hit.t);
            is_in_joint(&caster, &ray, hit.t)
        };
        for (gap, is_joint) in [(1e-4, true), (4e-4, true), (7e-4, false), (2e-3, false)] {
            let level = [of([1.0, -2.0, -2.0], [1.2, 0.0, 2.0]), of([1.0, gap, -2.0], [1.2, 2.0, 2.0])];
            let upright = [of([1.0, -2.0, -2.0], [1.2, 2.0, 0.0]), of([1.0, -2.0, gap], [1.2, 2.0, 2.0])];
            // Where one ends behind the other, as a floor behind the wall on its edge.
            let aslant = [of([1.0, -2.0, -2.0], [1.0001, 0.0, 2.0]), of([1.5, gap, -2.0], [1.7, 2.0, 2.0])];
            for blocks in [level, upright, aslant] {
                assert_eq!(seen(gap, blocks), is_joint, "{gap} {blocks:?}");
            }
        }
        let alone = [of([1.0, -2.0, -2.0], [1.2, 0.0, 2.0]), of([4.0, 0.0, 0.0], [4.2, 1.0, 1.0])];
        assert!(!seen(1e-4, alone), "past an edge");
    }

    #[test]
    fn nobody_stands_in_a_hollow_wall() {
        let walls =
            [0.0, 0.35, 3.0].map(|x| Aabb { min: DVec3::new(x - 0.05, 0.0, -5.0), max: DVec3::new(x, 3.0, 5.0) });
        let caster = Caster::of_scene(Arc::new(scene_of(&walls.each_ref().map(block))), false);
        let open = |x: f64| stands_in_the_open(&caster, DVec3::new(x, 1.6, 0.0));
        assert!(!open(0.15) && !open(0.2), "between the two sheets");
        assert!(open(0.45) && open(2.0) && open(2.85), "beside a wall");
    }
}
