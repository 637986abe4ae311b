//! Extensions of glTF: which ones are read, which ones may be left out, and what those that are
//! read say.
//!
//! The parser crate keeps what it knows of them; [`Additions`] is a second, narrower reading of the
//! same JSON for the rest, and for placements in f64 (the parser keeps f32, which is 3 cm at
//! 500 km). An extension object of another form than its specification is left out.

use std::collections::BTreeMap;

use gltf::json::Root;
use gltf::json::texture::Info;
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Deserializer};
use serde_json::Value;

use super::super::error::Fault;
use super::super::files::listed;
use super::super::model::Note;

/// Extensions that are read.
const READ: [&str; 14] = [
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_materials_emissive_strength",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_node_visibility",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "MSFT_texture_dds",
];

/// Extensions that change neither shape nor base colour, by name.
const HARMLESS: [&str; 25] = [
    "CESIUM_primitive_outline",
    "CESIUM_tile_edges",
    "EXT_feature_metadata",
    "EXT_instance_features",
    "EXT_lights_ies",
    "EXT_lights_image_based",
    "EXT_mesh_features",
    "EXT_mesh_manifold",
    "EXT_mesh_primitive_edge_visibility",
    "EXT_property_animation",
    "EXT_structural_metadata",
    "FB_geometry_metadata",
    "GRIFFEL_bim_data",
    "KHR_accessor_float64",
    "KHR_animation_pointer",
    "KHR_environment_map",
    "KHR_implicit_shapes",
    "KHR_interactivity",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MSFT_lod",
    "MSFT_packing_normalRoughnessMetallic",
    "MSFT_packing_occlusionRoughnessMetallic",
];

/// Beginnings of names of families that change neither shape nor base colour: gloss, light, sound,
/// physics, avatars, editors.
const HARMLESS_FAMILIES: [&str; 17] = [
    "ADOBE_materials_",
    "AGI_",
    "EXT_lights_",
    "GODOT_",
    "KHR_audio",
    "KHR_collision_shapes",
    "KHR_lights_",
    "KHR_materials_",
    "KHR_physics_",
    "KHR_rigid_bodies",
    "MSFT_audio_",
    "MSFT_physics_",
    "MX_",
    "NV_materials_",
    "OMI_",
    "VRM",
    "WONDERLAND_",
];

fn is_harmless(name: &str) -> bool {
    HARMLESS.contains(&name) || HARMLESS_FAMILIES.iter().any(|family| name.starts_with(family))
}

/// Refuses extensions that the file requires and that are not read; notes the others once.
pub(super) fn check(root: &Root, notes: &mut Vec<Note>) -> Result<(), Fault> {
    let required = &root.extensions_required;
    let unread = |name: &&String| !READ.contains(&name.as_str());
    let unknown: Vec<String> = required.iter().filter(unread).filter(|n| !is_harmless(n)).cloned().collect();
    if !unknown.is_empty() {
        let problem = format!("the file requires {}, which is not read", listed(&unknown));
        let names = |part: &str| unknown.iter().any(|n| n.to_ascii_lowercase().contains(part));
        let remedy = match () {
            () if names("compression") || names("quantiz") => "export without compression of meshes",
            () if names("texture") => "export textures as PNG or JPEG",
            () if names("splat") => "export a mesh; clouds of splats are not read",
            () => "export without it",
        };
        return Err(Fault::unsupported("extensionsRequired", problem, remedy));
    }
    let mut left_out = |names: Vec<String>, why: &str| {
        if !names.is_empty() {
            notes.push(Note { what: format!("extensions {}", listed(&names)), why: why.into() });
        }
    };
    let not_read: Vec<String> = required.iter().filter(unread).cloned().collect();
    left_out(not_read, "not read, though required; they change neither shape nor base colour");
    let used = root.extensions_used.iter().filter(unread).filter(|n| !required.contains(n)).cloned().collect();
    left_out(used, "not read; the file does not require them");
    Ok(())
}

