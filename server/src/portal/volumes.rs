//! Cells as parts of space, made of basins: who is above whom, and what lies within walls and
//! floors.
//!
//! In: storeys with a label per place. Out: [`Volumes`]: per place of the plan a stack of
//! [`Run`]s, everything else being outside; boxes that hold the same; and [`hatches`], the
//! horizontal openings between what is stacked.
//!
//! ```text
//!    y │ outside          a wall's places take the label of the nearest room: borders run in the middle of walls
//!      ├──────────  roof
//!      │ cell 3           borders between storeys run below the upper floor, or along the top of what the upper storey only sees
//!      ├──────────  slab  (the roof of a wing)
//!      │ cell 1
//!      └──────────
//! ```

use super::hull::hull;
use super::storeys::{Ground, Storey};
use glam::{DVec2, DVec3};
use ldi_protocol::Aabb;
use ldi_protocol::rooms::{Cell, CellId, Portal, PortalKind};
use std::collections::BTreeMap;

/// Nothing known.
pub(super) const UNKNOWN: u32 = u32::MAX;
/// The outside.
pub(super) const OUTSIDE: u32 = u32::MAX - 1;

/// How deep labels reach into walls, metres: half of the thickest wall.
const INTO_WALLS_M: f64 = 0.6;
/// Surfaces at least this far above the floor are ceilings, metres.
const CEILING_M: f64 = 1.95;
/// Thickest slab between storeys that counts as one, metres.
const SLAB_M: f64 = 0.6;
/// A surface so near the upper storey's floor is that floor, metres, whether somebody can stand on
/// it or something stands on it.
const SAME_FLOOR_M: f64 = 0.1;
/// How far a border lies within a slab, metres.
const INTO_SLAB_M: f64 = 0.05;
/// Height of a room without ceiling and walls, metres.
const OPEN_ROOM_M: f64 = 2.4;
/// A room is without ceiling if this share of it is.
const OPEN_SHARE: f64 = 0.5;
/// Boxes whose heights differ by less are joined, metres; below the margin of the rooms.
const JOIN_M: f32 = 0.08;
/// Smallest hatch, m²: smaller ones are noise of the lines or found by rays.
const SMALLEST_HATCH_M2: f64 = 0.05;

pub(super) fn id(label: u32) -> CellId {
    (label < OUTSIDE).then_some(label)
}

/// A part of a place's vertical line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Run {
    pub low_m: f32,
    pub high_m: f32,
    pub label: u32,
}

/// Labels of all of space.
pub(super) struct Volumes {
    first: Vec<u32>,
    runs: Vec<Run>,
}

/// An open border between what is stacked at a place.
#[derive(Clone, Copy)]
struct Well {
    place: usize,
    below: u32,
    above: u32,
    y_m: f32,
}

/// Spreads labels into walls: every place within reach takes the label that comes first, step by
/// step.
pub(super) fn fill(ground: &Ground, label: &mut [u32]) {
    let mut front: Vec<usize> = (0..label.len()).filter(|p| label[*p] != UNKNOWN).collect();
    for _ in 0..(INTO_WALLS_M / ground.raster.pitch_m).ceil() as usize {
        let mut next = Vec::new();
        for p in front {
            for (q, ..) in ground.neighbours(p) {
                if label[q] == UNKNOWN {
                    label[q] = label[p];
                    next.push(q);
                }
            }
        }
        front = next;
    }
}

/// Heights of the cells, from the surfaces above their floors.
struct Heights {
    /// Lowest floor.
    floor_m: Vec<f64>,
    /// Where a room without a ceiling ends; None where it has one.
    open_top_m: Vec<Option<f64>>,
    /// Highest top that counts.
    cap_m: Vec<f64>,
}

/// A storey with its labels, before and after [`fill`].
pub(super) struct Labelled<'a> {
    pub storey: &'a Storey,
    pub free: &'a [u32],
    pub filled: &'a [u32],
}

impl Labelled<'_> {
    fn floor_m(&self, place: usize) -> f64 {
        let y = f64::from(self.storey.floor_m[place]);
        if y.is_nan() { self.storey.base_m } else { y }
    }
}

