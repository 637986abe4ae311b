//! Draws the LDI tree (Chang, Bishop, Lastra 1999), which is shown where finer data is missing.
//!
//! In: a cut of the tree, resident nodes, a pose, the pixels to draw. Out: a [`FarFrame`] of
//! colours and disparities.
//!
//! 1. `splat_projection`: every sample is a parallelogram on its surface, one pitch wide, projected
//!    as a quadrilateral with the plane's disparity at every pixel.
//! 2. `splat`: the parts of splats that their surfaces cover into a z-buffer; then all splats
//!    again, twice as wide and with bilinear weights, within a merge threshold of the z-buffer:
//!    outlines are as fine as coverage masks, colours are interpolated between samples.
//! 3. Gap filling (section 3.5): pixels that nothing reached are drawn again from coarser cuts,
//!    including filtered samples, without the rims of surfaces. Gaps that remain are wider than a
//!    few samples: there is no surface.
//! 4. While the eye rests (section 3.4), `progressive` keeps the picture: a finer one is drawn over
//!    several frames (`pass`) and shown when it is finished.
//!
//! `lists` is the reference of steps 1 and 2.

pub mod lists;
mod pass;
mod pixel_mask;
mod progressive;
#[cfg(test)]
mod progressive_test;
mod splat;
mod splat_projection;
mod stats;
#[cfg(test)]
mod tests;
mod view;

use crate::{resident::Resident, warp::FarFrame};
use ldi_protocol::{
    OutputCamera, Pose,
    tree::{CutOptions, Tree},
};
use pass::Pass;
pub use pixel_mask::{BLOCK, PixelMask};
pub use progressive::ProgressivePainter;
use splat::SplatBuffers;
pub use stats::TreeStats;
use view::TreeView;

/// Growth of the largest stamp in each pass of gap filling.
const GAP_STEP: f64 = 4.0;
/// Passes of gap filling. More: the sky between beams takes their colours; fewer: holes stay.
pub const GAP_PASSES: u32 = 2;
/// Number of passes of which the last draws the root, as in the paper.
pub const ALL_GAP_PASSES: u32 = 5;

/// Options of drawing the tree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TreeOptions {
    /// Refinement.
    pub cut: CutOptions,
    /// Passes of gap filling.
    pub gap_passes: u32,
}

impl Default for TreeOptions {
    fn default() -> Self {
        Self { cut: CutOptions::default(), gap_passes: GAP_PASSES }
    }
}

/// Draws trees; keeps buffers between frames.
#[derive(Debug, Default)]
pub struct TreePainter {
    painting: SplatBuffers,
    pass: Pass,
}

impl TreePainter {
    /// Draws into the wanted pixels of `out`, which is reset to the camera's size. `no_gap`:
    /// whether a pixel at a row and column must not be gap filled, because it is painted otherwise,
    /// or sky.
    #[expect(clippy::too_many_arguments, reason = "each is another thing that a picture depends on")]
    pub fn draw(
        &mut self,
        tree: &Tree,
        resident: &dyn Resident,
        pose: &Pose,
        camera: &OutputCamera,
        options: &TreeOptions,
        wanted: &mut PixelMask,
        no_gap: &(dyn Fn(usize, usize) -> bool + Sync),
        out: &mut FarFrame,
    ) -> TreeStats {
        out.reset(camera.width, camera.height);
        out.clear();
        let mut stats = TreeStats::default();
        if wanted.is_empty() {
            return stats;
        }
        let view = TreeView { tree, resident, pose, camera };
        self.pass.begin(view.cut(&options.cut), false);
        self.pass.advance(&view, u64::MAX, wanted, out, &mut self.painting, &mut stats);
        self.finish(&view, options, wanted, no_gap, out, &mut stats);
        stats
    }

    /// Counts what the finished pass painted and fills gaps.
    fn finish(
        &mut self,
        view: &TreeView<'_>,
        options: &TreeOptions,
        wanted: &mut PixelMask,
        no_gap: &(dyn Fn(usize, usize) -> bool + Sync),
        out: &mut FarFrame,
        stats: &mut TreeStats,
    ) {
        stats.painted = wanted.settle(out);
        (stats.missing, stats.limited) = (std::mem::take(&mut self.pass.cut.missing), self.pass.cut.limited);
        stats.shown = self.pass.cut.samples;
        if options.gap_passes == 0 {
            return;
        }
        wanted.drop_where(no_gap);
        let mut stamp_px = options.cut.stamp_px.max(1.0);
        for pass in 1..=options.gap_passes {
            if wanted.is_empty() {
                break;
            }
            stamp_px = if pass == ALL_GAP_PASSES { f64::INFINITY } else { stamp_px * GAP_STEP };
            self.pass.begin(view.cut(&CutOptions { stamp_px, ..options.cut }), true);
            self.pass.advance(view, u64::MAX, wanted, out, &mut self.painting, stats);
            stats.gaps_filled += wanted.settle(out);
        }
    }
}
