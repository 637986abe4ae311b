//! A sample under construction: a small piece of plane seen through a pixel.
//!
//! The disparity of a plane is linear in the image: with n . (X - C) = n . P on the plane and X -
//! C = r(u, v) / d follows d = n . r(u, v) / (n . P). So a hit with its geometric normal predicts
//! the disparity in the whole pixel, and in the next one, exactly as far as the surface is plane.
//! Merging, linking and explaining all rest on this instead of on thresholds relative to depth: it
//! is what keeps slanted ground from being duplicated into layers.

use super::view::Lens;
use glam::DVec3;

/// A sample at a pixel centre, or a hit on its way to become one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Sample {
    /// 1 / depth, 1/m. 0: nothing here (in the central image: sky); [`UNSEEN`]: nobody looks here.
    pub disparity: f32,
    /// Change of disparity per column and per row along the surface.
    pub gradient: [f32; 2],
    /// Primitive of an instance.
    pub surface: u32,
    /// Triangle; samples of one triangle lie in one plane.
    pub triangle: u32,
    /// sRGB.
    pub rgb: [u8; 3],
    /// Pixels along each axis from one hit of the construction camera that found it to the next;
    /// 0: the centre of projection did.
    ///
    /// Where the centre faces a surface that eyes see at a grazing angle, a camera's pixel is many
    /// of the image's long: a wall behind a door would have a slit after every hit.
    pub apart: [u8; 2],
}

/// A sample to be: its pixel, and the disparity at the pixel's centre that its plane predicts.
pub(super) type Prediction = (u32, Sample);

/// The disparity of a pixel of the central image that no eye looks at: nothing is known of it.
pub(super) const UNSEEN: f32 = -1.0;

/// Largest change of disparity per pixel that is believed, relative to the disparity. A steeper
/// surface is seen so nearly edge-on that its next pixel says nothing; a larger value lets such
/// planes explain whatever lies behind them.
const STEEPEST: f64 = 1.0;

/// The disparity of a sample's plane where it has changed by so much, within reason: beyond four
/// times the depth a plane is worthless.
#[inline]
pub(super) fn bounded(s: &Sample, change: f32) -> f32 {
    (s.disparity + change).clamp(0.25 * s.disparity, 4.0 * s.disparity)
}

/// The gradient of disparity of the plane with normal `n` at image coordinates with ray `r` and
/// disparity `d`.
pub(super) fn gradient(lens: &Lens, n: DVec3, r: DVec3, d: f64) -> [f32; 2] {
    let facing = n.dot(r);
    let limit = STEEPEST * d;
    let g = |along: f64| {
        let x = d * along / (lens.pixels_per_unit * facing);
        // A plane through the centre of projection: NaN or infinite.
        if x.is_nan() { limit as f32 } else { x.clamp(-limit, limit) as f32 }
    };
    [g(n.dot(lens.basis.right)), g(-n.dot(lens.basis.up))]
}

/// How far two disparities may lie apart before anybody can see it, and before it is a different
/// surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tolerance {
    /// The disparity that moves a sample by an eighth of an output pixel for the worst eye: one
    /// quantization step.
    pub step: f32,
}

/// Different surfaces may be joined over at most this many steps (four output pixels of parallax
/// by the bound, about two in truth). Larger: a table, seen nearly edge-on, grows a skirt to the
/// wall behind it; smaller: floors tear from the walls they meet.
const ADJOINING_STEPS: f32 = 32.0;

impl Tolerance {
    /// Whether `b`, the next pixel along `axis` (0: right, 1: down), continues the surface of `a`:
    /// the step between them is a mixture of both slopes, as it is on one plane and on both sides
    /// of a crease wherever it runs between the centres.
    #[inline]
    pub fn continuous(&self, a: &Sample, b: &Sample, axis: usize) -> bool {
        let (ga, gb) = (a.gradient[axis], b.gradient[axis]);
        let delta = b.disparity - a.disparity;
        // Two pieces of a curved surface: more planes may lie between the centres than two.
        let slack = self.step + 0.25 * (ga - gb).abs();
        let explained = delta >= ga.min(gb) - slack && delta <= ga.max(gb) + slack;
        explained && (a.surface == b.surface || delta.abs() <= ADJOINING_STEPS * self.step)
    }

    /// Whether a predicted sample is the same piece of surface as one that is already in the pixel.
    #[inline]
    pub fn same(&self, known: &Sample, predicted: &Sample) -> bool {
        if known.triangle == predicted.triangle {
            return true;
        }
        let apart = (known.disparity - predicted.disparity).abs();
        let slope = |s: &Sample| 0.5 * (s.gradient[0].abs() + s.gradient[1].abs());
        apart <= self.step
            || (known.surface == predicted.surface && apart <= self.step + slope(known).max(slope(predicted)))
    }
}
