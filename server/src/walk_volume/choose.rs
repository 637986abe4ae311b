//! Which regions people walk in.
//!
//! In: regions with their figures, what is seen from near each, and where people start. Out: per
//! region why it is kept or left out.
//!
//! 1. Some are nowhere to walk in themselves: too small, tops of furniture, above ceilings, roofs,
//!    the inside of solids.
//! 2. Walking begins where people start, or else in the region from which most detail is seen from
//!    near, amid it.
//! 3. From there people get to what lies beyond a thin obstacle at the same level, a closed door,
//!    a threshold, a terrace, and up a long ledge: a platform.
//! 4. Without given starts, walking begins again in the region that adds most to the detail seen,
//!    as long as that is [`LEAST_GAIN`] of all: another building. Then in large regions that see
//!    detail too: another storey. Last where cameras and spawn points of the file stand.

use super::{lines::Raster, regions::Regions, survey::Seen};
use std::collections::BTreeMap;

/// Smallest region, m²: less is no place to walk about in.
const LEAST_M2: f64 = 1.0;
/// A region with more sides of its lines on its border than this, per line, is too rough: pipes,
/// rubble, leaves. A passage of three lines has two thirds.
const ROUGH: f64 = 1.0;
/// Smallest region that walking begins again in, m². Smaller: ducts and shelves with a view.
const LEAST_BEGIN_M2: f64 = 4.0;
/// Regions smaller than this, m², count less as the first to walk in, by their area: the top of a
/// wall or a cupboard sees as much as the hall around it.
const ROOM_M2: f64 = 25.0;
/// A region below this with a border that falls to a floor just below is the top of furniture, m².
const FURNITURE_M2: f64 = 8.0;
/// Share of a border that falls, above which a region is a top: the rest may stand at a wall.
const FALLING: f64 = 0.4;
/// A region is a roof when this share of it lies under the sky and above another floor.
const ROOF_SHARE: f64 = 0.7;
/// A region is the upper side of a ceiling when this share of it is a thin sheet over a room, and
/// a void when this share is low.
const SHEET_SHARE: f64 = 0.8;
/// Least share of all detail that a region must add for walking to begin in it again.
const LEAST_GAIN: f64 = 0.01;
/// The same for a region under the sky: a plain below a town is not walked on for the bridge above
/// it.
const LEAST_GAIN_OPEN: f64 = 0.1;
/// Walking begins in a region of this share of the largest one's area even if it adds nothing to
/// the detail seen.
const LARGE: f64 = 0.25;
/// A region with this share of its floor under the sky is no storey of a building.
const OPEN: f64 = 0.5;
/// An opening is at least so many lines wide: half a metre.
const DOOR_LINES: u32 = 2;
/// A ledge is at least so many sides of lines long, counted from above and from below: two metres.
/// Less is a chair before a table.
const LEDGE_SIDES: u32 = 16;

/// What becomes of a region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Verdict {
    /// People start here.
    Start,
    /// A camera or spawn point of the file stands here.
    Viewpoint,
    /// Most detail is seen from here.
    MostDetail,
    /// Beyond a thin obstacle from a place where people walk.
    Beyond,
    /// Detail is seen from here that is seen from nowhere else.
    MoreDetail,
    /// As large as others where people walk.
    Storey,
    /// Too small, or too rough.
    Small,
    /// The top of furniture.
    Furniture,
    /// Upper side of a ceiling, or a void.
    Ceiling,
    /// A roof.
    Roof,
    /// Inside of a solid.
    Solid,
    /// Nobody gets there, and it shows nothing more.
    Apart,
}

impl Verdict {
    /// Whether people walk there.
    pub fn is_kept(self) -> bool {
        matches!(
            self,
            Self::Start | Self::Viewpoint | Self::MostDetail | Self::Beyond | Self::MoreDetail | Self::Storey
        )
    }

