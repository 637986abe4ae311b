//! Wavefront OBJ, with its material libraries.
//!
//! In: the text of an `.obj` file (Wavefront's Advanced Visualizer manual, appendix B). Out: a
//! [`Scene`]: a mesh per object or group, a primitive per material in it, one instance each, at
//! the origin or where the mesh is ([`origin`]). Coordinates are taken as metres, Y up; v counts
//! upward in OBJ and downward here, so it is turned over. Polygons become triangles ([`polygons`]).
//! Where a face names no normals, its primitive gets flat ones. Materials draw both sides, since
//! OBJ does not say.
//!
//! Read: `v` (with w, or with r g b), `vt`, `vn`, `f`, `o`, `g`, `usemtl`, `mtllib`. Points, lines
//! and free-form surfaces are left out with a note. The reader is our own: the usual crate panics
//! on a colour of two numbers, misaligns attributes that only some vertices have, and knows no
//! line numbers, so that checking its input would take another parser. [`text`] parses, [`mtl`]
//! reads libraries, this module builds meshes.
//!
//! [`polygons`]: super::polygons

mod mtl;
mod text;

use std::collections::{HashMap, HashSet};

use glam::{Affine2, DAffine3, DVec3, Vec2, Vec3};

use super::error::Fault;
use super::files::{Files, listed};
use super::images;
use super::limits::Limits;
use super::model::{Instance, Mesh, Note, Primitive, Scene};
use super::normals;
use super::origin;
use super::polygons::Polygons;
use super::repair;
use text::{Corner, Face, Obj};

/// Bytes in which a file whose name does not say so shows that it is OBJ.
const HEAD: usize = 64 << 10;

/// Whether bytes are an OBJ file, whatever its name ends in.
pub(super) fn is_obj(bytes: &[u8]) -> bool {
    text::has_vertex(&bytes[..bytes.len().min(HEAD)])
}

/// What building changed or left out.
#[derive(Debug, Default)]
struct Changes {
    /// Primitives that got flat normals.
    flat: usize,
    /// Polygons without area.
    without_area: usize,
    /// Triangles with a corner that is not finite.
    unplaced: usize,
}

