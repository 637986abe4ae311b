//! What an octree promises, checked.

use super::{Clusters, Octree};
use crate::scene::Scene;
use ldi_protocol::mesh::MAX_CLUSTER_TRIANGLES;

/// A broken promise.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum OctreeFault {
    /// A cluster is empty, too large, or its triangles do not ascend within the primitive.
    #[error("cluster {0}: 1 to 256 triangles of the primitive, ascending, are expected")]
    Cluster(usize),
    /// The clusters of a mesh are not its triangles, each once.
    #[error("mesh {mesh}: its clusters hold {found} distinct triangles of {expected}")]
    Mesh {
        /// Position in the scene.
        mesh: usize,
        /// Distinct triangles in clusters.
        found: u64,
        /// Triangles of the mesh.
        expected: u64,
    },
    /// The cells do not hold every cluster instance exactly once.
    #[error("the cells hold {found} distinct cluster instances ({listed} with repetitions) of {expected}")]
    Instances {
        /// Distinct cluster instances in cells.
        found: usize,
        /// Entries in cells.
        listed: usize,
        /// Cluster instances of the scene.
        expected: usize,
    },
    /// A cell's count or order is wrong.
    #[error("cell {0}: its triangle count is not that of its content, or its content does not ascend")]
    Cell(usize),
    /// A vertex sticks out of a cell.
    #[error("cell {0}: its bounds do not contain its content or are no f32 values")]
    Bounds(usize),
}

impl Octree {
    /// Checks that every triangle of every instance is in exactly one cell, that counts are right
    /// and that bounds contain what they bound. Takes time proportional to the expanded scene.
    pub fn check(&self, scene: &Scene, clusters: &Clusters) -> Result<(), OctreeFault> {
        check_clusters(scene, clusters)?;
        let mut seen = std::collections::BTreeSet::new();
        let mut listed = 0;
        for (number, cell) in self.cells.iter().enumerate() {
            let count: usize = cell.content.iter().map(|c| clusters.clusters[c.1 as usize].triangles.len()).sum();
            if count != cell.triangles as usize || !cell.content.is_sorted_by(|a, b| a < b) {
                return Err(OctreeFault::Cell(number));
            }
            let corners = [cell.bounds.min, cell.bounds.max];
            if corners.iter().any(|p| p.as_vec3().as_dvec3() != *p) {
                return Err(OctreeFault::Bounds(number));
            }
            for &(instance, cluster) in &cell.content {
                listed += 1;
                seen.insert((instance, cluster));
                let (instance, cluster) = (&scene.instances[instance as usize], &clusters.clusters[cluster as usize]);
                if cluster.mesh != instance.mesh {
                    return Err(OctreeFault::Cell(number));
                }
                let p = &scene.meshes[cluster.mesh as usize].primitives[cluster.primitive as usize];
                let inside = cluster.triangles.iter().flat_map(|t| p.triangles[*t as usize]).all(|v| {
                    let world = instance.world_from_mesh.transform_point3(p.positions[v as usize].as_dvec3());
                    cell.bounds.contains(world)
                });
                if !inside {
                    return Err(OctreeFault::Bounds(number));
                }
            }
        }
        let expected = scene.instances.iter().map(|i| clusters.of_mesh[i.mesh as usize].len()).sum();
        if seen.len() != expected || listed != expected {
            return Err(OctreeFault::Instances { found: seen.len(), listed, expected });
        }
        Ok(())
    }
}

fn check_clusters(scene: &Scene, clusters: &Clusters) -> Result<(), OctreeFault> {
    for (number, c) in clusters.clusters.iter().enumerate() {
        let of_primitive = scene.meshes[c.mesh as usize].primitives[c.primitive as usize].triangles.len();
        let in_range = (1..=MAX_CLUSTER_TRIANGLES).contains(&c.triangles.len())
            && c.triangles.last().is_some_and(|t| (*t as usize) < of_primitive)
            && clusters.of_mesh[c.mesh as usize].contains(&(number as u32));
        if !in_range || !c.triangles.is_sorted_by(|a, b| a < b) {
            return Err(OctreeFault::Cluster(number));
        }
    }
    for (mesh, range) in clusters.of_mesh.iter().enumerate() {
        let of_mesh = &clusters.clusters[range.start as usize..range.end as usize];
        let mut triangles: Vec<(u32, u32)> =
            of_mesh.iter().flat_map(|c| c.triangles.iter().map(|t| (c.primitive, *t))).collect();
        let listed = triangles.len();
        triangles.sort_unstable();
        triangles.dedup();
        let (found, expected) = (triangles.len() as u64, scene.meshes[mesh].triangles());
        if found != expected || listed != triangles.len() {
            return Err(OctreeFault::Mesh { mesh, found, expected });
        }
    }
    Ok(())
}
