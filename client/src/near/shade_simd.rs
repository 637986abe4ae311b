//! Colours of eight neighbouring pixels of one triangle at a time: the equivalent of `shade` for
//! one.
//!
//! In: a triangle's attributes, a row. Out: packed colours. Written over [`Lanes`], so that the
//! picture does not depend on AVX2. Texels and codes are gathered; pixels with different mip levels
//! are sampled one level after the other.
//!
//! Closures are not used, as they would be compiled without AVX2.
//!
//! The level of detail uses a polynomial instead of the library's logarithm, with an error of at
//! most 2e-5.

use super::{
    attributes::Attributes,
    lane_math::{at, at3, centres, dot, hold, splat3, tap, times},
    triangle_setup::Projection,
};
use crate::simd::{LANES, Lanes};
use glam::{Vec2, Vec3};
use ldi_protocol::{
    mesh::Wrap,
    shade::{LIGHT_FROM, SRGB8_TABLE_SCALE, linear_from_srgb8_table, srgb8_table},
    texture::{MipLevel, Texture},
};

/// Shades the first `out.len()` of eight pixels from `column` on, in the row whose centre is at
/// `y`.
#[inline(always)]
pub(super) fn shade8<L: Lanes>(t: &Attributes<'_>, projection: &Projection, column: usize, y: f32, out: &mut [u32]) {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let scale = 1.0 / projection.focal_px as f32;
    let ([u, v], inverse) = t.weights8::<L>(projection.rays8::<L>(centres::<L>(column), y));
    let mut colour = at3::<L>(t.colour, u, v);
    if let Some(texture) = t.texture {
        let [f, g, h] = t.uv;
        let uv = [at::<L>(f.x, g.x, h.x, u, v), at::<L>(f.y, g.y, h.y, u, v)];
        let step = L::mul(inverse, L::splat(scale));
        let size = Vec2::new(t.texture_size.0 as f32, t.texture_size.1 as f32);
        let (across, down) = (texels2::<L>(t, 0, [u, v], step, size), texels2::<L>(t, 1, [u, v], step, size));
        // Less than a texel is level 0, and so is NaN.
        let longest2 = L::max(L::max(across, down), one);
        let lod = L::min(L::mul(L::splat(0.5), log2::<L>(longest2)), L::splat(32.0));
        let texel = sample8::<L>(texture, uv, lod, t.wrap, (1 << out.len()) - 1);
        colour = [L::mul(colour[0], texel[0]), L::mul(colour[1], texel[1]), L::mul(colour[2], texel[2])];
    }
    if !t.unlit {
        let normal = at3::<L>(t.normal, u, v);
        let length2 = dot::<L>(normal, normal);
        let unit = L::select(L::gt(length2, zero), L::div(one, L::sqrt(length2)), zero);
        let normal = times::<L>(normal, unit);
        let facing = dot::<L>(normal, splat3::<L>(Vec3::from(LIGHT_FROM)));
        let facing = L::max(facing, L::sub(zero, facing));
        let sky = L::mul(L::splat(0.25), L::add(L::splat(0.5), L::mul(L::splat(0.5), normal[1])));
        colour = times::<L>(colour, L::add(L::add(L::splat(0.35), sky), L::mul(L::splat(0.40), facing)));
    }
    let table = srgb8_table();
    let [r, g, b] = [code::<L>(table, colour[0]), code::<L>(table, colour[1]), code::<L>(table, colour[2])];
    let packed = L::or(r, L::or(L::shift_left::<8>(g), L::shift_left::<16>(b)));
    let n = out.len();
    out.copy_from_slice(&L::array_int(packed)[..n]);
}

/// sRGB codes of linear light.
#[inline(always)]
fn code<L: Lanes>(table: &[u8], light: L::F) -> L::I {
    let root = L::sqrt(hold::<L>(light));
    L::gather_bytes(table, L::to_int(L::add(L::mul(root, L::splat(SRGB8_TABLE_SCALE)), L::splat(0.5))))
}

/// Squared texels per pixel along columns (0) or rows (1): derivatives of (A . r) / (D . r).
#[inline(always)]
fn texels2<L: Lanes>(t: &Attributes<'_>, i: usize, [u, v]: [L::F; 2], step: L::F, size: Vec2) -> L::F {
    let du = L::sub(L::splat(t.a[i]), L::mul(u, L::splat(t.d[i])));
    let dv = L::sub(L::splat(t.b[i]), L::mul(v, L::splat(t.d[i])));
    let x = L::add(L::mul(L::splat(t.uv[1].x), du), L::mul(L::splat(t.uv[2].x), dv));
    let y = L::add(L::mul(L::splat(t.uv[1].y), du), L::mul(L::splat(t.uv[2].y), dv));
    let (x, y) = (L::mul(L::mul(x, step), L::splat(size.x)), L::mul(L::mul(y, step), L::splat(size.y)));
    L::add(L::mul(x, x), L::mul(y, y))
}

