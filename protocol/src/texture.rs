//! Textures, decoded: mip levels of 8-bit sRGB texels, filtered in linear light; sampled by one
//! function.
//!
//! In: 8-bit texels (sRGB colour, linear alpha). Out: a pyramid of mip levels
//! ([`Texture::from_base`]) and samples of it in linear light ([`sample`], [`sample_bilinear`]),
//! the same for the ray caster and the software rasterizer.
//!
//! - Texel (i, j) of a level with `width` columns has its centre at u = (i + 0.5) / width, and
//!   likewise down; row 0 is v = 0.
//! - A level has half the columns and rows of the finer one, rounded down, at least 1. Its texels
//!   are means over the area they cover (box filter; fractional weights where a size is odd),
//!   carried in f32 from level to level and rounded to 8 bits only for storage.
//! - Colour is averaged with alpha as weight where the texture is alpha-masked: the colour behind
//!   cut-out texels is arbitrary and must not bleed in. Where all alphas are 0 the plain mean is
//!   taken.
//! - Between levels the filter is trilinear (Williams 1983), isotropic; `lod` counts levels, 0 is
//!   the finest ([`lod_of`]).
//! - Alpha tests read the finest level present, whatever the level of the colour: averaged alpha
//!   against a fixed cutoff would make distant foliage vanish.

use crate::{
    mesh::Wrap,
    shade::{linear_from_srgb8_table, srgb8_from_linear},
};
use glam::Vec2;

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

/// A texture; level 0 is the finest. While finer levels are still on their way the front entries
/// are None.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Texture {
    /// All levels down to 1 x 1.
    pub levels: Vec<Option<MipLevel>>,
}

/// Levels of a full pyramid over a base of this size, the base and the 1 x 1 level included.
pub fn level_count(width: u32, height: u32) -> u32 {
    width.max(height).max(1).ilog2() + 1
}

/// Columns and rows of a level of a pyramid over a base of this size.
pub fn level_size(width: u32, height: u32, level: u32) -> (u32, u32) {
    let at = |n: u32| n.checked_shr(level).unwrap_or(0).max(1);
    (at(width), at(height))
}

impl Texture {
    /// The full pyramid over `base`; `masked` weights colour by alpha. A base without texels gives
    /// a texture without levels.
    pub fn from_base(base: MipLevel, masked: bool) -> Self {
        let count = level_count(base.width, base.height);
        Self::finest(base, masked, count)
    }

    /// The finest `count` levels of [`Self::from_base`], of those that there are.
    pub(crate) fn finest(base: MipLevel, masked: bool, count: u32) -> Self {
        let (width, height) = (base.width, base.height);
        if width == 0 || height == 0 || base.rgba.len() != width as usize * height as usize {
            return Self::default();
        }
        let mut levels = vec![None];
        let mut finer: Option<Linear> = None;
        for level in 1..count.min(level_count(width, height)) {
            let (w, h) = level_size(width, height, level);
            let linear = match &finer {
                None => Linear::below(&base, masked, (w as usize, h as usize)),
                Some(finer) => finer.halved((w as usize, h as usize)),
            };
            levels.push(Some(linear.to_level(masked)));
            finer = Some(linear);
        }
        levels[0] = Some(base);
        Self { levels }
    }

    /// The level itself or the next coarser one present, else the coarsest present.
    #[inline]
    pub fn level_or_coarser(&self, level: usize) -> Option<&MipLevel> {
        match self.levels.get(level) {
            Some(Some(l)) => Some(l),
            _ => self.levels.iter().skip(level).flatten().next().or_else(|| self.levels.iter().rev().flatten().next()),
        }
    }

    /// Columns and rows of level 0; when it is not here, estimated from the finest level present
    /// (exact for powers of two).
    pub fn size(&self) -> Option<(u32, u32)> {
        self.levels.iter().enumerate().find_map(|(k, l)| {
            let l = l.as_ref()?;
            Some((l.width << k.min(16), l.height << k.min(16)))
        })
    }
}