/// What a member says if it has the form of its specification.
fn lenient<'de, D: Deserializer<'de>, T: DeserializeOwned>(from: D) -> Result<Option<T>, D::Error> {
    Ok(serde_json::from_value(Value::deserialize(from)?).ok())
}

/// What the parser crate does not keep.
#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Additions {
    pub(super) nodes: Vec<Node>,
    pub(super) meshes: Vec<Mesh>,
    pub(super) buffer_views: Vec<View>,
    pub(super) textures: Vec<Texture>,
    pub(super) materials: Vec<Material>,
}

/// A node's placement as the file writes it, and its extensions.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    /// 4 x 4, column-major.
    pub(super) matrix: Option<[f64; 16]>,
    /// Metres.
    pub(super) translation: Option<[f64; 3]>,
    /// Quaternion x, y, z, w.
    pub(super) rotation: Option<[f64; 4]>,
    /// Factors.
    pub(super) scale: Option<[f64; 3]>,
    #[serde(deserialize_with = "lenient")]
    pub(super) extensions: Option<NodeExtensions>,
}

/// Extensions of a node.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
pub(super) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing", deserialize_with = "lenient")]
    pub(super) instancing: Option<Instancing>,
    #[serde(rename = "KHR_node_visibility", deserialize_with = "lenient")]
    visibility: Option<Visibility>,
}

/// Many placements of a node's mesh.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Instancing {
    /// Accessors of `TRANSLATION`, `ROTATION` and `SCALE`.
    pub(super) attributes: BTreeMap<String, usize>,
}

#[derive(Debug, Clone, Deserialize)]
struct Visibility {
    visible: Option<bool>,
}

impl Node {
    /// Whether the node hides itself and all below it.
    pub(super) fn is_hidden(&self) -> bool {
        let visibility = self.extensions.as_ref().and_then(|e| e.visibility.as_ref());
        visibility.is_some_and(|v| v.visible == Some(false))
    }

    /// Placements of its mesh, if there are many.
    pub(super) fn instancing(&self) -> Option<&Instancing> {
        self.extensions.as_ref()?.instancing.as_ref()
    }
}

/// A mesh's primitives.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Mesh {
    pub(super) primitives: Vec<Primitive>,
}

/// Extensions of a primitive.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Primitive {
    #[serde(deserialize_with = "lenient")]
    extensions: Option<PrimitiveExtensions>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression", deserialize_with = "lenient")]
    draco: Option<Draco>,
}

/// Where a primitive's Draco stream is.
#[derive(Debug, Clone, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Draco {
    pub(super) buffer_view: usize,
    /// Draco's numbers of attributes, by their names in glTF.
    pub(super) attributes: BTreeMap<String, u32>,
}

impl Primitive {
    pub(super) fn draco(&self) -> Option<&Draco> {
        self.extensions.as_ref()?.draco.as_ref()
    }
}

/// Extensions of a buffer view.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct View {
    #[serde(deserialize_with = "lenient")]
    extensions: Option<ViewExtensions>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct ViewExtensions {
    #[serde(rename = "EXT_meshopt_compression", deserialize_with = "lenient")]
    ext: Option<Meshopt>,
    #[serde(rename = "KHR_meshopt_compression", deserialize_with = "lenient")]
    khr: Option<Meshopt>,
}

/// A view compressed by meshoptimizer.
#[derive(Debug, Clone, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Meshopt {
    pub(super) buffer: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: u64,
    pub(super) count: u64,
    pub(super) mode: String,
    #[serde(default)]
    pub(super) filter: Option<String>,
}

impl View {
    pub(super) fn meshopt(&self) -> Option<&Meshopt> {
        let extensions = self.extensions.as_ref()?;
        extensions.khr.as_ref().or(extensions.ext.as_ref())
    }
}

/// Extensions of a texture.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Texture {
    #[serde(deserialize_with = "lenient")]
    extensions: Option<TextureExtensions>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct TextureExtensions {
    #[serde(rename = "EXT_texture_webp", deserialize_with = "lenient")]
    webp: Option<Source>,
    #[serde(rename = "MSFT_texture_dds", deserialize_with = "lenient")]
    dds: Option<Source>,
    #[serde(rename = "KHR_texture_basisu", deserialize_with = "lenient")]
    basisu: Option<Source>,
}

