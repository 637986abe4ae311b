//! Arithmetic of eight neighbouring pixels: vectors, texture coordinates.
//!
//! Functions instead of closures, which would be compiled without AVX2.

use crate::simd::{LANES, Lanes};
use glam::Vec3;
use ldi_protocol::mesh::Wrap;

const LANE_NUMBERS: [u32; LANES] = [0, 1, 2, 3, 4, 5, 6, 7];

/// A value at the first corner and its differences to the others, at eight pixels.
#[inline(always)]
pub(super) fn at<L: Lanes>(f: f32, g: f32, h: f32, u: L::F, v: L::F) -> L::F {
    L::add(L::add(L::splat(f), L::mul(L::splat(g), u)), L::mul(L::splat(h), v))
}

#[inline(always)]
pub(super) fn at3<L: Lanes>([f, g, h]: [Vec3; 3], u: L::F, v: L::F) -> [L::F; 3] {
    [at::<L>(f.x, g.x, h.x, u, v), at::<L>(f.y, g.y, h.y, u, v), at::<L>(f.z, g.z, h.z, u, v)]
}

#[inline(always)]
pub(super) fn dot<L: Lanes>(a: [L::F; 3], b: [L::F; 3]) -> L::F {
    L::add(L::add(L::mul(a[0], b[0]), L::mul(a[1], b[1])), L::mul(a[2], b[2]))
}

#[inline(always)]
pub(super) fn splat3<L: Lanes>(v: Vec3) -> [L::F; 3] {
    [L::splat(v.x), L::splat(v.y), L::splat(v.z)]
}

#[inline(always)]
pub(super) fn times<L: Lanes>(a: [L::F; 3], k: L::F) -> [L::F; 3] {
    [L::mul(a[0], k), L::mul(a[1], k), L::mul(a[2], k)]
}

/// Held in [0, 1]; NaN becomes 0.
#[inline(always)]
pub(super) fn hold<L: Lanes>(w: L::F) -> L::F {
    L::min(L::max(w, L::splat(0.0)), L::splat(1.0))
}

/// Centres of eight columns, from `column` on.
#[inline(always)]
pub(super) fn centres<L: Lanes>(column: usize) -> L::F {
    L::add(L::from_int(L::load_int(&LANE_NUMBERS)), L::splat(column as f32 + 0.5))
}

/// A texture coordinate brought into [0, 1], as the sampler does it.
#[inline(always)]
pub(super) fn fold<L: Lanes>(u: L::F, wrap: Wrap) -> L::F {
    match wrap {
        Wrap::Repeat => L::sub(u, L::floor(u)),
        Wrap::Mirror => {
            let t = L::sub(u, L::mul(L::splat(2.0), L::floor(L::mul(u, L::splat(0.5)))));
            L::select(L::gt(t, L::splat(1.0)), L::sub(L::splat(2.0), t), t)
        }
        Wrap::Clamp => hold::<L>(u),
    }
}

/// The two texels around a coordinate along one axis, as in `texture`.
pub(super) struct Tap<L: Lanes> {
    pub first: L::I,
    pub second: L::I,
    /// In [0, 1]; the first has the rest.
    pub second_weight: L::F,
}

#[inline(always)]
pub(super) fn tap<L: Lanes>(u: L::F, n: u32, wrap: Wrap) -> Tap<L> {
    let (zero, one, last) = (L::splat(0.0), L::splat(1.0), L::splat(n as f32 - 1.0));
    let x = L::sub(L::mul(fold::<L>(u, wrap), L::splat(n as f32)), L::splat(0.5));
    let below = L::floor(x);
    let above = L::add(below, one);
    let (first, second) = match wrap {
        Wrap::Repeat => (L::select(L::gt(zero, below), last, below), L::select(L::gt(above, last), zero, above)),
        // At a mirrored border the neighbour of the border texel is itself, as with clamping.
        Wrap::Mirror | Wrap::Clamp => (below, above),
    };
    Tap {
        first: L::to_int(L::min(L::max(first, zero), last)),
        second: L::to_int(L::min(L::max(second, zero), last)),
        second_weight: hold::<L>(L::sub(x, below)),
    }
}
