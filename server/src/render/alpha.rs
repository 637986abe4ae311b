//! Alpha masks inside the traversal: a compact copy of all that the test of one hit needs.
//!
//! A ray through foliage meets some ten cut-out triangles before it hits one. Looking up instance, primitive, vertices
//! and material through the scene costs a cache miss each; here one entry per masked triangle holds its texture coordinates and
//! its material, next to those of its neighbours in the hierarchy.

use super::{
    bvh::{Block, Bvh},
    geometry::Geometry,
    shading::Textures,
};
use glam::Vec2;
use ldi_protocol::{mesh::Alpha, texture::AlphaTest};
use rayon::prelude::*;

/// Cut-out tests by slot of the hierarchy.
pub(super) struct AlphaMasks {
    /// Of the masked lanes of all blocks.
    entries: Vec<Entry>,
    /// Per material of the scene.
    materials: Vec<MaskedMaterial>,
}

/// Never on two cache lines.
#[repr(align(32))]
struct Entry {
    uvs: [Vec2; 3],
    material: u32,
}

struct MaskedMaterial {
    /// The texture and the test; without a texture what is masked is cut out everywhere.
    test: Option<(u32, AlphaTest)>,
}

impl AlphaMasks {
    /// Entries for all lanes that `bvh` marks as masked.
    pub fn new(geometry: &Geometry, textures: &Textures, bvh: &Bvh) -> Self {
        let mut entries = Vec::new();
        for block in &bvh.blocks {
            for (lane, &triangle) in block.triangles.iter().enumerate() {
                if block.masked >> lane & 1 == 1 {
                    let source = geometry.source(triangle);
                    let primitive = geometry.primitive(&source);
                    let uv = |v: u32| primitive.uvs.get(v as usize).copied().unwrap_or(Vec2::ZERO);
                    let uvs = primitive.triangles[source.triangle as usize].map(uv);
                    entries.push(Entry { uvs, material: primitive.material });
                }
            }
        }
        let materials = geometry.scene.materials.par_iter().map(|m| {
            let Alpha::Mask(cutoff) = m.alpha else { return MaskedMaterial { test: None } };
            let test = |t: u32| (t, AlphaTest::new(textures.get(t), m.wrap, m.base_colour[3], cutoff));
            MaskedMaterial { test: m.texture.map(test) }
        });
        Self { entries, materials: materials.collect() }
    }

    /// Whether the hit at these barycentric weights of a masked lane is cut out.
    #[inline]
    pub fn is_cut_out(&self, textures: &Textures, block: &Block, lane: u32, u: f32, v: f32) -> bool {
        let below = block.masked & ((1u8 << lane) - 1);
        let entry = &self.entries[(block.first_mask + below.count_ones()) as usize];
        let material = &self.materials[entry.material as usize];
        let Some((texture, test)) = &material.test else { return true };
        let [a, b, c] = entry.uvs;
        !test.passes(textures.get(*texture), a * (1.0 - u - v) + b * u + c * v)
    }
}
