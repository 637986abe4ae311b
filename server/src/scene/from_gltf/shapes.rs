//! Meshes as they are shown: with morph targets by their default weights (glTF 2.0 section
//! 3.7.2.2), with skins in the pose of their joints (section 3.7.3).
//!
//! In: instances of meshes. Out: instances of shapes. A mesh that no instance changes is its own
//! shape, under its own number; of a mesh that is changed in one way alone, that shape takes its
//! number; further ones follow after all meshes. A skin whose joints agree moves the instance and
//! not the vertices. A skin's joints place the mesh in the world; its node's placement does not
//! count.

use std::collections::HashMap;

use glam::{DAffine3, DMat4, DVec3, Vec3};
use gltf::json::Root;
use gltf::json::mesh::Semantic;
use gltf::json::validation::Checked;

use super::super::error::Fault;
use super::super::limits::Limits;
use super::super::model::Note;
use super::super::origin;
use super::accessors::{Data, MATRICES};
use super::extensions::Additions;
use super::nodes::{self, Placed};

/// Difference of placements, as a part of their size, that counts as none: rounding of f32 input.
const SAME: f64 = 1.0e-5;

/// A mesh as it is shown.
#[derive(Debug)]
pub(super) struct Shape {
    /// Number of the mesh.
    pub(super) mesh: usize,
    /// What changes its vertices.
    pub(super) deform: Option<Deform>,
}

/// Changes of vertices.
#[derive(Debug)]
pub(super) enum Deform {
    /// By morph targets of these weights.
    Morph(Vec<f32>),
    /// By joints, after morph targets.
    Skin {
        /// Of morph targets.
        weights: Vec<f32>,
        /// World from mesh, for each joint.
        joints: Vec<DAffine3>,
        /// World position of the shape's own origin.
        origin: DVec3,
    },
}

impl Deform {
    /// Weights of morph targets.
    pub(super) fn weights(&self) -> &[f32] {
        match self {
            Self::Morph(weights) | Self::Skin { weights, .. } => weights,
        }
    }
}

/// Shapes alike for two instances of one mesh.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Key {
    Plain,
    /// Bits of the weights.
    Morph(Vec<u32>),
    /// Number of the node.
    Skin(u32),
}

/// Shapes of all meshes and instances; the instances then refer to them.
pub(super) fn shapes(
    root: &Root,
    additions: &Additions,
    data: &Data<'_>,
    placed: &mut Placed,
    limits: &Limits,
    notes: &mut Vec<Note>,
) -> Result<Vec<Shape>, Fault> {
    let mut skins = Skins { root, data, inverse: HashMap::new(), left: limits.instances };
    let mut out: Vec<Shape> = (0..root.meshes.len()).map(|mesh| Shape { mesh, deform: None }).collect();
    let (mut morphed, mut posed) = (0, 0);
    let mut wanted: Vec<(Key, Option<Deform>)> = Vec::with_capacity(placed.instances.len());
    let mut kept = Vec::with_capacity(placed.instances.len());
    for instance in &placed.instances {
        let mut instance = *instance;
        let node = &root.nodes[instance.node as usize];
        let mesh = &root.meshes[instance.mesh as usize];
        let weights = node.weights.as_ref().or(mesh.weights.as_ref());
        let weights = weights.filter(|w| w.iter().all(|w| w.is_finite()) && w.iter().any(|w| *w != 0.0));
        let weights = weights.cloned().unwrap_or_default();
        let many = additions.nodes.get(instance.node as usize).is_some_and(|n| n.instancing().is_some());
        let mut wish = match weights.is_empty() {
            true => (Key::Plain, None),
            false => (Key::Morph(weights.iter().map(|w| w.to_bits()).collect()), Some(Deform::Morph(weights.clone()))),
        };
        if let Some(skin) = node.skin.filter(|_| !many && has_joints(mesh)) {
            let joints = skins
                .joints(skin.value(), &placed.world_from_node)
                .map_err(|f| f.within(format!("node {}", instance.node)))?;
            match common(&joints) {
                Some(world_from_mesh) if is_same(&world_from_mesh, &instance.world_from_mesh) => {}
                Some(world_from_mesh) => {
                    posed += 1;
                    instance.world_from_mesh = world_from_mesh;
                }
                None => {
                    posed += 1;
                    let origin = origin::of(joints.iter().map(|j| j.translation));
                    instance.world_from_mesh = DAffine3::from_translation(origin);
                    wish = (Key::Skin(instance.node), Some(Deform::Skin { weights, joints, origin }));
                }
            }
        }
        if nodes::is_flat(&instance.world_from_mesh) {
            continue;
        }
        morphed += usize::from(matches!(wish.0, Key::Morph(_)));
        wanted.push(wish);
        kept.push(instance);
    }
    placed.instances = kept;
    // A mesh that some instance shows as it is keeps its number for that.
    let mut numbers: HashMap<(u32, Key), u32> = HashMap::new();
    for (instance, (key, _)) in placed.instances.iter().zip(&wanted) {
        if *key == Key::Plain {
            numbers.insert((instance.mesh, Key::Plain), instance.mesh);
        }
    }
    let mut taken: Vec<bool> = (0..out.len() as u32).map(|m| numbers.contains_key(&(m, Key::Plain))).collect();
    for (instance, (key, deform)) in placed.instances.iter_mut().zip(wanted) {
        let mesh = instance.mesh;
        instance.mesh = *numbers.entry((mesh, key)).or_insert_with(|| {
            let own = &mut taken[mesh as usize];
            if !*own {
                *own = true;
                out[mesh as usize].deform = deform;
                return mesh;
            }
            out.push(Shape { mesh: mesh as usize, deform });
            out.len() as u32 - 1
        });
    }
    let mut note = |count: usize, what: &str, why: &str| {
        if count > 0 {
            notes.push(Note { what: format!("{count} {what}"), why: why.into() });
        }
    };
    note(morphed, "instances with morph targets", "shown by their default weights");
    note(posed, "instances with skins", "shown in the pose of their joints");
    Ok(out)
}

