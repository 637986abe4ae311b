//! Colours of eight neighbouring pixels of one triangle at a time: what `shade` computes for one.
//!
//! In: a triangle's attributes, a row. Out: packed colours. Written over [`Lanes`], so that the picture does not depend on whether AVX2 is there. Texels and codes are
//! gathered; pixels of different mip levels, mostly none or two kinds, are sampled one level after the other.
//!
//! The level of detail comes from a polynomial in place of the library's logarithm: off by at most 2e-5.

use super::{setup::View, shade::Attributes};
use crate::lanes::{LANES, Lanes};
use ldi_protocol::{
    mesh::Wrap,
    shade::{LIGHT_FROM, SRGB8_TABLE_SCALE, linear_from_srgb8_table, srgb8_table},
    texture::{MipLevel, Texture},
};

const LANE_NUMBERS: [u32; LANES] = [0, 1, 2, 3, 4, 5, 6, 7];

/// A value at the first corner and its differences to the others, at eight pixels.
#[inline(always)]
fn at<L: Lanes>([f, g, h]: [f32; 3], u: L::F, v: L::F) -> L::F {
    L::add(L::add(L::splat(f), L::mul(L::splat(g), u)), L::mul(L::splat(h), v))
}

#[inline(always)]
fn dot<L: Lanes>(a: [L::F; 3], b: [L::F; 3]) -> L::F {
    L::add(L::add(L::mul(a[0], b[0]), L::mul(a[1], b[1])), L::mul(a[2], b[2]))
}

/// Shades the first `out.len()` of eight pixels from `column` on, in the row whose centre is at `y`.
#[inline(always)]
pub(super) fn shade8<L: Lanes>(t: &Attributes<'_>, view: &View, column: usize, y: f32, out: &mut [u32]) {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let scale = 1.0 / view.focal_px as f32;
    let x = L::add(L::from_int(L::load_int(&LANE_NUMBERS)), L::splat(column as f32 + 0.5));
    let ray = [
        L::mul(L::sub(x, L::splat(view.centre_px[0] as f32)), L::splat(scale)),
        L::splat((view.centre_px[1] as f32 - y) * scale),
        one,
    ];
    let along_ray = |v: glam::Vec3| dot::<L>([L::splat(v.x), L::splat(v.y), L::splat(v.z)], ray);
    let inverse = L::div(one, along_ray(t.d));
    // NaN, of an edge-on triangle, becomes 0.
    let hold = |w: L::F| L::min(L::max(w, zero), one);
    let u = hold(L::mul(along_ray(t.a), inverse));
    let v = hold(L::mul(along_ray(t.b), inverse));
    let mut colour: [L::F; 3] = std::array::from_fn(|k| at::<L>(t.colour.map(|c| c[k]), u, v));
    if let Some(texture) = t.texture {
        let uv: [L::F; 2] = std::array::from_fn(|k| at::<L>(t.uv.map(|c| c[k]), u, v));
        let step = L::mul(inverse, L::splat(scale));
        let (width, height) = t.texture_size;
        // Squared texels per pixel along columns (0) and rows (1): derivatives of (A . r) / (D . r).
        let texels2 = |i: usize| {
            let du = L::sub(L::splat(t.a[i]), L::mul(u, L::splat(t.d[i])));
            let dv = L::sub(L::splat(t.b[i]), L::mul(v, L::splat(t.d[i])));
            let moved = |k: usize, size: u32| {
                let d = L::add(L::mul(L::splat(t.uv[1][k]), du), L::mul(L::splat(t.uv[2][k]), dv));
                L::mul(L::mul(d, step), L::splat(size as f32))
            };
            let (a, b) = (moved(0, width), moved(1, height));
            L::add(L::mul(a, a), L::mul(b, b))
        };
        // Less than a texel is level 0, and so is NaN.
        let longest2 = L::max(L::max(texels2(0), texels2(1)), one);
        let lod = L::min(L::mul(L::splat(0.5), log2::<L>(longest2)), L::splat(32.0));
        let texel = sample8::<L>(texture, uv, lod, t.wrap, (1 << out.len()) - 1);
        colour = std::array::from_fn(|k| L::mul(colour[k], texel[k]));
    }
    if !t.unlit {
        let normal: [L::F; 3] = std::array::from_fn(|k| at::<L>(t.normal.map(|c| c[k]), u, v));
        let length2 = dot::<L>(normal, normal);
        let unit = L::select(L::gt(length2, zero), L::div(one, L::sqrt(length2)), zero);
        let normal = normal.map(|n| L::mul(n, unit));
        let facing = dot::<L>(normal, LIGHT_FROM.map(L::splat));
        let facing = L::max(facing, L::sub(zero, facing));
        let sky = L::mul(L::splat(0.25), L::add(L::splat(0.5), L::mul(L::splat(0.5), normal[1])));
        let amount = L::add(L::add(L::splat(0.35), sky), L::mul(L::splat(0.40), facing));
        colour = colour.map(|c| L::mul(c, amount));
    }
    let [r, g, b] = colour.map(|c| {
        let root = L::sqrt(L::min(L::max(c, zero), one));
        let place = L::to_int(L::add(L::mul(root, L::splat(SRGB8_TABLE_SCALE)), L::splat(0.5)));
        L::gather_bytes(srgb8_table(), place)
    });
    let packed = L::or(r, L::or(L::shift_left::<8>(g), L::shift_left::<16>(b)));
    out.copy_from_slice(&L::array_int(packed)[..out.len()]);
}

