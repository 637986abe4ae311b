//! The state of an open window: what is shown, input, and messages.

use super::{
    AppConfig, AppError,
    events::{Events, fields},
    frame_times::FrameTimes,
    gamepad::{Gamepad, PadPress},
    hud::Hud,
    interface_pass::Interface,
    keys::Keys,
    map::Map,
    recordings_and_bookmarks::{Announcement, RecordingsAndBookmarks},
    render_mailbox::{Picture, RenderConfig},
    render_thread::RenderThread,
    screen::{Screen, ScreenError},
    screenshot::{Outcome, Screenshots},
    server_connection::ServerConnection,
    settings::UserSettings,
    start_screen,
    walker::Intent,
};
use crate::engine::{DisplayMode, FrameRenderer};
use ldi_protocol::{Pose, volume::WalkVolume};
use std::{
    sync::{Arc, mpsc},
    time::{Duration, Instant},
};
use winit::{
    dpi::PhysicalSize,
    event::{ElementState, KeyEvent},
    event_loop::{ActiveEventLoop, EventLoopProxy, OwnedDisplayHandle},
    keyboard::{Key, KeyCode, ModifiersState, NamedKey, PhysicalKey},
    window::{CursorGrabMode, Window},
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
/// Number of pictures of a moving eye after which the help line disappears.
const HELP_FOR: u32 = 600;
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
    pub moved_pictures: u32,
    pub frame_times: FrameTimes,
    /// Counts of pictures and redraws.
    pub counts: Counts,
    pub last_reported: LastReported,
    pub settings: UserSettings,
    shows: DisplayMode,
    kept: RecordingsAndBookmarks,
    /// Whether a replay starts with the first complete picture.
    walk_at_once: bool,
    /// Whether a walk is being replayed.
    replaying: bool,
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
    map: bool,
    others: Option<usize>,
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
        let (width, height) = config.size;
        let attributes = Window::default_attributes()
            .with_title(format!("ldi-client: {}", config.connect.server))
            .with_min_inner_size(PhysicalSize::new(160, 120))
            .with_inner_size(PhysicalSize::new(width, height));
        let window = event_loop.create_window(attributes).map_err(|e| AppError::no_display(&e))?;
        let window = Arc::new(window);
        let display = event_loop.owned_display_handle();
        let screen = Screen::open(window.clone(), display.clone())?;
        let hz = window
            .current_monitor()
            .and_then(|m| m.refresh_rate_millihertz())
            .map_or(DEFAULT_HZ, |mhz| f64::from(mhz) * 1e-3);
        let hz = if hz > 1.0 { hz } else { DEFAULT_HZ };
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
            frame_ms: config.frame_ms,
            begin: config.begin,
            window_px: [size.width, size.height],
            interval: Duration::from_secs_f64(1.0 / hz),
            even: screen.keeps_interface(),
        };
        let render_thread =
            RenderThread::start(render_config, renderer, connection, screenshots, notify(UserEvent::Picture))
                .map_err(AppError::Thread)?;
        let egui = interface_of(&window, &display, &screen);
        Ok(Self {
            render_thread,
            screen: Some(screen),
            reopened: None,
            display,
            egui,
            window,
            screenshots: outcomes,
            picture: None,
            hud: Hud::default(),
            map: Map::default(),
            keys: Keys::default(),
            pad: Gamepad::watch(config.gamepad.clone(), notify(UserEvent::Pad)),
            focused: true,
            modifiers: ModifiersState::empty(),
            captured: false,
            capture_again: false,
            started: false,
            moved_pictures: 0,
            frame_times: FrameTimes::default(),
            counts: Counts::default(),
            last_reported: LastReported::default(),
            settings: UserSettings::new(config.frame_ms),
            shows: DisplayMode::default(),
            kept: RecordingsAndBookmarks::new(config),
            walk_at_once: config.replay.is_some(),
            replaying: false,
            repaint_at: Instant::now(),
            written: None,
        })
    }

    /// Takes the newest picture.
    pub fn take(&mut self, events: &mut Events) {
        if !self.render_thread.take(&mut self.picture) {
            return;
        }
        let Some(picture) = &self.picture else { return };
        if let Some(screen) = &mut self.screen {
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
        }
        self.kept.pose(picture.pose, picture.at);
        let last_reported = self.last_reported.pose;
        if last_reported.is_none_or(|(pose, _)| pose != picture.pose) {
            self.moved_pictures += 1;
            if self.moved_pictures == HELP_FOR {
                self.hud.help = false;
            }
            if last_reported.is_none_or(|(_, at)| at.elapsed() >= POSE_EVERY) {
                self.last_reported.pose = Some((picture.pose, Instant::now()));
                events.write("pose", pose_fields(&picture.pose));
            }
        }
    }

    /// Reports the outcome of a screenshot.
    pub fn shot(&mut self, outcome: Outcome, events: &mut Events) {
        self.written = None;
        match outcome {
            Ok(path) => {
                let path = std::path::absolute(&path).unwrap_or(path);
                println!("{}", path.display());
                self.hud.show_message(format!("saved {}", path.display()), true);
                events.write("screenshot", fields! { "path": path.display().to_string() });
            }
            Err(e) => {
                tracing::warn!("{e}");
                events.write("screenshot_failed", fields! { "reason": &e });
                self.hud.show_message(e, false);
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
        if pressed && !event.repeat && self.command(event, connection, events) {
            return true;
        }
        if let PhysicalKey::Code(code) = event.physical_key {
            let control = self.modifiers.control_key() || self.modifiers.super_key();
            if self.keys.set(code, pressed && !control) {
                self.started |= pressed;
                self.render_thread.set_intent(self.intent());
            }
        }
        false
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

    /// Handles a key with a single action. Returns whether the window is to be closed.
    fn command(&mut self, event: &KeyEvent, connection: &ServerConnection, events: &mut Events) -> bool {
        let letter = |wanted: &str| matches!(&event.logical_key, Key::Character(c) if c.eq_ignore_ascii_case(wanted));
        let control = self.modifiers.control_key() || self.modifiers.super_key();
        if let Some(digit) = digit(event) {
            self.bookmark(digit, control, connection, events);
        }
        if control {
            return letter("q") || letter("w");
        }
        match &event.logical_key {
            Key::Named(NamedKey::F2) => {
                self.shows = self.shows.next(self.modifiers.shift_key());
                self.render_thread.show(self.shows);
                self.hud.show_message(self.shows.legend().into(), true);
                events.write("view", fields! { "shows": self.shows });
            }
            Key::Named(NamedKey::F3) => {
                if self.map.open {
                    // The map would cover the settings.
                    self.toggle_map(connection, events);
                }
                self.settings.open = !self.settings.open;
                if self.settings.open {
                    self.capture(false, events);
                }
                events.write("settings", fields! { "open": self.settings.open });
            }
            _ if letter("r") => {
                let described = self.kept.record(self.render_thread.speed_m_per_s());
                self.announce(described, events);
            }
            _ if letter("p") => match self.kept.walk() {
                _ if self.replaying => self.render_thread.replay(None),
                Some(walk) => self.render_thread.replay(Some(walk)),
                None => self.hud.show_message("nothing to walk again yet: R records a walk".into(), false),
            },
            Key::Named(NamedKey::Escape) if self.map.open => self.toggle_map(connection, events),
            Key::Named(NamedKey::Escape) if self.settings.open => {
                self.settings.open = false;
                events.write("settings", fields! { "open": false });
            }
            Key::Named(NamedKey::Escape) => self.capture(false, events),
            Key::Named(NamedKey::F1) => {
                self.hud.figures = !self.hud.figures;
                self.hud.help = self.hud.figures;
                events.write("figures", fields! { "shown": self.hud.figures });
            }
            Key::Named(NamedKey::F12) => self.render_thread.take_screenshot(),
            _ if letter("g") => {
                let closed = self.render_thread.toggle_walls();
                self.hud.show_message(
                    if closed { "walls are closed" } else { "walls are open: G closes them" }.into(),
                    true,
                );
                events.write("walls", fields! { "closed": closed });
            }
            Key::Named(NamedKey::PageUp) if self.map.open => self.map.change_storey(true),
            Key::Named(NamedKey::PageDown) if self.map.open => self.map.change_storey(false),
            _ if letter("m") => self.toggle_map(connection, events),
            _ => {}
        }
        self.window.request_redraw();
        false
    }

    /// Shows a message and logs its event.
    fn announce(&mut self, described: Announcement, events: &mut Events) {
        self.hud.show_message(described.text, described.good);
        if let Some((event, more)) = described.event {
            events.write(event, more);
        }
    }

    /// Stores the current pose under a digit, or moves to the stored one.
    fn bookmark(&mut self, digit: u8, keep: bool, connection: &ServerConnection, events: &mut Events) {
        let (Some(scene), Some(picture)) = (connection.scene(), &self.picture) else { return };
        let (there, described) = self.kept.bookmark(digit, keep.then_some(picture.pose), &scene.index.scene.name);
        if let Some(pose) = there {
            self.render_thread.place(pose);
        }
        self.announce(described, events);
    }

    /// Turns the head by a mouse movement.
    pub fn turn_by_mouse(&self, delta: (f64, f64), deg_per_count: f64) {
        let (yaw_deg, pitch_deg) = self.settings.turn_deg(delta, deg_per_count);
        self.render_thread.turn(yaw_deg, pitch_deg);
    }

    fn toggle_map(&mut self, connection: &ServerConnection, events: &mut Events) {
        self.started = true;
        self.map.toggle();
        connection.others().set_wanted(self.map.open);
        (self.last_reported.map, self.last_reported.others) = (false, None);
        if self.map.open {
            if std::mem::take(&mut self.settings.open) {
                events.write("settings", fields! { "open": false });
            }
            self.capture_again = self.captured;
            self.capture(false, events);
        } else {
            events.write("map", fields! { "open": false });
            self.capture(self.capture_again, events);
        }
    }

    /// Reports the start and the end of a replay, of which no picture may tell.
    fn report_replay(&mut self, events: &mut Events) {
        let replaying = self.render_thread.is_replaying();
        if std::mem::replace(&mut self.replaying, replaying) != replaying {
            self.hud.show_message(
                if replaying { "walking by itself: P or any step ends it" } else { "the walk is over" }.into(),
                true,
            );
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
        let Err(e) = screen.present(self.picture.as_ref().map(|p| &p.frame), interface) else { return Ok(()) };
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
        self.hud.show_message("the graphics driver failed and was started again".into(), false);
        self.window.request_redraw();
        Ok(())
    }

    /// Redraws the window.
    ///
    /// # Errors
    /// If the driver has failed permanently.
    pub fn redraw(
        &mut self,
        server: &str,
        connection: &ServerConnection,
        events: &mut Events,
    ) -> Result<(), ScreenError> {
        self.report_replay(events);
        let to_read_alone = self.started && !self.map.open && !self.settings.open;
        let written = self.written.is_some_and(|at| at.elapsed() < WRITE_EVERY);
        if written && to_read_alone && self.screen.as_ref().is_some_and(Screen::keeps_interface) {
            return self.present(None);
        }
        self.written = Some(Instant::now());
        let input = self.egui.take_egui_input(&self.window);
        let ctx = self.egui.egui_ctx().clone();
        let (scene, state, stats) = (connection.scene(), connection.state(), connection.summary());
        let others = connection.others().list();
        let speed = self.render_thread.speed_m_per_s();
        let mut clicked = None;
        let output = ctx.run_pass(input, |ctx| {
            let shown = self.picture.as_ref();
            if !self.started {
                start_screen::show(ctx, server, connection, shown);
                return;
            }
            if let (true, Some(scene), Some(p)) = (self.map.open, &scene, shown) {
                clicked = self.map.show(ctx, scene, p, others.as_deref()).or(clicked);
            }
            let shown = shown.zip(scene.as_ref()).map(|(p, s)| (p, &*s.index));
            let hud_below_map = self.map.open && self.hud.figures;
            if hud_below_map {
                // The map takes the place of the statistics; messages stay.
                self.hud.figures = false;
            }
            self.hud.show(ctx, shown, &stats, &state, speed);
            if self.settings.open && self.settings.show(ctx) {
                self.render_thread.apply_settings(self.settings.frame_ms, self.settings.fine);
            }
            self.hud.figures |= hud_below_map;
        });
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
        if let (Some(sheet), false) = (self.map.sheet, self.last_reported.map) {
            self.last_reported.map = true;
            let a = sheet.area;
            let px = [a.min.x, a.min.y, a.max.x, a.max.y].map(|v| v * scale);
            let [x, z] = sheet.corner;
            events.write("map", fields! { "open": true, "area_px": px, "corner": [x, z], "px_per_m": sheet.per_metre * f64::from(scale) });
        }
        let shown = others.filter(|_| self.map.open).map(|o| o.len());
        if shown.is_some() && std::mem::replace(&mut self.last_reported.others, shown) != shown {
            events.write("others", fields! { "shown": shown });
        }
        if let Some(p) = clicked {
            self.render_thread.teleport(p);
            events.write("teleport", fields! { "position": p.to_array() });
            let is_floor = |v: &WalkVolume| v.heights(p.x, p.z).next().is_some();
            if connection.scene().is_some_and(|s| s.index.volume.as_ref().is_some_and(|v| !is_floor(v))) {
                self.hud.show_message("nobody can stand where you clicked: this is the nearest place".into(), true);
            }
            self.toggle_map(connection, events);
        }
        Ok(())
    }

    /// Closes the window and saves a recording in progress.
    pub fn close(&mut self, events: &mut Events) {
        if self.kept.is_recording() {
            let described = self.kept.record(self.render_thread.speed_m_per_s());
            self.announce(described, events);
        }
    }
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

/// The digit of a key, by its position: independent of Shift and keyboard layout.
fn digit(event: &KeyEvent) -> Option<u8> {
    const DIGITS: [KeyCode; 9] = [
        KeyCode::Digit1,
        KeyCode::Digit2,
        KeyCode::Digit3,
        KeyCode::Digit4,
        KeyCode::Digit5,
        KeyCode::Digit6,
        KeyCode::Digit7,
        KeyCode::Digit8,
        KeyCode::Digit9,
    ];
    let PhysicalKey::Code(code) = event.physical_key else { return None };
    (1u8..).zip(DIGITS).find(|(_, c)| *c == code).map(|(digit, _)| digit)
}

fn pose_fields(pose: &Pose) -> serde_json::Map<String, serde_json::Value> {
    fields! { "position": pose.position.to_array(), "yaw": pose.yaw_deg, "pitch": pose.pitch_deg }
}