/// Level of detail for a pixel across which the texture coordinate moves by `duv_dx` to the right
/// neighbour and `duv_dy` to the one below: log2 of the longer one in texels of level 0, at least
/// 0 (isotropic, as graphics hardware does it).
#[inline]
pub fn lod_of(size: (u32, u32), duv_dx: Vec2, duv_dy: Vec2) -> f32 {
    let size = Vec2::new(size.0 as f32, size.1 as f32);
    let longest_squared = (duv_dx * size).length_squared().max((duv_dy * size).length_squared());
    // Infinity comes from rays along the surface; NaN from degenerate triangles: level 0.
    if longest_squared.is_nan() { 0.0 } else { (0.5 * longest_squared.log2()).clamp(0.0, 32.0) }
}

/// Linear colour and alpha of a texture at `uv`, trilinear at level of detail `lod` (0 or less:
/// bilinear in level 0). Levels that are not here are replaced by the next coarser one; a texture
/// without levels is opaque white.
#[inline]
pub fn sample(texture: &Texture, uv: Vec2, lod: f32, wrap: [Wrap; 2]) -> ([f32; 3], f32) {
    let fine = lod.max(0.0) as usize;
    let blend = lod.max(0.0) - fine as f32;
    let Some(fine_level) = texture.level_or_coarser(fine) else { return ([1.0; 3], 1.0) };
    let (c0, a0) = bilinear(fine_level, uv, wrap);
    if blend <= 0.0 || fine + 1 >= texture.levels.len() {
        return (c0, a0);
    }
    let Some(coarse_level) = texture.level_or_coarser(fine + 1) else { return (c0, a0) };
    let (c1, a1) = bilinear(coarse_level, uv, wrap);
    (std::array::from_fn(|k| c0[k] + (c1[k] - c0[k]) * blend), a0 + (a1 - a0) * blend)
}

/// Linear colour and alpha of the finest level present, bilinear; opaque white without levels.
#[inline]
pub fn sample_bilinear(texture: &Texture, uv: Vec2, wrap: [Wrap; 2]) -> ([f32; 3], f32) {
    texture.level_or_coarser(0).map_or(([1.0; 3], 1.0), |l| bilinear(l, uv, wrap))
}

/// Alpha alone of the finest level present, bilinear: what alpha tests compare with the cutoff. 1
/// without levels.
#[inline]
pub fn sample_alpha(texture: &Texture, uv: Vec2, wrap: [Wrap; 2]) -> f32 {
    let Some(l) = texture.level_or_coarser(0) else { return 1.0 };
    bilinear_alpha(l, &tap(uv.x, l.width, wrap[0]), &tap(uv.y, l.height, wrap[1]))
}

#[inline]
fn bilinear_alpha(l: &MipLevel, x: &Tap, y: &Tap) -> f32 {
    let w = l.width as usize;
    let alpha = |row: usize, column: usize| f32::from(l.rgba[row * w + column][3]);
    let top = alpha(y.first, x.first) * (1.0 - x.second_weight) + alpha(y.first, x.second) * x.second_weight;
    let bottom = alpha(y.second, x.first) * (1.0 - x.second_weight) + alpha(y.second, x.second) * x.second_weight;
    (top * (1.0 - y.second_weight) + bottom * y.second_weight) * (1.0 / 255.0)
}

/// The alpha test of one material on the finest level of its texture, with the answer known in
/// advance wherever the four texels of a bilinear sample agree. Two bits per texel fit into a
/// cache where the texture does not.
#[derive(Debug, Clone)]
pub struct AlphaTest {
    wrap: [Wrap; 2],
    factor: f32,
    cutoff: f32,
    size: [u32; 2],
    /// Row-major, four to a byte; for the texel and the next ones to the right and below.
    answers: Vec<u8>,
}

