//! Who may use a grid point, and does every eye have one? A certificate by interval subdivision
//! (row A3, DESIGN "Near and far").
//!
//! In: the walk volume as a tree of boxes, the grid points, the directions. Out: for each grid
//! point and each unit of directions (pitch band times yaw bin), a convex region that holds every
//! eye for which `select` may return the point, and the largest distance of such an eye. The paper
//! bounds users by spheres around the grid points; those are not conservative in three dimensions
//! and, on a mixed-level grid, far from tight.
//!
//! For a box of eyes and a bin of directions let U be the smallest, over the points that lie in
//! every reverse frustum, of the largest distance to an eye of the box. `select` takes the closest
//! point, so it takes one within U: every point that lies in some reverse frustum and comes within
//! U is recorded, and no other can be returned. Without a point in every reverse frustum, boxes
//! and bins are halved until there is one; if there is none at the finest, the eye is reported as
//! not covered. Halving also stops where a box adds nothing to the regions found so far, so that
//! only the outlines of the regions are resolved finely.

use super::{
    bands::Directions,
    bin_planes::{Behind, BinPlanes},
    eye_tree::{EyeTree, longest_axis},
    hull::EyeHull,
};
use glam::DVec3;
use ldi_protocol::Aabb;
use rayon::prelude::*;

/// Boxes of eyes are halved down to this half size, as a share of U. Larger: regions of users
/// grow, images move away, more points; smaller: longer planning.
const FINEST_BOX: f64 = 1.0 / 14.0;
/// Bins are halved at most this often in yaw and in pitch (15 x 10 degrees become 3.75 x 5).
const FINEST_BIN: [u32; 2] = [2, 1];
/// Where no point is certain, halving goes on this many times beyond the limits above.
const LAST_RESORT: u32 = 18;

/// The eyes that may use a point.
#[derive(Debug, Clone, Default)]
pub(super) struct PointUses {
    /// By unit of directions, ascending.
    pub units: Vec<(u16, EyeHull)>,
    /// No eye farther than this selects the point, metres.
    pub radius: f64,
}

/// An eye without a grid point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gap {
    /// Where.
    pub position: DVec3,
    /// Looking where: yaw, pitch, degrees.
    pub direction_deg: [f64; 2],
}

/// What a block of the volume contributes.
#[derive(Debug, Clone, Default)]
struct BlockUses {
    /// The points that were looked at, ascending: while they stay the same, so does the result.
    candidates: Vec<u32>,
    /// Point, unit, region, largest distance.
    uses: Vec<(u32, u16, EyeHull, f64)>,
    boxes: u64,
}

/// The certificate, kept from round to round: points are only ever added, and blocks that no new
/// point can serve keep their part.
pub(super) struct Coverage<'a> {
    tree: &'a EyeTree,
    directions: &'a Directions,
    bins: Vec<Vec<BinPlanes>>,
    blocks: Vec<(u32, BlockUses)>,
}

impl<'a> Coverage<'a> {
    /// Prepares for a square frustum of half tangent `t`. `block_m`: size of the blocks worked on
    /// as one.
    pub fn new(tree: &'a EyeTree, directions: &'a Directions, t: f64, block_m: f64) -> Self {
        let bins = (0..directions.units()).map(|u| sub_bins(directions, u, t)).collect();
        let blocks = tree.blocks(block_m).into_iter().map(|b| (b, BlockUses::default())).collect();
        Self { tree, directions, bins, blocks }
    }

    /// Boxes in the certificate so far.
    pub fn boxes(&self) -> u64 {
        self.blocks.iter().map(|b| b.1.boxes).sum()
    }

