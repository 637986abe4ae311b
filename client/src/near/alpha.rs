//! Alpha tests by blocks: most of a cut-out texture is fully opaque or fully transparent.
//!
//! In: a texture. Out: for each block of 4 x 4 texels of its finest level the smallest and largest
//! alpha of bilinear samples inside. A test reads two bytes, and the texels only where the block
//! does not decide.

use glam::Vec2;
use ldi_protocol::{
    mesh::Wrap,
    texture::{MipLevel, Texture, sample_alpha},
};

/// Texels along a side of a block. Larger: decides less often; smaller: reads more memory.
const BLOCK: usize = 4;
/// Bilinear weights are rounded: blocks decide only this far from the cutoff, in alpha.
const MARGIN: f32 = 1e-4;

/// The blocks of a texture.
#[derive(Debug, Default)]
pub(super) struct AlphaBlocks {
    columns: usize,
    rows: usize,
    /// Blocks per unit of texture coordinate.
    per_unit: Vec2,
    /// Least and greatest alpha, 0 to 255, row-major.
    range: Vec<[u8; 2]>,
}

impl AlphaBlocks {
    /// Blocks of the finest resident level; none for a texture without levels.
    pub fn new(texture: &Texture) -> Self {
        let Some(level) = texture.level_or_coarser(0) else { return Self::default() };
        let (columns, rows) = ((level.width as usize).div_ceil(BLOCK), (level.height as usize).div_ceil(BLOCK));
        let range =
            (0..rows).flat_map(|r| (0..columns).map(move |c| (c, r))).map(|(c, r)| block_range(level, c, r)).collect();
        let per_unit = Vec2::new(level.width as f32, level.height as f32) / BLOCK as f32;
        Self { columns, rows, per_unit, range }
    }

    /// Whether the texture's alpha at `uv` times `factor` reaches `cutoff`: equals
    /// [`sample_alpha`], but faster.
    #[inline]
    pub fn passes(&self, texture: &Texture, uv: Vec2, wrap: [Wrap; 2], factor: f32, cutoff: f32) -> bool {
        // Saturating casts: coordinates that are not finite read block 0.
        let column = ((fold(uv.x, wrap[0]) * self.per_unit.x) as usize).min(self.columns.wrapping_sub(1));
        let row = ((fold(uv.y, wrap[1]) * self.per_unit.y) as usize).min(self.rows.wrapping_sub(1));
        if let Some(range) = self.range.get(row.wrapping_mul(self.columns).wrapping_add(column)) {
            let [least, greatest] = range.map(|a| f32::from(a) * (1.0 / 255.0));
            if least * factor > cutoff + MARGIN {
                return true;
            }
            if greatest * factor < cutoff - MARGIN {
                return false;
            }
        }
        sample_alpha(texture, uv, wrap) * factor >= cutoff
    }
}

/// A texture coordinate brought into [0, 1], as the sampler does it.
#[inline]
fn fold(u: f32, wrap: Wrap) -> f32 {
    // `floor` is a library call on baseline x86-64.
    let floor = |x: f32| {
        let whole = x as i32 as f32;
        if whole > x { whole - 1.0 } else { whole }
    };
    match wrap {
        Wrap::Repeat => u - floor(u),
        Wrap::Mirror => {
            let t = u - 2.0 * floor(u * 0.5);
            if t > 1.0 { 2.0 - t } else { t }
        }
        Wrap::Clamp => u.clamp(0.0, 1.0),
    }
}

/// Extremes of a block and the ring around it, which bilinear samples near its border read. At the
/// texture's border the ring contains the border itself (clamped, mirrored) and the opposite one
/// (tiled).
fn block_range(level: &MipLevel, column: usize, row: usize) -> [u8; 2] {
    let ring = |block: usize, size: u32| {
        let size = size as usize;
        let (first, last) = (block * BLOCK, ((block + 1) * BLOCK).min(size));
        let before = if first == 0 { size - 1 } else { first - 1 };
        let after = if last == size { 0 } else { last };
        (first..last).chain([before, after])
    };
    let (mut least, mut greatest) = (u8::MAX, 0);
    for y in ring(row, level.height) {
        for x in ring(column, level.width) {
            let alpha = level.rgba[y * level.width as usize + x][3];
            (least, greatest) = (least.min(alpha), greatest.max(alpha));
        }
    }
    [least, greatest]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blobs of alpha on an odd-sized texture: every test agrees with the sampler.
    #[test]
    fn blocks_decide_as_the_sampler_does() {
        let (width, height) = (45u32, 37u32);
        let rgba = (0..width * height)
            .map(|i| {
                let (x, y) = ((i % width) as f32, (i / width) as f32);
                [0, 0, 0, ((x * 0.11).sin() * (y * 0.13).cos() * 300.0 + 128.0).clamp(0.0, 255.0) as u8]
            })
            .collect();
        let texture = Texture { levels: vec![Some(MipLevel { width, height, rgba })] };
        let blocks = AlphaBlocks::new(&texture);
        let (mut inside, mut decided) = (0, 0);
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            for i in 0..20_000u32 {
                let h = i.wrapping_mul(2_654_435_761);
                let uv = Vec2::new((h & 0xFFFF) as f32 / 16_384.0 - 2.0, (h >> 16) as f32 / 16_384.0 - 2.0);
                for (factor, cutoff) in [(1.0, 0.5), (0.8, 0.1)] {
                    let exact = sample_alpha(&texture, uv, [wrap; 2]) * factor >= cutoff;
                    assert_eq!(
                        blocks.passes(&texture, uv, [wrap; 2], factor, cutoff),
                        exact,
                        "{uv} {wrap:?} {factor} {cutoff}"
                    );
                    inside += u32::from(exact);
                }
            }
        }
        assert!(inside > 10_000 && inside < 110_000, "{inside}");
        for [least, greatest] in &blocks.range {
            decided += u32::from(*least > 127 || *greatest < 128);
        }
        assert!(decided > 3, "some block must decide");
        assert!(AlphaBlocks::new(&Texture::default()).passes(
            &Texture::default(),
            Vec2::ZERO,
            [Wrap::Clamp; 2],
            1.0,
            0.5
        ));
    }
}