impl AlphaTest {
    /// The answer depends on the weights of the texels.
    const MIXED: u8 = 0;
    /// Every sample passes.
    const PASSES: u8 = 1;
    /// No sample passes.
    const FAILS: u8 = 2;

    /// For the test `factor * alpha >= cutoff`; a texture without levels has alpha 1.
    pub fn new(texture: &Texture, wrap: [Wrap; 2], factor: f32, cutoff: f32) -> Self {
        let mut test = Self { wrap, factor, cutoff, size: [0; 2], answers: Vec::new() };
        let Some(level) = texture.level_or_coarser(0) else { return test };
        let (w, h) = (level.width as usize, level.height as usize);
        test.size = [level.width, level.height];
        test.answers = vec![0; (w * h).div_ceil(4)];
        let next = |i: usize, n: usize, wrap: Wrap| match wrap {
            Wrap::Repeat => (i + 1) % n,
            Wrap::Mirror | Wrap::Clamp => (i + 1).min(n - 1),
        };
        for row in 0..h {
            let below = next(row, h, wrap[1]);
            for column in 0..w {
                let right = next(column, w, wrap[0]);
                let of = |row: usize, column: usize| level.rgba[row * w + column][3];
                let four = [of(row, column), of(row, right), of(below, column), of(below, right)];
                let (least, greatest) = four.iter().fold((u8::MAX, 0), |(l, g), a| (l.min(*a), g.max(*a)));
                let at = row * w + column;
                test.answers[at / 4] |= test.answer(least, greatest) << (at % 4 * 2);
            }
        }
        test
    }

    /// The answer for every mixture of these alphas, however it is rounded.
    fn answer(&self, least: u8, greatest: u8) -> u8 {
        // Interpolation errs by some 3e-7 of the greatest.
        const SLACK: f32 = 1e-5;
        let of = |alpha: u8| f32::from(alpha) / 255.0 * self.factor;
        if !(self.factor >= 0.0) {
            Self::MIXED
        } else if of(least) * (1.0 - SLACK) >= self.cutoff {
            Self::PASSES
        } else if of(greatest) * (1.0 + SLACK) < self.cutoff {
            Self::FAILS
        } else {
            Self::MIXED
        }
    }

    /// Whether `factor * sample_alpha(texture, uv, wrap) >= cutoff`; `texture` is the one that the
    /// test was made for.
    #[inline]
    pub fn passes(&self, texture: &Texture, uv: Vec2) -> bool {
        let alpha = if self.answers.is_empty() {
            1.0
        } else {
            let [w, h] = self.size;
            let (x, y) = (tap(uv.x, w, self.wrap[0]), tap(uv.y, h, self.wrap[1]));
            let at = y.first * w as usize + x.first;
            match self.answers[at / 4] >> (at % 4 * 2) & 3 {
                Self::PASSES => return true,
                Self::FAILS => return false,
                _ => texture.level_or_coarser(0).map_or(1.0, |l| bilinear_alpha(l, &x, &y)),
            }
        };
        !(alpha * self.factor < self.cutoff)
    }
}

/// Bilinear sample of one level, in linear light.
#[inline]
pub fn bilinear(level: &MipLevel, uv: Vec2, wrap: [Wrap; 2]) -> ([f32; 3], f32) {
    let table = linear_from_srgb8_table();
    let (x, y) = (tap(uv.x, level.width, wrap[0]), tap(uv.y, level.height, wrap[1]));
    let w = level.width as usize;
    let texels = [
        level.rgba[y.first * w + x.first],
        level.rgba[y.first * w + x.second],
        level.rgba[y.second * w + x.first],
        level.rgba[y.second * w + x.second],
    ];
    let (x1, y1) = (x.second_weight, y.second_weight);
    let weights = [(1.0 - x1) * (1.0 - y1), x1 * (1.0 - y1), (1.0 - x1) * y1, x1 * y1];
    let mut colour = [0.0; 3];
    let mut alpha = 0.0;
    for (texel, weight) in texels.iter().zip(weights) {
        for (sum, code) in colour.iter_mut().zip(texel) {
            *sum += table[usize::from(*code)] * weight;
        }
        alpha += f32::from(texel[3]) * weight;
    }
    (colour, alpha * (1.0 / 255.0))
}

