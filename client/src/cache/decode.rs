//! Decodes chunks and joins them to objects. Pure; runs on the decoding threads.

use super::{DecodeError, Value};
use ldi_protocol::{
    codec::{self, texture::TextureLevels},
    index::{Index, TextureEntry},
    ldi::Ldi,
    manifest,
    texture::Texture,
};
use std::{ops::Range, sync::Arc};

/// Decodes a cell.
pub(super) fn cell(index: &Index, cell: u32, bytes: &[u8]) -> Result<Value, DecodeError> {
    let geometry = codec::cell::decode(bytes)?;
    manifest::check_cell(index, cell, &geometry)?;
    manifest::check_decoded_bytes(index, index.cells[cell as usize].chunk, codec::cell::decoded_bytes(&geometry))?;
    Ok(Value::Geometry(Arc::new(geometry)))
}

/// Decodes a bundle.
pub(super) fn bundle(index: &Index, chunk: u32, bytes: &[u8]) -> Result<Value, DecodeError> {
    let geometry = codec::cell::decode(bytes)?;
    manifest::check_bundle(index, &geometry)?;
    manifest::check_decoded_bytes(index, chunk, codec::cell::decoded_bytes(&geometry))?;
    Ok(Value::Geometry(Arc::new(geometry)))
}

/// Decodes levels of detail.
pub(super) fn levels(index: &Index, chunk: u32, bytes: &[u8]) -> Result<Value, DecodeError> {
    let geometry = codec::cell::decode(bytes)?;
    manifest::check_levels(index, &geometry)?;
    manifest::check_decoded_bytes(index, chunk, codec::cell::decoded_bytes(&geometry))?;
    Ok(Value::Geometry(Arc::new(geometry)))
}

/// Decodes nodes of the LDI tree.
pub(super) fn brood(index: &Index, chunk: u32, nodes: Range<u32>, bytes: &[u8]) -> Result<Value, DecodeError> {
    let tree = index.tree.as_ref().ok_or(DecodeError::Unreferenced)?;
    let brood = tree.decode(nodes, bytes)?;
    manifest::check_decoded_bytes(index, chunk, brood.decoded_bytes())?;
    Ok(Value::Brood(Arc::new(brood)))
}

/// Adds a chunk to an LDI. Deeper layers that arrive before the first one are kept as bytes.
pub(super) fn ldi(index: &Index, image_number: u32, old: &Value, part: u8, bytes: &[u8]) -> Result<Value, DecodeError> {
    let counted = |image: &Ldi, part: usize| {
        let chunk = index.images[image_number as usize].chunks.get(part).ok_or(DecodeError::Unreferenced)?;
        Ok::<_, DecodeError>(manifest::check_decoded_bytes(index, *chunk, codec::ldi::decoded_bytes(image)[part])?)
    };
    let deepened = |image: &Ldi, bytes: &[u8]| {
        let mut image = image.clone();
        codec::ldi::decode_deeper(bytes, &mut image)?;
        manifest::check_ldi(index, image_number, &image)?;
        counted(&image, 1)?;
        Ok::<_, DecodeError>(image)
    };
    if part == 0 {
        let mut image = codec::ldi::decode_first(bytes)?;
        manifest::check_ldi(index, image_number, &image)?;
        counted(&image, 0)?;
        if let Value::WaitingLayers(waiting) = old {
            // The first layer is usable without them.
            if let Ok(deep) = deepened(&image, waiting) {
                image = deep;
            }
        }
        return Ok(Value::Ldi(Arc::new(image)));
    }
    match old {
        Value::Ldi(image) => Ok(Value::Ldi(Arc::new(deepened(image, bytes)?))),
        _ => Ok(Value::WaitingLayers(bytes.to_vec())),
    }
}

/// Decodes the levels in a texture's chunk.
pub(super) fn texture_levels(
    index: &Index,
    texture: u32,
    part: u8,
    bytes: &[u8],
) -> Result<TextureLevels, DecodeError> {
    let entry = &index.textures[texture as usize];
    let levels = codec::texture::decode(bytes)?;
    let wanted = entry.chunks.get(usize::from(part)).ok_or(DecodeError::Unreferenced)?;
    manifest::check_texture(entry, wanted, &levels)?;
    manifest::check_decoded_bytes(index, wanted.chunk, codec::texture::decoded_bytes(&levels))?;
    Ok(levels)
}

/// Adds levels to a texture.
pub(super) fn texture(old: &Value, entry: &TextureEntry, levels: &TextureLevels) -> Value {
    let count = ldi_protocol::texture::level_count(entry.width, entry.height) as usize;
    let mut joined = match old {
        Value::Texture(t) => (**t).clone(),
        _ => Texture { levels: vec![None; count] },
    };
    for (level, mip) in levels.levels.iter().enumerate() {
        if let Some(slot) = joined.levels.get_mut(usize::from(levels.first_level) + level) {
            *slot = Some(mip.clone());
        }
    }
    Value::Texture(Arc::new(joined))
}
