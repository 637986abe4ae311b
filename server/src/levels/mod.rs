//! Stage 3: levels of detail of what cells draw as geometry.
//!
//! In: the scene, its clusters and cells. Out: per cell coarser and coarser meshes, each with the
//! distance that it stays within: [`Levels`].
//!
//! The unit of simplification is a **part**: what one cell draws of one primitive of one mesh. A
//! mesh that lies within one cell is whole, and its instances share what is made of it. Where a
//! part meets another, of the same mesh in another cell or of another primitive, its vertices
//! stay, so that neighbours meet whichever levels they are drawn at.
//!
//! ```text
//! cell -> parts -> chains of meshes that may err by ever more (`simplify`)
//!                  each with a bound on how far it lies from the full part (`deviation`)
//!      -> levels: thresholds of deviation, each worth its triangles (`cells`)
//! ```
//!
//! Parts with alpha masks stay in full: a simplified leaf covers other pixels.

mod cells;
mod deviation;
mod parts;
mod simplify;

pub(crate) use deviation::SurfaceTree;

use crate::octree::{Clusters, Octree};
use crate::scene::Scene;
use glam::{DMat3, Vec3};
use ldi_protocol::{Aabb, codec::cell};
use std::borrow::Cow;

/// At most 256 triangles of one primitive: a cluster, or a part of a simplified mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Piece<'a> {
    /// Position in `Scene::meshes`.
    pub mesh: u32,
    /// Position in the mesh's primitives.
    pub primitive: u32,
    /// Vertex numbers of the primitive, three per triangle.
    pub triangles: Cow<'a, [[u32; 3]]>,
    /// Corners, numbered through all triangles and ascending, that have another normal than their
    /// vertex; unit length.
    pub turned: Cow<'a, [(u32, Vec3)]>,
}

/// A coarser mesh of a cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Level {
    /// No point of it lies farther from the cell's surfaces, nor they from it, metres; an f32.
    pub deviation_m: f64,
    /// Triangles, instances counted.
    pub triangles: u32,
    /// (instance in `Scene::instances`, number of a piece: see [`Levels::piece`]).
    pub content: Vec<(u32, u32)>,
}

/// Levels of detail of all cells.
#[derive(Debug, Clone, Default)]
pub struct Levels {
    /// Simplified pieces; their numbers go on from those of the clusters.
    pub pieces: Vec<Piece<'static>>,
    /// Per cell, fine to coarse.
    pub cells: Vec<Vec<Level>>,
    /// Position step of each mesh, as a power of two: the same for all its pieces, so that
    /// neighbours meet without cracks.
    pub position_steps_log2: Vec<i8>,
}

impl Levels {
    /// Simplifies what every cell draws; deterministic, on all cores.
    pub fn build(scene: &Scene, clusters: &Clusters, octree: &Octree) -> Self {
        let parts = parts::find(clusters, octree);
        let chains = simplify::chains(scene, clusters, &parts.parts);
        cells::assemble(scene, clusters, &parts, chains)
    }

    /// No levels: every cell is drawn in full.
    pub fn none(scene: &Scene, octree: &Octree) -> Self {
        let cells = vec![Vec::new(); octree.cells.len()];
        Self { pieces: Vec::new(), cells, position_steps_log2: position_steps_log2(scene) }
    }

    /// A piece by its number: clusters come first, then [`Levels::pieces`].
    pub fn piece<'a>(&'a self, clusters: &Clusters, scene: &Scene, number: u32) -> Piece<'a> {
        if let Some(simplified) = number.checked_sub(clusters.clusters.len() as u32) {
            let Piece { mesh, primitive, triangles, turned } = &self.pieces[simplified as usize];
            let (triangles, turned) = (Cow::Borrowed(&**triangles), Cow::Borrowed(&**turned));
            return Piece { mesh: *mesh, primitive: *primitive, triangles, turned };
        }
        let cluster = &clusters.clusters[number as usize];
        let all = &scene.meshes[cluster.mesh as usize].primitives[cluster.primitive as usize].triangles;
        let triangles = cluster.triangles.iter().map(|t| all[*t as usize]).collect();
        Piece { mesh: cluster.mesh, primitive: cluster.primitive, triangles, turned: Cow::Borrowed(&[]) }
    }
}

/// How many times longer a vector can get: an upper bound of the largest singular value, exact
/// where the axes stay at right angles (Gershgorin's circles of the Gram matrix).
fn largest_stretch(m: &DMat3) -> f64 {
    let gram = m.transpose() * *m;
    let row = |k: usize| gram.row(k).abs().element_sum();
    row(0).max(row(1)).max(row(2)).sqrt()
}

/// See [`Levels::position_steps_log2`].
fn position_steps_log2(scene: &Scene) -> Vec<i8> {
    let mut scales = vec![0.0f64; scene.meshes.len()];
    for i in &scene.instances {
        let m = &i.world_from_mesh.matrix3;
        let s = m.x_axis.length().max(m.y_axis.length()).max(m.z_axis.length());
        scales[i.mesh as usize] = scales[i.mesh as usize].max(s);
    }
    let steps = scene.meshes.iter().zip(scales).map(|(m, s)| {
        let bounds = Aabb::from_points(m.primitives.iter().flat_map(|p| &p.positions).map(|p| p.as_dvec3()));
        cell::position_step_log2(if bounds.is_empty() { 0.0 } else { bounds.size().max_element() }, s)
    });
    steps.collect()
}

#[cfg(test)]
mod tests;
