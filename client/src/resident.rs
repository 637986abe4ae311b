//! The interface through which the renderer reads decoded objects.

use ldi_protocol::{ldi::Ldi, mesh::CellGeometry, texture::Texture, tree::Brood};
use std::sync::Arc;

/// Decoded data that is resident now. Absent data is None: the frame is drawn without it, and says
/// so.
pub trait Resident: Sync {
    /// Geometry of a cell.
    fn cell(&self, cell: u32) -> Option<Arc<CellGeometry>>;
    /// A bundle of shared clusters, by chunk number.
    fn bundle(&self, chunk: u32) -> Option<Arc<CellGeometry>>;
    /// A texture with the levels that have arrived; None without any.
    fn texture(&self, texture: u32) -> Option<Arc<Texture>>;
    /// The LDI of an image with the layers that have arrived; None without the first.
    fn ldi(&self, image: u32) -> Option<Arc<Ldi>>;
    /// Nodes of the LDI tree, by chunk number.
    fn brood(&self, chunk: u32) -> Option<Arc<Brood>>;
}
