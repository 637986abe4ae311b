//! Speed against error: every reconstruction, order and density of the warp on real views.
//!
//! In: scenes with walk paths, datasets of several densities (built here, or given). Out: a
//! [`Row`] per scene, density and setting: the time of the warp and of the frame, how near it is
//! to what this machine could do, and how far the pictures are from the truth.
//!
//! All in one process: chunks come from the dataset's files, so that neither network nor decoding
//! takes part. Views are those of the path that show images. A time is the median over the views
//! of the median over the repetitions; limits are measured on the same views between them.

use super::{
    colours::{self, ColourRow},
    placement::{path_beside, usual_options},
};
use anyhow::{Context as _, Result, bail};
use ldi_client::{
    cache::Cache,
    composite::Fill,
    engine::{Appearance, Cull, DisplayMode, FrameRenderer, Method, Pace, Scores, Truth, View, WalkOptions, view_of},
    frame::{Frame, Source, supersampled},
    near::Rasterizer,
    report::StageMs,
    resident::Resident as _,
    warp::{FarFrame, ImageInView, Order, PreparedLdi, Stamp, WarpOptions, WarpStats, transform_only, warp_images},
};
use ldi_protocol::{OutputCamera, Pose, codec::ColourProfile, need::Sight, path::Walk};
use ldi_server::{
    build::{self, Progress},
    render::{Caster, RenderOptions, render_path},
    scene,
    store::Dataset,
};
use rayon::prelude::*;
use serde::Serialize;
use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

/// What to measure.
#[derive(Debug, Clone)]
pub struct Job {
    /// Scene files; beside NAME.glb lies NAME.path.json.
    pub scenes: Vec<String>,
    /// Datasets to take instead of building, scene by scene; empty, or as many as scenes.
    pub datasets: Vec<PathBuf>,
    /// Folder for truths and datasets.
    pub output: PathBuf,
    /// Geometry budget, percent of the scene's triangles.
    pub budget_percent: f64,
    /// Samples per output pixel pitch.
    pub densities: Vec<f64>,
    /// Output size.
    pub size: (u32, u32),
    /// Views.
    pub frames: usize,
    /// Repetitions of each measurement.
    pub repeat: usize,
    /// Threads, the last for the pictures.
    pub threads: Vec<usize>,
    /// Reconstructions.
    pub stamps: Vec<Stamp>,
}

/// What shows what is far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drawn {
    /// All of it is drawn as geometry, in full.
    Geometry,
    /// All of it is drawn as geometry, at levels of detail.
    Levels,
    /// Images, with this reconstruction.
    Images(Stamp),
}

impl Drawn {
    /// What it is called in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Geometry => "geometry",
            Self::Levels => "levels",
            Self::Images(stamp) => stamp.name(),
        }
    }
}

/// How a frame is made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Setting {
    /// What shows what is far.
    #[serde(rename = "stamp", serialize_with = "by_name")]
    pub drawn: Drawn,
    /// Painted in occlusion-compatible order instead of by depth.
    pub epipole: bool,
    /// Tiles that cannot reach the picture are drawn as well.
    pub unclipped: bool,
    /// Samples per output pixel along each side.
    pub supersample: u32,
    /// 3 x 3 smoothing.
    pub smooth: bool,
    /// What holes show.
    pub fill: Fill,
    /// Threads.
    pub threads: usize,
}

fn by_name<S: serde::Serializer>(drawn: &Drawn, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_str(drawn.name())
}

