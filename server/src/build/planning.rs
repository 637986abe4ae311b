//! Planning: from a scene to what has to be made.
//!
//! In: the options of a build. Out: the scene in clusters, cells and levels of detail, where people
//! walk, and the plan of images, by grid points or rooms.

use super::{
    BudgetChoice, BudgetRule, BuildError, BuildOptions, Clock, Progress, Represent, choose_budget, index_of,
    rooms::{self, RoomPlan, RoomSource, Site},
};
use crate::levels::{self, Levels};
use crate::octree::{Cell, Clusters, Octree};
use crate::placement::{self, Groupings, PlacementError, PlacementResult, SearchCase, SearchComparison, Sees};
use crate::render::{Caster, CellSet, Ray};
use crate::scene::{self, Scene};
use crate::walk_volume::{self, WalkError, WalkOptions, WalkReport};
use glam::DVec3;
use ldi_protocol::client_profile::LEAST_BUDGET;
use ldi_protocol::index::CELLS;
use ldi_protocol::index::{BuildSettings, CellEntry, CellLevel};
use ldi_protocol::volume::WalkVolume;
use std::sync::Arc;

/// A scene with its plan.
pub(super) struct Planned {
    pub scene: Arc<Scene>,
    pub clusters: Clusters,
    pub octree: Octree,
    pub levels: Levels,
    /// With the optimization budget filled in.
    pub settings: BuildSettings,
    pub plan: PlacementResult,
    pub walk: WalkReport,
    pub caster: Caster,
    pub rooms: Option<(RoomPlan, Site)>,
    /// The grid's alone, to be weighed against a plan by rooms.
    pub grid_alone: Option<PlacementResult>,
    /// Why there is nothing to weigh it against, though rooms were welcome.
    pub no_rooms: Option<String>,
    /// How the budget was found; None if it was given, or nothing was to be placed.
    pub budget: Option<BudgetChoice>,
}

/// Whether nothing lies between two places.
pub(super) fn sees(caster: &Caster, from: DVec3, to: DVec3) -> bool {
    let ray = Ray { origin: from, direction: to - from, t_min: 0.0, t_max: 1.0 };
    !caster.occluded(&ray, &CellSet::all())
}

/// Plans the grid for the eyes of a volume.
pub(super) fn place(
    scene: &Scene,
    cells: (&Octree, &Levels),
    settings: &BuildSettings,
    caster: &Caster,
    volume: WalkVolume,
    progress: &dyn Progress,
) -> Result<PlacementResult, PlacementError> {
    let in_sight = |a, b| sees(caster, a, b);
    let eyes = (&placement::Parameters::default(), volume);
    placement::plan_placements(scene, cells, settings, eyes, Sees(&in_sight), &|what| progress.note(what))
}

