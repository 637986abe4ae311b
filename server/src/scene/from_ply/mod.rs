//! PLY polygon files (Turk 1994), ASCII and binary in both byte orders.
//!
//! In: the bytes of a `.ply` file. Out: a [`Scene`] of one mesh, placed once, at the origin or
//! where it is ([`origin`]). Coordinates are taken as metres, Y up. Read: vertex positions, normals
//! (else smooth ones are made, as fits a scan), colours (integers are sRGB codes, floats linear
//! light, or codes where they count to 255), texture coordinates with the pictures of `TextureFile`
//! comments; faces as polygons of any size ([`Polygons`]), with `texcoord` per corner, `texnumber`
//! and colours of their own ([`looks`]); `tristrips` where there are no faces. Other elements and
//! properties are read over with a note. A file without surfaces is a point cloud and refused. The
//! reader is our own: the crates for it are unmaintained and trust the header's counts.

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
use super::polygons::Polygons;
use super::repair;
use body::Body;
use header::Element;
use looks::Looks;

const MAGIC: &[u8] = b"ply";

/// Whether the bytes start as a PLY file does.
pub(super) fn is_ply(bytes: &[u8]) -> bool {
    bytes.strip_prefix(MAGIC).and_then(<[u8]>::first).is_some_and(u8::is_ascii_whitespace)
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
    let (mut mended, mut unread) = (Mended::default(), Vec::new());
    let has_faces = header.elements.iter().any(|e| e.name == "face" && e.count > 0);
    for element in &header.elements {
        let from = Faces { vertices, pictures: header.textures.len(), limits };
        match element.name.as_str() {
            "vertex" => read_vertices(&mut body, element, &mut world, &mut out, &mut unread, &mut mended)?,
            "face" => read_faces(&mut body, element, &from, &world, &mut out, &mut looks, &mut unread, &mut mended)?,
            "tristrips" if !has_faces => read_strips(&mut body, element, &from, &mut out)?,
            name => {
                unread.push(name.to_owned());
                body.skip(element)?;
            }
        }
    }
    let origin = origin::of(world.iter().copied().filter(|p| p.as_vec3().is_finite()));
    out.positions = world.into_iter().map(|p| (p - origin).as_vec3()).collect();
    let unplaced = drop_unplaced(&mut out, &mut looks);
    if out.triangles.is_empty() && unplaced > 0 {
        let place = mended.first_unplaced.unwrap_or_default();
        let problem = "the position is not finite, and no triangle is left without such a vertex";
        return Err(Fault::broken(place, problem));
    }
    if out.triangles.is_empty() {
        let remedy = "make a mesh of polygons from it first, for example by Poisson reconstruction";
        return Err(Fault::unsupported("element face", "the file has no faces; point clouds are not read", remedy));
    }
    let mut notes = Vec::new();
    let mut note = |count: usize, what: &str, why: &str| {
        if count > 0 {
            notes.push(Note { what: format!("{count} {what}"), why: why.into() });
        }
    };
    note(mended.short_faces, "faces of fewer than three corners", "they have no surface");
    note(mended.without_area, "polygons without area", "left out");
    note(unplaced, "triangles with a corner that is not finite", "left out");
    note(mended.not_finite, "normals, texture coordinates or colours that are not finite", "made anew");
    note(mended.colours_of_bytes, "lists of colours of type float above 1", "taken as numbers of 0 to 255");
    note(body.with_more_words, "lines with more words than the header names", "the words are left out");
    note(header.unnamed_textures, "TextureFile comments without a name", "left out");
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
            let bytes = files.dispensable(read, true).map(Into::into);
            images.push(EncodedImage { name: path, place, bytes, needed: true });
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
    let textures = images::decode_all(&images, files, limits);
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
        notes,
        ..Scene::default()
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

/// Three values as fractions of the largest of their type; floats as they are.
fn fractions(element: &Element, values: &[f64], colour: [usize; 3]) -> [f32; 3] {
    colour.map(|k| (values[k] / element.properties[k].item.largest()) as f32)
}

/// Largest colour of type float that is taken for a number of [0, 1] out of its range; a larger
/// one counts to 255.
const MOST_COLOUR: f32 = 2.0;

/// Fractions as linear colours within [0, 1].
fn finish_colours(colours: &mut [[f32; 3]], are_floats: bool, mended: &mut Mended) {
    let of_bytes = are_floats && colours.as_flattened().iter().any(|c| *c > MOST_COLOUR);
    mended.colours_of_bytes += usize::from(of_bytes);
    for colour in colours {
        mended.not_finite += usize::from(!colour.iter().all(|c| c.is_finite()));
        let linear = match (are_floats, of_bytes) {
            (true, false) => *colour,
            (true, true) => colour.map(|c| linear_from_srgb((c / 255.0).max(0.0))),
            (false, _) => colour.map(|c| linear_from_srgb(c.max(0.0))),
        };
        let is_number = colour.iter().all(|c| !c.is_nan());
        *colour = if is_number { repair::clamp_colour(linear) } else { [1.0; 3] };
    }
}

/// What was read otherwise than written.
#[derive(Debug, Default)]
struct Mended {
    short_faces: usize,
    without_area: usize,
    not_finite: usize,
    /// Lists of colours that count to 255.
    colours_of_bytes: usize,
    /// Place of the first vertex whose position is not finite.
    first_unplaced: Option<String>,
}

/// Takes out vertices whose position is not finite, and triangles that use one, with their looks;
/// returns how many triangles.
fn drop_unplaced(out: &mut Primitive, looks: &mut Looks) -> usize {
    if out.positions.iter().all(|p| p.is_finite()) {
        return 0;
    }
    let placed: Vec<bool> =
        out.triangles.iter().map(|t| t.iter().all(|&v| out.positions[v as usize].is_finite())).collect();
    fn keep<T: Copy>(values: &mut Vec<T>, placed: &[bool]) {
        if !values.is_empty() {
            *values = values.iter().zip(placed).filter(|(_, kept)| **kept).map(|(value, _)| *value).collect();
        }
    }
    keep(&mut looks.uvs, &placed);
    keep(&mut looks.colours, &placed);
    keep(&mut looks.pictures, &placed);
    repair::drop_unplaced(out).triangles
}

fn read_vertices(
    body: &mut Body<'_>,
    element: &Element,
    world: &mut Vec<DVec3>,
    out: &mut Primitive,
    unread: &mut Vec<String>,
    mended: &mut Mended,
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
        if !xyz.map(at).iter().all(|x| x.is_finite()) && mended.first_unplaced.is_none() {
            mended.first_unplaced = Some(body.fault("").within(format!("vertex {i}")).place().to_owned());
        }
        world.push(DVec3::from(xyz.map(|k| values[k])));
        if let Some(normal) = normal {
            let normal = Vec3::from(normal.map(at));
            mended.not_finite += usize::from(!normal.is_finite());
            out.normals.push(normal);
        }
        if let Some(uv) = uv {
            let [u, v] = uv.map(at);
            // v counts upward in PLY, downward here.
            out.uvs.push(Vec2::new(u, 1.0 - v));
        }
        if let Some(colour) = colour {
            out.colours.push(fractions(element, &values, colour));
        }
        body.end_element();
    }
    mended.not_finite += repair::place_uvs(&mut out.uvs);
    if let Some(colour) = colour {
        finish_colours(&mut out.colours, element.properties[colour[0]].item.is_float(), mended);
    }
    Ok(())
}