/// One setting over all views of a scene.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Scene.
    pub scene: String,
    /// Density of its dataset.
    pub density: f64,
    /// Setting.
    #[serde(flatten)]
    pub setting: Setting,
    /// Views.
    pub frames: usize,
    /// Samples in tiles that may reach the picture, mean.
    pub samples: f64,
    /// Milliseconds of warping all of them.
    pub warp_ms: f64,
    /// The share of them that near geometry or other samples hide, tile by tile.
    pub hidden: f64,
    /// Milliseconds of the warp of a frame, which leaves these out.
    pub warp_hidden_ms: f64,
    /// Milliseconds of the frame: selection, near geometry, warp, composite.
    pub frame_ms: f64,
    /// Millions of samples warped per second.
    pub msamples_per_s: f64,
    /// The time of transforming the same samples without painting, over that of the warp.
    pub of_compute: f64,
    /// The time of moving the same bytes once through memory, over that of the warp.
    pub of_memory: f64,
    /// Decibels, mean.
    pub psnr_db: f64,
    /// Mean.
    pub ssim: f64,
    /// Mean FLIP.
    pub flip: f64,
    /// Mean FLIP of pixels that came from images.
    pub flip_far: f64,
    /// Mean FLIP over that of drawing everything with one ray per pixel.
    pub flip_over_baseline: f64,
    /// The same over the pixels that came from images.
    pub flip_far_over_baseline: f64,
    /// Largest FLIP of a view over the largest of the baseline.
    pub worst_over_baseline: f64,
    /// Share of pixels where the truth has a surface and nothing known is shown.
    pub holes: f64,
    /// The same before averaging and filling.
    pub holes_before_fill: f64,
    /// Pixels that differ from those of the z-buffer, as a share: another surface (disparities a
    /// tenth apart, or painted in one alone).
    pub orders_differ: Option<f64>,
}

/// Limits of this machine, measured between the settings.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Limits {
    /// Threads.
    pub threads: usize,
    /// Bytes per second that a sum over a large array reads, billions.
    pub memory_gb_per_s: f64,
}

/// What was found.
#[derive(Debug, Clone, Serialize)]
pub struct Found {
    /// Rows.
    pub rows: Vec<Row>,
    /// Limits.
    pub limits: Vec<Limits>,
    /// Colour profiles, of datasets with exact colours.
    pub colours: Vec<ColourRow>,
}

/// What `ldi-client walk` does unless told otherwise.
pub(super) const PLAIN: Setting = Setting {
    drawn: Drawn::Images(Stamp::Quads),
    epipole: false,
    unclipped: false,
    supersample: 1,
    smooth: false,
    fill: Fill::Surface,
    threads: 1,
};

/// Every setting with its own picture, at the last number of threads, and the main ones at the
/// others.
fn settings(threads: &[usize], stamps: &[Stamp]) -> Vec<Setting> {
    let most = *threads.last().unwrap_or(&1);
    let plain = Setting { threads: most, ..PLAIN };
    let mut all = Vec::new();
    for drawn in [Drawn::Geometry, Drawn::Levels] {
        all.extend([1, 2].map(|supersample| Setting { drawn, supersample, ..plain }));
    }
    for stamp in stamps.iter().copied() {
        let plain = Setting { drawn: Drawn::Images(stamp), ..plain };
        all.extend([1, 2].map(|supersample| Setting { supersample, ..plain }));
        let small = matches!(stamp, Stamp::OnePixel | Stamp::TwoByTwo);
        if small {
            all.push(Setting { epipole: true, ..plain });
        }
        if small || matches!(stamp, Stamp::Footprint | Stamp::Quads) {
            all.push(Setting { smooth: true, ..plain });
        }
        if matches!(stamp, Stamp::TwoByTwo | Stamp::Quads) {
            all.push(Setting { fill: Fill::Off, ..plain });
            all.push(Setting { fill: Fill::Last, ..plain });
        }
        if stamp == Stamp::Quads {
            all.push(Setting { unclipped: true, ..plain });
        }
        for threads in threads.iter().copied().filter(|t| *t != most) {
            all.push(Setting { threads, ..plain });
            if small {
                all.push(Setting { threads, epipole: true, ..plain });
            }
        }
    }
    all
}

