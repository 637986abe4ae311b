//! The render loop: renders a picture for each refresh of the display while something changes.
//!
//! The window's thread writes input to the [`mailbox`](super::render_mailbox) and takes finished
//! pictures from it; neither thread waits for the other. The walker moves at the start of a frame,
//! by the time since the last one, so that a picture shows the latest pose. After a GPU failure the
//! CPU renders.
//!
//! While the eye moves, the picture's size follows the frame time ([`DynamicResolution`]). At rest
//! the picture takes the window's size, then four samples per pixel. Unchanged pictures are not
//! rendered again.

use super::{
    collision::{CollisionGeometry, STRAY_M},
    dynamic_resolution::DynamicResolution,
    recording::pose_at,
    render_mailbox::{Picture, PictureStats, RenderConfig, RenderMailbox, lock},
    screenshot::Screenshots,
    server_connection::{Scene, ServerConnection},
    settings::has_few_textures,
    start_pose::{MovedStart, StartPoseSearch},
    walker::{self, Intent, WalkSpace, Walker},
};
use crate::{
    composite::Fill,
    engine::{
        Anticipated, Appearance, Cull, DisplayMode, FrameRenderer, Method, Pace, RenderError, View, WalkOptions,
        select_view,
    },
    frame::Frame,
    near::MAX_SIDE_PX,
    report::StageMs,
    warp::{Order, Stamp},
};
use glam::DVec3;
use ldi_protocol::{OutputCamera, Pose, camera::apart_deg, need::Sight, path::Walk, volume::WalkVolume};
use std::{
    sync::{Arc, Condvar, Mutex, PoisonError},
    time::{Duration, Instant},
};

/// Rest after which the picture takes the window's size. Longer: a picture that is sharp again
/// later than a tenth of a second after the eye has stopped; shorter: a turn by small movements of
/// the mouse stutters.
const REST_LARGE: Duration = Duration::from_millis(40);
/// Rest after which the picture gets four samples per pixel.
const REST_FINE: Duration = Duration::from_millis(450);
/// Longest expected time of a picture with four samples per pixel. Larger: a walker who starts
/// meanwhile waits longer; smaller: slow machines never show it.
const FINE_MS: f64 = 250.0;
/// Interval at which a resting eye checks for new data.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Interval at which collision surfaces are gathered while data arrives.
const GATHER_EVERY: Duration = Duration::from_millis(250);
/// Change of eye height after which collision surfaces are gathered again, metres: the knee's
/// height depends on it.
const CLIMB_M: f64 = 0.08;
/// Time without progress after which missing chunks are requested by number.
const ASK_AFTER: Duration = Duration::from_secs(1);
/// Received bytes that count as progress; acknowledgements do not.
const PROGRESS_BYTES: u64 = 4096;

/// Inputs of a picture. If none has changed, no picture is rendered.
#[derive(Debug, Clone, PartialEq)]
struct PictureInputs {
    pose: Pose,
    size: [u32; 2],
    supersample: u32,
    shows: DisplayMode,
    appearance: Appearance,
    fov_deg: f64,
}

/// Times at which the future view is predicted, seconds. Long enough for layout and upload. Larger:
/// more objects that are never seen.
const AHEAD_S: [f64; 2] = [0.4, 1.0];
/// Largest number of anticipated images, about as many as a view shows. Larger: more memory.
const MOST_AHEAD: usize = 32;
/// Longest interval between pictures from which motion is predicted, seconds.
const LONGEST_STEP_S: f64 = 0.5;
/// Fastest plausible motion; anything faster is a jump.
const FASTEST_M_PER_S: f64 = 50.0;

/// The last picture.
struct Last {
    inputs: PictureInputs,
    /// Missing chunks.
    missing: Vec<u32>,
    /// Bytes in the cache when it was rendered.
    cache_bytes: u64,
    /// Whether layouts or uploads were in progress.
    waiting: bool,
}

