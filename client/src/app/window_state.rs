//! The state of an open window: what is shown, input, and messages.

use super::{
    AppConfig, AppError,
    banners::Conditions,
    commands,
    events::{Events, fields},
    frame_times::FrameTimes,
    gamepad::{Gamepad, PadPress},
    help::Help,
    hud::{Hud, Shown},
    interface_pass::Interface,
    keys::Keys,
    map::Map,
    recordings_and_bookmarks::RecordingsAndBookmarks,
    render_mailbox::{Picture, RenderConfig},
    render_thread::RenderThread,
    screen::{Screen, ScreenError},
    screenshot::{Outcome, Screenshots},
    server_connection::ServerConnection,
    settings::{SettingsFile, UserSettings},
    settings_panel, start_screen,
    walker::Intent,
};
use crate::engine::{DisplayMode, FrameRenderer};
use ldi_protocol::Pose;
use std::{
    sync::{Arc, mpsc},
    time::{Duration, Instant},
};
use winit::{
    dpi::PhysicalSize,
    event::{ElementState, KeyEvent},
    event_loop::{ActiveEventLoop, EventLoopProxy, OwnedDisplayHandle},
    keyboard::{ModifiersState, PhysicalKey},
    window::{CursorGrabMode, Fullscreen, Window},
};

/// Interval at which the interface is redrawn without new pictures.
pub(super) const REFRESH: Duration = Duration::from_millis(200);
/// Interval at which an interface that stays on screen is redrawn for new statistics: faster
/// changes cannot be read. Interactive parts are redrawn with every picture.
const WRITE_EVERY: Duration = Duration::from_millis(150);
/// A driver that fails twice within this time has failed permanently.
const STEADY: Duration = Duration::from_secs(5);
/// Shortest interval between poses in the event log.
const POSE_EVERY: Duration = Duration::from_millis(100);
/// Time for which the last place is offered.
const OFFER: Duration = Duration::from_secs(15);
/// Height of the map's line of help, points, in a window that is wide enough for it.
const MAP_LINE: f32 = 34.0;
/// Refresh rate, if the display does not report it.
const DEFAULT_HZ: f64 = 60.0;

/// A notification from another thread.
#[derive(Debug, Clone, Copy)]
pub(super) enum UserEvent {
    /// A picture is finished.
    Picture,
    /// The gamepad's state has changed.
    Pad,
    /// The connection's state has changed, or a screenshot was saved.
    Other,
}

/// The state of an open window.
pub(super) struct WindowState {
    /// The server's address, as the user gave it.
    pub server: String,
    pub render_thread: RenderThread,
    /// None only while the screen is being reopened.
    screen: Option<Screen>,
    /// Time of the last reopening after a driver failure.
    reopened: Option<Instant>,
    display: OwnedDisplayHandle,
    pub egui: egui_winit::State,
    pub window: Arc<Window>,
    pub screenshots: mpsc::Receiver<Outcome>,
    pub picture: Option<Picture>,
    pub hud: Hud,
    pub map: Map,
    pub keys: Keys,
    pad: Gamepad,
    /// Whether the window has the keyboard. The gamepad counts only then.
    focused: bool,
    pub modifiers: ModifiersState,
    pub captured: bool,
    /// Whether the pointer was captured before the map was opened.
    pub capture_again: bool,
    /// Whether the start screen was left.
    pub started: bool,
    pub frame_times: FrameTimes,
    /// Counts of pictures and redraws.
    pub counts: Counts,
    pub last_reported: LastReported,
    pub settings: UserSettings,
    pub settings_file: SettingsFile,
    /// Whether the panel of the settings is shown.
    pub settings_open: bool,
    pub shows: DisplayMode,
    pub kept: RecordingsAndBookmarks,
    /// A link to be copied with the next redraw.
    pub copy: Option<String>,
    /// Whether the client chose the start.
    chose_start: bool,
    /// Whether a replay starts with the first complete picture.
    walk_at_once: bool,
    /// Whether a walk is being replayed.
    pub replaying: bool,
    pub repaint_at: Instant,
    /// Time of the interface's last redraw; None if its content has changed since.
    written: Option<Instant>,
}