/// What faces refer to.
struct Faces<'a> {
    vertices: u64,
    pictures: usize,
    limits: &'a Limits,
}

/// Reads triangle strips: -1 begins a new one.
fn read_strips(body: &mut Body<'_>, element: &Element, from: &Faces<'_>, out: &mut Primitive) -> Result<(), Fault> {
    body.check_room(element)?;
    let is_strip = |name: &str| matches!(name, "vertex_indices" | "vertex_index");
    let most = from.limits.unique_triangles;
    let mut strip: Vec<u32> = Vec::new();
    for i in 0..element.count {
        for p in &element.properties {
            let Some(count) = p.count else {
                body.number(p.item)?;
                continue;
            };
            strip.clear();
            for _ in 0..body.list_length(count, p.item)? {
                let v = body.number(p.item)?;
                if !is_strip(&p.name) {
                    continue;
                }
                if v == -1.0 {
                    strip.clear();
                    continue;
                }
                if !(v >= 0.0 && v < from.vertices as f64 && v.fract() == 0.0) {
                    return Err(body.fault(format!("strip {i}: vertex {v} of {}", from.vertices)));
                }
                strip.push(v as u32);
                if let &[.., a, b, c] = &strip[..]
                    && a != b
                    && b != c
                    && c != a
                {
                    // Every second triangle of a strip is wound the other way.
                    out.triangles.push(if strip.len() % 2 == 1 { [a, b, c] } else { [b, a, c] });
                    if out.triangles.len() as u64 > most {
                        return Err(Fault::too_large("element tristrips", "or more triangles", most + 1, most));
                    }
                }
            }
        }
        body.end_element();
    }
    Ok(())
}

