//! Arguments and files that several commands read.

use super::failure::Failure;
use anyhow::Context;
use ldi_client::{near::MAX_SIDE_PX, stream::DiskCache};
use ldi_protocol::path;
use std::{path::Path, sync::Arc};

/// Longest shared secret in a file, bytes.
const MAX_TOKEN_BYTES: u64 = 1024;

/// Opens the disk cache.
pub fn disk(folder: &Path, cap_bytes: u64) -> Result<Arc<DiskCache>, Failure> {
    check_folder(folder, "--disk-cache")?;
    DiskCache::open(folder, cap_bytes).map(Arc::new).map_err(|e| Failure { code: 1, error: e.into() })
}

/// Checks that a folder is there or can be: neither it nor a folder above it is a file.
pub fn check_folder(folder: &Path, option: &str) -> Result<(), Failure> {
    match folder.ancestors().find(|p| p.symlink_metadata().is_ok()).filter(|p| !p.is_dir()) {
        None => Ok(()),
        Some(file) => Err(Failure::permanent(anyhow::anyhow!(
            "{option} {}: {} is a file; name another folder",
            folder.display(),
            file.display()
        ))),
    }
}

/// Checks that a file can be written: its folder is there, and it is no folder itself.
pub fn check_file(file: &Path, option: &str) -> Result<(), Failure> {
    let folder = file.parent().filter(|p| !p.as_os_str().is_empty());
    let why = match folder {
        _ if file.is_dir() => "it is a folder; name a file".to_owned(),
        Some(folder) if folder.exists() && !folder.is_dir() => {
            format!("{} is a file; name another folder", folder.display())
        }
        Some(folder) if !folder.exists() => format!("there is no folder {}; make it first", folder.display()),
        _ => return Ok(()),
    };
    Err(Failure::permanent(anyhow::anyhow!("{option} {}: {why}", file.display())))
}

pub fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let (w, h) = text.split_once('x').ok_or("give WxH, like 1280x720")?;
    let side = |s: &str| s.parse::<u32>().ok().filter(|n| (1..=MAX_SIDE_PX / 2).contains(n));
    side(w).zip(side(h)).ok_or_else(|| format!("width and height lie in 1 ..= {}", MAX_SIDE_PX / 2))
}

pub fn read_path(file: &Path) -> Result<path::Walk, Failure> {
    std::fs::File::open(file)
        .map_err(path::PathError::from)
        .and_then(|open| path::read(open, |told| tracing::warn!("{}: {told}", file.display())))
        .with_context(|| format!("{}: cannot be walked", file.display()))
        .map_err(Failure::permanent)
}

/// Reads the shared secret from the file or the environment.
pub fn token(file: Option<&Path>) -> Result<Option<String>, Failure> {
    let from_file = file.map(read_token).transpose().map_err(Failure::permanent)?;
    Ok(from_file.or_else(|| std::env::var("LDI_TOKEN").ok().filter(|t| !t.is_empty())))
}

fn read_token(path: &Path) -> anyhow::Result<String> {
    let bytes = std::fs::metadata(path).with_context(|| format!("{}: cannot be read", path.display()))?.len();
    anyhow::ensure!(
        bytes <= MAX_TOKEN_BYTES,
        "{}: {bytes} bytes; a token has at most {MAX_TOKEN_BYTES}",
        path.display()
    );
    let token = std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    Ok(token.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_in_the_way_of_folders_are_named() {
        let folder = std::env::temp_dir().join(format!("ldi-input-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let file = folder.join("frames");
        std::fs::write(&file, "").expect("written");
        assert!(check_folder(&folder, "-o").is_ok() && check_folder(&folder.join("new/deep"), "-o").is_ok());
        assert!(check_file(&file, "--report").is_ok() && check_file(&folder.join("new"), "--report").is_ok());
        let said = |r: Result<(), Failure>| r.map_err(|e| (e.code, e.error.to_string())).expect_err("refused");
        for place in [file.clone(), file.join("below/it")] {
            let (code, text) = said(check_folder(&place, "-o"));
            assert!(code == 42 && text.contains(&format!("{} is a file", file.display())), "{text}");
        }
        for (place, part) in
            [(&file.join("r.json"), "is a file"), (&folder, "it is a folder"), (&folder.join("a/b"), "make it first")]
        {
            let (code, text) = said(check_file(place, "--report"));
            assert!(code == 42 && text.contains(part), "{text}");
        }
        std::fs::remove_dir_all(&folder).expect("removed");
    }
}
