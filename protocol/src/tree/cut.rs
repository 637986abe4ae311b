//! Which nodes a view draws: section 3.2 of the paper, on data that may not all be there.
//!
//! From the root down: what lies outside of the frustum is left out; a node whose samples would be
//! larger than one output pixel, or that has the eye in it, gives way to its children and keeps
//! only its unfiltered samples. Unlike in the paper the largest stamp is refined first, so that a
//! bound on the number of samples ends the work where it shows least, and a node whose children
//! are not at hand stays as it is.

use super::{Tree, TreeNode};
use crate::{OutputCamera, Pose, camera::Frustum};
use std::{cmp::Ordering, collections::BinaryHeap};

/// A node to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutNode {
    /// Position in [`Tree::nodes`].
    pub node: u32,
    /// Where its samples are: a chunk, and which of its nodes.
    pub home: (u32, u8),
    /// Whether filtered samples are drawn, too: its children are not.
    pub filtered: bool,
    /// Bound on the size of its samples in the picture, output pixels; infinite with the eye in or
    /// beside it.
    pub stamp_px: f64,
}

/// The nodes of a view, near to far, and what it lacks.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Cut {
    /// What to draw.
    pub nodes: Vec<CutNode>,
    /// Chunks that would sharpen it, largest stamps first.
    pub missing: Vec<u32>,
    /// Samples to draw.
    pub samples: u64,
    /// Whether [`CutOptions::max_samples`] kept something from being refined.
    pub limited: bool,
}

/// Larger samples save no time: fewer of them cover the picture more often, as they hide each
/// other later (docs/benchmarks/tree.md has figures).
pub const COARSEST_PX: f64 = 8.0;

/// How far to refine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutOptions {
    /// Samples may be this large, output pixels. The paper: one.
    pub stamp_px: f64,
    /// Samples that may be drawn; but larger ones than [`CutOptions::coarsest_px`] give way to
    /// finer ones in any case.
    pub max_samples: u64,
    /// See [`CutOptions::max_samples`]; output pixels.
    pub coarsest_px: f64,
}

/// What the picture looks at: half tangents across and up, and the focal length in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Of half the field of view across.
    pub half_tan_x: f64,
    /// Of half the field of view up.
    pub half_tan_y: f64,
    /// Pixels.
    pub focal_px: f64,
}

impl From<&OutputCamera> for Lens {
    fn from(c: &OutputCamera) -> Self {
        Self { half_tan_x: c.half_tan_x(), half_tan_y: c.half_tan_y(), focal_px: c.focal_px() }
    }
}

impl Default for CutOptions {
    fn default() -> Self {
        Self { stamp_px: 1.0, max_samples: u64::MAX, coarsest_px: COARSEST_PX }
    }
}

/// A node on the way, ordered by stamp.
struct Candidate {
    stamp_px: f64,
    node: u32,
    home: (u32, u8),
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}
impl Eq for Candidate {}
impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        // Of equal stamps the node listed first.
        self.stamp_px.total_cmp(&other.stamp_px).then(other.node.cmp(&self.node))
    }
}

/// How a view sees the nodes of a tree.
struct Eye<'a> {
    tree: &'a Tree,
    pose: &'a Pose,
    frustum: Frustum,
    /// Pixels per radian, where that is most.
    scale: f64,
}

impl<'a> Eye<'a> {
    fn new(tree: &'a Tree, pose: &'a Pose, lens: &Lens) -> Self {
        let frustum = Frustum::new(pose.position, &pose.basis(), lens.half_tan_x, lens.half_tan_y);
        // The largest angle between the line of sight and a ray: a pixel's stamp is P f / depth,
        // and depth is at least the distance times its cosine.
        let slant = (1.0 + lens.half_tan_x.powi(2) + lens.half_tan_y.powi(2)).sqrt();
        Self { tree, pose, frustum, scale: lens.focal_px * slant }
    }

    fn distance(&self, node: &TreeNode) -> f64 {
        self.tree.bounds_of(node).distance(self.pose.position)
    }

