//! Stage 3: the walk volume, where people walk. Grid points are kept only where an eye can select
//! them, so the smaller the volume, the fewer the images; what lies outside has no images, so it
//! must hold every place that people get to.
//!
//! In: the scene, its octree, a ray caster and an eye height. Out: a [`WalkVolume`] that holds
//! every eye from eye height - 0.5 m to + 0.4 m above a floor on which people walk, 0.05 m clear
//! of the next surface above; and a [`WalkReport`].
//!
//! ```text
//!   tiles    16 m squares near the scene's detail; a backdrop has none
//!     v
//!   floors   vertical lines 0.25 m apart; surfaces with head room, no cliffs, no leaves
//!     v
//!   regions  floors that steps of at most 0.5 m join
//!     v
//!   survey   rays from eyes on each region: what detail is seen from near, and whether it is inside of a solid
//!     v
//!   choose   where walking begins, and what is reached from there
//! ```
//!
//! Each line counts for its neighbours as well, so that eyes between the lines are included. Cost
//! grows with the area near detail, whatever the extent of the scene.
//!
//! A scene without any floor, an exhibit or a vehicle, is walked around on a plane at its foot.

mod choose;
mod corridor;
mod floors;
pub(crate) mod lines;
mod regions;
mod report;
mod survey;
mod tiles;

#[cfg(test)]
mod tests;

pub use corridor::Corridor;
pub use report::{Patch, RegionReport, WalkReport};

use crate::{
    octree::{Clusters, Octree},
    render::{Caster, CellSet, Ray},
};
use choose::{Verdict, area_m2};
use corridor::{Columns, Runs};
use floors::{Floor, FloorRules, TileFloors, floors_of};
use glam::{DVec2, DVec3};
use ldi_protocol::{Aabb, path, volume::ColumnRuns, volume::WalkVolume};
use lines::Raster;
use rayon::prelude::*;
use regions::Regions;
use std::collections::BTreeMap;
use survey::Seen;
use tiles::{LINES, Wanted};

/// How far below and above the nominal eye height an eye may be, metres.
pub(crate) const BELOW_M: f64 = 0.5;
/// See [`BELOW_M`].
const ABOVE_M: f64 = 0.4;
/// An eye keeps this far from the surface above it, metres.
const CLEAR_M: f64 = 0.05;
/// Distance between vertical lines, metres. Larger: doors and stairs are missed. Smaller: time and
/// memory grow with the square.
const LINE_M: f64 = 0.25;
/// Lines along each axis of a column. Smaller columns follow walls more closely at more memory;
/// the slab between floor and ceiling is what limits users, so half a metre is enough.
const LINES_PER_COLUMN: u32 = 2;
/// Height of a layer, metres.
const LAYER_M: f64 = 0.1;
/// A flying eye may be this far above the scene's box, metres.
const FLY_ABOVE_M: f64 = 1.6;
/// Eyes of the survey, over all regions: enough for one per few square metres of a building.
const SURVEYED_EYES: u32 = 3000;
/// Eyes of the survey for a region, at least.
const LEAST_EYES: u32 = 3;
/// Around a scene without floors people walk this far from it, as a share of its size, metres.
const AROUND: f64 = 0.75;
/// See [`AROUND`]: the least and the most, metres.
const AROUND_M: [f64; 2] = [4.0, 40.0];
/// Floor below this in all is none: a scene of less is walked around.
const LEAST_FLOOR_M2: f64 = 2.0;
/// A start, or a pose of a path, stands on a floor at most this far below the eye, metres, beyond
/// the eye height.
const START_SLACK_M: f64 = 1.0;
/// Regions that the report lists.
const LISTED: usize = 40;
/// Below this share of the scene's triangles seen from near where people walk, the build warns.
const LITTLE_DETAIL: f64 = 0.25;
/// A scene of which this much more is seen from floors that were left out, as a share of its
/// triangles, is warned of.
const MUCH_MORE: f64 = 0.15;

/// What the walk volume is made for.
#[derive(Debug, Clone, Default)]
pub struct WalkOptions {
    /// Eye height above floors, metres; None: flying, the whole box.
    pub eye_height_m: Option<f64>,
    /// Places where people start, eyes or feet; walking is limited to what is reached from them.
    /// None given: it is found out.
    pub starts: Vec<DVec3>,
    /// Eyes are near this path only.
    pub along: Option<Corridor>,
}

