//! What the shading of a picture has to know of its disparities.

use ldi_protocol::OutputCamera;

/// Smallest disparity that counts as a surface, 1/m. Sky has 0.
pub(super) const NOTHING: f32 = 1e-6;

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
}
