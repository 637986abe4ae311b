//! Layered depth images, decoded. The coding lives in `codec`.
//!
//! A sample at pixel centre (u, v) with disparity d lies at X = cop + (x right - y up + forward) /
//! d with x = (left + u) / pixels_per_unit and y = (top + v) / pixels_per_unit (McMillan's X = C +
//! (u a + v b + c) / d).

mod check;

pub use check::LdiFault;

use crate::ViewBasis;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// The camera of an LDI: an orthonormal basis and a window of its image plane.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LdiCamera {
    /// Centre of projection in the world.
    pub cop: DVec3,
    /// Orientation; `forward` is the image plane's normal, toward the scene.
    pub basis: ViewBasis,
    /// Samples per unit of the image plane at distance 1 (a focal length in pixels).
    pub pixels_per_unit: f64,
    /// Image-plane coordinate, in samples, of the left border of column 0; rightward positive.
    pub left: i32,
    /// Image-plane coordinate, in samples, of the upper border of row 0; downward positive.
    pub top: i32,
    /// Columns, at most [`Ldi::MAX_SIDE`].
    pub width: u32,
    /// Rows, at most [`Ldi::MAX_SIDE`].
    pub height: u32,
}

impl LdiCamera {
    /// World direction through image coordinates (u, v), with component 1 along `forward`.
    pub fn ray(&self, u: f64, v: f64) -> DVec3 {
        let s = 1.0 / self.pixels_per_unit;
        self.basis.forward + self.basis.right * ((f64::from(self.left) + u) * s)
            - self.basis.up * ((f64::from(self.top) + v) * s)
    }

    /// Image coordinates (u, v) and disparity of a world point; None at or behind the centre of
    /// projection's plane.
    pub fn project(&self, p: DVec3) -> Option<(f64, f64, f64)> {
        let e = p - self.cop;
        let z = e.dot(self.basis.forward);
        (z > 0.0).then(|| {
            let s = self.pixels_per_unit / z;
            (
                e.dot(self.basis.right) * s - f64::from(self.left),
                -e.dot(self.basis.up) * s - f64::from(self.top),
                1.0 / z,
            )
        })
    }
}

/// Uniform codes of disparity: code 0 is sky, code k >= 1 is `smallest + (k - 1) * step`, in 1/m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DisparityCodes {
    /// Disparity of code 1.
    pub smallest: f64,
    /// Difference between neighbouring codes.
    pub step: f64,
    /// Largest code in use, at most 65,535.
    pub largest_code: u16,
}

impl DisparityCodes {
    /// Disparity of a code (0 for the sky).
    #[inline]
    pub fn disparity(&self, code: u16) -> f64 {
        if code == 0 { 0.0 } else { self.smallest + f64::from(code - 1) * self.step }
    }
    /// Nearest code of a positive disparity.
    #[inline]
    pub fn code(&self, disparity: f64) -> u16 {
        let k = ((disparity - self.smallest) / self.step).round();
        1 + k.clamp(0.0, f64::from(self.largest_code - 1)) as u16
    }
}

/// A run of samples of one layer in one row and one block of 256 columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segment {
    /// Row.
    pub row: u16,
    /// First column of the block, a multiple of 256.
    pub column_base: u16,
    /// Position of the segment's first sample in the layer's arrays.
    pub first: u32,
    /// Number of samples, 1 to 256.
    pub count: u16,
}

/// One layer: at most one sample per pixel; structure of arrays in row-major order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LdiLayer {
    /// Non-empty segments by row, then column.
    pub segments: Vec<Segment>,
    /// Column within the block, one per sample, ascending within a segment.
    pub column: Vec<u8>,
    /// Disparity codes (1 and up), one per sample.
    pub disparity: Vec<u16>,
    /// sRGB colour, one per sample.
    pub rgb: Vec<[u8; 3]>,
    /// [`LINK_RIGHT`] and [`LINK_DOWN`]: the neighbour in this layer continues the same surface.
    pub links: Vec<u8>,
    /// How far the surface goes on beyond the sample's centre where no link leads on: [`END_BITS`]
    /// for each of [`SIDES`], in units of 1 / [`END_PARTS`] pixel, at most [`END_PARTS`]; 0 where
    /// it is linked.
    pub ends: Vec<u16>,
    /// By how much disparity changes more, per column and per row, than along the sample's link on
    /// that axis (than not at all without one), in units of [`SLOPE_CODES`] codes, where the
    /// surface goes on beyond its centre on a side without a link; else 0.
    pub slopes: Vec<[i8; 2]>,
}

/// Sides of a sample, in the order of [`LdiLayer::ends`] from the lowest bits: left, right, up,
/// down.
pub const SIDES: [[i32; 2]; 4] = [[-1, 0], [1, 0], [0, -1], [0, 1]];
/// Bits of an end.
pub const END_BITS: usize = 4;
/// Ends are told in this part of a pixel, so that they are off by an eighth of one at most. By
/// judgement.
pub const END_PARTS: u16 = 4;

/// Slopes are told in this many codes per pixel: over half a pixel they are off by a quarter of an
/// output pixel for the worst eye. By judgement; finer costs more bytes than it shows.
pub const SLOPE_CODES: i32 = 8;

/// Whether a sample's surface goes on along an axis (0: columns, 1: rows) where no link leads:
/// where a slope is told.
#[inline]
pub fn is_loose(ends: u16, axis: usize) -> bool {
    end_of(ends, 2 * axis) | end_of(ends, 2 * axis + 1) != 0
}

/// The end of a sample on a side.
#[inline]
pub fn end_of(ends: u16, side: usize) -> u16 {
    ends >> (side * END_BITS) & ((1 << END_BITS) - 1)
}