impl Setting {
    fn warp_options(&self) -> WarpOptions {
        WarpOptions {
            stamp: if let Drawn::Images(stamp) = self.drawn { stamp } else { Stamp::default() },
            order: if self.epipole { Order::Epipole } else { Order::Z },
            keep_all_tiles: self.unclipped,
            ..WarpOptions::default()
        }
    }

    pub(super) fn walk_options(&self, (width, height): (u32, u32)) -> WalkOptions {
        let WarpOptions { stamp, order, .. } = self.warp_options();
        WalkOptions {
            width,
            height,
            method: match self.drawn {
                Drawn::Geometry => Method::Geometry,
                Drawn::Levels => Method::Levels,
                Drawn::Images(_) => Method::Auto,
            },
            cache_error_px: 2.0,
            stamp,
            order,
            cull: if self.unclipped { Cull::Off } else { Cull::On },
            fill: self.fill,
            smooth: self.smooth,
            frame_ms: None,
            supersample: self.supersample,
            pace: Pace::Wait,
            every: 1,
            cache_bytes: None,
            debug_views: false,
            shows: DisplayMode::Scene,
            appearance: Appearance::default(),
            background_layout: false,
            baseline_frames: 0,
        }
    }
}

/// Measures everything; `done` hears of every row.
///
/// # Errors
/// A scene, path or dataset that cannot be read; a path whose views use no image.
pub fn run(job: &Job, progress: &dyn Progress, mut done: impl FnMut(&Row)) -> Result<Found> {
    let pools = job
        .threads
        .iter()
        .map(|n| rayon::ThreadPoolBuilder::new().num_threads(*n).build().context("cannot start threads"))
        .collect::<Result<Vec<_>>>()?;
    let limits: Vec<Limits> = pools
        .iter()
        .map(|pool| Limits { threads: pool.current_num_threads(), memory_gb_per_s: pool.install(memory_gb_per_s) })
        .collect();
    let (mut rows, mut profiles) = (Vec::new(), Vec::new());
    for (i, spec) in job.scenes.iter().enumerate() {
        let walk = path_beside(spec)?.with_context(|| {
            let path = Path::new(spec).with_extension("path.json");
            format!(
                "{}: a path beside the scene is needed; `ldi-server scene` writes one with its scene",
                path.display()
            )
        })?;
        let datasets = match job.datasets.get(i) {
            Some(path) => vec![Dataset::open(path)?],
            None => {
                let each = job.densities.iter().map(|density| dataset_of(job, spec, *density, progress));
                each.collect::<Result<Vec<_>>>()?
            }
        };
        let Some(first) = datasets.first() else { continue };
        // The same for all densities, so that they can be compared.
        let views = views(job, spec, first, &walk, progress)?;
        for dataset in &datasets {
            profiles.extend(colours::compare(&name_of(spec), dataset, &camera_of(job), &views)?);
            for setting in settings(&job.threads, &job.stamps) {
                let at = job.threads.iter().position(|t| *t == setting.threads).unwrap_or(0);
                let row =
                    pools[at].install(|| measure(job, spec, dataset, &views, &setting, limits[at].memory_gb_per_s))?;
                done(&row);
                rows.push(row);
            }
        }
    }
    Ok(Found { rows, limits, colours: profiles })
}

fn name_of(spec: &str) -> String {
    Path::new(spec).file_stem().map_or_else(|| spec.to_string(), |n| n.to_string_lossy().into_owned())
}

/// The dataset of a scene at a density: the one that an earlier run left in the folder, or a new
/// one.
fn dataset_of(job: &Job, spec: &str, density: f64, progress: &dyn Progress) -> Result<Dataset> {
    let (width, height) = job.size;
    let name = format!("{}-{}pct-{width}x{height}-x{density}", name_of(spec), job.budget_percent);
    let output = job.output.join(name);
    if let Ok(found) = Dataset::open(&output) {
        return Ok(found);
    }
    let mut options = usual_options(spec, job.budget_percent)?;
    // Speed does not depend on it, and profiles are compared with it.
    let colour = ColourProfile::Lossless;
    options.output = output.clone();
    options.colour = colour;
    options.settings.camera = camera_of(job);
    options.settings.colour = colour.name().into();
    options.settings.density = density;
    build::build(&options, progress)?;
    Ok(Dataset::open(&output)?)
}

