//! PLY polygon files (Turk 1994), ASCII and binary in both byte orders.
//!
//! In: the bytes of a `.ply` file. Out: a [`Scene`] of one mesh, placed once, at the origin or
//! where it is ([`origin`]). Coordinates are taken as metres, Y up. Read: vertex positions,
//! normals (else smooth ones are made, as fits a scan), colours (integers are sRGB codes, floats
//! linear light), texture coordinates with the pictures of `TextureFile` comments; faces as
//! polygons of any size, cut into fans, with `texcoord` per corner, `texnumber` and colours of
//! their own ([`looks`]). Other elements and properties are read over with a note. A file without
//! faces is a point cloud and refused. The reader is our own: the crates for it are unmaintained
//! and trust the header's counts.

mod body;
mod header;
mod looks;

use glam::{DAffine3, DVec3, Vec2, Vec3};
use ldi_protocol::mesh::{Alpha, Material, Wrap};
use ldi_protocol::shade::linear_from_srgb;

use super::error::Fault;
use super::files::{Files, listed, shown};
use super::images::{self, EncodedImage};
use super::limits::Limits;
use super::model::{Instance, Mesh, Note, Primitive, Scene};
use super::normals;
use super::origin;
use body::Body;
use header::Element;
use looks::Looks;

const MAGIC: &[u8] = b"ply";

/// Whether the bytes start as a PLY file does.
pub(super) fn is_ply(bytes: &[u8]) -> bool {
    bytes.strip_prefix(MAGIC).is_some_and(|rest| rest.starts_with(b"\n") || rest.starts_with(b"\r"))
}

/// Reads a PLY file.
pub(super) fn import(name: &str, bytes: &[u8], files: &mut Files, limits: &Limits) -> Result<Scene, Fault> {
    let header = header::parse(bytes, limits)?;
    // Their first would be counted and checked, another read.
    for name in ["vertex", "face"] {
        if header.elements.iter().filter(|e| e.name == name).count() > 1 {
            let remedy = "split the file, or join the elements";
            return Err(Fault::unsupported("header", format!("element {name} stands twice"), remedy));
        }
    }
    let vertices = header.elements.iter().find(|e| e.name == "vertex").map_or(0, |e| e.count);
    if vertices > limits.vertices {
        return Err(Fault::too_large("header", "vertices", vertices, limits.vertices));
    }
    let mut body = Body::new(bytes, &header);
    let mut out = Primitive::default();
    let (mut world, mut looks) = (Vec::new(), Looks::default());
    let (mut skipped, mut unread) = (0, Vec::new());
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => read_vertices(&mut body, element, &mut world, &mut out, &mut unread)?,
            "face" => {
                let from = Faces { vertices, pictures: header.textures.len(), limits };
                skipped += read_faces(&mut body, element, &from, &mut out, &mut looks, &mut unread)?;
            }
            name => {
                unread.push(name.to_owned());
                body.skip(element)?;
            }
        }
    }
    let origin = origin::of(world.iter().copied());
    out.positions = world.into_iter().map(|p| (p - origin).as_vec3()).collect();
    if out.triangles.is_empty() {
        let remedy = "make a mesh of polygons from it first, for example by Poisson reconstruction";
        return Err(Fault::unsupported("element face", "the file has no faces; point clouds are not read", remedy));
    }
    let mut notes = Vec::new();
    if skipped > 0 {
        notes.push(Note {
            what: format!("{skipped} faces of fewer than three corners"),
            why: "they have no surface".into(),
        });
    }
    if out.normals.is_empty() {
        out.normals = normals::smooth(&out.positions, &out.triangles);
        notes.push(Note { what: "no normals".into(), why: "smooth ones made".into() });
    } else {
        normals::repair(&mut out);
    }
    if !unread.is_empty() {
        let why = "not read".into();
        notes.push(Note { what: format!("elements or properties: {}", listed(&unread)), why });
    }
    let painted = !out.uvs.is_empty() || !looks.uvs.is_empty();
    let mut images = Vec::new();
    if painted {
        for path in &header.textures {
            let path = path.replace('\\', "/");
            let place = format!("header, texture {}", shown(&path));
            let read = files.read_relative(&path, &place);
            let bytes = files.dispensable(read)?.map(Into::into);
            images.push(EncodedImage { name: path, place, bytes });
        }
    }
    match (painted, header.textures.len()) {
        (true, 0) => {
            notes.push(Note { what: "texture coordinates".into(), why: "no TextureFile names a picture".into() });
        }
        (false, 1..) => {
            notes.push(Note { what: "TextureFile".into(), why: "there are no texture coordinates".into() });
        }
        (true, 2..) if !looks.pictures.iter().any(|p| (1..u32::MAX).contains(p)) => notes.push(Note {
            what: "all pictures but the first".into(),
            why: "no texnumber says which faces show them".into(),
        }),
        _ => {}
    }
    let textures = images::decode_all(&images, files, limits)?;
    if textures.is_empty() {
        (out.uvs, looks.uvs, looks.pictures) = (Vec::new(), Vec::new(), Vec::new());
    }
    if !looks.colours.is_empty() && !out.colours.is_empty() {
        looks.colours = Vec::new();
        notes.push(Note { what: "colours of faces".into(), why: "those of the vertices are shown".into() });
    }
    let primitives = match looks.uvs.is_empty() && looks.colours.is_empty() && looks.pictures.is_empty() {
        true => vec![out],
        false => looks::split(&out, &looks, textures.len(), limits)?,
    };
    let material = |texture: Option<u32>| Material {
        base_colour: [1.0; 4],
        texture,
        alpha: Alpha::Opaque,
        unlit: false,
        double_sided: true,
        wrap: [Wrap::Repeat; 2],
    };
    let materials = (0..primitives.len()).map(|i| material((i < textures.len()).then_some(i as u32))).collect();
    Ok(Scene {
        name: name.to_owned(),
        meshes: vec![Mesh { name: name.to_owned(), primitives }],
        instances: vec![Instance { node: 0, mesh: 0, world_from_mesh: DAffine3::from_translation(origin) }],
        materials,
        textures,
        rooms: Vec::new(),
        portals: Vec::new(),
        viewpoints: Vec::new(),
        notes,
    })
}