pub(super) fn plan(options: &BuildOptions, clock: &mut Clock, progress: &dyn Progress) -> Result<Planned, BuildError> {
    let (scene, clusters, octree, mut settings) = read(options, clock, progress)?;
    let levels = levels_of(&settings, (&scene, &clusters, &octree), progress);
    clock.lap("levels");
    let caster = Caster::new(Arc::clone(&scene), &clusters, &octree);
    clock.lap("caster");
    let (volume, walk) = walked(options, &caster, &clusters, &octree, &settings, progress)?;
    clock.lap("walk volume");
    progress.stage("grid and placement", 0);
    let placed = |settings: BuildSettings, volume: WalkVolume| {
        place(&scene, (&octree, &levels), &settings, &caster, volume, progress)
    };
    let mut by_choice = None;
    let is_placed = settings.grid == CELLS && !matches!(options.represent, Represent::Tree { .. } | Represent::Cache);
    if let (BudgetRule::For { profile, bytes_per_scene_byte }, true) = (&options.budget, is_placed) {
        let pixels = f64::from(settings.camera.width) * f64::from(settings.camera.height);
        let most_bytes = (bytes_per_scene_byte * scene_bytes(options, &scene) as f64) as u64;
        let of_budget = |budget: u64| {
            let plan = placed(BuildSettings { budget, optimize_budget: budget, ..settings.clone() }, volume.clone())?;
            let size = choose_budget::Size::of(&plan);
            Ok((plan, size))
        };
        let (plan, choice) = choose_budget::choose(profile, (pixels, most_bytes), &of_budget, progress)?;
        (settings.budget, settings.optimize_budget) = (choice.chosen, choice.chosen);
        by_choice = Some((plan, choice));
        clock.lap("budget");
    }
    let settings = settings;
    let place = |budget: u64, volume: WalkVolume| placed(BuildSettings { budget, ..settings.clone() }, volume);
    let within_budget = scene.triangles() <= settings.budget;
    // Nothing to place: what remains of a plan is the walk volume.
    let ground = || place(settings.budget.max(scene.triangles()), volume.clone());
    let (mut by_grid, choice) = by_choice.unzip();
    let needs_no_images = by_grid.as_ref().is_some_and(|plan| plan.plans.is_empty());
    // The grid's plan for all of the volume; once, if the budget's choice has made it.
    let mut grid = || by_grid.take().map_or_else(|| place(settings.budget, volume.clone()), Ok);
    let (mut rooms, mut grid_alone, mut no_rooms) = (None, None, None);
    let automatic = matches!(options.represent, Represent::Auto { .. });
    let known = match &options.represent {
        _ if within_budget || automatic && needs_no_images => None,
        Represent::Auto { rooms, .. } if !rooms::are_given(&scene, rooms) => {
            no_rooms = Some(rooms::NONE_GIVEN.to_string());
            None
        }
        Represent::Portals { rooms, portals } | Represent::Auto { rooms, portals } => {
            progress.stage("rooms", 0);
            let found = rooms::rooms_of(&caster, rooms, &walk_volume::surroundings(&volume, &scene.bounds()));
            clock.lap("rooms");
            match found {
                // What no room holds is the grid's, and where there are none, that is everything.
                Err(BuildError::NoRooms { why }) if automatic || !matches!(rooms, RoomSource::File(_)) => {
                    progress.note(&format!("grid: {why}"));
                    if !automatic {
                        tracing::warn!("all of the scene is left to the grid, as there are no rooms to walk by: {why}");
                    }
                    no_rooms = Some(why);
                    None
                }
                known => Some((known?, portals)),
            }
        }
        _ => None,
    };
    let plan = match known {
        _ if matches!(options.represent, Represent::Tree { .. } | Represent::Cache) => ground()?,
        Some((known, portals)) => {
            if automatic {
                progress.stage("grid and placement", 0);
                grid_alone = Some(grid()?);
                clock.lap("placement of the grid alone");
            }
            let entry = |(c, levels): (&Cell, &Vec<levels::Level>)| CellEntry {
                bounds: c.bounds,
                triangles: c.triangles,
                chunk: 0,
                bundles: Vec::new(),
                materials: Vec::new(),
                texel_density: Vec::new(),
                levels: levels.iter().map(draft_level).collect(),
            };
            let cells = octree.cells.iter().zip(&levels.cells).map(entry).collect();
            let (parts, nothing) = ((cells, Vec::new()), (Vec::new(), Vec::new(), None));
            let draft = index_of(options, &scene, settings.clone(), ground()?, parts, Vec::new(), nothing);
            let grid = |volume| place(settings.budget, volume);
            let site = Site::of(&caster, known, draft.cells.len(), progress);
            let (plan, found) =
                rooms::plan_rooms(&caster, &site, portals, draft, rooms::Share::default(), &grid, progress)?;
            rooms = Some((found, site));
            plan
        }
        None => grid()?,
    };
    clock.lap("placement");
    Ok(Planned {
        walk,
        rooms,
        grid_alone,
        no_rooms,
        scene,
        clusters,
        octree,
        levels,
        settings,
        plan,
        caster,
        budget: choice,
    })
}

/// Bytes of a scene: of its files, or of its unique geometry, if that is more.
fn scene_bytes(options: &BuildOptions, scene: &Scene) -> u64 {
    let of_file = |spec: &String| Some(std::fs::metadata(scene::FileSpec::parse(spec).ok()?.path).ok()?.len());
    options.scenes.iter().filter_map(of_file).sum::<u64>().max(scene.unique_triangles() * BYTES_PER_TRIANGLE)
}

/// Bytes of a triangle in a file without compression: half a vertex and three indices.
const BYTES_PER_TRIANGLE: u64 = 28;

