//! Image placement at one grid point (Aliaga and Lastra 1999, section 3.3; rows A5 to A9).
//!
//! In: a grid point, its certified users per unit of directions, the cells, the budgets. Out:
//! images, and for each pitch band the angular ranges with the image to use; or the news that some
//! range cannot be brought within the budget from here, so that the grid must become finer.
//!
//! The range with the most triangles comes first; its subset is solved with the full model. Then:
//!
//! - The image's plane may stand no nearer than its users demand: all of them in front of it, and
//!   the footprint bound kept (`footprint`). The paper asks only that the plane lie outside a
//!   sphere.
//! - The subset is widened to everything beyond its plane within the largest window, and the plane
//!   moved back as far as the optimization budget allows. An image then serves the ranges beside
//!   its own too, also in other pitch bands: each range whose users keep the footprint bound and
//!   whose count comes within P takes it. That is what keeps the number of images low.
//! - What is left over the budget is solved in turn, again with the full model, so that a frame
//!   needs one image at most.

use super::{
    arcs::BandPlanes,
    bands::{Directions, YAW_BINS},
    bin_planes::BinPlanes,
    cell_mask::CellMask,
    cells::Cells,
    coverage::PointUses,
    eye_tree::EyeTree,
    footprint::Footprint,
    gaze::Gaze,
    hull::EyeHull,
    subset::{CostBenefit, Goal, Item, best_subset},
    view::BandView,
};
use glam::DVec3;
use ldi_protocol::{
    Aabb, ViewBasis,
    camera::Frustum,
    index::{BuildSettings, CELLS},
};
use std::sync::OnceLock;

/// Largest half extent of an image, as a tangent. Wider images serve more directions, but their
/// outer samples are dense where nobody looks, and every frame warps the whole image: 1 (45
/// degrees) is a little under twice the picture's own extent.
const WIDEST: f64 = 1.0;
/// All culled cells lie beyond the plane by this much, metres: above the rounding of bounds and of
/// the plane itself.
const PLANE_GAP_M: f64 = 1e-4;

/// How eyes are given to grid points (`--grid`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scheme {
    /// The closest point in the reverse frustum.
    Paper,
    /// The closest point.
    Cells,
}

/// Tells whether two places (world, metres) see each other, nothing being between them.
#[derive(Clone, Copy)]
pub struct Sees<'a>(pub &'a (dyn Fn(DVec3, DVec3) -> bool + Sync));

impl std::fmt::Debug for Sees<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Sees")
    }
}

/// What all points share.
#[derive(Debug)]
pub(super) struct Context<'a> {
    /// Cells.
    pub cells: &'a Cells,
    /// Bands and bins.
    pub directions: &'a Directions,
    /// Planes per pitch band.
    pub planes: Vec<BandPlanes>,
    /// Planes per unit of directions.
    pub bins: Vec<BinPlanes>,
    /// Half tangent of the square planning frustum.
    pub half_tan: f64,
    /// Half tangents of the picture across and up: what of an image can be seen. Cells are counted
    /// in the square.
    pub picture_tan: (f64, f64),
    /// Footprint bounds.
    pub footprint: Footprint,
    /// Where eyes can be; None: not known.
    pub eyes: Option<&'a EyeTree>,
    /// How eyes are given to grid points.
    pub scheme: Scheme,
    /// P.
    pub budget: u64,
    /// Popt.
    pub optimize_budget: u64,
    /// Which places see each other.
    pub sees: Sees<'a>,
    /// Longest axis of the model, metres.
    pub longest_axis_m: f64,
    /// Constants of the cost-benefit function.
    pub constants: CostBenefit,
    /// What pictures hold per unit of directions, once it is asked for.
    gazes: OnceLock<Vec<Gaze>>,
}