/// log2 of numbers of at least 1: exponent and, for the mantissa m, the series of 2 artanh((m - 1) / (m + 1)) to the seventh power.
#[inline(always)]
fn log2<L: Lanes>(x: L::F) -> L::F {
    let bits = L::bits(x);
    let exponent = L::sub(L::from_int(L::shift_right::<23>(bits)), L::splat(127.0));
    let mantissa = L::or(L::and(bits, L::splat_int((1 << 23) - 1)), L::splat_int(127 << 23));
    let m = L::from_bits(mantissa);
    let t = L::div(L::sub(m, L::splat(1.0)), L::add(m, L::splat(1.0)));
    let t2 = L::mul(t, t);
    let term = |inner: L::F, k: f32| L::add(L::splat(k), L::mul(t2, inner));
    let series = term(term(term(L::splat(1.0 / 7.0), 1.0 / 5.0), 1.0 / 3.0), 1.0);
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
        // The lane that was asked is one of them unless it is NaN, which `lod` is not.
        left &= !L::mask_bits(of_level) & (left - 1);
        let number = number as usize;
        let Some(level) = texture.level_or_coarser(number) else { continue };
        let mut colour = bilinear8::<L>(level, uv, wrap);
        let between = L::mask_bits(L::and(of_level, L::gt(blend, L::splat(0.0)))) & wanted != 0;
        if let (true, Some(coarse)) =
            (between && number + 1 < texture.levels.len(), texture.level_or_coarser(number + 1))
        {
            let coarse = bilinear8::<L>(coarse, uv, wrap);
            colour = std::array::from_fn(|k| L::add(colour[k], L::mul(L::sub(coarse[k], colour[k]), blend)));
        }
        out = std::array::from_fn(|k| L::select(of_level, colour[k], out[k]));
    }
    out
}

/// Linear colours of one level.
#[inline(always)]
fn bilinear8<L: Lanes>(level: &MipLevel, [u, v]: [L::F; 2], wrap: [Wrap; 2]) -> [L::F; 3] {
    if level.rgba.is_empty() {
        return [L::splat(1.0); 3];
    }
    let (x, y) = (tap8::<L>(u, level.width, wrap[0]), tap8::<L>(v, level.height, wrap[1]));
    let row = |y: L::I| L::mul_int(y, L::splat_int(level.width));
    let texel = |x: L::I, row: L::I| L::gather_texels(&level.rgba, L::add_int(row, x));
    let (top, bottom) = (row(y.first), row(y.second));
    let texels = [texel(x.first, top), texel(x.second, top), texel(x.first, bottom), texel(x.second, bottom)];
    let (x1, y1) = (x.second_weight, y.second_weight);
    let (x0, y0) = (L::sub(L::splat(1.0), x1), L::sub(L::splat(1.0), y1));
    let weights = [L::mul(x0, y0), L::mul(x1, y0), L::mul(x0, y1), L::mul(x1, y1)];
    let table = linear_from_srgb8_table();
    let [a, b, c, d] = texels;
    let part = |texel: L::I, weight: L::F| L::mul(L::gather(table, L::and(texel, L::splat_int(255))), weight);
    let [wa, wb, wc, wd] = weights;
    let sum = |a, b, c, d| L::add(L::add(L::add(part(a, wa), part(b, wb)), part(c, wc)), part(d, wd));
    let (g, h) = (L::shift_right::<8>, L::shift_right::<16>);
    [sum(a, b, c, d), sum(g(a), g(b), g(c), g(d)), sum(h(a), h(b), h(c), h(d))]
}

/// The two texels that coordinates lie between along one axis, as `texture` finds them.
struct Tap8<L: Lanes> {
    first: L::I,
    second: L::I,
    second_weight: L::F,
}

#[inline(always)]
fn tap8<L: Lanes>(u: L::F, n: u32, wrap: Wrap) -> Tap8<L> {
    let (zero, one, last) = (L::splat(0.0), L::splat(1.0), L::splat(n as f32 - 1.0));
    let folded = match wrap {
        Wrap::Repeat => L::sub(u, L::floor(u)),
        Wrap::Mirror => {
            let t = L::sub(u, L::mul(L::splat(2.0), L::floor(L::mul(u, L::splat(0.5)))));
            L::select(L::gt(t, one), L::sub(L::splat(2.0), t), t)
        }
        Wrap::Clamp => L::min(L::max(u, zero), one),
    };
    let x = L::sub(L::mul(folded, L::splat(n as f32)), L::splat(0.5));
    let below = L::floor(x);
    let hold = |x: L::F| L::min(L::max(x, zero), last);
    let (first, second) = (below, L::add(below, one));
    let (first, second) = match wrap {
        Wrap::Repeat => {
            (L::select(L::gt(zero, first), last, L::min(first, last)), L::select(L::gt(second, last), zero, second))
        }
        // At a mirrored border the neighbour of the border texel is itself, as with clamping.
        Wrap::Mirror | Wrap::Clamp => (first, second),
    };
    let second_weight = L::min(L::max(L::sub(x, below), zero), one);
    Tap8 { first: L::to_int(hold(first)), second: L::to_int(hold(second)), second_weight }
}