/// Why there is no walk volume. All are permanent: the same request fails again.
#[derive(Debug, thiserror::Error)]
pub enum WalkError {
    /// Nothing is there.
    #[error("no eye position: {scene} holds no surface at all")]
    Empty {
        /// Scene name.
        scene: String,
    },
    /// No floor lies below a start.
    #[error(
        "no floor below the start ({x:.2}, {y:.2}, {z:.2}): the next floor there must lie at most {below_m:.1} m below; give a place on a floor, in metres, Y up",
        x = place.x, y = place.y, z = place.z
    )]
    Start {
        /// The start.
        place: DVec3,
        /// How far below it a floor may be, metres.
        below_m: f64,
    },
    /// Nobody can stand near the path.
    #[error(
        "no eye position within {within_m} m of the path: none of its {poses} poses has a floor below it within {below_m:.1} m; the first is at ({x:.2}, {y:.2}, {z:.2}), the scene spans {low:.1} to {high:.1}; {remedy}",
        x = first.x, y = first.y, z = first.z
    )]
    NowhereAlong {
        /// Distance, metres.
        within_m: f64,
        /// Poses of the path, thinned.
        poses: usize,
        /// The first one.
        first: DVec3,
        /// How far below an eye a floor may be, metres.
        below_m: f64,
        /// Corners of the scene's box.
        low: DVec3,
        /// See `low`.
        high: DVec3,
        /// Which factor or axes would fit, or what to check.
        remedy: String,
    },
    /// The walk volume cannot be stored.
    #[error(transparent)]
    Volume(#[from] ldi_protocol::volume::VolumeError),
}

/// Finds where people walk.
///
/// Deterministic. The caster must be one of the scene's with the octree's cells.
///
/// # Errors
/// [`WalkError`]: an empty scene, a start or a path without a floor below it, or more walkable
/// area than can be stored.
pub fn walk_volume(
    caster: &Caster,
    clusters: &Clusters,
    octree: &Octree,
    options: &WalkOptions,
) -> Result<(WalkVolume, WalkReport), WalkError> {
    let scene = caster.scene();
    let bounds = octree.cells.iter().fold(Aabb::EMPTY, |b, c| b.union(c.bounds));
    if bounds.is_empty() {
        return Err(WalkError::Empty { scene: scene.name.clone() });
    }
    let Some(eye_height_m) = options.eye_height_m else {
        let mut b = bounds;
        b.max.y += FLY_ABOVE_M;
        return Ok((WalkVolume::of_box(&b)?, WalkReport::default()));
    };
    let site = Site { caster, clusters, octree, bounds, eye_height_m };
    let mut found = site.ground(options, false)?;
    if options.starts.is_empty() && options.along.is_none() && found.area_m2() < LEAST_FLOOR_M2 {
        found = site.around(options)?;
    }
    let (volume, cut) = found.volume(&site, options)?;
    Ok((volume, found.report(&site, cut)))
}

/// The part of a scene's box around where people walk, over all heights.
pub fn surroundings(volume: &WalkVolume, scene: &Aabb) -> Aabb {
    const AROUND_M: f64 = 3.0;
    let walked = volume.boxes().fold(Aabb::EMPTY, |all, b| all.union(b)).inflated(AROUND_M);
    let (low, high) = (walked.min.max(scene.min), walked.max.min(scene.max));
    Aabb { min: low.with_y(scene.min.y), max: high.with_y(scene.max.y) }
}

/// What every step looks at.
struct Site<'a> {
    caster: &'a Caster,
    clusters: &'a Clusters,
    octree: &'a Octree,
    bounds: Aabb,
    eye_height_m: f64,
}

/// Regions, and what became of them.
struct Ground {
    raster: Raster,
    all: Regions,
    seen: BTreeMap<u32, Seen>,
    verdicts: Vec<Verdict>,
    /// Cells seen from near where people walk, ascending.
    known: Vec<u32>,
    /// The scene's foot, metres.
    foot_m: f64,
    /// Tiles that were not searched because there would be too many.
    left_out_tiles: usize,
    /// Poses of the path without a floor.
    floating: Vec<(usize, DVec3)>,
    /// There is no floor: a plane at the scene's foot stands in.
    is_around: bool,
}

