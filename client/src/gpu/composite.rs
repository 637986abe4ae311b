//! The composite on the GPU (`composite.wgsl`): the equivalents of the CPU's `merge`, `fill` and
//! `downsample`.
//!
//! In: near and warped pictures on the GPU. Out: the finished, averaged frame. Sky and the LDI tree
//! are known only to the CPU, so that the composite has two halves: the first returns a bit for
//! each pixel that nothing reached ([`CompositePass::merge`]), and the second takes what the CPU
//! found for these pixels ([`CompositePass::finish`]). Far fewer bytes are read back than with both
//! pictures.

use super::{
    depth_shading::DepthShadingPass,
    device::{GpuDevice, GpuError, GrowableBuffer},
    near::COLOUR_CODES,
    read_back::ReadBack,
};
use crate::{
    composite::{CodeStep, DepthLens},
    frame::{Frame, SKY, Source},
    near::NEAR_PLANE_M,
};
use bytemuck::{Pod, Zeroable};
use ldi_protocol::OutputCamera;
use rayon::prelude::*;

/// Threads of a workgroup, along a row.
const ACROSS: u32 = 64;
/// Tree samples per dispatch: buffers and workgroups are bounded.
const SENT_AT_ONCE: usize = 1 << 20;
/// Pixels per word of a bit mask.
const WORD: usize = 32;

/// Parameters in the layout of `composite.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct CompositeUniform {
    width: u32,
    height: u32,
    faces: u32,
    far_stride: u32,
    nearest: f32,
    sky: u32,
    samples: u32,
    factor: u32,
}

/// A face in the layout of `composite.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Face {
    forward: [f32; 3],
    eye_depth: f32,
    step: f32,
}

/// A pixel taken from the LDI tree, in the layout of `composite.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Sample {
    at: u32,
    colour: u32,
    disparity: f32,
}

