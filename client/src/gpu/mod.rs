//! Rendering on a GPU: the equivalents of `near`, `warp` and `composite`, with the same stages and
//! names.
//!
//! In and out as for those stages, with the pictures on the GPU: they are composited and averaged
//! there (`composite`), or read back as a [`Frame`] of near geometry and a [`FarFrame`] of warped
//! images. Near geometry uses the hardware rasterizer (`near`), micro-quads and fixed stamps
//! compute shaders (`warp`).
//!
//! Pictures equal those of the CPU up to rounding: f32 instead of f64 vertices, hardware filter
//! weights, and pixel centres on edges. `tests` holds both to stated bounds.
//!
//! An adapter may be software ([`Gpu::is_software`]), where the CPU's own warp is faster. A short
//! calibration ([`Gpu::calibrate`]) chooses the device that warps.
//!
//! The 32-bit method of keeping the nearest sample per pixel (two passes: depths first, then the
//! colours of samples at that depth) is by Schütz, Kerbl and Wimmer ("Rendering Point Clouds with
//! Compute Shaders", 2021). It is used where 64-bit atomics, their other method, are missing.

mod calibrate;
mod calibration;
mod composite;
mod depth_shading;
mod device;
mod geometry;
mod images;
mod lru;
mod near;
mod read_back;
#[cfg(test)]
mod tests;
mod textures;
mod transfer;
mod warp;

pub use calibration::{Calibration, WarpOn};
pub use composite::Finishing;
pub use device::{Atomics, GpuError};
pub use images::Packed;
pub use lru::PATIENCE;
pub use textures::TextureUpload;

use crate::{
    composite::CodeStep,
    frame::Frame,
    near::NearStats,
    resident::Resident,
    warp::{FarFrame, ImageInView, PreparedLdi, WarpOptions, WarpStats},
};
use device::{GpuDevice, Software};
use ldi_protocol::{
    OutputCamera, Pose,
    index::{DrawnCell, Index},
    mesh::CellGeometry,
    texture::Texture,
};
use std::sync::Arc;
use transfer::UploadBudget;

/// A GPU and the objects on it.
pub struct Gpu {
    card: GpuDevice,
    near: near::NearPass,
    warp: warp::WarpPass,
    composite_pass: composite::CompositePass,
    calibration: Option<Calibration>,
    /// Largest buffer that can be bound, bytes.
    largest_bytes: u64,
    budget: UploadBudget,
}

impl std::fmt::Debug for Gpu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Gpu").field("adapter", &self.card.name).field("calibration", &self.calibration).finish()
    }
}

impl Gpu {
    /// Opens the best adapter.
    ///
    /// # Errors
    /// If no adapter has the required features.
    pub fn open() -> Result<Self, GpuError> {
        Self::with(GpuDevice::open(Atomics::Best, Software::Too)?)
    }

    /// Opens the best hardware adapter.
    ///
    /// # Errors
    /// If no hardware adapter has the required features.
    pub fn open_real() -> Result<Self, GpuError> {
        Self::with(GpuDevice::open(Atomics::Best, Software::No)?)
    }

    /// Opens the best adapter with a given kind of atomics, for comparisons.
    ///
    /// # Errors
    /// If no adapter has the required features.
    pub fn open_with(atomics: Atomics) -> Result<Self, GpuError> {
        Self::with(GpuDevice::open(atomics, Software::Too)?)
    }

    fn with(card: GpuDevice) -> Result<Self, GpuError> {
        let (near, warp, composite_pass) =
            (near::NearPass::new(&card), warp::WarpPass::new(&card), composite::CompositePass::new(&card));
        card.check()?;
        let limits = card.device.limits();
        let largest_bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let budget = UploadBudget::new(u64::MAX);
        Ok(Self { card, near, warp, composite_pass, calibration: None, largest_bytes, budget })
    }

    /// Name of the adapter and its graphics interface.
    pub fn adapter(&self) -> &str {
        &self.card.name
    }

    /// Whether the adapter is software.
    pub fn is_software(&self) -> bool {
        self.card.software
    }

    /// The way to keep the nearest sample of a pixel.
    pub fn atomics(&self) -> Atomics {
        self.card.atomics
    }

    /// Checks whether the GPU can warp with these options: not all stamps, and only by depth.
    ///
    /// # Errors
    /// If it cannot.
    pub fn can_warp(options: &WarpOptions) -> Result<(), GpuError> {
        warp::check_options(options)
    }

    /// Whether pictures of this size fit the GPU's textures and buffers.
    pub fn fits(&self, camera: &OutputCamera) -> bool {
        let limits = self.card.device.limits();
        let pixels = u64::from(camera.width) * u64::from(camera.height);
        camera.width.max(camera.height) <= limits.max_texture_dimension_2d
            && warp::PIXEL_BYTES * pixels <= limits.max_storage_buffer_binding_size
    }

    /// Whether an image fits the GPU's largest buffer.
    pub fn fits_image(&self, laid_out: &PreparedLdi) -> bool {
        self.warp.images.has(laid_out.serial) || images::largest_buffer(laid_out) <= self.largest_bytes
    }

    /// Bytes of geometry, textures and images on the GPU, without pictures.
    pub fn held_bytes(&self) -> u64 {
        self.near.bytes() + self.warp.images.bytes()
    }

    /// Limits the largest buffer, for tests.
    #[cfg(test)]
    pub(crate) fn shrink(&mut self, largest_bytes: u64) {
        self.largest_bytes = largest_bytes;
    }

