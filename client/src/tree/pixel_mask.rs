//! The pixels of a picture that still want a colour, counted per block so that whole blocks are
//! skipped.

use crate::warp::FarFrame;
use rayon::prelude::*;
use std::ops::Range;

/// Side of a block, pixels.
pub const BLOCK: usize = 16;

/// The pixels that still need a colour.
#[derive(Debug, Clone, Default)]
pub struct PixelMask {
    width: usize,
    blocks_across: usize,
    pixels: Vec<bool>,
    /// Number of wanted pixels in each block.
    blocks: Vec<u32>,
    /// Column and row of each block that initially had wanted pixels. Large samples touch more
    /// blocks than these if few pixels are wanted.
    listed: Vec<[u32; 2]>,
    /// Smallest disparity of a sample that shows in each block; infinite in blocks without wanted
    /// pixels.
    floors: Vec<f32>,
    total: u64,
    /// Distance below which samples are not wanted, metres.
    beyond_m: f32,
}

impl PixelMask {
    /// From a flag per pixel, and the disparity below which samples are hidden in each (none if
    /// empty).
    pub fn new(width: u32, height: u32, pixels: Vec<bool>, hidden_below: &[f32]) -> Self {
        let (width, height) = (width as usize, height as usize);
        assert_eq!(pixels.len(), width * height, "a flag per pixel");
        let blocks_across = width.div_ceil(BLOCK).max(1);
        let mut blocks = vec![0; blocks_across * height.div_ceil(BLOCK)];
        for (row, pixels) in pixels.chunks(width.max(1)).enumerate() {
            let of_row = &mut blocks[row / BLOCK * blocks_across..][..blocks_across];
            for (block, pixels) in of_row.iter_mut().zip(pixels.chunks(BLOCK)) {
                *block += pixels.iter().map(|w| u32::from(*w)).sum::<u32>();
            }
        }
        let total = blocks.iter().map(|b| u64::from(*b)).sum();
        let place = |block: usize| [block % blocks_across, block / blocks_across].map(|v| v as u32);
        let listed = (0..blocks.len()).filter(|b| blocks[*b] > 0).map(place).collect();
        let mut wanted =
            Self { width, blocks_across, pixels, blocks, listed, floors: Vec::new(), total, beyond_m: 0.0 };
        wanted.floors = wanted.floors_of(|at| hidden_below.get(at).copied().unwrap_or(0.0));
        wanted
    }

    /// The same mask without samples nearer than `metres`.
    #[must_use]
    pub fn beyond(self, metres: f32) -> Self {
        Self { beyond_m: metres, ..self }
    }

    /// Whether a sample of this pitch at this distance is wanted, metres. It represents surfaces
    /// within half a pitch.
    pub(super) fn reaches(&self, distance_m: f32, pitch: f32) -> bool {
        distance_m + 0.5 * pitch >= self.beyond_m
    }

    /// The smallest value of `hidden_below` over the wanted pixels of each block.
    fn floors_of(&self, hidden_below: impl Fn(usize) -> f32 + Sync) -> Vec<f32> {
        let height = self.pixels.len() / self.width.max(1);
        let floor = |block: usize| {
            if self.blocks[block] == 0 {
                return f32::INFINITY;
            }
            let (row, column) = (block / self.blocks_across * BLOCK, block % self.blocks_across * BLOCK);
            let mut floor = f32::INFINITY;
            for r in row..(row + BLOCK).min(height) {
                for at in r * self.width + column..r * self.width + (column + BLOCK).min(self.width) {
                    if self.pixels[at] {
                        floor = floor.min(hidden_below(at));
                    }
                }
            }
            floor
        };
        (0..self.blocks.len()).into_par_iter().map(floor).collect()
    }

    /// Rejects samples behind `frame` by more than `margin`, a share of the disparity.
    pub(super) fn raise_floors(&mut self, frame: &FarFrame, margin: f32) {
        let found = self.floors_of(|at| FarFrame::unpack(frame.packed[at]).map_or(0.0, |(_, d)| d * (1.0 - margin)));
        self.floors.iter_mut().zip(found).for_each(|(a, b)| *a = a.max(b));
    }

