//! Splatting reference pixels into levels, and filtering levels upward (section 3.1).
//!
//! Every level is one grid of pixels per face over the whole root cube; a node is what lies in its
//! part of it. A pixel holds layers: samples of surfaces more than [`MERGE`] pitches apart. What
//! is merged is moved along its own surface to the pixel's centre first, so that a slope does not
//! part into layers. How much of its pixel a layer covers is not counted from what was merged, but
//! measured when its level is complete (`coverage`): pixels of references are too irregular to
//! tell the edge of a surface from a sparse place on it.

use super::{
    coverage::{self, Patch},
    reference::{Point, Reference},
};
use crate::render::Caster;
use glam::{DVec3, Vec3};
use ldi_protocol::tree::{SIDE, across, share_covered};
use rayon::prelude::*;
use std::collections::HashMap;

/// Samples of one pixel that lie closer are one, in pitches: slightly below the spacing, so that a
/// surface seen edge-on keeps its sampling rate (section 3.1).
const MERGE: f32 = 0.9;
/// Steepest slope that is kept; a face's surfaces are at most 55 degrees askew, 1.42.
const STEEPEST: f64 = 1.9;
/// Parts of a level that are filled at the same time. More: better balance; each costs some memory
/// in every batch.
const SHARDS: usize = 64;
/// Weights below this are not worth a sample: they would be lost in coding, and divided by when
/// samples are normalized.
const LEAST_WEIGHT: f32 = 1e-4;

/// A pixel of a face of a level: level, face, column, row, and which cell along the face's axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Pixel(u64);

impl Pixel {
    fn new(level: u8, face: usize, column: u32, row: u32, depth_cell: u32) -> Self {
        Self(
            u64::from(level) << 57
                | (face as u64) << 54
                | u64::from(depth_cell) << 40
                | u64::from(row) << 20
                | u64::from(column),
        )
    }
    pub fn level(self) -> u8 {
        (self.0 >> 57) as u8
    }
    pub fn face(self) -> usize {
        (self.0 >> 54 & 7) as usize
    }
    fn depth_cell(self) -> u32 {
        (self.0 >> 40 & 0x3fff) as u32
    }
    pub fn row(self) -> u32 {
        (self.0 >> 20 & 0xf_ffff) as u32
    }
    pub fn column(self) -> u32 {
        (self.0 & 0xf_ffff) as u32
    }
    /// The node that it belongs to.
    pub fn cell(self) -> [u16; 3] {
        let axis = self.face() / 2;
        let [a, b] = across(axis);
        let mut cell = [0; 3];
        (cell[a], cell[b]) = ((self.column() / SIDE) as u16, (self.row() / SIDE) as u16);
        cell[axis] = self.depth_cell() as u16;
        cell
    }
    fn shard(self) -> usize {
        let [x, y, z] = self.cell().map(usize::from);
        (x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ z.wrapping_mul(83_492_791)) % SHARDS
    }
}

/// A surface in a pixel.
#[derive(Debug, Clone, Copy)]
pub struct Layer {
    /// Where.
    pub pixel: Pixel,
    /// From the cell's smallest corner along the face's axis, pitches; weighted mean.
    pub depth: f32,
    /// Weighted mean.
    pub slope: [f32; 2],
    /// Linear light, weighted mean.
    pub colour: [f32; 3],
    /// Whether nodes below have part in it.
    pub filtered: bool,
    /// Coverage mask ([`ldi_protocol::tree::TreeSample::covers`]), once the level is complete.
    pub covers: u16,
    /// Sum of weights.
    weight: f32,
    /// Position of the pixel's next layer; `u32::MAX` ends.
    next: u32,
}

/// What a surface adds to one pixel.
#[derive(Clone, Copy)]
struct Part {
    pixel: Pixel,
    depth: f32,
    slope: [f32; 2],
    colour: [f32; 3],
    weight: f32,
    filtered: bool,
}

/// Some of a level's pixels.
#[derive(Default)]
struct Shard {
    first: HashMap<Pixel, u32>,
    layers: Vec<Layer>,
}

