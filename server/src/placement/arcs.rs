//! For which yaws can a cell be drawn? (Aliaga and Lastra 1999, section 3.3.1; row A5.)
//!
//! In: a cell's box relative to a grid point G, a pitch band. Out: arcs of yaw that hold every yaw
//! at which, for some pitch of the band, the square frustum at G passes the run-time test
//! `Frustum::may_intersect`. An eye E that uses G lies in G's own frustum for its direction;
//! moving the apex from E back to G only moves the four planes outward, so what is drawn at E is
//! counted at G.
//!
//! The run-time test asks of each plane that some corner v of the box is on its inner side. With v
//! at horizontal distance rho in direction theta, height v_y, and psi = yaw - theta, the four
//! planes of half tangent t at pitch p read
//!
//! ```text
//!   left, right:  +-rho sin psi + t (cos p rho cos psi + sin p v_y) >= 0
//!   bottom:       rho cos psi (t cos p - sin p) + v_y (cos p + t sin p) >= 0
//!   top:          rho cos psi (t cos p + sin p) + v_y (t sin p - cos p) >= 0
//! ```
//!
//! each of the form A cos(psi - phase) >= B: an arc. Over a band [p0, p1] of half width e: bottom
//! and top hold for some pitch of the band exactly if they hold at p0 or at p1 (half-planes that
//! turn about a line by less than 180 degrees); left and right at an inner pitch imply them at an
//! end with t / cos e instead of t (the end's value of cos p a + sin p b is at least cos e times
//! the largest one; where it is negative, t itself is the weaker one and is tested too). So the
//! union over the band is a union of arcs; we take its hull per plane over the corners, and
//! intersect the four planes. A box around the vertical axis through G, and a plane that the pole
//! turns over, are handled by the full circle.

use glam::DVec3;
use std::f64::consts::{PI, TAU};

/// Arcs are widened by this much at both ends, radians: far above rounding, far below any cell.
const MARGIN: f64 = 2e-7;

/// An arc of yaw: from `start` in [0, 2 pi), `length` up to 2 pi; radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Arc {
    /// Where it starts.
    pub start: f64,
    /// How far it goes, toward growing yaw.
    pub length: f64,
}

impl Arc {
    /// All yaws.
    pub const FULL: Self = Self { start: 0.0, length: TAU };

    /// Whether a yaw lies in it.
    pub fn contains(&self, yaw: f64) -> bool {
        (yaw - self.start).rem_euclid(TAU) <= self.length
    }
}

/// A few arcs; disjoint after an intersection of disjoint ones.
#[derive(Debug, Clone, Copy)]
pub(super) struct ArcSet {
    n: usize,
    arcs: [Arc; 8],
}

impl ArcSet {
    const EMPTY: Self = Self { n: 0, arcs: [Arc { start: 0.0, length: 0.0 }; 8] };

    /// The arcs.
    pub fn arcs(&self) -> &[Arc] {
        &self.arcs[..self.n]
    }

    /// Adds an arc; when there is no room left the set becomes the full circle.
    fn push(&mut self, a: Arc) {
        if self.n == self.arcs.len() {
            *self = Self::EMPTY;
            self.push(Arc::FULL);
            return;
        }
        self.arcs[self.n] = a;
        self.n += 1;
    }

    /// The same yaws by disjoint arcs, so that a sweep counts a cell once.
    fn joined(mut self) -> Self {
        if self.n < 2 {
            return self;
        }
        self.arcs[..self.n].sort_by(|a, b| a.start.total_cmp(&b.start));
        let mut out = Self::EMPTY;
        for a in &self.arcs[..self.n] {
            match out.arcs[..out.n].last_mut() {
                Some(last) if a.start <= last.start + last.length => {
                    last.length = last.length.max(a.start - last.start + a.length).min(TAU);
                }
                _ => out.push(*a),
            }
        }
        // The last arc may reach around to the first.
        if out.n > 1 {
            let (first, last) = (out.arcs[0], out.arcs[out.n - 1]);
            let beyond = last.start + last.length - TAU;
            if beyond >= first.start {
                out.arcs[out.n - 1].length = last.length.max(first.start + first.length + TAU - last.start).min(TAU);
                out.arcs.copy_within(1..out.n, 0);
                out.n -= 1;
                return out.joined();
            }
        }
        out
    }

