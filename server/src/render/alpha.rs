//! Alpha masks inside the traversal: a compact copy of all that the test of one hit needs.
//!
//! A ray through foliage meets some ten cut-out triangles before it hits one. Looking up instance,
//! primitive, vertices and material through the scene costs a cache miss each; here one entry per
//! masked triangle holds its texture coordinates and its material, next to those of its neighbours
//! in the hierarchy.

use super::{
    bvh::{Block, Bvh},
    geometry::Geometry,
    shading::Textures,
};
use crate::scene::Primitive;
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
        let entry = |primitive: &Primitive, triangle: u32| {
            let uv = |v: u32| primitive.uvs.get(v as usize).copied().unwrap_or(Vec2::ZERO);
            Entry { uvs: primitive.triangles[triangle as usize].map(uv), material: primitive.material }
        };
        let masked = |block: &Block| {
            let lanes = (0..4).filter(|lane| block.masked >> lane & 1 == 1);
            lanes.map(|lane| block.triangles[lane]).collect::<Vec<u32>>()
        };
        for triangle in bvh.world.blocks.iter().flat_map(masked) {
            let source = geometry.source(triangle);
            entries.push(entry(geometry.primitive(&source), source.triangle));
        }
        for part in &bvh.local_parts {
            let primitive = &geometry.scene.meshes[part.mesh as usize].primitives[part.primitive as usize];
            let blocks = &bvh.local.blocks[part.blocks.start as usize..part.blocks.end as usize];
            entries.extend(blocks.iter().flat_map(masked).map(|triangle| entry(primitive, triangle)));
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
