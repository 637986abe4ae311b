//! What culling hidden samples gains and loses: the measurement that the octree proposal planned
//! and never published, beside what frames do.
//!
//! In: a dataset, a walk path. Out: a [`Row`] per size of the octree's leaves: shares of the
//! samples that land on the picture, summed over views of the path that show images.
//!
//! The judge is the picture that micro-quads give (with near geometry where it says so): a sample
//! is hidden if its pixel shows something nearer by more than [`SAME_SURFACE`]. Faults are what
//! the proposal calls so: visible samples that are culled, and hidden ones that are kept.

use super::speed_error::resident;
use anyhow::{Context as _, Result, bail};
use ldi_client::{
    engine::{Method, view_of},
    frame::Frame,
    near::Rasterizer,
    report::StageMs,
    resident::Resident as _,
    warp::{
        FarFrame, ImageInView, PreparedLdi, WarpMatrix, WarpOptions,
        octree::{OcclusionBuffer, OctreeNode, OctreeSample, SampleOctree, Stop, Visit},
        warp_images,
    },
};
use ldi_protocol::{OutputCamera, Pose, ldi::Ldi, need::Sight, path::Walk};
use ldi_server::store::Dataset;
use serde::Serialize;
use std::{fmt::Write as _, path::Path, sync::Arc};

/// Relative difference of disparities within a surface and a pixel. By judgement.
pub const SAME_SURFACE: f64 = 0.02;

/// Shares of the samples that land on the picture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Row {
    /// Most samples of a leaf; 0: tiles, as frames use them.
    pub leaf_samples: usize,
    /// Views.
    pub views: usize,
    /// Millions of samples that land on the picture, mean of the views.
    pub msamples: f64,
    /// Hidden by other samples.
    pub hidden: f64,
    /// Hidden by these or by near geometry.
    pub hidden_near: f64,
    /// Culled after the proposal, images alone; None of tiles.
    pub proposal: Option<Proposal>,
    /// In leaves or tiles of which nothing shows, images alone.
    pub culled: f64,
    /// The same with near geometry.
    pub culled_near: f64,
}

/// What the proposal's test does.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Proposal {
    /// Culled.
    pub culled: f64,
    /// Visible and culled.
    pub lost: f64,
    /// Hidden and kept.
    pub kept: f64,
}

/// A picture that samples are judged by: the disparity that each pixel shows.
struct Judge {
    camera: OutputCamera,
    disparity: Vec<f32>,
}

impl Judge {
    /// Where the matrix puts a sample: its pixel, and the sample's disparity there; None beside
    /// the picture.
    fn lands(&self, matrix: &WarpMatrix, s: &OctreeSample) -> Option<(usize, f64)> {
        let p = matrix.warp(f64::from(s.u), f64::from(s.v), f64::from(s.disparity))?;
        let inside = |p: f64, n: u32| p >= 0.0 && p < f64::from(n);
        let on = inside(p.x, self.camera.width) && inside(p.y, self.camera.height);
        on.then(|| (p.y as usize * self.camera.width as usize + p.x as usize, p.disparity))
    }

    fn hides(&self, (pixel, disparity): (usize, f64)) -> bool {
        disparity * (1.0 + SAME_SURFACE) < f64::from(self.disparity[pixel])
    }

    /// Whether nothing of a node shows: every pixel of its rectangle, and around as far as its
    /// quads reach, shows something nearer than all of it.
    fn hides_all(&self, node: &OctreeNode, matrix: &WarpMatrix) -> bool {
        let Some(([left, right, top, bottom], nearest)) = SampleOctree::rectangle(node, matrix, &self.camera) else {
            return false;
        };
        /// Pixels: a sample's quads end at its neighbours, a sample farther, and images are about
        /// as dense as pictures.
        const QUADS_PX: usize = 2;
        let width = self.camera.width as usize;
        let (left, right) = (left.saturating_sub(QUADS_PX), (right + QUADS_PX).min(width));
        let (top, bottom) = (top.saturating_sub(QUADS_PX), bottom + QUADS_PX);
        let mut rows = self.disparity.chunks(width).skip(top).take(bottom - top);
        rows.all(|row| row[left..right].iter().all(|d| f64::from(*d) > nearest))
    }
}

