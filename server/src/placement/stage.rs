//! The stage's door: checks the settings, runs the steps, gathers the statistics.

use super::{
    PlacementError, PlacementResult, PlacementStatistics,
    bands::Directions,
    cells::Cells,
    eye_tree::EyeTree,
    groups::{self, Groupings},
    lattice::Lattice,
    near_box::{Fit, Member},
    point::{Context, Sees},
    refine::{Refined, refine, timed},
    search::{Found, Search, search},
    subset::CostBenefit,
};
use crate::{levels::Levels, octree::Octree, scene::Scene};
use ldi_protocol::{
    Aabb,
    index::{AngularRange, BuildSettings, GridPoint},
    volume::WalkVolume,
};
use rayon::prelude::*;

/// Smallest field of view: below it the paper's star-shapes do not hold and the inflated grid need
/// not cover all eyes.
const SMALLEST_FOV_DEG: f64 = 54.0;

/// Choices beyond the build's settings.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Parameters {
    /// Constants of the cost-benefit function.
    pub cost_benefit: CostBenefit,
    /// Spacing of the level-0 grid, metres; None: half the model's longest axis, the paper's 3 x 3
    /// x 3.
    pub spacing_m: Option<f64>,
}

/// Plans all images of a scene.
///
/// The scene's bounds must be finite; cells come from its octree, eyes are in `volume`.
/// Deterministic: the same input gives the same result whatever the number of threads. `sees` is
/// asked about storeys; `heard` is told, in a few words, how far it is.
///
/// # Errors
/// Settings out of range, or a budget that no image can meet somewhere.
pub fn plan_placements(
    scene: &Scene,
    (octree, levels): (&Octree, &Levels),
    settings: &BuildSettings,
    (parameters, volume): (&Parameters, WalkVolume),
    sees: Sees<'_>,
    heard: &dyn Fn(&str),
) -> Result<PlacementResult, PlacementError> {
    check_settings(settings)?;
    let (total, mut statistics) = (triangles(octree), PlacementStatistics::default());
    if total <= settings.budget {
        statistics.nothing_to_do = Some(format!(
            "the whole scene has {total} triangles, within the budget of {} from everywhere",
            settings.budget
        ));
        statistics.coverage_certified = true;
        statistics.max_triangles = total;
        return Ok(PlacementResult {
            points: vec![],
            plans: vec![],
            pitch_bands_deg: vec![],
            volume,
            beyond_budget: vec![],
            statistics,
        });
    }
    refined(
        scene,
        (octree, levels),
        settings,
        (parameters, sees),
        &volume,
        (&mut statistics, heard),
        |ctx, refined, statistics| result(ctx, refined, volume.clone(), statistics),
    )
}

/// A group of view cells of a plan, and what the ways to search for its box found.
#[derive(Debug, Clone, serde::Serialize)]
pub struct SearchCase {
    /// View cells.
    pub members: usize,
    /// In the order of the ways that were asked for: what each found, and seconds.
    pub found: Vec<(Search, Found, f64)>,
}

/// How to compare ways to search.
#[derive(Debug, Clone)]
pub struct SearchComparison<'a> {
    /// The ways.
    pub searches: &'a [Search],
    /// Most groups, those of the fewest view cells first.
    pub cases: usize,
    /// A step of a search is so many of a plan's.
    pub steps: u32,
    /// Most boxes that a search may try.
    pub most: usize,
    /// View cells, close to each other, of which all partitions into groups are tried.
    pub together: usize,
}

