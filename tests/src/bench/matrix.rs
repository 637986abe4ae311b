//! Every scene with default settings and with each single method: what a user gets from a build
//! without options, beside all that could be had instead.
//!
//! In: scenes with a walk path. Out: per scene and setting the seconds, memory and bytes of the
//! build, and time, error, holes and bytes of a walk over evenly spaced poses of the path, all by
//! the project's own binaries. A default is dominated by a setting that is no worse in time, error
//! and bytes, and better in one of them.

use super::speed_error::median;
use crate::{
    poses,
    run::{self, Server},
};
use anyhow::{Context as _, Result, bail};
use serde::Serialize;
use serde_json::Value;
use std::{
    path::{Path, PathBuf},
    time::Instant,
};

/// Figures that differ by no more than this share count as equal.
pub const EQUAL: f64 = 0.05;

/// A setting: what is built, and how it is walked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Setting {
    /// No options.
    Default,
    /// Images by the grid alone.
    Grid,
    /// Images at portals.
    Portals,
    /// The LDI tree alone.
    Tree,
    /// Images that the client makes itself.
    Cache,
    /// Levels of detail of all that is in view.
    Levels,
    /// All that is in view in full.
    Geometry,
}

impl Setting {
    /// `--represent` of its dataset; None: no option.
    fn represent(self) -> Option<&'static str> {
        match self {
            Self::Default => None,
            Self::Grid => Some("grid"),
            Self::Portals => Some("portals"),
            Self::Tree => Some("tree"),
            // Geometry only, with its levels.
            Self::Cache | Self::Levels | Self::Geometry => Some("cache"),
        }
    }

    /// `--method` of its walk.
    pub fn method(self) -> &'static str {
        match self {
            Self::Default => "auto",
            Self::Grid => "grid",
            Self::Portals => "portals",
            Self::Tree => "tree",
            Self::Cache => "cache",
            Self::Levels => "levels",
            Self::Geometry => "geometry",
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            other => other.method(),
        }
    }
}

/// What to measure.
#[derive(Debug)]
pub struct Matrix {
    /// Scenes, as for `ldi-server build`; NAME.path.json beside NAME.glb is walked, and the path
    /// that comes with a built-in one.
    pub scenes: Vec<String>,
    /// Settings; the default one is always there.
    pub settings: Vec<Setting>,
    /// Picture size, WxH.
    pub size: String,
    /// Poses, evenly spaced over the path.
    pub frames: u64,
    /// Walks per setting. Times are medians over them; the settings of a scene take turns.
    pub repeats: u32,
    /// Options of all builds, such as `--budget 10%`.
    pub build: Vec<String>,
    /// Folder for what is left.
    pub output: PathBuf,
}

/// A scene's file and its size.
#[derive(Debug, Clone, Serialize)]
pub struct SceneFile {
    /// Name without folder and ending.
    pub name: String,
    /// Triangles, expanded.
    pub triangles: u64,
    /// Bytes of the file.
    pub bytes: u64,
}

/// Figures of one setting. What could not be measured is None.
#[derive(Debug, Clone, Serialize)]
pub struct Figures {
    /// Wall-clock seconds of the build.
    pub build_s: f64,
    /// Largest resident set of the build, bytes.
    pub build_peak_bytes: Option<u64>,
    /// Images in the dataset.
    pub images: u64,
    /// Triangle budget.
    pub budget: u64,
    /// Bytes of the dataset.
    pub dataset_bytes: u64,
    /// Milliseconds from connecting to the first useful frame.
    pub first_picture_ms: Option<f64>,
    /// Median frame time, milliseconds: the median of all walks.
    pub frame_ms: f64,
    /// The same of the fastest walk and of the slowest.
    pub frame_ms_range: [f64; 2],
    /// 99th percentile.
    pub frame_ms_p99: f64,
    /// Mean FLIP against 16 rays per pixel.
    pub flip: f64,
    /// Mean and worst frame, as multiples of those of one filtered ray per pixel.
    pub flip_ratio: [f64; 2],
    /// Largest share of a frame that is a hole.
    pub holes_max: f64,
    /// Frames with more triangles than the budget.
    pub violations: u64,
    /// Mean share of pixels from images.
    pub images_share: f64,
    /// Bytes that the walk received.
    pub walk_bytes: u64,
}

/// One scene with one setting.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// The scene.
    pub scene: SceneFile,
    /// The setting.
    pub setting: Setting,
    /// What was measured.
    pub figures: Option<Figures>,
    /// Why not.
    pub error: Option<String>,
}