/// Counts of samples.
#[derive(Debug, Default, Clone, Copy)]
struct Counts {
    views: usize,
    on_picture: u64,
    hidden: u64,
    hidden_near: u64,
    drawn: u64,
    drawn_hidden: u64,
    culled: u64,
    culled_near: u64,
}

/// Measures leaves of several sizes and tiles on views of a path, evenly spaced.
///
/// # Errors
/// A dataset or path that cannot be read, a path whose views show no image.
pub fn run(
    dataset: &Path,
    walk: &Walk,
    views: usize,
    (width, height): (u32, u32),
    leaves: &[usize],
) -> Result<Vec<Row>> {
    let dataset = Dataset::open(dataset)?;
    let camera = OutputCamera { width, height, fov_deg: 60.0 };
    let mut counts = vec![Counts::default(); leaves.len() + 1];
    for i in walk.evenly_spaced(views) {
        of_view(&dataset, &walk.poses[i].pose, &camera, leaves, &mut counts)?;
    }
    if counts[0].views == 0 {
        bail!("no view of this path shows an image of this dataset");
    }
    let sizes = leaves.iter().copied().chain([0]);
    Ok(sizes.zip(counts).map(|(size, c)| row(size, &c)).collect())
}

fn row(leaf_samples: usize, c: &Counts) -> Row {
    let share = |n: u64| n as f64 / c.on_picture.max(1) as f64;
    let proposal = (leaf_samples > 0).then(|| {
        let (culled, kept) = (c.on_picture - c.drawn, c.drawn_hidden);
        Proposal { culled: share(culled), lost: share(culled - (c.hidden - kept)), kept: share(kept) }
    });
    Row {
        leaf_samples,
        views: c.views,
        msamples: c.on_picture as f64 * 1e-6 / c.views.max(1) as f64,
        hidden: share(c.hidden),
        hidden_near: share(c.hidden_near),
        proposal,
        culled: share(c.culled),
        culled_near: share(c.culled_near),
    }
}

fn of_view(
    dataset: &Dataset,
    pose: &Pose,
    camera: &OutputCamera,
    leaves: &[usize],
    counts: &mut [Counts],
) -> Result<()> {
    let index = dataset.index();
    let view = view_of(index, pose, camera, Method::Auto, &mut StageMs::default());
    let cache = resident(dataset, &view, &Sight::new(pose, camera, 1))?;
    let images: Vec<Arc<Ldi>> = view.images.iter().filter_map(|i| cache.ldi(*i)).collect();
    if images.is_empty() {
        return Ok(());
    }
    let mut near = Frame::default();
    Rasterizer::default().draw(index, &cache, &view.cells, camera, pose, &mut near);
    let laid_out: Vec<PreparedLdi> = images.iter().map(|ldi| PreparedLdi::new(ldi)).collect();
    let shown: Vec<ImageInView<'_>> = laid_out.iter().map(ImageInView::from).collect();
    let (mut far, mut spare) = (FarFrame::new(camera.width, camera.height), FarFrame::default());
    let mut warp = |near: &[f32], keep_hidden: bool| {
        let options = WarpOptions { keep_hidden, ..WarpOptions::default() };
        far.reset(camera.width, camera.height);
        let stats = warp_images(&shown, near, pose, camera, &options, &mut far, &mut spare);
        stats.map(|s| (s, far.clone())).context("cannot warp")
    };
    let (alone, picture) = warp(&[], true)?;
    if alone.samples_warped == 0 {
        return Ok(());
    }
    let (without_hidden, _) = warp(&[], false)?;
    let (behind_near, _) = warp(&near.disparity, false)?;
    let of_images: Vec<f32> = (0..picture.packed.len()).map(|i| picture.get(i).map_or(0.0, |p| p.1)).collect();
    let of_both = of_images.iter().zip(&near.disparity).map(|(a, b)| a.max(*b)).collect();
    let judge = Judge { camera: *camera, disparity: of_images };
    let judge_near = Judge { camera: *camera, disparity: of_both };

    let (tiles, trees) = counts.split_last_mut().context("a place for tiles")?;
    let matrices: Vec<WarpMatrix> = images.iter().map(|i| WarpMatrix::new(&i.camera, pose, camera)).collect();
    for (count, samples) in trees.iter_mut().zip(leaves) {
        let octrees: Vec<SampleOctree> =
            images.iter().map(|ldi| SampleOctree::new(ldi, Stop { count: *samples, side_px: 1 })).collect();
        count.views += 1;
        let mut buffer = OcclusionBuffer::new(camera);
        for (tree, matrix) in octrees.iter().zip(&matrices) {
            for sample in tree.samples().iter().filter_map(|s| judge.lands(matrix, s)) {
                count.on_picture += 1;
                count.hidden += u64::from(judge.hides(sample));
                count.hidden_near += u64::from(judge_near.hides(sample));
            }
            let focal = camera.focal_px() / tree.pixels_per_unit();
            let mut state = (&mut buffer, &mut *count);
            tree.front_to_back(
                pose,
                &mut state,
                |(buffer, _), node| match SampleOctree::rectangle(node, matrix, camera) {
                    _ if !tree.reaches(node, matrix, camera) => Visit::Skip,
                    Some((rectangle, _)) if buffer.is_opaque(rectangle) => Visit::Skip,
                    _ => Visit::Enter,
                },
                |(buffer, count), s| {
                    let Some(p) = matrix.warp(f64::from(s.u), f64::from(s.v), f64::from(s.disparity)) else { return };
                    buffer.splat(p.x, p.y, focal * p.disparity / f64::from(s.disparity));
                    if let Some(landed) = judge.lands(matrix, s) {
                        count.drawn += 1;
                        count.drawn_hidden += u64::from(judge.hides(landed));
                    }
                },
            );
            let on_picture =
                |node: &OctreeNode| tree.samples_of(node).iter().filter_map(|s| judge.lands(matrix, s)).count() as u64;
            for node in tree.nodes().iter().filter(|n| n.is_leaf() && tree.reaches(n, matrix, camera)) {
                let hidden = [&judge, &judge_near].map(|j| j.hides_all(node, matrix));
                if hidden[1] {
                    let n = on_picture(node);
                    count.culled_near += n;
                    count.culled += if hidden[0] { n } else { 0 };
                }
            }
        }
    }
    // Tiles count what is in tiles that may reach the picture; shares are of that.
    tiles.views += 1;
    tiles.on_picture += alone.samples_warped;
    tiles.culled += without_hidden.samples_hidden;
    tiles.culled_near += behind_near.samples_hidden;
    Ok(())
}

