//! The convex region of eyes that may use an image: a prism over a polygon with sides at fixed
//! directions (a discrete oriented polytope). A box would do for the guarantee, but users fill a
//! wedge ahead of their grid point, and along a diagonal a box is up to 1.4 times as deep as the
//! wedge: images would have to stand that much farther away.

use glam::DVec3;
use ldi_protocol::Aabb;

/// Number of horizontal directions; direction k is yaw `k * 360 / SIDES`.
pub(super) const SIDES: usize = 16;

/// A prism: horizontal support values for [`SIDES`] directions and a height interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct EyeHull {
    /// Largest value of p . u_k over the region, u_k the unit vector at yaw k * 360 / SIDES (0 is
    /// -Z, a quarter turn is -X).
    support: [f64; SIDES],
    /// Smallest and largest height.
    y: [f64; 2],
}

/// (x, z) of the directions.
static DIRECTIONS: std::sync::LazyLock<([f64; SIDES], [f64; SIDES])> = std::sync::LazyLock::new(|| {
    let angle = |k: usize| (k as f64 / SIDES as f64 * 360.0).to_radians();
    (std::array::from_fn(|k| -angle(k).sin()), std::array::from_fn(|k| -angle(k).cos()))
});

impl EyeHull {
    /// Contains nothing.
    pub const EMPTY: Self = Self { support: [f64::NEG_INFINITY; SIDES], y: [f64::INFINITY, f64::NEG_INFINITY] };

    /// Whether there is no eye.
    pub fn is_empty(&self) -> bool {
        self.y[0] > self.y[1]
    }

    /// Support values of a box.
    #[inline]
    fn of(b: &Aabb) -> [f64; SIDES] {
        let (dx, dz) = &*DIRECTIONS;
        let (c, h) = (b.centre(), b.size() * 0.5);
        std::array::from_fn(|k| c.x * dx[k] + c.z * dz[k] + h.x * dx[k].abs() + h.z * dz[k].abs())
    }

    /// Grows to contain a box.
    #[inline]
    pub fn add(&mut self, b: &Aabb) {
        let s = Self::of(b);
        for k in 0..SIDES {
            self.support[k] = self.support[k].max(s[k]);
        }
        self.y = [self.y[0].min(b.min.y), self.y[1].max(b.max.y)];
    }

    /// Whether a box lies inside, to within `slack` metres.
    #[inline]
    pub fn contains(&self, b: &Aabb, slack: f64) -> bool {
        if b.min.y < self.y[0] - slack || b.max.y > self.y[1] + slack {
            return false;
        }
        let s = Self::of(b);
        (0..SIDES).all(|k| s[k] <= self.support[k] + slack)
    }

    /// Grows to contain another region.
    pub fn union(&mut self, o: &Self) {
        for k in 0..SIDES {
            self.support[k] = self.support[k].max(o.support[k]);
        }
        self.y = [self.y[0].min(o.y[0]), self.y[1].max(o.y[1])];
    }

    /// The region, widened horizontally by this many metres in every direction.
    pub fn widened(mut self, metres: f64) -> Self {
        self.support.iter_mut().for_each(|s| *s += metres);
        self
    }

    /// An upper bound of p . n over the region, for any n: n's horizontal part is written as a sum
    /// of the two nearest directions with weights of at least 0, for which supports add up (a
    /// support function is sublinear).
    pub fn support(&self, n: DVec3) -> f64 {
        let vertical = if n.y >= 0.0 { n.y * self.y[1] } else { n.y * self.y[0] };
        let length = n.x.hypot(n.z);
        if length == 0.0 {
            return vertical;
        }
        let turns = ((-n.x).atan2(-n.z) / std::f64::consts::TAU).rem_euclid(1.0) * SIDES as f64;
        let k = (turns.floor() as usize) % SIDES;
        let next = (k + 1) % SIDES;
        let step = std::f64::consts::TAU / SIDES as f64;
        let beyond = (turns - turns.floor()) * step;
        let (a, b) = ((step - beyond).sin() / step.sin(), beyond.sin() / step.sin());
        // Rounding of the angle is absorbed by a nanometre per metre of distance.
        let bound = length * (a * self.support[k] + b * self.support[next]);
        bound + 1e-9 * (1.0 + bound.abs()) + vertical
    }

    /// The box around it.
    pub fn bounds(&self) -> Aabb {
        let q = SIDES / 4;
        Aabb {
            min: DVec3::new(-self.support[q], self.y[0], -self.support[0]),
            max: DVec3::new(self.support[3 * q], self.y[1], self.support[2 * q]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    prop_compose! {
        fn point()(x in -9.0f64..9.0, y in -3.0f64..3.0, z in -9.0f64..9.0) -> DVec3 { DVec3::new(x, y, z) }
    }

    proptest! {
        #[test]
        fn supports_bound_every_point_in_every_direction(points in prop::collection::vec(point(), 1..8), n in point()) {
            let mut hull = EyeHull::EMPTY;
            for p in &points {
                hull.add(&Aabb { min: *p, max: *p + 0.25 });
            }
            let b = hull.bounds();
            for p in points {
                let own = Aabb { min: p, max: p + 0.25 };
                prop_assert!(hull.contains(&own, 1e-12));
                prop_assert!(own.support(n) <= hull.support(n));
                let grown = b.inflated(1e-9);
                let both = grown.contains(p) && grown.contains(p + 0.25);
                prop_assert!(both);
            }
        }

        #[test]
        fn a_diagonal_is_not_taken_for_its_box(length in 1.0f64..10.0) {
            let mut hull = EyeHull::EMPTY;
            hull.add(&Aabb { min: DVec3::ZERO, max: DVec3::ZERO });
            let end = DVec3::new(length, 0.0, length);
            hull.add(&Aabb { min: end, max: end });
            let off = Aabb { min: DVec3::X * length, max: DVec3::X * length };
            prop_assert!(!hull.contains(&off, 1e-9));
        }
    }
}
