//! Stored bytes to decoded objects, and parts joined to wholes. Pure; runs on the decoding threads.

use super::{DecodeError, Value};
use ldi_protocol::{
    codec::{self, texture::TextureLevels},
    index::{Index, TextureEntry},
    manifest,
    texture::Texture,
};
use std::sync::Arc;

/// A cell.
pub(super) fn cell(index: &Index, cell: u32, bytes: &[u8]) -> Result<Value, DecodeError> {
    let geometry = codec::cell::decode(bytes)?;
    manifest::check_cell(index, cell, &geometry)?;
    Ok(Value::Geometry(Arc::new(geometry)))
}

/// A bundle.
pub(super) fn bundle(index: &Index, bytes: &[u8]) -> Result<Value, DecodeError> {
    let geometry = codec::cell::decode(bytes)?;
    manifest::check_bundle(index, &geometry)?;
    Ok(Value::Geometry(Arc::new(geometry)))
}

/// Joins a chunk to an LDI. Deeper layers that come before the first wait as bytes.
pub(super) fn ldi(index: &Index, image_number: u32, old: &Value, part: u8, bytes: &[u8]) -> Result<Value, DecodeError> {
    if part == 0 {
        let mut image = codec::ldi::decode_first(bytes)?;
        manifest::check_ldi(index, image_number, &image)?;
        if let Value::WaitingLayers(waiting) = old {
            for (_, deeper) in waiting {
                // Their hash was right, so the build wrote them so; the first layer is good without them.
                if codec::ldi::decode_deeper(deeper, &mut image).is_err() {
                    break;
                }
            }
        }
        return Ok(Value::Ldi(Arc::new(image)));
    }
    if let Value::Ldi(image) = old {
        let mut image = (**image).clone();
        codec::ldi::decode_deeper(bytes, &mut image)?;
        manifest::check_ldi(index, image_number, &image)?;
        return Ok(Value::Ldi(Arc::new(image)));
    }
    let mut waiting = if let Value::WaitingLayers(w) = old { w.clone() } else { Vec::new() };
    waiting.push((part, bytes.to_vec()));
    waiting.sort_by_key(|w| w.0);
    Ok(Value::WaitingLayers(waiting))
}

/// The levels of a texture's chunk.
pub(super) fn texture_levels(entry: &TextureEntry, part: u8, bytes: &[u8]) -> Result<TextureLevels, DecodeError> {
    let levels = codec::texture::decode(bytes)?;
    let wanted = entry.chunks.get(usize::from(part)).ok_or(DecodeError::Unreferenced)?;
    manifest::check_texture(entry, wanted, &levels)?;
    Ok(levels)
}

/// Joins levels to a texture.
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
