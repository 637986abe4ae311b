//! Up to 64 rays from one origin through the hierarchy at once.
//!
//! In: rays that share their origin and point roughly the same way. Out: what
//! [`single::trace`](super::single::trace) gives for each, bit by bit.
//!
//! All rays lie in a thin pyramid around the dominant axis k of their mean direction: with p the
//! position relative to the origin, depth = |p_k| and slopes u = p_i / depth, v = p_j / depth
//! within the rays' extremes. A node costs one test of that pyramid against eight boxes, whatever
//! the number of rays (frustum traversal after Reshetov et al. 2005). A triangle is tested against
//! the pyramid, then against the slopes of groups of eight rays, and only groups that it may cover
//! compute hits: small triangles cost one or two groups, like in a tiled rasterizer.
//!
//! Slopes are widened by [`SLOPE_SLACK`] so that rounding never drops a box or triangle that a ray
//! touches.

use super::{
    bvh::{Bvh, EMPTY, ITEM, LEAF},
    cell_set::Masks,
    lanes::Lanes,
    single::{Branch, DISTANCE_SLACK, Nearest, Stack, side},
    triangles::{Rays, Triangles, Vec3L, axes_of, intersect, load3, map3, relative_corners, splat3},
};

/// Most rays in a packet.
pub(super) const PACKET: usize = 64;
/// Groups of eight.
const GROUPS: usize = PACKET / 8;
/// Slopes are widened by this much, relative and absolute: f32 slopes and products err by some
/// 3e-7.
const SLOPE_SLACK: f32 = 2e-6;
/// Widest pyramid, as a slope: in a wider one rays share too little. Eight pixels of a 60-degree
/// view, 1280 wide, are 0.007.
const MAX_SLOPE_SPREAD: f32 = 0.06;
/// Fewer rays than this go one by one.
const MIN_RAYS: usize = 8;

/// Rays from one origin, relative to the scene's middle, in groups of eight; groups that are not
/// full repeat the last ray.
pub(super) struct Packet {
    pub origin: [f32; 3],
    /// Dominant axis, and the two others.
    axes: [usize; 3],
    /// Sign of the direction along the dominant axis.
    sign: f32,
    direction: [[[f32; 8]; 3]; GROUPS],
    /// Slopes as the triangle test takes them: d_i / d_k and d_j / d_k.
    ray_slopes: [[[f32; 8]; 2]; GROUPS],
    t_min: [[f32; 8]; GROUPS],
    nearest_t: [[f32; 8]; GROUPS],
    nearest: [Nearest; PACKET],
    /// |direction| along the dominant axis: depth per t.
    depth_per_t: [[f32; 8]; GROUPS],
    /// Of every group: least and greatest depth at which a hit matters to some of its rays, with
    /// room for rounding.
    group_depths: [[f32; 8]; 2],
    /// Least depth at which a hit matters to some ray, with room for rounding.
    start: f32,
    /// Of every group: least u, greatest u, least v, greatest v, widened.
    group_slopes: [[f32; 8]; 4],
    /// The same of the whole packet.
    slopes: [f32; 4],
    count: usize,
    /// Rays end at their first hit, nearest or not.
    any: bool,
}

#[inline(always)]
fn least<F4: Lanes<4>>(x: [F4; 3]) -> F4 {
    x[0].min(x[1]).min(x[2])
}

#[inline(always)]
fn greatest<F4: Lanes<4>>(x: [F4; 3]) -> F4 {
    x[0].max(x[1]).max(x[2])
}

/// A plane of a box as a limit of depth: `(plane - origin) * inverse`, the least depth if the
/// plane is entered, else the greatest.
struct Side {
    plane: usize,
    axis: usize,
    inverse: f32,
    is_entered: bool,
}

/// A ray of a packet: direction, t_min, t_max.
pub(super) type PacketRay = ([f32; 3], f32, f32);