impl Shard {
    fn add(&mut self, p: &Part) {
        let next_layer = self.layers.len() as u32;
        let first = *self.first.entry(p.pixel).or_insert(next_layer);
        let (mut at, mut last, mut best) = (first, None, None);
        while at != u32::MAX && at < next_layer {
            let layer = &self.layers[at as usize];
            let apart = (layer.depth - p.depth).abs();
            if apart < best.map_or(MERGE, |(a, _)| a) {
                best = Some((apart, at));
            }
            last = Some(at);
            at = layer.next;
        }
        let Some((_, at)) = best else {
            if let Some(last) = last {
                self.layers[last as usize].next = next_layer;
            }
            let Part { pixel, depth, slope, colour, weight, filtered } = *p;
            let (covers, next) = (0, u32::MAX);
            self.layers.push(Layer { pixel, depth, slope, colour, filtered, covers, weight, next });
            return;
        };
        let l = &mut self.layers[at as usize];
        l.weight += p.weight;
        // Means are moved, not divided at the end: nothing is lost where weights are tiny.
        let t = p.weight / l.weight;
        let mix = |a: f32, b: f32| a + (b - a) * t;
        l.depth = mix(l.depth, p.depth);
        l.slope = std::array::from_fn(|k| mix(l.slope[k], p.slope[k]));
        l.colour = std::array::from_fn(|k| mix(l.colour[k], p.colour[k]));
        l.filtered |= p.filtered;
    }
}

/// Parts by level and shard.
type Sorted = Vec<Vec<Part>>;

/// All levels while they grow.
pub struct Forest {
    origin: DVec3,
    /// Pitch of level 0, metres.
    pitch_m: f64,
    max_level: u8,
    /// By level, then shard.
    shards: Vec<Shard>,
}

/// A finished forest: layers by level, in no order.
pub struct Grown {
    /// All of them.
    pub layers: Vec<Vec<Layer>>,
}

impl Forest {
    pub fn new(origin: DVec3, edge_m: f64, max_level: u8) -> Self {
        let shards = (0..(usize::from(max_level) + 1) * SHARDS).map(|_| Shard::default()).collect();
        Self { origin, pitch_m: edge_m / f64::from(SIDE), max_level, shards }
    }

    /// Adds references.
    pub fn splat(&mut self, references: &[Reference]) {
        let split = |r: &Reference| -> Sorted {
            let mut sorted: Sorted = vec![Vec::new(); self.shards.len()];
            for p in &r.points {
                let level = self.level_of(f64::from(p.stamp_m));
                self.parts_of_point(p, level, &mut sorted);
            }
            sorted
        };
        let parts: Vec<Sorted> = references.par_iter().map(split).collect();
        self.take(&parts);
    }

    fn take(&mut self, parts: &[Sorted]) {
        self.shards.par_iter_mut().enumerate().for_each(|(k, shard)| {
            parts.iter().filter_map(|p| p.get(k)).flatten().for_each(|p| shard.add(p));
        });
    }

    /// The finest level whose pitch is not below the stamp.
    fn level_of(&self, stamp_m: f64) -> u8 {
        let level = (self.pitch_m / stamp_m.max(1e-12)).log2().floor();
        level.clamp(0.0, f64::from(self.max_level)) as u8
    }

    fn parts_of_point(&self, p: &Point, level: u8, out: &mut [Vec<Part>]) {
        let pitch = self.pitch_of(level);
        let axis = p.normal.abs().max_position();
        // The part of a pixel of the face that the area covers.
        let covers = f64::from(p.area_m2 * p.normal[axis].abs()) / (pitch * pitch);
        let place = (p.position - self.origin) / pitch;
        splat(level, place, p.normal, covers as f32, p.colour, false, out);
    }

    fn pitch_of(&self, level: u8) -> f64 {
        self.pitch_m / f64::from(1u32 << level)
    }

