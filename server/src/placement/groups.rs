//! Which members share a near box.
//!
//! In: members. Out: groups of them, each with its box. Fewer, larger groups have fewer images;
//! their boxes must stand farther off, and hold less of what is near in detail, until one box
//! cannot keep the budget. Walkers of storeys that do not see each other share none: from the
//! one's rooms an image holds the other's only through the slab between, in deep layers and
//! edge-on.

use super::{
    near_box::{Member, NearBox, PLACEMENT_SAMPLES, fill, fit},
    point::{Context, TooNear},
};
use glam::DVec3;
use ldi_protocol::Aabb;
use rayon::prelude::*;

/// Groups members: halved, again and again, wherever one box cannot serve them or boxes of their
/// parts are cheaper; then groups beside each other are joined where one box is cheaper than two.
/// The boxes that are left take up what they leave of the budget.
///
/// Returns the groups, as positions in `members`, each with its box, in a fixed order. Err: a
/// member that no box serves.
pub(super) fn group(ctx: &Context, members: &[Member]) -> Result<Vec<(Vec<u32>, NearBox)>, (u32, TooNear)> {
    let all: Vec<u32> = (0..members.len() as u32).filter(|m| !members[*m as usize].units.is_empty()).collect();
    if all.is_empty() {
        return Ok(Vec::new());
    }
    let groups = join(ctx, members, divide(ctx, members, all)?);
    let filled = |(of, near): (Vec<u32>, NearBox)| {
        let near = fill(ctx, &of.iter().map(|m| &members[*m as usize]).collect::<Vec<_>>(), &near);
        (of, near)
    };
    Ok(groups.into_par_iter().map(filled).collect())
}

/// Eyes of groups that are joined lie at most this far apart, as a share of their extents. By
/// judgement.
const CLOSE: f64 = 0.25;

/// A group: positions of its members, its box, and the box around its eyes.
type Group = (Vec<u32>, NearBox, Aabb);

/// Two groups that one box serves for less.
struct Joint {
    groups: [usize; 2],
    joined: Group,
    saved: f64,
}

/// Joins neighbouring groups, always the two whose one box saves the most, as long as any does:
/// halving cuts in the middle, wherever the scene would have it.
fn join(ctx: &Context, members: &[Member], groups: Vec<(Vec<u32>, NearBox)>) -> Vec<(Vec<u32>, NearBox)> {
    let eyes_of = |of: &[u32]| of.iter().fold(Aabb::EMPTY, |b, m| b.union(members[*m as usize].eyes));
    let mut groups: Vec<Option<Group>> = groups
        .into_iter()
        .map(|(of, near)| (eyes_of(&of), of, near))
        .map(|(e, of, near)| Some((of, near, e)))
        .collect();
    let close = |a: &Aabb, b: &Aabb| a.inflated(a.size().max(b.size()).max_element() * CLOSE).intersects(b);
    let joint = |groups: &[Option<Group>], i: usize, j: usize| {
        let (a, b) = (groups[i].as_ref()?, groups[j].as_ref()?);
        if !close(&a.2, &b.2) {
            return None;
        }
        let of: Vec<u32> = a.0.iter().chain(&b.0).copied().collect();
        if apart(ctx, members, &of) {
            return None;
        }
        let near = fit_of(ctx, members, &of).ok()?;
        let saved = a.1.cost + b.1.cost - near.cost;
        (saved > 0.0).then(|| Joint { groups: [i, j], joined: (of, near, a.2.union(b.2)), saved })
    };
    let pairs: Vec<(usize, usize)> = (0..groups.len()).flat_map(|j| (0..j).map(move |i| (i, j))).collect();
    let mut found: Vec<Joint> = pairs.into_par_iter().filter_map(|(i, j)| joint(&groups, i, j)).collect();
    // Of equals the first: they stay in the order of their groups.
    while let Some(best) = (0..found.len()).rev().max_by(|a, b| found[*a].saved.total_cmp(&found[*b].saved)) {
        let Joint { groups: [i, j], joined, .. } = found.swap_remove(best);
        (groups[i], groups[j]) = (Some(joined), None);
        found.retain(|f| f.groups.iter().all(|g| *g != i && *g != j));
        let others: Vec<usize> = (0..groups.len()).filter(|k| *k != i).collect();
        found.par_extend(others.into_par_iter().filter_map(|k| joint(&groups, i.min(k), i.max(k))));
        found.sort_unstable_by_key(|f| f.groups);
    }
    groups.into_iter().flatten().map(|(of, near, _)| (of, near)).collect()
}

/// Middles of view cells this far apart in height, metres, are of different storeys: more than the
/// walk volume is high and half a flight of stairs.
const STOREY_M: f64 = 2.5;
/// Storeys that share a box see each other at least this often: an atrium's galleries and a
/// hillside do, rooms above each other do not. By judgement.
const IN_SIGHT: f64 = 0.25;
/// View cells that are asked, at most: some hundred rays tell a quarter from nothing, and joining
/// asks for thousands of pairs of groups.
const ASKED: usize = 24;

