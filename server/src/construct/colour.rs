//! Colours averaged over the pixel, where it shows.
//!
//! A sample's colour is the mean, in linear light, of n x n rays through its pixel that hit its
//! surface or what continues it; its disparity stays that of the central ray, so nothing is
//! averaged across a depth edge. A plain wall has the same colour all over its pixel: so rays go
//! only where linked neighbours differ in colour. Textures are among those: each ray filters a
//! part of the pixel, as one mip level for all of it is as coarse as the pixel's longest side on
//! the surface.

use super::{
    caster::SubsetCaster,
    central::{ray_beside, traced},
    layers::{RawLayer, for_each_link},
    sample::{Prediction, Tolerance},
    view::Rig,
};
use ldi_protocol::shade::srgb8_from_linear;

/// Neighbours whose colours differ by more than this in some channel (8-bit sRGB) are averaged.
/// Smaller chases shading gradients, which a mean does not change; larger leaves visible steps.
const VISIBLE: u8 = 4;

/// Rays that are averaged, across a pixel and down it. One blurs textures; more cost a build their
/// square.
pub(super) const RAYS_ACROSS: u32 = 2;

/// Averages the colours of the layers in place; returns the number of rays.
pub(super) fn average<C: SubsetCaster>(caster: &C, rig: &Rig, layers: &mut [RawLayer], tolerance: &Tolerance) -> u64 {
    let mut rays = 0;
    for layer in layers {
        let marked = uneven(layer, rig.window.width);
        let mut items: Vec<(Prediction, f64, f64)> =
            Vec::with_capacity(marked.len() * (RAYS_ACROSS * RAYS_ACROSS) as usize);
        for &i in &marked {
            for sub in 0..RAYS_ACROSS * RAYS_ACROSS {
                let at = |k: u32| (f64::from(k) + 0.5) / f64::from(RAYS_ACROSS) - 0.5;
                items.push((layer.samples[i], at(sub % RAYS_ACROSS), at(sub / RAYS_ACROSS)));
            }
        }
        rays += items.len() as u64;
        let ray_of = |(p, du, dv): &(Prediction, f64, f64)| ray_beside(rig, p, [*du, *dv], tolerance);
        let colours = traced(caster, rig, &items, ray_of, |surveyor, _, ray, hit| hit.map(|h| surveyor.linear(ray, h)));
        for (i, seen) in marked.into_iter().zip(colours.chunks((RAYS_ACROSS * RAYS_ACROSS) as usize)) {
            let mut sum = [0.0_f32; 3];
            let mut n = 0.0_f32;
            for c in seen.iter().flatten() {
                n += 1.0;
                sum = std::array::from_fn(|k| sum[k] + c[k]);
            }
            // No sub-ray met the surface: a sliver through the centre keeps the centre's colour.
            if n > 0.0 {
                layer.samples[i].1.rgb = sum.map(|x| srgb8_from_linear(x / n));
            }
        }
    }
    rays
}

/// Samples with a linked neighbour of a visibly different colour, ascending.
fn uneven(layer: &RawLayer, width: u32) -> Vec<usize> {
    let mut marks = vec![false; layer.samples.len()];
    for_each_link(layer, width, |i, j, _| {
        let (a, b) = (&layer.samples[i].1, &layer.samples[j].1);
        if (0..3).any(|k| a.rgb[k].abs_diff(b.rgb[k]) > VISIBLE) {
            marks[i] = true;
            marks[j] = true;
        }
    });
    marks.iter().enumerate().filter(|(_, m)| **m).map(|(i, _)| i).collect()
}