    /// In words, for reports.
    pub fn words(self) -> &'static str {
        match self {
            Self::Start => "people start here",
            Self::Viewpoint => "a camera or spawn point of the file stands here",
            Self::MostDetail => "most of the scene's detail is seen from here",
            Self::Beyond => "beside a place where people walk",
            Self::MoreDetail => "shows detail that no other place shows",
            Self::Storey => "as large as other places where people walk",
            Self::Small => "too small or rough to walk on",
            Self::Furniture => "top of furniture",
            Self::Ceiling => "above a ceiling, or too low to walk upright",
            Self::Roof => "roof",
            Self::Solid => "inside of a solid",
            Self::Apart => "not reached from where people walk, and shows nothing more",
        }
    }
}

/// Area of a number of lines, m².
pub(super) fn area_m2(lines: u32, raster: &Raster) -> f64 {
    f64::from(lines) * raster.pitch_m * raster.pitch_m
}

/// The first verdict, from a region's own figures; None: people may walk there.
pub(super) fn unfit(all: &Regions, region: u32, raster: &Raster) -> Option<Verdict> {
    let r = &all.regions[region as usize];
    let (area, share) = (area_m2(r.lines, raster), |n: u32, of: u32| f64::from(n) / f64::from(of.max(1)));
    if area < LEAST_M2 || share(r.border, r.lines) > ROUGH {
        Some(Verdict::Small)
    } else if area < FURNITURE_M2 && share(r.low_falls, r.border) > FALLING {
        Some(Verdict::Furniture)
    } else if share(r.sheets, r.lines) > SHEET_SHARE || share(r.low, r.lines) > SHEET_SHARE {
        Some(Verdict::Ceiling)
    } else if share(r.over_another, r.lines) > ROOF_SHARE {
        Some(Verdict::Roof)
    } else {
        None
    }
}

