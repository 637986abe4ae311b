//! Hits of construction images become samples at pixel centres.
//!
//! A hit that falls somewhere into a central pixel predicts, by its plane, the disparity at the
//! pixel's centre. Predictions that agree with what is known there, or with each other, are one.
//! Each that remains gets a short ray through the centre (recast): it misses, and the sample is
//! dropped (or becomes a sliver, `slivers`), or it gives the exact depth. Snapping hits to pixels
//! instead would grow every silhouette by half a pixel; recasting is the largest single gain in
//! picture quality (1.3 to 3 dB).

use super::{
    caster::SubsetCaster,
    central::{Surveyor, short_ray, traced},
    sample::{self, Prediction, Sample, Tolerance, bounded},
    slivers,
    view::{ConstructionCamera, Rig},
};
use crate::render::{Hit, Ray};
use rayon::prelude::*;
use std::cmp::Ordering;

/// What became of a construction ray.
pub(super) enum Seen {
    /// Nothing along the directions of this pixel of the construction camera: sky.
    Sky(u32),
    /// Nothing that could be stored.
    Nothing,
    /// Known already.
    Known,
    /// Outside of every user's picture.
    Pruned,
    /// New: what is predicted, and the pixel of the construction camera.
    New(Prediction, u32),
    /// Steep, and passes beside the ray through its pixel's centre, which meets nothing: no
    /// sample, but a sliver perhaps. And the axis along which it is.
    Beside(Prediction, u32, usize),
}

/// Everything known of the image so far.
pub(super) struct Known {
    /// Row-major; disparity 0 is sky, [`sample::UNSEEN`] where nobody looks.
    pub central: Vec<Sample>,
    /// By pixel, then nearest first; all behind the central sample.
    pub deeper: Vec<Prediction>,
    /// Per row, where `deeper` begins; one more entry than rows.
    row_starts: Vec<u32>,
    width: usize,
}

impl Known {
    pub fn new(central: Vec<Sample>, width: u32) -> Self {
        let rows = central.len() / width as usize;
        Self { central, deeper: Vec::new(), row_starts: vec![0; rows + 1], width: width as usize }
    }

    /// Deeper samples of a pixel.
    pub fn behind(&self, pixel: u32) -> &[Prediction] {
        let row = pixel as usize / self.width;
        let of_row = &self.deeper[self.row_starts[row] as usize..self.row_starts[row + 1] as usize];
        let first = of_row.partition_point(|d| d.0 < pixel);
        let count = of_row[first..].iter().take_while(|d| d.0 == pixel).count();
        &of_row[first..first + count]
    }

    /// Whether a prediction is the same piece of surface as something in its pixel, or none that
    /// is wanted.
    pub fn has(&self, p: &Prediction, tolerance: &Tolerance) -> bool {
        let central = &self.central[p.0 as usize];
        // Nothing can be found on a ray that hit nothing, or before its first hit; nor is anything
        // wanted where nobody looks.
        central.disparity <= 0.0
            || tolerance.same(central, &p.1)
            || self.behind(p.0).iter().any(|d| tolerance.same(&d.1, &p.1))
    }

    /// Whether the ray through the pixel's centre met nothing: what eyes see there is less than a
    /// pixel wide for the centre of projection.
    fn is_sky(&self, pixel: usize) -> bool {
        self.central[pixel].disparity == 0.0
    }

    /// Adds samples that are new; drops repetitions among them.
    fn add(&mut self, mut new: Vec<Prediction>, tolerance: &Tolerance) {
        new.par_sort_by(order);
        self.deeper.extend(new);
        // Stable: of equals the older one comes first and stays.
        self.deeper.par_sort_by(order);
        self.deeper.dedup_by(|b, a| a.0 == b.0 && (a.1.disparity - b.1.disparity).abs() <= tolerance.step);
        self.find_rows();
    }

    /// The place of each deeper sample in its pixel: 1, the nearest behind the central one.
    pub fn ranks(&self) -> Vec<usize> {
        let mut before = (u32::MAX, 0);
        let rank = |(pixel, _): &Prediction| {
            before = (*pixel, if before.0 == *pixel { before.1 + 1 } else { 1 });
            before.1
        };
        self.deeper.iter().map(rank).collect()
    }

