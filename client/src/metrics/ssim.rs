//! Structural similarity after Wang, Bovik, Sheikh and Simoncelli ("Image Quality Assessment", IEEE
//! TIP 2004, equation 13): 11 x 11 Gaussian window of sigma 1.5, K1 = 0.01, K2 = 0.03, data range
//! 255; the mean over all positions where the window lies inside the picture. As in their reference
//! implementation it is taken on luma: Y = 0.299 R + 0.587 G + 0.114 B of the 8-bit codes, not
//! rounded.
//!
//! The window is separable: each of the five moments (x, y, x^2, y^2, xy) is filtered along rows,
//! then along columns. Rows of the result are independent and summed in order, so that the value
//! does not depend on the number of threads.

use super::{MetricError, RgbImage};
use rayon::prelude::*;

const WINDOW: usize = 11;
const SIGMA: f64 = 1.5;
const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);

/// Normalized weights of one axis of the window.
fn weights() -> [f32; WINDOW] {
    let raw: [f64; WINDOW] = std::array::from_fn(|i| (-(i as f64 - 5.0).powi(2) / (2.0 * SIGMA * SIGMA)).exp());
    let sum: f64 = raw.iter().sum();
    raw.map(|w| (w / sum) as f32)
}

fn luma(p: &RgbImage) -> Vec<f32> {
    // Centred on 128: variances are differences of moments, and smaller numbers cancel less.
    p.rgb
        .chunks_exact(3)
        .map(|c| 0.299 * f32::from(c[0]) + 0.587 * f32::from(c[1]) + 0.114 * f32::from(c[2]) - 128.0)
        .collect()
}

/// Mean SSIM in [-1, 1]; None for pictures smaller than the window.
pub fn ssim(a: &RgbImage, b: &RgbImage) -> Result<Option<f64>, MetricError> {
    a.same_size(b)?;
    let (width, height) = (a.width as usize, a.height as usize);
    if width < WINDOW || height < WINDOW {
        return Ok(None);
    }
    let (x, y, w) = (luma(a), luma(b), weights());
    let columns = width + 1 - WINDOW;
    // Per row, the five moments filtered along the row: planes of `columns` values.
    let along_rows: Vec<[Vec<f32>; 5]> = x
        .par_chunks_exact(width)
        .zip(y.par_chunks_exact(width))
        .map(|(x, y)| {
            let filter = |f: &dyn Fn(usize) -> f32| -> Vec<f32> {
                let values: Vec<f32> = (0..width).map(f).collect();
                let mut out = vec![0.0; columns];
                for (k, w) in w.iter().enumerate() {
                    for (o, v) in out.iter_mut().zip(&values[k..]) {
                        *o += w * v;
                    }
                }
                out
            };
            [
                filter(&|i| x[i]),
                filter(&|i| y[i]),
                filter(&|i| x[i] * x[i]),
                filter(&|i| y[i] * y[i]),
                filter(&|i| x[i] * y[i]),
            ]
        })
        .collect();
    let sums: Vec<f64> = (0..=height - WINDOW)
        .into_par_iter()
        .map(|row| {
            let mut moments: [Vec<f32>; 5] = std::array::from_fn(|_| vec![0.0; columns]);
            for (k, w) in w.iter().enumerate() {
                for (out, plane) in moments.iter_mut().zip(&along_rows[row + k]) {
                    for (o, v) in out.iter_mut().zip(plane) {
                        *o += w * v;
                    }
                }
            }
            (0..columns).map(|i| similarity(std::array::from_fn(|m| f64::from(moments[m][i])))).sum()
        })
        .collect();
    Ok(Some(sums.iter().sum::<f64>() / (columns * sums.len()) as f64))
}

/// Equation 13 from the moments E x, E y, E x^2, E y^2, E xy of values centred on 128.
fn similarity([x, y, xx, yy, xy]: [f64; 5]) -> f64 {
    let (mx, my) = (x + 128.0, y + 128.0);
    let (vx, vy, cov) = (xx - x * x, yy - y * y, xy - x * y);
    ((2.0 * mx * my + C1) * (2.0 * cov + C2)) / ((mx * mx + my * my + C1) * (vx + vy + C2))
}
