//! The f32 transform of a tile's samples, eight at a time.
//!
//! In: the f64 [`WarpMatrix`]. Out: per tile, coefficients relative to the tile's upper left corner, so that f32
//! multiplies small column and row numbers only; per row, one affine function of (column, disparity) for each of X, Y,
//! W; per sample one division. Stated error against f64, tested on rows of 8,192: 1/64 pixel for samples
//! that land within 4,096 pixels of the picture's origin and whose footprint is at most 4 pixels (the error comes from rounding
//! X to 24 bits, about X 2^-23, and grows with magnification as 1/W does); 2^-18 relative in disparity.

use super::{
    matrix::WarpMatrix,
    prepared::{Part, TILE_ROWS, TILE_SAMPLES, Tile},
};
use crate::lanes::{LANES, Lanes};

/// Coefficients for one tile: X, Y, W as functions of tile-relative (u, v, 1, d).
#[derive(Debug, Clone, Copy)]
pub struct TileTransform {
    /// Rows X, Y, W; columns u, v, 1, d.
    pub rows: [[f32; 4]; 3],
    origin: [[f64; 2]; 3],
}

impl TileTransform {
    /// Moves the origin of (u, v) to the tile's upper left corner, in f64.
    pub fn new(matrix: &WarpMatrix, tile: &Tile) -> Self {
        let (u, v) = (f64::from(tile.column), f64::from(tile.row));
        let origin = matrix.rows.map(|r| [r[0] * u + r[1] * v + r[2], r[1]]);
        let rows = std::array::from_fn(|i| {
            let r = &matrix.rows[i];
            [r[0] as f32, r[1] as f32, origin[i][0] as f32, r[3] as f32]
        });
        Self { rows, origin }
    }

    /// The constant terms at the pixel centre of column 0 in a row of the tile, rounded once.
    pub fn row_constants(&self, matrix: &WarpMatrix, row: usize) -> [f32; 3] {
        let v = row as f64 + 0.5;
        std::array::from_fn(|i| (self.origin[i][0] + self.origin[i][1] * v + matrix.rows[i][0] * 0.5) as f32)
    }
}

/// A tile's samples on the output: pixels and 1/m. Disparity is -1 for samples at or behind the eye's plane.
pub struct Scratch {
    /// Output column coordinates.
    pub x: [f32; TILE_SAMPLES + LANES],
    /// Output row coordinates.
    pub y: [f32; TILE_SAMPLES + LANES],
    /// Output disparities.
    pub disparity: [f32; TILE_SAMPLES + LANES],
    /// Footprints, squared output pixels: the larger singular value of d(x, y)/d(u, v) at fixed disparity, squared.
    pub footprint2: [f32; TILE_SAMPLES + LANES],
}

impl Default for Scratch {
    fn default() -> Self {
        let zero = [0.0; TILE_SAMPLES + LANES];
        Self { x: zero, y: zero, disparity: zero, footprint2: zero }
    }
}

/// One sample before and after the f32 kernels, for those who judge them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transformed {
    /// Column of its centre in the image, LDI pixels.
    pub u: f64,
    /// Row of its centre.
    pub v: f64,
    /// Its disparity as the kernels got it, 1/m.
    pub disparity: f32,
    /// On the output, pixels.
    pub x: f32,
    /// On the output, pixels.
    pub y: f32,
    /// On the output, 1/m; -1 at or behind the eye's plane.
    pub warped_disparity: f32,
    /// Output pixels.
    pub footprint: f32,
}

/// What lies on the picture: columns from 0, rows from `first_row`.
#[derive(Debug, Clone, Copy)]
pub struct Window {
    /// Columns.
    pub width: u32,
    /// First row.
    pub first_row: u32,
    /// Rows.
    pub rows: u32,
}

/// Eight warped points; disparity -1 where W <= 0 (or NaN).
#[inline(always)]
pub fn warp8<L: Lanes>(xyw: [L::F; 3]) -> [L::F; 3] {
    let [x, y, w] = xyw;
    let inverse = L::div(L::splat(1.0), w);
    [L::mul(x, inverse), L::mul(y, inverse), inverse]
}

/// constant + a x + b y.
#[inline(always)]
pub fn affine8<L: Lanes>(constant: L::F, [a, x]: [L::F; 2], [b, y]: [L::F; 2]) -> L::F {
    L::add(L::add(constant, L::mul(a, x)), L::mul(b, y))
}

/// An entry of the Jacobian of (X/W, Y/W): (dX - p dW) / W.
#[inline(always)]
fn entry<L: Lanes>(slope: L::F, p: L::F, slope_w: L::F, inverse: L::F) -> L::F {
    L::mul(L::sub(slope, L::mul(p, slope_w)), inverse)
}

/// The larger singular value of [[a, b], [c, d]], squared.
#[inline(always)]
fn largest_singular_value2<L: Lanes>(a: L::F, b: L::F, c: L::F, d: L::F) -> L::F {
    let trace = L::add(L::add(L::mul(a, a), L::mul(b, b)), L::add(L::mul(c, c), L::mul(d, d)));
    let det = L::sub(L::mul(a, d), L::mul(b, c));
    let discriminant = L::sub(L::mul(trace, trace), L::mul(L::splat(4.0), L::mul(det, det)));
    L::mul(L::splat(0.5), L::add(trace, L::sqrt(L::max(discriminant, L::splat(0.0)))))
}

