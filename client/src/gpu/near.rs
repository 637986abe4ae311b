//! Near geometry on the hardware rasterizer (`near.wgsl`).
//!
//! In: the cells to draw, as for [`crate::near::Rasterizer`]. Out: the same picture, on the GPU,
//! and read back on request. Depth on the GPU is disparity times the near plane's distance: greater
//! is nearer, and the first of equally near triangles wins. Placements are relative to the eye,
//! formed in f64, so that a scene far from the world's origin looks the same.

use super::{
    device::{GpuDevice, GpuError, GrowableBuffer},
    geometry::Geometry,
    read_back::{ROW_ALIGNMENT, ReadBack},
    textures::Textures,
    transfer::UploadBudget,
};
use crate::{
    frame::{Frame, SKY, Source},
    near::{
        ABSENT_TEXEL, MAX_SIDE_PX, NEAR_PLANE_M, NearStats,
        gather::{Draw, Gathered, Mask, gather},
    },
    resident::Resident,
};
use bytemuck::{Pod, Zeroable};
use glam::{DMat3, Vec3};
use ldi_protocol::{
    OutputCamera, Pose,
    index::{DrawnCell, Index},
    mesh::{Material, Wrap},
};
use rayon::prelude::*;

const COLOUR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;
/// The same format, read without decoding.
pub const COLOUR_CODES: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Bytes per pixel of both targets.
const PIXEL: u32 = 4;

/// The camera, as `near.wgsl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct ViewUniform {
    scale: [f32; 2],
    near_m: f32,
    unused: f32,
}

/// A placed cluster, as `near.wgsl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Placed {
    rows: [[f32; 4]; 3],
    normal: [[f32; 3]; 3],
    factor: [f32; 4],
    kind: [f32; 4],
}

/// A draw with its resources.
struct Item {
    geometry: u32,
    cluster: u32,
    texture: Option<u32>,
    masked: bool,
}

/// Render targets.
struct Targets {
    size: [u32; 2],
    colour: wgpu::Texture,
    depth: wgpu::Texture,
}

/// Pipelines, targets and objects of near geometry.
pub struct NearPass {
    solid: wgpu::RenderPipeline,
    masked: wgpu::RenderPipeline,
    view: wgpu::Buffer,
    view_group: wgpu::BindGroup,
    pub geometry: Geometry,
    pub textures: Textures,
    placed: GrowableBuffer,
    targets: Option<Targets>,
    /// Whether the targets are empty.
    is_empty: bool,
    read_back: ReadBack,
}

const CORNER: [wgpu::VertexAttribute; 4] =
    wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Float32x2, 3 => Float32x3];
const PLACED: [wgpu::VertexAttribute; 8] = wgpu::vertex_attr_array![
    4 => Float32x4, 5 => Float32x4, 6 => Float32x4, 7 => Float32x3, 8 => Float32x3, 9 => Float32x3, 10 => Float32x4, 11 => Float32x4
];

