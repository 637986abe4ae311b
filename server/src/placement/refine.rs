//! Coverage, evaluation and subdivision in turns, until every grid point in use has a solution
//! (row A4).
//!
//! In: the walk volume, the cells, the settings. Out: the points that `select` can return, each
//! with its images. Adding points only takes users away from others, so a point that was solved
//! once is not looked at again until the end. Then all points are solved for the users they are
//! left with. Few fail then, as the middle of fewer users lies elsewhere and sees the cells
//! elsewhere: they are subdivided too.

use super::{
    PlacementError,
    bands::{Directions, YAW_BIN_DEG, YAW_BINS},
    coverage::{Coverage, PointUses},
    eye_tree::EyeTree,
    groups::group,
    hull::EyeHull,
    lattice::Lattice,
    model::{PlacementPlan, PlacementStatistics},
    near_box::{Member, enough, feasible, fit, needed},
    nearest::nearest,
    plan::{plan, plan_box},
    point::{Context, Scheme, Solution, TooNear, solve},
};
use glam::DVec3;
use ldi_protocol::Aabb;
use rayon::prelude::*;
use std::time::Instant;

/// Per pitch band: where a range starts, degrees, and its image.
pub(super) type Lists = Vec<Vec<(f64, Option<u32>)>>;

/// A grid of which every point in use has a solution.
pub(super) struct Refined {
    /// Points in use, in lattice order.
    pub points: Vec<RefinedPoint>,
    /// Placements.
    pub plans: Vec<PlacementPlan>,
    /// Per placement, triangles left where it was solved.
    pub left: Vec<u64>,
    /// Largest number of triangles left in any direction.
    pub max_triangles: u64,
    /// The view cells of each placement; none with the paper's grid.
    pub groups: Vec<Vec<Member>>,
    /// Places whose eyes no image can serve within the budget: they belong to no point.
    pub beyond: Vec<Beyond>,
}

/// A place whose eyes no image can serve within the budget.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beyond {
    /// Around its eyes.
    pub eyes: Aabb,
    pub too_near: TooNear,
}

/// A grid point in use.
pub(super) struct RefinedPoint {
    pub position: DVec3,
    pub level: u8,
    pub radius: f64,
    pub bands: Lists,
}

/// Blocks of the volume that the certificate treats as one, metres: about half a typical grid
/// spacing of a building.
const BLOCK_M: f64 = 4.0;

