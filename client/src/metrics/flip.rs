//! FLIP: the visible difference between two pictures that alternate on a screen (Andersson et al.,
//! "FLIP: A Difference Evaluator for Alternating Images", HPG 2020), by NVIDIA's implementation.

use super::{MetricError, RgbImage};
use nv_flip::{FlipImageRgb8, flip};

/// Pixels per degree of the viewer's field of view: the authors' default, 0.7 m from a 0.7 m wide
/// screen of 3840 pixels.
pub const PIXELS_PER_DEGREE: f32 = 67.0;

/// The error of each pixel, 0 (alike) to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct FlipMap {
    errors: Vec<f32>,
}

impl FlipMap {
    /// Compares `test` with `truth`.
    pub fn new(truth: &RgbImage, test: &RgbImage) -> Result<Self, MetricError> {
        truth.same_size(test)?;
        let image = |p: &RgbImage| FlipImageRgb8::with_data(p.width, p.height, &p.rgb);
        Ok(Self { errors: flip(image(truth), image(test), PIXELS_PER_DEGREE).to_vec() })
    }

    /// One error per pixel, row by row.
    pub fn errors(&self) -> &[f32] {
        &self.errors
    }

    /// Mean over all pixels.
    pub fn mean(&self) -> f64 {
        self.errors.iter().map(|e| f64::from(*e)).sum::<f64>() / self.errors.len() as f64
    }

    /// Mean over the pixels whose index satisfies `wanted`; None if there is none.
    pub fn mean_where(&self, wanted: impl Fn(usize) -> bool) -> Option<f64> {
        let (sum, n) = self
            .errors
            .iter()
            .enumerate()
            .filter(|(i, _)| wanted(*i))
            .fold((0.0, 0u64), |(s, n), (_, e)| (s + f64::from(*e), n + 1));
        (n > 0).then(|| sum / n as f64)
    }
}