    /// Certifies the volume for these points; users per point.
    pub fn certify(&mut self, points: &[DVec3]) -> Result<Vec<PointUses>, Gap> {
        let (tree, directions, bins) = (self.tree, self.directions, &self.bins);
        let fresh: Vec<Option<Result<BlockUses, Gap>>> = self
            .blocks
            .par_iter()
            .map(|(node, old)| {
                let mut work = Block::new(tree, directions, bins, points);
                let starts = work.starts(*node);
                (old.boxes == 0 || work.candidates != old.candidates).then(|| work.run(*node, starts))
            })
            .collect();
        for (block, new) in self.blocks.iter_mut().zip(fresh) {
            if let Some(new) = new {
                block.1 = new?;
            }
        }
        let mut by_point: Vec<Vec<(u16, EyeHull)>> = vec![Vec::new(); points.len()];
        let mut radius = vec![0.0f64; points.len()];
        for (_, block) in &self.blocks {
            for (point, unit, hull, far) in &block.uses {
                by_point[*point as usize].push((*unit, *hull));
                radius[*point as usize] = radius[*point as usize].max(*far);
            }
        }
        Ok(by_point
            .into_iter()
            .zip(radius)
            .map(|(mut list, radius)| {
                list.sort_by_key(|u| u.0);
                let mut units: Vec<(u16, EyeHull)> = Vec::new();
                for (unit, hull) in list {
                    match units.last_mut() {
                        Some(last) if last.0 == unit => last.1.union(&hull),
                        _ => units.push((unit, hull)),
                    }
                }
                PointUses { units, radius }
            })
            .collect())
    }
}

/// The bins of a unit as a binary tree in an array: entry 0 the unit, children of i at 2 i + 1 and
/// 2 i + 2.
fn sub_bins(directions: &Directions, unit: usize, t: f64) -> Vec<BinPlanes> {
    let levels = FINEST_BIN[0] + FINEST_BIN[1];
    let (yaw, pitch) = directions.unit(unit);
    let mut ranges = vec![(yaw, pitch, FINEST_BIN)];
    let mut at = 0;
    while ranges.len() < (2 << levels) - 1 {
        let (yaw, pitch, left) = ranges[at];
        at += 1;
        let half = |r: [f64; 2]| (r[0] + r[1]) * 0.5;
        let across = left[1] == 0 || (left[0] > 0 && yaw[1] - yaw[0] >= pitch[1] - pitch[0]);
        if across {
            let m = half(yaw);
            let left = [left[0].saturating_sub(1), left[1]];
            ranges.extend([([yaw[0], m], pitch, left), ([m, yaw[1]], pitch, left)]);
        } else {
            let m = half(pitch);
            let left = [left[0], left[1] - 1];
            ranges.extend([(yaw, [pitch[0], m], left), (yaw, [m, pitch[1]], left)]);
        }
    }
    ranges.into_iter().map(|(y, p, _)| BinPlanes::new(y, p, t, t)).collect()
}

/// Eyes: a node of the tree, or a part of a single box.
#[derive(Clone, Copy)]
struct Eyes {
    bounds: Aabb,
    node: Option<u32>,
}

/// Work on one block.
struct Block<'a> {
    tree: &'a EyeTree,
    directions: &'a Directions,
    bins: &'a [Vec<BinPlanes>],
    points: &'a [DVec3],
    candidates: Vec<u32>,
    /// Per point its region in the unit at work, or u32::MAX.
    slot: Vec<u32>,
    found: Vec<(u32, EyeHull, f64)>,
    /// Candidate lists of the recursion, stacked.
    stack: Vec<u32>,
    boxes: u64,
}

impl<'a> Block<'a> {
    fn new(tree: &'a EyeTree, directions: &'a Directions, bins: &'a [Vec<BinPlanes>], points: &'a [DVec3]) -> Self {
        let slot = Vec::new();
        Self {
            tree,
            directions,
            bins,
            points,
            candidates: Vec::new(),
            slot,
            found: Vec::new(),
            stack: Vec::new(),
            boxes: 0,
        }
    }

