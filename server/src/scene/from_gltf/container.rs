//! The outer layer of a glTF file: JSON text alone (`.gltf`), or a GLB container (glTF 2.0 section
//! 4: twelve bytes of header, a JSON chunk, an optional BIN chunk).

use std::borrow::Cow;

use gltf::json::Root;

use super::super::error::Fault;
use super::super::limits::Limits;
use super::super::model::Note;
use super::extensions::{self, Additions};
use super::json_repair::repaired;

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
    if bytes.get(4..8) == Some(&[1, 0, 0, 0]) {
        return Err(Fault::unsupported("GLB header", "it is glTF 1.0 (version 1), which is not read", OLD));
    }
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

const OLD: &str = "convert it, for example by gltf-pipeline 3 (`gltf-pipeline -i FILE -o FILE.glb`), or export it \
                   again as glTF 2.0";

/// Parses the JSON part, twice: once by the parser crate, once for what that leaves out. Nothing in
/// it is trusted yet.
pub(super) fn parse(json: &[u8], limits: &Limits, notes: &mut Vec<Note>) -> Result<(Root, Additions), Fault> {
    // Padding of zeros, where the format asks for spaces.
    let end = json.iter().rposition(|b| *b != 0 && *b != b' ').map_or(0, |last| last + 1);
    if json.len() as u64 > limits.json_bytes {
        return Err(Fault::too_large("JSON", "bytes", json.len(), limits.json_bytes));
    }
    let json = &json[..end];
    let objects = json.iter().filter(|&&b| b == b'{').count() as u64;
    if objects > limits.json_objects {
        return Err(Fault::too_large("JSON", "objects", objects, limits.json_objects));
    }
    let read = |json: &[u8]| -> Result<(Root, Additions), gltf::json::Error> {
        Ok((gltf::json::deserialize::from_slice(json)?, serde_json::from_slice(json)?))
    };
    let (root, additions) = match read(json) {
        Ok(read) => read,
        Err(fault) => match repaired(json).map(|text| read(&text)) {
            Some(Ok(read)) => {
                let what = format!("JSON that is no valid glTF (line {}: {fault})", fault.line());
                notes.push(Note { what, why: "read as its writer means it".into() });
                read
            }
            _ if is_old(json) => return Err(Fault::unsupported("asset", "it is glTF 1.0, which is not read", OLD)),
            _ => {
                let place = format!("JSON, line {}, column {}", fault.line(), fault.column());
                return Err(Fault::broken(place, fault.to_string()));
            }
        },
    };
    let version = &root.asset.version;
    if !version.starts_with("2.") {
        let problem = format!("glTF version {} is not read", super::super::files::shown(version));
        return Err(Fault::unsupported("asset", problem, OLD));
    }
    extensions::check(&root, notes)?;
    Ok((root, additions))
}

/// Whether a document is one of glTF 1.0, whose lists are objects.
fn is_old(json: &[u8]) -> bool {
    #[derive(serde::Deserialize)]
    struct Head {
        asset: Option<serde_json::Value>,
    }
    let asset = serde_json::from_slice::<Head>(json).ok().and_then(|head| head.asset);
    let version = asset.and_then(|a| a.get("version").cloned());
    version.is_some_and(|v| v.to_string().trim_matches('"').starts_with("1"))
}
