//! The file `elements`: what the nodes of the source scene are, by name, class and `GlobalId`.
//!
//! Together with `source` it tells what a triangle belongs to. It stays on the server, and is
//! there only if the scene's files name elements. Layout: `"LEL"` and the version, the raw length
//! (u64), one zstd frame over JSON (a list of objects `node`, `class`, `name`, `guid`, ascending
//! by node), BLAKE3 of all before.

use super::{StoreError, files};
use crate::scene::SceneElement;
use ldi_protocol::codec::CodecError;
use std::path::Path;

const MAGIC: &[u8; 4] = b"LEL\x01";
/// Longest file and longest text that is read.
const MAX_BYTES: u64 = 1 << 30;
/// Bytes of the magic and the raw length.
const HEAD: usize = 12;

/// Encodes the elements of a scene.
pub(super) fn encode(elements: &[SceneElement]) -> Result<Vec<u8>, std::io::Error> {
    let text = serde_json::to_vec(elements)?;
    let mut out = MAGIC.to_vec();
    out.extend((text.len() as u64).to_le_bytes());
    out.extend(zstd::bulk::compress(&text, 9)?);
    let hash = blake3::hash(&out);
    out.extend(hash.as_bytes());
    Ok(out)
}

/// Reads the elements; none when there is no such file.
pub(super) fn read(path: &Path) -> Result<Vec<SceneElement>, StoreError> {
    let Some(bytes) = files::read_if_there(path, MAX_BYTES)? else { return Ok(Vec::new()) };
    decode(&bytes).map_err(|reason| StoreError::Format {
        path: path.to_owned(),
        source: CodecError::Mismatch { field: "elements", reason: format!("{reason}; build the dataset again") },
    })
}

fn decode(bytes: &[u8]) -> Result<Vec<SceneElement>, &'static str> {
    let body = bytes.len().checked_sub(32).ok_or("the file is too short")?;
    let (body, hash) = bytes.split_at(body);
    if blake3::hash(body).as_bytes() != hash {
        return Err("its checksum is wrong: it was damaged or cut off");
    }
    let (head, frame) = body.split_first_chunk::<HEAD>().ok_or("the file is too short")?;
    if &head[..4] != MAGIC {
        return Err("it is of another kind or version");
    }
    let raw_bytes = head[4..].iter().rev().fold(0u64, |n, b| (n << 8) | u64::from(*b));
    if raw_bytes > MAX_BYTES {
        return Err("it claims more than it can hold");
    }
    let text = zstd::bulk::decompress(frame, raw_bytes as usize).map_err(|_| "it does not decompress")?;
    serde_json::from_slice(&text).map_err(|_| "it is no list of elements")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn door() -> Vec<SceneElement> {
        let text = |t: &str| t.to_owned();
        vec![SceneElement { node: 7, class: text("IfcDoor"), name: text("Tür"), guid: text("4hOSvn6df7F8") }]
    }

    #[test]
    fn what_is_written_reads_back() {
        assert_eq!(decode(&encode(&door()).unwrap()), Ok(door()));
    }

    #[test]
    fn damage_is_found() {
        let good = encode(&door()).unwrap();
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 1;
            assert!(decode(&bad).is_err(), "byte {at}");
            assert!(decode(&good[..at]).is_err(), "cut at {at}");
        }
    }
}
