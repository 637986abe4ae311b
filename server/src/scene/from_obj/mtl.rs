//! Material libraries (`.mtl`): the diffuse part of them.
//!
//! Read: `newmtl`, `Kd` (taken as linear, as modelling tools write it), `map_Kd` with `-clamp`,
//! `-s` and `-o`, `d`, `Tr`, `map_d`, and `Ke` where `Kd` is dark. Keywords may be in any letter
//! case. A material that is not opaque is masked at alpha 0.5, like a blended one of glTF. Other
//! options of textures are left out with a note.
//!
//! Writers disagree about opacity: some write `Tr` for opacity, some `d 0` for everything. Where
//! both stand, `d` is believed; a library whose every material would be invisible is drawn opaque.
//! `Kd 0 0 0` beside a picture means the picture, since the product would be black.

use std::collections::{HashMap, HashSet};

use glam::{Affine2, Vec2, Vec3};
use ldi_protocol::mesh::{Alpha, Material, Wrap};

use super::super::error::Fault;
use super::super::files::{Files, shown};
use super::super::images::{self, EncodedImage};
use super::super::limits::Limits;
use super::super::model::{Note, SceneTexture, WHITE};
use super::super::{DARK, repair, text};
use super::text::{at_line, lines, numbers};

/// Materials of all libraries of a file.
#[derive(Debug, Default)]
pub(super) struct Library {
    /// In order; the white default at the end once it was asked for.
    pub(super) materials: Vec<Material>,
    /// What the materials' textures refer to.
    pub(super) images: Vec<EncodedImage<'static>>,
    /// Pictures of alpha alone.
    masks: Vec<EncodedImage<'static>>,
    drafts: Vec<Draft>,
    by_name: HashMap<String, u32>,
    by_path: HashMap<(bool, String), u32>,
    default: Option<u32>,
    /// Statements that were not taken as written.
    changed: Changes,
}

/// A material as the library states it.
#[derive(Debug, Default, Clone)]
struct Draft {
    needed: bool,
    diffuse: Option<[f32; 3]>,
    emission: [f32; 3],
    /// `d`
    opacity: Option<f32>,
    /// `Tr`
    transparency: Option<f32>,
    map: Option<(u32, TextureMap)>,
    /// Position in [`Library::masks`].
    mask: Option<u32>,
}

#[derive(Debug, Default)]
struct Changes {
    other_options: usize,
    clamped: usize,
    unnamed_textures: usize,
    spectral: usize,
}

/// Reads the libraries that an OBJ file names; `used` are names of materials that it draws. A
/// missing library is a fault: the scene would silently turn white.
pub(super) fn load(
    libraries: &[(usize, String)],
    used: &HashSet<&str>,
    files: &mut Files,
    notes: &mut Vec<Note>,
) -> Result<Library, Fault> {
    let mut out = Library::default();
    for (line, names) in libraries {
        for path in named(names, files) {
            let place = format!("line {line}, material library {}", shown(&path));
            let read = files.read_relative(&path, &place);
            let Some(bytes) = files.dispensable(read, true) else { continue };
            out.read(&bytes, used, files).map_err(|f| f.within(&place))?;
        }
    }
    out.finish(notes);
    Ok(out)
}

/// Paths in a statement that names one library, with spaces perhaps, or several.
fn named(names: &str, files: &Files) -> Vec<String> {
    // Some exporters write DOS paths.
    let plain = |name: &str| name.replace('\\', "/");
    let one = plain(text::unquoted(names));
    let words = text::quoted_words(names);
    match words.len() {
        0 | 1 => vec![one],
        _ if files.has(&one) => vec![one],
        _ => words.iter().map(|w| plain(w)).collect(),
    }
}

impl Library {
    /// Position of a material.
    pub(super) fn find(&self, name: &str) -> Option<u32> {
        let known = |name: &str| self.by_name.get(name).copied();
        known(name).or_else(|| known(text::unquoted(name)))
    }

    /// Position of the white material.
    pub(super) fn default_material(&mut self) -> u32 {
        *self.default.get_or_insert_with(|| {
            self.materials.push(WHITE);
            self.materials.len() as u32 - 1
        })
    }

    /// Whether a material shows a picture, of colours or of alpha.
    pub(super) fn is_textured(&self, material: u32) -> bool {
        let masked = self.drafts.get(material as usize).is_some_and(|d| d.mask.is_some());
        masked || self.materials[material as usize].texture.is_some()
    }

