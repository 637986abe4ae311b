//! Recorded walks and bookmarks of the user, and the messages about them.

use super::{
    AppConfig,
    bookmarks::{Bookmarks, LAST_PLACE},
    events::fields,
    recording::Recording,
};
use ldi_protocol::{Pose, path::Walk};
use serde_json::{Map, Value};
use std::{
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant},
};

/// A message for the user, and an event.
pub(super) struct Announcement {
    pub text: String,
    pub good: bool,
    pub event: Option<(&'static str, Map<String, Value>)>,
}

impl Announcement {
    fn bad(text: String) -> Self {
        tracing::warn!("{text}");
        Self { text, good: false, event: None }
    }
}

/// The user's recordings and bookmarks.
pub(super) struct RecordingsAndBookmarks {
    folder: PathBuf,
    /// The recording in progress, and when it was started.
    recording: Option<(Recording, Instant)>,
    /// The walk that P replays.
    walk: Option<Arc<Walk>>,
    bookmarks: Option<Bookmarks>,
    bookmarks_file: Option<PathBuf>,
}

impl RecordingsAndBookmarks {
    pub fn new(config: &AppConfig) -> Self {
        Self {
            folder: config.screenshots.clone(),
            recording: None,
            walk: config.replay.clone().map(Arc::new),
            bookmarks: None,
            bookmarks_file: config.bookmarks.clone(),
        }
    }

    /// The walk to replay, if any.
    pub fn walk(&self) -> Option<Arc<Walk>> {
        self.walk.clone()
    }

    /// Records the pose of a picture.
    pub fn pose(&mut self, pose: Pose, at: Instant) {
        if let Some((recording, _)) = &mut self.recording {
            recording.pose(pose, at);
        }
    }

    /// Time since the recording in progress was started.
    pub fn recording_time(&self) -> Option<Duration> {
        self.recording.as_ref().map(|(_, since)| since.elapsed())
    }

    /// Starts a recording, or ends and saves it.
    pub fn record(&mut self, speed_m_per_s: f64) -> Announcement {
        let Some((recording, _)) = self.recording.take() else {
            let new = (Recording::new(&self.folder, speed_m_per_s), Instant::now());
            let (recording, _) = self.recording.insert(new);
            if let Some(e) = recording.trouble() {
                return Announcement::bad(format!("the walk can be walked again, but not saved: {e}"));
            }
            let event = Some(("recording", fields! {}));
            return Announcement { text: "recording the walk: R ends it".into(), good: true, event };
        };
        let (Some(walk), saved) = recording.end() else { return Announcement::bad("nothing was recorded".into()) };
        let poses = walk.poses.len();
        self.walk = Some(Arc::new(walk));
        match saved.map(|path| std::path::absolute(&path).unwrap_or(path).display().to_string()) {
            Ok(path) => {
                println!("{path}");
                let text = format!("saved {path}: P walks it again");
                Announcement { text, good: true, event: Some(("recorded", fields! { "path": path, "poses": poses })) }
            }
            Err(e) => Announcement::bad(e),
        }
    }

    /// The bookmarks of a scene, read at first use.
    fn bookmarks(&mut self, scene: &str) -> Result<&mut Bookmarks, String> {
        let bookmarks = match self.bookmarks.take() {
            Some(bookmarks) => bookmarks,
            None => {
                let file = self.bookmarks_file.clone().or_else(|| Bookmarks::default_file(scene));
                Bookmarks::load(file.ok_or("this user has no home folder: give --bookmarks FILE")?)?
            }
        };
        Ok(self.bookmarks.insert(bookmarks))
    }

    /// Whether the place where the last visit ended is known.
    pub fn knows_last_place(&mut self, scene: &str) -> bool {
        self.bookmarks(scene).is_ok_and(|b| b.get(LAST_PLACE).is_some())
    }

    /// Keeps the place where a visit ends.
    pub fn keep_last_place(&mut self, pose: Pose, scene: &str) {
        if let Err(e) = self.bookmarks(scene).and_then(|b| b.set(LAST_PLACE, pose)) {
            tracing::warn!("the next visit does not know where this one ended: {e}");
        }
    }

    /// Stores a pose under a digit, or returns the stored pose.
    pub fn bookmark(&mut self, digit: u8, keep: Option<Pose>, scene: &str) -> (Option<Pose>, Announcement) {
        let bookmarks = match self.bookmarks(scene) {
            Ok(bookmarks) => bookmarks,
            Err(e) => return (None, Announcement::bad(e)),
        };
        let there = bookmarks.get(digit);
        let event = Some(("bookmark", fields! { "digit": digit, "kept": keep.is_some() }));
        match (keep, there) {
            (Some(pose), _) => match bookmarks.set(digit, pose) {
                Ok(()) => (None, Announcement { text: format!("place {digit} is kept"), good: true, event }),
                Err(e) => (None, Announcement::bad(e)),
            },
            (None, Some(pose)) if digit == LAST_PLACE => {
                let text = "where the last visit ended".into();
                (Some(pose), Announcement { text, good: true, event })
            }
            (None, None) if digit == LAST_PLACE => {
                let text = "no earlier visit to this scene is known".into();
                (None, Announcement { text, good: false, event: None })
            }
            (None, Some(pose)) => (Some(pose), Announcement { text: format!("place {digit}"), good: true, event }),
            (None, None) => {
                let text = format!("no place {digit} is kept: Ctrl+{digit} keeps this one");
                (None, Announcement { text, good: false, event: None })
            }
        }
    }
}
