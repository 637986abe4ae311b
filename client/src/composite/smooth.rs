//! Smoothing of far pixels.
//!
//! In: a finished frame. Out: far and filled pixels replaced by the 3 x 3 binomial mean (1 2 1) x
//! (1 2 1) / 16, which reduces the noise of one-pixel stamps. Aliaga and Lastra convolve the whole
//! warped image; here neighbours of another surface (near geometry, sky, a different disparity) are
//! left out, so that silhouettes stay sharp. Means are taken in linear light.

use crate::frame::{Frame, Source, pack_rgb, unpack_rgb};
use ldi_protocol::shade::{linear_from_srgb8_table, srgb8_from_linear};
use rayon::prelude::*;

/// Neighbours whose disparities differ by more than this fraction belong to another surface.
const SAME_SURFACE: f32 = 0.1;

/// Smooths in place.
pub fn smooth(frame: &mut Frame) {
    let width = frame.width as usize;
    let (colour, disparity, source) = (&frame.colour, &frame.disparity, &frame.source);
    let is_far = |at: usize| matches!(source[at], Source::Far | Source::Filled);
    let linear = linear_from_srgb8_table();
    let smoothed: Vec<u32> = (0..colour.len())
        .into_par_iter()
        .map(|at| {
            if !is_far(at) {
                return colour[at];
            }
            let (row, column) = (at / width, at % width);
            let (mut sum, mut weights) = ([0.0f32; 3], 0.0);
            for r in row.saturating_sub(1)..(row + 2).min(colour.len() / width) {
                for c in column.saturating_sub(1)..(column + 2).min(width) {
                    let other = r * width + c;
                    let gap = (disparity[other] - disparity[at]).abs();
                    if !is_far(other) || gap > SAME_SURFACE * disparity[at] {
                        continue;
                    }
                    let weight = if r == row { 2.0 } else { 1.0 } * if c == column { 2.0 } else { 1.0 };
                    weights += weight;
                    let rgb = unpack_rgb(colour[other]);
                    sum.iter_mut().zip(rgb).for_each(|(s, c)| *s += weight * linear[usize::from(c)]);
                }
            }
            pack_rgb(sum.map(|s| srgb8_from_linear(s / weights)))
        })
        .collect();
    frame.colour = smoothed;
}
