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
    DiskCache::open(folder, cap_bytes).map(Arc::new).map_err(|e| Failure { code: 1, error: e.into() })
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
