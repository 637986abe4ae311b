//! The reference warp in f64, slow and simple, to which the fast one is compared.
//!
//! In: a decoded image, a pose, the output camera. Out: a [`FarFrame`]. No tiles, no culling, no
//! bands: every sample, square and pixel is processed by the rules of `tile_builder` and `stamps`,
//! directly from the layers.

use super::{
    FarFrame, LARGEST_FOOTPRINT_STAMP, Stamp, WarpMatrix, Warped,
    ewa::{CUT, PIXEL_VARIANCE, SAME_SURFACE, SAMPLE_VARIANCE},
    tiles::OVERLAP,
};
use crate::frame::{pack_rgb, unpack_rgb};
use ldi_protocol::{
    OutputCamera, Pose,
    ldi::{END_PARTS, LINK_DOWN, LINK_RIGHT, Ldi, LdiLayer, SIDES, SLOPE_CODES, Sliver, SliverCorner, end_of},
};
use std::collections::BTreeMap;

/// Warps with any stamp, z-buffered.
pub fn warp(ldi: &Ldi, pose: &Pose, camera: &OutputCamera, stamp: Stamp) -> FarFrame {
    let matrix = WarpMatrix::new(&ldi.camera, pose, camera);
    let mut frame = FarFrame::new(camera.width, camera.height);
    frame.packed.fill(0);
    frame.stale = false;
    for layer in &ldi.layers {
        let grid = Grid::new(ldi, layer);
        if stamp == Stamp::Quads {
            grid.quads(&matrix, &mut frame);
        } else if matches!(stamp, Stamp::Parallelogram | Stamp::Ewa) {
            grid.samples.iter().for_each(|(at, s)| paint_parallelogram(&matrix, *at, s, &mut frame));
        } else {
            grid.samples.iter().for_each(|(at, s)| paint_stamp(&matrix, *at, s, stamp, &mut frame));
        }
    }
    if stamp == Stamp::Ewa {
        weighted_means(&matrix, ldi, &mut frame);
    }
    if stamp == Stamp::Quads {
        for s in &ldi.slivers {
            let rgb = s.rgb.map(f64::from);
            let place = |x: i32| f64::from(x) / f64::from(Sliver::PARTS);
            let corner = |c: &SliverCorner| Vertex {
                u: place(c.u),
                v: place(c.v),
                disparity: ldi.codes.disparity(c.disparity),
                rgb,
            };
            paint_quad(&matrix, s.corners.each_ref().map(corner), &mut frame);
        }
    }
    frame
}

/// A sample by itself.
#[derive(Debug, Clone, Copy)]
struct Sample {
    disparity: f64,
    colour: u32,
    links: u8,
    ends: u16,
    /// Change of disparity to the next column and row beyond what links tell.
    slopes: [f64; 2],
}

/// A layer as a map from (row, column) to samples.
struct Grid {
    samples: BTreeMap<(i64, i64), Sample>,
}

/// A corner of a polygon in LDI pixels.
#[derive(Debug, Clone, Copy)]
struct Vertex {
    u: f64,
    v: f64,
    disparity: f64,
    rgb: [f64; 3],
}

fn put(frame: &mut FarFrame, column: i64, row: i64, disparity: f64, colour: u32) {
    if (0..i64::from(frame.width)).contains(&column) && (0..i64::from(frame.height)).contains(&row) {
        let at = (row * i64::from(frame.width) + column) as usize;
        let value = u64::from((disparity as f32).to_bits()) << 32 | u64::from(colour);
        frame.packed[at] = frame.packed[at].max(value);
    }
}

fn paint_stamp(matrix: &WarpMatrix, (row, column): (i64, i64), s: &Sample, stamp: Stamp, frame: &mut FarFrame) {
    let (u, v) = (column as f64 + 0.5, row as f64 + 0.5);
    let Some(p) = matrix.warp(u, v, s.disparity) else { return };
    let footprint = matrix.footprint(u, v, s.disparity).unwrap_or(1.0);
    let side = match stamp {
        Stamp::OnePixel => 1,
        Stamp::TwoByTwo => 2,
        Stamp::ThreeByThree | Stamp::Cross => 3,
        _ => footprint.ceil().clamp(1.0, f64::from(LARGEST_FOOTPRINT_STAMP)) as i64,
    };
    let offset = 0.5 * (side - 1) as f64;
    let (left, top) = ((p.x - offset).floor() as i64, (p.y - offset).floor() as i64);
    for dy in 0..side {
        for dx in 0..side {
            if stamp != Stamp::Cross || dx == 1 || dy == 1 {
                put(frame, left + dx, top + dy, p.disparity, s.colour);
            }
        }
    }
}

