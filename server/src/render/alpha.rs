//! Alpha masks inside the traversal: a compact copy of all that the test of one hit needs.
//!
//! A ray through foliage meets some ten cut-out triangles before it hits one. Looking up instance, primitive, vertices
//! and material through the scene costs a cache miss each; here one entry per masked triangle holds its texture coordinates and
//! its material, next to those of its neighbours in the hierarchy.

use super::{bvh::Bvh, geometry::Geometry, shading::Textures};
use glam::Vec2;
use ldi_protocol::{
    mesh::{Alpha, Wrap},
    texture::sample_alpha,
};

/// Cut-out tests by slot of the hierarchy.
pub(super) struct AlphaMasks {
    /// Per block: its first entry.
    first_of_block: Vec<u32>,
    entries: Vec<Entry>,
    /// Per material of the scene.
    materials: Vec<MaskedMaterial>,
}

struct Entry {
    uvs: [Vec2; 3],
    material: u32,
}

struct MaskedMaterial {
    texture: Option<u32>,
    wrap: [Wrap; 2],
    /// Factor of the texture's alpha.
    alpha: f32,
    cutoff: f32,
}

impl AlphaMasks {
    /// Entries for all lanes that `bvh` marks as masked.
    pub fn new(geometry: &Geometry, bvh: &Bvh) -> Self {
        let mut entries = Vec::new();
        let mut first_of_block = Vec::with_capacity(bvh.blocks.len());
        for (block, masked) in bvh.blocks.iter().zip(&bvh.masked) {
            first_of_block.push(entries.len() as u32);
            for (lane, &triangle) in block.triangles.iter().enumerate() {
                if masked >> lane & 1 == 1 {
                    let source = geometry.source(triangle);
                    let primitive = geometry.primitive(&source);
                    let uv = |v: u32| primitive.uvs.get(v as usize).copied().unwrap_or(Vec2::ZERO);
                    let uvs = primitive.triangles[source.triangle as usize].map(uv);
                    entries.push(Entry { uvs, material: primitive.material });
                }
            }
        }
        let materials = geometry.scene.materials.iter().map(|m| MaskedMaterial {
            texture: m.texture,
            wrap: m.wrap,
            alpha: m.base_colour[3],
            cutoff: if let Alpha::Mask(cutoff) = m.alpha { cutoff } else { 0.0 },
        });
        Self { first_of_block, entries, materials: materials.collect() }
    }

    /// Whether the hit at these barycentric weights of a masked slot is cut out.
    #[inline]
    pub fn is_cut_out(&self, textures: &Textures, masked: u8, slot: u32, u: f32, v: f32) -> bool {
        let below = masked & ((1u8 << (slot % 4)) - 1);
        let entry = &self.entries[(self.first_of_block[slot as usize / 4] + below.count_ones()) as usize];
        let material = &self.materials[entry.material as usize];
        let alpha = material.texture.map_or(1.0, |t| {
            let [a, b, c] = entry.uvs;
            sample_alpha(textures.get(t), a * (1.0 - u - v) + b * u + c * v, material.wrap)
        });
        alpha * material.alpha < material.cutoff
    }
}