/// Reads an OBJ file.
pub(super) fn import(name: &str, bytes: &[u8], files: &mut Files, limits: &Limits) -> Result<Scene, Fault> {
    let obj = text::parse(bytes, limits)?;
    // A polygon never becomes more triangles than its fan.
    let triangles: usize = obj.groups.iter().flat_map(|g| &g.faces).map(|f| f.corners.len() - 2).sum();
    let nothing = || Fault::invalid("file", "has no faces", "export the meshes as polygons");
    if triangles == 0 {
        return Err(nothing());
    }
    if triangles as u64 > limits.unique_triangles {
        return Err(Fault::too_large("file", "triangles", triangles, limits.unique_triangles));
    }
    let mut notes = Vec::new();
    let used: HashSet<&str> = obj.material_names.iter().map(String::as_str).collect();
    let mut library = mtl::load(&obj.libraries, &used, files, &mut notes)?;
    let mut meshes: Vec<Mesh> = Vec::new();
    let mut instances = Vec::new();
    let (mut unknown, mut changes, mut vertices) = (Vec::new(), Changes::default(), 0u64);
    let mut polygons = Polygons::default();
    for group in obj.groups.iter().filter(|g| !g.faces.is_empty()) {
        let mut mesh = Mesh { name: group.name.clone(), primitives: Vec::new() };
        let corners = group.faces.iter().flat_map(|f| &f.corners).map(|c| obj.positions[c.position as usize]);
        let origin = origin::of(corners.filter(|p| p.as_vec3().is_finite()));
        for (material_name, faces) in by_material(&group.faces) {
            let material = match material_name.map(|m| &obj.material_names[m]) {
                None => library.default_material(),
                Some(name) => library.find(name).unwrap_or_else(|| {
                    unknown.push(name.clone());
                    library.default_material()
                }),
            };
            let looks = Looks { material, textured: library.is_textured(material), moved: library.moved(material) };
            let primitive = build(&obj, &faces, &looks, origin, &mut polygons, &mut changes);
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
    if meshes.iter().all(|m| m.triangles() == 0) {
        let problem = "has no faces whose corners are finite and that have an area";
        return Err(Fault::invalid("file", problem, "export the meshes as polygons"));
    }
    let mut note = |count: usize, what: String, why: &str| {
        if count > 0 {
            notes.push(Note { what, why: why.into() });
        }
    };
    let m = &obj.mended;
    note(unknown.len(), format!("materials without definition: {}", listed(&unknown)), "drawn white");
    note(changes.flat, format!("{} primitives without normals on every face", changes.flat), "flat normals made");
    note(
        m.left_out,
        format!("{} statements for points, lines, curves or surfaces", m.left_out),
        "only polygons are drawn",
    );
    note(m.colours_clamped, format!("{} vertex colours outside [0, 1]", m.colours_clamped), "clamped");
    note(usize::from(m.colours_of_bytes), "vertex colours above 1".into(), "taken as numbers of 0 to 255");
    note(m.short_faces, format!("{} faces of fewer than three corners", m.short_faces), "they have no surface");
    note(changes.without_area, format!("{} polygons without area", changes.without_area), "left out");
    note(
        m.missing_looks,
        format!("{} corners that name texture coordinates or normals that do not exist", m.missing_looks),
        "read without them",
    );
    note(m.not_finite, format!("{} texture coordinates or normals that are not finite", m.not_finite), "made anew");
    note(changes.unplaced, format!("{} triangles with a corner that is not finite", changes.unplaced), "left out");
    note(m.weights_of_zero, format!("{} vertices of weight 0", m.weights_of_zero), "read without the weight");
    let mut textures = images::decode_all(&library.images, files, limits);
    library.apply_masks(&mut textures, files, limits)?;
    Ok(Scene {
        name: name.to_owned(),
        meshes,
        instances,
        materials: library.materials,
        textures,
        notes,
        ..Scene::default()
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

/// What a material asks of a primitive.
struct Looks {
    material: u32,
    textured: bool,
    /// Where its texture is moved, v upward.
    moved: Option<Affine2>,
}

/// One primitive about an origin: corners that agree in position, texture coordinate and normal
/// become one vertex.
fn build(
    obj: &Obj,
    faces: &[&Face],
    looks: &Looks,
    origin: DVec3,
    polygons: &mut Polygons,
    changes: &mut Changes,
) -> Primitive {
    let all_normals = faces.iter().flat_map(|f| &f.corners).all(|c| c.normal.is_some());
    let mut numbers: HashMap<Corner, u32> = HashMap::new();
    let mut out = Primitive { material: looks.material, ..Primitive::default() };
    let (mut places, mut vertices) = (Vec::new(), Vec::new());
    for face in faces {
        places.clear();
        places.extend(face.corners.iter().map(|c| obj.positions[c.position as usize]));
        let triangles = polygons.cut(&places);
        if triangles.is_empty() {
            changes.without_area += 1;
            continue;
        }
        vertices.clear();
        vertices.extend(face.corners.iter().map(|c| {
            // What the primitive does not keep must not keep vertices apart.
            let key = Corner {
                position: c.position,
                uv: c.uv.filter(|_| looks.textured),
                normal: c.normal.filter(|_| all_normals),
            };
            *numbers.entry(key).or_insert_with(|| {
                out.positions.push((obj.positions[key.position as usize] - origin).as_vec3());
                if looks.textured {
                    out.uvs.push(key.uv.map_or(Vec2::ZERO, |v| moved(obj.uvs[v as usize], looks.moved)));
                }
                if all_normals {
                    out.normals.push(key.normal.map_or(Vec3::Y, |v| obj.normals[v as usize]));
                }
                if !obj.colours.is_empty() {
                    out.colours.push(obj.colours[key.position as usize]);
                }
                out.positions.len() as u32 - 1
            })
        }));
        out.triangles.extend(triangles.iter().map(|t| t.map(|k| vertices[k as usize])));
    }
    changes.unplaced += repair::drop_unplaced(&mut out).triangles;
    repair::place_uvs(&mut out.uvs);
    if all_normals {
        normals::repair(&mut out);
    } else {
        changes.flat += 1;
        normals::flatten(&mut out);
    }
    out
}

/// A texture coordinate, v downward, moved by what counts v upward.
fn moved(uv: Vec2, by: Option<Affine2>) -> Vec2 {
    let Some(by) = by else { return uv };
    let up = by.transform_point2(Vec2::new(uv.x, 1.0 - uv.y));
    Vec2::new(up.x, 1.0 - up.y)
}
