//! Ground truth: pictures and depth maps of a walk, by ray casting alone.
//!
//! In: a [`Caster`], poses, [`RenderOptions`]. Out: 8-bit sRGB pictures and, on request, eye-space
//! depth.
//!
//! Samples lie on a regular n x n grid in every pixel (n = 1: its centre), each weighs the same
//! (box filter), sums are taken in linear light and only the mean is turned into sRGB. Depth is
//! that of the one ray through the pixel's centre; it is never averaged. Rays are cast in blocks
//! of up to 8 x 8 neighbouring samples in Morton order, which is what the caster's packets like.

use super::{Caster, CellSet, Hit, Ray, RayFootprint};
use glam::DVec3;
use ldi_protocol::{
    OutputCamera, Pose, ViewBasis,
    path::Walk,
    shade::{SKY_SRGB, linear_from_srgb8_table, srgb8_from_linear},
};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Samples across a block of rays: 8 x 8 = 64 rays make a packet.
const BLOCK: u32 = 8;
/// Rows that one task renders; a multiple of every block's rows.
const BAND_ROWS: u32 = 8;
/// Most samples per pixel, 16 x 16: beyond it 8-bit pictures do not change.
pub const MAX_SAMPLES: u32 = 256;
/// Most columns or rows of a picture.
pub const MAX_SIDE: u32 = 16_384;

/// How pictures are rendered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RenderOptions {
    /// The picture.
    pub camera: OutputCamera,
    /// Samples per pixel: a square number, 1 to 256.
    pub samples: u32,
    /// Filter textures trilinearly by the sample's footprint; the caster must have been made with
    /// mips.
    pub mips: bool,
    /// Make depth maps as well.
    pub depth: bool,
    /// Render poses 0, N, 2N, ...
    pub every: usize,
}

/// What went wrong.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// A setting outside its range.
    #[error("{setting} is {value}; {expected}")]
    Setting {
        /// Which.
        setting: &'static str,
        /// What it was.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// A file could not be written.
    #[error("cannot write {path}: {source}; check that the folder exists and has room")]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// A picture, and its depth where asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// 8-bit sRGB, row-major.
    pub rgb: Vec<[u8; 3]>,
    /// Eye-space depth at pixel centres, metres, +inf where there is sky; empty unless asked for.
    pub depth_m: Vec<f32>,
}

impl RenderOptions {
    /// Samples across a pixel.
    fn samples_across(&self) -> u32 {
        self.samples.isqrt()
    }

    /// Whether every setting is in range.
    pub fn check(&self) -> Result<(), RenderError> {
        let fail = |setting, value, expected| Err(RenderError::Setting { setting, value, expected });
        let n = self.samples_across();
        if self.samples == 0 || self.samples > MAX_SAMPLES || n * n != self.samples {
            return fail("samples", self.samples.into(), "a square number from 1 to 256 is needed (1, 4, 9, 16, ...)");
        }
        for (setting, side) in [("width", self.camera.width), ("height", self.camera.height)] {
            if side == 0 || side > MAX_SIDE {
                return fail(setting, side.into(), "1 to 16384 pixels are possible");
            }
        }
        if !(self.camera.fov_deg >= 1.0 && self.camera.fov_deg <= 170.0) {
            return fail("field of view", self.camera.fov_deg, "1 to 170 degrees are possible");
        }
        if self.every == 0 {
            return fail("every", 0.0, "at least 1 is needed");
        }
        Ok(())
    }
}

