//! A frame: colour, disparity and source of each pixel.
//!
//! The rasterizer (`near`) starts the frame, the warp's result is composited into it by disparity,
//! and [`Frame::resolve`] averages a supersampled frame to the output's size. Row 0 is on top,
//! pixel centres lie at +0.5. Disparity is 1 / eye-space depth in 1/m: greater is nearer, 0 is
//! nothing or infinitely far.

use ldi_protocol::{
    OutputCamera,
    shade::{SKY_SRGB, linear_from_srgb8_table, srgb8_from_linear},
};
use rayon::prelude::*;

/// The source of a pixel's colour, in order of increasing uncertainty; [`Frame::resolve`] uses the
/// order for ties.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[repr(u8)]
pub enum Source {
    /// Sky: the direction is known to meet no geometry.
    Sky = 0,
    /// A triangle drawn by the rasterizer.
    Near = 1,
    /// A warped sample of a layered depth image.
    Far = 2,
    /// A sample of the LDI tree, in place of finer data that is missing.
    Tree = 3,
    /// Extrapolated from neighbouring pixels.
    Filled = 4,
    /// Unknown and not filled.
    #[default]
    Unpainted = 5,
}

/// Packs 8-bit sRGB as 0x00BBGGRR: in memory the bytes are R, G, B, 0.
#[inline]
pub const fn pack_rgb(rgb: [u8; 3]) -> u32 {
    u32::from_le_bytes([rgb[0], rgb[1], rgb[2], 0])
}

/// The inverse of [`pack_rgb`].
#[inline]
pub const fn unpack_rgb(colour: u32) -> [u8; 3] {
    let b = colour.to_le_bytes();
    [b[0], b[1], b[2]]
}

/// [`SKY_SRGB`], packed. Also the colour of unpainted pixels, so that a picture without data is not
/// black.
pub const SKY: u32 = pack_rgb(SKY_SRGB);

/// A picture with depth. Three planes of `width * height`, row-major.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frame {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// sRGB by [`pack_rgb`].
    pub colour: Vec<u32>,
    /// 1 / eye-space depth at the pixel centre, 1/m; 0 where there is no surface.
    pub disparity: Vec<f32>,
    /// Source of the colour.
    pub source: Vec<Source>,
}

impl Source {
    /// All sources, by number.
    pub const ALL: [Self; 6] = [Self::Sky, Self::Near, Self::Far, Self::Tree, Self::Filled, Self::Unpainted];
}

impl Frame {
    /// An unpainted frame.
    pub fn new(width: u32, height: u32) -> Self {
        let mut frame = Self::default();
        frame.reset(width, height);
        frame
    }

    /// Makes every pixel unpainted, reusing buffers.
    pub fn reset(&mut self, width: u32, height: u32) {
        let n = width as usize * height as usize;
        (self.width, self.height) = (width, height);
        self.colour.clear();
        self.colour.resize(n, SKY);
        self.disparity.clear();
        self.disparity.resize(n, 0.0);
        self.source.clear();
        self.source.resize(n, Source::Unpainted);
    }

    /// Makes those pixels unpainted whose bit of `open` is set: row by row, lowest bit of a word
    /// first. All others were painted by the GPU: they count as near geometry, without valid
    /// colours and disparities.
    pub fn reset_open(&mut self, width: u32, height: u32, open: &[u32]) {
        const WORD: usize = u32::BITS as usize;
        let n = width as usize * height as usize;
        (self.width, self.height) = (width, height);
        self.colour.resize(n, SKY);
        self.disparity.resize(n, 0.0);
        self.source.resize(n, Source::Unpainted);
        let planes = self.colour.par_chunks_mut(WORD).zip(self.disparity.par_chunks_mut(WORD));
        let planes = planes.zip(self.source.par_chunks_mut(WORD)).zip(open.par_iter());
        planes.with_min_len(512).for_each(|(((colours, disparities), sources), word)| {
            sources.fill(Source::Near);
            let planes = colours.iter_mut().zip(disparities).zip(sources).enumerate();
            for (_, ((colour, disparity), source)) in planes.filter(|(bit, _)| *word != 0 && word >> bit & 1 == 1) {
                (*colour, *disparity, *source) = (SKY, 0.0, Source::Unpainted);
            }
        });
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.colour.len()
    }

    /// Whether the frame has no pixel.
    pub fn is_empty(&self) -> bool {
        self.colour.is_empty()
    }

