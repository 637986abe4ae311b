//! Stage 4: layered depth images, one per placement (A10).
//!
//! In: a ray caster, the culled cells, an [`ImagePlan`]. Out: an [`Ldi`] that holds what its users
//! can see of the culled cells, and figures.
//!
//! # Theory
//! Aliaga and Lastra 1999, section 4.1: one central image from the centre of projection, four
//! construction images on the vectors to the midpoints of the quadrilateral's edges, four mirrored
//! behind it, merged nearest first. What was changed:
//!
//! - The centre of projection is the middle of the users' box. Where eyes stand is known with view
//!   cells: rays from there find what shows past the cells that stay, and the image holds that
//!   alone (`sight`); construction cameras stand where they see most that the central image does
//!   not. With the paper's grid they stand in the corners of the users' box.
//! - Construction cameras have a quarter of the pixels: what they find is cast again at full
//!   resolution, and so is what lies between their hits.
//! - A construction camera traces only what the central image cannot explain (`explain`): rays
//!   that meet known surfaces through known emptiness bring nothing new. That is nine tenths of
//!   them.
//! - Merging compares planes, not depths (`sample`), and each merged sample is cast again through
//!   its pixel's centre (`merge`): all samples lie exactly on their pixel's ray, and silhouettes
//!   do not grow.
//! - Where surfaces end between pixels' centres is measured (`ends`), and what the centre of
//!   projection sees edge-on is held as slivers (`slivers`), as is the step where a surface turns
//!   back on itself (`folds`).
//! - What only cells that stay keep every eye from seeing is forgotten again, sample by sample
//!   (`hidden`).
//! - Sky is a bit per direction: set where some construction ray of that direction meets nothing.
//!
//! # Practice
//! Cells that are not culled are transparent to rays that make samples. Work is parallel over
//! rows, batches and cameras, and every result is collected in order: the image does not depend on
//! the number of threads. Memory is about 100 bytes per pixel.

mod caster;
mod central;
mod colour;
mod ends;
mod explain;
mod folds;
mod hidden;
mod layers;
mod merge;
mod portal_merge;
mod quality;
mod references;
mod sample;
mod sight;
mod slivers;
mod sums;
mod tiles;
mod view;

#[cfg(test)]
mod tests;

pub use caster::{Facet, Met, SubsetCaster};
pub use portal_merge::{MergeFigures, Offer, SAME_DEPTH, is_similar, merge_place};
pub use references::{SideImages, construct_side};
pub use sight::Survey;
pub use view::parallax_bound;

use crate::{
    placement::{ImagePlan, PlacementPlan},
    render::Caster,
};
use caster::Subset;
use ldi_protocol::{
    OutputCamera,
    ldi::{Ldi, Sliver},
    sky::SkyMap,
};
use merge::{Known, Seen};
use rayon::prelude::*;
use sample::Tolerance;
use sight::{Face, Sight};
use slivers::Candidate;
use std::time::Instant;
use tiles::Tile;
use view::{Rig, View};

/// Settings of construction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConstructOptions {
    /// The picture the dataset is made for: sets how fine disparities must be and what users can
    /// see.
    pub output: OutputCamera,
    /// Largest number of pixels of an image; more is an error, as memory grows by 100 bytes each.
    pub max_pixels: u64,
    /// What is seen of a plan's window is cut into tiles of at most so many pixels: a client
    /// fetches, lays out and keeps what it looks at, and what is fetched for a turn that never
    /// comes is small. Smaller: more images per frame (docs/adr/0018-image-tiles.md).
    pub tile_pixels: usize,
    /// Repeat samples where a surface changes layer, so that it stays linked.
    pub bridges: bool,
}

impl ConstructOptions {
    /// Defaults for a picture.
    pub fn new(output: OutputCamera) -> Self {
        Self { output, max_pixels: 1 << 26, tile_pixels: 250_000, bridges: true }
    }
}

/// Why an image could not be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConstructError {
    /// The plan holds a value that is not finite, an empty window or no users.
    #[error("the plan of the image is not usable: window, plane, scale or users are empty or not finite")]
    Plan,
    /// The image would be too large.
    #[error(
        "an image of {width:.0} x {height:.0} pixels exceeds 16384 on a side or {max_pixels} pixels; lower the density or the footprint"
    )]
    Size {
        /// Columns.
        width: f64,
        /// Rows.
        height: f64,
        /// The limit on pixels.
        max_pixels: u64,
    },
}

