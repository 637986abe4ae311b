//! McMillan's warp as one 3 x 4 matrix.
//!
//! In: the LDI's camera, the pose and the output camera. Out: the matrix M with (X, Y, W) = M (u,
//! v, 1, d), so that a sample at image coordinates (u, v) with disparity d lands on output
//! coordinates (X/W, Y/W) with disparity d/W. It is the equation (X, Y, W) = P2^-1 P1 (u, v, 1) + d
//! P2^-1 (C1 - C2) with its two terms written side by side. The difference C1 - C2 is formed in f64
//! before anything else, so that the result does not depend on where in the world both cameras are.
//!
//! W is the eye-space depth over the LDI-space depth: a sample with W <= 0 lies behind the eye or
//! in its plane.

use glam::DVec3;
use ldi_protocol::{OutputCamera, Pose, ldi::LdiCamera};

/// The warp from LDI coordinates (u, v, 1, disparity) to homogeneous output pixels, all in f64.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WarpMatrix {
    /// Rows X, Y, W; columns u, v, 1, d. X and Y are in output pixels times W.
    pub rows: [[f64; 4]; 3],
}

/// A sample after the warp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Warped {
    /// Output column coordinate, pixels; pixel centres lie at +0.5.
    pub x: f64,
    /// Output row coordinate, pixels, downward.
    pub y: f64,
    /// 1 / eye-space depth, 1/m.
    pub disparity: f64,
}

impl WarpMatrix {
    /// The warp from `from` to the eye at `pose`.
    pub fn new(from: &LdiCamera, pose: &Pose, to: &OutputCamera) -> Self {
        let basis = pose.basis();
        let focal = to.focal_px();
        let centre = (f64::from(to.width) * 0.5, f64::from(to.height) * 0.5);
        // P2^-1 of a world direction.
        let project = |e: DVec3| {
            let w = e.dot(basis.forward);
            [e.dot(basis.right) * focal + w * centre.0, w * centre.1 - e.dot(basis.up) * focal, w]
        };
        let scale = 1.0 / from.pixels_per_unit;
        let columns = [
            project(from.basis.right * scale),
            project(from.basis.up * -scale),
            project(from.ray(0.0, 0.0)),
            project(from.cop - pose.position),
        ];
        Self { rows: std::array::from_fn(|r| std::array::from_fn(|c| columns[c][r])) }
    }

    /// (X, Y, W) of (u, v, 1, d).
    pub fn homogeneous(&self, u: f64, v: f64, disparity: f64) -> [f64; 3] {
        self.rows.map(|r| r[0] * u + r[1] * v + r[2] + r[3] * disparity)
    }

    /// The warped sample; None behind the eye or in its plane (W <= 0), and None at infinity
    /// (disparity 0 is sky).
    pub fn warp(&self, u: f64, v: f64, disparity: f64) -> Option<Warped> {
        let [x, y, w] = self.homogeneous(u, v, disparity);
        (w > 0.0 && disparity > 0.0).then(|| Warped { x: x / w, y: y / w, disparity: disparity / w })
    }

    /// d(x, y)/d(u, v) at fixed disparity, output pixels per LDI pixel: xu, xv, yu, yv. None where
    /// [`Self::warp`] has none.
    pub fn jacobian(&self, u: f64, v: f64, disparity: f64) -> Option<[f64; 4]> {
        let p = self.warp(u, v, disparity)?;
        let w = self.homogeneous(u, v, disparity)[2];
        let [rx, ry, rw] = &self.rows;
        Some([
            (rx[0] - p.x * rw[0]) / w,
            (rx[1] - p.x * rw[1]) / w,
            (ry[0] - p.y * rw[0]) / w,
            (ry[1] - p.y * rw[1]) / w,
        ])
    }

    /// The footprint of a sample, in output pixels: the largest singular value of
    /// [`Self::jacobian`].
    pub fn footprint(&self, u: f64, v: f64, disparity: f64) -> Option<f64> {
        self.jacobian(u, v, disparity).map(largest_singular_value)
    }
}

/// The largest singular value of a matrix, row by row.
pub fn largest_singular_value(m: [f64; 4]) -> f64 {
    let trace = m.iter().map(|e| e * e).sum::<f64>();
    let det = m[0] * m[3] - m[1] * m[2];
    (0.5 * (trace + (trace * trace - 4.0 * det * det).max(0.0).sqrt())).sqrt()
}
