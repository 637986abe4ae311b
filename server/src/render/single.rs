//! One ray through the hierarchy: eight boxes at once, then four triangles at once, nearest first.
//!
//! Boxes are tested by slabs (Williams et al. 2005) with the planes chosen by the signs of the
//! direction.

use super::{
    bvh::{Block, Branches, Bvh, EMPTY, ITEM, LEAF, Node},
    cell_set::Masks,
    lanes::Lanes,
    place::Place,
    triangles::{Rays, Triangles, Vec3L, axes_of, intersect, relative_corners, splat3},
};

/// Relative room left for rounding wherever a distance to a box decides that nothing in it can be
/// nearer: a slab distance errs by some 2e-7, a triangle's t by up to about 1e-6 unless it is seen
/// at a grazing angle. Larger values only cost visits.
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
    /// Four times the block plus the lane; of the blocks in world space, or of an item's.
    pub slot: u32,
    /// The item, or [`NO_ITEM`].
    pub item: u32,
}

/// Item of a triangle in world space.
pub(super) const NO_ITEM: u32 = u32::MAX;

impl Nearest {
    /// Nothing before `t`.
    pub fn none(t: f32) -> Self {
        Self { t, triangle: u32::MAX, slot: u32::MAX, item: NO_ITEM }
    }

    /// Whether it is a triangle.
    pub fn is_some(&self) -> bool {
        self.slot != u32::MAX
    }
}

/// A hierarchy to traverse: the scene's own, or that of a cluster where an instance places it.
#[derive(Clone, Copy)]
pub(super) struct Branch<'a> {
    pub branches: &'a Branches,
    pub masks: Option<&'a Masks>,
    /// A child as a node has it.
    pub root: u32,
    pub place: Option<&'a Place>,
    pub item: u32,
    /// Added to the numbers of its triangles.
    pub first: u32,
}

impl<'a> Branch<'a> {
    /// The scene's own hierarchy; None if it is empty.
    #[inline(always)]
    pub fn world(bvh: &'a Bvh, masks: Option<&'a Masks>) -> Option<Self> {
        Some(Self { branches: &bvh.world, masks, root: bvh.root?, place: None, item: NO_ITEM, first: 0 })
    }

    /// The hierarchy of an item.
    #[inline(always)]
    pub fn of_item(bvh: &'a Bvh, number: u32) -> Self {
        let item = &bvh.items[number as usize];
        let place = Some(&bvh.places[item.place as usize]);
        Self { branches: &bvh.local, masks: None, root: item.root, place, item: number, first: item.first }
    }

    /// A node, and bits of the children that may be visited.
    #[inline(always)]
    pub fn node(&self, number: u32) -> (&'a Node, u32) {
        let node = &self.branches.nodes[number as usize];
        let present = match self.masks {
            Some(masks) => u32::from(masks.children[number as usize]),
            None => u32::from(node.used),
        };
        (node, present)
    }

    /// The boxes of a placed node; None in world space.
    #[expect(clippy::manual_map, reason = "a closure would be compiled without the widest vectors")]
    #[inline(always)]
    pub fn placed<F8: Lanes<8>>(&self, node: &Node) -> Option<[F8; 6]> {
        match self.place {
            Some(place) => Some(place.boxes(node)),
            None => None,
        }
    }

    /// A block, and bits of its lanes to test.
    #[inline(always)]
    pub fn block(&self, number: u32) -> (&'a Block, u32) {
        let lanes = match self.masks {
            Some(masks) => u32::from(masks.lanes[number as usize]),
            None => 0xf,
        };
        (&self.branches.blocks[number as usize], lanes)
    }
}

/// Stack entries on the way: distance in the upper half, so that integer order is distance order
/// (distances are not negative).
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

/// The side of a box on an axis that a ray enters through (`other` 0) or leaves through (3), of
/// min x, y, z, max x, y, z.
#[inline(always)]
fn entered(inverse: [f32; 3], axis: usize, other: usize) -> usize {
    if inverse[axis] < 0.0 { axis + 3 - other } else { axis + other }
}

/// One side of a node's boxes, of min x, y, z, max x, y, z.
#[inline(always)]
pub(super) fn side<F8: Lanes<8>>(node: &Node, placed: &Option<[F8; 6]>, number: usize) -> F8 {
    match placed {
        Some(boxes) => boxes[number],
        None => F8::load(&node.bounds[number]),
    }
}

/// What a ray needs at every box and triangle.
struct Prepared<F8, F4> {
    origin: Vec3L<F8>,
    inverse: Vec3L<F8>,
    /// Which side of each slab is entered first, and which last, of min x, y, z, max x, y, z.
    planes: [[usize; 3]; 2],
    axes: [usize; 3],
    rays: Rays<F4>,
    earliest: F8,
}

