//! Chunks kept on disk between visits: what was received once is read from here the next time.
//!
//! ```text
//!   DIR/chunks/ab/ab12...   stored bytes of a chunk or a page, named by their BLAKE3 hash
//!   DIR/roots/ab12...       the root of a manifest, named likewise: the server sends none of it to a client that has it
//! ```
//!
//! Several clients may share a folder, and none of them is trusted with the others' data: a file appears whole (written beside its place, then
//! renamed), is read with the length that the index states, and is believed only if its hash is its name. What is damaged is removed and fetched
//! anew. There are no locks; a file that somebody else removed meanwhile is one that is not there.
//!
//! The sum of all files stays below the cap: before a file is written that would exceed it, the least recently used ones go until an eighth of the cap is
//! free. Reading a file counts as use, by its time of modification. Each client counts what it adds, and looks at the folder again after a sixteenth of the cap: so
//! two clients at once may exceed the cap by that much, and no more for long.

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

/// Roots that a client says it has; the newest ones.
pub(super) const MAX_ROOTS: usize = 4;
/// Files that are looked at in one folder; a folder with more was not made here, and the rest of it is left alone.
const MAX_FILES: usize = 1 << 20;
/// The default cap: some datasets of the size of the shared scenes.
pub const DEFAULT_DISK_BYTES: u64 = 2 << 30;

/// A folder of chunks. Cloning is not needed: connections share it.
#[derive(Debug)]
pub struct DiskCache {
    folder: PathBuf,
    cap_bytes: u64,
    known: Mutex<Known>,
    /// Makes names of unfinished files differ within this process.
    next: AtomicU64,
}

#[derive(Debug, Default)]
struct Known {
    /// Bytes of all files when the folder was looked at, and of what was added since.
    bytes: u64,
    /// Of that, what was added since.
    added: u64,
}

/// A disk cache cannot be used.
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
    /// Opens a folder, and makes it if it is not there.
    ///
    /// # Errors
    /// A folder that cannot be made or read.
    pub fn open(folder: &Path, cap_bytes: u64) -> Result<Self, DiskError> {
        let error = |source| DiskError { folder: folder.into(), source };
        for kind in ["chunks", "roots"] {
            fs::create_dir_all(folder.join(kind)).map_err(error)?;
        }
        let cache = Self { folder: folder.into(), cap_bytes, known: Mutex::default(), next: AtomicU64::new(0) };
        // One that was filled under a larger cap shrinks now.
        cache.make_room(0);
        Ok(cache)
    }

    /// The user's cache folder: `$XDG_CACHE_HOME/ldi`, else `$HOME/.cache/ldi` on Linux. None without a home.
    pub fn default_folder() -> Option<PathBuf> {
        directories::ProjectDirs::from("", "", "ldi").map(|d| d.cache_dir().to_path_buf())
    }

    /// Bytes of all files, unfinished ones included.
    pub fn bytes(&self) -> u64 {
        self.entries().iter().map(|e| e.bytes).sum()
    }

    /// Whether a file of this name and length is there. Its bytes are not looked at.
    pub fn has(&self, name: &ChunkHash, bytes: u32) -> bool {
        fs::metadata(self.path_of(name)).is_ok_and(|m| m.is_file() && m.len() == u64::from(bytes))
    }

    /// The bytes of a chunk or page. None: not there, or not what its name says, and then it is gone now.
    pub fn load(&self, name: &ChunkHash, bytes: u32) -> Option<Vec<u8>> {
        read_checked(&self.path_of(name), name, bytes as usize)
    }

    /// Keeps a chunk or page whose hash was checked. A full or broken disk is no reason to stop a walk: it is logged.
    pub fn store(&self, name: &ChunkHash, bytes: &[u8]) {
        self.put(&self.path_of(name), bytes);
    }

    /// Keeps the root of a manifest.
    pub(super) fn store_root(&self, name: &ChunkHash, bytes: &[u8]) {
        self.put(&self.folder.join("roots").join(name.to_string()), bytes);
    }

    /// Manifests that are here whole and sound, the newest first: root and pages.
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
            // Not synced: what a crash leaves behind does not have its hash.
            File::create(&beside)?.write_all(bytes)?;
            fs::rename(&beside, path)
        };
        if let Err(e) = written() {
            let _ = fs::remove_file(&beside);
            tracing::warn!("{}: {e}; this chunk is not kept on disk", path.display());
        }
    }

    /// Makes room for so many bytes. False: there is none, as the cap is smaller.
    fn make_room(&self, bytes: u64) -> bool {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = known.bytes + bytes <= self.cap_bytes;
        if bytes > self.cap_bytes {
            return false;
        }
        // The first time, when it is full, and once in a while as others may add files too.
        if !fits || bytes == 0 || known.added + bytes > self.cap_bytes / 16 {
            let mut entries = self.entries();
            let mut sum: u64 = entries.iter().map(|e| e.bytes).sum();
            if sum + bytes > self.cap_bytes {
                entries.sort_by(|a, b| a.used.cmp(&b.used).then(a.path.cmp(&b.path)));
                for e in entries {
                    if sum + bytes <= self.cap_bytes - self.cap_bytes / 8 {
                        break;
                    }
                    // Whoever removed it first: it is gone.
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

/// Reads a file of exactly this length and hash; one that differs is removed.
fn read_checked(path: &Path, name: &ChunkHash, length: usize) -> Option<Vec<u8>> {
    let file = File::open(path).ok()?;
    let mut bytes = Vec::new();
    let fits = file.metadata().is_ok_and(|m| m.len() == length as u64);
    if fits && bytes.try_reserve_exact(length).is_ok() {
        let _ = (&file).take(length as u64).read_to_end(&mut bytes);
    }
    if bytes.len() == length && blake3::hash(&bytes).as_bytes() == &name.0 {
        // The time of use. Where it cannot be set, eviction is by age.
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
