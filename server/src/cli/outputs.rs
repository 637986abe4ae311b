//! Files and folders that commands write, and what is said where they cannot.

use super::Failure;
use anyhow::anyhow;
use ldi_protocol::said::is_lasting;
use std::io::{self, Write as _};
use std::path::Path;

pub(super) fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    std::fs::write(path, bytes).map_err(|e| cannot_write(path, e))
}

pub(super) fn write_json(path: &Path, value: &serde_json::Value) -> Result<(), Failure> {
    write_file(path, format!("{value:#}\n").as_bytes())
}

/// Makes a folder and those above it, unless they are there.
pub(super) fn make_folder(path: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(path).map_err(|e| {
        let remedy = match file_in_the_way(path) {
            Some(file) => format!("{} is a file; name another folder", file.display()),
            None => "name a folder that can be written".into(),
        };
        // A folder that is there is no error, so that what is there already is a file.
        Failure::of(is_lasting(&e), anyhow!("{}: cannot be made: {e}; {remedy}", path.display()))
    })
}

/// A file that cannot be written.
pub(super) fn cannot_write(path: &Path, e: io::Error) -> Failure {
    let parent = path.parent().filter(|p| !p.as_os_str().is_empty());
    let remedy = match (file_in_the_way(path), parent) {
        (Some(file), _) if file != path => format!("{} is a file; name another folder", file.display()),
        _ if path.is_dir() => "it is a folder; name a file".into(),
        (_, Some(parent)) if !parent.exists() => format!("there is no folder {}; make it first", parent.display()),
        _ if is_lasting(&e) => "name a file in a folder that can be written".into(),
        _ => "make room on the disk and try again".into(),
    };
    Failure::of(is_lasting(&e), anyhow!("cannot write {}: {e}; {remedy}", path.display()))
}

/// The file at a path or above it, where a folder would have to be.
fn file_in_the_way(path: &Path) -> Option<&Path> {
    path.ancestors().find(|p| p.symlink_metadata().is_ok()).filter(|p| !p.is_dir())
}

/// Whether a file can be written, found out before the work whose result it is to hold.
pub(super) fn check_writable(path: &Path) -> Result<(), Failure> {
    let is_new = !path.exists();
    std::fs::OpenOptions::new().create(true).append(true).open(path).map_err(|e| cannot_write(path, e))?;
    if is_new {
        let _ = std::fs::remove_file(path);
    }
    Ok(())
}

/// A line to stdout; a reader that has gone is no failure.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    match writeln!(io::stdout().lock(), "{text}") {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(Failure::of(false, e)),
        _ => Ok(()),
    }
}
