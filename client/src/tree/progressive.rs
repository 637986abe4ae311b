//! Progressive refinement of the tree's picture: drawn again when the view changes, refined while
//! it does not.
//!
//! Each frame may visit a limited number of samples. While the eye moves, that limits the picture.
//! While it rests the picture stays, and a cut with [`FINER`] times the samples is drawn in the
//! background, within the limit of each frame; it replaces the picture when it is finished, and the
//! next one starts. The picture equals that of a single frame without a limit, so that it never
//! becomes coarser, and a finished picture costs nothing.

use super::{PixelMask, TreeOptions, TreePainter, TreeStats, pass::Pass, view::TreeView};
use crate::{resident::Resident, warp::FarFrame};
use ldi_protocol::{
    OutputCamera, Pose,
    tree::{CutOptions, Tree},
};

/// Growth of the number of samples from one picture to the next. Larger: the next picture takes
/// longer; smaller: more samples are drawn for intermediate pictures.
const FINER: u64 = 4;

/// Draws the tree frame by frame.
#[derive(Debug, Default)]
pub struct ProgressivePainter {
    painter: TreePainter,
    /// View of the previous frame.
    last: Option<(Pose, OutputCamera)>,
    /// The tree's picture.
    picture: FarFrame,
    shown: Option<FinishedPicture>,
    making: Option<Refinement>,
}

/// The content of the picture, once the eye has rested for two frames.
#[derive(Debug)]
struct FinishedPicture {
    /// The pixels it was drawn for, and the disparity below which samples were hidden in each.
    wanted: PixelMask,
    hidden_below: Vec<f32>,
    samples: u64,
    limited: bool,
    missing: Vec<u32>,
}

/// The finer picture in progress.
#[derive(Debug)]
struct Refinement {
    pass: Pass,
    options: CutOptions,
    wanted: PixelMask,
    picture: FarFrame,
    stats: TreeStats,
}

impl ProgressivePainter {
    /// The picture for a frame whose pixels `wanted` need samples, except where a disparity above
    /// `hidden_below` hides them. Visits about `max_samples` samples. `no_gap` as in
    /// [`TreePainter::draw`]. [`TreeStats::samples`] counts this frame's samples.
    #[expect(clippy::too_many_arguments, reason = "each is another thing that a picture depends on")]
    pub fn frame(
        &mut self,
        tree: &Tree,
        resident: &dyn Resident,
        pose: &Pose,
        camera: &OutputCamera,
        max_samples: u64,
        wanted: PixelMask,
        hidden_below: &[f32],
        no_gap: &(dyn Fn(usize, usize) -> bool + Sync),
    ) -> (TreeStats, &FarFrame) {
        let view = TreeView { tree, resident, pose, camera };
        let stands = self.last.replace((*pose, *camera)) == Some((*pose, *camera));
        let serves = |s: &FinishedPicture| stands && s.wanted.covers(&s.hidden_below, &wanted, hidden_below);
        if !self.shown.as_ref().is_some_and(serves) {
            let before = self.shown.take().filter(|_| stands).map_or(0, |s| s.samples);
            self.making = None;
            let max_samples = max_samples.max(before);
            let options =
                TreeOptions { cut: CutOptions { max_samples, ..CutOptions::default() }, ..TreeOptions::default() };
            // Only a resting view is kept: a moving one would pay for the copies.
            let kept = stands.then(|| wanted.clone());
            let mut left = wanted;
            let stats = self.painter.draw(tree, resident, pose, camera, &options, &mut left, no_gap, &mut self.picture);
            if let Some(wanted) = kept {
                let (missing, hidden_below) = (stats.missing.clone(), hidden_below.to_vec());
                let (samples, limited) = (stats.shown, stats.limited);
                self.shown = Some(FinishedPicture { wanted, hidden_below, samples, limited, missing });
            }
            return (stats, &self.picture);
        }
        let stats = self.draw_on(&view, max_samples, no_gap);
        (stats, &self.picture)
    }

    /// Continues the picture of the previous frame.
    fn draw_on(
        &mut self,
        view: &TreeView<'_>,
        max_samples: u64,
        no_gap: &(dyn Fn(usize, usize) -> bool + Sync),
    ) -> TreeStats {
        let Some(shown) = &mut self.shown else { return TreeStats::default() };
        let same =
            |samples| TreeStats { samples, shown: shown.samples, limited: shown.limited, ..TreeStats::default() };
        if self.making.is_none() && (shown.limited || shown.missing.iter().any(|c| view.holds(*c))) {
            let options = CutOptions {
                max_samples: shown.samples.max(max_samples).saturating_mul(FINER),
                ..CutOptions::default()
            };
            let mut pass = Pass::default();
            pass.begin(view.cut(&options), false);
            let mut picture = FarFrame::default();
            picture.reset(view.camera.width, view.camera.height);
            picture.clear();
            let stats = TreeStats::default();
            self.making = Some(Refinement { pass, options, wanted: shown.wanted.clone(), picture, stats });
        }
        let Some(making) = &mut self.making else { return same(0) };
        let before = making.stats.samples;
        let Refinement { pass, wanted, picture, stats, .. } = making;
        if !pass.advance(view, max_samples.max(1), wanted, picture, &mut self.painter.painting, stats) {
            return same(stats.samples - before);
        }
        let Some(Refinement { pass, options, mut wanted, mut picture, mut stats }) = self.making.take() else {
            return same(0);
        };
        self.painter.pass = pass;
        let options = TreeOptions { cut: options, ..TreeOptions::default() };
        self.painter.finish(view, &options, &mut wanted, no_gap, &mut picture, &mut stats);
        (shown.samples, shown.limited) = (stats.shown, stats.limited);
        shown.missing.clone_from(&stats.missing);
        self.picture = picture;
        stats.samples -= before;
        stats
    }
}
