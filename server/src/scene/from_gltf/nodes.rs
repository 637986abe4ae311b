//! Nodes (glTF 2.0 section 3.5): from a hierarchy of placements to a flat list of instances.
//!
//! Nodes must form trees: every child exists, no node has two parents, none is its own ancestor,
//! none lies deeper than the limit. This is checked for all nodes, whether or not the shown scene
//! contains them. Placements multiply in f64 from the root down. Instances stand in node order, so
//! that they do not depend on how the tree is walked.
//!
//! A mirroring placement (negative determinant) stays as it is. It swaps front and back of its
//! triangles, as the specification (section 3.7.4) asks to be undone; this matters only where
//! single-sided faces are culled, and is undone there by the determinant's sign. A placement that
//! flattens its mesh to nothing (no inverse) is left out: exporters hide nodes with scale zero.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use gltf::json::Root;

use super::super::error::Fault;
use super::super::files::listed;
use super::super::limits::Limits;
use super::super::model::{Instance, Note};
use super::container::NodeTransform;

/// Determinant over the product of the axes' lengths below which a placement counts as flat: about
/// the rounding of f32 input, so that nothing invertible is lost.
const FLAT: f64 = 1.0e-9;
/// How far a matrix's last row may be from (0, 0, 0, 1).
const AFFINE: f64 = 1.0e-6;

/// Names of empty nodes that engines and exporters give to places where players enter a scene, in
/// lower case, as parts of the name.
const SPAWN_NAMES: [&str; 3] = ["spawn", "playerstart", "player_start"];
/// More viewpoints than this are left out: a camera animation baked to nodes names no place to
/// start.
const MOST_VIEWPOINTS: usize = 64;

/// Instances of the shown scene in node order, and the world positions of its cameras and spawn
/// points.
pub(super) fn instances(
    root: &Root,
    transforms: &[NodeTransform],
    limits: &Limits,
    notes: &mut Vec<Note>,
) -> Result<(Vec<Instance>, Vec<DVec3>), Fault> {
    let parents = parents(root)?;
    let shown = shown_roots(root, &parents, notes)?;
    let mut out = Vec::new();
    let mut viewpoints = Vec::new();
    let mut flat = Vec::new();
    // One walk over everything: shown trees carry their placement, others None.
    let mut stack: Vec<(usize, u32, Option<DAffine3>)> = Vec::new();
    for node in (0..parents.len()).filter(|&n| parents[n].is_none()) {
        stack.push((node, 1, shown[node].then_some(DAffine3::IDENTITY)));
    }
    let mut seen = vec![false; root.nodes.len()];
    while let Some((n, depth, world_from_parent)) = stack.pop() {
        seen[n] = true;
        if depth > limits.node_depth {
            return Err(Fault::too_large(
                format!("node {n}"),
                "or more nodes from a root down",
                depth,
                limits.node_depth,
            ));
        }
        let node = &root.nodes[n];
        let parent_from_node =
            placement(&transforms[n]).map_err(|problem| Fault::broken(format!("node {n}"), problem))?;
        let world_from_node = world_from_parent.map(|w| w * parent_from_node);
        for child in node.children.iter().flatten() {
            stack.push((child.value(), depth + 1, world_from_node));
        }
        if let Some(world) = world_from_node
            && is_viewpoint(node)
            && viewpoints.len() < MOST_VIEWPOINTS
        {
            viewpoints.push(world.translation);
        }
        let Some(mesh) = &node.mesh else { continue };
        if mesh.value() >= root.meshes.len() {
            return Err(Fault::broken(format!("node {n}"), format!("mesh {} does not exist", mesh.value())));
        }
        let Some(world_from_mesh) = world_from_node else { continue };
        if is_flat(&world_from_mesh) {
            flat.push(node.name.clone().unwrap_or_else(|| format!("node {n}")));
        } else {
            out.push(Instance { node: n as u32, mesh: mesh.value() as u32, world_from_mesh });
        }
        if out.len() as u64 > limits.instances {
            return Err(Fault::too_large("nodes", "or more instances", out.len(), limits.instances));
        }
    }
    if let Some(n) = seen.iter().position(|s| !s) {
        return Err(Fault::broken(format!("node {n}"), "is its own ancestor"));
    }
    out.sort_unstable_by_key(|i| i.node);
    if !flat.is_empty() {
        let what = format!("nodes whose placement has no inverse: {}", listed(&flat));
        notes.push(Note { what, why: "a mesh scaled to nothing has no surface".into() });
    }
    Ok((out, viewpoints))
}