/// A default that something else beats.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Dominated {
    /// The scene.
    pub scene: String,
    /// What beats its default.
    pub by: Setting,
    /// In which figures.
    pub better: Vec<&'static str>,
}

/// Measures everything; each row goes to `heard` when it is there. A setting that fails is a row
/// with its error.
///
/// # Errors
/// Scenes without a path, or that cannot be read; folders that cannot be written.
pub fn run(matrix: &Matrix, mut heard: impl FnMut(&Row)) -> Result<Vec<Row>> {
    std::fs::create_dir_all(&matrix.output).with_context(|| format!("cannot make {}", matrix.output.display()))?;
    let mut settings = vec![Setting::Default];
    settings.extend(matrix.settings.iter().filter(|s| **s != Setting::Default));
    let mut rows = Vec::new();
    for spec in &matrix.scenes {
        let site = Site::prepare(matrix, spec).with_context(|| spec.clone())?;
        let mut built: Vec<(Option<&str>, Result<Built, String>)> = Vec::new();
        let first = rows.len();
        // Per row that was walked: its dataset, and a report per walk, the first with errors.
        let mut walked: Vec<(usize, Built, Result<Vec<Value>>)> = Vec::new();
        for &setting in &settings {
            let represent = setting.represent();
            let dataset = match built.iter().find(|(made, _)| *made == represent) {
                Some((_, dataset)) => dataset.clone(),
                None => {
                    let dataset = site.build(matrix, represent).map_err(|e| format!("{e:#}"));
                    built.push((represent, dataset.clone()));
                    dataset
                }
            };
            let error = match dataset {
                Ok(dataset) => {
                    let report = site.walk(matrix, setting, &dataset, true);
                    walked.push((rows.len(), dataset, report.map(|r| vec![r])));
                    None
                }
                Err(e) => Some(e),
            };
            rows.push(Row { scene: site.scene.clone(), setting, figures: None, error });
        }
        for _ in 1..matrix.repeats {
            for (row, dataset, reports) in &mut walked {
                if let Ok(of_row) = reports {
                    match site.walk(matrix, rows[*row].setting, dataset, false) {
                        Ok(report) => of_row.push(report),
                        Err(e) => *reports = Err(e),
                    }
                }
            }
        }
        for (row, dataset, reports) in walked {
            match reports.and_then(|reports| figures(&dataset, &reports)) {
                Ok(figures) => rows[row].figures = Some(figures),
                Err(e) => rows[row].error = Some(format!("{e:#}")),
            }
        }
        rows[first..].iter().for_each(&mut heard);
    }
    Ok(rows)
}

/// The defaults that a setting beats in time, error and bytes at once.
pub fn dominated(rows: &[Row]) -> Vec<Dominated> {
    let defaults = rows.iter().filter(|r| r.setting == Setting::Default);
    let beaten = |default: &Row| {
        let own = default.figures.clone()?;
        let others = rows.iter().filter(|r| r.scene.name == default.scene.name && r.setting != Setting::Default);
        let by = others.filter_map(|r| Some((r.setting, better(r.figures.as_ref()?, &own)?)));
        Some(by.map(|(by, better)| Dominated { scene: default.scene.name.clone(), by, better }).collect::<Vec<_>>())
    };
    defaults.filter_map(beaten).flatten().collect()
}

/// In which figures one is better than the other; None if it is in none, or worse in one.
fn better(one: &Figures, other: &Figures) -> Option<Vec<&'static str>> {
    let pairs = [
        ("time", one.frame_ms, other.frame_ms),
        ("error", one.flip, other.flip),
        ("bytes", one.walk_bytes as f64, other.walk_bytes as f64),
    ];
    let is_worse = pairs.iter().any(|(_, a, b)| *a > b * (1.0 + EQUAL));
    let better: Vec<&str> = pairs.iter().filter(|(_, a, b)| a * (1.0 + EQUAL) < *b).map(|p| p.0).collect();
    (!is_worse && !better.is_empty()).then_some(better)
}

/// A dataset that was built.
#[derive(Debug, Clone)]
struct Built {
    folder: PathBuf,
    seconds: f64,
    report: Value,
}

/// A scene with poses and reference pictures, in a folder of its own.
struct Site {
    folder: PathBuf,
    file: PathBuf,
    poses: PathBuf,
    scene: SceneFile,
}

