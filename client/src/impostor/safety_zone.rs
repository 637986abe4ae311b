//! The safety zone of a cached image: the eye positions for which it stays valid (Shade et al.
//! 1996, section 3).
//!
//! A cached image lies on a plane. A point and its projection to the plane coincide for the eye
//! that the image was made for; for another eye they are an angle apart, the *discrepancy*. The
//! largest discrepancy of a box's corners represents all its points: not conservative, but
//! sufficient according to the paper.

use glam::DVec3;
use ldi_protocol::Aabb;

/// The plane of a cached image, and the eye it is made for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Position of the eye, metres.
    pub eye: DVec3,
    /// Unit normal, from the eye to the plane.
    pub normal: DVec3,
    /// Distance of the plane from the eye, metres.
    pub distance: f64,
}

impl Plane {
    /// The point of the plane that coincides with `point` for the eye; None behind the eye.
    pub fn stands_for(&self, point: DVec3) -> Option<DVec3> {
        let to = point - self.eye;
        let ahead = self.normal.dot(to);
        (ahead > 0.0).then(|| self.eye + to * (self.distance / ahead))
    }

    /// The largest discrepancy of a box's corners, radians (equation 1); None if a corner is not in
    /// front of the eye.
    pub fn error(&self, bounds: &Aabb, eye: DVec3) -> Option<f64> {
        let of = |a: DVec3| self.stands_for(a).map(|b| discrepancy(eye, a, b));
        bounds.corners().into_iter().try_fold(0.0f64, |worst, a| Some(worst.max(of(a)?)))
    }

    /// A cube of eye positions for which the discrepancy of the box's corners stays within `angle`
    /// radians (equations 2 to 4): inscribed in the sphere around the eye. None if a corner is not
    /// in front of the eye.
    pub fn safety_zone(&self, bounds: &Aabb, angle: f64) -> Option<Aabb> {
        let of = |a: DVec3| self.stands_for(a).map(|b| safety_radius(self.eye, a, b, angle));
        let radius = bounds.corners().into_iter().try_fold(f64::INFINITY, |least, a| Some(least.min(of(a)?)))?;
        let half = radius / 3f64.sqrt();
        Some(Aabb { min: self.eye - half, max: self.eye + half })
    }
}

/// The angle between two points as an eye sees them, radians.
pub fn discrepancy(eye: DVec3, a: DVec3, b: DVec3) -> f64 {
    let (a, b) = (a - eye, b - eye);
    a.cross(b).length().atan2(a.dot(b))
}

/// The distance from `eye` within which two points in one direction stay within `angle` radians, at
/// most pi / 2. All eyes with that angle lie on circles through both points, of radius r (equation
/// 3); the nearest of them is at distance d (equation 4), computed without the difference of nearly
/// equal numbers: as the points approach each other, r and d go to infinity.
pub fn safety_radius(eye: DVec3, a: DVec3, b: DVec3, angle: f64) -> f64 {
    let apart = a.distance(b);
    if apart == 0.0 {
        return f64::INFINITY;
    }
    let sin = angle.sin();
    let r = apart / (2.0 * sin);
    let h = eye.distance(a).min(eye.distance(b));
    h * (h + 2.0 * r * sin) / ((h * h + r * r + 2.0 * h * r * sin).sqrt() + r)
}

/// Intersection of two boxes; may be empty.
pub fn both(a: &Aabb, b: &Aabb) -> Aabb {
    Aabb { min: a.min.max(b.min), max: a.max.min(b.max) }
}

/// The motion of an eye, per frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct EyeMotion {
    /// Position, metres.
    pub eye: DVec3,
    /// Velocity, metres per frame.
    pub velocity: DVec3,
    /// Acceleration, metres per frame squared.
    pub acceleration: DVec3,
}

/// Longest prediction, frames: a resting eye may move at any time.
pub const LONGEST_LIFE: f64 = 300.0;

impl EyeMotion {
    /// The motion one frame later. After a jump the velocity is wrong for two frames.
    pub fn then(&self, eye: DVec3) -> Self {
        let velocity = eye - self.eye;
        Self { eye, velocity, acceleration: velocity - self.velocity }
    }

    /// Number of frames until the eye leaves a box, at most [`LONGEST_LIFE`]. Not conservative: the
    /// path may curve.
    pub fn life_span(&self, zone: &Aabb) -> f64 {
        let axis = |k: usize| {
            let (p, v, half_a) = (self.eye[k], self.velocity[k], 0.5 * self.acceleration[k]);
            leaves(half_a, v, p - zone.min[k]).min(leaves(-half_a, -v, zone.max[k] - p))
        };
        axis(0).min(axis(1)).min(axis(2)).min(LONGEST_LIFE)
    }
}

