//! An octree over an image's samples, after a proposal to cull hidden samples of LDIs by an octree.
//! Used by `ldi-bench occlusion` to measure its gain and losses.
//!
//! In: a decoded [`Ldi`], a pose. Out: its samples by nodes in front-to-back order, without those
//! that an occlusion buffer considers hidden.
//!
//! **Theory.** A node is a box of columns, rows and disparities; it is halved along all three axes
//! until it holds few samples or is small. Occlusion-compatible order draws back to front, away
//! from or toward the epipole, deeper samples first; its inverse is front to back. Of a node's
//! children those in the quadrant of columns and rows nearest to the eye are visited first, and
//! within a quadrant the nearer in disparity; quadrants next to the epipole's column and row, where
//! the sheets meet, come first or last as wholes. Warped samples make their pixel opaque in the
//! occlusion buffer, and add decreasing weights to pixels within their splat; a node is considered
//! hidden if the rectangle around its eight warped corners is opaque.
//!
//! The proposal leaves open: sizes of splats (here a square of a sample's width at its depth,
//! weights falling linearly), the sum of weights (here at most 1), and when to stop. It accepts two
//! faults: the order fails where a large node lies behind small ones, and splats cover pixels that
//! they only touch. Frames use `occlusion` instead, which has neither.

use super::{bounds::Bounds, matrix::WarpMatrix, occlusion_order::Epipole};
use ldi_protocol::{
    OutputCamera, Pose,
    ldi::{Ldi, LdiCamera},
};

/// When a node is not divided further.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stop {
    /// It holds at most so many samples.
    pub count: usize,
    /// It is at most so many columns or rows wide.
    pub side_px: u32,
}

/// A sample of any layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OctreeSample {
    /// Column coordinate of its centre, LDI pixels.
    pub u: f32,
    /// Row coordinate of its centre, LDI pixels.
    pub v: f32,
    /// 1/m.
    pub disparity: f32,
}

impl OctreeSample {
    fn along(&self, axis: usize) -> f32 {
        [self.u, self.v, self.disparity][axis]
    }
}

/// A box of samples.
#[derive(Debug, Clone)]
pub struct OctreeNode {
    /// Of its samples' centres: columns, rows, disparities.
    bounds: Bounds,
    /// Column and row in which its children meet.
    middle: [f32; 2],
    /// First of its samples.
    first: usize,
    /// Number of its samples.
    pub count: usize,
    /// Children with samples, by octant: bit 0 the right half, 1 the lower, 2 the nearer one. None
    /// for a leaf.
    children: [Option<usize>; 8],
}

impl OctreeNode {
    /// Whether it is not divided.
    pub fn is_leaf(&self) -> bool {
        self.children.iter().all(Option::is_none)
    }

    /// Columns and rows of the image with its samples: left, top, right, bottom.
    pub fn area(&self) -> [u32; 4] {
        let [u0, v0, u1, v1] = self.bounds.place;
        [u0.floor() as u32, v0.floor() as u32, u1.ceil() as u32, v1.ceil() as u32]
    }
}

/// An octree over the samples of an image.
#[derive(Debug)]
pub struct SampleOctree {
    camera: LdiCamera,
    samples: Vec<OctreeSample>,
    /// The root first.
    nodes: Vec<OctreeNode>,
}

/// What becomes of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Visit {
    /// Nothing of it is drawn.
    Skip,
    /// Its children are asked; a leaf is drawn.
    Enter,
}

impl SampleOctree {
    /// Sorts the samples of all layers into an octree.
    pub fn new(ldi: &Ldi, stop: Stop) -> Self {
        let mut samples = Vec::with_capacity(ldi.samples());
        for layer in &ldi.layers {
            for segment in &layer.segments {
                for i in segment.first as usize..segment.first as usize + usize::from(segment.count) {
                    samples.push(OctreeSample {
                        u: f32::from(segment.column_base) + f32::from(layer.column[i]) + 0.5,
                        v: f32::from(segment.row) + 0.5,
                        disparity: ldi.codes.disparity(layer.disparity[i]) as f32,
                    });
                }
            }
        }
        let mut bounds = Bounds::NONE;
        samples.iter().for_each(|s| bounds.grow(s.u, s.v, s.disparity));
        let [least, most] = bounds.disparity;
        let (w, h) = (ldi.camera.width as f32, ldi.camera.height as f32);
        let mut tree = Self { camera: ldi.camera, samples, nodes: Vec::new() };
        if !tree.samples.is_empty() {
            tree.divide(0..tree.samples.len(), [[0.0, w], [0.0, h], [least, most]], stop);
        }
        tree
    }