fn percentile(values: &mut [f64], share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(((values.len().max(1) - 1) as f64 * share) as usize).copied()
}

fn heights(ground: &Ground, storeys: &[Labelled], cells: usize) -> Heights {
    let mut h = Heights { floor_m: vec![f64::INFINITY; cells], open_top_m: vec![None; cells], cap_m: vec![0.0; cells] };
    let mut tops = vec![Vec::new(); cells];
    let mut walls = vec![Vec::new(); cells];
    let mut counts = vec![[0u32; 2]; cells];
    for s in storeys {
        for p in 0..ground.places() {
            let (free, label) = (s.free[p], s.filled[p]);
            if label >= OUTSIDE {
                continue;
            }
            let c = label as usize;
            let floor = s.floor_m(p);
            let top = ground.surfaces(p).last().map(|y| f64::from(*y)).filter(|y| *y > floor + CEILING_M);
            if free == UNKNOWN {
                walls[c].extend(top);
                continue;
            }
            h.floor_m[c] = h.floor_m[c].min(floor);
            counts[c][usize::from(top.is_some())] += 1;
            tops[c].extend(top);
        }
    }
    for c in 0..cells {
        let [open, covered] = counts[c].map(f64::from);
        if open > OPEN_SHARE * (open + covered) {
            h.open_top_m[c] = Some(percentile(&mut walls[c], 0.3).unwrap_or(h.floor_m[c] + OPEN_ROOM_M));
        }
        h.cap_m[c] = percentile(&mut tops[c], 0.9).unwrap_or(h.floor_m[c] + OPEN_ROOM_M) + 0.01;
        if !h.floor_m[c].is_finite() {
            h.floor_m[c] = 0.0;
        }
    }
    h
}

/// Border between a floor and the storey above it: its height, and whether it is open.
fn border(ground: &Ground, place: usize, floor_m: f64, upper_floor_m: f64, upper_stands: bool) -> (f64, bool) {
    let surfaces = ground.surfaces(place);
    let is_floor = |y: &f32| (f64::from(*y) - upper_floor_m).abs() <= SAME_FLOOR_M;
    // Under a table or a counter sight passes, and the floor is the border.
    let upper_stands = upper_stands || surfaces.iter().any(is_floor);
    // What the upper storey only looks over may end some way above its floor: a parapet.
    let limit = upper_floor_m + if upper_stands { -0.01 } else { super::storeys::SIGHT_M[0] };
    let at = surfaces.partition_point(|y| f64::from(*y) <= limit);
    // Far below the upper floor it is the flight of a stair or a low roof: the upper storey looks
    // down on it.
    let least = (floor_m + CEILING_M).max(upper_floor_m - SLAB_M);
    let below = surfaces[..at].iter().rev().map(|y| f64::from(*y)).find(|y| *y > least);
    if upper_stands {
        let slab = below.map_or(0.0, |b| upper_floor_m - b);
        let into = if slab > 0.0 && slab <= SLAB_M { INTO_SLAB_M.min(0.5 * slab) } else { 0.0 };
        return (upper_floor_m - into, false);
    }
    match below {
        Some(top) => {
            let thick = surfaces[..at].iter().any(|y| (top - SLAB_M..top - 0.01).contains(&f64::from(*y)));
            (top - if thick { INTO_SLAB_M } else { 0.0 }, false)
        }
        None => (upper_floor_m, true),
    }
}