impl Site<'_> {
    fn raster(&self, margin_m: f64) -> Raster {
        let size = self.bounds.size() + 2.0 * margin_m;
        // Whole columns, so that a column's lines are all there.
        let column_m = LINE_M * f64::from(LINES_PER_COLUMN);
        let count = |s: f64| ((s / column_m).floor() as u32 + 1) * LINES_PER_COLUMN;
        let origin = DVec2::new(self.bounds.min.x, self.bounds.min.z) - margin_m;
        Raster { origin, pitch_m: LINE_M, size: [count(size.x), count(size.z)] }
    }

    /// Finds the scene's own floors, and where people walk on them.
    fn ground(&self, options: &WalkOptions, masks_are_solid: bool) -> Result<Ground, WalkError> {
        let raster = self.raster(0.0);
        let rules = self.rules(masks_are_solid, false);
        let starts: Vec<DVec3> = options.starts.iter().chain(&self.caster.scene().viewpoints).copied().collect();
        let wanted = match &options.along {
            Some(path) => Wanted::Near { places: path.eyes(), within_m: path.within_m() + 2.0 },
            None => Wanted::Detail { starts: &starts },
        };
        let (all, left_out_tiles, turned) = self.regions(&raster, wanted, &rules);
        if all.regions.is_empty() && !masks_are_solid {
            // Some exporters call every material masked.
            return self.ground(options, true);
        }
        let below_m = self.eye_height_m + START_SLACK_M;
        let mut starts = Vec::new();
        for place in &options.starts {
            let region = below(&all, &raster, place - DVec3::Y * rules.foot_m, below_m);
            starts.push(region.ok_or(WalkError::Start { place: *place, below_m })?);
        }
        let mut floating = Vec::new();
        if let Some(along) = &options.along {
            for (number, eye) in along.eyes().iter().enumerate() {
                match below(&all, &raster, eye - DVec3::Y * rules.foot_m, below_m) {
                    Some(region) => starts.push(region),
                    None => floating.push((number, *eye)),
                }
            }
            if starts.is_empty() {
                return Err(WalkError::NowhereAlong {
                    within_m: along.within_m(),
                    poses: along.eyes().len(),
                    first: along.eyes().first().copied().unwrap_or_default(),
                    below_m,
                    low: self.bounds.min,
                    high: self.bounds.max,
                    remedy: path::misfit(along.eyes(), &self.bounds, None)
                        .unwrap_or_else(|| "check that path and scene have the same unit and up axis".into()),
                });
            }
            starts.sort_unstable();
            starts.dedup();
        }
        Ok(Ground { left_out_tiles, floating, ..self.chosen(raster, (all, turned), &starts, rules.foot_m) })
    }

    /// Finds where people walk around a scene without floors.
    fn around(&self, options: &WalkOptions) -> Result<Ground, WalkError> {
        let margin = (self.bounds.size().max_element() * AROUND).clamp(AROUND_M[0], AROUND_M[1]);
        let raster = self.raster(margin);
        let rules = self.rules(true, true);
        let corners = self.bounds.inflated(margin).corners();
        let wanted = Wanted::Near { places: &corners, within_m: self.bounds.size().max_element() + 2.0 * margin };
        let (all, left_out_tiles, turned) = self.regions(&raster, wanted, &rules);
        debug_assert!(options.starts.is_empty(), "people walk around it where nobody says otherwise");
        Ok(Ground { left_out_tiles, is_around: true, ..self.chosen(raster, (all, turned), &[], rules.foot_m) })
    }

    fn rules(&self, masks_are_solid: bool, ground: bool) -> FloorRules {
        let head_room_m = self.eye_height_m + CLEAR_M;
        FloorRules { foot_m: self.bounds.min.y, head_room_m, masks_are_solid, ground }
    }

    fn regions(&self, raster: &Raster, wanted: Wanted<'_>, rules: &FloorRules) -> (Regions, usize, bool) {
        let scene = self.caster.scene();
        let (tiles, left_out) = tiles::tiles(scene, self.clusters, self.octree, raster, wanted);
        let floors: Vec<TileFloors> =
            tiles.par_iter().map(|t| floors_of(scene, self.clusters, raster, t, rules)).collect();
        // Where the sky sees backs, and more spaces look like solids than like rooms, the file's
        // faces are turned.
        let sums = |of: fn(&TileFloors) -> [u32; 2]| {
            floors.iter().fold([0u64; 2], |sum, t| [0, 1].map(|k| sum[k] + u64::from(of(t)[k])))
        };
        let ([fronts, backs], [rooms, solids]) = (sums(|t| t.tops), sums(|t| t.spaces));
        let turned = backs > fronts && solids > rooms;
        let is_open = |from: [u32; 2], to: [u32; 2], y_m: f32| {
            let at = |[i, k]: [u32; 2]| {
                let line = raster.line(i, k);
                DVec3::new(line.x, rules.foot_m + f64::from(y_m), line.y)
            };
            let ray = Ray { origin: at(from), direction: at(to) - at(from), t_min: 0.0, t_max: 1.0 };
            !self.caster.occluded(&ray, &CellSet::all())
        };
        let floors = floors.into_iter().map(|t| t.without_insides(turned)).collect();
        (Regions::of(floors, &is_open), left_out, turned)
    }

    /// Surveys regions and chooses among them.
    fn chosen(&self, raster: Raster, (all, turned): (Regions, bool), starts: &[u32], foot_m: f64) -> Ground {
        let eyes = self.eyes(&raster, &all, starts, foot_m);
        let triangles = |cell: u32| u64::from(self.octree.cells[cell as usize].triangles);
        let seen: BTreeMap<u32, Seen> = survey::survey(self.caster, &eyes, turned, &triangles).into_iter().collect();
        for (region, s) in &seen {
            tracing::debug!(region, figures = ?all.regions[*region as usize], met = ?s.met, level = s.level, "region");
        }
        let below_m = self.eye_height_m + START_SLACK_M;
        let stands_in = |place: &DVec3| below(&all, &raster, place - DVec3::Y * foot_m, below_m);
        let viewpoints: Vec<u32> = self.caster.scene().viewpoints.iter().filter_map(stands_in).collect();
        let (verdicts, known) = choose::choose(&all, &seen, (starts, &viewpoints), &raster, &triangles);
        Ground { raster, all, seen, verdicts, known, foot_m, left_out_tiles: 0, floating: Vec::new(), is_around: false }
    }

    /// Eyes spread over every region that people may walk in, by region.
    fn eyes(&self, raster: &Raster, all: &Regions, starts: &[u32], foot_m: f64) -> Vec<(u32, DVec3)> {
        let fit: Vec<bool> = (0..all.regions.len() as u32)
            .map(|r| {
                matches!(choose::unfit(all, r, raster), None | Some(Verdict::Roof | Verdict::Ceiling))
                    || starts.contains(&r)
            })
            .collect();
        let lines: u32 = all.regions.iter().zip(&fit).filter(|(_, fit)| **fit).map(|(r, _)| r.lines).sum();
        let every = (lines / SURVEYED_EYES).max(1);
        let mut met = vec![0u32; all.regions.len()];
        let mut eyes = Vec::new();
        for (tile, floor, region) in all.floors() {
            if !fit[region as usize] {
                continue;
            }
            let step = every.min(all.regions[region as usize].lines / LEAST_EYES).max(1);
            let n = &mut met[region as usize];
            if *n % step == step / 2 {
                let at = line_of(tile.place, floor, raster);
                eyes.push((region, DVec3::new(at.x, foot_m + f64::from(floor.y_m) + self.eye_height_m, at.y)));
            }
            *n += 1;
        }
        eyes.sort_by_key(|e| e.0);
        eyes
    }
}

