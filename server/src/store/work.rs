//! The work directory of a build: finished pieces by key.
//!
//! A piece is whatever the pipeline wants to keep between a stop and the next start: encoded
//! chunks with their figures. Its key is the hash of everything it was made from, so a changed
//! scene or setting finds nothing. A file is `piece | length (u64) | BLAKE3 of piece and length`;
//! one that a crash left torn fails that check and does not count.

use super::{
    StoreError,
    files::{self, change, is_hex, list, make_directory, remove_folder, without_part},
};
use std::{
    ffi::OsStr,
    fs::{self, File, OpenOptions},
    path::{Path, PathBuf},
};

/// Longest piece that is read back: far above any real one.
const MAX_PIECE: u64 = 1 << 32;
/// Held while a build is under way.
const LOCK: &str = "lock";

/// `.build`, locked for one process, or for several that share out the pieces.
#[derive(Debug)]
pub(super) struct WorkDirectory {
    path: PathBuf,
    /// Held open for its lock.
    _lock: File,
}

impl WorkDirectory {
    /// Opens or creates the work directory of a dataset and locks it.
    pub fn open(dataset: &Path) -> Result<Self, StoreError> {
        Self::open_with(dataset, File::try_lock)
    }

    /// The same, beside other processes that open it like this.
    pub fn open_shared(dataset: &Path) -> Result<Self, StoreError> {
        Self::open_with(dataset, File::try_lock_shared)
    }

    fn open_with(dataset: &Path, take: fn(&File) -> Result<(), fs::TryLockError>) -> Result<Self, StoreError> {
        let path = dataset.join(files::WORK);
        make_directory(&path)?;
        let lock_path = path.join(LOCK);
        if files::kind_of(&lock_path)?.is_some_and(|kind| !kind.is_file()) {
            files::remove_if_there(&lock_path)?;
        }
        let open = || OpenOptions::new().write(true).create(true).truncate(false).open(&lock_path);
        let lock = change(&lock_path, "create it", open)?;
        match take(&lock) {
            Ok(()) => Ok(Self { path, _lock: lock }),
            Err(fs::TryLockError::WouldBlock) => Err(StoreError::Locked { path: dataset.to_owned() }),
            Err(fs::TryLockError::Error(e)) => Err(StoreError::io(&lock_path, "lock it")(e)),
        }
    }

    /// Pieces lie in 256 folders, by the first byte of the key.
    fn piece_path(&self, key: &[u8; 32]) -> PathBuf {
        let name: String = key.iter().map(|b| format!("{b:02x}")).collect();
        self.path.join(&name[..2]).join(&name[2..])
    }

    /// The piece stored under a key; None if there is none, or only a torn one.
    pub fn cached(&self, key: &[u8; 32]) -> Option<Vec<u8>> {
        let mut bytes = files::read_if_there(&self.piece_path(key), MAX_PIECE).ok()??;
        let length = bytes.len().checked_sub(40)?;
        let (head, hash) = bytes.split_at(length + 8);
        if head[length..] != (length as u64).to_le_bytes() || blake3::hash(head).as_bytes() != hash {
            return None;
        }
        bytes.truncate(length);
        Some(bytes)
    }

    /// Whether there is a piece under a key, perhaps a torn one.
    pub fn holds(&self, key: &[u8; 32]) -> bool {
        self.piece_path(key).is_file()
    }

    /// Stores a piece.
    pub fn store(&self, key: &[u8; 32], piece: &[u8]) -> Result<(), StoreError> {
        let path = self.piece_path(key);
        if let Some(folder) = path.parent() {
            make_directory(folder)?;
        }
        let length = (piece.len() as u64).to_le_bytes();
        let mut hasher = blake3::Hasher::new();
        hasher.update(piece).update(&length);
        let mut file = files::PendingFile::create(&path)?;
        file.write(piece)?;
        file.write(&length)?;
        file.write(hasher.finalize().as_bytes())?;
        file.sync()?.publish()
    }

    /// Removes the directory if it holds no piece.
    pub fn remove_if_empty(self) {
        let _ = fs::remove_file(self.path.join(LOCK));
        // Refused by the system while pieces are there.
        let _ = fs::remove_dir(&self.path);
    }

    /// Removes all pieces, and the directory if it holds nothing else.
    pub fn remove(self) -> Result<(), StoreError> {
        for folder in list(&self.path)? {
            let is_prefix = folder.name.to_str().is_some_and(|n| n.len() == 2 && is_hex(n));
            if is_prefix && folder.kind.is_dir() {
                remove_folder(&self.path.join(&folder.name), is_piece)?;
            }
        }
        remove_folder(&self.path, |name| name == LOCK)
    }
}

/// Whether a file in a folder of pieces has the name of one.
fn is_piece(name: &OsStr) -> bool {
    name.to_str().map(without_part).is_some_and(|n| n.len() == 62 && is_hex(n))
}