/// Reads polygons as triangles, with their looks. Where the vertices are not known yet, `world` is
/// empty, and polygons become fans.
#[allow(clippy::too_many_arguments, reason = "what one pass over the faces reads and fills")]
fn read_faces(
    body: &mut Body<'_>,
    element: &Element,
    from: &Faces<'_>,
    world: &[DVec3],
    out: &mut Primitive,
    looks: &mut Looks,
    unread: &mut Vec<String>,
    mended: &mut Mended,
) -> Result<(), Fault> {
    let list =
        |names: &[&str]| element.properties.iter().position(|p| p.count.is_some() && names.contains(&p.name.as_str()));
    let corners_at = match list(&["vertex_indices", "vertex_index"]) {
        Some(at) => at,
        None if element.count == 0 => return Ok(()),
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
    let mut values = vec![0.0; element.properties.len()];
    let (mut corners, mut uvs, mut places): (Vec<u32>, Vec<f32>, Vec<DVec3>) = Default::default();
    let mut polygons = Polygons::default();
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
        body.end_element();
        if corners.len() < 3 {
            mended.short_faces += 1;
            continue;
        }
        let triangles = (out.triangles.len() + corners.len() - 2) as u64;
        if triangles > most {
            return Err(too_many(triangles));
        }
        // A face without any is not painted.
        let painted = uvs_at.is_some() && !uvs.is_empty();
        if painted && uvs.len() != 2 * corners.len() {
            return Err(body.fault(format!(
                "face {i}: {} numbers for the texture coordinates of {} corners",
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
        let face_colour = colour.map(|c| fractions(element, &values, c));
        places.clear();
        places.extend(corners.iter().filter_map(|&v| world.get(v as usize)));
        let fan: Vec<[u32; 3]>;
        let cut = match places.len() == corners.len() {
            true => polygons.cut(&places),
            false => {
                fan = (2..corners.len() as u32).map(|k| [0, k - 1, k]).collect();
                &fan
            }
        };
        mended.without_area += usize::from(cut.is_empty());
        for t in cut {
            out.triangles.push(t.map(|k| corners[k as usize]));
            if uvs_at.is_some() {
                looks.uvs.push(t.map(|k| uv(k as usize)));
            }
            if uvs_at.is_some() || picture_at.is_some() {
                looks.pictures.push(picture.unwrap_or(u32::MAX));
            }
            looks.colours.extend(face_colour);
        }
    }
    mended.not_finite += repair::place_uvs(looks.uvs.as_flattened_mut());
    if let Some(colour) = colour {
        finish_colours(&mut looks.colours, element.properties[colour[0]].item.is_float(), mended);
    }
    Ok(())
}