/// Counts of pictures and redraws. A window is redrawn for each picture, and regularly for the
/// interface.
#[derive(Debug, Default, serde::Serialize)]
pub(super) struct Counts {
    pictures: u64,
    /// Pictures with missing data, or with layouts or uploads in progress.
    incomplete: u64,
    shown: u64,
    card_bytes_most: u64,
    /// Largest number of bytes uploaded by one picture.
    brought_bytes_most: u64,
}

/// The state that was written to the event log last.
#[derive(Default)]
pub(super) struct LastReported {
    picture: bool,
    complete: bool,
    pose: Option<(Pose, Instant)>,
    pub map: bool,
    pub others: Option<usize>,
}

impl WindowState {
    /// Opens a window and its threads.
    ///
    /// # Errors
    /// If there is no display, no driver or no thread.
    pub fn open(
        config: &AppConfig,
        renderer: FrameRenderer,
        event_loop: &ActiveEventLoop,
        connection: Arc<ServerConnection>,
        proxy: &EventLoopProxy<UserEvent>,
    ) -> Result<Self, AppError> {
        let path = config.settings.clone().or_else(SettingsFile::default_path);
        let (mut settings_file, mut settings, unread) = SettingsFile::load(path);
        settings_file.give_frame_ms(config.frame_ms, &mut settings);
        let window = window(config, &settings, event_loop)?;
        let display = event_loop.owned_display_handle();
        let screen = Screen::open(window.clone(), display.clone())?;
        let size = window.inner_size();
        let notify = |what: UserEvent| {
            let proxy = proxy.clone();
            move || {
                // The window may be closed already.
                let _ = proxy.send_event(what);
            }
        };
        let (screenshots, outcomes) = Screenshots::new(&config.screenshots, notify(UserEvent::Other));
        let render_config = RenderConfig {
            settings: settings.clone(),
            begin: config.begin,
            window_px: [size.width, size.height],
            interval: refresh_interval(&window),
            even: screen.keeps_interface(),
        };
        let render_thread =
            RenderThread::start(render_config, renderer, connection, screenshots, notify(UserEvent::Picture))
                .map_err(AppError::Thread)?;
        let egui = interface_of(&window, &display, &screen);
        let mut hud = Hud::default();
        if let Some(e) = unread {
            tracing::warn!("{e}");
            hud.banners.show_message(e, false);
        }
        Ok(Self {
            server: config.connect.address(),
            render_thread,
            screen: Some(screen),
            reopened: None,
            display,
            egui,
            window,
            screenshots: outcomes,
            picture: None,
            hud,
            map: Map::default(),
            keys: Keys::default(),
            pad: Gamepad::watch(config.gamepad.clone(), notify(UserEvent::Pad)),
            focused: true,
            modifiers: ModifiersState::empty(),
            captured: false,
            capture_again: false,
            started: false,
            frame_times: FrameTimes::default(),
            counts: Counts::default(),
            last_reported: LastReported::default(),
            settings,
            settings_file,
            settings_open: false,
            shows: DisplayMode::default(),
            kept: RecordingsAndBookmarks::new(config),
            copy: None,
            chose_start: config.begin.is_none(),
            walk_at_once: config.replay.is_some(),
            replaying: false,
            repaint_at: Instant::now(),
            written: None,
        })
    }

