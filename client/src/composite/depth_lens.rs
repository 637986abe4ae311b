//! What the shading of a picture has to know of its disparities.

use ldi_protocol::OutputCamera;

/// Smallest disparity that counts as a surface, 1/m. Sky has 0.
pub(super) const NOTHING: f32 = 1e-6;

/// The smaller number; the second where one is NaN. Unlike `f32::min` it is one instruction.
#[inline(always)]
pub(super) fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The larger number; the second where one is NaN.
#[inline(always)]
pub(super) fn most(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The nearest number from 0 to 1; 0 for NaN.
#[inline(always)]
pub(super) fn share(x: f32) -> f32 {
    least(most(x, 0.0), 1.0)
}

/// Distances of the pairs of samples, as shares of the picture's height. The largest is limited by
/// the cost of cache misses, the smallest by the resolution. More: smoother, slower.
const REACH: [f32; 4] = [1.0 / 360.0, 1.0 / 120.0, 1.0 / 40.0, 1.0 / 15.0];

/// How disparities of a picture are to be read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthLens {
    /// Focal length, pixels.
    pub focal_px: f32,
    /// Largest error of a disparity d, 1/m: `noise[0] + noise[1] * d`. A second difference of less
    /// than four times that means nothing.
    pub noise: [f32; 2],
}

impl DepthLens {
    /// The lens of a camera for disparities with this error.
    pub fn new(camera: &OutputCamera, noise: [f32; 2]) -> Self {
        Self { focal_px: camera.focal_px() as f32, noise }
    }

    /// Distances of the pairs of samples in a picture of this size, in pixels at half resolution; 0
    /// for none.
    pub fn reach(&self, [width, height]: [u32; 2]) -> [usize; 4] {
        // A reflection needs as many pixels inside as outside.
        let most = (width.min(height).div_ceil(2) as usize).saturating_sub(1);
        REACH.map(|share| ((share * height as f32 * 0.5).round() as usize).max(1).min(most))
    }
}
