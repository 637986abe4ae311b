//! The render backend: runs each stage of a frame on the CPU or the GPU.
//!
//! The GPU draws near geometry and composites, and warps where that is faster than on the CPU. The
//! CPU runs every stage that the GPU cannot.

use crate::{
    composite::CodeStep,
    frame::Frame,
    gpu::{Finishing, Gpu, GpuError, Packed},
    near::{NearStats, Rasterizer},
    resident::Resident,
    warp::{FarFrame, ImageInView, PreparedLdi, WarpError, WarpOptions, WarpStats, warp_images},
};
use ldi_protocol::{
    OutputCamera, Pose,
    index::{DrawnCell, Index},
};

/// A frame could not be rendered.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RenderError {
    /// The options ask for an order that cannot draw the stamp.
    #[error(transparent)]
    Warp(#[from] WarpError),
    /// The GPU failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// The rasterizer, buffers and GPU of a renderer.
#[derive(Debug, Default)]
pub struct RenderBackend {
    rasterizer: Rasterizer,
    /// Buffer for one image of several, where the order within an image matters and must not mix
    /// with that of others.
    single: FarFrame,
    gpu: Option<Box<Gpu>>,
    /// The parts of the frame that only the GPU holds.
    on_card: OnGpu,
}

/// Buffers on the GPU that were not read back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct OnGpu {
    near: bool,
    warped: bool,
}

impl RenderBackend {
    /// Creates a backend with a GPU.
    pub fn on(gpu: Gpu) -> Self {
        Self { gpu: Some(Box::new(gpu)), ..Self::default() }
    }

    /// The GPU, if one is used.
    pub fn gpu(&self) -> Option<&Gpu> {
        self.gpu.as_deref()
    }

    /// Drops all state of the scene: the next scene uses the same numbers for other objects.
    pub fn forget(&mut self) {
        self.rasterizer = Rasterizer::default();
        if let Some(gpu) = &mut self.gpu {
            gpu.forget();
        }
    }

    /// The GPU, if it can draw pictures of this size.
    pub(super) fn gpu_for(&mut self, camera: &OutputCamera) -> Option<&mut Gpu> {
        self.gpu.as_deref_mut().filter(|gpu| gpu.fits(camera))
    }

    /// The GPU, if it is to warp with these options.
    pub(super) fn warping_gpu_for(&mut self, camera: &OutputCamera, options: &WarpOptions) -> Option<&mut Gpu> {
        self.gpu_for(camera).filter(|gpu| gpu.warps() && Gpu::can_warp(options).is_ok())
    }

    /// Draws near geometry into `frame`, which takes the camera's size, or into GPU textures. The
    /// first stage of a frame.
    pub fn draw_near(
        &mut self,
        index: &Index,
        resident: &dyn Resident,
        cells: &[DrawnCell],
        camera: &OutputCamera,
        pose: &Pose,
        frame: &mut Frame,
    ) -> Result<NearStats, RenderError> {
        self.on_card = OnGpu::default();
        match self.gpu_for(camera) {
            Some(gpu) => {
                let stats = gpu.draw(index, resident, cells, camera, pose)?;
                self.on_card.near = true;
                Ok(stats)
            }
            None => Ok(self.rasterizer.draw(index, resident, cells, camera, pose, frame)),
        }
    }

    /// Begins a frame that may upload `allowed` bytes.
    pub fn begin_frame(&mut self, allowed: u64) {
        if let Some(gpu) = &mut self.gpu {
            gpu.begin_frame(allowed);
        }
    }

    /// Bytes uploaded by this frame.
    pub fn uploaded_bytes(&self) -> u64 {
        self.gpu.as_ref().map_or(0, |gpu| gpu.uploaded_bytes())
    }

    /// The GPU, if it is to warp this image with these options.
    fn warping_gpu_for_image(
        &mut self,
        laid_out: &PreparedLdi,
        camera: &OutputCamera,
        options: &WarpOptions,
    ) -> Option<&mut Gpu> {
        self.warping_gpu_for(camera, options).filter(|gpu| gpu.fits_image(laid_out))
    }

    /// Uploads an image if the GPU warps it ([`Gpu::upload_image`]). Returns whether it can be
    /// warped now.
    pub fn upload(
        &mut self,
        laid_out: &PreparedLdi,
        packed: &mut Option<Packed>,
        ahead: bool,
        camera: &OutputCamera,
        options: &WarpOptions,
    ) -> Result<bool, RenderError> {
        match self.warping_gpu_for_image(laid_out, camera, options) {
            Some(gpu) => Ok(gpu.upload_image(laid_out, packed, ahead)?),
            None => Ok(true),
        }
    }