impl Site {
    fn prepare(matrix: &Matrix, spec: &str) -> Result<Self> {
        let builtin = spec.strip_prefix("builtin:");
        let name = match builtin {
            Some(rest) => rest.replace(['?', '&', '=', ',', ':', '/'], "-"),
            None => Path::new(spec).file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        };
        let folder = matrix.output.join(&name);
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let file = match builtin {
            Some(rest) => made(rest, &folder)?,
            None => PathBuf::from(spec),
        };
        let path = file.with_extension("path.json");
        if !path.is_file() {
            bail!("no walk beside the scene: {} is not there; record one in the window", path.display());
        }
        let poses_file = folder.join("poses.json");
        poses::spread(&path, matrix.frames, &poses_file)?;
        for (samples, more, name) in [("16", "--depth", "truth"), ("1", "--mips", "baseline")] {
            let mut c = run::command("ldi-server")?;
            c.arg("render").arg(&file).arg("--path").arg(&poses_file).args(["--size", &matrix.size]);
            c.args(["--samples", samples, more, "-o"]).arg(folder.join(name));
            run::run(c)?;
        }
        let bytes = file.metadata().with_context(|| format!("cannot read {}", file.display()))?.len();
        let triangles = ldi_server::scene::load(&file.to_string_lossy())?.triangles() as u64;
        Ok(Self { folder, file, poses: poses_file, scene: SceneFile { name, triangles, bytes } })
    }

    fn build(&self, matrix: &Matrix, represent: Option<&str>) -> Result<Built> {
        let folder = self.folder.join(represent.unwrap_or("default"));
        let mut c = run::command("ldi-server")?;
        c.arg("build").arg(&self.file).arg("-o").arg(&folder).args(["--size", &matrix.size]).args(&matrix.build);
        if let Some(represent) = represent {
            c.args(["--represent", represent]);
        }
        let start = Instant::now();
        run::run(c)?;
        Ok(Built { seconds: start.elapsed().as_secs_f64(), report: read_json(&folder.join("report.json"))?, folder })
    }

    /// The report of a walk, whose pictures are compared with truth and baseline or not.
    fn walk(&self, matrix: &Matrix, setting: Setting, dataset: &Built, compared: bool) -> Result<Value> {
        let server = Server::start(&dataset.folder)?;
        let at = |what: &str| self.folder.join(format!("{}-{what}", setting.name()));
        let report = at(if compared { "walk.json" } else { "walk-again.json" });
        let mut c = run::command("ldi-client")?;
        c.args(["walk", &server.quic, "--fingerprint", &server.fingerprint, "--pace", "wait", "--size", &matrix.size]);
        c.args(["--method", setting.method(), "--path"]).arg(&self.poses).arg("--report").arg(&report);
        c.arg("-o").arg(at("frames"));
        if compared {
            c.arg("--truth").arg(self.folder.join("truth")).arg("--baseline").arg(self.folder.join("baseline"));
        }
        run::run(c)?;
        read_json(&report)
    }
}

/// Writes a built-in scene with its path.
fn made(spec: &str, folder: &Path) -> Result<PathBuf> {
    let (name, options) = spec.split_once('?').unwrap_or((spec, ""));
    let file = folder.join(format!("{name}.glb"));
    let mut c = run::command("ldi-server")?;
    c.args(["scene", name]);
    for (key, value) in options.split('&').filter_map(|o| o.split_once('=')) {
        c.arg(format!("--{key}")).arg(value);
    }
    run::run({
        c.arg("-o").arg(&file);
        c
    })?;
    Ok(file)
}

