//! Small text files of the user: settings, bookmarks.
//!
//! A file is read up to a bound, and replaced as a whole: written to a temporary file beside it,
//! then renamed.

use std::{
    io::Read as _,
    path::{Path, PathBuf},
};

/// Largest file that is read. Settings and ten poses need far less.
const MAX_BYTES: u64 = 64 << 10;

/// A file in the user's configuration folder. None without a home folder.
pub fn in_configuration(name: impl AsRef<Path>) -> Option<PathBuf> {
    Some(directories::ProjectDirs::from("", "", "ldi")?.config_dir().join(name))
}

/// Reads a file. None: there is none.
///
/// # Errors
/// If it cannot be read, or is too long.
pub fn read(file: &Path) -> Result<Option<String>, String> {
    let described = |e: &dyn std::fmt::Display| format!("{}: {e}; mend or remove it", file.display());
    let mut text = String::new();
    match std::fs::File::open(file) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(described(&e)),
        Ok(open) => open.take(MAX_BYTES + 1).read_to_string(&mut text).map_err(|e| described(&e))?,
    };
    if text.len() as u64 > MAX_BYTES {
        return Err(described(&format!("more than {MAX_BYTES} bytes are too many")));
    }
    Ok(Some(text))
}

/// Replaces a file, and makes its folder.
///
/// # Errors
/// If it cannot be written.
pub fn replace(file: &Path, text: &str) -> Result<(), String> {
    let described = |path: &Path, e: std::io::Error| format!("{}: {e}; make it writable", path.display());
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).map_err(|e| described(folder, e))?;
    }
    let beside = file.with_extension(format!("{}.tmp", std::process::id()));
    std::fs::write(&beside, text).map_err(|e| described(&beside, e))?;
    std::fs::rename(&beside, file).map_err(|e| described(file, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_replaced_and_their_length_is_bounded() {
        let folder = std::env::temp_dir().join(format!("ldi-user-file-{}", std::process::id()));
        let file = folder.join("deeper").join("settings.json");
        assert_eq!(read(&file), Ok(None));
        for text in ["first", "second"] {
            replace(&file, text).expect("written");
            assert_eq!(read(&file), Ok(Some(text.into())));
        }
        let beside = std::fs::read_dir(file.parent().expect("a folder")).expect("readable").count();
        assert_eq!(beside, 1, "no temporary file is left");
        replace(&file, &"x".repeat(MAX_BYTES as usize + 1)).expect("written");
        let e = read(&file).expect_err("too long");
        assert!(e.contains("settings.json") && e.contains("remove"), "{e}");
        let e = replace(&file.join("below"), "").expect_err("below a file");
        assert!(e.contains("settings.json"), "{e}");
        std::fs::remove_dir_all(&folder).expect("removed");
    }
}
