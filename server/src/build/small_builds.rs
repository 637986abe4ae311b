//! What tests of whole builds share: a folder that goes away, and options of a build of seconds.

use super::{BuildOptions, Represent};
use crate::placement::test_scenes;
use ldi_protocol::codec::ColourProfile;
use std::{
    fs,
    path::{Path, PathBuf},
};

/// A folder that goes away with the test; in memory where there is such a place.
pub(super) struct Folder(pub PathBuf);

impl Folder {
    /// An empty one. `name` is that of the test.
    pub fn new(name: &str) -> Self {
        let memory = Path::new("/dev/shm");
        let parent = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
        let path = parent.join(format!("ldi-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    /// Writes a file; returns its path, as a build is given it.
    pub fn write(&self, name: &str, text: &str) -> String {
        let path = self.0.join(name);
        fs::write(&path, text).unwrap();
        path.display().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// A build of the LDI tree alone, of few samples.
pub(super) fn options(scenes: Vec<String>, output: &Path) -> BuildOptions {
    BuildOptions {
        scenes,
        output: output.to_owned(),
        settings: test_scenes::settings(100),
        budget: crate::build::BudgetRule::Given,
        colour: ColourProfile::Lossless,
        represent: Represent::Tree { pitch_m: 0.25, side: 24 },
        starts: Vec::new(),
        along: None,
        time_limit: None,
    }
}
