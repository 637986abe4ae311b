//! Occlusion culling: tiles that something nearer hides are not warped.
//!
//! In: what is painted so far, the near geometry of the same pose, bounds of a tile in the picture. Out: whether every pixel that the tile may paint shows something nearer.
//!
//! After the occlusion culling of LDI samples by an octree, an unfinished proposal (section 3.2.2: what is warped front to back fills an occlusion buffer, and a node is not
//! warped where the rectangle around its eight warped corners is full). Their test looks at the picture alone, trusts the order, and accepts that seen samples are lost. Here it
//! is conservative: a pixel counts only if what it shows is nearer than the nearest corner of the tile's box, so that no order is needed and not a pixel that shows changes.
//! The picture itself is the buffer, and near geometry, which is drawn before, is most of what hides.

use super::{Stamp, cull::Within, ewa, quads::Target};
use ldi_protocol::OutputCamera;

/// Relative slack of disparities: thrice the bound of the kernels' errors (`ldi-bench numerics`, disparities after the warp).
const ROUNDING: f64 = 1.2e-5;
/// Pixels that are looked at before it is asked whether to go on.
const AT_ONCE: usize = 8;

/// What stands before the images.
#[derive(Debug, Clone, Copy)]
pub struct Before<'a> {
    /// Disparities of near geometry, 1/m, row-major; empty without any.
    near: &'a [f32],
    /// How far a tile paints beyond where its samples land, pixels.
    reach_px: f64,
    /// What hides is nearer by this factor.
    nearer: f64,
}

impl<'a> Before<'a> {
    /// Near geometry of another size than the picture counts as none.
    pub fn new(near: &'a [f32], stamp: Stamp, camera: &OutputCamera) -> Self {
        let whole = near.len() == camera.width as usize * camera.height as usize;
        // Gaussians take part in pixels that show something a little nearer.
        let nearer = if stamp == Stamp::Ewa { 1.0 / (1.0 - f64::from(ewa::SAME_SURFACE)) } else { 1.0 };
        Self { near: if whole { near } else { &[] }, reach_px: stamp.reach_px(), nearer: nearer * (1.0 + ROUNDING) }
    }

    /// Whether nothing of a tile shows in the rows of a target. What is painted later only hides more.
    #[inline(always)]
    pub fn hides(&self, target: &Target<'_>, tile: &Within) -> bool {
        let Some(silhouette) = &tile.silhouette else { return false };
        let window = target.window;
        let width = window.width as usize;
        // Saturating conversions.
        let from = silhouette.low.map(|p| (p - self.reach_px).floor().max(0.0) as usize);
        let to = silhouette.high.map(|p| (p + self.reach_px).ceil().max(0.0) as usize);
        let (left, right) = (from[0].min(width), to[0].min(width));
        let (first, rows) = (window.first_row as usize, window.rows as usize);
        let (top, bottom) = (from[1].max(first), to[1].min(first + rows));
        let disparity = (silhouette.nearest * self.nearer) as f32;
        // Disparities are positive: their bits order as they do.
        let bits = disparity.to_bits();
        let behind = |pixel: u64| (pixel >> 32) as u32 > bits;
        for row in top..bottom {
            let painted = &target.pixels[(row - first) * width..][left..right];
            // Groups without a branch inside.
            let hidden = if self.near.is_empty() {
                painted.chunks(AT_ONCE).all(|pixels| pixels.iter().fold(true, |all, p| all & behind(*p)))
            } else {
                let near = &self.near[row * width..][left..right];
                let mut groups = painted.chunks(AT_ONCE).zip(near.chunks(AT_ONCE));
                groups.all(|(pixels, near)| {
                    pixels.iter().zip(near).fold(true, |all, (p, n)| all & (behind(*p) | (*n > disparity)))
                })
            };
            if !hidden {
                return false;
            }
        }
        true
    }
}
