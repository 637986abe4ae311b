//! The pipeline: the one place that joins the stages into a dataset.
//!
//! ```text
//! scene -> octree -> placement -> construction ─┐
//!             └───────────────> pack ───────────┴-> store
//! ```
//!
//! In: a scene's name and settings. Out: a dataset directory and its report. The bytes depend on
//! the input alone, not on the number of threads. Images, the slow part, are kept as they are
//! finished, so that a stopped build goes on where it was.

mod choose;
mod choose_budget;
mod choose_rooms;
mod dry_run;
mod forecast;
mod images;
mod kept_tree;
mod key;
mod planning;
mod references;
mod report;
mod rooms;
#[cfg(test)]
mod several_test;
mod shard;
#[cfg(test)]
mod small_builds;
#[cfg(test)]
mod stop_test;

use images::Indexed;
use planning::{Planned, plan};

pub use choose::Weighing;
pub use choose_budget::{BudgetChoice, BudgetRule, BudgetTrial};
pub use choose_rooms::{Mixed, RoomWeighing, Weight};
pub use dry_run::{Draft, DryRun, draft, dry_run};
pub use forecast::Forecast;
pub use images::{IMAGE_LEVEL, ImageFigures};
pub use planning::compare_searches;
pub use references::ReferenceFigures;
pub use report::{images_per_grid_point, report_json};
pub use rooms::{GridUnderRooms, PortalOptions, RoomFigures, RoomSource};
pub use shard::{Shard, ShardFigures, build_shard};

use crate::construct::ConstructError;
use crate::floor_plans;
use crate::octree::RecountError;
use crate::pack::{self, PackError};
use crate::placement::{self, AuditReport, AuditSize, ImagePlan, PlacementError, PlacementResult, PlacementStatistics};
use crate::scene::{self, Note, Scene, SceneError};
use crate::store::{Dataset, DatasetWriter, StoreError, Written};
use crate::tree::{self, BuiltTree, Depth, TreeFigures};
use crate::walk_volume::{Corridor, WalkError, WalkReport};
use glam::DVec3;
use ldi_protocol::codec::ColourProfile;
use ldi_protocol::index::{
    BuildSettings, CellEntry, ChunkEntry, ChunkHash, ImageEntry, Index, Placement, SceneInfo, TextureEntry,
};
use ldi_protocol::ldi::LdiCamera;
use ldi_protocol::room_index::{BuiltImages, RoomIndex};
use ldi_protocol::tree::Tree;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// What to build.
#[derive(Debug, Clone)]
pub struct BuildOptions {
    /// Scenes, as [`scene::load_all`] takes them.
    pub scenes: Vec<String>,
    /// Dataset directory.
    pub output: PathBuf,
    /// Settings; an `optimize_budget` of 0 stands for the default: P with view cells, P - max(10%
    /// of P, 2 x the largest cell) with the paper's grid.
    pub settings: BuildSettings,
    /// How the budget is found; if it is not given, the settings' is not used.
    pub budget: BudgetRule,
    /// Colour coding; `settings.colour` is its name.
    pub colour: ColourProfile,
    /// Images and a base layer, or the LDI tree alone.
    pub represent: Represent,
    /// Places where people start: they walk wherever they get to from there. None given: found.
    pub starts: Vec<DVec3>,
    /// Eyes are near this path only; None: wherever one can walk.
    pub along: Option<Corridor>,
    /// After this time no image is begun any more: what is not made is shown by geometry and the
    /// LDI tree, and the same build goes on with it later.
    pub time_limit: Option<Duration>,
}

/// How what is far is represented.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Represent {
    /// Images of placements, with the coarse levels of an LDI tree under them.
    #[default]
    Grid,
    /// Whichever keeps the footprint bound with fewer bytes: the tree alone, or images over its
    /// coarse levels.
    Smaller,
    /// The LDI tree alone: no placements, so that no budget is promised.
    Tree {
        /// Smallest distance of samples, metres.
        pitch_m: f64,
        /// Pixels along a side of a reference image.
        side: u32,
    },
    /// Geometry and the coarse levels of an LDI tree: clients make images of what is far
    /// themselves (Shade et al. 1996). No budget is promised.
    Cache,
    /// Rooms, with images of what lies beyond their portals, the grid's images where that exceeds
    /// the budget, and the coarse levels of an LDI tree under them.
    Portals {
        /// Where the rooms come from.
        rooms: RoomSource,
        /// What is shown beyond portals.
        portals: PortalOptions,
    },
    /// By rooms if the scene names some, or another source is given, and that keeps both promises
    /// with fewer bytes; else by the grid alone.
    Auto {
        /// Where the rooms come from.
        rooms: RoomSource,
        /// What is shown beyond portals.
        portals: PortalOptions,
    },
}