/// Figures of several walks through a dataset: times are medians, all else is the first walk's.
fn figures(dataset: &Built, walks: &[Value]) -> Result<Figures> {
    let walk = walks.first().context("nothing was walked")?;
    let (build, s) = (&dataset.report, &walk["summary"]);
    let of_walks = |value: &dyn Fn(&Value) -> Option<f64>| walks.iter().filter_map(|w| value(&w["summary"])).collect();
    let frame_ms: Vec<f64> = of_walks(&|s| s["frame_ms"]["p50"].as_f64());
    let first_ms: Vec<f64> = of_walks(&|s| s["ms_first_useful_frame"].as_f64().or(s["ms_first_frame"].as_f64()));
    if frame_ms.len() < walks.len() {
        bail!("a report has no frame time");
    }
    let number = |v: &Value, what: &str| v.as_f64().with_context(|| format!("the report has no {what}"));
    let count = |v: &Value, what: &str| v.as_u64().with_context(|| format!("the report has no {what}"));
    // Over all frames: those without images count, too.
    let frames = walk["frames"].as_array().context("the report has no frames")?;
    let of = |key: &str| frames.iter().filter_map(|f| f[key].as_f64()).collect::<Vec<f64>>();
    let (own, baseline) = (of("flip"), of("flip_baseline"));
    let sum = |v: &[f64]| v.iter().sum::<f64>();
    let largest = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
    Ok(Figures {
        build_s: dataset.seconds,
        build_peak_bytes: build["peak_rss_bytes"].as_u64(),
        images: count(&build["ldis"], "images")?,
        budget: count(&s["budget_triangles"], "budget")?,
        dataset_bytes: count(&build["bytes"]["total"], "bytes")?,
        first_picture_ms: (!first_ms.is_empty()).then(|| median(first_ms)),
        frame_ms_range: [frame_ms.iter().copied().fold(f64::INFINITY, f64::min), largest(&frame_ms)],
        frame_ms: median(frame_ms),
        frame_ms_p99: median(of_walks(&|s| s["frame_ms"]["p99"].as_f64())),
        flip: number(&s["mean_flip"], "FLIP")?,
        flip_ratio: [sum(&own) / sum(&baseline), largest(&own) / largest(&baseline)],
        holes_max: number(&s["hole_fraction_max"], "holes")?,
        violations: count(&s["budget_violations"], "violations")?,
        images_share: number(&s["far_fraction_mean"], "share of images")?,
        walk_bytes: count(&s["bytes_total"], "bytes")?,
    })
}

fn read_json(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| path.display().to_string())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn row(scene: &str, setting: Setting, [frame_ms, flip, bytes]: [f64; 3]) -> Row {
        let figures = Figures {
            build_s: 1.0,
            build_peak_bytes: None,
            images: 3,
            budget: 200_000,
            dataset_bytes: bytes as u64,
            first_picture_ms: Some(10.0),
            frame_ms,
            frame_ms_range: [frame_ms; 2],
            frame_ms_p99: frame_ms,
            flip,
            flip_ratio: [1.0, 1.0],
            holes_max: 0.0,
            violations: 0,
            images_share: 0.5,
            walk_bytes: bytes as u64,
        };
        let scene = SceneFile { name: scene.into(), triangles: 7, bytes: 100 };
        Row { scene, setting, figures: Some(figures), error: None }
    }

    #[test]
    fn times_are_medians_over_walks() {
        let walk = |p50: f64, first: Option<f64>, flip: f64| {
            serde_json::json!({ "frames": [{ "flip": flip, "flip_baseline": 0.5 }], "summary": {
                "ms_first_useful_frame": first, "frame_ms": { "p50": p50, "p99": 2.0 * p50 }, "budget_triangles": 7,
                "mean_flip": flip, "hole_fraction_max": 0.0, "budget_violations": 0, "far_fraction_mean": 0.0,
                "bytes_total": 5,
            } })
        };
        let report = serde_json::json!({ "ldis": 0, "bytes": { "total": 9 } });
        let built = Built { folder: PathBuf::new(), seconds: 1.0, report };
        let walks = [walk(30.0, None, 0.25), walk(10.0, Some(5.0), 0.0), walk(11.0, Some(7.0), 0.0)];
        let found = figures(&built, &walks).expect("figures");
        assert_eq!((found.frame_ms, found.frame_ms_range, found.frame_ms_p99), (11.0, [10.0, 30.0], 22.0));
        assert_eq!((found.first_picture_ms, found.flip), (Some(6.0), 0.25));
    }

    #[test]
    fn a_default_is_dominated_by_what_is_worse_in_nothing_and_better_in_something() {
        let rows = [
            row("hall", Setting::Default, [20.0, 0.02, 1e6]),
            // Faster and smaller, and as good within what counts as equal.
            row("hall", Setting::Levels, [10.0, 0.0205, 5e5]),
            // Faster, but worse.
            row("hall", Setting::Tree, [5.0, 0.03, 1e5]),
            // Better in nothing.
            row("hall", Setting::Geometry, [20.5, 0.02, 1e6]),
            Row { figures: None, error: Some("no rooms".into()), ..row("hall", Setting::Portals, [1.0, 0.0, 1.0]) },
            // Another scene's.
            row("yard", Setting::Grid, [1.0, 0.001, 1.0]),
            row("yard", Setting::Default, [1.0, 0.001, 1.0]),
        ];
        let found = dominated(&rows);
        assert_eq!(found, [Dominated { scene: "hall".into(), by: Setting::Levels, better: vec!["time", "bytes"] }]);
    }
}
