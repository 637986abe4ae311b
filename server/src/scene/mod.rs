//! Stage 1: a scene, from a file or built in.
//!
//! In: a glTF/GLB, OBJ or PLY file (with `?up=z&unit=mm` where it is not in metres with Y up), or
//! `builtin:NAME?triangles=N&seed=S`. Out: a [`Scene`]: meshes once, instances as references,
//! materials and textures, all validated: finite values, indices in range, no cycles. What a later
//! stage reads here it may trust.
//!
//! A scene file is data from a stranger. [`Limits`] bounds what it may ask for, before anything is
//! allocated; `files` is the only door to the file system; every error names file, place and
//! remedy. Whatever is left out or changed on the way in stands in [`Scene::notes`].

mod annotations;
pub mod builtin;
mod check;
mod error;
mod files;
mod from_gltf;
mod from_obj;
mod from_ply;
pub mod glb_write;
mod images;
mod limits;
mod model;
mod normals;
mod origin;
mod spec;

use std::path::Path;

pub use annotations::{CellExtra, OUTSIDE, PortalExtra, SceneExtras};
pub use error::SceneError;
pub use limits::{LIMITS, Limits};
pub use model::{Instance, Mesh, Note, PortalAnnotation, Primitive, RoomAnnotation, Scene, SceneTexture};
pub use spec::{BuiltinSpec, FileSpec, unit_doubt};

use error::Fault;
use files::Files;

/// Loads a scene from a `.gltf`, `.glb`, `.obj` or `.ply` file ([`FileSpec`]), or builds
/// `builtin:NAME[?triangles=N&seed=S]`.
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
    let FileSpec { path, world_from_file, lenient } = FileSpec::parse(spec)?;
    let path = Path::new(&path);
    let (mut files, bytes) = Files::open(path, limits.file_bytes)?;
    files.lenient = lenient;
    let name = path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
    import(&name, &bytes, &mut files, limits)
        .map(|mut scene| {
            world_from_file.iter().for_each(|world| scene.transform(world));
            scene.notes.extend(files.missed());
            scene
        })
        .and_then(|scene| check::world_within(&scene, limits).map(|()| scene))
        .map_err(|fault| fault.in_file(&path.display().to_string()))
}

/// Reads a file by what its first bytes say, else by what its name ends in.
fn import(name: &str, bytes: &[u8], files: &mut Files, limits: &Limits) -> Result<Scene, Fault> {
    let extension = name.rsplit_once('.').map(|(_, e)| e.to_ascii_lowercase());
    match extension.as_deref() {
        _ if from_gltf::is_glb(bytes) => from_gltf::import(name, bytes, files, limits),
        _ if from_ply::is_ply(bytes) => from_ply::import(name, bytes, files, limits),
        Some("gltf" | "glb") => from_gltf::import(name, bytes, files, limits),
        Some("obj") => from_obj::import(name, bytes, files, limits),
        Some("ply") => from_ply::import(name, bytes, files, limits),
        _ => Err(Fault::unsupported(
            "file",
            "is no scene format that is read",
            "convert it to .gltf, .glb, .obj or .ply",
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