/// Whether a node is a camera, or an empty node named as a spawn point.
fn is_viewpoint(node: &gltf::json::Node) -> bool {
    let is_spawn = |name: &String| {
        let name = name.to_ascii_lowercase();
        SPAWN_NAMES.iter().any(|part| name.contains(part))
    };
    node.camera.is_some() || node.mesh.is_none() && node.name.as_ref().is_some_and(is_spawn)
}

/// Parent of each node; at most one each.
fn parents(root: &Root) -> Result<Vec<Option<usize>>, Fault> {
    let mut parents = vec![None; root.nodes.len()];
    for (n, node) in root.nodes.iter().enumerate() {
        for child in node.children.iter().flatten().map(|c| c.value()) {
            let slot = parents
                .get_mut(child)
                .ok_or_else(|| Fault::broken(format!("node {n}"), format!("child {child} does not exist")))?;
            if let Some(other) = slot.replace(n) {
                return Err(Fault::broken(format!("node {child}"), format!("has two parents, {other} and {n}")));
            }
        }
    }
    Ok(parents)
}

/// Which nodes are roots of the shown scene: the file's default one, else its first, else
/// everything.
fn shown_roots(root: &Root, parents: &[Option<usize>], notes: &mut Vec<Note>) -> Result<Vec<bool>, Fault> {
    let Some(index) = shown_scene(root)? else {
        return Ok(vec![true; parents.len()]);
    };
    if root.scenes.len() > 1 {
        let what = format!("{} other scenes", root.scenes.len() - 1);
        notes.push(Note { what, why: format!("scene {index} is the one to show") });
    }
    let mut shown = vec![false; parents.len()];
    for n in root.scenes[index].nodes.iter().map(|n| n.value()) {
        let fault = |problem: String| Fault::broken(format!("scene {index}"), problem);
        match parents.get(n) {
            None => return Err(fault(format!("node {n} does not exist"))),
            Some(Some(parent)) => return Err(fault(format!("node {n} is no root, but a child of node {parent}"))),
            Some(None) if shown[n] => return Err(fault(format!("node {n} is listed twice"))),
            Some(None) => shown[n] = true,
        }
    }
    Ok(shown)
}

/// The scene to show, if the file has any.
pub(super) fn shown_scene(root: &Root) -> Result<Option<usize>, Fault> {
    let index = root.scene.map_or(0, |s| s.value());
    if index < root.scenes.len() {
        return Ok(Some(index));
    }
    match root.scene {
        Some(_) => Err(Fault::broken("scene", format!("scene {index} does not exist"))),
        None => Ok(None),
    }
}

/// A node's own placement.
fn placement(t: &NodeTransform) -> Result<DAffine3, String> {
    let out = if let Some(m) = t.matrix {
        let row = [m[3], m[7], m[11], m[15]];
        if row.iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(a, b)| (a - b).abs() > AFFINE) {
            return Err(format!("matrix has the last row {row:?}, not 0, 0, 0, 1"));
        }
        let column = |c: usize| DVec3::new(m[4 * c], m[4 * c + 1], m[4 * c + 2]);
        DAffine3::from_mat3_translation(DMat3::from_cols(column(0), column(1), column(2)), column(3))
    } else {
        let rotation = match t.rotation {
            None => DQuat::IDENTITY,
            Some(q) => {
                let q = DQuat::from_array(q);
                // Exporters round; a quaternion that is far from unit length is no rotation.
                if !q.is_finite() || (q.length() - 1.0).abs() > 0.1 {
                    return Err(format!("rotation {q} is no unit quaternion"));
                }
                q.normalize()
            }
        };
        let scale = t.scale.map_or(DVec3::ONE, DVec3::from);
        let translation = t.translation.map_or(DVec3::ZERO, DVec3::from);
        DAffine3::from_scale_rotation_translation(scale, rotation, translation)
    };
    if out.is_finite() { Ok(out) } else { Err("placement is not finite".into()) }
}

fn is_flat(t: &DAffine3) -> bool {
    let m = t.matrix3;
    let lengths = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
    !t.inverse().is_finite() || m.determinant().abs() <= FLAT * lengths
}
