//! How many triangles can a group of eyes see? Bounded from above by subdivision.
//!
//! In: a box of eyes and a bin of directions. Out: a bound on the triangles of any single frame
//! among them. One test for the whole box and bin ([`Cells::count`](super::cells::Cells::count))
//! adds up what different eyes see in different directions; halving box and bin where that exceeds
//! the budget tells whether any one frame does. What the leaves prove holds for each eye and
//! direction in them, so nothing is sampled.

use super::{
    bin_planes::BinPlanes,
    cell_mask::CellMask,
    cells::{Eyes, RunSums, Shown},
    point::{Context, TooNear},
};
use ldi_protocol::Aabb;
use std::collections::BTreeMap;

/// Splits of a look: eyes, directions, then both again. Deeper: tighter counts, longer planning.
/// By judgement.
const DEEPEST: u8 = 3;
/// Boxes of eyes smaller than this are not split, metres.
const SMALLEST_EYES_M: f64 = 0.25;

/// Eyes and directions that are counted together.
#[derive(Debug, Clone)]
pub(super) struct Look {
    planes: BinPlanes,
    eyes: Aabb,
    /// Triangles of runs of cells from the box that it is a part of.
    sums: RunSums,
    yaw_deg: [f64; 2],
    pitch_deg: [f64; 2],
    depth: u8,
}

impl Look {
    /// All eyes of a box, with the sums of cells from it, in all directions of a unit.
    pub fn new(ctx: &Context, eyes: Aabb, sums: &RunSums, unit: u16) -> Self {
        let (yaw_deg, pitch_deg) = ctx.directions.unit(usize::from(unit));
        Self { planes: ctx.bins[usize::from(unit)], eyes, sums: sums.clone(), yaw_deg, pitch_deg, depth: 0 }
    }

    fn seen_by(&self) -> Eyes<'_> {
        Eyes { planes: &self.planes, eyes: &self.eyes, sums: &self.sums }
    }

    /// The middle of its directions: yaw, pitch, degrees.
    fn direction_deg(&self) -> [f64; 2] {
        [self.yaw_deg, self.pitch_deg].map(|r| (r[0] + r[1]) * 0.5)
    }

    /// A bound on the triangles that any of its frames shows of the cells `among` these.
    pub fn count(&self, ctx: &Context, among: &CellMask) -> u64 {
        ctx.cells.count(self.seen_by(), Some(among), u64::MAX).unwrap_or(u64::MAX)
    }

    /// Whether some frame may show more triangles of the cells `among` these (None: all) than the
    /// budget, as far as subdivision can tell.
    pub fn exceeds(&self, ctx: &Context, among: Option<&CellMask>) -> bool {
        self.exceeds_among(ctx, among, &ctx.cells.unknown())
    }

    /// [`Look::exceeds`], given what more frames show.
    fn exceeds_among(&self, ctx: &Context, among: Option<&CellMask>, shown: &Shown) -> bool {
        let shown = ctx.cells.narrow(self.seen_by(), among, shown, ctx.budget);
        shown.triangles > ctx.budget
            && self.split(ctx).is_none_or(|parts| parts.iter().any(|p| p.exceeds_among(ctx, among, &shown)))
    }

    /// Four parts that together hold all its frames; None when it is as small as it gets.
    pub fn split(&self, ctx: &Context) -> Option<[Self; 4]> {
        if self.depth >= DEEPEST {
            return None;
        }
        let part = |eyes: Aabb, yaw_deg: [f64; 2], pitch_deg: [f64; 2]| Self {
            planes: if (yaw_deg, pitch_deg) == (self.yaw_deg, self.pitch_deg) {
                self.planes
            } else {
                BinPlanes::new(yaw_deg, pitch_deg, ctx.half_tan, ctx.half_tan)
            },
            eyes,
            sums: self.sums.clone(),
            yaw_deg,
            pitch_deg,
            depth: self.depth + 1,
        };
        let half = |r: [f64; 2], k: usize| {
            let mid = (r[0] + r[1]) * 0.5;
            if k == 0 { [r[0], mid] } else { [mid, r[1]] }
        };
        let size = self.eyes.size();
        let by_eyes = self.depth.is_multiple_of(2) && size.x.max(size.z) >= SMALLEST_EYES_M;
        Some(std::array::from_fn(|k| {
            if by_eyes {
                let ([x0, x1], [z0, z1]) =
                    (half([self.eyes.min.x, self.eyes.max.x], k % 2), half([self.eyes.min.z, self.eyes.max.z], k / 2));
                let mut eyes = self.eyes;
                (eyes.min.x, eyes.max.x, eyes.min.z, eyes.max.z) = (x0, x1, z0, z1);
                part(eyes, self.yaw_deg, self.pitch_deg)
            } else {
                part(self.eyes, half(self.yaw_deg, k % 2), half(self.pitch_deg, k / 2))
            }
        }))
    }
}