/// The sample in the next column of the same row and layer exists and continues this surface.
pub const LINK_RIGHT: u8 = 1;
/// The sample in the same column of the next row and the same layer exists and continues this
/// surface.
pub const LINK_DOWN: u8 = 2;

impl LdiLayer {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.disparity.len()
    }
    /// Per sample, a bit for each of [`SIDES`] on which it is linked. The layer's segments must be
    /// sound.
    pub fn linked_sides(&self) -> Vec<u8> {
        let mut out = vec![0; self.len()];
        let places = || {
            let of = |s: &Segment| {
                let (row, base) = (u32::from(s.row), u32::from(s.column_base));
                let samples = s.first as usize..s.first as usize + usize::from(s.count);
                samples.map(move |i| (i, (row, base + u32::from(self.column[i]))))
            };
            self.segments.iter().flat_map(of).peekable()
        };
        let (mut next, mut below) = (places(), places());
        while let Some((i, (row, column))) = next.next() {
            if self.links[i] & LINK_RIGHT != 0 && next.peek().is_some_and(|n| n.1 == (row, column + 1)) {
                out[i] |= 2;
                out[i + 1] |= 1;
            }
            while below.next_if(|b| b.1 < (row + 1, column)).is_some() {}
            if let Some((j, _)) = below.peek().filter(|b| self.links[i] & LINK_DOWN != 0 && b.1 == (row + 1, column)) {
                out[i] |= 8;
                out[*j] |= 4;
            }
        }
        out
    }

    /// The layer with surfaces that end at the borders of their last pixels and go on as links
    /// tell: where nobody knows better.
    pub fn with_half_ends(mut self) -> Self {
        let half =
            |linked: u8| (0..4).filter(|side| linked >> side & 1 == 0).map(|s| (END_PARTS / 2) << (s * END_BITS)).sum();
        self.ends = self.linked_sides().into_iter().map(half).collect();
        self.slopes = vec![[0; 2]; self.len()];
        self
    }

    /// Whether the layer has no sample.
    pub fn is_empty(&self) -> bool {
        self.disparity.is_empty()
    }
}

/// A plane quadrilateral of one colour: a surface that the centre of projection sees so nearly
/// edge-on, or so narrow, that its pixels cannot hold what eyes beside it see.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sliver {
    /// Corners a, b (across from a), e (below a) and f (below b), as some eye sees them.
    pub corners: [SliverCorner; 4],
    /// sRGB.
    pub rgb: [u8; 3],
}

/// A corner of a [`Sliver`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SliverCorner {
    /// Column of the image, in units of 1 / [`Sliver::PARTS`]; at most [`Sliver::MARGIN`] columns
    /// outside.
    pub u: i32,
    /// Row, likewise.
    pub v: i32,
    /// Disparity code, 1 and up.
    pub disparity: u16,
}

impl Sliver {
    /// Parts of a pixel that corners are rounded to: an eighth of a picture's pixel where an
    /// image's pixel is two.
    pub const PARTS: i32 = 16;
    /// Pixels that a corner may lie outside of the image: surfaces that it holds go on beside it;
    /// what reaches farther is another image's.
    pub const MARGIN: i32 = 256;
    /// Most slivers of an image: bounds what a forged chunk can make a reader allocate, to 10 MB.
    pub const MOST: usize = 1 << 18;
}

/// A layered depth image. Layer 0 holds the nearest samples as seen from the centre of projection;
/// in a pixel, deeper layers hold farther samples; a deeper layer may repeat a sample of one above
/// it, so that what continues behind an occluder is linked to what it continues. Layers may skip a
/// pixel. Sky is no sample but a bit per pixel: a background pixel lies at infinity, so that
/// looking it up needs a rotation only.
#[derive(Debug, Clone, PartialEq)]
pub struct Ldi {
    /// Geometry of the image.
    pub camera: LdiCamera,
    /// Disparity codes of all layers.
    pub codes: DisparityCodes,
    /// Nearest first. May be fewer than the image has, while deeper layers are still on their way.
    pub layers: Vec<LdiLayer>,
    /// One bit per pixel, rows padded to whole u64 words ([`Ldi::sky_words_per_row`]): from some
    /// eye that may use the image, nothing of the culled subset covers this direction.
    pub sky: Vec<u64>,
    /// What the layers' pixels are too coarse for. Comes with the deeper layers.
    pub slivers: Vec<Sliver>,
}

impl Ldi {
    /// Largest width or height.
    pub const MAX_SIDE: u32 = 16_384;
    /// Largest number of pixels: 8 MiB of sky bits, and what a builder's buffers may cost.
    pub const MAX_PIXELS: u64 = 1 << 26;
    /// Largest number of layers.
    pub const MAX_LAYERS: usize = 32;

    /// Words of 64 bits per row of [`Ldi::sky`].
    pub fn sky_words_per_row(&self) -> usize {
        (self.camera.width as usize).div_ceil(64)
    }
    /// Whether some eye sees sky in the direction of this pixel; None outside the image.
    #[inline]
    pub fn is_sky(&self, column: i64, row: i64) -> Option<bool> {
        let (w, h) = (i64::from(self.camera.width), i64::from(self.camera.height));
        if column < 0 || row < 0 || column >= w || row >= h {
            return None;
        }
        let word = self.sky[row as usize * self.sky_words_per_row() + column as usize / 64];
        Some(word >> (column as usize % 64) & 1 == 1)
    }
    /// Samples over all layers.
    pub fn samples(&self) -> usize {
        self.layers.iter().map(LdiLayer::len).sum()
    }
}