/// Rays cast, by step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct RayCounts {
    /// Central image.
    pub central: u64,
    /// Construction images.
    pub construction: u64,
    /// Recast of merged samples.
    pub recast: u64,
    /// Continuation of deeper samples by one pixel.
    pub ring: u64,
    /// Sub-rays for colour.
    pub colour: u64,
    /// Slivers.
    pub slivers: u64,
    /// Ends of surfaces.
    pub ends: u64,
    /// From eyes at samples, to find those that cells hide which stay.
    pub hidden: u64,
}

impl RayCounts {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.central
            + self.construction
            + self.recast
            + self.ring
            + self.colour
            + self.slivers
            + self.ends
            + self.hidden
    }
}

/// Figures of one construction. Only `seconds` varies from run to run.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize)]
pub struct ConstructStats {
    /// Rays by step.
    pub rays: RayCounts,
    /// Pixels that each construction camera had to trace, and pixels that it has.
    pub unexplained: Vec<[u64; 2]>,
    /// Samples per layer.
    pub samples_by_layer: Vec<u32>,
    /// Hits dropped because no user's picture holds them.
    pub pruned: u64,
    /// Predictions whose recast ray missed.
    pub recast_missed: u64,
    /// Samples dropped because their pixel had [`Ldi::MAX_LAYERS`] already.
    pub too_deep: u64,
    /// Slivers.
    pub slivers: u32,
    /// Pixels that are sky from somewhere.
    pub sky_pixels: u64,
    /// 99th percentile over sampled samples of the largest extent along the surface, output pixels.
    pub stretch_p99_px: f64,
    /// Its maximum.
    pub stretch_max_px: f64,
    /// Largest footprint met, output pixels.
    pub footprint_seen_px: f64,
    /// Bound on the error that rounding disparity causes, output pixels.
    pub quantization_error_px: f64,
    /// Seconds: central, construction, recast, all the rest.
    pub seconds: [f64; 4],
}

/// An image and its figures.
#[derive(Debug, Clone)]
pub struct Constructed {
    /// The part of the plan's window that it stands for: left, right, bottom, top, as tangents.
    /// What eyes see there is in it.
    pub window: [f64; 4],
    /// The image, cut to what eyes see of it; passes [`Ldi::check`].
    pub ldi: Ldi,
    /// Figures.
    pub stats: ConstructStats,
}

/// All images of a placement.
#[derive(Debug, Clone, Default)]
pub struct Panorama {
    /// Per planned image, its tiles; none where nobody sees anything of it.
    pub images: Vec<Vec<Constructed>>,
    /// Where eyes see sky.
    pub sky: SkyMap,
    /// Rays that eyes sent to find what they see.
    pub sight_rays: u64,
    /// Seconds of that.
    pub sight_seconds: f64,
}

/// Makes the images of a placement. The caster should have mips ([`Caster::with_mips`]): colours
/// are filtered over the pixel by them.
///
/// # Errors
/// [`ConstructError`] if the plan is unusable or an image too large.
pub fn construct(
    caster: &Caster,
    plan: &PlacementPlan,
    options: &ConstructOptions,
) -> Result<Panorama, ConstructError> {
    let subset = Subset::of(caster, &plan.culled);
    let start = Instant::now();
    let survey = Survey::of(&subset, &plan.eyes, &plan.gaze, &plan.through);
    let looked_for = |s: &Survey| s.sky(&subset, &plan.lookouts, &plan.through);
    let (sky, sky_rays) = survey.as_ref().map_or_else(Default::default, looked_for);
    let mut out = Panorama {
        sky,
        sight_rays: survey.as_ref().map_or(0, |s| s.rays) + sky_rays,
        sight_seconds: start.elapsed().as_secs_f64(),
        images: Vec::new(),
    };
    for image in &plan.images {
        let [left, right, bottom, top] = image.window;
        if left >= right || bottom >= top {
            // The replaced cells lie in the planning square but in nobody's picture.
            out.images.push(Vec::new());
            continue;
        }
        let start = Instant::now();
        let tiles = construct_subset(&subset, survey.as_ref(), image, options)?;
        // What was met is shared out among tiles.
        let making: f64 = tiles.iter().flat_map(|t| t.stats.seconds).sum();
        out.sight_seconds += start.elapsed().as_secs_f64() - making;
        out.images.push(tiles);
    }
    Ok(out)
}

