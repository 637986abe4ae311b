//! Draws the LDI tree (Chang, Bishop, Lastra 1999): what stands where nothing better is at hand.
//!
//! In: a [`Cut`], the nodes at hand, a pose, and which blocks of the picture want something. Out: a [`FarFrame`] of colours and disparities.
//!
//! 1. `splats`: every sample is a parallelogram on its surface, one pitch wide, projected as a quadrilateral with the plane's own disparity at every pixel.
//! 2. `paint`: opaque tiles into a z-buffer; then all tiles once more, twice as wide and with bilinear weights, into what lies within a merge threshold
//!    of the z-buffer: between samples colours run over smoothly, and what is partly covered mixes with what lies behind.
//! 3. Gap filling (section 3.5): pixels that nothing reached are drawn again from coarser cuts, filtered samples included. What stays open then is wider than a few
//!    samples: there is no surface.
//!
//! 4. While the eye stands still (section 3.4), `still` keeps the picture and the traversal: a finer picture is drawn wave by wave over several frames (`pass`), and shown
//!    when it is done, so that nothing shown ever gets coarser.
//!
//! `lists` is the reference of steps 1 and 2: lists per pixel, sorted by depth, merged by the coarser level's threshold and blended front to back (section 3.3).

pub mod lists;
mod pass;
mod progressive;
#[cfg(test)]
mod progressive_test;
mod splat;
mod splat_projection;
#[cfg(test)]
mod tests;

use crate::{resident::Resident, warp::FarFrame};
use ldi_protocol::{
    OutputCamera, Pose,
    tree::{Cut, CutOptions, Lens, Tree, cut},
};
use pass::Pass;
pub use progressive::ProgressivePainter;
use splat::SplatBuffers;
pub use splat::{BLOCK, PixelMask};

/// Stamps may be so many times larger in each pass of gap filling.
const GAP_STEP: f64 = 4.0;
/// Passes of gap filling. More: the sky between beams is filled with the beams' colours. Fewer: holes stay (docs/decisions.md has figures).
pub const GAP_PASSES: u32 = 2;
/// The last of so many draws the root: the paper fills from all filtered samples.
pub const ALL_GAP_PASSES: u32 = 5;

/// How the tree is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TreeOptions {
    /// How far to refine.
    pub cut: CutOptions,
    /// How often gaps are filled from filtered samples, each time four times as large.
    pub gap_passes: u32,
}

impl Default for TreeOptions {
    fn default() -> Self {
        Self { cut: CutOptions::default(), gap_passes: GAP_PASSES }
    }
}

/// What is looked at, and from where.
#[derive(Clone, Copy)]
struct View<'a> {
    tree: &'a Tree,
    resident: &'a dyn Resident,
    pose: &'a Pose,
    camera: &'a OutputCamera,
}

impl View<'_> {
    fn holds(&self, chunk: u32) -> bool {
        self.resident.brood(chunk).is_some()
    }

    fn cut(&self, options: &CutOptions) -> Cut {
        cut(self.tree, self.pose, &Lens::from(self.camera), options, |chunk| self.holds(chunk))
    }
}

/// What drawing took.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TreeStats {
    /// Samples looked at.
    pub samples: u64,
    /// Samples of the cut that the picture shows.
    pub shown: u64,
    /// Whether a bound on samples kept it from being finer.
    pub limited: bool,
    /// Tiles in the picture.
    pub splats: u64,
    /// Pixels that the first pass painted.
    pub painted: u64,
    /// Pixels that gap filling painted.
    pub gaps_filled: u64,
    /// Chunks that would have sharpened it.
    pub missing: Vec<u32>,
    /// Pixels of the frame that show it.
    pub given: u64,
    /// Milliseconds, with what it takes to lay it under the frame.
    pub ms: f64,
}

/// Draws trees; keeps memory between frames.
#[derive(Debug, Default)]
pub struct TreePainter {
    painting: SplatBuffers,
    pass: Pass,
}

impl TreePainter {
    /// Draws into the wanted pixels of `out`, which is reset to the camera's size. `no_gap` says of a row and a column that
    /// nothing missing there is to be filled: it is painted otherwise, or sky.
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
        let view = View { tree, resident, pose, camera };
        self.pass.begin(view.cut(&options.cut));
        self.pass.advance(&view, u64::MAX, wanted, out, &mut self.painting, &mut stats);
        self.finish(&view, options, wanted, no_gap, out, &mut stats);
        stats
    }

    /// Counts what the finished pass painted and fills gaps.
    fn finish(
        &mut self,
        view: &View<'_>,
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
            self.pass.begin(view.cut(&CutOptions { stamp_px, ..options.cut }));
            self.pass.advance(view, u64::MAX, wanted, out, &mut self.painting, stats);
            stats.gaps_filled += wanted.settle(out);
        }
    }
}