    /// Filters every level into the one above, deepest first. Layers that cover nothing are
    /// dropped.
    pub fn filter(mut self, caster: &Caster) -> Grown {
        for level in (0..=self.max_level).rev() {
            let range = usize::from(level) * SHARDS..(usize::from(level) + 1) * SHARDS;
            let (origin, pitch_m) = (self.origin, self.pitch_of(level));
            self.shards[range.clone()].par_iter_mut().for_each(|shard| {
                // Nothing is added to this level any more.
                shard.first = HashMap::new();
                shard.layers.iter_mut().for_each(|l| l.covers = coverage::measure(caster, &patch(l, origin, pitch_m)));
                shard.layers.retain(|l| l.covers != 0);
            });
            if level == 0 {
                break;
            }
            let total = self.shards.len();
            let up = |shard: &Shard| -> Sorted {
                let mut sorted: Sorted = vec![Vec::new(); total];
                shard.layers.iter().for_each(|l| copy_up(l, &mut sorted));
                sorted
            };
            let parts: Vec<Sorted> = self.shards[range].par_iter().map(up).collect();
            self.take(&parts);
        }
        let mut layers: Vec<Vec<Layer>> = vec![Vec::new(); usize::from(self.max_level) + 1];
        for (k, shard) in self.shards.into_iter().enumerate() {
            layers[k / SHARDS].extend(shard.layers);
        }
        Grown { layers }
    }
}

/// Where a layer crosses the middle of its pixel, pitches from the root's corner.
fn place_of(l: &Layer) -> DVec3 {
    let axis = l.pixel.face() / 2;
    let [a, b] = across(axis);
    let mut place = DVec3::ZERO;
    place[axis] = f64::from(l.pixel.depth_cell() * SIDE) + f64::from(l.depth);
    (place[a], place[b]) = (f64::from(l.pixel.column()) + 0.5, f64::from(l.pixel.row()) + 0.5);
    place
}

fn patch(l: &Layer, origin: DVec3, pitch_m: f64) -> Patch {
    Patch { middle: origin + place_of(l) * pitch_m, face: l.pixel.face(), slope: l.slope, pitch_m }
}

/// The copy of a layer in the level above: a quarter of a pixel of it.
fn copy_up(l: &Layer, out: &mut [Vec<Part>]) {
    let axis = l.pixel.face() / 2;
    let [a, b] = across(axis);
    // A normal with these slopes, of any length: the axis is the largest as long as slopes stay
    // below 1, which `splat` must not judge anew.
    let sign = if l.pixel.face() % 2 == 1 { 1.0 } else { -1.0 };
    let mut normal = Vec3::ZERO;
    normal[axis] = sign;
    (normal[a], normal[b]) = (-l.slope[0] * sign, -l.slope[1] * sign);
    let weight = share_covered(l.covers) * 0.25;
    splat_on(l.pixel.level() - 1, place_of(l) * 0.5, axis, normal, weight, l.colour, true, out);
}

/// Bilinear splat of a surface at `place` (pitches from the root's corner) that covers so much of
/// a pixel: equations (3a), (3b) with a stamp of at most a pitch.
fn splat(level: u8, place: DVec3, normal: Vec3, covers: f32, colour: [f32; 3], filtered: bool, out: &mut [Vec<Part>]) {
    splat_on(level, place, normal.abs().max_position(), normal, covers, colour, filtered, out);
}

#[expect(clippy::too_many_arguments, reason = "a splat is all of these")]
fn splat_on(
    level: u8,
    place: DVec3,
    axis: usize,
    normal: Vec3,
    covers: f32,
    colour: [f32; 3],
    filtered: bool,
    out: &mut [Vec<Part>],
) {
    let [a, b] = across(axis);
    let face = 2 * axis + usize::from(normal[axis] > 0.0);
    let side = f64::from(SIDE << level);
    let slope = [a, b].map(|k| f64::from(-normal[k] / normal[axis]).clamp(-STEEPEST, STEEPEST));
    let first = [a, b].map(|k| (place[k] - 0.5).floor());
    for (i, j) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let (column, row) = (first[0] + i, first[1] + j);
        // From the point to the pixel's centre.
        let (du, dv) = (column + 0.5 - place[a], row + 0.5 - place[b]);
        let weight = covers * ((1.0 - du.abs()) * (1.0 - dv.abs())) as f32;
        let depth = place[axis] + slope[0] * du + slope[1] * dv;
        let within = [column, row, depth].iter().all(|v| *v >= 0.0 && *v < side);
        if !within || !(weight > LEAST_WEIGHT) {
            continue;
        }
        let cell = (depth / f64::from(SIDE)) as u32;
        let pixel = Pixel::new(level, face, column as u32, row as u32, cell);
        out[usize::from(level) * SHARDS + pixel.shard()].push(Part {
            pixel,
            depth: (depth - f64::from(cell * SIDE)) as f32,
            slope: slope.map(|s| s as f32),
            colour,
            weight,
            filtered,
        });
    }
}