fn has_joints(mesh: &gltf::json::Mesh) -> bool {
    mesh.primitives.iter().any(|p| p.attributes.contains_key(&Checked::Valid(Semantic::Joints(0))))
}

fn is_same(a: &DAffine3, b: &DAffine3) -> bool {
    let size = a.matrix3.to_cols_array().iter().chain(&a.translation.to_array()).fold(1.0f64, |m, x| m.max(x.abs()));
    a.abs_diff_eq(*b, SAME * size)
}

/// The placement that all joints agree on.
fn common(joints: &[DAffine3]) -> Option<DAffine3> {
    let first = joints.first()?;
    // Placements by tiny numbers, as of centimetres, are compared by their own size.
    let size = first.matrix3.to_cols_array().iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let alike = |j: &DAffine3| {
        first.matrix3.abs_diff_eq(j.matrix3, SAME * size)
            && first.translation.abs_diff_eq(j.translation, SAME * first.translation.abs().max_element().max(size))
    };
    joints.iter().all(alike).then_some(*first)
}

/// Skins of a document.
struct Skins<'a> {
    root: &'a Root,
    data: &'a Data<'a>,
    /// Joint from mesh, for each joint, by skin.
    inverse: HashMap<usize, Vec<DAffine3>>,
    /// Placements of joints that may still be made.
    left: u64,
}

impl Skins<'_> {
    /// World from mesh, for each joint of a skin.
    fn joints(&mut self, skin: usize, world_from_node: &[DAffine3]) -> Result<Vec<DAffine3>, Fault> {
        let place = format!("skin {skin}");
        let s = self.root.skins.get(skin).ok_or_else(|| Fault::broken(&place, "does not exist"))?;
        let count = s.joints.len() as u64;
        if count > self.left {
            return Err(Fault::too_large(place, "or more joints of all skins", count, self.left));
        }
        self.left -= count;
        if !self.inverse.contains_key(&skin) {
            let made = match s.inverse_bind_matrices {
                None => vec![DAffine3::IDENTITY; s.joints.len()],
                Some(accessor) => {
                    let most = (s.joints.len() as u64).max(self.root.nodes.len() as u64);
                    let elements =
                        self.data.elements(accessor.value(), &MATRICES, most).map_err(|f| f.within(&place))?;
                    let affine = |m: [f32; 16]| {
                        let m = DMat4::from_cols_array(&m.map(f64::from));
                        DAffine3::from_mat4(m)
                    };
                    elements.vectors(affine)
                }
            };
            if made.len() < s.joints.len() {
                let problem = format!("{} inverse bind matrices for {} joints", made.len(), s.joints.len());
                return Err(Fault::broken(place, problem));
            }
            self.inverse.insert(skin, made);
        }
        let joint_from_mesh = &self.inverse[&skin];
        let joint = |(joint, joint_from_mesh): (&gltf::json::Index<gltf::json::Node>, &DAffine3)| {
            let world = world_from_node.get(joint.value());
            let world =
                world.ok_or_else(|| Fault::broken(&place, format!("joint {} does not exist", joint.value())))?;
            let world_from_mesh = *world * *joint_from_mesh;
            match world_from_mesh.is_finite() {
                true => Ok(world_from_mesh),
                false => Err(Fault::broken(&place, format!("the placement of joint {} is not finite", joint.value()))),
            }
        };
        s.joints.iter().zip(joint_from_mesh).map(joint).collect()
    }
}

