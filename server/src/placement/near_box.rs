//! Near boxes: what a group of view cells draws as geometry, and the images that stand for all the
//! rest (DESIGN, "Near and far").
//!
//! In: grid points with the eyes that use them. Out: an axis-aligned box around those eyes. Cells
//! that touch the box are near and drawn; cells wholly beyond one of its six faces are far and
//! replaced. From the centre of projection, amid the eyes, each face is the quadrilateral of an
//! image. A place outside of the box belongs to the image of the face that it is beyond; if it is
//! beyond several, to that whose axis it is farthest along: the flatter the box, the more askew
//! its floor and ceiling would look at what is far away. So whatever an eye sees beyond the box
//! lies in one of the images, at a depth of at least the face's distance.
//!
//! ```text
//!      ·  image -z ·          D: distance of a face from the centre of projection
//!       · ┌─────┐ ·           e: how far eyes come toward the face
//!         │ ooo │             footprint <= k^2 D / (D - e) / scale        (`footprint`)
//! image -x│ o+o │image +x
//!         │ ooo │             o: eyes, +: centre of projection
//!       · └─────┘ ·
//! ```
//!
//! The paper gives each range of directions an image of its own (Aliaga and Lastra 1999, section
//! 3.3), so directions that overlap hold the same surfaces many times, and turning the head asks
//! for new images. Here a direction is held once per group, and turning asks for nothing that is
//! not there already.
//!
//! The six distances take the place of the paper's six border lists (section 3.3.2): the box
//! starts at the smallest that the footprint bound allows, and grows by the move that saves the
//! most samples while every direction of every eye stays within Popt; the smallest box must keep
//! within P alone.

use super::{
    cell_mask::CellMask,
    hull::EyeHull,
    looks::{Counts, Look},
    point::{Context, TooNear},
};
use glam::DVec3;
use ldi_protocol::{Aabb, ViewBasis};
use std::f64::consts::FRAC_PI_2;

/// All replaced cells lie beyond a face by this much, metres: above the rounding of bounds and of
/// the face itself.
const FACE_GAP_M: f64 = 1e-4;
/// A move takes faces this much farther. Smaller: fewer pixels, longer planning. By judgement.
pub(super) const STEP: f64 = 1.25;
/// The box that a plan uses goes on in steps of these powers of [`STEP`]: 1.12, 1.06, 1.03, 1.01.
/// The last is below what the edges of cells leave of the budget anyway (70 of the clinic's 71
/// boxes come within 1% of Popt).
const FINER: [f64; 4] = [0.5, 0.25, 0.125, 0.05];
/// Samples to expect of an image per pixel of its window, and per pixel that the bounds of a
/// replaced cell cover, cells that overlap counted each. Half of what the clinic's images at a
/// twentieth hold: of the two guesses neither alone gave the best plans.
const SAMPLES_PER_PIXEL: [f64; 2] = [0.05, 0.008];
/// Of so many replaced cells and fewer the images' windows are found cell by cell. More: planning
/// of large scenes takes longer; fewer: windows and expected samples are rougher.
const FEW_CELLS: usize = 16_384;
/// Of more, neighbouring cells count as one where their bounds are at most this share of their
/// distance in size. Larger: rougher windows.
const COMPACT: f64 = 0.1;
/// What a placement costs besides its samples: the rays that find what eyes see, a switch for
/// whoever walks past. In samples, by judgement.
pub(super) const PLACEMENT_SAMPLES: f64 = 500_000.0;
/// Faces, by (axis, side).
pub(super) const FACES: [(usize, usize); 6] = [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)];
/// Sets of faces that may move together, as bits of [`FACES`]: all, the walls, floor and ceiling,
/// each.
pub(super) const MOVES: [u8; 9] = [0b11_1111, 0b11_0011, 0b00_1100, 1, 2, 4, 8, 16, 32];

/// A grid point, its eyes, and what it must be relieved of.
#[derive(Debug, Clone)]
pub(super) struct Member {
    /// Where its eyes are.
    pub hull: EyeHull,
    /// The box around them.
    pub eyes: Aabb,
    /// Units of directions in which some of its eyes see more than P triangles.
    pub units: Vec<u16>,
    /// Cells that any of these eyes sees in any of these directions.
    pub seen: CellMask,
    /// Largest number of triangles in a unit that is within P as it is.
    pub largest: u64,
}

