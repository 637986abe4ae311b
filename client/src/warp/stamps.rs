//! Stamps: every sample paints a fixed set of pixels, with its own colour and disparity.
//!
//! In: a transformed tile. Out: pixels, as 64-bit maxima like the quads'. The inexpensive
//! reconstructions of image-based rendering since McMillan: one pixel, 2 x 2, 3 x 3, the five-pixel
//! cross, the axis-aligned square of the sample's footprint, and the parallelogram of the sample's
//! transformed cell. Even-sized stamps centre on the sample to half a pixel.

use super::{
    LARGEST_FOOTPRINT_STAMP, Stamp,
    matrix::WarpMatrix,
    quad_raster::Target,
    tiles::{OVERLAP, Part, TILE_ROWS, Tile},
    transform::{Inside, Largest, Scratch, Slopes, TileTransform, Window, first_lanes},
};
use crate::simd::{LANES, Lanes};
use std::ops::Range;

/// Stamps all samples of a tile without its halo.
#[inline(always)]
pub fn stamp_tile<L: Lanes>(
    target: &mut Target<'_>,
    transform: &TileTransform,
    part: &Part,
    tile: &Tile,
    scratch: &Scratch,
    stamp: Stamp,
) {
    for row in own_rows(part, tile) {
        for i in row.clone().step_by(LANES) {
            let colours = (&part.colour[tile.first + i..], row.len() - (i - row.start));
            match stamp {
                Stamp::OnePixel => offsets8::<L>(target, scratch, colours, i, (0.0, &ONE_PIXEL)),
                Stamp::TwoByTwo => offsets8::<L>(target, scratch, colours, i, (0.5, &TWO_BY_TWO)),
                Stamp::ThreeByThree => offsets8::<L>(target, scratch, colours, i, (0.0, &THREE_BY_THREE)),
                Stamp::Cross => offsets8::<L>(target, scratch, colours, i, (0.0, &CROSS)),
                Stamp::Parallelogram | Stamp::Ewa => {
                    for (at, colour) in colours.0[..colours.1.min(LANES)].iter().enumerate() {
                        if let Some(splat) = Splat::new(transform, part, tile, scratch, i + at) {
                            splat.parallelogram(target, *colour);
                        }
                    }
                }
                Stamp::Footprint | Stamp::Quads => footprint8::<L>(target, scratch, colours, i),
            }
        }
    }
}

/// The one-pixel stamp without intermediate arrays: [`super::transform::transform_tile`] and
/// [`stamp_tile`] combined.
#[inline(always)]
pub fn pixels_of_tile<L: Lanes>(
    target: &mut Target<'_>,
    (matrix, transform): (&WarpMatrix, &TileTransform),
    (part, tile): (&Part, &Tile),
    mut largest: Option<&mut Largest<L>>,
) {
    let slopes = Slopes::<L>::new(transform);
    let window = target.window;
    let inside = Inside::<L>::new(&window);
    let (top, width) = (L::splat(window.first_row as f32), L::splat_int(window.width));
    for (row, samples) in own_rows(part, tile).enumerate() {
        let constants = transform.row_constants(matrix, row).map(L::splat);
        for i in samples.clone().step_by(LANES) {
            let at = tile.first + i;
            let p = slopes.warp(constants, L::load_bytes(&part.column[at..]), L::load(&part.disparity[at..]));
            let seen = L::and(inside.test(&p), first_lanes::<L>(samples.end - i));
            if let Some(largest) = &mut largest {
                largest.see(seen, &slopes.stretch(&p));
            }
            let from_row = L::mul_int(L::to_int(L::sub(p.y, top)), width);
            let pixels = L::array_int(L::add_int(from_row, L::to_int(p.x)));
            let values = L::joined(L::load_int(&part.colour[at..]), L::bits(p.disparity));
            target.put8(L::mask_bits(seen), pixels, values);
        }
    }
}

/// Tile-local numbers of the samples of each row, without halo.
pub fn own_rows<'a>(part: &'a Part, tile: &'a Tile) -> impl Iterator<Item = Range<usize>> + 'a {
    (0..TILE_ROWS).map(|row| part.row_of(tile, row, false))
}

