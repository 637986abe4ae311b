//! OBJ statements, line by line.
//!
//! Every reference is in range when this is done, and a fault names its line. References are
//! compared with what stands above them, as exporters write it; the format's negative ones count
//! back from there.

use std::collections::HashMap;

use glam::{DVec3, Vec2, Vec3};

use super::super::error::Fault;
use super::super::files::shown;
use super::super::limits::Limits;
use super::super::repair;
use super::super::text;

/// A parsed file.
#[derive(Debug, Default)]
pub(super) struct Obj {
    /// World positions, metres; what is not finite is for the builder to drop.
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
    /// What was read otherwise than written.
    pub(super) mended: Mended,
}

/// Counts of what was read otherwise than written.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Mended {
    /// Statements for things that are not drawn.
    pub(super) left_out: usize,
    /// Colours that left [0, 1].
    pub(super) colours_clamped: usize,
    /// Whether colours count to 255.
    pub(super) colours_of_bytes: bool,
    /// Faces of fewer than three corners.
    pub(super) short_faces: usize,
    /// Corners that name a texture coordinate or normal that is not there.
    pub(super) missing_looks: usize,
    /// Texture coordinates and normals that are not finite.
    pub(super) not_finite: usize,
    /// Vertices whose fourth number is zero.
    pub(super) weights_of_zero: usize,
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

/// A number as programs print it; NaN where they print that it is none.
pub(super) fn number(word: &str) -> Option<f64> {
    word.parse().ok().or_else(|| {
        // Runtimes on Windows: 1.#IND, -1.#QNAN0, 1.#INF, -nan(ind).
        let bare = word.trim_start_matches(['-', '+']).to_ascii_lowercase();
        (bare.starts_with("1.#") || bare.starts_with("nan(")).then_some(f64::NAN)
    })
}

/// All words of a statement as numbers.
pub(super) fn numbers(words: &[&str], line: usize) -> Result<Vec<f64>, Fault> {
    let read = |w: &&str| {
        number(w).ok_or_else(|| match w.contains(',') && number(&w.replace(',', ".")).is_some() {
            true => Fault::invalid(
                format!("line {line}"),
                format!("{} is no number: it has a comma for the decimal point", shown(w)),
                "export again with a point, for example under English regional settings",
            ),
            false => at_line(line, format!("{} is no number", shown(w))),
        })
    };
    words.iter().map(read).collect()
}

