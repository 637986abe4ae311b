//! Picture quality metrics: PSNR, SSIM and FLIP, over 8-bit sRGB.
//!
//! In: two pictures of one size, as RGB bytes row by row. Out: scores, and for FLIP the error of
//! every pixel, so that means over parts of the picture (warped pixels) can be taken.

mod flip;
mod psnr;
mod ssim;

pub use flip::{FlipMap, PIXELS_PER_DEGREE};
pub use psnr::{LARGEST_DB, psnr_db};
pub use ssim::ssim;

/// A picture of RGB bytes; the constructor checks the length.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RgbImage {
    width: u32,
    height: u32,
    rgb: Vec<u8>,
}

/// The pictures cannot be compared.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MetricError {
    /// The number of bytes is not three per pixel.
    #[error("a picture of {width} x {height} pixels has {bytes} bytes; three per pixel are expected")]
    Length {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes given.
        bytes: usize,
    },
    /// Different sizes.
    #[error("the pictures measure {0:?} and {1:?} pixels; render the truth with the walk's --size")]
    Size((u32, u32), (u32, u32)),
}

impl RgbImage {
    /// Takes `3 * width * height` bytes.
    pub fn new(width: u32, height: u32, rgb: Vec<u8>) -> Result<Self, MetricError> {
        if rgb.is_empty() || rgb.len() as u64 != 3 * u64::from(width) * u64::from(height) {
            return Err(MetricError::Length { width, height, bytes: rgb.len() });
        }
        Ok(Self { width, height, rgb })
    }

    /// Columns and rows.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// The bytes, row by row.
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    fn same_size(&self, other: &Self) -> Result<(), MetricError> {
        if self.size() == other.size() { Ok(()) } else { Err(MetricError::Size(self.size(), other.size())) }
    }
}

#[cfg(test)]
mod tests;
