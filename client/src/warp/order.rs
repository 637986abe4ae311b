//! Occlusion-compatible order: painting without a z-buffer.
//!
//! In: the tiles that reach a band. Out: their samples, painted so that of two on one pixel the nearer comes last.
//!
//! **Theory** (McMillan; as used for LDIs by Shade et al. and Rafferty et al.). Let E = C2 - C1 be the eye seen from the image's
//! centre, e its projection, the epipole. What may land on one output pixel lies on one ray C2 + t r, whose image is
//! p(t) = e + (r - e r_z) t / (E_z + t r_z): a line through e. With the eye ahead of the centre (E_z > 0) near
//! points lie closer to e, so samples are drawn toward it; with the eye behind (E_z < 0) near points lie
//! farther from it, and they are drawn away from it. An eye in the plane of the centre (E_z = 0) puts e at infinity
//! on the side of E, which a large finite e stands for. Column and row distances from e are monotone along every such line, so the
//! image falls into up to four sheets at e, each drawn row by row. Deeper layers of a pixel come first.
//!
//! **Practice.** The same argument holds for tiles, and then within tiles, so the order is: tiles by distance of their
//! rows, then of their columns; within a tile rows, then columns, then layers. Threads share the output's rows as they do with the z-buffer; the papers cut sheets into
//! fragments instead. Stamps larger than 2 x 2 overpaint what the order meant to keep in front, so they are refused.

use super::{
    Stamp,
    cull::Reach,
    lanes::Lanes,
    matrix::WarpMatrix,
    prepared::{TILE_COLUMNS, TILE_ROWS},
    quads::Target,
    transform::{Scratch, transform_tile},
};
use ldi_protocol::{Pose, ldi::LdiCamera};

/// Stands for an epipole at infinity, LDI pixels: far beyond any image, small enough that f64 still tells columns apart.
const INFINITE: f64 = 1e9;

/// Where the eye lies in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Epipole {
    /// Column coordinate, LDI pixels.
    u: f64,
    /// Row coordinate, LDI pixels.
    v: f64,
    /// Whether to draw toward it.
    toward: bool,
}

impl Epipole {
    /// The epipole of an eye in an image.
    pub fn new(camera: &LdiCamera, pose: &Pose) -> Self {
        let e = pose.position - camera.cop;
        let (right, down, ahead) = (e.dot(camera.basis.right), -e.dot(camera.basis.up), e.dot(camera.basis.forward));
        // An eye beside the centre has no extent along the axis in question: lines run along the other, any order does.
        let coordinate = |p: f64, origin: i32| {
            let at = p / ahead * camera.pixels_per_unit - f64::from(origin);
            if at.is_nan() { 0.0 } else { at.clamp(-INFINITE, INFINITE) }
        };
        Self { u: coordinate(right, camera.left), v: coordinate(down, camera.top), toward: ahead >= 0.0 }
    }

    /// Sorts by distance from `e`: toward it the farthest first, away from it the nearest first.
    fn sort<T>(&self, items: &mut [T], distance: impl Fn(&T) -> f64) {
        items.sort_by(|a, b| {
            let order = distance(a).total_cmp(&distance(b));
            if self.toward { order.reverse() } else { order }
        });
    }

    /// Tiles in drawing order; those of one place follow one another, deepest layer first.
    pub fn sort_tiles(&self, tiles: &mut [Reach<'_>]) {
        let gap =
            |from: u32, size: usize, e: f64| (f64::from(from) - e).max(e - f64::from(from) - size as f64).max(0.0);
        // Stable sorts, the least significant key first.
        tiles.sort_by_key(|t| (t.tile.row, t.tile.column, std::cmp::Reverse(t.part.layer)));
        self.sort(tiles, |t| gap(t.tile.column, TILE_COLUMNS, self.u));
        self.sort(tiles, |t| gap(t.tile.row, TILE_ROWS, self.v));
    }

    /// Numbers 0 to `count` by the distance of `first` + number + 0.5 from `e`.
    fn order(&self, first: u32, count: usize, e: f64) -> Vec<usize> {
        let mut numbers: Vec<usize> = (0..count).collect();
        self.sort(&mut numbers, |i| (f64::from(first) + *i as f64 + 0.5 - e).abs());
        numbers
    }
}

/// Paints the tiles of one place in the image, deepest layer first, and returns the largest squared footprint.
#[inline(always)]
pub fn paint_place<L: Lanes>(
    target: &mut Target<'_>,
    matrix: &WarpMatrix,
    epipole: &Epipole,
    place: &[Reach<'_>],
    stamp: Stamp,
    scratches: &mut Vec<Scratch>,
) -> f32 {
    let Some(Reach { tile: first, .. }) = place.first() else { return 0.0 };
    if scratches.len() < place.len() {
        scratches.resize_with(place.len(), Scratch::default);
    }
    let mut footprint2 = 0.0f32;
    for (t, scratch) in place.iter().zip(scratches.iter_mut()) {
        footprint2 = footprint2.max(transform_tile::<L>(matrix, t.part, t.tile, &target.window, scratch));
    }
    let columns = epipole.order(first.column, TILE_COLUMNS, epipole.u);
    // Per layer, the sample of each column of a row.
    let mut samples = vec![[None::<u16>; TILE_COLUMNS]; place.len()];
    for row in epipole.order(first.row, TILE_ROWS, epipole.v) {
        for (t, samples) in place.iter().zip(&mut samples) {
            *samples = [None; TILE_COLUMNS];
            for i in t.tile.row_start[row]..t.tile.row_start[row + 1] {
                let column = usize::from(t.part.column[t.tile.first + usize::from(i)]);
                if column < TILE_COLUMNS {
                    samples[column] = Some(i);
                }
            }
        }
        for column in &columns {
            for ((t, samples), scratch) in place.iter().zip(&samples).zip(&*scratches) {
                let Some(i) = samples[*column].map(usize::from) else { continue };
                if scratch.disparity[i] > 0.0 {
                    let value = (scratch.disparity[i].to_bits(), t.part.colour[t.tile.first + i]);
                    overwrite(target, [scratch.x[i], scratch.y[i]], stamp, value);
                }
            }
        }
    }
    footprint2
}

/// Writes a stamp over what is there.
#[inline(always)]
fn overwrite(target: &mut Target<'_>, [x, y]: [f32; 2], stamp: Stamp, (disparity, colour): (u32, u32)) {
    let (side, shift) = if stamp == Stamp::TwoByTwo { (2, 0.5) } else { (1, 0.0) };
    let window = target.window;
    // Saturating conversions: far outside stays outside, and NaN is excluded by its disparity.
    let (left, top) = ((x - shift).floor() as i32, (y - shift).floor() as i32);
    let top = top.saturating_sub(window.first_row as i32);
    for row in top.max(0)..top.saturating_add(side).min(window.rows as i32) {
        for column in left.max(0)..left.saturating_add(side).min(window.width as i32) {
            target.set(row as usize * window.width as usize + column as usize, disparity, colour);
        }
    }
}