    /// Creates the node of samples within a box, and all nodes below it.
    fn divide(&mut self, range: std::ops::Range<usize>, of: [[f32; 2]; 3], stop: Stop) -> usize {
        let mut bounds = Bounds::NONE;
        self.samples[range.clone()].iter().for_each(|s| bounds.grow(s.u, s.v, s.disparity));
        let middle = of.map(|[from, to]| 0.5 * (from + to));
        let number = self.nodes.len();
        let (first, count, meet) = (range.start, range.len(), [middle[0], middle[1]]);
        self.nodes.push(OctreeNode { bounds, middle: meet, first, count, children: [None; 8] });
        let wide = |axis: usize| of[axis][1] - of[axis][0] > stop.side_px as f32;
        if range.len() <= stop.count || !(wide(0) && wide(1)) {
            return number;
        }
        let octant = |s: &OctreeSample| (0..3).fold(0, |o, a| o | usize::from(s.along(a) >= middle[a]) << a);
        self.samples[range.clone()].sort_by_key(octant);
        let mut first = range.start;
        for o in 0..8 {
            let end = first + self.samples[first..range.end].partition_point(|s| octant(s) <= o);
            if end > first {
                let half = std::array::from_fn(|a| match o >> a & 1 {
                    0 => [of[a][0], middle[a]],
                    _ => [middle[a], of[a][1]],
                });
                self.nodes[number].children[o] = Some(self.divide(first..end, half, stop));
            }
            first = end;
        }
        number
    }

    /// All samples, node by node.
    pub fn samples(&self) -> &[OctreeSample] {
        &self.samples
    }

    /// Those of a node.
    pub fn samples_of(&self, node: &OctreeNode) -> &[OctreeSample] {
        &self.samples[node.first..node.first + node.count]
    }

    /// LDI pixels per tangent unit.
    pub fn pixels_per_unit(&self) -> f64 {
        self.camera.pixels_per_unit
    }

    /// All nodes, the root first.
    pub fn nodes(&self) -> &[OctreeNode] {
        &self.nodes
    }

    /// Visits nodes front to back for an eye: `visit` decides on each, `draw` gets the samples of
    /// entered leaves; both get the `state`.
    pub fn front_to_back<S>(
        &self,
        eye: &Pose,
        state: &mut S,
        visit: impl Fn(&mut S, &OctreeNode) -> Visit,
        draw: impl Fn(&mut S, &OctreeSample),
    ) {
        let epipole = Epipole::new(&self.camera, eye);
        let mut stack: Vec<usize> = if self.nodes.is_empty() { vec![] } else { vec![0] };
        while let Some(number) = stack.pop() {
            let node = &self.nodes[number];
            if visit(state, node) == Visit::Skip {
                continue;
            }
            if node.is_leaf() {
                self.samples_of(node).iter().for_each(|s| draw(state, s));
                continue;
            }
            let first = epipole.first_quadrant(node.middle.map(f64::from));
            // The last of them is visited first.
            for step in [3, 2, 1, 0] {
                let quadrant = first ^ step;
                stack.extend([quadrant, quadrant | 4].into_iter().filter_map(|o| node.children[o]));
            }
        }
    }

    /// Whether a node can reach the picture.
    pub fn reaches(&self, node: &OctreeNode, matrix: &WarpMatrix, camera: &OutputCamera) -> bool {
        node.bounds.within(matrix, [0, 0, camera.width, camera.height]).is_some()
    }