/// The two texels that a coordinate lies between along one axis.
struct Tap {
    first: usize,
    second: usize,
    /// In [0, 1]; the first has the rest.
    second_weight: f32,
}

/// Wraps the coordinate itself first, so that only one period is left: no integer division per tap.
/// Coordinates that are not finite read texel 0.
#[inline(always)]
fn tap(u: f32, n: u32, wrap: Wrap) -> Tap {
    let size = n as f32;
    let last = n as i32 - 1;
    let folded = match wrap {
        Wrap::Repeat => u - floor(u),
        Wrap::Mirror => {
            let t = u - 2.0 * floor(u * 0.5);
            if t > 1.0 { 2.0 - t } else { t }
        }
        Wrap::Clamp => u.clamp(0.0, 1.0),
    };
    // In [-0.5, n - 0.5]: the first texel is -1 ..= n - 1, the second 0 ..= n.
    let x = folded * size - 0.5;
    let below = floor(x);
    let second_weight = if x.is_finite() { x - below } else { 0.0 };
    let first = below as i32;
    let (first, second) = match wrap {
        Wrap::Repeat => (if first < 0 { last } else { first.min(last) }, if first >= last { 0 } else { first + 1 }),
        // At a mirrored border the neighbour of the border texel is itself, as with clamping.
        Wrap::Mirror | Wrap::Clamp => (first.clamp(0, last), (first + 1).clamp(0, last)),
    };
    Tap { first: first.max(0) as usize, second: second.max(0) as usize, second_weight }
}