impl Volumes {
    /// Stacks the storeys. Also gives the hatches.
    pub(super) fn new(ground: &Ground, storeys: &[Labelled], cells: usize) -> (Self, Vec<Portal>) {
        let h = heights(ground, storeys, cells);
        let mut wells = Vec::new();
        let mut out = Self { first: vec![0], runs: Vec::new() };
        for p in 0..ground.places() {
            let stack: Vec<&Labelled> = storeys.iter().filter(|s| s.filled[p] != UNKNOWN).collect();
            let mut low = None;
            for (at, s) in stack.iter().enumerate() {
                let label = s.filled[p];
                let cell = (label < OUTSIDE).then_some(label as usize);
                let low_m = low.unwrap_or_else(|| cell.map_or(s.floor_m(p), |c| h.floor_m[c]) - 0.1);
                let high_m = if let Some(upper) = stack.get(at + 1) {
                    let (y, open) = border(ground, p, s.floor_m(p), upper.floor_m(p), upper.storey.real[p]);
                    if open && label != upper.filled[p] && s.free[p] != UNKNOWN {
                        wells.push(Well { place: p, below: label, above: upper.filled[p], y_m: y as f32 });
                    }
                    y
                } else if let Some(c) = cell {
                    let (y, open) = top(ground, p, s.floor_m(p), c, &h);
                    if open && s.free[p] != UNKNOWN {
                        wells.push(Well { place: p, below: label, above: OUTSIDE, y_m: y as f32 });
                    }
                    y
                } else {
                    f64::INFINITY
                };
                low = Some(high_m);
                if cell.is_some() && high_m > low_m + 0.01 {
                    out.runs.push(Run { low_m: low_m as f32, high_m: high_m as f32, label });
                }
            }
            out.first.push(out.runs.len() as u32);
        }
        let portals = hatches(ground, wells);
        (out, portals)
    }

    fn runs_of(&self, place: usize) -> &[Run] {
        &self.runs[self.first[place] as usize..self.first[place + 1] as usize]
    }

    /// What is at a point.
    pub(super) fn at(&self, ground: &Ground, p: DVec3) -> u32 {
        let Some(place) = ground.place(DVec2::new(p.x, p.z)) else { return OUTSIDE };
        let y = p.y as f32;
        self.runs_of(place).iter().find(|r| r.low_m <= y && y <= r.high_m).map_or(OUTSIDE, |r| r.label)
    }

    /// Whether a label lies within `margin_m` of a point, metres. The outside does if it holds the
    /// point or a corner of the cube of that half edge around it.
    pub(super) fn is_near(&self, ground: &Ground, p: DVec3, label: u32, margin_m: f64) -> bool {
        if label == OUTSIDE {
            let corners = Aabb { min: p - margin_m, max: p + margin_m }.corners();
            return corners.into_iter().chain([p]).any(|q| self.at(ground, q) == OUTSIDE);
        }
        let raster = &ground.raster;
        let at = DVec2::new(p.x, p.z) - raster.origin;
        let range = |at: f64, size: u32| {
            let place = |v: f64| (v / raster.pitch_m).floor().max(0.0) as usize;
            place(at - margin_m)..(place(at + margin_m) + 1).min(size as usize)
        };
        let beside = |at: f64, n: usize| {
            let low = n as f64 * raster.pitch_m;
            (low - at).max(at - low - raster.pitch_m).max(0.0)
        };
        range(at.y, raster.size[1]).any(|k| {
            range(at.x, raster.size[0]).any(|i| {
                let plan2 = beside(at.x, i).powi(2) + beside(at.y, k).powi(2);
                self.runs_of(k * ground.width() + i).iter().filter(|r| r.label == label).any(|r| {
                    let up = (f64::from(r.low_m) - p.y).max(p.y - f64::from(r.high_m)).max(0.0);
                    plan2 + up * up <= margin_m * margin_m
                })
            })
        })
    }

