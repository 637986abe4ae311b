//! Images for view cells, shared between cells (DESIGN, "Near and far": who may use a placement).
//!
//! In: the grid points of a region with the box of eyes of each. Out: images, and for each point and unit of directions (pitch band
//! times yaw bin) the image to use, if any.
//!
//! How near geometry may be counted and how far an image reaches are two things. Counts want small cells: a large one sees, from some
//! eye in some corner, nearly everything around it. An image wants many users: its footprint bound asks only that all of them
//! lie in front of its plane by a margin, whatever floor they stand on. So cells are small and images are shared:
//!
//! 1. Per point and unit, the set of cells that any of its eyes may draw in any of the unit's directions (`bin_planes`, with the box
//!    of eyes). Where it holds more than P triangles there is a demand.
//! 2. The demand with the most triangles gets an image along the middle of its unit. Planes at several distances are tried, from
//!    the farthest that meets the optimization budget to the nearest that the users allow; the image replaces all beyond its
//!    plane.
//! 3. Each other open demand, the closest first in angle and depth, joins if the footprint bound holds for all users together and
//!    its own count without the replaced cells is within P. The plane that serves the most demands stays (a greedy set cover).
//! 4. Until no demand is open.

use super::{
    bands::{YAW_BIN_DEG, YAW_BINS},
    coverage::PointUses,
    hull::EyeHull,
    plan::steepest,
    point::{Context, Image, TooNear, angle_to_unit, axis_of, depths},
};
use glam::DVec3;
use ldi_protocol::{Aabb, ViewBasis};

/// All culled cells lie beyond the plane by this much, metres.
const PLANE_GAP_M: f64 = 1e-4;
/// Planes tried per image.
const PLANES: usize = 7;
/// No direction of a user may be farther from the image's axis, radians (57 degrees). Larger: fewer, but wider images, of which every
/// frame warps all. On the built-in house at a quarter of its triangles 17, 26, 40 and 57 degrees gave 4746, 1825, 854 and 445 images
/// (without [`WIDEST_VIEW`], and with [`SHARED_REACH`] 1).
const WIDEST_TURN: f64 = 1.0;

/// Nor may a user's picture reach farther from the axis than this tangent (68 degrees): samples of a flat image crowd toward its
/// borders, and memory with them.
const WIDEST_VIEW: f64 = 2.5;

/// Cells are made so small that an image for one of them could serve eyes this many times as far out. 1 makes the fewest cells that
/// can be served at all, but then planes stand as near as their own eyes allow and few images can be shared. On the built-in house 1 and 2
/// gave 320 and 621 cells with 445 and 469 images of 845 and 662 million pixels (without [`WIDEST_VIEW`]); 1.5 is
/// a compromise, not an optimum: it was not measured against either on a real scene.
const SHARED_REACH: f64 = 1.5;

/// A grid point with its eyes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Member<'a> {
    pub position: DVec3,
    pub uses: &'a PointUses,
}

/// An image and who uses it.
#[derive(Debug, Clone)]
pub(super) struct SharedImage {
    /// Position of the point it was solved at in the slice of members.
    pub member: u32,
    /// The image; its plane is measured from that point.
    pub image: Image,
    /// (member, unit) pairs.
    pub users: Vec<(u32, u16)>,
}

/// Images of a region.
#[derive(Debug, Clone, Default)]
pub(super) struct RegionSolution {
    pub images: Vec<SharedImage>,
    /// Largest number of triangles left in any unit.
    pub max_triangles: u64,
}

/// The cells that eyes in a box may draw in some direction of a unit.
struct Demand {
    member: u32,
    unit: u16,
    visible: Vec<u64>,
    triangles: u64,
}

/// The box of a member's eyes.
fn eyes(m: &Member) -> (Aabb, EyeHull) {
    let hull = m.uses.units.first().map_or(EyeHull::EMPTY, |u| u.1);
    (hull.bounds(), hull)
}