    /// Takes the newest picture.
    pub fn take(&mut self, connection: &ServerConnection, events: &mut Events) {
        if !self.render_thread.take(&mut self.picture) {
            return;
        }
        let Some(picture) = &self.picture else { return };
        // Places that are only looked at to choose a start are not shown.
        if let Some(screen) = self.screen.as_mut().filter(|_| self.started || !picture.searching_start) {
            screen.upload(&picture.frame);
        }
        self.counts.pictures += 1;
        let on_card = picture.stats.card.as_ref().map_or(0, |(_, bytes)| *bytes);
        self.counts.card_bytes_most = self.counts.card_bytes_most.max(on_card);
        let brought = picture.stats.frame_stats.uploaded_bytes;
        self.counts.brought_bytes_most = self.counts.brought_bytes_most.max(brought);
        self.hud.picture(picture);
        let ms = &picture.stats.frame_stats.ms;
        self.frame_times.picture(&picture.pose, ms.total + ms.prepare, picture.at);
        let whole = picture.stats.frame_stats.is_complete();
        self.counts.incomplete += u64::from(!whole);
        let complete = whole && !picture.searching_start;
        self.started |= complete;
        let about = || {
            fields! {
                "width": picture.frame.width, "height": picture.frame.height,
                "triangles": picture.stats.frame_stats.triangles, "missing": picture.stats.frame_stats.missing_chunks.len(),
            }
        };
        if !std::mem::replace(&mut self.last_reported.picture, true) {
            events.write("first_picture", about());
        }
        if complete && !std::mem::replace(&mut self.last_reported.complete, true) {
            events.write("first_complete_picture", about());
            if std::mem::take(&mut self.walk_at_once) {
                self.render_thread.replay(self.kept.walk());
                self.started = true;
            }
            let scene = connection.scene().filter(|_| self.chose_start);
            if scene.is_some_and(|s| self.kept.knows_last_place(&s.index.scene.name)) {
                self.hud.banners.show_for("0: go to where your last visit ended".into(), true, OFFER);
                events.write("last_place", fields! {});
            }
        }
        let (pose, at) = (picture.pose, picture.at);
        self.report_pose(pose, at, events);
    }

    /// Records the pose of a picture.
    fn report_pose(&mut self, pose: Pose, at: Instant, events: &mut Events) {
        self.kept.pose(pose, at);
        self.map.track(pose.position);
        let last_reported = self.last_reported.pose;
        let due = last_reported.is_none_or(|(last, at)| last != pose && at.elapsed() >= POSE_EVERY);
        if due {
            self.last_reported.pose = Some((pose, Instant::now()));
            events.write("pose", pose_fields(&pose));
        }
        if let Some(moved) = self.render_thread.take_moved_start() {
            let text = moved.to_string();
            tracing::warn!("{text}");
            events.write("start_moved", fields! { "by_m": moved.by_m, "position": moved.to.to_array() });
            self.hud.banners.show_for(text, false, OFFER);
        }
    }

    /// Reports the outcome of a screenshot.
    pub fn shot(&mut self, outcome: Outcome, events: &mut Events) {
        self.written = None;
        match outcome {
            Ok(path) => {
                let path = std::path::absolute(&path).unwrap_or(path);
                println!("{}", path.display());
                self.hud.banners.show_message(format!("saved {}", path.display()), true);
                events.write("screenshot", fields! { "path": path.display().to_string() });
            }
            Err(e) => {
                tracing::warn!("{e}");
                events.write("screenshot_failed", fields! { "reason": &e });
                self.hud.banners.show_message(e, false);
            }
        }
    }

    /// Adapts to a new size of the window.
    pub fn resize(&mut self, size: PhysicalSize<u32>) {
        if let Some(screen) = &mut self.screen {
            screen.resize([size.width, size.height]);
        }
        // A minimized window has no area; the last size stays.
        if size.width > 0 && size.height > 0 {
            self.render_thread.resize([size.width, size.height]);
        }
        self.window.request_redraw();
    }