    /// Drops deeper samples; asks for each once, in order.
    pub fn retain_deeper(&mut self, stays: impl FnMut(&Prediction) -> bool) {
        self.deeper.retain(stays);
        self.find_rows();
    }

    fn find_rows(&mut self) {
        let mut next = 0;
        for (row, start) in self.row_starts.iter_mut().enumerate() {
            let limit = (row * self.width) as u32;
            next += self.deeper[next..].partition_point(|d| d.0 < limit);
            *start = next as u32;
        }
    }
}

/// By pixel, then nearest first; every field decides, so that no order of arrival shows.
fn order(a: &Prediction, b: &Prediction) -> Ordering {
    a.0.cmp(&b.0)
        .then(b.1.disparity.total_cmp(&a.1.disparity))
        .then(a.1.triangle.cmp(&b.1.triangle))
        .then(a.1.gradient[0].total_cmp(&b.1.gradient[0]))
        .then(a.1.gradient[1].total_cmp(&b.1.gradient[1]))
}

/// Traces pixels of a construction camera and brings their hits home.
pub(super) fn trace_construction<C: SubsetCaster>(
    caster: &C,
    rig: &Rig,
    camera: &ConstructionCamera,
    pixels: &[u32],
    known: &Known,
    tolerance: &Tolerance,
) -> Vec<Seen> {
    let back = camera.shift.reversed();
    let ray_of = |pixel: &u32| {
        let (u, v) = camera.centre(*pixel as usize);
        Ray { origin: camera.position, direction: rig.lens.ray(u, v), t_min: camera.near_m, t_max: f64::INFINITY }
    };
    traced(caster, rig, pixels, ray_of, |surveyor, from, ray, hit| {
        let (u, v) = camera.centre(*from as usize);
        let home = |u: f64, v: f64| {
            rig.window
                .index(u.floor() as i64 - i64::from(rig.window.left), v.floor() as i64 - i64::from(rig.window.top))
        };
        let Some(hit) = hit else { return Seen::Sky(*from) };
        let (u, v, d) = back.apply(u, v, 1.0 / hit.t);
        let Some(pixel) = home(u, v) else { return Seen::Nothing };
        if !rig.in_reach(u, v, d) {
            return Seen::Pruned;
        }
        let facet = surveyor.facet(ray, hit);
        let gradient = sample::gradient(&rig.lens, facet.normal, rig.lens.ray(u, v), d);
        let (cu, cv) = rig.window.centre(pixel);
        let at_centre = d + f64::from(gradient[0]) * (cu - u) + f64::from(gradient[1]) * (cv - v);
        let sample = Sample {
            disparity: at_centre.clamp(0.25 * d, 4.0 * d) as f32,
            gradient,
            surface: facet.surface,
            triangle: hit.triangle,
            rgb: [0; 3],
            apart: camera.apart(d, gradient),
        };
        let prediction = (pixel as u32, sample);
        if !known.has(&prediction, tolerance) {
            return Seen::New(prediction, *from);
        }
        match known.is_sky(pixel).then(|| slivers::steep_axis(camera, &prediction.1)).flatten() {
            Some(axis) => Seen::Beside(prediction, *from, axis),
            None => Seen::Known,
        }
    })
}

/// Figures of one recast.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Recast {
    pub rays: u64,
    pub missed: u64,
}

