//! Where surfaces end between pixel centres.
//!
//! In: linked layers. Out: per sample, for each side without a link, how far its surface goes on beyond the pixel's centre, and the slope that it has up to there.
//!
//! A pixel's centre is on a surface or is not, so a border drawn at the pixels' borders is off by up to half a pixel, twice that where surfaces part. Short rays beyond
//! the centre, at every [`END_PARTS`]th of a pixel, tell where it is. They meet the surface also where something nearer hides it from the
//! centre of projection: so what lies behind a border reaches under it, and neither cracks nor fringes are left.

use super::{
    caster::SubsetCaster,
    central::{ray_beside, traced},
    layers::{RawLayer, open_sides},
    sample::{Prediction, Tolerance},
    view::Rig,
};
use ldi_protocol::ldi::{END_BITS, END_PARTS, SIDES};

/// Sets the ends and slopes of a layer; returns the number of rays.
pub(super) fn measure<C: SubsetCaster>(caster: &C, rig: &Rig, layer: &mut RawLayer, tolerance: &Tolerance) -> u64 {
    let sides = open_sides(layer, rig.window.width);
    let open =
        || sides.iter().enumerate().flat_map(|(i, open)| (0..SIDES.len()).filter(|s| open[*s]).map(move |s| (i, s)));
    let samples = &layer.samples;
    let probes: Vec<(&Prediction, usize, u16)> =
        open().flat_map(|(i, side)| (0..END_PARTS).map(move |k| (&samples[i], side, k))).collect();
    let ray_of = |(sample, side, k): &(&Prediction, usize, u16)| {
        let beyond = (f64::from(*k) + 0.5) / f64::from(END_PARTS);
        ray_beside(rig, sample, SIDES[*side].map(|x| f64::from(x) * beyond), tolerance)
    };
    let met = traced(caster, rig, &probes, ray_of, |surveyor, ((_, s), ..), ray, hit| {
        hit.filter(|h| surveyor.facet(ray, h).surface == s.surface).map(|h| 1.0 / h.t)
    });
    let mut ends = vec![0; samples.len()];
    // Per axis, from the last place met on one side to that on the other: pixels, and the change of disparity.
    let mut chords = vec![[[0.0; 2]; 2]; samples.len()];
    for ((i, side), met) in open().zip(met.chunks_exact(usize::from(END_PARTS))) {
        let end = met.iter().take_while(|d| d.is_some()).count();
        ends[i] |= (end as u16) << (side * END_BITS);
        if let Some(d) = end.checked_sub(1).and_then(|last| met[last]) {
            let [across, down] = SIDES[side];
            let chord = &mut chords[i][side / 2];
            chord[0] += (end as f64 - 0.5) / f64::from(END_PARTS);
            chord[1] += f64::from(across + down) * (d - f64::from(samples[i].1.disparity));
        }
    }
    layer.ends = ends;
    let slope = |[pixels, change]: [f64; 2]| if pixels > 0.0 { change / pixels } else { 0.0 };
    layer.slopes = chords.into_iter().map(|axes| axes.map(slope)).collect();
    met.len() as u64
}
