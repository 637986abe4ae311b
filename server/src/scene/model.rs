//! The scene as later stages see it.

use glam::{DAffine3, DVec3, Vec2, Vec3};
use ldi_protocol::{
    Aabb,
    mesh::{Alpha, Material, Wrap},
};
use rayon::prelude::*;

/// A static, diffuse scene. Every number is in range and every value finite: importers check this.
#[derive(Debug, Clone, Default)]
pub struct Scene {
    /// File name or built-in name.
    pub name: String,
    /// Meshes, each stored once.
    pub meshes: Vec<Mesh>,
    /// Where meshes stand.
    pub instances: Vec<Instance>,
    /// Materials; primitives refer to them. At least one.
    pub materials: Vec<Material>,
    /// Textures; materials refer to them.
    pub textures: Vec<SceneTexture>,
    /// Rooms named by the file.
    pub rooms: Vec<RoomAnnotation>,
    /// Openings named by the file.
    pub portals: Vec<PortalAnnotation>,
    /// Building elements that the file names, ascending by node.
    pub elements: Vec<SceneElement>,
    /// World positions of the file's cameras and spawn points: where its author expects eyes.
    pub viewpoints: Vec<DVec3>,
    /// What was left out or changed on the way in, for the build report.
    pub notes: Vec<Note>,
}

/// What the file says about the thing that a node shows.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct SceneElement {
    /// [`Instance::node`] of the instances that show it.
    pub node: u32,
    /// Class, for example `IfcDoor`.
    pub class: String,
    /// Name; empty where there is none.
    pub name: String,
    /// `GlobalId`: 22 characters, the same in every export of the element.
    pub guid: String,
}

/// What is drawn where a file names no material.
pub(crate) const WHITE: Material = Material {
    base_colour: [1.0; 4],
    texture: None,
    alpha: Alpha::Opaque,
    unlit: false,
    double_sided: true,
    wrap: [Wrap::Repeat; 2],
};

/// Something skipped, and why.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Note {
    /// What was skipped or changed.
    pub what: String,
    /// Why.
    pub why: String,
}

/// A mesh: primitives in one space.
#[derive(Debug, Clone, Default)]
pub struct Mesh {
    /// Name in the file, for messages.
    pub name: String,
    /// Primitives in file order, so that (mesh, primitive, triangle) names a source triangle. One
    /// that was left out (points, lines) stays as an empty one.
    pub primitives: Vec<Primitive>,
}

/// Triangles of one material.
#[derive(Debug, Clone, Default)]
pub struct Primitive {
    /// Position in [`Scene::materials`].
    pub material: u32,
    /// Mesh space, metres.
    pub positions: Vec<Vec3>,
    /// Unit normals, one per vertex (made from the triangles where the file has none).
    pub normals: Vec<Vec3>,
    /// Texture coordinates, one per vertex, or empty.
    pub uvs: Vec<Vec2>,
    /// Linear colour multipliers, one per vertex, or empty.
    pub colours: Vec<[f32; 3]>,
    /// Vertex numbers, three per triangle, in file order; strips and fans are unrolled.
    pub triangles: Vec<[u32; 3]>,
}

/// A mesh placed in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instance {
    /// Node number in the file (glTF), else the instance's own number.
    pub node: u32,
    /// Position in [`Scene::meshes`].
    pub mesh: u32,
    /// Placement. It has an inverse. A negative determinant mirrors the mesh and so swaps the
    /// front and back of its triangles; this matters only where single-sided faces are culled.
    pub world_from_mesh: DAffine3,
}

/// A decoded image, row 0 on top.
#[derive(Debug, Clone, Default)]
pub struct SceneTexture {
    /// Name or number in the file.
    pub name: String,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// sRGB colour, linear alpha.
    pub rgba: Vec<[u8; 4]>,
    /// The PNG or JPEG file that the texels were decoded from; empty where they come from no file.
    pub file: Vec<u8>,
}

/// A room that the file names: a convex or box-shaped cell.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RoomAnnotation {
    /// Name.
    pub name: String,
    /// Bounds in the world.
    pub bounds: Aabb,
}

/// An opening that the file names: a convex polygon between two rooms.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PortalAnnotation {
    /// Names of the rooms on its two sides.
    pub rooms: [String; 2],
    /// Corners in the world, in order.
    pub corners: Vec<DVec3>,
}