impl<'a> Context<'a> {
    /// What follows from the cells, the directions and the build's settings.
    pub fn new(
        cells: &'a Cells,
        directions: &'a Directions,
        settings: &BuildSettings,
        longest_axis_m: f64,
        constants: CostBenefit,
        sees: Sees<'a>,
    ) -> Self {
        let half_tan = settings.square_half_tan();
        let bin = |unit| {
            let (yaw, pitch) = directions.unit(unit);
            BinPlanes::new(yaw, pitch, half_tan, half_tan)
        };
        Self {
            cells,
            directions,
            planes: (0..directions.bands()).map(|b| BandPlanes::new(directions.band(b), half_tan)).collect(),
            bins: (0..directions.units()).map(bin).collect(),
            half_tan,
            picture_tan: (settings.camera.half_tan_x().min(half_tan), settings.camera.half_tan_y().min(half_tan)),
            footprint: Footprint::new(&settings.camera, settings.density, settings.max_footprint_px),
            eyes: None,
            scheme: if settings.grid == CELLS { Scheme::Cells } else { Scheme::Paper },
            budget: settings.budget,
            optimize_budget: settings.optimize_budget.min(settings.budget),
            sees,
            longest_axis_m,
            constants,
            gazes: OnceLock::new(),
        }
    }

    /// What pictures hold in some units of directions.
    pub fn gaze_in(&self, units: &[u16]) -> Gaze {
        let (tx, ty) = self.picture_tan;
        let of = |unit: usize| {
            let (yaw, pitch) = self.directions.unit(unit);
            Gaze::of(&BinPlanes::new(yaw, pitch, tx, ty), self.footprint.focal_px)
        };
        let all = self.gazes.get_or_init(|| (0..self.directions.units()).map(of).collect());
        let mut out = Gaze::nowhere(self.footprint.focal_px);
        units.iter().for_each(|u| out.add(&all[usize::from(*u)]));
        out
    }
}

/// An image of one grid point, before its camera is fixed.
#[derive(Debug, Clone)]
pub(super) struct Image {
    /// Orientation.
    pub basis: ViewBasis,
    /// Distance of the plane from the grid point.
    pub plane_m: f64,
    /// Cells it replaces, ascending.
    pub culled: Vec<u32>,
    /// Its users.
    pub users: EyeHull,
    /// Largest angle between its axis and a user's direction, radians.
    pub phi: f64,
    /// Units that use it, with the yaw interval in use, degrees.
    pub units: Vec<(u16, [f64; 2])>,
    /// Triangles left in the range it was solved for.
    pub left: u64,
}

/// A point's images and ranges.
#[derive(Debug, Clone, Default)]
pub(super) struct Solution {
    /// Images in the order they were solved.
    pub images: Vec<Image>,
    /// Per pitch band: where each range starts (degrees), and its image; equal neighbours joined.
    /// Empty: no image at all.
    pub bands: Vec<Vec<(f64, Option<u32>)>>,
    /// Largest number of triangles left in any range in use.
    pub max_triangles: u64,
}

/// A range that cannot be brought within the budget.
#[derive(Debug, Clone, Copy)]
pub(super) struct TooNear {
    /// Yaw and pitch of the range, degrees.
    pub direction_deg: [f64; 2],
    /// Triangles that stay, whatever the image.
    pub needed: u64,
}

/// A range over the budget.
struct Demand {
    band: usize,
    range: usize,
    triangles: u64,
    image: Option<u32>,
}

/// Solves one grid point.
pub(super) fn solve(ctx: &Context, point: DVec3, uses: &PointUses) -> Result<Solution, TooNear> {
    let eyes = Aabb { min: point, max: point };
    if let Some(too_near) = hopeless(ctx, point, uses, &eyes) {
        return Err(too_near);
    }
    let views = views(ctx, &eyes, uses);
    let mut work = Work { ctx, point, uses, views, demands: Vec::new(), images: Vec::new(), max_triangles: 0 };
    work.collect_demands();
    // Worst first; ties to the lower band, then the lower yaw.
    while let Some(worst) = (0..work.demands.len())
        .filter(|d| work.demands[*d].image.is_none())
        .max_by(|a, b| work.demands[*a].triangles.cmp(&work.demands[*b].triangles).then(b.cmp(a)))
    {
        work.solve_range(worst)?;
    }
    Ok(work.finish())
}

/// Only every so many units are looked at by [`hopeless`]: coprime to the bins, so that all bands
/// and yaws take part.
const PROOF_STRIDE: usize = 7;

