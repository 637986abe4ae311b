//! The warp: layered depth images to the picture, on the CPU.
//!
//! In: a [`PreparedLdi`] (a decoded image laid out in tiles), a pose, the output camera. Out: a
//! [`FarFrame`], colour and disparity per pixel, and [`WarpStats`].
//!
//! **Theory.** McMillan's planar-to-planar warp (`matrix`): (X, Y, W) = P2^-1 P1 (u, v, 1) + d
//! P2^-1 (C1 - C2), projected to (X/W, Y/W) with disparity d/W. Samples with W <= 0 lie behind the
//! eye and never reach a pixel. The reconstruction determines quality and time: [`Stamp::Quads`]
//! joins linked samples to micro-quads (`tile_builder` constructs, `quad_raster` draws them), the
//! other stamps write fixed sets of pixels (`stamps`).
//!
//! **Practice.** Tiles that cannot reach the picture are culled by blocks (`cull`), and those
//! hidden by near geometry or painted pixels are left out (`occlusion`). The output is cut into
//! bands of rows with about equal numbers of samples (`row_bands`); a task owns a band and draws
//! every tile that reaches it. No two tasks share a pixel, and a pixel takes a maximum over
//! (disparity, colour): pictures do not depend on the number of threads, on the order of tiles, nor
//! on AVX2. At equal disparity the larger packed colour wins.
//!
//! Changes against the papers: they warp segments in painter's order without a z-buffer; order
//! `epipole` keeps that for small stamps. Micro-quads need depth: neighbouring quads overlap at
//! folds.

pub mod analytic;
mod bounds;
mod cull;
pub mod debug_colours;
mod ewa;
mod half_resolution;
mod matrix;
mod occlusion;
mod occlusion_order;
#[cfg(test)]
mod occlusion_tests;
pub mod octree;
mod portal_texture;
mod prepared;
mod quad_raster;
pub mod reference;
mod row_bands;
mod stamps;
#[cfg(test)]
mod tests;
mod tile_builder;
mod tiles;
mod transform;

pub use half_resolution::halved;
pub use matrix::{WarpMatrix, Warped};
pub use portal_texture::painted_onto;
pub use prepared::PreparedLdi;
pub(crate) use row_bands::picture_bytes;
pub use row_bands::{TileJob, tile_jobs, transform_only, transformed, warp, warp_images};
pub use transform::Transformed;

use std::{fmt, str::FromStr};

/// Largest side of a footprint stamp, pixels, above the footprints that images guarantee. Larger:
/// one sample covers others that are more accurate.
pub(crate) const LARGEST_FOOTPRINT_STAMP: f32 = 8.0;

/// How a warped sample becomes pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Stamp {
    /// The pixel that contains the sample.
    OnePixel,
    /// Two by two pixels.
    TwoByTwo,
    /// Three by three pixels.
    ThreeByThree,
    /// The pixel and its four neighbours.
    Cross,
    /// An axis-aligned square as large as the sample's footprint.
    Footprint,
    /// The sample's square cell, as transformed by the warp, at the sample's disparity.
    Parallelogram,
    /// Elliptical Gaussians: visibility as for parallelograms, colours are weighted means.
    Ewa,
    /// Linked neighbours joined to small quads.
    #[default]
    Quads,
}

impl Stamp {
    /// All stamps, cheapest first.
    pub const ALL: [Self; 8] = [
        Self::OnePixel,
        Self::TwoByTwo,
        Self::Cross,
        Self::ThreeByThree,
        Self::Footprint,
        Self::Parallelogram,
        Self::Ewa,
        Self::Quads,
    ];

    /// The name used on the command line and in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::OnePixel => "1px",
            Self::TwoByTwo => "2x2",
            Self::ThreeByThree => "3x3",
            Self::Cross => "cross",
            Self::Footprint => "footprint",
            Self::Parallelogram => "parallelogram",
            Self::Ewa => "ewa",
            Self::Quads => "quads",
        }
    }
}

impl fmt::Display for Stamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Stamp {
    type Err = WarpError;

    fn from_str(name: &str) -> Result<Self, WarpError> {
        Self::ALL.into_iter().find(|s| s.name() == name).ok_or_else(|| WarpError::UnknownStamp(name.to_owned()))
    }
}

impl Stamp {
    /// Largest distance that a stamp paints from its sample, output pixels: of quads the sample is
    /// a corner, of other stamps an inner point. The additional pixel covers f32 rounding.
    const fn reach_px(self) -> f64 {
        match self {
            Self::OnePixel | Self::Quads => 1.0,
            Self::TwoByTwo | Self::Cross | Self::ThreeByThree => 3.0,
            Self::Footprint | Self::Parallelogram | Self::Ewa => Self::LARGEST_REACH_PX,
        }
    }

