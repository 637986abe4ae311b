//! Alpha tests by blocks: most of a cut-out texture is fully opaque or fully transparent.
//!
//! In: a texture. Out: for each block of 4 x 4 texels of its finest level the smallest and largest
//! alpha of bilinear samples inside. A test reads one entry, and the texels only where the block
//! does not decide.

use super::lane_math::{Tap, fold, tap};
use crate::simd::Lanes;
use glam::Vec2;
use ldi_protocol::{
    mesh::Wrap,
    texture::{MipLevel, Texture},
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
    /// Least and greatest alpha, 0 to 255, then nothing; row-major.
    range: Vec<[u8; 4]>,
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

    /// At which of eight points the texture's alpha times a factor reaches a cutoff: the bits of
    /// `wanted` that stay set. Equals [`ldi_protocol::texture::sample_alpha`], but faster.
    #[inline(always)]
    pub fn passes8<L: Lanes>(
        &self,
        texture: &Texture,
        uv: [L::F; 2],
        wrap: [Wrap; 2],
        [factor, cutoff]: [f32; 2],
        wanted: u32,
    ) -> u32 {
        let level = texture.level_or_coarser(0).filter(|level| !level.rgba.is_empty());
        let (Some(level), false) = (level, self.range.is_empty()) else {
            return if factor >= cutoff { wanted } else { 0 };
        };
        let column = block::<L>(uv[0], wrap[0], self.per_unit.x, self.columns);
        let row = block::<L>(uv[1], wrap[1], self.per_unit.y, self.rows);
        let at = L::add_int(L::mul_int(row, L::splat_int(self.columns as u32)), column);
        let range = L::gather_texels(&self.range, at);
        let byte = L::splat_int(255);
        let (least, greatest) = (L::and(range, byte), L::and(L::shift_right::<8>(range), byte));
        let (least, greatest) = (scaled::<L>(least, factor), scaled::<L>(greatest, factor));
        let passes = L::mask_bits(L::gt(least, L::splat(cutoff + MARGIN)));
        let fails = L::mask_bits(L::gt(L::splat(cutoff - MARGIN), greatest));
        let open = wanted & !passes & !fails;
        if open == 0 {
            return wanted & passes;
        }
        let alpha = L::mul(alpha8::<L>(level, uv, wrap), L::splat(factor));
        let sampled = L::mask_bits(L::ge(alpha, L::splat(cutoff)));
        (wanted & passes) | (open & sampled)
    }
}

/// Numbers of the blocks along an axis. Coordinates that are not finite read block 0.
#[inline(always)]
fn block<L: Lanes>(u: L::F, wrap: Wrap, per_unit: f32, count: usize) -> L::I {
    let at = L::mul(fold::<L>(u, wrap), L::splat(per_unit));
    L::to_int(L::min(L::max(at, L::splat(0.0)), L::splat(count as f32 - 1.0)))
}

/// Alpha of 0 to 255 as a share of 1, times a factor.
#[inline(always)]
fn scaled<L: Lanes>(alpha: L::I, factor: f32) -> L::F {
    L::mul(L::mul(L::from_int(alpha), L::splat(1.0 / 255.0)), L::splat(factor))
}

/// Bilinear alpha of a level that is not empty.
#[inline(always)]
fn alpha8<L: Lanes>(level: &MipLevel, [u, v]: [L::F; 2], wrap: [Wrap; 2]) -> L::F {
    let (x, y) = (tap::<L>(u, level.width, wrap[0]), tap::<L>(v, level.height, wrap[1]));
    let width = L::splat_int(level.width);
    let top = along_row::<L>(level, L::mul_int(y.first, width), &x);
    let bottom = along_row::<L>(level, L::mul_int(y.second, width), &x);
    L::mul(mix::<L>(top, bottom, y.second_weight), L::splat(1.0 / 255.0))
}

#[inline(always)]
fn along_row<L: Lanes>(level: &MipLevel, row: L::I, x: &Tap<L>) -> L::F {
    let first = L::shift_right::<24>(L::gather_texels(&level.rgba, L::add_int(row, x.first)));
    let second = L::shift_right::<24>(L::gather_texels(&level.rgba, L::add_int(row, x.second)));
    mix::<L>(L::from_int(first), L::from_int(second), x.second_weight)
}

#[inline(always)]
fn mix<L: Lanes>(first: L::F, second: L::F, second_weight: L::F) -> L::F {
    L::add(L::mul(first, L::sub(L::splat(1.0), second_weight)), L::mul(second, second_weight))
}

/// Extremes of a block and the ring around it, which bilinear samples near its border read. At the
/// texture's border the ring contains the border itself (clamped, mirrored) and the opposite one
/// (tiled).
fn block_range(level: &MipLevel, column: usize, row: usize) -> [u8; 4] {
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
    [least, greatest, 0, 0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::{LANES, Portable};
    use ldi_protocol::texture::sample_alpha;

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
            for first in (0..20_000u32).step_by(LANES) {
                let uv: [Vec2; LANES] = std::array::from_fn(|i| {
                    let h = (first + i as u32).wrapping_mul(2_654_435_761);
                    Vec2::new((h & 0xFFFF) as f32 / 16_384.0 - 2.0, (h >> 16) as f32 / 16_384.0 - 2.0)
                });
                for (factor, cutoff) in [(1.0, 0.5), (0.8, 0.1)] {
                    let lanes = [uv.map(|uv| uv.x), uv.map(|uv| uv.y)];
                    let passed = blocks.passes8::<Portable>(&texture, lanes, [wrap; 2], [factor, cutoff], 255);
                    for (i, uv) in uv.into_iter().enumerate() {
                        let exact = sample_alpha(&texture, uv, [wrap; 2]) * factor >= cutoff;
                        assert_eq!(passed >> i & 1 == 1, exact, "{uv} {wrap:?} {factor} {cutoff}");
                        inside += u32::from(exact);
                    }
                }
            }
        }
        assert!(inside > 10_000 && inside < 110_000, "{inside}");
        for [least, greatest, ..] in &blocks.range {
            decided += u32::from(*least > 127 || *greatest < 128);
        }
        assert!(decided > 3, "some block must decide");
        let (none, zero) = (Texture::default(), [[0.0; LANES]; 2]);
        let of_none = |[alpha, cutoff]: [f32; 2]| {
            AlphaBlocks::new(&none).passes8::<Portable>(&none, zero, [Wrap::Clamp; 2], [alpha, cutoff], 0b101)
        };
        assert_eq!((of_none([1.0, 0.5]), of_none([0.4, 0.5])), (0b101, 0));
    }
}
