//! Pictures of few colours as PNG.

use image::{
    ExtendedColorType, ImageEncoder as _, ImageError,
    codecs::png::{CompressionType, FilterType, PngEncoder},
};

/// Encodes a picture with opacity. Without the filters of photographs, which make areas of one
/// colour longer.
///
/// # Errors
/// If the picture has another number of bytes than its size says.
pub(crate) fn encode([width, height]: [u32; 2], rgba: &[u8]) -> Result<Vec<u8>, ImageError> {
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::NoFilter);
    encoder.write_image(rgba, width, height, ExtendedColorType::Rgba8)?;
    Ok(bytes)
}
