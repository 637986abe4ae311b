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
                    let what = |source| PackError { what: format!("texture {number} ({})", t.name), source };
                    let mut bytes = texture::encode(&part, mode, LEVEL).map_err(what)?;
                    if first == 0 && last == 0 && !t.file.is_empty() && t.file.len() < bytes.len() {
                        let file = texture::encode_picture(t.width, t.height, &t.file).map_err(what)?;
                        if texture::decode(&file).is_ok_and(|levels| levels == part) {
                            bytes = file;
                        }
                    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneTexture;
    use ldi_protocol::codec::ColourProfile;

    /// What a JPEG file of a picture with detail decodes to.
    fn painted(name: &str) -> SceneTexture {
        let (width, height) = (256, 128);
        let mut pixels = image::RgbImage::new(width, height);
        for (x, y, p) in pixels.enumerate_pixels_mut() {
            let n = (x * 2_654_435_761).wrapping_add(y * 40_503) >> 9 & 31;
            *p = image::Rgb([x as u8, (y + n) as u8, 90 + n as u8]);
        }
        let mut file = std::io::Cursor::new(Vec::new());
        pixels.write_to(&mut file, image::ImageFormat::Jpeg).unwrap();
        let file = file.into_inner();
        let rgba = image::load_from_memory(&file).unwrap().into_rgba8().as_raw().as_chunks::<4>().0.to_vec();
        SceneTexture { name: name.to_owned(), width, height, rgba, file }
    }

    #[test]
    fn files_are_kept_where_they_are_smaller_and_give_the_texels() {
        let kept = painted("kept");
        let touched = SceneTexture { rgba: kept.rgba.iter().map(|p| p.map(|c| c ^ 1)).collect(), ..painted("touched") };
        let none = SceneTexture { file: Vec::new(), ..painted("none") };
        let padded = SceneTexture { file: [kept.file.clone(), vec![0; 1 << 20]].concat(), ..painted("padded") };
        let scene = Scene { textures: vec![kept, touched, none, padded], ..Scene::default() };
        let packed = pack_textures(&scene, ColourProfile::High.of_textures(), 7).unwrap();
        let finest = |n: usize| {
            let chunk = packed.textures[n].chunks.iter().find(|c| c.first_level == 0).unwrap().chunk - 7;
            &packed.chunks[chunk as usize].bytes
        };
        for (n, t) in scene.textures.iter().enumerate() {
            assert_eq!(texture::decode(finest(n)).unwrap().levels[0].rgba, t.rgba, "{}", t.name);
            assert_eq!(!t.file.is_empty() && finest(n).ends_with(&t.file), n == 0, "{}", t.name);
        }
        assert!(finest(0).len() < finest(2).len());
    }
}
