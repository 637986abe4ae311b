//! A layered depth image prepared for the warp: laid out once when it arrives, used every frame.
//!
//! In: a decoded [`Ldi`]. Out: its `tiles`, per layer and row of tiles. `tile_builder` constructs
//! quads and pieces from samples.

use super::{
    Stamp,
    cull::Blocks,
    occlusion_order::Streams,
    tile_builder::{Builder, slivers},
    tiles::{Part, PieceGroup, Run, TILE_ROWS, Tile},
};
use ldi_protocol::ldi::{Ldi, LdiCamera};
use rayon::prelude::*;
use std::sync::{
    OnceLock,
    atomic::{AtomicU64, Ordering},
};

/// See the module.
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

    /// Micro-quads and border pieces of a tile.
    pub(super) fn quads(part: &Part, tile: &Tile) -> u64 {
        let inner: u64 = part.runs[tile.runs.clone()].iter().map(|r| u64::from(r.count)).sum();
        inner + tile.pieces as u64
    }

    /// Bytes of a tile's arrays that a stamp reads.
    pub(super) fn bytes(tile: &Tile, stamp: Stamp) -> u64 {
        let samples = tile.row_start[TILE_ROWS + 1] as usize * (size_of::<u8>() + size_of::<f32>() + size_of::<u32>());
        let joined = tile.runs.len() * size_of::<Run>() + tile.groups.len() * size_of::<PieceGroup>();
        (samples + if stamp == Stamp::Quads { joined } else { 0 }) as u64
    }
}
