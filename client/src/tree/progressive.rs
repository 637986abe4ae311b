//! The tree's picture from frame to frame: drawn anew when the view changes; kept, and drawn on, while it does not (progressive refinement, row D6).
//!
//! A frame may look at so many samples. When the eye moves, that bounds the picture. When it stands still the picture stays; a cut with [`FINER`] times the samples is drawn beside it,
//! as many samples per frame as the bound allows, and takes its place when it is done; then the next. What is shown is exactly what one long frame would show, so it never gets coarser,
//! and a still eye that shows all there is costs nothing.

use super::{PixelMask, TreeOptions, TreePainter, TreeStats, View, pass::Pass};
use crate::{resident::Resident, warp::FarFrame};
use ldi_protocol::{
    OutputCamera, Pose,
    tree::{CutOptions, Tree},
};

/// How many times more samples the next picture has. Of all that is drawn until the last one, a quarter is drawn for those before it.
const FINER: u64 = 4;

/// Draws the tree for one frame after the other.
#[derive(Debug, Default)]
pub struct ProgressivePainter {
    painter: TreePainter,
    /// View of the frame before.
    last: Option<(Pose, OutputCamera)>,
    /// The tree's picture.
    picture: FarFrame,
    shown: Option<FinishedPicture>,
    making: Option<Refinement>,
}

/// What the picture shows, once an eye stood still for two frames.
#[derive(Debug)]
struct FinishedPicture {
    /// Pixels that it was drawn for, and the disparity that hid samples in each.
    wanted: PixelMask,
    hidden_below: Vec<f32>,
    samples: u64,
    limited: bool,
    missing: Vec<u32>,
}

/// A finer picture.
#[derive(Debug)]
struct Refinement {
    pass: Pass,
    options: CutOptions,
    wanted: PixelMask,
    picture: FarFrame,
    stats: TreeStats,
}

impl ProgressivePainter {
    /// The picture for a frame whose pixels `wanted` want samples where nothing of a larger disparity than `hidden_below` hides them. At most about `max_samples` are looked at. `no_gap` as
    /// of [`TreePainter::draw`]. [`TreeStats::samples`] are those of this frame.
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
        let view = View { tree, resident, pose, camera };
        let stands = self.last.replace((*pose, *camera)) == Some((*pose, *camera));
        let serves = |s: &FinishedPicture| stands && s.wanted.covers(&s.hidden_below, &wanted, hidden_below);
        if !self.shown.as_ref().is_some_and(serves) {
            let before = self.shown.take().filter(|_| stands).map_or(0, |s| s.samples);
            self.making = None;
            let max_samples = max_samples.max(before);
            let options =
                TreeOptions { cut: CutOptions { max_samples, ..CutOptions::default() }, ..TreeOptions::default() };
            // Only what a still eye shows is kept: copies cost a moving one time.
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

    /// A frame like the one before.
    fn draw_on(
        &mut self,
        view: &View<'_>,
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
            pass.begin(view.cut(&options));
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
