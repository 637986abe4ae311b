//! Poses, view bases, the output camera and the view frusta.

use crate::Aabb;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Where an eye is and where it looks; roll is 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Eye position in the world, metres.
    pub position: DVec3,
    /// Degrees; 0 looks along -Z, positive turns left.
    pub yaw_deg: f64,
    /// Degrees; positive looks up, in [-90, 90].
    pub pitch_deg: f64,
}

impl Pose {
    /// The pose's orthonormal basis.
    pub fn basis(&self) -> ViewBasis {
        ViewBasis::from_yaw_pitch(self.yaw_deg, self.pitch_deg)
    }
}

/// The turn from one heading to another, degrees, the shorter way: -180 to 180.
pub fn apart_deg(from: f64, to: f64) -> f64 {
    (to - from + 180.0).rem_euclid(360.0) - 180.0
}

/// Orthonormal, right-handed: `right x up = -forward`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ViewBasis {
    /// Unit vector toward growing columns.
    pub right: DVec3,
    /// Unit vector toward shrinking rows.
    pub up: DVec3,
    /// Unit vector into the scene.
    pub forward: DVec3,
}

impl ViewBasis {
    /// The basis of a direction. At yaw 0, pitch 0: right = +X, up = +Y, forward = -Z.
    pub fn from_yaw_pitch(yaw_deg: f64, pitch_deg: f64) -> Self {
        let (sy, cy) = yaw_deg.to_radians().sin_cos();
        let (sp, cp) = pitch_deg.to_radians().sin_cos();
        let ahead = DVec3::new(-sy, 0.0, -cy);
        Self { right: DVec3::new(cy, 0.0, -sy), up: DVec3::Y * cp - ahead * sp, forward: ahead * cp + DVec3::Y * sp }
    }
}

/// The pinhole camera of the picture on the screen: square pixels, principal point in the middle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OutputCamera {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Horizontal field of view, degrees.
    pub fov_deg: f64,
}

impl OutputCamera {
    /// Focal length in pixels.
    pub fn focal_px(&self) -> f64 {
        f64::from(self.width) * 0.5 / self.half_tan_x()
    }

    /// How far a place may move in the picture that moves by `moved_m` at `distance_m` from the
    /// eye, pixels: `focal moved k^2 / distance`, where k is the length of the longest ray to the
    /// picture's corners at depth 1. The largest singular value of the projection at depth z is
    /// `focal k / z`, and the distance is at most k z.
    pub fn displacement_px(&self, moved_m: f64, distance_m: f64) -> f64 {
        let k2 = 1.0 + self.half_tan_x().powi(2) + self.half_tan_y().powi(2);
        moved_m * self.focal_px() * k2 / distance_m
    }
    /// Tangent of half the horizontal field of view.
    pub fn half_tan_x(&self) -> f64 {
        (self.fov_deg.to_radians() * 0.5).tan()
    }
    /// Tangent of half the vertical field of view.
    pub fn half_tan_y(&self) -> f64 {
        self.half_tan_x() * f64::from(self.height) / f64::from(self.width)
    }
    /// World direction of the ray through pixel coordinates (u, v), not normalized: its component
    /// along `forward` is 1, so that `eye + t * ray` has eye-space depth t.
    pub fn ray(&self, basis: &ViewBasis, u: f64, v: f64) -> DVec3 {
        let f = self.focal_px();
        basis.forward + basis.right * ((u - f64::from(self.width) * 0.5) / f)
            - basis.up * ((v - f64::from(self.height) * 0.5) / f)
    }
}

/// A pyramid of four planes through an apex; semi-infinite. No near and no far plane.
#[derive(Debug, Clone, Copy)]
pub struct Frustum {
    /// Apex.
    pub apex: DVec3,
    /// Inward unit normals: left, right, bottom, top.
    pub normals: [DVec3; 4],
}

impl Frustum {
    /// The frustum at `apex` along `basis.forward`, with these half tangents across and up.
    pub fn new(apex: DVec3, basis: &ViewBasis, half_tan_x: f64, half_tan_y: f64) -> Self {
        let n = |side: DVec3, t: f64| (side + basis.forward * t).normalize();
        Self {
            apex,
            normals: [
                n(basis.right, half_tan_x),
                n(-basis.right, half_tan_x),
                n(basis.up, half_tan_y),
                n(-basis.up, half_tan_y),
            ],
        }
    }

    /// Whether `p` lies inside or on the border.
    pub fn contains(&self, p: DVec3) -> bool {
        let v = p - self.apex;
        self.normals.iter().all(|n| n.dot(v) >= 0.0)
    }

    /// False only when a plane has the whole box on its outer side (conservative: may admit boxes
    /// near an edge of the pyramid that do not touch it).
    pub fn may_intersect(&self, b: &Aabb) -> bool {
        self.normals.iter().all(|n| b.support(*n) >= n.dot(self.apex))
    }
}

#[cfg(test)]
mod tests {
    use super::apart_deg;

    #[test]
    fn headings_are_apart_by_the_shorter_way() {
        assert_eq!([apart_deg(350.0, 10.0), apart_deg(10.0, 350.0), apart_deg(0.0, 540.0).abs()], [20.0, -20.0, 180.0]);
    }
}
