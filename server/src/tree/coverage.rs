//! Which parts of its pixel a surface covers.
//!
//! In: a caster and a patch, the surface of one sample continued over its pixel. Out: the coverage
//! mask, measured by rays along the face's axis. So the mask depends on the scene alone, not on
//! which references saw the surface and how finely: a wall ends at its rim, a pipe that is thinner
//! than the pixel covers a part of it, and a sample that bilinear weights spread beyond a rim
//! covers nothing.

use crate::render::{Caster, CellSet, Ray};
use glam::DVec3;
use ldi_protocol::tree::{PARTS, WHOLE, across};

/// So far before and behind the patch a surface is looked for, pitches. Larger: surfaces beside it
/// count, and tangents of curved ones stick out; smaller: rough surfaces get holes.
const REACH: f64 = 0.35;
/// Every other part, like the black fields of a chessboard. Where the middles of all of them are
/// covered the pixel is taken to be: an eighth of the rays on walls.
const CHECKERED: u16 = 0xa5a5;
/// A part is covered if a surface is at one of these places beside its middle, in parts. Farther
/// apart: outlines widen; nearer: surfaces that meet at an edge part there.
const PLACES: [f64; 2] = [-0.25, 0.25];

/// A sample's surface within its pixel.
#[derive(Debug, Clone, Copy)]
pub struct Patch {
    /// Where it crosses the pixel's middle, world, metres.
    pub middle: DVec3,
    /// 0 to 5: -x, +x, -y, +y, -z, +z.
    pub face: usize,
    /// Growth of the coordinate along the face's axis per column and per row.
    pub slope: [f32; 2],
    /// Side of the pixel, metres.
    pub pitch_m: f64,
}

impl Patch {
    /// Whether a surface is near the patch at a place, in pitches from the pixel's middle.
    fn is_met(&self, caster: &Caster, u: f64, v: f64) -> bool {
        let axis = self.face / 2;
        let outwards = if self.face % 2 == 1 { 1.0 } else { -1.0 };
        let [a, b] = across(axis);
        let reach = REACH * self.pitch_m;
        let mut origin = self.middle;
        origin[a] += u * self.pitch_m;
        origin[b] += v * self.pitch_m;
        origin[axis] += (f64::from(self.slope[0]) * u + f64::from(self.slope[1]) * v) * self.pitch_m;
        origin[axis] += outwards * reach;
        let mut direction = DVec3::ZERO;
        direction[axis] = -outwards;
        caster.occluded(&Ray { t_max: 2.0 * reach, ..Ray::new(origin, direction) }, &CellSet::all())
    }
}

/// The coverage mask of a patch; 0 if no surface is there.
pub fn measure(caster: &Caster, patch: &Patch) -> u16 {
    let place = |part: u32, beside: f64| (f64::from(part) + 0.5 + beside) / f64::from(PARTS) - 0.5;
    let is_met = |part: u32, beside: [f64; 2]| {
        patch.is_met(caster, place(part % PARTS, beside[0]), place(part / PARTS, beside[1]))
    };
    let parts = 0..PARTS * PARTS;
    if parts.clone().filter(|part| CHECKERED >> part & 1 == 1).all(|part| is_met(part, [0.0; 2])) {
        return WHOLE;
    }
    let around = PLACES.map(|v| PLACES.map(|u| [u, v]));
    let is_covered = |part: &u32| around.as_flattened().iter().any(|beside| is_met(*part, *beside));
    parts.filter(is_covered).fold(0, |mask, part| mask | 1 << part)
}
