//! One ray through the hierarchy: eight boxes at once, then four triangles at once, nearest first.
//!
//! Boxes are tested by slabs (Williams et al. 2005) with the planes chosen by the signs of the direction.

use super::{
    bvh::{Bvh, EMPTY, LEAF, Node},
    cell_set::Masks,
    lanes::Lanes,
    triangles::{Rays, Triangles, Vec3L, axes_of, intersect, relative_corners, splat3},
};

/// Relative room left for rounding wherever a distance to a box decides that nothing in it can be nearer: a slab distance errs by
/// some 2e-7, a triangle's t by up to about 1e-6 unless it is seen at a grazing angle. Larger values only cost visits.
pub(super) const DISTANCE_SLACK: f32 = 1e-5;

/// A ray relative to the scene's middle.
pub(super) struct ShortRay {
    pub origin: [f32; 3],
    pub direction: [f32; 3],
    pub t_min: f32,
    pub t_max: f32,
}

/// The nearest triangle so far.
#[derive(Clone, Copy)]
pub(super) struct Nearest {
    pub t: f32,
    pub triangle: u32,
    /// Four times the block plus the lane.
    pub slot: u32,
}

/// Stack entries on the way: distance in the upper half, so that integer order is distance order (distances are not negative).
pub(super) struct Stack {
    entries: [u64; Self::INLINE],
    count: usize,
    /// What does not fit: deep trees of degenerate scenes.
    overflow: Vec<u64>,
}

impl Stack {
    const INLINE: usize = 64;

    #[inline(always)]
    pub fn new() -> Self {
        Self { entries: [0; Self::INLINE], count: 0, overflow: Vec::new() }
    }
    #[inline(always)]
    pub fn push(&mut self, distance: f32, child: u32) {
        self.push_entry(u64::from(distance.max(0.0).to_bits()) << 32 | u64::from(child));
    }
    #[inline(always)]
    fn push_entry(&mut self, entry: u64) {
        if let Some(e) = self.entries.get_mut(self.count) {
            *e = entry;
            self.count += 1;
        } else {
            self.overflow.push(entry);
        }
    }
    #[inline(always)]
    pub fn pop(&mut self) -> Option<(f32, u32)> {
        let entry = if let Some(e) = self.overflow.pop() {
            e
        } else {
            self.count = self.count.checked_sub(1)?;
            self.entries[self.count]
        };
        Some((f32::from_bits((entry >> 32) as u32), entry as u32))
    }
    /// Pushes the children in `bits`, the nearest last.
    #[inline(always)]
    pub fn push_sorted(&mut self, mut bits: u32, distances: &[f32; 8], children: &[u32; 8]) {
        let mut sorted = [0u64; 8];
        let mut n = 0;
        while bits != 0 {
            let i = bits.trailing_zeros() as usize & 7;
            bits &= bits - 1;
            let entry = u64::from(distances[i].max(0.0).to_bits()) << 32 | u64::from(children[i]);
            let mut at = n;
            while at > 0 && sorted[at - 1] < entry {
                sorted[at] = sorted[at - 1];
                at -= 1;
            }
            sorted[at] = entry;
            n += 1;
        }
        for &entry in &sorted[..n] {
            self.push_entry(entry);
        }
    }
}

/// t at which the ray crosses one plane of each slab, of eight boxes.
#[inline(always)]
fn slabs<F8: Lanes<8>>(node: &Node, planes: &[usize; 3], origin: Vec3L<F8>, inverse: Vec3L<F8>) -> Vec3L<F8> {
    [
        F8::load(&node.bounds[planes[0]]).sub(origin[0]).mul(inverse[0]),
        F8::load(&node.bounds[planes[1]]).sub(origin[1]).mul(inverse[1]),
        F8::load(&node.bounds[planes[2]]).sub(origin[2]).mul(inverse[2]),
    ]
}