/// log2 of numbers of at least 1: exponent and, for the mantissa m, the series of 2 artanh((m - 1)
/// / (m + 1)) to the seventh power.
#[inline(always)]
fn log2<L: Lanes>(x: L::F) -> L::F {
    let bits = L::bits(x);
    let exponent = L::sub(L::from_int(L::shift_right::<23>(bits)), L::splat(127.0));
    let mantissa = L::or(L::and(bits, L::splat_int((1 << 23) - 1)), L::splat_int(127 << 23));
    let m = L::from_bits(mantissa);
    let t = L::div(L::sub(m, L::splat(1.0)), L::add(m, L::splat(1.0)));
    let t2 = L::mul(t, t);
    let series = L::add(L::splat(1.0 / 5.0), L::mul(t2, L::splat(1.0 / 7.0)));
    let series = L::add(L::splat(1.0 / 3.0), L::mul(t2, series));
    let series = L::add(L::splat(1.0), L::mul(t2, series));
    L::add(exponent, L::mul(L::mul(t, series), L::splat(2.0 * std::f32::consts::LOG2_E)))
}

/// Linear colours of a texture, trilinear, where a bit of `wanted` is set.
#[inline(always)]
fn sample8<L: Lanes>(texture: &Texture, uv: [L::F; 2], lod: L::F, wrap: [Wrap; 2], wanted: u32) -> [L::F; 3] {
    let fine = L::floor(lod);
    let blend = L::sub(lod, fine);
    let levels = L::array(fine);
    let (mut out, mut left) = ([L::splat(1.0); 3], wanted);
    while left != 0 {
        let number = levels[left.trailing_zeros() as usize & (LANES - 1)];
        let of_level = L::and(L::ge(fine, L::splat(number)), L::ge(L::splat(number), fine));
        // `lod` is never NaN, so that the chosen lane is one of them.
        left &= !L::mask_bits(of_level) & (left - 1);
        let number = number as usize;
        let Some(level) = texture.level_or_coarser(number) else { continue };
        let mut colour = bilinear8::<L>(level, uv, wrap);
        let between = L::mask_bits(L::and(of_level, L::gt(blend, L::splat(0.0)))) & wanted != 0;
        if between
            && number + 1 < texture.levels.len()
            && let Some(coarse) = texture.level_or_coarser(number + 1)
        {
            let [r, g, b] = bilinear8::<L>(coarse, uv, wrap);
            colour = [
                L::add(colour[0], L::mul(L::sub(r, colour[0]), blend)),
                L::add(colour[1], L::mul(L::sub(g, colour[1]), blend)),
                L::add(colour[2], L::mul(L::sub(b, colour[2]), blend)),
            ];
        }
        out = [
            L::select(of_level, colour[0], out[0]),
            L::select(of_level, colour[1], out[1]),
            L::select(of_level, colour[2], out[2]),
        ];
    }
    out
}

/// Linear colours of one level.
#[inline(always)]
fn bilinear8<L: Lanes>(level: &MipLevel, [u, v]: [L::F; 2], wrap: [Wrap; 2]) -> [L::F; 3] {
    let rgba = &level.rgba[..];
    if rgba.is_empty() {
        return [L::splat(1.0); 3];
    }
    let (x, y) = (tap::<L>(u, level.width, wrap[0]), tap::<L>(v, level.height, wrap[1]));
    let width = L::splat_int(level.width);
    let (top, bottom) = (L::mul_int(y.first, width), L::mul_int(y.second, width));
    let texels = [
        L::gather_texels(rgba, L::add_int(top, x.first)),
        L::gather_texels(rgba, L::add_int(top, x.second)),
        L::gather_texels(rgba, L::add_int(bottom, x.first)),
        L::gather_texels(rgba, L::add_int(bottom, x.second)),
    ];
    let (x1, y1) = (x.second_weight, y.second_weight);
    let (x0, y0) = (L::sub(L::splat(1.0), x1), L::sub(L::splat(1.0), y1));
    let weights = [L::mul(x0, y0), L::mul(x1, y0), L::mul(x0, y1), L::mul(x1, y1)];
    let table = linear_from_srgb8_table();
    [
        channel::<L, 0>(table, texels, weights),
        channel::<L, 8>(table, texels, weights),
        channel::<L, 16>(table, texels, weights),
    ]
}

/// The weighted sum of the four texels' linear light in the byte that `SHIFT` names.
#[inline(always)]
fn channel<L: Lanes, const SHIFT: i32>(table: &[f32; 256], texels: [L::I; 4], weights: [L::F; 4]) -> L::F {
    let byte = L::splat_int(255);
    let a = L::mul(L::gather(table, L::and(L::shift_right::<SHIFT>(texels[0]), byte)), weights[0]);
    let b = L::mul(L::gather(table, L::and(L::shift_right::<SHIFT>(texels[1]), byte)), weights[1]);
    let c = L::mul(L::gather(table, L::and(L::shift_right::<SHIFT>(texels[2]), byte)), weights[2]);
    let d = L::mul(L::gather(table, L::and(L::shift_right::<SHIFT>(texels[3]), byte)), weights[3]);
    L::add(L::add(L::add(a, b), c), d)
}
