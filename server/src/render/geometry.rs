//! Numbers of the scene's triangles: every triangle of every instance has a number, a source and a
//! cell.

use crate::{
    octree::{Clusters, Octree},
    scene::{Instance, Primitive, Scene},
};
use glam::{DMat3, DVec3, Mat3};
use std::sync::Arc;

/// Where an expanded triangle comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TriangleSource {
    /// Position in [`Scene::instances`].
    pub instance: u32,
    /// Position in [`Scene::meshes`].
    pub mesh: u32,
    /// Position in the mesh's primitives.
    pub primitive: u32,
    /// Position in the primitive's triangles.
    pub triangle: u32,
}

/// One primitive of one instance: a run of expanded triangles.
struct Piece {
    instance: u32,
    primitive: u32,
    /// Number of its first triangle.
    first: u32,
    /// Number of its first triangle among the unique ones, mesh after mesh.
    first_unique: u32,
}

/// Triangles per entry of [`Geometry::piece_at`]. Larger: pieces are searched longer; smaller: more
/// memory.
const STRIDE: usize = 16;

/// The expanded scene. Triangles are numbered instance after instance, primitive after primitive,
/// in file order. Nothing is stored per expanded triangle.
pub(super) struct Geometry {
    pub scene: Arc<Scene>,
    /// Middle of the scene: f32 positions are relative to it.
    pub origin: DVec3,
    pub triangle_count: u32,
    pub cell_count: usize,
    /// Turns mesh normals to world normals (not yet unit), per instance.
    pub normal_matrices: Vec<Mat3>,
    pieces: Vec<Piece>,
    /// Per instance its first piece.
    first_piece: Vec<u32>,
    /// The last piece that starts at or before every [`STRIDE`]th triangle.
    piece_at: Vec<u32>,
    /// None without an octree: all triangles are in cell 0.
    cells: Option<CellTable>,
}

/// The cells of cluster instances.
struct CellTable {
    /// Cluster of each unique triangle.
    cluster_of: Vec<u32>,
    /// Per mesh its first cluster.
    first_cluster: Vec<u32>,
    /// Per instance the entry of its first cluster in `cells`.
    first_cell: Vec<u32>,
    cells: Vec<u32>,
}

impl CellTable {
    /// `first_unique`: per mesh and primitive the number of the first unique triangle.
    fn new(scene: &Scene, clusters: &Clusters, octree: &Octree, first_unique: &[Vec<u32>]) -> Self {
        let mut cluster_of = vec![0; scene.unique_triangles() as usize];
        for (number, cluster) in clusters.clusters.iter().enumerate() {
            let first = first_unique[cluster.mesh as usize][cluster.primitive as usize];
            for t in &cluster.triangles {
                cluster_of[(first + t) as usize] = number as u32;
            }
        }
        let mut count = 0;
        let first_cell = scene.instances.iter().map(|i| {
            let first = count;
            count += clusters.of_mesh[i.mesh as usize].len() as u32;
            first
        });
        let first_cell: Vec<u32> = first_cell.collect();
        let first_cluster: Vec<u32> = clusters.of_mesh.iter().map(|c| c.start).collect();
        let mut cells = vec![0; count as usize];
        for (number, cell) in octree.cells.iter().enumerate() {
            for &(instance, cluster) in &cell.content {
                let mesh = scene.instances[instance as usize].mesh as usize;
                cells[(first_cell[instance as usize] + cluster - first_cluster[mesh]) as usize] = number as u32;
            }
        }
        Self { cluster_of, first_cluster, first_cell, cells }
    }
}

