//! Peak signal-to-noise ratio over all channels of 8-bit sRGB.

use super::{MetricError, RgbImage};

/// Score of identical pictures, decibels: the true value is infinite, which a report cannot hold.
/// Every real difference scores lower.
pub const LARGEST_DB: f64 = 120.0;

/// 10 log10(255^2 / mean squared error), at most [`LARGEST_DB`].
pub fn psnr_db(a: &RgbImage, b: &RgbImage) -> Result<f64, MetricError> {
    a.same_size(b)?;
    let sum: u64 = a.rgb.iter().zip(&b.rgb).map(|(x, y)| u64::from(x.abs_diff(*y)).pow(2)).sum();
    let mean = sum as f64 / a.rgb.len() as f64;
    Ok(if sum == 0 { LARGEST_DB } else { (10.0 * (255.0 * 255.0 / mean).log10()).min(LARGEST_DB) })
}
