//! Lines of sight through narrow gaps: where surfaces touch but for a tenth of a millimetre, as
//! when the corners of a wall and those of a floor were rounded apart.
//!
//! In: a caster. Out: middles of such gaps, and rays through them from where eyes may be. Of
//! random rays from eyes one of 10^9 passes such a gap; of lines through the gap one of some
//! fifteen passes where an eye may be.

use super::check::{EYES_ABOVE_M, has_floor, is_clear, stands_in_the_open};
use super::columns::Columns;
use super::leaks::Random;
use crate::render::{Caster, CellSet, Ray};
use glam::DVec3;
use rayon::prelude::*;

/// Wider gaps are left to other rays, metres: an eye at 1 m sees them half a pixel of 320x200 wide.
const WIDEST_M: f64 = 2e-3;
/// What is nearer to an edge touches it, metres: corners in f32 are that far off, some hundred
/// metres from the middle of a scene.
const NARROWEST_M: f64 = 3e-5;
/// Gaps are sought along edges of triangles, in one place for so many metres, at random. What
/// shows through a joint shows along all of it, and joints are as long as walls.
const APART_M: f64 = 0.25;
/// In so many places at most: a scene with more edges gets fewer for each metre. The clinic has
/// six million; their gaps take 24 bytes each.
const MOST_PLACES: f64 = 8e6;
/// Directions across an edge in which a gap is sought: 45 degrees apart, so that a gap half as
/// wide as the widest is met whichever way it lies.
const ACROSS: u32 = 8;
/// Farthest eye, metres: from there the widest gap is a fiftieth of a pixel of 320x200.
const FARTHEST_M: f64 = 30.0;
/// Lines that end before lead to hardly an eye, metres: eyes are 0.1 m clear of everything.
const NEAREST_M: f64 = 0.3;
/// If none of the first so many lines leads farther the gap leads nowhere: most are within walls
/// and things. On the clinic lines take 6 s instead of 19, and find 17 pairs of cell and room
/// instead of 20.
const LINES_OUT: usize = 4;
/// Places along a line that are tried for eyes; most of it is above or below their heights. With 4
/// instead 17 pairs are found on the clinic, not 19, in a second less.
const EYES: usize = 16;

/// Middles of gaps between an edge of a triangle and whatever is beside it, in the order of the
/// triangles.
pub(super) fn gaps(caster: &Caster, random: impl Fn(u32) -> Random + Sync) -> Vec<DVec3> {
    let edges = |t: u32| {
        let [a, b, c] = caster.corners_world(t);
        [(a, b), (b, c), (c, a)]
    };
    let length = |t: u32| edges(t).map(|(a, b)| a.distance(b)).iter().sum::<f64>();
    let all_m: f64 = (0..caster.triangle_count()).map(length).sum();
    let apart_m = (all_m / MOST_PLACES).max(APART_M);
    let beside = |t: u32| {
        let mut random = random(t);
        let mut gaps = Vec::new();
        for (a, b) in edges(t) {
            // So many that the mean over all edges is right, also of those that are shorter.
            for _ in 0..(a.distance(b) / apart_m + random.unit()) as u64 {
                gaps.extend(gap_beside(caster, a.lerp(b, random.unit()), b - a, &mut random));
            }
        }
        gaps
    };
    (0..caster.triangle_count()).into_par_iter().flat_map_iter(beside).collect()
}

/// The middle of a gap between a place of an edge and another surface.
fn gap_beside(caster: &Caster, place: DVec3, edge: DVec3, random: &mut Random) -> Option<DVec3> {
    let (u, v) = edge.normalize().any_orthonormal_pair();
    (0..ACROSS).find_map(|k| {
        let angle = (f64::from(k) + random.unit()) / f64::from(ACROSS) * std::f64::consts::TAU;
        let across = u * angle.cos() + v * angle.sin();
        let ray = Ray { origin: place, direction: across, t_min: NARROWEST_M, t_max: WIDEST_M };
        caster.trace(&ray, &CellSet::all()).map(|hit| place + across * (0.5 * hit.t))
    })
}

/// Rays through a gap from where eyes may be, along random lines, both ways; at t = 1 they are in
/// the gap.
pub(super) fn rays_through(
    caster: &Caster,
    columns: &Columns,
    gap: DVec3,
    lines: usize,
    random: &mut Random,
) -> Vec<Ray> {
    let mut rays = Vec::new();
    let mut leads_out = false;
    for n in 0..lines {
        if n == LINES_OUT && !leads_out {
            break;
        }
        let line = random.direction();
        for way in [line, -line] {
            let sight = Ray { t_max: FARTHEST_M, ..Ray::new(gap, way) };
            let end = caster.trace(&sight, &CellSet::all()).map_or(FARTHEST_M, |hit| hit.t);
            if end < NEAREST_M {
                continue;
            }
            leads_out = true;
            let mut places = (0..EYES).map(|_| gap + way * (end * random.unit()));
            let eye = places.find(|p| may_be_an_eye(caster, columns, *p));
            rays.extend(eye.map(|eye| Ray::new(eye, gap - eye)));
        }
    }
    rays
}

fn may_be_an_eye(caster: &Caster, columns: &Columns, p: DVec3) -> bool {
    columns.is_at_height(p, &EYES_ABOVE_M)
        && has_floor(caster, p)
        && is_clear(caster, p)
        && stands_in_the_open(caster, p)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::test_scenes::{block, scene_of};
    use ldi_protocol::Aabb;
    use std::sync::Arc;

    /// Middles of the gaps of two boards of 1 m by 4 m, so far apart.
    fn gaps_of_boards(apart_m: f64) -> Vec<DVec3> {
        let board = |y: f64| block(&Aabb { min: DVec3::new(0.0, y, 0.0), max: DVec3::new(4.0, y + 0.1, 1.0) });
        let scene = Arc::new(scene_of(&[board(0.0), board(0.1 + apart_m)]));
        gaps(&Caster::of_scene(scene, false), |triangle| Random(u64::from(triangle)))
    }

    #[test]
    fn gaps_are_found_in_their_middle_and_wide_ones_are_none() {
        for apart_m in [1e-4, 1e-3] {
            let gaps = gaps_of_boards(apart_m);
            // Each edge belongs to two triangles: 40 m around the faces that face each other and
            // 16.5 m across them, with a place in each 0.25 m.
            let (between, others): (Vec<DVec3>, Vec<DVec3>) =
                gaps.into_iter().partition(|gap| (0.1..=0.1 + apart_m).contains(&gap.y));
            assert!((200..=250).contains(&between.len()), "{} gaps, {apart_m} m wide", between.len());
            assert!(others.len() <= 10, "in the corners of a board, between its own faces: {others:?}");
        }
        for apart_m in [0.0, 3e-3] {
            let gaps = gaps_of_boards(apart_m);
            assert!(gaps.len() <= 10, "{} gaps of boards {apart_m} m apart", gaps.len());
        }
    }
}