/// Bounds on the counts of many looks as the set of cells grows, each kept within the budget.
pub(super) struct Counts(Vec<(Look, u64)>);

impl Counts {
    /// Counts `looks` over `near`. Err: a look that exceeds `limit` however it is split.
    pub fn new(ctx: &Context, looks: impl Iterator<Item = Look>, near: &CellMask, limit: u64) -> Result<Self, TooNear> {
        let mut out = Self(Vec::new());
        for look in looks {
            match look.count(ctx, near) {
                n if n <= limit => out.0.push((look, n)),
                _ => out.add(ctx, look, near, limit, &ctx.cells.unknown())?,
            }
        }
        Ok(out)
    }

    /// Counts a look, or its parts, given what more frames show.
    fn add(&mut self, ctx: &Context, look: Look, near: &CellMask, limit: u64, shown: &Shown) -> Result<(), TooNear> {
        let shown = ctx.cells.narrow(look.seen_by(), Some(near), shown, u64::MAX);
        if shown.triangles <= limit {
            self.0.push((look, shown.triangles));
            return Ok(());
        }
        let too_near = TooNear { direction_deg: look.direction_deg(), needed: shown.triangles };
        look.split(ctx).ok_or(too_near)?.into_iter().try_for_each(|part| self.add(ctx, part, near, limit, &shown))
    }

    /// Adds the cells that `wider` holds beyond `near`, unless some look that sees one of them
    /// would exceed `limit` however it is split. What a look shows of them is counted only where
    /// all of them together would exceed the limit.
    pub fn grow(&mut self, ctx: &Context, near: &CellMask, wider: &CellMask, limit: u64) -> bool {
        let mut added = wider.clone();
        added.remove(near);
        // Triangles of all of them, by the eyes that look.
        let mut of_all: BTreeMap<usize, u64> = BTreeMap::new();
        let mut next = Self(Vec::with_capacity(self.0.len()));
        // Those with the most first: whether it is too much is known early.
        self.0.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
        for (look, n) in &self.0 {
            let all = *of_all.entry(look.sums.key()).or_insert_with(|| ctx.cells.sum_among(&added, &look.sums));
            let new = if n + all <= limit { all } else { look.count(ctx, &added) };
            if n + new <= limit {
                next.0.push((look.clone(), n + new));
            } else if next.add(ctx, look.clone(), wider, limit, &ctx.cells.unknown()).is_err() {
                return false;
            }
        }
        *self = next;
        true
    }

