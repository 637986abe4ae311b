//! Bad materials, pictures and annotations in glTF files.

use serde_json::{Value, json};

use super::gltf_file::png;
use super::hostile::Case;
use super::hostile_gltf::{file, overwrite, value};

/// All of them.
pub(super) fn cases() -> Vec<Case> {
    [looks(), pictures(), annotations()].into_iter().flatten().collect()
}

fn looks() -> Vec<Case> {
    let texture = "/materials/0/pbrMetallicRoughness/baseColorTexture";
    let factor = "/materials/0/pbrMetallicRoughness/baseColorFactor";
    vec![
        value("texture out of range", "texture 5", texture, json!({"index": 5})),
        value("image out of range", "texture 0", "/textures/0/source", json!(5)),
        value("sampler out of range", "sampler 5", "/textures/0/sampler", json!(5)),
        value("colour factor beyond f32", "JSON", factor, json!([1e39, 0, 0, 1])),
        value("colour factor of three", "JSON", factor, json!([1, 1, 1])),
        value(
            "texture transform beyond f32",
            "JSON",
            texture,
            json!({"index": 0, "extensions": {"KHR_texture_transform": {"scale": [1e39, 1]}}}),
        ),
    ]
}

/// A PNG whose header claims a size, its checksum right.
fn png_claiming(width: u32, height: u32) -> Vec<u8> {
    let mut out = overwrite(overwrite(png(), 16, &width.to_be_bytes()), 20, &height.to_be_bytes());
    let crc = crc32(&out[12..29]);
    out[29..33].copy_from_slice(&crc.to_be_bytes());
    out
}

/// The checksum of PNG chunks (ISO 3309), bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &b| {
        (0..8).fold(crc ^ u32::from(b), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xedb8_8320 } else { c >> 1 })
    })
}

fn pictures() -> Vec<Case> {
    let picture = |name, says, make: fn() -> Vec<u8>| {
        file(name, says, move |f| {
            let (f, view) = f.append(&make());
            f.with("/images/0/bufferView", json!(view))
        })
    };
    let image = |name, says, image: Value| value(name, says, "/images/0", image);
    vec![
        picture("picture of no bytes", "image 0", Vec::new),
        picture("picture of garbage", "no format that is read", || vec![7; 100]),
        picture("GIF without a frame", "image 0", || b"GIF89a\x01\0\x01\0\0\0\0;".to_vec()),
        picture("PNG cut in the header", "image 0", || png()[..20].to_vec()),
        picture("PNG cut in the data", "image 0", || png()[..45].to_vec()),
        picture("PNG of two billion columns", "image 0", || png_claiming(0x7fff_ffff, 0x7fff_ffff)),
        picture("PNG just too wide", "at most 16384", || png_claiming(16_385, 1)),
        picture("PNG bomb", "more than", || png_claiming(16_384, 16_384)),
        picture("PNG of no columns", "image 0", || png_claiming(0, 2)),
        picture("PNG with wrong checksum", "image 0", || overwrite(png(), 29, &[0; 4])),
        picture("JPEG of two bytes", "image 0", || vec![0xff, 0xd8]),
        picture("JPEG of garbage", "image 0", || [&[0xff, 0xd8, 0xff, 0xe0][..], &[0xab; 300]].concat()),
        image("picture from nowhere", "neither uri", json!({"name": "x"})),
        image("picture of no view", "bufferView 88", json!({"bufferView": 88, "mimeType": "image/png"})),
        image("picture goes up", "folder", json!({"uri": "../../etc/passwd"})),
        image("picture from the web", "scheme", json!({"uri": "http://127.0.0.1:9/x.png"})),
        image("picture missing", "cannot be read", json!({"uri": "missing.png"})),
        image("picture of wrong base64", "base64", json!({"uri": "data:image/png;base64,!"})),
    ]
}

fn annotations() -> Vec<Case> {
    let extras = |name, says, extras: Value| value(name, says, "/scenes/0/extras", extras);
    vec![
        extras("cells are no list", "ldi_cells", json!({"ldi_cells": 3})),
        extras(
            "cell upside down",
            "ldi_cells[0]",
            json!({"ldi_cells": [{"name": "a", "min": [0, 0, 0], "max": [-1, 1, 1]}]}),
        ),
        extras("portal to nowhere", "ldi_portals[0]", json!({"ldi_portals": [{"rooms": ["a", "b"], "corners": []}]})),
    ]
}
