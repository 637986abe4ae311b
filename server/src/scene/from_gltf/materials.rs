//! Materials, textures, samplers, images (glTF 2.0 sections 3.8 and 3.9): the diffuse part of them.
//!
//! Read: base colour factor and texture, its coordinate set and transform, alpha mode, sides,
//! unlit. Left out, since scenes here are diffuse: metalness, roughness, emission, normal and
//! occlusion maps. Only images that a base colour uses are decoded.

use glam::{Affine2, Vec2};
use gltf::json::Root;
use gltf::json::material::AlphaMode;
use gltf::json::texture::WrappingMode;
use gltf::json::validation::Checked;
use ldi_protocol::mesh::{Alpha, Material, Wrap};

use super::super::error::Fault;
use super::super::files::{Files, listed};
use super::super::images::EncodedImage;
use super::super::model::Note;
use super::accessors::Data;

/// Alpha below which a blended material is not there.
const BLEND_CUTOFF: f32 = 0.5;

/// Materials and what their textures need.
#[derive(Debug)]
pub(super) struct MaterialPlan {
    /// The file's materials in its order, then glTF's default one if something uses it.
    pub(super) materials: Vec<Material>,
    uvs: Vec<Option<UvSource>>,
    default: usize,
    /// Image numbers to decode, ascending; materials refer to positions in it.
    images: Vec<usize>,
}

/// Which texture coordinates a base colour texture takes.
#[derive(Debug, Clone, Copy)]
pub(super) struct UvSource {
    /// TEXCOORD set.
    pub(super) set: u32,
    /// What to do with them.
    pub(super) transform: Option<Affine2>,
}

/// Reads all materials.
pub(super) fn plan(root: &Root, notes: &mut Vec<Note>) -> Result<MaterialPlan, Fault> {
    let mut out =
        MaterialPlan { materials: Vec::new(), uvs: Vec::new(), default: root.materials.len(), images: Vec::new() };
    let (mut blended, mut glowing) = (Vec::new(), Vec::new());
    for (i, m) in root.materials.iter().enumerate() {
        let place = format!("material {i}");
        let name = || m.name.clone().unwrap_or_else(|| place.clone());
        let pbr = &m.pbr_metallic_roughness;
        let Checked::Valid(alpha_mode) = m.alpha_mode else {
            return Err(Fault::broken(place, "alphaMode is none of glTF's"));
        };
        let alpha = match alpha_mode {
            AlphaMode::Opaque => Alpha::Opaque,
            AlphaMode::Mask => match m.alpha_cutoff.unwrap_or_default().0 {
                cutoff if cutoff.is_finite() && cutoff >= 0.0 => Alpha::Mask(cutoff),
                cutoff => return Err(Fault::broken(place, format!("alphaCutoff is {cutoff}"))),
            },
            AlphaMode::Blend => {
                blended.push(name());
                Alpha::Mask(BLEND_CUTOFF)
            }
        };
        let factor = pbr.base_color_factor.0;
        if !factor.iter().all(|f| (0.0..=1.0).contains(f)) {
            return Err(Fault::broken(place, format!("baseColorFactor {factor:?} leaves [0, 1]")));
        }
        if m.emissive_factor.0.iter().any(|&e| e != 0.0) {
            glowing.push(name());
        }
        let (image, wrap) = match &pbr.base_color_texture {
            Some(info) => {
                out.uvs.push(Some(uv_source(info, &place)?));
                let (image, wrap) = texture(root, info.index.value(), &place)?;
                (Some(image), wrap)
            }
            None => {
                out.uvs.push(None);
                (None, [Wrap::Repeat; 2])
            }
        };
        out.materials.push(Material {
            base_colour: factor,
            // The image's number for now; its position among the decoded ones below.
            texture: image,
            alpha,
            unlit: m.extensions.as_ref().is_some_and(|e| e.unlit.is_some()),
            double_sided: m.double_sided,
            wrap,
        });
    }
    let mut images: Vec<u32> = out.materials.iter().filter_map(|m| m.texture).collect();
    images.sort_unstable();
    images.dedup();
    for m in &mut out.materials {
        m.texture = m.texture.and_then(|image| images.binary_search(&image).ok()).map(|at| at as u32);
    }
    out.images = images.into_iter().map(|i| i as usize).collect();
    let mut note = |names: &[String], what: &str, why: &str| {
        if !names.is_empty() {
            notes.push(Note { what: format!("{what}: {}", listed(names)), why: why.into() });
        }
    };
    note(&blended, "blended materials", "drawn as masked at alpha 0.5");
    note(&glowing, "emission", "surfaces are diffuse; base colours stay");
    if out.images.len() < root.images.len() {
        let what = format!("{} of {} images", root.images.len() - out.images.len(), root.images.len());
        notes.push(Note { what, why: "no base colour uses them".into() });
    }
    let uses_default = |p: &gltf::json::mesh::Primitive| p.material.is_none();
    if root.materials.is_empty() || root.meshes.iter().flat_map(|m| &m.primitives).any(uses_default) {
        out.materials.push(Material {
            base_colour: [1.0; 4],
            texture: None,
            alpha: Alpha::Opaque,
            unlit: false,
            double_sided: false,
            wrap: [Wrap::Repeat; 2],
        });
        out.uvs.push(None);
    }
    Ok(out)
}

fn uv_source(info: &gltf::json::texture::Info, place: &str) -> Result<UvSource, Fault> {
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

/// Image number and wrap modes of a texture.
fn texture(root: &Root, index: usize, place: &str) -> Result<(u32, [Wrap; 2]), Fault> {
    let t = root.textures.get(index).ok_or_else(|| Fault::broken(place, format!("texture {index} does not exist")))?;
    let image = t.source.value();
    if image >= root.images.len() {
        let problem = "has no PNG or JPEG image as its source";
        return Err(Fault::unsupported(format!("{place}, texture {index}"), problem, "export textures as PNG or JPEG"));
    }
    let wrap = match &t.sampler {
        None => [Wrap::Repeat; 2],
        Some(s) => {
            let fault =
                |problem: &str| Fault::broken(format!("{place}, texture {index}, sampler {}", s.value()), problem);
            let sampler = root.samplers.get(s.value()).ok_or_else(|| fault("does not exist"))?;
            let wrap = |mode: &Checked<WrappingMode>| match mode {
                Checked::Valid(WrappingMode::ClampToEdge) => Ok(Wrap::Clamp),
                Checked::Valid(WrappingMode::MirroredRepeat) => Ok(Wrap::Mirror),
                Checked::Valid(WrappingMode::Repeat) => Ok(Wrap::Repeat),
                Checked::Invalid => Err(fault("wrap mode is none of glTF's")),
            };
            [wrap(&sampler.wrap_s)?, wrap(&sampler.wrap_t)?]
        }
    };
    Ok((image as u32, wrap))
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
    ) -> Result<Vec<EncodedImage<'d>>, Fault> {
        let fetch = |&i: &usize| {
            let image = &root.images[i];
            let place = format!("image {i}");
            let bytes = match (&image.uri, &image.buffer_view) {
                (Some(uri), _) => {
                    let read = files.read_uri(uri, &place);
                    files.dispensable(read)?.map(Into::into)
                }
                (None, Some(view)) => Some(data.view(view.value(), &place)?.0.into()),
                (None, None) => return Err(Fault::broken(place, "has neither uri nor bufferView")),
            };
            let name = image.name.clone().unwrap_or_else(|| place.clone());
            Ok(EncodedImage { name, place, bytes })
        };
        self.images.iter().map(fetch).collect()
    }
}
