//! What the octree stage hands on.

use ldi_protocol::Aabb;

/// A piece of one primitive of one mesh, at most 256 triangles.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceCluster {
    /// Position in `Scene::meshes`.
    pub mesh: u32,
    /// Position in the mesh's primitives.
    pub primitive: u32,
    /// Triangle numbers within the primitive, ascending.
    pub triangles: Vec<u32>,
    /// Mesh-space bounds.
    pub bounds: Aabb,
}

/// All clusters, grouped by mesh in order.
#[derive(Debug, Clone, Default)]
pub struct Clusters {
    /// The clusters.
    pub clusters: Vec<SourceCluster>,
    /// Per mesh, the range of its clusters.
    pub of_mesh: Vec<std::ops::Range<u32>>,
    /// Clusters of triangles that are not larger themselves stay within this in the world, metres.
    pub extent_m: f64,
}

/// A cell that holds cluster instances.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Tight world bounds of its content, rounded outward to f32 so that every copy of them is the
    /// same.
    pub bounds: Aabb,
    /// Triangles, instances counted.
    pub triangles: u32,
    /// Octree depth, 0 for the root.
    pub depth: u8,
    /// (instance in `Scene::instances`, cluster in [`Clusters::clusters`]), ascending.
    pub content: Vec<(u32, u32)>,
}

/// The cells of the loose octree.
#[derive(Debug, Clone, Default)]
pub struct Octree {
    /// Cells with content, in depth-first (Morton) order.
    pub cells: Vec<Cell>,
    /// Largest depth in use.
    pub depth: u8,
    /// Nodes visited, cells or not, for the report.
    pub nodes: u32,
}