impl Packet {
    /// A packet of these rays, which look for their nearest hits or for `any`, or None if they are
    /// too few or too different to gain from it.
    #[inline(always)]
    pub fn new(origin: [f32; 3], rays: &[PacketRay], any: bool) -> Option<Self> {
        if rays.len() < MIN_RAYS || rays.len() > PACKET {
            return None;
        }
        let mut sum = [0.0f32; 3];
        for (d, ..) in rays {
            let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            for (s, x) in sum.iter_mut().zip(d) {
                *s += x / length;
            }
        }
        let axes = axes_of(sum);
        let [k, i, j] = axes;
        let sign = 1.0f32.copysign(sum[k]);
        let mut packet = Self {
            origin,
            axes,
            sign,
            direction: [[[0.0; 8]; 3]; GROUPS],
            ray_slopes: [[[0.0; 8]; 2]; GROUPS],
            t_min: [[0.0; 8]; GROUPS],
            nearest_t: [[0.0; 8]; GROUPS],
            nearest: [Nearest::none(0.0); PACKET],
            depth_per_t: [[0.0; 8]; GROUPS],
            group_depths: [[f32::INFINITY; 8], [f32::NEG_INFINITY; 8]],
            start: f32::INFINITY,
            group_slopes: [[f32::INFINITY; 8], [f32::NEG_INFINITY; 8], [f32::INFINITY; 8], [f32::NEG_INFINITY; 8]],
            slopes: [f32::INFINITY, f32::NEG_INFINITY, f32::INFINITY, f32::NEG_INFINITY],
            count: rays.len(),
            any,
        };
        for slot in 0..rays.len().next_multiple_of(8) {
            let (g, lane) = (slot / 8, slot % 8);
            let (d, t_min, t_max) = rays[slot.min(rays.len() - 1)];
            let depth = d[k] * sign;
            // Every ray must have the packet's dominant axis, as it has when it goes alone. Also
            // refuses NaN.
            if !(depth > 0.0 && d[i].abs() < depth && d[j].abs() < depth) {
                return None;
            }
            let (u, v) = (d[i] / depth, d[j] / depth);
            packet.ray_slopes[g][0][lane] = u * sign;
            packet.ray_slopes[g][1][lane] = v * sign;
            for (of_axis, x) in packet.direction[g].iter_mut().zip(d) {
                of_axis[lane] = x;
            }
            packet.t_min[g][lane] = t_min;
            packet.nearest_t[g][lane] = t_max;
            packet.depth_per_t[g][lane] = depth;
            let s = &mut packet.group_slopes;
            s[0][g] = s[0][g].min(u);
            s[1][g] = s[1][g].max(u);
            s[2][g] = s[2][g].min(v);
            s[3][g] = s[3][g].max(v);
            let start = t_min * depth * (1.0 - DISTANCE_SLACK);
            packet.group_depths[0][g] = packet.group_depths[0][g].min(start);
            packet.start = packet.start.min(start);
        }
        for (side, of_groups) in packet.group_slopes.iter_mut().enumerate() {
            for s in of_groups.iter_mut().filter(|s| s.is_finite()) {
                let slack = SLOPE_SLACK * (1.0 + s.abs());
                let whole = &mut packet.slopes[side];
                if side % 2 == 0 {
                    *s -= slack;
                    *whole = whole.min(*s);
                } else {
                    *s += slack;
                    *whole = whole.max(*s);
                }
            }
        }
        let spread = (packet.slopes[1] - packet.slopes[0]).max(packet.slopes[3] - packet.slopes[2]);
        (spread <= MAX_SLOPE_SPREAD).then_some(packet)
    }

    /// What ray number `i` hit.
    #[inline(always)]
    pub fn nearest(&self, i: usize) -> Option<Nearest> {
        self.nearest[i].is_some().then_some(self.nearest[i])
    }