    /// Turns unpainted pixels into sky, if everything visible was drawn.
    pub fn paint_rest_as_sky(&mut self) {
        for (source, colour) in self.source.iter_mut().zip(&mut self.colour) {
            if *source == Source::Unpainted {
                (*source, *colour) = (Source::Sky, SKY);
            }
        }
    }

    /// Pixels from `source`.
    pub fn count(&self, source: Source) -> usize {
        self.source.iter().filter(|s| **s == source).count()
    }

    /// The colours as RGB bytes, row by row.
    pub fn to_rgb8(&self) -> Vec<u8> {
        self.colour.iter().flat_map(|c| unpack_rgb(*c)).collect()
    }

    /// Averages blocks of `factor` x `factor` pixels into `out`, in linear light.
    ///
    /// Disparity is the block's largest, as visibility is decided at full resolution. The source is
    /// the most frequent one; ties go to the more uncertain. A factor of 1 copies.
    pub fn resolve(&self, factor: u32, out: &mut Self) {
        if factor <= 1 {
            out.clone_from(self);
            return;
        }
        let (width, height) = (self.width / factor, self.height / factor);
        out.reset(width, height);
        let linear = linear_from_srgb8_table();
        let scale = 1.0 / (factor * factor) as f32;
        for row in 0..height {
            for column in 0..width {
                let (mut sum, mut nearest, mut votes) = ([0.0f32; 3], 0.0f32, [0u32; 6]);
                for dy in 0..factor {
                    let first = ((row * factor + dy) * self.width + column * factor) as usize;
                    for i in first..first + factor as usize {
                        for (s, c) in sum.iter_mut().zip(unpack_rgb(self.colour[i])) {
                            *s += linear[c as usize];
                        }
                        nearest = nearest.max(self.disparity[i]);
                        votes[self.source[i] as usize] += 1;
                    }
                }
                let o = (row * width + column) as usize;
                out.colour[o] = pack_rgb(sum.map(|s| srgb8_from_linear(s * scale)));
                out.disparity[o] = nearest;
                out.source[o] = most_frequent(votes);
            }
        }
    }
}

/// The source with the most votes; ties go to the later one.
fn most_frequent(votes: [u32; 6]) -> Source {
    let mut best = 0;
    for (i, n) in votes.iter().enumerate() {
        if *n >= votes[best] {
            best = i;
        }
    }
    Source::ALL[best]
}

/// The camera of a frame at `factor` times the output's resolution: same field of view, more
/// pixels.
pub fn supersampled(camera: &OutputCamera, factor: u32) -> OutputCamera {
    OutputCamera { width: camera.width * factor, height: camera.height * factor, fov_deg: camera.fov_deg }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_average_in_linear_light() {
        let mut f = Frame::new(2, 2);
        f.colour = vec![pack_rgb([255; 3]), pack_rgb([0; 3]), pack_rgb([255; 3]), pack_rgb([0; 3])];
        let mut out = Frame::default();
        f.resolve(2, &mut out);
        // Half the light is code 188, not 128.
        assert_eq!(unpack_rgb(out.colour[0]), [188; 3]);
        assert_eq!(out.len(), 1);
    }

    #[test]
    fn resolve_keeps_uniform_colours_and_breaks_ties_doubtfully() {
        let mut f = Frame::new(4, 2);
        f.colour.fill(pack_rgb([17, 130, 251]));
        f.source = vec![
            Source::Near,
            Source::Far,
            Source::Near,
            Source::Near,
            Source::Near,
            Source::Filled,
            Source::Sky,
            Source::Near,
        ];
        f.disparity = vec![0.1, 0.2, 0.3, 0.0, 0.5, 0.0, 0.0, 0.4];
        let mut out = Frame::default();
        f.resolve(2, &mut out);
        assert_eq!(out.colour, vec![pack_rgb([17, 130, 251]); 2]);
        assert_eq!(out.source, vec![Source::Near, Source::Near]);
        assert_eq!(out.disparity, vec![0.5, 0.4]);
        f.source = vec![
            Source::Near,
            Source::Filled,
            Source::Far,
            Source::Near,
            Source::Near,
            Source::Filled,
            Source::Far,
            Source::Sky,
        ];
        f.resolve(2, &mut out);
        assert_eq!(out.source, vec![Source::Filled, Source::Far]);
    }

    #[test]
    fn packing_round_trips() {
        for rgb in [[0, 0, 0], [1, 2, 3], [255, 0, 128]] {
            assert_eq!(unpack_rgb(pack_rgb(rgb)), rgb);
        }
        assert_eq!(pack_rgb([1, 2, 3]).to_le_bytes(), [1, 2, 3, 0]);
    }
}
