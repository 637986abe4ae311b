//! Averaging of supersampled frames.
//!
//! In: a frame at twice the output's resolution. Out: the result of [`Frame::resolve`], which is
//! the definition (a test compares them), computed in parallel and without arithmetic for blocks of
//! one colour.

use crate::frame::{Frame, Source};
use ldi_protocol::shade::{linear_from_srgb8_table, srgb8_from_linear};
use rayon::prelude::*;

/// Averages blocks of `factor` x `factor` pixels into `out`; same result as [`Frame::resolve`].
pub fn downsample(frame: &Frame, factor: u32, out: &mut Frame) {
    let width = (frame.width / factor.max(1)) as usize;
    if factor != 2 || width == 0 {
        frame.resolve(factor, out);
        return;
    }
    out.reset(frame.width / 2, frame.height / 2);
    let from_width = frame.width as usize;
    let linear = linear_from_srgb8_table();
    out.colour
        .par_chunks_mut(width)
        .zip(out.disparity.par_chunks_mut(width))
        .zip(out.source.par_chunks_mut(width))
        .enumerate()
        .for_each(|(row, ((colour, disparity), source))| {
            let top = row * 2 * from_width;
            let lines = [top..top + 2 * width, top + from_width..top + from_width + 2 * width];
            let [colours, below] = [&frame.colour[lines[0].clone()], &frame.colour[lines[1].clone()]];
            let blocks = colours.as_chunks::<2>().0.iter().zip(below.as_chunks::<2>().0);
            for (to, ([a, b], [c, d])) in colour.iter_mut().zip(blocks) {
                *to = if a == b && c == d && a == c { *a } else { mean(linear, [*a, *b, *c, *d]) };
            }
            let [disparities, below] = [&frame.disparity[lines[0].clone()], &frame.disparity[lines[1].clone()]];
            let blocks = disparities.as_chunks::<2>().0.iter().zip(below.as_chunks::<2>().0);
            for (to, ([a, b], [c, d])) in disparity.iter_mut().zip(blocks) {
                *to = a.max(*b).max(c.max(*d));
            }
            let [sources, below] = [&frame.source[lines[0].clone()], &frame.source[lines[1].clone()]];
            let blocks = sources.as_chunks::<2>().0.iter().zip(below.as_chunks::<2>().0);
            for (to, ([a, b], [c, d])) in source.iter_mut().zip(blocks) {
                *to = if a == b && c == d && a == c { *a } else { most_frequent([*a, *b, *c, *d]) };
            }
        });
}

/// Mean of four packed colours in linear light.
#[inline]
fn mean(linear: &[f32; 256], [a, b, c, d]: [u32; 4]) -> u32 {
    let channel = |shift: u32| {
        let light = |colour: u32| linear[(colour >> shift & 255) as usize];
        u32::from(srgb8_from_linear((light(a) + light(b) + light(c) + light(d)) * 0.25)) << shift
    };
    channel(0) | channel(8) | channel(16)
}

/// The most frequent source; ties go to the more uncertain.
fn most_frequent(block: [Source; 4]) -> Source {
    let votes = |source: Source| block.iter().filter(|s| **s == source).count();
    block.into_iter().max_by_key(|s| (votes(*s), *s)).unwrap_or_default()
}