impl Member {
    /// Counts what the eyes of `hull` see, unit by unit; `closely`: by subdivision, so that no
    /// unit is taken for over the budget that is not.
    pub fn new(ctx: &Context, hull: EyeHull, closely: bool) -> Self {
        let mut m = Self { hull, eyes: hull.bounds(), units: Vec::new(), seen: ctx.cells.none(), largest: 0 };
        for (unit, planes) in (0u16..).zip(&ctx.bins) {
            match ctx.cells.count(planes, &m.eyes, None, ctx.budget) {
                Some(triangles) => m.largest = m.largest.max(triangles),
                // However it is split, no frame of the unit has more than P.
                None if closely && !Look::new(ctx, m.eyes, unit).exceeds(ctx, None) => m.largest = ctx.budget,
                None => {
                    m.units.push(unit);
                    ctx.cells.add_seen(planes, &m.eyes, &mut m.seen);
                }
            }
        }
        m
    }
}

/// The orientation of a face: `forward` is its outward normal.
pub(super) fn face_basis(face: usize) -> ViewBasis {
    let (axis, side) = FACES[face];
    let mut forward = DVec3::ZERO;
    forward[axis] = if side == 0 { -1.0 } else { 1.0 };
    let up = if axis == 1 { DVec3::Z } else { DVec3::Y };
    ViewBasis { right: forward.cross(up), up, forward }
}

/// A box and what it costs.
#[derive(Debug, Clone)]
pub(super) struct NearBox {
    /// Centre of projection: where an eye can be, closest to the middle of the eyes. Between two
    /// storeys, in the slab, it would see the ceiling that all eyes see from below edge-on or not
    /// at all.
    pub cop: DVec3,
    /// Distance of each of [`FACES`] from it.
    pub distance: [f64; 6],
    /// Per face: sampling density relative to the build's, footprint bound, and the tangents that
    /// far cells fill (left, right, bottom, top); None where nothing is seen beyond it.
    pub images: [Option<FaceImage>; 6],
    /// Cells it replaces.
    pub culled: CellMask,
    /// Samples to expect of all images, with a charge for the placement.
    pub cost: f64,
    /// Largest number of triangles that stay in any direction that uses the box.
    pub max_triangles: u64,
}

/// The image of a face.
#[derive(Debug, Clone, Copy)]
pub(super) struct FaceImage {
    pub scale: f64,
    pub footprint_px: f64,
    pub window: [f64; 4],
    /// What the bounds of replaced cells cover, added up, at distance 1.
    pub covered: f64,
}

/// A group of members and the box that is being fitted to them.
pub(super) struct Fit<'a> {
    ctx: &'a Context<'a>,
    members: &'a [&'a Member],
    seen: CellMask,
    cop: DVec3,
    /// How far eyes come toward each face.
    ahead: [f64; 6],
}

/// Whether a box can serve all eyes of `member` and those up to `extra_m` farther out within a
/// budget. Err: some direction that exceeds it.
pub(super) fn feasible(ctx: &Context, member: &Member, extra_m: f64, budget: u64) -> Result<(), TooNear> {
    let members = [member];
    let fit = Fit::new(ctx, &members, extra_m);
    fit.counts(&fit.near(&fit.smallest()), budget).map(|_| ())
}

/// The smallest budget with which a box can serve all eyes of `member`; None if this one is as
/// large.
pub(super) fn enough(ctx: &Context, member: &Member, budget: u64) -> Option<TooNear> {
    let members = [member];
    let fit = Fit::new(ctx, &members, 0.0);
    fit.needs(&fit.near(&fit.smallest()), budget)
}

/// The smallest budget that any box around the eyes of `member` could keep; None if the budget is
/// as large.
pub(super) fn needed(ctx: &Context, member: &Member) -> Option<TooNear> {
    let members = [member];
    let fit = Fit::new(ctx, &members, 0.0);
    // What touches the eyes themselves is within every box.
    fit.needs(&fit.near(&fit.ahead), ctx.budget)
}

/// Fits a box to a group of members. Err: some direction stays above the budget even with the
/// smallest box.
pub(super) fn fit(ctx: &Context, members: &[&Member]) -> Result<NearBox, TooNear> {
    let fit = Fit::new(ctx, members, 0.0);
    let smallest = fit.smallest();
    let near = fit.near(&smallest);
    let counts = fit.counts(&near, ctx.budget)?;
    let mut descent = Descent::new(fit, smallest, near, counts);
    descent.descend(STEP);
    Ok(descent.finish())
}

