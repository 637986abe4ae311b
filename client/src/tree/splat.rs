//! Tiles into pixels: a z-buffer of opaque tiles, then weighted colours of what lies on it.

use super::splat_projection::Splat;
use crate::{frame::pack_rgb, warp::FarFrame};
use ldi_protocol::{
    OutputCamera,
    shade::{linear_from_srgb8_table, srgb8_from_linear},
};
use rayon::prelude::*;
use std::ops::Range;

/// Side of the blocks in which wanted pixels are counted.
pub const BLOCK: usize = 16;
/// Samples that cover at least this of their pixel hide what lies behind. Lower: foliage grows fat; higher: what is behind shows through borders of faces.
const OPAQUE_FROM: f32 = 0.4;
/// Marks a packed colour that hides nothing: its highest byte is free.
const THIN: u32 = 1 << 24;
/// A pixel with less weight than this shows the z-buffer's own colour.
const LEAST_WEIGHT: f32 = 0.02;
/// Bands of rows per thread: enough to balance.
const BANDS_PER_THREAD: usize = 4;

/// The pixels of a picture that still want a colour.
#[derive(Debug, Clone, Default)]
pub struct PixelMask {
    width: usize,
    blocks_across: usize,
    pixels: Vec<bool>,
    /// Wanted pixels of each block.
    blocks: Vec<u32>,
    /// Column and row of each block that had wanted pixels at first: large samples touch more blocks than these where little is wanted.
    listed: Vec<[u32; 2]>,
    /// Smallest disparity that a sample needs to show in some wanted pixel of each block; infinite in blocks without.
    floors: Vec<f32>,
    total: u64,
    /// Samples of what lies nearer to the eye are not wanted, metres.
    beyond_m: f32,
}

impl PixelMask {
    /// From a flag per pixel, and what disparity hides samples in each (none where it is empty).
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

    /// The same without samples of what lies nearer to the eye than so many metres.
    #[must_use]
    pub fn beyond(self, metres: f32) -> Self {
        Self { beyond_m: metres, ..self }
    }

    /// Whether a sample of this pitch is wanted at this distance from the eye, metres: it stands for what lies within half a pitch.
    pub(super) fn reaches(&self, distance_m: f32, pitch: f32) -> bool {
        distance_m + 0.5 * pitch >= self.beyond_m
    }

    /// The smallest of `hidden_below` over the wanted pixels of each block.
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

    /// Samples behind what `frame` shows by more than `margin` (a share of the disparity) need no longer be drawn.
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

    /// Pixels wanted.
    pub fn count(&self) -> u64 {
        self.total
    }

    /// Whether a picture drawn for these pixels, where `hidden_below` hid samples, holds all that `other` wants.
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

    /// Whether something of this disparity shows in a block that a rectangle (first and last columns and rows, within the picture) touches.
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

    /// The parts of a row, as positions in the picture, that lie in blocks with wanted pixels. Where little is wanted, that is nearly nothing of it.
    fn spans(&self, row: usize) -> impl Iterator<Item = Range<usize>> + '_ {
        let of_row = &self.blocks[row / BLOCK * self.blocks_across..][..self.blocks_across];
        let span = move |block: usize| {
            row * self.width + block * BLOCK..row * self.width + ((block + 1) * BLOCK).min(self.width)
        };
        (0..self.blocks_across).filter(|b| of_row[*b] > 0).map(span)
    }

    /// Pixels of which `unwanted` holds, by row and column, are no longer wanted.
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

    /// What `frame` shows is no longer wanted; returns how many pixels that are.
    pub(super) fn settle(&mut self, frame: &FarFrame) -> u64 {
        let before = self.total;
        self.drop_where(&|row, column| FarFrame::unpack(frame.packed[row * frame.width as usize + column]).is_some());
        before - self.total
    }
}

/// Memory of the second pass.
#[derive(Debug, Default)]
pub struct SplatBuffers {
    /// Sums of linear colour and weight.
    sums: Vec<[f32; 4]>,
}

impl SplatBuffers {
    /// First pass: the z-buffer of opaque tiles, in wanted pixels of `out` that show nothing yet.
    pub fn cover(&mut self, splats: &[Vec<Splat>], camera: &OutputCamera, wanted: &PixelMask, out: &mut FarFrame) {
        let rows = 0..camera.height as usize;
        self.bands(camera, rows, wanted, out, |band| splats.iter().flatten().for_each(|t| band.cover(t)));
    }

    /// Second pass: colours of what lies on it, in some rows.
    pub fn mix(
        &mut self,
        splats: &[Vec<Splat>],
        camera: &OutputCamera,
        rows: Range<usize>,
        wanted: &PixelMask,
        out: &mut FarFrame,
    ) {
        self.bands(camera, rows, wanted, out, |band| {
            band.spans().for_each(|span| band.sums[span].fill([0.0; 4]));
            splats.iter().flatten().for_each(|t| band.cover_thinly(t));
            splats.iter().flatten().for_each(|t| band.mix(t));
            band.resolve();
        });
    }

