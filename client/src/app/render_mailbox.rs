//! The mailbox between the window's thread and the render thread: input in one direction, finished
//! pictures in the other.

use super::{
    settings::UserSettings,
    start_pose::MovedStart,
    walker::{Intent, Walker},
};
use crate::{
    engine::{DisplayMode, FrameStats},
    frame::Frame,
};
use ldi_protocol::{Pose, path::Walk, select::Selection};
use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

/// Statistics of a picture.
#[derive(Debug, Clone)]
pub struct PictureStats {
    /// Statistics of the renderer.
    pub frame_stats: FrameStats,
    /// Selected grid point and placement.
    pub selection: Selection,
    /// Stored bytes of the missing chunks.
    pub missing_bytes: u64,
    /// Stored bytes of all chunks that the view needs.
    pub needed_bytes: u64,
    /// Cells left out because they exceed the budget.
    pub dropped_cells: u32,
    /// Whether distant parts are coarser because no image was made for the eye's position.
    pub unplanned: bool,
    /// Samples per pixel along each side.
    pub supersample: u32,
    /// Display mode.
    pub shows: DisplayMode,
    /// Name of the GPU, and bytes of the scene on it; None if the CPU rendered.
    pub card: Option<(String, u64)>,
}

/// A finished picture.
#[derive(Debug, Clone)]
pub struct Picture {
    /// The pixels.
    pub frame: Frame,
    /// The eye's pose.
    pub pose: Pose,
    /// Horizontal field of view, degrees.
    pub fov_deg: f64,
    /// Statistics.
    pub stats: PictureStats,
    /// Whether the search for a start pose is still in progress.
    pub searching_start: bool,
    /// The time it was finished.
    pub at: Instant,
}

/// State shared by both threads.
pub(super) struct RenderMailbox {
    pub walker: Option<Walker>,
    /// The start pose, if given.
    pub begin: Option<Pose>,
    pub intent: Intent,
    /// Turn since the last frame, degrees: yaw, pitch.
    pub turned: (f64, f64),
    pub notches: f64,
    /// Whether collision is off.
    pub ghost: bool,
    pub window_px: [u32; 2],
    pub shot: bool,
    pub shows: DisplayMode,
    pub place: Option<Pose>,
    /// The replayed walk, and the time it started.
    pub replay: Option<(Arc<Walk>, Option<Instant>)>,
    pub settings: UserSettings,
    /// The move of a given start pose, until the window takes it.
    pub moved_start: Option<MovedStart>,
    pub done: Option<Picture>,
    pub spare: Option<Frame>,
    pub stop: bool,
    /// The last time the walker was moved.
    pub moved: Instant,
}

/// Settings of the render thread.
#[derive(Debug, Clone)]
pub struct RenderConfig {
    /// The user's settings.
    pub settings: UserSettings,
    /// Start pose; None for one chosen by the client.
    pub begin: Option<Pose>,
    /// Size of the window, pixels.
    pub window_px: [u32; 2],
    /// Shortest time between the starts of two frames.
    pub interval: Duration,
    /// Whether the render loop paces pictures, because no display does: intervals are most even if
    /// each picture is finished when the next one starts.
    pub even: bool,
}

pub(super) fn lock(mailbox: &Mutex<RenderMailbox>) -> MutexGuard<'_, RenderMailbox> {
    // Every change is complete before anything can panic.
    mailbox.lock().unwrap_or_else(PoisonError::into_inner)
}
