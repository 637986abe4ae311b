//! Malformed and hostile files: each gives an error that names the file and says what is wrong,
//! quickly, without a panic and without much memory.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::super::load;
use super::{Folder, hostile_gltf, hostile_looks, hostile_text};

/// One bad file.
pub(super) struct Case {
    pub(super) name: &'static str,
    /// What the message must say, besides the file's name.
    pub(super) says: &'static str,
    /// Writes the file, and what it needs beside it; returns its path.
    pub(super) write: Box<dyn Fn(&Folder) -> String>,
}

impl Case {
    pub(super) fn new(name: &'static str, says: &'static str, write: impl Fn(&Folder) -> String + 'static) -> Self {
        Self { name, says, write: Box::new(write) }
    }
}

/// Largest resident size of this process so far, bytes.
fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? * 1024)
}

#[test]
fn every_bad_file_gives_a_clear_error() {
    /// Far above what the small files here need, far below what they claim.
    const MOST_BYTES: u64 = 1 << 30;
    let cases = [
        hostile_gltf::cases(),
        hostile_looks::cases(),
        hostile_text::cases(),
        #[cfg(feature = "ifc")]
        super::hostile_ifc::cases(),
    ];
    let cases: Vec<Case> = cases.into_iter().flatten().collect();
    assert!(cases.len() >= 100, "{} cases", cases.len());
    let before = peak_bytes();
    let mut failures = Vec::new();
    for case in &cases {
        let folder = Folder::new();
        let path = (case.write)(&folder);
        // The file's name, or the built-in scene's without parameters.
        let file = path.rsplit('/').next().unwrap().split('?').next().unwrap();
        match catch_unwind(AssertUnwindSafe(|| load(&path))) {
            Err(_) => failures.push(format!("{}: panicked", case.name)),
            Ok(Ok(_)) => failures.push(format!("{}: was loaded", case.name)),
            Ok(Err(error)) => {
                let message = error.to_string();
                if !message.contains(file) || !message.contains(case.says) || message.len() > 600 {
                    failures.push(format!("{}: message does not say \"{}\": {message}", case.name, case.says));
                }
            }
        }
    }
    assert!(failures.is_empty(), "{} of {} cases:\n{}", failures.len(), cases.len(), failures.join("\n"));
    if let (Some(before), Some(after)) = (before, peak_bytes()) {
        assert!(after - before < MOST_BYTES, "{} bytes", after - before);
    }
    let mut names: Vec<_> = cases.iter().map(|c| c.name).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), cases.len(), "two cases share a name");
}