/// Pixel centres around a warped sample, within half of the largest stamp along each axis: column,
/// row, offset.
fn around(p: Warped) -> impl Iterator<Item = (i64, i64, [f64; 2])> {
    let half = 0.5 * f64::from(LARGEST_FOOTPRINT_STAMP);
    let reach = half as i64 + 1;
    let (left, top) = (p.x.floor() as i64 - reach, p.y.floor() as i64 - reach);
    let all = (0..=2 * reach).flat_map(move |dy| (0..=2 * reach).map(move |dx| (left + dx, top + dy)));
    all.map(move |(column, row)| (column, row, [column as f64 + 0.5 - p.x, row as f64 + 0.5 - p.y]))
        .filter(move |(_, _, [dx, dy])| dx.abs() <= half && dy.abs() <= half)
}

fn paint_parallelogram(matrix: &WarpMatrix, (row, column): (i64, i64), s: &Sample, frame: &mut FarFrame) {
    let (u, v) = (column as f64 + 0.5, row as f64 + 0.5);
    let (Some(p), Some([a, b, c, d])) = (matrix.warp(u, v, s.disparity), matrix.jacobian(u, v, s.disparity)) else {
        return;
    };
    let (det, half) = (a * d - b * c, 0.5 + f64::from(OVERLAP));
    for (column, row, [dx, dy]) in around(p) {
        let (s_at, t_at) = ((d * dx - b * dy) / det, (a * dy - c * dx) / det);
        if (s_at.abs() <= half && t_at.abs() <= half) || (dx.abs() <= 0.5 && dy.abs() <= 0.5) {
            put(frame, column, row, p.disparity, s.colour);
        }
    }
}

/// The colours of [`Stamp::Ewa`] over a picture of parallelograms, by the formulas that `ewa`
/// states.
fn weighted_means(matrix: &WarpMatrix, ldi: &Ldi, frame: &mut FarFrame) {
    let [sample, pixel, cut, same] = [SAMPLE_VARIANCE, PIXEL_VARIANCE, CUT, SAME_SURFACE].map(f64::from);
    let mut sums = vec![[0.0f64; 4]; frame.packed.len()];
    for layer in &ldi.layers {
        for ((row, column), s) in &Grid::new(ldi, layer).samples {
            let (u, v) = (*column as f64 + 0.5, *row as f64 + 0.5);
            let (warped, jacobian) = (matrix.warp(u, v, s.disparity), matrix.jacobian(u, v, s.disparity));
            let (Some(p), Some([a, b, c, d])) = (warped, jacobian) else { continue };
            let variance = glam::DMat2::from_cols_array(&[
                sample * (a * a + b * b) + pixel,
                sample * (a * c + b * d),
                sample * (a * c + b * d),
                sample * (c * c + d * d) + pixel,
            ]);
            let inverse = variance.inverse();
            for (column, row, offset) in around(p) {
                let inside =
                    (0..i64::from(frame.width)).contains(&column) && (0..i64::from(frame.height)).contains(&row);
                let at = (row * i64::from(frame.width) + column) as usize;
                let Some((_, seen)) = inside.then(|| frame.get(at)).flatten() else { continue };
                let offset = glam::DVec2::from_array(offset);
                let q = offset.dot(inverse * offset);
                if (f64::from(seen) - p.disparity).abs() <= same * f64::from(seen) && q < cut {
                    let weight = (1.0 - q / cut).powi(4);
                    let light = unpack_rgb(s.colour).map(|c| f64::from(c).powi(2));
                    let add = [light[0], light[1], light[2], 1.0].map(|x| x * weight);
                    sums[at].iter_mut().zip(add).for_each(|(sum, x)| *sum += x);
                }
            }
        }
    }
    for (packed, [r, g, b, w]) in frame.packed.iter_mut().zip(sums).filter(|(_, s)| s[3] > 0.0) {
        let colour = pack_rgb([r, g, b].map(|sum| (sum / w).sqrt().round() as u8));
        *packed = *packed >> 32 << 32 | u64::from(colour);
    }
}

