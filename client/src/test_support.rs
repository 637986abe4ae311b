//! Geometry for the tests.

pub use crate::memory::{Memory, dataset, loose_cluster, plain_material};

use glam::{DVec3, Vec2, Vec3};
use ldi_protocol::mesh::Cluster;

/// A quadrilateral with texture coordinates (0,0), (1,0), (1,1), (0,1) at its corners.
pub fn quad_cluster(material: u32, corners: [Vec3; 4]) -> Cluster {
    Cluster {
        material,
        positions: corners.to_vec(),
        origin: DVec3::ZERO,
        normals: vec![Vec3::Y; 4],
        uvs: vec![Vec2::new(0.0, 0.0), Vec2::new(1.0, 0.0), Vec2::new(1.0, 1.0), Vec2::new(0.0, 1.0)],
        colours: Vec::new(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}