/// The verdict on every region. `seen`: of those that were surveyed; `starts`: regions where people
/// start; `viewpoints`: regions where cameras of the file stand; `triangles`: of a cell.
/// Also what is seen from the regions that are kept: cells, ascending.
pub(super) fn choose(
    all: &Regions,
    seen: &BTreeMap<u32, Seen>,
    (starts, viewpoints): (&[u32], &[u32]),
    raster: &Raster,
    triangles: &dyn Fn(u32) -> u64,
) -> (Vec<Verdict>, Vec<u32>) {
    let mut verdicts: Vec<Verdict> =
        (0..all.regions.len() as u32).map(|r| unfit(all, r, raster).unwrap_or(Verdict::Apart)).collect();
    let detail = |r: u32| seen.get(&r).map_or(0, |s| s.cells.iter().map(|c| triangles(*c)).sum::<u64>());
    let mut order: Vec<u32> = (0..all.regions.len() as u32).filter(|r| seen.contains_key(r)).collect();
    // Of regions that see as much, as a street and the plain around it, the one amid it first.
    let amid = |r: u32| seen.get(&r).map_or(0.0, |s| s.sightings as f64 / f64::from(s.eyes.max(1)));
    let roomy = |r: u32| (area_m2(all.regions[r as usize].lines, raster) / ROOM_M2).min(1.0);
    let rank = |r: u32| detail(r) as f64 * amid(r) * roomy(r);
    order.sort_by(|a, b| rank(*b).total_cmp(&rank(*a)).then(a.cmp(b)));
    for r in &order {
        let region = &all.regions[*r as usize];
        let on_back = f64::from(region.backs) > 0.8 * f64::from(region.lines);
        if verdicts[*r as usize] != Verdict::Small && !is_open(all, *r, 0.1) && seen[r].is_inside_a_solid(on_back) {
            verdicts[*r as usize] = Verdict::Solid;
        }
    }
    let mut known: Vec<u32> = Vec::new();
    let begin = |verdicts: &mut Vec<Verdict>, known: &mut Vec<u32>, region: u32, verdict: Verdict| {
        verdicts[region as usize] = verdict;
        let mut left = vec![region];
        while let Some(r) = left.pop() {
            known.extend(seen.get(&r).into_iter().flat_map(|s| &s.cells));
            for other in beyond(all, r) {
                let there = &mut verdicts[other as usize];
                if matches!(there, Verdict::Apart | Verdict::Roof) {
                    *there = Verdict::Beyond;
                    left.push(other);
                }
            }
        }
        known.sort_unstable();
        known.dedup();
    };
    for start in starts {
        if !verdicts[*start as usize].is_kept() || verdicts[*start as usize] == Verdict::Beyond {
            begin(&mut verdicts, &mut known, *start, Verdict::Start);
        }
    }
    if !starts.is_empty() {
        return (verdicts, known);
    }
    let everything: u64 = {
        let mut cells: Vec<u32> = seen.values().flat_map(|s| s.cells.iter().copied()).collect();
        cells.sort_unstable();
        cells.dedup();
        cells.into_iter().map(triangles).sum()
    };
    loop {
        let first = known.is_empty();
        let gain = |r: u32| -> u64 {
            seen[&r].cells.iter().filter(|c| known.binary_search(c).is_err()).map(|c| triangles(*c)).sum()
        };
        let open = order.iter().copied().filter(|r| verdicts[*r as usize] == Verdict::Apart);
        let large = open.filter(|r| first || area_m2(all.regions[*r as usize].lines, raster) >= LEAST_BEGIN_M2);
        let is_worth = |gain: u64, r: u32| {
            let least = if is_open(all, r, OPEN) { LEAST_GAIN_OPEN } else { LEAST_GAIN };
            first || gain as f64 >= (least * everything as f64).max(1.0)
        };
        let worth = large.map(|r| (gain(r), r)).filter(|(gain, r)| is_worth(*gain, *r));
        // The first one by rank.
        let best =
            if first { worth.min_by_key(|_| 0) } else { worth.max_by_key(|(gain, r)| (*gain, std::cmp::Reverse(*r))) };
        match best {
            Some((_, r)) => {
                let verdict = if first { Verdict::MostDetail } else { Verdict::MoreDetail };
                begin(&mut verdicts, &mut known, r, verdict);
                if first && known.is_empty() {
                    // Nothing is seen from near anywhere: all that is left is as good.
                    verdicts.iter_mut().filter(|v| **v == Verdict::Apart).for_each(|v| *v = Verdict::MoreDetail);
                    return (verdicts, known);
                }
            }
            _ => break,
        }
    }
    let largest = verdicts.iter().zip(&all.regions).filter(|(v, _)| v.is_kept()).map(|(_, r)| r.lines).max();
    for r in order {
        let is_large = f64::from(all.regions[r as usize].lines) >= LARGE * f64::from(largest.unwrap_or(0));
        let sees = detail(r) as f64 >= LEAST_GAIN * everything as f64;
        // A canal or a sea beside a town is large, too.
        let is_covered = !is_open(all, r, OPEN);
        if verdicts[r as usize] == Verdict::Apart && is_large && sees && is_covered {
            begin(&mut verdicts, &mut known, r, Verdict::Storey);
        }
    }
    for r in viewpoints {
        // A camera on a table or among pipes is for a picture, and names no place to walk.
        if matches!(verdicts[*r as usize], Verdict::Apart | Verdict::Roof) {
            begin(&mut verdicts, &mut known, *r, Verdict::Viewpoint);
        }
    }
    (verdicts, known)
}

/// Whether at least this share of a region lies under the sky.
fn is_open(all: &Regions, region: u32, share: f64) -> bool {
    let region = &all.regions[region as usize];
    f64::from(region.sky) >= share * f64::from(region.lines)
}

/// Regions beyond a thin obstacle, or up or down a long ledge.
fn beyond(all: &Regions, region: u32) -> Vec<u32> {
    let other = |&(a, b): &(u32, u32)| match (a == region, b == region) {
        (true, _) => Some(b),
        (_, true) => Some(a),
        _ => None,
    };
    let long = |pairs: &BTreeMap<(u32, u32), u32>, least: u32| -> Vec<u32> {
        pairs.iter().filter(|(_, lines)| **lines >= least).filter_map(|(pair, _)| other(pair)).collect()
    };
    [long(&all.doors, DOOR_LINES), long(&all.ledges, LEDGE_SIDES)].concat()
}