/// A sample with the warp's Jacobian.
#[derive(Debug, Clone, Copy)]
pub struct Splat {
    /// Output pixels.
    pub x: f32,
    /// Output pixels.
    pub y: f32,
    /// 1/m.
    pub disparity: f32,
    /// d(x, y)/d(u, v) at fixed disparity: xu, xv, yu, yv.
    pub jacobian: [f32; 4],
}

impl Splat {
    /// Sample `i` of a transformed tile; None at or behind the eye's plane.
    #[inline(always)]
    pub fn new(transform: &TileTransform, part: &Part, tile: &Tile, scratch: &Scratch, i: usize) -> Option<Self> {
        let (x, y, disparity) = (scratch.x[i], scratch.y[i], scratch.disparity[i]);
        // Also refuses NaN.
        if !(disparity > 0.0) {
            return None;
        }
        let inverse = disparity / part.disparity[tile.first + i];
        let [rx, ry, rw] = &transform.rows;
        let entry = |slope: f32, p: f32, slope_w: f32| (slope - p * slope_w) * inverse;
        let jacobian = [entry(rx[0], x, rw[0]), entry(rx[1], x, rw[1]), entry(ry[0], y, rw[0]), entry(ry[1], y, rw[1])];
        Some(Self { x, y, disparity, jacobian })
    }

    /// Calls `visit` with the index in the window and the offset from the sample, pixels, of every
    /// pixel centre at most `reach` away along each axis, and at most half of
    /// [`LARGEST_FOOTPRINT_STAMP`].
    #[inline(always)]
    pub fn pixels(&self, window: Window, reach: [f32; 2], mut visit: impl FnMut(usize, [f32; 2])) {
        let [rx, ry] = reach.map(|r| r.min(0.5 * LARGEST_FOOTPRINT_STAMP));
        let (x, y) = (self.x - 0.5, self.y - 0.5 - window.first_row as f32);
        // Saturating conversions: far outside stays outside.
        let span = |p: f32, r: f32, size: u32| {
            let (from, to) = ((p - r).ceil().max(0.0) as usize, (p + r).floor().min(size as f32 - 1.0));
            from..if to < 0.0 { 0 } else { to as usize + 1 }
        };
        for row in span(y, ry, window.rows) {
            for column in span(x, rx, window.width) {
                visit(row * window.width as usize + column, [column as f32 - x, row as f32 - y]);
            }
        }
    }

    /// Paints the pixel centres inside the sample's cell, and the pixel that contains the sample.
    #[inline(always)]
    fn parallelogram(&self, target: &mut Target<'_>, colour: u32) {
        let [a, b, c, d] = self.jacobian;
        let half = 0.5 + OVERLAP;
        let reach = [(a.abs() + b.abs()) * half, (c.abs() + d.abs()) * half].map(|r| r.max(0.5));
        let inverse = 1.0 / (a * d - b * c);
        let bits = self.disparity.to_bits();
        self.pixels(target.window, reach, |at, [dx, dy]| {
            let (s, t) = ((d * dx - b * dy) * inverse, (a * dy - c * dx) * inverse);
            let home = dx.abs().max(dy.abs()) <= 0.5;
            if home || s.abs().max(t.abs()) <= half {
                target.put(at, bits, colour);
            }
        });
    }
}

