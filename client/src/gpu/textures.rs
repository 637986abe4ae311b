//! Textures on the GPU: resident levels, uploaded again when finer ones arrive.

use super::{
    device::GpuDevice,
    lru::PATIENCE,
    transfer::{Transfer, UploadBudget},
};
use bytemuck::{Pod, Zeroable};
use ldi_protocol::texture::{MipLevel, Texture};
use std::{
    collections::HashMap,
    sync::{Arc, Weak},
};

/// Largest side of levels that are uploaded at once, so that every texture shows something.
const SMALL_PX: u32 = 256;

/// As `near.wgsl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct ImageInfo {
    size: [f32; 2],
    first_level: f32,
    unused: f32,
}

struct UploadedTexture {
    /// Keeps the texture's address from being used again.
    source: Weak<Texture>,
    group: wgpu::BindGroup,
    bytes: u64,
    /// Whether all resident levels that the GPU supports are uploaded.
    whole: bool,
    /// The frame that used it last.
    used: u64,
}

/// The state of a texture on the GPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextureUpload {
    /// Nothing is uploaded.
    Nothing,
    /// Coarser levels than the resident ones are uploaded.
    Coarse,
    /// All resident levels are uploaded.
    All,
}

/// The textures on the GPU.
pub struct Textures {
    pub layout: wgpu::BindGroupLayout,
    held: HashMap<u32, UploadedTexture>,
    /// Finer versions of textures, being uploaded.
    arriving: HashMap<u32, (UploadedTexture, Transfer)>,
    frame: u64,
    /// Bound for materials without a texture.
    none: wgpu::BindGroup,
}

impl Textures {
    pub fn new(card: &GpuDevice) -> Self {
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty,
            count: None,
        };
        let uniform = wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let texels = wgpu::BindingType::Texture {
            multisampled: false,
            sample_type: wgpu::TextureSampleType::Float { filterable: false },
            view_dimension: wgpu::TextureViewDimension::D2,
        };
        let layout = card.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("texture"),
            entries: &[entry(0, uniform), entry(1, texels)],
        });
        let none = group(card, &layout, &white(card), ImageInfo { size: [1.0; 2], first_level: 0.0, unused: 0.0 });
        Self { layout, held: HashMap::new(), arriving: HashMap::new(), frame: 0, none }
    }

    /// Starts a frame.
    pub fn begin_frame(&mut self) {
        let last = self.frame;
        self.frame += 1;
        self.arriving.retain(|_, (u, _)| u.used + PATIENCE >= last);
        // Textures used recently may return at once; those that the cache has evicted will not.
        self.held.retain(|_, u| u.used == last || u.source.strong_count() > 0);
    }

    /// Uploads a texture within the budget: small levels first, which are shown until all levels
    /// are uploaded.
    pub fn upload(
        &mut self,
        card: &GpuDevice,
        number: u32,
        texture: &Arc<Texture>,
        budget: &mut UploadBudget,
    ) -> TextureUpload {
        let is = |u: &UploadedTexture| u.source.as_ptr() == Arc::as_ptr(texture);
        let held = self.held.get_mut(&number);
        let (any, all) = (held.is_some(), held.as_ref().is_some_and(|u| is(u) && u.whole));
        held.into_iter().for_each(|u| u.used = self.frame);
        if all {
            return TextureUpload::All;
        }
        let Some(finest) = finest(card, texture) else { return TextureUpload::All };
        if !any && budget.left > 0 && bytes_from(texture, finest) > budget.left {
            let small = |l: &Option<MipLevel>| l.as_ref().is_some_and(|l| l.width.max(l.height) <= SMALL_PX);
            let first = texture.levels.iter().position(small).filter(|first| *first > finest);
            if let Some((uploaded, mut transfer)) = first.and_then(|first| self.begin(card, texture, first)) {
                budget.without_bound(|a| transfer.push(card, a));
                self.held.insert(number, UploadedTexture { whole: false, ..uploaded });
            }
        }
        let mut arriving = self.arriving.remove(&number).filter(|(u, _)| is(u));
        if arriving.is_none() && budget.left > 0 {
            arriving = self.begin(card, texture, finest);
        }
        if let Some((mut uploaded, mut transfer)) = arriving {
            if transfer.push(card, budget) {
                self.held.insert(number, uploaded);
                return TextureUpload::All;
            }
            uploaded.used = self.frame;
            self.arriving.insert(number, (uploaded, transfer));
        }
        if self.held.contains_key(&number) { TextureUpload::Coarse } else { TextureUpload::Nothing }
    }

    /// The texture of a material.
    pub fn get(&self, number: Option<u32>) -> &wgpu::BindGroup {
        number.and_then(|n| self.held.get(&n)).map_or(&self.none, |u| &u.group)
    }

    /// Bytes on the GPU, including incomplete uploads.
    pub fn bytes(&self) -> u64 {
        self.held.values().chain(self.arriving.values().map(|(u, _)| u)).map(|u| u.bytes).sum()
    }

    pub fn clear(&mut self) {
        self.held.clear();
        self.arriving.clear();
    }

    /// The levels from `first` on, and their transfer.
    fn begin(&self, card: &GpuDevice, texture: &Arc<Texture>, first: usize) -> Option<(UploadedTexture, Transfer)> {
        let levels: Vec<_> = texture.levels[first..].iter().map_while(Option::as_ref).collect();
        let finest = levels.first()?;
        let on_card = allocate(card, finest.width, finest.height, levels.len() as u32);
        let mut transfer = Transfer::default();
        for number in 0..levels.len() {
            transfer.level(texture, first + number, &on_card, number as u32);
        }
        let (width, height) = texture.size()?;
        let info = ImageInfo { size: [width as f32, height as f32], first_level: first as f32, unused: 0.0 };
        let group = group(card, &self.layout, &on_card, info);
        let bytes = bytes_from(texture, first);
        let source = Arc::downgrade(texture);
        Some((UploadedTexture { source, group, bytes, whole: true, used: self.frame }, transfer))
    }
}

/// The finest resident level that the GPU supports.
fn finest(card: &GpuDevice, texture: &Texture) -> Option<usize> {
    let most = card.device.limits().max_texture_dimension_2d;
    texture.levels.iter().position(|l| l.as_ref().is_some_and(|l| l.width.max(l.height) <= most))
}

/// Bytes of the levels from `first` on.
fn bytes_from(texture: &Texture, first: usize) -> u64 {
    texture.levels[first..].iter().map_while(Option::as_ref).map(|l| size_of_val(&*l.rgba) as u64).sum()
}

fn white(card: &GpuDevice) -> wgpu::Texture {
    let texture = allocate(card, 1, 1, 1);
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4), rows_per_image: None };
    card.queue.write_texture(texture.as_image_copy(), &[255; 4], layout, texture.size());
    texture
}

fn allocate(card: &GpuDevice, width: u32, height: u32, levels: u32) -> wgpu::Texture {
    card.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("texels"),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: levels,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba8UnormSrgb,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    })
}

fn group(
    card: &GpuDevice,
    layout: &wgpu::BindGroupLayout,
    texture: &wgpu::Texture,
    info: ImageInfo,
) -> wgpu::BindGroup {
    let info = card.buffer("texture", bytemuck::bytes_of(&info), wgpu::BufferUsages::UNIFORM);
    let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
    card.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("texture"),
        layout,
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: info.as_entire_binding() },
            wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(&view) },
        ],
    })
}
