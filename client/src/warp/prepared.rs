//! A layered depth image prepared for the warp: laid out once when it arrives, used every frame.
//!
//! In: a decoded [`Ldi`]. Out: its `tiles`, per layer and row of tiles. `tile_builder` constructs
//! quads and pieces from samples.

use super::{
    cull::Blocks,
    occlusion_order::Streams,
    tile_builder::{Builder, slivers},
    tiles::{Part, TILE_ROWS},
};
use ldi_protocol::ldi::{Ldi, LdiCamera};
use rayon::prelude::*;
use std::sync::{
    OnceLock,
    atomic::{AtomicU64, Ordering},
};

/// An image prepared for the warp.
#[derive(Debug)]
pub struct PreparedLdi {
    /// The image's camera.
    pub camera: LdiCamera,
    /// Parts in order of layer, then row; slivers last.
    pub parts: Vec<Part>,
    /// The parts' tiles in blocks, for clipping.
    pub blocks: Blocks,
    /// The samples in another order, once it is asked for.
    streams: OnceLock<Streams>,
    /// Samples in all.
    pub samples: usize,
    /// Unique number of this layout, by which copies on the GPU are known.
    pub serial: u64,
}

/// The next [`PreparedLdi::serial`].
static SERIAL: AtomicU64 = AtomicU64::new(0);

impl PreparedLdi {
    /// Lays out all resident layers, and the slivers. Links to samples that do not exist are
    /// ignored.
    pub fn new(ldi: &Ldi) -> Self {
        let rows_of_tiles = (ldi.camera.height as usize).div_ceil(TILE_ROWS);
        let jobs = ldi.layers.len() * rows_of_tiles;
        let parts: Vec<Part> = (0..jobs)
            .into_par_iter()
            .map(|job| Builder::new(ldi, job / rows_of_tiles, (job % rows_of_tiles) * TILE_ROWS).build())
            .filter(|part| !part.tiles.is_empty())
            .chain(slivers(ldi))
            .collect();
        let blocks = Blocks::new(&parts);
        Self {
            camera: ldi.camera,
            parts,
            blocks,
            streams: OnceLock::new(),
            samples: ldi.samples(),
            serial: SERIAL.fetch_add(1, Ordering::Relaxed),
        }
    }

    /// The samples in occlusion-compatible order, laid out at first use.
    pub(super) fn streams(&self) -> &Streams {
        self.streams.get_or_init(|| Streams::new(&self.parts))
    }
}