/// Renders one pose, on all threads of the current pool; the same bytes on any number of them.
/// `options` must pass [`RenderOptions::check`].
pub fn render_frame(caster: &Caster, pose: &Pose, options: &RenderOptions) -> Frame {
    let (width, height) = (options.camera.width, options.camera.height);
    let view = View::new(pose, options);
    let mut rgb = vec![[0; 3]; width as usize * height as usize];
    let band = (width * BAND_ROWS) as usize;
    rgb.par_chunks_mut(band).enumerate().for_each_init(Scratch::default, |scratch, (i, band)| {
        view.render_band(caster, i as u32 * BAND_ROWS, band, scratch);
    });
    let mut depth_m = Vec::new();
    if options.depth {
        let view = View { samples_across: 1, ..view };
        depth_m = vec![f32::INFINITY; rgb.len()];
        depth_m.par_chunks_mut(band).enumerate().for_each_init(Scratch::default, |scratch, (i, band)| {
            view.depth_band(caster, i as u32 * BAND_ROWS, band, scratch);
        });
    }
    Frame { width, height, rgb, depth_m }
}

/// Renders poses 0, N, 2N, ... of a walk to `frame_00000.png` ... (and `.f32`: row-major
/// little-endian depth) in `out_dir`, which must exist, numbered by pose. `progress` hears (frames
/// done, frames in all) after each. Returns the numbers of the poses rendered.
pub fn render_path(
    caster: &Caster,
    walk: &Walk,
    options: &RenderOptions,
    out_dir: &Path,
    progress: &mut (dyn FnMut(usize, usize) + Send),
) -> Result<Vec<usize>, RenderError> {
    options.check()?;
    let numbers: Vec<usize> = (0..walk.poses.len()).step_by(options.every).collect();
    let mut previous: Option<(usize, Frame)> = None;
    for (done, &number) in numbers.iter().enumerate() {
        // Encoding a picture keeps one thread busy for a while: it runs beside the next picture's
        // rays.
        let (written, frame) = rayon::join(
            || previous.as_ref().map_or(Ok(()), |(n, frame)| frame.write(out_dir, *n)),
            || render_frame(caster, &walk.poses[number].pose, options),
        );
        written?;
        previous = Some((number, frame));
        progress(done + 1, numbers.len());
    }
    if let Some((number, frame)) = &previous {
        frame.write(out_dir, *number)?;
    }
    Ok(numbers)
}

impl Frame {
    /// Writes `frame_NUMBER.png` and, if there is depth, `frame_NUMBER.f32`.
    pub fn write(&self, dir: &Path, number: usize) -> Result<(), RenderError> {
        let png = dir.join(format!("frame_{number:05}.png"));
        let bytes: Vec<u8> = self.rgb.iter().flatten().copied().collect();
        image::save_buffer(&png, &bytes, self.width, self.height, image::ExtendedColorType::Rgb8).map_err(|e| {
            let source = match e {
                image::ImageError::IoError(e) => e,
                other => std::io::Error::other(other),
            };
            RenderError::Write { path: png.clone(), source }
        })?;
        if !self.depth_m.is_empty() {
            let path = dir.join(format!("frame_{number:05}.f32"));
            let bytes: Vec<u8> = self.depth_m.iter().flat_map(|d| d.to_le_bytes()).collect();
            std::fs::write(&path, bytes).map_err(|source| RenderError::Write { path, source })?;
        }
        Ok(())
    }
}

/// A camera in the world.
#[derive(Clone, Copy)]
struct View {
    camera: OutputCamera,
    eye: DVec3,
    basis: ViewBasis,
    samples_across: u32,
    mips: bool,
}

/// Buffers of one task.
#[derive(Default)]
struct Scratch {
    rays: Vec<Ray>,
    /// Position in the block, samples.
    at: Vec<[u32; 2]>,
    hits: Vec<Option<Hit>>,
    colours: Vec<[f32; 3]>,
}

impl View {
    fn new(pose: &Pose, options: &RenderOptions) -> Self {
        Self {
            camera: options.camera,
            eye: pose.position,
            basis: pose.basis(),
            samples_across: options.samples_across(),
            mips: options.mips,
        }
    }

    /// Pixels across a block.
    fn block_pixels(&self) -> u32 {
        (BLOCK / self.samples_across).max(1)
    }

