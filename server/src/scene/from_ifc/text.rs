//! The STEP text of an IFC file, as far as it is looked at before the shapes are read: its schema,
//! its end, and how many records it has.

use ifc_lite_core::{EntityDecoder, EntityScanner};

use super::super::error::Fault;
use super::super::files::shown;
use super::super::limits::Limits;
use super::mapped::Mapped;

/// Bytes in which a file says what it is.
const HEAD: usize = 64 << 10;
/// Bytes at the end in which the file's last words are looked for.
const TAIL: usize = 4096;
const COPY: &str = "copy the file again, or export it again";
/// Schemas that are read, by the beginnings of their names; that of IFC 4.3 is IFC4X3.
const READ: [&str; 2] = ["IFC2X3", "IFC4"];

/// The schema that the header names, if bytes are STEP text.
pub(super) fn schema(bytes: &[u8]) -> Option<String> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    if !bytes.starts_with(b"ISO-10303-21") {
        return None;
    }
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(HEAD)]).to_ascii_uppercase();
    let (_, after) = head.split_once("FILE_SCHEMA")?;
    let name = after.split('\'').nth(1)?.trim();
    Some(name.to_owned())
}

/// Fails where a file is cut off, of a schema that is not read, or larger than the limits.
pub(super) fn check(bytes: &[u8], limits: &Limits) -> Result<(), Fault> {
    let schema = schema(bytes).unwrap_or_default();
    if !READ.iter().any(|r| schema.starts_with(r)) {
        let problem = format!("its schema is {}", shown(&schema));
        return Err(Fault::unsupported("header", problem, "export it as IFC 2x3, IFC 4 or IFC 4.3"));
    }
    if bytes.len() as u64 > limits.step_bytes {
        return Err(Fault::too_large("file", "bytes of STEP text", bytes.len(), limits.step_bytes));
    }
    let tail = &bytes[bytes.len().saturating_sub(TAIL)..];
    let last = |word: &[u8]| tail.windows(word.len()).rposition(|w| w.eq_ignore_ascii_case(word));
    // The header ends with the same word.
    if last(b"ENDSEC") <= last(b"DATA;") {
        let place = format!("byte {}", bytes.len());
        return Err(Fault::invalid(place, "the file ends amid its data, before ENDSEC", COPY));
    }
    let mut scanner = EntityScanner::new(bytes);
    let mut records = 0u64;
    let decoder = EntityDecoder::new(bytes);
    let mut mapped = Mapped::default();
    while let Some((_, keyword, start, end)) = scanner.next_entity() {
        records += 1;
        if records > limits.step_records {
            return Err(Fault::too_large("data", "or more records", records, limits.step_records));
        }
        mapped.add(keyword, || decoder.decode_at_uncached(start, end).ok());
    }
    match records {
        0 => Err(Fault::invalid("data", "has no records", COPY)),
        _ => mapped.check(bytes, limits),
    }
}
