//! Packs opened for reading.
//!
//! Packs are read at their positions and not mapped into memory: whoever cuts off a mapped file
//! ends every process that looks at it (SIGBUS). An opened pack stays readable when a build
//! replaces it.

use super::{StoreError, files::DataFiles};
use ldi_protocol::{index::ChunkHash, manifest::layout::Location};
use std::{
    fs::File,
    io,
    os::unix::fs::FileExt,
    path::{Path, PathBuf},
};

/// A pack.
#[derive(Debug)]
pub(super) struct Pack {
    path: PathBuf,
    file: File,
    /// Its length when it was opened.
    bytes: u64,
}

impl Pack {
    /// Opens a pack; None if there is none.
    pub fn open(path: PathBuf) -> Result<Option<Self>, StoreError> {
        match File::open(&path).and_then(|file| Ok((file.metadata()?.len(), file))) {
            Ok((bytes, file)) => Ok(Some(Self { path, file, bytes })),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(e) => Err(StoreError::io(&path, "open it")(e)),
        }
    }
    pub fn path(&self) -> &Path {
        &self.path
    }
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Reads what lies somewhere in the pack, and checks it; else says what is wrong.
    pub fn read(&self, at: &Location, hash: &ChunkHash) -> Result<Vec<u8>, String> {
        // Checked before that much memory is asked for.
        if at.offset.saturating_add(at.bytes.into()) > self.bytes {
            return Err("it lies beyond the end of its pack".into());
        }
        let mut bytes = vec![0; at.bytes as usize];
        self.file.read_exact_at(&mut bytes, at.offset).map_err(|e| match e.kind() {
            io::ErrorKind::UnexpectedEof => "it lies beyond the end of its pack".to_owned(),
            _ => format!("it cannot be read: {e}"),
        })?;
        match blake3::hash(&bytes).as_bytes() == &hash.0 {
            true => Ok(bytes),
            false => Err("its bytes have another hash".into()),
        }
    }
}

/// Opens packs from the first on, until there is none.
pub(super) fn open_all(files: &DataFiles) -> Result<Vec<Pack>, StoreError> {
    (0..).map_while(|k| Pack::open(files.pack(k)).transpose()).collect()
}