/// A pose of the path that uses images, and the pictures that it is judged by.
pub struct OneView {
    /// The pose.
    pub pose: Pose,
    /// 16 rays per pixel.
    pub truth: Truth,
    /// One ray per pixel.
    pub baseline: Truth,
}

/// Whether a hundredth of a view's pixels comes from images: often all that they hold is hidden.
/// Asked of a small picture.
fn shows_images(dataset: &Dataset, pose: &Pose, camera: &OutputCamera) -> Result<bool> {
    let small = OutputCamera { width: camera.width.div_ceil(4), height: camera.height.div_ceil(4), ..*camera };
    let index = dataset.index();
    let view = view_of(index, pose, &small, Method::Auto, &mut StageMs::default());
    if view.images.is_empty() {
        return Ok(false);
    }
    let options = PLAIN.walk_options((small.width, small.height));
    let (cache, mut picture) = (resident(dataset, &view, &Sight::new(pose, &small, 1))?, Frame::default());
    FrameRenderer::default().render(index, &cache, &view, pose, &small, &options, StageMs::default(), &mut picture)?;
    Ok(picture.count(Source::Far) * 100 >= picture.len())
}

/// Views spread evenly over those of 200 poses of the path that show images, with their truths.
fn views(job: &Job, spec: &str, dataset: &Dataset, walk: &Walk, progress: &dyn Progress) -> Result<Vec<OneView>> {
    let camera = camera_of(job);
    let mut candidates = Vec::new();
    for i in walk.evenly_spaced(200) {
        if shows_images(dataset, &walk.poses[i].pose, &camera)? {
            candidates.push(i);
        }
    }
    if candidates.is_empty() {
        bail!("{spec}: no view of its path shows an image at this budget; try a smaller --budget");
    }
    let n = job.frames.min(candidates.len());
    let chosen: Vec<usize> = (0..n).map(|i| candidates[i * candidates.len() / n]).collect();
    let path = Walk { poses: chosen.iter().map(|i| walk.poses[*i]).collect(), ..walk.clone() };
    let loaded = Arc::new(scene::load(spec)?);
    let folder = job.output.join(format!("{}-pictures", name_of(spec)));
    for (name, samples, depth) in [("truth", 16, true), ("baseline", 1, false)] {
        let folder = folder.join(name);
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let options = RenderOptions { camera, samples, mips: samples == 1, depth, every: 1 };
        let caster = Caster::of_scene(Arc::clone(&loaded), options.mips);
        progress.stage(&format!("{} pictures", name), n as u64);
        render_path(&caster, &path, &options, &folder, &mut |_, _| progress.advance(1))?;
    }
    let picture = |name: &str, i: usize| {
        Truth::load(&folder.join(name), i)?.with_context(|| format!("{}: picture {i} is gone", folder.display()))
    };
    (0..n)
        .map(|i| {
            let pose = path.poses[i].pose;
            Ok(OneView { pose, truth: picture("truth", i)?, baseline: picture("baseline", i)? })
        })
        .collect()
}

fn camera_of(job: &Job) -> OutputCamera {
    OutputCamera { width: job.size.0, height: job.size.1, fov_deg: 60.0 }
}

/// A cache that holds what a view needs, looked at so.
pub(super) fn resident(dataset: &Dataset, view: &View, sight: &Sight) -> Result<Cache> {
    let cache = Cache::new(Arc::clone(dataset.index()), u64::MAX);
    for chunk in view.needed(dataset.index(), sight).all() {
        let bytes = dataset.chunk(chunk)?;
        cache.insert(chunk, &bytes).with_context(|| format!("chunk {chunk}"))?;
    }
    Ok(cache)
}

