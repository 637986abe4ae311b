//! Splats to pixels: a z-buffer of what splats cover, then weighted colours of the splats on it.

use super::{pixel_mask::PixelMask, splat_projection::Splat};
use crate::{frame::pack_rgb, warp::FarFrame};
use ldi_protocol::{
    OutputCamera,
    shade::{linear_from_srgb8_table, srgb8_from_linear},
};
use rayon::prelude::*;
use std::ops::Range;

/// Pixels with less weight take the z-buffer's colour.
const LEAST_WEIGHT: f32 = 0.02;
/// Bands of rows per thread, for balance.
const BANDS_PER_THREAD: usize = 4;

/// Buffers of the second pass.
#[derive(Debug, Default)]
pub struct SplatBuffers {
    /// Sums of linear colour and weight.
    sums: Vec<[f32; 4]>,
}

impl SplatBuffers {
    /// First pass: the z-buffer of what splats cover, in wanted pixels of `out` that are empty.
    pub fn cover(&mut self, splats: &[Vec<Splat>], camera: &OutputCamera, wanted: &PixelMask, out: &mut FarFrame) {
        let rows = 0..camera.height as usize;
        self.bands(camera, rows, wanted, out, |band| splats.iter().flatten().for_each(|t| band.cover(t)));
    }

    /// Second pass: blended colours, in some rows.
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

/// A band of rows.
struct Band<'a> {
    first_row: i32,
    width: usize,
    packed: &'a mut [u64],
    sums: &'a mut [[f32; 4]],
    wanted: &'a PixelMask,
}

impl<'a> Band<'a> {
    /// The spans of its rows, as indices in the band, in blocks with wanted pixels.
    fn spans(&self) -> impl Iterator<Item = Range<usize>> + use<'a> {
        let (wanted, first) = (self.wanted, self.first_row as usize);
        let begin = first * self.width;
        let rows = first..first + self.packed.len() / self.width;
        rows.flat_map(move |row| wanted.spans(row)).map(move |span| span.start - begin..span.end - begin)
    }

    /// Calls `f` for the pixels of a splat in this band: index in the band, disparity, position on
    /// the splat.
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

    /// First pass: what splats cover, by depth.
    fn cover(&mut self, splat: &Splat) {
        let colour = pack_rgb(splat.rgb);
        self.each(splat, |band, at, (disparity, s, t)| {
            if splat.covers(s, t) {
                let packed = FarFrame::pack(disparity, colour);
                band.packed[at] = band.packed[at].max(packed);
            }
        });
    }

    /// Second pass: weighted colours of visible splats.
    fn mix(&mut self, splat: &Splat) {
        let linear = linear_from_srgb8_table();
        let colour = splat.rgb.map(|c| linear[usize::from(c)]);
        let coverage = splat.coverage();
        self.each(splat, |band, at, (disparity, s, t)| {
            let Some((_, front)) = FarFrame::unpack(band.packed[at]) else { return };
            // Another surface: hidden by the front, or before it beside what it covers.
            if (1.0 / disparity - 1.0 / front).abs() > splat.merge_m {
                return;
            }
            let weight = (1.0 - s.abs()) * (1.0 - t.abs()) * coverage;
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
            let Some((_, disparity)) = FarFrame::unpack(*packed) else { continue };
            if sum[3] > LEAST_WEIGHT {
                let rgb = std::array::from_fn(|k| srgb8_from_linear(sum[k] / sum[3]));
                *packed = FarFrame::pack(disparity, pack_rgb(rgb));
            }
        }
    }
}
