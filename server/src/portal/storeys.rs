//! Free space, storey by storey: where sight is free at the height of the eyes.
//!
//! In: a scene and its caster. Out: [`Storey`]s, each a raster with a floor height per place and
//! the open steps between neighbours.
//!
//! Floors come from vertical lines ([`lines`], [`floors`]). The heights with most floor, at least
//! [`STOREY_M`] apart, are the storeys' levels; what climbs from one to the next belongs to the
//! lower one until it is nearly there. From even floors the raster spreads where nothing stands
//! between two places at one of the heights [`SIGHT_M`]: over tables and beds, through windows,
//! into the air around the house; so furniture makes no walls, and an open window is an opening
//! like a door.

use super::floors;
use crate::render::{Caster, CellSet, Ray};
use crate::walk_volume::lines::{self, Raster};
use glam::{DVec2, DVec3};
use ldi_protocol::Aabb;
use rayon::prelude::*;

/// Heights above the floor at which sight is tried, metres: above tables and sills, below lintels.
/// One free height is enough, so that shelves of 1.8 m make no walls. Lower: furniture splits
/// rooms. Higher: doors of two metres are closed.
pub(super) const SIGHT_M: [f64; 3] = [1.15, 1.5, 1.9];
/// Floors need this much head room, metres: the highest line of sight and a little.
const HEAD_ROOM_M: f64 = 1.95;
/// Wanted edge of a raster place, metres. A door of 0.8 m then has eight; doubling it loses narrow
/// doors.
const PITCH_M: f64 = 0.1;
/// Coarsest edge at which doors are still found.
const COARSEST_PITCH_M: f64 = 0.2;
/// Most places of the raster: bounds memory, at about 60 bytes each and per storey.
const MOST_PLACES: f64 = 3.0e6;
/// Free border around the scene, metres: what reaches it is outside.
const BORDER_M: f64 = 1.0;
/// Height of a bin of the histogram of floors, metres.
const BIN_M: f64 = 0.1;
/// A level is a height at which there is this much floor, m²: more than a landing of a stair.
const LEVEL_M2: f64 = 3.0;
/// Least distance between the levels of two storeys, metres: nobody can stand above another within
/// it.
const STOREY_M: f64 = 2.1;
/// A storey's level holds at least this share of all floor: ramps and the tops of cupboards are no
/// storeys.
const STOREY_SHARE: f64 = 0.02;
/// What lies at most this far below a storey's level belongs to it, metres; what climbs is the
/// lower storey's until there.
const SUNK_M: f64 = 0.6;
/// Highest step between neighbouring places of a storey, metres: beds and tables that lines take
/// for floors make no walls.
const STEP_M: f64 = 1.0;

/// A raster over the scene, and all surfaces that its vertical lines meet.
pub(super) struct Ground {
    pub raster: Raster,
    /// Per place the position of its first surface, and one more.
    first: Vec<u32>,
    surfaces_m: Vec<f32>,
}

/// One storey.
pub(super) struct Storey {
    /// Height of its lowest level, metres.
    pub base_m: f64,
    /// Floor height per place; NaN where sight is not free.
    pub floor_m: Vec<f32>,
    /// Whether somebody can stand there.
    pub real: Vec<bool>,
    /// Next surface above a real floor; infinite elsewhere.
    pub above_m: Vec<f32>,
    /// Bit 0: open toward larger x; bit 1: toward larger z.
    pub open: Vec<u8>,
}

impl Ground {
    pub(super) fn new(caster: &Caster, bounds: &Aabb) -> Result<Self, String> {
        let scene = caster.scene();
        if bounds.is_empty() || scene.triangles() == 0 {
            return Err("the scene is empty".into());
        }
        let size = bounds.size() + 2.0 * BORDER_M;
        let pitch_m = PITCH_M.max((size.x * size.z / MOST_PLACES).sqrt());
        if pitch_m > COARSEST_PITCH_M {
            return Err(format!(
                "{:.0} x {:.0} m are too wide to look for doors in (places of {pitch_m:.2} m, at most {COARSEST_PITCH_M} m); annotate rooms in the file, or cut the building out of its surroundings",
                size.x, size.z
            ));
        }
        // Off the round numbers at which walls stand.
        let origin = DVec2::new(bounds.min.x, bounds.min.z) - BORDER_M - 0.0317;
        let count = |s: f64| (s / pitch_m).ceil() as u32 + 1;
        let raster = Raster { origin, pitch_m, size: [count(size.x), count(size.z)] };
        let mesh_bounds = lines::mesh_bounds(scene);
        let strips: Vec<u32> = (0..raster.size[1]).step_by(64).collect();
        let hits: Vec<Vec<(u32, f32)>> = strips
            .par_iter()
            .map(|&k| {
                let mut hits = lines::heights(scene, &mesh_bounds, &raster, k..(k + 64).min(raster.size[1]));
                hits.iter_mut().for_each(|h| h.0 += k * raster.size[0]);
                hits
            })
            .collect();
        let hits = hits.concat();
        let mut first = vec![0u32; raster.size[0] as usize * raster.size[1] as usize + 1];
        hits.iter().for_each(|h| first[h.0 as usize + 1] += 1);
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        Ok(Self { raster, first, surfaces_m: hits.into_iter().map(|h| h.1).collect() })
    }

