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
use super::accessors::{Data, ROTATIONS, VECTORS};
use super::extensions::{Additions, Instancing, Node as NodeAddition};

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

/// What the nodes of a document place.
#[derive(Debug, Default)]
pub(super) struct Placed {
    /// Instances of the shown scene in node order.
    pub(super) instances: Vec<Instance>,
    /// World positions of its cameras and spawn points.
    pub(super) viewpoints: Vec<DVec3>,
    /// World placements of all nodes, shown or not: joints need not be shown.
    pub(super) world_from_node: Vec<DAffine3>,
}

/// A node that waits for its turn.
struct Waiting {
    node: usize,
    depth: u32,
    world_from_parent: DAffine3,
    /// Where the shown scene holds an ancestor: the parent's placement below it.
    shown_from_parent: Option<DAffine3>,
    hidden: bool,
}

/// Reads all nodes.
pub(super) fn place(
    root: &Root,
    additions: &Additions,
    data: &Data<'_>,
    limits: &Limits,
    notes: &mut Vec<Note>,
) -> Result<Placed, Fault> {
    let parents = parents(root)?;
    let shown = shown_roots(root, parents.len(), notes)?;
    let mut out = Placed { world_from_node: vec![DAffine3::IDENTITY; parents.len()], ..Placed::default() };
    let (mut flat, mut many, mut hidden_meshes) = (Vec::new(), 0, 0);
    // One walk over everything: shown trees carry their placement, others None.
    let mut stack: Vec<Waiting> = Vec::new();
    for node in (0..parents.len()).filter(|&n| parents[n].is_none()) {
        let world_from_parent = DAffine3::IDENTITY;
        stack.push(Waiting { node, depth: 1, world_from_parent, shown_from_parent: None, hidden: false });
    }
    let mut seen = vec![false; root.nodes.len()];
    let nothing = NodeAddition::default();
    while let Some(Waiting { node: n, depth, world_from_parent, shown_from_parent, hidden }) = stack.pop() {
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
        let added = additions.nodes.get(n).unwrap_or(&nothing);
        let parent_from_node = placement(added).map_err(|problem| Fault::broken(format!("node {n}"), problem))?;
        out.world_from_node[n] = world_from_parent * parent_from_node;
        // A scene may list a node that is also a child; its parents then place nothing.
        let shown_parent = shown_from_parent.or(shown[n].then_some(DAffine3::IDENTITY));
        let world_from_node = shown_parent.map(|w| w * parent_from_node);
        let hidden = hidden || added.is_hidden();
        for child in node.children.iter().flatten() {
            stack.push(Waiting {
                node: child.value(),
                depth: depth + 1,
                world_from_parent: out.world_from_node[n],
                shown_from_parent: world_from_node,
                hidden,
            });
        }
        if let Some(world) = world_from_node
            && is_viewpoint(node)
            && out.viewpoints.len() < MOST_VIEWPOINTS
        {
            out.viewpoints.push(world.translation);
        }
        let Some(mesh) = &node.mesh else { continue };
        if mesh.value() >= root.meshes.len() {
            return Err(Fault::broken(format!("node {n}"), format!("mesh {} does not exist", mesh.value())));
        }
        let Some(world_from_mesh) = world_from_node else { continue };
        if hidden {
            hidden_meshes += 1;
            continue;
        }
        let left = limits.instances - out.instances.len() as u64;
        let placements = match added.instancing() {
            None => vec![world_from_mesh],
            Some(instancing) => {
                many += 1;
                let place = format!("node {n}, EXT_mesh_gpu_instancing");
                let own = instance_placements(instancing, data, left, &place)?;
                own.into_iter().map(|p| world_from_mesh * p).collect()
            }
        };
        for world_from_mesh in placements {
            if is_flat(&world_from_mesh) {
                flat.push(node.name.clone().unwrap_or_else(|| format!("node {n}")));
            } else {
                out.instances.push(Instance { node: n as u32, mesh: mesh.value() as u32, world_from_mesh });
            }
        }
        if out.instances.len() as u64 > limits.instances {
            return Err(Fault::too_large("nodes", "or more instances", out.instances.len(), limits.instances));
        }
    }
    if let Some(n) = seen.iter().position(|s| !s) {
        return Err(Fault::broken(format!("node {n}"), "is its own ancestor"));
    }
    // Stable: instances of one node stay in their order.
    out.instances.sort_by_key(|i| i.node);
    let mut note = |what: String, why: &str| notes.push(Note { what, why: why.into() });
    if !flat.is_empty() {
        let what = format!("nodes whose placement has no inverse: {}", listed(&flat));
        note(what, "a mesh scaled to nothing has no surface");
    }
    if hidden_meshes > 0 {
        note(format!("{hidden_meshes} nodes with meshes that are not visible"), "left out");
    }
    if many > 0 && additions.nodes.iter().any(|n| n.instancing().is_some_and(Instancing::has_more)) {
        note("attributes of instances besides their placements".into(), "not read");
    }
    Ok(out)
}

