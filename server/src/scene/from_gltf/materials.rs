//! Materials, textures, samplers, images (glTF 2.0 sections 3.8 and 3.9): the diffuse part of them.
//!
//! Read: base colour factor and texture (or the diffuse part of specular and glossiness, where
//! there is no base colour), its coordinate set and transform, alpha mode, sides, unlit. A material
//! through which light goes is blended. One that is dark but emits light shows its emission.
//! Left out, since scenes here are diffuse: metalness, roughness, other emission, normal and
//! occlusion maps. Only images that a base colour uses are decoded.

use glam::{Affine2, Vec2};
use gltf::json::Root;
use gltf::json::material::AlphaMode;
use gltf::json::texture::{Info, WrappingMode};
use gltf::json::validation::Checked;
use ldi_protocol::mesh::{Alpha, Material, Wrap};

use super::super::error::Fault;
use super::super::files::{Files, listed};
use super::super::images::EncodedImage;
use super::super::model::{Note, WHITE};
use super::super::{DARK, repair};
use super::accessors::Data;
use super::extensions::{self, Additions};

/// Alpha below which a blended material is not there.
const BLEND_CUTOFF: f32 = 0.5;

/// Materials and what their textures need.
#[derive(Debug)]
pub(super) struct MaterialPlan {
    /// The file's materials in its order, then glTF's default one if something uses it.
    pub(super) materials: Vec<Material>,
    uvs: Vec<Option<UvSource>>,
    default: usize,
    /// Image numbers to decode, ascending, and whether something drawn shows them; materials refer
    /// to positions in it.
    images: Vec<(usize, bool)>,
}

/// Which texture coordinates a base colour texture takes.
#[derive(Debug, Clone, Copy)]
pub(super) struct UvSource {
    /// TEXCOORD set.
    pub(super) set: u32,
    /// What to do with them.
    pub(super) transform: Option<Affine2>,
}

/// What was read otherwise than written: names of materials.
#[derive(Debug, Default)]
struct Changes {
    blended: Vec<String>,
    transmitting: Vec<String>,
    glowing: Vec<String>,
    shown_glowing: Vec<String>,
    clamped: Vec<String>,
    without_picture: Vec<String>,
    unknown_modes: Vec<String>,
    by_gloss: Vec<String>,
}

/// Reads all materials.
pub(super) fn plan(root: &Root, additions: &Additions, notes: &mut Vec<Note>) -> Result<MaterialPlan, Fault> {
    let mut out =
        MaterialPlan { materials: Vec::new(), uvs: Vec::new(), default: root.materials.len(), images: Vec::new() };
    let mut changes = Changes::default();
    let nothing = extensions::Material::default();
    for (i, m) in root.materials.iter().enumerate() {
        let added = additions.materials.get(i).unwrap_or(&nothing);
        let material = out.material(root, additions, i, m, added, &mut changes)?;
        out.materials.push(material);
    }
    let mut used = vec![false; root.materials.len()];
    for primitive in root.meshes.iter().flat_map(|m| &m.primitives) {
        if let Some(used) = primitive.material.and_then(|i| used.get_mut(i.value())) {
            *used = true;
        }
    }
    let mut images: Vec<u32> = out.materials.iter().filter_map(|m| m.texture).collect();
    images.sort_unstable();
    images.dedup();
    let is_needed = |image: u32| out.materials.iter().zip(&used).any(|(m, used)| *used && m.texture == Some(image));
    out.images = images.iter().map(|&i| (i as usize, is_needed(i))).collect();
    for m in &mut out.materials {
        m.texture = m.texture.and_then(|image| images.binary_search(&image).ok()).map(|at| at as u32);
    }
    let mut note = |names: &[String], what: &str, why: &str| {
        if !names.is_empty() {
            notes.push(Note { what: format!("{what}: {}", listed(names)), why: why.into() });
        }
    };
    note(&changes.blended, "blended materials", "drawn as masked at alpha 0.5");
    note(&changes.transmitting, "materials through which light goes", "drawn as masked at alpha 0.5");
    note(&changes.glowing, "emission", "surfaces are diffuse; base colours stay");
    note(&changes.shown_glowing, "emission of dark materials", "shown in place of the base colour");
    note(&changes.clamped, "colour factors outside [0, 1]", "clamped");
    note(&changes.without_picture, "textures without an image", "drawn without");
    note(&changes.unknown_modes, "alpha modes that glTF does not have", "drawn opaque");
    note(&changes.by_gloss, "materials by specular and glossiness", "only their diffuse part is read");
    if out.images.len() < root.images.len() {
        let what = format!("{} of {} images", root.images.len() - out.images.len(), root.images.len());
        notes.push(Note { what, why: "no base colour uses them".into() });
    }
    let uses_default = |p: &gltf::json::mesh::Primitive| p.material.is_none();
    if root.materials.is_empty() || root.meshes.iter().flat_map(|m| &m.primitives).any(uses_default) {
        out.materials.push(Material { double_sided: false, ..WHITE });
        out.uvs.push(None);
    }
    Ok(out)
}