    pub(super) fn places(&self) -> usize {
        self.first.len() - 1
    }

    /// Surfaces on the line of a place, ascending.
    pub(super) fn surfaces(&self, place: usize) -> &[f32] {
        &self.surfaces_m[self.first[place] as usize..self.first[place + 1] as usize]
    }

    pub(super) fn width(&self) -> usize {
        self.raster.size[0] as usize
    }

    /// Middle of a place, (x, z).
    pub(super) fn middle(&self, place: usize) -> DVec2 {
        let w = self.width();
        self.raster.origin + (DVec2::new((place % w) as f64, (place / w) as f64) + 0.5) * self.raster.pitch_m
    }

    /// The place at (x, z).
    pub(super) fn place(&self, p: DVec2) -> Option<usize> {
        let at = ((p - self.raster.origin) / self.raster.pitch_m).floor();
        let [w, h] = self.raster.size;
        (at.x >= 0.0 && at.y >= 0.0 && at.x < f64::from(w) && at.y < f64::from(h))
            .then(|| at.y as usize * w as usize + at.x as usize)
    }

    /// The up to four neighbours, with the bit and the place that hold whether the step is open.
    pub(super) fn neighbours(&self, place: usize) -> impl Iterator<Item = (usize, u8, usize)> + use<> {
        let (w, n) = (self.width(), self.places());
        let i = place % w;
        [
            (i + 1 < w).then(|| (place + 1, 1, place)),
            (i > 0).then(|| (place - 1, 1, place - 1)),
            (place + w < n).then(|| (place + w, 2, place)),
            (place >= w).then(|| (place - w, 2, place - w)),
        ]
        .into_iter()
        .flatten()
    }

    /// Whether a place lies on the raster's rim.
    pub(super) fn on_rim(&self, place: usize) -> bool {
        let (w, n) = (self.width(), self.places());
        place < w || place + w >= n || place.is_multiple_of(w) || place % w == w - 1
    }

    fn floors(&self) -> Vec<floors::Floor> {
        let mut heights = Vec::with_capacity(self.surfaces_m.len());
        for place in 0..self.places() {
            heights.extend(self.surfaces(place).iter().map(|y| (place as u32, *y)));
        }
        floors::floors(&heights, &self.raster, HEAD_ROOM_M).0
    }

    /// The storeys from below to above.
    pub(super) fn storeys(&self, caster: &Caster) -> Vec<Storey> {
        let floors = self.floors();
        let bins = self.levels(&floors);
        let levels: Vec<f64> = bins.iter().filter(|b| b.1 >= LEVEL_M2).map(|b| b.0).collect();
        let peaks = peaks(&bins);
        let lows: Vec<f64> = peaks.iter().map(|p| p - SUNK_M).collect();
        let is_level = |y: f64| {
            let at = levels.partition_point(|l| *l < y - 1.5 * BIN_M);
            levels.get(at).is_some_and(|l| *l <= y + 1.5 * BIN_M)
        };
        let n = self.places();
        let mut storeys: Vec<Storey> = peaks
            .iter()
            .map(|peak| Storey {
                base_m: *peak,
                floor_m: vec![f32::NAN; n],
                real: vec![false; n],
                above_m: vec![f32::INFINITY; n],
                open: Vec::new(),
            })
            .collect();
        for f in &floors {
            let at = lows.partition_point(|l| *l <= f64::from(f.y)).max(1) - 1;
            let Some(s) = storeys.get_mut(at) else { continue };
            let p = f.line as usize;
            // Of two floors of one storey the lower one.
            if !s.real[p] {
                (s.floor_m[p], s.real[p], s.above_m[p]) = (f.y, true, f.above);
            }
        }
        storeys.par_iter_mut().for_each(|s| self.spread(caster, s, &is_level));
        storeys.iter_mut().for_each(|s| s.open = self.opened(caster, s));
        storeys
    }