    /// The points that may serve each unit somewhere in the block, and their union in `candidates`.
    fn starts(&mut self, node: u32) -> Vec<Vec<u32>> {
        let bounds = self.tree.nodes[node as usize].bounds;
        let (middle, half) = (bounds.centre(), bounds.size() * 0.5);
        let mut order: Vec<(f64, u32)> =
            self.points.iter().enumerate().map(|(i, p)| (bounds.distance(*p), i as u32)).collect();
        order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut used = vec![false; self.points.len()];
        let lists: Vec<Vec<u32>> = self
            .bins
            .iter()
            .map(|bins| {
                let (mut list, mut bound) = (Vec::new(), f64::INFINITY);
                for &(near, i) in &order {
                    if near > bound {
                        break;
                    }
                    let g = self.points[i as usize];
                    let far = bounds.max_distance(g);
                    match bins[0].behind(middle - g, half, far) {
                        Behind::Never => continue,
                        Behind::Always => bound = bound.min(far),
                        Behind::Maybe => {}
                    }
                    list.push(i);
                }
                // Points found before the bound fell may lie beyond it.
                list.retain(|i| bounds.distance(self.points[*i as usize]) <= bound);
                list.iter().for_each(|i| used[*i as usize] = true);
                list
            })
            .collect();
        self.candidates = (0..self.points.len() as u32).filter(|i| used[*i as usize]).collect();
        lists
    }

    fn run(mut self, node: u32, starts: Vec<Vec<u32>>) -> Result<BlockUses, Gap> {
        self.slot = vec![u32::MAX; self.points.len()];
        let eyes = Eyes { bounds: self.tree.nodes[node as usize].bounds, node: Some(node) };
        let mut uses = Vec::new();
        for (unit, start) in starts.into_iter().enumerate() {
            self.stack.clear();
            self.stack.extend_from_slice(&start);
            self.visit(eyes, unit, 0, 0, start.len(), 0)?;
            for (point, hull, far) in self.found.drain(..) {
                self.slot[point as usize] = u32::MAX;
                uses.push((point, unit as u16, hull, far));
            }
        }
        Ok(BlockUses { candidates: self.candidates, uses, boxes: self.boxes.max(1) })
    }

    /// Resolves eyes and the bin `bin` of a unit, for the candidates `stack[from..to]`.
    fn visit(&mut self, eyes: Eyes, unit: usize, bin: usize, from: usize, to: usize, extra: u32) -> Result<(), Gap> {
        self.boxes += 1;
        let planes = self.bins[unit][bin];
        let (middle, half) = (eyes.bounds.centre(), eyes.bounds.size() * 0.5);
        let mark = self.stack.len();
        let mut bound = f64::INFINITY;
        for at in from..to {
            let i = self.stack[at];
            let g = self.points[i as usize];
            if eyes.bounds.distance(g) > bound {
                continue;
            }
            let far = eyes.bounds.max_distance(g);
            match planes.behind(middle - g, half, far) {
                Behind::Never => continue,
                Behind::Always => bound = bound.min(far),
                Behind::Maybe => {}
            }
            self.stack.push(i);
        }
        let mut end = mark;
        let mut known = bound.is_finite();
        for at in mark..self.stack.len() {
            let i = self.stack[at];
            if eyes.bounds.distance(self.points[i as usize]) <= bound + 1e-9 {
                self.stack[end] = i;
                end += 1;
                let slot = self.slot[i as usize];
                known = known && slot != u32::MAX && {
                    let (_, hull, far) = &self.found[slot as usize];
                    hull.contains(&eyes.bounds, 0.0)
                        && eyes.bounds.max_distance(self.points[i as usize]).min(bound) <= *far
                };
            }
        }
        self.stack.truncate(end);
        let result = if known {
            Ok(())
        } else if bound.is_finite() && end == mark + 1 {
            // One point is left, and it is certain: the record is exact.
            self.record(&eyes.bounds, mark, end, bound);
            Ok(())
        } else {
            self.split(eyes, unit, bin, mark, end, extra, bound)
        };
        self.stack.truncate(mark);
        result
    }