/// A quick proof that some unit cannot be brought within the budget: the cells that the frustum
/// along the middle of the unit keeps and that no image of that unit may replace. Exact as far as
/// it goes (the same cells, axis and plane as in [`Work::solve_range`]).
fn hopeless(ctx: &Context, point: DVec3, uses: &PointUses, eyes: &Aabb) -> Option<TooNear> {
    for (unit, users) in &uses.units {
        let unit = *unit as usize;
        if !unit.is_multiple_of(PROOF_STRIDE) {
            continue;
        }
        let (basis, direction_deg) = axis_of(ctx, unit);
        let phi = angle_to_unit(ctx, &basis, unit);
        let (middle, ahead) = depths(users, &basis, point);
        let nearest =
            ctx.footprint.nearest_plane_m(phi, ahead).map_or(f64::INFINITY, |d| (d + middle).max(1e-3)) + PLANE_GAP_M;
        let behind = nearest + point.dot(basis.forward);
        let frustum = Frustum::new(DVec3::ZERO, &basis, ctx.half_tan, ctx.half_tan);
        // Support of the differences between cell and eyes = support of the cell plus that of the
        // mirrored eyes.
        let offsets = frustum.normals.map(|n| -eyes.support(-n));
        let kept = |b: &Aabb| (0..4).all(|k| b.support(frustum.normals[k]) >= offsets[k]);
        let stays = ctx.cells.sum(kept, |b| -b.support(-basis.forward) < behind && kept(b));
        if stays > ctx.budget {
            return Some(TooNear { direction_deg, needed: stays });
        }
    }
    None
}

/// The axis of images for a unit: its middle.
pub(super) fn axis_of(ctx: &Context, unit: usize) -> (ViewBasis, [f64; 2]) {
    let (yaw, pitch) = ctx.directions.unit(unit);
    let direction_deg = [(yaw[0] + yaw[1]) * 0.5, (pitch[0] + pitch[1]) * 0.5];
    (ViewBasis::from_yaw_pitch(direction_deg[0], direction_deg[1]), direction_deg)
}

/// Views of the bands in use; None for the others.
fn views(ctx: &Context, eyes: &Aabb, uses: &PointUses) -> Vec<Option<BandView>> {
    (0..ctx.directions.bands())
        .map(|band| {
            let used = uses.units.iter().any(|u| u.0 as usize / YAW_BINS == band);
            used.then(|| BandView::new(ctx.cells, &ctx.planes[band], eyes))
        })
        .collect()
}

struct Work<'a> {
    ctx: &'a Context<'a>,
    point: DVec3,
    uses: &'a PointUses,
    views: Vec<Option<BandView>>,
    /// By band, then yaw.
    demands: Vec<Demand>,
    images: Vec<Image>,
    max_triangles: u64,
}

