//! The disk cache: chunks kept between visits.
//!
//! ```text
//!   DIR/chunks/ab/ab12...   stored bytes of a chunk or a page, named by their BLAKE3 hash
//!   DIR/roots/ab12...       the root of a manifest, named likewise; clients announce these roots,
//!                           so that the server does not send their manifests again
//! ```
//!
//! Several clients may share a folder, and none trusts the others' data: a file is written to a
//! temporary name and renamed, is read with the length that the index states, and is accepted only
//! if its hash is its name. Damaged files are removed and fetched again. There are no locks; a file
//! removed by another client is simply absent.
//!
//! The total size stays below the capacity: before a file would exceed it, the least recently used
//! files are removed until an eighth of the capacity is free. Reading a file counts as use, through
//! its modification time. Each client counts the bytes it adds, and lists the folder again after a
//! sixteenth of the capacity; two clients can exceed the capacity by that much for a short time.

use ldi_protocol::{
    index::ChunkHash,
    manifest::{self, Root},
    wire::MAX_ROOT_BYTES,
};
use std::{
    fs::{self, File},
    io::{self, Read as _, Write as _},
    path::{Path, PathBuf},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    time::SystemTime,
};

/// Largest number of roots that a client announces, newest first.
pub(super) const MAX_ROOTS: usize = 4;
/// Largest number of files listed per folder; any others are ignored.
const MAX_FILES: usize = 1 << 20;
/// Default capacity, bytes.
pub const DEFAULT_DISK_BYTES: u64 = 2 << 30;

/// A folder of chunks, shared by connections.
#[derive(Debug)]
pub struct DiskCache {
    folder: PathBuf,
    cap_bytes: u64,
    known: Mutex<Known>,
    /// Makes temporary names unique within this process.
    next: AtomicU64,
}

#[derive(Debug, Default)]
struct Known {
    /// Bytes of all files at the last listing, plus those added since.
    bytes: u64,
    /// Bytes added since the last listing.
    added: u64,
}

/// The disk cache cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{folder}: {source}; give --disk-cache a folder that can be written, or leave it out")]
pub struct DiskError {
    folder: PathBuf,
    source: io::Error,
}

#[derive(Debug)]
struct Entry {
    used: SystemTime,
    bytes: u64,
    path: PathBuf,
}

impl DiskCache {
    /// Opens a folder, and creates it if absent.
    ///
    /// # Errors
    /// If the folder cannot be created or read.
    pub fn open(folder: &Path, cap_bytes: u64) -> Result<Self, DiskError> {
        let error = |source| DiskError { folder: folder.into(), source };
        for kind in ["chunks", "roots"] {
            fs::create_dir_all(folder.join(kind)).map_err(error)?;
        }
        let cache = Self { folder: folder.into(), cap_bytes, known: Mutex::default(), next: AtomicU64::new(0) };
        // The capacity may be smaller than before.
        cache.make_room(0);
        Ok(cache)
    }

    /// The user's cache folder: `$XDG_CACHE_HOME/ldi`, else `$HOME/.cache/ldi` on Linux. None
    /// without a home.
    pub fn default_folder() -> Option<PathBuf> {
        directories::ProjectDirs::from("", "", "ldi").map(|d| d.cache_dir().to_path_buf())
    }

    /// Bytes of all files, including temporary ones.
    pub fn bytes(&self) -> u64 {
        self.entries().iter().map(|e| e.bytes).sum()
    }

    /// Whether there is a file of this name and length, without reading it.
    pub fn has(&self, name: &ChunkHash, bytes: u32) -> bool {
        fs::metadata(self.path_of(name)).is_ok_and(|m| m.is_file() && m.len() == u64::from(bytes))
    }

    /// Reads a chunk or page. None if it is absent, or damaged (it is then removed).
    pub fn load(&self, name: &ChunkHash, bytes: u32) -> Option<Vec<u8>> {
        read_checked(&self.path_of(name), name, bytes as usize)
    }

    /// Stores a verified chunk or page. Errors are logged: a full or broken disk does not stop a
    /// walk.
    pub fn store(&self, name: &ChunkHash, bytes: &[u8]) {
        self.put(&self.path_of(name), bytes);
    }

    /// Stores the root of a manifest.
    pub(super) fn store_root(&self, name: &ChunkHash, bytes: &[u8]) {
        self.put(&self.folder.join("roots").join(name.to_string()), bytes);
    }

