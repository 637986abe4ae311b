//! Drawing on a graphics card: the twin of `near` and `warp`, with their stages and names.
//!
//! In: what those take. Out: what those give, on the card: there both are joined and averaged ([`composite_pass`]), or they are read back, a [`Frame`] of the near geometry and a [`FarFrame`] of the
//! warped images, which `composite` merges as it merges the processor's. The near geometry goes through the card's rasterizer ([`near`]), the micro-quads and the fixed stamps through compute shaders ([`warp`]),
//! so that an adapter without a rasterizer could still warp.
//!
//! Pictures equal the processor's up to rounding: f32 in place of f64 for vertices, a card's own filter weights, and pixels whose centres lie on an edge to
//! within that. `tests` holds both to stated bounds.
//!
//! An adapter may be software ([`Gpu::is_software`]); there the processor's own warp is several times faster, so that a short calibration ([`Gpu::calibrate`]) decides which
//! of the two draws.
//!
//! What was not taken from the papers: they had no cards. The 32-bit way to keep the nearest of many samples per pixel (two passes: depths first, then the colours of those that
//! hold the depth) is that of Schütz, Kerbl and Wimmer ("Rendering Point Clouds with Compute Shaders", 2021), where 64-bit atomics, their other way, are missing.

mod calibrate;
mod composite;
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

pub use calibrate::{Calibration, WarpOn};
pub use device::{Atomics, GpuError};
pub use images::Packed;
pub use lru::PATIENCE;
pub use textures::TextureUpload;

use crate::{
    composite::CodeStep,
    frame::Frame,
    near::NearStats,
    resident::Resident,
    warp::{FarFrame, ImageInView, Order, PreparedLdi, WarpOptions, WarpStats},
};
use device::{GpuDevice, Software};
use ldi_protocol::{OutputCamera, Pose, index::Index, mesh::CellGeometry, texture::Texture};
use std::sync::Arc;
use transfer::UploadBudget;

/// A graphics card, and what lies on it.
pub struct Gpu {
    card: GpuDevice,
    near: near::NearPass,
    warp: warp::WarpPass,
    composite_pass: composite::CompositePass,
    calibration: Option<Calibration>,
    /// Largest array that it can bind or hold, bytes.
    largest_bytes: u64,
    budget: UploadBudget,
}

impl std::fmt::Debug for Gpu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Gpu").field("adapter", &self.card.name).field("calibration", &self.calibration).finish()
    }
}

impl Gpu {
    /// Opens the best adapter there is.
    ///
    /// # Errors
    /// If there is none that can do it.
    pub fn open() -> Result<Self, GpuError> {
        Self::with(GpuDevice::open(Atomics::Best, Software::Too)?)
    }

    /// The same, but none that is the processor in disguise; that is found out before anything is made.
    ///
    /// # Errors
    /// If there is none that can do it.
    pub fn open_real() -> Result<Self, GpuError> {
        Self::with(GpuDevice::open(Atomics::Best, Software::No)?)
    }

    /// The same with a given way to keep the nearest sample: to compare them.
    ///
    /// # Errors
    /// If there is no adapter that can do it.
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

    /// Name of the adapter and how it is driven.
    pub fn adapter(&self) -> &str {
        &self.card.name
    }

    /// Whether the adapter is the processor in disguise.
    pub fn is_software(&self) -> bool {
        self.card.software
    }

    /// How the nearest sample of a pixel is kept.
    pub fn atomics(&self) -> Atomics {
        self.card.atomics
    }

    /// Whether a card can warp so: not with every stamp, and by depth only.
    ///
    /// # Errors
    /// Where it cannot.
    pub fn can_warp(options: &WarpOptions) -> Result<(), GpuError> {
        warp::number_of(options.stamp)?;
        if options.order == Order::Z { Ok(()) } else { Err(GpuError::Order(options.order)) }
    }

    /// Whether pictures of this size fit the card: its textures, and what its shaders may write to.
    pub fn fits(&self, camera: &OutputCamera) -> bool {
        let limits = self.card.device.limits();
        let pixels = u64::from(camera.width) * u64::from(camera.height);
        camera.width.max(camera.height) <= limits.max_texture_dimension_2d
            && warp::PIXEL_BYTES * pixels <= limits.max_storage_buffer_binding_size
    }

    /// Whether an image fits the card. Software drivers bind no more than 128 MiB: some ten million samples are larger.
    pub fn fits_image(&self, laid_out: &PreparedLdi) -> bool {
        self.warp.images.has(laid_out.serial) || images::largest_buffer(laid_out) <= self.largest_bytes
    }

    /// Bytes of geometry, textures and images that lie on the card, without pictures in the making.
    pub fn held_bytes(&self) -> u64 {
        self.near.bytes() + self.warp.images.bytes()
    }

    /// A smaller card.
    #[cfg(test)]
    pub(crate) fn shrink(&mut self, largest_bytes: u64) {
        self.largest_bytes = largest_bytes;
    }

