//! Comparing saved pictures with the client's own metrics.

use anyhow::{Context as _, Result};
use ldi_client::metrics::{FlipMap, Picture};
use std::path::Path;

/// Mean FLIP of a picture against the truth, both files of one size.
///
/// # Errors
/// If a file cannot be read as a picture, or the sizes differ.
pub fn mean_flip(truth: &Path, test: &Path) -> Result<f64> {
    Ok(FlipMap::new(&read(truth)?, &read(test)?)?.mean())
}

fn read(path: &Path) -> Result<Picture> {
    let rgb = image::open(path).with_context(|| format!("{}", path.display()))?.to_rgb8();
    let (width, height) = rgb.dimensions();
    Ok(Picture::new(width, height, rgb.into_raw())?)
}