    /// The cells' boxes: runs joined along x, then along z.
    pub(super) fn boxes(&self, ground: &Ground, cells: &mut [Cell]) {
        let [w, h] = ground.raster.size.map(|n| n as usize);
        let near = |a: &Run, b: &Run| {
            a.label == b.label && (a.low_m - b.low_m).abs() < JOIN_M && (a.high_m - b.high_m).abs() < JOIN_M
        };
        // Open boxes by their span along x: first row and heights.
        let mut open: Vec<(usize, usize, usize, Run)> = Vec::new();
        let mut done: Vec<(usize, usize, usize, usize, Run)> = Vec::new();
        for k in 0..=h {
            let mut rows: Vec<(usize, usize, Run)> = Vec::new();
            let mut growing: Vec<(usize, Run)> = Vec::new();
            for i in 0..=w {
                let runs = if i < w && k < h { self.runs_of(k * w + i) } else { &[] };
                let (stay, end): (Vec<_>, Vec<_>) =
                    growing.into_iter().partition(|g| runs.iter().any(|r| near(r, &g.1)));
                rows.extend(end.into_iter().map(|(from, run)| (from, i, run)));
                growing = stay;
                for r in runs {
                    if !growing.iter().any(|g| near(r, &g.1)) {
                        growing.push((i, *r));
                    }
                }
            }
            let mut next = Vec::new();
            for (from, to, first, run) in open {
                if let Some(at) = rows.iter().position(|r| r.0 == from && r.1 == to && near(&r.2, &run)) {
                    rows.swap_remove(at);
                    next.push((from, to, first, run));
                } else {
                    done.push((from, to, first, k, run));
                }
            }
            next.extend(rows.into_iter().map(|(from, to, run)| (from, to, k, run)));
            open = next;
        }
        done.sort_by_key(|(from, to, first, last, run)| (run.label, *first, *from, *last, *to, run.low_m.to_bits()));
        for (from, to, first, last, run) in done {
            let corner =
                |i: usize, k: usize| ground.raster.origin + DVec2::new(i as f64, k as f64) * ground.raster.pitch_m;
            let (a, b) = (corner(from, first), corner(to, last));
            cells[run.label as usize].boxes.push(Aabb {
                min: DVec3::new(a.x, f64::from(run.low_m), a.y),
                max: DVec3::new(b.x, f64::from(run.high_m), b.y),
            });
        }
    }
}

/// Top of a cell with nothing above it, and whether it is open to the sky.
fn top(ground: &Ground, place: usize, floor_m: f64, cell: usize, h: &Heights) -> (f64, bool) {
    if let Some(open) = h.open_top_m[cell] {
        return (open.max(h.floor_m[cell] + CEILING_M), true);
    }
    let surfaces = ground.surfaces(place);
    match surfaces.last().map(|y| f64::from(*y)).filter(|y| *y > floor_m + CEILING_M) {
        None => (h.cap_m[cell], true),
        Some(top) => {
            let thick = surfaces.iter().any(|y| (top - SLAB_M..top - 0.01).contains(&f64::from(*y)));
            ((top - if thick { INTO_SLAB_M } else { 0.0 }).min(h.cap_m[cell]), false)
        }
    }
}

/// Horizontal portals: wells beside each other between the same two at about the same height, as
/// convex hulls.
fn hatches(ground: &Ground, wells: Vec<Well>) -> Vec<Portal> {
    let mut by_pair: BTreeMap<(u32, u32, i64), BTreeMap<usize, f32>> = BTreeMap::new();
    for w in wells {
        by_pair.entry((w.below, w.above, (f64::from(w.y_m) * 4.0).round() as i64)).or_default().insert(w.place, w.y_m);
    }
    let mut portals = Vec::new();
    for ((below, above, _), mut places) in by_pair {
        while let Some((first, y)) = places.pop_first() {
            let (mut group, mut at, mut top) = (vec![first], 0, y);
            while at < group.len() {
                let p = group[at];
                for (q, ..) in ground.neighbours(p) {
                    if let Some(y) = places.remove(&q) {
                        group.push(q);
                        top = top.max(y);
                    }
                }
                at += 1;
            }
            let pitch = ground.raster.pitch_m;
            if group.len() as f64 * pitch * pitch < SMALLEST_HATCH_M2 {
                continue;
            }
            let corners = group.iter().flat_map(|p| {
                let m = ground.middle(*p);
                // A place beyond the borders, which are as sharp as the raster.
                [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, z)| m + DVec2::new(x, z) * pitch)
            });
            let outline = super::hull::rectangle_if_nearly(hull(corners.collect()));
            // Counter-clockwise in (x, z) looks down; reversed, the normal points up, from below
            // to above.
            let corners: Vec<DVec3> = outline.iter().rev().map(|p| DVec3::new(p.x, f64::from(top), p.y)).collect();
            if corners.len() >= 3 {
                portals.push(Portal { cells: [id(below), id(above)], kind: PortalKind::Hatch, corners });
            }
        }
    }
    portals
}