/// Visible sets of a member, unit by unit; those over the budget, and the largest count within it. Ends early when `each` fails.
fn demands<E>(ctx: &Context, number: u32, m: &Member, mut each: impl FnMut(Demand) -> Result<(), E>) -> Result<u64, E> {
    let (eyes, _) = eyes(m);
    let words = ctx.cells.bounds.len().div_ceil(64);
    let mut largest = 0;
    // Level bands first: most likely the worst.
    let mut units: Vec<usize> = (0..ctx.directions.units()).collect();
    units.sort_by_key(|u| (2 * (u / YAW_BINS)).abs_diff(ctx.directions.bands() - 1));
    let mut visible = vec![0u64; words];
    for unit in units {
        visible.fill(0);
        let triangles = ctx.cells.seen(&ctx.bins[unit], &eyes, &mut visible);
        if triangles > ctx.budget {
            each(Demand { member: number, unit: unit as u16, visible: visible.clone(), triangles })?;
        } else {
            largest = largest.max(triangles);
        }
    }
    Ok(largest)
}

/// Whether a member can be served: for every unit over the budget there is a plane far enough ahead, for its own eyes alone or, with
/// `shared`, for all eyes within [`SHARED_REACH`] times its own extent, in all directions that an image may serve.
pub(super) fn feasible(ctx: &Context, m: &Member, shared: bool) -> Result<(), TooNear> {
    let (own, hull) = eyes(m);
    let extra = own.size().x.max(own.size().z) * 0.5 * (SHARED_REACH - 1.0);
    let hull = if shared { hull.widened(extra) } else { hull };
    demands(ctx, 0, m, |d| {
        let turn = if shared { WIDEST_TURN } else { 0.0 };
        let reach = Reach::new(ctx, m, &hull, usize::from(d.unit), turn);
        let mut stays = 0;
        for (w, word) in d.visible.iter().enumerate() {
            let mut bits = *word;
            while bits != 0 {
                let cell = w * 64 + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                if reach.near(&ctx.cells.bounds[cell]).is_none() {
                    stays += u64::from(ctx.cells.triangles[cell]);
                }
            }
        }
        if stays > ctx.budget { Err(TooNear { direction_deg: reach.direction_deg, needed: stays }) } else { Ok(()) }
    })
    .map(|_| ())
}

/// What an image along the middle of a unit may replace.
struct Reach {
    basis: ViewBasis,
    direction_deg: [f64; 2],
    phi: f64,
    /// Smallest depth of a replaced cell, from the origin.
    behind: f64,
}

impl Reach {
    /// `turn`: directions up to this far from the axis must be served, and those of the unit anyway.
    fn new(ctx: &Context, m: &Member, hull: &EyeHull, unit: usize, turn: f64) -> Self {
        let (basis, direction_deg) = axis_of(ctx, unit);
        let phi = angle_to_unit(ctx, &basis, unit).max(turn);
        let (middle, ahead) = depths(hull, &basis, m.position);
        let nearest =
            ctx.footprint.nearest_plane_m(phi, ahead).map_or(f64::INFINITY, |p| (p + middle).max(1e-3)) + PLANE_GAP_M;
        Self { basis, direction_deg, phi, behind: nearest + m.position.dot(basis.forward) }
    }

    /// The nearest depth of a cell that may be replaced: wholly beyond the nearest plane.
    fn near(&self, b: &Aabb) -> Option<f64> {
        let near = -b.support(-self.basis.forward);
        (near >= self.behind).then_some(near)
    }
}

/// The largest angle between an axis and the directions of a unit; infinite when it exceeds [`WIDEST_TURN`] or a picture of the unit
/// reaches out of [`WIDEST_VIEW`].
fn turn_within_view(ctx: &Context, basis: &ViewBasis, unit: usize) -> f64 {
    let turn = angle_to_unit(ctx, basis, unit);
    if turn > WIDEST_TURN {
        return f64::INFINITY;
    }
    let units = [(unit as u16, ctx.directions.unit(unit).0)];
    let within = [-basis.right, basis.right, -basis.up, basis.up]
        .into_iter()
        .all(|side| steepest(ctx, basis, &units, side).is_some_and(|slope| slope <= WIDEST_VIEW));
    if within { turn } else { f64::INFINITY }
}

/// An image's axis and what it may replace, for the demand that starts it.
struct Seed {
    basis: ViewBasis,
    direction_deg: [f64; 2],
    phi: f64,
    /// Cells beyond the nearest plane: nearest depth from the member's point, cell; farthest first.
    items: Vec<(f64, u32)>,
    /// Triangles of the demand that are not among them.
    stays: u64,
    /// Per unit, how far its directions lie from the axis, radians; infinite where the image would have to be too wide.
    turn: Vec<f64>,
}