/// Where the line of a floor stands: (x, z).
fn line_of(tile: [u32; 2], floor: &Floor, raster: &Raster) -> DVec2 {
    let [i, k] = place_of(tile, floor);
    raster.line(i, k)
}

/// The place of a floor's line in the raster.
fn place_of(tile: [u32; 2], floor: &Floor) -> [u32; 2] {
    let line = u32::from(floor.line);
    [tile[0] * LINES + line % LINES, tile[1] * LINES + line / LINES]
}

/// The region of the highest floor below a place (heights above the scene's foot), on its line or
/// one beside it.
fn below(all: &Regions, raster: &Raster, place: DVec3, below_m: f64) -> Option<u32> {
    let at = ((DVec2::new(place.x, place.z) - raster.origin) / raster.pitch_m).floor();
    let mut best: Option<(f32, u32, u32)> = None;
    for (dk, di) in [(0, 0), (0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)] {
        let (i, k) = (at.x + f64::from(di), at.y + f64::from(dk));
        if i < 0.0 || k < 0.0 {
            continue;
        }
        for (floor, region) in all.at([i as u32, k as u32]) {
            let fall = place.y - f64::from(floor.y_m);
            // A place may be given at the floor itself.
            if !(-0.1..=below_m).contains(&fall) {
                continue;
            }
            // The line's own floor first; of others the one in the largest region.
            let lines = if (di, dk) == (0, 0) { u32::MAX } else { all.regions[region as usize].lines };
            if best.is_none_or(|(y, n, _)| (lines, floor.y_m) > (n, y)) {
                best = Some((floor.y_m, lines, region));
            }
        }
    }
    best.map(|b| b.2)
}

