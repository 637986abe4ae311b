//! Axis-aligned boxes in world or mesh space.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// An axis-aligned box, metres. Empty when any `min` exceeds `max` (see [`Aabb::EMPTY`]).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Aabb {
    /// Smallest corner.
    pub min: DVec3,
    /// Largest corner.
    pub max: DVec3,
}

impl Aabb {
    /// The box that contains nothing: growing it by a point gives that point.
    pub const EMPTY: Self = Self { min: DVec3::splat(f64::INFINITY), max: DVec3::splat(f64::NEG_INFINITY) };

    /// The smallest box around `points`.
    pub fn from_points(points: impl IntoIterator<Item = DVec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |b, p| b.grown_to(p))
    }

    /// Whether the box contains no point at all.
    pub fn is_empty(&self) -> bool {
        !(self.min.cmple(self.max).all())
    }

    /// This box, enlarged to contain `p`.
    #[must_use]
    pub fn grown_to(self, p: DVec3) -> Self {
        Self { min: self.min.min(p), max: self.max.max(p) }
    }

    /// The smallest box around both.
    #[must_use]
    pub fn union(self, o: Self) -> Self {
        Self { min: self.min.min(o.min), max: self.max.max(o.max) }
    }

    /// This box, moved outward by `margin` metres on all six sides.
    #[must_use]
    pub fn inflated(self, margin: f64) -> Self {
        Self { min: self.min - margin, max: self.max + margin }
    }

    /// Centre.
    pub fn centre(&self) -> DVec3 {
        (self.min + self.max) * 0.5
    }

    /// Edge lengths.
    pub fn size(&self) -> DVec3 {
        self.max - self.min
    }

    /// Whether `p` lies inside or on the border.
    pub fn contains(&self, p: DVec3) -> bool {
        self.min.cmple(p).all() && p.cmple(self.max).all()
    }

    /// Whether the two boxes share at least a point.
    pub fn intersects(&self, o: &Self) -> bool {
        self.min.cmple(o.max).all() && o.min.cmple(self.max).all()
    }

    /// The eight corners; bit 0 of the position picks max x, bit 1 max y, bit 2 max z.
    pub fn corners(&self) -> [DVec3; 8] {
        std::array::from_fn(|i| {
            DVec3::new(
                if i & 1 == 0 { self.min.x } else { self.max.x },
                if i & 2 == 0 { self.min.y } else { self.max.y },
                if i & 4 == 0 { self.min.z } else { self.max.z },
            )
        })
    }

    /// Largest value of `p . n` over the box.
    pub fn support(&self, n: DVec3) -> f64 {
        (self.min * n).max(self.max * n).element_sum()
    }

    /// Smallest distance from `p` to the box; 0 inside.
    pub fn distance(&self, p: DVec3) -> f64 {
        (p.clamp(self.min, self.max) - p).length()
    }

    /// Largest distance from `p` to a point of the box.
    pub fn max_distance(&self, p: DVec3) -> f64 {
        (p - self.min).abs().max((p - self.max).abs()).length()
    }
}
