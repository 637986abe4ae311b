//! What `serve DATASET|FOLDER` serves: a dataset, or all datasets in a folder by their names.

use super::Failure;
use crate::serve::{ChunkSource, Datasets, NamedSources};
use crate::store::{self, Dataset, StoreError};
use ldi_protocol::said::{escaped, said};
use ldi_protocol::wire::MAX_NAME_CHARS;
use std::collections::BTreeSet;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// A dataset, or a folder of datasets.
#[derive(Debug)]
pub(super) struct OnDisk {
    path: PathBuf,
    /// What was said of folders that are not served, so that it is said once.
    said: Mutex<BTreeSet<String>>,
}

impl OnDisk {
    /// Nothing is read yet.
    pub fn new(path: PathBuf) -> Self {
        Self { path, said: Mutex::default() }
    }

    /// Opens what there is. A folder's datasets that cannot be opened are left out with a warning.
    ///
    /// # Errors
    /// Nothing can be opened; with `all` also if anything cannot.
    pub fn open_checked(&self, all: bool) -> Result<NamedSources, Failure> {
        let failed = |e: StoreError| Failure::of(e.permanent(), e);
        let folders = self.folders();
        if folders.is_empty() {
            // Its error says what is missing.
            let dataset = Dataset::open(&self.path).map_err(failed)?;
            return Ok(named(&self.path, dataset));
        }
        let mut sources = NamedSources::new();
        let mut first_error = None;
        for folder in folders {
            match Dataset::open(&folder) {
                Ok(dataset) => sources.extend(named(&folder, dataset)),
                Err(e) if all => return Err(failed(e)),
                Err(e) => {
                    self.warn_once(format!("not served: {}", said(&e)));
                    first_error.get_or_insert(e);
                }
            }
        }
        match first_error {
            Some(e) if sources.is_empty() => Err(failed(e)),
            _ => Ok(sources),
        }
    }

    /// Folders in the folder that hold datasets under names that clients can ask for; none if it is
    /// a dataset itself.
    fn folders(&self) -> Vec<PathBuf> {
        if store::is_dataset(&self.path) {
            return Vec::new();
        }
        let entries = std::fs::read_dir(&self.path).into_iter().flatten().flatten();
        let mut found: Vec<PathBuf> =
            entries.map(|e| e.path()).filter(|p| store::manifest_stamp(p).is_some()).collect();
        found.retain(|folder| {
            let is_name = folder.file_name().and_then(|n| n.to_str()).is_some_and(is_name);
            if !is_name {
                self.warn_once(format!(
                    "{}: not served: clients ask for a dataset by its folder's name, which has at most \
                     {MAX_NAME_CHARS} characters, no '#' and none that cannot be shown; rename it",
                    folder.display()
                ));
            }
            is_name
        });
        found.sort();
        found
    }

    fn warn_once(&self, text: String) {
        let mut said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
        if !said.contains(&text) {
            tracing::warn!("{text}");
            said.insert(text);
        }
    }
}

impl Datasets for OnDisk {
    fn open(&self) -> Result<NamedSources, String> {
        self.open_checked(false).map_err(|e| format!("{:#}", e.error))
    }

    fn stamp(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        let folders = self.folders();
        let all = if folders.is_empty() { std::slice::from_ref(&self.path) } else { &folders[..] };
        for folder in all {
            (folder, store::manifest_stamp(folder)).hash(&mut hasher);
        }
        hasher.finish()
    }
}

/// A dataset under the name of its folder.
fn named(folder: &Path, dataset: Dataset) -> NamedSources {
    // Of `.` and `..` too.
    let full = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = full.file_name().map_or_else(|| "dataset".into(), |n| n.to_string_lossy().into_owned());
    NamedSources::from([(name, Arc::new(dataset) as Arc<dyn ChunkSource>)])
}

/// Whether clients can ask for a dataset of this name: it is shown as it is, and `#` begins the
/// pose in links.
fn is_name(name: &str) -> bool {
    name.chars().count() <= MAX_NAME_CHARS && !name.contains('#') && escaped(name) == name
}