    /// The six planes of a box as limits of depth. On the slope's axis a box from `low` to `high`
    /// needs `u_max * depth >= low` and `u_min * depth <= high` for some ray to be in it at that
    /// depth; divided by the slope, either is a least or a greatest depth, by its sign. Together
    /// they are at least as tight as the four sides of the pyramid.
    fn sides(&self) -> [Side; 6] {
        let [k, i, j] = self.axes;
        let [u_min, u_max, v_min, v_max] = self.slopes.map(|s| 1.0 / s);
        let lower = |axis, inverse: f32| Side { plane: axis, axis, inverse, is_entered: inverse > 0.0 };
        let upper = |axis, inverse: f32| Side { plane: axis + 3, axis, inverse, is_entered: inverse < 0.0 };
        [lower(k, self.sign), upper(k, self.sign), lower(i, u_max), upper(i, u_min), lower(j, v_max), upper(j, v_min)]
    }

    fn groups(&self) -> usize {
        self.count.div_ceil(8)
    }

    /// Greatest depth at which a hit still matters to some ray, with room for rounding; looks anew
    /// at some groups.
    #[inline(always)]
    fn reach<F8: Lanes<8>>(&mut self, mut groups: u32) -> f32 {
        while groups != 0 {
            let g = groups.trailing_zeros() as usize & 7;
            groups &= groups - 1;
            let mut depths = [0.0; 8];
            F8::load(&self.nearest_t[g]).mul(F8::load(&self.depth_per_t[g])).store(&mut depths);
            let greatest = depths.into_iter().fold(f32::NEG_INFINITY, f32::max);
            self.group_depths[1][g] = greatest * (1.0 + DISTANCE_SLACK);
        }
        self.group_depths[1].into_iter().fold(0.0, f32::max)
    }

    /// Finds the hits; `is_there(ray, hit)` has the last word about triangles with a mask.
    #[inline(always)]
    pub fn trace<F8: Lanes<8>, F4: Lanes<4>>(
        &mut self,
        bvh: &Bvh,
        masks: Option<&Masks>,
        is_there: &impl Fn(usize, &Nearest) -> bool,
    ) {
        let Some(branch) = Branch::world(bvh, masks) else { return };
        let reach = self.reach::<F8>((1 << self.groups()) - 1);
        self.descend::<F8, F4, true>(bvh, branch, reach, is_there);
    }

    /// Looks for nearer hits in a hierarchy, with `ITEMS` in the items that it holds, too; `reach`
    /// is the greatest depth at which one matters, before and after.
    #[inline(always)]
    fn descend<F8: Lanes<8>, F4: Lanes<4>, const ITEMS: bool>(
        &mut self,
        bvh: &Bvh,
        branch: Branch<'_>,
        mut reach: f32,
        is_there: &impl Fn(usize, &Nearest) -> bool,
    ) -> f32 {
        let origin: Vec3L<F8> = splat3(self.origin);
        let sides = self.sides();
        let (nearer, farther) = (F8::splat(1.0 - DISTANCE_SLACK), F8::splat(1.0 + DISTANCE_SLACK));
        let start = F8::splat(self.start.max(0.0));
        let mut stack = Stack::new();
        stack.push(0.0, branch.root);
        while let Some((distance, child)) = stack.pop() {
            if distance > reach {
                continue;
            }
            if child & LEAF == 0 {
                let (node, present) = branch.node(child);
                let placed = if ITEMS { None } else { branch.placed::<F8>(node) };
                let (mut enter, mut leave) = (start, F8::splat(reach));
                for s in &sides {
                    let plane = side(node, &placed, s.plane);
                    let depth = plane.sub(origin[s.axis]).mul(F8::splat(s.inverse));
                    if s.is_entered {
                        // Of a NaN (a plane through the origin, a slope of 0) and a number, these
                        // keep the number.
                        enter = depth.mul(nearer).max(enter);
                    } else {
                        leave = depth.mul(farther).min(leave);
                    }
                }
                let bits = F8::bits(enter.le(leave)) & present;
                if bits != 0 {
                    let mut distances = [0.0; 8];
                    enter.store(&mut distances);
                    stack.push_sorted(bits, &distances, &node.children);
                }
            } else if child == EMPTY {
            } else if ITEMS && child & ITEM != 0 {
                let item = Branch::of_item(bvh, child & !(LEAF | ITEM));
                reach = self.descend::<F8, F4, false>(bvh, item, reach, is_there);
            } else {
                let improved = self.block::<F8, F4, ITEMS>(&branch, child & !LEAF, reach, is_there);
                if improved != 0 {
                    reach = self.reach::<F8>(improved);
                }
            }
        }
        reach
    }

