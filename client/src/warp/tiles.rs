//! Tiles: the arrays of samples, runs and border pieces that the warp reads.
//!
//! A tile covers [`TILE_ROWS`] x [`TILE_COLUMNS`] pixels of one layer and is complete in itself:
//! its samples in structure-of-arrays order with one row and one column of its neighbours' samples
//! ("halo"), the runs of micro-quads between samples, and the pieces that border them. A tile is
//! the unit of culling and of threading. Segments of one row, the storage order, would make poor
//! units: a rotated camera spreads a row over many output rows.

use super::bounds::Bounds;
use crate::simd::LANES;
use std::ops::Range;

/// Rows of a tile. Larger tiles cull worse and straddle more thread bands; smaller ones repeat more
/// halo (17/16).
pub const TILE_ROWS: usize = 16;
/// Columns of a tile: several groups of eight, so that runs of quads fill the lanes.
pub const TILE_COLUMNS: usize = 64;
/// Samples of a tile with halo, at most; also a bound on tile-local indices.
pub const TILE_SAMPLES: usize = (TILE_ROWS + 1) * (TILE_COLUMNS + 1);
/// Outward growth of unlinked borders in LDI pixels. Smaller leaves pinholes where a curved surface
/// changes layers; larger makes silhouettes grow by as much.
pub const OVERLAP: f32 = 1.0 / 32.0;
/// Elements past the end of a part's arrays, so that groups of eight may be read anywhere.
pub(super) const PADDING: usize = LANES;

/// A corner of a piece, relative to the row of tiles' upper left.
#[derive(Debug, Clone, Copy)]
pub struct Vertex {
    /// Column.
    pub u: f32,
    /// Row.
    pub v: f32,
    /// Disparity, 1/m.
    pub disparity: f32,
    /// Packed sRGB.
    pub colour: u32,
}

/// Consecutive micro-quads of one row: quad k joins samples `top + k`, `top + k + 1`, `bottom + k`,
/// `bottom + k + 1`.
#[derive(Debug, Clone, Copy)]
pub struct Run {
    /// Tile-local number of the first upper left sample.
    pub top: u16,
    /// Tile-local number of the first lower left sample.
    pub bottom: u16,
    /// Number of quads.
    pub count: u16,
}

/// Eight border pieces: quads with corners of their own. Structure of arrays; corner order a, b, e,
/// f.
#[derive(Debug, Clone, Copy, Default)]
pub struct PieceGroup {
    /// Columns relative to the tile's left border, LDI pixels.
    pub u: [[f32; LANES]; 4],
    /// Rows relative to the tile's upper border, LDI pixels.
    pub v: [[f32; LANES]; 4],
    /// Disparities, 1/m.
    pub disparity: [[f32; LANES]; 4],
    /// Packed sRGB.
    pub colour: [[u32; LANES]; 4],
}

/// Border pieces in groups of eight; a tile begins a new group.
#[derive(Debug, Default)]
pub struct Pieces {
    /// The groups.
    pub groups: Vec<PieceGroup>,
    /// Pieces of the tile being built.
    count: usize,
}

/// One tile of one layer; ranges point into its [`Part`].
#[derive(Debug, Clone)]
pub struct Tile {
    /// Column of the tile's left border.
    pub column: u32,
    /// Row of the tile's upper border.
    pub row: u32,
    /// First sample.
    pub first: usize,
    /// Start of each row's samples relative to `first`, halo row and end included.
    pub row_start: [u32; TILE_ROWS + 2],
    /// Samples that are not halo.
    pub own: u32,
    /// Its quad runs.
    pub runs: Range<usize>,
    /// Groups of its border pieces.
    pub groups: Range<usize>,
    /// Number of its border pieces; the last group may be incomplete.
    pub pieces: usize,
    /// Of all that it draws.
    pub bounds: Bounds,
}

