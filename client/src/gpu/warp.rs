//! The warp by compute shaders (`warp.wgsl`): one workgroup per tile that reaches the picture.
//!
//! In: images on the GPU, a pose. Out: the same picture as the CPU's, on the GPU, and read back on
//! request. The CPU finds the tiles that reach the picture, and sends one matrix per tile. Samples
//! are written as maxima, so that the picture does not depend on their order.

use super::{
    device::{Atomics, GpuDevice, GpuError, GrowableBuffer},
    images::{Packed, UploadedImage},
    lru::GpuLru,
    read_back::ReadBack,
    transfer::UploadBudget,
};
use crate::warp::{
    FarFrame, ImageInView, Order, PreparedLdi, Stamp, StretchHistogram, TileJob, WarpOptions, WarpStats, picture_bytes,
    tile_jobs,
};
use bytemuck::{Pod, Zeroable};
use ldi_protocol::{OutputCamera, Pose};
use rayon::prelude::*;

/// Bytes of images that are kept; the current frame may exceed them.
const KEPT_BYTES: u64 = 256 << 20;
/// Largest number of workgroups along one axis of a dispatch.
const ACROSS: u32 = 65_535;

/// Bytes of a pixel: disparity and colour.
pub const PIXEL_BYTES: u64 = 8;

/// Picture parameters in the layout of `warp.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct PictureUniform {
    width: u32,
    height: u32,
    stamp: u32,
    unused: u32,
}

/// A batch of tiles in the layout of `warp.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Batch {
    first_job: u32,
    jobs: u32,
    across: u32,
    unused: u32,
}

/// A tile's matrix in the layout of `warp.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Job {
    rows: [[f32; 4]; 3],
    tile: [u32; 4],
}

/// Pipelines, buffers and images of the warp.
pub struct WarpPass {
    /// One pass with 64-bit atomics, otherwise two.
    passes: Vec<wgpu::ComputePipeline>,
    frame_layout: wgpu::BindGroupLayout,
    image_layout: wgpu::BindGroupLayout,
    target_layout: wgpu::BindGroupLayout,
    picture: GrowableBuffer,
    jobs: GrowableBuffer,
    figures: wgpu::Buffer,
    /// One plane of 64 bits, or two of 32.
    targets: [GrowableBuffer; 2],
    /// Images by serial number.
    pub images: GpuLru<u64, UploadedImage>,
    read_back: ReadBack,
}

/// Words of the statistics: footprint and histogram.
const FIGURES: u64 = 1 + StretchHistogram::BINS as u64;

fn storage(binding: u32, read_only: bool) -> wgpu::BindGroupLayoutEntry {
    entry(binding, wgpu::BufferBindingType::Storage { read_only })
}

fn entry(binding: u32, ty: wgpu::BufferBindingType) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}

/// The stamp's number in `warp.wgsl`.
pub fn number_of(stamp: Stamp) -> Result<u32, GpuError> {
    match stamp {
        Stamp::Quads => Ok(0),
        Stamp::OnePixel => Ok(1),
        Stamp::TwoByTwo => Ok(2),
        Stamp::Cross => Ok(3),
        Stamp::ThreeByThree => Ok(4),
        Stamp::Footprint | Stamp::Parallelogram | Stamp::Ewa => Err(GpuError::Stamp(stamp)),
    }
}

/// Checks whether the shaders implement the stamp and the order.
pub fn check_options(options: &WarpOptions) -> Result<(), GpuError> {
    number_of(options.stamp)?;
    if options.order == Order::Z { Ok(()) } else { Err(GpuError::Order(options.order)) }
}