impl Work<'_> {
    fn hull(&self, unit: usize) -> Option<&EyeHull> {
        let at = self.uses.units.binary_search_by_key(&(unit as u16), |u| u.0).ok()?;
        Some(&self.uses.units[at].1)
    }

    fn collect_demands(&mut self) {
        for (band, view) in self.views.iter().enumerate() {
            let Some(view) = view else { continue };
            for range in 0..view.len() {
                let triangles = view.triangles[range];
                if self.hull(band * YAW_BINS + view.bin(range)).is_none() {
                    continue;
                }
                if triangles > self.ctx.budget {
                    self.demands.push(Demand { band, range, triangles, image: None });
                } else {
                    self.max_triangles = self.max_triangles.max(triangles);
                }
            }
        }
    }

    fn unit_of(&self, d: &Demand) -> usize {
        let bin = self.views[d.band].as_ref().map_or(0, |v| v.bin(d.range));
        d.band * YAW_BINS + bin
    }

    /// Solves the range of a demand and gives its image to every other range that can use it.
    fn solve_range(&mut self, worst: usize) -> Result<(), TooNear> {
        let (ctx, d) = (self.ctx, &self.demands[worst]);
        let (band, range, visible) = (d.band, d.range, d.triangles);
        let Some(view) = &self.views[band] else { return Ok(()) };
        let unit = self.unit_of(d);
        let (basis, direction_deg) = axis_of(ctx, unit);
        let too_near = |needed| TooNear { direction_deg, needed };
        let users = *self.hull(unit).ok_or(too_near(visible))?;
        let seen = view.visible(range);

        // The nearest plane its users allow.
        let phi = angle_to_unit(ctx, &basis, unit);
        let (middle, ahead) = depths(&users, &basis, self.point);
        let nearest = ctx.footprint.nearest_plane_m(phi, ahead).ok_or(too_near(visible))? + middle;
        let nearest = nearest.max(1e-3);
        let cop = centre(&users, &basis);
        let all = self.items(&basis, cop, nearest + PLANE_GAP_M);
        let seen_set = CellMask::of(ctx.cells.bounds.len(), &seen);
        let eligible: Vec<Item> = all.iter().filter(|i| seen_set.has(i.cell)).copied().collect();
        let replaceable: u64 = eligible.iter().map(|i| i.triangles).sum();
        let stays = visible - replaceable;
        if stays > ctx.budget {
            return Err(too_near(stays));
        }
        let left = ctx.optimize_budget.max(stays);
        let goal = Goal {
            visible,
            must_go: visible - left,
            screen: 2.0 * ctx.half_tan,
            longest_axis_m: ctx.longest_axis_m,
            constants: ctx.constants,
            look_ahead: 1,
        };
        let picked = best_subset(&eligible, &goal).ok_or(too_near(visible))?;
        let core_near = picked.iter().map(|i| eligible[*i].near).fold(f64::INFINITY, f64::min);

        // Widen to all beyond the plane, then move the plane back as far as the goal allows.
        let mut near: Vec<(f64, u64)> = eligible.iter().map(|i| (i.near, i.triangles)).collect();
        near.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
        let (mut gone, mut plane) = (0, core_near);
        for (depth, triangles) in near {
            gone += triangles;
            if gone >= goal.must_go {
                plane = plane.max(depth);
                break;
            }
        }
        let mut culled: Vec<u32> = all.iter().filter(|i| i.near >= plane).map(|i| i.cell).collect();
        culled.sort_unstable();
        let set = CellMask::of(ctx.cells.bounds.len(), &culled);
        let gone: u64 = eligible.iter().filter(|i| i.near >= plane).map(|i| i.triangles).sum();
        let number = self.images.len() as u32;
        self.images.push(Image {
            basis,
            plane_m: plane - PLANE_GAP_M,
            culled,
            users,
            phi,
            units: Vec::new(),
            left: visible - gone,
        });
        self.assign(number, &set, unit);
        if self.demands[worst].image.is_none() {
            // Cannot happen while counts are consistent; ends the search instead of looping.
            return Err(too_near(visible - gone));
        }
        Ok(())
    }

    /// Cells wholly beyond `nearest` from the point along the axis and within the widest window
    /// from `cop`.
    fn items(&self, basis: &ViewBasis, cop: DVec3, nearest: f64) -> Vec<Item> {
        let cells = self.ctx.cells;
        let mut out = Vec::new();
        for (i, b) in cells.bounds.iter().enumerate() {
            let near = -b.support(-basis.forward) - self.point.dot(basis.forward);
            if near < nearest {
                continue;
            }
            let tangents = tangents(b, basis, cop);
            if tangents.iter().all(|t| t.abs() <= WIDEST) {
                out.push(Item { cell: i as u32, triangles: u64::from(cells.triangles[i]), tangents, near });
            }
        }
        out
    }

    /// Gives image `number` to the open ranges that it serves, the units nearest to its axis first.
    fn assign(&mut self, number: u32, set: &CellMask, own: usize) {
        let ctx = self.ctx;
        let mut image = self.images[number as usize].clone();
        let counts: Vec<Option<Vec<u64>>> =
            self.views.iter().map(|v| v.as_ref().map(|v| v.count(ctx.cells, set))).collect();
        let served: Vec<(usize, usize, u64)> = self
            .demands
            .iter()
            .enumerate()
            .filter(|(_, d)| d.image.is_none())
            .filter_map(|(i, d)| {
                let left = counts[d.band].as_ref()?[d.range];
                (left <= ctx.budget).then(|| (self.unit_of(d), i, left))
            })
            .collect();
        let mut units: Vec<(f64, usize)> = served
            .iter()
            .map(|s| s.0)
            .collect::<std::collections::BTreeSet<_>>()
            .into_iter()
            .map(|u| (if u == own { -1.0 } else { angle_to_unit(ctx, &image.basis, u) }, u))
            .collect();
        units.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (_, unit) in units {
            let Some(hull) = self.hull(unit) else { continue };
            let mut users = image.users;
            users.union(hull);
            let phi = image.phi.max(angle_to_unit(ctx, &image.basis, unit));
            let (middle, ahead) = depths(&users, &image.basis, self.point);
            if ctx.footprint.scale(phi, image.plane_m - middle, ahead).is_none() {
                continue;
            }
            (image.users, image.phi) = (users, phi);
            let mut yaw = [f64::INFINITY, f64::NEG_INFINITY];
            for (_, i, left) in served.iter().filter(|s| s.0 == unit) {
                let d = &mut self.demands[*i];
                d.image = Some(number);
                self.max_triangles = self.max_triangles.max(*left);
                if let Some(view) = &self.views[d.band] {
                    yaw = [yaw[0].min(view.start_deg[d.range]), yaw[1].max(view.end_deg(d.range))];
                }
            }
            image.units.push((unit as u16, yaw));
        }
        image.units.sort_by_key(|u| u.0);
        self.images[number as usize] = image;
    }

    /// Joins the ranges into lists. A direction that nobody uses takes whatever its neighbour
    /// takes.
    fn finish(self) -> Solution {
        let mut of_demand = self.demands.iter().peekable();
        let mut bands = Vec::with_capacity(self.views.len());
        for (band, view) in self.views.iter().enumerate() {
            let mut list: Vec<(f64, Option<u32>)> = Vec::new();
            for range in 0..view.as_ref().map_or(0, BandView::len) {
                let Some(view) = view else { break };
                let image = match of_demand.next_if(|d| d.band == band && d.range == range) {
                    Some(d) => d.image,
                    None => {
                        let unused = self
                            .uses
                            .units
                            .binary_search_by_key(&((band * YAW_BINS + view.bin(range)) as u16), |u| u.0)
                            .is_err();
                        if unused { list.last().and_then(|l| l.1) } else { None }
                    }
                };
                if list.last().is_none_or(|l| l.1 != image) {
                    list.push((view.start_deg[range], image));
                }
            }
            if list.iter().all(|l| l.1.is_none()) {
                list.clear();
            }
            bands.push(list);
        }
        if bands.iter().all(Vec::is_empty) {
            bands.clear();
        }
        Solution { images: self.images, bands, max_triangles: self.max_triangles }
    }
}