    #[allow(clippy::too_many_arguments, reason = "the state of one recursion")]
    fn split(
        &mut self,
        eyes: Eyes,
        unit: usize,
        bin: usize,
        from: usize,
        to: usize,
        extra: u32,
        bound: f64,
    ) -> Result<(), Gap> {
        let (half_yaw, half_pitch) = self.bins[unit][bin].half_widths();
        let size = eyes.bounds.size();
        let near = (from..to)
            .map(|at| eyes.bounds.distance(self.points[self.stack[at] as usize]))
            .fold(f64::INFINITY, f64::min);
        let scale = if bound.is_finite() { bound } else { near.max(0.25) };
        let half = size.max_element() * 0.5;
        let box_open = half > scale * FINEST_BOX;
        let bin_open = 2 * bin + 2 < self.bins[unit].len();
        let forced = !box_open && !bin_open;
        if forced && bound.is_finite() {
            self.record(&eyes.bounds, from, to, bound);
            return Ok(());
        }
        if to == from || (forced && extra >= LAST_RESORT) {
            let (yaw, pitch) = self.directions.unit(unit);
            return Err(Gap {
                position: eyes.bounds.centre(),
                direction_deg: [(yaw[0] + yaw[1]) * 0.5, (pitch[0] + pitch[1]) * 0.5],
            });
        }
        let extra = extra + u32::from(forced);
        if bin_open && (!box_open || half / scale < half_yaw.max(half_pitch)) {
            for child in [2 * bin + 1, 2 * bin + 2] {
                self.visit(eyes, unit, child, from, to, extra)?;
            }
            return Ok(());
        }
        if let Some(children) = eyes.node.and_then(|n| self.tree.nodes[n as usize].children) {
            for n in children {
                let part = Eyes { bounds: self.tree.nodes[n as usize].bounds, node: Some(n) };
                self.visit(part, unit, bin, from, to, extra)?;
            }
            return Ok(());
        }
        let axis = longest_axis(size);
        let (mut low, mut high) = (eyes.bounds, eyes.bounds);
        low.max[axis] = eyes.bounds.centre()[axis];
        high.min[axis] = low.max[axis];
        for bounds in [low, high] {
            self.visit(Eyes { bounds, node: None }, unit, bin, from, to, extra)?;
        }
        Ok(())
    }