impl Ground {
    fn is_kept(&self, region: u32) -> bool {
        self.verdicts[region as usize].is_kept()
    }

    /// Floor on which people walk, m².
    fn area_m2(&self) -> f64 {
        let kept = self.all.regions.iter().zip(0..).filter(|(_, r)| self.is_kept(*r));
        area_m2(kept.map(|(r, _)| r.lines).sum(), &self.raster)
    }

    /// The volume over the kept floors, and how many runs lie too far from the path.
    fn volume(&self, site: &Site<'_>, options: &WalkOptions) -> Result<(WalkVolume, u64), WalkError> {
        let column_m = LINE_M * f64::from(LINES_PER_COLUMN);
        let count = self.raster.size.map(|n| n / LINES_PER_COLUMN);
        let height = site.bounds.size().y + site.eye_height_m + 2.0;
        // One layer of slack below the lowest possible eye, and layers thick enough that 16 bits
        // count them.
        let origin_y = self.foot_m + site.eye_height_m - BELOW_M - LAYER_M;
        let origin = DVec3::new(self.raster.origin.x, origin_y, self.raster.origin.y);
        let layer_m = LAYER_M.max(height / 60_000.0);
        let mut runs = Runs::default();
        for (tile, floor, region) in self.all.floors() {
            if self.is_kept(region) {
                self.add_floor(&mut runs, place_of(tile.place, floor), floor, site, count, |y| {
                    (y - origin.y) / layer_m
                });
            }
        }
        let mut cut = 0;
        if let Some(path) = &options.along {
            cut = path.cut(&mut runs, &Columns { origin, pitch_m: column_m, layer_m, count });
        }
        let mut columns: Vec<ColumnRuns> = runs.into_iter().map(|(place, runs)| ColumnRuns { place, runs }).collect();
        columns.sort_unstable_by_key(|c| (c.place[1], c.place[0]));
        let mut limits = site.bounds;
        if self.is_around {
            let [x, z] = [0, 1].map(|axis| f64::from(self.raster.size[axis]) * self.raster.pitch_m);
            limits = Aabb { min: origin, max: origin + DVec3::new(x, 0.0, z) };
        }
        Ok((WalkVolume::of_columns(origin, column_m, layer_m, count, columns, &limits)?, cut))
    }

    /// Adds the eyes above a floor to the columns around its line: the line counts for the ones
    /// beside it too.
    fn add_floor(
        &self,
        runs: &mut Runs,
        [i, k]: [u32; 2],
        floor: &Floor,
        site: &Site<'_>,
        count: [u32; 2],
        layer: impl Fn(f64) -> f64,
    ) {
        let low = self.foot_m + f64::from(floor.y_m) + site.eye_height_m - BELOW_M;
        let high = (low + BELOW_M + ABOVE_M).min(self.foot_m + f64::from(floor.above_m) - CLEAR_M);
        let run = [layer(low).floor() as u16, layer(high).ceil() as u16];
        let around =
            |line: u32, n: u32| line.saturating_sub(1) / LINES_PER_COLUMN..=((line + 1) / LINES_PER_COLUMN).min(n - 1);
        for k in around(k, count[1]) {
            for i in around(i, count[0]) {
                add_run(runs.entry([i, k]).or_default(), run);
            }
        }
    }