impl MaterialPlan {
    /// Reads a material; its texture is the image's number for now.
    fn material(
        &mut self,
        root: &Root,
        additions: &Additions,
        i: usize,
        m: &gltf::json::Material,
        added: &extensions::Material,
        changes: &mut Changes,
    ) -> Result<Material, Fault> {
        let place = format!("material {i}");
        let name = || m.name.clone().unwrap_or_else(|| place.clone());
        let mut alpha = match m.alpha_mode {
            Checked::Valid(AlphaMode::Opaque) => Alpha::Opaque,
            Checked::Invalid => {
                changes.unknown_modes.push(name());
                Alpha::Opaque
            }
            Checked::Valid(AlphaMode::Mask) => Alpha::Mask(m.alpha_cutoff.unwrap_or_default().0.max(0.0)),
            Checked::Valid(AlphaMode::Blend) => {
                changes.blended.push(name());
                Alpha::Mask(BLEND_CUTOFF)
            }
        };
        let pbr = &m.pbr_metallic_roughness;
        let (stated, mut info) = match added.diffuse() {
            Some(diffuse) => {
                changes.by_gloss.push(name());
                (diffuse.diffuse_factor.unwrap_or([1.0; 4]), diffuse.diffuse_texture.as_ref())
            }
            None => (pbr.base_color_factor.0, pbr.base_color_texture.as_ref()),
        };
        let [r, g, b, opacity] = stated;
        let mut colour = repair::clamp_colour([r, g, b]);
        let mut opacity = repair::clamp_colour([opacity; 3])[0];
        if [colour[0], colour[1], colour[2], opacity] != stated {
            changes.clamped.push(name());
        }
        let mut unlit = m.extensions.as_ref().is_some_and(|e| e.unlit.is_some());
        let emission = m.emissive_factor.0.map(|e| e * added.emissive_strength());
        if emission.iter().any(|&e| e != 0.0) {
            match colour.iter().all(|c| *c <= DARK) && emission.iter().any(|e| *e > DARK) {
                true => {
                    changes.shown_glowing.push(name());
                    (colour, info, unlit) = (repair::clamp_colour(emission), m.emissive_texture.as_ref(), true);
                }
                false => changes.glowing.push(name()),
            }
        }
        if added.transmission() > 0.0 {
            changes.transmitting.push(name());
            opacity *= 1.0 - added.transmission();
            if alpha == Alpha::Opaque {
                alpha = Alpha::Mask(BLEND_CUTOFF);
            }
        }
        let picture = match info {
            Some(info) => texture(root, additions, info.index.value(), &place)?,
            None => None,
        };
        if info.is_some() && picture.is_none() {
            changes.without_picture.push(name());
        }
        let (image, wrap) = match (info, picture) {
            (Some(info), Some((image, wrap))) => {
                self.uvs.push(Some(uv_source(info, &place)?));
                (Some(image), wrap)
            }
            _ => {
                self.uvs.push(None);
                (None, [Wrap::Repeat; 2])
            }
        };
        let [r, g, b] = colour;
        let base_colour = [r, g, b, opacity];
        Ok(Material { base_colour, texture: image, alpha, unlit, double_sided: m.double_sided, wrap })
    }
}

