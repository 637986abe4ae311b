//! The last step of data before it is drawn: onto the card, as much with every picture as it may put there, what it shows first, then what the next ones will.
//!
//! In: what is resident, laid out and wanted. Out: what is there. Where the processor draws, that is everything at once.

use super::{
    image_layouts::{ImageLayout, ImageLayouts, LayoutRequest},
    render_backend::{RenderBackend, RenderError},
};
use crate::{
    gpu::{PATIENCE, TextureUpload},
    resident::Resident,
    warp::WarpOptions,
};
use ldi_protocol::{OutputCamera, index::Index, ldi::Ldi, mesh::CellGeometry, texture::Texture, tree::Brood};
use std::{collections::BTreeSet, sync::Arc};

/// Bytes that a picture of a moving eye may put onto the card: a quarter of a gigabyte per second at 60 pictures. Larger: jerks; smaller: what was not foreseen is seen later.
const MOVING_BYTES: u64 = 4 << 20;
/// Of a resting eye: only the one who waits for it sees how long it takes.
const RESTING_BYTES: u64 = 32 << 20;

/// Bytes that a picture may put onto the card.
pub(super) fn upload_budget_bytes(background_layout: bool, moving: bool) -> u64 {
    match (background_layout, moving) {
        (false, _) => u64::MAX,
        (true, true) => MOVING_BYTES,
        (true, false) => RESTING_BYTES,
    }
}

/// What the next frames may show, likeliest first.
#[derive(Debug, Clone, Default)]
pub struct Anticipated {
    /// Images.
    pub images: Vec<u32>,
    /// Cells.
    pub cells: Vec<u32>,
}

/// Chunks that are resident and not on the card yet.
#[derive(Debug, Default)]
pub(super) struct PendingUploads {
    /// They do not show.
    pub chunks: BTreeSet<u32>,
    /// Of so many textures coarse levels show.
    pub coarse: usize,
}

/// Decoded data that is where it is drawn from.
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

/// Brings what cells are drawn from; `ahead`: as far as there is room besides what the frame wants.
pub(super) fn upload_cells(
    backend: &mut RenderBackend,
    index: &Index,
    resident: &dyn Resident,
    cells: &[u32],
    camera: &OutputCamera,
    ahead: bool,
) -> Result<PendingUploads, RenderError> {
    let mut late = PendingUploads::default();
    let Some(gpu) = backend.gpu_for(camera) else { return Ok(late) };
    let mut seen = BTreeSet::new();
    for (number, entry) in cells.iter().filter_map(|c| Some((*c, index.cells.get(*c as usize)?))) {
        let bundles = entry.bundles.iter().filter_map(|b| Some((*b, resident.bundle(*b)?)));
        for (chunk, geometry) in resident.cell(number).map(|g| (entry.chunk, g)).into_iter().chain(bundles) {
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

/// Images that are laid out and on their way to the card, and for how many pictures nobody has wanted them.
#[derive(Debug, Default)]
pub(super) struct UploadQueue(Vec<(ImageLayout, u64)>);

impl UploadQueue {
    /// Takes in what was laid out beside.
    pub fn insert(&mut self, layout: ImageLayout) {
        let same = |l: &ImageLayout| (l.of.number, l.of.half) == (layout.of.number, layout.of.half);
        self.0.retain(|(l, _)| !same(l));
        self.0.push((layout, 0));
    }

    /// Whether this is on its way.
    pub fn holds(&self, wanted: &LayoutRequest) -> bool {
        self.0.iter().any(|(l, _)| l.of.is(wanted))
    }

    /// Whether any image is that the last picture wanted, or that was expected then.
    pub fn is_under_way(&self) -> bool {
        self.0.iter().any(|(_, idle)| *idle == 0)
    }

    /// Brings images in this order, `ahead` after those that the view wants, and hands on those that are there; those that nobody has wanted for long are forgotten.
    pub fn upload(
        &mut self,
        backend: &mut RenderBackend,
        layouts: &mut ImageLayouts,
        (wanted, ahead): (&[u32], &[u32]),
        camera: &OutputCamera,
        options: &WarpOptions,
    ) -> Result<(), RenderError> {
        // What the card has let go of meanwhile is laid out anew: bringing it back at once might be too much for one picture.
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
