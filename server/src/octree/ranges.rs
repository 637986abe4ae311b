//! What a cell holds, as runs of source triangles: for `inspect`, so that others can count again.

use super::{Clusters, Octree};
use crate::scene::Scene;
use serde::Serialize;

/// A run of consecutive triangles of one primitive of one node of the source file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct SourceRange {
    /// [`crate::scene::Instance::node`].
    pub node: u32,
    /// Position in [`Scene::meshes`].
    pub mesh: u32,
    /// Position in the mesh's primitives.
    pub primitive: u32,
    /// First triangle.
    pub first: u32,
    /// Number of triangles.
    pub count: u32,
}

impl Octree {
    /// The triangles of a cell, in order of (instance, primitive, triangle), runs merged across
    /// clusters.
    pub fn ranges(&self, scene: &Scene, clusters: &Clusters, cell: usize) -> Vec<SourceRange> {
        let mut triangles = Vec::with_capacity(self.cells[cell].triangles as usize);
        for &(instance, cluster) in &self.cells[cell].content {
            let cluster = &clusters.clusters[cluster as usize];
            triangles.extend(cluster.triangles.iter().map(|t| (instance, cluster.primitive, *t)));
        }
        triangles.sort_unstable();
        let follows = |a: &(u32, u32, u32), b: &(u32, u32, u32)| a.0 == b.0 && a.1 == b.1 && a.2 + 1 == b.2;
        triangles
            .chunk_by(follows)
            .map(|run| {
                let instance = &scene.instances[run[0].0 as usize];
                SourceRange {
                    node: instance.node,
                    mesh: instance.mesh,
                    primitive: run[0].1,
                    first: run[0].2,
                    count: run.len() as u32,
                }
            })
            .collect()
    }
}