    /// Records a box of eyes for the candidates `stack[from..to]`.
    fn record(&mut self, bounds: &Aabb, from: usize, to: usize, bound: f64) {
        for at in from..to {
            let i = self.stack[at];
            let slot = &mut self.slot[i as usize];
            if *slot == u32::MAX {
                *slot = self.found.len() as u32;
                self.found.push((i, EyeHull::EMPTY, 0.0));
            }
            let (_, hull, far) = &mut self.found[*slot as usize];
            hull.add(bounds);
            *far = far.max(bounds.max_distance(self.points[i as usize]).min(bound));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::{lattice::Lattice, test_scenes::Random};
    use ldi_protocol::{ViewBasis, volume::WalkVolume};

    const T: f64 = 0.577_350_269_189_625_8;

    /// The point that `select` returns: closest in the reverse frustum, ties to the smaller number.
    fn selected(points: &[DVec3], eye: DVec3, basis: &ViewBasis) -> Option<usize> {
        let behind = |g: &DVec3| {
            let w = eye - *g;
            let z = w.dot(basis.forward);
            z >= 0.0 && w.dot(basis.right).abs() <= T * z && w.dot(basis.up).abs() <= T * z
        };
        (0..points.len())
            .filter(|i| behind(&points[*i]))
            .min_by(|a, b| points[*a].distance_squared(eye).total_cmp(&points[*b].distance_squared(eye)))
    }

    #[test]
    fn the_certified_users_hold_every_eye_that_selects_the_point() {
        let model = Aabb { min: DVec3::ZERO, max: DVec3::new(8.0, 4.0, 8.0) };
        let mut lattice = Lattice::new(&model, 4.0);
        lattice.subdivide(150, true);
        lattice.subdivide(171, true);
        let points: Vec<DVec3> = (0..lattice.points.len()).map(|i| lattice.position(i)).collect();
        let runs: Vec<Vec<[u16; 2]>> =
            (0..64u16).map(|c| if c % 5 == 0 { vec![] } else { vec![[8, 17 + c % 3]] }).collect();
        let volume = WalkVolume::new(DVec3::ZERO, 1.0, 0.1, [8, 8], &runs, &model).unwrap();
        let (tree, directions) = (EyeTree::new(&volume), Directions::new(60.0));
        let mut coverage = Coverage::new(&tree, &directions, T, 4.0);
        let uses = coverage.certify(&points).unwrap();
        let (sampler, mut random) = (volume.sampler(), Random::new(7));
        let mut largest = 0.0f64;
        for _ in 0..20_000 {
            let eye = sampler.point(std::array::from_fn(|_| random.unit())).unwrap();
            let (yaw, pitch) = (random.unit() * 360.0, random.unit() * 120.0 - 60.0);
            let g = selected(&points, eye, &ViewBasis::from_yaw_pitch(yaw, pitch)).expect("covered");
            let band = ((pitch + 60.0) / 10.0) as usize;
            let unit =
                (band * super::super::bands::YAW_BINS + (yaw / super::super::bands::YAW_BIN_DEG) as usize) as u16;
            let (_, hull) = uses[g].units.iter().find(|u| u.0 == unit).expect("the unit is in use");
            assert!(hull.contains(&Aabb { min: eye, max: eye }, 1e-9));
            assert!(eye.distance(points[g]) <= uses[g].radius);
            largest = largest.max(eye.distance(points[g]));
        }
        // Tightness: certified radii stay near the largest distances met.
        let certified = uses.iter().map(|u| u.radius).fold(0.0, f64::max);
        assert!(certified < 1.35 * largest, "certified {certified}, met {largest}");
    }

    #[test]
    fn an_eye_without_a_point_behind_it_is_reported() {
        let volume = WalkVolume::of_box(&Aabb { min: DVec3::ZERO, max: DVec3::ONE }).unwrap();
        let (tree, directions) = (EyeTree::new(&volume), Directions::new(0.0));
        let points = vec![DVec3::new(0.5, 0.5, 5.0)];
        assert!(
            Coverage::new(&tree, &directions, T, 4.0).certify(&points).is_err(),
            "nothing behind an eye that looks along +Z"
        );
    }

    #[test]
    fn a_second_round_equals_starting_afresh() {
        let model = Aabb { min: DVec3::ZERO, max: DVec3::new(8.0, 4.0, 8.0) };
        let mut lattice = Lattice::new(&model, 4.0);
        let volume =
            WalkVolume::of_box(&Aabb { min: DVec3::new(0.0, 1.0, 0.0), max: DVec3::new(8.0, 2.0, 8.0) }).unwrap();
        let (tree, directions) = (EyeTree::new(&volume), Directions::new(0.0));
        let positions = |l: &Lattice| (0..l.points.len()).map(|i| l.position(i)).collect::<Vec<_>>();
        let mut coverage = Coverage::new(&tree, &directions, T, 4.0);
        coverage.certify(&positions(&lattice)).unwrap();
        lattice.subdivide(171, true);
        let again = coverage.certify(&positions(&lattice)).unwrap();
        let fresh = Coverage::new(&tree, &directions, T, 4.0).certify(&positions(&lattice)).unwrap();
        for (a, b) in again.iter().zip(&fresh) {
            assert_eq!((a.radius, &a.units), (b.radius, &b.units));
        }
    }
}
