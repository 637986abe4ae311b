//! The desk between the window and the drawing thread: what was pressed and turned lies on one side, finished pictures on the other.

use super::{
    render_loop::RenderLoop,
    screenshot::Screenshots,
    server_connection::ServerConnection,
    walker::{self, Intent, Walker},
};
use crate::{
    engine::{DisplayMode, FrameRenderer, FrameStats},
    frame::Frame,
};
use glam::DVec3;
use ldi_protocol::{Pose, path::Walk, select::Selection};
use std::{
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
    time::{Duration, Instant},
};

/// What a picture took, showed and lacked.
#[derive(Debug, Clone)]
pub struct PictureStats {
    /// The engine's.
    pub frame_stats: FrameStats,
    /// Grid point and placement.
    pub selection: Selection,
    /// Stored bytes of the missing chunks.
    pub missing_bytes: u64,
    /// Stored bytes of all chunks that the view needs.
    pub needed_bytes: u64,
    /// Cells left out because the budget was used up.
    pub dropped_cells: u32,
    /// Whether what is far is softer because no image was made for the place.
    pub unplanned: bool,
    /// Samples per pixel along each side.
    pub supersample: u32,
    /// What it shows.
    pub shows: DisplayMode,
    /// Name of the card that drew it, and bytes of the scene that lie on it; None for the processor.
    pub card: Option<(String, u64)>,
}

/// A finished picture.
#[derive(Debug, Clone)]
pub struct Picture {
    /// The pixels.
    pub frame: Frame,
    /// The eye.
    pub pose: Pose,
    /// Horizontal field of view.
    pub fov_deg: f64,
    /// What it took.
    pub stats: PictureStats,
    /// The eye is not yet where the visit begins.
    pub searching_start: bool,
    /// When it was finished.
    pub at: Instant,
}

/// What the two threads hand each other.
pub(super) struct RenderMailbox {
    pub walker: Option<Walker>,
    /// Where to begin, if somebody said so.
    pub begin: Option<Pose>,
    pub intent: Intent,
    /// Degrees since the last frame.
    pub turned: (f64, f64),
    pub notches: f64,
    /// Walls can be walked through.
    pub ghost: bool,
    pub teleport: Option<DVec3>,
    pub window_px: [u32; 2],
    pub shot: bool,
    pub shows: DisplayMode,
    pub place: Option<Pose>,
    /// A walk that is walked again, and since when.
    pub replay: Option<(Arc<Walk>, Option<Instant>)>,
    pub frame_ms: f64,
    /// Resting pictures get four samples per pixel.
    pub fine: bool,
    pub done: Option<Picture>,
    pub spare: Option<Frame>,
    pub stop: bool,
    /// The last time the walker was moved.
    pub moved: Instant,
}

/// The drawing thread; stopped when dropped.
pub struct RenderThread {
    mailbox: Arc<(Mutex<RenderMailbox>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

/// How to draw.
#[derive(Debug, Clone)]
pub struct RenderConfig {
    /// Time for a frame while moving.
    pub frame_ms: f64,
    /// Where to begin; None for a place of its own choice.
    pub begin: Option<Pose>,
    /// Size of the window.
    pub window_px: [u32; 2],
    /// Shortest time between the beginnings of two frames.
    pub interval: Duration,
    /// No display holds pictures back until it shows the next one: the time between two is as even as drawing allows if each is finished
    /// when the next begins.
    pub even: bool,
}

pub(super) fn lock(mailbox: &Mutex<RenderMailbox>) -> MutexGuard<'_, RenderMailbox> {
    // Every change is complete before anything can panic.
    mailbox.lock().unwrap_or_else(PoisonError::into_inner)
}

impl RenderThread {
    /// Begins to draw what `connection` brings. `done` is called after every picture, `screenshots` takes the screenshots.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start(
        config: RenderConfig,
        renderer: FrameRenderer,
        connection: Arc<ServerConnection>,
        screenshots: Screenshots,
        done: impl Fn() + Send + 'static,
    ) -> std::io::Result<Self> {
        let mailbox = RenderMailbox {
            walker: None,
            begin: config.begin,
            intent: Intent::default(),
            turned: (0.0, 0.0),
            notches: 0.0,
            ghost: false,
            teleport: None,
            window_px: config.window_px,
            shot: false,
            shows: DisplayMode::default(),
            place: None,
            replay: None,
            frame_ms: config.frame_ms,
            fine: true,
            done: None,
            spare: None,
            stop: false,
            moved: Instant::now(),
        };
        let mailbox = Arc::new((Mutex::new(mailbox), Condvar::new()));
        let render_loop = RenderLoop::new(mailbox.clone(), renderer, connection, screenshots, Box::new(done), &config);
        let thread = std::thread::Builder::new().name("ldi-draw".into()).spawn(move || render_loop.run())?;
        Ok(Self { mailbox, thread: Some(thread) })
    }