fn measure(
    job: &Job,
    spec: &str,
    dataset: &Dataset,
    views: &[OneView],
    setting: &Setting,
    memory_gb_per_s: f64,
) -> Result<Row> {
    let index = dataset.index();
    let camera = camera_of(job);
    let full = supersampled(&camera, setting.supersample);
    let options = setting.walk_options(job.size);
    let warp_options = setting.warp_options();
    let (mut warp_ms, mut warp_hidden_ms, mut compute_ms, mut frame_ms) = (vec![], vec![], vec![], vec![]);
    let mut hidden = 0;
    let mut stats = WarpStats::default();
    let mut verdicts = Vec::new();
    let mut differ = Vec::new();
    let (mut far, mut spare, mut picture) = (FarFrame::default(), FarFrame::default(), Frame::default());
    let mut renderer = FrameRenderer::default();
    for v in views {
        let view = view_of(index, &v.pose, &camera, options.method, &mut StageMs::default());
        let cache = resident(dataset, &view, &Sight::new(&v.pose, &full, 1))?;
        if matches!(setting.drawn, Drawn::Images(_)) {
            let images: Vec<PreparedLdi> =
                view.images.iter().filter_map(|i| cache.ldi(*i)).map(|ldi| PreparedLdi::new(&ldi)).collect();
            let images: Vec<ImageInView<'_>> = images.iter().map(ImageInView::from).collect();
            let mut timed =
                |f: &mut dyn FnMut(&mut FarFrame) -> Result<WarpStats>| timed(job.repeat, &full, &mut far, f);
            let transformed = |far: &mut FarFrame| {
                let mut sum = WarpStats::default();
                images.iter().for_each(|i| sum.add(&transform_only(i.laid_out, &v.pose, &full, &warp_options, far)));
                Ok(sum)
            };
            compute_ms.push(timed(&mut { transformed })?.0);
            let mut near = Frame::default();
            Rasterizer::default().draw(index, &cache, &view.cells, &full, &v.pose, &mut near);
            let mut by = |order: Order, keep_hidden: bool| {
                let options = WarpOptions { order, keep_hidden, ..warp_options };
                let near = &near.disparity;
                timed(&mut |far| Ok(warp_images(&images, near, &v.pose, &full, &options, far, &mut spare)?))
            };
            let by_depth = setting.epipole.then(|| by(Order::Z, true)).transpose()?.map(|(.., far)| far);
            let (ms, of_this, picture) = by(warp_options.order, true)?;
            warp_ms.push(ms);
            let (ms, of_frame, _) = by(warp_options.order, warp_options.keep_hidden)?;
            warp_hidden_ms.push(ms);
            hidden += of_frame.samples_hidden;
            stats.add(&of_this);
            differ.extend(by_depth.map(|z| share_of_other_surfaces(&z, &picture)));
        }
        let mut times = Vec::new();
        for _ in 0..job.repeat.div_ceil(2) {
            let frame_stats =
                renderer.render(index, &cache, &view, &v.pose, &camera, &options, StageMs::default(), &mut picture)?;
            times.push(frame_stats.ms.total);
        }
        frame_ms.push(median(times));
        verdicts.push(v.truth.evaluate(&picture, renderer.full(), Some(&v.baseline))?);
    }
    let n = views.len() as f64;
    let (warp, compute) = (median(warp_ms), median(compute_ms));
    let mean = |of: fn(&Scores) -> Option<f64>| {
        let known: Vec<f64> = verdicts.iter().filter_map(of).collect();
        known.iter().sum::<f64>() / known.len().max(1) as f64
    };
    let most = |of: fn(&Scores) -> Option<f64>| verdicts.iter().filter_map(of).fold(0.0, f64::max);
    let samples = stats.samples_warped as f64 / n;
    Ok(Row {
        scene: name_of(spec),
        density: index.settings.density,
        setting: *setting,
        frames: views.len(),
        samples,
        warp_ms: warp,
        hidden: hidden as f64 / stats.samples_warped as f64,
        warp_hidden_ms: median(warp_hidden_ms),
        frame_ms: median(frame_ms),
        msamples_per_s: samples / warp / 1e3,
        of_compute: compute / warp,
        of_memory: stats.bytes as f64 / n / memory_gb_per_s / 1e6 / warp,
        psnr_db: mean(|v| v.psnr_db),
        ssim: mean(|v| v.ssim),
        flip: mean(|v| v.flip),
        flip_far: mean(|v| v.flip_far),
        flip_over_baseline: mean(|v| v.flip) / mean(|v| v.flip_baseline),
        flip_far_over_baseline: mean(|v| v.flip_far) / mean(|v| v.flip_baseline_far),
        worst_over_baseline: most(|v| v.flip) / most(|v| v.flip_baseline),
        holes: mean(|v| v.hole_fraction),
        holes_before_fill: mean(|v| v.hole_before_fill),
        orders_differ: (!differ.is_empty()).then(|| differ.iter().sum::<f64>() / differ.len() as f64),
    })
}