/// Positions of named properties; all or none of a group.
fn group<const N: usize>(element: &Element, spellings: &[[&str; N]]) -> Option<[usize; N]> {
    spellings.iter().find_map(|names| {
        let found = names.map(|n| element.properties.iter().position(|p| p.name == n && p.count.is_none()));
        found.iter().all(Option::is_some).then(|| found.map(Option::unwrap_or_default))
    })
}

const COLOURS: [[&str; 3]; 3] =
    [["red", "green", "blue"], ["r", "g", "b"], ["diffuse_red", "diffuse_green", "diffuse_blue"]];

/// Names of properties that are none of these go to `unread`.
fn note_unread(element: &Element, read: &[usize], unread: &mut Vec<String>) {
    let rest = element.properties.iter().enumerate().filter(|(i, _)| !read.contains(i));
    unread.extend(rest.map(|(_, p)| p.name.clone()));
}

/// The linear colour of three values.
fn linear(element: &Element, values: &[f64], colour: [usize; 3]) -> [f32; 3] {
    colour.map(|k| {
        let kind = element.properties[k].item;
        let c = (values[k] / kind.largest()) as f32;
        if kind.is_float() { c } else { linear_from_srgb(c.max(0.0)) }
    })
}

fn read_vertices(
    body: &mut Body<'_>,
    element: &Element,
    world: &mut Vec<DVec3>,
    out: &mut Primitive,
    unread: &mut Vec<String>,
) -> Result<(), Fault> {
    body.check_room(element)?;
    let xyz = group(element, &[["x", "y", "z"]]).ok_or_else(|| body.fault("element vertex lacks x, y or z"))?;
    let normal = group(element, &[["nx", "ny", "nz"]]);
    let colour = group(element, &COLOURS);
    let uv = group(element, &[["u", "v"], ["s", "t"], ["texture_u", "texture_v"]]);
    let read =
        [Some(&xyz[..]), normal.as_ref().map(|n| &n[..]), colour.as_ref().map(|c| &c[..]), uv.as_ref().map(|u| &u[..])];
    note_unread(element, &read.into_iter().flatten().flatten().copied().collect::<Vec<_>>(), unread);
    let mut values = vec![0.0; element.properties.len()];
    for i in 0..element.count {
        for (value, p) in values.iter_mut().zip(&element.properties) {
            *value = match p.count {
                None => body.number(p.item)?,
                Some(count) => {
                    for _ in 0..body.list_length(count, p.item)? {
                        body.number(p.item)?;
                    }
                    0.0
                }
            };
        }
        let at = |k: usize| values[k] as f32;
        let finite = |what: &str, v: &[f32]| match v.iter().all(|x| x.is_finite()) {
            true => Ok(()),
            false => Err(body.fault(format!("vertex {i}: {what} {v:?} is not finite"))),
        };
        finite("position", &xyz.map(at))?;
        world.push(DVec3::from(xyz.map(|k| values[k])));
        if let Some(normal) = normal {
            let normal = normal.map(at);
            finite("normal", &normal)?;
            out.normals.push(Vec3::from(normal));
        }
        if let Some(uv) = uv {
            let [u, v] = uv.map(at);
            finite("texture coordinate", &[u, v])?;
            // v counts upward in PLY, downward here.
            out.uvs.push(Vec2::new(u, 1.0 - v));
        }
        if let Some(colour) = colour {
            let linear = linear(element, &values, colour);
            finite("colour", &linear)?;
            out.colours.push(linear.map(|c| c.clamp(0.0, 1.0)));
        }
    }
    Ok(())
}