/// Searches for the boxes of a plan's groups in several ways, and groups some of its view cells in
/// several ways.
///
/// # Errors
/// As [`plan_placements`]. A scene within its budget has no groups.
pub fn compare_searches(
    scene: &Scene,
    (octree, levels): (&Octree, &Levels),
    settings: &BuildSettings,
    volume: &WalkVolume,
    sees: Sees<'_>,
    comparison: &SearchComparison,
) -> Result<(Vec<SearchCase>, Vec<Groupings>), PlacementError> {
    let parameters = Parameters::default();
    check_settings(settings)?;
    let mut statistics = PlacementStatistics::default();
    if triangles(octree) <= settings.budget {
        return Ok(Default::default());
    }
    refined(
        scene,
        (octree, levels),
        settings,
        (&parameters, sees),
        volume,
        (&mut statistics, &|_| ()),
        |ctx, refined, _| {
            let mut groups = refined.groups;
            let members: Vec<&Member> = groups.iter().flatten().filter(|m| !m.units.is_empty()).collect();
            // The neighbours of view cells that are spread over the plan.
            let middle = |m: &Member| m.eyes.centre();
            let every = members.len().div_ceil(comparison.cases.max(1)).max(1);
            let around = |first: &&Member| {
                let mut near = members.clone();
                near.sort_by(|a, b| {
                    let distance = |m: &Member| middle(m).distance_squared(middle(first));
                    distance(a).total_cmp(&distance(b))
                });
                groups::compare(ctx, &near.into_iter().take(comparison.together).cloned().collect::<Vec<_>>())
            };
            let groupings = members.iter().step_by(every).filter_map(around).collect();
            groups.sort_by_key(Vec::len);
            groups.truncate(comparison.cases);
            let case = |group: &Vec<Member>| {
                let members: Vec<&Member> = group.iter().collect();
                let fit = Fit::new(ctx, &members, 0.0);
                let one = |by: &Search| {
                    let start = std::time::Instant::now();
                    search(&fit, *by, comparison.steps, comparison.most)
                        .map(|f| (*by, f, start.elapsed().as_secs_f64()))
                };
                SearchCase { members: group.len(), found: comparison.searches.iter().filter_map(one).collect() }
            };
            (groups.par_iter().with_max_len(1).map(case).collect(), groupings)
        },
    )
}

/// Triangles of all cells.
fn triangles(octree: &Octree) -> u64 {
    octree.cells.iter().map(|c| u64::from(c.triangles)).sum()
}