    fn update(&self, change: impl FnOnce(&mut RenderMailbox)) {
        change(&mut lock(&self.mailbox.0));
        self.mailbox.1.notify_all();
    }

    /// What is pressed now.
    pub fn set_intent(&self, intent: Intent) {
        self.update(|d| d.intent = intent);
    }

    /// The head turned, degrees: positive left and up.
    pub fn turn(&self, yaw_deg: f64, pitch_deg: f64) {
        self.update(|d| {
            d.turned.0 += yaw_deg;
            d.turned.1 += pitch_deg;
        });
    }

    /// The wheel turned.
    pub fn change_speed(&self, notches: f64) {
        self.update(|d| d.notches += notches);
    }

    /// Opens the walls or closes them. Whether they are closed now.
    pub fn toggle_walls(&self) -> bool {
        let mut mailbox = lock(&self.mailbox.0);
        mailbox.ghost = !mailbox.ghost;
        !mailbox.ghost
    }

    /// To the place of the volume nearest to `p`.
    pub fn teleport(&self, p: DVec3) {
        self.update(|d| d.teleport = Some(p));
    }

    /// To the place of the volume nearest to a pose, looking as it does.
    pub fn place(&self, pose: Pose) {
        self.update(|d| d.place = Some(pose));
    }

    /// What pictures show from now on.
    pub fn show(&self, shows: DisplayMode) {
        self.update(|d| d.shows = shows);
    }

    /// Walks along a walk from its begin, or ends that. Whatever moves the walker ends it too.
    pub fn replay(&self, walk: Option<Arc<Walk>>) {
        self.update(|d| d.replay = walk.map(|w| (w, None)));
    }

    /// Whether a walk is walked again.
    pub fn is_replaying(&self) -> bool {
        lock(&self.mailbox.0).replay.is_some()
    }

    /// Time for a picture while moving, milliseconds, and whether resting pictures get four samples per pixel.
    pub fn apply_settings(&self, frame_ms: f64, fine: bool) {
        self.update(|d| (d.frame_ms, d.fine) = (frame_ms, fine));
    }

    /// The window has another size.
    pub fn resize(&self, window_px: [u32; 2]) {
        self.update(|d| d.window_px = window_px);
    }

    /// Draws a picture for the disk.
    pub fn take_screenshot(&self) {
        self.update(|d| d.shot = true);
    }

    /// The newest picture that was not taken yet. `last` gives back the memory of the one before.
    pub fn take(&self, last: &mut Option<Picture>) -> bool {
        let mut mailbox = lock(&self.mailbox.0);
        let Some(new) = mailbox.done.take() else { return false };
        mailbox.spare = last.replace(new).map(|p| p.frame);
        true
    }

    /// The speed that the wheel has chosen, m/s.
    pub fn speed_m_per_s(&self) -> f64 {
        lock(&self.mailbox.0).walker.as_ref().map_or(walker::WALK_M_PER_S, Walker::speed_m_per_s)
    }
}

impl Drop for RenderThread {
    fn drop(&mut self) {
        self.update(|d| d.stop = true);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