    /// Bound on the size of its samples, output pixels.
    fn stamp_px(&self, node: &TreeNode) -> f64 {
        let distance = self.distance(node);
        if distance <= 0.0 { f64::INFINITY } else { self.tree.pitch_of(node.level) * self.scale / distance }
    }

    /// Samples on a cell's border reach half a pitch beyond it.
    fn sees(&self, node: &TreeNode) -> bool {
        self.frustum.may_intersect(&self.tree.bounds_of(node).inflated(self.tree.pitch_of(node.level)))
    }
}

/// The nodes that a view draws. `held` tells whether a chunk is at hand.
pub fn cut(tree: &Tree, pose: &Pose, lens: &Lens, options: &CutOptions, held: impl Fn(u32) -> bool) -> Cut {
    let mut out = Cut::default();
    if !held(tree.root_chunk) {
        out.missing.push(tree.root_chunk);
        return out;
    }
    let eye = Eye::new(tree, pose, lens);
    let mut heap = BinaryHeap::new();
    let visit = |number: u32, home: (u32, u8), heap: &mut BinaryHeap<Candidate>| -> u64 {
        let node = &tree.nodes[number as usize];
        if !eye.sees(node) {
            return 0;
        }
        heap.push(Candidate { stamp_px: eye.stamp_px(node), node: number, home });
        node.samples.into()
    };
    let mut samples = visit(0, (tree.root_chunk, 0), &mut heap);
    while let Some(Candidate { stamp_px, node: number, home }) = heap.pop() {
        let node = &tree.nodes[number as usize];
        let children = node.child_range();
        let mut filtered = true;
        if stamp_px > options.stamp_px && node.children > 0 {
            let more: u64 = children
                .clone()
                .map(|c| &tree.nodes[c as usize])
                .filter(|c| eye.sees(c))
                .map(|c| u64::from(c.samples))
                .sum();
            let after = samples - u64::from(node.samples - node.unfiltered) + more;
            if !held(node.chunk) {
                out.missing.push(node.chunk);
            } else if after > options.max_samples && stamp_px <= options.coarsest_px {
                out.limited = true;
            } else {
                filtered = false;
                samples = after;
                (0u8..).zip(children).for_each(|(slot, c)| {
                    visit(c, (node.chunk, slot), &mut heap);
                });
            }
        }
        if filtered || node.unfiltered > 0 {
            out.nodes.push(CutNode { node: number, home, filtered, stamp_px });
        }
    }
    out.samples = samples;
    let distance = |c: &CutNode| eye.distance(&tree.nodes[c.node as usize]);
    out.nodes.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.node.cmp(&b.node)));
    out
}

/// Per node, whether the chunk of its children or one below is absent: where [`lacking`] descends.
/// Once for many views.
pub fn lacking_below(tree: &Tree, absent: impl Fn(u32) -> bool) -> Vec<bool> {
    let mut below = vec![false; tree.nodes.len()];
    // Children come after their parent.
    for (number, node) in tree.nodes.iter().enumerate().rev() {
        below[number] = node.children > 0 && (absent(node.chunk) || node.child_range().any(|c| below[c as usize]));
    }
    below
}

/// The absent chunks among those that a view descends to, with samples of one output pixel and no
/// bound on their number: as of [`cut`] with all at hand, but in the order of the tree, and
/// looking only at what [`lacking_below`] says, `below`.
pub fn lacking(tree: &Tree, pose: &Pose, lens: &Lens, below: &[bool], absent: impl Fn(u32) -> bool) -> Vec<u32> {
    let eye = Eye::new(tree, pose, lens);
    let mut found: Vec<u32> = absent(tree.root_chunk).then_some(tree.root_chunk).into_iter().collect();
    let mut open = vec![0];
    while let Some(number) = open.pop() {
        let node = &tree.nodes[number as usize];
        if !below[number as usize] || !eye.sees(node) || eye.stamp_px(node) <= CutOptions::default().stamp_px {
            continue;
        }
        found.extend(absent(node.chunk).then_some(node.chunk));
        open.extend(node.child_range());
    }
    found
}