impl<F8: Lanes<8>, F4: Lanes<4>> Prepared<F8, F4> {
    #[inline(always)]
    fn new(ray: &ShortRay) -> Self {
        // Infinite for components of zero: such a ray is in the slab for all t or for none, and 0
        // x infinity, on a border, is NaN and no limit.
        let inverse = ray.direction.map(|d| 1.0 / d);
        let axes = axes_of(ray.direction);
        let [k, i, j] = axes;
        let slopes = [ray.direction[i] / ray.direction[k], ray.direction[j] / ray.direction[k]];
        Self {
            origin: splat3(ray.origin),
            inverse: splat3(inverse),
            planes: [
                [entered(inverse, 0, 0), entered(inverse, 1, 0), entered(inverse, 2, 0)],
                [entered(inverse, 0, 3), entered(inverse, 1, 3), entered(inverse, 2, 3)],
            ],
            axes,
            rays: Rays {
                direction: splat3(ray.direction),
                slopes: [F4::splat(slopes[0]), F4::splat(slopes[1])],
                t_min: F4::splat(ray.t_min),
                t_max: F4::splat(ray.t_max),
            },
            earliest: F8::splat(ray.t_min * (1.0 - DISTANCE_SLACK)),
        }
    }

    /// t at which the ray crosses one plane of each slab, of eight boxes.
    #[inline(always)]
    fn slabs(&self, node: &Node, placed: &Option<[F8; 6]>, planes: &[usize; 3]) -> Vec3L<F8> {
        [
            side(node, placed, planes[0]).sub(self.origin[0]).mul(self.inverse[0]),
            side(node, placed, planes[1]).sub(self.origin[1]).mul(self.inverse[1]),
            side(node, placed, planes[2]).sub(self.origin[2]).mul(self.inverse[2]),
        ]
    }

    /// Looks for nearer hits in a hierarchy; with `ITEMS` in the items that it holds, too.
    #[inline(always)]
    fn descend<const ITEMS: bool>(
        &mut self,
        bvh: &Bvh,
        branch: Branch<'_>,
        ray: &ShortRay,
        nearest: &mut Nearest,
        any: bool,
        is_there: &impl Fn(&Nearest) -> bool,
    ) {
        let (nearer, farther) = (F8::splat(1.0 - DISTANCE_SLACK), F8::splat(1.0 + DISTANCE_SLACK));
        let mut stack = Stack::new();
        stack.push(0.0, branch.root);
        while let Some((distance, child)) = stack.pop() {
            if distance > nearest.t {
                continue;
            }
            if child & LEAF == 0 {
                let (node, present) = branch.node(child);
                let placed = if ITEMS { None } else { branch.placed::<F8>(node) };
                let [x, y, z] = self.slabs(node, &placed, &self.planes[0]);
                // Of a NaN and a number, these keep the number on the right.
                let enter = z.mul(nearer).max(y.mul(nearer).max(x.mul(nearer).max(self.earliest)));
                let [x, y, z] = self.slabs(node, &placed, &self.planes[1]);
                let leave = z.mul(farther).min(y.mul(farther).min(x.mul(farther).min(F8::splat(nearest.t))));
                let bits = F8::bits(enter.le(leave)) & present;
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
            if ITEMS && child & ITEM != 0 {
                let item = Branch::of_item(bvh, child & !(LEAF | ITEM));
                self.descend::<false>(bvh, item, ray, nearest, any, is_there);
                if any && nearest.is_some() {
                    return;
                }
                continue;
            }
            let number = child & !LEAF;
            let (block, lanes) = branch.block(number);
            self.rays.t_max = F4::splat(nearest.t);
            let place = if ITEMS { None } else { branch.place };
            let triangles = Triangles::new(block, place, relative_corners(block, place, ray.origin));
            let (bits, t) = intersect(self.axes, &triangles, &self.rays);
            let mut bits = bits & lanes;
            if bits == 0 {
                continue;
            }
            let mut ts = [0.0; 4];
            t.store(&mut ts);
            while bits != 0 {
                let lane = bits.trailing_zeros() as usize & 3;
                bits &= bits - 1;
                let (t, triangle) = (ts[lane], branch.first.wrapping_add(block.triangles[lane]));
                let found = Nearest { t, triangle, slot: number * 4 + lane as u32, item: branch.item };
                let is_nearer = t < nearest.t || (t == nearest.t && triangle < nearest.triangle);
                if is_nearer && (block.masked >> lane & 1 == 0 || is_there(&found)) {
                    *nearest = found;
                    if any {
                        return;
                    }
                }
            }
        }
    }
}

/// The nearest hit; of several at the same t, the one with the smallest number. `is_there` has the
/// last word about triangles with a mask. With `any`, some hit.
#[inline(always)]
pub(super) fn trace<F8: Lanes<8>, F4: Lanes<4>>(
    bvh: &Bvh,
    ray: &ShortRay,
    masks: Option<&Masks>,
    any: bool,
    is_there: &impl Fn(&Nearest) -> bool,
) -> Option<Nearest> {
    let branch = Branch::world(bvh, masks)?;
    let mut nearest = Nearest::none(ray.t_max);
    Prepared::<F8, F4>::new(ray).descend::<true>(bvh, branch, ray, &mut nearest, any, is_there);
    nearest.is_some().then_some(nearest)
}
