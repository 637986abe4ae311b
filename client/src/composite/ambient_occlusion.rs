//! Ambient occlusion from a picture's disparities.
//!
//! In: disparities, row-major. Out: a darkness from 0 to 1 at every second pixel of every second
//! row.
//!
//! Theory: disparity (1 / depth) is an affine function of the pixel on every plane. The mean of two
//! opposite neighbours minus the pixel between them is therefore 0 on a plane at any angle, positive
//! in a concave corner and negative on a convex edge. Pairs of opposite samples are those of
//! volumetric obscurance (Loos and Sloan, "Volumetric Obscurance", I3D 2010). Here each side of a
//! pair is a slope (change of depth per distance across the view), which needs no normals, and
//! neither random directions nor a blur, because neighbouring pixels use the same offsets.
//!
//! Practice: pairs along four directions at several distances in pixels. A distance counts as far
//! as it is within [`RADIUS_M`] at the pixel's depth. Beyond the picture's border disparities are
//! continued by a point reflection, which continues planes. Rows are independent, so that the
//! result does not depend on the number of threads.

use super::depth_lens::{DepthLens, NOTHING, least, most, share};
use rayon::prelude::*;

/// Radius of the occlusion, metres. Larger: wide soft shadows that merge; smaller: only a line in
/// the corner. A judgement.
const RADIUS_M: f32 = 0.5;
/// Slope up to which a nearer side darkens fully. Beyond, the side fades until it counts nothing at
/// [`CUT`] times the slope: it is another object in front. Larger: dark rims around objects;
/// smaller: no shadow beside walls that are seen at a grazing angle.
const STEEPEST: f32 = 2.5;
/// See [`STEEPEST`].
const CUT: f32 = 2.2;
/// Slope of a pair that does not darken yet: rounding, and curved surfaces made of flat pieces.
const BIAS: f32 = 0.04;
/// Darkness of a right angle, as a share of the largest.
const GAIN: f32 = 1.2;
/// Largest darkness. A judgement.
const DARKEST: f32 = 0.42;

/// The darkness at every second pixel; keeps its buffers between pictures.
#[derive(Debug, Default)]
pub(super) struct AmbientOcclusion {
    /// Disparities at half resolution, with a border of `border` on all sides.
    disparity: Vec<f32>,
    width: usize,
    height: usize,
    border: usize,
    /// Row-major, `width` x `height`.
    darkness: Vec<f32>,
}

impl AmbientOcclusion {
    /// Computes the darkness of a picture of `width` columns.
    pub fn update(&mut self, disparity: &[f32], width: usize, lens: &DepthLens) {
        let height = disparity.len() / width.max(1);
        (self.width, self.height) = (width.div_ceil(2), height.div_ceil(2));
        let reach = lens.reach([width as u32, height as u32]);
        self.border = reach.into_iter().max().unwrap_or(0);
        self.shrink(disparity, width);
        self.darkness.resize(self.width * self.height, 0.0);
        let (stride, border, disparity) = (self.width + 2 * self.border, self.border, &self.disparity);
        let columns = self.width;
        self.darkness.par_chunks_mut(columns.max(1)).enumerate().with_min_len(8).for_each_init(
            || Sums::new(columns),
            |sums, (y, out)| {
                let at = |row: isize, column: isize| {
                    let first = (y + border).wrapping_add_signed(row) * stride + border.wrapping_add_signed(column);
                    &disparity[first..first + columns]
                };
                sums.begin(at(0, 0));
                for o in reach.into_iter().filter(|o| *o > 0) {
                    add(sums, &Ring::new(&at, o), lens);
                }
                sums.finish(out);
            },
        );
    }

    /// The darkness of one row at half resolution.
    pub fn row(&self, y: usize) -> &[f32] {
        let y = y.min(self.height.saturating_sub(1));
        &self.darkness[y * self.width..(y + 1) * self.width]
    }

    /// Takes every second pixel, and continues it beyond the border.
    fn shrink(&mut self, disparity: &[f32], width: usize) {
        let (border, columns, rows) = (self.border, self.width, self.height);
        let stride = columns + 2 * border;
        self.disparity.resize(stride * (rows + 2 * border), 0.0);
        let inner = &mut self.disparity[border * stride..(border + rows) * stride];
        inner.par_chunks_mut(stride.max(1)).zip(disparity.par_chunks(2 * width.max(1))).for_each(|(row, from)| {
            let middle = &mut row[border..border + columns];
            middle.iter_mut().zip(from[..width].iter().step_by(2)).for_each(|(to, from)| *to = *from);
            for i in 1..=border {
                row[border - i] = 2.0 * row[border] - row[border + i];
                row[border + columns - 1 + i] = 2.0 * row[border + columns - 1] - row[border + columns - 1 - i];
            }
        });
        for i in 1..=border {
            let last = border + rows - 1;
            for (to, edge, from) in [(border - i, border, border + i), (last + i, last, last - i)] {
                for x in 0..stride {
                    self.disparity[to * stride + x] =
                        2.0 * self.disparity[edge * stride + x] - self.disparity[from * stride + x];
                }
            }
        }
    }
}

