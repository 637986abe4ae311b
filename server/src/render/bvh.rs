//! The bounding volume hierarchy: eight boxes to a node, four triangles to a leaf.
//!
//! obvhs builds a binary tree (PLOC with reinsertion, Meister and Bittner 2018); here it is flattened into nodes of up to eight
//! children, always opening the child with the largest surface (Wald, Benthin and Boulos 2008), and leaves of one block of up to
//! four triangles. Boxes and triangles lie in arrays by coordinate, so that one ray is tested against eight boxes or four
//! triangles at once; a packet of rays shares the very same layout.
//!
//! Positions are f32 relative to the middle of the scene: over 100 m they are exact to 4 um.

use super::geometry::Geometry;
use glam::Vec3A;
use obvhs::{Boundable, BvhBuildParams, bvh2::Bvh2};
use rayon::prelude::*;

/// Marks a child that is a block of triangles.
pub(super) const LEAF: u32 = 1 << 31;
/// Marks a child that is not there.
pub(super) const EMPTY: u32 = u32::MAX;
/// Triangle number of a lane that is not there.
pub(super) const NO_TRIANGLE: u32 = u32::MAX;

/// Up to eight boxes; on as few cache lines as they fit on.
#[repr(C, align(64))]
pub(super) struct Node {
    /// min x, y, z, max x, y, z of every child; absent children have inverted infinite boxes.
    pub bounds: [[f32; 8]; 6],
    /// Node number, or LEAF | block number, or EMPTY.
    pub children: [u32; 8],
}

/// Up to four triangles; on as few cache lines as they fit on. Lanes that are not there have NaN corners, which nothing hits.
#[repr(C, align(64))]
pub(super) struct Block {
    /// x, y, z of corner 0, 1, 2.
    pub corners: [[[f32; 4]; 3]; 3],
    /// x, y, z of the unit normal, computed in f64: f32 differences of the corners would lose it for slivers.
    pub normal: [[f32; 4]; 3],
    /// Numbers of the triangles.
    pub triangles: [u32; 4],
    /// Bits of the lanes whose hits an alpha mask may cut out.
    pub masked: u8,
    /// The alpha masks' entry of the first of these ([`AlphaMasks`](super::alpha::AlphaMasks)).
    pub first_mask: u32,
}

/// The hierarchy. The root is node 0; children come after their parents.
pub(super) struct Bvh {
    pub nodes: Vec<Node>,
    pub blocks: Vec<Block>,
}

struct Boxed(obvhs::aabb::Aabb);

impl Boundable for Boxed {
    fn aabb(&self) -> obvhs::aabb::Aabb {
        self.0
    }
}

/// World corners relative to the scene's middle.
fn corners(geometry: &Geometry, triangle: u32) -> [Vec3A; 3] {
    geometry.corners_world(triangle).map(|p| (p - geometry.origin).as_vec3a())
}

impl Bvh {
    /// Builds the hierarchy; `is_masked` says which triangles need a look at their alpha.
    pub fn new(geometry: &Geometry, is_masked: impl Fn(u32) -> bool + Sync) -> Self {
        let boxes: Vec<Boxed> = (0..geometry.triangle_count)
            .into_par_iter()
            .map(|t| {
                let [a, b, c] = corners(geometry, t);
                Boxed(obvhs::aabb::Aabb { min: a.min(b).min(c), max: a.max(b).max(c) })
            })
            .collect();
        let parameters = BvhBuildParams { max_prims_per_leaf: 4, ..BvhBuildParams::medium_build() };
        let binary = obvhs::bvh2::builder::build_bvh2(&boxes, parameters, &mut std::time::Duration::default());
        drop(boxes);
        let mut flat = Flattener { binary: &binary, nodes: Vec::new(), leaves: Vec::new() };
        if !binary.nodes.is_empty() && geometry.triangle_count > 0 {
            flat.node(0);
        }
        let Flattener { nodes, leaves, .. } = flat;
        let triangles_of = |leaf: &u32| {
            let n = &binary.nodes[*leaf as usize];
            &binary.primitive_indices[n.first_index as usize..(n.first_index + n.prim_count) as usize]
        };
        let mut blocks: Vec<Block> = leaves.par_iter().map(|l| Block::new(geometry, triangles_of(l))).collect();
        let mut masks = 0;
        for block in &mut blocks {
            (block.masked, block.first_mask) = (block.lanes(&is_masked), masks);
            masks += block.masked.count_ones();
        }
        Self { nodes, blocks }
    }
}