/// Eight samples on the output.
#[derive(Clone, Copy)]
pub struct Points<L: Lanes> {
    /// Pixels.
    pub x: L::F,
    /// Pixels.
    pub y: L::F,
    /// 1/m; -1 at or behind the eye's plane.
    pub disparity: L::F,
    /// See [`Scratch::footprint2`].
    pub footprint2: L::F,
}

/// A tile's coefficients in all lanes; rows X, Y, W.
#[derive(Clone, Copy)]
pub struct Slopes<L: Lanes> {
    u: [L::F; 3],
    v: [L::F; 3],
    d: [L::F; 3],
}

impl<L: Lanes> Slopes<L> {
    /// Of a tile.
    #[inline(always)]
    pub fn new(transform: &TileTransform) -> Self {
        let column = |k: usize| transform.rows.map(|r| L::splat(r[k]));
        Self { u: column(0), v: column(1), d: column(3) }
    }

    /// Warps eight samples of one row from its constants, their columns in the tile and their disparities.
    #[inline(always)]
    pub fn warp(&self, constants: [L::F; 3], u: L::F, d: L::F) -> Points<L> {
        let [xu, yu, wu] = self.u;
        let [xv, yv, wv] = self.v;
        let [xd, yd, wd] = self.d;
        let [x0, y0, w0] = constants;
        let x = affine8::<L>(x0, [xu, u], [xd, d]);
        let y = affine8::<L>(y0, [yu, u], [yd, d]);
        let w = affine8::<L>(w0, [wu, u], [wd, d]);
        let [x, y, inverse] = warp8::<L>([x, y, w]);
        let ahead = L::gt(inverse, L::splat(0.0));
        let footprint2 = largest_singular_value2::<L>(
            entry::<L>(xu, x, wu, inverse),
            entry::<L>(xv, x, wv, inverse),
            entry::<L>(yu, y, wu, inverse),
            entry::<L>(yv, y, wv, inverse),
        );
        Points { x, y, disparity: L::select(ahead, L::mul(d, inverse), L::splat(-1.0)), footprint2 }
    }
}

/// Tells which points lie in a window, ahead of the eye.
#[derive(Clone, Copy)]
pub struct Inside<L: Lanes> {
    right: L::F,
    top: L::F,
    bottom: L::F,
}

impl<L: Lanes> Inside<L> {
    /// Of a window.
    #[inline(always)]
    pub fn new(window: &Window) -> Self {
        Self {
            right: L::splat(window.width as f32),
            top: L::splat(window.first_row as f32),
            bottom: L::splat((window.first_row + window.rows) as f32),
        }
    }

    /// Mask.
    #[inline(always)]
    pub fn test(&self, p: &Points<L>) -> L::I {
        let zero = L::splat(0.0);
        let across = L::and(L::ge(p.x, zero), L::gt(self.right, p.x));
        let down = L::and(L::ge(p.y, self.top), L::gt(self.bottom, p.y));
        L::and(L::and(across, down), L::gt(p.disparity, zero))
    }
}

/// Mask of the first `count` lanes.
#[inline(always)]
pub fn first_lanes<L: Lanes>(count: usize) -> L::I {
    L::gt(L::splat(count as f32), L::from_int(L::load_int(&LANE_NUMBERS)))
}

/// Transforms all samples of a tile, halo included, into `scratch`; returns the largest squared footprint among those
/// that land inside the window.
#[inline(always)]
pub fn transform_tile<L: Lanes>(
    matrix: &WarpMatrix,
    part: &Part,
    tile: &Tile,
    window: &Window,
    scratch: &mut Scratch,
) -> f32 {
    let transform = TileTransform::new(matrix, tile);
    let slopes = Slopes::<L>::new(&transform);
    let inside = Inside::<L>::new(window);
    let mut largest = L::splat(0.0);
    for row in 0..=TILE_ROWS {
        let constants = transform.row_constants(matrix, row).map(L::splat);
        let (from, to) = (tile.row_start[row] as usize, tile.row_start[row + 1] as usize);
        // The last group may spill into the next row's places, which are written afterwards.
        for i in (from..to).step_by(LANES) {
            let at = tile.first + i;
            let p = slopes.warp(constants, L::load_bytes(&part.column[at..]), L::load(&part.disparity[at..]));
            L::store(p.x, &mut scratch.x[i..]);
            L::store(p.y, &mut scratch.y[i..]);
            L::store(p.disparity, &mut scratch.disparity[i..]);
            L::store(p.footprint2, &mut scratch.footprint2[i..]);
            // Lanes past the row's end hold another row's samples with this row's constants: harmless on the picture,
            // because they are overwritten, but not for the maximum.
            let seen = L::and(inside.test(&p), first_lanes::<L>(to - i));
            largest = L::max(L::select(seen, p.footprint2, L::splat(0.0)), largest);
        }
    }
    L::array(largest).into_iter().fold(0.0, f32::max)
}

/// 0 to 7.
pub const LANE_NUMBERS: [u32; LANES] = [0, 1, 2, 3, 4, 5, 6, 7];