impl Seed {
    fn new(ctx: &Context, m: &Member, hull: &EyeHull, d: &Demand) -> Self {
        let reach = Reach::new(ctx, m, hull, usize::from(d.unit), 0.0);
        let mut items = Vec::new();
        let mut gone = 0;
        for (i, b) in ctx.cells.bounds.iter().enumerate() {
            let Some(near) = reach.near(b) else { continue };
            items.push((near - m.position.dot(reach.basis.forward), i as u32));
            if has(&d.visible, i as u32) {
                gone += u64::from(ctx.cells.triangles[i]);
            }
        }
        items.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let Reach { basis, direction_deg, phi, .. } = reach;
        let turn = (0..ctx.directions.units()).map(|u| turn_within_view(ctx, &basis, u)).collect();
        Self { basis, direction_deg, phi, items, stays: d.triangles - gone, turn }
    }

    /// Depths of the planes to try, farthest first.
    fn planes(&self, ctx: &Context, d: &Demand) -> Vec<f64> {
        let must_go = d.triangles - ctx.optimize_budget.max(self.stays);
        let mut gone = 0;
        let mut farthest = self.items.last().map_or(0.0, |i| i.0);
        for (near, cell) in &self.items {
            if has(&d.visible, *cell) {
                gone += u64::from(ctx.cells.triangles[*cell as usize]);
                if gone >= must_go {
                    farthest = *near;
                    break;
                }
            }
        }
        let nearest = self.items.last().map_or(farthest, |i| i.0).min(farthest);
        let step = |k: usize| farthest * (nearest / farthest).powf(k as f64 / (PLANES - 1) as f64);
        let mut out: Vec<f64> = (0..PLANES).map(step).collect();
        (out[0], out[PLANES - 1]) = (farthest, nearest);
        out.dedup();
        out
    }
}

/// Solves a region. All members must be [`feasible`].
pub(super) fn solve_region(ctx: &Context, members: &[Member]) -> Result<RegionSolution, (u32, TooNear)> {
    let mut out = RegionSolution::default();
    let mut all = Vec::new();
    for (i, m) in members.iter().enumerate() {
        let mut list = Vec::new();
        let collected = demands(ctx, i as u32, m, |d| {
            list.push(d);
            Ok::<(), std::convert::Infallible>(())
        });
        let largest = collected.unwrap_or(0);
        list.sort_by_key(|d| d.unit);
        all.append(&mut list);
        out.max_triangles = out.max_triangles.max(largest);
    }
    let hulls: Vec<EyeHull> = members.iter().map(|m| eyes(m).1).collect();
    let mut open: Vec<usize> = (0..all.len()).collect();
    // Most triangles first; ties to the smaller member and unit.
    open.sort_by(|a, b| all[*b].triangles.cmp(&all[*a].triangles).then(a.cmp(b)));
    while let Some(&first) = open.first() {
        let d = &all[first];
        let m = &members[d.member as usize];
        let seed = Seed::new(ctx, m, &hulls[d.member as usize], d);
        if seed.stays > ctx.budget {
            return Err((d.member, TooNear { direction_deg: seed.direction_deg, needed: seed.stays }));
        }
        let grown =
            seed.planes(ctx, d).into_iter().map(|plane| grow(ctx, members, &hulls, &all, &open, first, &seed, plane));
        // The plane that serves the most; ties to the farthest.
        let Some(best) = grown.reduce(|a, b| if b.served.len() > a.served.len() { b } else { a }) else { break };
        out.max_triangles = out.max_triangles.max(best.max_triangles);
        let mut served = best.served;
        served.sort_unstable();
        open.retain(|i| served.binary_search(i).is_err());
        let mut image = best.image;
        image.culled = seed.items.iter().take_while(|i| i.0 >= best.plane).map(|i| i.1).collect();
        image.culled.sort_unstable();
        out.images.push(shared_image(ctx, d, &all, &served, image));
    }
    Ok(out)
}

/// An image under construction.
struct Grown {
    image: Image,
    /// Nearest depth of what it replaces.
    plane: f64,
    served: Vec<usize>,
    max_triangles: u64,
}

