//! Textures, decoded: mip levels of 8-bit sRGB texels, filtered in linear light; sampled by one function.

use crate::mesh::Wrap;

/// One mip level: row-major, row 0 on top (glTF: v = 0), RGBA with sRGB colour and linear alpha.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MipLevel {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` texels.
    pub rgba: Vec<[u8; 4]>,
}

/// A texture; level 0 is the finest. While finer levels are still on their way the front entries are None.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Texture {
    /// All levels down to 1 x 1.
    pub levels: Vec<Option<MipLevel>>,
}

/// Position of a texel after wrapping.
#[inline]
pub fn wrap_texel(i: i64, n: i64, wrap: Wrap) -> usize {
    (match wrap {
        Wrap::Repeat => i.rem_euclid(n),
        Wrap::Mirror => {
            let k = i.rem_euclid(2 * n);
            if k < n { k } else { 2 * n - 1 - k }
        }
        Wrap::Clamp => i.clamp(0, n - 1),
    }) as usize
}
