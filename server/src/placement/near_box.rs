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
    cells::{Eyes, RunSums},
    faces::{FACES, Region, Surroundings, Window, face_basis},
    hull::EyeHull,
    looks::{Counts, Look},
    point::{Context, TooNear},
};
use glam::DVec3;
use ldi_protocol::Aabb;
use std::f64::consts::FRAC_PI_2;

/// All replaced cells lie beyond a face by this much, metres: above the rounding of bounds and of
/// the face itself.
const FACE_GAP_M: f64 = 1e-4;
/// A move takes faces this many times farther. Of 1.25, 1.5 and 2 this gave the fewest pixels on
/// west_riverside_mep and the clinic; 2 plans faster.
pub(super) const STEP: f64 = 1.5;
/// The box that a plan uses goes on in steps of these powers of [`STEP`]: 1.22, 1.11, 1.05, 1.02.
/// The last is about what the edges of cells leave of the budget anyway.
const FINER: [f64; 4] = [0.5, 0.25, 0.125, 0.05];
/// Samples to expect of an image per pixel of its window, and per pixel that the bounds of a
/// replaced cell cover, cells that overlap counted each. Half of what the clinic's images at a
/// twentieth hold: of the two guesses neither alone gave the best plans.
const SAMPLES_PER_PIXEL: [f64; 2] = [0.05, 0.008];
/// Of so many replaced cells and fewer the images' windows are found cell by cell. More: planning
/// of large scenes takes longer; fewer: windows and expected samples are rougher.
const FEW_CELLS: usize = 16_384;
/// The same while boxes are compared as they grow, which is most of a plan's time; the box that is
/// found is looked at anew. By judgement.
const FEW_CELLS_OF_A_MOVE: usize = 1024;
/// Of more, neighbouring cells count as one where their bounds are at most this share of their
/// distance in size. Larger: rougher windows.
const COMPACT: f64 = 0.1;
/// What a placement costs besides its samples: the rays that find what eyes see, a switch for
/// whoever walks past. In samples, by judgement.
pub(super) const PLACEMENT_SAMPLES: f64 = 500_000.0;
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
    /// Triangles of runs of cells from these eyes.
    pub sums: RunSums,
    /// Units of directions in which some of its eyes may see more than P triangles.
    pub units: Vec<u16>,
    /// Cells that any of these eyes sees in any of these directions.
    pub seen: CellMask,
    /// Largest number of triangles in a unit that is within P as it is.
    pub largest: u64,
}

impl Member {
    /// Counts what the eyes of `hull` see, unit by unit; `closely`: by subdivision until some unit
    /// exceeds the budget, so that no cell is given images that needs none.
    pub fn new(ctx: &Context, hull: EyeHull, closely: bool) -> Self {
        let eyes = hull.bounds();
        let sums = ctx.cells.sums_from(&eyes);
        let mut m = Self { hull, eyes, sums, units: Vec::new(), seen: ctx.cells.none(), largest: 0 };
        for (unit, planes) in (0u16..).zip(&ctx.bins) {
            match ctx.cells.count(Eyes { planes, eyes: &m.eyes, sums: &m.sums }, None, ctx.budget) {
                Some(triangles) => m.largest = m.largest.max(triangles),
                // However it is split, no frame of the unit has more than P.
                None if closely && m.units.is_empty() && !Look::new(ctx, m.eyes, &m.sums, unit).exceeds(ctx, None) => {
                    m.largest = ctx.budget
                }
                None => {
                    m.units.push(unit);
                    ctx.cells.add_seen(planes, &m.eyes, &mut m.seen);
                }
            }
        }
        m
    }
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
    surroundings: Surroundings,
    distance: [f64; 6],
    near: CellMask,
    counts: Counts,
    cost: f64,
}

impl<'a> Descent<'a> {
    fn new(fit: Fit<'a>, distance: [f64; 6], near: CellMask, counts: Counts) -> Self {
        let surroundings = Surroundings::new(&fit.beyond(&near, FEW_CELLS_OF_A_MOVE), &distance);
        let mut out = Self { fit, surroundings, distance, near, counts, cost: 0.0 };
        out.cost = out.cost_at(&distance);
        out
    }

    /// What a box is expected to cost, quickly.
    fn cost_at(&self, distance: &[f64; 6]) -> f64 {
        self.fit.cost(&self.fit.images_of(distance, &self.surroundings.windows(distance, FACE_GAP_M)))
    }