    fn report(&self, site: &Site<'_>, cut: u64) -> WalkReport {
        let total: u64 = site.octree.cells.iter().map(|c| u64::from(c.triangles)).sum();
        let share = |cells: &[u32]| {
            let seen: u64 = cells.iter().map(|c| u64::from(site.octree.cells[*c as usize].triangles)).sum();
            seen as f64 / total.max(1) as f64
        };
        // Roofs, ceilings and solids show much, and nobody misses it.
        let may_walk = |r: &u32| self.is_kept(*r) || self.verdicts[*r as usize] == Verdict::Apart;
        let seen = self.seen.iter().filter(|(r, _)| may_walk(r));
        let mut everything: Vec<u32> = seen.flat_map(|(_, s)| s.cells.iter().copied()).collect();
        everything.sort_unstable();
        everything.dedup();
        let mut report = WalkReport {
            detail: share(&self.known),
            detail_from_anywhere: share(&everything),
            floating: self.floating.iter().take(8).map(|(n, p)| (*n, p.to_array())).collect(),
            floating_total: self.floating.len(),
            ..WalkReport::default()
        };
        for (region, verdict) in self.all.regions.iter().zip(&self.verdicts) {
            *report.area_m2.entry(verdict.words().into()).or_default() += area_m2(region.lines, &self.raster);
        }
        let mut listed: Vec<u32> = (0..self.all.regions.len() as u32).collect();
        listed.sort_by_key(|r| (!self.is_kept(*r), std::cmp::Reverse(self.all.regions[*r as usize].lines), *r));
        let kept = listed.iter().filter(|r| self.is_kept(**r)).count();
        // Half of the list at least is for what was left out.
        let listed: Vec<u32> =
            listed[..kept].iter().take(LISTED / 2).chain(listed[kept..].iter().take(LISTED / 2)).copied().collect();
        report.regions = self.described(&listed, &share);
        self.warn(&mut report, site, cut);
        report
    }

    /// The regions of a list, in its order.
    fn described(&self, listed: &[u32], share: &dyn Fn(&[u32]) -> f64) -> Vec<RegionReport> {
        let number: BTreeMap<u32, usize> = listed.iter().copied().zip(0..).collect();
        let mut out: Vec<RegionReport> = listed
            .iter()
            .map(|r| {
                let verdict = self.verdicts[*r as usize];
                RegionReport {
                    kept: verdict.is_kept(),
                    why: verdict.words().into(),
                    area_m2: area_m2(self.all.regions[*r as usize].lines, &self.raster),
                    heights_m: [f64::INFINITY, f64::NEG_INFINITY],
                    place: [0.0; 3],
                    detail: self.seen.get(r).map_or(0.0, |s| share(&s.cells)),
                    patches: Vec::new(),
                }
            })
            .collect();
        let mut met = vec![0u32; out.len()];
        for (tile, floor, region) in self.all.floors() {
            let Some(&n) = number.get(&region) else { continue };
            let (at, y) = (line_of(tile.place, floor, &self.raster), self.foot_m + f64::from(floor.y_m));
            let r = &mut out[n];
            r.heights_m = [r.heights_m[0].min(y), r.heights_m[1].max(y)];
            // The one in the middle of the order stands for the region.
            if met[n] <= self.all.regions[region as usize].lines / 2 {
                r.place = [at.x, y, at.y];
            }
            met[n] += 1;
        }
        let left_out: Vec<bool> = out.iter().map(|r| !r.kept).collect();
        for (n, patch) in self.patches(&number, &left_out) {
            out[n].patches.push(patch);
        }
        out
    }

