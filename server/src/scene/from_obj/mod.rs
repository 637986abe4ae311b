//! Wavefront OBJ, with its material libraries.
//!
//! In: the text of an `.obj` file (Wavefront's Advanced Visualizer manual, appendix B). Out: a
//! [`Scene`]: a mesh per object or group, a primitive per material in it, one instance each, at
//! the origin or where the mesh is ([`origin`]). Coordinates are taken as metres, Y up; v counts
//! upward in OBJ and downward here, so it is turned over. Polygons become fans. Where a face names
//! no normals, it gets flat ones. Materials draw both sides, since OBJ does not say.
//!
//! Read: `v` (with w, or with r g b), `vt`, `vn`, `f`, `o`, `g`, `usemtl`, `mtllib`. Points, lines
//! and free-form surfaces are left out with a note. The reader is our own: the usual crate panics
//! on a colour of two numbers, misaligns attributes that only some vertices have, and knows no
//! line numbers, so that checking its input would take another parser. [`text`] parses, [`mtl`]
//! reads libraries, this module builds meshes.

mod mtl;
mod text;

use std::collections::HashMap;

use glam::{DAffine3, DVec3, Vec2, Vec3};

use super::error::Fault;
use super::files::{Files, listed};
use super::images;
use super::limits::Limits;
use super::model::{Instance, Mesh, Note, Primitive, Scene};
use super::normals;
use super::origin;
use text::{Corner, Face, Obj};

/// Reads an OBJ file.
pub(super) fn import(name: &str, bytes: &[u8], files: &mut Files, limits: &Limits) -> Result<Scene, Fault> {
    let obj = text::parse(bytes, limits)?;
    let triangles: usize = obj.groups.iter().flat_map(|g| &g.faces).map(|f| f.corners.len() - 2).sum();
    if triangles == 0 {
        return Err(Fault::invalid("file", "has no faces", "export the meshes as polygons"));
    }
    if triangles as u64 > limits.unique_triangles {
        return Err(Fault::too_large("file", "triangles", triangles, limits.unique_triangles));
    }
    let mut notes = Vec::new();
    let mut library = mtl::load(&obj.libraries, files, &mut notes)?;
    let mut meshes: Vec<Mesh> = Vec::new();
    let mut instances = Vec::new();
    let (mut unknown, mut flat, mut vertices) = (Vec::new(), 0usize, 0u64);
    for group in obj.groups.iter().filter(|g| !g.faces.is_empty()) {
        let mut mesh = Mesh { name: group.name.clone(), primitives: Vec::new() };
        let corners = group.faces.iter().flat_map(|f| &f.corners);
        let origin = origin::of(corners.map(|c| obj.positions[c.position as usize]));
        for (material_name, faces) in by_material(&group.faces) {
            let material = match material_name.map(|m| &obj.material_names[m]) {
                None => library.default_material(),
                Some(name) => library.find(name).unwrap_or_else(|| {
                    unknown.push(name.clone());
                    library.default_material()
                }),
            };
            let textured = library.materials[material as usize].texture.is_some();
            let (primitive, made_normals) = build(&obj, &faces, material, textured, origin);
            flat += usize::from(made_normals);
            vertices += primitive.positions.len() as u64;
            if vertices > limits.vertices {
                return Err(Fault::too_large("file", "or more vertices", vertices, limits.vertices));
            }
            mesh.primitives.push(primitive);
        }
        let number = meshes.len() as u32;
        let world_from_mesh = DAffine3::from_translation(origin);
        instances.push(Instance { node: number, mesh: number, world_from_mesh });
        meshes.push(mesh);
    }
    let mut note = |count: usize, what: String, why: &str| {
        if count > 0 {
            notes.push(Note { what, why: why.into() });
        }
    };
    note(unknown.len(), format!("materials without definition: {}", listed(&unknown)), "drawn white");
    note(flat, format!("{flat} primitives without normals on every face"), "flat normals made");
    note(
        obj.left_out,
        format!("{} statements for points, lines, curves or surfaces", obj.left_out),
        "only polygons are drawn",
    );
    note(obj.colours_clamped, format!("{} vertex colours outside [0, 1]", obj.colours_clamped), "clamped");
    let textures = images::decode_all(&library.images, files, limits)?;
    Ok(Scene {
        name: name.to_owned(),
        meshes,
        instances,
        materials: library.materials,
        textures,
        rooms: Vec::new(),
        portals: Vec::new(),
        viewpoints: Vec::new(),
        notes,
    })
}

/// Faces by material, materials in order of first use.
fn by_material(faces: &[Face]) -> Vec<(Option<usize>, Vec<&Face>)> {
    let mut at = HashMap::new();
    let mut out: Vec<(Option<usize>, Vec<&Face>)> = Vec::new();
    for face in faces {
        let slot = *at.entry(face.material).or_insert_with(|| {
            out.push((face.material, Vec::new()));
            out.len() - 1
        });
        out[slot].1.push(face);
    }
    out
}

/// One primitive about an origin: corners that agree in position, texture coordinate and normal
/// become one vertex. The flag says whether normals had to be made.
fn build(obj: &Obj, faces: &[&Face], material: u32, textured: bool, origin: DVec3) -> (Primitive, bool) {
    let all_normals = faces.iter().flat_map(|f| &f.corners).all(|c| c.normal.is_some());
    let mut numbers: HashMap<Corner, u32> = HashMap::new();
    let mut out = Primitive { material, ..Primitive::default() };
    for face in faces {
        let mut fan = face.corners.iter().map(|c| {
            // What the primitive does not keep must not keep vertices apart.
            let key = Corner {
                position: c.position,
                uv: c.uv.filter(|_| textured),
                normal: c.normal.filter(|_| all_normals),
            };
            *numbers.entry(key).or_insert_with(|| {
                out.positions.push((obj.positions[key.position as usize] - origin).as_vec3());
                if textured {
                    out.uvs.push(key.uv.map_or(Vec2::ZERO, |v| obj.uvs[v as usize]));
                }
                if all_normals {
                    out.normals.push(key.normal.map_or(Vec3::Y, |v| obj.normals[v as usize]));
                }
                if !obj.colours.is_empty() {
                    out.colours.push(obj.colours[key.position as usize]);
                }
                out.positions.len() as u32 - 1
            })
        });
        let (Some(first), Some(mut last)) = (fan.next(), fan.next()) else { continue };
        let mut triangles = Vec::new();
        for next in fan {
            triangles.push([first, last, next]);
            last = next;
        }
        out.triangles.extend(triangles);
    }
    if all_normals {
        normals::repair(&mut out);
    } else {
        normals::flatten(&mut out);
    }
    (out, !all_normals)
}
