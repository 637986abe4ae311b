//! The f32 transform of a tile's samples, eight at a time.
//!
//! In: the f64 [`WarpMatrix`]. Out: per tile, coefficients relative to the tile's upper left
//! corner, so that f32 multiplies small column and row numbers only; per row, one affine function
//! of (column, disparity) for each of X, Y, W; per sample one division. Stated error against f64,
//! tested on rows of 8,192: 1/64 pixel for samples that land within 4,096 pixels of the picture's
//! origin and whose footprint is at most 4 pixels (the error comes from rounding X to 24 bits,
//! about X 2^-23, and grows with magnification as 1/W does); 2^-18 relative in disparity.

use super::{
    matrix::WarpMatrix,
    tiles::{Part, TILE_ROWS, TILE_SAMPLES, Tile},
};
use crate::simd::{LANES, Lanes};
use std::ops::Range;

/// Relative error of footprints, at most (`ldi-bench numerics`, footprints).
const FOOTPRINT_ERROR: f64 = 1e-3;

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

/// A tile's samples on the output: pixels and 1/m. Disparity is -1 for samples at or behind the
/// eye's plane.
pub struct Scratch {
    /// Output column coordinates.
    pub x: [f32; TILE_SAMPLES + LANES],
    /// Output row coordinates.
    pub y: [f32; TILE_SAMPLES + LANES],
    /// Output disparities.
    pub disparity: [f32; TILE_SAMPLES + LANES],
    /// Footprints, squared output pixels: the larger singular value of d(x, y)/d(u, v) at fixed
    /// disparity, squared.
    pub footprint2: [f32; TILE_SAMPLES + LANES],
}

impl Default for Scratch {
    fn default() -> Self {
        let zero = [0.0; TILE_SAMPLES + LANES];
        Self { x: zero, y: zero, disparity: zero, footprint2: zero }
    }
}

/// One sample before and after the f32 kernels, for tests.
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

/// The visible area: columns from 0, rows from `first_row`.
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

/// Values that determine the singular values of eight Jacobians [[a, b], [c, d]].
#[derive(Clone, Copy)]
pub struct Stretch<L: Lanes> {
    /// Sum of their squares.
    sum: L::F,
    /// Square of their product.
    product2: L::F,
}

impl<L: Lanes> Stretch<L> {
    #[inline(always)]
    fn new([a, b, c, d]: [L::F; 4]) -> Self {
        let sum = L::add(L::add(L::mul(a, a), L::mul(b, b)), L::add(L::mul(c, c), L::mul(d, d)));
        let product = L::sub(L::mul(a, d), L::mul(b, c));
        Self { sum, product2: L::mul(product, product) }
    }

    /// The larger singular value, squared.
    #[inline(always)]
    fn larger2(&self) -> L::F {
        let discriminant = L::sub(L::mul(self.sum, self.sum), L::mul(L::splat(4.0), self.product2));
        L::mul(L::splat(0.5), L::add(self.sum, L::sqrt(L::max(discriminant, L::splat(0.0)))))
    }

    /// Whether the larger squared singular value exceeds `m`, without a square root. The squares
    /// are the zeros of x^2 - sum x + product2:
    /// one zero lies above m if its value there is negative, or both do if their mean does.
    #[inline(always)]
    fn exceeds(&self, m: L::F) -> L::I {
        let between = L::gt(L::mul(m, L::sub(self.sum, m)), self.product2);
        L::or(between, L::gt(self.sum, L::add(m, m)))
    }
}

/// The largest squared footprint of many samples, in all lanes.
#[derive(Clone, Copy)]
pub struct Largest<L: Lanes>(L::F);

impl<L: Lanes> Largest<L> {
    /// Of none.
    #[inline(always)]
    pub fn none() -> Self {
        Self(L::splat(0.0))
    }

    /// Adds eight footprints, of which those of a mask count.
    #[inline(always)]
    pub fn see(&mut self, seen: L::I, stretch: &Stretch<L>) {
        let larger = L::and(seen, stretch.exceeds(self.0));
        if L::mask_bits(larger) != 0 {
            let of_these = L::max(L::select(larger, stretch.larger2(), L::splat(0.0)), self.0);
            self.0 = L::splat(L::array(of_these).into_iter().fold(0.0, f32::max));
        }
    }

    /// Whether footprints of at most `bound` output pixels cannot change the maximum.
    #[inline(always)]
    pub fn is_at_least(&self, bound: f64) -> bool {
        f64::from(self.squared()) >= (bound * (1.0 + FOOTPRINT_ERROR)).powi(2)
    }

    /// Squared output pixels.
    #[inline(always)]
    pub fn squared(&self) -> f32 {
        L::array(self.0)[0]
    }
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
    /// 1/W.
    inverse: L::F,
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