/// Hears of progress: bars on a terminal, plain lines elsewhere, nothing in tests.
pub trait Progress: Sync {
    /// A stage begins with this many steps; 0: unknown.
    fn stage(&self, name: &str, steps: u64);
    /// Steps are done.
    fn advance(&self, steps: u64);
    /// Steps need not be done: an earlier build left what they make.
    fn skip(&self, steps: u64) {
        self.advance(steps);
    }
    /// How far a stage is whose steps are not known.
    fn note(&self, what: &str);
}

/// Nobody listens.
impl Progress for () {
    fn stage(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn note(&self, _: &str) {}
}

/// Why a dataset could not be built.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The octree; of dry runs, which check it.
    #[error(transparent)]
    Cells(#[from] RecountError),
    /// The walk volume.
    #[error(transparent)]
    Walk(#[from] WalkError),
    /// Placement.
    #[error(transparent)]
    Placement(#[from] PlacementError),
    /// The images of a placement.
    #[error("images of placement {number} of {total}")]
    Construct {
        /// Its number.
        number: usize,
        /// How many there are.
        total: usize,
        /// Why.
        source: ConstructError,
    },
    /// Rooms.
    #[error(
        "no rooms to walk by: {why}; give corrected ones by --rooms FILE (`ldi-server rooms`), or build with --represent grid"
    )]
    Rooms {
        /// What is wrong.
        why: String,
    },
    /// There are no rooms.
    #[error(
        "there are no rooms to walk by: {why}; give some by --rooms FILE (`ldi-server rooms`), or build with --represent auto or grid"
    )]
    NoRooms {
        /// Why not.
        why: String,
    },
    /// The images of a build cannot be shared out.
    #[error("--shard: {why}; add --represent grid or portals, or leave --shard out")]
    NoShares {
        /// Why not.
        why: &'static str,
    },
    /// Encoding.
    #[error(transparent)]
    Pack(#[from] PackError),
    /// Writing.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// What a build found, for its report.
#[derive(Debug, Clone)]
pub struct BuildFigures {
    /// The dataset's index.
    pub index: Index,
    /// Cells, their depth, the largest.
    pub octree: BTreeMap<&'static str, u64>,
    /// Where people walk.
    pub walk: WalkReport,
    /// Placement.
    pub placement: PlacementStatistics,
    /// Random poses, after the fact.
    pub audit: AuditReport,
    /// Images.
    pub images: ImageFigures,
    /// What they were expected to take; None without images, or where all were there already.
    pub forecast: Option<Forecast>,
    /// The LDI tree; None without one.
    pub tree: Option<TreeFigures>,
    /// How images and tree compare; None if that was not asked for, or there is nothing to place.
    pub weighing: Option<Weighing>,
    /// How rooms and the grid alone compare; None if that was not asked for, or there are no rooms.
    pub room_weighing: Option<RoomWeighing>,
    /// Rooms; None without.
    pub rooms: Option<RoomFigures>,
    /// How the budget was found; None if it was given, or nothing was to be placed.
    pub budget: Option<BudgetChoice>,
    /// What was skipped or changed.
    pub notes: Vec<Note>,
    /// Seconds per stage.
    pub seconds: Vec<(&'static str, f64)>,
}

/// A finished dataset.
#[derive(Debug)]
pub struct Built {
    /// What was written.
    pub written: Written,
    /// The report, as in the dataset's `report.json`.
    pub report: serde_json::Value,
    /// How the budget was found; None if it was given, or nothing was to be placed.
    pub budget: Option<BudgetChoice>,
    /// Of what `skipped` of the report lists, so many entries, the first ones, are of the scene.
    pub of_scene: usize,
}

/// Joins what the stages made.
fn index_of(
    options: &BuildOptions,
    scene: &Scene,
    settings: BuildSettings,
    plan: PlacementResult,
    (cells, textures): (Vec<CellEntry>, Vec<TextureEntry>),
    chunks: Vec<ChunkEntry>,
    (placements, images, tree): (Vec<Placement>, Vec<ImageEntry>, Option<Tree>),
) -> Index {
    Index {
        scene: SceneInfo {
            name: display_name(&options.scenes),
            triangles: scene.triangles(),
            unique_triangles: scene.unique_triangles(),
            instances: scene.instances.len() as u64,
            bounds: scene.bounds(),
        },
        settings,
        chunks,
        cells,
        materials: scene.materials.clone(),
        textures,
        pitch_bands_deg: plan.pitch_bands_deg,
        points: plan.points,
        placements,
        images,
        volume: Some(plan.volume),
        tree,
        rooms: None,
        plans: Vec::new(),
    }
}

fn chunk_entry(chunk: &pack::Chunk) -> ChunkEntry {
    ChunkEntry {
        hash: ChunkHash(*blake3::hash(&chunk.bytes).as_bytes()),
        stored_bytes: chunk.bytes.len() as u32,
        decoded_bytes: u32::try_from(chunk.decoded_bytes).unwrap_or(u32::MAX),
        kind: chunk.kind,
    }
}

/// The index of a plan before any image is made: without chunks.
fn draft_index(
    options: &BuildOptions,
    scene: &Scene,
    settings: &BuildSettings,
    plan: &PlacementResult,
    cells: Vec<CellEntry>,
    rooms: Option<&RoomIndex>,
) -> Index {
    let none = images::Images::none_of(&plan.plans);
    let Indexed { placements, images, .. } = none.indexed(&plan.plans, &[], 0);
    let parts = ((cells, Vec::new()), Vec::new(), (placements, images, None));
    let mut index = index_of(options, scene, settings.clone(), plan.clone(), parts.0, parts.1, parts.2);
    index.rooms = rooms.cloned();
    index
}

/// Poses of the audit that every build ends with: a second or two. `verify --guarantee` takes as
/// many as one likes.
const AUDITED_POSES: AuditSize = AuditSize { random: 5_000, adversarial: 5_000 };

/// The camera of an image as planned, before it is cut to what eyes see.
fn planned_camera(plan: &ImagePlan) -> LdiCamera {
    let [left, right, bottom, top] = plan.window.map(|t| t * plan.pixels_per_unit);
    LdiCamera {
        cop: plan.cop,
        basis: plan.basis,
        pixels_per_unit: plan.pixels_per_unit,
        left: left.floor() as i32,
        top: (-top).floor() as i32,
        width: (right - left).ceil() as u32,
        height: (top - bottom).ceil() as u32,
    }
}

/// Builds a dataset.
///
/// # Errors
/// A scene that cannot be read, a budget that cannot be met, or a directory that cannot be written.
pub fn build(options: &BuildOptions, progress: &dyn Progress) -> Result<Built, BuildError> {
    let mut clock = Clock::default();
    // First: whether the directory can be written is known at once, planning takes minutes.
    let writer = DatasetWriter::open(&options.output)?;
    if let Ok(there) = Dataset::open(&options.output) {
        let (path, before) = (options.output.display(), &there.index().scene.name);
        tracing::warn!(
            "{path} holds a dataset of {before}: it is replaced when this one is done, and stays until then"
        );
    }
    let planned = plan(options, &mut clock, progress);
    let Planned {
        scene,
        clusters,
        octree,
        levels,
        settings,
        mut plan,
        walk,
        caster,
        rooms,
        grid_alone,
        no_rooms,
        budget,
    } = match planned {
        Ok(planned) => planned,
        Err(e) => {
            writer.give_up();
            return Err(e);
        }
    };

    progress.stage("near geometry and textures", 0);
    let geometry = pack::pack_geometry(&scene, &clusters, &octree, &levels, 0)?;
    let textures = pack::pack_textures(&scene, options.colour.of_textures(), geometry.chunks.len() as u32)?;
    let mut chunks = geometry.chunks;
    chunks.extend(textures.chunks);
    clock.lap("pack");

    let caster = caster.with_mips();
    let scene_key = key::scene_key(&scene);
    let heard = |what: &str| progress.note(what);
    let mut room_weighing = None;
    let mut rooms = match (rooms, grid_alone, &options.represent) {
        (Some((by_rooms, site)), Some(grid_alone), Represent::Auto { portals, .. }) => {
            progress.stage("rooms or the grid alone", 0);
            let ground = choose_rooms::Ground {
                options,
                caster: &caster,
                scene: &scene,
                octree: &octree,
                levels: &levels,
                settings: &settings,
                cells: &geometry.cells,
                chunks: &chunks.iter().map(chunk_entry).collect::<Vec<_>>(),
                textures: &textures.textures,
                scene_key: &scene_key,
                writer: &writer,
                progress,
            };
            let (found, chosen, by_rooms) =
                choose_rooms::choose_rooms(&ground, (plan, by_rooms, &site), grid_alone, portals)?;
            room_weighing = Some(found);
            plan = chosen;
            clock.lap("weighing of rooms");
            by_rooms
        }
        (rooms, ..) => rooms.map(|(by_rooms, _)| by_rooms),
    };
    progress.stage("reference positions of the LDI tree", 0);
    let places = tree::choose(&caster, &plan.volume, &scene.bounds());
    heard(&format!("{} of {} candidates", places.positions.len(), places.candidates));
    let bounds = scene.bounds();
    let tree_input = kept_tree::TreeInput {
        caster: &caster,
        bounds: &bounds,
        places: &places,
        scene_key: &scene_key,
        first_chunk: chunks.len() as u32,
    };
    let mut built = None;
    let mut weighing = None;
    if options.represent == Represent::Smaller && !plan.plans.is_empty() {
        progress.stage("images or the LDI tree alone", 0);
        let candidates = choose::Candidates {
            caster: &caster,
            tree_input: &tree_input,
            volume: &plan.volume,
            cells: &geometry.cells,
            plans: &plan.plans,
            settings: &settings,
        };
        let (found, tree) = choose::weigh(&candidates, options, &writer, &heard)?;
        heard(&format!("{}: {}", found.chosen, found.why));
        if tree.is_some() {
            // Without grid points, what the budget leaves comes from the tree.
            (plan.points, plan.plans) = (Vec::new(), Vec::new());
        }
        (built, weighing) = (tree, Some(found));
        clock.lap("weighing");
    }

    let deadline = options.time_limit.map(|limit| clock.start + limit);
    let forecast = match plan.plans.is_empty() {
        false => {
            let work = forecast::Work {
                caster: &caster,
                settings: &settings,
                colour: options.colour,
                scene_key: &scene_key,
                writer: &writer,
                deadline,
                progress,
            };
            let found = Forecast::of(&work, &plan.plans)?;
            if let Some(found) = &found {
                let said = found.said(options.along.is_some(), options.time_limit.is_some());
                heard(&said);
                tracing::info!("{said}");
            }
            found
        }
        true => None,
    };
    clock.lap("forecast");
    progress.stage("layered depth images, by placement", plan.plans.len() as u64);
    let mut images = match plan.plans.is_empty() {
        false => images::construct_all(
            &caster,
            &plan.plans,
            &settings,
            options.colour,
            &scene_key,
            &writer,
            deadline,
            progress,
        )?,
        true => images::Images::default(),
    };
    clock.lap("images");
    let no_sides = Vec::new();
    if let (Represent::Portals { portals, .. } | Represent::Auto { portals, .. }, Some(rooms)) =
        (&options.represent, &mut rooms)
        && portals.images != BuiltImages::Ours
    {
        progress.stage("reference images, by side of a portal", rooms.sides.len() as u64);
        let made = references::construct_references(
            &mut images,
            &caster,
            &rooms.sides,
            portals.same_depth,
            &settings,
            options.colour,
            &scene_key,
            &writer,
            progress,
        )?;
        rooms.figures.references = Some(made);
        clock.lap("reference images");
    }
    let sides = rooms.as_ref().map_or(&no_sides, |r| &r.sides);

    progress.stage("LDI tree", 0);
    if built.is_none() {
        let depth = match options.represent {
            Represent::Tree { pitch_m, side } => Depth::Fine { pitch_m, side },
            _ => Depth::Base,
        };
        built = tree_input.tree(depth, &writer, &heard)?;
    }
    let (tree, tree_figures) = match built {
        Some(BuiltTree { tree, chunks: of_tree, figures }) => {
            chunks.extend(of_tree);
            (Some(tree), Some(figures))
        }
        None => (None, None),
    };
    clock.lap("tree");

    progress.stage("writing", 0);
    let first_image_chunk = chunks.len() as u32;
    let Indexed { placements, images: image_entries, plans, sides } =
        images.indexed(&plan.plans, sides, first_image_chunk);
    let cameras: Vec<LdiCamera> = plans.into_iter().map(planned_camera).collect();
    let mut notes = scene.notes.clone();
    notes.extend(
        plan.statistics.nothing_to_do.iter().map(|why| Note { what: "grid and images".into(), why: why.clone() }),
    );
    notes.extend(images.notes(&plan.plans));
    notes.extend(weighing.iter().map(Weighing::note));
    notes.extend(room_weighing.iter().map(RoomWeighing::note));
    notes.extend(no_rooms.map(rooms::without));
    notes.extend(rooms.iter().map(|r| r.figures.grid.note()));
    let entries = chunks.iter().map(chunk_entry).chain(images.entries()).collect();
    let placement = plan.statistics.clone();
    let parts = (geometry.cells, textures.textures);
    let mut index = index_of(options, &scene, settings, plan, parts, entries, (placements, image_entries, tree));
    let room_figures = rooms.as_ref().map(|r| r.figures.clone());
    index.rooms = rooms.map(|r| r.index_with(sides));
    if let Some(volume) = &index.volume {
        progress.stage("floor plans", 0);
        let eye_height_m = index.settings.eye_height_m;
        index.plans = floor_plans::floor_plans(&scene, &clusters, &octree, volume, eye_height_m);
        clock.lap("floor plans");
    }
    let ranges = (0..octree.cells.len()).map(|c| octree.ranges(&scene, &clusters, c)).collect::<Vec<_>>();
    let counts: Vec<u64> = ranges.iter().map(|cell| cell.iter().map(|r| u64::from(r.count)).sum()).collect();
    let audit = placement::audit(&index, &counts, &|i| cameras.get(i as usize).copied(), AUDITED_POSES, 1);
    if audit.violations > 0 {
        tracing::error!(
            violations = audit.violations,
            "the audit found poses that break a promise; please report the scene"
        );
    }
    clock.lap("audit");
    let seconds = clock.laps;
    let octree_figures = BTreeMap::from([
        ("cells", octree.cells.len() as u64),
        ("depth", u64::from(octree.depth)),
        ("nodes", u64::from(octree.nodes)),
        ("largest_cell_triangles", u64::from(octree.largest_cell())),
        ("clusters", clusters.clusters.len() as u64),
        ("shared_clusters", geometry.shared_clusters as u64),
    ]);
    let mut image_bytes = images.reader();
    let bytes = |writer: &DatasetWriter, number: u32| match chunks.get(number as usize) {
        Some(chunk) => Ok(Cow::Borrowed(&*chunk.bytes)),
        None => image_bytes(writer, number as usize - chunks.len()).map(Cow::Owned).ok_or(StoreError::Chunk { number }),
    };
    let figures = BuildFigures {
        index,
        octree: octree_figures,
        walk,
        placement,
        audit,
        images: images.figures.clone(),
        forecast,
        tree: tree_figures,
        weighing,
        room_weighing,
        rooms: room_figures,
        budget,
        notes,
        seconds,
    };
    let mut report = serde_json::Value::Null;
    let is_whole = figures.images.unmade == 0;
    let written =
        writer.with_elements(scene.elements.clone()).finish(&figures.index, bytes, &ranges, is_whole, |written| {
            report = report_json(&figures, written);
            report.clone()
        })?;
    Ok(Built { written, report, budget: figures.budget, of_scene: scene.notes.len() })
}

/// The scene's name as reports show it: names of files without their folders, which are nobody's
/// business.
fn display_name(specs: &[String]) -> String {
    specs.iter().map(|s| display_name_of(s)).collect::<Vec<_>>().join(" + ")
}

fn display_name_of(spec: &str) -> String {
    if spec.starts_with("builtin:") {
        return spec.to_string();
    }
    let path = scene::FileSpec::parse(spec).map_or_else(|_| spec.to_owned(), |s| s.path);
    std::path::Path::new(&path).file_name().map_or_else(|| path.clone(), |n| n.to_string_lossy().into_owned())
}

#[derive(Debug)]
struct Clock {
    start: Instant,
    last: Instant,
    laps: Vec<(&'static str, f64)>,
}

impl Default for Clock {
    fn default() -> Self {
        let now = Instant::now();
        Self { start: now, last: now, laps: Vec::new() }
    }
}

impl Clock {
    fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        self.laps.push((stage, (now - self.last).as_secs_f64()));
        self.last = now;
    }
}
