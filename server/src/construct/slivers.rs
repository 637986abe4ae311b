//! Slivers: surfaces that the image's pixels are too coarse for.
//!
//! In: hits of construction cameras, finished layers. Out: [`Sliver`]s.
//!
//! What the centre of projection sees edge-on takes a pixel there or none, and many pixels in the
//! picture of an eye beside it: the jamb of a door, the side of a post. A hit is of that kind if a
//! pixel's step along its surface is longer than [`STEEP`] pixels of its camera. Unless the layers
//! hold its surface on both sides, so that micro-quads span it, the camera's pixel is kept as it
//! is: a square of the camera's picture, cast again at full resolution, on the plane that was hit.
//! It goes on along the axis as long as full-resolution rays meet the same plane, at most a pixel
//! of the camera: the face of a post is few of them wide. Squares of one plane and colour are
//! joined to rectangles, which is most of them where walls are plain.

use super::{
    caster::SubsetCaster,
    central::traced,
    layers::RawLayer,
    sample::{Prediction, Sample, Tolerance},
    view::{COARSENESS, ConstructionCamera, Rig},
};
use crate::render::Ray;
use glam::DVec3;
use ldi_protocol::{
    ldi::{DisparityCodes, LINK_DOWN, LINK_RIGHT, Sliver, SliverCorner},
    shade::srgb8_from_linear,
};
use std::collections::BTreeMap;

/// Steps along a surface from a pixel to the next that are longer than this in the picture of a
/// camera, pixels, show: a surface's border is off by up to half of it. By judgement.
const STEEP: f64 = 2.0;
/// Surfaces that a camera sees at less than this sine of an angle, one degree, are left out: a
/// square would be fifty pixels long there, whatever ends in it. By judgement.
const GRAZING: f64 = 0.02;
/// Colours of one rectangle differ by at most this in each channel (8-bit sRGB). By judgement.
const SAME_COLOUR: u8 = 3;
/// Normals of one plane: cosine of the angle between them, 1.5 minutes; f32 positions give no
/// better. That its squares lie in it is tested besides.
const SAME_NORMAL: f64 = 1.0 - 1e-7;

/// A sample whose disparity changes along an axis by this share of another's, or more, may be of
/// the same face: smaller, a box's front would stand for its side. By judgement.
const AS_STEEP: f32 = 0.25;

/// Squares at full resolution that are tried on either side of a camera's pixel.
const BEYOND: u32 = COARSENESS as u32;

/// A hit that may become a sliver.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    /// Number of its camera.
    pub camera: u32,
    /// Its pixel of the camera.
    pub pixel: u32,
    /// Its pixel of the image, and the sample that it predicts there.
    pub home: Prediction,
    /// The axis along which it is steep.
    pub axis: usize,
    /// The ray through the pixel's centre meets nothing: the surface passes beside it.
    pub beside: bool,
}

/// Along which axis (0: to the next column, 1: row) a surface is steep for a camera; None: along
/// neither.
pub(super) fn steep_axis(camera: &ConstructionCamera, s: &Sample) -> Option<usize> {
    let [across, down] = camera.steps(f64::from(s.disparity), s.gradient);
    (across.max(down) > STEEP).then_some(usize::from(down > across))
}

/// A square of a camera's picture at full resolution.
#[derive(Debug, Clone, Copy)]
struct Square {
    camera: u32,
    row: u32,
    column: u32,
    surface: u32,
    plane: Plane,
    rgb: [u8; 3],
    /// How many squares it lies beyond the camera's pixel, up to [`BEYOND`], and the step (row,
    /// column) back to it.
    beyond: (u32, [i32; 2]),
}

/// A plane as a camera sees it: disparity at image coordinates.
#[derive(Debug, Clone, Copy)]
struct Plane {
    normal: DVec3,
    /// Disparity at (0, 0), and per pixel along each axis.
    at: [f64; 3],
}

