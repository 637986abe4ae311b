//! Coverage, evaluation and subdivision in turns, until every grid point in use has a solution (row A4).
//!
//! In: the walk volume, the cells, the settings. Out: the points that `select` can return, each with its images. Adding points only
//! takes users away from others, so a point that was solved once stays solvable; at the end all points are solved again for the
//! users they are left with.

use super::{
    PlacementError,
    bands::Directions,
    coverage::{Coverage, PointUses},
    eye_tree::EyeTree,
    hull::EyeHull,
    lattice::Lattice,
    model::PlacementStatistics,
    nearest::nearest,
    point::{Context, Image, Scheme, Solution, TooNear, solve},
    shared::{Member, RegionSolution, feasible, lists, solve_region},
};
use glam::DVec3;
use rayon::prelude::*;
use std::{collections::BTreeMap, time::Instant};

/// Per pitch band: where a range starts, degrees, and its image.
pub(super) type Lists = Vec<Vec<(f64, Option<u32>)>>;

/// A grid of which every point in use has a solution.
pub(super) struct Refined {
    /// Points in use, in lattice order.
    pub points: Vec<RefinedPoint>,
    /// Images, each with the point it was solved at.
    pub images: Vec<(u32, Image)>,
    /// Largest number of triangles left in any direction.
    pub max_triangles: u64,
}

/// A grid point in use.
pub(super) struct RefinedPoint {
    pub position: DVec3,
    pub level: u8,
    pub radius: f64,
    pub bands: Lists,
}

/// Blocks of the volume that the certificate treats as one, metres: about half a typical grid spacing of a building.
const BLOCK_M: f64 = 4.0;