    /// Where a material's texture is moved, v upward.
    pub(super) fn moved(&self, material: u32) -> Option<Affine2> {
        let (_, map) = self.drafts.get(material as usize)?.map.as_ref()?;
        let still = map.scale == Vec2::ONE && map.offset == Vec2::ZERO;
        (!still).then(|| Affine2::from_scale_angle_translation(map.scale, 0.0, map.offset))
    }

    fn read(&mut self, bytes: &[u8], used: &HashSet<&str>, files: &mut Files) -> Result<(), Fault> {
        let text = text::decode(bytes);
        for (line, statement) in lines(&text) {
            let words: Vec<&str> = statement.split_whitespace().collect();
            let Some((&keyword, arguments)) = words.split_first() else { continue };
            let rest = statement.trim_start()[keyword.len()..].trim();
            match keyword.to_ascii_lowercase().as_str() {
                "newmtl" => {
                    self.by_name.insert(rest.to_owned(), self.drafts.len() as u32);
                    let needed = used.contains(rest) || used.iter().any(|u| text::unquoted(u) == rest);
                    self.drafts.push(Draft { needed, ..Draft::default() });
                }
                lower => self.property(lower, keyword, arguments, line, files)?,
            }
        }
        Ok(())
    }

    /// One statement about the last material; `lower` is its keyword in lower case.
    fn property(
        &mut self,
        lower: &str,
        keyword: &str,
        arguments: &[&str],
        line: usize,
        files: &mut Files,
    ) -> Result<(), Fault> {
        if !matches!(lower, "kd" | "ke" | "d" | "tr" | "map_kd" | "map_d") {
            return Ok(());
        }
        let Some(needed) = self.drafts.last().map(|d| d.needed) else {
            return Err(at_line(line, format!("{keyword} before any newmtl")));
        };
        let mut draft = Draft::default();
        match lower {
            "kd" => draft.diffuse = self.colour(keyword, arguments, line)?,
            // Extensions write more after it; what is no colour is no emission.
            "ke" => draft.emission = self.colour(keyword, arguments, line).ok().flatten().unwrap_or_default(),
            "d" => draft.opacity = Some(self.share(keyword, arguments, line)?),
            "tr" => draft.transparency = Some(self.share(keyword, arguments, line)?),
            _ => {
                let map = texture_map(arguments);
                self.changed.other_options += usize::from(map.other_options);
                if map.path.is_empty() {
                    self.changed.unnamed_textures += 1;
                    return Ok(());
                }
                let picture = self.image(lower == "map_d", &map.path, needed, line, files);
                match lower {
                    "map_d" => draft.mask = Some(picture),
                    _ => draft.map = Some((picture, map)),
                }
            }
        }
        if let Some(last) = self.drafts.last_mut() {
            match lower {
                "kd" => last.diffuse = draft.diffuse.or(last.diffuse),
                "ke" => last.emission = draft.emission,
                "d" => last.opacity = draft.opacity,
                "tr" => last.transparency = draft.transparency,
                "map_d" => last.mask = draft.mask,
                _ => last.map = draft.map,
            }
        }
        Ok(())
    }

    /// A colour within [0, 1]; None for one that is a curve over the spectrum.
    fn colour(&mut self, keyword: &str, arguments: &[&str], line: usize) -> Result<Option<[f32; 3]>, Fault> {
        let (space, words) = match arguments.split_first() {
            Some((first, rest)) if first.eq_ignore_ascii_case("xyz") => ("xyz", rest),
            Some((first, _)) if first.eq_ignore_ascii_case("spectral") => {
                self.changed.spectral += 1;
                return Ok(None);
            }
            _ => ("rgb", arguments),
        };
        let colour = match numbers(words, line)?[..] {
            // One number means a grey.
            [r] => [r; 3],
            [r, g, b] | [r, g, b, _] => [r, g, b],
            _ => return Err(at_line(line, format!("{keyword} takes one or three numbers"))),
        };
        let colour = colour.map(|c| c as f32);
        let linear = if space == "xyz" { linear_from_xyz(colour) } else { colour };
        self.changed.clamped += usize::from(!linear.iter().all(|c| (0.0..=1.0).contains(c)));
        Ok(Some(repair::clamp_colour(linear)))
    }

    /// A number within [0, 1], or the mean of three.
    fn share(&mut self, keyword: &str, arguments: &[&str], line: usize) -> Result<f32, Fault> {
        // "d -halo 0.5" fades toward the rim; the factor counts.
        let value = match numbers(arguments.strip_prefix(&["-halo"]).unwrap_or(arguments), line)?[..] {
            [value] => value,
            [r, g, b] => (r + g + b) / 3.0,
            _ => return Err(at_line(line, format!("{keyword} takes one number in [0, 1]"))),
        };
        self.changed.clamped += usize::from(!(0.0..=1.0).contains(&value));
        Ok(if value.is_nan() { 1.0 } else { value.clamp(0.0, 1.0) as f32 })
    }

