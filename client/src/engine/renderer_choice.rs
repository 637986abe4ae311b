//! The choice between CPU and GPU, made when the renderer is opened.

use super::frame_renderer::FrameRenderer;
use crate::gpu::{Gpu, GpuError, WarpOn};
use serde::Serialize;

/// The device that renders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Renderer {
    /// The CPU.
    Cpu,
    /// The GPU; a software driver is accepted.
    Gpu,
    /// The GPU if there is a hardware one, otherwise the CPU.
    Auto,
}

impl Renderer {
    /// Opens the renderer. `on` selects the device that warps; by default both are timed.
    ///
    /// # Errors
    /// If a GPU is required and none can draw.
    pub fn renderer(self, on: WarpOn) -> Result<FrameRenderer, GpuError> {
        let opened = match self {
            Self::Cpu => return Ok(FrameRenderer::default()),
            Self::Gpu => Gpu::open(),
            Self::Auto => Gpu::open_real(),
        };
        let calibrated = opened.and_then(|mut gpu| {
            let found = gpu.calibrate(on)?;
            tracing::info!("drawing on {}, warping on {found}", gpu.adapter());
            Ok(gpu)
        });
        match calibrated {
            Err(e) if self == Self::Auto => {
                tracing::info!("drawing on the CPU: {}", e.reason());
                Ok(FrameRenderer::default())
            }
            calibrated => Ok(FrameRenderer::on(calibrated?)),
        }
    }
}
