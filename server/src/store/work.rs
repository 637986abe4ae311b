//! The work directory of a build: finished pieces by key.
//!
//! A piece is whatever the pipeline wants to keep between a stop and the next start: encoded chunks with their figures. Its key
//! is the hash of everything it was made from, so a changed scene or setting finds nothing. A file is
//! `piece | length (u64) | BLAKE3 of piece and length`; one that a crash left torn fails that check and does not count.

use super::{StoreError, files};
use std::{
    fs::{self, File},
    path::{Path, PathBuf},
};

/// Longest piece that is read back: far above any real one.
const MAX_PIECE: u64 = 1 << 32;

/// `.build`, locked for one process.
#[derive(Debug)]
pub(super) struct WorkDirectory {
    path: PathBuf,
    /// Held open for its lock.
    _lock: File,
}

impl WorkDirectory {
    /// Opens or creates the work directory of a dataset and locks it.
    pub fn open(dataset: &Path) -> Result<Self, StoreError> {
        let path = dataset.join(files::WORK);
        fs::create_dir_all(&path).map_err(StoreError::io(&path, "create it"))?;
        let lock_path = path.join("lock");
        let lock = File::create(&lock_path).map_err(StoreError::io(&lock_path, "create it"))?;
        match lock.try_lock() {
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

    /// Stores a piece.
    pub fn store(&self, key: &[u8; 32], piece: &[u8]) -> Result<(), StoreError> {
        let path = self.piece_path(key);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(StoreError::io(folder, "create it"))?;
        }
        let length = (piece.len() as u64).to_le_bytes();
        let mut hasher = blake3::Hasher::new();
        hasher.update(piece).update(&length);
        let mut file = files::PendingFile::create(&path)?;
        file.write(piece)?;
        file.write(&length)?;
        file.write(hasher.finalize().as_bytes())?;
        file.publish()
    }

    /// Removes the directory if it holds no piece.
    pub fn remove_if_empty(self) {
        let _ = fs::remove_file(self.path.join("lock"));
        // Refused by the system while pieces are there.
        let _ = fs::remove_dir(&self.path);
    }

    /// Removes the directory with all pieces.
    pub fn remove(self) -> Result<(), StoreError> {
        fs::remove_dir_all(&self.path).map_err(StoreError::io(&self.path, "remove it"))
    }
}
