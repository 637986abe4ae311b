//! Where surfaces end between pixel centres.
//!
//! In: linked layers. Out: per sample, for each side without a link, how far its surface goes on
//! beyond the pixel's centre, and the slope that it has up to there.
//!
//! A pixel's centre is on a surface or is not, so a border drawn at the pixels' borders is off by
//! up to half a pixel, twice that where surfaces part. Short rays beyond the centre, at every
//! [`END_PARTS`]th of a pixel, tell where it is. They meet the surface also where something nearer
//! hides it from the centre of projection: so what lies behind a border reaches under it, and
//! neither cracks nor fringes are left.

use super::{
    caster::SubsetCaster,
    central::{ray_beside, traced},
    layers::{RawLayer, open_sides},
    sample::Tolerance,
    view::Rig,
};
use ldi_protocol::ldi::{END_BITS, END_PARTS, SIDES};

/// How far a surface goes on from a sample.
struct Reached {
    /// Position among the layer's samples.
    sample: usize,
    side: usize,
    /// Parts of a pixel in which rays met the surface, one after the other.
    end: u16,
    /// Disparity where the last of these rays met it.
    last: f64,
}

/// Sets the ends and slopes of a layer; returns the number of rays.
pub(super) fn measure<C: SubsetCaster>(caster: &C, rig: &Rig, layer: &mut RawLayer, tolerance: &Tolerance) -> u64 {
    let sides = open_sides(layer, rig.window.width);
    let samples = &layer.samples;
    let mut reached: Vec<Reached> = Vec::new();
    for (sample, open) in sides.iter().enumerate() {
        reached.extend((0..SIDES.len()).filter(|s| open[*s]).map(|side| Reached { sample, side, end: 0, last: 0.0 }));
    }
    let mut rays = 0;
    // A part is asked for only where the surface goes on through the one before it.
    let mut asked: Vec<u32> = (0..reached.len() as u32).collect();
    for part in 0..END_PARTS {
        let beyond = (f64::from(part) + 0.5) / f64::from(END_PARTS);
        let ray_of = |number: &u32| {
            let Reached { sample, side, .. } = reached[*number as usize];
            ray_beside(rig, &samples[sample], SIDES[side].map(|x| f64::from(x) * beyond), tolerance)
        };
        let met = traced(caster, rig, &asked, ray_of, |surveyor, number, ray, hit| {
            let surface = samples[reached[*number as usize].sample].1.surface;
            hit.filter(|h| surveyor.facet(ray, h).surface == surface).map(|h| 1.0 / h.t)
        });
        rays += met.len() as u64;
        let mut met = met.into_iter();
        asked.retain(|number| {
            let met = met.next().flatten();
            if let Some(disparity) = met {
                let reached = &mut reached[*number as usize];
                (reached.end, reached.last) = (part + 1, disparity);
            }
            met.is_some()
        });
    }
    let mut ends = vec![0; samples.len()];
    // Per axis, from the last place met on one side to that on the other: pixels, and the change
    // of disparity.
    let mut chords = vec![[[0.0; 2]; 2]; samples.len()];
    for Reached { sample, side, end, last } in reached {
        ends[sample] |= end << (side * END_BITS);
        if end > 0 {
            let [across, down] = SIDES[side];
            let chord = &mut chords[sample][side / 2];
            chord[0] += (f64::from(end) - 0.5) / f64::from(END_PARTS);
            chord[1] += f64::from(across + down) * (last - f64::from(samples[sample].1.disparity));
        }
    }
    layer.ends = ends;
    let slope = |[pixels, change]: [f64; 2]| if pixels > 0.0 { change / pixels } else { 0.0 };
    layer.slopes = chords.into_iter().map(|axes| axes.map(slope)).collect();
    rays
}
