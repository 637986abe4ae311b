//! PLY polygon files (Turk 1994), ASCII and binary in both byte orders.
//!
//! In: the bytes of a `.ply` file. Out: a [`Scene`] of one mesh, placed once at the origin. Coordinates are taken as
//! metres, Y up. Read: vertex positions, normals (else smooth ones are made, as fits a scan), colours (integers are
//! sRGB codes, floats linear light), texture coordinates with the picture of a `TextureFile` comment; faces as polygons
//! of any size, cut into fans. Other elements and properties are read over. A file without faces is a point cloud and
//! refused. The reader is our own: the crates for it are unmaintained and trust the header's counts.

mod body;
mod header;

use glam::{DAffine3, Vec2, Vec3};
use ldi_protocol::mesh::{Alpha, Material, Wrap};
use ldi_protocol::shade::linear_from_srgb;

use super::error::Fault;
use super::files::{Files, shown};
use super::images::{self, EncodedImage};
use super::limits::Limits;
use super::model::{Instance, Mesh, Note, Primitive, Scene};
use super::normals;
use body::Body;
use header::{Element, Property};

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
    let mut skipped = 0;
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => read_vertices(&mut body, element, &mut out)?,
            "face" => skipped += read_faces(&mut body, element, vertices, limits, &mut out)?,
            _ => body.skip(element)?,
        }
    }
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
    let textures = match &header.texture {
        Some(path) if !out.uvs.is_empty() => {
            let path = path.replace('\\', "/");
            let place = format!("header, texture {}", shown(&path));
            let bytes = files.read_relative(&path, &place)?.into();
            images::decode_all(&[EncodedImage { name: path, place, bytes }], limits)?
        }
        _ => {
            out.uvs = Vec::new();
            Vec::new()
        }
    };
    let material = Material {
        base_colour: [1.0; 4],
        texture: (!textures.is_empty()).then_some(0),
        alpha: Alpha::Opaque,
        unlit: false,
        double_sided: true,
        wrap: [Wrap::Repeat; 2],
    };
    Ok(Scene {
        name: name.to_owned(),
        meshes: vec![Mesh { name: name.to_owned(), primitives: vec![out] }],
        instances: vec![Instance { node: 0, mesh: 0, world_from_mesh: DAffine3::IDENTITY }],
        materials: vec![material],
        textures,
        rooms: Vec::new(),
        portals: Vec::new(),
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

fn read_vertices(body: &mut Body<'_>, element: &Element, out: &mut Primitive) -> Result<(), Fault> {
    body.check_room(element)?;
    let xyz = group(element, &[["x", "y", "z"]]).ok_or_else(|| body.fault("element vertex lacks x, y or z"))?;
    let normal = group(element, &[["nx", "ny", "nz"]]);
    let colour =
        group(element, &[["red", "green", "blue"], ["r", "g", "b"], ["diffuse_red", "diffuse_green", "diffuse_blue"]]);
    let uv = group(element, &[["u", "v"], ["s", "t"], ["texture_u", "texture_v"]]);
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
        let position = xyz.map(at);
        finite("position", &position)?;
        out.positions.push(Vec3::from(position));
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
            let linear = colour.map(|k| {
                let kind = element.properties[k].item;
                let c = (values[k] / kind.largest()) as f32;
                if kind.is_float() { c } else { linear_from_srgb(c.max(0.0)) }
            });
            finite("colour", &linear)?;
            out.colours.push(linear.map(|c| c.clamp(0.0, 1.0)));
        }
    }
    Ok(())
}

/// Reads polygons as fans; returns how many had fewer than three corners.
fn read_faces(
    body: &mut Body<'_>,
    element: &Element,
    vertices: u64,
    limits: &Limits,
    out: &mut Primitive,
) -> Result<usize, Fault> {
    let is_corners = |p: &Property| p.count.is_some() && (p.name == "vertex_indices" || p.name == "vertex_index");
    if !element.properties.iter().any(is_corners) && element.count > 0 {
        return Err(body.fault("element face lacks the list vertex_indices"));
    }
    body.check_room(element)?;
    let mut skipped = 0;
    for i in 0..element.count {
        for p in &element.properties {
            let n = match p.count {
                Some(count) => body.list_length(count, p.item)?,
                None => 1,
            };
            if !is_corners(p) {
                for _ in 0..n {
                    body.number(p.item)?;
                }
                continue;
            }
            skipped += usize::from(n < 3);
            let triangles = out.triangles.len() as u64 + (n as u64).saturating_sub(2);
            if triangles > limits.unique_triangles {
                return Err(Fault::too_large("element face", "or more triangles", triangles, limits.unique_triangles));
            }
            let mut fan = [0u32; 2];
            for k in 0..n {
                let v = body.number(p.item)?;
                // A float, a negative number or NaN is no vertex either.
                if !(v >= 0.0 && v < vertices as f64 && v.fract() == 0.0) {
                    return Err(body.fault(format!("face {i}: vertex {v} of {vertices}")));
                }
                let v = v as u32;
                match k {
                    0 | 1 => fan[k] = v,
                    _ => {
                        out.triangles.push([fan[0], fan[1], v]);
                        fan[1] = v;
                    }
                }
            }
        }
    }
    Ok(skipped)
}