/// Refines the grid of a scene that exceeds its budget, and hands it on.
fn refined<T>(
    scene: &Scene,
    (octree, levels): (&Octree, &Levels),
    settings: &BuildSettings,
    (parameters, sees): (&Parameters, Sees<'_>),
    volume: &WalkVolume,
    (statistics, heard): (&mut PlacementStatistics, &dyn Fn(&str)),
    then: impl FnOnce(&Context, Refined, PlacementStatistics) -> T,
) -> Result<T, PlacementError> {
    let cells = Cells::of_octree(octree, levels, settings.deviation_per_metre());
    let directions = Directions::new(settings.pitch_deg);
    let tree = timed(statistics, "walk volume", || EyeTree::new(volume));
    let bounds = scene.bounds();
    let (longest, constants) = (bounds.size().max_element(), parameters.cost_benefit);
    let mut ctx = Context::new(&cells, &directions, settings, longest, constants, sees);
    ctx.eyes = Some(&tree);
    // The grid spans the model and every eye: walkers on a roof stand above the model's box.
    let model = bounds.union(*volume.bounds());
    let spacing_m = parameters.spacing_m.unwrap_or(model.size().max_element() * 0.5);
    let lattice = Lattice::new(&model, spacing_m);
    statistics.spacing_m = spacing_m;
    for level in 0..=super::lattice::DEEPEST {
        statistics.paper_radius_m.insert(level, lattice.paper_radius(level));
    }
    let refined = refine(&ctx, &tree, &directions, lattice, statistics, heard)?;
    Ok(then(&ctx, refined, std::mem::take(statistics)))
}

/// Refuses settings outside their ranges.
///
/// # Errors
/// [`PlacementError::FieldOfView`] and [`PlacementError::Setting`].
pub fn check_settings(s: &BuildSettings) -> Result<(), PlacementError> {
    if s.camera.fov_deg.is_nan() || !(SMALLEST_FOV_DEG..120.0).contains(&s.camera.fov_deg) {
        return Err(PlacementError::FieldOfView { fov_deg: s.camera.fov_deg });
    }
    let within = |name, value: f64, low: f64, high: f64, must| {
        if value >= low && value <= high { Ok(()) } else { Err(PlacementError::Setting { name, value, must }) }
    };
    within("pitch", s.pitch_deg, 0.0, 85.0, "between 0 and 85 degrees")?;
    within("max-footprint", s.max_footprint_px, 0.5, 64.0, "between 0.5 and 64 pixels")?;
    within("density", s.density, 0.25, 8.0, "between 0.25 and 8")?;
    within("eye-height", s.eye_height_m.unwrap_or(1.6), 0.6, 100.0, "between 0.6 and 100 metres")?;
    within("budget", s.budget as f64, 1.0, 1e15, "at least 1 triangle")
}

/// Points, plans and figures from the refined grid.
fn result(ctx: &Context, refined: Refined, volume: WalkVolume, mut statistics: PlacementStatistics) -> PlacementResult {
    let mut points = Vec::new();
    for p in &refined.points {
        let range = |&(yaw_start_deg, placement): &(f64, Option<u32>)| AngularRange { yaw_start_deg, placement };
        points.push(GridPoint {
            position: p.position,
            level: p.level,
            radius: p.radius,
            bands: p.bands.iter().map(|b| b.iter().map(range).collect()).collect(),
        });
        *statistics.by_level.entry(p.level).or_default() += 1;
        let paper = statistics.paper_radius_m.get(&p.level).copied().unwrap_or(f64::INFINITY);
        statistics.largest_radius_ratio = statistics.largest_radius_ratio.max(p.radius / paper);
    }
    statistics.max_triangles = refined.max_triangles;
    let mut closeness = vec![0u32; 21];
    for left in &refined.left {
        let off = left.abs_diff(ctx.optimize_budget) as f64 / ctx.optimize_budget.max(1) as f64;
        closeness[((off * 100.0) as usize).min(20)] += 1;
    }
    let deepest = statistics.by_level.keys().max().copied().unwrap_or(0);
    statistics.paper_radius_m.retain(|level, _| *level <= deepest);
    let solved: u32 = closeness.iter().sum();
    statistics.within_two_percent = f64::from(closeness[0] + closeness[1]) / f64::from(solved.max(1));
    statistics.popt_closeness = closeness;
    let plans = refined.plans;
    statistics.max_footprint_px = plans.iter().map(|p| p.footprint_px).fold(0.0, f64::max);
    let beyond_budget: Vec<Aabb> = refined.beyond.iter().map(|b| b.eyes).collect();
    let kept = without(&volume, &beyond_budget);
    if let Some(most) = refined.beyond.iter().rev().max_by_key(|b| b.too_near.needed) {
        statistics.beyond_budget_m2 = floor_m2(&volume) - floor_m2(&kept);
        statistics.beyond_budget_needs = most.too_near.needed;
        let ([x, y, z], needed) = (most.eyes.centre().to_array(), most.too_near.needed);
        tracing::warn!(
            "{:.0} m² of the walk volume, most near ({x:.2}, {y:.2}, {z:.2}), are left to coarse geometry, as up to {needed} triangles lie \
             too near there for images within the budget of {}; a --budget of {} serves all",
            statistics.beyond_budget_m2,
            ctx.budget,
            needed + needed / 2,
        );
    }
    if plans.is_empty() && beyond_budget.is_empty() {
        statistics.nothing_to_do = Some(format!(
            "geometry with its levels of detail stays within the budget of {} triangles from everywhere: {} at most",
            ctx.budget, statistics.max_triangles
        ));
    }
    let pitch_bands_deg = ctx.directions.bands_deg.clone();
    PlacementResult { points, plans, pitch_bands_deg, volume: kept, beyond_budget, statistics }
}

/// Floor of a walk volume, square metres.
fn floor_m2(volume: &WalkVolume) -> f64 {
    volume.boxes().map(|b| b.size().x * b.size().z).sum()
}

/// A walk volume without the boxes that touch one of `beyond`.
pub fn without(volume: &WalkVolume, beyond: &[Aabb]) -> WalkVolume {
    if beyond.is_empty() {
        return volume.clone();
    }
    let kept: Vec<bool> = volume.boxes().map(|b| !beyond.iter().any(|o| o.intersects(&b))).collect();
    volume.only(|number| kept[number])
}