    /// The largest count of a look over `near`, all the cells that were added.
    pub fn largest(&mut self, ctx: &Context, near: &CellMask) -> u64 {
        self.0.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
        let mut largest = 0;
        for (look, n) in &self.0 {
            if *n <= largest {
                break;
            }
            largest = largest.max(look.count(ctx, near));
        }
        largest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::{
        CostBenefit,
        bands::Directions,
        cells::Cells,
        test_scenes::{NOTHING_BETWEEN, Random, settings, strewn},
    };
    use glam::DVec3;
    use ldi_protocol::{ViewBasis, camera::Frustum};

    /// No frame, drawn by brute force, has more than its count says; and subdivision makes counts
    /// tighter.
    #[test]
    fn no_frame_exceeds_what_its_look_counts() {
        let (bounds, triangles) = strewn(900, 21);
        let cells = Cells::new(bounds, triangles);
        let directions = Directions::new(60.0);
        let mut random = Random::new(8);
        let eyes = Aabb { min: DVec3::new(-3.0, 1.0, -2.0), max: DVec3::new(2.0, 2.0, 3.0) };
        let sums = cells.sums_from(&eyes);
        let near = CellMask::of(900, &(0..900).filter(|c| c % 3 > 0).collect::<Vec<_>>());
        let (mut split, mut refused) = (0, 0);
        for unit in (0..directions.units() as u16).step_by(11) {
            let all =
                Context::new(&cells, &directions, &settings(u64::MAX), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
            let whole = Look::new(&all, eyes, &sums, unit).count(&all, &near);
            // The largest frame by sampling is below every bound; a budget between the two is
            // proved by subdivision alone.
            let (yaw, pitch) = directions.unit(usize::from(unit));
            let mut largest = 0;
            for _ in 0..200 {
                let within = |r: [f64; 2], u: f64| r[0] + (r[1] - r[0]) * u;
                let d = ViewBasis::from_yaw_pitch(within(yaw, random.unit()), within(pitch, random.unit()));
                let eye = eyes.min + eyes.size() * DVec3::new(random.unit(), random.unit(), random.unit());
                let frustum = Frustum::new(eye, &d, all.half_tan, all.half_tan);
                let drawn = near.iter().filter(|c| frustum.may_intersect(&cells.bounds[*c as usize]));
                largest = largest.max(drawn.map(|c| u64::from(cells.triangles[c as usize])).sum());
            }
            assert!(largest <= whole);
            let budget = (largest + whole) / 2;
            let ctx =
                Context::new(&cells, &directions, &settings(budget), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
            match Counts::new(&ctx, std::iter::once(Look::new(&ctx, eyes, &sums, unit)), &near, ctx.budget) {
                Ok(mut counts) => {
                    let counted = counts.largest(&ctx, &near);
                    assert!(counted >= largest && counted <= budget);
                    assert!(!Look::new(&ctx, eyes, &sums, unit).exceeds(&ctx, Some(&near)));
                    split += usize::from(counts.0.len() > 1);
                }
                Err(too_near) => {
                    assert!(too_near.needed > budget);
                    refused += 1;
                }
            }
            if largest > 0 {
                let less = Context::new(
                    &cells,
                    &directions,
                    &settings(largest - 1),
                    60.0,
                    CostBenefit::default(),
                    NOTHING_BETWEEN,
                );
                assert!(Look::new(&less, eyes, &sums, unit).exceeds(&less, Some(&near)), "a frame was found that does");
            }
        }
        assert!(split > 5, "{split} units were proved by subdivision, {refused} refused");
    }

    #[test]
    fn what_is_known_of_more_frames_narrows_to_what_their_parts_count() {
        let (bounds, triangles) = strewn(900, 21);
        let cells = Cells::new(bounds, triangles);
        let directions = Directions::new(60.0);
        let ctx = Context::new(&cells, &directions, &settings(9_000), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
        let eyes = Aabb { min: DVec3::new(-3.0, 1.0, -2.0), max: DVec3::new(2.0, 2.0, 3.0) };
        let sums = cells.sums_from(&eyes);
        let some = CellMask::of(900, &(0..900).filter(|c| c % 3 > 0).collect::<Vec<_>>());
        let mut fewer = 0;
        for unit in (0..directions.units() as u16).step_by(7) {
            for among in [None, Some(&some)] {
                let look = Look::new(&ctx, eyes, &sums, unit);
                let counted = |look: &Look| ctx.cells.count(look.seen_by(), among, u64::MAX).expect("no limit");
                let whole = ctx.cells.narrow(look.seen_by(), among, &ctx.cells.unknown(), u64::MAX);
                // What stopped early goes on where it stopped.
                let begun = ctx.cells.narrow(look.seen_by(), among, &ctx.cells.unknown(), whole.triangles / 3);
                assert_eq!(whole.triangles, counted(&look));
                assert!(begun.triangles <= whole.triangles);
                for part in look.split(&ctx).expect("parts") {
                    let narrowed = |from| ctx.cells.narrow(part.seen_by(), among, from, u64::MAX).triangles;
                    assert_eq!(narrowed(&whole), counted(&part));
                    assert_eq!(narrowed(&begun), counted(&part));
                    fewer += u32::from(counted(&part) < whole.triangles);
                }
            }
        }
        assert!(fewer > 100, "{fewer} parts show less than the whole");
    }

    #[test]
    fn growing_equals_counting_anew() {
        let (bounds, triangles) = strewn(600, 5);
        let cells = Cells::new(bounds, triangles);
        let directions = Directions::new(60.0);
        let ctx = Context::new(&cells, &directions, &settings(9_000), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
        let eyes = Aabb { min: DVec3::new(-1.0, 1.0, -1.0), max: DVec3::new(1.0, 2.0, 1.0) };
        let sums = cells.sums_from(&eyes);
        let looks = || (0..directions.units() as u16).map(|u| Look::new(&ctx, eyes, &sums, u));
        let some = |k: u32| CellMask::of(600, &(0..600).filter(|c| c % 7 < k).collect::<Vec<_>>());
        let mut counts = Counts::new(&ctx, looks(), &some(1), ctx.budget).map_err(|e| e.needed).expect("few triangles");
        let mut grown = 1;
        for k in 2..=7 {
            let anew = Counts::new(&ctx, looks(), &some(k), ctx.budget);
            let fits = counts.grow(&ctx, &some(k - 1), &some(k), ctx.budget);
            assert_eq!(fits, anew.is_ok(), "step {k}");
            match anew {
                Ok(mut anew) => {
                    let [grown, anew] = [&mut counts, &mut anew].map(|c| c.largest(&ctx, &some(k)));
                    assert!(grown <= anew, "a finer split is never worse");
                }
                Err(_) => break,
            }
            grown = k;
        }
        assert!((2..7).contains(&grown), "grew to {grown}");
    }
}