/// A table for people.
pub fn table(rows: &[Row]) -> String {
    let mut out = String::from(
        "                Msamples   hidden, with near   proposal: culled   lost   hidden kept   nothing shows, with near\n",
    );
    for r in rows {
        let name = if r.leaf_samples == 0 { "tiles".into() } else { format!("leaves of {}", r.leaf_samples) };
        let percent = |x: f64| format!("{:.2}%", 100.0 * x);
        let of = |f: fn(&Proposal) -> f64| r.proposal.as_ref().map_or("-".into(), |p| percent(f(p)));
        let known = |x: f64| if r.leaf_samples == 0 { "-".into() } else { percent(x) };
        let _ = writeln!(
            out,
            "{name:15} {:9.3} {:>8} {:>11} {:>18} {:>6} {:>13} {:>15} {:>10}",
            r.msamples,
            known(r.hidden),
            known(r.hidden_near),
            of(|p| p.culled),
            of(|p| p.lost),
            of(|p| p.kept),
            percent(r.culled),
            percent(r.culled_near),
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_of_what_lands_and_faults_add_up() {
        let counts = Counts {
            views: 2,
            on_picture: 1_000_000,
            hidden: 400_000,
            hidden_near: 500_000,
            drawn: 700_000,
            drawn_hidden: 150_000,
            culled: 300_000,
            culled_near: 350_000,
        };
        let r = row(16, &counts);
        let Proposal { culled, lost, kept } = r.proposal.expect("an octree's row");
        assert_eq!((r.msamples, r.hidden, culled, lost, kept), (0.5, 0.4, 0.3, 0.05, 0.15));
        // What is culled and not lost was hidden, and so is what is kept although hidden.
        assert!((culled - lost + kept - r.hidden).abs() < 1e-12);
        let tiles = row(0, &counts);
        assert_eq!(tiles.proposal, None);
        let text = table(&[r, tiles]);
        assert!(text.contains("leaves of 16") && text.contains("30.00%") && text.contains("tiles"), "{text}");
    }
}
