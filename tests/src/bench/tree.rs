//! The LDI tree against the number of its reference images: charts 1 to 3 of Chang, Bishop and
//! Lastra (1999) again.
//!
//! In: a scene with a path. Out: per number of reference images (square, 90 degrees) the tree's
//! memory, and the time to draw it along the path, with and without gap filling. Reference
//! positions are those that a build would choose, in that order; each gives four images, to -x,
//! +x, -z, +z.

use crate::plot::Plot;
use anyhow::{Context as _, Result, bail};
use glam::DVec3;
use ldi_client::{
    resident::Resident,
    tree::{ALL_GAP_PASSES, PixelMask, TreeOptions, TreePainter},
    warp::FarFrame,
};
use ldi_protocol::{
    Aabb, OutputCamera, Pose,
    ldi::Ldi,
    mesh::CellGeometry,
    path::{self, Walk},
    texture::Texture,
    tree::{Brood, Tree},
};
use ldi_server::{
    octree::{Clusters, Octree},
    render::{Caster, CellSet, Ray},
    scene,
    tree::{Grower, choose},
    walk_volume::{WalkOptions, walk_volume},
};
use serde::Serialize;
use std::{collections::BTreeMap, path::Path, sync::Arc, time::Instant};

/// What to try.
#[derive(Debug, Clone)]
pub struct Study {
    /// Scene, as `ldi-server build` takes it; its path.
    pub scene: String,
    /// Numbers of reference images, ascending.
    pub images: Vec<usize>,
    /// Pixels along a side of a reference image.
    pub side: u32,
    /// Smallest distance of samples, metres.
    pub pitch_m: f64,
    /// Output size.
    pub size: (u32, u32),
    /// Views along the path.
    pub frames: usize,
}

/// A tree of so many images.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Reference images.
    pub images: usize,
    /// Their pixels that meet a surface.
    pub reference_pixels: u64,
    /// Nodes.
    pub nodes: usize,
    /// Samples of all levels.
    pub samples: u64,
    /// Samples over reference pixels; the paper's is about 5.
    pub samples_per_pixel: f64,
    /// Stored bytes.
    pub stored_bytes: u64,
    /// Decoded bytes: what the client holds.
    pub decoded_bytes: u64,
    /// Stored bytes that each image added since the row before.
    pub added_per_image: f64,
    /// Seconds to build it.
    pub build_s: f64,
    /// Samples looked at per view, mean.
    pub samples_drawn: f64,
    /// Milliseconds per view without gap filling.
    pub ms: Vec<f64>,
    /// The same with it.
    pub ms_filled: Vec<f64>,
    /// Share of the pixels with a surface that nothing reached, without and with gap filling; mean.
    pub holes: [f64; 2],
    /// Mean of |colour - truth| in 8-bit codes over pixels with a surface, with gap filling.
    pub error: f64,
}

impl Row {
    /// Mean milliseconds without and with gap filling.
    pub fn mean_ms(&self) -> [f64; 2] {
        [&self.ms, &self.ms_filled].map(|m| m.iter().sum::<f64>() / m.len().max(1) as f64)
    }
}

/// A tree in memory.
struct Held(BTreeMap<u32, Arc<Brood>>);

impl Resident for Held {
    fn cell(&self, _: u32) -> Option<Arc<CellGeometry>> {
        None
    }
    fn bundle(&self, _: u32) -> Option<Arc<CellGeometry>> {
        None
    }
    fn texture(&self, _: u32) -> Option<Arc<Texture>> {
        None
    }
    fn ldi(&self, _: u32) -> Option<Arc<Ldi>> {
        None
    }
    fn brood(&self, chunk: u32) -> Option<Arc<Brood>> {
        self.0.get(&chunk).cloned()
    }
}

/// What rays see at a pose: whether there is a surface, and its colour.
struct Truth(Vec<Option<[u8; 3]>>);

impl Truth {
    fn new(caster: &Caster, pose: &Pose, camera: &OutputCamera) -> Self {
        let basis = pose.basis();
        let pixel = |k: u32| {
            let (u, v) = (f64::from(k % camera.width) + 0.5, f64::from(k / camera.width) + 0.5);
            let ray = Ray::new(pose.position, camera.ray(&basis, u, v));
            let hit = caster.trace(&ray, &CellSet::all())?;
            Some(caster.shade(&hit, &ray, None).map(ldi_protocol::shade::srgb8_from_linear))
        };
        Self((0..camera.width * camera.height).map(pixel).collect())
    }