    /// Area of floor within a bin's height of every bin's middle, under a ceiling if there is
    /// enough of that: (height, m²), ascending.
    fn levels(&self, floors: &[floors::Floor]) -> Vec<(f64, f64)> {
        let place_m2 = self.raster.pitch_m * self.raster.pitch_m;
        let covered = floors.iter().filter(|f| f.above.is_finite()).count() as f64 * place_m2 > 2.0 * LEVEL_M2;
        let mut bins = std::collections::BTreeMap::<i64, f64>::new();
        for f in floors.iter().filter(|f| !covered || f.above.is_finite()) {
            *bins.entry((f64::from(f.y) / BIN_M).round() as i64).or_default() += place_m2;
        }
        let area = |b: i64| (b - 1..=b + 1).filter_map(|b| bins.get(&b)).sum::<f64>();
        bins.keys().map(|b| (*b as f64 * BIN_M, area(*b))).collect()
    }

    /// Fills the places that can be seen from beside them, from even floors on.
    fn spread(&self, caster: &Caster, s: &mut Storey, is_level: &(dyn Fn(f64) -> bool + Sync)) {
        let mut front: Vec<usize> =
            (0..self.places()).filter(|p| s.real[*p] && is_level(f64::from(s.floor_m[*p]))).collect();
        while !front.is_empty() {
            let floor_m = &s.floor_m;
            let found: Vec<(usize, f32)> = front
                .par_iter()
                .with_min_len(256)
                .flat_map_iter(|&p| {
                    let y = floor_m[p];
                    self.neighbours(p)
                        .filter(move |(q, ..)| floor_m[*q].is_nan() && self.is_open(caster, p, *q, f64::from(y)))
                        .map(move |(q, ..)| (q, y))
                })
                .collect();
            front.clear();
            for (q, y) in found {
                if s.floor_m[q].is_nan() {
                    s.floor_m[q] = y;
                    front.push(q);
                }
            }
        }
    }

    fn is_open(&self, caster: &Caster, p: usize, q: usize, floor_m: f64) -> bool {
        let (a, b) = (self.middle(p), self.middle(q));
        SIGHT_M.iter().rev().any(|h| {
            let at = |v: DVec2| DVec3::new(v.x, floor_m + h, v.y);
            is_free(caster, at(a), at(b))
        })
    }

    fn opened(&self, caster: &Caster, s: &Storey) -> Vec<u8> {
        let w = self.width();
        let step = |p: usize, q: usize| {
            let (a, b) = (f64::from(s.floor_m[p]), f64::from(s.floor_m[q]));
            (a - b).abs() <= STEP_M && self.is_open(caster, p, q, a.max(b))
        };
        (0..self.places())
            .into_par_iter()
            .map(|p| {
                if s.floor_m[p].is_nan() {
                    return 0;
                }
                u8::from(p % w + 1 < w && step(p, p + 1)) | (u8::from(p + w < self.places() && step(p, p + w)) << 1)
            })
            .collect()
    }
}

/// The storeys' levels, ascending: the heights with most floor first, none closer to another than
/// a storey is high.
fn peaks(bins: &[(f64, f64)]) -> Vec<f64> {
    let total: f64 = bins.iter().map(|b| b.1).sum::<f64>() / 3.0;
    let mut order: Vec<&(f64, f64)> = bins.iter().filter(|b| b.1 >= LEVEL_M2.max(STOREY_SHARE * total)).collect();
    order.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.total_cmp(&b.0)));
    let mut peaks: Vec<f64> = Vec::new();
    for (y, _) in order {
        if peaks.iter().all(|p| (p - y).abs() >= STOREY_M) {
            peaks.push(*y);
        }
    }
    peaks.sort_by(f64::total_cmp);
    peaks
}

/// Whether nothing lies between two points.
pub(super) fn is_free(caster: &Caster, from: DVec3, to: DVec3) -> bool {
    !caster.occluded(&Ray { origin: from, direction: to - from, t_min: 0.0, t_max: 1.0 }, &CellSet::all())
}

impl Storey {
    /// Whether sight leads from a place to a neighbour, as [`Ground::neighbours`] gives it.
    pub(super) fn is_open(&self, (_, bit, holder): (usize, u8, usize)) -> bool {
        self.open[holder] & bit != 0
    }
}
