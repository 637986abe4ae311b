//! Draws the LDI tree (Chang, Bishop, Lastra 1999): what stands where nothing better is at hand.
//!
//! In: a [`Cut`], the nodes at hand, a pose, and which blocks of the picture want something. Out: a [`FarFrame`] of colours and disparities.
//!
//! 1. `tiles`: every sample is a parallelogram on its surface, one pitch wide, projected as a quadrilateral with the plane's own disparity at every pixel.
//! 2. `paint`: opaque tiles into a z-buffer; then all tiles once more, twice as wide and with bilinear weights, into what lies within a merge threshold
//!    of the z-buffer: between samples colours run over smoothly, and what is partly covered mixes with what lies behind.
//! 3. Gap filling (section 3.5): pixels that nothing reached are drawn again from ever coarser cuts, filtered samples included.
//!
//! `lists` is the reference of steps 1 and 2: lists per pixel, sorted by depth, merged by the coarser level's threshold and blended front to back (section 3.3).

pub mod lists;
mod paint;
#[cfg(test)]
mod tests;
mod tiles;

use crate::{resident::Resident, warp::FarFrame};
use ldi_protocol::{
    OutputCamera, Pose,
    tree::{Cut, CutOptions, Lens, Tree, cut},
};
use paint::Painting;
pub use paint::{BLOCK, Wanted};
use rayon::prelude::*;
use tiles::Tile;

/// Stamps may be so many times larger in each pass of gap filling; the paper goes on with all filtered samples at once.
const GAP_STEP: f64 = 4.0;
/// Samples of the nodes that are drawn before what they hide is left out of the rest. Fewer: more is left out; each round costs a look at all pixels.
const WAVE_SAMPLES: u32 = 150_000;
/// What lies behind the nearest samples by more than this share of the disparity is hidden: more than any merge threshold in view.
const HIDDEN_MARGIN: f32 = 0.1;
/// Passes of gap filling before the last, which draws the root.
const GAP_PASSES: u32 = 4;

/// How the tree is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TreeOptions {
    /// How far to refine.
    pub cut: CutOptions,
    /// Fill gaps from filtered samples.
    pub fill_gaps: bool,
}

impl Default for TreeOptions {
    fn default() -> Self {
        Self { cut: CutOptions::default(), fill_gaps: true }
    }
}

/// What drawing took.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TreeStats {
    /// Samples looked at.
    pub samples: u64,
    /// Tiles in the picture.
    pub tiles: u64,
    /// Pixels that the first pass painted.
    pub painted: u64,
    /// Pixels that gap filling painted.
    pub gaps_filled: u64,
    /// Chunks that would have sharpened it.
    pub missing: Vec<u32>,
    /// Milliseconds, with what it takes to lay it under the frame.
    pub ms: f64,
}

/// Draws trees; keeps memory between frames.
#[derive(Debug, Default)]
pub struct TreePainter {
    painting: Painting,
    tiles: Vec<Vec<Tile>>,
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
        wanted: &mut Wanted,
        no_gap: &(dyn Fn(usize, usize) -> bool + Sync),
        out: &mut FarFrame,
    ) -> TreeStats {
        out.reset(camera.width, camera.height);
        out.clear();
        let mut stats = TreeStats::default();
        if wanted.is_empty() {
            return stats;
        }
        let lens = Lens::from(camera);
        let held = |chunk: u32| resident.brood(chunk).is_some();
        let first = cut(tree, pose, &lens, &options.cut, held);
        self.pass(tree, &first, resident, pose, camera, wanted, out, &mut stats);
        stats.painted = wanted.settle(out);
        stats.missing = first.missing;
        if options.fill_gaps {
            wanted.drop_where(no_gap);
            let mut stamp_px = options.cut.stamp_px.max(1.0);
            for pass in 0..=GAP_PASSES {
                if wanted.is_empty() {
                    break;
                }
                stamp_px = if pass == GAP_PASSES { f64::INFINITY } else { stamp_px * GAP_STEP };
                let coarser = cut(tree, pose, &lens, &CutOptions { stamp_px, ..options.cut }, held);
                self.pass(tree, &coarser, resident, pose, camera, wanted, out, &mut stats);
                stats.gaps_filled += wanted.settle(out);
            }
        }
        stats
    }

    #[expect(clippy::too_many_arguments, reason = "each is another thing that a picture depends on")]
    fn pass(
        &mut self,
        tree: &Tree,
        nodes: &Cut,
        resident: &dyn Resident,
        pose: &Pose,
        camera: &OutputCamera,
        wanted: &mut Wanted,
        out: &mut FarFrame,
        stats: &mut TreeStats,
    ) {
        let view = tiles::Eye::new(pose, camera);
        let broods: Vec<_> = nodes.nodes.iter().filter_map(|n| Some((n, resident.brood(n.home.0)?))).collect();
        self.tiles.resize_with(broods.len().max(self.tiles.len()), Vec::new);
        let lists = &mut self.tiles[..broods.len()];
        // Near to far, in waves: what one covers need not be made into tiles by the next.
        let mut first = 0;
        while first < broods.len() {
            let mut samples = 0;
            let wave = broods[first..]
                .iter()
                .take_while(|(n, _)| {
                    let before = samples;
                    samples += tree.nodes[n.node as usize].samples;
                    before < WAVE_SAMPLES
                })
                .count();
            let of_wave = first..first + wave;
            let seen = &*wanted;
            stats.samples += lists[of_wave.clone()]
                .par_iter_mut()
                .zip(&broods[of_wave.clone()])
                .map(|(list, (n, brood))| {
                    list.clear();
                    let node = &tree.nodes[n.node as usize];
                    match brood.nodes.get(usize::from(n.home.1)) {
                        Some(s) if view.sees(&tree.bounds_of(node).inflated(tree.pitch_of(node.level)), seen) => {
                            view.tiles(tree, node, n.filtered, &s.samples, seen, list);
                            s.samples.len() as u64
                        }
                        _ => 0,
                    }
                })
                .sum::<u64>();
            self.painting.cover(&lists[of_wave.clone()], camera, wanted, out);
            first = of_wave.end;
            if first < broods.len() {
                wanted.raise_floors(out, HIDDEN_MARGIN);
            }
        }
        stats.tiles += lists.iter().map(|l| l.len() as u64).sum::<u64>();
        self.painting.mix(lists, camera, wanted, out);
    }
}
