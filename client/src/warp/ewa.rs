//! Elliptical weighted means: the colours of [`super::Stamp::Ewa`].
//!
//! In: a picture in which every sample's cell has decided visibility (`stamps`, as for
//! parallelograms). Out: the same pixels with other colours: means over all samples near enough, in
//! depth and on the picture. After Zwicker, Pfister, van Baar and Gross, Surface splatting (2001):
//! a round Gaussian around each sample is transformed to an ellipse by the warp's Jacobian and
//! widened by the pixel's own; its tail is cut.
//!
//! Visibility and depth do not change: silhouettes stay as sharp as the cells are, holes stay
//! holes. Samples are added in the order of the tiles, whatever the number of threads, and no
//! library function is used that differs between platforms.

use super::{
    quad_raster::Target,
    stamps::{Splat, own_rows},
    tiles::{Part, Tile},
    transform::{Scratch, TileTransform},
};
use crate::frame::{pack_rgb, unpack_rgb};

/// Variance of a sample's Gaussian, squared LDI pixels. Smaller: single samples become visible;
/// larger: blur. A judgement.
pub const SAMPLE_VARIANCE: f32 = 0.16;
/// Variance of a pixel's Gaussian, squared output pixels: about that of a box one pixel wide, 1/12.
pub const PIXEL_VARIANCE: f32 = 0.09;
/// Squared distance, in standard deviations, where the tail is cut.
pub const CUT: f32 = 8.0;
/// Samples whose disparities differ from the pixel's by more than this fraction belong to another
/// surface. By judgement: a row of a floor at a grazing angle is nearly as much apart.
pub const SAME_SURFACE: f32 = 1.0 / 16.0;

/// Weighted sums for the pixels of a band.
pub struct Means {
    /// Squared sRGB codes (see `quads`), and weights.
    sums: Vec<[f32; 4]>,
}

/// The ellipse of a sample: its weight at an offset on the picture.
struct Ellipse {
    /// Inverse of the variance: xx, xy, yy, per squared pixel.
    inverse: [f32; 3],
    /// Half the width and height of what is not cut, pixels.
    reach: [f32; 2],
}

impl Ellipse {
    fn new([a, b, c, d]: [f32; 4]) -> Self {
        let xx = SAMPLE_VARIANCE * (a * a + b * b) + PIXEL_VARIANCE;
        let xy = SAMPLE_VARIANCE * (a * c + b * d);
        let yy = SAMPLE_VARIANCE * (c * c + d * d) + PIXEL_VARIANCE;
        let scale = 1.0 / (xx * yy - xy * xy);
        Self { inverse: [yy * scale, -xy * scale, xx * scale], reach: [(CUT * xx).sqrt(), (CUT * yy).sqrt()] }
    }

    /// (1 - q / 8)^4, which is nearly exp(-q / 2) and ends at q = 8.
    fn weight(&self, [dx, dy]: [f32; 2]) -> f32 {
        let [xx, xy, yy] = self.inverse;
        let q = dx * dx * xx + 2.0 * dx * dy * xy + dy * dy * yy;
        let root = (1.0 - q / CUT).max(0.0);
        (root * root) * (root * root)
    }
}

impl Means {
    /// Nothing yet.
    pub fn new(target: &Target<'_>) -> Self {
        Self { sums: vec![[0.0; 4]; target.pixels.len()] }
    }

    /// Adds a transformed tile's own samples.
    #[inline(always)]
    pub fn add_tile(
        &mut self,
        target: &Target<'_>,
        transform: &TileTransform,
        part: &Part,
        tile: &Tile,
        scratch: &Scratch,
    ) {
        for i in own_rows(part, tile).flatten() {
            let Some(splat) = Splat::new(transform, part, tile, scratch, i) else { continue };
            let ellipse = Ellipse::new(splat.jacobian);
            let light = unpack_rgb(part.colour[tile.first + i]).map(|c| f32::from(c) * f32::from(c));
            splat.pixels(target.window, ellipse.reach, |at, offset| {
                let seen = f32::from_bits((target.pixels[at] >> 32) as u32);
                if (seen - splat.disparity).abs() > SAME_SURFACE * seen {
                    return;
                }
                let weight = ellipse.weight(offset);
                let [r, g, b, w] = &mut self.sums[at];
                for (sum, l) in [r, g, b].into_iter().zip(light) {
                    *sum += weight * l;
                }
                *w += weight;
            });
        }
    }

    /// Replaces the colours of pixels with samples.
    pub fn write(self, target: &mut Target<'_>) {
        for (at, [r, g, b, w]) in self.sums.into_iter().enumerate().filter(|(_, s)| s[3] > 0.0) {
            let disparity = (target.pixels[at] >> 32) as u32;
            target.set(at, disparity, pack_rgb([r, g, b].map(|sum| ((sum / w).sqrt() + 0.5) as u8)));
        }
    }
}
