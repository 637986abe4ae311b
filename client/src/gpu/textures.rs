//! Textures on the card: the levels that are here, put there anew when finer ones have come.

use super::device::Card;
use bytemuck::{Pod, Zeroable};
use ldi_protocol::{mesh::Wrap, texture::Texture};
use std::{
    collections::{HashMap, HashSet},
    sync::{Arc, Weak},
};

/// As `near.wgsl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct ImageInfo {
    size: [f32; 2],
    first_level: f32,
    unused: f32,
}

struct Uploaded {
    /// Held so that the address stays this texture's.
    source: Weak<Texture>,
    group: wgpu::BindGroup,
    bytes: u64,
}

/// See the module.
pub struct Textures {
    pub layout: wgpu::BindGroupLayout,
    pub sampler_layout: wgpu::BindGroupLayout,
    held: HashMap<u32, Uploaded>,
    /// For materials without a texture.
    none: wgpu::BindGroup,
    /// By wrap modes across and down.
    samplers: [[wgpu::BindGroup; 3]; 3],
}

const WRAPS: [Wrap; 3] = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];

fn mode(wrap: Wrap) -> wgpu::AddressMode {
    match wrap {
        Wrap::Repeat => wgpu::AddressMode::Repeat,
        Wrap::Mirror => wgpu::AddressMode::MirrorRepeat,
        Wrap::Clamp => wgpu::AddressMode::ClampToEdge,
    }
}

impl Textures {
    pub fn new(card: &Card) -> Self {
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
            sample_type: wgpu::TextureSampleType::Float { filterable: true },
            view_dimension: wgpu::TextureViewDimension::D2,
        };
        let layout = card.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("texture"),
            entries: &[entry(0, uniform), entry(1, texels)],
        });
        let sampling = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
        let sampler_layout = card.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("sampler"),
            entries: &[entry(0, sampling)],
        });
        let samplers = WRAPS.map(|across| {
            WRAPS.map(|down| {
                let sampler = card.device.create_sampler(&wgpu::SamplerDescriptor {
                    label: Some("texels"),
                    address_mode_u: mode(across),
                    address_mode_v: mode(down),
                    mag_filter: wgpu::FilterMode::Linear,
                    min_filter: wgpu::FilterMode::Linear,
                    mipmap_filter: wgpu::MipmapFilterMode::Linear,
                    ..Default::default()
                });
                card.device.create_bind_group(&wgpu::BindGroupDescriptor {
                    label: Some("sampler"),
                    layout: &sampler_layout,
                    entries: &[wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::Sampler(&sampler) }],
                })
            })
        });
        let none = group(card, &layout, &white(card), ImageInfo { size: [1.0; 2], first_level: 0.0, unused: 0.0 });
        Self { layout, sampler_layout, held: HashMap::new(), none, samplers }
    }

    /// Puts the textures of a frame onto the card, those that are there; others go.
    pub fn hold<'a>(&mut self, card: &Card, textures: impl Iterator<Item = (u32, &'a Arc<Texture>)>) {
        let mut wanted = HashSet::new();
        for (number, texture) in textures {
            wanted.insert(number);
            if self.held.get(&number).is_some_and(|u| u.source.as_ptr() == Arc::as_ptr(texture)) {
                continue;
            }
            self.held.remove(&number);
            if let Some(group) = self.upload(card, texture) {
                let bytes = texture.levels.iter().flatten().map(|l| size_of_val(&*l.rgba) as u64).sum();
                self.held.insert(number, Uploaded { source: Arc::downgrade(texture), group, bytes });
            }
        }
        // Those in sight a moment ago may come back at once; those that the cache has let go will not.
        self.held.retain(|number, u| wanted.contains(number) || u.source.strong_count() > 0);
    }

    /// The texture of a material.
    pub fn get(&self, number: Option<u32>) -> &wgpu::BindGroup {
        number.and_then(|n| self.held.get(&n)).map_or(&self.none, |u| &u.group)
    }

    /// How a material continues its texture.
    pub fn sampler(&self, wrap: [Wrap; 2]) -> &wgpu::BindGroup {
        let [across, down] = wrap.map(|w| WRAPS.iter().position(|k| *k == w).unwrap_or(0));
        &self.samplers[across][down]
    }

    /// Bytes on the card.
    pub fn bytes(&self) -> u64 {
        self.held.values().map(|u| u.bytes).sum()
    }

    pub fn clear(&mut self) {
        self.held.clear();
    }

    /// The levels from the finest on that is here and that the card can take; None where there are none.
    fn upload(&self, card: &Card, texture: &Texture) -> Option<wgpu::BindGroup> {
        let most = card.device.limits().max_texture_dimension_2d;
        let fits = |width: u32, height: u32| width.max(height) <= most;
        let first = texture.levels.iter().position(|l| l.as_ref().is_some_and(|l| fits(l.width, l.height)))?;
        let levels: Vec<_> = texture.levels[first..].iter().map_while(Option::as_ref).collect();
        let finest = levels.first()?;
        let on_card = room(card, finest.width, finest.height, levels.len() as u32);
        for (number, level) in (0u32..).zip(&levels) {
            write(card, &on_card, number, [level.width, level.height], level.rgba.as_flattened());
        }
        let (width, height) = texture.size()?;
        let info = ImageInfo { size: [width as f32, height as f32], first_level: first as f32, unused: 0.0 };
        Some(group(card, &self.layout, &on_card, info))
    }
}

fn white(card: &Card) -> wgpu::Texture {
    let texture = room(card, 1, 1, 1);
    write(card, &texture, 0, [1, 1], &[255; 4]);
    texture
}

fn room(card: &Card, width: u32, height: u32, levels: u32) -> wgpu::Texture {
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

fn write(card: &Card, texture: &wgpu::Texture, level: u32, [width, height]: [u32; 2], rgba: &[u8]) {
    let to = wgpu::TexelCopyTextureInfo { mip_level: level, ..texture.as_image_copy() };
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * width), rows_per_image: None };
    card.queue.write_texture(to, rgba, layout, wgpu::Extent3d { width, height, depth_or_array_layers: 1 });
}

fn group(card: &Card, layout: &wgpu::BindGroupLayout, texture: &wgpu::Texture, info: ImageInfo) -> wgpu::BindGroup {
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