/// A picture to render.
struct Job {
    inputs: PictureInputs,
    /// The eye's place as if it were not raised.
    nominal_eye: DVec3,
    cache_bytes: u64,
    moving: bool,
    /// Whether a screenshot is taken as well.
    shot: bool,
    window_px: [u32; 2],
}

/// The thread's state.
pub(super) struct RenderLoop {
    mailbox: Arc<(Mutex<RenderMailbox>, Condvar)>,
    connection: Arc<ServerConnection>,
    screenshots: Screenshots,
    done: Box<dyn Fn() + Send>,
    interval: Duration,
    even: bool,
    scale: DynamicResolution,
    renderer: FrameRenderer,
    scene: Option<Scene>,
    /// Whether the scene has few textures.
    few_textures: bool,
    last: Option<Last>,
    began: Option<Instant>,
    still_since: Instant,
    /// Milliseconds of the last picture of the window's size, at one sample per pixel.
    large_ms: Option<f64>,
    progress: (u64, Instant),
    collision: Option<NearbyCollision>,
    /// The search for a start pose, while it lasts.
    start_search: Option<StartPoseSearch>,
    /// The pose that the search wants to see next.
    sent: Option<Pose>,
    /// The pose of the last picture, and when it was started.
    before: Option<(Pose, Instant)>,
}

/// Collision surfaces around the eye, and the inputs they depend on.
struct NearbyCollision {
    collision: CollisionGeometry,
    eye: DVec3,
    cache_bytes: u64,
    at: Instant,
}

impl RenderLoop {
    pub fn new(
        mailbox: Arc<(Mutex<RenderMailbox>, Condvar)>,
        renderer: FrameRenderer,
        connection: Arc<ServerConnection>,
        screenshots: Screenshots,
        done: Box<dyn Fn() + Send>,
        config: &RenderConfig,
    ) -> Self {
        Self {
            mailbox,
            connection,
            screenshots,
            done,
            interval: config.interval,
            even: config.even,
            scale: DynamicResolution::new(config.settings.frame_ms),
            renderer,
            scene: None,
            few_textures: false,
            last: None,
            began: None,
            still_since: Instant::now(),
            large_ms: None,
            progress: (0, Instant::now()),
            collision: None,
            start_search: None,
            sent: None,
            before: None,
        }
    }

    /// The thread's body.
    pub fn run(mut self) {
        while let Some((scene, job)) = self.next() {
            self.draw(&scene, job);
        }
    }

