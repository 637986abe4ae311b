//! Stage 1: a scene, from a file or built in.
//!
//! In: a glTF/GLB, OBJ, PLY, STL or IFC file, or one of them in a gzip file or zip archive (with
//! `?up=z&unit=mm` where it is not in metres with Y up), or `builtin:NAME?triangles=N&seed=S`. Out:
//! a [`Scene`]: meshes once, instances as references, materials and textures, all validated: finite
//! values, indices in range, no cycles. What a later stage reads here it may trust.
//!
//! A scene file is data from a stranger. [`Limits`] bounds what it may ask for, before anything is
//! allocated; `files` is the only door to the file system; every error names file, place and
//! remedy. Whatever is left out or changed on the way in stands in [`Scene::notes`].

mod annotations;
pub mod builtin;
mod check;
mod doubts;
mod error;
mod files;
mod from_gltf;
#[cfg(feature = "ifc")]
mod from_ifc;
mod from_obj;
mod from_ply;
mod from_stl;
pub mod glb_write;
mod guard;
mod images;
mod limits;
mod merge;
mod model;
mod normals;
mod origin;
mod polygons;
mod recognise;
mod repair;
mod spec;
mod text;
mod unpack;

use std::path::Path;

use ldi_protocol::codec::texture::MAX_TEXELS;

pub use annotations::{CellExtra, OUTSIDE, PortalExtra, SceneExtras};
pub use doubts::doubts;
pub use error::SceneError;
pub use limits::{LIMITS, Limits};
#[cfg(test)]
pub(crate) use model::WHITE;
pub use model::{Instance, Mesh, Note, PortalAnnotation, Primitive, RoomAnnotation, Scene, SceneElement, SceneTexture};
pub use spec::{BuiltinSpec, FileSpec};

use error::Fault;
use files::Files;

/// Below this, in linear light, all of a material's colour is dark, and emission shows instead.
const DARK: f32 = 0.04;

/// Loads a scene from a `.gltf`, `.glb`, `.obj`, `.ply`, `.stl` or `.ifc` file ([`FileSpec`]), or
/// builds `builtin:NAME[?triangles=N&seed=S]`.
///
/// # Errors
/// A [`SceneError`] that names the file, the place in it and the remedy. No input makes this panic.
pub fn load(spec: &str) -> Result<Scene, SceneError> {
    load_within(spec, &LIMITS)
}

/// [`load`] with limits of one's own.
///
/// # Errors
/// As [`load`].
pub fn load_within(spec: &str, limits: &Limits) -> Result<Scene, SceneError> {
    if let Some(builtin) = BuiltinSpec::parse(spec) {
        return load_builtin(&builtin?);
    }
    let FileSpec { path, world_from_file, lenient, spaces_are_rooms, .. } = FileSpec::parse(spec)?;
    let path = Path::new(&path);
    let in_file = |fault: Fault| fault.in_file(&path.display().to_string());
    let (mut files, bytes) = Files::open(path, limits.file_bytes)?;
    (files.lenient, files.spaces_are_rooms) = (lenient, spaces_are_rooms);
    let name = path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
    let (name, bytes) = files.unpacked(&name, bytes).map_err(in_file)?;
    let imported = import(&name, &bytes, &mut files, limits);
    let (scene, fault) = match imported {
        Ok(scene) => (Some(scene), None),
        Err(fault) => (None, Some(fault)),
    };
    files.verdict(fault).map_err(in_file)?;
    // Without a scene the verdict is a fault.
    let mut scene = scene.unwrap_or_default();
    world_from_file.iter().for_each(|world| scene.transform(world));
    scene.notes.extend(files.notes());
    let too_large = images::halved_to(&mut scene, MAX_TEXELS);
    scene.notes.extend(too_large);
    check::world_within(&scene, limits).map_err(in_file)?;
    Ok(scene)
}

/// Loads several files, or built-in scenes, as one scene. Each has units and axes of its own; their
/// world frame is one.
///
/// # Errors
/// As [`load`], of the first that cannot be read or exceeds what is left of the limits.
pub fn load_all(specs: &[String]) -> Result<Scene, SceneError> {
    load_all_within(specs, &LIMITS)
}

/// [`load_all`] with limits of one's own, which hold for all files together.
///
/// # Errors
/// As [`load_all`].
pub fn load_all_within(specs: &[String], limits: &Limits) -> Result<Scene, SceneError> {
    let Some((first, others)) = specs.split_first() else {
        let fault = Fault::invalid("arguments", "no scene is named", "name at least one");
        return Err(fault.in_file("scenes"));
    };
    let mut scene = load_within(first, limits)?;
    for spec in others {
        let left = merge::limits_beside(&scene, limits);
        let more = load_within(spec, &left).map_err(merge::beside_others)?;
        merge::join(&mut scene, more).map_err(|fault| fault.in_file(spec))?;
    }
    Ok(scene)
}

/// Reads a file by what its first bytes say, else by what its name ends in.
fn import(name: &str, bytes: &[u8], files: &mut Files, limits: &Limits) -> Result<Scene, Fault> {
    let extension = name.rsplit_once('.').map(|(_, e)| e.to_ascii_lowercase());
    if from_gltf::is_glb(bytes) {
        return from_gltf::import(name, bytes, files, limits);
    }
    if from_ply::is_ply(bytes) {
        return from_ply::import(name, bytes, files, limits);
    }
    #[cfg(feature = "ifc")]
    if from_ifc::is_ifc(bytes) {
        return from_ifc::import(name, bytes, files, limits);
    }
    if let Some(fault) = recognise::foreign(name, bytes) {
        return Err(fault);
    }
    match extension.as_deref() {
        Some("gltf" | "glb") => from_gltf::import(name, bytes, files, limits),
        Some("obj") => from_obj::import(name, bytes, files, limits),
        Some("ply") => from_ply::import(name, bytes, files, limits),
        Some("stl") => from_stl::import(name, bytes, limits),
        _ if recognise::is_gltf_text(bytes) => from_gltf::import(name, bytes, files, limits),
        _ if from_stl::is_stl(bytes) => from_stl::import(name, bytes, limits),
        _ if from_obj::is_obj(bytes) => from_obj::import(name, bytes, files, limits),
        _ => Err(Fault::unsupported(
            "file",
            "is no scene format that is read",
            "convert it to .gltf, .glb, .obj, .ply, .stl or .ifc",
        )),
    }
}

fn load_builtin(spec: &BuiltinSpec) -> Result<Scene, SceneError> {
    builtin::build(&spec.name, spec.triangles, spec.seed).map(|built| built.scene).map_err(|e| SceneError::Builtin {
        name: spec.name.clone(),
        problem: e.to_string(),
        remedy: "`ldi-server scene --help` lists names and ranges".into(),
    })
}

#[cfg(test)]
mod tests;