/// What faces refer to.
struct Faces<'a> {
    vertices: u64,
    pictures: usize,
    limits: &'a Limits,
}

/// Reads polygons as fans, with their looks; returns how many had fewer than three corners.
fn read_faces(
    body: &mut Body<'_>,
    element: &Element,
    from: &Faces<'_>,
    out: &mut Primitive,
    looks: &mut Looks,
    unread: &mut Vec<String>,
) -> Result<usize, Fault> {
    let list =
        |names: &[&str]| element.properties.iter().position(|p| p.count.is_some() && names.contains(&p.name.as_str()));
    let corners_at = match list(&["vertex_indices", "vertex_index"]) {
        Some(at) => at,
        None if element.count == 0 => return Ok(0),
        None => return Err(body.fault("element face lacks the list vertex_indices")),
    };
    let (uvs_at, picture_at, colour) =
        (list(&["texcoord"]), group(element, &[["texnumber"]]), group(element, &COLOURS));
    let mut read = vec![corners_at];
    read.extend(uvs_at);
    read.extend(picture_at.iter().flatten());
    read.extend(colour.iter().flatten());
    note_unread(element, &read, unread);
    body.check_room(element)?;
    let most = from.limits.unique_triangles;
    let too_many = |triangles: u64| Fault::too_large("element face", "or more triangles", triangles, most);
    let mut skipped = 0;
    let mut values = vec![0.0; element.properties.len()];
    let (mut corners, mut uvs) = (Vec::new(), Vec::new());
    for i in 0..element.count {
        corners.clear();
        uvs.clear();
        for (at, p) in element.properties.iter().enumerate() {
            let Some(count) = p.count else {
                values[at] = body.number(p.item)?;
                continue;
            };
            let n = body.list_length(count, p.item)?;
            if n as u64 > 2 * (most + 2) {
                return Err(too_many(n as u64 / 2));
            }
            for _ in 0..n {
                let v = body.number(p.item)?;
                if at == corners_at {
                    // A float, a negative number or NaN is no vertex either.
                    if !(v >= 0.0 && v < from.vertices as f64 && v.fract() == 0.0) {
                        return Err(body.fault(format!("face {i}: vertex {v} of {}", from.vertices)));
                    }
                    corners.push(v as u32);
                } else if Some(at) == uvs_at {
                    uvs.push(v as f32);
                }
            }
        }
        if corners.len() < 3 {
            skipped += 1;
            continue;
        }
        let triangles = (out.triangles.len() + corners.len() - 2) as u64;
        if triangles > most {
            return Err(too_many(triangles));
        }
        // A face without any is not painted.
        let painted = uvs_at.is_some() && !uvs.is_empty();
        if painted && (uvs.len() != 2 * corners.len() || !uvs.iter().all(|x| x.is_finite())) {
            return Err(body.fault(format!(
                "face {i}: {} numbers for the texture coordinates of {} corners, or one is not finite",
                uvs.len(),
                corners.len()
            )));
        }
        let uv = |k: usize| match painted {
            // v counts upward in PLY, downward here.
            true => Vec2::new(uvs[2 * k], 1.0 - uvs[2 * k + 1]),
            false => Vec2::ZERO,
        };
        let picture = match picture_at {
            _ if uvs_at.is_some() && !painted => None,
            Some([at]) if from.pictures > 0 => match values[at] {
                -1.0 => None,
                n if n >= 0.0 && n < from.pictures as f64 && n.fract() == 0.0 => Some(n as u32),
                n => return Err(body.fault(format!("face {i}: texture {n} of {}", from.pictures))),
            },
            _ => Some(0),
        };
        let face_colour = colour.map(|c| linear(element, &values, c));
        if face_colour.is_some_and(|c| !c.iter().all(|x| x.is_finite())) {
            return Err(body.fault(format!("face {i}: colour {face_colour:?} is not finite")));
        }
        for k in 2..corners.len() {
            out.triangles.push([corners[0], corners[k - 1], corners[k]]);
            if uvs_at.is_some() {
                looks.uvs.push([uv(0), uv(k - 1), uv(k)]);
            }
            if uvs_at.is_some() || picture_at.is_some() {
                looks.pictures.push(picture.unwrap_or(u32::MAX));
            }
            looks.colours.extend(face_colour.map(|c| c.map(|x| x.clamp(0.0, 1.0))));
        }
    }
    Ok(skipped)
}
