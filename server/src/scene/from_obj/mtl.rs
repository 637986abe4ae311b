//! Material libraries (`.mtl`): the diffuse part of them.
//!
//! Read: `newmtl`, `Kd` (taken as linear, as modelling tools write it), `map_Kd` with `-clamp on`,
//! `d` and `Tr`. A material that is not opaque is masked at alpha 0.5, like a blended one of glTF.
//! `map_d` and the options that move a texture are left out with a note.

use std::collections::HashMap;

use ldi_protocol::mesh::{Alpha, Material, Wrap};

use super::super::error::Fault;
use super::super::files::{Files, shown};
use super::super::images::EncodedImage;
use super::super::model::Note;
use super::text::{at_line, lines, numbers};

/// Materials of all libraries of a file.
#[derive(Debug, Default)]
pub(super) struct Library {
    /// In order; the white default at the end once it was asked for.
    pub(super) materials: Vec<Material>,
    /// What the materials' textures refer to.
    pub(super) images: Vec<EncodedImage<'static>>,
    by_name: HashMap<String, u32>,
    by_path: HashMap<String, u32>,
    default: Option<u32>,
}

const WHITE: Material = Material {
    base_colour: [1.0; 4],
    texture: None,
    alpha: Alpha::Opaque,
    unlit: false,
    double_sided: true,
    wrap: [Wrap::Repeat; 2],
};

/// Reads the libraries that an OBJ file names. A missing one is an error: the scene would silently
/// turn white.
pub(super) fn load(libraries: &[(usize, String)], files: &mut Files, notes: &mut Vec<Note>) -> Result<Library, Fault> {
    let mut out = Library::default();
    let (mut moved, mut masked, mut translucent) = (0, 0, 0);
    for (line, path) in libraries {
        // Some exporters write DOS paths.
        let path = path.replace('\\', "/");
        let place = format!("line {line}, material library {}", shown(&path));
        let read = files.read_relative(&path, &place);
        let Some(bytes) = files.dispensable(read)? else { continue };
        let text = String::from_utf8_lossy(&bytes);
        for (line, statement) in lines(&text) {
            let words: Vec<&str> = statement.split_whitespace().collect();
            let Some((&keyword, arguments)) = words.split_first() else { continue };
            let read = out.statement(keyword, arguments, &statement, line, files);
            let option = read.map_err(|f| f.within(&place))?;
            moved += usize::from(option == Treatment::Moved);
            masked += usize::from(option == Treatment::AlphaMap);
            translucent += usize::from(option == Treatment::Translucent);
        }
    }
    let mut note = |count: usize, what: &str, why: &str| {
        if count > 0 {
            notes.push(Note { what: format!("{count} {what}"), why: why.into() });
        }
    };
    note(moved, "textures with scale, offset or other options", "options left out");
    note(masked, "alpha maps (map_d)", "alpha comes from the colour texture alone");
    note(translucent, "translucent materials", "drawn as masked at alpha 0.5");
    Ok(out)
}

/// What was not taken as written.
#[derive(Debug, PartialEq)]
enum Treatment {
    AsWritten,
    Moved,
    AlphaMap,
    Translucent,
}

impl Library {
    /// Position of a material.
    pub(super) fn find(&self, name: &str) -> Option<u32> {
        self.by_name.get(name).copied()
    }

    /// Position of the white material.
    pub(super) fn default_material(&mut self) -> u32 {
        *self.default.get_or_insert_with(|| {
            self.materials.push(WHITE);
            self.materials.len() as u32 - 1
        })
    }