impl Geometry {
    /// Numbers the triangles. Without an octree all are in cell 0.
    ///
    /// # Panics
    /// If the scene has more than 2^31 triangles: importers refuse such scenes.
    pub fn new(scene: Arc<Scene>, cells: Option<(&Clusters, &Octree)>) -> Self {
        assert!(scene.triangles() < 1 << 31, "importers refuse scenes of 2^31 triangles and more");
        let mut unique = 0;
        let mut numbered = |p: &Primitive| {
            let first = unique;
            unique += p.triangles.len() as u32;
            first
        };
        let first_unique: Vec<Vec<u32>> =
            scene.meshes.iter().map(|m| m.primitives.iter().map(&mut numbered).collect()).collect();
        let (mut pieces, mut first_piece) = (Vec::new(), Vec::with_capacity(scene.instances.len()));
        let mut triangle_count = 0u32;
        for (i, instance) in scene.instances.iter().enumerate() {
            first_piece.push(pieces.len() as u32);
            for (k, primitive) in scene.meshes[instance.mesh as usize].primitives.iter().enumerate() {
                let first_unique = first_unique[instance.mesh as usize][k];
                pieces.push(Piece { instance: i as u32, primitive: k as u32, first: triangle_count, first_unique });
                triangle_count += primitive.triangles.len() as u32;
            }
        }
        let mut piece_at = Vec::with_capacity(triangle_count as usize / STRIDE + 1);
        let mut piece = 0;
        for triangle in (0..triangle_count).step_by(STRIDE) {
            while pieces.get(piece + 1).is_some_and(|p: &Piece| p.first <= triangle) {
                piece += 1;
            }
            piece_at.push(piece as u32);
        }
        let bounds = scene.bounds();
        Self {
            origin: if bounds.is_empty() { DVec3::ZERO } else { bounds.centre() },
            triangle_count,
            cell_count: cells.map_or(1, |c| c.1.cells.len()),
            normal_matrices: scene.instances.iter().map(normal_matrix).collect(),
            pieces,
            first_piece,
            piece_at,
            cells: cells.map(|(clusters, octree)| CellTable::new(&scene, clusters, octree, &first_unique)),
            scene,
        }
    }

    #[inline]
    fn piece_of(&self, triangle: u32) -> &Piece {
        let mut piece = self.piece_at[triangle as usize / STRIDE] as usize;
        while self.pieces.get(piece + 1).is_some_and(|p| p.first <= triangle) {
            piece += 1;
        }
        &self.pieces[piece]
    }

    /// Whether triangles are in cells of an octree.
    pub fn has_cells(&self) -> bool {
        self.cells.is_some()
    }

    /// The octree cell of a triangle.
    pub fn cell_of(&self, triangle: u32) -> u32 {
        let Some(table) = &self.cells else { return 0 };
        let piece = self.piece_of(triangle);
        self.cell(piece.instance, table.cluster_of[(piece.first_unique + triangle - piece.first) as usize])
    }

    /// The octree cell of a cluster of an instance.
    pub fn cell(&self, instance: u32, cluster: u32) -> u32 {
        let Some(table) = &self.cells else { return 0 };
        let mesh = self.scene.instances[instance as usize].mesh as usize;
        table.cells[(table.first_cell[instance as usize] + cluster - table.first_cluster[mesh]) as usize]
    }

    /// Number of the first triangle of an instance's primitive.
    pub fn first_triangle(&self, instance: u32, primitive: u32) -> u32 {
        self.pieces[(self.first_piece[instance as usize] + primitive) as usize].first
    }

    pub fn source(&self, triangle: u32) -> TriangleSource {
        let piece = self.piece_of(triangle);
        TriangleSource {
            instance: piece.instance,
            mesh: self.scene.instances[piece.instance as usize].mesh,
            primitive: piece.primitive,
            triangle: triangle - piece.first,
        }
    }

    pub fn primitive(&self, source: &TriangleSource) -> &Primitive {
        &self.scene.meshes[source.mesh as usize].primitives[source.primitive as usize]
    }

    /// World corners in f64.
    pub fn corners_world(&self, triangle: u32) -> [DVec3; 3] {
        let source = self.source(triangle);
        let primitive = self.primitive(&source);
        let world_from_mesh = &self.scene.instances[source.instance as usize].world_from_mesh;
        primitive.triangles[source.triangle as usize]
            .map(|v| world_from_mesh.transform_point3(primitive.positions[v as usize].as_dvec3()))
    }
}

/// Inverse transpose, scaled to largest entry 1 so that f32 holds it for any unit of the mesh.
fn normal_matrix(instance: &Instance) -> Mat3 {
    let m = instance.world_from_mesh.matrix3;
    // The cofactor matrix is the inverse transpose times the determinant; unlike the inverse it
    // exists for flat matrices as well.
    let cofactors = DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis))
        * m.determinant().signum();
    let largest = cofactors.to_cols_array().iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    if largest > 0.0 { (cofactors * (1.0 / largest)).as_mat3() } else { Mat3::IDENTITY }
}