impl Plane {
    /// Of a hit of a camera's ray; None if the camera sees it at a grazing angle.
    fn of(rig: &Rig, normal: DVec3, ray: &Ray, t: f64) -> Option<Self> {
        let facing = normal.dot(ray.direction);
        if facing.abs() < GRAZING * ray.direction.length() {
            return None;
        }
        // d(u, v) = n . r(u, v) / (n . (X - E)).
        let (distance, s) = (facing * t, 1.0 / rig.lens.pixels_per_unit);
        let b = &rig.lens.basis;
        let along = [b.forward, b.right * s, -b.up * s];
        Some(Self { normal, at: along.map(|v| normal.dot(v) / distance) })
    }

    fn disparity(&self, u: f64, v: f64) -> f64 {
        self.at[0] + self.at[1] * u + self.at[2] * v
    }
}

/// The slivers of the candidates that the layers do not hold, in a fixed order, and the number of
/// rays. `cameras` are those of the candidates.
pub(super) fn find<C: SubsetCaster>(
    caster: &C,
    rig: &Rig,
    layers: &[RawLayer],
    cameras: &[ConstructionCamera],
    mut candidates: Vec<Candidate>,
    tolerance: &Tolerance,
) -> (Vec<Found>, u64) {
    candidates.retain(|c| !held(rig, layers, c, tolerance));
    // Of the cameras that see a surface through a pixel the one that sees most of the surface:
    // pictures of several do not join without gaps.
    let mut share: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    candidates.iter().for_each(|c| *share.entry((c.home.1.surface, c.camera)).or_default() += 1);
    candidates.sort_by_key(|c| (c.home.0, c.home.1.surface, c.camera, c.pixel));
    let best =
        candidates.chunk_by(|a, b| (a.home.0, a.home.1.surface) == (b.home.0, b.home.1.surface)).flat_map(|seen| {
            let by_camera = seen.chunk_by(|a, b| a.camera == b.camera);
            by_camera.rev().max_by_key(|c| share.get(&(c[0].home.1.surface, c[0].camera))).unwrap_or_default()
        });
    let mut items: Vec<Item> = best.flat_map(|c| items_of(c, &cameras[c.camera as usize])).collect();
    // Where pixels meet, what belongs to one lies beyond the other.
    items.sort_by_key(|i| (i.candidate.camera, i.row, i.column, i.candidate.home.1.surface, i.beyond.0));
    items.dedup_by_key(|i| (i.candidate.camera, i.row, i.column, i.candidate.home.1.surface));
    let ray_of = |i: &Item| {
        let camera = &cameras[i.candidate.camera as usize];
        let (u, v) = place(camera, f64::from(i.column) + 0.5, f64::from(i.row) + 0.5);
        Ray { origin: camera.position, direction: rig.lens.ray(u, v), t_min: camera.near_m, t_max: f64::INFINITY }
    };
    let squares = traced(caster, rig, &items, ray_of, |surveyor, i, ray, hit| {
        let hit = hit?;
        let facet = surveyor.facet(ray, hit);
        if facet.surface != i.candidate.home.1.surface {
            return None;
        }
        Some(Square {
            camera: i.candidate.camera,
            row: i.row,
            column: i.column,
            surface: facet.surface,
            plane: Plane::of(rig, facet.normal, ray, hit.t)?,
            rgb: surveyor.linear(ray, hit).map(srgb8_from_linear),
            beyond: i.beyond,
        })
    });
    let rays = squares.len() as u64;
    let squares = going_on(squares.into_iter().flatten().collect(), rig, cameras);
    let joined = rectangles(&squares, rig, cameras);
    (joined.iter().filter_map(|r| r.found(rig, cameras)).collect(), rays)
}

/// A square to try.
#[derive(Debug, Clone, Copy)]
struct Item {
    candidate: Candidate,
    row: u32,
    column: u32,
    /// As of its [`Square`].
    beyond: (u32, [i32; 2]),
}