    /// Captures or releases the pointer.
    pub fn capture(&mut self, capture: bool, events: &mut Events) {
        if self.captured == capture {
            return;
        }
        let done = if capture {
            // Some systems cannot lock the pointer; all can confine it.
            let grab = |mode| self.window.set_cursor_grab(mode);
            grab(CursorGrabMode::Locked).or_else(|_| grab(CursorGrabMode::Confined))
        } else {
            self.window.set_cursor_grab(CursorGrabMode::None)
        };
        if let (true, Err(e)) = (capture, done) {
            // Turning works as far as the pointer can move.
            tracing::warn!("the pointer cannot be captured: {e}");
        }
        self.window.set_cursor_visible(!capture);
        self.captured = capture;
        events.write(if capture { "captured" } else { "released" }, fields! {});
    }

    /// Handles a click: on the map if it is open, otherwise it captures the pointer.
    pub fn click(&mut self, events: &mut Events) {
        self.written = None;
        let on_panel = self.egui.egui_ctx().is_pointer_over_egui();
        if !self.map.open && !on_panel {
            self.started = true;
            self.capture(true, events);
        }
    }

    /// Handles a key. Returns whether the window is to be closed.
    pub fn key(&mut self, event: &KeyEvent, connection: &ServerConnection, events: &mut Events) -> bool {
        let pressed = event.state == ElementState::Pressed;
        // Repeated keys do not change the interface.
        self.written = self.written.filter(|_| event.repeat || !pressed);
        if pressed && !event.repeat {
            let (control, shift) = (self.control(), self.modifiers.shift_key());
            let command = commands::command(&event.logical_key, &event.physical_key, control, shift);
            if command.is_some_and(|c| self.command(c, connection, events)) {
                return true;
            }
            self.window.request_redraw();
        }
        if let PhysicalKey::Code(code) = event.physical_key
            && self.keys.set(code, pressed && !self.control())
        {
            self.started |= pressed;
            self.render_thread.set_intent(self.intent());
        }
        false
    }

    /// Whether Control, or the Mac's command key, is down.
    fn control(&self) -> bool {
        self.modifiers.control_key() || self.modifiers.super_key()
    }

    /// The intent of keyboard and gamepad.
    fn intent(&self) -> Intent {
        match self.focused {
            true => self.keys.intent().and(self.pad.pad().intent()),
            false => Intent::default(),
        }
    }

    /// Handles a change of the keyboard focus.
    pub fn focus(&mut self, focused: bool, events: &mut Events) {
        self.focused = focused;
        if !focused {
            self.keys.release();
            self.capture(false, events);
        }
        self.render_thread.set_intent(self.intent());
    }

    /// Handles gamepad input.
    pub fn pad(&mut self, connection: &ServerConnection, events: &mut Events) {
        let presses = self.pad.pad().presses();
        self.written = self.written.filter(|_| presses.is_empty());
        if !self.focused {
            return;
        }
        let intent = self.intent();
        self.started |= intent != Intent::default();
        self.render_thread.set_intent(intent);
        for press in presses {
            match press {
                PadPress::Shot => self.render_thread.take_screenshot(),
                PadPress::Map => self.toggle_map(connection, events),
            }
            self.window.request_redraw();
        }
    }

    /// Turns the head by a mouse movement.
    pub fn turn_by_mouse(&self, delta: (f64, f64), deg_per_count: f64) {
        let (yaw_deg, pitch_deg) = self.settings.turn_deg(delta, deg_per_count);
        self.render_thread.turn(yaw_deg, pitch_deg);
    }

    /// Reports the start and the end of a replay, of which no picture may tell.
    fn report_replay(&mut self, events: &mut Events) {
        let replaying = self.render_thread.is_replaying();
        if std::mem::replace(&mut self.replaying, replaying) != replaying {
            if !replaying {
                self.hud.banners.show_message("the walk is over".into(), true);
            }
            events.write("replay", fields! { "running": replaying });
        }
    }

    /// Name of the adapter that presents pictures.
    pub fn adapter(&self) -> &str {
        self.screen.as_ref().map_or("", Screen::adapter)
    }

