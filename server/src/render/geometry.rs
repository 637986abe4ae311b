//! The expanded scene: every triangle of every instance has a number, a source and a cell.

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
    first: u32,
}

/// The expanded scene. Triangles are numbered instance after instance, primitive after primitive, in file order.
pub(super) struct Geometry {
    pub scene: Arc<Scene>,
    /// Middle of the scene: f32 positions are relative to it.
    pub origin: DVec3,
    pub triangle_count: u32,
    pub cell_count: usize,
    /// Turns mesh normals to world normals (not yet unit), per instance.
    pub normal_matrices: Vec<Mat3>,
    pieces: Vec<Piece>,
    piece_of: Vec<u32>,
    /// Cell per triangle; empty without an octree.
    cell_of: Vec<u32>,
}

impl Geometry {
    /// Numbers the triangles. Without an octree all are in cell 0.
    ///
    /// # Panics
    /// If the scene has more than 2^31 triangles: importers refuse such scenes.
    pub fn new(scene: Arc<Scene>, cells: Option<(&Clusters, &Octree)>) -> Self {
        assert!(scene.triangles() < 1 << 31, "importers refuse scenes of 2^31 triangles and more");
        let mut pieces = Vec::new();
        let mut piece_of = Vec::with_capacity(scene.triangles() as usize);
        let mut first_piece_of_instance = Vec::with_capacity(scene.instances.len());
        for (i, instance) in scene.instances.iter().enumerate() {
            first_piece_of_instance.push(pieces.len());
            for (k, primitive) in scene.meshes[instance.mesh as usize].primitives.iter().enumerate() {
                let first = piece_of.len() as u32;
                piece_of.resize(piece_of.len() + primitive.triangles.len(), pieces.len() as u32);
                pieces.push(Piece { instance: i as u32, primitive: k as u32, first });
            }
        }
        let mut cell_of = Vec::new();
        if let Some((clusters, octree)) = cells {
            cell_of = vec![0; piece_of.len()];
            for (number, cell) in octree.cells.iter().enumerate() {
                for &(instance, cluster) in &cell.content {
                    let cluster = &clusters.clusters[cluster as usize];
                    let piece = first_piece_of_instance[instance as usize] + cluster.primitive as usize;
                    for &t in &cluster.triangles {
                        cell_of[(pieces[piece].first + t) as usize] = number as u32;
                    }
                }
            }
        }
        let bounds = scene.bounds();
        Self {
            origin: if bounds.is_empty() { DVec3::ZERO } else { bounds.centre() },
            triangle_count: piece_of.len() as u32,
            cell_count: cells.map_or(1, |c| c.1.cells.len()),
            normal_matrices: scene.instances.iter().map(normal_matrix).collect(),
            pieces,
            piece_of,
            cell_of,
            scene,
        }
    }

    #[inline]
    pub fn cell_of(&self, triangle: u32) -> u32 {
        self.cell_of.get(triangle as usize).copied().unwrap_or(0)
    }

    pub fn source(&self, triangle: u32) -> TriangleSource {
        let piece = &self.pieces[self.piece_of[triangle as usize] as usize];
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
    // The cofactor matrix is the inverse transpose times the determinant; unlike the inverse it exists for flat matrices as well.
    let cofactors = DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis))
        * m.determinant().signum();
    let largest = cofactors.to_cols_array().iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    if largest > 0.0 { (cofactors * (1.0 / largest)).as_mat3() } else { Mat3::IDENTITY }
}
