//! What goes into the caster and what comes out.

use glam::DVec3;

/// A ray: the points `origin + t * direction`, `t_min <= t <= t_max`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// World, metres.
    pub origin: DVec3,
    /// Any length but zero; t counts in it. With the rays of [`ldi_protocol::OutputCamera::ray`] t
    /// is the eye-space depth.
    pub direction: DVec3,
    /// Hits before it are not seen.
    pub t_min: f64,
    /// Hits beyond it are not seen; may be infinite.
    pub t_max: f64,
}

impl Ray {
    /// The whole half line.
    pub fn new(origin: DVec3, direction: DVec3) -> Self {
        Self { origin, direction, t_min: 0.0, t_max: f64::INFINITY }
    }

    /// The point at `t`.
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin + self.direction * t
    }
}

/// Where a ray first meets the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// In units of the ray's direction; computed in f64 from the triangle's plane.
    pub t: f64,
    /// Number of the triangle in the expanded scene: instance after instance, primitive after
    /// primitive, in file order.
    pub triangle: u32,
    /// Barycentric weight of the triangle's second vertex.
    pub u: f32,
    /// Barycentric weight of its third vertex; the first has `1 - u - v`.
    pub v: f32,
}

/// How the direction of a ray changes from pixel to pixel, for filtering textures by the pixel's
/// footprint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayFootprint {
    /// Change of `direction` toward the next column.
    pub direction_dx: DVec3,
    /// Change of `direction` toward the next row.
    pub direction_dy: DVec3,
}
