//! OBJ statements, line by line.
//!
//! Every number is finite and every reference in range when this is done, and a fault names its
//! line. References are compared with what stands above them, as exporters write it; the format's
//! negative ones count back from there.

use std::collections::HashMap;

use glam::{DVec3, Vec2, Vec3};

use super::super::error::Fault;
use super::super::files::shown;
use super::super::limits::Limits;

/// A parsed file.
#[derive(Debug, Default)]
pub(super) struct Obj {
    /// World positions, metres.
    pub(super) positions: Vec<DVec3>,
    /// Linear colours of all positions, or empty if no position has one.
    pub(super) colours: Vec<[f32; 3]>,
    /// Texture coordinates, v downward.
    pub(super) uvs: Vec<Vec2>,
    /// Normals, of any length.
    pub(super) normals: Vec<Vec3>,
    /// Objects and groups, in order.
    pub(super) groups: Vec<Group>,
    /// Names in `usemtl`, each once.
    pub(super) material_names: Vec<String>,
    /// Files in `mtllib`, with their lines.
    pub(super) libraries: Vec<(usize, String)>,
    /// Statements for things that are not drawn.
    pub(super) left_out: usize,
    /// Colours that left [0, 1].
    pub(super) colours_clamped: usize,
}

/// An object or group.
#[derive(Debug, Default)]
pub(super) struct Group {
    /// Name.
    pub(super) name: String,
    /// Polygons.
    pub(super) faces: Vec<Face>,
}

/// A polygon of three or more corners.
#[derive(Debug)]
pub(super) struct Face {
    /// Position in [`Obj::material_names`].
    pub(super) material: Option<usize>,
    /// Corners in order.
    pub(super) corners: Vec<Corner>,
}

/// Positions in the file's lists.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Corner {
    /// In [`Obj::positions`].
    pub(super) position: u32,
    /// In [`Obj::uvs`].
    pub(super) uv: Option<u32>,
    /// In [`Obj::normals`].
    pub(super) normal: Option<u32>,
}

const REMEDY: &str = "correct the line, or export the file again";

/// A fault at a line.
pub(super) fn at_line(line: usize, problem: impl Into<String>) -> Fault {
    Fault::invalid(format!("line {line}"), problem, REMEDY)
}

/// Numbers that are finite in single precision, all words of a statement.
pub(super) fn numbers(words: &[&str], line: usize) -> Result<Vec<f32>, Fault> {
    Ok(precise_numbers(words, line)?.into_iter().map(|x| x as f32).collect())
}

/// [`numbers`] as the file has them.
fn precise_numbers(words: &[&str], line: usize) -> Result<Vec<f64>, Fault> {
    let number = |w: &&str| match w.parse::<f64>() {
        Ok(x) if (x as f32).is_finite() => Ok(x),
        Ok(_) => Err(at_line(line, format!("{} is not finite", shown(w)))),
        Err(_) => Err(at_line(line, format!("{} is no number", shown(w)))),
    };
    words.iter().map(number).collect()
}

/// Logical lines with their numbers: a backslash at the end joins the next line.
pub(super) fn lines(text: &str) -> impl Iterator<Item = (usize, String)> {
    // Some editors mark text as UTF-8 by a first character.
    let mut physical = text.strip_prefix('\u{feff}').unwrap_or(text).lines().enumerate();
    std::iter::from_fn(move || {
        let (i, first) = physical.next()?;
        let mut line = first.trim_end().to_owned();
        while line.ends_with('\\') {
            line.pop();
            match physical.next() {
                Some((_, more)) => {
                    line.push(' ');
                    line.push_str(more.trim_end());
                }
                None => break,
            }
        }
        // A number sign inside a word belongs to a name.
        let comment =
            line.match_indices('#').find(|&(at, _)| line[..at].chars().next_back().is_none_or(char::is_whitespace));
        if let Some((at, _)) = comment {
            line.truncate(at);
        }
        Some((i + 1, line))
    })
}

