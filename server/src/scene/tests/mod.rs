//! Tests of the whole import: files in, scenes or errors out.

mod fuzz;
mod gltf_file;
mod hostile;
mod hostile_gltf;
#[cfg(feature = "ifc")]
mod hostile_ifc;
mod hostile_looks;
mod hostile_text;
#[cfg(feature = "ifc")]
mod ifc;
#[cfg(feature = "ifc")]
mod ifc_text;
mod limits;
mod picture_files;
mod pictures;
mod placement;
mod repaired;
mod several;
mod shared_inputs;
mod shared_scenes;
mod valid;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// A folder of its own for each test, gone with it.
pub(super) struct Folder(PathBuf);

impl Folder {
    pub(super) fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let name = format!("ldi-scene-{}-{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let path = std::env::temp_dir().join(name);
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(super) fn path(&self) -> &Path {
        &self.0
    }

    /// Writes a file and returns its path as text.
    pub(super) fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> String {
        let path = self.0.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, bytes).unwrap();
        path.display().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // A folder that stays behind harms nobody.
        let _ = fs::remove_dir_all(&self.0);
    }
}
