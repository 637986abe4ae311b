//! Measured rendering costs of this machine, milliseconds (Shade et al. 1996, section 2: costs are
//! found by experiment).

use super::image::OVERSAMPLED;

/// Weight of a new measurement. Larger: disturbed by single frames; smaller: adapts slowly.
const NEW: f64 = 0.1;
/// Measurements with fewer triangles are dominated by fixed costs, and ignored.
const FEW_TRIANGLES: u64 = 10_000;
/// Measurements with fewer pixels are ignored.
const FEW_PIXELS: u64 = 10_000;

/// Running means, milliseconds.
#[derive(Debug, Clone, Copy)]
pub struct Costs {
    /// Cost of a triangle; None before the first measurement.
    triangle: Option<f64>,
    /// Cost of a pixel of the picture covered by an image.
    image_pixel: f64,
    /// Cost of a pixel of an image being made.
    made_pixel: f64,
}

impl Default for Costs {
    /// Costs of pixels are estimated until the first measurement.
    fn default() -> Self {
        Self { triangle: None, image_pixel: 1e-5, made_pixel: 4e-5 }
    }
}

fn mean(old: f64, new: f64) -> f64 {
    old + NEW * (new - old)
}

impl Costs {
    /// Whether the cost of geometry was measured.
    pub fn are_known(&self) -> bool {
        self.triangle.is_some()
    }

    /// Records the time of drawing triangles.
    pub fn drew_geometry(&mut self, ms: f64, triangles: u64) {
        if triangles >= FEW_TRIANGLES {
            let new = ms / triangles as f64;
            self.triangle = Some(self.triangle.map_or(new, |old| mean(old, new)));
        }
    }

    /// Records the time of drawing images.
    pub fn drew_images(&mut self, ms: f64, pixels: u64) {
        if pixels >= FEW_PIXELS {
            self.image_pixel = mean(self.image_pixel, ms / pixels as f64);
        }
    }

    /// Records the time of making an image.
    pub fn made_image(&mut self, ms: f64, triangles: u64, pixels: u64) {
        let rest = (ms - self.geometry_ms(triangles)).max(0.0);
        self.made_pixel = mean(self.made_pixel, rest / pixels as f64);
    }

    /// Expected time of drawing triangles, milliseconds.
    pub fn geometry_ms(&self, triangles: u64) -> f64 {
        self.triangle.unwrap_or(0.0) * triangles as f64
    }

    /// Expected time of drawing an image, milliseconds.
    pub fn image_ms(&self, pixels: u64) -> f64 {
        self.image_pixel * pixels as f64 / (OVERSAMPLED * OVERSAMPLED)
    }

    /// Expected time of making an image beyond drawing its content, milliseconds.
    pub fn making_ms(&self, pixels: u64) -> f64 {
        self.made_pixel * pixels as f64
    }
}

#[cfg(test)]
impl Costs {
    /// A fixed cost per triangle, which outweighs measured costs.
    pub fn fixed(triangle: f64) -> Self {
        Self { triangle: Some(triangle), image_pixel: 1e-9, made_pixel: 1e-9 }
    }
}
