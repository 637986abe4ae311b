//! Screenshots: a picture of the window's size without the interface, and its pose as a path file.

use super::unique_file::{describe_error, first_free};
use crate::{engine::save_rgb, frame::Frame};
use ldi_protocol::Pose;
use std::{
    path::{Path, PathBuf},
    sync::{Arc, mpsc},
};

/// The file of a screenshot, or the error.
pub type Outcome = Result<PathBuf, String>;

/// Saves screenshots on their own threads, so that rendering and window do not wait for the disk.
#[derive(Clone)]
pub struct Screenshots {
    folder: PathBuf,
    outcomes: mpsc::Sender<Outcome>,
    saved: Arc<dyn Fn() + Send + Sync>,
}

impl Screenshots {
    /// Saves into `folder`. Outcomes go to the receiver; `saved` is called after each.
    pub fn new(folder: &Path, saved: impl Fn() + Send + Sync + 'static) -> (Self, mpsc::Receiver<Outcome>) {
        let (outcomes, received) = mpsc::channel();
        (Self { folder: folder.to_owned(), outcomes, saved: Arc::new(saved) }, received)
    }

    /// Saves a picture as the first free file.
    pub fn save(&self, frame: Frame, pose: Pose, fov_deg: f64) {
        let Self { folder, outcomes, saved } = self.clone();
        let work = move || {
            // The receiver is gone once the window is closed.
            let _ = outcomes.send(write(&folder, &frame, &pose, fov_deg));
            saved();
        };
        if let Err(e) = std::thread::Builder::new().name("ldi-shot".into()).spawn(work) {
            let _ = self.outcomes.send(Err(format!("no screenshot: {e}")));
        }
    }
}

fn write(folder: &Path, frame: &Frame, pose: &Pose, fov_deg: f64) -> Outcome {
    let (_, path) = first_free(folder, "ldi-", ".png")?;
    save_rgb(&path, frame.width, frame.height, &frame.to_rgb8()).map_err(|e| e.to_string())?;
    let beside = path.with_extension("path.json");
    let poses = serde_json::json!({
        "size": format!("{}x{}", frame.width, frame.height),
        "fov_deg": fov_deg,
        "poses": [{ "t": 0.0, "position": pose.position.to_array(), "yaw": pose.yaw_deg, "pitch": pose.pitch_deg }],
    });
    std::fs::write(&beside, poses.to_string() + "\n").map_err(|e| describe_error(&beside, &e))?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn screenshots_have_numbers_of_their_own_and_a_pose_that_can_be_walked() {
        let folder = std::env::temp_dir().join(format!("ldi-shot-{}", std::process::id())).join("deeper");
        let pose = Pose { position: DVec3::new(1.0, 1.6, -2.0), yaw_deg: 30.0, pitch_deg: -5.0 };
        let frame = Frame::new(4, 2);
        let paths = [(); 2].map(|()| write(&folder, &frame, &pose, 60.0).expect("written"));
        assert!(paths[0].ends_with("ldi-0001.png") && paths[1].ends_with("ldi-0002.png"), "{paths:?}");
        let text = std::fs::read_to_string(folder.join("ldi-0002.path.json")).expect("readable");
        assert_eq!(ldi_protocol::path::parse(&text).expect("a path").poses[0].pose, pose);
        assert_eq!(image::open(&paths[1]).expect("a picture").width(), 4);
        std::fs::write(folder.join("file"), "").expect("written");
        let error = write(&folder.join("file"), &frame, &pose, 60.0).expect_err("no folder");
        assert!(error.contains("--shots"), "{error}");
        std::fs::remove_dir_all(folder.parent().expect("made")).expect("removed");
    }
}
