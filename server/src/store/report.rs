//! The file `report.json`: what the build did and skipped, with the hash of its text.
//!
//! Its last member, `blake3`, is the hash of the text without that member. The report names the
//! dataset that it is of: a stop between both files leaves that of the dataset before.

use super::{StoreError, files};
use ldi_protocol::{codec::CodecError, index::ChunkHash};
use serde_json::{Map, Value};
use std::path::Path;

/// Longest report that is read.
const MAX_BYTES: u64 = 64 << 20;
/// What stands between the other members and the hash.
const BEFORE_HASH: &str = ",\n  \"blake3\": \"";
/// What stands after the hash.
const END: &str = "\n}";

/// The text of a report of a dataset.
pub(super) fn encode(report: Value, dataset: &ChunkHash) -> Result<String, serde_json::Error> {
    let mut members = match report {
        Value::Object(members) => members,
        other => Map::from_iter([("report".to_owned(), other)]),
    };
    members.insert("dataset".into(), dataset.to_string().into());
    let text = serde_json::to_string_pretty(&members)?;
    let hash = blake3::hash(text.as_bytes()).to_hex();
    let members = text.strip_suffix(END).unwrap_or(&text);
    Ok(format!("{members}{BEFORE_HASH}{hash}\"{END}"))
}

/// Reads the report of a dataset; None if there is none. Earlier versions wrote no hash.
///
/// # Errors
/// If it is damaged.
pub(super) fn read(dataset: &Path, has_hash: bool) -> Result<Option<Value>, StoreError> {
    let path = dataset.join(files::REPORT);
    let Some(bytes) = files::read_if_there(&path, MAX_BYTES)? else { return Ok(None) };
    let damaged = |reason: String| StoreError::Format {
        path: path.clone(),
        source: CodecError::Mismatch { field: "report", reason: format!("{reason}; build the dataset again") },
    };
    if has_hash && !hash_fits(&bytes) {
        return Err(damaged("its hash is wrong or missing: it was damaged, changed or cut off".into()));
    }
    serde_json::from_slice(&bytes).map(Some).map_err(|e| damaged(e.to_string()))
}

/// Whether a report says nothing else than that it is of this dataset.
pub(super) fn is_of(report: &Value, dataset: &ChunkHash) -> bool {
    report.get("dataset").is_none_or(|named| named.as_str() == Some(&dataset.to_string()))
}

fn hash_fits(bytes: &[u8]) -> bool {
    let parts = || {
        let (members, end) = std::str::from_utf8(bytes).ok()?.rsplit_once(BEFORE_HASH)?;
        Some((members, end.strip_suffix(END)?.strip_suffix('"')?))
    };
    parts().is_some_and(|(members, hash)| {
        let mut hasher = blake3::Hasher::new();
        hasher.update(members.as_bytes()).update(END.as_bytes());
        hasher.finalize().to_hex().as_str() == hash
    })
}