/// Refines `lattice` until every point in use is solved; `heard` is told of every round.
pub(super) fn refine(
    ctx: &Context,
    tree: &EyeTree,
    directions: &Directions,
    mut lattice: Lattice,
    statistics: &mut PlacementStatistics,
    heard: &dyn Fn(&str),
) -> Result<Refined, PlacementError> {
    if let (Scheme::Cells, Some(most)) = (ctx.scheme, hardest_eye(ctx, tree)) {
        return Err(infeasible(ctx, most));
    }
    let mut beyond: Vec<Beyond> = Vec::new();
    // By point: whether its eyes are among them.
    let mut given_up: Vec<bool> = Vec::new();
    let mut cover = Cover::new(ctx, tree, directions);
    let mut solved: Vec<bool> = Vec::new();
    loop {
        statistics.rounds += 1;
        let positions: Vec<DVec3> = (0..lattice.points.len()).map(|i| lattice.position(i)).collect();
        let (uses, boxes) = timed(statistics, "coverage", || cover.certify(&positions))?;
        solved.resize(positions.len(), false);
        given_up.resize(positions.len(), false);
        let open: Vec<usize> = (0..positions.len()).filter(|i| !solved[*i] && !uses[*i].units.is_empty()).collect();
        let evaluate = |i: &usize| match ctx.scheme {
            Scheme::Paper => solve(ctx, positions[*i], &uses[*i]).map(|_| ()).map_err(Some),
            Scheme::Cells => {
                let member = Member::new(ctx, uses[*i].units[0].1, false);
                let extra_m = member.eyes.size().max_element() * 0.5 * (SHARED_REACH - 1.0);
                // Below this spacing sharing is given up before the budget is.
                let shared = lattice.spacing_of(lattice.points[*i].level) > FINEST_SHARED_M;
                match shared {
                    true => feasible(ctx, &member, extra_m, ctx.budget).map_err(Some)?,
                    // It may be the last word on this place.
                    false => enough(ctx, &member, ctx.budget).map_or(Ok(()), |too_near| Err(Some(too_near)))?,
                }
                if shared && worth_subdividing(ctx, &member) { Err(None) } else { Ok(()) }
            }
        };
        // Err(None): within the budget, but dearer than its parts.
        let results: Vec<Result<(), Option<TooNear>>> =
            timed(statistics, "evaluate", || open.par_iter().with_max_len(4).map(evaluate).collect());
        let mut failed: Vec<(usize, Option<TooNear>)> = Vec::new();
        for (i, result) in open.iter().zip(&results) {
            match result {
                Ok(_) => solved[*i] = true,
                Err(too_near) => failed.push((*i, *too_near)),
            }
        }
        tracing::debug!(
            round = statistics.rounds,
            points = positions.len(),
            evaluated = open.len(),
            failed = failed.len(),
            boxes,
            seconds = ?statistics.seconds,
            "grid refinement"
        );
        heard(&format!("round {}: {} cells, {} to subdivide", statistics.rounds, positions.len(), failed.len()));
        let eyes: Vec<Option<Aabb>> = uses.iter().map(|u| u.units.first().map(|u| u.1.bounds())).collect();
        if failed.is_empty() {
            let uses = uses.into_iter().enumerate().filter(|(i, _)| !given_up[*i]).collect();
            match finish(ctx, &lattice, uses, statistics) {
                Ok(refined) => {
                    statistics.certified_boxes = boxes;
                    statistics.coverage_certified = true;
                    return Ok(Refined { beyond, ..refined });
                }
                Err(again) => failed = again.into_iter().map(|(i, e)| (i, Some(e))).collect(),
            }
        }
        let given_up_before = beyond.len();
        let levels: Vec<u8> = lattice.points.iter().map(|p| p.level).collect();
        for (i, too_near) in failed {
            let level = levels[i];
            // A neighbour's subdivision has refined the surroundings of this one already: see
            // first whether that is enough.
            if lattice.points[i].level > level {
                continue;
            }
            let spacing_m = lattice.spacing_of(level);
            let (graded, most) = match (ctx.scheme, &too_near) {
                (Scheme::Paper, _) => (true, MOST_GRID_POINTS),
                (Scheme::Cells, Some(_)) => (false, MOST_VIEW_CELLS),
                (Scheme::Cells, None) => (false, MOST_DEAR_CELLS),
            };
            // Near what is dense, parts of a small cell fail as it did.
            let hopeless = || {
                ctx.scheme == Scheme::Cells && spacing_m < COARSEST_HOPELESS_M && {
                    let eye = tree.closest(lattice.position(i));
                    eye.is_some_and(|eye| needed_at(ctx, eye).is_some())
                }
            };
            let too_fine = spacing_m < FINEST_SPACING_M || lattice.points.len() > most;
            if too_fine || too_near.is_some() && hopeless() || !lattice.subdivide(i as u32, graded) {
                match (too_near, eyes[i]) {
                    (Some(too_near), _) if ctx.scheme == Scheme::Paper => {
                        return Err(infeasible(ctx, (lattice.position(i), too_near)));
                    }
                    (Some(too_near), Some(eyes)) => {
                        beyond.push(Beyond { eyes, too_near });
                        given_up[i] = true;
                    }
                    _ => {}
                }
                solved[i] = true;
            }
        }
        let most = beyond.iter().rev().max_by_key(|b| b.too_near.needed);
        if let Some(most) = most.filter(|_| beyond.len() > given_up_before && lost_share(tree, &beyond) > MOST_LOST) {
            return Err(infeasible(ctx, (most.eyes.centre(), most.too_near)));
        }
    }
}

/// More than this share of the walk volume is not given up: the budget does not suit the scene.
const MOST_LOST: f64 = 0.25;