    /// The yaws in both.
    fn intersect(&self, o: &Self) -> Self {
        let mut out = Self::EMPTY;
        for a in self.arcs() {
            for b in o.arcs() {
                if a.length >= TAU {
                    out.push(*b);
                    continue;
                }
                if b.length >= TAU {
                    out.push(*a);
                    continue;
                }
                let s = (b.start - a.start).rem_euclid(TAU);
                if s <= a.length {
                    out.push(Arc { start: b.start, length: b.length.min(a.length - s) });
                }
                let wrapped = s + b.length - TAU;
                if wrapped >= 0.0 {
                    out.push(Arc { start: a.start, length: wrapped.min(a.length) });
                }
            }
        }
        out
    }
}

/// What depends on the band only.
#[derive(Debug, Clone, Copy)]
pub(super) struct BandPlanes {
    /// Left plane (the right one mirrors it): phase, and factor of v_y / rho in -B / A.
    sides: [[f64; 2]; 4],
    /// Bottom and top, at p0 and p1: A and C of A rho cos psi + C v_y >= 0.
    caps: [[[f64; 2]; 2]; 2],
}

impl BandPlanes {
    /// Planes of the square frustum of half tangent `t` for pitches in `band_deg`.
    pub fn new(band_deg: [f64; 2], t: f64) -> Self {
        let p = band_deg.map(f64::to_radians);
        let half_width = (p[1] - p[0]) * 0.5;
        let side = |p: f64, t: f64| {
            let across = t * p.cos();
            [1.0f64.atan2(across), t * p.sin() / (1.0 + across * across).sqrt()]
        };
        let wide = t / half_width.cos();
        Self {
            sides: [side(p[0], t), side(p[1], t), side(p[0], wide), side(p[1], wide)],
            caps: [
                p.map(|p| [t * p.cos() - p.sin(), p.cos() + t * p.sin()]),
                p.map(|p| [t * p.cos() + p.sin(), t * p.sin() - p.cos()]),
            ],
        }
    }

    /// The arcs of a box given by its corners relative to G.
    pub fn arcs(&self, min: DVec3, max: DVec3) -> ArcSet {
        let around_axis = min.x <= 0.0 && max.x >= 0.0 && min.z <= 0.0 && max.z >= 0.0;
        if around_axis {
            return self.arcs_around_axis(min, max);
        }
        let centre = (min + max) * 0.5;
        let middle = (-centre.x).atan2(-centre.z);
        let corners = [(min.x, min.z), (max.x, min.z), (min.x, max.z), (max.x, max.z)].map(|(x, z)| {
            let mut offset = (-x).atan2(-z) - middle;
            if offset > PI {
                offset -= TAU;
            } else if offset <= -PI {
                offset += TAU;
            }
            (offset, 1.0 / x.hypot(z).max(1e-300))
        });
        let (mut left, mut right) = (Hull::EMPTY, Hull::EMPTY);
        for [phase, factor] in self.sides {
            let v_y = if factor >= 0.0 { max.y } else { min.y };
            for (offset, per_rho) in corners {
                let width = half_width(-factor * v_y * per_rho);
                left.add(offset + phase, width);
                right.add(offset - phase, width);
            }
        }
        let mut out = left.set(middle).intersect(&right.set(middle));
        for cap in &self.caps {
            if out.n == 0 {
                break;
            }
            let (mut ahead, mut behind, mut always) = (Hull::EMPTY, Hull::EMPTY, false);
            for [a, c] in *cap {
                let v_y = if c >= 0.0 { max.y } else { min.y };
                if a.abs() < 1e-9 {
                    // Independent of yaw to within rounding: kept when it can hold at all.
                    let reach = corners.iter().fold(0.0f64, |m, k| m.max(1.0 / k.1));
                    always |= c * v_y + a.abs() * reach + 1e-9 >= 0.0;
                    continue;
                }
                let (hull, turn) = if a > 0.0 { (&mut ahead, 0.0) } else { (&mut behind, PI) };
                for (offset, per_rho) in corners {
                    hull.add(offset + turn, half_width(-c * v_y * per_rho / a.abs()));
                }
            }
            if !always {
                let mut either = ahead.set(middle);
                behind.set(middle).arcs().iter().for_each(|a| either.push(*a));
                out = out.intersect(&either);
            }
        }
        out.joined()
    }