    fn statement(
        &mut self,
        keyword: &str,
        arguments: &[&str],
        statement: &str,
        line: usize,
        files: &mut Files,
    ) -> Result<Treatment, Fault> {
        if keyword == "newmtl" {
            let name = statement.trim_start()[keyword.len()..].trim().to_owned();
            self.by_name.insert(name, self.materials.len() as u32);
            self.materials.push(WHITE);
            return Ok(Treatment::AsWritten);
        }
        let material = self.materials.last_mut();
        let current = || at_line(line, format!("{keyword} before any newmtl"));
        match keyword {
            "Kd" => {
                let colour = match numbers(arguments, line)?[..] {
                    // "Kd r" means a grey.
                    [r] => [r; 3],
                    [r, g, b] => [r, g, b],
                    _ => return Err(at_line(line, "Kd takes one or three numbers")),
                };
                if !colour.iter().all(|c| (0.0..=1.0).contains(c)) {
                    return Err(at_line(line, "Kd leaves [0, 1]"));
                }
                material.ok_or_else(current)?.base_colour[..3].copy_from_slice(&colour);
            }
            "d" | "Tr" => {
                // "d -halo 0.5" fades toward the rim; the factor counts.
                let value = match numbers(arguments.strip_prefix(&["-halo"]).unwrap_or(arguments), line)?[..] {
                    [value] if (0.0..=1.0).contains(&value) => value,
                    _ => return Err(at_line(line, format!("{keyword} takes one number in [0, 1]"))),
                };
                let material = material.ok_or_else(current)?;
                material.base_colour[3] = if keyword == "d" { value } else { 1.0 - value };
                material.alpha = if material.base_colour[3] < 1.0 { Alpha::Mask(0.5) } else { Alpha::Opaque };
                if material.alpha != Alpha::Opaque {
                    return Ok(Treatment::Translucent);
                }
            }
            "map_Kd" => {
                let map = texture_map(arguments);
                let texture = self.image(&map.path.replace('\\', "/"), line, files)?;
                let material = self.materials.last_mut().ok_or_else(current)?;
                material.texture = Some(texture);
                material.wrap = [if map.clamp { Wrap::Clamp } else { Wrap::Repeat }; 2];
                if map.moved {
                    return Ok(Treatment::Moved);
                }
            }
            "map_d" => return Ok(Treatment::AlphaMap),
            _ => {}
        }
        Ok(Treatment::AsWritten)
    }

    fn image(&mut self, path: &str, line: usize, files: &mut Files) -> Result<u32, Fault> {
        if let Some(&known) = self.by_path.get(path) {
            return Ok(known);
        }
        let place = format!("line {line}, texture {}", shown(path));
        let read = files.read_relative(path, &place);
        let bytes = files.dispensable(read)?.map(Into::into);
        self.images.push(EncodedImage { name: path.to_owned(), place, bytes });
        let at = self.images.len() as u32 - 1;
        self.by_path.insert(path.to_owned(), at);
        Ok(at)
    }
}

#[derive(Debug, Default, PartialEq)]
struct TextureMap {
    path: String,
    clamp: bool,
    moved: bool,
}

/// Options, then a path that may hold spaces.
fn texture_map(arguments: &[&str]) -> TextureMap {
    let mut out = TextureMap::default();
    let mut rest = arguments;
    while let Some((option, after)) = rest.split_first().filter(|(o, _)| o.starts_with('-')) {
        let is_number = |w: &&&str| w.parse::<f32>().is_ok();
        let taken = match *option {
            "-o" | "-s" | "-t" => after.iter().take(3).take_while(is_number).count(),
            "-mm" => 2,
            _ => 1,
        };
        match *option {
            "-clamp" => out.clamp = after.first() == Some(&"on"),
            _ => out.moved = true,
        }
        rest = after.get(taken..).unwrap_or_default();
    }
    out.path = rest.join(" ");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texture_options_are_told_from_paths() {
        let map = |text: &str| texture_map(&text.split_whitespace().collect::<Vec<_>>());
        let want = |path: &str, clamp, moved| TextureMap { path: path.into(), clamp, moved };
        assert_eq!(map("a.png"), want("a.png", false, false));
        assert_eq!(map("my wall.png"), want("my wall.png", false, false));
        assert_eq!(map("-clamp on a.png"), want("a.png", true, false));
        assert_eq!(map("-s 2 2 -o 0.5 1 1 -bm 1 dir/a.png"), want("dir/a.png", false, true));
        assert_eq!(map("-s"), want("", false, true));
    }
}