    /// Position of a picture among those of colours or of alpha.
    fn image(&mut self, mask: bool, path: &str, needed: bool, line: usize, files: &mut Files) -> u32 {
        let path = path.replace('\\', "/");
        let key = (mask, path);
        let pictures = if mask { &mut self.masks } else { &mut self.images };
        if let Some(&known) = self.by_path.get(&key) {
            pictures[known as usize].needed |= needed;
            return known;
        }
        let path = key.1.clone();
        let place = format!("line {line}, texture {}", shown(&path));
        let read = files.read_relative(&path, &place);
        let bytes = files.dispensable(read, needed).map(Into::into);
        pictures.push(EncodedImage { name: path, place, bytes, needed });
        let at = pictures.len() as u32 - 1;
        self.by_path.insert(key, at);
        at
    }

    /// Materials from what was stated about them.
    fn finish(&mut self, notes: &mut Vec<Note>) {
        let mut note = |count: usize, what: &str, why: &str| {
            if count > 0 {
                notes.push(Note { what: format!("{count} {what}"), why: why.into() });
            }
        };
        let invisible = !self.drafts.is_empty() && self.drafts.iter().all(|d| d.alpha() == 0.0);
        let (mut translucent, mut glowing, mut black) = (0, 0, 0);
        for draft in &self.drafts {
            let mut made = WHITE;
            let diffuse = draft.diffuse.unwrap_or([1.0; 3]);
            made.base_colour[..3].copy_from_slice(&diffuse);
            if let Some((picture, map)) = &draft.map {
                made.texture = Some(*picture);
                made.wrap = [if map.clamp { Wrap::Clamp } else { Wrap::Repeat }; 2];
                if diffuse == [0.0; 3] {
                    made.base_colour = [1.0; 4];
                    black += 1;
                }
            } else if diffuse.iter().all(|c| *c <= DARK) && draft.emission.iter().any(|c| *c > DARK) {
                made.base_colour[..3].copy_from_slice(&draft.emission);
                made.unlit = true;
                glowing += 1;
            }
            made.base_colour[3] = if invisible { 1.0 } else { draft.alpha() };
            if made.base_colour[3] < 1.0 {
                made.alpha = Alpha::Mask(0.5);
                translucent += 1;
            }
            self.materials.push(made);
        }
        let changed = &self.changed;
        note(changed.other_options, "textures with options besides -clamp, -s and -o", "options left out");
        note(translucent, "translucent materials", "drawn as masked at alpha 0.5");
        note(usize::from(invisible) * self.drafts.len(), "materials, all of them invisible", "drawn opaque");
        note(changed.clamped, "numbers of materials outside [0, 1]", "clamped");
        note(changed.unnamed_textures, "textures without a name", "left out");
        note(changed.spectral, "colours by spectrum", "drawn white");
        note(black, "materials of black beside a picture", "the picture is shown");
        note(glowing, "dark materials that emit light", "shown in the colour of their light");
    }

    /// Gives materials with a picture of alpha a texture of both.
    pub(super) fn apply_masks(
        &mut self,
        textures: &mut Vec<SceneTexture>,
        files: &mut Files,
        limits: &Limits,
    ) -> Result<(), Fault> {
        let masks = images::decode_all(&self.masks, files, limits);
        let mut made: HashMap<(Option<u32>, u32), u32> = HashMap::new();
        let mut pixels: u64 = textures.iter().chain(&masks).map(|t| t.rgba.len() as u64).sum();
        for (material, draft) in self.materials.iter_mut().zip(&self.drafts) {
            let Some(number) = draft.mask else { continue };
            let mask = &masks[number as usize];
            let colour = material.texture.map(|t| &textures[t as usize]);
            let same = colour.is_some_and(|c| c.name == mask.name);
            if same && mask.rgba.iter().all(|t| t[3] == 255) {
                // The picture's own colours are no alpha.
                continue;
            }
            let key = (material.texture, number);
            let texture = match made.get(&key) {
                Some(known) => *known,
                None => {
                    let width = colour.map_or(1, |c| c.width).max(mask.width);
                    let height = colour.map_or(1, |c| c.height).max(mask.height);
                    pixels += u64::from(width) * u64::from(height);
                    if pixels > limits.image_pixels {
                        let place = &self.masks[number as usize].place;
                        let what = "or more pixels in all images together";
                        return Err(Fault::too_large(place, what, pixels, limits.image_pixels));
                    }
                    textures.push(images::masked(colour, mask));
                    made.insert(key, textures.len() as u32 - 1);
                    textures.len() as u32 - 1
                }
            };
            material.texture = Some(texture);
            material.alpha = Alpha::Mask(0.5);
        }
        // What only a mask asked for has texture coordinates, so it shows a texture.
        Ok(())
    }
}