/// Joints of a vertex and how much each moves it: sets of four.
pub(super) type Influences = Vec<(Vec<[f32; 4]>, Vec<[f32; 4]>)>;

/// Moves vertices by joints; returns whether triangles turn inside out by it.
///
/// # Errors
/// If a vertex names a joint that the skin does not have.
pub(super) fn pose(
    positions: &mut [Vec3],
    normals: &mut [Vec3],
    influences: &Influences,
    joints: &[DAffine3],
    origin: DVec3,
) -> Result<bool, Fault> {
    let first = joints.first().ok_or_else(|| Fault::broken("skin", "has no joints"))?;
    for (v, position) in positions.iter_mut().enumerate() {
        let (mut sum, mut blended) = (0.0, DAffine3::ZERO);
        for (names, weights) in influences {
            for (name, weight) in names[v].into_iter().zip(weights[v]) {
                let weight = f64::from(weight);
                if !(weight > 0.0 && weight.is_finite()) {
                    continue;
                }
                let joint = joints.get(name as usize).ok_or_else(|| {
                    Fault::broken(format!("vertex {v}"), format!("joint {name} of {} does not exist", joints.len()))
                })?;
                sum += weight;
                blended.matrix3 += joint.matrix3 * weight;
                blended.translation += joint.translation * weight;
            }
        }
        let world = match sum > 0.0 {
            true => DAffine3 { matrix3: blended.matrix3 * sum.recip(), translation: blended.translation / sum },
            false => *first,
        };
        *position = (world.transform_point3(position.as_dvec3()) - origin).as_vec3();
        if let Some(normal) = normals.get_mut(v) {
            let m = world.matrix3;
            let (x, y, z) = (m.x_axis, m.y_axis, m.z_axis);
            // The matrix of cofactors: the inverse transposed, without its division.
            let n = normal.as_dvec3();
            let turned = y.cross(z) * n.x + z.cross(x) * n.y + x.cross(y) * n.z;
            let towards = if m.determinant() < 0.0 { -turned } else { turned };
            *normal = towards.normalize_or_zero().as_vec3();
        }
    }
    Ok(first.matrix3.determinant() < 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    #[test]
    fn joints_that_agree_are_one_placement() {
        let placed = DAffine3::from_scale_rotation_translation(DVec3::splat(0.01), DQuat::IDENTITY, DVec3::X);
        assert_eq!(common(&[placed; 3]), Some(placed));
        let other = DAffine3::from_translation(DVec3::X);
        assert!(common(&[placed, other]).is_none() && common(&[]).is_none());
        assert!(is_same(&placed, &placed) && !is_same(&placed, &other));
    }

    #[test]
    fn vertices_follow_their_joints() {
        let quarter = DAffine3::from_quat(DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2));
        let joints = [DAffine3::IDENTITY, quarter];
        let mut positions = [Vec3::X, Vec3::X, Vec3::X, Vec3::X];
        let mut normals = [Vec3::X; 4];
        let names = vec![[0.0, 1.0, 0.0, 0.0]; 4];
        let weights = vec![[1.0, 0.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0], [0.5, 0.5, 0.0, 0.0], [0.0; 4]];
        let turned = pose(&mut positions, &mut normals, &vec![(names, weights)], &joints, DVec3::ZERO).expect("poses");
        assert!(!turned);
        let near = |a: Vec3, b: Vec3| a.distance(b) < 1e-6;
        assert!(near(positions[0], Vec3::X) && near(positions[1], Vec3::Y) && near(positions[3], Vec3::X));
        assert!(near(positions[2], Vec3::new(0.5, 0.5, 0.0)));
        assert!(near(normals[1], Vec3::Y) && near(normals[2], Vec3::new(1.0, 1.0, 0.0).normalize()));
        let beyond: Influences = vec![(vec![[9.0; 4]], vec![[1.0; 4]])];
        assert!(pose(&mut positions[..1], &mut [], &beyond, &joints, DVec3::ZERO).is_err());
    }
}