    /// Tests a block's triangles against all rays; bits of the groups with a nearer hit than
    /// before.
    #[inline(always)]
    fn block<F8: Lanes<8>, F4: Lanes<4>, const ITEMS: bool>(
        &mut self,
        branch: &Branch<'_>,
        number: u32,
        reach: f32,
        is_there: &impl Fn(usize, &Nearest) -> bool,
    ) -> u32 {
        let (block, lanes) = branch.block(number);
        let place = if ITEMS { None } else { branch.place };
        let corners: [Vec3L<F4>; 3] = relative_corners(block, place, self.origin);
        let (mut bits, ranges) = self.cover(corners, reach);
        bits &= lanes;
        if bits == 0 {
            return 0;
        }
        let four = Triangles::new(block, place, corners);
        let mut stored = [[0.0f32; 4]; 13];
        for k in 0..3 {
            four.corners[0][k].store(&mut stored[k]);
            four.corners[1][k].store(&mut stored[3 + k]);
            four.corners[2][k].store(&mut stored[6 + k]);
            four.normal[k].store(&mut stored[9 + k]);
        }
        four.distance.store(&mut stored[12]);
        let mut improved = 0;
        while bits != 0 {
            let lane = bits.trailing_zeros() as usize & 3;
            bits &= bits - 1;
            let of_lane = |n: usize| splat3([stored[n][lane], stored[n + 1][lane], stored[n + 2][lane]]);
            let one = Triangles {
                corners: [of_lane(0), of_lane(3), of_lane(6)],
                normal: of_lane(9),
                distance: F8::splat(stored[12][lane]),
            };
            let (triangle, slot) = (branch.first.wrapping_add(block.triangles[lane]), number * 4 + lane as u32);
            let is_masked = block.masked >> lane & 1 == 1;
            let mut groups = self.groups_over::<F8>(&ranges, lane);
            while groups != 0 {
                let g = groups.trailing_zeros() as usize & 7;
                groups &= groups - 1;
                let rays = Rays {
                    direction: load3(&self.direction[g]),
                    slopes: [F8::load(&self.ray_slopes[g][0]), F8::load(&self.ray_slopes[g][1])],
                    t_min: F8::load(&self.t_min[g]),
                    t_max: F8::load(&self.nearest_t[g]),
                };
                let (mut hits, t) = intersect(self.axes, &one, &rays);
                if hits == 0 {
                    continue;
                }
                let mut ts = [0.0; 8];
                t.store(&mut ts);
                while hits != 0 {
                    let ray = hits.trailing_zeros() as usize & 7;
                    hits &= hits - 1;
                    let nearest = &mut self.nearest[g * 8 + ray];
                    let nearest_t = &mut self.nearest_t[g][ray];
                    let t = ts[ray];
                    let is_nearer = t < *nearest_t || (t == *nearest_t && triangle < nearest.triangle);
                    let found = Nearest { t, triangle, slot, item: branch.item };
                    if is_nearer && (!is_masked || is_there(g * 8 + ray, &found)) {
                        // Nothing is nearer than that.
                        *nearest_t = if self.any { f32::NEG_INFINITY } else { t };
                        *nearest = found;
                        improved |= 1 << g;
                    }
                }
            }
        }
        improved
    }

