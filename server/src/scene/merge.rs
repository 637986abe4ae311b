//! Several files as one scene.
//!
//! In: scenes, each in metres with Y up, in one world frame. Out: one [`Scene`] that holds the
//! meshes, instances, looks, rooms and elements of all, in their order. Materials without a picture
//! that are the same become one, so that two files give what one file holding both would.

use std::collections::{BTreeSet, HashMap};

use ldi_protocol::mesh::Material;

use super::OUTSIDE;
use super::error::{Fault, SceneError};
use super::limits::Limits;
use super::model::Scene;

/// Limits of the files after those that are already there.
pub(super) fn limits_beside(scene: &Scene, limits: &Limits) -> Limits {
    let pixels = scene.textures.iter().map(|t| t.rgba.len() as u64).sum::<u64>();
    let primitives = || scene.meshes.iter().flat_map(|m| &m.primitives);
    let vertices = primitives().map(|p| p.positions.len() as u64).sum::<u64>();
    let rooms = scene.rooms.len().max(scene.portals.len()) as u64;
    Limits {
        vertices: limits.vertices.saturating_sub(vertices),
        unique_triangles: limits.unique_triangles.saturating_sub(scene.unique_triangles()),
        expanded_triangles: limits.expanded_triangles.saturating_sub(scene.triangles()),
        instances: limits.instances.saturating_sub(scene.instances.len() as u64),
        image_pixels: limits.image_pixels.saturating_sub(pixels),
        rooms: limits.rooms.saturating_sub(rooms),
        ..*limits
    }
}

/// The error of a file that would fit by itself.
pub(super) fn beside_others(error: SceneError) -> SceneError {
    match error {
        SceneError::TooLarge { file, place, problem, remedy } => {
            let remedy = format!("{remedy}; the files before it take their part of what is read together");
            SceneError::TooLarge { file, place, problem, remedy }
        }
        other => other,
    }
}

/// Adds a scene to those before it.
pub(super) fn join(into: &mut Scene, mut more: Scene) -> Result<(), Fault> {
    let nodes = into.instances.iter().map(|i| u64::from(i.node) + 1).max().unwrap_or(0);
    let most_node = more.instances.iter().map(|i| u64::from(i.node)).max().unwrap_or(0);
    if nodes + most_node > u64::from(u32::MAX) {
        return Err(Fault::too_large("file", "nodes together with the files before it", nodes + most_node, u32::MAX));
    }
    join_looks(into, &mut more);
    let (meshes, nodes) = (into.meshes.len() as u32, nodes as u32);
    for i in &mut more.instances {
        i.mesh += meshes;
        i.node += nodes;
    }
    for e in &mut more.elements {
        e.node += nodes;
    }
    rename_rooms(into, &mut more);
    for note in &mut more.notes {
        note.what = format!("{}: {}", more.name, note.what);
    }
    into.name = format!("{} + {}", into.name, more.name);
    into.meshes.append(&mut more.meshes);
    into.instances.append(&mut more.instances);
    into.textures.append(&mut more.textures);
    into.rooms.append(&mut more.rooms);
    into.portals.append(&mut more.portals);
    into.elements.append(&mut more.elements);
    into.viewpoints.append(&mut more.viewpoints);
    into.notes.append(&mut more.notes);
    Ok(())
}

/// Takes over the materials, and has the meshes refer to where materials and textures are then.
fn join_looks(into: &mut Scene, more: &mut Scene) {
    let textures = into.textures.len() as u32;
    let mut places = Vec::with_capacity(more.materials.len());
    // Debug prints every digit of a float.
    let key = |m: &Material| format!("{m:?}");
    let plain = into.materials.iter().zip(0u32..).filter(|(m, _)| m.texture.is_none());
    let mut there: HashMap<String, u32> = plain.map(|(m, at)| (key(m), at)).collect();
    for mut material in more.materials.drain(..) {
        material.texture = material.texture.map(|t| t + textures);
        let next = into.materials.len() as u32;
        let place = match material.texture {
            None => *there.entry(key(&material)).or_insert(next),
            Some(_) => next,
        };
        if place == next {
            into.materials.push(material);
        }
        places.push(place);
    }
    for primitive in more.meshes.iter_mut().flat_map(|m| &mut m.primitives) {
        // Importers check that every material is there.
        primitive.material = places[primitive.material as usize];
    }
}

/// Gives rooms whose name is taken the name of their file besides.
fn rename_rooms(into: &Scene, more: &mut Scene) {
    let mut taken: BTreeSet<String> = into.rooms.iter().map(|r| r.name.clone()).collect();
    taken.insert(OUTSIDE.to_owned());
    for room in &mut more.rooms {
        let old = room.name.clone();
        let numbered = |n: u32| match n {
            0 => old.clone(),
            1 => format!("{old} ({})", more.name),
            n => format!("{old} ({}, {n})", more.name),
        };
        let new = (0..).map(numbered).find(|name| !taken.contains(name)).unwrap_or_default();
        if new != old {
            let sides = more.portals.iter_mut().flat_map(|p| &mut p.rooms);
            sides.filter(|r| **r == old).for_each(|r| r.clone_from(&new));
        }
        taken.insert(new.clone());
        room.name = new;
    }
}