    /// Of all stamps.
    const LARGEST_REACH_PX: f64 = 0.5 * LARGEST_FOOTPRINT_STAMP as f64 + 1.0;
}

/// How samples that meet in a pixel are ordered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Order {
    /// The nearest wins, by disparity.
    #[default]
    Z,
    /// Occlusion-compatible order around the epipole; the last wins.
    Epipole,
}

impl Order {
    /// The name used on the command line and in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Z => "z",
            Self::Epipole => "epipole",
        }
    }
}

impl FromStr for Order {
    type Err = WarpError;

    fn from_str(name: &str) -> Result<Self, WarpError> {
        [Self::Z, Self::Epipole]
            .into_iter()
            .find(|o| o.name() == name)
            .ok_or_else(|| WarpError::UnknownOrder(name.to_owned()))
    }
}

/// An image that takes part in a picture.
#[derive(Debug, Clone, Copy)]
pub struct ImageInView<'a> {
    /// The image.
    pub laid_out: &'a PreparedLdi,
    /// Nothing of it is wanted outside of this rectangle of the picture (from column, from row, to
    /// column, to row): samples that cannot reach it are left out, as they are outside of the
    /// picture. None: the whole picture.
    pub within: Option<[u32; 4]>,
}

impl<'a> From<&'a PreparedLdi> for ImageInView<'a> {
    fn from(laid_out: &'a PreparedLdi) -> Self {
        Self { laid_out, within: None }
    }
}

/// Settings of the warp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct WarpOptions {
    /// Reconstruction.
    pub stamp: Stamp,
    /// Visibility.
    pub order: Order,
    /// Whether to draw tiles that cannot reach the picture, and hidden ones, for measuring the gain
    /// of culling. The picture is the same.
    pub keep_all_tiles: bool,
    /// Whether to draw hidden tiles, for measuring the gain of occlusion culling. The picture is
    /// the same.
    pub keep_hidden: bool,
    /// Whether to use the portable kernels, for comparisons. The picture is the same.
    pub portable: bool,
}

/// What went wrong in a warp.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum WarpError {
    /// No such stamp.
    #[error("unknown stamp `{0}`; use 1px, 2x2, 3x3, cross, footprint, parallelogram, ewa or quads")]
    UnknownStamp(String),
    /// No such order.
    #[error("unknown order `{0}`; use z or epipole")]
    UnknownOrder(String),
    /// A combination that does not exist.
    #[error("order epipole cannot draw stamp `{0}`; use it with 1px or 2x2, or use --order z")]
    OrderWithStamp(Stamp),
}

/// What a warp did.
#[derive(Debug, Clone, PartialEq)]
pub struct WarpStats {
    /// Samples of the image's layers that are there.
    pub samples: u64,
    /// Samples in tiles that were drawn.
    pub samples_warped: u64,
    /// Samples in tiles that cannot reach the picture, or that something nearer hides.
    pub samples_culled: u64,
    /// Hidden samples among these. Each thread tests its own rows, so that a tile on a border
    /// counts as hidden if its upper part is.
    pub samples_hidden: u64,
    /// Micro-quads and border pieces, or stamps, of the tiles that were drawn.
    pub primitives: u64,
    /// Bytes that any warp of these tiles moves: their arrays read once, the picture cleared and
    /// written once.
    pub bytes: u64,
    /// Largest footprint of a sample that landed on the picture, output pixels: the largest
    /// singular value of d(x, y)/d(u, v) at fixed disparity.
    pub footprint_max_px: f32,
    /// Histogram of the longest sides of every eighth quad, a measure of stretched surfaces.
    pub stretch: StretchHistogram,
}

impl WarpStats {
    /// Counts a tile that is drawn.
    fn count_tile(&mut self, part: &tiles::Part, tile: &tiles::Tile, stamp: Stamp) {
        self.samples_warped += u64::from(tile.own);
        self.primitives += if stamp == Stamp::Quads { part.quads(tile) } else { u64::from(tile.own) };
        self.bytes += tile.bytes(stamp == Stamp::Quads);
    }

    /// Adds another image's or band's figures.
    pub fn add(&mut self, other: &Self) {
        self.samples += other.samples;
        self.samples_warped += other.samples_warped;
        self.samples_culled += other.samples_culled;
        self.samples_hidden += other.samples_hidden;
        self.primitives += other.primitives;
        self.bytes += other.bytes;
        self.footprint_max_px = self.footprint_max_px.max(other.footprint_max_px);
        self.stretch.0.iter_mut().zip(other.stretch.0).for_each(|(a, b)| *a += b);
    }
}