    /// Bits of the groups whose slopes and depths meet those of one lane.
    #[inline(always)]
    fn groups_over<F8: Lanes<8>>(&self, ranges: &[[f32; 4]; 6], lane: usize) -> u32 {
        let [u_min, u_max, v_min, v_max] = &self.group_slopes;
        let [from, to] = &self.group_depths;
        let u = F8::and(F8::load(u_min).le(F8::splat(ranges[1][lane])), F8::splat(ranges[0][lane]).le(F8::load(u_max)));
        let v = F8::and(F8::load(v_min).le(F8::splat(ranges[3][lane])), F8::splat(ranges[2][lane]).le(F8::load(v_max)));
        let depth = F8::and(F8::load(from).le(F8::splat(ranges[5][lane])), F8::splat(ranges[4][lane]).le(F8::load(to)));
        F8::bits(F8::and(F8::and(u, v), depth))
    }

    /// Bits of the triangles that may touch the pyramid within reach, and their ranges of slopes
    /// and depths.
    #[inline(always)]
    fn cover<F4: Lanes<4>>(&self, corners: [Vec3L<F4>; 3], reach: f32) -> (u32, [[f32; 4]; 6]) {
        let [k, i, j] = self.axes;
        let sign = F4::splat(self.sign);
        let depth = map3(corners, |p| p[k].mul(sign));
        let (p_i, p_j) = (map3(corners, |p| p[i]), map3(corners, |p| p[j]));
        let zero = F4::splat(0.0);
        // A triangle outside one side of the pyramid has all its corners there.
        let beyond = |p: [F4; 3], slope: f32| -> [F4; 3] {
            let slope = F4::splat(slope);
            [p[0].sub(depth[0].mul(slope)), p[1].sub(depth[1].mul(slope)), p[2].sub(depth[2].mul(slope))]
        };
        let [u_min, u_max, v_min, v_max] = self.slopes;
        let near = least(depth);
        let (from, to) =
            (near.mul(F4::splat(1.0 - DISTANCE_SLACK)), greatest(depth).mul(F4::splat(1.0 + DISTANCE_SLACK)));
        let mut may = F4::and(F4::splat(self.start.max(0.0)).le(to), from.le(F4::splat(reach)));
        may = F4::and(may, F4::and(zero.le(greatest(beyond(p_i, u_min))), least(beyond(p_i, u_max)).le(zero)));
        may = F4::and(may, F4::and(zero.le(greatest(beyond(p_j, v_min))), least(beyond(p_j, v_max)).le(zero)));
        let bits = F4::bits(may);
        let mut ranges = [[0.0; 4]; 6];
        if bits != 0 {
            // Corners at or behind the origin have no slope: such triangles may cover every group.
            let mut nears = [0.0; 4];
            near.store(&mut nears);
            let of = |p: [F4; 3]| -> [F4; 3] { [p[0].div(depth[0]), p[1].div(depth[1]), p[2].div(depth[2])] };
            let (u, v) = (of(p_i), of(p_j));
            least(u).store(&mut ranges[0]);
            greatest(u).store(&mut ranges[1]);
            least(v).store(&mut ranges[2]);
            greatest(v).store(&mut ranges[3]);
            from.store(&mut ranges[4]);
            to.store(&mut ranges[5]);
            for (lane, near) in nears.into_iter().enumerate() {
                // Too near, a corner's slope is mostly rounding error.
                const MIN_DEPTH_M: f32 = 1e-3;
                for (side, range) in ranges[..4].iter_mut().enumerate() {
                    let slack = SLOPE_SLACK * (1.0 + range[lane].abs());
                    let outward = if side % 2 == 0 { -1.0 } else { 1.0 };
                    range[lane] =
                        if near > MIN_DEPTH_M { range[lane] + outward * slack } else { outward * f32::INFINITY };
                }
            }
        }
        (bits, ranges)
    }
}
