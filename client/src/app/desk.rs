//! The desk between the window and the drawing thread: what was pressed and turned lies on one side, finished pictures on the other.

use super::{
    drawing::Draughtsman,
    link::Link,
    motion::{self, Intent, Walker},
    shot::Shots,
};
use crate::{
    engine::{Painted, Painter, Shows},
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
pub struct Figures {
    /// The engine's.
    pub painted: Painted,
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
    pub shows: Shows,
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
    pub figures: Figures,
    /// The eye is not yet where the visit begins.
    pub scouting: bool,
    /// When it was finished.
    pub at: Instant,
}

/// What the two threads hand each other.
pub(super) struct Desk {
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
    pub shows: Shows,
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
pub struct Drawing {
    desk: Arc<(Mutex<Desk>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

/// How to draw.
#[derive(Debug, Clone)]
pub struct DrawingConfig {
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

pub(super) fn lock(desk: &Mutex<Desk>) -> MutexGuard<'_, Desk> {
    // Every change is complete before anything can panic.
    desk.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Drawing {
    /// Begins to draw what `link` brings. `done` is called after every picture, `shots` takes the screenshots.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start(
        config: DrawingConfig,
        painter: Painter,
        link: Arc<Link>,
        shots: Shots,
        done: impl Fn() + Send + 'static,
    ) -> std::io::Result<Self> {
        let desk = Desk {
            walker: None,
            begin: config.begin,
            intent: Intent::default(),
            turned: (0.0, 0.0),
            notches: 0.0,
            ghost: false,
            teleport: None,
            window_px: config.window_px,
            shot: false,
            shows: Shows::default(),
            place: None,
            replay: None,
            frame_ms: config.frame_ms,
            fine: true,
            done: None,
            spare: None,
            stop: false,
            moved: Instant::now(),
        };
        let desk = Arc::new((Mutex::new(desk), Condvar::new()));
        let draughtsman = Draughtsman::new(desk.clone(), painter, link, shots, Box::new(done), &config);
        let thread = std::thread::Builder::new().name("ldi-draw".into()).spawn(move || draughtsman.run())?;
        Ok(Self { desk, thread: Some(thread) })
    }

    fn tell(&self, change: impl FnOnce(&mut Desk)) {
        change(&mut lock(&self.desk.0));
        self.desk.1.notify_all();
    }

    /// What is pressed now.
    pub fn press(&self, intent: Intent) {
        self.tell(|d| d.intent = intent);
    }

    /// The head turned, degrees: positive left and up.
    pub fn turn(&self, yaw_deg: f64, pitch_deg: f64) {
        self.tell(|d| {
            d.turned.0 += yaw_deg;
            d.turned.1 += pitch_deg;
        });
    }

    /// The wheel turned.
    pub fn change_speed(&self, notches: f64) {
        self.tell(|d| d.notches += notches);
    }

    /// Opens the walls or closes them. Whether they are closed now.
    pub fn toggle_walls(&self) -> bool {
        let mut desk = lock(&self.desk.0);
        desk.ghost = !desk.ghost;
        !desk.ghost
    }

    /// To the place of the volume nearest to `p`.
    pub fn teleport(&self, p: DVec3) {
        self.tell(|d| d.teleport = Some(p));
    }

    /// To the place of the volume nearest to a pose, looking as it does.
    pub fn place(&self, pose: Pose) {
        self.tell(|d| d.place = Some(pose));
    }

    /// What pictures show from now on.
    pub fn show(&self, shows: Shows) {
        self.tell(|d| d.shows = shows);
    }

    /// Walks along a walk from its begin, or ends that. Whatever moves the walker ends it too.
    pub fn replay(&self, walk: Option<Arc<Walk>>) {
        self.tell(|d| d.replay = walk.map(|w| (w, None)));
    }

    /// Whether a walk is walked again.
    pub fn is_replaying(&self) -> bool {
        lock(&self.desk.0).replay.is_some()
    }

    /// Time for a picture while moving, milliseconds, and whether resting pictures get four samples per pixel.
    pub fn settle(&self, frame_ms: f64, fine: bool) {
        self.tell(|d| (d.frame_ms, d.fine) = (frame_ms, fine));
    }

    /// The window has another size.
    pub fn resize(&self, window_px: [u32; 2]) {
        self.tell(|d| d.window_px = window_px);
    }

    /// Draws a picture for the disk.
    pub fn shoot(&self) {
        self.tell(|d| d.shot = true);
    }

    /// The newest picture that was not taken yet. `last` gives back the memory of the one before.
    pub fn take(&self, last: &mut Option<Picture>) -> bool {
        let mut desk = lock(&self.desk.0);
        let Some(new) = desk.done.take() else { return false };
        desk.spare = last.replace(new).map(|p| p.frame);
        true
    }

    /// The speed that the wheel has chosen, m/s.
    pub fn speed_m_per_s(&self) -> f64 {
        lock(&self.desk.0).walker.as_ref().map_or(motion::WALK_M_PER_S, Walker::speed_m_per_s)
    }
}

impl Drop for Drawing {
    fn drop(&mut self) {
        self.tell(|d| d.stop = true);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
