//! Changes to the file system: files that are there whole or not at all, and the names of a
//! dataset's files.
//!
//! Every call that changes something goes through [`change`], where tests let it fail. Links are
//! not followed: a folder must be one, and a file is made anew.

use super::StoreError;
use ldi_protocol::index::ChunkHash;
use std::{
    ffi::OsStr,
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

pub(super) const MANIFEST: &str = "manifest";
pub(super) const REPORT: &str = "report.json";
pub(super) const WORK: &str = ".build";
/// Folder of the packs of datasets without a marker; and what the names of later ones begin with.
pub(super) const PACKS: &str = "packs";
const SOURCE: &str = "source";
const ELEMENTS: &str = "elements";
/// Ending of files that are being written.
const PART: &str = "part";
/// Hexadecimal digits of the manifest's hash in the name of a folder of packs.
const HASH_DIGITS: usize = 16;

/// Where the files lie that one manifest names: packs and source ranges.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct DataFiles {
    folder: PathBuf,
    source: PathBuf,
}

impl DataFiles {
    /// Where a build puts the files of the manifest of this hash.
    pub fn new(dataset: &Path, hash: &ChunkHash) -> Self {
        let folder = dataset.join(format!("{PACKS}-{}", &hash.to_string()[..HASH_DIGITS]));
        Self { source: folder.join(SOURCE), folder }
    }

    /// Where the files of the manifest of this hash are, also of a dataset of an earlier version.
    pub fn find(dataset: &Path, hash: &ChunkHash) -> Self {
        let (new, old) = (Self::new(dataset, hash), dataset.join(PACKS));
        match !new.folder.is_dir() && old.is_dir() {
            true => Self { folder: old, source: dataset.join(SOURCE) },
            false => new,
        }
    }

    /// Whether they are those of a dataset without a marker.
    pub fn are_old(&self) -> bool {
        self.folder.ends_with(PACKS)
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }
    pub fn source(&self) -> &Path {
        &self.source
    }
    pub fn elements(&self) -> PathBuf {
        self.folder.join(ELEMENTS)
    }
    pub fn pack(&self, number: usize) -> PathBuf {
        self.folder.join(format!("pack-{number:05}.bin"))
    }
}

/// Whether a build gave this name to a folder of packs.
pub(super) fn is_data_folder(name: &OsStr) -> bool {
    let hash = name.to_str().and_then(|n| n.strip_prefix(PACKS)?.strip_prefix('-'));
    hash.is_some_and(|h| h.len() == HASH_DIGITS && is_hex(h))
}

/// Whether a build gave this name to a file in a folder of packs.
pub(super) fn is_data_file(name: &OsStr) -> bool {
    let Some(name) = name.to_str() else { return false };
    let whole = without_part(name);
    let number = whole.strip_prefix("pack-").and_then(|n| n.strip_suffix(".bin"));
    whole == SOURCE
        || whole == ELEMENTS
        || number.is_some_and(|n| n.len() >= 5 && n.bytes().all(|b| b.is_ascii_digit()))
}

/// The name of a file without the ending that says it is being written.
pub(super) fn without_part(name: &str) -> &str {
    name.strip_suffix(PART).and_then(|n| n.strip_suffix('.')).unwrap_or(name)
}

/// Whether a text is of small hexadecimal digits.
pub(super) fn is_hex(text: &str) -> bool {
    text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

/// Makes one change to the file system.
pub(super) fn change<T>(
    path: &Path,
    action: &'static str,
    call: impl FnOnce() -> io::Result<T>,
) -> Result<T, StoreError> {
    #[cfg(test)]
    super::tests::faults::before_change(path).map_err(StoreError::io(path, action))?;
    call().map_err(StoreError::io(path, action))
}

/// A file under another name until it is published.
pub(super) struct PendingFile {
    part: PathBuf,
    target: PathBuf,
    file: File,
}

impl PendingFile {
    /// Starts a file that will be `target`.
    pub fn create(target: &Path) -> Result<Self, StoreError> {
        let mut name = target.file_name().unwrap_or_default().to_owned();
        name.push(".");
        name.push(PART);
        let part = target.with_file_name(name);
        remove_if_there(&part)?;
        let file = change(&part, "create it", || File::create_new(&part))?;
        Ok(Self { part, target: target.to_owned(), file })
    }

    /// Appends bytes.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        #[cfg(test)]
        if super::tests::faults::is_next(&self.part) {
            // A write that fails has written something, as a rule.
            let _ = self.file.write_all(&bytes[..bytes.len() / 2]);
        }
        change(&self.part, "write", || self.file.write_all(bytes))
    }

    /// Syncs the bytes to the disk.
    pub fn sync(self) -> Result<SyncedFile, StoreError> {
        let Self { part, target, file } = self;
        change(&part, "sync it to the disk", || file.sync_all())?;
        Ok(SyncedFile { part, target })
    }
}

