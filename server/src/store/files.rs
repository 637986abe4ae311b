//! Writing files so that they are there whole or not at all, and the names of a dataset's files.

use super::StoreError;
use std::{
    fs::{self, File},
    io::{BufWriter, Write},
    path::{Path, PathBuf},
};

pub(super) const MANIFEST: &str = "manifest";
pub(super) const PACKS: &str = "packs";
pub(super) const SOURCE: &str = "source";
pub(super) const REPORT: &str = "report.json";
pub(super) const WORK: &str = ".build";
/// Ending of files that are being written.
const PART: &str = "part";

/// Path of a pack.
pub(super) fn pack_path(dataset: &Path, number: usize) -> PathBuf {
    dataset.join(PACKS).join(format!("pack-{number:05}.bin"))
}

/// A file under another name until it is published.
pub(super) struct PendingFile {
    part: PathBuf,
    target: PathBuf,
    out: BufWriter<File>,
}

impl PendingFile {
    /// Starts a file that will be `target`.
    pub fn create(target: &Path) -> Result<Self, StoreError> {
        let mut name = target.file_name().unwrap_or_default().to_owned();
        name.push(".");
        name.push(PART);
        let part = target.with_file_name(name);
        let file = File::create(&part).map_err(StoreError::io(&part, "create it"))?;
        Ok(Self { part, target: target.to_owned(), out: BufWriter::with_capacity(1 << 20, file) })
    }
    /// Appends bytes.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        self.out.write_all(bytes).map_err(StoreError::io(&self.part, "write"))
    }
    /// Syncs the bytes to the disk and gives the file its name. The directory is for the caller to sync.
    pub fn publish(self) -> Result<(), StoreError> {
        let Self { part, target, out } = self;
        let file = out.into_inner().map_err(|e| StoreError::io(&part, "write")(e.into_error()))?;
        file.sync_all().map_err(StoreError::io(&part, "sync it to the disk"))?;
        drop(file);
        fs::rename(&part, &target).map_err(StoreError::io(&target, "give it its name"))
    }
}

/// Writes a file whole.
pub(super) fn write_file(target: &Path, bytes: &[u8]) -> Result<(), StoreError> {
    let mut file = PendingFile::create(target)?;
    file.write(bytes)?;
    file.publish()
}

/// Syncs the names in a directory to the disk.
pub(super) fn sync_directory(path: &Path) -> Result<(), StoreError> {
    File::open(path).and_then(|d| d.sync_all()).map_err(StoreError::io(path, "sync the directory to the disk"))
}

/// Removes a file if it is there.
pub(super) fn remove_if_there(path: &Path) -> Result<(), StoreError> {
    match fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(StoreError::io(path, "remove it")(e)),
        _ => Ok(()),
    }
}

/// Reads a file of at most `limit` bytes; None if there is none.
pub(super) fn read_if_there(path: &Path, limit: u64) -> Result<Option<Vec<u8>>, StoreError> {
    use std::io::Read;
    let file = match File::open(path) {
        Ok(f) => f,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(StoreError::io(path, "open it")(e)),
    };
    let mut bytes = Vec::new();
    file.take(limit + 1).read_to_end(&mut bytes).map_err(StoreError::io(path, "read it"))?;
    if bytes.len() as u64 > limit {
        let source = std::io::Error::new(std::io::ErrorKind::FileTooLarge, format!("more than {limit} bytes"));
        return Err(StoreError::io(path, "read it")(source));
    }
    Ok(Some(bytes))
}
