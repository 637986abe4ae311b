//! The render thread's handle: starts it, passes commands to it, takes finished pictures from it.

use super::{
    render_loop::RenderLoop,
    render_mailbox::{Picture, RenderConfig, RenderMailbox, lock},
    screenshot::Screenshots,
    server_connection::ServerConnection,
    settings::UserSettings,
    start_pose::MovedStart,
    walker::{Intent, Walker},
};
use crate::engine::{DisplayMode, FrameRenderer};
use ldi_protocol::{Pose, path::Walk};
use std::{
    sync::{Arc, Condvar, Mutex},
    thread::JoinHandle,
    time::Instant,
};

/// The render thread's handle. Dropping it stops the thread.
pub struct RenderThread {
    mailbox: Arc<(Mutex<RenderMailbox>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

impl RenderThread {
    /// Starts the thread. `done` is called after every picture; `screenshots` saves screenshots.
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
            window_px: config.window_px,
            shot: false,
            shows: DisplayMode::default(),
            place: None,
            replay: None,
            settings: config.settings.clone(),
            moved_start: None,
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

    /// Sets the intent of keys and gamepad.
    pub fn set_intent(&self, intent: Intent) {
        self.update(|d| d.intent = intent);
    }

    /// Turns the head, degrees: positive left and up.
    pub fn turn(&self, yaw_deg: f64, pitch_deg: f64) {
        self.update(|d| {
            d.turned.0 += yaw_deg;
            d.turned.1 += pitch_deg;
        });
    }

    /// Changes the speed by notches of the wheel.
    pub fn change_speed(&self, notches: f64) {
        self.update(|d| d.notches += notches);
    }

    /// Switches collision on or off. Returns whether it is on now.
    pub fn toggle_walls(&self) -> bool {
        let mut mailbox = lock(&self.mailbox.0);
        mailbox.ghost = !mailbox.ghost;
        !mailbox.ghost
    }

    /// Moves the walker to the place of the volume nearest to a pose, with its direction.
    pub fn place(&self, pose: Pose) {
        self.update(|d| d.place = Some(pose));
    }

    /// Sets the display mode.
    pub fn show(&self, shows: DisplayMode) {
        self.update(|d| d.shows = shows);
    }

    /// Starts to replay a walk, or ends the replay. Any other movement ends it too.
    pub fn replay(&self, walk: Option<Arc<Walk>>) {
        self.update(|d| d.replay = walk.map(|w| (w, None)));
    }

    /// Whether a walk is being replayed.
    pub fn is_replaying(&self) -> bool {
        lock(&self.mailbox.0).replay.is_some()
    }

    /// Applies the user's settings.
    pub fn apply_settings(&self, settings: &UserSettings) {
        self.update(|d| {
            d.settings.clone_from(settings);
            if let Some(walker) = &mut d.walker {
                walker.set_speed(settings.speed_m_per_s);
                walker.set_raise(settings.raise_m);
            }
        });
    }

    /// Takes the move of a given start pose, if it was moved.
    pub fn take_moved_start(&self) -> Option<MovedStart> {
        lock(&self.mailbox.0).moved_start.take()
    }

    /// Sets the window's size.
    pub fn resize(&self, window_px: [u32; 2]) {
        self.update(|d| d.window_px = window_px);
    }

    /// Takes a screenshot.
    pub fn take_screenshot(&self) {
        self.update(|d| d.shot = true);
    }

    /// Takes the newest picture, if there is a new one. `last` returns the buffers of the previous
    /// picture.
    pub fn take(&self, last: &mut Option<Picture>) -> bool {
        let mut mailbox = lock(&self.mailbox.0);
        let Some(new) = mailbox.done.take() else { return false };
        mailbox.spare = last.replace(new).map(|p| p.frame);
        true
    }

    /// The chosen speed, m/s.
    pub fn speed_m_per_s(&self) -> f64 {
        let mailbox = lock(&self.mailbox.0);
        mailbox.walker.as_ref().map_or(mailbox.settings.speed_m_per_s, Walker::speed_m_per_s)
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
