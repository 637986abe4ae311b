//! Portals in every way there is: Figures 5 and 6 of Rafferty, Aliaga, Popescu and Lastra (1998)
//! again.
//!
//! In: a scene with rooms, its path. Out: per method and frame of the path, milliseconds by stage
//! and what was drawn; on some frames the error against 16 rays per pixel; samples per layer of
//! the layered images, and what clipping saves of them.
//!
//! As in the paper there is no geometry budget here: portal culling draws all that is seen through
//! portals, and every other method shows an image wherever a portal has one for the eye.

use super::placement::{path_beside, usual_options};
use anyhow::{Context as _, Result, bail};
use ldi_client::{
    cache::Cache,
    composite::Fill,
    engine::{Appearance, Cull, DisplayMode, FrameRenderer, Method, Pace, Scores, Truth, WalkOptions, view_of},
    frame::Frame,
    report::StageMs,
    warp::{Order, Stamp},
};
use ldi_protocol::{
    OutputCamera,
    index::Index,
    need::Sight,
    path::{TimedPose, Walk},
    room_index::BuiltImages,
};
use ldi_server::{
    build::{self, PortalOptions, Progress, Represent, RoomSource},
    portal::Semicircle,
    render::{Caster, RenderOptions, render_path},
    scene,
    store::Dataset,
};
use serde::Serialize;
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// What to measure.
#[derive(Debug, Clone)]
pub struct Study {
    /// Scenes, as `ldi-server build` takes them.
    pub scenes: Vec<String>,
    /// Folder for what is left; datasets found there are used again.
    pub output: PathBuf,
    /// The walk; None: the one beside each scene's file.
    pub path: Option<Walk>,
    /// Output size.
    pub size: (u32, u32),
    /// Frames of the path.
    pub frames: usize,
    /// Every so many of them are judged.
    pub judge_every: usize,
    /// Where reference images are taken from.
    pub semicircle: Semicircle,
    /// Depths that differ by at most this share are one in merging.
    pub same_depth: f64,
    /// Which images the dataset has: both, or those of 1998 alone, which take less time to make.
    pub built: BuiltImages,
    /// Geometry budget that the dataset is built for, percent of the scene's triangles; decides
    /// how large octree cells are, and which of our images are made.
    pub budget_percent: f64,
}

/// The methods, in the order of the table: name, how it is drawn. Portal culling alone is our own
/// method without a limit on geometry.
pub const METHODS: [(&str, Method); 8] = [
    ("portal culling", Method::Portals),
    ("one texture", Method::Texture),
    ("several textures", Method::Textures),
    ("one image", Method::Warp1),
    ("two images", Method::Warp2),
    ("layered image", Method::Ldi),
    ("ours", Method::PortalsEverywhere),
    ("all in the frustum", Method::Geometry),
];

/// A frame by one method.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct FrameRow {
    /// Position among the frames.
    pub frame: usize,
    /// Milliseconds, all stages but laying out new images.
    pub ms: f64,
    /// Of them selection and culling.
    pub select_ms: f64,
    /// Of them near geometry.
    pub near_ms: f64,
    /// Of them the warp.
    pub warp_ms: f64,
    /// Laying out new images, not in `ms`.
    pub prepare_ms: f64,
    /// Near triangles.
    pub triangles: u64,
    /// Portals that show images.
    pub portals: usize,
    /// Samples drawn, and left out by clipping.
    pub samples: [u64; 2],
    /// Error, where the frame was judged.
    pub psnr_db: Option<f64>,
    /// Mean FLIP, likewise.
    pub flip: Option<f64>,
    /// The same over pixels from images.
    pub flip_far: Option<f64>,
    /// That of one ray per pixel over the same pixels.
    pub flip_far_baseline: Option<f64>,
    /// That of one ray per pixel.
    pub flip_baseline: Option<f64>,
    /// Share of pixels with a surface that nothing reached.
    pub holes: Option<f64>,
}