/// Tangent extents of a box about `cop`: left, right, bottom, top. The box must lie ahead of it.
pub(super) fn tangents(b: &Aabb, basis: &ViewBasis, cop: DVec3) -> [f64; 4] {
    let mut out = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
    for corner in b.corners() {
        let v = corner - cop;
        let z = v.dot(basis.forward).max(1e-9);
        let (x, y) = (v.dot(basis.right) / z, v.dot(basis.up) / z);
        out = [out[0].min(x), out[1].max(x), out[2].min(y), out[3].max(y)];
    }
    out
}

/// The depth of the users' middle ahead of a point along the axis, and half their extent in depth.
pub(super) fn depths(users: &EyeHull, basis: &ViewBasis, point: DVec3) -> (f64, f64) {
    let (high, low) = (users.support(basis.forward), -users.support(-basis.forward));
    ((high + low) * 0.5 - point.dot(basis.forward), (high - low) * 0.5)
}

/// The middle of the users in the image's frame: the LDI's centre of projection.
pub(super) fn centre(users: &EyeHull, basis: &ViewBasis) -> DVec3 {
    [basis.right, basis.up, basis.forward]
        .into_iter()
        .map(|axis| axis * ((users.support(axis) - users.support(-axis)) * 0.5))
        .sum()
}

/// Largest angle between the axis and a direction of a unit, radians: it is attained at a corner
/// of the unit.
pub(super) fn angle_to_unit(ctx: &Context, basis: &ViewBasis, unit: usize) -> f64 {
    let (yaw, pitch) = ctx.directions.unit(unit);
    let mut smallest: f64 = 1.0;
    for y in yaw {
        for p in pitch {
            smallest = smallest.min(ViewBasis::from_yaw_pitch(y, p).forward.dot(basis.forward));
        }
    }
    smallest.clamp(-1.0, 1.0).acos()
}