    /// Share of holes and mean error.
    fn judge(&self, picture: &FarFrame) -> (f64, f64) {
        let (mut surface, mut holes, mut error) = (0u64, 0u64, 0.0);
        for (at, truth) in self.0.iter().enumerate() {
            let Some(truth) = truth else { continue };
            surface += 1;
            match picture.get(at) {
                Some((colour, _)) => {
                    let ours = ldi_client::frame::unpack_rgb(colour);
                    error += ours.iter().zip(truth).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / 3.0;
                }
                None => holes += 1,
            }
        }
        (holes as f64 / surface.max(1) as f64, error / (surface - holes).max(1) as f64)
    }
}

/// The path of a built-in scene or beside a file.
fn walk_of(spec: &str) -> Result<Walk> {
    if let Some(name) = spec.strip_prefix("builtin:") {
        let name = name.split('?').next().unwrap_or(name);
        let made = scene::builtin::build(name, None, 1)?;
        let waypoints: Vec<[f64; 3]> = made.waypoints.iter().map(|w| w.to_array()).collect();
        let json = serde_json::json!({ "eye_height": 1.6, "waypoints": waypoints, "closed": false });
        return Ok(path::parse(&json.to_string())?);
    }
    let file = Path::new(spec).with_extension("path.json");
    let text = std::fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))?;
    Ok(path::parse(&text)?)
}

/// Builds and draws the trees; `heard` gets each row as it is done.
///
/// # Errors
/// A scene or path that cannot be read, a scene in which nobody can stand.
pub fn run(study: &Study, mut heard: impl FnMut(&Row)) -> Result<Vec<Row>> {
    let scene = Arc::new(scene::load(&study.scene)?);
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, scene.triangles());
    let camera = OutputCamera { width: study.size.0, height: study.size.1, fov_deg: 60.0 };
    let caster = Caster::new(Arc::clone(&scene), &clusters, &octree).with_mips();
    let on_foot = WalkOptions { eye_height_m: Some(1.6), ..WalkOptions::default() };
    let (volume, _) = walk_volume(&caster, &clusters, &octree, &on_foot)?;
    let walk = walk_of(&study.scene)?;
    let poses: Vec<Pose> = walk.evenly_spaced(study.frames).into_iter().map(|k| walk.poses[k].pose).collect();
    let truths: Vec<Truth> = poses.iter().map(|p| Truth::new(&caster, p, &camera)).collect();
    let places: Vec<(DVec3, usize)> = choose(&caster, &volume, &Aabb::EMPTY)
        .positions
        .into_iter()
        .flat_map(|p| [0, 1, 4, 5].map(|face| (p, face)))
        .collect();
    if places.len() < 4 {
        bail!("{}: there is no place for a reference image", study.scene);
    }
    let mut rows: Vec<Row> = Vec::new();
    for &images in study.images.iter().filter(|n| **n <= places.len()) {
        let start = Instant::now();
        let mut grower = Grower::new(&scene.bounds(), study.pitch_m);
        for batch in places[..images].chunks(8) {
            grower.add(&caster, batch, study.side);
        }
        let reference_pixels = grower.reference_pixels();
        let built = grower.finish(&caster, 0)?;
        let build_s = start.elapsed().as_secs_f64();
        let stored_bytes = built.chunks.iter().map(|c| c.bytes.len() as u64).sum();
        let samples = built.figures.samples_by_level.iter().sum();
        let mut row = Row {
            images,
            reference_pixels,
            nodes: built.tree.nodes.len(),
            samples,
            samples_per_pixel: samples as f64 / reference_pixels.max(1) as f64,
            stored_bytes,
            decoded_bytes: built.chunks.iter().map(|c| c.decoded_bytes as u64).sum(),
            added_per_image: rows.last().map_or(stored_bytes as f64 / images as f64, |last| {
                (stored_bytes as f64 - last.stored_bytes as f64) / (images - last.images) as f64
            }),
            build_s,
            samples_drawn: 0.0,
            ms: Vec::new(),
            ms_filled: Vec::new(),
            holes: [0.0; 2],
            error: 0.0,
        };
        let held = hold(&built.tree, &built.chunks.iter().map(|c| &c.bytes[..]).collect::<Vec<_>>())?;
        let mut renderer = TreePainter::default();
        let mut picture = FarFrame::default();
        let n = poses.len() as f64;
        for (pose, truth) in poses.iter().zip(&truths) {
            for fill_gaps in [false, true] {
                // As in the paper: until the root fills.
                let gap_passes = if fill_gaps { ALL_GAP_PASSES } else { 0 };
                let options = TreeOptions { gap_passes, ..TreeOptions::default() };
                let mut wanted = PixelMask::all(camera.width, camera.height);
                let start = Instant::now();
                let tree = &built.tree;
                let stats =
                    renderer.draw(tree, &held, pose, &camera, &options, &mut wanted, &|_, _| false, &mut picture);
                let ms = start.elapsed().as_secs_f64() * 1e3;
                let (holes, error) = truth.judge(&picture);
                row.holes[usize::from(fill_gaps)] += holes / n;
                if fill_gaps {
                    row.ms_filled.push(ms);
                    row.error += error / n;
                } else {
                    row.ms.push(ms);
                    row.samples_drawn += stats.samples as f64 / n;
                }
            }
        }
        heard(&row);
        rows.push(row);
    }
    Ok(rows)
}