/// A method over the whole path.
#[derive(Debug, Clone, Serialize)]
pub struct MethodRows {
    /// Its name.
    pub name: &'static str,
    /// Frame by frame.
    pub frames: Vec<FrameRow>,
}

/// A scene's figures.
#[derive(Debug, Clone, Serialize)]
pub struct Found {
    /// Scene.
    pub scene: String,
    /// Its triangles.
    pub triangles: u64,
    /// Threads.
    pub threads: usize,
    /// Samples of all layered images by layer.
    pub layered_samples: Vec<u64>,
    /// Stored bytes of reference images, layered images, our images.
    pub bytes: [u64; 3],
    /// Their numbers.
    pub images: [u64; 3],
    /// The build's own figures of its rooms.
    pub rooms: serde_json::Value,
    /// All methods.
    pub methods: Vec<MethodRows>,
}

impl MethodRows {
    /// Values of all frames that have one, ascending.
    pub fn sorted(&self, of: impl Fn(&FrameRow) -> Option<f64>) -> Vec<f64> {
        let mut values: Vec<f64> = self.frames.iter().filter_map(of).collect();
        values.sort_by(f64::total_cmp);
        values
    }

    /// Mean over the frames that have a value; NaN of none.
    pub fn mean(&self, of: impl Fn(&FrameRow) -> Option<f64>) -> f64 {
        let values = self.sorted(of);
        values.iter().sum::<f64>() / values.len() as f64
    }
}

/// Measures everything; `heard` is told what is done.
///
/// # Errors
/// A scene, path or dataset that cannot be read; a scene without rooms or path.
pub fn run(study: &Study, progress: &dyn Progress, mut heard: impl FnMut(&str)) -> Result<Vec<Found>> {
    let mut all = Vec::new();
    for scene in &study.scenes {
        let found = of_scene(study, scene, progress, &mut heard)?;
        all.push(found);
    }
    Ok(all)
}

fn of_scene(study: &Study, spec: &str, progress: &dyn Progress, heard: &mut impl FnMut(&str)) -> Result<Found> {
    let walk = match &study.path {
        Some(walk) => walk.clone(),
        None => path_beside(spec)?.with_context(|| {
            format!("{spec}: no path beside it; give --path FILE, or write the scene with `ldi-server scene`, which writes one")
        })?,
    };
    let camera = OutputCamera { width: study.size.0, height: study.size.1, fov_deg: 60.0 };
    let (dataset, rooms) = dataset_of(study, spec, &camera, progress)?;
    let poses: Vec<TimedPose> = walk.evenly_spaced(study.frames).into_iter().map(|i| walk.poses[i]).collect();
    heard(&format!("{spec}: the truth of every {}th of {} frames", study.judge_every, poses.len()));
    let truths = truths(study, spec, &camera, &Walk { poses: poses.clone(), ..walk })?;
    // As in the paper, nothing bounds the geometry.
    let mut index: Index = (**dataset.index()).clone();
    index.settings.budget = u64::MAX;
    let mut methods = Vec::new();
    let ours = index.rooms.as_ref().is_some_and(|r| r.built == BuiltImages::Both);
    for (name, method) in METHODS.into_iter().filter(|m| ours || m.1 != Method::PortalsEverywhere) {
        let pictures = study.output.join("pictures").join(format!("{method:?}").to_lowercase());
        let frames = walk_by(method, &dataset, &index, &poses, &truths, &camera, Some(&pictures))?;
        let rows = MethodRows { name, frames };
        heard(&line(&rows));
        methods.push(rows);
    }
    let of = |placements: &mut dyn Iterator<Item = u32>| {
        let (mut bytes, mut images, mut samples) = (0, 0, Vec::new());
        for (_, image) in placements.flat_map(|p| index.images_of(p).collect::<Vec<_>>()) {
            bytes += image.chunks.iter().map(|c| u64::from(index.chunks[*c as usize].stored_bytes)).sum::<u64>();
            images += u64::from(!image.chunks.is_empty());
            samples.resize(samples.len().max(image.samples_by_layer.len()), 0);
            samples.iter_mut().zip(&image.samples_by_layer).for_each(|(a, b)| *a += u64::from(*b));
        }
        (bytes, images, samples)
    };
    let Some(own) = &index.rooms else { bail!("{spec}: no rooms") };
    let references = of(&mut own.sides.iter().flatten().flat_map(|s| s.references.clone()));
    let layered = of(&mut own.sides.iter().flatten().filter_map(|s| s.layered));
    let zones = of(&mut own.placements.iter().flatten().flat_map(|r| r.clone()));
    Ok(Found {
        scene: spec.to_owned(),
        triangles: index.scene.triangles,
        threads: rayon::current_num_threads(),
        layered_samples: layered.2,
        bytes: [references.0, layered.0, zones.0],
        images: [references.1, layered.1, zones.1],
        rooms,
        methods,
    })
}