/// Refines `lattice` until every point in use is solved.
pub(super) fn refine(
    ctx: &Context,
    tree: &EyeTree,
    directions: &Directions,
    mut lattice: Lattice,
    statistics: &mut PlacementStatistics,
) -> Result<Refined, PlacementError> {
    let mut cover = Cover::new(ctx, tree, directions);
    let mut solved: Vec<bool> = Vec::new();
    loop {
        statistics.rounds += 1;
        let positions: Vec<DVec3> = (0..lattice.points.len()).map(|i| lattice.position(i)).collect();
        let (uses, boxes) = timed(statistics, "coverage", || cover.certify(&positions))?;
        solved.resize(positions.len(), false);
        let open: Vec<usize> = (0..positions.len()).filter(|i| !solved[*i] && !uses[*i].units.is_empty()).collect();
        let evaluate = |i: &usize| match ctx.scheme {
            Scheme::Paper => solve(ctx, positions[*i], &uses[*i]).map(|_| ()),
            Scheme::Cells => {
                // Below this spacing sharing is given up before the budget is.
                let shared = lattice.spacing_of(lattice.points[*i].level) > FINEST_SHARED_M;
                feasible(ctx, &Member { position: positions[*i], uses: &uses[*i] }, shared)
            }
        };
        let results: Vec<Result<(), TooNear>> =
            timed(statistics, "evaluate", || open.par_iter().with_max_len(4).map(evaluate).collect());
        let mut failed = Vec::new();
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
        if failed.is_empty() {
            statistics.certified_boxes = boxes;
            statistics.coverage_certified = true;
            return finish(ctx, &lattice, uses, statistics);
        }
        let levels: Vec<u8> = lattice.points.iter().map(|p| p.level).collect();
        for (i, too_near) in failed {
            let level = levels[i];
            // A neighbour's subdivision has refined the surroundings of this one already: see first whether that is enough.
            if lattice.points[i].level > level {
                continue;
            }
            let spacing_m = lattice.spacing_of(level);
            if spacing_m < FINEST_SPACING_M || !lattice.subdivide(i as u32) {
                return Err(infeasible(ctx, &lattice, i, too_near));
            }
        }
    }
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
                // Few blocks for huge scenes: a block costs time even where one grid point serves it all.
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

/// Cells of this spacing and below need not be small enough for sharing, metres: their number would outgrow the images saved.
const FINEST_SHARED_M: f64 = 1.3;

/// Points closer than this bring nothing: eyes themselves keep 5 cm from surfaces.
const FINEST_SPACING_M: f64 = 0.1;

/// Solves all points in use for the users they are left with.
fn finish(
    ctx: &Context,
    lattice: &Lattice,
    uses: Vec<PointUses>,
    statistics: &mut PlacementStatistics,
) -> Result<Refined, PlacementError> {
    let mut used: Vec<(usize, PointUses)> = uses.into_iter().enumerate().filter(|(_, u)| !u.units.is_empty()).collect();
    used.sort_by_key(|(i, _)| lattice.points[*i].place.to_array());
    let unused = (lattice.points.len() - used.len()) as u64;
    statistics.skipped.insert("no eye of the walk volume can select the point".into(), unused);
    let (images, lists, max_triangles) = timed(statistics, "solve", || match ctx.scheme {
        Scheme::Paper => solve_points(ctx, lattice, &used),
        Scheme::Cells => solve_regions(ctx, lattice, &used),
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
    Ok(Refined { points, images, max_triangles })
}

/// Images with their points, lists per point, largest count.
type Solved = Result<(Vec<(u32, Image)>, Vec<Lists>, u64), PlacementError>;

/// The error for a point that cannot be served.
fn infeasible(ctx: &Context, lattice: &Lattice, point: usize, too_near: TooNear) -> PlacementError {
    let level = lattice.points[point].level;
    PlacementError::Infeasible {
        budget: ctx.budget,
        needed: too_near.needed,
        position: lattice.position(point),
        yaw_deg: too_near.direction_deg[0],
        pitch_deg: too_near.direction_deg[1],
        level,
        spacing_m: lattice.spacing_of(level),
    }
}

/// Solves every point for itself.
fn solve_points(ctx: &Context, lattice: &Lattice, used: &[(usize, PointUses)]) -> Solved {
    // A point solved with more users is solvable with fewer (see above).
    let solutions: Vec<Result<Solution, PlacementError>> = used
        .par_iter()
        .map(|(i, u)| solve(ctx, lattice.position(*i), u).map_err(|e| infeasible(ctx, lattice, *i, e)))
        .collect();
    let (mut images, mut lists, mut most) = (Vec::new(), Vec::new(), 0);
    for (point, s) in solutions.into_iter().enumerate() {
        let s = s?;
        let first = images.len() as u32;
        images.extend(s.images.into_iter().map(|i| (point as u32, i)));
        let renumber =
            |list: Vec<(f64, Option<u32>)>| list.into_iter().map(|(yaw, i)| (yaw, i.map(|k| first + k))).collect();
        lists.push(s.bands.into_iter().map(renumber).collect());
        most = most.max(s.max_triangles);
    }
    Ok((images, lists, most))
}

/// Edge of a region within which images are shared, as a multiple of the spacing of its points.
const REGION: f64 = 10.0;
/// Largest height of a region, metres: users on different storeys see different things, and an image for both would hold both.
const REGION_HEIGHT_M: f64 = 2.5;

/// Solves points together, region by region; points of one level form regions.
fn solve_regions(ctx: &Context, lattice: &Lattice, used: &[(usize, PointUses)]) -> Solved {
    let mut regions: BTreeMap<(u8, [i64; 3]), Vec<u32>> = BTreeMap::new();
    for (n, (i, _)) in used.iter().enumerate() {
        let (p, level) = (lattice.position(*i), lattice.points[*i].level);
        let edge = REGION * lattice.spacing_of(level);
        let place = p / DVec3::new(edge, edge.min(REGION_HEIGHT_M), edge);
        regions.entry((level, place.floor().as_i64vec3().to_array())).or_default().push(n as u32);
    }
    let regions: Vec<Vec<u32>> = regions.into_values().collect();
    let solved: Vec<Result<RegionSolution, PlacementError>> = regions
        .par_iter()
        .with_max_len(1)
        .map(|r| {
            let members: Vec<Member> = r
                .iter()
                .map(|n| &used[*n as usize])
                .map(|(i, uses)| Member { position: lattice.position(*i), uses })
                .collect();
            solve_region(ctx, &members)
                .map_err(|(member, e)| infeasible(ctx, lattice, used[r[member as usize] as usize].0, e))
        })
        .collect();
    let (mut images, mut most) = (Vec::new(), 0);
    let mut image_of: Vec<BTreeMap<u16, u32>> = vec![BTreeMap::new(); used.len()];
    for (region, solution) in regions.iter().zip(solved) {
        let solution = solution?;
        most = most.max(solution.max_triangles);
        for shared in solution.images {
            for (member, unit) in &shared.users {
                image_of[region[*member as usize] as usize].insert(*unit, images.len() as u32);
            }
            images.push((region[shared.member as usize], shared.image));
        }
    }
    let lists = image_of.iter().map(|of| lists(ctx.directions.bands(), |unit| of.get(&unit).copied())).collect();
    Ok((images, lists, most))
}

/// Runs a step and adds its seconds to the statistics.
pub(super) fn timed<T>(statistics: &mut PlacementStatistics, step: &str, f: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let out = f();
    *statistics.seconds.entry(step.to_string()).or_default() += start.elapsed().as_secs_f64();
    out
}
