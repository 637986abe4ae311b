//! Pose updates: which poses are sent, and when.
//!
//! Dead reckoning, as in networked simulations: both ends extrapolate the motion of the last two
//! sent poses. While the eye follows that motion, the server's prediction holds, and a pose would
//! only cost a packet and a plan. Predicted poses are sent rarely, as datagrams get lost.

use glam::DVec3;
use ldi_protocol::{Pose, camera::apart_deg};
use std::{
    sync::{Mutex, PoisonError},
    time::Duration,
};
use tokio::{
    sync::Notify,
    time::{Instant, sleep_until},
};

/// Shortest interval between poses, about two frames: the server does not plan more often.
const LEAST_INTERVAL: Duration = Duration::from_millis(30);
/// Longest interval between poses of a moving eye. Longer: fewer packets, and an older prediction.
const MOST_INTERVAL: Duration = Duration::from_millis(100);
/// A pose is predicted if it is within this distance of the extrapolated motion, metres and
/// degrees.
const FORETOLD: (f64, f64) = (0.03, 2.0);
/// A pose beyond this distance is sent at once, but not sooner than [`JUMP_INTERVAL`].
const ELSEWHERE: (f64, f64) = (0.5, 15.0);
/// Shortest interval of unpredicted jumps, within the server's rate limit.
const JUMP_INTERVAL: Duration = Duration::from_millis(10);
/// Time until a pose that was sent at once is repeated.
const FIRST_REPEAT: Duration = Duration::from_millis(50);
/// An unchanged pose is repeated after [`MOST_INTERVAL`], then after doubled intervals up to this.
const MAX_REPEAT: Duration = Duration::from_secs(2);

/// Decides when poses are sent. Pure: time is passed in.
#[derive(Debug, Default)]
pub struct PoseClock {
    newest: Option<Pose>,
    sent: Option<Sent>,
    due: Option<Duration>,
    repeat: Duration,
}

/// A sent pose, and the motion at that time.
#[derive(Debug, Clone, Copy)]
struct Sent {
    pose: Pose,
    at: Duration,
    velocity_m_s: DVec3,
    /// Yaw and pitch rate, degrees per second.
    turn_deg_s: [f64; 2],
}

impl Sent {
    /// Distance of a pose from the extrapolated motion, metres and degrees.
    fn off(&self, pose: &Pose, now: Duration) -> (f64, f64) {
        let t = now.saturating_sub(self.at).as_secs_f64();
        let place = self.pose.position + self.velocity_m_s * t;
        let [yaw, pitch] = turned(&self.pose, pose);
        let turn = (yaw - self.turn_deg_s[0] * t).abs().max((pitch - self.turn_deg_s[1] * t).abs());
        (pose.position.distance(place), turn)
    }

    /// The state after the next sent pose.
    fn then(&self, pose: Pose, at: Duration) -> Self {
        let t = (at.saturating_sub(self.at)).as_secs_f64().max(1e-3);
        Self {
            pose,
            at,
            velocity_m_s: (pose.position - self.pose.position) / t,
            turn_deg_s: turned(&self.pose, &pose).map(|d| d / t),
        }
    }
}

/// Turn from one pose to another in yaw and pitch, degrees.
fn turned(from: &Pose, to: &Pose) -> [f64; 2] {
    [apart_deg(from.yaw_deg, to.yaw_deg), to.pitch_deg - from.pitch_deg]
}

fn beyond((metres, degrees): (f64, f64), limit: (f64, f64)) -> bool {
    metres > limit.0 || degrees > limit.1
}

impl PoseClock {
    /// Sets the eye's pose. Returns whether a pose is due sooner than before.
    pub fn update_view(&mut self, pose: &Pose, now: Duration) -> bool {
        self.newest = Some(*pose);
        let due = match &self.sent {
            None => now,
            Some(sent) => {
                let off = sent.off(pose, now);
                if beyond(off, ELSEWHERE) {
                    sent.at + JUMP_INTERVAL
                } else if beyond(off, FORETOLD) {
                    sent.at + LEAST_INTERVAL
                } else if *pose != sent.pose {
                    sent.at + MOST_INTERVAL
                } else {
                    return false;
                }
            }
        };
        let sooner = self.due.is_none_or(|before| due < before);
        if sooner {
            self.due = Some(due);
        }
        sooner
    }

    /// Takes the newest pose, if it is due.
    pub fn take(&mut self, now: Duration) -> Option<Pose> {
        let pose = self.newest.filter(|_| self.due.is_some_and(|due| now >= due))?;
        let jumped = self.sent.as_ref().is_none_or(|s| beyond(s.off(&pose, now), ELSEWHERE));
        self.repeat = match &self.sent {
            _ if jumped => FIRST_REPEAT,
            Some(sent) if sent.pose == pose => (2 * self.repeat).min(MAX_REPEAT),
            _ => MOST_INTERVAL,
        };
        let standing = Sent { pose, at: now, velocity_m_s: DVec3::ZERO, turn_deg_s: [0.0; 2] };
        self.sent = Some(self.sent.filter(|_| !jumped).map_or(standing, |s| s.then(pose, now)));
        self.due = Some(now + self.repeat);
        Some(pose)
    }
}

/// Poses passed from the render thread to the session.
#[derive(Debug)]
pub(super) struct PoseUpdates {
    clock: Mutex<PoseClock>,
    began: Instant,
    sooner: Notify,
}

impl PoseUpdates {
    /// None yet.
    pub fn new() -> Self {
        Self { clock: Mutex::default(), began: Instant::now(), sooner: Notify::new() }
    }

