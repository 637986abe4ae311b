//! Parts: what one cell draws of one primitive, each once.

use crate::octree::{Clusters, Octree};
use std::collections::HashMap;

/// Clusters of one primitive that one cell draws of an instance.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct Part {
    pub mesh: u32,
    pub primitive: u32,
    /// Ascending.
    pub clusters: Box<[u32]>,
}

/// All parts, and which cell draws which.
#[derive(Debug, Default)]
pub(super) struct Parts {
    /// Each once, in the order in which cells first draw them.
    pub parts: Vec<Part>,
    /// Per cell (instance, part), ascending by instance.
    pub of_cell: Vec<Vec<(u32, u32)>>,
}

pub(super) fn find(clusters: &Clusters, octree: &Octree) -> Parts {
    let mut numbers: HashMap<Part, u32> = HashMap::new();
    let mut parts = Parts::default();
    for cell in &octree.cells {
        let mut drawn = Vec::new();
        // Content ascends by instance, then by cluster; clusters of a primitive follow each other.
        let key = |(instance, cluster): (u32, u32)| (instance, clusters.clusters[cluster as usize].primitive);
        for group in cell.content.chunk_by(|a, b| key(*a) == key(*b)) {
            let first = &clusters.clusters[group[0].1 as usize];
            let of = group.iter().map(|(_, cluster)| *cluster).collect();
            let part = Part { mesh: first.mesh, primitive: first.primitive, clusters: of };
            let number = *numbers.entry(part).or_insert_with_key(|part| {
                parts.parts.push(part.clone());
                parts.parts.len() as u32 - 1
            });
            drawn.push((group[0].0, number));
        }
        parts.of_cell.push(drawn);
    }
    parts
}