    /// Takes faces `step` times farther, always by the move that saves the most, until none that
    /// keeps Popt saves anything. A move saves less and less as the box grows, nearly always; so
    /// one that saved too little before is not looked at again until its turn comes (Minoux 1978,
    /// "Accelerated greedy algorithms").
    fn descend(&mut self, step: f64) {
        /// Where a move leads to.
        struct Next {
            cost: f64,
            distance: [f64; 6],
        }
        // What every move saved when it was looked at last, and where it leads from here.
        let mut savings = [f64::INFINITY; MOVES.len()];
        let mut next: [Option<Next>; MOVES.len()] = Default::default();
        let mut is_stuck = [false; MOVES.len()];
        loop {
            let moves = || (0..MOVES.len()).filter(|m| !is_stuck[*m]);
            // Of equals the first.
            let best = moves().reduce(|a, b| if savings[b] > savings[a] { b } else { a });
            // Nothing is known to save anything: those that were not looked at from here may yet.
            let best = best.filter(|m| savings[*m] > 0.0).or_else(|| moves().find(|m| next[*m].is_none()));
            let Some(best) = best else { break };
            match next[best].take() {
                None => {
                    let moved = |f: usize| if MOVES[best] >> f & 1 == 1 { step } else { 1.0 };
                    let distance: [f64; 6] = std::array::from_fn(|f| self.distance[f] * moved(f));
                    let cost = self.cost_at(&distance);
                    savings[best] = self.cost - cost;
                    next[best] = Some(Next { cost, distance });
                }
                Some(to) => {
                    let (ctx, near) = (self.fit.ctx, self.fit.near(&to.distance));
                    if self.counts.grow(ctx, &self.near, &near, ctx.optimize_budget) {
                        (self.cost, self.distance, self.near) = (to.cost, to.distance, near);
                        next = Default::default();
                    } else {
                        // Counts only grow: what does not fit now never will.
                        is_stuck[best] = true;
                    }
                }
            }
        }
    }

    fn finish(self) -> NearBox {
        let Self { fit, distance, near, mut counts, .. } = self;
        let max_triangles = counts.largest(fit.ctx, &near);
        let images = fit.images(&distance, &near);
        let cost = fit.cost(&images);
        let mut culled = fit.seen;
        culled.remove(&near);
        NearBox { cop: fit.cop, distance, images, culled, cost, max_triangles }
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
        let looks = self.members.iter().flat_map(|m| m.units.iter().map(|u| Look::new(self.ctx, m.eyes, &m.sums, *u)));
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
        let mut windows = [Window::EMPTY; 6];
        let regions: [Region; 6] = std::array::from_fn(|f| Region::new(f, distance));
        for (b, fill) in self.beyond(near, FEW_CELLS) {
            for (region, window) in regions.iter().zip(&mut windows) {
                // Most boxes are beyond few of the faces.
                if region.is_beyond(b.min, b.max)
                    && let Some(t) = region.tangents_of(&region.local(b.min, b.max))
                {
                    window.add(&t, fill);
                }
            }
        }
        self.images_of(distance, &windows)
    }

    /// Boxes around all cells that are seen and not `near`, relative to the centre of projection,
    /// each with the share of its surface that is covered; cell by cell where there are at most
    /// `few`.
    fn beyond(&self, near: &CellMask, few: usize) -> Vec<(Aabb, f64)> {
        let mut far = self.seen.clone();
        far.remove(near);
        let cells = self.ctx.cells;
        let mut out = Vec::new();
        let mut add = |b: &Aabb, fill: f64| out.push((Aabb { min: b.min - self.cop, max: b.max - self.cop }, fill));
        if far.count() <= few {
            far.iter().for_each(|cell| add(&cells.bounds[cell as usize], 1.0));
        } else {
            cells.compacted(&far, self.cop, COMPACT, add);
        }
        out
    }

    /// The images of faces with these windows.
    fn images_of(&self, distance: &[f64; 6], windows: &[Window; 6]) -> [Option<FaceImage>; 6] {
        std::array::from_fn(|f| {
            let Window { tangents: window, covered } = windows[f];
            let (scale, footprint_px) = self
                .ctx
                .footprint
                .scale(FRAC_PI_2, distance[f], self.ahead[f])
                .unwrap_or((f64::INFINITY, f64::INFINITY));
            (window[0] < window[1] && window[2] < window[3]).then_some(FaceImage {
                scale,
                footprint_px,
                window,
                covered,
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

#[cfg(test)]
mod tests;