/// The planes to composite: colours and depths of the near picture; colours, disparities, and words
/// per pixel of the warped picture, if any.
pub struct DrawnPlanes<'a> {
    pub near: [&'a wgpu::Texture; 2],
    pub far: Option<([&'a wgpu::Buffer; 2], u32)>,
}

/// The second half of a composite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Finishing {
    /// Whether holes are filled.
    pub fill: bool,
    /// Pixels of the frame along a pixel of the picture.
    pub factor: u32,
    /// Shading by depths.
    pub shading: Option<DepthLens>,
}

/// Pipelines and buffers of the composite.
pub struct CompositePass {
    merge: wgpu::ComputePipeline,
    lay_sky: wgpu::ComputePipeline,
    lay_samples: wgpu::ComputePipeline,
    fill: wgpu::ComputePipeline,
    downsample: wgpu::ComputePipeline,
    shading: DepthShadingPass,
    uniform: GrowableBuffer,
    faces: GrowableBuffer,
    colours: GrowableBuffer,
    disparities: GrowableBuffer,
    open: GrowableBuffer,
    skies: GrowableBuffer,
    samples: GrowableBuffer,
    averaged: GrowableBuffer,
    filled: wgpu::Buffer,
    read_back: ReadBack,
}

/// A colour with its source, in the GPU's encoding.
const fn sourced(colour: u32, source: Source) -> u32 {
    colour | (source as u32) << 24
}

impl CompositePass {
    pub fn new(card: &GpuDevice) -> Self {
        let module = card.shader("composite", include_str!("composite.wgsl"));
        let pipeline = |entry| card.pipeline(&module, entry);
        let (storage, to, from) =
            (wgpu::BufferUsages::STORAGE, wgpu::BufferUsages::COPY_DST, wgpu::BufferUsages::COPY_SRC);
        Self {
            merge: pipeline("merge"),
            lay_sky: pipeline("lay_sky"),
            lay_samples: pipeline("lay_samples"),
            fill: pipeline("fill"),
            downsample: pipeline("downsample"),
            shading: DepthShadingPass::new(card),
            uniform: GrowableBuffer::new("join", wgpu::BufferUsages::UNIFORM | to),
            faces: GrowableBuffer::new("faces", storage | to),
            colours: GrowableBuffer::new("colours", storage),
            disparities: GrowableBuffer::new("disparities", storage),
            open: GrowableBuffer::new("open pixels", storage | to | from),
            skies: GrowableBuffer::new("sky", storage | to),
            samples: GrowableBuffer::new("samples of the tree", storage | to),
            averaged: GrowableBuffer::new("averaged", storage | from),
            filled: card.allocate("filled", 4, storage | to | from),
            read_back: ReadBack::new(),
        }
    }

    /// Merges by depth and closes seams. Near geometry wins within the precision given by `steps`.
    /// `open` takes a bit per pixel that nothing reached, row by row, lowest bit of a word first.
    pub fn merge(
        &mut self,
        card: &GpuDevice,
        drawn: &DrawnPlanes<'_>,
        steps: &[CodeStep],
        camera: &OutputCamera,
        open: &mut Vec<u32>,
    ) -> Result<(), GpuError> {
        let pixels = u64::from(camera.width) * u64::from(camera.height);
        let faces: Vec<Face> = steps
            .iter()
            .map(|s| Face {
                forward: s.forward.map(|x| x as f32),
                eye_depth: s.eye_depth_m as f32,
                step: s.step as f32,
            })
            .collect();
        let uniform = CompositeUniform {
            far_stride: drawn.far.map_or(0, |(_, stride)| stride),
            faces: faces.len() as u32,
            ..uniform(camera)
        };
        let words = pixels.div_ceil(WORD as u64);
        let uniform = self.uniform.write(card, bytemuck::bytes_of(&uniform));
        let faces = self.faces.write(card, bytemuck::cast_slice(&faces));
        let (colours, disparities) =
            (self.colours.allocate(card, 4 * pixels), self.disparities.allocate(card, 4 * pixels));
        let bits = self.open.allocate(card, 4 * words);
        // Bindings must not be empty if nothing was warped.
        let [far_colours, far_disparities] = drawn.far.map_or([faces, faces], |(planes, _)| planes);
        let codes = wgpu::TextureViewDescriptor { format: Some(COLOUR_CODES), ..Default::default() };
        let [colour, depth] =
            [drawn.near[0].create_view(&codes), drawn.near[1].create_view(&wgpu::TextureViewDescriptor::default())];
        let mut encoder = card.encoder();
        encoder.clear_buffer(bits, 0, None);
        let resources = [
            (0, uniform.as_entire_binding()),
            (1, wgpu::BindingResource::TextureView(&colour)),
            (2, wgpu::BindingResource::TextureView(&depth)),
            (3, far_colours.as_entire_binding()),
            (4, far_disparities.as_entire_binding()),
            (5, faces.as_entire_binding()),
            (6, colours.as_entire_binding()),
            (7, disparities.as_entire_binding()),
            (8, bits.as_entire_binding()),
        ];
        card.dispatch(&mut encoder, &self.merge, &resources, [camera.width.div_ceil(ACROSS), camera.height]);
        let copy = |encoder: &mut wgpu::CommandEncoder, to: &wgpu::Buffer| {
            encoder.copy_buffer_to_buffer(bits, 0, to, 0, 4 * words);
        };
        self.read_back.run(card, encoder, 4 * words, copy, |bytes| {
            open.clear();
            open.extend(bytes.as_chunks::<4>().0.iter().map(|w| u32::from_le_bytes(*w)));
        })
    }

    /// Adds sky and tree samples of `found` to `open` pixels, fills holes if wanted, averages blocks
    /// of pixels into `out`, whose disparities are 0, and shades it if wanted. Returns the number of
    /// filled pixels.
    pub fn finish(
        &mut self,
        card: &GpuDevice,
        open: &[u32],
        found: &Frame,
        Finishing { fill, factor, shading }: &Finishing,
        out: &mut Frame,
    ) -> Result<u64, GpuError> {
        let (fill, factor) = (*fill, (*factor).max(1));
        let (width, height) = (found.width / factor, found.height / factor);
        out.reset(width, height);
        if out.is_empty() {
            return Ok(0);
        }
        let camera = OutputCamera { width: found.width, height: found.height, fov_deg: 0.0 };
        let (skies, samples) = laid(open, found);
        let everywhere = [camera.width.div_ceil(ACROSS), camera.height];
        let planes = [self.colours.allocate(card, 0), self.disparities.allocate(card, 0)];
        let [colours, disparities] = planes.map(wgpu::Buffer::as_entire_binding);
        for sent in samples.chunks(SENT_AT_ONCE) {
            let uniform = CompositeUniform { samples: sent.len() as u32, ..uniform(&camera) };
            let uniform = self.uniform.write(card, bytemuck::bytes_of(&uniform)).as_entire_binding();
            let sent_there = self.samples.write(card, bytemuck::cast_slice(sent)).as_entire_binding();
            let resources = [(0, uniform), (6, colours.clone()), (7, disparities.clone()), (10, sent_there)];
            let mut encoder = card.encoder();
            card.dispatch(&mut encoder, &self.lay_samples, &resources, [(sent.len() as u32).div_ceil(ACROSS), 1]);
            // Submitted before the buffers are written again.
            card.queue.submit([encoder.finish()]);
        }
        let uniform = CompositeUniform { factor, ..uniform(&camera) };
        let uniform = self.uniform.write(card, bytemuck::bytes_of(&uniform)).as_entire_binding();
        let mut encoder = card.encoder();
        if skies.iter().any(|w| *w != 0) {
            let skies = self.skies.write(card, bytemuck::cast_slice(&skies)).as_entire_binding();
            let resources = [(0, uniform.clone()), (6, colours.clone()), (9, skies)];
            card.dispatch(&mut encoder, &self.lay_sky, &resources, everywhere);
        }
        encoder.clear_buffer(&self.filled, 0, None);
        if fill {
            let filled = self.filled.as_entire_binding();
            let resources = [(0, uniform.clone()), (6, colours.clone()), (7, disparities), (12, filled)];
            card.dispatch(&mut encoder, &self.fill, &resources, everywhere);
        }
        let size = 4 * u64::from(width) * u64::from(height);
        let averaged = self.averaged.allocate(card, size);
        let resources = [(0, uniform), (6, colours), (11, averaged.as_entire_binding())];
        card.dispatch(&mut encoder, &self.downsample, &resources, [width.div_ceil(ACROSS), height]);
        if let Some(lens) = shading {
            self.shading.record(card, &mut encoder, [planes[1], averaged], ([width, height], factor), lens);
        }
        let filled = &self.filled;
        let copy = |encoder: &mut wgpu::CommandEncoder, to: &wgpu::Buffer| {
            encoder.copy_buffer_to_buffer(averaged, 0, to, 0, size);
            encoder.copy_buffer_to_buffer(filled, 0, to, size, 4);
        };
        self.read_back.run(card, encoder, size + 4, copy, |bytes| {
            let words = bytes.as_chunks::<4>().0;
            let (pixels, filled) = words.split_at(out.len());
            let planes = out.colour.par_iter_mut().zip(out.source.par_iter_mut());
            planes.zip(pixels.par_iter()).for_each(|((colour, source), word)| {
                let [r, g, b, from] = *word;
                *colour = u32::from_le_bytes([r, g, b, 0]);
                *source = Source::ALL[usize::from(from).min(Source::ALL.len() - 1)];
            });
            filled.first().map_or(0, |w| u64::from(u32::from_le_bytes(*w)))
        })
    }
}

fn uniform(camera: &OutputCamera) -> CompositeUniform {
    CompositeUniform {
        width: camera.width,
        height: camera.height,
        faces: 0,
        far_stride: 0,
        nearest: (1.0 / NEAR_PLANE_M) as f32,
        sky: sourced(SKY, Source::Sky),
        samples: 0,
        factor: 1,
    }
}

/// The content of open pixels: a bit for each sky pixel, and the tree's samples.
fn laid(open: &[u32], found: &Frame) -> (Vec<u32>, Vec<Sample>) {
    let of_word = |(number, bits): (usize, &u32)| {
        let (mut sky, mut samples, mut left) = (0u32, Vec::new(), *bits);
        while left != 0 {
            let bit = left.trailing_zeros();
            left &= left - 1;
            let at = number * WORD + bit as usize;
            // A bit beyond the frame is a driver's fault, and is ignored.
            match found.source.get(at) {
                Some(Source::Sky) => sky |= 1 << bit,
                Some(Source::Tree) => samples.push(Sample {
                    at: at as u32,
                    colour: sourced(found.colour[at], Source::Tree),
                    disparity: found.disparity[at],
                }),
                _ => {}
            }
        }
        (sky, samples)
    };
    let words: Vec<(u32, Vec<Sample>)> = open.par_iter().enumerate().map(of_word).collect();
    let samples = words.iter().flat_map(|(_, s)| s).copied().collect();
    (words.iter().map(|(sky, _)| *sky).collect(), samples)
}