/// The box of a group, grown on in ever smaller steps: what is left of the budget after the last
/// whole step is worth some pixels yet.
pub(super) fn fill(ctx: &Context, members: &[&Member], near_box: &NearBox) -> NearBox {
    let fit = Fit::new(ctx, members, 0.0);
    let near = fit.near(&near_box.distance);
    // A box that is the smallest may exceed Popt.
    let Ok(counts) = fit.counts(&near, ctx.optimize_budget) else { return near_box.clone() };
    let mut descent = Descent::new(fit, near_box.distance, near, counts);
    FINER.iter().for_each(|part| descent.descend(STEP.powf(*part)));
    descent.finish()
}

/// A box while it grows.
struct Descent<'a> {
    fit: Fit<'a>,
    distance: [f64; 6],
    near: CellMask,
    counts: Counts,
    images: [Option<FaceImage>; 6],
    cost: f64,
}

impl<'a> Descent<'a> {
    fn new(fit: Fit<'a>, distance: [f64; 6], near: CellMask, counts: Counts) -> Self {
        let images = fit.images(&distance, &near);
        let cost = fit.cost(&images);
        Self { fit, distance, near, counts, images, cost }
    }

    /// Takes faces `step` times farther, always by the move that saves the most, until none that
    /// keeps Popt saves anything.
    fn descend(&mut self, step: f64) {
        let fit = &self.fit;
        let mut stuck = 0u16;
        loop {
            let mut best: Option<(f64, usize, [f64; 6], CellMask, [Option<FaceImage>; 6])> = None;
            for (number, moved) in MOVES.iter().enumerate().filter(|(n, _)| stuck >> n & 1 == 0) {
                let to: [f64; 6] =
                    std::array::from_fn(|f| self.distance[f] * if moved >> f & 1 == 1 { step } else { 1.0 });
                let wider = fit.near(&to);
                let images = fit.images(&to, &wider);
                let c = fit.cost(&images);
                if c < self.cost && best.as_ref().is_none_or(|b| c < b.0) {
                    best = Some((c, number, to, wider, images));
                }
            }
            let Some((c, number, to, wider, images)) = best else { break };
            if self.counts.grow(fit.ctx, &self.near, &wider, fit.ctx.optimize_budget) {
                (self.cost, self.distance, self.near, self.images) = (c, to, wider, images);
            } else {
                // Counts only grow: what does not fit now never will.
                stuck |= 1 << number;
            }
        }
    }

    fn finish(self) -> NearBox {
        let Self { fit, distance, near, counts, images, cost } = self;
        let mut culled = fit.seen;
        culled.remove(&near);
        NearBox { cop: fit.cop, distance, images, culled, cost, max_triangles: counts.largest() }
    }
}

