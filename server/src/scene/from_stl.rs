//! STL, binary and text.
//!
//! In: the bytes of an `.stl` file (3D Systems, 1988). Out: a [`Scene`] of one mesh, placed once,
//! at the origin or where it is ([`origin`]), in one white material that draws both sides. Each
//! triangle has the normal of its corners; stored normals, which many writers leave empty, are not
//! read. STL knows no units and no axes: coordinates are taken as metres, Y up, as `?up=z&unit=mm`
//! changes.

use glam::{DAffine3, DVec3};

use super::error::Fault;
use super::files::shown;
use super::limits::Limits;
use super::model::{Instance, Mesh, Note, Primitive, Scene, WHITE};
use super::normals;
use super::origin;
use super::repair;
use super::text;

/// Bytes before the first triangle of a binary file: a comment and the number of triangles.
const HEADER: usize = 84;
/// Bytes of a triangle: a normal, three corners, two bytes for colours.
const TRIANGLE: usize = 50;
const NORMAL: usize = 12;

const REMEDY: &str = "export the file again";

/// Triangles that a binary file says it has.
fn count(bytes: &[u8]) -> Option<u64> {
    let count = bytes.get(HEADER - 4..HEADER)?.first_chunk::<4>()?;
    Some(u64::from(u32::from_le_bytes(*count)))
}

/// Whether the length of a file is just that of a binary one.
fn is_binary(bytes: &[u8]) -> bool {
    count(bytes).is_some_and(|n| n > 0 && HEADER as u64 + n * TRIANGLE as u64 == bytes.len() as u64)
}

fn is_text(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(4096)];
    let lower = head.trim_ascii_start().to_ascii_lowercase();
    lower.starts_with(b"solid") && lower.windows(5).any(|w| w == b"facet")
}

/// Whether bytes are an STL file, whatever its name ends in.
pub(super) fn is_stl(bytes: &[u8]) -> bool {
    is_binary(bytes) || is_text(bytes)
}

