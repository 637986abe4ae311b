//! The LDI tree (Chang, Bishop, Lastra 1999): an octree whose nodes hold orthographic layered
//! depth images of what lies in them.
//!
//! A node of level l is a cube of edge `edge_m / 2^l`. Its LDI has [`SIDE`] x [`SIDE`] pixels of
//! pitch edge / [`SIDE`] on each of **six** faces, not one as in the paper: a surface goes to the
//! face that its normal points to most. One face sees surfaces beside it edge-on and keeps them as
//! stacks of samples a pitch apart; by the normal, no surface is more than 55 degrees askew, and
//! the two sides of a thin wall, which lie within one merge threshold of each other, never mix.
//!
//! Pixels of a level lie on one grid over the whole tree, so that what is splatted across a border
//! of cells lands in the neighbour. *Unfiltered* samples come from reference pixels whose stamp
//! matches the node's pitch; *filtered* ones from nodes below (section 3.1). The children of a
//! node travel together, as one chunk: a node is drawn from them or from itself.
//!
//! ```text
//!   face f = 2 axis + (normal points up the axis)     SkyMap's order: -x +x -y +y -z +z
//!   position[axis]  = cell min + (depth + 0.5) pitch / DEPTH_STEPS
//!   position[a, b]  = cell min + (column + 0.5, row + 0.5) pitch       a, b: the other two axes in the order x, y, z
//! ```

mod cut;

pub use cut::{Cut, CutNode, CutOptions, Lens, cut, lacking, lacking_below};

use crate::{
    Aabb,
    codec::{self, CodecError},
};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Pixels along each side of a node's faces; the paper's.
pub const SIDE: u32 = 64;
/// Steps of depth per pixel pitch. Coded depth errs by half of one: a 128th of what the sampling
/// itself does.
pub const DEPTH_STEPS: u32 = 64;
/// Deepest level: a pixel of one has 20 bits along each axis, so that level, face and place fit 64.
pub const MAX_LEVEL: u8 = 14;
/// Most samples of one pixel of one face: a column of surfaces one merge threshold apart.
pub const MAX_LAYERS: usize = 2 * SIDE as usize;
/// Parts along each side of a pixel's coverage mask.
pub const PARTS: u32 = 4;
/// The coverage mask of a pixel that its surface covers whole.
pub const WHOLE: u16 = u16::MAX;

/// The two axes of a face's columns and rows.
pub const fn across(axis: usize) -> [usize; 2] {
    [[1, 2], [0, 2], [0, 1]][axis]
}

/// A sample of a node's LDI.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TreeSample {
    /// 0 to 5, see the module.
    pub face: u8,
    /// Below [`SIDE`].
    pub column: u8,
    /// Below [`SIDE`].
    pub row: u8,
    /// Which of the pixel's [`PARTS`] x [`PARTS`] parts the surface covers, never 0: row by row,
    /// the lowest bit first.
    pub covers: u16,
    /// Along the face's axis from the cell's smallest corner, below `SIDE * DEPTH_STEPS`.
    pub depth: u16,
    /// How depth grows per column and per row, in steps: 64 is 45 degrees.
    pub slope: [i8; 2],
    /// 8-bit sRGB.
    pub rgb: [u8; 3],
    /// Whether samples of nodes below have part in it.
    pub filtered: bool,
}

impl TreeSample {
    /// Share of the pixel that the surface covers, above 0 and up to 1.
    pub fn coverage(&self) -> f32 {
        share_covered(self.covers)
    }
}

/// Share of a pixel that a coverage mask ([`TreeSample::covers`]) covers, up to 1.
pub fn share_covered(mask: u16) -> f32 {
    mask.count_ones() as f32 / (PARTS * PARTS) as f32
}

/// The LDI of one node: samples by face, row, column, depth.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct NodeSamples {
    /// All of them.
    pub samples: Vec<TreeSample>,
}

/// What a chunk of the tree holds: the LDIs of a node's children, or the root's.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Brood {
    /// In the order of [`Tree::nodes`].
    pub nodes: Vec<NodeSamples>,
}

impl Brood {
    /// Bytes in memory, for the cache's accounts.
    pub fn decoded_bytes(&self) -> usize {
        self.nodes.iter().map(|n| 32 + n.samples.len() * size_of::<TreeSample>()).sum()
    }
}

/// A node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct TreeNode {
    /// 0: the root.
    pub level: u8,
    /// Which cube of its level: each below `2^level`.
    pub cell: [u16; 3],
    /// Samples of its LDI.
    pub samples: u32,
    /// Those that are unfiltered.
    pub unfiltered: u32,
    /// The first of its children in [`Tree::nodes`]; 0 without children.
    pub first_child: u32,
    /// How many there are, at most 8.
    pub children: u8,
    /// The chunk of its children; 0 without.
    pub chunk: u32,
}