/// The dataset of a scene with both kinds of images: one of an earlier run, or a new one; and what
/// its build says of rooms.
fn dataset_of(
    study: &Study,
    spec: &str,
    camera: &OutputCamera,
    progress: &dyn Progress,
) -> Result<(Dataset, serde_json::Value)> {
    let Semicircle { references, radius_m, arc_deg } = study.semicircle;
    let name = Path::new(spec).file_stem().map_or_else(|| spec.into(), |n| n.to_string_lossy().into_owned());
    let name: String = name.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).collect();
    let output = study.output.join(format!(
        "{name}-{:?}-{}pct-{}x{}-{references}-{radius_m}-{arc_deg}-{}",
        study.built, study.budget_percent, camera.width, camera.height, study.same_depth
    ));
    let dataset = match Dataset::open(&output) {
        Ok(found) => found,
        Err(_) => {
            let mut options = usual_options(spec, study.budget_percent)?;
            options.output = output.clone();
            options.settings.camera = *camera;
            let portals = PortalOptions {
                images: study.built,
                semicircle: study.semicircle,
                same_depth: study.same_depth,
                ..PortalOptions::default()
            };
            options.represent = Represent::Portals { rooms: RoomSource::Scene, portals };
            build::build(&options, progress)?;
            Dataset::open(&output)?
        }
    };
    if dataset.index().rooms.as_ref().is_none_or(|r| r.sides.is_empty()) {
        bail!(
            "{spec}: the dataset has no images of portals; the scene has no rooms, or fits the budget of {}%",
            study.budget_percent
        );
    }
    let rooms = dataset.report().and_then(|r| r.get("rooms").cloned()).unwrap_or_default();
    Ok((dataset, rooms))
}

/// Per frame 16 rays per pixel, and one, for those that are judged.
fn truths(study: &Study, spec: &str, camera: &OutputCamera, path: &Walk) -> Result<Vec<Option<[Truth; 2]>>> {
    let loaded = Arc::new(scene::load(spec)?);
    let folder = study.output.join("pictures");
    let every = study.judge_every.max(1);
    for (name, samples) in [("truth", 16), ("baseline", 1)] {
        let folder = folder.join(name);
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let options = RenderOptions { camera: *camera, samples, mips: samples == 1, depth: samples > 1, every };
        let caster = Caster::of_scene(Arc::clone(&loaded), options.mips);
        render_path(&caster, path, &options, &folder, &mut |_, _| {})?;
    }
    let load = |name: &str, i: usize| {
        Truth::load(&folder.join(name), i)?.with_context(|| format!("{}: picture {i} is gone", folder.display()))
    };
    (0..path.poses.len())
        .map(|i| match i.is_multiple_of(every) {
            true => Ok(Some([load("truth", i)?, load("baseline", i)?])),
            false => Ok(None),
        })
        .collect()
}