/// The squares of a candidate's pixel, and those beyond it along its axis.
fn items_of(c: &Candidate, camera: &ConstructionCamera) -> impl Iterator<Item = Item> + use<> {
    let finer = COARSENESS as u32;
    let candidate = *c;
    let (columns, rows) = (camera.window.width * finer, camera.window.height * finer);
    let (row, column) = (c.pixel / camera.window.width * finer, c.pixel % camera.window.width * finer);
    let along = finer + 2 * BEYOND;
    (0..finer * along).filter_map(move |k| {
        let (side, step) = (k / along, k % along);
        let (beyond, back) = match step {
            step if step < BEYOND => (BEYOND - step, 1),
            step if step < BEYOND + finer => (0, 0),
            step => (step + 1 - BEYOND - finer, -1),
        };
        let (r, c, back) = if candidate.axis == 0 {
            (row + side, (column + step).checked_sub(BEYOND)?, [0, back])
        } else {
            ((row + step).checked_sub(BEYOND)?, column + side, [back, 0])
        };
        (r < rows && c < columns).then_some(Item { candidate, row: r, column: c, beyond: (beyond, back) })
    })
}

/// Drops squares beyond a pixel that do not lie in the plane of the one before them; the rest in
/// order of camera, row, column.
fn going_on(mut squares: Vec<Square>, rig: &Rig, cameras: &[ConstructionCamera]) -> Vec<Square> {
    squares.sort_by_key(|s| s.beyond.0);
    let mut kept: BTreeMap<(u32, u32, u32), Square> = BTreeMap::new();
    for s in squares {
        let [row, column] = s.beyond.1;
        let before = (s.camera, s.row.wrapping_add_signed(row), s.column.wrapping_add_signed(column));
        if s.beyond.0 == 0 || kept.get(&before).is_some_and(|b| in_plane(b, &s, rig, cameras)) {
            kept.entry((s.camera, s.row, s.column)).or_insert(s);
        }
    }
    kept.into_values().collect()
}

/// Whether a square continues the plane of another of the same camera.
fn in_plane(a: &Square, b: &Square, rig: &Rig, cameras: &[ConstructionCamera]) -> bool {
    let (u, v) = place(&cameras[a.camera as usize], f64::from(b.column) + 0.5, f64::from(b.row) + 0.5);
    a.surface == b.surface
        && a.plane.normal.dot(b.plane.normal).abs() >= SAME_NORMAL
        && (a.plane.disparity(u, v) - b.plane.disparity(u, v)).abs() <= 0.5 * rig.step()
}

/// Absolute image coordinates of a place in a camera's picture, in pixels at full resolution from
/// its upper left.
fn place(camera: &ConstructionCamera, column: f64, row: f64) -> (f64, f64) {
    let of = |start: i32, x: f64| (f64::from(start) + x / COARSENESS as f64) / camera.scale;
    (of(camera.window.left, column), of(camera.window.top, row))
}

/// Whether the layers hold a candidate's surface in its pixel and in both neighbours along its
/// axis; where no ray through the pixel's centre meets it, in one of them, from which it goes on.
fn held(rig: &Rig, layers: &[RawLayer], candidate: &Candidate, tolerance: &Tolerance) -> bool {
    let Candidate { home: (pixel, s), axis, beside, .. } = candidate;
    let (step, bit) = if *axis == 0 { (1, LINK_RIGHT) } else { (rig.window.width, LINK_DOWN) };
    let at = |layer: &RawLayer, pixel: u32| layer.samples.binary_search_by_key(&pixel, |x| x.0).ok();
    if *beside {
        // As steep: another face of the same surface ends there.
        let on = |layer: &RawLayer, pixel: u32| {
            at(layer, pixel).map(|i| &layer.samples[i].1).is_some_and(|n| {
                n.surface == s.surface && n.gradient[*axis] * s.gradient[*axis] > AS_STEEP * s.gradient[*axis].powi(2)
            })
        };
        let neighbours = [pixel.checked_sub(step), pixel.checked_add(step)];
        return layers.iter().any(|layer| neighbours.into_iter().flatten().any(|n| on(layer, n)));
    }
    layers.iter().any(|layer| {
        let linked = |i: usize| layer.links[i] & bit != 0;
        at(layer, *pixel).is_some_and(|i| {
            tolerance.same(&layer.samples[i].1, s)
                && linked(i)
                && pixel.checked_sub(step).and_then(|before| at(layer, before)).is_some_and(linked)
        })
    })
}