/// The tiles of one layer and one row of tiles.
#[derive(Debug, Default)]
pub struct Part {
    /// Layer.
    pub layer: usize,
    /// Non-empty tiles, left to right.
    pub tiles: Vec<Tile>,
    /// Column within the tile, 0 to [`TILE_COLUMNS`]; the last is halo.
    pub column: Vec<u8>,
    /// Disparity, 1/m.
    pub disparity: Vec<f32>,
    /// Packed sRGB.
    pub colour: Vec<u32>,
    /// Quad runs of all tiles.
    pub runs: Vec<Run>,
    /// Border pieces of all tiles.
    pub pieces: Pieces,
}

impl Part {
    /// Micro-quads and border pieces of a tile.
    pub(super) fn quads(&self, tile: &Tile) -> u64 {
        let inner: u64 = self.runs[tile.runs.clone()].iter().map(|r| u64::from(r.count)).sum();
        inner + tile.pieces as u64
    }

    /// Tile-local numbers of a row's samples, the one in the halo's column last, which is left out
    /// unless `with_halo`.
    #[inline(always)]
    pub(super) fn row_of(&self, tile: &Tile, row: usize, with_halo: bool) -> Range<usize> {
        let (from, to) = (tile.row_start[row] as usize, tile.row_start[row + 1] as usize);
        let halo = !with_halo && to > from && usize::from(self.column[tile.first + to - 1]) == TILE_COLUMNS;
        from..to - usize::from(halo)
    }
}

impl Pieces {
    /// Begins a tile: returns its first group.
    pub(super) fn begin(&mut self) -> usize {
        self.count = 0;
        self.groups.len()
    }

    /// Pieces since the tile began.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Appends a piece.
    pub(super) fn push(&mut self, corners: [Vertex; 4]) {
        let lane = self.count % LANES;
        if lane == 0 {
            self.groups.push(PieceGroup::default());
        }
        self.count += 1;
        if let Some(group) = self.groups.last_mut() {
            for (i, c) in corners.iter().enumerate() {
                group.u[i][lane] = c.u;
                group.v[i][lane] = c.v;
                group.disparity[i][lane] = c.disparity;
                group.colour[i][lane] = c.colour;
            }
        }
    }
}

impl Tile {
    /// Bytes of the tile's arrays that the warp reads; `joined`: with micro-quads and pieces.
    pub(super) fn bytes(&self, joined: bool) -> u64 {
        let samples = self.row_start[TILE_ROWS + 1] as usize * (size_of::<u8>() + size_of::<f32>() + size_of::<u32>());
        let pieces = self.runs.len() * size_of::<Run>() + self.groups.len() * size_of::<PieceGroup>();
        (samples + if joined { pieces } else { 0 }) as u64
    }

    /// Starts a tile at (row, column), the upper left corner, at the end of a part's arrays.
    pub(super) fn new(row: usize, column: usize, part: &mut Part) -> Self {
        Self {
            column: column as u32,
            row: row as u32,
            first: part.column.len(),
            row_start: [0; TILE_ROWS + 2],
            own: 0,
            runs: part.runs.len()..0,
            groups: part.pieces.begin()..0,
            pieces: 0,
            bounds: Bounds::NONE,
        }
    }

    /// Ends a tile: everything added to the part since belongs to it, and its pieces' columns
    /// become relative to it.
    pub(super) fn finish(&mut self, part: &mut Part) {
        self.runs.end = part.runs.len();
        self.groups.end = part.pieces.groups.len();
        self.pieces = part.pieces.count();
        for i in 0..self.pieces {
            let (group, lane) = (&mut part.pieces.groups[self.groups.start + i / LANES], i % LANES);
            for corner in 0..4 {
                let v = group.v[corner][lane] + self.row as f32;
                self.bounds.grow(group.u[corner][lane], v, group.disparity[corner][lane]);
                group.u[corner][lane] -= self.column as f32;
            }
        }
    }
}