fn uv_source(info: &Info, place: &str) -> Result<UvSource, Fault> {
    let Some(t) = info.extensions.as_ref().and_then(|e| e.texture_transform.as_ref()) else {
        return Ok(UvSource { set: info.tex_coord, transform: None });
    };
    let (offset, angle, scale) = (t.offset.0, t.rotation.0, t.scale.0);
    // The extension turns counter-clockwise in its own space, whose v points down: clockwise here,
    // so -angle.
    let transform = Affine2::from_scale_angle_translation(Vec2::from(scale), -angle, Vec2::from(offset));
    if !transform.is_finite() {
        return Err(Fault::broken(place, "KHR_texture_transform is not finite"));
    }
    Ok(UvSource { set: t.tex_coord.unwrap_or(info.tex_coord), transform: Some(transform) })
}

/// What a texture without a source has in the parsed document.
const NO_SOURCE: usize = u32::MAX as usize;

/// Image number and wrap modes of a texture; None of one without an image.
fn texture(root: &Root, additions: &Additions, index: usize, place: &str) -> Result<Option<(u32, [Wrap; 2])>, Fault> {
    let t = root.textures.get(index).ok_or_else(|| Fault::broken(place, format!("texture {index} does not exist")))?;
    let image = match t.source.value() {
        NO_SOURCE => additions.textures.get(index).and_then(extensions::Texture::source),
        source => Some(source),
    };
    let Some(image) = image else { return Ok(None) };
    if image >= root.images.len() {
        let problem = format!("image {image}, its source, does not exist");
        return Err(Fault::broken(format!("{place}, texture {index}"), problem));
    }
    let wrap = match &t.sampler {
        None => [Wrap::Repeat; 2],
        Some(s) => {
            let fault =
                |problem: &str| Fault::broken(format!("{place}, texture {index}, sampler {}", s.value()), problem);
            let sampler = root.samplers.get(s.value()).ok_or_else(|| fault("does not exist"))?;
            let wrap = |mode: &Checked<WrappingMode>| match mode {
                Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
                Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
                // Repeating is the default, and what readers do with modes they do not know.
                Checked::Valid(WrappingMode::Repeat) | Checked::Invalid => Wrap::Repeat,
            };
            [wrap(&sampler.wrap_s), wrap(&sampler.wrap_t)]
        }
    };
    Ok(Some((image as u32, wrap)))
}

impl MaterialPlan {
    /// Position of a primitive's material.
    pub(super) fn of_primitive(&self, material: Option<usize>, place: &str) -> Result<usize, Fault> {
        match material {
            None => Ok(self.default),
            Some(i) if i < self.default => Ok(i),
            Some(i) => Err(Fault::broken(place, format!("material {i} does not exist"))),
        }
    }

    /// Texture coordinates that a material takes; `None` without a texture.
    pub(super) fn uv_source(&self, material: usize) -> Option<UvSource> {
        self.uvs[material]
    }

    /// Fetches the bytes of the images that are used.
    pub(super) fn encoded_images<'d>(
        &self,
        root: &Root,
        data: &'d Data<'_>,
        files: &mut Files,
    ) -> Vec<EncodedImage<'d>> {
        let fetch = |&(i, needed): &(usize, bool)| {
            let image = &root.images[i];
            let place = format!("image {i}");
            let read = match (&image.uri, &image.buffer_view) {
                (Some(uri), _) => files.read_uri(uri, &place).map(Into::into),
                (None, Some(view)) => data.view(view.value(), &place).map(|(bytes, _)| bytes.into()),
                (None, None) => Err(Fault::broken(&place, "has neither uri nor bufferView")),
            };
            let bytes = files.dispensable(read, needed);
            let name = image.name.clone().unwrap_or_else(|| place.clone());
            EncodedImage { name, place, bytes, needed }
        };
        self.images.iter().map(fetch).collect()
    }
}