    fn with<T>(&self, f: impl FnOnce(&mut PoseClock, Duration) -> T) -> T {
        // The state is valid even after a panic.
        f(&mut self.clock.lock().unwrap_or_else(PoisonError::into_inner), self.began.elapsed())
    }

    /// Sets the eye's pose.
    pub fn update_view(&self, pose: &Pose) {
        if self.with(|clock, now| clock.update_view(pose, now)) {
            self.sooner.notify_one();
        }
    }

    /// The newest pose.
    pub fn newest(&self) -> Option<Pose> {
        self.with(|clock, _| clock.newest)
    }

    /// Waits until a pose is due. Cancel-safe.
    pub async fn next(&self) -> Pose {
        loop {
            let (pose, due) = self.with(|clock, now| (clock.take(now), clock.due));
            if let Some(pose) = pose {
                return pose;
            }
            let sleep = async {
                match due {
                    Some(due) => sleep_until(self.began + due).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                () = self.sooner.notified() => {}
                () = sleep => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f64, yaw_deg: f64) -> Pose {
        Pose { position: DVec3::new(x, 0.0, 0.0), yaw_deg, pitch_deg: 0.0 }
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// Times in milliseconds at which poses of a walk are sent. The walk is updated 60 times per
    /// second, the clock read every millisecond.
    fn went(clock: &mut PoseClock, walk: impl Fn(f64) -> Pose, from_ms: u64, to_ms: u64) -> Vec<u64> {
        let mut out = Vec::new();
        for t in from_ms..to_ms {
            let frame = t * 60 / 1000;
            if frame != t.saturating_sub(1) * 60 / 1000 || t == 0 {
                clock.update_view(&walk(frame as f64 / 60.0), ms(t));
            }
            out.extend(clock.take(ms(t)).map(|_| t));
        }
        out
    }

    #[test]
    fn a_steady_walk_needs_ten_poses_per_second_and_a_turn_is_told_soon() {
        let mut clock = PoseClock::default();
        let steady = |t: f64| pose(1.4 * t, 179.0 + 90.0 * t);
        let first = went(&mut clock, steady, 0, 1000);
        assert!((10..=14).contains(&first.len()), "{first:?}");
        // Stands still and turns faster the other way.
        let turns = |t: f64| pose(1.4, 269.0 - 120.0 * (t - 1.0).max(0.0));
        let then = went(&mut clock, turns, 1000, 1200);
        assert!(then[0] < 1060, "told late: {then:?}");
        assert!(then.windows(2).all(|w| w[1] - w[0] >= 30), "{then:?}");
    }

    #[test]
    fn an_unsteady_one_goes_with_every_other_frame() {
        let mut clock = PoseClock::default();
        let shaken = |t: f64| pose(0.0, 6.0 * (t * 40.0).sin());
        let all = went(&mut clock, shaken, 0, 1000);
        assert!((20..=34).contains(&all.len()) && all.windows(2).all(|w| w[1] - w[0] >= 30), "{all:?}");
    }

    #[test]
    fn jumps_go_at_once_and_are_repeated_soon() {
        let mut clock = PoseClock::default();
        assert!(clock.update_view(&pose(0.0, 0.0), ms(0)) && clock.take(ms(0)).is_some());
        assert!(!clock.update_view(&pose(0.02, 0.0), ms(5)) && clock.take(ms(5)).is_none(), "a small step");
        assert!(clock.update_view(&pose(0.02, 20.0), ms(12)) && clock.take(ms(12)).is_some(), "a turn");
        assert!(clock.update_view(&pose(0.72, 20.0), ms(13)) && clock.take(ms(13)).is_none(), "a jump right after it");
        assert!(clock.take(ms(12) + JUMP_INTERVAL).is_some());
        assert_eq!(clock.due, Some(ms(12) + JUMP_INTERVAL + FIRST_REPEAT));
    }

    #[test]
    fn the_last_pose_goes_ever_more_seldom_until_there_is_another() {
        let mut clock = PoseClock::default();
        clock.update_view(&pose(0.0, 0.0), ms(0));
        let mut at = vec![0];
        for _ in 0..9 {
            let now = clock.due.unwrap();
            at.push(now.as_millis() as u64);
            assert!(clock.take(now).is_some());
            assert!(!clock.update_view(&pose(0.0, 0.0), now + ms(1)), "the same again is no news");
        }
        let waits: Vec<u64> = at.windows(2).map(|w| w[1] - w[0]).collect();
        assert_eq!(waits, [0, 50, 100, 200, 400, 800, 1600, 2000, 2000]);
        // A small step right after a repetition may not wait for the next one, two seconds later.
        let now = ms(at[9] + 10);
        assert!(clock.update_view(&pose(0.02, 0.0), now));
        assert_eq!(clock.due, Some(ms(at[9]) + MOST_INTERVAL));
    }

    #[tokio::test(start_paused = true)]
    async fn waiting_ends_when_a_pose_goes() {
        let poses = PoseUpdates::new();
        let nothing = tokio::time::timeout(ms(500), poses.next()).await;
        assert!(nothing.is_err());
        let (first, ()) = tokio::join!(poses.next(), async { poses.update_view(&pose(1.0, 0.0)) });
        assert_eq!(first, pose(1.0, 0.0));
        let before = Instant::now();
        assert_eq!(poses.next().await, pose(1.0, 0.0));
        assert_eq!(before.elapsed().as_millis() / 10, 5, "repeated after 50 ms");
        let (jumped, ()) = tokio::join!(poses.next(), async { poses.update_view(&pose(9.0, 0.0)) });
        assert_eq!((jumped, poses.newest()), (pose(9.0, 0.0), Some(pose(9.0, 0.0))));
    }
}