impl<'a> Fit<'a> {
    pub fn new(ctx: &'a Context<'a>, members: &'a [&'a Member], extra_m: f64) -> Self {
        let mut hull = EyeHull::EMPTY;
        let mut seen = ctx.cells.none();
        for m in members {
            hull.union(&m.hull);
            seen.add(&m.seen);
        }
        let hull = hull.widened(extra_m);
        let middle = hull.bounds().centre();
        let cop = ctx.eyes.and_then(|e| e.closest(middle)).unwrap_or(middle);
        let ahead = std::array::from_fn(|f| {
            let n = face_basis(f).forward;
            (hull.support(n) - cop.dot(n)).max(0.0)
        });
        Self { ctx, members, seen, cop, ahead }
    }

    /// The distances that the footprint bound asks for.
    fn smallest(&self) -> [f64; 6] {
        self.ahead.map(|e| self.ctx.footprint.nearest_plane_m(FRAC_PI_2, e).unwrap_or(f64::INFINITY))
    }

    /// How many times farther off than the smallest box's faces would have nothing beyond them.
    pub fn farthest_steps(&self) -> [f64; 6] {
        let seen = self.seen.iter().fold(Aabb::EMPTY, |b, c| b.union(self.ctx.cells.bounds[c as usize]));
        let smallest = self.smallest();
        std::array::from_fn(|f| {
            let n = face_basis(f).forward;
            if seen.is_empty() { 1.0 } else { (seen.support(n) - self.cop.dot(n)) / smallest[f] }
        })
    }

    /// The cost of a box that stands `steps` times farther off than the smallest, face by face;
    /// None if it exceeds the budget.
    pub fn try_steps(&self, steps: &[f64; 6]) -> Option<f64> {
        let smallest = self.smallest();
        let distance = std::array::from_fn(|f| smallest[f] * steps[f]);
        let near = self.near(&distance);
        let largest = if steps.iter().all(|s| *s == 1.0) { self.ctx.budget } else { self.ctx.optimize_budget };
        self.counts(&near, largest).ok()?;
        Some(self.cost(&self.images(&distance, &near)))
    }

    /// What stays of `near` in every look of every member. Err: a look that exceeds `limit`.
    fn counts(&self, near: &CellMask, limit: u64) -> Result<Counts, TooNear> {
        let looks = self.members.iter().flat_map(|m| m.units.iter().map(|u| Look::new(self.ctx, m.eyes, *u)));
        Counts::new(self.ctx, looks, near, limit)
    }

    /// The direction with the most triangles if it exceeds a budget.
    fn needs(&self, near: &CellMask, budget: u64) -> Option<TooNear> {
        let mut worst = None;
        while let Err(more) = self.counts(near, worst.map_or(budget, |w: TooNear| w.needed)) {
            worst = Some(more);
        }
        worst
    }

    /// The cells that touch the box.
    fn near(&self, distance: &[f64; 6]) -> CellMask {
        let mut b = Aabb { min: self.cop, max: self.cop };
        for (f, (axis, side)) in FACES.iter().enumerate() {
            let d = distance[f] + FACE_GAP_M;
            if *side == 0 { b.min[*axis] -= d } else { b.max[*axis] += d }
        }
        self.ctx.cells.touching(&b)
    }

    /// The images of all faces.
    fn images(&self, distance: &[f64; 6], near: &CellMask) -> [Option<FaceImage>; 6] {
        self.images_of(distance, near, FEW_CELLS)
    }

    /// [`Fit::images`], cell by cell where at most `few` are replaced.
    fn images_of(&self, distance: &[f64; 6], near: &CellMask, few: usize) -> [Option<FaceImage>; 6] {
        let mut windows = [[f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY]; 6];
        let mut covered = [0.0; 6];
        let regions: [Region; 6] = std::array::from_fn(|f| Region::new(f, distance));
        let mut far = self.seen.clone();
        far.remove(near);
        let mut add = |b: &Aabb, fill: f64| {
            let (low, high) = (b.min - self.cop, b.max - self.cop);
            for ((region, w), covered) in regions.iter().zip(&mut windows).zip(&mut covered) {
                // Most boxes are beyond few of the faces.
                if region.is_beyond(low, high)
                    && let Some(t) = region.tangents_of(&region.local(low, high))
                {
                    *covered += (t[1] - t[0]) * (t[3] - t[2]) * fill;
                    *w = [w[0].min(t[0]), w[1].max(t[1]), w[2].min(t[2]), w[3].max(t[3])];
                }
            }
        };
        let cells = self.ctx.cells;
        if far.count() <= few {
            far.iter().for_each(|cell| add(&cells.bounds[cell as usize], 1.0));
        } else {
            cells.compacted(&far, self.cop, COMPACT, add);
        }
        std::array::from_fn(|f| {
            let window = windows[f];
            let (scale, footprint_px) = self
                .ctx
                .footprint
                .scale(FRAC_PI_2, distance[f], self.ahead[f])
                .unwrap_or((f64::INFINITY, f64::INFINITY));
            (window[0] < window[1] && window[2] < window[3]).then_some(FaceImage {
                scale,
                footprint_px,
                window,
                covered: covered[f],
            })
        })
    }

    fn cost(&self, images: &[Option<FaceImage>; 6]) -> f64 {
        let samples = |i: &FaceImage| {
            let w = i.window;
            let per_unit = self.ctx.footprint.pixels_per_unit(i.scale).powi(2);
            (SAMPLES_PER_PIXEL[0] * (w[1] - w[0]) * (w[3] - w[2]) + SAMPLES_PER_PIXEL[1] * i.covered) * per_unit
        };
        images.iter().flatten().map(samples).sum::<f64>() + PLACEMENT_SAMPLES
    }
}

