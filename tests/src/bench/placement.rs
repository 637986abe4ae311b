//! What image placement costs at which geometry budget: Figures 13 to 16 and Table 1 of Aliaga and
//! Lastra (1999) again.
//!
//! In: scenes, budgets, ways to cover the eyes. Out: a [`Row`] per combination. Plans only, no
//! image is made; every plan is audited.

use anyhow::{Context as _, Result};
use ldi_protocol::codec::ColourProfile;
use ldi_protocol::index::BuildSettings;
use ldi_protocol::{OutputCamera, path};
use ldi_server::build::{self, BuildError, BuildOptions, Draft, Progress, Represent};
use ldi_server::placement::{AuditReport, AuditSize, PlacementError, plan_row};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// What to try.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// Scenes, as `ldi-server build` takes them. A path file beside a scene's file
    /// (`NAME.path.json`) is walked.
    pub scenes: Vec<String>,
    /// Budgets, percent of the scene's triangles.
    pub budgets_percent: Vec<f64>,
    /// `cells`, `paper`.
    pub grids: Vec<String>,
    /// Output size.
    pub size: (u32, u32),
    /// Free look up and down, degrees.
    pub pitch_deg: f64,
    /// Poses of each audit.
    pub audit: AuditSize,
}

/// One plan.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Row {
    /// Scene.
    pub scene: String,
    /// How the eyes are covered.
    pub grid: String,
    /// Budget, percent of the scene's triangles.
    pub budget_percent: f64,
    /// Triangles of the scene.
    pub triangles: u64,
    /// Geometry budget P.
    pub budget: u64,
    /// Optimization budget Popt.
    pub optimize_budget: u64,
    /// Why there is no plan.
    pub error: Option<String>,
    /// Grid points in use.
    pub points: usize,
    /// Placements; with view cells each is a near box of up to six faces, with the paper's grid a
    /// single image.
    pub placements: usize,
    /// Images as planned: faces. When they are made they are cut into tiles around what eyes see.
    pub images: usize,
    /// Their pixels, millions; what no eye sees of them is not made.
    pub megapixels: f64,
    /// Images, by how many of them a grid point may use (Figure 15).
    pub images_per_point: Vec<u32>,
    /// Placements within 0-1%, 1-2% ... of Popt; the last entry: 20% and more (Figure 16).
    pub popt_closeness: Vec<u32>,
    /// Share of placements within 2% of Popt.
    pub within_two_percent: f64,
    /// Every eye has a certified grid point for every direction.
    pub certified: bool,
    /// Largest footprint that an image may have, output pixels.
    pub max_footprint_px: f64,
    /// Seconds of planning.
    pub seconds: f64,
    /// The audit.
    pub audit: Option<AuditReport>,
    /// Along the scene's path: triangles of all cells in view, and those drawn (Figure 14).
    pub along_path: Vec<[u64; 2]>,
}

/// Poses along a path for Figure 14.
const PATH_POSES: usize = 300;

/// Runs a sweep; `done` hears of every row.
///
/// # Errors
/// A scene or path that cannot be read, settings out of range. A budget that cannot be met is a
/// row that says so.
pub fn run(sweep: &Sweep, progress: &dyn Progress, mut done: impl FnMut(&Row)) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for scene in &sweep.scenes {
        let triangles = ldi_server::scene::load(scene)?.triangles();
        let walk = walk_beside(scene)?;
        for grid in &sweep.grids {
            for percent in &sweep.budgets_percent {
                let budget = ((triangles as f64 * percent / 100.0).round() as u64).max(1);
                let mut row = Row {
                    scene: scene.clone(),
                    grid: grid.clone(),
                    budget_percent: *percent,
                    triangles,
                    budget,
                    ..Row::default()
                };
                let options = options(scene, budget, grid, sweep.size, sweep.pitch_deg, walk.as_ref());
                match build::draft(&options, progress) {
                    Ok(draft) => fill(&mut row, &draft, walk.as_ref(), sweep.audit),
                    Err(BuildError::Placement(e @ PlacementError::Infeasible { .. })) => {
                        row.error = Some(e.to_string())
                    }
                    Err(e) => return Err(e).with_context(|| format!("{scene} at {percent}%")),
                }
                done(&row);
                rows.push(row);
            }
        }
    }
    Ok(rows)
}