/// A level as far as counting goes.
fn draft_level(level: &levels::Level) -> CellLevel {
    let levels::Level { deviation_m, triangles, .. } = *level;
    CellLevel { deviation_m, triangles, chunk: 0, instances: 0..0, bundles: Vec::new() }
}

/// Levels of detail, if the settings ask for any.
fn levels_of(
    settings: &BuildSettings,
    (scene, clusters, octree): (&Scene, &Clusters, &Octree),
    progress: &dyn Progress,
) -> Levels {
    if settings.max_deviation_px == 0.0 {
        return Levels::none(scene, octree);
    }
    progress.stage("levels of detail", 0);
    Levels::build(scene, clusters, octree)
}

/// Where people walk; what is told of it goes to `progress`.
fn walked(
    options: &BuildOptions,
    caster: &Caster,
    clusters: &Clusters,
    octree: &Octree,
    settings: &BuildSettings,
    progress: &dyn Progress,
) -> Result<(WalkVolume, WalkReport), WalkError> {
    progress.stage("walk volume", 0);
    let along = options.along.clone();
    let walk = WalkOptions { eye_height_m: settings.eye_height_m, starts: options.starts.clone(), along };
    let (volume, report) = walk_volume::walk_volume(caster, clusters, octree, &walk)?;
    progress.note(&report.lines().join("; "));
    report.warnings.iter().for_each(|warning| tracing::warn!("walk volume: {warning}"));
    Ok((volume, report))
}

/// Compares ways to search for the near boxes of a build; nothing is written.
///
/// # Errors
/// As [`super::build`].
pub fn compare_searches(
    options: &BuildOptions,
    comparison: &SearchComparison,
) -> Result<(Vec<SearchCase>, Vec<Groupings>), BuildError> {
    let (scene, clusters, octree, settings) = read(options, &mut Clock::default(), &())?;
    let levels = levels_of(&settings, (&scene, &clusters, &octree), &());
    let caster = Caster::new(Arc::clone(&scene), &clusters, &octree);
    let (volume, _) = walked(options, &caster, &clusters, &octree, &settings, &())?;
    let in_sight = |a, b| sees(&caster, a, b);
    Ok(placement::compare_searches(&scene, (&octree, &levels), &settings, &volume, Sees(&in_sight), comparison)?)
}

/// A scene in clusters and cells, and the settings with the optimization budget filled in.
type Read = (Arc<Scene>, Clusters, Octree, BuildSettings);

fn read(options: &BuildOptions, clock: &mut Clock, progress: &dyn Progress) -> Result<Read, BuildError> {
    // Of a share of the scene's triangles nothing is known yet.
    let asked = BuildSettings { budget: options.settings.budget.max(1), ..options.settings.clone() };
    placement::check_settings(&asked)?;
    progress.stage("reading the scene", 0);
    let scene = Arc::new(scene::load_all(&options.scenes)?);
    // A wrong unit or axis shows here.
    let [x, y, z] = scene.bounds().size().to_array().map(|m| format!("{m:.1}"));
    progress.note(&format!("{} triangles, {x} x {y} x {z} m, Y up", scene.triangles()));
    for doubt in scene::doubts(&options.scenes, &scene) {
        tracing::warn!("{}: {doubt}", options.scenes.join(" + "));
    }
    clock.lap("scene");

    progress.stage("clusters and octree", 0);
    let mut settings = options.settings.clone();
    // Cells as for the smallest budget that may be chosen.
    if matches!(options.budget, BudgetRule::For { .. }) {
        settings.budget = LEAST_BUDGET;
    }
    if let BudgetRule::Share(share) = options.budget {
        settings.budget = ((scene.triangles() as f64 * share) as u64).max(1);
        progress.note(&format!("budget: {} of {} triangles", settings.budget, scene.triangles()));
    }
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, settings.budget);
    if settings.optimize_budget == 0 && settings.grid == CELLS {
        // A box takes what P allows, to the triangle; aiming lower costs pixels
        // (docs/adr/0008-near-boxes.md).
        settings.optimize_budget = settings.budget;
    } else if settings.optimize_budget == 0 {
        let slack = (settings.budget / 10).max(2 * u64::from(octree.largest_cell()));
        settings.optimize_budget = settings.budget.saturating_sub(slack).max(1);
    }
    clock.lap("octree");
    Ok((scene, clusters, octree, settings))
}