/// The first t > 0 at which c + b t + a t^2 falls below 0, from c >= 0; infinity if it never does.
fn leaves(a: f64, b: f64, c: f64) -> f64 {
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return f64::INFINITY;
    }
    // Both roots without cancellation.
    let q = -0.5 * (b + discriminant.sqrt().copysign(b));
    let roots = [q / a, c / q];
    let falls = |t: &f64| *t > 0.0 && t.is_finite() && b + 2.0 * a * t <= 0.0;
    roots.into_iter().filter(falls).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector(range: std::ops::Range<f64>) -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(range).prop_map(DVec3::from)
    }

    proptest! {
        /// Eyes anywhere in the zone see no corner farther from what stands for it than was
        /// allowed, and somewhere just beyond the sphere one does.
        #[test]
        fn zones_keep_their_promise(
            centre in vector(-50.0..50.0), half in vector(0.1..5.0), eye_motion in vector(-1.0..1.0), far in 1.1f64..40.0, pixels in 0.5f64..8.0,
            inside in prop::collection::vec(vector(-1.0..1.0), 20)
        ) {
            let bounds = Aabb { min: centre - half, max: centre + half };
            prop_assume!(eye_motion.length() > 0.1);
            let eye = centre - eye_motion.normalize() * (half.length() * far);
            let plane = Plane { eye, normal: eye_motion.normalize(), distance: half.length() * far };
            let angle = pixels / 900.0;
            let zone = plane.safety_zone(&bounds, angle).unwrap();
            for offset in inside {
                let at = eye + offset * zone.size() * 0.5;
                let error = plane.error(&bounds, at);
                prop_assert!(error.is_none_or(|e| e <= angle * (1.0 + 1e-9)), "{error:?} of {angle}");
            }
            prop_assert!(plane.error(&bounds, eye).unwrap() < 1e-7);
            // The bound is met: on the two circles, somewhere on the sphere of the corner that
            // decides.
            let corner = bounds.corners().into_iter().min_by(|a, b| {
                let d = |a: &DVec3| safety_radius(eye, *a, plane.stands_for(*a).unwrap(), angle);
                d(a).total_cmp(&d(b))
            }).unwrap();
            let other = plane.stands_for(corner).unwrap();
            let d = safety_radius(eye, corner, other, angle);
            let line = (corner - eye).normalize();
            let side = line.any_orthonormal_vector();
            let worst = (0..3600).map(|i| f64::from(i) * std::f64::consts::TAU / 3600.0).map(|t| {
                discrepancy(eye + (line * t.cos() + side * t.sin()) * d, corner, other)
            }).fold(0.0, f64::max);
            prop_assert!(worst <= angle * (1.0 + 1e-9) && worst > angle * 0.999, "{worst} of {angle}");
        }

        /// Against counting frames.
        #[test]
        fn lives_end_where_the_way_leaves(
            half in vector(0.01..3.0), velocity in vector(-0.1..0.1), acceleration in vector(-0.01..0.01), at in vector(-0.99..0.99)
        ) {
            let zone = Aabb { min: -half, max: half };
            let eye_motion = EyeMotion { eye: at * half, velocity, acceleration };
            let place = |n: f64| eye_motion.eye + eye_motion.velocity * n + 0.5 * eye_motion.acceleration * n * n;
            let counted = (1..=300).map(f64::from).find(|n| !zone.contains(place(*n))).unwrap_or(LONGEST_LIFE + 1.0);
            let found = eye_motion.life_span(&zone);
            // A way that leaves and comes back between two frames is not seen by counting.
            prop_assert!(found <= counted, "{found} against {counted}");
            for i in 0..100 {
                prop_assert!(zone.inflated(1e-9).contains(place(found * f64::from(i) / 100.0)), "{found}");
            }
            prop_assert!(found == LONGEST_LIFE || !zone.inflated(-1e-9).contains(place(found)), "{found}");
        }
    }

    /// As the points draw together the zone grows without bound; equation 4 as printed gives
    /// nothing there.
    #[test]
    fn zones_of_points_that_draw_together_do_not_cancel() {
        let (eye, angle) = (DVec3::ZERO, 2.0 / 900.0);
        for k in 0..14 {
            let apart = 10f64.powi(-k);
            let (a, b) = (DVec3::new(0.0, 0.0, -10.0), DVec3::new(0.0, 0.0, -10.0 - apart));
            let d = safety_radius(eye, a, b, angle);
            // From the circle's centre, which lies beside the middle between the points: x - r =
            // (x^2 - r^2) / (x + r).
            let r = apart / (2.0 * angle.sin());
            let to_centre = DVec3::new(r * angle.cos(), 0.0, 10.0 + 0.5 * apart).length();
            let expected = 10.0 * (10.0 + apart) / (to_centre + r);
            assert!((d - expected).abs() <= 1e-6 * expected && d > 0.0, "{apart}: {d} instead of {expected}");
        }
        assert_eq!(safety_radius(eye, DVec3::X, DVec3::X, angle), f64::INFINITY);
        // Far apart: as printed.
        let (a, b) = (DVec3::new(0.0, 0.0, -3.0), DVec3::new(0.0, 0.0, -9.0));
        let r = 3.0 / angle.sin();
        let printed = (9.0 + r * r + 2.0 * 3.0 * r * angle.sin()).sqrt() - r;
        assert!((safety_radius(eye, a, b, angle) - printed).abs() < 1e-9);
    }
}