impl Grid {
    fn new(ldi: &Ldi, layer: &LdiLayer) -> Self {
        let mut samples = BTreeMap::new();
        for segment in &layer.segments {
            let first = segment.first as usize;
            for i in first..first + usize::from(segment.count) {
                let column = i64::from(segment.column_base) + i64::from(layer.column[i]);
                let sample = Sample {
                    disparity: ldi.codes.disparity(layer.disparity[i]),
                    colour: pack_rgb(layer.rgb[i]),
                    links: layer.links[i],
                    ends: layer.ends[i],
                    slopes: layer.slopes[i].map(|s| f64::from(i32::from(s) * SLOPE_CODES) * ldi.codes.step),
                };
                samples.insert((i64::from(segment.row), column), sample);
            }
        }
        Self { samples }
    }

    /// Whether two neighbours continue one surface; `step` is (0, +-1) or (+-1, 0).
    fn linked(&self, (r, c): (i64, i64), step: (i64, i64)) -> bool {
        let other = (r + step.0, c + step.1);
        let first = (r.min(other.0), c.min(other.1));
        let bit = if step.0 == 0 { LINK_RIGHT } else { LINK_DOWN };
        self.samples.contains_key(&(r, c)) && self.samples.contains_key(&other) && self.samples[&first].links & bit != 0
    }

    /// What lies half a cell from a sample along an axis: (extent, change of disparity, change of
    /// squared codes).
    fn half(&self, at: (i64, i64), step: (i64, i64)) -> (f64, f64, [f64; 3]) {
        if step == (0, 0) {
            return (0.0, 0.0, [0.0; 3]);
        }
        let here = self.samples[&at];
        let beside = |s: (i64, i64)| self.samples[&(at.0 + s.0, at.1 + s.1)];
        let sign = (step.0 + step.1) as f64;
        if self.linked(at, step) {
            let other = beside(step);
            let (a, b) = (unpack_rgb(here.colour).map(f64::from), unpack_rgb(other.colour).map(f64::from));
            let change = |i: usize| ((a[i] * a[i] + b[i] * b[i]) * 0.5).sqrt() - a[i];
            return (0.5 * sign, (other.disparity - here.disparity) * 0.5, std::array::from_fn(change));
        }
        let side =
            SIDES.iter().position(|s| [i64::from(s[1]), i64::from(s[0])] == [step.0, step.1]).unwrap_or_default();
        let extent = f64::from(end_of(here.ends, side)) / f64::from(END_PARTS) + f64::from(OVERLAP);
        let back = (-step.0, -step.1);
        let linked = if self.linked(at, back) { here.disparity - beside(back).disparity } else { 0.0 };
        let slope = linked + here.slopes[side / 2] * sign;
        (extent * sign, slope * extent, [0.0; 3])
    }

    fn vertex(&self, at: (i64, i64), across: i64, down: i64) -> Vertex {
        let here = self.samples[&at];
        let (du, slope_u, colour_u) = self.half(at, (0, across));
        let (dv, slope_v, colour_v) = self.half(at, (down, 0));
        let own = unpack_rgb(here.colour).map(f64::from);
        Vertex {
            u: at.1 as f64 + 0.5 + du,
            v: at.0 as f64 + 0.5 + dv,
            disparity: (here.disparity + slope_u + slope_v).max(here.disparity * 0.25),
            rgb: std::array::from_fn(|i| (own[i] + colour_u[i] + colour_v[i]).clamp(0.0, 255.0)),
        }
    }

    fn alone(&self, at: (i64, i64)) -> bool {
        [(0, 1), (0, -1), (1, 0), (-1, 0)].into_iter().all(|step| !self.linked(at, step))
    }

    fn quads(&self, matrix: &WarpMatrix, frame: &mut FarFrame) {
        let mut squares: Vec<(i64, i64)> =
            self.samples.keys().flat_map(|(r, c)| [(r - 1, c - 1), (r - 1, *c), (*r, c - 1), (*r, *c)]).collect();
        squares.sort_unstable();
        squares.dedup();
        for a in squares {
            self.square(matrix, a, frame);
        }
        for at in self.samples.keys().filter(|at| self.alone(**at)) {
            let corner = |across, down| self.vertex(*at, across, down);
            paint_quad(matrix, [corner(-1, -1), corner(1, -1), corner(-1, 1), corner(1, 1)], frame);
        }
    }