/// Floor without the library call that baseline x86-64 makes of `f32::floor`. Exact below 2^31 in
/// magnitude; beyond that, f32 has no fraction left, the cast saturates and the caller's clamps
/// hold.
#[inline]
fn floor(x: f32) -> f32 {
    let whole = x as i32 as f32;
    if whole > x { whole - 1.0 } else { whole }
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

/// A level in f32 linear light: premultiplied colour, plain colour, alpha.
struct Linear {
    width: usize,
    height: usize,
    /// Colour times alpha (or times 1 when not masked), then alpha in [0, 1].
    weighted: Vec<[f32; 4]>,
    /// Colour for where all alphas are 0; empty when not masked.
    plain: Vec<[f32; 3]>,
}

impl Linear {
    /// The level of `size` columns and rows below the finest.
    fn below(base: &MipLevel, masked: bool, size: (usize, usize)) -> Self {
        let table = linear_from_srgb8_table();
        let alphas: [f32; 256] = std::array::from_fn(|code| code as f32 / 255.0);
        let (w, h) = (base.width as usize, base.height as usize);
        let colour = |t: [u8; 4]| [table[usize::from(t[0])], table[usize::from(t[1])], table[usize::from(t[2])]];
        let weighted = |x, y| {
            let texel: [u8; 4] = base.rgba[y * w + x];
            let alpha = alphas[usize::from(texel[3])];
            let weight = if masked { alpha } else { 1.0 };
            let c = colour(texel);
            [c[0] * weight, c[1] * weight, c[2] * weight, alpha]
        };
        let plain = |x, y| colour(base.rgba[y * w + x]);
        Self {
            width: size.0,
            height: size.1,
            weighted: box_filter((w, h), size, weighted),
            plain: if masked { box_filter((w, h), size, plain) } else { Vec::new() },
        }
    }

    fn halved(&self, size: (usize, usize)) -> Self {
        let (w, h) = (self.width, self.height);
        let masked = !self.plain.is_empty();
        Self {
            width: size.0,
            height: size.1,
            weighted: box_filter((w, h), size, |x, y| self.weighted[y * w + x]),
            plain: if masked { box_filter((w, h), size, |x, y| self.plain[y * w + x]) } else { Vec::new() },
        }
    }

    fn to_level(&self, masked: bool) -> MipLevel {
        // Below half an 8-bit step of alpha the quotient is mostly rounding noise: take the plain
        // mean.
        const ALPHA_MIN: f32 = 0.5 / 255.0;
        let rgba = self
            .weighted
            .iter()
            .enumerate()
            .map(|(i, t)| {
                let alpha = t[3];
                let colour = if !masked {
                    [t[0], t[1], t[2]]
                } else if alpha < ALPHA_MIN {
                    self.plain[i]
                } else {
                    [t[0] / alpha, t[1] / alpha, t[2] / alpha]
                };
                let code = colour.map(srgb8_from_linear);
                [code[0], code[1], code[2], (alpha * 255.0 + 0.5) as u8]
            })
            .collect();
        MipLevel { width: self.width as u32, height: self.height as u32, rgba }
    }
}

/// Means over the areas that the texels of a coarser raster of `coarse` columns and rows cover, in
/// each row first. `texel`: of the `fine` columns and rows, by column and row.
fn box_filter<const N: usize>(
    fine: (usize, usize),
    coarse: (usize, usize),
    texel: impl Fn(usize, usize) -> [f32; N],
) -> Vec<[f32; N]> {
    let columns = footprints(fine.0, coarse.0);
    let pairs = fine.0 == 2 * coarse.0;
    let mut narrow = vec![[0.0; N]; coarse.0];
    let mut out = vec![[0.0; N]; coarse.0 * coarse.1];
    for (f, sums) in footprints(fine.1, coarse.1).iter().zip(out.chunks_exact_mut(coarse.0)) {
        for (k, weight) in f.weights[..f.count].iter().enumerate() {
            let y = f.first + k;
            if pairs {
                // What footprints give, without their loops.
                for (x, mean) in narrow.iter_mut().enumerate() {
                    let (a, b) = (texel(2 * x, y), texel(2 * x + 1, y));
                    *mean = std::array::from_fn(|c| a[c] * 0.5 + b[c] * 0.5);
                }
            } else {
                for (f, mean) in columns.iter().zip(&mut narrow) {
                    *mean = f.mean(|x| texel(x, y));
                }
            }
            for (sum, mean) in sums.iter_mut().zip(&narrow) {
                for (s, m) in sum.iter_mut().zip(mean) {
                    *s += m * weight;
                }
            }
        }
    }
    out
}

/// Fine texels under one coarse texel along one axis, at most three of them, with weights that sum
/// to 1.
struct Footprint {
    first: usize,
    weights: [f32; 3],
    count: usize,
}

impl Footprint {
    #[inline]
    fn mean<const N: usize>(&self, texel: impl Fn(usize) -> [f32; N]) -> [f32; N] {
        let mut sum = [0.0; N];
        for (k, weight) in self.weights[..self.count].iter().enumerate() {
            let t = texel(self.first + k);
            for (s, c) in sum.iter_mut().zip(t) {
                *s += c * weight;
            }
        }
        sum
    }
}

/// Coarse texel i covers [i n / m, (i + 1) n / m): with m = floor(n / 2), at most three fine
/// texels. In integers: exact.
fn footprints(n: usize, m: usize) -> Vec<Footprint> {
    (0..m)
        .map(|i| {
            let (start, end) = (i * n, (i + 1) * n);
            let first = start / m;
            let last = (end - 1) / m;
            let mut weights = [0.0; 3];
            for (k, weight) in weights.iter_mut().enumerate().take(last - first + 1) {
                let cell = (first + k) * m;
                let overlap = end.min(cell + m) - start.max(cell);
                *weight = overlap as f32 / n as f32;
            }
            Footprint { first, weights, count: last - first + 1 }
        })
        .collect()
}

#[cfg(test)]
#[path = "texture_test.rs"]
mod tests;
