//! Writes a [`Scene`] as binary glTF 2.0: one buffer, textures embedded as PNG, instances as nodes
//! that share meshes.
//!
//! Rooms and portals go to the glTF scene's `extras` as `ldi_cells` and `ldi_portals`, which the
//! importer reads back.

use super::{Primitive, Scene, SceneExtras};
use glam::DAffine3;
use image::ImageEncoder as _;
use ldi_protocol::mesh::{Alpha, Wrap};
use serde_json::{Value, json};

/// Why a scene cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum GlbWriteError {
    /// GLB counts bytes in 32 bits.
    #[error("{0} bytes do not fit into a GLB file (4 GiB); ask for fewer unique triangles")]
    TooLarge(usize),
    /// A texture could not be encoded.
    #[error("texture {0}: {1}")]
    Texture(usize, image::ImageError),
}

/// The GLB file's bytes; the same for the same scene.
///
/// # Errors
/// More than 4 GiB, or a texture whose size and texels disagree.
pub fn glb_bytes(scene: &Scene) -> Result<Vec<u8>, GlbWriteError> {
    let mut w = Writer::default();
    let meshes: Vec<Value> = scene
        .meshes
        .iter()
        .map(|m| {
            let primitives: Vec<Value> = m.primitives.iter().map(|p| w.primitive(p)).collect();
            json!({ "name": m.name, "primitives": primitives })
        })
        .collect();
    let images = scene
        .textures
        .iter()
        .enumerate()
        .map(|(i, t)| {
            let view = w.view(&png(t).map_err(|e| GlbWriteError::Texture(i, e))?, None);
            Ok(json!({ "name": t.name, "mimeType": "image/png", "bufferView": view }))
        })
        .collect::<Result<Vec<_>, GlbWriteError>>()?;
    let textures: Vec<Value> =
        scene.textures.iter().enumerate().map(|(i, _)| json!({ "source": i, "sampler": 0 })).collect();
    let mut root = json!({
        "asset": { "version": "2.0", "generator": "ldi-server scene" },
        "scene": 0,
        "scenes": [{ "name": scene.name, "nodes": (0..scene.instances.len()).collect::<Vec<_>>(), "extras": extras(scene) }],
        "nodes": scene.instances.iter().map(|i| node(i.mesh, &i.world_from_mesh)).collect::<Vec<_>>(),
        "meshes": meshes,
        "materials": scene.materials.iter().map(material).collect::<Vec<_>>(),
        "accessors": w.accessors,
        "bufferViews": w.views,
        "buffers": [{ "byteLength": w.bytes.len() }],
    });
    if !images.is_empty() {
        root["images"] = images.into();
        root["textures"] = textures.into();
        let wrap = scene.materials.first().map_or([Wrap::Repeat; 2], |m| m.wrap);
        root["samplers"] =
            json!([{ "magFilter": 9729, "minFilter": 9987, "wrapS": wrap_code(wrap[0]), "wrapT": wrap_code(wrap[1]) }]);
    }
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    w.bytes.resize(w.bytes.len().next_multiple_of(4), 0);
    let total = 12 + 8 + text.len() + 8 + w.bytes.len();
    let length = u32::try_from(total).map_err(|_| GlbWriteError::TooLarge(total))?;
    let mut out = Vec::with_capacity(total);
    out.extend(b"glTF");
    out.extend(2u32.to_le_bytes());
    out.extend(length.to_le_bytes());
    for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &w.bytes)] {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    Ok(out)
}

#[derive(Default)]
struct Writer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

const VERTICES: u32 = 34_962;
const INDICES: u32 = 34_963;
const FLOAT: u32 = 5126;

