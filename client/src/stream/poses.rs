//! When poses go: not every frame's, and the last one again and again, as datagrams get lost. No sockets; time comes in.

use ldi_protocol::Pose;
use std::time::Duration;
use tokio::time::Instant;

/// Poses that follow one another go no closer than this, so of 60 per second every other one: the server plans again after 25 ms at the soonest, and each pose costs both
/// ends a packet. The last of them goes with the first repetition.
const LEAST_INTERVAL: Duration = Duration::from_millis(30);
/// A pose this much elsewhere than the last one that went, metres and degrees, goes at once.
const ELSEWHERE: (f64, f64) = (0.5, 15.0);
/// A pose is repeated after this time, then after twice as long, and so on up to [`MAX_REPEAT`].
const MIN_REPEAT: Duration = Duration::from_millis(50);
/// See [`MIN_REPEAT`].
const MAX_REPEAT: Duration = Duration::from_secs(2);

/// What went last, and when it goes again.
#[derive(Debug)]
pub(super) struct PoseClock {
    last: Option<(Pose, Instant)>,
    /// Time from the next repetition to the one after it.
    repeat: Duration,
    /// When the newest pose goes unless a newer one goes before.
    pub repeat_at: Instant,
}

impl PoseClock {
    /// Nothing went yet.
    pub fn new(now: Instant) -> Self {
        Self { last: None, repeat: 2 * MIN_REPEAT, repeat_at: now + MIN_REPEAT }
    }

    /// There is a new pose: whether it goes now.
    pub fn goes(&mut self, pose: &Pose, now: Instant) -> bool {
        let goes = self.last.as_ref().is_none_or(|(last, at)| {
            let turned = (pose.yaw_deg - last.yaw_deg).abs().max((pose.pitch_deg - last.pitch_deg).abs());
            let elsewhere = pose.position.distance(last.position) > ELSEWHERE.0 || turned > ELSEWHERE.1;
            elsewhere || now >= *at + LEAST_INTERVAL
        });
        if goes {
            self.last = Some((*pose, now));
            self.repeat_at = now + MIN_REPEAT;
        } else {
            self.repeat_at = self.repeat_at.min(now + MIN_REPEAT);
        }
        self.repeat = 2 * MIN_REPEAT;
        goes
    }

    /// The newest pose, if there is one, goes because its time has come.
    pub fn repeated(&mut self, pose: Option<&Pose>, now: Instant) {
        self.last = pose.map(|p| (*p, now));
        self.repeat_at = now + self.repeat;
        self.repeat = (2 * self.repeat).min(MAX_REPEAT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn pose(x: f64, yaw_deg: f64) -> Pose {
        Pose { position: DVec3::new(x, 0.0, 0.0), yaw_deg, pitch_deg: 0.0 }
    }

    #[test]
    fn of_sixty_poses_per_second_every_other_one_goes_and_jumps_at_once() {
        let start = Instant::now();
        let mut clock = PoseClock::new(start);
        let at = |frame: u64| start + Duration::from_micros(16_667 * frame);
        let went: Vec<u64> = (0..8).filter(|f| clock.goes(&pose(*f as f64 * 0.02, 0.0), at(*f))).collect();
        assert_eq!(went, [0, 2, 4, 6]);
        let soon = at(7) + Duration::from_millis(1);
        assert!(!clock.goes(&pose(0.15, 3.0), soon), "a small step");
        assert!(clock.goes(&pose(0.15, 20.0), soon), "a turn");
        assert!(clock.goes(&pose(0.75, 20.0), soon), "a jump");
    }

    #[test]
    fn the_last_pose_goes_soon_and_then_ever_more_seldom() {
        let start = Instant::now();
        let mut clock = PoseClock::new(start);
        assert!(clock.goes(&pose(0.0, 0.0), start));
        let mut waits = Vec::new();
        let mut now = start;
        for _ in 0..8 {
            waits.push((clock.repeat_at - now).as_millis());
            now = clock.repeat_at;
            clock.repeated(Some(&pose(0.0, 0.0)), now);
        }
        assert_eq!(waits, [50, 100, 200, 400, 800, 1600, 2000, 2000]);
        // One small step right after a repetition: it may not wait for the next one, two seconds later.
        let step = now + Duration::from_millis(10);
        assert!(!clock.goes(&pose(0.02, 0.0), step));
        assert_eq!(clock.repeat_at - step, MIN_REPEAT);
    }
}