/// The samples around a row at one distance: four pairs of opposite rows.
struct Ring<'a> {
    pairs: [[&'a [f32]; 2]; 4],
    /// Distances of the pairs, pixels.
    lengths: [f32; 4],
}

impl<'a> Ring<'a> {
    fn new(at: &impl Fn(isize, isize) -> &'a [f32], offset: usize) -> Self {
        let o = offset as isize;
        let d = ((offset as f32) * std::f32::consts::FRAC_1_SQRT_2).round().max(1.0) as isize;
        let diagonal = d as f32 * std::f32::consts::SQRT_2;
        Self {
            pairs: [[at(0, -o), at(0, o)], [at(-o, 0), at(o, 0)], [at(-d, -d), at(d, d)], [at(-d, d), at(d, -d)]],
            lengths: [o as f32, o as f32, diagonal, diagonal],
        }
    }
}

/// Adds the pairs at one distance to the sums of a row.
fn add(sums: &mut Sums<'_>, ring: &Ring<'_>, lens: &DepthLens) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: AVX2 was detected. Twice the lanes of the plain loop, with the same results.
        return unsafe { add_avx2(sums, ring, lens) };
    }
    sums.add(ring, lens);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn add_avx2(sums: &mut Sums<'_>, ring: &Ring<'_>, lens: &DepthLens) {
    sums.add(ring, lens);
}

/// Sums over the distances of a row.
struct Sums<'a> {
    here: &'a [f32],
    depth_m: Vec<f32>,
    occlusion: Vec<f32>,
    weight: Vec<f32>,
}

impl<'a> Sums<'a> {
    fn new(columns: usize) -> Self {
        Self { here: &[], depth_m: vec![0.0; columns], occlusion: vec![0.0; columns], weight: vec![0.0; columns] }
    }

    fn begin(&mut self, here: &'a [f32]) {
        self.here = here;
        self.occlusion.fill(0.0);
        self.weight.fill(0.0);
        for (depth, d) in self.depth_m.iter_mut().zip(here) {
            // Where there is no surface all slopes are 0.
            *depth = if *d > NOTHING { 1.0 / *d } else { 0.0 };
        }
    }

    /// Adds the pairs at one distance.
    #[inline(always)]
    fn add(&mut self, ring: &Ring<'_>, lens: &DepthLens) {
        let n = self.here.len();
        let [[l, r], [u, b], [ul, br], [ur, bl]] = ring.pairs.map(|pair| pair.map(|row| &row[..n]));
        let (here, depth) = (&self.here[..n], &self.depth_m[..n]);
        let (occlusion, weight) = (&mut self.occlusion[..n], &mut self.weight[..n]);
        // Half of the pixels: half of the focal length.
        let focal = 0.5 * lens.focal_px;
        let slope = ring.lengths.map(|px| focal / px);
        let noise = lens.noise;
        for x in 0..n {
            let (d, z) = (here[x], depth[x]);
            // Four errors, and two more of a sample that was continued beyond the border.
            let lost = BIAS + 6.0 * slope[0] * (noise[0] * z + noise[1]);
            let sum = pair(l[x], r[x], d, z * slope[0], lost)
                + pair(u[x], b[x], d, z * slope[1], lost)
                + pair(ul[x], br[x], d, z * slope[2], lost)
                + pair(ur[x], bl[x], d, z * slope[3], lost);
            // The radius in units of this distance: 1 and more counts fully, a third not at all.
            let within = RADIUS_M * d * slope[0];
            let w = share(1.5 * within - 0.5);
            occlusion[x] += w * sum;
            weight[x] += w;
        }
    }

    fn finish(&self, out: &mut [f32]) {
        for ((out, sum), weight) in out.iter_mut().zip(&self.occlusion).zip(&self.weight) {
            // A right angle seen along its bisector has slopes of 1 on both sides, for three of four
            // directions in part.
            *out = (GAIN * 0.25 * sum / weight.max(1.0)).min(1.0) * DARKEST;
        }
    }
}

/// The occlusion by two opposite samples: half the angle's slope, 0 to 1.
#[inline(always)]
fn pair(a: f32, b: f32, d: f32, slope: f32, lost: f32) -> f32 {
    const FADE: f32 = 1.0 / (CUT - 1.0);
    let side = |s: f32| least(s, most((CUT * STEEPEST - s) * FADE, 0.0));
    share(0.5 * (side((a - d) * slope) + side((b - d) * slope) - lost))
}