    /// Decides whether the card warps, or the processor: by a short comparison, or as the caller says.
    ///
    /// # Errors
    /// If the card fails meanwhile.
    pub fn calibrate(&mut self, on: WarpOn) -> Result<Calibration, GpuError> {
        let calibration = calibrate::calibrate(self, on)?;
        self.calibration = Some(calibration);
        Ok(calibration)
    }

    /// What the calibration found; None before one.
    pub fn calibration(&self) -> Option<Calibration> {
        self.calibration
    }

    /// Whether the card warps, as the calibration found; before one, yes.
    pub fn warps(&self) -> bool {
        self.calibration.is_none_or(|c| c.on_card)
    }

    /// What [`crate::near::Rasterizer::draw`] does; the picture stays on the card.
    ///
    /// # Errors
    /// If the card fails.
    pub fn draw(
        &mut self,
        index: &Index,
        resident: &dyn Resident,
        cells: &[u32],
        camera: &OutputCamera,
        pose: &Pose,
    ) -> Result<NearStats, GpuError> {
        self.near.draw(&self.card, &mut self.budget, index, resident, cells, camera, pose)
    }

    /// Reads back what [`Self::draw`] drew with the same camera; `frame` becomes as large.
    ///
    /// # Errors
    /// If the card fails.
    pub fn read_near(&mut self, camera: &OutputCamera, frame: &mut Frame) -> Result<(), GpuError> {
        self.near.read(&self.card, camera, frame)
    }

    /// A frame begins that may put so many bytes of the scene onto the card; until one does there is no bound. What was not wanted for long makes room.
    pub fn begin_frame(&mut self, allowed: u64) {
        self.budget = UploadBudget::new(allowed);
        self.near.begin_frame();
        self.warp.images.begin_frame(|_| true);
    }

    /// Bytes that this frame has put onto the card. They exceed what it may by the small levels of a texture at most, and by what it draws without having brought it.
    pub fn uploaded_bytes(&self) -> u64 {
        self.budget.spent
    }

    /// Puts an image that fits ([`Self::fits_image`]) onto the card, as much of it as this frame may; what was packed already need not be. `ahead`: only if there is room besides what this
    /// frame wants. Returns whether all of it is there.
    ///
    /// # Errors
    /// If the card fails.
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

    /// Whether an image is on the card.
    pub fn holds(&self, laid_out: &PreparedLdi) -> bool {
        self.warp.images.get(laid_out.serial).is_some()
    }

    /// The same for geometry.
    ///
    /// # Errors
    /// If the card fails.
    pub fn upload_geometry(&mut self, chunk: &Arc<CellGeometry>, ahead: bool) -> Result<bool, GpuError> {
        let geometry = &mut self.near.geometry;
        let there = (!ahead || geometry.has_room(chunk)) && geometry.upload(&self.card, chunk, &mut self.budget);
        self.card.check()?;
        Ok(there)
    }

    /// The same for a texture, of which small levels come first.
    ///
    /// # Errors
    /// If the card fails.
    pub fn upload_texture(&mut self, number: u32, texture: &Arc<Texture>) -> Result<TextureUpload, GpuError> {
        let arrived = self.near.textures.upload(&self.card, number, texture, &mut self.budget);
        self.card.check()?;
        Ok(arrived)
    }

    /// Warps images that fit ([`Self::fits_image`]) to one picture, by depth: what [`crate::warp::warp_images`] does with [`crate::warp::Order::Z`]; the picture stays on the card.
    ///
    /// # Errors
    /// If the card fails, or cannot draw the stamp or the order.
    pub fn warp_images(
        &mut self,
        images: &[ImageInView<'_>],
        pose: &Pose,
        camera: &OutputCamera,
        options: &WarpOptions,
    ) -> Result<WarpStats, GpuError> {
        self.warp.warp_images(&self.card, images, pose, camera, options, &mut self.budget)
    }

    /// Reads back what [`Self::warp_images`] warped, into a picture of the same size.
    ///
    /// # Errors
    /// If the card fails.
    pub fn read_warped(&mut self, into: &mut FarFrame) -> Result<(), GpuError> {
        self.warp.read(&self.card, into)
    }

    /// Merges what [`Self::draw`] drew and, if something was `warped`, [`Self::warp_images`] warped, both with the same camera, by depth, and closes seams: [`crate::composite::merge`] without the sky. `open` takes a bit per
    /// pixel that neither reached, row by row, the lowest bit of a word first.
    ///
    /// # Errors
    /// If the card fails.
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

    /// Lays what was `found` where pixels are `open`, sky and samples of the LDI tree, into what [`Self::merge`] made, fills what is left if it is to be filled
    /// ([`crate::composite::Fill::Surface`]), and averages blocks of `factor` pixels into `out`, whose disparities are 0: they stay on the card. Returns how many pixels were filled.
    ///
    /// # Errors
    /// If the card fails.
    pub fn finish(
        &mut self,
        open: &[u32],
        found: &Frame,
        fill: bool,
        factor: u32,
        out: &mut Frame,
    ) -> Result<u64, GpuError> {
        self.composite_pass.finish(&self.card, open, found, fill, factor, out)
    }

    /// Forgets what lies on the card: numbers are about to mean something else.
    pub fn forget(&mut self) {
        self.near.forget();
        self.warp.images.clear();
    }
}