/// Makes a planned image, over anything that casts rays, from what eyes see of it; without a
/// survey they may be anywhere. Returns its tiles.
///
/// # Errors
/// As [`construct`].
pub fn construct_subset<C: SubsetCaster>(
    caster: &C,
    survey: Option<&Survey>,
    plan: &ImagePlan,
    options: &ConstructOptions,
) -> Result<Vec<Constructed>, ConstructError> {
    let whole = Rig::new(plan, &options.output)?;
    let Some(survey) = survey else {
        return Ok(tile(caster, whole, None, plan.window, plan, options)?.into_iter().collect());
    };
    let face = Face::of(survey, plan, &whole);
    let mut out = Vec::new();
    for Tile { share, window } in face.tiles(&whole, options.tile_pixels) {
        let share = share.tangents_within(&whole.window, plan);
        out.extend(tile(caster, Rig { window, ..whole.clone() }, Some(&face), share, plan, options)?);
    }
    Ok(out)
}

/// Makes the image of a rig's window, which stands for a `share` of the plan's; None: nobody sees
/// anything of it.
fn tile<C: SubsetCaster>(
    caster: &C,
    mut rig: Rig,
    face: Option<&Face>,
    share: [f64; 4],
    plan: &ImagePlan,
    options: &ConstructOptions,
) -> Result<Option<Constructed>, ConstructError> {
    let tolerance = Tolerance { step: rig.step() as f32 };
    let mut stats = ConstructStats::default();
    let Some(sight) = Sight::of(face, &mut rig) else { return Ok(None) };
    rig.window.check(options.max_pixels)?;
    let started = Instant::now();

    let (central, rays) = central::central_image(caster, &rig, &sight.looked);
    stats.rays.central = rays;
    let mut sky = sky_of(&central, &rig);
    let mut known = Known::new(central, rig.window.width);
    let after_central = Instant::now();

    let mut recast_seconds = 0.0;
    let (mut cameras, mut candidates) = (Vec::new(), Vec::new());
    let coarse = explain::Coarse::new(&known.central, rig.window.width as usize);
    for round in &sight.cameras(&rig, &known.central, &tolerance) {
        let seen: Vec<(Vec<Seen>, [u64; 2])> =
            round.par_iter().map(|view| look(caster, &rig, view, &known, &coarse, &tolerance)).collect();
        let mut predictions = Vec::new();
        for (View { camera, .. }, (seen, share)) in round.iter().zip(seen) {
            let number = cameras.len() as u32;
            cameras.push(*camera);
            stats.rays.construction += share[0];
            stats.unexplained.push(share);
            for s in seen {
                match s {
                    Seen::Sky(pixel) => {
                        camera.same_directions(pixel, &rig.window).for_each(|p| set_sky(&mut sky, p, &rig))
                    }
                    Seen::Pruned => stats.pruned += 1,
                    Seen::New(home, pixel) => {
                        predictions.push(home);
                        if let Some(axis) = slivers::steep_axis(camera, &home.1) {
                            candidates.push(Candidate { camera: number, pixel, home, axis, beside: false });
                        }
                    }
                    Seen::Beside(home, pixel, axis) => {
                        candidates.push(Candidate { camera: number, pixel, home, axis, beside: true });
                    }
                    Seen::Known | Seen::Nothing => {}
                }
            }
        }
        let before_recast = Instant::now();
        let recast = merge::recast(caster, &rig, &mut known, predictions, &tolerance);
        stats.rays.recast += recast.rays;
        stats.recast_missed += recast.missed;
        recast_seconds += before_recast.elapsed().as_secs_f64();
    }
    let before_ring = Instant::now();
    let predictions = merge::between(&rig, &known, &tolerance);
    stats.rays.ring += merge::recast(caster, &rig, &mut known, predictions, &tolerance).rays;
    for sides in merge::RING_SIDES {
        let predictions = merge::ring(&rig, &known, &tolerance, sides);
        stats.rays.ring += merge::recast(caster, &rig, &mut known, predictions, &tolerance).rays;
    }
    recast_seconds += before_ring.elapsed().as_secs_f64();
    let after_merge = Instant::now();

    if let Some(face) = face {
        stats.rays.hidden = hidden::Watchers::of(face, &rig).forget_hidden(caster, &rig, &mut known);
        stats.rays.hidden += hidden::drop_hidden(caster, &rig, &cameras, &mut candidates);
    }
    let (mut raw, dropped) = layers::rank(&known, &rig, &tolerance, options.bridges);
    stats.too_deep = dropped.too_deep;
    stats.pruned += dropped.out_of_reach;
    let (mut slivers, rays) = slivers::find(caster, &rig, &raw, &cameras, candidates, &tolerance);
    stats.rays.slivers = rays;
    stats.rays.ends = raw.iter_mut().map(|l| ends::measure(caster, &rig, l, &tolerance)).sum();
    stats.rays.colour = colour::average(caster, &rig, &mut raw, &tolerance);
    slivers.extend(folds::find(&rig, &raw, &tolerance));
    if slivers.len() > Sliver::MOST {
        tracing::warn!(
            found = slivers.len(),
            kept = Sliver::MOST,
            "more slivers than an image may have: the rest is left out"
        );
        slivers.truncate(Sliver::MOST);
    }
    stats.slivers = slivers.len() as u32;
    let codes = layers::codes(&rig, &raw, slivers.iter().flat_map(|s| s.disparities()));
    let sizes = quality::measure(&rig, plan, &options.output, &raw);
    stats.stretch_p99_px = sizes.stretch_p99;
    stats.stretch_max_px = sizes.stretch_max;
    stats.footprint_seen_px = sizes.footprint_max;
    // Rounding errs by half a step.
    stats.quantization_error_px = 0.5 * codes.step * rig.parallax_bound;
    let layers: Vec<_> = raw.par_iter().map(|l| layers::encode(l, rig.window.width, &codes)).collect();
    stats.samples_by_layer = layers.iter().map(|l| l.len() as u32).collect();
    stats.sky_pixels = sky.iter().map(|w| u64::from(w.count_ones())).sum();
    let construction = (after_merge - after_central).as_secs_f64() - recast_seconds;
    stats.seconds =
        [(after_central - started).as_secs_f64(), construction, recast_seconds, after_merge.elapsed().as_secs_f64()];
    let slivers = slivers.iter().map(|s| s.coded(&codes)).collect();
    let ldi = Ldi { camera: rig.ldi_camera(), codes, layers, sky, slivers };
    debug_assert_eq!(ldi.check(), Ok(()));
    Ok(Some(Constructed { window: share, ldi, stats }))
}