impl Default for WarpStats {
    fn default() -> Self {
        Self {
            samples: 0,
            samples_warped: 0,
            samples_culled: 0,
            samples_hidden: 0,
            primitives: 0,
            bytes: 0,
            footprint_max_px: 0.0,
            stretch: StretchHistogram([0; StretchHistogram::BINS]),
        }
    }
}

/// Counts of quads by their longest side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StretchHistogram([u32; Self::BINS]);

impl StretchHistogram {
    /// Bins of an eighth of a pixel; the last takes everything from 32 pixels.
    pub(crate) const BINS: usize = 257;
    const PER_PIXEL: f32 = 8.0;

    /// From counts by bin.
    pub(crate) fn of(counts: &[u32]) -> Self {
        let mut bins = [0; Self::BINS];
        bins.iter_mut().zip(counts).for_each(|(bin, n)| *bin = *n);
        Self(bins)
    }

    fn count(&mut self, side2_px: f32, counts: bool) {
        let bin = (side2_px.sqrt() * Self::PER_PIXEL) as usize;
        self.0[bin.min(Self::BINS - 1)] += u32::from(counts);
    }

    /// The side, in pixels, that a fraction `q` of the quads does not exceed, to an eighth of a
    /// pixel; 0 without quads.
    pub fn quantile_px(&self, q: f64) -> f32 {
        let total: u64 = self.0.iter().map(|n| u64::from(*n)).sum();
        let wanted = (total as f64 * q).ceil() as u64;
        let mut seen = 0;
        for (bin, n) in self.0.iter().enumerate() {
            seen += u64::from(*n);
            if seen >= wanted && seen > 0 {
                return (bin + 1) as f32 / Self::PER_PIXEL;
            }
        }
        0.0
    }
}

/// The warped picture: per pixel, disparity in the upper 32 bits (an f32, 1/m, positive, so that
/// its bits order as it does), colour in the lower ([`crate::frame::pack_rgb`]); 0 where no sample
/// came.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FarFrame {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row-major pixels.
    pub packed: Vec<u64>,
    /// Whether the pixels hold an older picture, which the next warp clears.
    stale: bool,
}

impl FarFrame {
    /// An empty picture.
    pub fn new(width: u32, height: u32) -> Self {
        let mut frame = Self::default();
        frame.reset(width, height);
        frame
    }

    /// Starts a new picture. The buffer is kept, and cleared by the first warp.
    pub fn reset(&mut self, width: u32, height: u32) {
        (self.width, self.height) = (width, height);
        self.packed.resize(width as usize * height as usize, 0);
        self.stale = true;
    }

    /// Makes every pixel empty at once, for direct writes.
    pub fn clear(&mut self) {
        self.packed.fill(0);
        self.stale = false;
    }

    /// An element of `packed`; the larger of two is nearer. Disparity (1/m) must be positive.
    #[inline]
    pub fn pack(disparity: f32, colour: u32) -> u64 {
        u64::from(disparity.to_bits()) << 32 | u64::from(colour)
    }

    /// Packed colour and disparity of a pixel (1/m); None where no sample came.
    #[inline]
    pub fn get(&self, at: usize) -> Option<(u32, f32)> {
        if self.stale { None } else { Self::unpack(self.packed[at]) }
    }

    /// Packed colour and disparity (1/m) of an element of `packed`; None where no sample came.
    #[inline]
    pub fn unpack(packed: u64) -> Option<(u32, f32)> {
        (packed != 0).then(|| (packed as u32, f32::from_bits((packed >> 32) as u32)))
    }

    /// Number of pixels that a sample reached.
    pub fn painted(&self) -> usize {
        if self.stale { 0 } else { self.packed.iter().filter(|p| **p != 0).count() }
    }

    /// Takes the pixels of another picture of the same size that are nearer.
    pub fn take_nearer(&mut self, other: &Self) {
        if other.stale || self.packed.len() != other.packed.len() {
            return;
        }
        if std::mem::take(&mut self.stale) {
            self.packed.copy_from_slice(&other.packed);
        } else {
            self.packed.iter_mut().zip(&other.packed).for_each(|(a, b)| *a = (*a).max(*b));
        }
    }

    /// Whether nothing was warped since the last reset.
    pub fn is_untouched(&self) -> bool {
        self.stale
    }
}