/// Whether members lie on different storeys that do not see each other.
fn apart(ctx: &Context, members: &[Member], of: &[u32]) -> bool {
    let eyes = |m: &u32| &members[*m as usize].eyes;
    if of.iter().fold(Aabb::EMPTY, |b, m| b.union(*eyes(m))).size().y <= STOREY_M {
        return false;
    }
    let mut middles: Vec<DVec3> = of.iter().map(|m| eyes(m).centre()).collect();
    middles.sort_by(|a, b| a.y.total_cmp(&b.y));
    let asked: Vec<DVec3> = middles.iter().copied().step_by(middles.len().div_ceil(ASKED)).collect();
    let (mut pairs, mut seen) = (0, 0);
    for (i, a) in asked.iter().enumerate() {
        for b in asked[..i].iter().filter(|b| a.y - b.y > STOREY_M) {
            pairs += 1;
            seen += u32::from((ctx.sees.0)(*a, *b));
        }
    }
    f64::from(seen) < IN_SIGHT * f64::from(pairs)
}

/// A split is made where it costs less than this share of the whole. By judgement: a switch
/// between placements is worth a little.
const WORTH_SPLITTING: f64 = 0.95;

type Grouped = Result<Vec<(Vec<u32>, NearBox)>, (u32, TooNear)>;

fn fit_of(ctx: &Context, members: &[Member], of: &[u32]) -> Result<NearBox, TooNear> {
    fit(ctx, &of.iter().map(|m| &members[*m as usize]).collect::<Vec<_>>())
}

/// The cheapest groups that halving some members, their halves and so on gives. All halves are
/// looked at: often two cost as much as the whole, and four much less.
fn divide(ctx: &Context, members: &[Member], of: Vec<u32>) -> Grouped {
    if of.len() == 1 {
        return fit_of(ctx, members, &of).map(|b| vec![(of.clone(), b)]).map_err(|e| (of[0], e));
    }
    let whole = if apart(ctx, members, &of) { None } else { fit_of(ctx, members, &of).ok() };
    let limit = whole.as_ref().map_or(f64::INFINITY, |w| w.cost * WORTH_SPLITTING);
    let parts = || {
        let (low, high) = halve(members, &of);
        let (low, high) = rayon::join(|| divide(ctx, members, low), || divide(ctx, members, high));
        let mut groups = low?;
        groups.extend(high?);
        Ok(groups)
    };
    match whole {
        None => parts(),
        // No two groups cost less.
        Some(whole) if limit <= 2.0 * PLACEMENT_SAMPLES => Ok(vec![(of, whole)]),
        Some(whole) => match parts() {
            Ok(parts) if cost_of(&parts) < limit => Ok(parts),
            _ => Ok(vec![(of, whole)]),
        },
    }
}

/// What all groups cost, in samples to expect.
fn cost_of(groups: &[(Vec<u32>, NearBox)]) -> f64 {
    groups.iter().map(|g| g.1.cost).sum()
}

/// What ways to group the same view cells cost, in samples to expect.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Groupings {
    /// View cells.
    pub members: usize,
    /// Each by itself.
    pub apart: f64,
    /// Halved wherever that is cheaper in the end.
    pub halved: f64,
    /// Halved, then joined: the way in use.
    pub joined: f64,
    /// The best of all partitions.
    pub best: f64,
}

/// Compares ways to group some members, by trying every partition; for few of them, as their
/// subsets are fitted one by one. None: some member has no box.
pub(super) fn compare(ctx: &Context, members: &[Member]) -> Option<Groupings> {
    let n = members.len();
    let every: Vec<u32> = (1..1 << n).collect();
    let subset = |s: u32| (0..n as u32).filter(|m| s >> m & 1 == 1).collect::<Vec<u32>>();
    let cost = |s: &u32| {
        let of = subset(*s);
        // No way may take what the plan may not.
        if apart(ctx, members, &of) {
            f64::INFINITY
        } else {
            fit_of(ctx, members, &of).map_or(f64::INFINITY, |b| b.cost)
        }
    };
    let whole: Vec<f64> = std::iter::once(0.0).chain(every.par_iter().map(cost).collect::<Vec<_>>()).collect();
    let mut best = vec![0.0; whole.len()];
    for s in 1..whole.len() {
        // The group of its first member, and the best of all others.
        let first = s & s.wrapping_neg();
        let with_first = (1..=s).filter(|t| t & !s == 0 && t & first != 0);
        best[s] = with_first.map(|t| whole[t] + best[s & !t]).fold(f64::INFINITY, f64::min);
    }
    let halved = divide(ctx, members, (0..n as u32).collect()).ok()?;
    Some(Groupings {
        members: n,
        apart: (0..n).map(|m| whole[1 << m]).sum(),
        halved: cost_of(&halved),
        joined: cost_of(&join(ctx, members, halved)),
        best: *best.last()?,
    })
}

