//! Calibration: warps the same image on the GPU and the CPU, once, to choose the faster one.

use super::{Calibration, Gpu, GpuError, WarpOn};
use crate::warp::{FarFrame, ImageInView, PreparedLdi, WarpError, WarpOptions, analytic, warp};
use glam::DVec3;
use ldi_protocol::{OutputCamera, Pose, ldi::Ldi};
use std::time::Instant;

/// Number of warps on each device, of which the fastest counts: the first ones include one-time
/// costs.
const ROUNDS: usize = 4;
/// Side of the calibration image, samples: large enough for the warp to exceed the cost of a call,
/// small enough to be fast.
const SIDE: u32 = 512;
const CAMERA: OutputCamera = OutputCamera { width: 640, height: 640, fov_deg: 60.0 };

impl Gpu {
    /// Chooses the device that warps, by a comparison or as given.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn calibrate(&mut self, on: WarpOn) -> Result<Calibration, GpuError> {
        let calibration = match on {
            WarpOn::Auto => compare(self)?,
            chosen => Calibration { on_card: chosen == WarpOn::Gpu, card_ms: None, processor_ms: None },
        };
        self.calibration = Some(calibration);
        Ok(calibration)
    }
}

/// Warps the same image on both devices.
fn compare(gpu: &mut Gpu) -> Result<Calibration, GpuError> {
    let laid_out = PreparedLdi::new(&image());
    let image = ImageInView::from(&laid_out);
    let pose = Pose { position: DVec3::new(0.1, 0.05, -0.1), yaw_deg: 3.0, pitch_deg: -2.0 };
    let options = WarpOptions::default();
    let mut far = FarFrame::default();
    let mut best = [f64::INFINITY; 2];
    for _ in 0..ROUNDS {
        let start = Instant::now();
        gpu.warp_images(&[image], &pose, &CAMERA, &options)?;
        best[0] = best[0].min(start.elapsed().as_secs_f64() * 1e3);
        let start = Instant::now();
        far.reset(CAMERA.width, CAMERA.height);
        let done: Result<_, WarpError> = warp(&laid_out, &pose, &CAMERA, &options, &mut far);
        // Order and stamp are the default ones, which go together.
        debug_assert!(done.is_ok());
        best[1] = best[1].min(start.elapsed().as_secs_f64() * 1e3);
    }
    gpu.warp.images.clear();
    Ok(Calibration { on_card: best[0] < best[1], card_ms: Some(best[0]), processor_ms: Some(best[1]) })
}

/// The calibration image: two walls, one behind the other, and a sphere.
fn image() -> Ldi {
    let scene = analytic::Scene {
        surfaces: vec![
            analytic::Surface::Sphere { centre: DVec3::new(0.2, -0.1, -3.0), radius: 0.6 },
            analytic::Surface::Fence { z: -4.0, period: 0.8, solid: 0.3 },
            analytic::Surface::Fence { z: -6.0, period: 100.0, solid: 101.0 },
        ],
        wavelength_m: 0.7,
    };
    scene.ldi(analytic::ldi_camera(DVec3::ZERO, SIDE, SIDE, 66.0), 3)
}