    /// Waits for a picture to render. None: stop.
    fn next(&mut self) -> Option<(Scene, Job)> {
        let shared = self.mailbox.clone();
        let mut mailbox = lock(&shared.0);
        loop {
            if mailbox.stop {
                return None;
            }
            let due = self.began.map_or(Duration::ZERO, |b| self.interval.saturating_sub(b.elapsed()));
            if due > Duration::ZERO {
                mailbox = shared.1.wait_timeout(mailbox, due).unwrap_or_else(PoisonError::into_inner).0;
                continue;
            }
            if let Some(scene) = self.scene_now(&mut mailbox)
                && let Some(job) = self.job(&mut mailbox, &scene)
            {
                self.began = Some(Instant::now());
                return Some((scene, job));
            }
            self.request_if_stuck();
            let wait = self.next_look();
            mailbox = shared.1.wait_timeout(mailbox, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// The time until it has to be looked for changes again: sooner if the eye is about to rest.
    fn next_look(&self) -> Duration {
        let rested = self.still_since.elapsed();
        let until_rest = REST_LARGE.checked_sub(rested).map(|left| left + Duration::from_millis(1));
        until_rest.map_or(LOOK_EVERY, |left| left.min(LOOK_EVERY))
    }

    /// The connection's current scene. A new scene places the walker in its volume.
    fn scene_now(&mut self, mailbox: &mut RenderMailbox) -> Option<Scene> {
        let scene = self.connection.scene()?;
        if !self.scene.as_ref().is_some_and(|s| s.is(&scene)) {
            let index = &scene.index;
            let (volume, flying) = (index.volume.as_ref(), index.settings.eye_height_m.is_none());
            let given = mailbox.begin.filter(|_| mailbox.walker.is_none());
            let begin = mailbox.walker.as_ref().map(Walker::pose).or(given).unwrap_or_else(|| {
                let bounds = volume.map_or(&index.scene.bounds, WalkVolume::bounds);
                let centre = Pose { position: bounds.centre(), yaw_deg: 0.0, pitch_deg: 0.0 };
                let Some(volume) = volume.filter(|v| !flying && !v.is_empty()) else { return centre };
                let (start_search, first) = StartPoseSearch::new(volume);
                self.start_search = Some(start_search);
                first.unwrap_or(centre)
            });
            let mut walker = Walker::new(begin, volume, flying, index.settings.pitch_deg);
            walker.set_speed(mailbox.settings.speed_m_per_s);
            walker.set_raise(mailbox.settings.raise_m);
            let place = walker.pose().position;
            mailbox.moved_start = given.and_then(|g| MovedStart::between(g.position, place, volume));
            mailbox.walker = Some(walker);
            mailbox.moved = Instant::now();
            self.renderer.forget_scene();
            self.few_textures = has_few_textures(&scene.index);
            (self.last, self.large_ms, self.collision) = (None, None, None);
            self.scene = Some(scene.clone());
        } else if self.scene.as_ref().is_some_and(|s| !Arc::ptr_eq(&s.index, &scene.index)) {
            // The index is complete now: the same view may need more.
            self.last = None;
            self.few_textures = has_few_textures(&scene.index);
            self.scene = Some(scene.clone());
        }
        Some(scene)
    }

    /// Moves the walker. Returns the picture to render, if any.
    fn job(&mut self, mailbox: &mut RenderMailbox, scene: &Scene) -> Option<Job> {
        let now = Instant::now();
        let volume = scene.index.volume.as_ref();
        let turned = std::mem::take(&mut mailbox.turned);
        let notches = std::mem::take(&mut mailbox.notches);
        let place = mailbox.place.take();
        let (intent, dt) = (mailbox.intent, now - std::mem::replace(&mut mailbox.moved, now));
        let walker = mailbox.walker.as_mut()?;
        walker.change_speed(notches);
        if let Some(pose) = &place {
            walker.place(pose, volume);
        }
        let moved = intent != Intent::default() || turned != (0.0, 0.0) || place.is_some();
        if moved || mailbox.replay.is_some() {
            (self.start_search, self.sent) = (None, None);
        }
        if let Some(pose) = self.sent.take() {
            walker.place(&pose, volume);
        }
        let followed = mailbox.replay.take_if(|_| moved).is_none() && follow(&mut mailbox.replay, walker, now);
        if !followed {
            walker.turn(turned.0, turned.1);
            let collision = self.collision.as_ref().map(|s| &s.collision);
            walker.advance(WalkSpace { volume, collision, walls: !mailbox.ghost }, &intent, dt.as_secs_f64());
        }
        let (pose, nominal_eye) = (walker.pose(), walker.nominal_eye());
        if self.last.as_ref().is_none_or(|l| l.inputs.pose != pose) {
            self.still_since = now;
        }
        let rest = now - self.still_since;
        let window = mailbox.window_px.map(|n| n.clamp(1, MAX_SIDE_PX / 2));
        // While data arrives, pictures follow each other quickly and are not refined.
        let complete = scene.index.is_whole() && self.last.as_ref().is_some_and(|l| l.missing.is_empty() && !l.waiting);
        let settings = &mailbox.settings;
        self.scale.set_goal(settings.frame_ms);
        let fine = settings.fine && complete && self.large_ms.is_some_and(|ms| 4.0 * ms < FINE_MS);
        // Layouts depend on the picture's resolution: those in progress are finished first.
        let half_way = self.last.as_ref().is_some_and(|l| l.waiting && l.inputs.size != window);
        let (size, supersample) = match rest {
            r if r < REST_LARGE || half_way => (self.scale.size(window), 1),
            r if r < REST_FINE || !fine => (window, 1),
            _ => (window, 2),
        };
        let cache_bytes = scene.cache.usage().bytes;
        // The search compares what the scene shows, without what shading adds.
        let appearance = match self.start_search {
            Some(_) => Appearance::default(),
            None => settings.appearance(self.few_textures),
        };
        let (shows, fov_deg) = (mailbox.shows, settings.fov_deg);
        let inputs = PictureInputs { pose, size, supersample, shows, appearance, fov_deg };
        let shot = std::mem::take(&mut mailbox.shot);
        // Data that a complete picture does not need does not change it.
        let changed = self.last.as_ref().is_none_or(|l| {
            l.inputs != inputs
                || (l.waiting && self.renderer.has_news())
                || (!l.missing.is_empty() && l.cache_bytes != cache_bytes)
        });
        let moving = rest < REST_LARGE;
        (changed || shot).then_some(Job { inputs, nominal_eye, cache_bytes, moving, shot, window_px: window })
    }

    fn draw(&mut self, scene: &Scene, job: Job) {
        let mut frame = lock(&self.mailbox.0).spare.take().unwrap_or_default();
        let inputs = job.inputs.clone();
        let mut options = WalkOptions { background_layout: true, ..options(&inputs) };
        if job.moving {
            options.frame_ms = Some(self.scale.goal_ms());
            if self.scale.is_exhausted() {
                options.stamp = Stamp::TwoByTwo;
            }
        }
        let Some((camera, stats)) = self.render(scene, &inputs, options, &mut frame) else { return };
        let pose = inputs.pose;
        let ms = stats.frame_stats.ms.total + stats.frame_stats.ms.prepare;
        if job.moving {
            self.scale.record_frame(ms);
        } else if inputs.supersample == 1 {
            self.large_ms = Some(ms);
        }
        self.update_collision(scene, job.nominal_eye, job.cache_bytes);
        if stats.frame_stats.is_complete() && self.start_search.is_some() {
            self.advance_start_search(scene, &pose, &frame);
        }
        let searching_start = self.start_search.is_some() || self.sent.is_some();
        let (missing, waiting) = (stats.frame_stats.missing_chunks.clone(), stats.frame_stats.waiting > 0);
        if let (true, Some(began)) = (self.even && job.moving, self.began) {
            std::thread::sleep(self.interval.saturating_sub(began.elapsed()));
        }
        let picture = Picture { frame, pose, fov_deg: camera.fov_deg, stats, searching_start, at: Instant::now() };
        if job.shot {
            let mut shot = Frame::default();
            let inputs = PictureInputs { size: job.window_px, supersample: 2, ..inputs };
            if let Some((camera, _)) = self.render(scene, &inputs, self::options(&inputs), &mut shot) {
                self.screenshots.save(shot, pose, camera.fov_deg);
            }
        }
        lock(&self.mailbox.0).done = Some(picture);
        self.last = Some(Last { inputs: job.inputs, missing, cache_bytes: job.cache_bytes, waiting });
        self.request_if_stuck();
        (self.done)();
    }

    /// Objects that will be seen if the motion continues, soonest first.
    fn ahead(&mut self, scene: &Scene, pose: &Pose, camera: &OutputCamera, seen: &View) -> Anticipated {
        let (now, mut ahead) = (Instant::now(), Anticipated::default());
        let Some((before, at)) = self.before.replace((*pose, now)) else { return ahead };
        let dt_s = (now - at).as_secs_f64();
        let step = pose.position - before.position;
        if before == *pose || dt_s > LONGEST_STEP_S || step.length() > FASTEST_M_PER_S * dt_s {
            return ahead;
        }
        let turn_deg = apart_deg(before.yaw_deg, pose.yaw_deg);
        fn add<T: PartialEq>(to: &mut Vec<T>, view: Vec<T>, seen: &[T]) {
            let new: Vec<T> = view.into_iter().filter(|i| !to.contains(i) && !seen.contains(i)).collect();
            to.extend(new);
        }
        for t_s in AHEAD_S {
            let (position, yaw_deg) = (pose.position + step * (t_s / dt_s), pose.yaw_deg + turn_deg * (t_s / dt_s));
            let then = Pose { position, yaw_deg, ..*pose };
            let view = select_view(&scene.index, &then, camera, Method::Auto);
            add(&mut ahead.images, view.images, &seen.images);
            add(&mut ahead.cells, view.cells, &seen.cells);
        }
        ahead.images.truncate(MOST_AHEAD);
        ahead
    }

    /// Renders one picture.
    fn render(
        &mut self,
        scene: &Scene,
        inputs: &PictureInputs,
        options: WalkOptions,
        out: &mut Frame,
    ) -> Option<(OutputCamera, PictureStats)> {
        let index = &*scene.index;
        let (pose, [width, height]) = (&inputs.pose, inputs.size);
        let camera = fit(&index.settings.camera, width, height, inputs.fov_deg);
        let options = WalkOptions { width, height, ..options };
        let start = Instant::now();
        let view = select_view(index, pose, &camera, Method::Auto);
        let ms = StageMs { cull: start.elapsed().as_secs_f64() * 1e3, ..StageMs::default() };
        let sight = Sight::new(pose, &camera, options.supersample);
        let needed = view.needed_within(index, &sight, scene.cache.usage().cap_bytes);
        self.connection.update_view(pose, &needed);
        if options.background_layout {
            let ahead = self.ahead(scene, pose, &camera, &view);
            self.renderer.anticipate(ahead);
        }
        let frame_stats = match self.renderer.render(index, &*scene.cache, &view, pose, &camera, &options, ms, out) {
            Err(RenderError::Gpu(e)) => {
                tracing::error!("{e}; going on without it");
                self.renderer = FrameRenderer::default();
                self.renderer.render(index, &*scene.cache, &view, pose, &camera, &options, ms, out)
            }
            frame_stats => frame_stats,
        };
        let frame_stats = frame_stats.map_err(|e| tracing::error!("{e}")).ok()?;
        let stored = |chunk: &u32| index.chunks.get(*chunk as usize).map_or(0, |c| u64::from(c.stored_bytes));
        let stats = PictureStats {
            selection: view.selection,
            missing_bytes: frame_stats.missing_chunks.iter().map(stored).sum(),
            needed_bytes: needed.all().map(|c| stored(&c)).sum(),
            dropped_cells: view.dropped,
            unplanned: view.dropped > 0 && view.is_unplanned(index, pose),
            supersample: options.supersample,
            shows: options.shows,
            card: self.renderer.gpu().map(|g| (g.adapter().to_owned(), g.held_bytes())),
            frame_stats,
        };
        Some((camera, stats))
    }

    /// Updates the collision surfaces around the eye.
    fn update_collision(&mut self, scene: &Scene, eye: DVec3, cache_bytes: u64) {
        let Some(eye_height_m) = scene.index.settings.eye_height_m else { return };
        let good = self.collision.as_ref().is_some_and(|g| {
            let off = eye - g.eye;
            let fresh = g.cache_bytes == cache_bytes || g.at.elapsed() < GATHER_EVERY;
            fresh && off.x.hypot(off.z) < STRAY_M && off.y.abs() < CLIMB_M
        });
        if !good {
            let collision = CollisionGeometry::around(scene, eye, eye_height_m);
            self.collision = Some(NearbyCollision { collision, eye, cache_bytes, at: Instant::now() });
        }
    }

    /// Advances the search for a start pose: moves the eye to the next candidate, or to the best
    /// one.
    fn advance_start_search(&mut self, scene: &Scene, pose: &Pose, frame: &Frame) {
        let index = &scene.index;
        let (Some(start_search), Some(volume), Some(eye_height_m)) =
            (&mut self.start_search, &index.volume, index.settings.eye_height_m)
        else {
            return;
        };
        let outlook_deg = || {
            let collision = CollisionGeometry::within(scene, pose.position, eye_height_m, walker::OUTLOOK_M);
            walker::outlook_deg(volume, &collision, pose.position)
        };
        self.sent = start_search.on_picture(pose, frame, outlook_deg);
        self.start_search.take_if(|s| s.is_done());
    }

    /// Requests missing chunks by number if nothing arrives. Normally the server pushes them.
    fn request_if_stuck(&mut self) {
        let missing = self.last.as_ref().map_or(&[][..], |l| &l.missing);
        let bytes = self.connection.summary().bytes;
        if missing.is_empty() || bytes > self.progress.0 + PROGRESS_BYTES {
            self.progress = (bytes, Instant::now());
        } else if self.progress.1.elapsed() > ASK_AFTER {
            self.connection.request(missing);
            self.progress = (bytes, Instant::now());
        }
    }
}

/// The camera of a picture of this size, within the dataset's field of view in both directions:
/// images contain no more. `wanted_deg`: the widest horizontal field of view that the user wants.
fn fit(made_for: &OutputCamera, width: u32, height: u32, wanted_deg: f64) -> OutputCamera {
    let across = made_for.half_tan_x().min(made_for.half_tan_y() * f64::from(width) / f64::from(height));
    OutputCamera { width, height, fov_deg: (2.0 * across.atan().to_degrees()).min(wanted_deg) }
}

/// Moves the walker along a replayed walk. False without one, or after its end.
fn follow(replay: &mut Option<(Arc<Walk>, Option<Instant>)>, walker: &mut Walker, now: Instant) -> bool {
    let Some((walk, since)) = replay else { return false };
    let t_s = (now - *since.get_or_insert(now)).as_secs_f64();
    match pose_at(walk, t_s) {
        Some(pose) => walker.follow(pose),
        None => *replay = None,
    }
    replay.is_some()
}

/// Render options of a resting eye. The size is the camera's.
fn options(inputs: &PictureInputs) -> WalkOptions {
    WalkOptions {
        width: 0,
        height: 0,
        method: Method::Auto,
        cache_error_px: 2.0,
        stamp: Stamp::Quads,
        order: Order::Z,
        cull: Cull::Auto,
        fill: Fill::Surface,
        smooth: false,
        frame_ms: None,
        supersample: inputs.supersample,
        pace: Pace::Realtime,
        every: 1,
        cache_bytes: None,
        debug_views: false,
        shows: inputs.shows,
        appearance: inputs.appearance,
        background_layout: false,
        baseline_frames: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_show_no_more_than_the_dataset_was_made_for() {
        let made_for = OutputCamera { width: 1280, height: 720, fov_deg: 60.0 };
        for (width, height) in [(1280, 720), (640, 360), (1920, 800), (800, 800), (500, 1200)] {
            let camera = fit(&made_for, width, height, 120.0);
            let (x, y) = (camera.half_tan_x() / made_for.half_tan_x(), camera.half_tan_y() / made_for.half_tan_y());
            assert!(x < 1.0 + 1e-9 && y < 1.0 + 1e-9, "{width}x{height}: {x} {y}");
            // The field of view is as large as possible.
            assert!(x.max(y) > 1.0 - 1e-9, "{width}x{height}: {x} {y}");
            assert_eq!(fit(&made_for, width, height, 35.0).fov_deg, camera.fov_deg.min(35.0));
        }
    }
}