impl Block {
    fn new(geometry: &Geometry, triangles: &[u32]) -> Self {
        let mut block = Self {
            corners: [[[f32::NAN; 4]; 3]; 3],
            normal: [[0.0; 4]; 3],
            triangles: [NO_TRIANGLE; 4],
            masked: 0,
            first_mask: 0,
        };
        for (lane, &t) in triangles.iter().enumerate() {
            block.triangles[lane] = t;
            let local = corners(geometry, t);
            for (corner, p) in block.corners.iter_mut().zip(local) {
                for (axis, x) in corner.iter_mut().zip(p.to_array()) {
                    axis[lane] = x;
                }
            }
            // Of the corners as they are stored, so that the plane is the one that edges are tested against.
            let [a, b, c] = local.map(|p| p.as_dvec3());
            let n = (b - a).cross(c - a).normalize_or_zero().as_vec3();
            for (axis, x) in block.normal.iter_mut().zip(n.to_array()) {
                axis[lane] = x;
            }
        }
        block
    }

    /// Bits of the lanes whose triangle is `wanted`.
    pub fn lanes(&self, wanted: impl Fn(u32) -> bool) -> u8 {
        let is_wanted = |t: u32| t != NO_TRIANGLE && wanted(t);
        self.triangles.iter().enumerate().fold(0, |bits, (i, t)| bits | u8::from(is_wanted(*t)) << i)
    }
}

/// Turns the binary tree into wide nodes, depth first.
struct Flattener<'a> {
    binary: &'a Bvh2,
    nodes: Vec<Node>,
    /// Binary leaf of every block.
    leaves: Vec<u32>,
}

impl Flattener<'_> {
    /// Adds the wide node of a binary node and everything below; returns its number. An explicit stack: binary trees can be deep.
    fn node(&mut self, binary_root: u32) {
        let mut pending = vec![(binary_root, None)];
        while let Some((binary, parent)) = pending.pop() {
            let number = self.nodes.len() as u32;
            if let Some((parent, slot)) = parent {
                let parent: &mut Node = &mut self.nodes[parent as usize];
                parent.children[slot] = number;
            }
            let opened = self.open(binary);
            let mut node = Node { bounds: [[0.0; 8]; 6], children: [EMPTY; 8] };
            for slot in 0..8 {
                let (min, max) = match opened.get(slot) {
                    Some(b) => {
                        let b = self.binary.nodes[*b as usize].aabb();
                        (b.min.to_array(), b.max.to_array())
                    }
                    None => ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]),
                };
                for axis in 0..3 {
                    node.bounds[axis][slot] = min[axis];
                    node.bounds[axis + 3][slot] = max[axis];
                }
            }
            for (slot, &b) in opened.iter().enumerate() {
                if self.binary.nodes[b as usize].is_leaf() {
                    node.children[slot] = LEAF | self.leaves.len() as u32;
                    self.leaves.push(b);
                } else {
                    pending.push((b, Some((number, slot))));
                }
            }
            self.nodes.push(node);
        }
    }

    /// Up to eight descendants that together are the binary node.
    fn open(&self, binary: u32) -> Vec<u32> {
        let node = &self.binary.nodes[binary as usize];
        if node.is_leaf() {
            return vec![binary];
        }
        let mut opened = vec![node.first_index, node.first_index + 1];
        while opened.len() < 8 {
            let area = |b: &u32| self.binary.nodes[*b as usize].aabb().half_area();
            let inner = opened.iter().enumerate().filter(|(_, b)| !self.binary.nodes[**b as usize].is_leaf());
            let Some((largest, _)) = inner.max_by(|a, b| area(a.1).total_cmp(&area(b.1))) else { break };
            let first = self.binary.nodes[opened[largest] as usize].first_index;
            opened[largest] = first;
            opened.push(first + 1);
        }
        opened
    }
}
