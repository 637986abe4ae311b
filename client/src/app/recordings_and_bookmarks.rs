//! Recorded walks and bookmarks of the user, and the messages about them.

use super::{AppConfig, bookmarks::Bookmarks, events::fields, recording::Recording};
use ldi_protocol::{Pose, path::Walk};
use serde_json::{Map, Value};
use std::{path::PathBuf, sync::Arc, time::Instant};

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
    recording: Option<Recording>,
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
        if let Some(recording) = &mut self.recording {
            recording.pose(pose, at);
        }
    }

    /// Whether a walk is being recorded.
    pub fn is_recording(&self) -> bool {
        self.recording.is_some()
    }

    /// Starts a recording, or ends and saves it.
    pub fn record(&mut self, speed_m_per_s: f64) -> Announcement {
        let Some(recording) = self.recording.take() else {
            let recording = self.recording.insert(Recording::new(&self.folder, speed_m_per_s));
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

    /// Stores a pose under a digit, or returns the stored pose.
    pub fn bookmark(&mut self, digit: u8, keep: Option<Pose>, scene: &str) -> (Option<Pose>, Announcement) {
        if self.bookmarks.is_none() {
            let file = self.bookmarks_file.clone().or_else(|| Bookmarks::default_file(scene));
            match file.ok_or("this user has no home folder: give --bookmarks FILE".into()).and_then(Bookmarks::load) {
                Ok(bookmarks) => self.bookmarks = Some(bookmarks),
                Err(e) => return (None, Announcement::bad(e)),
            }
        }
        let bookmarks = self.bookmarks.as_mut();
        let there = bookmarks.as_ref().and_then(|b| b.get(digit));
        let event = Some(("bookmark", fields! { "digit": digit, "kept": keep.is_some() }));
        match (keep, there) {
            (Some(pose), _) => match bookmarks.map_or(Ok(()), |b| b.set(digit, pose)) {
                Ok(()) => (None, Announcement { text: format!("place {digit} is kept"), good: true, event }),
                Err(e) => (None, Announcement::bad(e)),
            },
            (None, Some(pose)) => (Some(pose), Announcement { text: format!("place {digit}"), good: true, event }),
            (None, None) => {
                let text = format!("no place {digit} is kept: Ctrl+{digit} keeps this one");
                (None, Announcement { text, good: false, event: None })
            }
        }
    }
}