    /// Presents the newest picture with the interface. After a driver failure the screen is
    /// reopened once: adapters get lost when they are switched, or when the computer sleeps.
    ///
    /// # Errors
    /// If it fails again within [`STEADY`].
    fn present(&mut self, interface: Option<Interface>) -> Result<(), ScreenError> {
        self.counts.shown += 1;
        let Some(screen) = &mut self.screen else { return Ok(()) };
        let shown = self.picture.as_ref().filter(|p| self.started || !p.searching_start);
        let Err(e) = screen.present(shown.map(|p| &p.frame), interface) else { return Ok(()) };
        if self.reopened.is_some_and(|at| at.elapsed() < STEADY) {
            return Err(e);
        }
        tracing::warn!("{e}; opening it anew");
        // A window can have one surface at a time.
        self.screen = None;
        let mut screen = Screen::open(self.window.clone(), self.display.clone())?;
        if let Some(picture) = &self.picture {
            screen.upload(&picture.frame);
        }
        // The font texture belonged to the old screen.
        self.egui = interface_of(&self.window, &self.display, &screen);
        (self.screen, self.reopened, self.written) = (Some(screen), Some(Instant::now()), None);
        self.hud.banners.show_message("the graphics driver failed and was started again".into(), false);
        self.window.request_redraw();
        Ok(())
    }

    /// Redraws the window.
    ///
    /// # Errors
    /// If the driver has failed permanently.
    pub fn redraw(&mut self, connection: &ServerConnection, events: &mut Events) -> Result<(), ScreenError> {
        self.report_replay(events);
        let to_read_alone = self.started && !self.map.open && !self.settings_open;
        let written = self.written.is_some_and(|at| at.elapsed() < WRITE_EVERY);
        if written && to_read_alone && self.screen.as_ref().is_some_and(Screen::keeps_interface) {
            return self.present(None);
        }
        self.written = Some(Instant::now());
        let input = self.egui.take_egui_input(&self.window);
        let ctx = self.egui.egui_ctx().clone();
        let mut clicked = None;
        let output = ctx.run_pass(input, |ctx| clicked = self.draw_interface(ctx, connection));
        self.egui.handle_platform_output(&self.window, output.platform_output);
        if self.captured {
            // egui shows the pointer whenever it sets its shape.
            self.window.set_cursor_visible(false);
        }
        let delay = output.viewport_output.values().map(|v| v.repaint_delay).min().unwrap_or(REFRESH);
        self.repaint_at = self.repaint_at.min(Instant::now() + delay.min(REFRESH));
        let primitives = ctx.tessellate(output.shapes, output.pixels_per_point);
        let scale = output.pixels_per_point;
        let interface = Interface { primitives, textures: output.textures_delta, scale };
        self.present(Some(interface))?;
        self.report_map(scale, connection, events);
        if let Some(p) = clicked {
            self.go_to_map_place(p, connection, events);
        }
        Ok(())
    }

    /// Draws the interface. Returns the pose at the place on the map that was clicked.
    fn draw_interface(&mut self, ctx: &egui::Context, connection: &ServerConnection) -> Option<Pose> {
        if let Some(text) = self.copy.take() {
            ctx.copy_text(text);
        }
        let shown = self.picture.as_ref();
        if !self.started {
            start_screen::show(ctx, &self.server, connection, shown);
            return None;
        }
        let (scene, state, stats) = (connection.scene(), connection.state(), connection.summary());
        let mut clicked = None;
        if let (true, Some(scene), Some(p)) = (self.map.open, &scene, shown) {
            clicked = self.map.show(ctx, scene, p, connection.others().list().as_deref());
        }
        let conditions = Conditions {
            connection: &state,
            recording: self.kept.recording_time(),
            replaying: self.replaying,
            unplanned: shown.is_some_and(|p| p.stats.unplanned),
            replaced: connection.is_replaced(),
        };
        let speed_m_per_s = self.render_thread.speed_m_per_s();
        let picture = shown.zip(scene.as_ref()).map(|(p, s)| (p, &*s.index));
        let covered = self.map.open || self.settings_open || self.hud.help.open;
        let taken = if self.map.open { MAP_LINE } else { 0.0 };
        let top = self.hud.show(ctx, &Shown { picture, line: &stats, conditions, speed_m_per_s, covered, taken });
        if self.hud.help.open {
            Help::show_panel(ctx);
        }
        if self.settings_open {
            self.settings.speed_m_per_s = speed_m_per_s;
            let widest_deg = scene.map(|s| s.index.settings.camera.fov_deg);
            if settings_panel::show(ctx, top, &mut self.settings_open, &mut self.settings, widest_deg) {
                self.apply_settings();
            }
            if !self.settings_open {
                self.save_settings();
            }
        }
        clicked
    }