/// Parses a file.
pub(super) fn parse(bytes: &[u8], limits: &Limits) -> Result<Obj, Fault> {
    let text = String::from_utf8_lossy(bytes);
    let mut out = Obj { groups: vec![Group { name: "unnamed".into(), faces: Vec::new() }], ..Obj::default() };
    let mut known_materials = HashMap::new();
    let mut material = None;
    let mut corners = 0u64;
    for (line, statement) in lines(&text) {
        let words: Vec<&str> = statement.split_whitespace().collect();
        let Some((&keyword, arguments)) = words.split_first() else { continue };
        let rest = || statement.trim_start()[keyword.len()..].trim().to_owned();
        match keyword {
            "v" => out.vertex(&precise_numbers(arguments, line)?, line)?,
            "vt" => match numbers(arguments, line)?[..] {
                [u] => out.uvs.push(Vec2::new(u, 1.0)),
                [u, v] | [u, v, _] => out.uvs.push(Vec2::new(u, 1.0 - v)),
                _ => return Err(at_line(line, "vt takes one to three numbers")),
            },
            "vn" => match numbers(arguments, line)?[..] {
                [x, y, z] => out.normals.push(Vec3::new(x, y, z)),
                _ => return Err(at_line(line, "vn takes three numbers")),
            },
            "f" | "fo" => {
                if arguments.len() < 3 {
                    return Err(at_line(line, "a face has three corners or more"));
                }
                // Corners bound both vertices and triangles, and with them memory.
                corners += arguments.len() as u64;
                if corners > limits.vertices {
                    return Err(Fault::too_large(
                        format!("line {line}"),
                        "or more corners of faces",
                        corners,
                        limits.vertices,
                    ));
                }
                let face = arguments.iter().map(|c| out.corner(c, line)).collect::<Result<_, _>>()?;
                if let Some(group) = out.groups.last_mut() {
                    group.faces.push(Face { material, corners: face });
                }
            }
            "o" | "g" => {
                let name = rest();
                out.groups
                    .push(Group { name: if name.is_empty() { "unnamed".into() } else { name }, faces: Vec::new() });
            }
            "usemtl" => {
                let name = rest();
                material = Some(*known_materials.entry(name.clone()).or_insert_with(|| {
                    out.material_names.push(name);
                    out.material_names.len() - 1
                }));
            }
            "mtllib" => out.libraries.push((line, rest())),
            "p" | "l" | "curv" | "curv2" | "surf" => out.left_out += 1,
            // Smoothing groups, display attributes, and the bodies of free-form surfaces.
            _ => {}
        }
    }
    // Colours stand for all positions or none.
    if !out.colours.is_empty() {
        out.colours.resize(out.positions.len(), [1.0; 3]);
    }
    Ok(out)
}

impl Obj {
    fn vertex(&mut self, n: &[f64], line: usize) -> Result<(), Fault> {
        let (position, colour) = match *n {
            [x, y, z] => (DVec3::new(x, y, z), None),
            [x, y, z, w] => (DVec3::new(x, y, z) / w, None),
            [x, y, z, r, g, b] => (DVec3::new(x, y, z), Some([r, g, b].map(|c| c as f32))),
            _ => return Err(at_line(line, "v takes three numbers, four with w, or six with a colour")),
        };
        if !position.as_vec3().is_finite() {
            return Err(at_line(line, "position is not finite once divided by w"));
        }
        if let Some(colour) = colour {
            self.colours.resize(self.positions.len(), [1.0; 3]);
            self.colours_clamped += usize::from(!colour.iter().all(|c| (0.0..=1.0).contains(c)));
            // Colours on screen, as scanning tools write them: sRGB.
            self.colours.push(colour.map(|c| ldi_protocol::shade::linear_from_srgb(c.clamp(0.0, 1.0))));
        }
        self.positions.push(position);
        Ok(())
    }

    /// `position`, `position/uv`, `position//normal` or `position/uv/normal`.
    fn corner(&self, word: &str, line: usize) -> Result<Corner, Fault> {
        let mut parts = word.split('/');
        let mut part = |what: &str, length: usize| match parts.next() {
            None | Some("") => Ok(None),
            Some(number) => reference(number, length).map(Some).ok_or_else(|| {
                at_line(line, format!("{what} {} does not exist; there are {length} above", shown(number)))
            }),
        };
        let position = part("position", self.positions.len())?;
        let uv = part("texture coordinate", self.uvs.len())?;
        let normal = part("normal", self.normals.len())?;
        match (position, parts.next()) {
            (Some(position), None) => Ok(Corner { position, uv, normal }),
            _ => Err(at_line(line, format!("corner {} is not position/texture coordinate/normal", shown(word)))),
        }
    }
}

/// A one-based or, if negative, backward reference into a list.
fn reference(number: &str, length: usize) -> Option<u32> {
    let n: i64 = number.parse().ok()?;
    let length = i64::try_from(length).ok()?;
    let at = if n < 0 { length.checked_add(n)? } else { n.checked_sub(1)? };
    if (0..length).contains(&at) { u32::try_from(at).ok() } else { None }
}

#[cfg(test)]
mod tests {
    use super::super::super::limits::LIMITS;
    use super::*;

    #[test]
    fn references_count_from_one_or_from_the_end() {
        assert_eq!(reference("1", 3), Some(0));
        assert_eq!(reference("3", 3), Some(2));
        assert_eq!(reference("-1", 3), Some(2));
        assert_eq!(reference("-3", 3), Some(0));
        for wrong in ["0", "4", "-4", "1.5", "x", "", "9223372036854775807", "-9223372036854775808"] {
            assert_eq!(reference(wrong, 3), None, "{wrong}");
        }
    }

    #[test]
    fn lines_join_at_backslashes_and_drop_comments() {
        let all: Vec<_> = lines("a \\\nb\nc# # d\n\\").collect();
        assert_eq!(all, [(1, "a  b".into()), (3, "c# ".into()), (4, String::new())]);
    }

    #[test]
    fn corners_in_all_four_forms() {
        let obj = parse(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nf 1 2/1 3//1\nf 1/1/1 -2 -1", &LIMITS).unwrap();
        let corner = |position, uv, normal| Corner { position, uv, normal };
        let faces = &obj.groups[0].faces;
        assert_eq!(faces[0].corners, [corner(0, None, None), corner(1, Some(0), None), corner(2, None, Some(0))]);
        assert_eq!(faces[1].corners, [corner(0, Some(0), Some(0)), corner(1, None, None), corner(2, None, None)]);
    }
}