/// The places that belong to a face.
pub(super) struct Region {
    /// World axes of right, up and forward, and their signs.
    axes: [(usize, f64); 3],
    /// Distance of the face.
    distance: f64,
    /// Distances of the faces beside it: left, right, bottom, top.
    pub beside: [f64; 4],
}

impl Region {
    pub fn new(face: usize, distance: &[f64; 6]) -> Self {
        let basis = face_basis(face);
        let axes = [basis.right, basis.up, basis.forward].map(|v| {
            let axis = v.abs().max_position();
            (axis, v[axis])
        });
        let of =
            |(axis, sign): (usize, f64), positive: bool| distance[axis * 2 + usize::from((sign > 0.0) == positive)];
        let beside = [of(axes[0], false), of(axes[0], true), of(axes[1], false), of(axes[1], true)];
        Self { axes, distance: distance[face], beside }
    }

    /// Whether a box relative to the centre of projection reaches beyond the face.
    pub fn is_beyond(&self, low: DVec3, high: DVec3) -> bool {
        let (axis, sign) = self.axes[2];
        (low[axis] * sign).max(high[axis] * sign) > self.distance
    }

    /// A box relative to the centre of projection, along right, up, forward.
    pub fn local(&self, low: DVec3, high: DVec3) -> Aabb {
        let mut out = Aabb { min: DVec3::ZERO, max: DVec3::ZERO };
        for (k, (axis, sign)) in self.axes.iter().enumerate() {
            let (a, b) = (low[*axis] * sign, high[*axis] * sign);
            (out.min[k], out.max[k]) = (a.min(b), a.max(b));
        }
        out
    }

