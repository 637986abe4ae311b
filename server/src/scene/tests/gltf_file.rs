//! A small glTF file to start from: one textured, coloured square of two triangles.

use serde_json::{Value, json};

/// A document and its binary buffer.
#[derive(Clone)]
pub(super) struct GltfFile {
    pub(super) json: Value,
    pub(super) bin: Vec<u8>,
}

/// Offsets into the buffer.
pub(super) const POSITIONS_AT: usize = 0;
pub(super) const NORMALS_AT: usize = 48;
pub(super) const UVS_AT: usize = 96;
pub(super) const COLOURS_AT: usize = 128;
pub(super) const INDICES_AT: usize = 144;
const IMAGE_AT: usize = 156;

/// Red, green / blue, transparent white.
pub(super) const TEXELS: [[u8; 4]; 4] = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 255, 0]];

/// The texels as a PNG file.
pub(super) fn png() -> Vec<u8> {
    let mut out = std::io::Cursor::new(Vec::new());
    let image = image::RgbaImage::from_raw(2, 2, TEXELS.concat()).unwrap();
    image.write_to(&mut out, image::ImageFormat::Png).unwrap();
    out.into_inner()
}

impl GltfFile {
    /// The square (0, 0, 0) to (1, 1, 0), facing +Z, placed at (5, 0, 0).
    pub(super) fn square() -> Self {
        let mut bin = Vec::new();
        for v in [0., 0., 0., 1., 0., 0., 1., 1., 0., 0., 1., 0.] {
            bin.extend(f32::to_le_bytes(v));
        }
        for _ in 0..4 {
            for v in [0., 0., 1.] {
                bin.extend(f32::to_le_bytes(v));
            }
        }
        for v in [0., 1., 1., 1., 1., 0., 0., 0.] {
            bin.extend(f32::to_le_bytes(v));
        }
        for c in [[255, 255, 255, 255], [255, 0, 0, 255], [0, 255, 0, 255], [51, 102, 153, 255]] {
            bin.extend::<[u8; 4]>(c);
        }
        for i in [0u16, 1, 2, 0, 2, 3] {
            bin.extend(i.to_le_bytes());
        }
        let png = png();
        bin.extend(&png);
        while !bin.len().is_multiple_of(4) {
            bin.push(0);
        }
        let json = json!({
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"name": "place", "mesh": 0, "translation": [5, 0, 0]}],
            "meshes": [{"name": "square", "primitives": [{
                "attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2, "COLOR_0": 3}, "indices": 4, "material": 0,
            }]}],
            "materials": [{"name": "paper", "doubleSided": true, "alphaMode": "MASK", "alphaCutoff": 0.25,
                "pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0.25, 1], "baseColorTexture": {"index": 0}}}],
            "textures": [{"source": 0, "sampler": 0}],
            "samplers": [{"wrapS": 33071, "wrapT": 33648}],
            "images": [{"name": "four texels", "bufferView": 5, "mimeType": "image/png"}],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
                {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC3"},
                {"bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC2"},
                {"bufferView": 3, "componentType": 5121, "count": 4, "type": "VEC4", "normalized": true},
                {"bufferView": 4, "componentType": 5123, "count": 6, "type": "SCALAR"},
            ],
            "bufferViews": [
                {"buffer": 0, "byteOffset": POSITIONS_AT, "byteLength": 48},
                {"buffer": 0, "byteOffset": NORMALS_AT, "byteLength": 48},
                {"buffer": 0, "byteOffset": UVS_AT, "byteLength": 32},
                {"buffer": 0, "byteOffset": COLOURS_AT, "byteLength": 16},
                {"buffer": 0, "byteOffset": INDICES_AT, "byteLength": 12},
                {"buffer": 0, "byteOffset": IMAGE_AT, "byteLength": png.len()},
            ],
            "buffers": [{"byteLength": bin.len()}],
        });
        Self { json, bin }
    }

    /// Replaces the value at a JSON pointer, making the last object key if need be.
    pub(super) fn set(&mut self, pointer: &str, value: Value) {
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        match self.json.pointer_mut(parent) {
            Some(Value::Array(items)) => items[key.parse::<usize>().unwrap()] = value,
            Some(Value::Object(map)) => drop(map.insert(key.to_owned(), value)),
            _ => panic!("nothing at {parent}"),
        }
    }

    /// The same with one value replaced.
    pub(super) fn with(mut self, pointer: &str, value: Value) -> Self {
        self.set(pointer, value);
        self
    }

    /// The same with an item added to an array.
    pub(super) fn push(mut self, pointer: &str, value: Value) -> Self {
        self.json.pointer_mut(pointer).unwrap().as_array_mut().unwrap().push(value);
        self
    }

    /// The same with bytes of the buffer replaced.
    pub(super) fn patch(mut self, at: usize, bytes: &[u8]) -> Self {
        self.bin[at..at + bytes.len()].copy_from_slice(bytes);
        self
    }

    /// The same with bytes at the end of the buffer and a view of them; returns the view's number
    /// too.
    pub(super) fn append(mut self, bytes: &[u8]) -> (Self, usize) {
        let view = json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len()});
        self.bin.extend(bytes);
        while !self.bin.len().is_multiple_of(4) {
            self.bin.push(0);
        }
        let length = self.bin.len();
        let number = self.json["bufferViews"].as_array().unwrap().len();
        (self.push("/bufferViews", view).with("/buffers/0/byteLength", json!(length)), number)
    }

    /// As a GLB file.
    pub(super) fn glb(&self) -> Vec<u8> {
        glb(self.json.to_string().as_bytes(), Some(&self.bin))
    }

    /// As a text file whose buffer is the URI.
    pub(super) fn gltf(&self, uri: &str) -> Vec<u8> {
        self.clone().with("/buffers/0/uri", json!(uri)).json.to_string().into_bytes()
    }
}

/// A GLB container.
pub(super) fn glb(json: &[u8], bin: Option<&[u8]>) -> Vec<u8> {
    let padding = json.len().next_multiple_of(4) - json.len();
    let mut body = Vec::new();
    body.extend(((json.len() + padding) as u32).to_le_bytes());
    body.extend(b"JSON");
    body.extend(json);
    body.extend(vec![b' '; padding]);
    if let Some(bin) = bin {
        body.extend((bin.len() as u32).to_le_bytes());
        body.extend(b"BIN\0");
        body.extend(bin);
    }
    let mut out = b"glTF".to_vec();
    out.extend(2u32.to_le_bytes());
    out.extend((body.len() as u32 + 12).to_le_bytes());
    out.extend(body);
    out
}
