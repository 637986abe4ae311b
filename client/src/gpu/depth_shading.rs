//! Shading by depths on the GPU (`depth_shading.wgsl`): the equivalent of the CPU's
//! [`DepthShading`](crate::composite::DepthShading).
//!
//! In: the frame's disparities and the averaged picture, both on the GPU. Out: the picture, darker
//! in corners and at outlines.

use super::device::{GpuDevice, GrowableBuffer};
use crate::composite::DepthLens;
use bytemuck::{Pod, Zeroable};

/// Threads of a workgroup, along a row.
const ACROSS: u32 = 64;

/// Parameters in the layout of `depth_shading.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct ShadingUniform {
    width: u32,
    height: u32,
    factor: u32,
    frame_width: u32,
    reach: [i32; 4],
    focal_px: f32,
    noise: [f32; 2],
    unused: u32,
}

/// Pipelines and buffers of the shading.
pub struct DepthShadingPass {
    shrink: wgpu::ComputePipeline,
    occlude: wgpu::ComputePipeline,
    shade: wgpu::ComputePipeline,
    uniform: GrowableBuffer,
    nearest: GrowableBuffer,
    darkness: GrowableBuffer,
}

impl DepthShadingPass {
    pub fn new(card: &GpuDevice) -> Self {
        let module = card.shader("depth shading", include_str!("depth_shading.wgsl"));
        let pipeline = |entry| card.pipeline(&module, entry);
        let storage = wgpu::BufferUsages::STORAGE;
        Self {
            shrink: pipeline("shrink"),
            occlude: pipeline("occlude"),
            shade: pipeline("shade"),
            uniform: GrowableBuffer::new("depth shading", wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST),
            nearest: GrowableBuffer::new("nearest disparities", storage),
            darkness: GrowableBuffer::new("darkness", storage),
        }
    }

    /// Records the shading of a picture of `size`, an average over blocks of `factor` pixels of a
    /// frame with these disparities.
    pub fn record(
        &mut self,
        card: &GpuDevice,
        encoder: &mut wgpu::CommandEncoder,
        [disparities, colours]: [&wgpu::Buffer; 2],
        ([width, height], factor): ([u32; 2], u32),
        lens: &DepthLens,
    ) {
        let half = [width.div_ceil(2), height.div_ceil(2)];
        let uniform = ShadingUniform {
            width,
            height,
            factor,
            frame_width: width * factor,
            reach: lens.reach([width, height]).map(|px| px as i32),
            focal_px: lens.focal_px,
            noise: lens.noise,
            unused: 0,
        };
        let uniform = self.uniform.write(card, bytemuck::bytes_of(&uniform)).as_entire_binding();
        let nearest = self.nearest.allocate(card, 4 * u64::from(width) * u64::from(height)).as_entire_binding();
        let darkness = self.darkness.allocate(card, 4 * u64::from(half[0]) * u64::from(half[1])).as_entire_binding();
        let everywhere = [width.div_ceil(ACROSS), height];
        let mut run = |pipeline: &wgpu::ComputePipeline, resources: &[(u32, wgpu::BindingResource<'_>)], groups| {
            card.dispatch(encoder, pipeline, resources, groups);
        };
        run(
            &self.shrink,
            &[(0, uniform.clone()), (1, disparities.as_entire_binding()), (2, nearest.clone())],
            everywhere,
        );
        run(
            &self.occlude,
            &[(0, uniform.clone()), (2, nearest.clone()), (3, darkness.clone())],
            [half[0].div_ceil(ACROSS), half[1]],
        );
        run(&self.shade, &[(0, uniform), (2, nearest), (3, darkness), (4, colours.as_entire_binding())], everywhere);
    }
}
