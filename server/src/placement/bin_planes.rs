//! The reverse-frustum test for all directions of a bin and all eyes of a box at once.
//!
//! In: a bin of directions, half widths dy (yaw) and dp (pitch), and the vectors w = E - G for E
//! in a box. Out: whether G lies in the reverse square frustum of every (eye, direction), of some,
//! or of none. A plane's normal n = S right + U up + t forward (S, U in {-1, 0, 1}, t the half
//! tangent across or up) turns with the direction; Taylor's theorem about the bin's middle gives,
//! for every direction in it,
//!
//! ```text
//!   |n . w - n0 . w| <= dy |n_y . w| + dp |n_p . w| + (dy + dp)^2 / 2 (1 + t) |w|
//! ```
//!
//! because every second derivative of n has a norm of at most 1 + t. A box of half size h adds
//! (|n0| + dy |n_y| + dp |n_p|) . h.

use glam::DVec3;
use ldi_protocol::{Aabb, ViewBasis};

/// Slack of the tests, metres per metre of distance: far above rounding, far below any box.
const ROUNDING: f64 = 1e-9;

/// Whether a grid point lies in the reverse frusta of a box of eyes and a bin of directions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Behind {
    /// In none of them.
    Never,
    /// In some, as far as one can tell.
    Maybe,
    /// In all of them.
    Always,
}

/// x, y and z of four vectors, one for each plane: all planes are tested at once.
type FourVectors = [[f64; 4]; 3];

/// Dot products of four vectors with one.
#[inline(always)]
fn dots(four: &FourVectors, v: DVec3) -> [f64; 4] {
    let mut out = [0.0; 4];
    for (k, d) in out.iter_mut().enumerate() {
        *d = four[0][k] * v.x + four[1][k] * v.y + four[2][k] * v.z;
    }
    out
}

/// The four planes over a bin.
#[derive(Debug, Clone, Copy)]
pub(super) struct BinPlanes {
    middle: FourVectors,
    by_yaw: FourVectors,
    by_pitch: FourVectors,
    /// |n0| + dy |n_y| + dp |n_p|, by component.
    reach: FourVectors,
    half_yaw: f64,
    half_pitch: f64,
    second: f64,
}

impl BinPlanes {
    /// Planes of the frustum of half tangents `tx` across and `ty` up over yaws and pitches,
    /// degrees.
    pub fn new(yaw_deg: [f64; 2], pitch_deg: [f64; 2], tx: f64, ty: f64) -> Self {
        let (yaw, pitch) = ((yaw_deg[0] + yaw_deg[1]) * 0.5, (pitch_deg[0] + pitch_deg[1]) * 0.5);
        let half_yaw = ((yaw_deg[1] - yaw_deg[0]) * 0.5).to_radians();
        let half_pitch = ((pitch_deg[1] - pitch_deg[0]) * 0.5).to_radians();
        let ViewBasis { right, up, forward } = ViewBasis::from_yaw_pitch(yaw, pitch);
        let (sin, cos) = pitch.to_radians().sin_cos();
        let ahead = DVec3::new(forward.x, 0.0, forward.z) / cos.abs().max(1e-12) * cos.signum();
        let mut out = Self {
            middle: [[0.0; 4]; 3],
            by_yaw: [[0.0; 4]; 3],
            by_pitch: [[0.0; 4]; 3],
            reach: [[0.0; 4]; 3],
            half_yaw,
            half_pitch,
            second: 0.5 * (half_yaw + half_pitch).powi(2) * (1.0 + tx.max(ty)),
        };
        for (plane, (s, u, t)) in
            [(1.0, 0.0, tx), (-1.0, 0.0, tx), (0.0, 1.0, ty), (0.0, -1.0, ty)].into_iter().enumerate()
        {
            let middle = right * s + up * u + forward * t;
            // d right / d yaw = ahead, d up / d yaw = right sin p, d forward / d yaw = -right cos
            // p.
            let by_yaw = ahead * s + right * (u * sin) - right * (t * cos);
            // d up / d pitch = -forward, d forward / d pitch = up.
            let by_pitch = forward * -u + up * t;
            let reach = middle.abs() + by_yaw.abs() * half_yaw + by_pitch.abs() * half_pitch;
            for axis in 0..3 {
                out.middle[axis][plane] = middle[axis];
                out.by_yaw[axis][plane] = by_yaw[axis];
                out.by_pitch[axis][plane] = by_pitch[axis];
                out.reach[axis][plane] = reach[axis];
            }
        }
        out
    }