impl NearPass {
    pub fn new(card: &GpuDevice) -> Self {
        let textures = Textures::new(card);
        let view_layout = card.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("view"),
            entries: &[wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::VERTEX,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            }],
        });
        let layout = card.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("near"),
            bind_group_layouts: &[Some(&view_layout), Some(&textures.layout)],
            immediate_size: 0,
        });
        let module = card.shader("near", include_str!("near.wgsl"));
        let pipeline = |fragment: &str| {
            card.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(fragment),
                layout: Some(&layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("vertex"),
                    buffers: &[
                        Some(wgpu::VertexBufferLayout {
                            array_stride: size_of::<super::geometry::Corner>() as u64,
                            step_mode: wgpu::VertexStepMode::Vertex,
                            attributes: &CORNER,
                        }),
                        Some(wgpu::VertexBufferLayout {
                            array_stride: size_of::<Placed>() as u64,
                            step_mode: wgpu::VertexStepMode::Instance,
                            attributes: &PLACED,
                        }),
                    ],
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                },
                // Both faces are drawn.
                primitive: wgpu::PrimitiveState::default(),
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(true),
                    depth_compare: Some(wgpu::CompareFunction::Greater),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(fragment),
                    targets: &[Some(COLOUR.into())],
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        let view = card.allocate(
            "view",
            size_of::<ViewUniform>() as u64,
            wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        );
        let view_group = card.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("view"),
            layout: &view_layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: view.as_entire_binding() }],
        });
        Self {
            solid: pipeline("solid"),
            masked: pipeline("masked"),
            view,
            view_group,
            geometry: Geometry::new(),
            textures,
            placed: GrowableBuffer::new("placed", wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST),
            targets: None,
            is_empty: true,
            read_back: ReadBack::new(),
        }
    }

    pub fn forget(&mut self) {
        self.geometry.clear();
        self.textures.clear();
    }

    /// Starts a frame.
    pub fn begin_frame(&mut self) {
        self.geometry.begin_frame();
        self.textures.begin_frame();
    }

    /// See [`super::Gpu::draw`]. Textures are uploaded within the budget.
    #[expect(clippy::too_many_arguments, reason = "the card and what a frame depends on")]
    pub fn draw(
        &mut self,
        card: &GpuDevice,
        budget: &mut UploadBudget,
        index: &Index,
        resident: &dyn Resident,
        cells: &[DrawnCell],
        camera: &OutputCamera,
        pose: &Pose,
    ) -> Result<NearStats, GpuError> {
        let [width, height] = [camera.width, camera.height].map(|n| n.min(MAX_SIDE_PX));
        let scene = gather(index, resident, cells);
        self.is_empty = width == 0 || height == 0 || scene.draws.is_empty();
        if width == 0 || height == 0 {
            return Ok(scene.stats);
        }
        for chunk in &scene.held {
            budget.without_bound(|a| self.geometry.upload(card, chunk, a));
        }
        for (number, texture) in scene.textures() {
            self.textures.upload(card, number, texture, budget);
        }
        let (items, placed) = arrange(&scene, pose);
        let view = ViewUniform {
            scale: [1.0 / camera.half_tan_x() as f32, 1.0 / camera.half_tan_y() as f32],
            near_m: NEAR_PLANE_M as f32,
            unused: 0.0,
        };
        card.queue.write_buffer(&self.view, 0, bytemuck::bytes_of(&view));
        self.placed.write(card, bytemuck::cast_slice(&placed));
        let held = self.targets.take().filter(|t| t.size == [width, height]);
        self.targets = Some(held.unwrap_or_else(|| Targets::new(card, [width, height])));
        let mut encoder = card.encoder();
        self.encode(card, &mut encoder, &scene, &items);
        card.run(encoder)?;
        Ok(scene.stats)
    }

    /// Bytes of geometry and textures on the GPU.
    pub fn bytes(&self) -> u64 {
        self.geometry.bytes() + self.textures.bytes()
    }

    /// Colours and depths of the last picture.
    pub fn textures(&self) -> Option<[&wgpu::Texture; 2]> {
        self.targets.as_ref().map(|t| [&t.colour, &t.depth])
    }

    fn encode(&mut self, card: &GpuDevice, encoder: &mut wgpu::CommandEncoder, scene: &Gathered<'_>, items: &[Item]) {
        let Some(targets) = &self.targets else { return };
        let [colour, depth] =
            [&targets.colour, &targets.depth].map(|t| t.create_view(&wgpu::TextureViewDescriptor::default()));
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("near"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &colour,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
                depth_slice: None,
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &depth,
                depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Store }),
                stencil_ops: None,
            }),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_bind_group(0, &self.view_group, &[]);
        pass.set_vertex_buffer(1, self.placed.allocate(card, 0).slice(..));
        for (masked, pipeline) in [(false, &self.solid), (true, &self.masked)] {
            pass.set_pipeline(pipeline);
            // Skips redundant bindings.
            let (mut geometry, mut texture) = (None, None);
            for (number, item) in (0u32..).zip(items).filter(|(_, i)| i.masked == masked) {
                let Some(uploaded) = self.geometry.get(&scene.held[item.geometry as usize]) else { continue };
                let Some(span) = uploaded.spans.get(item.cluster as usize).filter(|s| s.indices > 0) else { continue };
                if geometry.replace(item.geometry) != Some(item.geometry) {
                    pass.set_vertex_buffer(0, uploaded.corners.slice(..));
                    pass.set_index_buffer(uploaded.indices.slice(..), wgpu::IndexFormat::Uint16);
                }
                if texture.replace(item.texture) != Some(item.texture) {
                    pass.set_bind_group(1, self.textures.get(item.texture), &[]);
                }
                let indices = span.first_index..span.first_index + span.indices;
                pass.draw_indexed(indices, span.first_corner, number..number + 1);
            }
        }
    }

    /// Reads colours and depths of the last picture.
    pub fn read(&mut self, card: &GpuDevice, camera: &OutputCamera, frame: &mut Frame) -> Result<(), GpuError> {
        let [width, height] = [camera.width, camera.height].map(|n| n.min(MAX_SIDE_PX));
        frame.reset(width, height);
        let Some(targets) = self.targets.as_ref().filter(|t| !self.is_empty && t.size == [width, height]) else {
            return Ok(());
        };
        let (width, height) = (frame.width as usize, frame.height);
        let stride = (PIXEL * frame.width).next_multiple_of(ROW_ALIGNMENT);
        let plane = u64::from(stride) * u64::from(height);
        let copy = |encoder: &mut wgpu::CommandEncoder, to: &wgpu::Buffer| {
            for (texture, offset) in [(&targets.colour, 0), (&targets.depth, plane)] {
                let layout = wgpu::TexelCopyBufferLayout { offset, bytes_per_row: Some(stride), rows_per_image: None };
                encoder.copy_texture_to_buffer(
                    texture.as_image_copy(),
                    wgpu::TexelCopyBufferInfo { buffer: to, layout },
                    texture.size(),
                );
            }
        };
        self.read_back.run(card, card.encoder(), 2 * plane, copy, |bytes| {
            let (colours, depths) = bytes.split_at(plane as usize);
            let rows = colours.par_chunks(stride as usize).zip(depths.par_chunks(stride as usize));
            frame
                .colour
                .par_chunks_mut(width)
                .zip(frame.disparity.par_chunks_mut(width))
                .zip(frame.source.par_chunks_mut(width))
                .zip(rows)
                .for_each(|(((colour, disparity), source), (colours, depths))| {
                    let read = colours.as_chunks::<4>().0.iter().zip(depths.as_chunks::<4>().0);
                    let to = colour.iter_mut().zip(disparity).zip(source);
                    for (((colour, disparity), source), (c, d)) in to.zip(read) {
                        let depth = f32::from_le_bytes(*d);
                        let there = depth > 0.0;
                        *disparity = depth * (1.0 / NEAR_PLANE_M) as f32;
                        *colour = if there { u32::from_le_bytes([c[0], c[1], c[2], 0]) } else { SKY };
                        *source = if there { Source::Near } else { Source::Unpainted };
                    }
                });
        })
    }
}

