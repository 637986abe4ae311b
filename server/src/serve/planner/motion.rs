//! How a walker moves: velocity and turn rate from poses, smoothed, as poses come with the jitter
//! of frames and of hands.

use glam::DVec3;
use ldi_protocol::{Pose, camera::apart_deg, wire::PoseDatagram};

/// Largest believable speed, m/s; a faster one is a jump and predicts nothing.
const MAX_SPEED_M_S: f64 = 15.0;
/// Largest believable turn, degrees per second.
const MAX_TURN_DEG_S: f64 = 400.0;
/// Time constant of the smoothing, seconds. Larger: calmer, but a turn is noticed later, and what
/// it brings into view comes later by as much; smaller: a mouse that trembles looks like a walker
/// who is about to turn round.
const SMOOTHING_S: f64 = 0.03;
/// Slower than this is standing, m/s.
const MIN_SPEED_M_S: f64 = 0.1;
/// Slower than this is looking ahead, degrees per second.
const MIN_TURN_DEG_S: f64 = 5.0;

/// The newest pose and how it changes.
#[derive(Debug, Clone, Copy)]
pub struct Motion {
    /// As it came.
    pub newest: PoseDatagram,
    /// Metres per second, smoothed.
    pub velocity_m_s: DVec3,
    /// Degrees per second, positive to the left, smoothed.
    pub turn_deg_s: f64,
}

impl Motion {
    /// A walker who stands.
    pub fn standing(newest: PoseDatagram) -> Self {
        Self { newest, velocity_m_s: DVec3::ZERO, turn_deg_s: 0.0 }
    }

    /// The motion after another pose. The same pose again is no news of standing: clients repeat
    /// the last one in case it was lost, and only after a while of it has the walker stopped.
    pub fn then(&self, next: PoseDatagram) -> Self {
        let dt = next.sent_us.saturating_sub(self.newest.sent_us) as f64 * 1e-6;
        let (a, b) = (self.newest.pose, next.pose);
        let moved = (b.position - a.position) / dt.max(1e-3);
        let turned = apart_deg(a.yaw_deg, b.yaw_deg) / dt.max(1e-3);
        if dt <= 0.0 || moved.length() > MAX_SPEED_M_S || turned.abs() > MAX_TURN_DEG_S {
            return Self::standing(next);
        }
        let news = 1.0 - (-dt / SMOOTHING_S).exp();
        Self {
            newest: next,
            velocity_m_s: self.velocity_m_s + (moved - self.velocity_m_s) * news,
            turn_deg_s: self.turn_deg_s + (turned - self.turn_deg_s) * news,
        }
    }

    /// Whether the eye changes its place.
    pub fn walks(&self) -> bool {
        self.velocity_m_s.length() > MIN_SPEED_M_S
    }

    /// Whether it changes its direction.
    pub fn turns(&self) -> bool {
        self.turn_deg_s.abs() > MIN_TURN_DEG_S
    }

    /// Whether it does either.
    pub fn moves(&self) -> bool {
        self.walks() || self.turns()
    }

    /// The newest pose.
    pub fn pose(&self) -> Pose {
        self.newest.pose
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64, x: f64, yaw_deg: f64) -> PoseDatagram {
        let pose = Pose { position: DVec3::new(x, 0.0, 0.0), yaw_deg, pitch_deg: 0.0 };
        PoseDatagram { sequence: ms as u32, sent_us: ms * 1000, pose }
    }

    /// 60 poses per second of a walk at 2 m/s and 90 degrees per second, every other pose 4 ms
    /// late: the noise of the raw differences is a quarter, and smoothed ones have less.
    #[test]
    fn steady_motion_is_found_amid_jitter() {
        let mut m = Motion::standing(at(0, 0.0, 170.0));
        let mut raw_error = 0f64;
        let mut error = 0f64;
        for i in 1..120u64 {
            let t = i as f64 / 60.0;
            let stamped = (t * 1e3) as u64 + 4 * (i % 2);
            let next = at(stamped, 2.0 * t, (170.0 + 90.0 * t).rem_euclid(360.0));
            let dt = (next.sent_us - m.newest.sent_us) as f64 * 1e-6;
            if i > 60 {
                raw_error = raw_error.max((2.0 / 60.0 / dt - 2.0).abs());
                error = error.max((m.velocity_m_s.x - 2.0).abs());
            }
            m = m.then(next);
        }
        assert!(raw_error > 0.4 && error < 0.7 * raw_error, "raw {raw_error}, smoothed {error} m/s");
        assert!((m.turn_deg_s - 90.0).abs() < 20.0, "{} degrees per second over the seam", m.turn_deg_s);
    }

    #[test]
    fn a_jump_is_no_motion() {
        let m = Motion::standing(at(0, 0.0, 0.0)).then(at(20, 0.03, 0.0));
        assert!(m.velocity_m_s.x > 0.3);
        assert_eq!(m.then(at(40, 7.0, 0.0)).velocity_m_s, DVec3::ZERO);
        assert_eq!(m.then(at(40, 0.05, 170.0)).turn_deg_s, 0.0);
        assert_eq!(m.then(at(20, 0.04, 0.0)).velocity_m_s, DVec3::ZERO, "no time has passed");
    }
}
