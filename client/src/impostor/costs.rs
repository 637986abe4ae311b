//! What drawing costs on the machine that it runs on, in milliseconds (Shade et al. 1996, section 2: costs are found by experiment).

use super::image::OVERSAMPLED;

/// Weight of a new measurement: ten frames, as single ones are held up by other work.
const NEW: f64 = 0.1;
/// Fewer triangles say nothing: starting and clearing take as long.
const FEW_TRIANGLES: u64 = 10_000;
/// Fewer pixels say nothing.
const FEW_PIXELS: u64 = 10_000;

/// Running means, milliseconds.
#[derive(Debug, Clone, Copy)]
pub struct Costs {
    /// Of a triangle; None before any was drawn.
    triangle: Option<f64>,
    /// Of a pixel of the picture that an image covers.
    image_pixel: f64,
    /// Of a pixel of an image that is made.
    made_pixel: f64,
}

impl Default for Costs {
    /// Pixels are guessed until the first is drawn: some ten nanoseconds.
    fn default() -> Self {
        Self { triangle: None, image_pixel: 1e-5, made_pixel: 4e-5 }
    }
}

fn mean(old: f64, new: f64) -> f64 {
    old + NEW * (new - old)
}

impl Costs {
    /// Whether geometry was measured.
    pub fn are_known(&self) -> bool {
        self.triangle.is_some()
    }

    /// So many triangles took so long.
    pub fn drew_geometry(&mut self, ms: f64, triangles: u64) {
        if triangles >= FEW_TRIANGLES {
            let new = ms / triangles as f64;
            self.triangle = Some(self.triangle.map_or(new, |old| mean(old, new)));
        }
    }

    /// Images took so long that cover so many pixels.
    pub fn drew_images(&mut self, ms: f64, pixels: u64) {
        if pixels >= FEW_PIXELS {
            self.image_pixel = mean(self.image_pixel, ms / pixels as f64);
        }
    }

    /// An image of so many pixels took so long to make from so many triangles.
    pub fn made_image(&mut self, ms: f64, triangles: u64, pixels: u64) {
        let rest = (ms - self.geometry_ms(triangles)).max(0.0);
        self.made_pixel = mean(self.made_pixel, rest / pixels as f64);
    }

    /// Drawing triangles, milliseconds.
    pub fn geometry_ms(&self, triangles: u64) -> f64 {
        self.triangle.unwrap_or(0.0) * triangles as f64
    }

    /// Drawing an image of so many pixels, milliseconds.
    pub fn image_ms(&self, pixels: u64) -> f64 {
        self.image_pixel * pixels as f64 / (OVERSAMPLED * OVERSAMPLED)
    }

    /// Making one, beside drawing what it shows, milliseconds.
    pub fn making_ms(&self, pixels: u64) -> f64 {
        self.made_pixel * pixels as f64
    }
}

#[cfg(test)]
impl Costs {
    /// So many milliseconds per triangle, and nothing that is measured matters much.
    pub fn fixed(triangle: f64) -> Self {
        Self { triangle: Some(triangle), image_pixel: 1e-9, made_pixel: 1e-9 }
    }
}
