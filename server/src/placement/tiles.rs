//! Which parts of a near box's images anyone looks at, cut into tiles.
//!
//! In: a [`NearBox`] and its members. Out: windows on its faces. A face is cut into a raster; a square of it counts if some far cell lies
//! behind it and some eye, in some direction that uses the box, may have that part of the cell in its picture (`bin_planes`, with the
//! picture's own height and width: the square frustum is for counting). The squares that count are covered by rectangles.

use super::{
    bin_planes::{Behind, BinPlanes},
    near_box::{Cone, Member, NearBox},
    point::Context,
};
use glam::DVec3;
use ldi_protocol::Aabb;

/// Edge of a raster square, pixels. Smaller: tighter windows, longer planning. By judgement: a ninth of the picture's width or so.
const SQUARE_PIXELS: f64 = 192.0;
/// Rectangles larger than this are cut, pixels: the memory and time of one image stay bounded, and a client fetches what it looks at.
const TILE_PIXELS: f64 = 3.0e6;
/// A rectangle is cut where that leaves out more than this share of it. By judgement: each cut costs an image.
const WORTH_CUTTING: f64 = 0.25;
/// Tiles and faces overlap by this many pixels each way, so that surfaces join across their borders.
const OVERLAP_PIXELS: f64 = 2.0;
/// Depths are taken together by powers of two of the face's distance; the last holds all that is farther.
const OCTAVES: usize = 4;

/// All eyes that use a box in one unit of directions, with the planes of their pictures.
pub(super) struct Gaze {
    planes: BinPlanes,
    eyes: Aabb,
}

/// Everything that members look at through their box's images.
pub(super) fn gazes(ctx: &Context, members: &[&Member]) -> Vec<Gaze> {
    let mut eyes = vec![Aabb::EMPTY; ctx.directions.units()];
    for m in members {
        m.units.iter().for_each(|u| eyes[usize::from(*u)] = eyes[usize::from(*u)].union(m.eyes));
    }
    let (tx, ty) = ctx.picture_tan;
    let gaze = |(unit, eyes): (usize, Aabb)| {
        let (yaw, pitch) = ctx.directions.unit(unit);
        Gaze { planes: BinPlanes::new(yaw, pitch, tx, ty), eyes }
    };
    eyes.into_iter().enumerate().filter(|(_, e)| !e.is_empty()).map(gaze).collect()
}

/// The windows of a face that hold something to see: left, right, bottom, top, overlap included.
pub(super) fn windows(ctx: &Context, near: &NearBox, face: usize, gazes: &[Gaze]) -> Vec<[f64; 4]> {
    let Some(image) = &near.images[face] else { return Vec::new() };
    let pixels_per_unit = ctx.footprint.pixels_per_unit(image.scale);
    let mut raster = Raster::new(image.window, pixels_per_unit);
    raster.fill(ctx, near, &Cone::new(face, &near.distance), near.distance[face]);
    raster.keep_seen(near.cop, face, gazes);
    let overlap = OVERLAP_PIXELS / pixels_per_unit;
    let mut out = Vec::new();
    raster.cover([0, raster.columns, 0, raster.rows], &mut |r| {
        let [l, right, b, t] = raster.window_of(r);
        out.push([l - overlap, right + overlap, b - overlap, t + overlap]);
    });
    out
}

/// Squares of a face, with what lies behind each.
struct Raster {
    window: [f64; 4],
    columns: usize,
    rows: usize,
    /// Pixels of a square.
    square_pixels: f64,
    /// Per square and octave of depth: bounds relative to the centre of projection, along right, up, forward.
    content: Vec<[Aabb; OCTAVES]>,
    needed: Vec<bool>,
}

impl Raster {
    fn new(window: [f64; 4], pixels_per_unit: f64) -> Self {
        let count =
            |low: f64, high: f64| ((high - low) * pixels_per_unit / SQUARE_PIXELS).ceil().clamp(1.0, 256.0) as usize;
        let (columns, rows) = (count(window[0], window[1]), count(window[2], window[3]));
        let area = (window[1] - window[0]) * (window[3] - window[2]) * pixels_per_unit * pixels_per_unit;
        let n = columns * rows;
        Self {
            window,
            columns,
            rows,
            square_pixels: area / n as f64,
            content: vec![[Aabb::EMPTY; OCTAVES]; n],
            needed: vec![false; n],
        }
    }

    /// Tangents of a block of squares: columns from, to, rows from, to.
    fn window_of(&self, r: [usize; 4]) -> [f64; 4] {
        let [l, right, b, t] = self.window;
        let x = |c: usize| l + (right - l) * c as f64 / self.columns as f64;
        let y = |r: usize| b + (t - b) * r as f64 / self.rows as f64;
        [x(r[0]), x(r[1]), y(r[2]), y(r[3])]
    }