impl Targets {
    fn new(card: &GpuDevice, size: [u32; 2]) -> Self {
        let target = |label, format, view_formats| {
            card.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT
                    | wgpu::TextureUsages::COPY_SRC
                    | wgpu::TextureUsages::TEXTURE_BINDING,
                view_formats,
            })
        };
        Self { size, colour: target("near colour", COLOUR, &[COLOUR_CODES]), depth: target("near depth", DEPTH, &[]) }
    }
}

/// The draws of a frame and their placements, in the order of the cells.
fn arrange(scene: &Gathered<'_>, pose: &Pose) -> (Vec<Item>, Vec<Placed>) {
    let basis = pose.basis();
    let eye_from_world = DMat3::from_cols(basis.right, basis.up, basis.forward).transpose();
    let (mut items, mut placed) = (Vec::with_capacity(scene.draws.len()), Vec::with_capacity(scene.draws.len()));
    for draw in &scene.draws {
        let cluster = scene.cluster(draw);
        let material = scene.material(cluster);
        let cutoff = match scene.mask(cluster) {
            Mask::Solid => -1.0,
            Mask::ByTexel(cutoff) => cutoff.max(0.0),
            Mask::Nothing => continue,
        };
        let texture = material.texture.filter(|_| !cluster.uvs.is_empty());
        let here = texture.filter(|_| scene.texture(material).is_some());
        placed.push(place(
            draw,
            cluster.origin,
            material,
            eye_from_world,
            pose,
            [texture.is_some(), here.is_some()],
            cutoff,
        ));
        items.push(Item { geometry: draw.geometry, cluster: draw.cluster, texture: here, masked: cutoff >= 0.0 });
    }
    (items, placed)
}

/// The wrap modes of a material, in the encoding of `near.wgsl`.
fn wrap_code([across, down]: [Wrap; 2]) -> f32 {
    let code = |wrap| match wrap {
        Wrap::Repeat => 0u8,
        Wrap::Mirror => 1,
        Wrap::Clamp => 2,
    };
    f32::from(code(across) + 3 * code(down))
}

/// A draw's placement and material. Positions are relative to the cluster's origin.
fn place(
    draw: &Draw,
    origin: glam::DVec3,
    material: &Material,
    eye_from_world: DMat3,
    pose: &Pose,
    [textured, here]: [bool; 2],
    cutoff: f32,
) -> Placed {
    let m = &draw.world_from_mesh;
    let matrix = eye_from_world * m.matrix3;
    let offset = matrix * origin + eye_from_world * (m.translation - pose.position);
    let rows = std::array::from_fn(|i| {
        let r = matrix.row(i);
        [r.x as f32, r.y as f32, r.z as f32, offset[i] as f32]
    });
    // Normals turn by the inverse transpose; its scale is irrelevant.
    let turn = m.matrix3.inverse().transpose().as_mat3();
    let mut factor = material.base_colour;
    if textured && !here {
        let grey = Vec3::from_slice(&factor) * Vec3::from(ABSENT_TEXEL);
        factor[..3].copy_from_slice(&grey.to_array());
    }
    Placed {
        rows,
        normal: turn.to_cols_array_2d(),
        factor,
        kind: [f32::from(u8::from(material.unlit)), f32::from(u8::from(here)), cutoff, wrap_code(material.wrap)],
    }
}
