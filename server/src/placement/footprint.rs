//! How large can a sample of an image get on the screen?
//!
//! The footprint is the largest singular value of d(u2, v2) / d(u1, v1) at fixed disparity: how
//! far two samples that are one pixel apart in the LDI, at one depth, can lie apart in the output
//! picture.
//!
//! A pixel step in the LDI at depth z1 moves a point by z1 / f1 within the plane perpendicular to
//! the image's axis c. Seen from an eye E that looks along d, phi away from c, the point has depth
//! z along d and tangent tau from the picture's middle, at most that of the corner, tau_c. The
//! projection's derivative for a unit step with component sin a along d (a <= phi) is at most f2 /
//! z (cos a + tau sin a). And with e = (E - cop) . c, the depth along c is z1 - e = z (d . c +
//! ...) <= z (cos phi + tau sin phi). So
//!
//! ```text
//!   footprint <= (f2 / f1) k^2 z1 / (z1 - e),    k = cos phi + tau_c sin phi for phi < atan tau_c, else 1 / cos atan tau_c
//! ```
//!
//! which falls with z1 where e > 0: the plane's distance D and the largest e give the bound of an
//! image.

use ldi_protocol::OutputCamera;

/// Footprint bounds for one output camera.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Footprint {
    /// Tangent from the picture's middle to its corner.
    corner_tan: f64,
    /// Largest footprint allowed, output pixels.
    pub limit_px: f64,
    /// Focal length of the output, pixels.
    pub focal_px: f64,
    /// LDI samples per output pixel at scale 1.
    density: f64,
}

/// Sampling densities to choose from, relative to the build's. Higher ones let users come nearer
/// to the plane, at the square of the samples; above 1.5 a finer grid is cheaper.
pub(crate) const SCALES: [f64; 4] = [1.0, 1.15, 1.3, 1.5];

impl Footprint {
    /// Bounds for pictures of `camera` from LDIs of `density` samples per output pixel.
    pub fn new(camera: &OutputCamera, density: f64, limit_px: f64) -> Self {
        let corner_tan = camera.half_tan_x().hypot(camera.half_tan_y());
        Self { corner_tan, limit_px, focal_px: camera.focal_px(), density }
    }

    /// The factor k^2 for directions up to `phi` radians away from the image's axis.
    fn turn_factor(&self, phi: f64) -> f64 {
        let k = if phi < self.corner_tan.atan() {
            phi.cos() + self.corner_tan * phi.sin()
        } else {
            self.corner_tan.hypot(1.0)
        };
        k * k
    }

    /// The bound for an image whose plane is `plane_m` ahead of its centre of projection, of eyes
    /// up to `ahead_m` ahead of it that look up to `phi` radians away from its axis. Infinite when
    /// an eye may reach the plane.
    pub fn bound_px(&self, scale: f64, phi: f64, plane_m: f64, ahead_m: f64) -> f64 {
        if plane_m <= 0.0 || ahead_m >= plane_m {
            return f64::INFINITY;
        }
        let magnification = if ahead_m > 0.0 { plane_m / (plane_m - ahead_m) } else { 1.0 };
        // One part in 10^9 for rounding.
        self.turn_factor(phi) * magnification / (self.density * scale) * (1.0 + 1e-9)
    }

    /// The smallest scale whose bound keeps the limit, and that bound.
    pub fn scale(&self, phi: f64, plane_m: f64, ahead_m: f64) -> Option<(f64, f64)> {
        SCALES.iter().map(|s| (*s, self.bound_px(*s, phi, plane_m, ahead_m))).find(|(_, bound)| *bound <= self.limit_px)
    }

    /// The smallest distance from the centre of projection at which a plane can keep the limit;
    /// None when no distance can.
    pub fn nearest_plane_m(&self, phi: f64, ahead_m: f64) -> Option<f64> {
        let largest = SCALES[SCALES.len() - 1];
        let allowed = self.limit_px * self.density * largest / (self.turn_factor(phi) * (1.0 + 2e-9));
        // D / (D - e) <= allowed.
        (allowed > 1.0).then(|| (ahead_m.max(0.0) * allowed / (allowed - 1.0)).max(1e-3))
    }