    /// Adds the far cells' parts to the squares that they lie behind.
    fn fill(&mut self, ctx: &Context, near: &NearBox, cone: &Cone, distance: f64) {
        let [left, right, bottom, top] = self.window;
        let place = |t: f64, low: f64, high: f64, n: usize| {
            (((t - low) / (high - low) * n as f64).floor().max(0.0) as usize).min(n - 1)
        };
        for cell in near.culled.iter() {
            let b = &ctx.cells.bounds[cell as usize];
            let local = cone.local(b.min - near.cop, b.max - near.cop);
            for octave in 0..OCTAVES {
                let from = distance * f64::from(1u32 << octave);
                let to = if octave + 1 == OCTAVES { f64::INFINITY } else { from * 2.0 };
                let mut part = local;
                (part.min.z, part.max.z) = (part.min.z.max(from), part.max.z.min(to));
                // A floor is as flat as can be: only what is empty is skipped.
                if part.min.z > part.max.z {
                    continue;
                }
                let Some(t) = cone.tangents_of(&part) else { continue };
                let columns = place(t[0], left, right, self.columns)..=place(t[1], left, right, self.columns);
                for column in columns {
                    for row in place(t[2], bottom, top, self.rows)..=place(t[3], bottom, top, self.rows) {
                        let w = self.window_of([column, column + 1, row, row + 1]);
                        let mut here = part;
                        for (axis, low, high) in [(0, w[0], w[1]), (1, w[2], w[3])] {
                            let reach = |t: f64, far: bool| t * if far { part.max.z } else { part.min.z };
                            here.min[axis] = here.min[axis].max(reach(low, low < 0.0));
                            here.max[axis] = here.max[axis].min(reach(high, high > 0.0));
                        }
                        if here.min.cmple(here.max).all() {
                            let at = &mut self.content[row * self.columns + column][octave];
                            *at = at.union(here);
                        }
                    }
                }
            }
        }
    }

    /// Marks the squares that someone may look at.
    fn keep_seen(&mut self, cop: DVec3, face: usize, gazes: &[Gaze]) {
        for (needed, content) in self.needed.iter_mut().zip(&self.content) {
            let mut boxes = content.iter().filter(|b| !b.is_empty()).map(|b| Cone::world(face, b, cop));
            *needed = boxes.any(|b| gazes.iter().any(|g| g.planes.show(&g.eyes, &b) != Behind::Never));
        }
    }

    /// Covers the needed squares of a block with rectangles.
    fn cover(&self, block: [usize; 4], found: &mut dyn FnMut([usize; 4])) {
        let Some((tight, count)) = self.tight(block) else { return };
        let [c0, c1, r0, r1] = tight;
        let squares = (c1 - c0) * (r1 - r0);
        let large = squares as f64 * self.square_pixels > TILE_PIXELS && squares > 1;
        let sparse = (squares - count) as f64 > WORTH_CUTTING * squares as f64;
        if !large && !sparse {
            return found(tight);
        }
        // The cut that leaves out the most squares; the most even one if the block is merely large.
        let mut best: Option<(usize, usize, [[usize; 4]; 2])> = None;
        let cuts = (c0 + 1..c1).map(|c| ([c0, c, r0, r1], [c, c1, r0, r1]));
        let cuts = cuts.chain((r0 + 1..r1).map(|r| ([c0, c1, r0, r], [c0, c1, r, r1])));
        for (a, b) in cuts {
            let area = |r: [usize; 4]| self.tight(r).map_or(0, |(t, _)| (t[1] - t[0]) * (t[3] - t[2]));
            let (a_area, b_area) = (area(a), area(b));
            let rank = (a_area + b_area, a_area.abs_diff(b_area));
            if best.as_ref().is_none_or(|x| rank < (x.0, x.1)) {
                best = Some((rank.0, rank.1, [a, b]));
            }
        }
        match best {
            Some((area, _, parts)) if large || (squares - area) as f64 > 0.5 * WORTH_CUTTING * squares as f64 => {
                parts.into_iter().for_each(|p| self.cover(p, found));
            }
            _ => found(tight),
        }
    }

    /// The smallest block around the needed squares of a block, and their number.
    fn tight(&self, [c0, c1, r0, r1]: [usize; 4]) -> Option<([usize; 4], usize)> {
        let (mut out, mut n) = ([usize::MAX, 0, usize::MAX, 0], 0);
        for row in r0..r1 {
            for column in c0..c1 {
                if self.needed[row * self.columns + column] {
                    out = [out[0].min(column), out[1].max(column + 1), out[2].min(row), out[3].max(row + 1)];
                    n += 1;
                }
            }
        }
        (n > 0).then_some((out, n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::{
        CostBenefit,
        bands::Directions,
        cells::{CellMask, Cells},
        near_box::FaceImage,
        test_scenes::settings,
    };

    /// A floor of one triangle has no thickness, and is all there is to see of its square.
    #[test]
    fn flat_cells_are_looked_at() {
        for [low, high] in [[-5.0, -5.0], [-5.1, -5.0]] {
            let floor = Aabb { min: DVec3::new(-1.0, low, -4.0), max: DVec3::new(1.0, high, -2.0) };
            let (cells, directions) = (Cells::new(vec![floor], vec![1]), Directions::new(60.0));
            let ctx = Context::new(&cells, &directions, &settings(9_000), 60.0, CostBenefit::default());
            let mut images = [None; 6];
            images[2] = Some(FaceImage { scale: 1.0, footprint_px: 1.5, window: [-0.2, 0.2, -0.8, -0.3] });
            let near = NearBox {
                cop: DVec3::ZERO,
                distance: [4.0; 6],
                images,
                culled: CellMask::of(1, &[0]),
                cost: 0.0,
                max_triangles: 0,
            };
            let (tx, ty) = ctx.picture_tan;
            let gaze = |pitch: [f64; 2]| Gaze {
                planes: BinPlanes::new([0.0, 10.0], pitch, tx, ty),
                eyes: Aabb { min: DVec3::splat(-0.5), max: DVec3::splat(0.5) },
            };
            assert_eq!(windows(&ctx, &near, 2, &[gaze([-60.0, -50.0])]).len(), 1, "looking down");
            assert_eq!(windows(&ctx, &near, 2, &[gaze([40.0, 50.0])]).len(), 0, "looking up");
        }
    }
}