    /// All pixels.
    pub fn all(width: u32, height: u32) -> Self {
        Self::new(width, height, vec![true; width as usize * height as usize], &[])
    }

    /// Whether nothing is wanted.
    pub fn is_empty(&self) -> bool {
        self.total == 0
    }

    /// Number of wanted pixels.
    pub fn count(&self) -> u64 {
        self.total
    }

    /// Whether a picture drawn for this mask and `hidden_below` contains everything that `other`
    /// needs.
    pub(super) fn covers(&self, hidden_below: &[f32], other: &Self, other_hidden_below: &[f32]) -> bool {
        let hides = |of: &[f32], at: usize| of.get(at).copied().unwrap_or(0.0);
        self.pixels.len() == other.pixels.len()
            && self.beyond_m == other.beyond_m
            && (0..self.pixels.len()).all(|at| {
                !other.pixels[at] || self.pixels[at] && hides(hidden_below, at) <= hides(other_hidden_below, at)
            })
    }

    /// Whether a pixel is wanted.
    pub fn holds(&self, at: usize) -> bool {
        self.pixels[at]
    }

    /// Whether a sample of this disparity shows in a block that a rectangle touches (first and last
    /// columns and rows, within the picture).
    pub(super) fn any(&self, columns: [i32; 2], rows: [i32; 2], disparity: f32) -> bool {
        let [columns, rows] = [columns, rows].map(|[first, last]| first as usize / BLOCK..last as usize / BLOCK + 1);
        let floors = |row: usize| &self.floors[row * self.blocks_across..][..self.blocks_across];
        if self.listed.len() < rows.len() * columns.len() {
            let touched = self.listed.iter().map(|place| place.map(|v| v as usize));
            let mut touched = touched.filter(|[column, row]| columns.contains(column) && rows.contains(row));
            return touched.any(|[column, row]| disparity >= floors(row)[column]);
        }
        rows.into_iter().any(|row| floors(row)[columns.clone()].iter().any(|floor| disparity >= *floor))
    }

    /// The spans of a row, as pixel indices, that lie in blocks with wanted pixels.
    pub(super) fn spans(&self, row: usize) -> impl Iterator<Item = Range<usize>> + '_ {
        let of_row = &self.blocks[row / BLOCK * self.blocks_across..][..self.blocks_across];
        let span = move |block: usize| {
            row * self.width + block * BLOCK..row * self.width + ((block + 1) * BLOCK).min(self.width)
        };
        (0..self.blocks_across).filter(|b| of_row[*b] > 0).map(span)
    }

    /// Removes pixels for which `unwanted` holds, by row and column.
    pub(super) fn drop_where(&mut self, unwanted: &(dyn Fn(usize, usize) -> bool + Sync)) {
        let height = self.pixels.len() / self.width.max(1);
        let seen = &*self;
        let of_row =
            |row: usize| seen.spans(row).flatten().filter(move |at| seen.pixels[*at] && unwanted(row, at % seen.width));
        let dropped: Vec<usize> = (0..height).into_par_iter().flat_map_iter(of_row).collect();
        dropped.into_iter().for_each(|at| self.drop_one(at));
    }

    fn drop_one(&mut self, at: usize) {
        self.pixels[at] = false;
        let block = at / self.width / BLOCK * self.blocks_across + at % self.width / BLOCK;
        self.blocks[block] -= 1;
        if self.blocks[block] == 0 {
            self.floors[block] = f32::INFINITY;
        }
        self.total -= 1;
    }

    /// Removes the pixels that `frame` shows. Returns their number.
    pub(super) fn settle(&mut self, frame: &FarFrame) -> u64 {
        let before = self.total;
        self.drop_where(&|row, column| FarFrame::unpack(frame.packed[row * frame.width as usize + column]).is_some());
        before - self.total
    }
}