/// Collapses predictions that agree, recasts the rest, adds what is hit.
pub(super) fn recast<C: SubsetCaster>(
    caster: &C,
    rig: &Rig,
    known: &mut Known,
    mut predictions: Vec<Prediction>,
    tolerance: &Tolerance,
) -> Recast {
    predictions.par_sort_by(order);
    predictions.dedup_by(|b, a| a.0 == b.0 && tolerance.same(&a.1, &b.1));
    let margin = |s: &Sample| 0.5 * (s.gradient[0].abs() + s.gradient[1].abs()) + 2.0 * tolerance.step;
    let ray_of = |p: &Prediction| {
        let (u, v) = rig.window.centre(p.0 as usize);
        short_ray(rig, u, v, f64::from(p.1.disparity), f64::from(margin(&p.1)))
    };
    let result = |surveyor: &mut Surveyor<'_, C>, p: &Prediction, ray: &Ray, hit: Option<&Hit>| {
        let hit = hit?;
        let found = Sample { apart: p.1.apart, ..surveyor.sample(ray, hit) };
        let near = (found.disparity - p.1.disparity).abs() <= 2.0 * tolerance.step;
        (near || found.surface == p.1.surface).then_some((p.0, found))
    };
    let hits = traced(caster, rig, &predictions, ray_of, result);
    let rays = hits.len() as u64;
    let found: Vec<Prediction> = hits.into_iter().flatten().collect();
    let missed = rays - found.len() as u64;
    let new = found
        .into_iter()
        .filter(|p| {
            let central = &known.central[p.0 as usize];
            central.triangle != p.1.triangle && central.disparity - p.1.disparity > tolerance.step
        })
        .collect();
    known.add(new, tolerance);
    Recast { rays, missed }
}

/// Predicts what lies between a hit of a construction camera and the next piece of its surface in
/// the row or column, where the camera's pixels are farther apart than [`ring`] reaches
/// ([`Sample::apart`]).
pub(super) fn between(rig: &Rig, known: &Known, tolerance: &Tolerance) -> Vec<Prediction> {
    let (width, height) = (rig.window.width, rig.window.height);
    let gap = |(pixel, s): &Prediction, axis: usize, sign: f32| {
        let (column, row) = (pixel % width, pixel / width);
        let (stride, room) = match (axis, sign > 0.0) {
            (0, true) => (1, width - 1 - column),
            (0, false) => (1, column),
            (_, true) => (width, height - 1 - row),
            (_, false) => (width, row),
        };
        let at = |k: u32| {
            let there = if sign > 0.0 { pixel + k * stride } else { pixel - k * stride };
            (there, Sample { disparity: bounded(s, sign * k as f32 * s.gradient[axis]), ..*s })
        };
        // A ray between two hits may have brought nothing.
        let reach = 2 * u32::from(s.apart[axis]);
        let beyond = (1..=room.min(reach)).find(|k| known.has(&at(*k), tolerance));
        (1..beyond.unwrap_or(1)).map(at).collect::<Vec<_>>()
    };
    let sides = [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)];
    known.deeper.par_iter().flat_map_iter(|d| sides.into_iter().flat_map(|(axis, sign)| gap(d, axis, sign))).collect()
}

/// Passes of [`ring`]: around every sample, twice as construction cameras have half the
/// resolution, then into what is still open on three sides or more.
pub(super) const RING_SIDES: [usize; 3] = [1, 1, 3];

/// Continues deeper samples into neighbouring pixels where nothing is known there, if at least
/// `sides` neighbours agree.
///
/// Construction images sample slanted and distant surfaces less densely than the central image
/// does, so that newly seen surfaces have pinholes; and eyes between the cameras see a little
/// further than they do. Rings close both.
pub(super) fn ring(rig: &Rig, known: &Known, tolerance: &Tolerance, sides: usize) -> Vec<Prediction> {
    let (width, height) = (i64::from(rig.window.width), i64::from(rig.window.height));
    let continued = |(pixel, s): &Prediction| {
        let (column, row) = (i64::from(*pixel) % width, i64::from(*pixel) / width);
        [(1, 0), (-1, 0), (0, 1), (0, -1)].map(|(dx, dy)| {
            let (c, r) = (column + dx, row + dy);
            if c < 0 || r < 0 || c >= width || r >= height {
                return None;
            }
            let change = dx as f32 * s.gradient[0] + dy as f32 * s.gradient[1];
            let prediction = ((r * width + c) as u32, Sample { disparity: bounded(s, change), ..*s });
            (!known.has(&prediction, tolerance)).then_some(prediction)
        })
    };
    let mut predictions: Vec<Prediction> =
        known.deeper.par_iter().flat_map_iter(|d| continued(d).into_iter().flatten()).collect();
    if sides > 1 {
        predictions.par_sort_by(order);
        predictions = predictions
            .chunk_by(|a, b| a.0 == b.0 && tolerance.same(&a.1, &b.1))
            .filter(|group| group.len() >= sides)
            .map(|group| group[0])
            .collect();
    }
    predictions
}