    /// The pixels around a node's eight warped corners (columns from, to, rows from, to) and the
    /// largest disparity it may show, 1/m; None where some lie behind the eye.
    pub fn rectangle(node: &OctreeNode, matrix: &WarpMatrix, camera: &OutputCamera) -> Option<([usize; 4], f64)> {
        let silhouette = node.bounds.within(matrix, [0, 0, camera.width, camera.height])?.silhouette?;
        // Saturating conversions.
        let from = silhouette.low.map(|p| p.floor().max(0.0) as usize);
        let to = silhouette.high.map(|p| p.floor().max(0.0) as usize + 1);
        let (w, h) = (camera.width as usize, camera.height as usize);
        Some(([from[0].min(w), to[0].min(w), from[1].min(h), to[1].min(h)], silhouette.nearest))
    }
}

/// How much of each pixel is covered.
#[derive(Debug)]
pub struct OcclusionBuffer {
    width: usize,
    /// 0 to 1, row-major.
    cover: Vec<f32>,
}

impl OcclusionBuffer {
    /// Nothing is covered.
    pub fn new(camera: &OutputCamera) -> Self {
        let width = camera.width as usize;
        Self { width, cover: vec![0.0; width * camera.height as usize] }
    }

    /// Whether all of a rectangle is opaque: columns from, to, rows from, to.
    pub fn is_opaque(&self, [left, right, top, bottom]: [usize; 4]) -> bool {
        let rows = self.cover.chunks(self.width.max(1)).skip(top).take(bottom.saturating_sub(top));
        rows.into_iter().all(|row| row[left..right].iter().all(|c| *c >= 1.0))
    }