    /// Result of the calibration; None before it.
    pub fn calibration(&self) -> Option<Calibration> {
        self.calibration
    }

    /// Whether the GPU warps; true before the calibration.
    pub fn warps(&self) -> bool {
        self.calibration.is_none_or(|c| c.on_card)
    }

    /// The equivalent of [`crate::near::Rasterizer::draw`]; the picture stays on the GPU.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn draw(
        &mut self,
        index: &Index,
        resident: &dyn Resident,
        cells: &[DrawnCell],
        camera: &OutputCamera,
        pose: &Pose,
    ) -> Result<NearStats, GpuError> {
        self.near.draw(&self.card, &mut self.budget, index, resident, cells, camera, pose)
    }

    /// Reads the picture of [`Self::draw`] with the same camera into `frame`.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn read_near(&mut self, camera: &OutputCamera, frame: &mut Frame) -> Result<(), GpuError> {
        self.near.read(&self.card, camera, frame)
    }

    /// Starts a frame with an upload budget; before the first one uploads are unlimited. Evicts
    /// objects that were not used for long.
    pub fn begin_frame(&mut self, allowed: u64) {
        self.budget = UploadBudget::new(allowed);
        self.near.begin_frame();
        self.warp.images.begin_frame(|_| true);
    }

    /// Bytes uploaded by this frame. They exceed the budget at most by the small levels of a
    /// texture, and by objects that are drawn without having been uploaded before.
    pub fn uploaded_bytes(&self) -> u64 {
        self.budget.spent
    }

    /// Uploads an image that fits ([`Self::fits_image`]) within the budget; `packed` saves packing
    /// it again. `ahead`: only if there is room beside what this frame uses. Returns whether it is
    /// complete.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn upload_image(
        &mut self,
        laid_out: &PreparedLdi,
        packed: &mut Option<Packed>,
        ahead: bool,
    ) -> Result<bool, GpuError> {
        let there = self.warp.upload(&self.card, laid_out, packed, ahead, &mut self.budget);
        self.card.check()?;
        Ok(there)
    }

    /// Whether an image is complete on the GPU.
    pub fn holds(&self, laid_out: &PreparedLdi) -> bool {
        self.warp.images.get(laid_out.serial).is_some()
    }

    /// Uploads a geometry chunk, as [`Self::upload_image`] does.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn upload_geometry(&mut self, chunk: &Arc<CellGeometry>, ahead: bool) -> Result<bool, GpuError> {
        let geometry = &mut self.near.geometry;
        let there = (!ahead || geometry.has_room(chunk)) && geometry.upload(&self.card, chunk, &mut self.budget);
        self.card.check()?;
        Ok(there)
    }

    /// Uploads a texture within the budget, small levels first.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn upload_texture(&mut self, number: u32, texture: &Arc<Texture>) -> Result<TextureUpload, GpuError> {
        let arrived = self.near.textures.upload(&self.card, number, texture, &mut self.budget);
        self.card.check()?;
        Ok(arrived)
    }

    /// Warps images that fit ([`Self::fits_image`]) by depth, the equivalent of
    /// [`crate::warp::warp_images`] with [`crate::warp::Order::Z`]; the picture stays on the GPU.
    ///
    /// # Errors
    /// If the GPU fails, or does not implement the stamp or the order.
    pub fn warp_images(
        &mut self,
        images: &[ImageInView<'_>],
        pose: &Pose,
        camera: &OutputCamera,
        options: &WarpOptions,
    ) -> Result<WarpStats, GpuError> {
        self.warp.warp_images(&self.card, images, pose, camera, options, &mut self.budget)
    }

    /// Reads the picture of [`Self::warp_images`] into one of the same size.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn read_warped(&mut self, into: &mut FarFrame) -> Result<(), GpuError> {
        self.warp.read(&self.card, into)
    }

    /// Merges the pictures of [`Self::draw`] and, if something was `warped`, [`Self::warp_images`],
    /// both with the same camera, by depth, and closes seams: [`crate::composite::merge`] without
    /// the sky. `open` takes a bit per pixel that neither reached, row by row, lowest bit of a word
    /// first.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn merge(
        &mut self,
        warped: bool,
        steps: &[CodeStep],
        camera: &OutputCamera,
        open: &mut Vec<u32>,
    ) -> Result<(), GpuError> {
        let Some(near) = self.near.textures() else { return Err(self.card.failed("nothing was drawn")) };
        let far = warped.then(|| self.warp.planes(&self.card));
        self.composite_pass.merge(&self.card, &composite::DrawnPlanes { near, far }, steps, camera, open)
    }

    /// Adds sky and tree samples, `found` for `open` pixels, to the result of [`Self::merge`],
    /// fills holes if wanted ([`crate::composite::Fill::Surface`]), and averages blocks of `factor`
    /// pixels into `out`, whose disparities are 0. Returns the number of filled pixels.
    ///
    /// # Errors
    /// If the GPU fails.
    pub fn finish(
        &mut self,
        open: &[u32],
        found: &Frame,
        finishing: &Finishing,
        out: &mut Frame,
    ) -> Result<u64, GpuError> {
        self.composite_pass.finish(&self.card, open, found, finishing, out)
    }

    /// Drops all objects of the scene: the next scene uses the same numbers for others.
    pub fn forget(&mut self) {
        self.near.forget();
        self.warp.images.clear();
    }
}
