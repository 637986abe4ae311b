//! Occlusion culling: tiles hidden by nearer content are not warped.
//!
//! In: the pixels painted so far, near geometry of the same pose, bounds of a tile in the picture.
//! Out: whether every pixel that the tile may paint shows something nearer.
//!
//! After a proposal to cull LDI samples by an octree (front-to-back warping fills an occlusion
//! buffer, and a node is not warped if the rectangle around its eight warped corners is full). That
//! test uses the picture alone, relies on the order, and loses visible samples. This one is
//! conservative: a pixel counts only if its content is nearer than the nearest corner of the tile's
//! box, so that no order is needed and no pixel changes. The picture itself is the buffer. Near
//! geometry, which hides the most, is tested alone before the work is distributed to threads.

use super::{
    Stamp,
    cull::{Silhouette, Within},
    ewa,
    quad_raster::Target,
};
use ldi_protocol::OutputCamera;
use std::ops::Range;

/// Relative slack of disparities: three times the error bound of the kernels.
const ROUNDING: f64 = 1.2e-5;
/// Pixels tested between two checks for an early exit.
const AT_ONCE: usize = 8;

/// What stands before the images.
#[derive(Debug, Clone, Copy)]
pub struct Before<'a> {
    /// Disparities of near geometry, 1/m, row-major; empty without any.
    near: &'a [f32],
    /// Columns and rows of the picture.
    size: [usize; 2],
    /// Distance that a tile paints beyond its samples, pixels.
    reach_px: f64,
    /// What hides is nearer by this factor.
    nearer: f64,
}

impl<'a> Before<'a> {
    /// Near geometry of another size than the picture is ignored.
    pub fn new(near: &'a [f32], stamp: Stamp, camera: &OutputCamera) -> Self {
        let size = [camera.width, camera.height].map(|n| n as usize);
        let whole = near.len() == size[0] * size[1];
        // Gaussians contribute to pixels that show something slightly nearer.
        let nearer = if stamp == Stamp::Ewa { 1.0 / (1.0 - f64::from(ewa::SAME_SURFACE)) } else { 1.0 };
        Self {
            near: if whole { near } else { &[] },
            size,
            reach_px: stamp.reach_px(),
            nearer: nearer * (1.0 + ROUNDING),
        }
    }

    /// Whether near geometry alone hides all of a tile.
    pub fn near_hides(&self, tile: &Within) -> bool {
        let Some(silhouette) = &tile.silhouette else { return false };
        let [columns, mut rows] = self.painted(silhouette);
        let disparity = self.nearest(silhouette);
        !self.near.is_empty()
            && rows.all(|row| self.row(row, &columns).chunks(AT_ONCE).all(|near| all(near, |n| *n > disparity)))
    }

    /// Whether a tile is hidden in the rows of a target. Later pixels only hide more.
    #[inline(always)]
    pub fn hides(&self, target: &Target<'_>, tile: &Within) -> bool {
        let Some(silhouette) = &tile.silhouette else { return false };
        let [columns, rows] = self.painted(silhouette);
        let first = target.window.first_row as usize;
        let rows = rows.start.max(first)..rows.end.min(first + target.window.rows as usize);
        let disparity = self.nearest(silhouette);
        // Disparities are positive: their bits order as they do.
        let bits = disparity.to_bits();
        let behind = |pixel: u64| (pixel >> 32) as u32 > bits;
        for row in rows {
            let painted = &target.pixels[(row - first) * self.size[0]..][columns.clone()];
            let hidden = if self.near.is_empty() {
                painted.chunks(AT_ONCE).all(|pixels| all(pixels, |p| behind(*p)))
            } else {
                let mut groups = painted.chunks(AT_ONCE).zip(self.row(row, &columns).chunks(AT_ONCE));
                groups.all(|(pixels, near)| all(pixels.iter().zip(near), |(p, n)| behind(*p) | (*n > disparity)))
            };
            if !hidden {
                return false;
            }
        }
        true
    }

    /// Columns and rows that something may paint.
    #[inline(always)]
    fn painted(&self, silhouette: &Silhouette) -> [Range<usize>; 2] {
        std::array::from_fn(|axis| {
            // Saturating conversions.
            let from = (silhouette.low[axis] - self.reach_px).floor().max(0.0) as usize;
            let to = (silhouette.high[axis] + self.reach_px).ceil().max(0.0) as usize;
            from.min(self.size[axis])..to.min(self.size[axis])
        })
    }

    /// The disparity that hides something, 1/m.
    #[inline(always)]
    fn nearest(&self, silhouette: &Silhouette) -> f32 {
        (silhouette.nearest * self.nearer) as f32
    }

    /// Near geometry's disparities in a row.
    #[inline(always)]
    fn row(&self, row: usize, columns: &Range<usize>) -> &[f32] {
        &self.near[row * self.size[0]..][columns.clone()]
    }
}

/// Whether a predicate holds for all elements, without a branch for each.
#[inline(always)]
fn all<T>(few: impl IntoIterator<Item = T>, holds: impl Fn(T) -> bool) -> bool {
    few.into_iter().fold(true, |all, x| all & holds(x))
}