/// Runs a warp several times: the median of its milliseconds, its figures, its picture.
fn timed(
    repeat: usize,
    camera: &OutputCamera,
    far: &mut FarFrame,
    warp: &mut dyn FnMut(&mut FarFrame) -> Result<WarpStats>,
) -> Result<(f64, WarpStats, FarFrame)> {
    let mut stats = WarpStats::default();
    let mut times = Vec::new();
    for _ in 0..repeat {
        far.reset(camera.width, camera.height);
        let start = Instant::now();
        stats = warp(far)?;
        times.push(start.elapsed().as_secs_f64() * 1e3);
    }
    Ok((median(times), stats, far.clone()))
}

/// See [`Row::orders_differ`].
fn share_of_other_surfaces(a: &FarFrame, b: &FarFrame) -> f64 {
    let differ = (0..a.packed.len()).filter(|i| match (a.get(*i), b.get(*i)) {
        (Some((_, a)), Some((_, b))) => (a - b).abs() > 0.1 * a.max(b),
        (None, None) => false,
        _ => true,
    });
    differ.count() as f64 / a.packed.len().max(1) as f64
}

/// The middle value; NaN of none.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n => 0.5 * (values[(n - 1) / 2] + values[n / 2]),
    }
}

/// How fast the current pool's threads read an array that no cache holds: the best of five passes.
fn memory_gb_per_s() -> f64 {
    let words = vec![1u64; 32 << 20];
    let pass = || {
        let start = Instant::now();
        let sum: u64 = words.par_chunks(1 << 16).map(|c| c.iter().copied().fold(0, u64::wrapping_add)).sum();
        std::hint::black_box(sum);
        size_of_val(words.as_slice()) as f64 / start.elapsed().as_secs_f64() / 1e9
    };
    (0..5).map(|_| pass()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians() {
        assert_eq!([median(vec![3.0, 1.0, 2.0]), median(vec![1.0, 4.0])], [2.0, 2.5]);
        assert!(median(vec![]).is_nan());
    }

    #[test]
    fn settings_are_distinct_and_can_be_drawn() {
        let all = settings(&[1, 2], &Stamp::ALL);
        for (i, a) in all.iter().enumerate() {
            assert!(!all[..i].contains(a), "{a:?} twice");
            assert!(!a.epipole || matches!(a.drawn, Drawn::Images(Stamp::OnePixel | Stamp::TwoByTwo)));
        }
        for stamp in Stamp::ALL {
            for threads in [1, 2] {
                assert!(all.iter().any(|s| s.drawn == Drawn::Images(stamp) && s.threads == threads));
            }
        }
    }
}