/// Pixels of a stamp relative to the one that contains the sample's position less the stamp's
/// shift.
type Offsets = [(i8, i8)];
const ONE_PIXEL: [(i8, i8); 1] = [(0, 0)];
const TWO_BY_TWO: [(i8, i8); 4] = [(0, 0), (1, 0), (0, 1), (1, 1)];
const CROSS: [(i8, i8); 5] = [(0, -1), (-1, 0), (0, 0), (1, 0), (0, 1)];
const THREE_BY_THREE: [(i8, i8); 9] = [(-1, -1), (0, -1), (1, -1), (-1, 0), (0, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];

/// The same stamp at eight samples, of which the first `count` count.
#[inline(always)]
fn offsets8<L: Lanes>(
    target: &mut Target<'_>,
    scratch: &Scratch,
    (colours, count): (&[u32], usize),
    i: usize,
    (shift, offsets): (f32, &Offsets),
) {
    let window = target.window;
    let shift = L::splat(shift);
    let column = L::floor(L::sub(L::load(&scratch.x[i..]), shift));
    let row = L::floor(L::sub(L::load(&scratch.y[i..]), shift));
    let row = L::sub(row, L::splat(window.first_row as f32));
    let disparity = L::load(&scratch.disparity[i..]);
    let ahead = L::and(L::gt(disparity, L::splat(0.0)), first_lanes::<L>(count));
    if L::mask_bits(ahead) == 0 {
        return;
    }
    let values = L::joined(L::load_int(colours), L::bits(disparity));
    let (zero, width, rows) = (L::splat(0.0), L::splat(window.width as f32), L::splat(window.rows as f32));
    for (dx, dy) in offsets {
        let column = L::add(column, L::splat(f32::from(*dx)));
        let row = L::add(row, L::splat(f32::from(*dy)));
        let inside_x = L::and(L::ge(column, zero), L::gt(width, column));
        let inside_y = L::and(L::ge(row, zero), L::gt(rows, row));
        let bits = L::mask_bits(L::and(ahead, L::and(inside_x, inside_y)));
        let from_row = L::mul_int(L::to_int(row), L::splat_int(window.width));
        let at = L::array_int(L::add_int(from_row, L::to_int(column)));
        target.put8(bits, at, values);
    }
}

/// Squares of the footprints' sizes, each placed so that its centre is nearest to its sample, at
/// eight samples, of which those with colours count.
#[inline(always)]
fn footprint8<L: Lanes>(target: &mut Target<'_>, scratch: &Scratch, (colours, count): (&[u32], usize), i: usize) {
    let window = target.window;
    let (x, y) = (L::load(&scratch.x[i..]), L::load(&scratch.y[i..]));
    let y = L::sub(y, L::splat(window.first_row as f32));
    let disparity = L::load(&scratch.disparity[i..]);
    // The margin admits stamps that reach in from outside. False for NaN.
    let (low, margin) = (L::splat(-LARGEST_FOOTPRINT_STAMP), LARGEST_FOOTPRINT_STAMP);
    let across = L::and(L::gt(x, low), L::gt(L::splat(window.width as f32 + margin), x));
    let down = L::and(L::gt(y, low), L::gt(L::splat(window.rows as f32 + margin), y));
    let ahead = L::and(L::gt(disparity, L::splat(0.0)), first_lanes::<L>(count));
    let on = L::and(ahead, L::and(across, down));
    if L::mask_bits(on) == 0 {
        return;
    }
    // The next integer up, in the range of sides: minus the floor of minus.
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let up = L::sub(zero, L::floor(L::sub(zero, L::sqrt(L::load(&scratch.footprint2[i..])))));
    let side = L::min(L::max(up, one), L::splat(LARGEST_FOOTPRINT_STAMP));
    let offset = L::mul(L::splat(0.5), L::sub(side, one));
    let (left, top) = (L::floor(L::sub(x, offset)), L::floor(L::sub(y, offset)));
    let values = L::joined(L::load_int(colours), L::bits(disparity));
    let (width, rows) = (L::splat(window.width as f32), L::splat(window.rows as f32));
    // Pixel by pixel of the largest square, at all eight samples.
    let mut down = zero;
    loop {
        let on = L::and(on, L::gt(side, down));
        if L::mask_bits(on) == 0 {
            break;
        }
        let row = L::add(top, down);
        let on = L::and(on, L::and(L::ge(row, zero), L::gt(rows, row)));
        let from_row = L::mul_int(L::to_int(row), L::splat_int(window.width));
        let mut across = zero;
        loop {
            let on = L::and(on, L::gt(side, across));
            if L::mask_bits(on) == 0 {
                break;
            }
            let column = L::add(left, across);
            let bits = L::mask_bits(L::and(on, L::and(L::ge(column, zero), L::gt(width, column))));
            target.put8(bits, L::array_int(L::add_int(from_row, L::to_int(column))), values);
            across = L::add(across, one);
        }
        down = L::add(down, one);
    }
}