/// The tree as both ends know it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tree {
    /// Smallest corner of the root's cube.
    pub origin: DVec3,
    /// Its edge, metres.
    pub edge_m: f64,
    /// Chunk of the root's LDI.
    pub root_chunk: u32,
    /// Levels 0 to this one less one come first and stay.
    pub pinned_levels: u8,
    /// By level, then by parent, then by octant (x fastest): children of one node lie together.
    pub nodes: Vec<TreeNode>,
}

impl TreeNode {
    /// Its children in [`Tree::nodes`].
    pub fn child_range(&self) -> Range<u32> {
        self.first_child..self.first_child + u32::from(self.children)
    }
}

impl Tree {
    /// Edge of a cube, metres.
    pub fn edge_of(&self, level: u8) -> f64 {
        self.edge_m / f64::from(1u32 << level)
    }

    /// Distance of samples on a face, metres.
    pub fn pitch_of(&self, level: u8) -> f64 {
        self.edge_of(level) / f64::from(SIDE)
    }

    /// Smallest corner of a node's cube.
    pub fn corner_of(&self, node: &TreeNode) -> DVec3 {
        let edge = self.edge_of(node.level);
        self.origin + DVec3::from_array(node.cell.map(|c| f64::from(c) * edge))
    }

    /// A node's cube.
    pub fn bounds_of(&self, node: &TreeNode) -> Aabb {
        let min = self.corner_of(node);
        Aabb { min, max: min + self.edge_of(node.level) }
    }

    /// The chunks of the pinned levels, coarse ones first.
    pub fn pinned_chunks(&self) -> impl Iterator<Item = u32> + '_ {
        let root = (self.pinned_levels > 0).then_some(self.root_chunk);
        let parents = self.nodes.iter().take_while(|n| n.level + 1 < self.pinned_levels);
        root.into_iter().chain(parents.filter(|n| n.children > 0).map(|n| n.chunk))
    }

    /// All chunks with the nodes that they hold, coarse ones first.
    pub fn broods(&self) -> impl Iterator<Item = (u32, Range<u32>)> + '_ {
        let parents = self.nodes.iter().filter(|n| n.children > 0);
        std::iter::once((self.root_chunk, 0..1)).chain(parents.map(|n| (n.chunk, n.child_range())))
    }

    /// Decodes the chunk of some nodes and checks it against what is listed of them.
    ///
    /// # Errors
    /// If the bytes are not these nodes' samples.
    pub fn decode(&self, nodes: Range<u32>, bytes: &[u8]) -> Result<Brood, CodecError> {
        let listed: Vec<(u32, u32)> =
            nodes.filter_map(|n| self.nodes.get(n as usize)).map(|n| (n.samples, n.unfiltered)).collect();
        codec::tree::decode(bytes, &listed)
    }

    /// The rules of a tree: nodes by level, children together and within their parent, each node
    /// but the root child of one.
    ///
    /// # Errors
    /// The first broken rule, in words.
    pub fn check(&self) -> Result<(), String> {
        if !self.origin.is_finite() || !(self.edge_m > 0.0 && self.edge_m.is_finite()) {
            return Err("its cube is not finite or empty".into());
        }
        // Pitches are computed from it: a shift by as many bits.
        if self.pinned_levels > MAX_LEVEL + 1 {
            return Err(format!("{} levels are pinned, there are at most {}", self.pinned_levels, MAX_LEVEL + 1));
        }
        let Some(root) = self.nodes.first() else { return Err("it has no root".into()) };
        if root.level != 0 || root.cell != [0; 3] {
            return Err("its first node is not the root".into());
        }
        let mut next = 1;
        for (number, node) in self.nodes.iter().enumerate() {
            if node.unfiltered > node.samples {
                return Err(format!("node {number} has more unfiltered samples than samples"));
            }
            if node.children == 0 {
                continue;
            }
            let range = node.first_child as usize..node.first_child as usize + usize::from(node.children);
            if range.start != next || node.children > 8 || node.level >= MAX_LEVEL {
                return Err(format!("the children of node {number} do not follow those of the node before"));
            }
            next = range.end;
            let children =
                self.nodes.get(range).ok_or_else(|| format!("node {number} has children that do not exist"))?;
            let is_child = |c: &TreeNode| c.level == node.level + 1 && (0..3).all(|k| c.cell[k] / 2 == node.cell[k]);
            let octants = |c: &TreeNode| (c.cell[2] % 2, c.cell[1] % 2, c.cell[0] % 2);
            if !children.iter().all(is_child) || children.windows(2).any(|w| octants(&w[0]) >= octants(&w[1])) {
                return Err(format!("the children of node {number} are not its octants in order"));
            }
        }
        if next == self.nodes.len() { Ok(()) } else { Err("some nodes are nobody's children".into()) }
    }
}

#[cfg(test)]
mod tests;