/// The share of the walk volume's floor where eyes lie in `beyond`.
fn lost_share(tree: &EyeTree, beyond: &[Beyond]) -> f64 {
    let area = |boxes: Vec<Aabb>| boxes.iter().map(|b| b.size().x * b.size().z).sum::<f64>();
    let lost = area(tree.leaves_touching(|b| beyond.iter().any(|o| o.eyes.intersects(b))));
    lost / area(tree.leaves_touching(|_| true)).max(f64::MIN_POSITIVE)
}

/// Who may use which point, by either scheme.
enum Cover<'a> {
    Paper(Coverage<'a>),
    Cells { tree: &'a EyeTree, units: u16 },
}

impl<'a> Cover<'a> {
    fn new(ctx: &Context, tree: &'a EyeTree, directions: &'a Directions) -> Self {
        match ctx.scheme {
            Scheme::Cells => Self::Cells { tree, units: directions.units() as u16 },
            Scheme::Paper => {
                // Few blocks for huge scenes: a block costs time even where one grid point serves
                // it all.
                let extent = tree.nodes.first().map_or(0.0, |n| n.bounds.size().max_element());
                Self::Paper(Coverage::new(tree, directions, ctx.half_tan, BLOCK_M.max(extent / 64.0)))
            }
        }
    }

    /// Users per point, and the number of boxes in the certificate.
    fn certify(&mut self, positions: &[DVec3]) -> Result<(Vec<PointUses>, u64), PlacementError> {
        match self {
            Self::Paper(coverage) => {
                let uses = coverage.certify(positions).map_err(|gap| PlacementError::Uncovered {
                    position: gap.position,
                    yaw_deg: gap.direction_deg[0],
                    pitch_deg: gap.direction_deg[1],
                })?;
                Ok((uses, coverage.boxes()))
            }
            Self::Cells { tree, units } => {
                let (regions, boxes) = nearest(tree, positions);
                let uses = |(hull, radius): (EyeHull, f64)| PointUses {
                    units: if hull.is_empty() { vec![] } else { (0..*units).map(|u| (u, hull)).collect() },
                    radius,
                };
                Ok((regions.into_iter().map(uses).collect(), boxes))
            }
        }
    }
}

/// View cells are made so small that a box could serve eyes this many times as far out: boxes are
/// shared by several. On the clinic at a tenth of its triangles 1, 1.5 and 2.5 gave 281, 301 and
/// 786 cells and images of 2.1, 1.8 and 2.2 thousand million pixels.
const SHARED_REACH: f64 = 1.5;

/// Cells of this spacing and below need not be small enough for sharing, metres: their number
/// would outgrow the images saved.
const FINEST_SHARED_M: f64 = 1.3;

/// Cells of this spacing and above are subdivided even where an eye amid them sees too much,
/// metres: eyes that far apart may see less. Larger: more of the walk volume is given up; smaller:
/// dense places take longer to plan.
const COARSEST_HOPELESS_M: f64 = 0.65;

/// A view cell whose own box is expected to hold more samples than this is subdivided if boxes for
/// its halves or quarters hold fewer together. Less takes 2 to 17 times as long to plan for at
/// most 3% fewer pixels of west_riverside_mep at a fiftieth
/// (docs/adr/0017-groups-halved-then-joined.md).
const DEAR_SAMPLES: f64 = 8_000_000.0;
/// They must hold less than this share: a grid of more view cells takes longer to plan. By
/// judgement.
const WORTH_SUBDIVIDING: f64 = 0.8;

/// Whether a view cell's box is dear, and boxes for its parts are cheaper.
fn worth_subdividing(ctx: &Context, member: &Member) -> bool {
    let costs = |members: &[&Member]| fit(ctx, members).map_or(f64::INFINITY, |near| near.cost);
    let whole = costs(&[member]);
    if whole <= DEAR_SAMPLES {
        return false;
    }
    let Aabb { min, max } = member.eyes;
    let middle = member.eyes.centre();
    let quarters: Vec<Member> = (0..4)
        .map(|k| {
            let within =
                |axis: usize, upper: bool| if upper { (middle[axis], max[axis]) } else { (min[axis], middle[axis]) };
            let ((x0, x1), (z0, z1)) = (within(0, k & 1 != 0), within(2, k & 2 != 0));
            let mut hull = EyeHull::EMPTY;
            hull.add(&Aabb { min: DVec3::new(x0, min.y, z0), max: DVec3::new(x1, max.y, z1) });
            Member::new(ctx, hull, false)
        })
        .collect();
    let of = |parts: &[&[usize]]| {
        let part = |p: &&[usize]| costs(&p.iter().map(|k| &quarters[*k]).collect::<Vec<_>>());
        parts.iter().map(part).sum::<f64>()
    };
    let best = of(&[&[0, 1], &[2, 3]]).min(of(&[&[0, 2], &[1, 3]])).min(of(&[&[0], &[1], &[2], &[3]]));
    best < whole * WORTH_SUBDIVIDING
}

/// More view cells than this are given up, unused points included: some ten times what any plan
/// that ended took (2,070).
const MOST_VIEW_CELLS: usize = 20_000;

/// The same for the paper's grid, whose neighbour rule makes hundreds of unused points for one in
/// use.
const MOST_GRID_POINTS: usize = 4_000_000;

/// With more view cells than this none is subdivided for its samples: the rest is for those that
/// exceed the budget, which end the build if they cannot be.
const MOST_DEAR_CELLS: usize = MOST_VIEW_CELLS / 4;

/// Points closer than this bring nothing: eyes themselves keep 5 cm from surfaces.
const FINEST_SPACING_M: f64 = 0.1;

/// Solves all points in use for the users they are left with. Err: the points that cannot be, by
/// their number in the lattice.
fn finish(
    ctx: &Context,
    lattice: &Lattice,
    uses: Vec<(usize, PointUses)>,
    statistics: &mut PlacementStatistics,
) -> Result<Refined, Vec<(usize, TooNear)>> {
    let mut used: Vec<(usize, PointUses)> = uses.into_iter().filter(|(_, u)| !u.units.is_empty()).collect();
    used.sort_by_key(|(i, _)| lattice.points[*i].place.to_array());
    let unused = (lattice.points.len() - used.len()) as u64;
    statistics.skipped.insert("no eye of the walk volume can select the point".into(), unused);
    let Solved { plans, left, lists, max_triangles, groups } = timed(statistics, "solve", || match ctx.scheme {
        Scheme::Paper => solve_points(ctx, lattice, &used),
        Scheme::Cells => solve_groups(ctx, &used),
    })?;
    let points = used
        .into_iter()
        .zip(lists)
        .map(|((i, uses), bands)| RefinedPoint {
            position: lattice.position(i),
            level: lattice.points[i].level,
            radius: uses.radius,
            bands,
        })
        .collect();
    Ok(Refined { points, plans, left, max_triangles, groups, beyond: Vec::new() })
}

/// All points solved.
#[derive(Default)]
struct Solved {
    plans: Vec<PlacementPlan>,
    left: Vec<u64>,
    /// Per point.
    lists: Vec<Lists>,
    max_triangles: u64,
    groups: Vec<Vec<Member>>,
}

/// The error for a place that cannot be served.
fn infeasible(ctx: &Context, (position, too_near): (DVec3, TooNear)) -> PlacementError {
    PlacementError::Infeasible {
        budget: ctx.budget,
        needed: too_near.needed,
        position,
        yaw_deg: too_near.direction_deg[0],
        pitch_deg: too_near.direction_deg[1],
    }
}

/// Eyes that are asked before any grid is made whether the budget can be met: enough for budgets
/// that are wrong by a factor of ten, in a second.
const PROBES: usize = 64;
/// They stand in boxes of eyes of about this size, metres.
const PROBED_M: f64 = 1.0;

/// A quick proof that the budget suits few places: of some eyes, spread over all, the one with the
/// most triangles too near for an image that serves it alone, if more than [`MOST_LOST`] of them
/// have more than the budget. A view cell that holds the eye needs as many or more.
fn hardest_eye(ctx: &Context, tree: &EyeTree) -> Option<(DVec3, TooNear)> {
    let blocks = tree.blocks(PROBED_M);
    let every = blocks.len().div_ceil(PROBES).max(1);
    let probes: Vec<u32> = blocks.into_iter().step_by(every).collect();
    let needs = |block: &u32| {
        let eye = tree.closest(tree.nodes[*block as usize].bounds.centre())?;
        Some((eye, needed_at(ctx, eye)?))
    };
    let found: Vec<(DVec3, TooNear)> = probes.par_iter().filter_map(needs).collect();
    if found.len() as f64 <= probes.len() as f64 * MOST_LOST {
        return None;
    }
    found.into_iter().rev().max_by_key(|f| f.1.needed)
}

/// The smallest budget that an image for a single eye could keep; None if the budget is as large.
fn needed_at(ctx: &Context, eye: DVec3) -> Option<TooNear> {
    let mut hull = EyeHull::EMPTY;
    hull.add(&Aabb { min: eye, max: eye });
    needed(ctx, &Member::new(ctx, hull, false))
}

/// Solves every point for itself.
fn solve_points(
    ctx: &Context,
    lattice: &Lattice,
    used: &[(usize, PointUses)],
) -> Result<Solved, Vec<(usize, TooNear)>> {
    let solutions: Vec<Result<Solution, TooNear>> =
        used.par_iter().map(|(i, u)| solve(ctx, lattice.position(*i), u)).collect();
    let failed = used.iter().zip(&solutions).filter_map(|((i, _), s)| Some((*i, *s.as_ref().err()?)));
    let failed: Vec<(usize, TooNear)> = failed.collect();
    if !failed.is_empty() {
        return Err(failed);
    }
    let mut out = Solved::default();
    for (point, s) in solutions.into_iter().flatten().enumerate() {
        let first = out.plans.len() as u32;
        let position = lattice.position(used[point].0);
        out.left.extend(s.images.iter().map(|i| i.left));
        out.plans.extend(s.images.iter().map(|i| plan(ctx, i, point as u32, position)));
        let renumber =
            |list: Vec<(f64, Option<u32>)>| list.into_iter().map(|(yaw, i)| (yaw, i.map(|k| first + k))).collect();
        out.lists.push(s.bands.into_iter().map(renumber).collect());
        out.max_triangles = out.max_triangles.max(s.max_triangles);
    }
    Ok(out)
}

/// Solves view cells in groups.
fn solve_groups(ctx: &Context, used: &[(usize, PointUses)]) -> Result<Solved, Vec<(usize, TooNear)>> {
    let members: Vec<Member> = used.par_iter().map(|(_, u)| Member::new(ctx, u.units[0].1, true)).collect();
    let groups = group(ctx, &members).map_err(|(member, e)| vec![(used[member as usize].0, e)])?;
    let mut out = Solved::default();
    let mut placement_of: Vec<Option<u32>> = vec![None; used.len()];
    for (number, (of, near)) in (0u32..).zip(&groups) {
        of.iter().for_each(|m| placement_of[*m as usize] = Some(number));
        out.left.push(near.max_triangles);
    }
    out.plans = groups
        .par_iter()
        .map(|(of, near)| {
            let users: Vec<&Member> = of.iter().map(|m| &members[*m as usize]).collect();
            plan_box(ctx, near, &users, of[0])
        })
        .collect();
    let uncut = members.iter().map(|m| m.largest).max().unwrap_or(0);
    out.max_triangles = out.left.iter().copied().max().unwrap_or(0).max(uncut);
    let lists_of = |(m, placement): (&Member, &Option<u32>)| {
        lists(ctx.directions.bands(), |unit| placement.filter(|_| m.units.binary_search(&unit).is_ok()))
    };
    out.lists = members.iter().zip(&placement_of).map(lists_of).collect();
    out.groups = groups.iter().map(|(of, _)| of.iter().map(|m| members[*m as usize].clone()).collect()).collect();
    Ok(out)
}

/// Yaw-bin lists of a point: where each list entry starts, and its placement; neighbours that
/// agree are joined.
fn lists(bands: usize, placement_of: impl Fn(u16) -> Option<u32>) -> Lists {
    let mut out: Lists = Vec::with_capacity(bands);
    for band in 0..bands {
        let mut list: Vec<(f64, Option<u32>)> = Vec::new();
        for bin in 0..YAW_BINS {
            let placement = placement_of((band * YAW_BINS + bin) as u16);
            if list.last().is_none_or(|l| l.1 != placement) {
                list.push((bin as f64 * YAW_BIN_DEG, placement));
            }
        }
        if list.iter().all(|l| l.1.is_none()) {
            list.clear();
        }
        out.push(list);
    }
    if out.iter().all(Vec::is_empty) {
        out.clear();
    }
    out
}

/// Runs a step and adds its seconds to the statistics.
pub(super) fn timed<T>(statistics: &mut PlacementStatistics, step: &str, f: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let out = f();
    *statistics.seconds.entry(step.to_string()).or_default() += start.elapsed().as_secs_f64();
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::levels::Levels;
    use crate::octree::{Clusters, Octree};
    use crate::placement::{
        CostBenefit, Parameters, PlacementError,
        cells::Cells,
        plan_placements,
        test_scenes::{NOTHING_BETWEEN, settings, strewn, walked},
    };
    use ldi_protocol::{index::BuildSettings, volume::WalkVolume};

    #[test]
    fn view_cells_whose_box_is_dear_are_subdivided() {
        let (bounds, triangles) = strewn(1500, 33);
        let model = bounds.iter().fold(Aabb::EMPTY, |all, b| all.union(*b));
        let (cells, directions) = (Cells::new(bounds, triangles), Directions::new(60.0));
        let runs: Vec<Vec<[u16; 2]>> = (0..48 * 48).map(|_| vec![[11, 20]]).collect();
        let cut = Aabb { min: DVec3::new(-24.0, 0.0, -24.0), max: DVec3::new(24.0, 3.0, 24.0) };
        let volume = WalkVolume::new(DVec3::new(-24.0, 0.0, -24.0), 1.0, 0.1, [48, 48], &runs, &cut).expect("a volume");
        let tree = EyeTree::new(&volume);
        let settings = BuildSettings { density: 3.0, ..settings(12_000) };
        let mut ctx = Context::new(&cells, &directions, &settings, 60.0, CostBenefit::default(), NOTHING_BETWEEN);
        ctx.eyes = Some(&tree);
        let mut statistics = PlacementStatistics::default();
        let refined = refine(&ctx, &tree, &directions, Lattice::new(&model, 30.0), &mut statistics, &|_| ());
        let members: Vec<Member> = refined.expect("feasible").groups.into_iter().flatten().collect();
        let samples = members.iter().map(|m| fit(&ctx, &[m]).map_or(f64::INFINITY, |near| near.cost)).sum::<f64>();
        // 848 million where only the budget subdivides.
        assert!(samples < 400e6, "{samples} samples to expect of {} view cells", members.len());
    }

    #[test]
    fn points_that_fail_with_fewer_users_are_subdivided() {
        // In this church the last round leaves points whose remaining users see cells outside of
        // the widest image.
        let scene = crate::scene::load("builtin:church?triangles=20000").unwrap();
        let budget = 6_000;
        let settings = BuildSettings { pitch_deg: 0.0, grid: "paper".into(), ..settings(budget) };
        let clusters = Clusters::build(&scene);
        let octree = Octree::build(&scene, &clusters, budget);
        let eyes = (&Parameters::default(), walked(&scene, &clusters, &octree));
        let result =
            plan_placements(&scene, (&octree, &Levels::default()), &settings, eyes, NOTHING_BETWEEN, &|_| ()).unwrap();
        assert!(result.statistics.coverage_certified && !result.plans.is_empty());
        assert!(result.statistics.max_triangles <= budget);
    }

    #[test]
    fn budgets_far_too_small_are_refused_before_any_grid_is_made() {
        let scene = crate::scene::load("builtin:church?triangles=20000").unwrap();
        let refused = |budget: u64| {
            let clusters = Clusters::build(&scene);
            let octree = Octree::build(&scene, &clusters, 1_000);
            let settings = settings(budget);
            let no_grid = |what: &str| panic!("{what}");
            let eyes = (&Parameters::default(), walked(&scene, &clusters, &octree));
            match plan_placements(&scene, (&octree, &Levels::default()), &settings, eyes, NOTHING_BETWEEN, &no_grid) {
                Err(PlacementError::Infeasible { budget: given, needed, .. }) => {
                    assert!(given == budget && needed > budget, "{needed} for {budget}");
                    needed
                }
                other => panic!("{other:?}"),
            }
        };
        // The least that would do does not depend on how far the budget is off.
        assert_eq!(refused(10), refused(20));
    }

    #[test]
    fn a_budget_that_cannot_be_met_anywhere_is_refused_with_one_that_is_nearer() {
        let (bounds, triangles) = strewn(4000, 33);
        let model = bounds.iter().fold(Aabb::EMPTY, |all, b| all.union(*b));
        let (cells, directions) = (Cells::new(bounds, triangles), Directions::new(0.0));
        let runs = [vec![[11, 20]]];
        let cut = Aabb { min: DVec3::new(-0.5, 0.0, -0.5), max: DVec3::new(0.5, 3.0, 0.5) };
        let volume = WalkVolume::new(cut.min, 1.0, 0.1, [1, 1], &runs, &cut).expect("a volume");
        let mut budget = 10;
        while let Err(refused) = refined(&cells, &directions, &volume, &model, budget) {
            let PlacementError::Infeasible { needed, .. } = refused else { panic!("{refused}") };
            assert!(needed > budget, "{needed} for {budget}");
            budget = needed;
        }
        assert!(budget > 10);
    }

    /// A grid for a volume.
    fn refined(
        cells: &Cells,
        directions: &Directions,
        volume: &WalkVolume,
        model: &Aabb,
        budget: u64,
    ) -> Result<Refined, PlacementError> {
        let (tree, settings) = (EyeTree::new(volume), settings(budget));
        let mut ctx = Context::new(cells, directions, &settings, 60.0, CostBenefit::default(), NOTHING_BETWEEN);
        ctx.eyes = Some(&tree);
        refine(&ctx, &tree, directions, Lattice::new(model, 30.0), &mut PlacementStatistics::default(), &|_| ())
    }

    #[test]
    fn eyes_beside_what_is_too_dense_for_the_budget_are_given_up_and_no_others() {
        // Eyes are within the boxes of 400 cells in the middle of a yard of 24 m; as many are all
        // over it.
        let spread = |n: usize, side: f64, size: f64| {
            (0..n * n).map(move |i| {
                let at = |k: usize| (k as f64 / (n - 1) as f64 - 0.5) * side;
                let middle = DVec3::new(at(i % n), 1.0 + 0.8 * ((i * 7) % n) as f64 / n as f64, at(i / n));
                Aabb { min: middle - DVec3::splat(size), max: middle + DVec3::splat(size) }
            })
        };
        let bounds: Vec<Aabb> = spread(20, 0.5, 0.4).chain(spread(20, 24.0, 0.2)).collect();
        let model = bounds.iter().fold(Aabb::EMPTY, |all, b| all.union(*b));
        let (triangles, directions) = (vec![100; bounds.len()], Directions::new(30.0));
        let cells = Cells::new(bounds, triangles);
        let cut = Aabb { min: DVec3::new(-12.0, 0.0, -12.0), max: DVec3::new(12.0, 3.0, 12.0) };
        let runs: Vec<Vec<[u16; 2]>> = (0..48 * 48).map(|_| vec![[15, 17]]).collect();
        let volume = WalkVolume::new(cut.min, 0.5, 0.1, [48, 48], &runs, &cut).expect("a volume");
        let beyond = |budget: u64| refined(&cells, &directions, &volume, &model, budget).expect("some places").beyond;
        let given_up = beyond(20_000);
        assert!(!given_up.is_empty());
        for place in &given_up {
            assert!(place.too_near.needed > 20_000);
            assert!(place.eyes.centre().with_y(0.0).length() < 4.0, "{:?}", place.eyes);
        }
        assert!(beyond(80_000).is_empty());
    }
}