#[derive(Debug, Deserialize)]
struct Source {
    source: usize,
}

impl Texture {
    /// The image that an extension names in place of the texture's own.
    pub(super) fn source(&self) -> Option<usize> {
        let e = self.extensions.as_ref()?;
        [&e.webp, &e.dds, &e.basisu].into_iter().flatten().map(|s| s.source).next()
    }
}

/// What a material states itself, and its extensions.
#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Material {
    #[serde(deserialize_with = "lenient")]
    pbr_metallic_roughness: Option<Stated>,
    #[serde(deserialize_with = "lenient")]
    extensions: Option<MaterialExtensions>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Stated {
    base_color_factor: Option<IgnoredAny>,
    base_color_texture: Option<IgnoredAny>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct MaterialExtensions {
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness", deserialize_with = "lenient")]
    specular_glossiness: Option<SpecularGlossiness>,
    #[serde(rename = "KHR_materials_transmission", deserialize_with = "lenient")]
    transmission: Option<Transmission>,
    #[serde(rename = "KHR_materials_emissive_strength", deserialize_with = "lenient")]
    emission: Option<EmissiveStrength>,
}

/// The diffuse part of a material of specular and glossiness.
#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct SpecularGlossiness {
    pub(super) diffuse_factor: Option<[f32; 4]>,
    #[serde(deserialize_with = "lenient")]
    pub(super) diffuse_texture: Option<Info>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Transmission {
    transmission_factor: f32,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct EmissiveStrength {
    emissive_strength: Option<f32>,
}

impl Material {
    /// The diffuse part that stands in for a base colour, where the file states none of that.
    pub(super) fn diffuse(&self) -> Option<&SpecularGlossiness> {
        let stated = self.pbr_metallic_roughness.as_ref();
        let has_base = stated.is_some_and(|s| s.base_color_factor.is_some() || s.base_color_texture.is_some());
        self.extensions.as_ref()?.specular_glossiness.as_ref().filter(|_| !has_base)
    }

    /// Part of the light that goes through.
    pub(super) fn transmission(&self) -> f32 {
        let factor = self.extensions.as_ref().and_then(|e| e.transmission.as_ref());
        factor.map_or(0.0, |t| if t.transmission_factor.is_nan() { 0.0 } else { t.transmission_factor.clamp(0.0, 1.0) })
    }

    /// What the emissive factor is multiplied with.
    pub(super) fn emissive_strength(&self) -> f32 {
        let strength = self.extensions.as_ref().and_then(|e| e.emission.as_ref()?.emissive_strength);
        strength.filter(|s| s.is_finite() && *s >= 0.0).unwrap_or(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn members_of_another_form_are_left_out() {
        let json = r#"{"nodes": [{"name": 3, "extensions": {"KHR_node_visibility": {"visible": 7},
            "EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 4}}}}, {"extensions": null}],
            "materials": [{"pbrMetallicRoughness": null,
                "extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [1, 0, 0, 1]}}}]}"#;
        let read: Additions = serde_json::from_str(json).expect("parses");
        assert!(!read.nodes[0].is_hidden());
        assert_eq!(read.nodes[0].instancing().expect("is there").attributes["TRANSLATION"], 4);
        assert!(read.nodes[1].instancing().is_none());
        assert_eq!(read.materials[0].diffuse().expect("is there").diffuse_factor, Some([1.0, 0.0, 0.0, 1.0]));
    }

    #[test]
    fn gloss_is_harmless_and_geometry_is_not() {
        for name in ["KHR_materials_clearcoat", "MSFT_lod", "VRMC_vrm", "EXT_mesh_features", "KHR_lights_punctual"] {
            assert!(is_harmless(name), "{name}");
        }
        for name in ["KHR_gaussian_splatting", "EXT_texture_avif", "WEB3D_quantized_attributes", "x"] {
            assert!(!is_harmless(name), "{name}");
        }
    }
}
