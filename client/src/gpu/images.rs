//! Images on the GPU: the arrays of a [`PreparedLdi`], one buffer each for all its tiles, uploaded
//! once.

use super::{device::GpuDevice, transfer::Transfer};
use crate::warp::PreparedLdi;
use bytemuck::{Pod, Zeroable};

/// Ranges of a tile in the layout of `warp.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Tile {
    first_sample: u32,
    samples: u32,
    first_quad: u32,
    quads: u32,
    first_group: u32,
    pieces: u32,
}

/// A sample in the layout of `warp.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Sample {
    /// Column in the tile, and row above it.
    place: u32,
    disparity: f32,
    colour: u32,
}

/// Bits of a sample's number in a tile.
const NUMBER_BITS: u32 = 11;
/// Marks the quads whose sides are measured.
const COUNTED: u32 = 1 << 31;
const COUNTED_EVERY: u32 = 8;

/// An image on the GPU.
pub struct UploadedImage {
    pub tiles: wgpu::Buffer,
    pub samples: wgpu::Buffer,
    pub quads: wgpu::Buffer,
    pub groups: wgpu::Buffer,
    /// Number of the first tile of each part.
    first_tile: Vec<u32>,
}

/// An image in the GPU's format, not uploaded yet; can be packed on any thread.
pub struct Packed {
    tiles: Vec<Tile>,
    samples: Vec<Sample>,
    quads: Vec<u32>,
    groups: Vec<u32>,
    first_tile: Vec<u32>,
}

impl std::fmt::Debug for Packed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Packed").field("tiles", &self.tiles.len()).finish_non_exhaustive()
    }
}

impl Packed {
    /// Packs an image.
    pub fn new(laid_out: &PreparedLdi) -> Self {
        let parts = &laid_out.parts;
        let (mut tiles, mut samples, mut quads, mut groups) = (Vec::new(), Vec::new(), Vec::new(), Vec::<u32>::new());
        let mut first_tile = Vec::with_capacity(parts.len());
        for part in parts {
            first_tile.push(tiles.len() as u32);
            for tile in &part.tiles {
                let ends = tile.row_start.iter().skip(1);
                let count = ends.clone().next_back().copied().unwrap_or(0);
                let (first_sample, first_quad) = (samples.len() as u32, quads.len() as u32);
                for (row, (from, to)) in (0u32..).zip(tile.row_start.iter().zip(ends)) {
                    samples.extend((*from..*to).map(|i| {
                        let at = tile.first + i as usize;
                        let place = u32::from(part.column[at]) | row << 8;
                        Sample { place, disparity: part.disparity[at], colour: part.colour[at] }
                    }));
                }
                for run in &part.runs[tile.runs.clone()] {
                    quads.extend((0..u32::from(run.count)).map(|k| {
                        let counted = if k % COUNTED_EVERY == 0 { COUNTED } else { 0 };
                        (u32::from(run.top) + k) | (u32::from(run.bottom) + k) << NUMBER_BITS | counted
                    }));
                }
                tiles.push(Tile {
                    first_sample,
                    samples: count,
                    first_quad,
                    quads: quads.len() as u32 - first_quad,
                    // Groups have 128 words each.
                    first_group: (groups.len() / 128) as u32,
                    pieces: tile.pieces as u32,
                });
                for group in &part.pieces.groups[tile.groups.clone()] {
                    for lanes in [&group.u, &group.v, &group.disparity] {
                        groups.extend(lanes.as_flattened().iter().map(|x| x.to_bits()));
                    }
                    groups.extend(group.colour.as_flattened());
                }
            }
        }
        Self { tiles, samples, quads, groups, first_tile }
    }

    /// Approximate bytes on the GPU.
    pub fn bytes(&self) -> u64 {
        let [tiles, samples] = [size_of_val(&*self.tiles), size_of_val(&*self.samples)];
        (tiles + samples + size_of_val(&*self.quads) + size_of_val(&*self.groups)) as u64
    }
}

impl UploadedImage {
    /// Also returns its bytes and the transfer.
    pub fn new(card: &GpuDevice, packed: Packed) -> (Self, u64, Transfer) {
        let storage = wgpu::BufferUsages::STORAGE;
        let bytes = packed.bytes();
        let Packed { tiles, samples, quads, groups, first_tile } = packed;
        let mut transfer = Transfer::default();
        let uploaded = Self {
            tiles: transfer.array(card, "tiles", tiles, storage),
            samples: transfer.array(card, "samples", samples, storage),
            quads: transfer.array(card, "quads", quads, storage),
            groups: transfer.array(card, "pieces", groups, storage),
            first_tile,
        };
        (uploaded, bytes, transfer)
    }

    /// The number of a tile among all, from its part's and its own number.
    pub fn tile(&self, [part, tile]: [u32; 2]) -> u32 {
        self.first_tile.get(part as usize).map_or(0, |first| first + tile)
    }
}

/// Bytes of an image's largest buffer on the GPU: bindings have a limited size.
pub fn largest_buffer(laid_out: &PreparedLdi) -> u64 {
    let (mut samples, mut quads, mut groups) = (0, 0, 0);
    for part in &laid_out.parts {
        samples += part.disparity.len() as u64;
        quads += part.runs.iter().map(|r| u64::from(r.count)).sum::<u64>();
        groups += part.pieces.groups.len() as u64;
    }
    (samples * size_of::<Sample>() as u64).max(quads * 4).max(groups * 512)
}
