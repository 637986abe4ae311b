//! glTF 2.0, text or binary.
//!
//! In: the bytes of a `.gltf` or `.glb` file. Out: a [`Scene`] with the file's meshes, in its order
//! and each once, and an instance per node with a mesh. The JSON is parsed by the `gltf` crate; its
//! importer is not used (it follows any path, trusts counts, and panics on indices out of range, as
//! its validator does), so every reference, size and value is checked here: [`container`] the file,
//! [`extensions`] what the parser leaves out, [`accessors`] typed arrays, [`compressed`] their
//! codecs, [`primitives`] triangles, [`materials`] looks, [`nodes`] placements, [`shapes`] skins
//! and morph targets.
//!
//! Left out with a note, since scenes are static and diffuse: animations, lights, everything of a
//! material but its base colour, points and lines. An extension that the file requires, that
//! changes shape or base colour, and that is not read here is an error.

mod accessors;
mod compressed;
mod container;
mod extensions;
mod json_repair;
mod materials;
mod nodes;
mod primitives;
mod shapes;

use gltf::json::Root;

use super::annotations;
use super::error::Fault;
use super::files::Files;
use super::images;
use super::limits::Limits;
use super::model::{Instance, Note, Scene};

pub(super) use container::is_glb;

/// Reads a glTF file.
pub(super) fn import(name: &str, bytes: &[u8], files: &mut Files, limits: &Limits) -> Result<Scene, Fault> {
    let container::Parts { json, bin } = container::split(bytes)?;
    let mut parse_notes = Vec::new();
    let (root, additions) = container::parse(&json, limits, &mut parse_notes)?;
    let data = accessors::Data::load(&root, &additions, bin, files, limits)?;
    let mut notes = Vec::new();
    let materials = materials::plan(&root, &additions, &mut notes)?;
    let mut placed = nodes::place(&root, &additions, &data, limits, &mut notes)?;
    let shapes = shapes::shapes(&root, &additions, &data, &mut placed, limits, &mut notes)?;
    let nodes::Placed { instances, viewpoints, .. } = placed;
    let mut changes = primitives::Changes::default();
    let plans = primitives::plan(&root, &data, &materials, &shapes, limits, &mut changes)?;
    check_expanded(&instances, &plans.triangles, limits)?;
    let encoded = materials.encoded_images(&root, &data, files);
    let (textures, meshes) =
        rayon::join(|| images::decode_all(&encoded, files, limits), || plans.decode(&shapes, &mut changes));
    let meshes = meshes?;
    if changes.unplaced > 0 && meshes.iter().all(|m| m.triangles() == 0) {
        return Err(Fault::broken("accessors", "no triangle has corners that are finite"));
    }
    let (rooms, portals) = match nodes::shown_scene(&root)?.map(|s| (s, &root.scenes[s].extras)) {
        Some((s, Some(extras))) => annotations::from_extras(extras.get(), &format!("scene {s}"), limits)?,
        _ => Default::default(),
    };
    note_left_out(&root, &changes, &mut notes);
    notes.extend(parse_notes);
    Ok(Scene {
        name: name.to_owned(),
        meshes,
        instances,
        materials: materials.materials,
        textures,
        rooms,
        portals,
        viewpoints,
        notes,
        ..Scene::default()
    })
}

/// Bounds the triangles with instances counted, from the plans alone.
fn check_expanded(instances: &[Instance], triangles: &[u64], limits: &Limits) -> Result<(), Fault> {
    let mut sum = 0u64;
    for i in instances {
        // Cannot overflow: unique triangles and instances are bounded already.
        sum += triangles[i.mesh as usize];
        if sum > limits.expanded_triangles {
            let place = format!("node {}", i.node);
            return Err(Fault::too_large(
                place,
                "or more triangles, instances counted",
                sum,
                limits.expanded_triangles,
            ));
        }
    }
    if sum == 0 {
        let remedy = "export meshes of triangles, placed by nodes of the scene";
        return Err(Fault::invalid("scene", "shows no triangles", remedy));
    }
    Ok(())
}

fn note_left_out(root: &Root, changes: &primitives::Changes, notes: &mut Vec<Note>) {
    let mut note = |count: usize, what: &str, why: &str| {
        if count > 0 {
            notes.push(Note { what: format!("{count} {what}"), why: why.into() });
        }
    };
    note(root.animations.len(), "animations", "scenes are static");
    note(root.cameras.len(), "cameras", "only their positions are read, as places where people walk");
    note(changes.without_surface, "primitives of points or lines", "only triangles are drawn");
    note(changes.without_normals, "primitives without normals", "flat normals made, as glTF asks");
    note(changes.normals_repaired, "normals of no length or not finite", "replaced by the mean of their triangles'");
    note(changes.uvs_placed, "texture coordinates that are not finite", "taken as (0, 0)");
    note(changes.unplaced, "triangles with a corner that is not finite", "left out");
    note(changes.left_over, "vertices that are no whole triangle", "left out");
    note(changes.without_uvs, "primitives without the texture coordinates of their material", "taken as (0, 0)");
    note(changes.colours_clamped, "vertex colours outside [0, 1]", "clamped");
    note(changes.colour_alpha, "vertex colours with alpha", "alpha comes from material and texture alone");
}
