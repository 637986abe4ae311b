//! Ray against triangle, four triangles at a time or eight rays at a time, without cracks.
//!
//! The test of Woop, Benthin and Wald 2013: corners relative to the origin are sheared along the
//! ray's dominant axis k so that the ray becomes that axis,
//!
//! ```text
//!     x = p_i - p_k d_i / d_k        y = p_j - p_k d_j / d_k
//! ```
//!
//! and the ray hits the triangle where the three edge functions U = c_x b_y - c_y b_x, V = a_x
//! c_y - a_y c_x, W = b_x a_y - b_y a_x do not differ in sign. Triangles that share a corner find
//! the same (x, y) for it, and because rounding is monotonic, c_x b_y - c_y b_x never has the
//! wrong sign: at worst it is 0, which counts for both sides. So a ray cannot slip between
//! triangles that share corners, not even at a corner; on an edge it hits both. (Products of
//! Pluecker coordinates need fewer operations in packets, but let rays through at corners: tried,
//! and seen in `nothing_slips_through_shared_edges`.)
//!
//! Changed against the paper: the depth is that of the plane, t = (a . n) / (d . n) with n from
//! f64 (`Block::normal`), since weighting the corners' depths by U, V, W is no better than those
//! for slivers; and no second evaluation in f64 where an edge function is 0.
//!
//! Single rays and packets run through the same arithmetic in the same order, so they see the same
//! hits bit by bit.

use super::{bvh::Block, lanes::Lanes, place::Place};

/// Three coordinates.
pub(super) type Vec3L<F> = [F; 3];

/// `array::map` that is certain to be inlined: a kernel's registers must not pass through
/// functions compiled for fewer instructions.
#[inline(always)]
pub(super) fn map3<A: Copy, B>(a: [A; 3], f: impl Fn(A) -> B) -> [B; 3] {
    [f(a[0]), f(a[1]), f(a[2])]
}

/// Three arrays as lanes.
#[inline(always)]
pub(super) fn load3<const N: usize, F: Lanes<N>>(a: &[[f32; N]; 3]) -> Vec3L<F> {
    [F::load(&a[0]), F::load(&a[1]), F::load(&a[2])]
}

/// The same point in all lanes.
#[inline(always)]
pub(super) fn splat3<const N: usize, F: Lanes<N>>(a: [f32; 3]) -> Vec3L<F> {
    [F::splat(a[0]), F::splat(a[1]), F::splat(a[2])]
}

#[inline(always)]
fn sub<const N: usize, F: Lanes<N>>(a: Vec3L<F>, b: Vec3L<F>) -> Vec3L<F> {
    [a[0].sub(b[0]), a[1].sub(b[1]), a[2].sub(b[2])]
}
#[inline(always)]
fn dot<const N: usize, F: Lanes<N>>(a: Vec3L<F>, b: Vec3L<F>) -> F {
    a[0].mul(b[0]).add(a[1].mul(b[1])).add(a[2].mul(b[2]))
}

/// Corners relative to a ray origin, of a block in world space or placed there.
#[inline(always)]
pub(super) fn relative_corners<F: Lanes<4>>(block: &Block, place: Option<&Place>, origin: [f32; 3]) -> [Vec3L<F>; 3] {
    if let Some(place) = place {
        return place.relative_corners(block, origin);
    }
    let o = splat3(origin);
    [sub(load3(&block.corners[0]), o), sub(load3(&block.corners[1]), o), sub(load3(&block.corners[2]), o)]
}

/// Triangles to test: corners relative to the origin, normals, and how far the planes lie from the
/// origin along the normals.
#[derive(Clone, Copy)]
pub(super) struct Triangles<F> {
    pub corners: [Vec3L<F>; 3],
    pub normal: Vec3L<F>,
    pub distance: F,
}

impl<F: Lanes<4>> Triangles<F> {
    /// The four of a block.
    #[inline(always)]
    pub fn new(block: &Block, place: Option<&Place>, corners: [Vec3L<F>; 3]) -> Self {
        let normal = match place {
            Some(place) => place.normals(block),
            None => load3(&block.normal),
        };
        Self { corners, normal, distance: dot(corners[0], normal) }
    }
}

/// Dominant axis of a direction and the two others; of equal ones the last.
#[inline(always)]
pub(super) fn axes_of(direction: [f32; 3]) -> [usize; 3] {
    let [x, y, z] = direction.map(f32::abs);
    let k = if z >= x && z >= y {
        2
    } else if y >= x {
        1
    } else {
        0
    };
    [k, (k + 1) % 3, (k + 2) % 3]
}

/// Rays to test: directions, slopes d_i / d_k and d_j / d_k, limits.
#[derive(Clone, Copy)]
pub(super) struct Rays<F> {
    pub direction: Vec3L<F>,
    pub slopes: [F; 2],
    pub t_min: F,
    pub t_max: F,
}

/// A corner sheared so that the ray is the axis k.
#[inline(always)]
fn sheared<const N: usize, F: Lanes<N>>(p: Vec3L<F>, [k, i, j]: [usize; 3], rays: &Rays<F>) -> [F; 2] {
    [p[i].sub(rays.slopes[0].mul(p[k])), p[j].sub(rays.slopes[1].mul(p[k]))]
}

/// Where lanes hit: bits of the lanes with `t_min <= t <= t_max`, and t of all lanes. Either side
/// may be the same in all lanes.
#[inline(always)]
pub(super) fn intersect<const N: usize, F: Lanes<N>>(
    axes: [usize; 3],
    triangles: &Triangles<F>,
    rays: &Rays<F>,
) -> (u32, F) {
    let [a, b, c] = triangles.corners;
    let (a, b, c) = (sheared(a, axes, rays), sheared(b, axes, rays), sheared(c, axes, rays));
    let u = c[0].mul(b[1]).sub(c[1].mul(b[0]));
    let v = a[0].mul(c[1]).sub(a[1].mul(c[0]));
    let w = b[0].mul(a[1]).sub(b[1].mul(a[0]));
    let zero = F::splat(0.0);
    let inside = F::or(zero.le(u.min(v).min(w)), u.max(v).max(w).le(zero));
    if F::bits(inside) == 0 {
        return (0, zero);
    }
    // Parallel or without area: infinite or NaN, and every comparison with a limit fails.
    let t = triangles.distance.div(dot(triangles.normal, rays.direction));
    let in_range = F::and(rays.t_min.le(t), t.le(rays.t_max));
    (F::bits(F::and(inside, in_range)), t)
}