impl Writer {
    fn view(&mut self, data: &[u8], target: Option<u32>) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": data.len() });
        if let Some(t) = target {
            view["target"] = t.into();
        }
        self.bytes.extend(data);
        self.views.push(view);
        self.views.len() - 1
    }

    fn floats<const N: usize>(&mut self, rows: &[[f32; N]], bounds: bool) -> usize {
        let data: Vec<u8> = rows.iter().flatten().flat_map(|f| f.to_le_bytes()).collect();
        let view = self.view(&data, Some(VERTICES));
        let mut accessor =
            json!({ "bufferView": view, "componentType": FLOAT, "count": rows.len(), "type": format!("VEC{N}") });
        if bounds {
            let fold = |start: f32, pick: fn(f32, f32) -> f32| -> Vec<f32> {
                (0..N).map(|k| rows.iter().fold(start, |a, r| pick(a, r[k]))).collect()
            };
            accessor["min"] = fold(f32::INFINITY, f32::min).into();
            accessor["max"] = fold(f32::NEG_INFINITY, f32::max).into();
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn primitive(&mut self, p: &Primitive) -> Value {
        let rows3 = |v: &[glam::Vec3]| -> Vec<[f32; 3]> { v.iter().map(|p| p.to_array()).collect() };
        let mut attributes = json!({
            "POSITION": self.floats(&rows3(&p.positions), true),
            "NORMAL": self.floats(&rows3(&p.normals), false),
        });
        if !p.uvs.is_empty() {
            let rows: Vec<[f32; 2]> = p.uvs.iter().map(|v| v.to_array()).collect();
            attributes["TEXCOORD_0"] = self.floats(&rows, false).into();
        }
        if !p.colours.is_empty() {
            attributes["COLOR_0"] = self.floats(&p.colours, false).into();
        }
        // 65,535 is the restart value of 16-bit indices.
        let short = p.positions.len() <= 65_535;
        let data: Vec<u8> = p
            .triangles
            .iter()
            .flatten()
            .flat_map(|i| if short { (*i as u16).to_le_bytes().to_vec() } else { i.to_le_bytes().to_vec() })
            .collect();
        let view = self.view(&data, Some(INDICES));
        self.accessors.push(json!({
            "bufferView": view, "componentType": if short { 5123 } else { 5125 }, "count": p.triangles.len() * 3, "type": "SCALAR"
        }));
        json!({ "attributes": attributes, "indices": self.accessors.len() - 1, "material": p.material })
    }
}

fn node(mesh: u32, world_from_mesh: &DAffine3) -> Value {
    if *world_from_mesh == DAffine3::IDENTITY {
        return json!({ "mesh": mesh });
    }
    json!({ "mesh": mesh, "matrix": glam::DMat4::from(*world_from_mesh).to_cols_array() })
}

fn material(m: &ldi_protocol::mesh::Material) -> Value {
    let mut pbr = json!({ "baseColorFactor": m.base_colour, "metallicFactor": 0.0, "roughnessFactor": 1.0 });
    if let Some(t) = m.texture {
        pbr["baseColorTexture"] = json!({ "index": t });
    }
    let mut out = json!({ "pbrMetallicRoughness": pbr, "doubleSided": m.double_sided });
    if let Alpha::Mask(cutoff) = m.alpha {
        out["alphaMode"] = "MASK".into();
        out["alphaCutoff"] = cutoff.into();
    }
    out
}

fn wrap_code(w: Wrap) -> u32 {
    match w {
        Wrap::Repeat => 10_497,
        Wrap::Mirror => 33_648,
        Wrap::Clamp => 33_071,
    }
}

fn extras(scene: &Scene) -> Value {
    if scene.rooms.is_empty() && scene.portals.is_empty() {
        return Value::Null;
    }
    json!(SceneExtras::from(scene))
}

fn png(t: &super::SceneTexture) -> Result<Vec<u8>, image::ImageError> {
    let mut out = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut out);
    if t.rgba.iter().all(|p| p[3] == 255) {
        let rgb: Vec<u8> = t.rgba.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
        encoder.write_image(&rgb, t.width, t.height, image::ExtendedColorType::Rgb8)?;
    } else {
        let rgba: Vec<u8> = t.rgba.iter().flatten().copied().collect();
        encoder.write_image(&rgba, t.width, t.height, image::ExtendedColorType::Rgba8)?;
    }
    Ok(out)
}