    /// Warps eight samples of one row, from its constants, their columns in the tile and their
    /// disparities.
    #[inline(always)]
    pub fn warp(&self, constants: [L::F; 3], u: L::F, d: L::F) -> Points<L> {
        let [xu, yu, wu] = self.u;
        let [xd, yd, wd] = self.d;
        let [x0, y0, w0] = constants;
        let x = affine8::<L>(x0, [xu, u], [xd, d]);
        let y = affine8::<L>(y0, [yu, u], [yd, d]);
        let w = affine8::<L>(w0, [wu, u], [wd, d]);
        let [x, y, inverse] = warp8::<L>([x, y, w]);
        let ahead = L::gt(inverse, L::splat(0.0));
        Points { x, y, disparity: L::select(ahead, L::mul(d, inverse), L::splat(-1.0)), inverse }
    }

    /// The stretch of the image around eight samples, at fixed disparity.
    #[inline(always)]
    pub fn stretch(&self, p: &Points<L>) -> Stretch<L> {
        let ([xu, yu, wu], [xv, yv, wv]) = (self.u, self.v);
        Stretch::new([
            entry::<L>(xu, p.x, wu, p.inverse),
            entry::<L>(xv, p.x, wv, p.inverse),
            entry::<L>(yu, p.y, wu, p.inverse),
            entry::<L>(yv, p.y, wv, p.inverse),
        ])
    }
}

/// Tests which points lie in a window, in front of the eye.
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

/// What of a tile is transformed.
#[derive(Debug, Clone, Copy)]
pub struct Wanted {
    /// The next tiles' samples that it holds.
    pub halo: bool,
    /// [`Scratch::footprint2`].
    pub footprints: bool,
    /// What the largest footprint is found from.
    pub largest: bool,
}

/// Transforms a tile's samples into `scratch`; `largest` gets the footprints of those inside of the
/// window, if wanted.
#[inline(always)]
pub fn transform_tile<L: Lanes>(
    matrix: &WarpMatrix,
    part: &Part,
    tile: &Tile,
    (window, wanted): (&Window, Wanted),
    scratch: &mut Scratch,
    largest: &mut Largest<L>,
) {
    let transform = TileTransform::new(matrix, tile);
    let slopes = Slopes::<L>::new(&transform);
    let inside = Inside::<L>::new(window);
    for row in 0..TILE_ROWS + usize::from(wanted.halo) {
        let constants = transform.row_constants(matrix, row).map(L::splat);
        let Range { start: from, end: to } = part.row_of(tile, row, wanted.halo);
        // The last group may write into the next row's elements, which are written afterwards.
        for i in (from..to).step_by(LANES) {
            let at = tile.first + i;
            let p = slopes.warp(constants, L::load_bytes(&part.column[at..]), L::load(&part.disparity[at..]));
            L::store(p.x, &mut scratch.x[i..]);
            L::store(p.y, &mut scratch.y[i..]);
            L::store(p.disparity, &mut scratch.disparity[i..]);
            if !wanted.footprints && !wanted.largest {
                continue;
            }
            let stretch = slopes.stretch(&p);
            if wanted.footprints {
                L::store(stretch.larger2(), &mut scratch.footprint2[i..]);
            }
            if !wanted.largest {
                continue;
            }
            // Lanes past the row's end hold another row's samples with this row's constants:
            // harmless on the picture, because they are overwritten, but not for the maximum.
            largest.see(L::and(inside.test(&p), first_lanes::<L>(to - i)), &stretch);
        }
    }
}

/// 0 to 7.
pub const LANE_NUMBERS: [u32; LANES] = [0, 1, 2, 3, 4, 5, 6, 7];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::Portable;

    #[test]
    fn the_largest_footprint_is_found_without_taking_every_root() {
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u32 << 24) as f32
        };
        for round in 0..2_000 {
            // From turned scalings, whose product is nearly the half of the sum, to lines, whose
            // product is none.
            let flatness = (round % 20) as f32 / 19.0;
            let mut largest = Largest::<Portable>::none();
            let mut expected = 0.0f64;
            for _ in 0..1 + round % 5 {
                let cells: [[f32; LANES]; 4] = {
                    let mut cells = [[0.0; LANES]; 4];
                    for lane in 0..LANES {
                        let (size, angle) = (0.1 + 3.0 * random(), 6.3 * random());
                        let (c, s) = (size * angle.cos(), size * angle.sin());
                        let thin = 1.0 - flatness * random();
                        [c, -s * thin, s, c * thin].into_iter().enumerate().for_each(|(k, x)| cells[k][lane] = x);
                    }
                    cells
                };
                let seen: [u32; LANES] = std::array::from_fn(|_| if random() < 0.7 { u32::MAX } else { 0 });
                largest.see(seen, &Stretch::new(cells));
                for lane in (0..LANES).filter(|lane| seen[*lane] != 0) {
                    let [a, b, c, d] = cells.map(|cell| f64::from(cell[lane]));
                    let (sum, product) = (a * a + b * b + c * c + d * d, a * d - b * c);
                    let root = (sum * sum - 4.0 * product * product).max(0.0).sqrt();
                    expected = expected.max(0.5 * (sum + root));
                }
            }
            // In f32 the root of what two nearly equal squares leave has lost half of its digits.
            let found = f64::from(largest.squared());
            assert!((found - expected).abs() <= 1e-3 * expected, "round {round}: {found} instead of {expected}");
        }
    }
}