    /// A box around the vertical axis through G: all yaws, or none where it is wholly beyond
    /// bottom or top at every yaw.
    fn arcs_around_axis(&self, min: DVec3, max: DVec3) -> ArcSet {
        let rho = min.x.abs().max(max.x).hypot(min.z.abs().max(max.z));
        let reachable = self
            .caps
            .iter()
            .all(|cap| cap.iter().any(|[a, c]| a.abs() * rho + (c * min.y).max(c * max.y) + 1e-9 >= 0.0));
        let mut out = ArcSet::EMPTY;
        if reachable {
            out.push(Arc::FULL);
        }
        out
    }
}

/// Half width of the arc where cos x >= `threshold`; negative where there is none.
fn half_width(threshold: f64) -> f64 {
    if threshold <= -1.0 {
        PI
    } else if threshold <= 1.0 {
        threshold.acos()
    } else if threshold <= 1.0 + 1e-9 {
        0.0
    } else {
        -1.0
    }
}

/// Hull of arcs around nearby middles, before wrapping.
#[derive(Clone, Copy)]
struct Hull {
    low: f64,
    high: f64,
}

impl Hull {
    const EMPTY: Self = Self { low: f64::INFINITY, high: f64::NEG_INFINITY };

    fn add(&mut self, middle: f64, half_width: f64) {
        if half_width >= 0.0 {
            self.low = self.low.min(middle - half_width);
            self.high = self.high.max(middle + half_width);
        }
    }

    fn set(&self, origin: f64) -> ArcSet {
        let mut out = ArcSet::EMPTY;
        if self.low <= self.high {
            let length = self.high - self.low + 2.0 * MARGIN;
            out.push(if length >= TAU {
                Arc::FULL
            } else {
                Arc { start: (origin + self.low - MARGIN).rem_euclid(TAU), length }
            });
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ldi_protocol::{Aabb, ViewBasis, camera::Frustum};
    use proptest::prelude::*;

    const T: f64 = 0.577_350_269_189_625_8;

    proptest! {
        // Most random boxes are out of view, and say nothing.
        #![proptest_config(ProptestConfig { cases: 20_000, max_global_rejects: 4_000_000, ..ProptestConfig::default() })]
        #[test]
        fn what_is_drawn_from_a_user_is_counted(
            low in -70.0f64..60.0, width in 2.0f64..15.0, at in 0.0f64..=1.0, yaw in 0.0f64..360.0,
            corner in prop::array::uniform3(-9.0f64..9.0), size in prop::array::uniform3(0.0f64..5.0),
            eye in prop::array::uniform3(0.0f64..=1.0), side in prop::array::uniform2(-1.0f64..=1.0),
        ) {
            let band = [low, low + width];
            let pitch = low + width * at;
            let basis = ViewBasis::from_yaw_pitch(yaw, pitch);
            // An eye in the square frustum at G = 0: depth up to 4 m.
            let depth = eye[0] * 4.0;
            let e = (basis.forward + basis.right * (side[0] * T) + basis.up * (side[1] * T)) * depth;
            let b = Aabb { min: DVec3::from_array(corner), max: DVec3::from_array(corner) + DVec3::from_array(size) };
            prop_assume!(Frustum::new(e, &basis, T, T).may_intersect(&b));
            let set = BandPlanes::new(band, T).arcs(b.min, b.max);
            prop_assert!(set.arcs().iter().any(|a| a.contains(yaw.to_radians())), "{set:?}");
        }
    }

    #[test]
    fn a_small_box_ahead_is_seen_over_the_field_of_view() {
        // Level gaze, box of a centimetre 10 m along -Z: the arc is 60 degrees plus the box's own
        // width.
        let b = Aabb { min: DVec3::new(-0.005, -0.005, -10.0), max: DVec3::new(0.005, 0.005, -9.99) };
        let set = BandPlanes::new([-0.01, 0.01], T).arcs(b.min, b.max);
        assert_eq!(set.arcs().len(), 1);
        let a = set.arcs()[0];
        assert!((a.length.to_degrees() - 60.0).abs() < 0.1, "{a:?}");
        assert!(a.contains(0.0) && a.contains(0.5) && !a.contains(0.6) && !a.contains(PI));
    }

    #[test]
    fn a_box_overhead_is_not_seen_looking_down() {
        let b = Aabb { min: DVec3::new(-1.0, 5.0, -1.0), max: DVec3::new(1.0, 6.0, 1.0) };
        assert!(BandPlanes::new([-60.0, -50.0], T).arcs(b.min, b.max).arcs().is_empty());
        assert_eq!(BandPlanes::new([50.0, 60.0], T).arcs(b.min, b.max).arcs(), &[Arc::FULL]);
    }
}