    /// Half widths of the bin in yaw and pitch, radians.
    pub fn half_widths(&self) -> (f64, f64) {
        (self.half_yaw, self.half_pitch)
    }

    /// Whether points of a box may lie in the frusta of eyes in another: never, sometimes, or
    /// always for every eye and direction.
    #[inline(always)]
    pub fn show(&self, eyes: &Aabb, b: &Aabb) -> Behind {
        // Every plane keeps a point for some eye exactly if it keeps their difference for an eye
        // at the origin.
        let (w, h) = (b.centre() - eyes.centre(), (b.size() + eyes.size()) * 0.5);
        self.behind(w, h, (w.abs() + h).length())
    }

    /// The test for w = E - G in a box of middle `w` and half size `h`; `farthest` bounds |w| over
    /// the box.
    #[inline(always)]
    pub fn behind(&self, w: DVec3, h: DVec3, farthest: f64) -> Behind {
        let common = (self.second + ROUNDING) * farthest;
        let (value, by_yaw, by_pitch) = (dots(&self.middle, w), dots(&self.by_yaw, w), dots(&self.by_pitch, w));
        let reach = dots(&self.reach, h);
        let (mut never, mut always) = (false, true);
        for k in 0..4 {
            let spread = self.half_yaw * by_yaw[k].abs() + self.half_pitch * by_pitch[k].abs() + reach[k] + common;
            never |= value[k] + spread < 0.0;
            always &= value[k] - spread >= 0.0;
        }
        match (never, always) {
            (true, _) => Behind::Never,
            (false, true) => Behind::Always,
            (false, false) => Behind::Maybe,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ldi_protocol::camera::Frustum;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        #[test]
        fn never_and_always_are_certain(
            yaw in 0.0f64..360.0, width in 0.1f64..16.0, pitch in -60.0f64..50.0, height in 0.1f64..12.0, t in 0.51f64..1.0, s in 0.2f64..1.0,
            w in prop::array::uniform3(-8.0f64..8.0), h in prop::array::uniform3(0.0f64..2.0),
            at in prop::array::uniform5(0.0f64..=1.0),
        ) {
            let bin = BinPlanes::new([yaw, yaw + width], [pitch, pitch + height], t, s);
            let (w, h) = (DVec3::from_array(w), DVec3::from_array(h));
            let verdict = bin.behind(w, h, (w.abs() + h).length());
            // One eye, relative to G, and one direction of the bin.
            let e = w + h * (DVec3::new(at[0], at[1], at[2]) * 2.0 - 1.0);
            let basis = ViewBasis::from_yaw_pitch(yaw + width * at[3], pitch + height * at[4]);
            let inside = Frustum::new(DVec3::ZERO, &basis, t, s).contains(e);
            prop_assert!(verdict != Behind::Never || !inside);
            prop_assert!(verdict != Behind::Always || inside);
        }
    }

    #[test]
    fn a_point_well_behind_is_certain_and_one_ahead_is_excluded() {
        let bin = BinPlanes::new([0.0, 15.0], [-5.0, 5.0], 0.577, 0.577);
        let ahead = ViewBasis::from_yaw_pitch(7.5, 0.0).forward;
        assert_eq!(bin.behind(ahead * 5.0, DVec3::splat(0.2), 5.4), Behind::Always);
        assert_eq!(bin.behind(ahead * -5.0, DVec3::splat(0.2), 5.4), Behind::Never);
    }
}