    /// Tangents (left, right, bottom, top) around the part of a local box that is in the region;
    /// None if none is.
    pub fn tangents_of(&self, b: &Aabb) -> Option<[f64; 4]> {
        let (near, far) = (b.min.z.max(self.distance), b.max.z);
        if far <= self.distance {
            return None;
        }
        let mut out = [0.0; 4];
        for k in 0..2 {
            let [low, high] = [self.beside[2 * k], self.beside[2 * k + 1]];
            // At depth z the region reaches to the larger of z and the face beside it.
            if b.min[k] > high.max(far) || b.max[k] < -low.max(far) {
                return None;
            }
            let least = b.min[k] / if b.min[k] < 0.0 { near } else { far };
            let most = b.max[k] / if b.max[k] > 0.0 { near } else { far };
            out[2 * k] = least.max(-(low / near).max(1.0));
            out[2 * k + 1] = most.min((high / near).max(1.0));
            if out[2 * k] >= out[2 * k + 1] {
                return None;
            }
        }
        Some(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::{
        CostBenefit,
        bands::Directions,
        cells::Cells,
        eye_tree::EyeTree,
        groups::group,
        model::{ImagePlan, PlacementPlan},
        plan::plan_box,
        search::{Search, search},
        test_scenes::{NOTHING_BETWEEN, Random, settings, strewn},
    };
    use ldi_protocol::{camera::Frustum, index::BuildSettings, volume::WalkVolume};

    fn hall() -> (Cells, Directions) {
        let (mut bounds, triangles) = strewn(1500, 33);
        // Floors and walls of a single triangle have no thickness.
        for (i, b) in bounds.iter_mut().enumerate().filter(|(i, _)| i % 4 == 0) {
            b.max[i / 4 % 3] = b.min[i / 4 % 3];
        }
        (Cells::new(bounds, triangles), Directions::new(60.0))
    }

    /// Nine cells of eyes, 2 m wide, on one floor.
    fn members(ctx: &Context) -> Vec<Member> {
        let hull = |k: i32| {
            let at = DVec3::new(f64::from(k % 3 - 1), 0.0, f64::from(k / 3 - 1)) * 2.0;
            let mut hull = EyeHull::EMPTY;
            hull.add(&Aabb { min: at + DVec3::new(-1.0, 1.1, -1.0), max: at + DVec3::new(1.0, 2.0, 1.0) });
            hull
        };
        (0..9).map(|k| Member::new(ctx, hull(k), true)).collect()
    }

    fn within(r: [f64; 2], u: f64) -> f64 {
        r[0] + (r[1] - r[0]) * u
    }

    /// Both promises and coverage, by brute force over random eyes and directions.
    #[test]
    fn groups_keep_the_budget_and_show_all_that_they_replace() {
        let (cells, directions) = hall();
        let ctx = Context::new(&cells, &directions, &settings(9_000), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
        let members = members(&ctx);
        let groups = group(&ctx, &members).map_err(|(m, e)| (m, e.needed)).expect("feasible");
        let mut of = vec![usize::MAX; members.len()];
        for (g, (list, _)) in groups.iter().enumerate() {
            for m in list {
                assert_eq!(std::mem::replace(&mut of[*m as usize], g), usize::MAX, "a member is in one group");
            }
        }
        let plans: Vec<PlacementPlan> = groups
            .iter()
            .map(|(list, near)| {
                plan_box(&ctx, near, &list.iter().map(|m| &members[*m as usize]).collect::<Vec<_>>(), 0)
            })
            .collect();
        for ((_, near), plan) in groups.iter().zip(&plans) {
            for cell in plan.culled.iter() {
                let b = &cells.bounds[cell as usize];
                let beyond = (0..6).any(|f| {
                    let n = face_basis(f).forward;
                    -b.support(-n) > near.cop.dot(n) + near.distance[f]
                });
                assert!(beyond, "a replaced cell reaches into the box");
            }
        }
        let mut random = Random::new(6);
        let (mut replaced, mut shown) = (0, 0);
        for _ in 0..4000 {
            let k = (random.bits() % 9) as usize;
            let (m, unit) = (&members[k], (random.bits() % directions.units() as u64) as usize);
            let (yaw, pitch) = directions.unit(unit);
            let d = ViewBasis::from_yaw_pitch(within(yaw, random.unit()), within(pitch, random.unit()));
            let eye = m.eyes.min + m.eyes.size() * DVec3::new(random.unit(), random.unit(), random.unit());
            let square = Frustum::new(eye, &d, ctx.half_tan, ctx.half_tan);
            let plan = m.units.binary_search(&(unit as u16)).ok().map(|_| &plans[of[k]]);
            let culled = plan.map(|p| &p.culled);
            let drawn: u64 = (0..1500u32)
                .filter(|c| {
                    !culled.is_some_and(|all| all.contains(*c)) && square.may_intersect(&cells.bounds[*c as usize])
                })
                .map(|c| u64::from(cells.triangles[c as usize]))
                .sum();
            assert!(drawn <= ctx.budget, "{drawn} triangles");
            let Some(plan) = plan else { continue };
            replaced += 1;
            let picture = Frustum::new(eye, &d, ctx.picture_tan.0, ctx.picture_tan.1);
            for c in plan.culled.iter().filter(|c| picture.may_intersect(&cells.bounds[*c as usize])) {
                let b = &cells.bounds[c as usize];
                let q = b.min + b.size() * DVec3::new(random.unit(), random.unit(), random.unit());
                if !picture.contains(q) {
                    continue;
                }
                shown += 1;
                let held = plan.images.iter().any(|i| {
                    let v = q - plan.cop;
                    let z = v.dot(i.basis.forward);
                    let (x, y) = (v.dot(i.basis.right) / z, v.dot(i.basis.up) / z);
                    z >= i.plane_distance
                        && x >= i.window[0]
                        && x <= i.window[1]
                        && y >= i.window[2]
                        && y <= i.window[3]
                });
                assert!(held, "{q} is in the picture of {eye}, but in no image");
            }
        }
        assert!(replaced > 500 && shown > 5000, "{replaced} frames with images, {shown} points");
        assert!(groups.len() < 9, "some cells share a box: {} groups", groups.len());
    }

    #[test]
    fn windows_of_many_cells_hold_those_of_each_and_are_hardly_larger() {
        // Runs of 16 neighbours in a yard, as the octree's order gives them.
        let mut random = Random::new(9);
        let mut bounds = Vec::new();
        for _ in 0..400 {
            let middle = DVec3::new(random.unit() - 0.5, 0.04 * random.unit(), random.unit() - 0.5) * 400.0;
            bounds.extend((0..16).map(|_| {
                let min = middle + DVec3::new(random.unit(), random.unit(), random.unit()) * 3.0;
                Aabb { min, max: min + DVec3::splat(0.2 + random.unit()) }
            }));
        }
        let (cells, directions) = (Cells::new(bounds, vec![1; 6400]), Directions::new(60.0));
        let ctx = Context::new(&cells, &directions, &settings(9_000), 400.0, CostBenefit::default(), NOTHING_BETWEEN);
        let members = members(&ctx);
        let member = [&members[4]];
        let mut fit = Fit::new(&ctx, &member, 0.0);
        (0..6400).for_each(|c| fit.seen.insert(c));
        let distance = [8.0, 9.0, 5.0, 5.0, 8.0, 12.0];
        let near = fit.near(&distance);
        let (exact, joined) = (fit.images_of(&distance, &near, usize::MAX), fit.images_of(&distance, &near, 0));
        let mut found = 0;
        let far = (0..6400).filter(|c| !near.has(*c)).count();
        let mut mask = fit.seen.clone();
        mask.remove(&near);
        cells.compacted(&mask, fit.cop, COMPACT, |_, _| found += 1);
        assert!(found * 2 < far, "{found} boxes for {far} cells");
        for (exact, joined) in exact.iter().zip(&joined) {
            assert_eq!(exact.is_some(), joined.is_some());
            let Some((e, j)) = exact.as_ref().zip(joined.as_ref()) else { continue };
            for k in 0..2 {
                let (low, high) = (2 * k, 2 * k + 1);
                assert!(j.window[low] <= e.window[low] && j.window[high] >= e.window[high]);
                let grown = (j.window[high] - j.window[low]) / (e.window[high] - e.window[low]);
                assert!(grown < 1.1, "{grown} times as wide");
            }
            let ratio = j.covered / e.covered;
            assert!((0.7..1.4).contains(&ratio), "{ratio} times as much covered");
        }
    }

    #[test]
    fn the_centre_of_projection_is_where_an_eye_can_be() {
        let (cells, directions) = hall();
        let mut ctx =
            Context::new(&cells, &directions, &settings(9_000), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
        // Two storeys, 1 to 2 m and 4 to 5 m: the middle of their eyes is in the slab.
        let runs: Vec<Vec<[u16; 2]>> = (0..64).map(|_| vec![[10, 20], [40, 50]]).collect();
        let cut = Aabb { min: DVec3::new(-2.0, 0.0, -2.0), max: DVec3::new(2.0, 0.0, 2.0) };
        let volume = WalkVolume::new(DVec3::new(-2.0, 0.0, -2.0), 0.5, 0.1, [8, 8], &runs, &cut).expect("a volume");
        let tree = EyeTree::new(&volume);
        let mut hull = EyeHull::EMPTY;
        volume.boxes().for_each(|b| hull.add(&b));
        let member = Member::new(&ctx, hull, true);
        let fitted = |ctx: &Context| fit(ctx, &[&member]).map_err(|e| e.needed).expect("feasible");
        let slab = fitted(&ctx).cop;
        assert!(slab.y > 2.5 && slab.y < 3.5 && !volume.contains(slab));
        ctx.eyes = Some(&tree);
        assert!(volume.contains(fitted(&ctx).cop), "{}", fitted(&ctx).cop);
    }

    #[test]
    fn boxes_grow_to_the_optimization_budget() {
        let (cells, directions) = hall();
        let largest = |optimize_budget: u64| {
            let settings = BuildSettings { optimize_budget, ..settings(9_000) };
            let ctx = Context::new(&cells, &directions, &settings, 60.0, CostBenefit::default(), NOTHING_BETWEEN);
            let members = members(&ctx);
            let near = fit(&ctx, &[&members[4]]).map_err(|e| e.needed).expect("feasible");
            near.max_triangles
        };
        let all = [6_000, 7_500, 9_000].map(|popt| (popt, largest(popt)));
        assert!(all.iter().all(|(popt, n)| n <= popt && *n > popt / 2), "{all:?}");
        assert!(all.windows(2).all(|w| w[0].1 < w[1].1), "{all:?}");
    }

    #[test]
    fn a_filled_box_keeps_popt_and_costs_less() {
        let (cells, directions) = hall();
        let settings = BuildSettings { optimize_budget: 8_000, ..settings(9_000) };
        let ctx = Context::new(&cells, &directions, &settings, 60.0, CostBenefit::default(), NOTHING_BETWEEN);
        let mut saved = 0.0;
        for member in &members(&ctx) {
            let near = fit(&ctx, &[member]).map_err(|e| e.needed).expect("feasible");
            let filled = fill(&ctx, &[member], &near);
            assert!((0..6).all(|f| filled.distance[f] >= near.distance[f]) && filled.cost <= near.cost);
            assert!(filled.max_triangles >= near.max_triangles && filled.max_triangles <= 8_000);
            let alone = [member];
            let of = Fit::new(&ctx, &alone, 0.0);
            assert!(of.counts(&of.near(&filled.distance), 8_000).is_ok());
            saved += 1.0 - filled.cost / near.cost;
        }
        assert!(saved > 0.0);
    }

    #[test]
    fn the_box_of_a_plan_is_that_of_a_descent() {
        let (cells, directions) = hall();
        let ctx = Context::new(&cells, &directions, &settings(9_000), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
        for member in &members(&ctx) {
            let near = fit(&ctx, &[member]).map_err(|e| e.needed).expect("feasible");
            let found = search(&Fit::new(&ctx, &[member], 0.0), Search::Descent, 1, 100_000).expect("feasible");
            assert!((near.cost / found.cost - 1.0).abs() < 1e-12, "{} {found:?}", near.cost);
            assert!(found.complete && found.states > 9);
        }
    }

    #[test]
    fn a_budget_that_nothing_meets_is_refused_with_the_need() {
        let (cells, directions) = hall();
        let ctx = Context::new(&cells, &directions, &settings(40), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
        let members = members(&ctx);
        assert!(feasible(&ctx, &members[4], 0.0, ctx.budget).is_err());
        let Err((_, too_near)) = group(&ctx, &members) else { panic!("no box can serve") };
        assert!(too_near.needed > 40);
    }

    #[test]
    fn faces_look_outward_and_their_regions_fill_what_is_outside_of_the_box() {
        let distance = [2.0, 3.0, 1.0, 4.0, 5.0, 2.5];
        let mut random = Random::new(17);
        let mut outside = [0; 6];
        for _ in 0..20_000 {
            let p = DVec3::from_array(std::array::from_fn(|_| (random.unit() - 0.5) * 40.0));
            let half = DVec3::from_array(std::array::from_fn(|_| random.unit()));
            let mut owners = 0;
            for (face, (axis, side)) in FACES.into_iter().enumerate() {
                let b = face_basis(face);
                assert!((b.right.cross(b.up) + b.forward).length() < 1e-12, "right-handed, as cameras are");
                let region = Region::new(face, &distance);
                let local = DVec3::new(p.dot(b.right), p.dot(b.up), p.dot(b.forward));
                assert_eq!(region.local(p, p).min, local);
                // Farthest along of those that it is beyond.
                let along = |f: usize| if FACES[f].1 == 0 { -p[FACES[f].0] } else { p[FACES[f].0] };
                let beyond = (0..6).filter(|f| along(*f) > distance[*f]);
                let owner = beyond.max_by(|a, b| along(*a).total_cmp(&along(*b)));
                let plan = ImagePlan { plane_distance: distance[face], beside: region.beside, ..plan_of_face(face) };
                assert_eq!(plan.owns(local), owner == Some(face), "{p}, axis {axis}, side {side}");
                if owner == Some(face) {
                    owners += 1;
                    outside[face] += 1;
                    let t = region.tangents_of(&region.local(p - half, p + half)).expect("its middle is in there");
                    let (x, y) = (local.x / local.z, local.y / local.z);
                    assert!(x >= t[0] && x <= t[1] && y >= t[2] && y <= t[3], "{t:?} without {x} {y}");
                }
            }
            let inside = (0..3).all(|a| p[a] >= -distance[2 * a] && p[a] <= distance[2 * a + 1]);
            assert_eq!(owners, usize::from(!inside));
        }
        assert!(outside.iter().all(|n| *n > 1000), "{outside:?}");
        // What is far to the side is the side's.
        let far = Aabb { min: DVec3::new(50.0, 5.0, -1.0), max: DVec3::new(60.0, 6.0, 1.0) };
        let ceiling = Region::new(3, &distance);
        assert_eq!(ceiling.tangents_of(&ceiling.local(far.min, far.max)), None);
    }

    fn plan_of_face(face: usize) -> ImagePlan {
        ImagePlan {
            basis: face_basis(face),
            cop: DVec3::ZERO,
            plane_distance: 1.0,
            beside: [f64::INFINITY; 4],
            pixels_per_unit: 1.0,
            window: [-1.0, 1.0, -1.0, 1.0],
            users: Aabb::EMPTY,
            directions: vec![],
            footprint_px: 1.0,
        }
    }
}