impl Scene {
    /// Triangles with every instance counted.
    pub fn triangles(&self) -> u64 {
        self.instances.iter().map(|i| self.meshes[i.mesh as usize].triangles()).sum()
    }
    /// Triangles with each mesh counted once.
    pub fn unique_triangles(&self) -> u64 {
        self.meshes.iter().map(Mesh::triangles).sum()
    }
    /// Moves all of it: an affine map that takes boxes to boxes, such as quarter turns and scales.
    pub(super) fn transform(&mut self, world: &DAffine3) {
        for i in &mut self.instances {
            i.world_from_mesh = *world * i.world_from_mesh;
        }
        for room in &mut self.rooms {
            let corners = [room.bounds.min, room.bounds.max];
            room.bounds = Aabb::from_points(corners.map(|c| world.transform_point3(c)));
        }
        let corners = self.portals.iter_mut().flat_map(|p| &mut p.corners);
        for corner in corners.chain(&mut self.viewpoints) {
            *corner = world.transform_point3(*corner);
        }
    }
    /// World bounds of all instances, of every vertex. Takes a pass over the unique vertices and
    /// one over the instances; placed vertex by vertex are only instances near the scene's border.
    pub fn bounds(&self) -> Aabb {
        let of_meshes: Vec<Aabb> = self.meshes.par_iter().map(Mesh::bounds).collect();
        // Contain the vertices, but reach farther where the placement turns.
        let outer: Vec<Aabb> = self.instances.iter().map(|i| placed(&of_meshes[i.mesh as usize], i)).collect();
        let mut bounds = Aabb::EMPTY;
        let mut grow = |at: usize| {
            let outer = &outer[at];
            // Corners and vertices round differently by a hair.
            let slack = outer.min.abs().max(outer.max.abs()).max_element() * 1e-12;
            let inside = bounds.contains(outer.min - slack) && bounds.contains(outer.max + slack);
            if !outer.is_empty() && !inside {
                let i = &self.instances[at];
                let vertices = self.meshes[i.mesh as usize].primitives.iter().flat_map(|p| &p.positions);
                bounds = vertices.fold(bounds, |b, p| b.grown_to(i.world_from_mesh.transform_point3(p.as_dvec3())));
            }
        };
        // Those that reach farthest first: most others lie within their bounds.
        for axis in 0..3 {
            (0..outer.len())
                .max_by(|a, b| outer[*a].max[axis].total_cmp(&outer[*b].max[axis]))
                .into_iter()
                .for_each(&mut grow);
            (0..outer.len())
                .min_by(|a, b| outer[*a].min[axis].total_cmp(&outer[*b].min[axis]))
                .into_iter()
                .for_each(&mut grow);
        }
        (0..outer.len()).for_each(grow);
        bounds
    }
}

/// The box of a placed box.
fn placed(bounds: &Aabb, instance: &Instance) -> Aabb {
    if bounds.is_empty() {
        return Aabb::EMPTY;
    }
    Aabb::from_points(bounds.corners().map(|c| instance.world_from_mesh.transform_point3(c)))
}

impl Mesh {
    /// Mesh-space bounds.
    pub fn bounds(&self) -> Aabb {
        Aabb::from_points(self.primitives.iter().flat_map(|p| &p.positions).map(|p| p.as_dvec3()))
    }
    /// Triangles of all primitives.
    pub fn triangles(&self) -> u64 {
        self.primitives.iter().map(|p| p.triangles.len() as u64).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DQuat};

    /// Against a pass over every vertex of every instance.
    #[test]
    fn bounds_are_those_of_every_vertex() {
        let mut seed = 5u64;
        let mut next = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 40) as f64 / (1u64 << 24) as f64 - 0.5
        };
        for instances in [0, 1, 2, 7, 60] {
            let mut scene = Scene::default();
            for size in [0, 1, 5, 40] {
                let positions = (0..size).map(|_| DVec3::new(next(), next(), next()).as_vec3()).collect();
                let primitives = vec![Primitive { positions, ..Primitive::default() }];
                scene.meshes.push(Mesh { primitives, ..Mesh::default() });
            }
            for node in 0..instances {
                let turn = DQuat::from_rotation_y(next() * 6.0) * DQuat::from_rotation_x(next() * 6.0);
                let matrix3 = DMat3::from_quat(turn) * DMat3::from_diagonal(DVec3::new(1.0, 3.0, next()));
                let translation = DVec3::new(next(), next(), next()) * 20.0;
                let world_from_mesh = DAffine3 { matrix3, translation };
                scene.instances.push(Instance { node, mesh: node % 4, world_from_mesh });
            }
            let mut want = Aabb::EMPTY;
            for i in &scene.instances {
                for p in &scene.meshes[i.mesh as usize].primitives[0].positions {
                    want = want.grown_to(i.world_from_mesh.transform_point3(p.as_dvec3()));
                }
            }
            assert_eq!(scene.bounds(), want, "{instances} instances");
        }
    }
}
