//! The file `source`: which triangles of the source scene each cell holds.
//!
//! It lets others count triangles again without this program, through `inspect --json`. It stays
//! on the server. Layout: `"LSR"` and the version, the number of cells (u32), the raw length
//! (u64), one zstd frame over LEB128 numbers (per cell the number of ranges, per range node, mesh,
//! primitive, first, count), BLAKE3 of all before.

use super::{StoreError, files};
use crate::octree::SourceRange;
use ldi_protocol::codec::CodecError;
use std::path::Path;

const MAGIC: &[u8; 4] = b"LSR\x01";
/// Longest file and longest list that is read.
const MAX_BYTES: u64 = 1 << 32;

/// Encodes the ranges of all cells.
pub(super) fn encode(ranges: &[Vec<SourceRange>]) -> Result<Vec<u8>, std::io::Error> {
    let mut numbers = Vec::new();
    for cell in ranges {
        put(&mut numbers, cell.len() as u32);
        cell.iter().for_each(|r| {
            [r.node, r.mesh, r.primitive, r.first, r.count].into_iter().for_each(|v| put(&mut numbers, v))
        });
    }
    let mut out = MAGIC.to_vec();
    out.extend((ranges.len() as u32).to_le_bytes());
    out.extend((numbers.len() as u64).to_le_bytes());
    out.extend(zstd::bulk::compress(&numbers, 9)?);
    let hash = blake3::hash(&out);
    out.extend(hash.as_bytes());
    Ok(out)
}

/// Reads the ranges of all cells; None when there is no such file.
pub(super) fn read(path: &Path) -> Result<Option<Vec<Vec<SourceRange>>>, StoreError> {
    let Some(bytes) = files::read_if_there(path, MAX_BYTES)? else { return Ok(None) };
    decode(&bytes).map(Some).map_err(|reason| StoreError::Format {
        path: path.to_owned(),
        source: CodecError::Mismatch { field: "source ranges", reason: format!("{reason}; build the dataset again") },
    })
}

fn decode(bytes: &[u8]) -> Result<Vec<Vec<SourceRange>>, &'static str> {
    let body = bytes.len().checked_sub(32).ok_or("the file is too short")?;
    let (body, hash) = bytes.split_at(body);
    if blake3::hash(body).as_bytes() != hash {
        return Err("its checksum is wrong: it was damaged or cut off");
    }
    let (head, frame) = body.split_first_chunk::<16>().ok_or("the file is too short")?;
    if &head[..4] != MAGIC {
        return Err("it is of another kind or version");
    }
    let cells = u32::from_le_bytes([head[4], head[5], head[6], head[7]]);
    let raw_bytes = u64::from_le_bytes([head[8], head[9], head[10], head[11], head[12], head[13], head[14], head[15]]);
    if raw_bytes > MAX_BYTES || u64::from(cells) > raw_bytes {
        return Err("it claims more than it can hold");
    }
    let raw = zstd::bulk::decompress(frame, raw_bytes as usize).map_err(|_| "it does not decompress")?;
    let mut rest = &raw[..];
    let mut next = || take(&mut rest).ok_or("a number is cut off");
    let mut out = Vec::new();
    for _ in 0..cells {
        let mut cell = Vec::new();
        for _ in 0..next()? {
            cell.push(SourceRange { node: next()?, mesh: next()?, primitive: next()?, first: next()?, count: next()? });
        }
        out.push(cell);
    }
    if rest.is_empty() { Ok(out) } else { Err("there are bytes too many at its end") }
}

fn put(out: &mut Vec<u8>, mut v: u32) {
    while v >= 128 {
        out.push(v as u8 | 128);
        v >>= 7;
    }
    out.push(v as u8);
}

fn take(bytes: &mut &[u8]) -> Option<u32> {
    let mut v = 0u64;
    for shift in (0..35).step_by(7) {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        v |= u64::from(byte & 127) << shift;
        if byte < 128 {
            return u32::try_from(v).ok();
        }
    }
    None
}
