//! A tree of boxes over the walk volume, so that the certificate can treat large regions at once.
//!
//! In: the boxes of a [`WalkVolume`]. Out: a binary tree with tight bounds, split at the middle of
//! the longest axis. Flat slabs between floors stay flat boxes, which an octree's cubes would not.

use glam::DVec3;
use ldi_protocol::{Aabb, volume::WalkVolume};

/// A node: bounds of its eyes, and its two children unless it is a single box.
#[derive(Debug, Clone, Copy)]
pub(super) struct EyeNode {
    /// Tight bounds of the eyes below.
    pub bounds: Aabb,
    /// Positions of the children in [`EyeTree::nodes`].
    pub children: Option<[u32; 2]>,
}

/// The tree; node 0 is the root.
#[derive(Debug, Clone, Default)]
pub(super) struct EyeTree {
    /// Parents before children.
    pub nodes: Vec<EyeNode>,
}

impl EyeTree {
    /// Builds the tree.
    pub fn new(volume: &WalkVolume) -> Self {
        let mut boxes: Vec<Aabb> = volume.boxes().collect();
        let mut tree = Self::default();
        if !boxes.is_empty() {
            tree.build(&mut boxes);
        }
        tree
    }

    fn build(&mut self, boxes: &mut [Aabb]) -> u32 {
        let bounds = boxes.iter().fold(Aabb::EMPTY, |b, o| b.union(*o));
        let at = self.nodes.len() as u32;
        self.nodes.push(EyeNode { bounds, children: None });
        if boxes.len() > 1 {
            let axis = longest_axis(bounds.size());
            let middle = bounds.centre()[axis];
            let mut split = partition(boxes, |b| b.centre()[axis] < middle);
            if split == 0 || split == boxes.len() {
                // All centres on one side: halve by rank, stable whatever the order.
                boxes.sort_by(|a, b| a.centre()[axis].total_cmp(&b.centre()[axis]));
                split = boxes.len() / 2;
            }
            let (a, b) = boxes.split_at_mut(split);
            let children = [self.build(a), self.build(b)];
            self.nodes[at as usize].children = Some(children);
        }
        at
    }

    /// The single boxes for which `wanted` holds, as it must for whatever holds one of them.
    pub fn leaves_touching(&self, wanted: impl Fn(&Aabb) -> bool) -> Vec<Aabb> {
        let mut out = Vec::new();
        let mut stack = if self.nodes.is_empty() { vec![] } else { vec![0] };
        while let Some(n) = stack.pop() {
            let node = &self.nodes[n as usize];
            match node.children {
                _ if !wanted(&node.bounds) => {}
                Some([a, b]) => stack.extend([b, a]),
                None => out.push(node.bounds),
            }
        }
        out
    }

    /// The place where an eye may be that is closest to `p`; None without eyes.
    pub fn closest(&self, p: DVec3) -> Option<DVec3> {
        let mut best: Option<(f64, DVec3)> = None;
        let mut stack = if self.nodes.is_empty() { vec![] } else { vec![0] };
        while let Some(n) = stack.pop() {
            let node = &self.nodes[n as usize];
            let place = p.clamp(node.bounds.min, node.bounds.max);
            let distance = place.distance_squared(p);
            if best.is_some_and(|b| b.0 <= distance) {
                continue;
            }
            match node.children {
                Some([a, b]) => stack.extend([b, a]),
                None => best = Some((distance, place)),
            }
        }
        best.map(|b| b.1)
    }

    /// Nodes no larger than `edge_m`, or single boxes, that together hold all eyes.
    pub fn blocks(&self, edge_m: f64) -> Vec<u32> {
        let mut out = Vec::new();
        let mut stack = if self.nodes.is_empty() { vec![] } else { vec![0] };
        while let Some(n) = stack.pop() {
            let node = &self.nodes[n as usize];
            match node.children {
                Some([a, b]) if node.bounds.size().max_element() > edge_m => stack.extend([b, a]),
                _ => out.push(n),
            }
        }
        out
    }
}

/// 0, 1 or 2.
pub(super) fn longest_axis(size: DVec3) -> usize {
    if size.x >= size.y && size.x >= size.z {
        0
    } else if size.z >= size.y {
        2
    } else {
        1
    }
}

/// Stable partition; returns how many satisfy `keep`.
fn partition(boxes: &mut [Aabb], keep: impl Fn(&Aabb) -> bool) -> usize {
    let (yes, no): (Vec<Aabb>, Vec<Aabb>) = boxes.iter().partition(|b| keep(b));
    boxes[..yes.len()].copy_from_slice(&yes);
    boxes[yes.len()..].copy_from_slice(&no);
    yes.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_hold_all_boxes_and_are_small() {
        let runs: Vec<Vec<[u16; 2]>> =
            (0..400u16).map(|c| if c % 7 == 0 { vec![] } else { vec![[c % 5, 12], [30, 31 + c % 3]] }).collect();
        let cut = Aabb { min: DVec3::ZERO, max: DVec3::new(10.0, 0.0, 10.0) };
        let v = WalkVolume::new(DVec3::ZERO, 0.5, 0.1, [20, 20], &runs, &cut).unwrap();
        let tree = EyeTree::new(&v);
        let blocks = tree.blocks(2.0);
        assert!(blocks.iter().all(|b| tree.nodes[*b as usize].bounds.size().max_element() <= 2.0));
        for b in v.boxes() {
            assert!(blocks.iter().any(|n| tree.nodes[*n as usize].bounds.contains(b.centre())));
        }
        let leaves = tree.nodes.iter().filter(|n| n.children.is_none()).count();
        assert_eq!(leaves, v.boxes().count());
        for k in 0..200 {
            let p = DVec3::new(f64::from(k * 7 % 23) - 6.0, f64::from(k * 5 % 31) * 0.2 - 1.0, f64::from(k % 13));
            let nearest = v.boxes().map(|b| b.distance(p)).fold(f64::INFINITY, f64::min);
            let place = tree.closest(p).expect("there are eyes");
            assert!((place.distance(p) - nearest).abs() < 1e-12 && v.boxes().any(|b| b.contains(place)));
        }
        assert_eq!(EyeTree::default().closest(DVec3::ZERO), None);
    }
}
