//! Files with unique numbers: saving never replaces an existing file.

use std::{
    fs::{File, OpenOptions},
    io::ErrorKind,
    path::{Path, PathBuf},
};

/// Highest number in a file name: five digits.
const MOST: u32 = 99_999;

/// Describes an error of a file in the folder of `--shots`, with its remedy.
pub fn describe_error(path: &Path, e: &dyn std::fmt::Display) -> String {
    format!("{}: {e}; give a folder that can be written with --shots", path.display())
}

/// Creates `before`0001`after` in a folder, or the first free number after it, and the folder.
/// Never opens an existing file: two windows may share a folder.
///
/// # Errors
/// If the folder cannot be written, or no number is free.
pub fn first_free(folder: &Path, before: &str, after: &str) -> Result<(File, PathBuf), String> {
    std::fs::create_dir_all(folder).map_err(|e| describe_error(folder, &e))?;
    for number in 1..=MOST {
        let path = folder.join(format!("{before}{number:04}{after}"));
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
            Err(e) => return Err(describe_error(&path, &e)),
            Ok(file) => return Ok((file, path)),
        }
    }
    Err(format!("{}: there are {MOST} such files already; give another folder with --shots", folder.display()))
}