impl Draft {
    fn alpha(&self) -> f32 {
        match (self.opacity, self.transparency) {
            // Contradictory: the writer means opacity by both, or transparency by both.
            (Some(0.0), Some(t)) => 1.0 - t,
            (Some(d), _) => d,
            (None, Some(t)) => 1.0 - t,
            (None, None) => 1.0,
        }
    }
}

/// Linear sRGB of CIE XYZ (IEC 61966-2-1, D65).
fn linear_from_xyz([x, y, z]: [f32; 3]) -> [f32; 3] {
    let xyz = Vec3::new(x, y, z);
    let row = |a: f32, b: f32, c: f32| Vec3::new(a, b, c).dot(xyz);
    [row(3.2406, -1.5372, -0.4986), row(-0.9689, 1.8758, 0.0415), row(0.0557, -0.2040, 1.0570)]
}

#[derive(Debug, Clone, PartialEq)]
struct TextureMap {
    path: String,
    clamp: bool,
    scale: Vec2,
    offset: Vec2,
    /// Options that are not read.
    other_options: bool,
}

/// Options, then a path that may hold spaces.
fn texture_map(arguments: &[&str]) -> TextureMap {
    let mut out =
        TextureMap { path: String::new(), clamp: false, scale: Vec2::ONE, offset: Vec2::ZERO, other_options: false };
    let mut rest = arguments;
    while let Some((option, after)) = rest.split_first().filter(|(o, _)| o.starts_with('-') && o.len() > 1) {
        let number = |w: &&str| w.parse::<f32>().ok().filter(|n| n.is_finite());
        let values: Vec<f32> = after.iter().take(3).map_while(number).collect();
        let pair =
            |other: f32| Vec2::new(values.first().copied().unwrap_or(other), values.get(1).copied().unwrap_or(other));
        let taken = match option.to_ascii_lowercase().as_str() {
            "-s" => {
                out.scale = pair(1.0);
                values.len()
            }
            "-o" => {
                out.offset = pair(0.0);
                values.len()
            }
            "-clamp" => {
                out.clamp = after.first().is_some_and(|w| w.eq_ignore_ascii_case("on"));
                1
            }
            other => {
                out.other_options = true;
                match other {
                    "-t" => values.len(),
                    "-mm" => 2,
                    _ => 1,
                }
            }
        };
        rest = after.get(taken..).unwrap_or_default();
    }
    let path = rest.join(" ");
    out.path = text::unquoted(&path).to_owned();
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texture_options_are_told_from_paths() {
        let map = |text: &str| texture_map(&text.split_whitespace().collect::<Vec<_>>());
        let plain = |path: &str| TextureMap {
            path: path.into(),
            clamp: false,
            scale: Vec2::ONE,
            offset: Vec2::ZERO,
            other_options: false,
        };
        assert_eq!(map("a.png"), plain("a.png"));
        assert_eq!(map("my wall.png"), plain("my wall.png"));
        assert_eq!(map("\"my wall.png\""), plain("my wall.png"));
        assert_eq!(map("-clamp on a.png"), TextureMap { clamp: true, ..plain("a.png") });
        let moved = TextureMap { scale: Vec2::splat(2.0), offset: Vec2::new(0.5, 1.0), ..plain("dir/a.png") };
        assert_eq!(map("-s 2 2 -o 0.5 1 1 -bm 1 dir/a.png"), TextureMap { other_options: true, ..moved.clone() });
        assert_eq!(map("-s 2 2 -o 0.5 1 1 dir/a.png"), moved);
        assert_eq!(map("-s"), plain(""));
    }

    #[test]
    fn opacity_is_believed_before_transparency() {
        let alpha = |opacity, transparency| Draft { opacity, transparency, ..Draft::default() }.alpha();
        assert_eq!(alpha(None, None), 1.0);
        assert_eq!((alpha(Some(0.3), None), alpha(None, Some(0.3))), (0.3, 0.7));
        assert_eq!((alpha(Some(1.0), Some(1.0)), alpha(Some(0.0), Some(0.0))), (1.0, 1.0));
    }
}
