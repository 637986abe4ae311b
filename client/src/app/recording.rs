//! Recorded walks (R) and their replay (P), as path files.
//!
//! In: poses of pictures and their times; for replay the time since its start. Out: a path file for
//! `walk`, `render` and `plan`; a pose for any time, interpolated between the recorded ones. The
//! file is saved every few seconds, so that a crash loses little.

use super::unique_file::{describe_error, first_free};
use ldi_protocol::{
    Pose,
    path::{MAX_POSES, TimedPose, Walk},
};
use std::{
    path::{Path, PathBuf},
    thread::JoinHandle,
    time::{Duration, Instant},
};

/// Frame rate stated in the file. Its poses have their own times.
const FPS: f64 = 60.0;

/// Time until the first save, and between later ones.
const SAVED_AFTER: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(10)];

/// A walk being recorded.
#[derive(Debug)]
pub struct Recording {
    walk: Walk,
    /// Time of the first pose, and of the next save.
    times: Option<[Instant; 2]>,
    /// The file, or the reason why there is none.
    file: Result<PathBuf, String>,
    saving: Option<JoinHandle<()>>,
}

impl Recording {
    /// Starts a recording in the first free file. `speed_m_per_s`: walking speed stated in the
    /// file.
    pub fn new(folder: &Path, speed_m_per_s: f64) -> Self {
        let walk = Walk { fps: FPS, speed: speed_m_per_s, eye_height: None, poses: Vec::new() };
        let file = first_free(folder, "walk-", ".path.json").map(|(_, path)| path);
        Self { walk, times: None, file, saving: None }
    }

    /// The reason why the recording cannot be saved.
    pub fn trouble(&self) -> Option<&String> {
        self.file.as_ref().err()
    }

    /// Records the pose of a picture. A rest takes two poses, however long it is.
    pub fn pose(&mut self, pose: Pose, at: Instant) {
        let [start, due] = *self.times.get_or_insert([at, at + SAVED_AFTER[0]]);
        let t_s = at.saturating_duration_since(start).as_secs_f64();
        let poses = &mut self.walk.poses;
        if poses.last().is_some_and(|p| p.t_s >= t_s) || poses.len() >= MAX_POSES {
            return;
        }
        if let [.., before, last] = &mut poses[..]
            && before.pose == last.pose
            && last.pose == pose
        {
            last.t_s = t_s;
        } else {
            poses.push(TimedPose { t_s, pose });
        }
        if at >= due && self.saving.as_ref().is_none_or(|s| s.is_finished()) {
            self.times = Some([start, at + SAVED_AFTER[1]]);
            self.save_beside();
        }
    }

    /// Saves the recording on its own thread, so that no picture waits for the disk.
    fn save_beside(&mut self) {
        let Ok(path) = self.file.clone() else { return };
        let walk = self.walk.clone();
        self.saving = Some(std::thread::spawn(move || {
            write(&path, &walk).unwrap_or_else(|e| tracing::warn!("the walk so far is not saved: {e}"));
        }));
    }

    /// Ends and saves the recording. Returns the walk even if it cannot be saved; None if nothing
    /// was recorded.
    pub fn end(mut self) -> (Option<Walk>, Result<PathBuf, String>) {
        // A save that ended later would restore an older state.
        if let Some(Err(_)) = self.saving.take().map(JoinHandle::join) {
            tracing::warn!("saving the walk so far failed");
        }
        if self.walk.poses.is_empty() {
            // Removes the empty file.
            let _ = self.file.as_ref().map(std::fs::remove_file);
            return (None, self.file);
        }
        let saved = self.file.and_then(|path| write(&path, &self.walk).map(|()| path));
        (Some(self.walk), saved)
    }
}

/// Replaces the file as a whole.
fn write(path: &Path, walk: &Walk) -> Result<(), String> {
    let part = path.with_extension("part");
    let done = std::fs::write(&part, walk.to_json() + "\n").and_then(|()| std::fs::rename(&part, path));
    done.map_err(|e| describe_error(path, &e))
}