    /// Floor of the listed regions that `wanted` marks, in rows of a metre: what the volume itself
    /// does not show.
    fn patches(&self, number: &BTreeMap<u32, usize>, wanted: &[bool]) -> Vec<(usize, Patch)> {
        const PER_PATCH: u32 = 4;
        let mut squares: BTreeMap<(usize, u32, u32), f32> = BTreeMap::new();
        for (tile, floor, region) in self.all.floors() {
            let Some(&n) = number.get(&region).filter(|n| wanted[**n]) else { continue };
            let [i, k] = place_of(tile.place, floor).map(|p| p / PER_PATCH);
            squares.entry((n, k, i)).or_insert(floor.y_m);
        }
        let edge = self.raster.pitch_m * f64::from(PER_PATCH);
        let mut out: Vec<(usize, Patch)> = Vec::new();
        let mut last: Option<(usize, u32, u32)> = None;
        for ((n, k, i), y) in squares {
            let x = (self.raster.origin.x + f64::from(i) * edge) as f32;
            let z = (self.raster.origin.y + f64::from(k) * edge) as f32;
            match out.last_mut() {
                Some((_, patch)) if last == Some((n, k, i.wrapping_sub(1))) => patch[1] = x + edge as f32,
                _ => out.push((n, [x, x + edge as f32, z, z + edge as f32, self.foot_m as f32 + y])),
            }
            last = Some((n, k, i));
        }
        out
    }

    /// What a user should know and can change.
    fn warn(&self, report: &mut WalkReport, site: &Site<'_>, cut: u64) {
        if self.is_around {
            report.warnings.push(
                "the scene has no floor to walk on: people walk around it on a plane at its foot; --fly lets them go anywhere".into(),
            );
        }
        if self.left_out_tiles > 0 {
            let edge = f64::from(LINES) * LINE_M;
            let area_km2 = self.left_out_tiles as f64 * edge * edge * 1e-6;
            report.unsearched = Some(format!("{area_km2:.2} km² with the least detail were not searched for floors"));
            report.warnings.push(format!(
                "{area_km2:.2} km² with the least detail were not searched for places to walk; --start X,Y,Z searches around a place"
            ));
        }
        if report.floating_total > 0 {
            let (number, [x, y, z]) = report.floating[0];
            report.warnings.push(format!(
                "{} of the path's places have no floor within {:.1} m below them: nobody stands there, so no image is made for them; the first is number {number} at ({x:.2}, {y:.2}, {z:.2})",
                report.floating_total,
                site.eye_height_m + START_SLACK_M,
            ));
        }
        if cut == 0 && report.floating_total == 0 && !self.is_around {
            if report.detail_from_anywhere - report.detail > MUCH_MORE {
                let best = report
                    .regions
                    .iter()
                    .filter(|r| r.why == Verdict::Apart.words())
                    .max_by(|a, b| a.detail.total_cmp(&b.detail));
                let place = best.map_or(String::new(), |r| {
                    let [x, y, z] = r.place;
                    format!("; the largest such place is {} at ({x:.1}, {y:.1}, {z:.1}): {}", m2(r.area_m2), r.why)
                });
                report.warnings.push(format!(
                    "{:.0}% of the scene's triangles are seen from near only from floors on which nobody walks{place}; --start X,Y,Z lets people walk from a place",
                    (report.detail_from_anywhere - report.detail) * 100.0
                ));
            }
            if report.detail < LITTLE_DETAIL {
                report.warnings.push(format!(
                    "only {:.0}% of the scene's triangles are seen from near where people walk; look at `ldi-server inspect DATASET --plan plan.svg`, and give --start X,Y,Z or --fly if that is wrong",
                    report.detail * 100.0
                ));
            }
        }
    }
}

/// An area in words.
fn m2(area: f64) -> String {
    if area < 10.0 { format!("{area:.1} m²") } else { format!("{area:.0} m²") }
}

/// Adds a run to a sorted, disjoint list, joining what touches.
fn add_run(runs: &mut Vec<[u16; 2]>, mut run: [u16; 2]) {
    let from = runs.partition_point(|r| r[1] < run[0]);
    let to = runs.partition_point(|r| r[0] <= run[1]);
    if from < to {
        run = [run[0].min(runs[from][0]), run[1].max(runs[to - 1][1])];
    }
    runs.splice(from..to, [run]);
}