impl WarpPass {
    pub fn new(card: &GpuDevice) -> Self {
        let layout = |label, entries: &[wgpu::BindGroupLayoutEntry]| {
            card.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries })
        };
        let uniform = |binding| entry(binding, wgpu::BufferBindingType::Uniform);
        let frame_layout = layout("warp", &[uniform(0), storage(1, true), storage(2, false)]);
        let image_layout =
            layout("image", &[storage(0, true), storage(1, true), storage(2, true), storage(3, true), uniform(4)]);
        let planes = [storage(0, false), storage(1, false)];
        let wide = card.atomics == Atomics::Wide;
        let target_layout = layout("picture", if wide { &planes[..1] } else { &planes });
        let pipeline_layout = card.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("warp"),
            bind_group_layouts: &[Some(&frame_layout), Some(&image_layout), Some(&target_layout)],
            immediate_size: 0,
        });
        let keeps: &[&str] = match wide {
            true => &[include_str!("nearest_wide.wgsl")],
            false => &[include_str!("nearest_depth.wgsl"), include_str!("nearest_colour.wgsl")],
        };
        let passes = keeps.iter().map(|keep| {
            let module = card.shader("warp", &format!("{}\n{keep}", include_str!("warp.wgsl")));
            card.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some("warp"),
                layout: Some(&pipeline_layout),
                module: &module,
                entry_point: Some("warp_tile"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            })
        });
        let (copy, storage) = (wgpu::BufferUsages::COPY_DST, wgpu::BufferUsages::STORAGE);
        let target = || GrowableBuffer::new("picture", storage | copy | wgpu::BufferUsages::COPY_SRC);
        Self {
            passes: passes.collect(),
            frame_layout,
            image_layout,
            target_layout,
            picture: GrowableBuffer::new("warp", wgpu::BufferUsages::UNIFORM | copy),
            jobs: GrowableBuffer::new("tiles of the frame", storage | copy),
            figures: card.allocate("figures", 4 * FIGURES, storage | copy | wgpu::BufferUsages::COPY_SRC),
            targets: [target(), target()],
            images: GpuLru::new(KEPT_BYTES),
            read_back: ReadBack::new(),
        }
    }

    /// See [`super::Gpu::upload_image`].
    pub fn upload(
        &mut self,
        card: &GpuDevice,
        laid_out: &PreparedLdi,
        packed: &mut Option<Packed>,
        ahead: bool,
        budget: &mut UploadBudget,
    ) -> bool {
        let serial = laid_out.serial;
        if ahead && !self.images.has(serial) {
            let bytes = packed.get_or_insert_with(|| Packed::new(laid_out)).bytes();
            if !self.images.has_room(bytes) {
                return false;
            }
        }
        self.images.upload(serial, card, budget, || {
            UploadedImage::new(card, packed.take().unwrap_or_else(|| Packed::new(laid_out)))
        })
    }

    /// See [`super::Gpu::warp_images`].
    pub fn warp_images(
        &mut self,
        card: &GpuDevice,
        images: &[ImageInView<'_>],
        pose: &Pose,
        camera: &OutputCamera,
        options: &WarpOptions,
        budget: &mut UploadBudget,
    ) -> Result<WarpStats, GpuError> {
        check_options(options)?;
        let stamp = number_of(options.stamp)?;
        let (mut stats, mut jobs, mut batches) = (WarpStats::default(), Vec::<Job>::new(), Vec::new());
        for image in images {
            budget.without_bound(|a| self.upload(card, image.laid_out, &mut None, false, a));
            let (tiles, more) = tile_jobs(image, pose, camera, options);
            stats.add(&more);
            let Some(uploaded) = self.images.get(image.laid_out.serial) else { continue };
            let first_job = jobs.len() as u32;
            jobs.extend(tiles.iter().map(|t: &TileJob| Job { rows: t.rows, tile: [uploaded.tile(t.number), 0, 0, 0] }));
            let count = tiles.len() as u32;
            batches.push((
                image.laid_out.serial,
                Batch { first_job, jobs: count, across: count.clamp(1, ACROSS), unused: 0 },
            ));
        }
        stats.bytes += picture_bytes(camera);
        let picture = PictureUniform { width: camera.width, height: camera.height, stamp, unused: 0 };
        let encoder = self.encode(card, &picture, &jobs, &batches);
        let figures = &self.figures;
        let copy = |encoder: &mut wgpu::CommandEncoder, to: &wgpu::Buffer| {
            encoder.copy_buffer_to_buffer(figures, 0, to, 0, 4 * FIGURES);
        };
        let figures = self.read_back.run(card, encoder, 4 * FIGURES, copy, |bytes| {
            bytes.as_chunks::<4>().0.iter().map(|w| u32::from_le_bytes(*w)).collect::<Vec<u32>>()
        })?;
        stats.footprint_max_px = f32::from_bits(figures[0]).sqrt();
        stats.stretch = StretchHistogram::of(&figures[1..]);
        Ok(stats)
    }

    fn encode(
        &mut self,
        card: &GpuDevice,
        picture: &PictureUniform,
        jobs: &[Job],
        batches: &[(u64, Batch)],
    ) -> wgpu::CommandEncoder {
        let pixels = u64::from(picture.width) * u64::from(picture.height);
        let [first, second] = &mut self.targets;
        let planes = match card.atomics {
            Atomics::Wide => vec![first.allocate(card, PIXEL_BYTES * pixels)],
            _ => [first, second].map(|plane| plane.allocate(card, PIXEL_BYTES / 2 * pixels)).to_vec(),
        };
        let bind = |layout, buffers: &[&wgpu::Buffer]| {
            let entries: Vec<wgpu::BindGroupEntry<'_>> = (0u32..)
                .zip(buffers)
                .map(|(binding, b)| wgpu::BindGroupEntry { binding, resource: b.as_entire_binding() })
                .collect();
            card.device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries })
        };
        let target_group = bind(&self.target_layout, &planes);
        let picture = self.picture.write(card, bytemuck::bytes_of(picture));
        let jobs = self.jobs.write(card, bytemuck::cast_slice(jobs));
        let frame_group = bind(&self.frame_layout, &[picture, jobs, &self.figures]);
        let mut encoder = card.encoder();
        for plane in &planes {
            encoder.clear_buffer(plane, 0, None);
        }
        encoder.clear_buffer(&self.figures, 0, None);
        let images: Vec<(wgpu::BindGroup, &Batch)> = batches
            .iter()
            .filter(|(_, batch)| batch.jobs > 0)
            .filter_map(|(serial, batch)| {
                let held = self.images.get(*serial)?;
                let of_image = card.buffer("batch", bytemuck::bytes_of(batch), wgpu::BufferUsages::UNIFORM);
                let buffers = [&held.tiles, &held.samples, &held.quads, &held.groups, &of_image];
                Some((bind(&self.image_layout, &buffers), batch))
            })
            .collect();
        // All depths are written before any colour.
        for pipeline in &self.passes {
            let mut pass = encoder
                .begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("warp"), timestamp_writes: None });
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &frame_group, &[]);
            pass.set_bind_group(2, &target_group, &[]);
            for (group, batch) in &images {
                pass.set_bind_group(1, group, &[]);
                pass.dispatch_workgroups(batch.across, batch.jobs.div_ceil(batch.across), 1);
            }
        }
        encoder
    }

    /// The planes of the last picture: colours, disparities, and words from one pixel to the next.
    pub fn planes(&mut self, card: &GpuDevice) -> ([&wgpu::Buffer; 2], u32) {
        let wide = card.atomics == Atomics::Wide;
        let [first, second] = &mut self.targets;
        let first = first.allocate(card, 0);
        // Disparity is the upper half of 64 bits, or the first of two planes.
        if wide { ([first, first], 2) } else { ([second.allocate(card, 0), first], 1) }
    }

    /// Reads the last picture into one of the same size.
    pub fn read(&mut self, card: &GpuDevice, into: &mut FarFrame) -> Result<(), GpuError> {
        let size = PIXEL_BYTES * into.packed.len() as u64;
        let wide = card.atomics == Atomics::Wide;
        let [first, second] = &mut self.targets;
        let planes = [first.allocate(card, 0), second.allocate(card, 0)];
        let copy = |encoder: &mut wgpu::CommandEncoder, to: &wgpu::Buffer| {
            if wide {
                encoder.copy_buffer_to_buffer(planes[0], 0, to, 0, size);
            } else {
                encoder.copy_buffer_to_buffer(planes[0], 0, to, 0, size / 2);
                encoder.copy_buffer_to_buffer(planes[1], 0, to, size / 2, size / 2);
            }
        };
        into.clear();
        self.read_back.run(card, card.encoder(), size, copy, |picture| {
            if wide {
                let read = picture.as_chunks::<8>().0;
                into.packed.par_iter_mut().zip(read.par_iter()).for_each(|(to, p)| *to = u64::from_le_bytes(*p));
            } else {
                let (depths, colours) = picture.split_at(size as usize / 2);
                let read = depths.as_chunks::<4>().0.par_iter().zip(colours.as_chunks::<4>().0.par_iter());
                into.packed.par_iter_mut().zip(read).for_each(|(to, (d, c))| {
                    *to = u64::from(u32::from_le_bytes(*d)) << 32 | u64::from(u32::from_le_bytes(*c));
                });
            }
        })
    }
}