/// A file whose bytes are on the disk, under another name until it is published.
pub(super) struct SyncedFile {
    part: PathBuf,
    target: PathBuf,
}

impl SyncedFile {
    /// Gives the file its name; one of that name is replaced. The directory is for the caller to
    /// sync.
    pub fn publish(self) -> Result<(), StoreError> {
        change(&self.target, "give it its name", || fs::rename(&self.part, &self.target))
    }
}

/// Writes a file whole and syncs it.
pub(super) fn write_file(target: &Path, bytes: &[u8]) -> Result<SyncedFile, StoreError> {
    let mut file = PendingFile::create(target)?;
    file.write(bytes)?;
    file.sync()
}

/// Syncs the names in a directory to the disk.
pub(super) fn sync_directory(path: &Path) -> Result<(), StoreError> {
    change(path, "sync the directory to the disk", || File::open(path).and_then(|d| d.sync_all()))
}

/// What a path names, links not followed; None if there is nothing.
pub(super) fn kind_of(path: &Path) -> Result<Option<fs::FileType>, StoreError> {
    match fs::symlink_metadata(path) {
        Ok(found) => Ok(Some(found.file_type())),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(StoreError::io(path, "look at it")(e)),
    }
}

/// Makes a directory unless it is there.
///
/// # Errors
/// If something else is there, also a link to a directory.
pub(super) fn make_directory(path: &Path) -> Result<(), StoreError> {
    match kind_of(path)? {
        Some(kind) if kind.is_dir() => Ok(()),
        Some(kind) if kind.is_symlink() => Err(StoreError::NotOurs {
            path: path.to_owned(),
            why: "it is a symbolic link, which no build follows; remove the link, or name another folder".into(),
        }),
        Some(_) => Err(StoreError::NotOurs {
            path: path.to_owned(),
            why: "it is not a folder; remove it, or name another folder".into(),
        }),
        None => match change(path, "create it", || fs::create_dir(path)) {
            // Another thread or process was faster.
            Err(e) if e.is_of_a_race() && path.is_dir() => Ok(()),
            made => made,
        },
    }
}

/// Removes a file if it is there.
pub(super) fn remove_if_there(path: &Path) -> Result<(), StoreError> {
    match kind_of(path)? {
        Some(_) => change(path, "remove it", || fs::remove_file(path)),
        None => Ok(()),
    }
}

/// Removes the files in a folder whose name `is_ours`, and the folder if it is empty then. Whatever
/// else it holds stays.
pub(super) fn remove_folder(path: &Path, is_ours: impl Fn(&OsStr) -> bool) -> Result<(), StoreError> {
    let mut is_empty = true;
    for entry in list(path)? {
        match is_ours(&entry.name) && entry.kind.is_file() {
            true => remove_if_there(&path.join(&entry.name))?,
            false => is_empty = false,
        }
    }
    match is_empty {
        true => change(path, "remove it", || fs::remove_dir(path)),
        false => Ok(()),
    }
}

/// Something in a folder.
pub(super) struct Entry {
    pub name: std::ffi::OsString,
    /// Links not followed.
    pub kind: fs::FileType,
}

/// What a folder holds, by name.
pub(super) fn list(path: &Path) -> Result<Vec<Entry>, StoreError> {
    let of = |e: io::Result<fs::DirEntry>| e.and_then(|e| Ok(Entry { name: e.file_name(), kind: e.file_type()? }));
    let all = fs::read_dir(path).and_then(|entries| entries.map(of).collect::<io::Result<Vec<_>>>());
    let mut all = all.map_err(StoreError::io(path, "list it"))?;
    all.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(all)
}

/// Bytes that may still be written to the disk of a folder; None where the system does not say.
pub(super) fn free_bytes(folder: &Path) -> Option<u64> {
    #[cfg(test)]
    if let Some(bytes) = super::tests::faults::free_bytes(folder) {
        return Some(bytes);
    }
    let disk = rustix::fs::statvfs(folder).ok()?;
    disk.f_bavail.checked_mul(disk.f_frsize)
}

/// Reads a file of at most `limit` bytes; None if there is none.
pub(super) fn read_if_there(path: &Path, limit: u64) -> Result<Option<Vec<u8>>, StoreError> {
    use std::io::Read;
    let file = match File::open(path) {
        Ok(f) => f,
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(StoreError::io(path, "open it")(e)),
    };
    let mut bytes = Vec::new();
    file.take(limit + 1).read_to_end(&mut bytes).map_err(StoreError::io(path, "read it"))?;
    if bytes.len() as u64 > limit {
        let source = io::Error::new(io::ErrorKind::FileTooLarge, format!("more than {limit} bytes"));
        return Err(StoreError::io(path, "read it")(source));
    }
    Ok(Some(bytes))
}
