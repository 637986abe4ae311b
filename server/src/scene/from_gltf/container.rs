//! The outer layer of a glTF file: JSON text alone (`.gltf`), or a GLB container (glTF 2.0 section
//! 4: twelve bytes of header, a JSON chunk, an optional BIN chunk).

use std::borrow::Cow;

use gltf::json::Root;
use serde::Deserialize;

use super::super::error::{Fault, RE_EXPORT};
use super::super::limits::Limits;

const MAGIC: &[u8] = b"glTF";
const HEADER_BYTES: usize = 12;
/// A text editor's mark at the start of UTF-8; glTF forbids it, and readers skip it.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Whether the bytes start as a GLB container does.
pub(in super::super) fn is_glb(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC)
}

/// The two parts of a glTF file.
#[derive(Debug)]
pub(super) struct Parts<'a> {
    /// JSON text.
    pub(super) json: Cow<'a, [u8]>,
    /// Bytes of buffer 0, in a GLB.
    pub(super) bin: Option<Cow<'a, [u8]>>,
}

/// Splits a file into JSON text and the BIN chunk.
pub(super) fn split(bytes: &[u8]) -> Result<Parts<'_>, Fault> {
    if !is_glb(bytes) {
        let text = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
        return match text.iter().find(|b| !b.is_ascii_whitespace()) {
            Some(b'{') => Ok(Parts { json: Cow::Borrowed(text), bin: None }),
            Some(_) => Err(Fault::broken("file", "it is neither a GLB container nor the JSON text of a glTF file")),
            None => Err(Fault::broken("file", "it is empty")),
        };
    }
    let fault = |problem: String| Fault::invalid("GLB header", problem, "copy or export the file again, whole");
    // The parser subtracts the header's size from this length without looking.
    let length = bytes.get(8..HEADER_BYTES).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
    let length =
        length.ok_or_else(|| fault(format!("{} bytes, the header alone takes {HEADER_BYTES}", bytes.len())))? as usize;
    if length < HEADER_BYTES || length > bytes.len() {
        return Err(fault(format!("length is given as {length} bytes, the file has {}", bytes.len())));
    }
    let glb = gltf::Glb::from_slice(&bytes[..length])
        .map_err(|e| Fault::invalid("GLB chunks", e.to_string(), "copy or export the file again, whole"))?;
    Ok(Parts { json: glb.json, bin: glb.bin })
}

/// Node placements as the file writes them: the parser keeps f32, which is 3 cm at 500 km
/// (geographic coordinates).
#[derive(Debug, Clone, Default, Deserialize)]
pub(super) struct NodeTransform {
    /// 4 x 4, column-major.
    pub(super) matrix: Option<[f64; 16]>,
    /// Metres.
    pub(super) translation: Option<[f64; 3]>,
    /// Quaternion x, y, z, w.
    pub(super) rotation: Option<[f64; 4]>,
    /// Factors.
    pub(super) scale: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct Transforms {
    #[serde(default)]
    nodes: Vec<NodeTransform>,
}

/// Parses the JSON part, twice: once by the parser crate, once for placements in f64. Nothing in
/// it is trusted yet.
pub(super) fn parse(json: &[u8], limits: &Limits) -> Result<(Root, Vec<NodeTransform>), Fault> {
    if json.len() as u64 > limits.json_bytes {
        return Err(Fault::too_large("JSON", "bytes", json.len(), limits.json_bytes));
    }
    let objects = json.iter().filter(|&&b| b == b'{').count() as u64;
    if objects > limits.json_objects {
        return Err(Fault::too_large("JSON", "objects", objects, limits.json_objects));
    }
    let fault =
        |e: gltf::json::Error| Fault::broken(format!("JSON, line {}, column {}", e.line(), e.column()), e.to_string());
    let root: Root = gltf::json::deserialize::from_slice(json).map_err(fault)?;
    let transforms: Transforms = serde_json::from_slice(json).map_err(fault)?;
    let version = &root.asset.version;
    if !version.starts_with("2.") {
        let problem = format!("glTF version {} is not read", super::super::files::shown(version));
        return Err(Fault::unsupported("asset", problem, "export as glTF 2.0"));
    }
    check_extensions(&root)?;
    Ok((root, transforms.nodes))
}

/// Extensions that a file may require of us.
const KNOWN_EXTENSIONS: [&str; 3] = ["KHR_materials_unlit", "KHR_mesh_quantization", "KHR_texture_transform"];

fn check_extensions(root: &Root) -> Result<(), Fault> {
    match root.extensions_required.iter().find(|e| !KNOWN_EXTENSIONS.contains(&e.as_str())) {
        None => Ok(()),
        Some(unknown) => {
            let problem = format!("the file requires {}, which is not read", super::super::files::shown(unknown));
            let remedy = format!("export without it (no compression of meshes or textures); {RE_EXPORT}");
            Err(Fault::unsupported("extensionsRequired", problem, remedy))
        }
    }
}

/// Extensions that the file uses without requiring them and that are not read.
pub(super) fn ignored_extensions(root: &Root) -> Vec<String> {
    let unknown = |e: &&String| !KNOWN_EXTENSIONS.contains(&e.as_str());
    root.extensions_used.iter().filter(unknown).cloned().collect()
}