impl Instancing {
    /// Whether instances have more than placements.
    fn has_more(&self) -> bool {
        self.attributes.keys().any(|name| !matches!(name.as_str(), "TRANSLATION" | "ROTATION" | "SCALE"))
    }
}

/// Placements of a node's mesh below the node, of at most `limit`.
fn instance_placements(
    instancing: &Instancing,
    data: &Data<'_>,
    limit: u64,
    place: &str,
) -> Result<Vec<DAffine3>, Fault> {
    let elements = |name: &str, usage| match instancing.attributes.get(name) {
        None => Ok(None),
        Some(index) => data.elements(*index, usage, limit).map(Some).map_err(|f| f.within(place)),
    };
    let translations = elements("TRANSLATION", &VECTORS)?;
    let rotations = elements("ROTATION", &ROTATIONS)?;
    let scales = elements("SCALE", &VECTORS)?;
    let counts = [&translations, &rotations, &scales].map(|e| e.as_ref().map(|e| e.count));
    let Some(count) = counts.into_iter().flatten().next() else { return Ok(vec![DAffine3::IDENTITY]) };
    if counts.into_iter().flatten().any(|other| other != count) {
        return Err(Fault::broken(place, "its attributes have different numbers of elements"));
    }
    let vector = |v: [f32; 3]| DVec3::from(v.map(f64::from));
    let translations = translations.map_or_else(|| vec![DVec3::ZERO; count], |e| e.vectors(vector));
    let scales = scales.map_or_else(|| vec![DVec3::ONE; count], |e| e.vectors(vector));
    let rotations = rotations.map_or_else(
        || vec![DQuat::IDENTITY; count],
        |e| e.vectors(|q: [f32; 4]| unit_rotation(q.map(f64::from)).unwrap_or(DQuat::IDENTITY)),
    );
    let placed = |((t, r), s): ((DVec3, DQuat), DVec3)| DAffine3::from_scale_rotation_translation(s, r, t);
    let all: Vec<DAffine3> = translations.into_iter().zip(rotations).zip(scales).map(placed).collect();
    match all.iter().position(|p| !p.is_finite()) {
        Some(k) => Err(Fault::broken(place, format!("the placement of instance {k} is not finite"))),
        None => Ok(all),
    }
}

/// A rotation; None of a quaternion that is not finite. One of no length means none to many
/// writers; others are brought to unit length.
fn unit_rotation(q: [f64; 4]) -> Option<DQuat> {
    let q = DQuat::from_array(q);
    if !q.is_finite() {
        return None;
    }
    let length = q.length();
    Some(if length > 0.0 && length.is_finite() { q.normalize() } else { DQuat::IDENTITY })
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

/// Which nodes the shown scene lists: the file's default one, else its first, else
/// everything.
fn shown_roots(root: &Root, nodes: usize, notes: &mut Vec<Note>) -> Result<Vec<bool>, Fault> {
    let Some(index) = shown_scene(root)? else {
        return Ok(vec![true; nodes]);
    };
    if root.scenes.len() > 1 {
        let what = format!("{} other scenes", root.scenes.len() - 1);
        notes.push(Note { what, why: format!("scene {index} is the one to show") });
    }
    let mut shown = vec![false; nodes];
    for n in root.scenes[index].nodes.iter().map(|n| n.value()) {
        match shown.get_mut(n) {
            None => return Err(Fault::broken(format!("scene {index}"), format!("node {n} does not exist"))),
            Some(shown) => *shown = true,
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
fn placement(t: &NodeAddition) -> Result<DAffine3, String> {
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
            Some(q) => unit_rotation(q).ok_or_else(|| format!("rotation {q:?} is not finite"))?,
        };
        let scale = t.scale.map_or(DVec3::ONE, DVec3::from);
        let translation = t.translation.map_or(DVec3::ZERO, DVec3::from);
        DAffine3::from_scale_rotation_translation(scale, rotation, translation)
    };
    if out.is_finite() { Ok(out) } else { Err("placement is not finite".into()) }
}

/// Whether a placement flattens what it places.
pub(super) fn is_flat(t: &DAffine3) -> bool {
    let m = t.matrix3;
    let lengths = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
    !t.inverse().is_finite() || m.determinant().abs() <= FLAT * lengths
}