    /// The square right and below of `a`.
    fn square(&self, matrix: &WarpMatrix, a: (i64, i64), frame: &mut FarFrame) {
        let (b, e, f) = ((a.0, a.1 + 1), (a.0 + 1, a.1), (a.0 + 1, a.1 + 1));
        let (ab, ef) = (self.linked(a, (0, 1)), self.linked(e, (0, 1)));
        let (ae, bf) = (self.linked(a, (1, 0)), self.linked(b, (1, 0)));
        let v = |at, across, down| self.vertex(at, across, down);
        let mut draw = |q: [Vertex; 4]| paint_quad(matrix, q, frame);
        let mut left: Vec<(i64, i64)> = [a, b, e, f].into_iter().filter(|s| self.samples.contains_key(s)).collect();
        if ab && ef && ae && bf {
            draw([v(a, 0, 0), v(b, 0, 0), v(e, 0, 0), v(f, 0, 0)]);
            return;
        }
        if ab || ef {
            if ab {
                draw([v(a, 0, 0), v(b, 0, 0), v(a, 0, 1), v(b, 0, 1)]);
                left.retain(|s| *s != a && *s != b);
            }
            if ef {
                draw([v(e, 0, -1), v(f, 0, -1), v(e, 0, 0), v(f, 0, 0)]);
                left.retain(|s| *s != e && *s != f);
            }
        } else {
            if ae {
                draw([v(a, 0, 0), v(a, 1, 0), v(e, 0, 0), v(e, 1, 0)]);
                left.retain(|s| *s != a && *s != e);
            }
            if bf {
                draw([v(b, -1, 0), v(b, 0, 0), v(f, -1, 0), v(f, 0, 0)]);
                left.retain(|s| *s != b && *s != f);
            }
        }
        for s in left.into_iter().filter(|s| !self.alone(*s)) {
            let (x0, x1) = if s.1 == a.1 { (0, 1) } else { (-1, 0) };
            let (y0, y1) = if s.0 == a.0 { (0, 1) } else { (-1, 0) };
            draw([v(s, x0, y0), v(s, x1, y0), v(s, x0, y1), v(s, x1, y1)]);
        }
    }
}

/// Paints the pixel centres inside the two triangles of a quad, with bilinear attributes.
fn paint_quad(matrix: &WarpMatrix, corners: [Vertex; 4], frame: &mut FarFrame) {
    let warped: Vec<Warped> = corners.iter().filter_map(|c| matrix.warp(c.u, c.v, c.disparity)).collect();
    let [a, b, e, f] = warped[..] else { return };
    let bound = |pick: fn(&Warped) -> f64, limit: u32| {
        let values = [a, b, e, f].map(|p| pick(&p));
        let low = values.into_iter().fold(f64::MAX, f64::min).floor().max(0.0);
        let high = values.into_iter().fold(f64::MIN, f64::max).ceil().min(f64::from(limit));
        (low as i64, high as i64)
    };
    let ((x0, x1), (y0, y1)) = (bound(|p| p.x, frame.width), bound(|p| p.y, frame.height));
    for row in y0..y1 {
        for column in x0..x1 {
            let centre = (column as f64 + 0.5, row as f64 + 0.5);
            let first = locate(centre, a, b, e);
            let second = locate(centre, f, e, b).map(|(s, t)| (1.0 - s, 1.0 - t));
            let Some((s, t)) = first.or(second) else { continue };
            let bilinear = |p: [f64; 4]| {
                let (top, bottom) = (p[0] + s * (p[1] - p[0]), p[2] + s * (p[3] - p[2]));
                top + t * (bottom - top)
            };
            let disparity = bilinear([a, b, e, f].map(|p| p.disparity));
            let light = |i: usize| bilinear(corners.map(|c| c.rgb[i] * c.rgb[i])).max(0.0);
            let rgb = std::array::from_fn(|i| (light(i).sqrt() + 0.5) as u8);
            put(frame, column, row, disparity, pack_rgb(rgb));
        }
    }
}

/// Coordinates (s, t) of a point in the triangle (p, p + s, p + t); None outside.
fn locate((x, y): (f64, f64), p: Warped, across: Warped, down: Warped) -> Option<(f64, f64)> {
    let (ax, ay) = (across.x - p.x, across.y - p.y);
    let (dx, dy) = (down.x - p.x, down.y - p.y);
    let (qx, qy) = (x - p.x, y - p.y);
    let det = ax * dy - ay * dx;
    let (s, t) = ((qx * dy - qy * dx) / det, (ax * qy - ay * qx) / det);
    (s >= 0.0 && t >= 0.0 && s + t <= 1.0).then_some((s, t))
}
