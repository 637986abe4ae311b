//! Read-only memory maps of packs: chunks are sent without a copy.

use super::StoreError;
use memmap2::Mmap;
use std::{fs::File, path::Path};

/// Maps a file of exactly `expected` bytes.
#[allow(unsafe_code, reason = "memory maps are unsafe in Rust's eyes: a file may change under them")]
pub(super) fn map_pack(path: &Path, expected: u64) -> Result<Mmap, StoreError> {
    let file = File::open(path).map_err(StoreError::io(path, "open it"))?;
    let found = file.metadata().map_err(StoreError::io(path, "open it"))?.len();
    if found != expected {
        return Err(StoreError::PackLength { path: path.to_owned(), found, expected });
    }
    // SAFETY: packs are never written in place: a build writes another file and renames it, which leaves this map's file as
    // it is. Whoever else overwrites or truncates a pack while it is served breaks the dataset anyway; readers treat
    // the bytes as untrusted, so that changed ones give errors, and a truncated pack ends the process (SIGBUS).
    // Gain: sending from the map instead of reading into a buffer saves a copy of every byte and one buffer per stream.
    unsafe { Mmap::map(&file) }.map_err(StoreError::io(path, "map it into memory"))
}
