//! Uploads images and geometry to the GPU under a byte budget per frame: first the objects that the
//! frame shows, then those that the next frames may show.
//!
//! In: resident, laid out and wanted objects. Out: those that can be drawn now. Without a GPU these
//! are all objects.

use super::{
    image_layouts::{ImageLayout, ImageLayouts, LayoutRequest},
    render_backend::{RenderBackend, RenderError},
};
use crate::{
    gpu::{PATIENCE, TextureUpload},
    resident::{self, Resident},
    warp::WarpOptions,
};
use ldi_protocol::{
    OutputCamera,
    index::{DrawnCell, Index},
    ldi::Ldi,
    mesh::CellGeometry,
    texture::Texture,
    tree::Brood,
};
use std::{collections::BTreeSet, sync::Arc};

/// Upload budget of a frame while the eye moves, bytes. Larger: uneven frame times; smaller:
/// objects that were not anticipated appear later.
const MOVING_BYTES: u64 = 4 << 20;
/// Upload budget of a frame while the eye rests, bytes. Larger: a single frame may take long;
/// smaller: a resting view takes longer to become complete.
const RESTING_BYTES: u64 = 32 << 20;

/// Upload budget of a frame, bytes.
pub(super) fn upload_budget_bytes(background_layout: bool, moving: bool) -> u64 {
    match (background_layout, moving) {
        (false, _) => u64::MAX,
        (true, true) => MOVING_BYTES,
        (true, false) => RESTING_BYTES,
    }
}

/// Objects that the next frames may show, likeliest first.
#[derive(Debug, Clone, Default)]
pub struct Anticipated {
    /// Images.
    pub images: Vec<u32>,
    /// Cells.
    pub cells: Vec<DrawnCell>,
}

/// Resident objects that are still being uploaded.
#[derive(Debug, Default)]
pub(super) struct PendingUploads {
    /// Chunks that cannot be drawn yet.
    pub chunks: BTreeSet<u32>,
    /// Number of textures currently shown at a coarser mip level.
    pub coarse: usize,
}

/// Decoded data, without chunks that are still being uploaded.
pub(super) struct UploadedOnly<'a> {
    pub resident: &'a dyn Resident,
    pub index: &'a Index,
    pub late: &'a BTreeSet<u32>,
}

impl Resident for UploadedOnly<'_> {
    fn cell(&self, cell: u32) -> Option<Arc<CellGeometry>> {
        let entry = self.index.cells.get(cell as usize)?;
        if self.late.contains(&entry.chunk) { None } else { self.resident.cell(cell) }
    }

    fn bundle(&self, chunk: u32) -> Option<Arc<CellGeometry>> {
        if self.late.contains(&chunk) { None } else { self.resident.bundle(chunk) }
    }

    fn texture(&self, texture: u32) -> Option<Arc<Texture>> {
        let late = first_chunk(self.index, texture).is_some_and(|c| self.late.contains(&c));
        if late { None } else { self.resident.texture(texture) }
    }

    fn ldi(&self, image: u32) -> Option<Arc<Ldi>> {
        self.resident.ldi(image)
    }

    fn brood(&self, chunk: u32) -> Option<Arc<Brood>> {
        self.resident.brood(chunk)
    }
}

fn first_chunk(index: &Index, texture: u32) -> Option<u32> {
    index.textures.get(texture as usize)?.chunks.first().map(|c| c.chunk)
}

/// Uploads the geometry and textures of cells. `ahead`: only within the budget that the frame
/// itself leaves.
pub(super) fn upload_cells(
    backend: &mut RenderBackend,
    index: &Index,
    resident: &dyn Resident,
    cells: &[DrawnCell],
    camera: &OutputCamera,
    ahead: bool,
) -> Result<PendingUploads, RenderError> {
    let mut late = PendingUploads::default();
    let Some(gpu) = backend.gpu_for(camera) else { return Ok(late) };
    let mut seen = BTreeSet::new();
    for drawn in cells {
        let (Some(entry), Some(mesh)) = (index.cells.get(drawn.cell as usize), index.mesh_of(*drawn)) else { continue };
        let bundles = mesh.bundles.iter().filter_map(|b| Some((*b, resident.bundle(*b)?)));
        let own = resident::mesh(index, resident, *drawn).map(|g| (mesh.chunk, g));
        for (chunk, geometry) in own.into_iter().chain(bundles) {
            if seen.insert(chunk) && !gpu.upload_geometry(&geometry, ahead)? {
                late.chunks.insert(chunk);
            }
        }
        let textures = entry.materials.iter().filter_map(|m| index.materials.get(*m as usize)?.texture);
        for (number, texture) in textures.filter_map(|t| Some((t, resident.texture(t)?))) {
            let Some(chunk) = first_chunk(index, number).filter(|c| seen.insert(*c)) else { continue };
            match gpu.upload_texture(number, &texture)? {
                TextureUpload::All => {}
                TextureUpload::Coarse => late.coarse += 1,
                TextureUpload::Nothing => drop(late.chunks.insert(chunk)),
            }
        }
    }
    Ok(late)
}

/// Laid out images that are being uploaded, each with the number of frames since it was last
/// wanted.
#[derive(Debug, Default)]
pub(super) struct UploadQueue(Vec<(ImageLayout, u64)>);

impl UploadQueue {
    /// Adds a finished layout.
    pub fn insert(&mut self, layout: ImageLayout) {
        let same = |l: &ImageLayout| (l.of.number, l.of.half) == (layout.of.number, layout.of.half);
        self.0.retain(|(l, _)| !same(l));
        self.0.push((layout, 0));
    }

    /// Whether the layout is queued.
    pub fn holds(&self, wanted: &LayoutRequest) -> bool {
        self.0.iter().any(|(l, _)| l.of.is(wanted))
    }

    /// Whether any queued image was wanted or anticipated by the last frame.
    pub fn is_under_way(&self) -> bool {
        self.0.iter().any(|(_, idle)| *idle == 0)
    }

    /// Uploads images in this order, `ahead` after those that the view wants, and moves finished
    /// ones to `layouts`. Drops images that no frame has wanted for long.
    pub fn upload(
        &mut self,
        backend: &mut RenderBackend,
        layouts: &mut ImageLayouts,
        (wanted, ahead): (&[u32], &[u32]),
        camera: &OutputCamera,
        options: &WarpOptions,
    ) -> Result<(), RenderError> {
        // Images that the GPU has evicted are laid out again: uploading them at once could exceed
        // the budget.
        layouts.retain(|l| backend.holds(&l.laid_out, camera, options));
        self.0.iter_mut().for_each(|(_, idle)| *idle += 1);
        for (number, ahead) in wanted.iter().map(|n| (*n, false)).chain(ahead.iter().map(|n| (*n, true))) {
            for layout in layouts.of(number) {
                backend.upload(&layout.laid_out, &mut None, ahead, camera, options)?;
            }
            for (mut layout, _) in self.0.extract_if(.., |(l, _)| l.of.number == number).collect::<Vec<_>>() {
                let ImageLayout { laid_out, packed, .. } = &mut layout;
                match backend.upload(laid_out, packed, ahead, camera, options)? {
                    true => {
                        layout.packed = None;
                        layouts.insert(layout);
                    }
                    false => self.0.push((layout, 0)),
                }
            }
        }
        self.0.retain(|(_, idle)| *idle <= PATIENCE);
        Ok(())
    }
}
