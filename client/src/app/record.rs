//! Walks that are kept (R) and walked again (P), as path files.
//!
//! In: the poses of pictures and when they were drawn; later the time since the replay began. Out: a path file that `walk`, `render` and `plan` take; a pose for any time,
//! interpolated between the recorded ones. Pure but for the file.

use super::numbered::{first_free, said};
use ldi_protocol::{
    Pose,
    path::{MAX_POSES, TimedPose, Walk},
};
use std::{
    io::Write as _,
    path::{Path, PathBuf},
    time::Instant,
};

/// Frames per second that the file states; its poses have times of their own.
const FPS: f64 = 60.0;

/// A walk being recorded.
#[derive(Debug)]
pub struct Recording {
    start: Option<Instant>,
    poses: Vec<TimedPose>,
}

impl Recording {
    /// Begins with the first pose that is told.
    pub fn new() -> Self {
        Self { start: None, poses: Vec::new() }
    }

    /// The eye was here at that time. A rest takes two poses, however long it is.
    pub fn pose(&mut self, pose: Pose, at: Instant) {
        let start = *self.start.get_or_insert(at);
        let t_s = at.saturating_duration_since(start).as_secs_f64();
        if self.poses.last().is_some_and(|p| p.t_s >= t_s) || self.poses.len() >= MAX_POSES {
            return;
        }
        if let [.., before, last] = &mut self.poses[..]
            && before.pose == last.pose
            && last.pose == pose
        {
            last.t_s = t_s;
            return;
        }
        self.poses.push(TimedPose { t_s, pose });
    }

    /// The walk; None where nothing was recorded. `speed_m_per_s` is what the file states.
    pub fn walk(self, speed_m_per_s: f64) -> Option<Walk> {
        (!self.poses.is_empty()).then_some(Walk { fps: FPS, speed: speed_m_per_s, eye_height: None, poses: self.poses })
    }
}

/// Writes a walk under the first free number.
pub fn save(folder: &Path, walk: &Walk) -> Result<PathBuf, String> {
    let (mut file, path) = first_free(folder, "walk-", ".path.json")?;
    file.write_all((walk.to_json() + "\n").as_bytes()).map_err(|e| said(&path, &e))?;
    Ok(path)
}

/// The pose at a time after the walk's begin; None once it is over.
pub fn pose_at(walk: &Walk, t_s: f64) -> Option<Pose> {
    let t_s = t_s + walk.poses.first()?.t_s;
    let next = walk.poses.partition_point(|p| p.t_s <= t_s);
    let (Some(a), Some(b)) = (walk.poses.get(next.saturating_sub(1)), walk.poses.get(next)) else { return None };
    let share = (t_s - a.t_s) / (b.t_s - a.t_s);
    let turn = (b.pose.yaw_deg - a.pose.yaw_deg + 180.0).rem_euclid(360.0) - 180.0;
    Some(Pose {
        position: a.pose.position.lerp(b.pose.position, share),
        yaw_deg: a.pose.yaw_deg + turn * share,
        pitch_deg: a.pose.pitch_deg + (b.pose.pitch_deg - a.pose.pitch_deg) * share,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use std::time::Duration;

    fn pose(x: f64, yaw_deg: f64) -> Pose {
        Pose { position: DVec3::new(x, 1.6, 0.0), yaw_deg, pitch_deg: 2.0 * x }
    }

    #[test]
    fn what_was_walked_is_walked_again() {
        let (mut recording, start) = (Recording::new(), Instant::now());
        let at = |ms: u64| start + Duration::from_millis(ms);
        recording.pose(pose(0.0, 170.0), at(500));
        recording.pose(pose(1.0, -170.0), at(1500));
        // A rest of eight seconds: two poses.
        for ms in (1500..9500).step_by(20) {
            recording.pose(pose(1.0, -170.0), at(ms));
        }
        recording.pose(pose(2.0, -170.0), at(10_500));
        let walk = recording.walk(1.4).expect("poses");
        assert_eq!(walk.poses.len(), 4, "{:?}", walk.poses);
        let file = ldi_protocol::path::parse(&walk.to_json()).expect("a path file");
        for walk in [&walk, &file] {
            let half = pose_at(walk, 0.5).expect("on the way");
            assert!((half.position.x - 0.5).abs() < 1e-9 && (half.pitch_deg - 1.0).abs() < 1e-9);
            // The short way round.
            assert!((half.yaw_deg - 180.0).abs() < 1e-9, "{}", half.yaw_deg);
            assert_eq!(pose_at(walk, 0.0), Some(pose(0.0, 170.0)));
            assert_eq!(pose_at(walk, 5.0).map(|p| p.position.x), Some(1.0));
            assert!(pose_at(walk, 9.5).is_some_and(|p| p.position.x > 1.4) && pose_at(walk, 10.1).is_none());
        }
        assert!(Recording::new().walk(1.4).is_none());
    }

    #[test]
    fn walks_have_numbers_of_their_own() {
        let folder = std::env::temp_dir().join(format!("ldi-record-{}", std::process::id())).join("deeper");
        let walk =
            Walk { fps: 60.0, speed: 1.4, eye_height: None, poses: vec![TimedPose { t_s: 0.0, pose: pose(0.0, 0.0) }] };
        let paths = [(); 2].map(|()| save(&folder, &walk).expect("written"));
        assert!(paths[0].ends_with("walk-0001.path.json") && paths[1].ends_with("walk-0002.path.json"), "{paths:?}");
        std::fs::write(folder.join("file"), "").expect("written");
        assert!(save(&folder.join("file"), &walk).expect_err("no folder").contains("--shots"));
        std::fs::remove_dir_all(folder.parent().expect("made")).expect("removed");
    }
}