fn hold(tree: &Tree, chunks: &[&[u8]]) -> Result<Held> {
    let broods = tree.broods().map(|(chunk, nodes)| Ok((chunk, Arc::new(tree.decode(nodes, chunks[chunk as usize])?))));
    Ok(Held(broods.collect::<Result<_>>()?))
}

/// One line of progress.
pub fn line(r: &Row) -> String {
    let [ms, filled] = r.mean_ms();
    format!(
        "{} images: {} nodes, {:.2} M samples ({:.2} per pixel), {:.2} MB stored, {:.1} MB in memory, {:.1} ms ({filled:.1} filled), holes {:.2}% ({:.3}% filled)",
        r.images,
        r.nodes,
        r.samples as f64 * 1e-6,
        r.samples_per_pixel,
        r.stored_bytes as f64 * 1e-6,
        r.decoded_bytes as f64 * 1e-6,
        ms,
        r.holes[0] * 100.0,
        r.holes[1] * 100.0
    )
}

/// The rows as CSV.
pub fn csv(rows: &[Row]) -> String {
    let mut out = String::from(
        "images,reference_pixels,nodes,samples,samples_per_pixel,stored_bytes,decoded_bytes,added_bytes_per_image,build_s,samples_drawn,ms,ms_filled,holes,holes_filled,error\n",
    );
    for r in rows {
        let [ms, filled] = r.mean_ms();
        let fields = [
            r.images as f64,
            r.reference_pixels as f64,
            r.nodes as f64,
            r.samples as f64,
            r.samples_per_pixel,
            r.stored_bytes as f64,
            r.decoded_bytes as f64,
            r.added_per_image,
            r.build_s,
            r.samples_drawn,
            ms,
            filled,
            r.holes[0],
            r.holes[1],
            r.error,
        ];
        out += &(fields.map(|v| v.to_string()).join(",") + "\n");
    }
    out
}

/// Charts 1 to 3, by name.
pub fn plots(rows: &[Row]) -> Vec<(&'static str, String)> {
    use crate::plot::Series;
    let line = |name: &'static str, f: &dyn Fn(&Row) -> f64| Series {
        name,
        points: rows.iter().map(|r| (r.images as f64, f(r))).collect(),
    };
    let along = |r: &Row| r.ms_filled.iter().enumerate().map(|(k, ms)| (k as f64, *ms)).collect::<Vec<_>>();
    let some: Vec<&Row> = [0, rows.len() / 3, rows.len() * 2 / 3, rows.len().saturating_sub(1)]
        .into_iter()
        .filter_map(|k| rows.get(k))
        .collect();
    let names: Vec<String> = some.iter().map(|r| format!("{} images", r.images)).collect();
    let memory = Plot {
        title: "Chart 1: memory",
        x: "reference images",
        y: "MB",
        series: vec![
            line("in memory", &|r| r.decoded_bytes as f64 * 1e-6),
            line("stored", &|r| r.stored_bytes as f64 * 1e-6),
        ],
        bound: None,
    };
    let time = Plot {
        title: "Chart 2: time along the path",
        x: "view",
        y: "ms",
        series: some.iter().zip(&names).map(|(r, name)| Series { name, points: along(r) }).collect(),
        bound: None,
    };
    let mean = Plot {
        title: "Chart 3: mean time",
        x: "reference images",
        y: "ms",
        series: vec![line("with gap filling", &|r| r.mean_ms()[1]), line("without", &|r| r.mean_ms()[0])],
        bound: None,
    };
    let holes = Plot {
        title: "Pixels with a surface that nothing reached",
        x: "reference images",
        y: "%",
        series: vec![line("without gap filling", &|r| r.holes[0] * 100.0), line("with", &|r| r.holes[1] * 100.0)],
        bound: None,
    };
    vec![("chart1", memory.svg()), ("chart2", time.svg()), ("chart3", mean.svg()), ("holes", holes.svg())]
}
