//! Textures as chunks by mip range, coarse first.

use super::{Chunk, PackError};
use crate::scene::{Scene, SceneTexture};
use ldi_protocol::codec::texture::{self, TextureLevels};
use ldi_protocol::codec::{CodecError, ColourMode};
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
    let one = |(number, t): (usize, &SceneTexture)| {
        let masked = scene.materials.iter().any(|m| m.texture == Some(number as u32) && m.alpha != Alpha::Opaque);
        pack(t, masked, mode).map_err(|source| PackError { what: format!("texture {number} ({})", t.name), source })
    };
    let encoded: Vec<Result<Vec<Part>, PackError>> = scene.textures.par_iter().enumerate().map(one).collect();
    let mut packed = PackedTextures { chunks: Vec::new(), textures: Vec::new() };
    for (parts, t) in encoded.into_iter().zip(&scene.textures) {
        let mut chunks = Vec::new();
        for Part { levels: (first_level, last_level), bytes, decoded_bytes } in parts? {
            chunks.push(TextureChunk { chunk: first_chunk + packed.chunks.len() as u32, first_level, last_level });
            packed.chunks.push(Chunk { kind: ChunkKind::Texture, bytes, decoded_bytes });
        }
        packed.textures.push(TextureEntry { width: t.width, height: t.height, chunks });
    }
    Ok(packed)
}

/// A texture's chunk.
struct Part {
    /// Finest and coarsest level in it.
    levels: (u8, u8),
    bytes: Vec<u8>,
    decoded_bytes: usize,
}

/// The chunks of a texture, coarse first.
fn pack(t: &SceneTexture, masked: bool, mode: ColourMode) -> Result<Vec<Part>, CodecError> {
    let base = MipLevel { width: t.width, height: t.height, rgba: t.rgba.clone() };
    let pyramid: Vec<MipLevel> = Texture::from_base(base, masked).levels.into_iter().flatten().collect();
    let of = |first: u8, last: u8| TextureLevels {
        width: t.width,
        height: t.height,
        first_level: first,
        levels: pyramid[first.into()..=last.into()].to_vec(),
    };
    let mut parts = Vec::new();
    for range in texture::chunk_ranges(t.width, t.height) {
        let (first, last) = (*range.start(), *range.end());
        let levels = of(first, last);
        let bytes = texture::encode(&levels, mode, LEVEL)?;
        parts.push(Part { levels: (first, last), bytes, decoded_bytes: texture::decoded_bytes(&levels) });
    }
    let sizes: Vec<usize> = parts.iter().map(|p| p.bytes.len()).collect();
    if let Some(from) = first_by_file(&sizes, t.file.len(), masked) {
        let levels = of(0, parts[from].levels.1);
        let bytes = texture::encode_picture(t.width, t.height, levels.levels.len() as u8, masked, &t.file)?;
        if texture::decode(&bytes).is_ok_and(|decoded| decoded == levels) {
            parts.truncate(from);
            let decoded_bytes = texture::decoded_bytes(&levels);
            parts.push(Part { levels: (0, levels.levels.len() as u8 - 1), bytes, decoded_bytes });
        }
    }
    Ok(parts)
}

/// Which of a texture's chunks, of these sizes, is the first that its file of `file` bytes
/// replaces, with all finer ones; so that no view needs more bytes than with the chunks. Alpha
/// tests read the finest level: who needs one finer than the coarse chunk of a masked texture
/// needs all.
fn first_by_file(sizes: &[usize], file: usize, masked: bool) -> Option<usize> {
    if file == 0 {
        return None;
    }
    match sizes {
        [_, finer @ ..] if masked && !finer.is_empty() => (file < finer.iter().sum()).then_some(1),
        _ => sizes.iter().position(|size| file < *size),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
        for (t, entry) in scene.textures.iter().zip(&packed.textures) {
            let base = MipLevel { width: t.width, height: t.height, rgba: t.rgba.clone() };
            let mut levels = Texture::from_base(base, false).levels.into_iter().flatten().rev();
            let mut by_file = 0;
            for c in &entry.chunks {
                let bytes = &packed.chunks[c.chunk as usize - 7].bytes;
                let decoded = texture::decode(bytes).unwrap();
                assert_eq!(decoded.levels.len(), usize::from(c.last_level - c.first_level) + 1);
                for level in decoded.levels.iter().rev() {
                    assert_eq!(level, &levels.next().unwrap(), "{}", t.name);
                }
                by_file += usize::from(!t.file.is_empty() && bytes.ends_with(&t.file));
            }
            assert!(levels.next().is_none());
            assert_eq!(by_file, usize::from(t.name == "kept"), "{}", t.name);
        }
        assert_eq!(packed.textures.iter().map(|t| t.chunks.len()).collect::<Vec<_>>(), [2, 3, 3, 3]);
    }

    #[test]
    fn files_never_cost_a_view_bytes() {
        let sizes = [10, 100, 350, 1_000];
        for (file, masked, from) in [
            (0, false, None),
            (5, false, Some(0)),
            (60, false, Some(1)),
            (100, false, Some(2)),
            (999, false, Some(3)),
            (1_000, false, None),
            (5, true, Some(1)),
            (1_449, true, Some(1)),
            (1_450, true, None),
        ] {
            assert_eq!(first_by_file(&sizes, file, masked), from, "{file} {masked}");
        }
        assert_eq!(first_by_file(&[10], 5, true), Some(0));
        assert_eq!(first_by_file(&[], 5, true), None);
    }
}