    /// Complete and valid manifests, newest first: root and pages.
    pub(super) fn manifests(&self) -> Vec<(Root, Vec<Vec<u8>>)> {
        let mut roots = Vec::new();
        list(&self.folder.join("roots"), &mut roots);
        roots.sort_by_key(|e| std::cmp::Reverse(e.used));
        let whole = |e: Entry| {
            let name = parse_name(e.path.file_name()?.to_str()?)?;
            let length = usize::try_from(e.bytes).ok().filter(|n| *n <= MAX_ROOT_BYTES)?;
            let bytes = read_checked(&e.path, &name, length)?;
            let root = manifest::decode_root(&bytes).ok()?;
            let pages = root.pages.iter().map(|p| self.load(&p.hash, p.stored_bytes)).collect::<Option<_>>()?;
            Some((root, pages))
        };
        roots.into_iter().take(MAX_ROOTS).filter_map(whole).collect()
    }

    fn path_of(&self, name: &ChunkHash) -> PathBuf {
        let name = name.to_string();
        self.folder.join("chunks").join(&name[..2]).join(name)
    }

    fn put(&self, path: &Path, bytes: &[u8]) {
        let length = bytes.len() as u64;
        if path.exists() || !self.make_room(length) {
            return;
        }
        let number = self.next.fetch_add(1, Relaxed);
        let beside = path.with_extension(format!("{}-{number}.part", std::process::id()));
        let written = || {
            if let Some(parent) = path.parent() {
                fs::create_dir_all(parent)?;
            }
            // Not synced: after a crash an incomplete file fails its hash.
            File::create(&beside)?.write_all(bytes)?;
            fs::rename(&beside, path)
        };
        if let Err(e) = written() {
            let _ = fs::remove_file(&beside);
            tracing::warn!("{}: {e}; this chunk is not kept on disk", path.display());
        }
    }

    /// Makes room for `bytes`. Returns whether the capacity suffices.
    fn make_room(&self, bytes: u64) -> bool {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = known.bytes + bytes <= self.cap_bytes;
        if bytes > self.cap_bytes {
            return false;
        }
        // Lists the folder at first use, when it is full, and regularly, as other clients may add
        // files.
        if !fits || bytes == 0 || known.added + bytes > self.cap_bytes / 16 {
            let mut entries = self.entries();
            let mut sum: u64 = entries.iter().map(|e| e.bytes).sum();
            if sum + bytes > self.cap_bytes {
                entries.sort_by(|a, b| a.used.cmp(&b.used).then(a.path.cmp(&b.path)));
                for e in entries {
                    if sum + bytes <= self.cap_bytes - self.cap_bytes / 8 {
                        break;
                    }
                    // Another client may have removed it.
                    let _ = fs::remove_file(&e.path);
                    sum = sum.saturating_sub(e.bytes);
                }
            }
            *known = Known { bytes: sum, added: 0 };
        }
        known.bytes += bytes;
        known.added += bytes;
        true
    }

    /// All files.
    fn entries(&self) -> Vec<Entry> {
        let mut out = Vec::new();
        list(&self.folder.join("roots"), &mut out);
        let folders = fs::read_dir(self.folder.join("chunks")).into_iter().flatten().flatten();
        for folder in folders.take(1 << 10) {
            list(&folder.path(), &mut out);
        }
        out
    }
}

/// The files of one folder.
fn list(folder: &Path, out: &mut Vec<Entry>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        if out.len() >= MAX_FILES {
            return;
        }
        let Some(m) = entry.metadata().ok().filter(fs::Metadata::is_file) else { continue };
        let used = m.modified().unwrap_or(SystemTime::UNIX_EPOCH);
        out.push(Entry { used, bytes: m.len(), path: entry.path() });
    }
}

/// Reads a file of this length and hash. A file that differs is removed.
fn read_checked(path: &Path, name: &ChunkHash, length: usize) -> Option<Vec<u8>> {
    let file = File::open(path).ok()?;
    let mut bytes = Vec::new();
    let fits = file.metadata().is_ok_and(|m| m.len() == length as u64);
    if fits && bytes.try_reserve_exact(length).is_ok() {
        let _ = (&file).take(length as u64).read_to_end(&mut bytes);
    }
    if bytes.len() == length && blake3::hash(&bytes).as_bytes() == &name.0 {
        // The time of use. If it cannot be set, eviction is by age.
        let _ = file.set_modified(SystemTime::now());
        return Some(bytes);
    }
    tracing::warn!("{}: damaged, removed", path.display());
    let _ = fs::remove_file(path);
    None
}

fn parse_name(text: &str) -> Option<ChunkHash> {
    let digits = text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
    let byte = |i: usize| u8::from_str_radix(text.get(2 * i..2 * i + 2)?, 16).ok();
    let mut hash = [0; 32];
    for (i, b) in hash.iter_mut().enumerate() {
        *b = byte(i).filter(|_| digits)?;
    }
    Some(ChunkHash(hash))
}

#[cfg(test)]
#[path = "disk_test.rs"]
mod tests;