    /// LDI samples per unit of the image plane at distance 1.
    pub fn pixels_per_unit(&self, scale: f64) -> f64 {
        self.focal_px * self.density * scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use ldi_protocol::ViewBasis;
    use proptest::prelude::*;

    /// Largest singular value of the LDI-to-picture map at fixed disparity, by central differences.
    fn measured(camera: &OutputCamera, image: &ViewBasis, f1: f64, p: DVec3, eye: DVec3, view: &ViewBasis) -> f64 {
        let z1 = p.dot(image.forward);
        let project = |q: DVec3| {
            let v = q - eye;
            let z = v.dot(view.forward);
            (v.dot(view.right) / z * camera.focal_px(), v.dot(view.up) / z * camera.focal_px())
        };
        let h = 1e-5;
        let column = |side: DVec3| {
            let (a, b) = (project(p + side * (z1 / f1 * h)), project(p - side * (z1 / f1 * h)));
            ((a.0 - b.0) / (2.0 * h), (a.1 - b.1) / (2.0 * h))
        };
        let (a, b) = (column(image.right), column(image.up));
        let (m, n, k) = (a.0 * a.0 + a.1 * a.1, b.0 * b.0 + b.1 * b.1, a.0 * b.0 + a.1 * b.1);
        ((m + n + ((m - n).powi(2) + 4.0 * k * k).sqrt()) * 0.5).sqrt()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        #[test]
        fn the_bound_holds(
            yaw in -40.0f64..40.0, pitch in -40.0f64..40.0, eye in prop::array::uniform3(-3.0f64..3.0),
            plane in 3.5f64..20.0, beyond in 0.0f64..30.0, picture in prop::array::uniform2(-1.0f64..=1.0),
        ) {
            let camera = OutputCamera { width: 1280, height: 720, fov_deg: 60.0 };
            let footprint = Footprint::new(&camera, 1.0, 2.0);
            let image = ViewBasis::from_yaw_pitch(0.0, 0.0);
            let view = ViewBasis::from_yaw_pitch(yaw, pitch);
            let eye = DVec3::from_array(eye);
            let phi = image.forward.dot(view.forward).clamp(-1.0, 1.0).acos();
            // A point in the picture, at a depth along c beyond the plane.
            let ray = view.forward + view.right * (picture[0] * camera.half_tan_x()) + view.up * (picture[1] * camera.half_tan_y());
            let along = ray.dot(image.forward);
            prop_assume!(along > 0.05);
            let ahead = eye.dot(image.forward);
            let p = eye + ray * ((plane + beyond - ahead) / along);
            let bound = footprint.bound_px(1.3, phi, plane, ahead);
            let value = measured(&camera, &image, footprint.pixels_per_unit(1.3), p, eye, &view);
            prop_assert!(value <= bound * (1.0 + 1e-6), "{value} > {bound}");
        }
    }

    #[test]
    fn the_bound_is_reached_straight_ahead() {
        let camera = OutputCamera { width: 1280, height: 720, fov_deg: 60.0 };
        let footprint = Footprint::new(&camera, 1.0, 2.0);
        let b = ViewBasis::from_yaw_pitch(0.0, 0.0);
        let value = measured(&camera, &b, footprint.pixels_per_unit(1.0), b.forward * 4.0, b.forward * 2.0, &b);
        assert!((value - 2.0).abs() < 1e-6 && (footprint.bound_px(1.0, 0.0, 4.0, 2.0) - 2.0).abs() < 1e-6);
    }

    #[test]
    fn the_nearest_plane_keeps_the_limit_and_a_nearer_one_does_not() {
        let footprint = Footprint::new(&OutputCamera { width: 1280, height: 720, fov_deg: 60.0 }, 1.0, 2.0);
        let d = footprint.nearest_plane_m(0.2, 3.0).unwrap();
        assert!(footprint.scale(0.2, d, 3.0).is_some());
        assert!(footprint.scale(0.2, d * 0.999, 3.0).is_none());
        assert!(footprint.scale(0.2, 2.9, 3.0).is_none(), "the plane is behind an eye");
    }
}