/// Logical lines with their numbers: a backslash at the end joins the next line.
pub(super) fn lines(text: &str) -> impl Iterator<Item = (usize, String)> {
    // Before OS X, lines ended with a carriage return alone.
    let end = if text.contains('\n') { '\n' } else { '\r' };
    let mut physical = text.split(end).enumerate();
    std::iter::from_fn(move || {
        let (i, first) = physical.next()?;
        let mut line = first.trim_end().to_owned();
        // A path at the end of a comment joins nothing.
        let joins = !line.trim_start().starts_with('#');
        while joins && line.ends_with('\\') {
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

/// Faults of a file that are told at once.
const MOST_FAULTS: usize = 8;

/// Parses a file.
pub(super) fn parse(bytes: &[u8], limits: &Limits) -> Result<Obj, Fault> {
    let text = text::decode(bytes);
    let mut parser = Parser { limits, known_materials: HashMap::new(), material: None, corners: 0 };
    let mut out = Obj { groups: vec![Group { name: "unnamed".into(), faces: Vec::new() }], ..Obj::default() };
    let mut faults = Vec::new();
    for (line, statement) in lines(&text) {
        match parser.statement(&mut out, &statement, line) {
            Err(fault) if fault.is_of_size() => return Err(fault),
            Err(fault) => faults.push(fault),
            Ok(()) => {}
        }
        if faults.len() == MOST_FAULTS {
            break;
        }
    }
    match Fault::together(faults) {
        Some(fault) => Err(fault),
        None => {
            out.finish_colours();
            Ok(out)
        }
    }
}

/// Whether a text has a vertex of OBJ, whatever the file's name ends in.
pub(super) fn has_vertex(bytes: &[u8]) -> bool {
    let text = text::decode(bytes);
    let is_vertex = |statement: String| {
        let mut words = statement.split_whitespace();
        words.next() == Some("v") && words.clone().count() >= 3 && words.all(|w| number(w).is_some())
    };
    lines(&text).any(|(_, statement)| is_vertex(statement))
}

/// Where reading stands.
struct Parser<'a> {
    limits: &'a Limits,
    known_materials: HashMap<String, usize>,
    material: Option<usize>,
    corners: u64,
}

impl Parser<'_> {
    fn statement(&mut self, out: &mut Obj, statement: &str, line: usize) -> Result<(), Fault> {
        let words: Vec<&str> = statement.split_whitespace().collect();
        let Some((&keyword, arguments)) = words.split_first() else { return Ok(()) };
        let rest = || statement.trim_start()[keyword.len()..].trim().to_owned();
        let lower = keyword.bytes().any(|b| b.is_ascii_uppercase()).then(|| keyword.to_ascii_lowercase());
        match lower.as_deref().unwrap_or(keyword) {
            "v" => out.vertex(&numbers(arguments, line)?, line)?,
            "vt" => {
                let uv = match numbers(arguments, line)?[..] {
                    [u] => Vec2::new(u as f32, 1.0),
                    [u, v] | [u, v, _] | [u, v, _, _] => Vec2::new(u as f32, 1.0 - v as f32),
                    _ => return Err(at_line(line, "vt takes one to three numbers")),
                };
                out.mended.not_finite += usize::from(!uv.is_finite());
                out.uvs.push(if uv.is_finite() { uv } else { Vec2::ZERO });
            }
            "vn" => {
                let normal = match numbers(arguments, line)?[..] {
                    [x, y, z] => Vec3::new(x as f32, y as f32, z as f32),
                    _ => return Err(at_line(line, "vn takes three numbers")),
                };
                out.mended.not_finite += usize::from(!normal.is_finite());
                out.normals.push(normal);
            }
            "f" | "fo" => {
                if arguments.len() < 3 {
                    out.mended.short_faces += 1;
                    return Ok(());
                }
                // Corners bound both vertices and triangles, and with them memory.
                self.corners += arguments.len() as u64;
                if self.corners > self.limits.vertices {
                    let place = format!("line {line}");
                    return Err(Fault::too_large(
                        place,
                        "or more corners of faces",
                        self.corners,
                        self.limits.vertices,
                    ));
                }
                let face = arguments.iter().map(|c| out.corner(c, line)).collect::<Result<_, _>>()?;
                if let Some(group) = out.groups.last_mut() {
                    group.faces.push(Face { material: self.material, corners: face });
                }
            }
            "o" | "g" => {
                let name = rest();
                out.groups
                    .push(Group { name: if name.is_empty() { "unnamed".into() } else { name }, faces: Vec::new() });
            }
            "usemtl" => {
                let name = rest();
                self.material = Some(*self.known_materials.entry(name.clone()).or_insert_with(|| {
                    out.material_names.push(name);
                    out.material_names.len() - 1
                }));
            }
            "mtllib" => out.libraries.push((line, rest())),
            "p" | "l" | "curv" | "curv2" | "surf" => out.mended.left_out += 1,
            // Smoothing groups, display attributes, and the bodies of free-form surfaces.
            _ => {}
        }
        Ok(())
    }
}

/// Largest colour that is taken for a number of [0, 1] that is out of its range; a larger one
/// counts to 255.
const MOST_COLOUR: f32 = 2.0;

impl Obj {
    fn vertex(&mut self, n: &[f64], line: usize) -> Result<(), Fault> {
        let (position, colour) = match *n {
            [x, y, z] => (DVec3::new(x, y, z), None),
            // A weight of rational curves, which polygons do not have.
            [x, y, z, 0.0] => {
                self.mended.weights_of_zero += 1;
                (DVec3::new(x, y, z), None)
            }
            [x, y, z, w] => (DVec3::new(x, y, z) / w, None),
            [x, y, z, r, g, b] | [x, y, z, r, g, b, _] => (DVec3::new(x, y, z), Some([r, g, b].map(|c| c as f32))),
            _ => return Err(at_line(line, "v takes three numbers, four with w, or six with a colour")),
        };
        if let Some(colour) = colour {
            self.colours.resize(self.positions.len(), [f32::NAN; 3]);
            self.colours.push(colour);
        }
        self.positions.push(position);
        Ok(())
    }

    /// Colours as linear light, of all positions or none; white where a position has none.
    fn finish_colours(&mut self) {
        if self.colours.is_empty() {
            return;
        }
        self.colours.resize(self.positions.len(), [f32::NAN; 3]);
        let of_bytes = self.colours.as_flattened().iter().any(|c| *c > MOST_COLOUR);
        self.mended.colours_of_bytes = of_bytes;
        for colour in &mut self.colours {
            if colour.iter().all(|c| c.is_nan()) {
                *colour = [1.0; 3];
                continue;
            }
            let scaled = if of_bytes { colour.map(|c| c / 255.0) } else { *colour };
            self.mended.colours_clamped += usize::from(!scaled.iter().all(|c| (0.0..=1.0).contains(c)));
            // Colours on screen, as scanning tools write them: sRGB.
            *colour = repair::clamp_colour(scaled).map(ldi_protocol::shade::linear_from_srgb);
        }
    }

    /// `position`, `position/uv`, `position//normal` or `position/uv/normal`.
    fn corner(&mut self, word: &str, line: usize) -> Result<Corner, Fault> {
        let mut parts = word.split('/');
        let mut part = |what: &str, length: usize| match parts.next() {
            None | Some("") => Ok(None),
            Some(number) => match (reference(number, length), number.parse::<i64>()) {
                (Some(at), _) => Ok(Some(at)),
                // Looks that are not there are left out.
                (None, Ok(_)) if what != POSITION => {
                    self.mended.missing_looks += 1;
                    Ok(None)
                }
                _ => Err(at_line(line, format!("{what} {} does not exist; there are {length} above", shown(number)))),
            },
        };
        let position = part(POSITION, self.positions.len())?;
        let uv = part("texture coordinate", self.uvs.len())?;
        let normal = part("normal", self.normals.len())?;
        match (position, parts.next()) {
            (Some(position), None) => Ok(Corner { position, uv, normal }),
            _ => Err(at_line(line, format!("corner {} is not position/texture coordinate/normal", shown(word)))),
        }
    }
}

const POSITION: &str = "position";

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
        let all: Vec<_> = lines("a \\\nb\nc# # d\n# C:\\\n\\").collect();
        assert_eq!(all, [(1, "a  b".into()), (3, "c# ".into()), (4, String::new()), (5, String::new())]);
    }

    #[test]
    fn lines_of_any_system_are_told_apart() {
        for text in ["v 1\nv 2\nv 3", "v 1\r\nv 2\r\nv 3", "v 1\rv 2\rv 3"] {
            let all: Vec<_> = lines(text).collect();
            assert_eq!(all, [(1, "v 1".into()), (2, "v 2".into()), (3, "v 3".into())], "{text:?}");
        }
    }

    #[test]
    fn numbers_that_are_none_are_told_from_words() {
        assert_eq!(number("-1.5e3"), Some(-1500.0));
        for nan in ["nan", "-nan", "NaN", "-1.#IND00", "1.#QNAN", "1.#INF", "-nan(ind)"] {
            assert!(number(nan).is_some_and(|x| !x.is_finite()), "{nan}");
        }
        assert!(["", "x", "1,5", "1.2.3"].iter().all(|word| number(word).is_none()));
    }

    #[test]
    fn faults_are_told_together() {
        let said = parse(b"v 0 0 x\nv 1,5 0 0\nf 1 2 3", &LIMITS).unwrap_err().in_short();
        assert!(said.starts_with("line 1") && said.contains("line 2") && said.contains("line 3"), "{said}");
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
