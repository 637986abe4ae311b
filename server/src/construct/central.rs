//! Rays in bulk: the central image, and the short rays that give merged samples their exact place.

use super::{
    caster::{Facet, SubsetCaster},
    colour::RAYS_ACROSS,
    sample::{self, Prediction, Sample, Tolerance},
    sight::Looked,
    view::{Lens, Rig},
};
use crate::render::{Hit, Ray, RayFootprint};
use ldi_protocol::shade::srgb8_from_linear;
use rayon::prelude::*;

/// Rays traced together: enough to share a call, few enough to keep both threads busy to the end.
pub(super) const BATCH: usize = 2048;

/// Turns hits into samples of one camera, remembering the last plane: neighbours mostly share it.
pub(super) struct Surveyor<'a, C> {
    caster: &'a C,
    lens: &'a Lens,
    footprint: RayFootprint,
    last: Option<(u32, Facet)>,
}

impl<'a, C: SubsetCaster> Surveyor<'a, C> {
    pub fn new(caster: &'a C, lens: &'a Lens) -> Self {
        // Textures are filtered over what one of the rays stands for that are averaged.
        let s = 1.0 / (lens.pixels_per_unit * f64::from(RAYS_ACROSS));
        let footprint = RayFootprint { direction_dx: lens.basis.right * s, direction_dy: -lens.basis.up * s };
        Self { caster, lens, footprint, last: None }
    }

    pub fn facet(&mut self, ray: &Ray, hit: &Hit) -> Facet {
        match self.last {
            // A plane has one normal; an analytic patch may not, so it must not be remembered: its
            // number repeats.
            Some((triangle, facet)) if triangle == hit.triangle && C::PLANAR => facet,
            _ => {
                let facet = self.caster.facet(ray, hit);
                self.last = Some((hit.triangle, facet));
                facet
            }
        }
    }

    pub fn linear(&self, ray: &Ray, hit: &Hit) -> [f32; 3] {
        self.caster.shade(ray, hit, &self.footprint)
    }

    /// The sample of a hit from the centre of projection.
    pub fn sample(&mut self, ray: &Ray, hit: &Hit) -> Sample {
        let facet = self.facet(ray, hit);
        let d = 1.0 / hit.t;
        Sample {
            disparity: d as f32,
            gradient: sample::gradient(self.lens, facet.normal, ray.direction, d),
            surface: facet.surface,
            triangle: hit.triangle,
            rgb: self.linear(ray, hit).map(srgb8_from_linear),
            apart: [0; 2],
        }
    }
}

/// One ray per pixel centre that is looked at, from the centre of projection: disparity 0 where
/// there is sky, [`sample::UNSEEN`] where nobody looks. And the number of rays.
pub(super) fn central_image<C: SubsetCaster>(caster: &C, rig: &Rig, looked: &Looked) -> (Vec<Sample>, u64) {
    let width = rig.window.width as usize;
    let unseen = Sample { disparity: sample::UNSEEN, ..Sample::default() };
    let mut samples = vec![unseen; rig.window.pixels()];
    let rays = samples.par_chunks_mut(width).enumerate().map(|(row, out)| {
        let mut surveyor = Surveyor::new(caster, &rig.lens);
        let mut count = 0;
        for run in looked.runs(row, width) {
            let ray = |column| pixel_ray(rig, row * width + column, rig.near_m, f64::INFINITY);
            let rays: Vec<Ray> = run.clone().map(ray).collect();
            let mut hits = vec![None; rays.len()];
            caster.trace(&rays, &mut hits);
            for ((ray, hit), out) in rays.iter().zip(&hits).zip(&mut out[run]) {
                *out = hit.map_or_else(Sample::default, |hit| surveyor.sample(ray, &hit));
            }
            count += rays.len() as u64;
        }
        count
    });
    let rays = rays.sum();
    (samples, rays)
}

/// The ray from the centre of projection through a pixel's centre.
pub(super) fn pixel_ray(rig: &Rig, pixel: usize, t_min: f64, t_max: f64) -> Ray {
    let (u, v) = rig.window.centre(pixel);
    Ray { origin: rig.cop, direction: rig.lens.ray(u, v), t_min, t_max }
}

/// A ray through (u, v) that can only hit near disparity `d`.
pub(super) fn short_ray(rig: &Rig, u: f64, v: f64, d: f64, margin: f64) -> Ray {
    // Beyond four times the depth a prediction is worthless.
    let farthest = (d - margin).max(0.25 * d);
    Ray {
        origin: rig.cop,
        direction: rig.lens.ray(u, v),
        t_min: (1.0 / (d + margin)).max(rig.near_m),
        t_max: 1.0 / farthest,
    }
}

/// A ray (`across`, `down`) pixels beside a sample's centre that can only hit its surface or what
/// continues it.
pub(super) fn ray_beside(rig: &Rig, (pixel, s): &Prediction, [across, down]: [f64; 2], tolerance: &Tolerance) -> Ray {
    let (u, v) = rig.window.centre(*pixel as usize);
    let (d, gu, gv) = (f64::from(s.disparity), f64::from(s.gradient[0]), f64::from(s.gradient[1]));
    let predicted = (d + across * gu + down * gv).clamp(0.25 * d, 4.0 * d);
    let margin = 0.25 * (gu.abs() + gv.abs()) + 2.0 * f64::from(tolerance.step);
    short_ray(rig, u + across, v + down, predicted, margin)
}

/// Traces each prediction's pixel centre and maps it, in order, with its hit.
pub(super) fn traced<C: SubsetCaster, T: Sync, R: Send>(
    caster: &C,
    rig: &Rig,
    items: &[T],
    ray_of: impl Fn(&T) -> Ray + Sync,
    result: impl Fn(&mut Surveyor<'_, C>, &T, &Ray, Option<&Hit>) -> R + Sync,
) -> Vec<R> {
    items
        .par_chunks(BATCH)
        .flat_map_iter(|chunk| {
            let rays: Vec<Ray> = chunk.iter().map(&ray_of).collect();
            let mut hits = vec![None; rays.len()];
            caster.trace(&rays, &mut hits);
            let mut surveyor = Surveyor::new(caster, &rig.lens);
            let results: Vec<R> =
                chunk.iter().zip(&rays).zip(&hits).map(|((i, r), h)| result(&mut surveyor, i, r, h.as_ref())).collect();
            results
        })
        .collect()
}