    /// Casts the samples of the block whose first pixel is (x, y); samples beyond the picture are
    /// left out.
    fn cast_block(&self, caster: &Caster, x: u32, y: u32, scratch: &mut Scratch) {
        let n = self.samples_across;
        let side = self.block_pixels() * n;
        let (columns, rows) = ((self.camera.width - x) * n, (self.camera.height - y) * n);
        scratch.rays.clear();
        scratch.at.clear();
        for code in 0..side.next_power_of_two().pow(2) {
            let (i, j) = (even_bits(code), even_bits(code >> 1));
            if i >= side.min(columns) || j >= side.min(rows) {
                continue;
            }
            let u = f64::from(x) + (f64::from(i) + 0.5) / f64::from(n);
            let v = f64::from(y) + (f64::from(j) + 0.5) / f64::from(n);
            scratch.rays.push(Ray::new(self.eye, self.camera.ray(&self.basis, u, v)));
            scratch.at.push([i, j]);
        }
        scratch.hits.clear();
        scratch.hits.resize(scratch.rays.len(), None);
        caster.trace_batch(&scratch.rays, &CellSet::all(), &mut scratch.hits);
    }

    /// Calls `f(x, y)` with the first pixel of every block of a band.
    fn blocks(&self, first_row: u32, rows: u32, mut f: impl FnMut(u32, u32)) {
        let step = self.block_pixels() as usize;
        for y in (first_row..first_row + rows).step_by(step) {
            for x in (0..self.camera.width).step_by(step) {
                f(x, y);
            }
        }
    }

    fn render_band(&self, caster: &Caster, first_row: u32, band: &mut [[u8; 3]], scratch: &mut Scratch) {
        let n = self.samples_across;
        let width = self.camera.width as usize;
        let pitch = 1.0 / (self.camera.focal_px() * f64::from(n));
        let footprint = RayFootprint { direction_dx: self.basis.right * pitch, direction_dy: -self.basis.up * pitch };
        let footprint = self.mips.then_some(&footprint);
        let table = linear_from_srgb8_table();
        let sky = SKY_SRGB.map(|c| table[usize::from(c)]);
        let block = self.block_pixels();
        let side = (block * n) as usize;
        self.blocks(first_row, (band.len() / width) as u32, |x, y| {
            self.cast_block(caster, x, y, scratch);
            scratch.colours.resize(side * side, [0.0; 3]);
            for ((ray, hit), [i, j]) in scratch.rays.iter().zip(&scratch.hits).zip(&scratch.at) {
                let colour = hit.as_ref().map_or(sky, |h| caster.shade(h, ray, footprint));
                scratch.colours[*j as usize * side + *i as usize] = colour;
            }
            for py in 0..block.min(self.camera.height - y) {
                for px in 0..block.min(self.camera.width - x) {
                    let mut sum = [0.0; 3];
                    for j in py * n..(py + 1) * n {
                        for i in px * n..(px + 1) * n {
                            let c = scratch.colours[j as usize * side + i as usize];
                            sum = std::array::from_fn(|k| sum[k] + c[k]);
                        }
                    }
                    let mean = sum.map(|s| s / (n * n) as f32);
                    band[(y - first_row + py) as usize * width + (x + px) as usize] = mean.map(srgb8_from_linear);
                }
            }
        });
    }

    fn depth_band(&self, caster: &Caster, first_row: u32, band: &mut [f32], scratch: &mut Scratch) {
        let width = self.camera.width as usize;
        self.blocks(first_row, (band.len() / width) as u32, |x, y| {
            self.cast_block(caster, x, y, scratch);
            for (hit, [i, j]) in scratch.hits.iter().zip(&scratch.at) {
                let depth = hit.map_or(f32::INFINITY, |h| h.t as f32);
                band[(y - first_row + j) as usize * width + (x + i) as usize] = depth;
            }
        });
    }
}

/// The even bits of a Morton code, moved together.
fn even_bits(code: u32) -> u32 {
    (0..16).fold(0, |x, k| x | (code >> (2 * k) & 1) << k)
}

#[cfg(test)]
#[path = "truth_test.rs"]
mod tests;