/// Draws poses by a method, each complete. `index`: the dataset's, or one changed in what it
/// shows. `truths`: per pose 16 rays per pixel and one, of those to be judged; their frames go to
/// `pictures`.
///
/// # Errors
/// Chunks that cannot be read, pictures that cannot be judged or written.
pub fn walk_by(
    method: Method,
    dataset: &Dataset,
    index: &Index,
    poses: &[TimedPose],
    truths: &[Option<[Truth; 2]>],
    camera: &OutputCamera,
    pictures: Option<&Path>,
) -> Result<Vec<FrameRow>> {
    let options = WalkOptions {
        width: camera.width,
        height: camera.height,
        method,
        cache_error_px: 2.0,
        stamp: Stamp::Quads,
        order: Order::Z,
        cull: Cull::On,
        fill: Fill::Surface,
        smooth: false,
        frame_ms: None,
        supersample: 1,
        pace: Pace::Wait,
        every: 1,
        cache_bytes: None,
        debug_views: false,
        shows: DisplayMode::Scene,
        appearance: Appearance::default(),
        background_layout: false,
        baseline_frames: 0,
    };
    let cache = Cache::new(Arc::clone(dataset.index()), u64::MAX);
    let (mut renderer, mut picture) = (FrameRenderer::default(), Frame::default());
    if let Some(folder) = pictures {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    let mut rows = Vec::new();
    for (i, (at, truth)) in poses.iter().zip(truths).enumerate() {
        let mut ms = StageMs::default();
        let view = view_of(index, &at.pose, camera, method, &mut ms);
        for chunk in cache.missing(view.needed(index, &Sight::new(&at.pose, camera, 1)).all()) {
            let bytes = dataset.chunk(chunk)?;
            cache.insert(chunk, &bytes).with_context(|| format!("chunk {chunk}"))?;
        }
        let frame_stats = renderer.render(index, &cache, &view, &at.pose, camera, &options, ms, &mut picture)?;
        let verdict = match truth {
            Some([truth, baseline]) => truth.evaluate(&picture, renderer.full(), Some(baseline))?,
            None => Scores::default(),
        };
        if let Some(folder) = pictures.filter(|_| truth.is_some()) {
            let rgb: Vec<u8> = picture.colour.iter().flat_map(|c| ldi_client::frame::unpack_rgb(*c)).collect();
            let file = folder.join(format!("frame_{i:05}.png"));
            image::save_buffer(&file, &rgb, camera.width, camera.height, image::ExtendedColorType::Rgb8)
                .with_context(|| format!("cannot write {}", file.display()))?;
        }
        let m = &frame_stats.ms;
        rows.push(FrameRow {
            frame: i,
            ms: m.total,
            select_ms: m.select + m.cull,
            near_ms: m.near,
            warp_ms: m.warp,
            prepare_ms: m.prepare,
            triangles: frame_stats.triangles,
            portals: view.portals.len(),
            samples: frame_stats.warp.as_ref().map_or([0; 2], |w| [w.samples_warped, w.samples_culled]),
            psnr_db: verdict.psnr_db,
            flip: verdict.flip,
            flip_far: verdict.flip_far,
            flip_far_baseline: verdict.flip_baseline_far,
            flip_baseline: verdict.flip_baseline,
            holes: verdict.hole_before_fill,
        });
    }
    Ok(rows)
}

/// One line of progress.
pub fn line(r: &MethodRows) -> String {
    format!(
        "{}: {:.1} ms, {:.0} triangles, {:.0} samples, FLIP {:.4}, PSNR {:.2} dB",
        r.name,
        r.mean(|f| Some(f.ms)),
        r.mean(|f| Some(f.triangles as f64)),
        r.mean(|f| Some(f.samples[0] as f64)),
        r.mean(|f| f.flip),
        r.mean(|f| f.psnr_db)
    )
}