    /// Whether an image can be warped now.
    pub fn holds(&mut self, laid_out: &PreparedLdi, camera: &OutputCamera, options: &WarpOptions) -> bool {
        self.warping_gpu_for_image(laid_out, camera, options).is_none_or(|gpu| gpu.holds(laid_out))
    }

    /// Warps images to one picture, into `into` or GPU buffers: within an image by the given order,
    /// between images by depth. `near` holds the near geometry, unless the GPU does.
    pub fn warp(
        &mut self,
        images: &[ImageInView<'_>],
        near: &Frame,
        pose: &Pose,
        camera: &OutputCamera,
        options: &WarpOptions,
        into: &mut FarFrame,
    ) -> Result<WarpStats, RenderError> {
        // All images of a picture are warped by the same device.
        let fit = |gpu: &&mut Gpu| images.iter().all(|i| gpu.fits_image(i.laid_out));
        if let Some(gpu) = self.warping_gpu_for(camera, options).filter(fit) {
            let stats = gpu.warp_images(images, pose, camera, options)?;
            self.on_card.warped = true;
            return Ok(stats);
        }
        let near = if self.on_card.near { &[][..] } else { &near.disparity };
        Ok(warp_images(images, near, pose, camera, options, into, &mut self.single)?)
    }

    /// Composites near geometry and warped images on the GPU, if it holds both (`into` was passed
    /// to [`Self::warp`]) and is faster at it. Returns a bit for each pixel that nothing reached
    /// ([`Gpu::merge`]). None: the CPU composites, after [`Self::read_back`].
    pub fn merge(
        &mut self,
        steps: &[CodeStep],
        camera: &OutputCamera,
        into: &FarFrame,
    ) -> Result<Option<Vec<u32>>, RenderError> {
        let OnGpu { near, warped } = self.on_card;
        let all = near && (warped || into.is_untouched());
        let Some(gpu) = self.gpu.as_deref_mut().filter(|gpu| all && gpu.warps()) else { return Ok(None) };
        let mut open = Vec::new();
        gpu.merge(warped, steps, camera, &mut open)?;
        Ok(Some(open))
    }

    /// See [`Gpu::finish`].
    pub fn finish(
        &mut self,
        open: &[u32],
        found: &Frame,
        finishing: &Finishing,
        out: &mut Frame,
    ) -> Result<u64, RenderError> {
        match self.gpu.as_deref_mut() {
            Some(gpu) => Ok(gpu.finish(open, found, finishing, out)?),
            None => Ok(0),
        }
    }

    /// Copies buffers that only the GPU holds to where the CPU composites.
    pub fn read_back(
        &mut self,
        camera: &OutputCamera,
        frame: &mut Frame,
        warped: &mut FarFrame,
    ) -> Result<(), RenderError> {
        let on_card = std::mem::take(&mut self.on_card);
        let Some(gpu) = self.gpu.as_deref_mut() else { return Ok(()) };
        if on_card.near {
            gpu.read_near(camera, frame)?;
        }
        if on_card.warped {
            gpu.read_warped(warped)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{gpu::GpuError, warp::analytic};
    use glam::DVec3;

    #[test]
    fn images_larger_than_the_card_are_the_processors() {
        let gpu = match Gpu::open() {
            Err(e @ (GpuError::NoAdapter(_) | GpuError::Lacking { .. })) => return eprintln!("SKIPPED: {e}"),
            opened => opened.expect("an adapter that draws"),
        };
        let laid_out =
            PreparedLdi::new(&analytic::scene("sphere").ldi(analytic::ldi_camera(DVec3::ZERO, 64, 64, 80.0), 3));
        let camera = OutputCamera { width: 160, height: 100, fov_deg: 70.0 };
        let pose = Pose { position: DVec3::new(0.1, 0.05, -0.2), yaw_deg: 5.0, pitch_deg: 0.0 };
        let mut small = RenderBackend::on(gpu);
        small.gpu.as_mut().expect("a card").shrink(1000);
        let options = WarpOptions::default();
        let brought = small.upload(&laid_out, &mut None, false, &camera, &options);
        assert_eq!(brought, Ok(true), "left to the processor");
        let drawn = |backend: &mut RenderBackend| {
            let mut far = FarFrame::new(camera.width, camera.height);
            let images = [ImageInView::from(&laid_out)];
            backend.warp(&images, &Frame::default(), &pose, &camera, &options, &mut far).expect("warped");
            backend.read_back(&camera, &mut Frame::default(), &mut far).expect("read back");
            far.packed
        };
        assert!(drawn(&mut small) == drawn(&mut RenderBackend::default()), "bit by bit");
        let gpu = small.gpu.as_mut().expect("a card");
        assert!(!gpu.holds(&laid_out));
    }
}