/// A build of which only the plan counts.
fn options(
    scene: &str,
    budget: u64,
    grid: &str,
    (width, height): (u32, u32),
    pitch_deg: f64,
    walk: Option<&Walk>,
) -> BuildOptions {
    BuildOptions {
        represent: Represent::Grid,
        starts: Vec::new(),
        along: None,
        time_limit: None,
        budget: build::BudgetRule::Given,
        scenes: vec![scene.into()],
        output: PathBuf::new(),
        colour: ColourProfile::Lossless,
        settings: BuildSettings {
            budget,
            optimize_budget: 0,
            camera: OutputCamera { width, height, fov_deg: 60.0 },
            max_footprint_px: 2.0,
            max_deviation_px: 0.5,
            pitch_deg,
            density: 1.0,
            colour: "lossless".into(),
            grid: grid.into(),
            eye_height_m: Some(walk.and_then(|w| w.eye_height_m).unwrap_or(1.6)),
        },
    }
}

/// Options of a plan with view cells at a share of a scene's triangles, 1280x720, free look of 60
/// degrees.
///
/// # Errors
/// A scene or path that cannot be read.
pub fn usual_options(scene: &str, budget_percent: f64) -> Result<BuildOptions> {
    let triangles = ldi_server::scene::load(scene)?.triangles();
    let budget = ((triangles as f64 * budget_percent / 100.0).round() as u64).max(1);
    Ok(options(scene, budget, "cells", (1280, 720), 60.0, walk_beside(scene)?.as_ref()))
}

/// Poses and eye height of a path file.
struct Walk {
    poses: Vec<ldi_protocol::Pose>,
    eye_height_m: Option<f64>,
}

/// The path file beside a scene's file, if there is one.
///
/// # Errors
/// A file that cannot be read or is no path.
pub fn path_beside(scene: &str) -> Result<Option<path::Walk>> {
    let file = Path::new(scene).with_extension("path.json");
    if scene.starts_with("builtin:") || !file.is_file() {
        return Ok(None);
    }
    let text = std::fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))?;
    Ok(Some(path::parse(&text).with_context(|| file.display().to_string())?))
}

/// The walk along the path beside a scene, if there is one, in few poses.
fn walk_beside(scene: &str) -> Result<Option<Walk>> {
    Ok(path_beside(scene)?.map(|walk| {
        let step = walk.poses.len().div_ceil(PATH_POSES).max(1);
        Walk { poses: walk.poses.iter().step_by(step).map(|p| p.pose).collect(), eye_height_m: walk.eye_height }
    }))
}

fn fill(row: &mut Row, draft: &Draft, walk: Option<&Walk>, audit: AuditSize) {
    let (index, statistics) = (&draft.index, &draft.statistics);
    row.optimize_budget = index.settings.optimize_budget;
    row.points = index.points.len();
    row.placements = index.placements.len();
    row.images = draft.images.len();
    row.megapixels = draft.pixels() / 1e6;
    row.popt_closeness = statistics.popt_closeness.clone();
    row.within_two_percent = statistics.within_two_percent;
    row.certified = statistics.coverage_certified;
    row.max_footprint_px = statistics.max_footprint_px;
    row.seconds = draft.seconds.iter().filter(|s| s.0 == "placement").map(|s| s.1).sum();
    // No image is made yet: all count.
    row.images_per_point = build::images_per_grid_point(index, |_| true);
    row.audit = Some(draft.audit(audit));
    for pose in walk.iter().flat_map(|w| &w.poses) {
        let drawn = plan_row(index, 0, pose).triangles;
        let camera = &index.settings.camera;
        let frusta =
            ldi_protocol::select::DrawFrusta::new(&index.settings, pose, (camera.half_tan_x(), camera.half_tan_y()));
        let in_view =
            index.cells.iter().filter(|c| frusta.admit(&c.bounds)).map(|c| u64::from(c.triangles)).sum::<u64>();
        row.along_path.push([in_view, drawn]);
    }
}

/// A dataset of the paper's Table 1.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct PaperRow {
    /// Our counterpart of its model: a built-in scene.
    pub scene: &'static str,
    /// P as a share of its model's triangles, percent.
    pub budget_percent: f64,
    /// Its images, one per placement.
    pub images: u32,
}

/// Aliaga and Lastra 1999, Table 1; the torpedo room has no counterpart here.
pub const TABLE_1: [PaperRow; 5] = [
    PaperRow { scene: "plant", budget_percent: 12.5, images: 5815 },
    PaperRow { scene: "plant", budget_percent: 25.0, images: 239 },
    PaperRow { scene: "house", budget_percent: 8.8, images: 2492 },
    PaperRow { scene: "pipes", budget_percent: 15.0, images: 893 },
    PaperRow { scene: "pipes", budget_percent: 25.0, images: 282 },
];
