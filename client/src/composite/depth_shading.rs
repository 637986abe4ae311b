//! Shading of a finished picture by its depths: ambient occlusion and outlines, so that surfaces of
//! one colour can be told apart.
//!
//! In: colours and disparities of the finished picture, from near geometry and images alike. Out:
//! the colours, darkened in corners (`ambient_occlusion`), at silhouettes and at creases. A measured
//! walk never uses it.
//!
//! Outlines follow Saito and Takahashi ("Comprehensible Rendering of 3-D Shapes", SIGGRAPH 1990):
//! differences of a depth image. Disparity is affine on a plane, so that its second difference along
//! a row or column is 0 on a plane at any angle. Divided by the disparity and multiplied by the
//! focal length it is the change of slope between the two sides of the pixel, in metres per metre
//! whatever the distance and resolution. A negative one is a convex edge or the border in front of
//! something farther; only the nearer side of a border gets the line, so that lines are one pixel
//! wide.

use super::{
    ambient_occlusion::AmbientOcclusion,
    depth_lens::{DepthLens, NOTHING, least, most, share},
};
use crate::frame::Frame;
use rayon::prelude::*;

/// Change of slope at which a line begins, and by how much more it is complete. Smaller: lines on
/// the flat pieces of curved surfaces; larger: blunt edges have none. A judgement.
const CREASE: [f32; 2] = [0.25, 0.75];
/// Change of slope beyond which a concave crease is taken for the far side of a border, which gets
/// no line; twice that much has none at all.
const BORDER: f32 = 6.0;
/// Darkness of a complete line. A judgement.
const LINE: f32 = 0.38;
/// Distance at which lines have half of their darkness, metres: far away every pixel is an edge.
const FADE_M: f32 = 25.0;
/// Rows per task. Smaller: more overhead; larger: less balance between threads.
const ROWS_PER_TASK: usize = 16;

/// Shades pictures; keeps its buffers between them.
#[derive(Debug, Default)]
pub struct DepthShading {
    occlusion: AmbientOcclusion,
}

impl DepthShading {
    /// Darkens the colours of a frame by its disparities. A frame without disparities stays as it
    /// is.
    pub fn shade(&mut self, frame: &mut Frame, lens: &DepthLens) {
        let width = frame.width as usize;
        let height = frame.height as usize;
        if width < 3 || height < 3 || frame.disparity.len() != frame.colour.len() {
            return;
        }
        let disparity = &frame.disparity[..];
        self.occlusion.update(disparity, width, lens);
        let occlusion = &self.occlusion;
        frame.colour.par_chunks_mut(width).enumerate().with_min_len(ROWS_PER_TASK).for_each_init(
            || [vec![0.0; width], vec![0.0; width]],
            |[darkness, change], (y, colours)| {
                let row = |y: usize| &disparity[y * width..(y + 1) * width];
                let beside = (y > 0 && y + 1 < height).then(|| [row(y - 1), row(y + 1)]);
                let coarse = [occlusion.row(y / 2), occlusion.row(y.div_ceil(2))];
                shade_row(&Rows { coarse, here: row(y), beside }, lens, [darkness, change], colours);
            },
        );
    }
}

/// The rows that the shading of a row depends on.
struct Rows<'a> {
    /// Darkness at half resolution above and below.
    coarse: [&'a [f32]; 2],
    /// Disparities of the row.
    here: &'a [f32],
    /// Disparities of the rows above and below, if there are both.
    beside: Option<[&'a [f32]; 2]>,
}

/// Shades a row. `buffers`: two rows to work in.
fn shade_row(rows: &Rows<'_>, lens: &DepthLens, buffers: [&mut [f32]; 2], colours: &mut [u32]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: AVX2 was detected. Twice the lanes of the plain loops, with the same results.
        return unsafe { shade_row_avx2(rows, lens, buffers, colours) };
    }
    shade_row_plain(rows, lens, buffers, colours);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn shade_row_avx2(rows: &Rows<'_>, lens: &DepthLens, buffers: [&mut [f32]; 2], colours: &mut [u32]) {
    shade_row_plain(rows, lens, buffers, colours);
}

#[inline(always)]
fn shade_row_plain(rows: &Rows<'_>, lens: &DepthLens, [darkness, change]: [&mut [f32]; 2], colours: &mut [u32]) {
    enlarge(rows.coarse, darkness);
    across(rows.here, change);
    if let Some([above, below]) = rows.beside {
        down([above, rows.here, below], change);
    }
    draw_lines(rows.here, change, lens, darkness);
    darken(darkness, colours);
}

/// The darkness of a row of pixels from those of the rows at half resolution above and below,
/// bilinear: pixel 2i lies on sample i.
#[inline(always)]
fn enlarge([above, below]: [&[f32]; 2], out: &mut [f32]) {
    let mean = |i: usize| 0.5 * (above[i] + below[i]);
    let last = above.len() - 1;
    let (pairs, rest) = out.as_chunks_mut::<2>();
    for (i, pair) in pairs.iter_mut().enumerate() {
        let here = mean(i);
        *pair = [here, 0.5 * (here + mean((i + 1).min(last)))];
    }
    rest.iter_mut().for_each(|o| *o = mean(last));
}

/// Second differences along a row.
#[inline(always)]
fn across(here: &[f32], out: &mut [f32]) {
    let n = here.len();
    (out[0], out[n - 1]) = (0.0, 0.0);
    let (left, middle, right) = (&here[..n - 2], &here[1..n - 1], &here[2..]);
    for (((out, l), d), r) in out[1..n - 1].iter_mut().zip(left).zip(middle).zip(right) {
        *out = l + r - 2.0 * d;
    }
}

/// Replaces second differences by those along columns where these are larger.
#[inline(always)]
fn down([above, here, below]: [&[f32]; 3], out: &mut [f32]) {
    for (((out, a), d), b) in out.iter_mut().zip(above).zip(here).zip(below) {
        let other = a + b - 2.0 * d;
        *out = if other.abs() > out.abs() { other } else { *out };
    }
}

/// Adds the darkness of lines.
#[inline(always)]
fn draw_lines(here: &[f32], change: &[f32], lens: &DepthLens, darkness: &mut [f32]) {
    let (focal, noise) = (lens.focal_px, lens.noise);
    for ((out, change), d) in darkness.iter_mut().zip(change).zip(here) {
        let d = most(*d, NOTHING);
        let slope = change * focal / d;
        let lost = CREASE[0] + 4.0 * focal * (noise[0] / d + noise[1]);
        let convex = -slope - lost;
        let concave = least(slope, 2.0 * BORDER - slope) - lost;
        let line = share(most(convex, concave) * (1.0 / CREASE[1]));
        // Sky has neither surface nor line.
        let faded = (d - NOTHING) / (d + 1.0 / FADE_M);
        *out += LINE * faded * line * (1.0 - *out);
    }
}

/// Multiplies colours by 1 - darkness, in sRGB codes.
#[inline(always)]
fn darken(darkness: &[f32], colours: &mut [u32]) {
    const PAIR: u32 = 0x00ff_00ff;
    for (colour, dark) in colours.iter_mut().zip(darkness) {
        let kept = 256 - (256.0 * dark) as i32 as u32;
        let red_blue = ((*colour & PAIR) * kept) >> 8 & PAIR;
        let green = ((*colour >> 8 & 0xff) * kept) & 0xff00;
        *colour = red_blue | green;
    }
}

#[cfg(test)]
#[path = "depth_shading_test.rs"]
mod tests;