    /// A sample lands at (x, y), and is `side_px` wide there.
    pub fn splat(&mut self, x: f64, y: f64, side_px: f64) {
        /// By judgement: larger ones are few, and take long.
        const LARGEST_PX: f64 = 8.0;
        let height = self.cover.len() / self.width.max(1);
        let reach = 0.5 * side_px.min(LARGEST_PX) + 0.5;
        let axis = |p: f64, n: usize| {
            let (from, to) = ((p - reach - 0.5).ceil().max(0.0) as usize, (p + reach - 0.5).floor());
            from..if to < 0.0 { 0 } else { (to as usize + 1).min(n) }
        };
        let weight = |at: usize, p: f64| (1.0 - (at as f64 + 0.5 - p).abs() / reach).max(0.0);
        for row in axis(y, height) {
            for column in axis(x, self.width) {
                let own = column as f64 == x.floor() && row as f64 == y.floor();
                let w = if own { 1.0 } else { weight(column, x) * weight(row, y) };
                let cover = &mut self.cover[row * self.width + column];
                *cover = (*cover + w as f32).min(1.0);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::warp::analytic::{ldi_camera, scene};
    use glam::DVec3;

    const CAMERA: OutputCamera = OutputCamera { width: 160, height: 120, fov_deg: 60.0 };

    fn tree(name: &str, stop: Stop) -> SampleOctree {
        SampleOctree::new(&scene(name).ldi(ldi_camera(DVec3::ZERO, 320, 240, 90.0), 4), stop)
    }

    fn pose(x: f64, z: f64) -> Pose {
        Pose { position: DVec3::new(x, 0.1, z), yaw_deg: 0.0, pitch_deg: 0.0 }
    }

    #[test]
    fn every_sample_is_in_one_leaf_and_within_its_bounds() {
        for stop in [Stop { count: 1, side_px: 1 }, Stop { count: 64, side_px: 1 }, Stop { count: 1, side_px: 32 }] {
            let tree = tree("fence", stop);
            let mut seen = vec![0; tree.samples.len()];
            for node in tree.nodes() {
                let children = node.children.iter().flatten().map(|c| tree.nodes[*c].count).sum::<usize>();
                assert!(node.is_leaf() || children == node.count);
                assert!(node.count > 0);
                let [u0, v0, u1, v1] = node.area().map(|p| p as f32);
                for i in node.first..node.first + node.count {
                    let s = &tree.samples[i];
                    assert!(s.u >= u0 && s.u <= u1 && s.v >= v0 && s.v <= v1);
                    assert!(s.disparity >= node.bounds.disparity[0] && s.disparity <= node.bounds.disparity[1]);
                    seen[i] += usize::from(node.is_leaf());
                }
            }
            assert!(seen.iter().all(|n| *n == 1));
            assert!(tree.nodes.iter().filter(|n| n.is_leaf()).all(|n| n.count <= stop.count.max(1)
                || stop.side_px > 1
                || n.area()[2] - n.area()[0] <= 2
                || n.area()[3] - n.area()[1] <= 2));
        }
    }

    /// Samples in the order in which they are drawn, with where they land and how near they are
    /// there.
    fn drawn(tree: &SampleOctree, order_of: &Pose, pose: &Pose) -> Vec<(usize, f64)> {
        let matrix = WarpMatrix::new(&tree.camera, pose, &CAMERA);
        let draw = |out: &mut Vec<(usize, f64)>, s: &OctreeSample| {
            let at = matrix.warp(f64::from(s.u), f64::from(s.v), f64::from(s.disparity));
            let inside = |p: f64, n: u32| p >= 0.0 && p < f64::from(n);
            if let Some(p) = at.filter(|p| inside(p.x, CAMERA.width) && inside(p.y, CAMERA.height)) {
                out.push((p.y as usize * CAMERA.width as usize + p.x as usize, p.disparity));
            }
        };
        let mut out = Vec::new();
        tree.front_to_back(order_of, &mut out, |_, _| Visit::Enter, draw);
        out
    }

    /// The share of pixels whose nearest surface is not drawn first.
    fn late(samples: &[(usize, f64)]) -> f64 {
        let n = (CAMERA.width * CAMERA.height) as usize;
        let (mut first, mut nearest) = (vec![0.0f64; n], vec![0.0f64; n]);
        for (at, disparity) in samples {
            if first[*at] == 0.0 {
                first[*at] = *disparity;
            }
            nearest[*at] = nearest[*at].max(*disparity);
        }
        let hit = nearest.iter().filter(|d| **d > 0.0).count();
        first.iter().zip(&nearest).filter(|(f, n)| **f * 1.1 < **n).count() as f64 / hit as f64
    }

    #[test]
    fn the_order_is_front_to_back() {
        let tree = tree("fence", Stop { count: 16, side_px: 1 });
        for eye in [pose(0.0, -1.5), pose(0.9, -1.0), pose(0.1, 1.5), pose(-0.8, 0.9), pose(0.9, 0.0)] {
            let samples = drawn(&tree, &eye, &eye);
            assert!(samples.len() > 10_000);
            // The faults that the proposal accepts: a large node of the wall behind small ones of
            // the fence.
            let right = late(&samples);
            assert!(right < 0.02, "{eye:?}: {right}");
        }
        let (eye, mirrored) = (pose(0.9, -1.0), pose(-0.9, 1.0));
        let (right, wrong) = (late(&drawn(&tree, &eye, &eye)), late(&drawn(&tree, &mirrored, &eye)));
        assert!(wrong > right + 0.02, "the mirrored eye's order is the wrong one: {wrong}, {right}");
    }

    #[test]
    fn a_node_is_hidden_where_its_rectangle_is_opaque() {
        let mut buffer = OcclusionBuffer::new(&CAMERA);
        for y in 10..20 {
            for x in 10..20 {
                buffer.splat(f64::from(x) + 0.5, f64::from(y) + 0.5, 0.1);
            }
        }
        assert!(buffer.is_opaque([10, 20, 10, 20]) && buffer.is_opaque([12, 15, 10, 11]));
        assert!(!buffer.is_opaque([9, 20, 10, 20]) && !buffer.is_opaque([10, 20, 10, 21]));
        // Skirts: half a pixel beside two samples is covered by both together.
        let mut skirts = OcclusionBuffer::new(&CAMERA);
        skirts.splat(30.5, 30.5, 3.0);
        assert!(skirts.is_opaque([30, 31, 30, 31]) && !skirts.is_opaque([31, 32, 30, 31]));
        skirts.splat(32.5, 30.5, 3.0);
        assert!(skirts.is_opaque([31, 32, 30, 31]));
    }
}