/// The pose at a time after the start; None after the end.
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

    fn folder(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!("ldi-record-{}", std::process::id())).join(name)
    }

    #[test]
    fn what_was_walked_is_walked_again() {
        let folder = folder("again");
        let (mut recording, start) = (Recording::new(&folder, 1.4), Instant::now());
        let at = |ms: u64| start + Duration::from_millis(ms);
        recording.pose(pose(0.0, 170.0), at(500));
        recording.pose(pose(1.0, -170.0), at(1500));
        // A rest of eight seconds: two poses.
        for ms in (1500..9500).step_by(20) {
            recording.pose(pose(1.0, -170.0), at(ms));
        }
        recording.pose(pose(2.0, -170.0), at(10_500));
        let (Some(walk), Ok(path)) = recording.end() else { panic!("poses, and a file") };
        assert_eq!(walk.poses.len(), 4, "{:?}", walk.poses);
        let file = ldi_protocol::path::parse(&std::fs::read_to_string(path).expect("saved")).expect("a path file");
        for walk in [&walk, &file] {
            let half = pose_at(walk, 0.5).expect("on the way");
            assert!((half.position.x - 0.5).abs() < 1e-9 && (half.pitch_deg - 1.0).abs() < 1e-9);
            // The short way round.
            assert!((half.yaw_deg - 180.0).abs() < 1e-9, "{}", half.yaw_deg);
            assert_eq!(pose_at(walk, 0.0), Some(pose(0.0, 170.0)));
            assert_eq!(pose_at(walk, 5.0).map(|p| p.position.x), Some(1.0));
            assert!(pose_at(walk, 9.5).is_some_and(|p| p.position.x > 1.4) && pose_at(walk, 10.1).is_none());
        }
        std::fs::remove_dir_all(folder).expect("removed");
    }

    #[test]
    fn a_walk_that_nobody_ends_is_saved_all_the_same() {
        let folder = folder("torn");
        let (mut recording, start) = (Recording::new(&folder, 1.4), Instant::now());
        let at = |ms: u64| start + Duration::from_millis(ms);
        let saved = || {
            let text = std::fs::read_to_string(folder.join("walk-0001.path.json")).expect("its number is taken");
            ldi_protocol::path::parse(&text).map_or(0, |walk| walk.poses.len())
        };
        let mut found = Vec::new();
        for k in 0..240u32 {
            recording.pose(pose(f64::from(k) * 0.1, 0.0), at(u64::from(k) * 50));
            if let Some(saving) = recording.saving.take_if(|_| k % 10 == 0) {
                saving.join().expect("written");
            }
            if k % 60 == 0 {
                found.push(saved());
            }
        }
        // After one second and eleven: poses 0 to 20, and 0 to 220.
        assert_eq!(found, [0, 21, 21, 21]);
        drop(recording.saving.take().map(JoinHandle::join));
        assert_eq!(saved(), 221);
        drop(recording);
        std::fs::remove_dir_all(folder).expect("removed");
    }

    #[test]
    fn walks_have_numbers_of_their_own() {
        let folder = folder("numbers");
        let ended = |folder: &Path, poses: u32| {
            let mut recording = Recording::new(folder, 1.4);
            (0..poses).for_each(|_| recording.pose(pose(0.0, 0.0), Instant::now()));
            recording.end()
        };
        let paths = [(); 2].map(|()| ended(&folder, 1).1.expect("written"));
        assert!(paths[0].ends_with("walk-0001.path.json") && paths[1].ends_with("walk-0002.path.json"), "{paths:?}");
        assert!(ended(&folder, 0).0.is_none() && !folder.join("walk-0003.path.json").exists(), "nothing was recorded");
        std::fs::write(folder.join("file"), "").expect("written");
        let (walk, nowhere) = ended(&folder.join("file"), 1);
        assert!(walk.is_some() && nowhere.expect_err("no folder").contains("--shots"));
        std::fs::remove_dir_all(folder).expect("removed");
    }
}