    /// Calls `f` with bands of these rows that have wanted pixels, in parallel.
    fn bands(
        &mut self,
        camera: &OutputCamera,
        rows: Range<usize>,
        wanted: &PixelMask,
        out: &mut FarFrame,
        f: impl Fn(&mut Band<'_>) + Sync,
    ) {
        let (width, height) = (camera.width as usize, camera.height as usize);
        self.sums.resize(width * height, [0.0; 4]);
        let deep = rows.len().div_ceil(rayon::current_num_threads() * BANDS_PER_THREAD).max(1);
        let pixels = rows.start * width..rows.end * width;
        let packed = out.packed[pixels.clone()].par_chunks_mut(deep * width);
        packed.zip(self.sums[pixels].par_chunks_mut(deep * width)).enumerate().for_each(|(k, (packed, sums))| {
            let mut band = Band { first_row: (rows.start + k * deep) as i32, width, packed, sums, wanted };
            if band.spans().next().is_some() {
                f(&mut band);
            }
        });
    }
}

/// Some rows of the picture.
struct Band<'a> {
    first_row: i32,
    width: usize,
    packed: &'a mut [u64],
    sums: &'a mut [[f32; 4]],
    wanted: &'a PixelMask,
}

impl<'a> Band<'a> {
    /// The parts of its rows, as positions in it, that lie in blocks with wanted pixels.
    fn spans(&self) -> impl Iterator<Item = Range<usize>> + use<'a> {
        let (wanted, first) = (self.wanted, self.first_row as usize);
        let begin = first * self.width;
        let rows = first..first + self.packed.len() / self.width;
        rows.flat_map(move |row| wanted.spans(row)).map(move |span| span.start - begin..span.end - begin)
    }

    /// Calls `f` with the pixels of a tile in this band: position in it, disparity, place on the tile.
    fn each(&mut self, splat: &Splat, mut f: impl FnMut(&mut Self, usize, (f32, f32, f32))) {
        let last_row = self.first_row + (self.packed.len() / self.width) as i32 - 1;
        for row in splat.rows[0].max(self.first_row)..=splat.rows[1].min(last_row) {
            let first = (row - self.first_row) as usize * self.width;
            for column in splat.columns[0]..=splat.columns[1] {
                if !self.wanted.holds(row as usize * self.width + column as usize) {
                    continue;
                }
                if let Some(place) = splat.at(column as f32 + 0.5, row as f32 + 0.5) {
                    f(self, first + column as usize, place);
                }
            }
        }
    }

    /// First pass: opaque tiles by depth.
    fn cover(&mut self, splat: &Splat) {
        if splat.alpha < OPAQUE_FROM {
            return;
        }
        let half = Splat::half_width();
        let colour = pack_rgb(splat.rgb);
        self.each(splat, |band, at, (disparity, s, t)| {
            if s.abs() <= half && t.abs() <= half {
                let packed = FarFrame::pack(disparity, colour);
                band.packed[at] = band.packed[at].max(packed);
            }
        });
    }

    /// Between the passes: where nothing opaque is, the nearest of what covers a part.
    fn cover_thinly(&mut self, splat: &Splat) {
        if splat.alpha >= OPAQUE_FROM {
            return;
        }
        let half = Splat::half_width();
        let colour = pack_rgb(splat.rgb) | THIN;
        self.each(splat, |band, at, (disparity, s, t)| {
            let there = band.packed[at];
            if s.abs() <= half && t.abs() <= half && (there == 0 || there as u32 & THIN != 0) {
                band.packed[at] = there.max(FarFrame::pack(disparity, colour));
            }
        });
    }

    /// Second pass: weighted colours of what is not hidden.
    fn mix(&mut self, splat: &Splat) {
        let linear = linear_from_srgb8_table();
        let colour = splat.rgb.map(|c| linear[usize::from(c)]);
        self.each(splat, |band, at, (disparity, s, t)| {
            if let Some((_, front)) = FarFrame::unpack(band.packed[at]) {
                // Behind the front by more than a merge threshold.
                if front > disparity && 1.0 / disparity - 1.0 / front > splat.merge_m {
                    return;
                }
            }
            let weight = (1.0 - s.abs()) * (1.0 - t.abs()) * splat.alpha;
            let sum = &mut band.sums[at];
            for (sum, c) in sum.iter_mut().zip(colour) {
                *sum += c * weight;
            }
            sum[3] += weight;
        });
    }

    fn resolve(&mut self) {
        for at in self.spans().flatten() {
            let (packed, sum) = (&mut self.packed[at], &self.sums[at]);
            let Some((colour, disparity)) = FarFrame::unpack(*packed) else { continue };
            *packed = FarFrame::pack(disparity, colour & !THIN);
            if sum[3] > LEAST_WEIGHT {
                let rgb = std::array::from_fn(|k| srgb8_from_linear(sum[k] / sum[3]));
                *packed = FarFrame::pack(disparity, pack_rgb(rgb));
            }
        }
    }
}