/// Squares of one plane and colour.
#[derive(Debug, Clone, Copy)]
struct Rectangle {
    first: Square,
    /// Row after the last, column after the last.
    end: [u32; 2],
}

/// Joins squares, in order of camera, row, column: along rows, then runs of the same columns.
fn rectangles(squares: &[Square], rig: &Rig, cameras: &[ConstructionCamera]) -> Vec<Rectangle> {
    let same = |a: &Square, b: &Square| {
        a.camera == b.camera
            && in_plane(a, b, rig, cameras)
            && (0..3).all(|k| a.rgb[k].abs_diff(b.rgb[k]) <= SAME_COLOUR)
    };
    let runs = squares
        .chunk_by(|a, b| a.row == b.row && a.column + 1 == b.column && same(a, b))
        .map(|run| Rectangle { first: run[0], end: [run[0].row + 1, run[0].column + run.len() as u32] });
    let mut done: Vec<Rectangle> = Vec::new();
    // By camera and columns: the rectangle that a run may be added to.
    let mut open: BTreeMap<(u32, u32, u32), usize> = BTreeMap::new();
    for run in runs {
        let key = (run.first.camera, run.first.column, run.end[1]);
        match open.get(&key).map(|i| &mut done[*i]) {
            Some(above) if above.end[0] == run.first.row && same(&above.first, &run.first) => above.end[0] += 1,
            _ => {
                open.insert(key, done.len());
                done.push(run);
            }
        }
    }
    done
}

/// A sliver before its disparities are coded.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    /// Places on the image, in parts of a pixel, and disparities.
    pub corners: [([i32; 2], f64); 4],
    pub rgb: [u8; 3],
}

impl Found {
    /// Disparities of its corners, 1/m.
    pub fn disparities(&self) -> impl Iterator<Item = f64> + use<> {
        self.corners.into_iter().map(|c| c.1)
    }

    pub fn coded(&self, codes: &DisparityCodes) -> Sliver {
        let corner = |([u, v], d): ([i32; 2], f64)| SliverCorner { u, v, disparity: codes.code(d) };
        Sliver { corners: self.corners.map(corner), rgb: self.rgb }
    }
}

impl Rectangle {
    /// As the image sees it; None where that is too far outside of it, or its plane runs behind
    /// its camera.
    fn found(&self, rig: &Rig, cameras: &[ConstructionCamera]) -> Option<Found> {
        let s = &self.first;
        let camera = &cameras[s.camera as usize];
        let back = camera.shift.reversed();
        let middle = place(camera, f64::from(s.column) + 0.5, f64::from(s.row) + 0.5);
        let believed = s.plane.disparity(middle.0, middle.1);
        let w = &rig.window;
        let part = |x: f64, start: i32, side: u32| {
            let x = x - f64::from(start);
            let margin = f64::from(Sliver::MARGIN);
            (x > -margin && x < f64::from(side) + margin).then(|| (x * f64::from(Sliver::PARTS)).round() as i32)
        };
        let corner = |row: u32, column: u32| {
            let (u, v) = place(camera, f64::from(column), f64::from(row));
            let d = s.plane.disparity(u, v);
            // A plane is believed up to eight times as far as it was hit; before the nearest
            // replaced cell, but for rounding, there is nothing.
            if d < 0.125 * believed || d * camera.near_m > 1.0 + 1e-3 {
                return None;
            }
            let (u, v, d) = back.apply(u, v, d);
            let corner = ([part(u, w.left, w.width)?, part(v, w.top, w.height)?], d);
            (d > 0.0 && d.is_finite()).then_some(corner)
        };
        let ([top, left], [bottom, right]) = ([s.row, s.column], self.end);
        let corners = [corner(top, left)?, corner(top, right)?, corner(bottom, left)?, corner(bottom, right)?];
        Some(Found { corners, rgb: s.rgb })
    }
}