/// Two halves along the longest axis of the members' middles; heights count double, as storeys see
/// different things.
fn halve(members: &[Member], of: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let middle = |m: u32| members[m as usize].eyes.centre() * DVec3::new(1.0, 2.0, 1.0);
    let bounds = of.iter().fold(Aabb::EMPTY, |b, m| b.grown_to(middle(*m)));
    let axis = bounds.size().max_position();
    let cut = bounds.centre()[axis];
    let (mut low, mut high): (Vec<u32>, Vec<u32>) = of.iter().partition(|m| middle(**m)[axis] < cut);
    if low.is_empty() || high.is_empty() {
        low = of.to_vec();
        high = low.split_off(of.len() / 2);
    }
    (low, high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::{
        CostBenefit, Sees,
        bands::Directions,
        cells::Cells,
        hull::EyeHull,
        test_scenes::{NOTHING_BETWEEN, settings, strewn},
    };

    #[test]
    fn storeys_share_a_box_only_where_they_see_each_other() {
        let (bounds, triangles) = strewn(1500, 33);
        let (cells, directions) = (Cells::new(bounds, triangles), Directions::new(60.0));
        // Three view cells on each of two floors, the upper above the lower.
        let member = |ctx: &Context, k: u32| {
            let at = DVec3::new(f64::from(k % 3) * 2.0, f64::from(k / 3) * 4.0, 0.0);
            let mut hull = EyeHull::EMPTY;
            hull.add(&Aabb { min: at + DVec3::new(-1.0, 1.1, -1.0), max: at + DVec3::new(1.0, 2.0, 1.0) });
            Member::new(ctx, hull, true)
        };
        let mixed = |sees: Sees<'_>| {
            let ctx = Context::new(&cells, &directions, &settings(20_000), 60.0, CostBenefit::default(), sees);
            let members: Vec<Member> = (0..6).map(|k| member(&ctx, k)).collect();
            assert!(members.iter().all(|m| !m.units.is_empty()), "each needs a box");
            assert!(!apart(&ctx, &members, &[0, 1, 2]) && !apart(&ctx, &members, &[3, 4, 5]), "one floor");
            let groups = group(&ctx, &members).map_err(|(m, e)| (m, e.needed)).expect("feasible");
            let both = |of: &[u32]| of.iter().any(|m| *m < 3) && of.iter().any(|m| *m >= 3);
            (apart(&ctx, &members, &[0, 1, 4]), groups.iter().any(|(of, _)| both(of)))
        };
        assert_eq!(mixed(Sees(&|_, _| false)), (true, false), "a slab between");
        assert_eq!(mixed(Sees(&|_, _| true)), (false, true), "nothing between");
    }

    /// Sixteen view cells in a row along a strewn hall.
    fn row(ctx: &Context) -> Vec<Member> {
        let member = |k: u32| {
            let at = DVec3::new(f64::from(k) * 3.0 - 24.0, 0.0, 0.0);
            let mut hull = EyeHull::EMPTY;
            hull.add(&Aabb { min: at + DVec3::new(-1.5, 1.1, -1.5), max: at + DVec3::new(1.5, 2.0, 1.5) });
            Member::new(ctx, hull, true)
        };
        (0..16).map(member).filter(|m| !m.units.is_empty()).collect()
    }

    /// What boxes cost when members are halved `levels` times; None where one cannot serve its
    /// part.
    fn cut(ctx: &Context, members: &[Member], of: &[u32], levels: u32) -> Option<f64> {
        if levels == 0 || of.len() == 1 {
            return fit_of(ctx, members, of).ok().map(|b| b.cost);
        }
        let (low, high) = halve(members, of);
        Some(cut(ctx, members, &low, levels - 1)? + cut(ctx, members, &high, levels - 1)?)
    }

    #[test]
    fn halving_looks_past_halves_that_do_not_pay() {
        let directions = Directions::new(60.0);
        let mut late = 0;
        for seed in 0..4 {
            let (bounds, triangles) = strewn(1500, 33 + seed);
            let cells = Cells::new(bounds, triangles);
            for budget in [14_000, 20_000, 26_000] {
                let ctx =
                    Context::new(&cells, &directions, &settings(budget), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
                let members = row(&ctx);
                let all: Vec<u32> = (0..members.len() as u32).collect();
                let found = cost_of(&divide(&ctx, &members, all.clone()).map_err(|e| e.1.needed).expect("feasible"));
                let cuts: Vec<Option<f64>> = (0..=4).map(|levels| cut(&ctx, &members, &all, levels)).collect();
                for (levels, cost) in cuts.iter().enumerate() {
                    let allowed = cost.map_or(f64::INFINITY, |c| c / WORTH_SPLITTING.powi(levels as i32));
                    assert!(
                        found <= allowed * (1.0 + 1e-9),
                        "seed {seed}, {budget}: {found}, {levels} levels: {allowed}"
                    );
                }
                if let [Some(whole), Some(halves), ..] = cuts[..]
                    && halves >= whole * WORTH_SPLITTING
                {
                    late += u32::from(found < whole);
                }
            }
        }
        assert!(late > 0, "where two halves do not pay, parts of them may");
    }
}
