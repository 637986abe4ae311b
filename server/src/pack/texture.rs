//! Textures as chunks by mip range, coarse first.

use super::{Chunk, PackError};
use crate::scene::Scene;
use ldi_protocol::codec::ColourMode;
use ldi_protocol::codec::texture::{self, TextureLevels};
use ldi_protocol::index::{ChunkKind, TextureChunk, TextureEntry};
use ldi_protocol::mesh::Alpha;
use ldi_protocol::texture::{MipLevel, Texture};
use rayon::prelude::*;

/// zstd level of texture chunks: they are compressed once and sent often.
const LEVEL: i32 = 12;

/// Textures as chunks.
#[derive(Debug, Clone)]
pub struct PackedTextures {
    /// In the order of the entries; numbers count from `first_chunk`.
    pub chunks: Vec<Chunk>,
    /// One per texture of the scene.
    pub textures: Vec<TextureEntry>,
}

/// Encodes all textures; the first chunk gets number `first_chunk`.
///
/// # Errors
/// If a texture does not fit the format.
pub fn pack_textures(scene: &Scene, mode: ColourMode, first_chunk: u32) -> Result<PackedTextures, PackError> {
    let encoded: Vec<Result<Vec<(u8, u8, Chunk)>, PackError>> = scene
        .textures
        .par_iter()
        .enumerate()
        .map(|(number, t)| {
            let masked = scene.materials.iter().any(|m| m.texture == Some(number as u32) && m.alpha != Alpha::Opaque);
            let base = MipLevel { width: t.width, height: t.height, rgba: t.rgba.clone() };
            let levels = Texture::from_base(base, masked).levels;
            texture::chunk_ranges(t.width, t.height)
                .into_iter()
                .map(|range| {
                    let (first, last) = (*range.start(), *range.end());
                    let part = TextureLevels {
                        width: t.width,
                        height: t.height,
                        first_level: first,
                        levels: levels[first as usize..=last as usize].iter().flatten().cloned().collect(),
                    };
                    let bytes = texture::encode(&part, mode, LEVEL)
                        .map_err(|source| PackError { what: format!("texture {number} ({})", t.name), source })?;
                    Ok((
                        first,
                        last,
                        Chunk { kind: ChunkKind::Texture, bytes, decoded_bytes: texture::decoded_bytes(&part) },
                    ))
                })
                .collect()
        })
        .collect();
    let mut packed = PackedTextures { chunks: Vec::new(), textures: Vec::new() };
    for (parts, t) in encoded.into_iter().zip(&scene.textures) {
        let mut chunks = Vec::new();
        for (first_level, last_level, chunk) in parts? {
            chunks.push(TextureChunk { chunk: first_chunk + packed.chunks.len() as u32, first_level, last_level });
            packed.chunks.push(chunk);
        }
        packed.textures.push(TextureEntry { width: t.width, height: t.height, chunks });
    }
    Ok(packed)
}
