//! Near geometry, decoded: clusters of triangles, and cells that place them. The coding lives in
//! `codec`.

use glam::{DAffine3, Vec2, Vec3};
use serde::{Deserialize, Serialize};

/// Largest number of triangles in a cluster.
pub const MAX_CLUSTER_TRIANGLES: usize = 256;

/// A piece of one mesh with one material: at most 256 triangles, in mesh space.
#[derive(Debug, Clone, PartialEq)]
pub struct Cluster {
    /// Position in [`crate::index::Index::materials`].
    pub material: u32,
    /// Mesh-space positions, relative to `origin`.
    pub positions: Vec<Vec3>,
    /// Mesh-space origin of the positions.
    pub origin: glam::DVec3,
    /// Unit normals, one per vertex.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, one per vertex, or empty where the material has no texture.
    pub uvs: Vec<Vec2>,
    /// Linear vertex colour multipliers, one per vertex, or empty.
    pub colours: Vec<[f32; 3]>,
    /// Vertex numbers, three per triangle.
    pub triangles: Vec<[u16; 3]>,
}

/// A cluster in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct ClusterInstance {
    /// Which cluster.
    pub cluster: ClusterRef,
    /// Placement of the mesh in the world. Normals turn by the inverse transpose.
    pub world_from_mesh: DAffine3,
}

/// Where a cell finds a cluster.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ClusterRef {
    /// In the cell's own chunk: position in [`CellGeometry::clusters`].
    Own(u32),
    /// In a bundle that several cells share: chunk number and position in the bundle.
    Shared {
        /// Position in [`crate::index::Index::chunks`].
        chunk: u32,
        /// Position in the bundle.
        cluster: u32,
    },
}

/// The content of a cell's chunk: clusters that no other cell uses, and the instances of all its
/// clusters. A bundle chunk has the same form with no instances.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CellGeometry {
    /// Clusters stored here.
    pub clusters: Vec<Cluster>,
    /// What the cell draws.
    pub instances: Vec<ClusterInstance>,
}

/// How alpha is treated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Alpha {
    /// Ignored.
    Opaque,
    /// Texels and factors whose alpha is below the cutoff are not there (blended materials: cutoff
    /// 0.5).
    Mask(f32),
}

/// A diffuse material.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Linear base colour factor and alpha.
    pub base_colour: [f32; 4],
    /// Position in the index's textures.
    pub texture: Option<u32>,
    /// Alpha treatment.
    pub alpha: Alpha,
    /// Takes light = 1 instead of [`crate::shade::light`].
    pub unlit: bool,
    /// Whether back faces are drawn. Everything that judges pictures draws them as the material
    /// says.
    pub double_sided: bool,
    /// Sampler wrap modes across and down.
    pub wrap: [Wrap; 2],
}

/// What a texture coordinate outside [0, 1] means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wrap {
    /// Tiles.
    Repeat,
    /// Tiles, every second one mirrored.
    Mirror,
    /// The border texel goes on.
    Clamp,
}
