//! The folder of a dataset, and the marker that tells it from folders of others.
//!
//! A build writes into a new folder, an empty one, or one with the marker file that only a build
//! writes. A dataset of an earlier version has none: it is read as any other, and not overwritten.

use super::{
    StoreError,
    files::{self, change, kind_of, list},
};
use ldi_protocol::manifest::MAX_ROOT_BYTES;
use std::{
    fs::{self, File},
    hash::{DefaultHasher, Hash as _, Hasher as _},
    io::Write,
    path::{Path, PathBuf},
    time::Duration,
};

/// Name of the marker file.
pub(super) const MARKER: &str = "ldi-dataset";
/// Its content.
const TEXT: &str = "ldi-dataset 1\n\
    This folder belongs to `ldi-server build`, which replaces and removes the files that it made here.\n";

/// Attempts to claim a folder that others claim at the same time, and the pause between them.
const CLAIMS: usize = 20;
/// See [`CLAIMS`].
const CLAIM_AGAIN: Duration = Duration::from_millis(20);

/// A folder that a build may write into.
#[derive(Debug)]
pub(super) struct DatasetFolder {
    path: PathBuf,
    /// Whether this run made the folder, and the marker in it.
    made: (bool, bool),
}

impl DatasetFolder {
    /// Makes the folder or takes one that is empty or marked.
    ///
    /// # Errors
    /// If it is a link, no folder, or holds what no build put there.
    pub fn claim(path: &Path) -> Result<Self, StoreError> {
        // Without a slash at its end: that would follow a link.
        let path: PathBuf = path.components().collect();
        let there = path.ancestors().skip(1).find(|above| above.symlink_metadata().is_ok());
        if let Some(file) = there.filter(|above| !above.is_dir()) {
            let why = format!("{}, in which it would lie, is a file; name another folder", file.display());
            return Err(StoreError::NotOurs { path, why });
        }
        let made = match kind_of(&path)? {
            None => {
                if let Some(parent) = path.parent() {
                    change(parent, "create it", || fs::create_dir_all(parent))?;
                }
                true
            }
            Some(_) => false,
        };
        files::make_directory(&path)?;
        let is_marked = is_marked(&path)?;
        if !is_marked {
            refuse_other_files(&path)?;
            write_marker(&path)?;
        }
        Ok(Self { path, made: (made, !is_marked) })
    }

    /// The same while other processes do it.
    ///
    /// # Errors
    /// As [`Self::claim`].
    pub fn claim_beside_others(path: &Path) -> Result<Self, StoreError> {
        for _ in 0..CLAIMS {
            match Self::claim(path) {
                Err(e) if e.is_of_a_race() || is_marked(path).unwrap_or(false) => std::thread::sleep(CLAIM_AGAIN),
                end => return end,
            }
        }
        Self::claim(path)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Removes what [`Self::claim`] made, if nothing else is in the folder.
    pub fn give_back(self) {
        let (folder, marker) = self.made;
        let alone = list(&self.path).is_ok_and(|entries| entries.iter().all(|e| e.name == MARKER));
        if marker && alone {
            let _ = fs::remove_file(self.path.join(MARKER));
            if folder {
                let _ = fs::remove_dir(&self.path);
            }
        }
    }
}

/// Whether a folder holds the marker.
pub(super) fn is_marked(folder: &Path) -> Result<bool, StoreError> {
    Ok(read_marker(folder)?.is_some_and(|text| text == TEXT.as_bytes()))
}

/// Whether a folder holds a dataset, or is known as one of a build that has not ended.
pub fn is_dataset(folder: &Path) -> bool {
    folder.join(files::MANIFEST).is_file() || is_marked(folder).unwrap_or(false)
}

/// A value that changes when a folder's dataset is replaced; None without a manifest. Nothing is
/// read: by its file's number, length and time.
pub fn manifest_stamp(folder: &Path) -> Option<u64> {
    let found = fs::metadata(folder.join(files::MANIFEST)).ok()?;
    let mut hasher = DefaultHasher::new();
    (found.len(), found.modified().ok()).hash(&mut hasher);
    #[cfg(unix)]
    std::os::unix::fs::MetadataExt::ino(&found).hash(&mut hasher);
    Some(hasher.finish())
}

/// The content of the marker file; None if there is none, or something else of that name.
fn read_marker(folder: &Path) -> Result<Option<Vec<u8>>, StoreError> {
    let path = folder.join(MARKER);
    match kind_of(&path)? {
        Some(kind) if kind.is_file() => files::read_if_there(&path, 1 << 16),
        _ => Ok(None),
    }
}

fn refuse_other_files(folder: &Path) -> Result<(), StoreError> {
    let entries = list(folder)?;
    // A stop may have left a part of the marker.
    let is_torn = || Ok::<_, StoreError>(read_marker(folder)?.is_some_and(|text| TEXT.as_bytes().starts_with(&text)));
    let other = match &entries[..] {
        [] => return Ok(()),
        [only] if only.name == MARKER && is_torn()? => return Ok(()),
        [first, ..] => first.name.to_string_lossy().into_owned(),
    };
    let manifest = folder.join(files::MANIFEST);
    let is_dataset = kind_of(&manifest)?.is_some_and(|k| k.is_file())
        && files::read_if_there(&manifest, MAX_ROOT_BYTES as u64)
            .is_ok_and(|m| m.is_some_and(|m| m.starts_with(b"LDM")));
    Err(StoreError::NotOurs {
        path: folder.to_owned(),
        why: match is_dataset {
            true => format!(
                "it holds a dataset of an earlier version, without the file `{MARKER}`; remove the folder \
                 yourself, or name an empty or a new one"
            ),
            false => format!(
                "it holds {other:?} and is not known as a dataset's folder, which has the file `{MARKER}`; name an \
                 empty or a new one"
            ),
        },
    })
}

fn write_marker(folder: &Path) -> Result<(), StoreError> {
    let path = folder.join(MARKER);
    files::remove_if_there(&path)?;
    let mut file = change(&path, "create it", || File::create_new(&path))?;
    change(&path, "write", || file.write_all(TEXT.as_bytes()))?;
    change(&path, "sync it to the disk", || file.sync_all())?;
    files::sync_directory(folder)
}