/// One construction image: what its rays met, and (rays, pixels).
fn look<C: SubsetCaster>(
    caster: &C,
    rig: &Rig,
    view: &View,
    known: &Known,
    coarse: &explain::Coarse,
    tolerance: &Tolerance,
) -> (Vec<Seen>, [u64; 2]) {
    let camera = &view.camera;
    let mut unexplained = explain::unexplained(rig, view, (&known.central, coarse, &known.deeper), tolerance);
    let mut pixels = std::mem::take(&mut unexplained.first);
    let (mut all, mut open) = (Vec::new(), Vec::new());
    while !pixels.is_empty() {
        let seen = merge::trace_construction(caster, rig, camera, &pixels, known, tolerance);
        let mut new = Vec::new();
        for (pixel, s) in pixels.iter().zip(&seen) {
            match s {
                Seen::New(..) | Seen::Beside(..) => new.push(*pixel),
                Seen::Sky(_) => open.push(*pixel),
                _ => {}
            }
        }
        all.extend(seen);
        pixels = unexplained.around(&new);
    }
    let rays = all.len() as u64;
    let holes = unexplained.holes_around(&open);
    all.extend(holes.into_iter().map(Seen::Sky));
    (all, [rays, camera.window.pixels() as u64])
}

/// Sky bits of the central image.
fn sky_of(central: &[sample::Sample], rig: &Rig) -> Vec<u64> {
    let mut sky = vec![0; (rig.window.width as usize).div_ceil(64) * rig.window.height as usize];
    for (pixel, _) in central.iter().enumerate().filter(|(_, s)| s.disparity == 0.0) {
        set_sky(&mut sky, pixel as u32, rig);
    }
    sky
}

fn set_sky(sky: &mut [u64], pixel: u32, rig: &Rig) {
    let (row, column) = (pixel / rig.window.width, pixel % rig.window.width);
    sky[row as usize * (rig.window.width as usize).div_ceil(64) + column as usize / 64] |= 1 << (column % 64);
}