/// Takes in as many open demands as the plane allows.
#[allow(clippy::too_many_arguments, reason = "the state of the greedy cover")]
fn grow(
    ctx: &Context,
    members: &[Member],
    hulls: &[EyeHull],
    all: &[Demand],
    open: &[usize],
    first: usize,
    seed: &Seed,
    plane: f64,
) -> Grown {
    let words = ctx.cells.bounds.len().div_ceil(64);
    let mut keep = vec![!0u64; words];
    seed.items.iter().take_while(|i| i.0 >= plane).for_each(|(_, c)| keep[*c as usize / 64] &= !(1 << (c % 64)));
    let start = &members[all[first].member as usize];
    let mut image = Image {
        basis: seed.basis,
        plane_m: plane - PLANE_GAP_M,
        culled: Vec::new(),
        users: hulls[all[first].member as usize],
        phi: seed.phi,
        units: Vec::new(),
        left: left(ctx, &all[first].visible, &keep, u64::MAX).unwrap_or(0),
    };
    // Closest first: turn and shift in depth both cost footprint.
    let turn = &seed.turn;
    let shift: Vec<f64> = members
        .iter()
        .map(|m| ((m.position - start.position).dot(seed.basis.forward)).abs() / plane.max(1e-3))
        .collect();
    let mut order: Vec<(f64, usize)> = open
        .iter()
        .filter(|i| turn[usize::from(all[**i].unit)] <= WIDEST_TURN && **i != first)
        .map(|i| (turn[usize::from(all[*i].unit)] / WIDEST_TURN + shift[all[*i].member as usize], *i))
        .collect();
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut grown = Grown { plane, served: vec![first], max_triangles: image.left, image: image.clone() };
    for (_, i) in order {
        let d = &all[i];
        let mut users = image.users;
        users.union(&hulls[d.member as usize]);
        let phi = image.phi.max(turn[usize::from(d.unit)]);
        let (middle, ahead) = depths(&users, &image.basis, start.position);
        if ctx.footprint.scale(phi, image.plane_m - middle, ahead).is_none() {
            continue;
        }
        let Some(rest) = left(ctx, &d.visible, &keep, ctx.budget) else { continue };
        (image.users, image.phi) = (users, phi);
        grown.max_triangles = grown.max_triangles.max(rest);
        grown.served.push(i);
    }
    grown.image = image;
    grown
}

/// Triangles of the cells in both sets; None when more than `most`.
fn left(ctx: &Context, visible: &[u64], keep: &[u64], most: u64) -> Option<u64> {
    let mut sum = 0;
    for (w, (a, b)) in visible.iter().zip(keep).enumerate() {
        let mut bits = a & b;
        while bits != 0 {
            sum += u64::from(ctx.cells.triangles[w * 64 + bits.trailing_zeros() as usize]);
            bits &= bits - 1;
        }
        if sum > most {
            return None;
        }
    }
    Some(sum)
}

/// Completes an image: of the cells beyond its plane, those that some user may see.
fn shared_image(ctx: &Context, first: &Demand, all: &[Demand], served: &[usize], mut image: Image) -> SharedImage {
    let mut seen = vec![0u64; ctx.cells.bounds.len().div_ceil(64)];
    let mut units = std::collections::BTreeSet::new();
    for i in served {
        seen.iter_mut().zip(&all[*i].visible).for_each(|(a, b)| *a |= b);
        units.insert(all[*i].unit);
    }
    image.culled.retain(|c| has(&seen, *c));
    image.units = units.into_iter().map(|u| (u, ctx.directions.unit(usize::from(u)).0)).collect();
    let users = served.iter().map(|i| (all[*i].member, all[*i].unit)).collect();
    SharedImage { member: first.member, image, users }
}

fn has(set: &[u64], cell: u32) -> bool {
    set[cell as usize / 64] >> (cell % 64) & 1 == 1
}

/// Yaw-bin lists of a point: where each list entry starts, and its image; neighbours that agree are joined.
pub(super) fn lists(bands: usize, image_of: impl Fn(u16) -> Option<u32>) -> Vec<Vec<(f64, Option<u32>)>> {
    let mut out: Vec<Vec<(f64, Option<u32>)>> = Vec::with_capacity(bands);
    for band in 0..bands {
        let mut list: Vec<(f64, Option<u32>)> = Vec::new();
        for bin in 0..YAW_BINS {
            let image = image_of((band * YAW_BINS + bin) as u16);
            if list.last().is_none_or(|l| l.1 != image) {
                list.push((bin as f64 * YAW_BIN_DEG, image));
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