    /// Reports the map's place in the window and the walkers on it, once they have changed.
    fn report_map(&mut self, scale: f32, connection: &ServerConnection, events: &mut Events) {
        if let (Some(sheet), false) = (self.map.sheet, self.last_reported.map) {
            self.last_reported.map = true;
            let a = sheet.area;
            let px = [a.min.x, a.min.y, a.max.x, a.max.y].map(|v| v * scale);
            let [x, z] = sheet.corner;
            events.write("map", fields! { "open": true, "area_px": px, "corner": [x, z], "px_per_m": sheet.per_metre * f64::from(scale) });
        }
        let shown = connection.others().list().filter(|_| self.map.open).map(|o| o.len());
        if shown.is_some() && std::mem::replace(&mut self.last_reported.others, shown) != shown {
            events.write("others", fields! { "shown": shown });
        }
    }

    /// Closes the window. Saves the settings, the place and a recording in progress.
    pub fn close(&mut self, connection: &ServerConnection, events: &mut Events) {
        self.settings.speed_m_per_s = self.render_thread.speed_m_per_s();
        self.save_settings();
        if let (Some(scene), Some(picture), true) = (connection.scene(), &self.picture, self.last_reported.complete) {
            self.kept.keep_last_place(picture.pose, &scene.index.scene.name);
        }
        if self.kept.recording_time().is_some() {
            let described = self.kept.record(self.render_thread.speed_m_per_s());
            self.announce(described, events);
        }
    }
}

/// Opens a window.
fn window(config: &AppConfig, settings: &UserSettings, event_loop: &ActiveEventLoop) -> Result<Arc<Window>, AppError> {
    let (width, height) = config.size;
    let attributes = Window::default_attributes()
        .with_title(format!("ldi-client: {}", config.connect.address()))
        .with_min_inner_size(PhysicalSize::new(160, 120))
        .with_fullscreen(settings.full_screen.then_some(Fullscreen::Borderless(None)))
        .with_inner_size(PhysicalSize::new(width, height));
    event_loop.create_window(attributes).map(Arc::new).map_err(|e| AppError::no_display(&e))
}

/// The time between two refreshes of a window's display.
fn refresh_interval(window: &Window) -> Duration {
    let monitor = window.current_monitor();
    let hz = monitor.and_then(|m| m.refresh_rate_millihertz()).map_or(DEFAULT_HZ, |mhz| f64::from(mhz) * 1e-3);
    Duration::from_secs_f64(1.0 / if hz > 1.0 { hz } else { DEFAULT_HZ })
}

/// The interface's state for a window and its screen.
fn interface_of(window: &Window, display: &OwnedDisplayHandle, screen: &Screen) -> egui_winit::State {
    egui_winit::State::new(
        egui::Context::default(),
        egui::ViewportId::ROOT,
        display,
        Some(window.scale_factor() as f32),
        None,
        Some(screen.max_side_px() as usize),
    )
}

fn pose_fields(pose: &Pose) -> serde_json::Map<String, serde_json::Value> {
    fields! { "position": pose.position.to_array(), "yaw": pose.yaw_deg, "pitch": pose.pitch_deg }
}