/// Reads an STL file.
pub(super) fn import(name: &str, bytes: &[u8], limits: &Limits) -> Result<Scene, Fault> {
    // A binary file may start with the word of a text: its length decides.
    let world = match is_text(bytes) && !is_binary(bytes) {
        true => from_text(bytes, limits)?,
        false => from_binary(bytes, limits)?,
    };
    let finite = world.as_flattened().iter().copied().filter(|p| p.as_vec3().is_finite());
    let origin = origin::of(finite);
    let positions = world.as_flattened().iter().map(|p| (*p - origin).as_vec3()).collect();
    let triangles = (0..world.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let mut primitive = Primitive { positions, triangles, ..Primitive::default() };
    let dropped = repair::drop_unplaced(&mut primitive);
    if primitive.triangles.is_empty() {
        return Err(Fault::invalid("file", "has no triangles", "export the meshes again"));
    }
    normals::flatten(&mut primitive);
    let mut notes = Vec::new();
    if dropped.triangles > 0 {
        let what = format!("{} triangles with a corner that is not finite", dropped.triangles);
        notes.push(Note { what, why: "left out".into() });
    }
    Ok(Scene {
        name: name.to_owned(),
        meshes: vec![Mesh { name: name.to_owned(), primitives: vec![primitive] }],
        instances: vec![Instance { node: 0, mesh: 0, world_from_mesh: DAffine3::from_translation(origin) }],
        materials: vec![WHITE],
        notes,
        ..Scene::default()
    })
}

/// Both limits: three vertices belong to each triangle alone.
fn check(triangles: u64, place: &str, limits: &Limits) -> Result<(), Fault> {
    if triangles > limits.unique_triangles {
        return Err(Fault::too_large(place, "or more triangles", triangles, limits.unique_triangles));
    }
    if 3 * triangles > limits.vertices {
        return Err(Fault::too_large(place, "or more vertices", 3 * triangles, limits.vertices));
    }
    Ok(())
}

fn from_binary(bytes: &[u8], limits: &Limits) -> Result<Vec<[DVec3; 3]>, Fault> {
    let fault = |problem: String| Fault::invalid("file", problem, REMEDY);
    let declared = count(bytes).ok_or_else(|| fault(format!("{} bytes are no STL file", bytes.len())))?;
    check(declared, "file", limits)?;
    let body = &bytes[HEADER..];
    if declared * TRIANGLE as u64 > body.len() as u64 {
        return Err(fault(format!("{declared} triangles do not fit into the {} bytes that follow", body.len())));
    }
    let number = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let corner = |b: &[u8]| DVec3::new(number(b), number(&b[4..]), number(&b[8..]));
    let triangle = |b: &[u8; TRIANGLE]| [0, 1, 2].map(|k| corner(&b[NORMAL * (1 + k)..]));
    Ok(body.as_chunks::<TRIANGLE>().0.iter().take(declared as usize).map(triangle).collect())
}

fn from_text(bytes: &[u8], limits: &Limits) -> Result<Vec<[DVec3; 3]>, Fault> {
    let text = text::decode(bytes);
    let (mut out, mut corners) = (Vec::new(), Vec::new());
    for (i, line) in text.lines().enumerate() {
        let place = || format!("line {}", i + 1);
        let mut words = line.split_whitespace();
        let Some(keyword) = words.next() else { continue };
        if keyword.eq_ignore_ascii_case("vertex") {
            let mut number = || {
                let word = words.next().unwrap_or_default();
                word.parse::<f64>()
                    .map_err(|_| Fault::invalid(place(), format!("{} is no number", shown(word)), REMEDY))
            };
            corners.push(DVec3::new(number()?, number()?, number()?));
        } else if keyword.eq_ignore_ascii_case("endfacet") {
            let &[a, b, c] = &corners[..] else {
                let problem = format!("a facet has {} corners instead of three", corners.len());
                return Err(Fault::invalid(place(), problem, REMEDY));
            };
            corners.clear();
            out.push([a, b, c]);
            check(out.len() as u64, &place(), limits)?;
        }
        if corners.len() > 3 {
            return Err(Fault::invalid(place(), "a facet has more than three corners", REMEDY));
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::super::limits::LIMITS;
    use super::*;

    const TEXT: &str = "solid a\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   vertex 1 0 0\n   \
                        vertex 0 1 0\n  endloop\n endfacet\nendsolid a\n";

    fn binary(triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
        let mut out = vec![b' '; HEADER - 4];
        out.extend((triangles.len() as u32).to_le_bytes());
        for t in triangles {
            out.extend([0; NORMAL]);
            out.extend(t.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
            out.extend([0; 2]);
        }
        out
    }

    const CORNER: [[f32; 3]; 3] = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]];

    #[test]
    fn text_and_binary_give_the_same_triangle() {
        let of = |bytes: &[u8]| {
            assert!(is_stl(bytes));
            let scene = import("a.stl", bytes, &LIMITS).expect("loads");
            scene.check().expect("is sound");
            scene.meshes[0].primitives[0].clone()
        };
        // Writers of binary files put the word of a text into the comment.
        let mut misnamed = binary(&[CORNER]);
        misnamed[..10].copy_from_slice(b"solid cube");
        let (a, b, c) = (of(TEXT.as_bytes()), of(&binary(&[CORNER])), of(&misnamed));
        assert_eq!((&a.positions, &a.normals), (&b.positions, &b.normals));
        assert_eq!(b.positions, c.positions);
        assert_eq!(a.normals, [glam::Vec3::Z; 3]);
    }

    #[test]
    fn corners_without_a_place_take_their_triangle_with_them() {
        let bad = [[f32::NAN, 0., 0.], CORNER[1], CORNER[2]];
        let scene = import("a.stl", &binary(&[bad, CORNER]), &LIMITS).expect("loads");
        assert_eq!((scene.triangles(), scene.notes.len()), (1, 1));
        assert!(import("a.stl", &binary(&[bad]), &LIMITS).is_err());
    }

    #[test]
    fn forged_files_are_refused() {
        let said = |bytes: &[u8]| import("a.stl", bytes, &LIMITS).expect_err("refused").in_short();
        let mut many = binary(&[CORNER]);
        many[HEADER - 4..HEADER].copy_from_slice(&9u32.to_le_bytes());
        assert!(said(&many).contains("do not fit"));
        many[HEADER - 4..HEADER].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(said(&many).contains("at most"));
        assert!(said(b"").contains("no STL"));
        assert!(said(TEXT.replace("vertex 1 0 0", "vertex 1 x 0").as_bytes()).contains("line 5"));
        assert!(said(TEXT.replace("vertex 1 0 0", "").as_bytes()).contains("2 corners"));
        let few = Limits { unique_triangles: 1, ..LIMITS };
        assert!(import("a.stl", &binary(&[CORNER, CORNER]), &few).is_err());
    }
}