/// The nearest hit; of several at the same t, the one with the smallest number. `is_there(triangle, slot)` has the last word about triangles
/// with a mask. With `any`, some hit.
#[inline(always)]
pub(super) fn trace<F8: Lanes<8>, F4: Lanes<4>>(
    bvh: &Bvh,
    ray: &ShortRay,
    masks: Option<&Masks>,
    any: bool,
    is_there: &impl Fn(u32, u32) -> bool,
) -> Option<Nearest> {
    let mut nearest = Nearest { t: ray.t_max, triangle: u32::MAX, slot: u32::MAX };
    if bvh.nodes.is_empty() {
        return None;
    }
    // Infinite for components of zero: such a ray is in the slab for all t or for none, and 0 x infinity, on a border, is NaN and no limit.
    let inverse = ray.direction.map(|d| 1.0 / d);
    // Which plane of each slab is entered first.
    let near_plane: [usize; 3] = std::array::from_fn(|k| if inverse[k] < 0.0 { k + 3 } else { k });
    let far_plane: [usize; 3] = std::array::from_fn(|k| if inverse[k] < 0.0 { k } else { k + 3 });
    let origin: Vec3L<F8> = splat3(ray.origin);
    let inverse: Vec3L<F8> = splat3(inverse);
    let axes = axes_of(ray.direction);
    let [k, i, j] = axes;
    let slopes = [ray.direction[i] / ray.direction[k], ray.direction[j] / ray.direction[k]];
    let mut rays = Rays {
        direction: splat3(ray.direction),
        slopes: [F4::splat(slopes[0]), F4::splat(slopes[1])],
        t_min: F4::splat(ray.t_min),
        t_max: F4::splat(ray.t_max),
    };
    let (nearer, farther) = (F8::splat(1.0 - DISTANCE_SLACK), F8::splat(1.0 + DISTANCE_SLACK));
    let earliest = F8::splat(ray.t_min * (1.0 - DISTANCE_SLACK));
    let mut stack = Stack::new();
    stack.push(0.0, 0);
    while let Some((distance, child)) = stack.pop() {
        if distance > nearest.t {
            continue;
        }
        if child & LEAF == 0 {
            let node = &bvh.nodes[child as usize];
            let [x, y, z] = slabs(node, &near_plane, origin, inverse);
            // Of a NaN and a number, these keep the number on the right.
            let enter = z.mul(nearer).max(y.mul(nearer).max(x.mul(nearer).max(earliest)));
            let [x, y, z] = slabs(node, &far_plane, origin, inverse);
            let leave = z.mul(farther).min(y.mul(farther).min(x.mul(farther).min(F8::splat(nearest.t))));
            let mut bits = F8::bits(enter.le(leave));
            if let Some(m) = masks {
                bits &= u32::from(m.children[child as usize]);
            }
            if bits != 0 {
                let mut distances = [0.0; 8];
                enter.store(&mut distances);
                stack.push_sorted(bits, &distances, &node.children);
            }
            continue;
        }
        if child == EMPTY {
            continue;
        }
        let number = child & !LEAF;
        let block = &bvh.blocks[number as usize];
        rays.t_max = F4::splat(nearest.t);
        let triangles = Triangles::new(block, relative_corners(block, ray.origin));
        let (mut bits, t) = intersect(axes, &triangles, &rays);
        if let Some(m) = masks {
            bits &= u32::from(m.lanes[number as usize]);
        }
        if bits == 0 {
            continue;
        }
        let mut ts = [0.0; 4];
        t.store(&mut ts);
        while bits != 0 {
            let lane = bits.trailing_zeros() as usize & 3;
            bits &= bits - 1;
            let (t, triangle, slot) = (ts[lane], block.triangles[lane], number * 4 + lane as u32);
            let is_nearer = t < nearest.t || (t == nearest.t && triangle < nearest.triangle);
            if is_nearer && (block.masked >> lane & 1 == 0 || is_there(triangle, slot)) {
                nearest = Nearest { t, triangle, slot };
                if any {
                    return Some(nearest);
                }
            }
        }
    }
    (nearest.slot != u32::MAX).then_some(nearest)
}
