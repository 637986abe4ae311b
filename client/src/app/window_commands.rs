//! What commands do to an open window.

use super::{
    commands::Command,
    events::{Events, fields},
    recordings_and_bookmarks::Announcement,
    server_connection::ServerConnection,
    view_link::ViewLink,
    window_state::WindowState,
};
use ldi_protocol::Pose;
use winit::window::Fullscreen;

impl WindowState {
    /// Carries out a command. Returns whether the window is to be closed.
    pub(super) fn command(&mut self, command: Command, connection: &ServerConnection, events: &mut Events) -> bool {
        match command {
            Command::Leave => return true,
            Command::CopyLink => self.copy_link(events),
            Command::GoTo(digit) => self.bookmark(digit, false, connection, events),
            Command::Keep(digit) => self.bookmark(digit, true, connection, events),
            Command::Help => self.toggle_help(events),
            Command::Figures => {
                self.hud.figures = !self.hud.figures;
                events.write("figures", fields! { "shown": self.hud.figures });
            }
            Command::NextView { back } => self.next_view(back, events),
            Command::Settings => self.toggle_settings(connection, events),
            Command::Reconnect if connection.is_replaced() => connection.reconnect(),
            Command::Reconnect => self.tell("the server has no newer build of this scene", true),
            Command::FullScreen => {
                self.settings.full_screen = !self.settings.full_screen;
                self.apply_settings();
                self.save_settings();
                events.write("full_screen", fields! { "on": self.settings.full_screen });
            }
            Command::Screenshot => self.render_thread.take_screenshot(),
            Command::Record => {
                let described = self.kept.record(self.render_thread.speed_m_per_s());
                self.announce(described, events);
            }
            Command::Replay => match self.kept.walk() {
                _ if self.replaying => self.render_thread.replay(None),
                Some(walk) => self.render_thread.replay(Some(walk)),
                None => self.tell("nothing to walk again yet: R records a walk", false),
            },
            Command::Walls => {
                let closed = self.render_thread.toggle_walls();
                self.tell(if closed { "walls are closed" } else { "walls are open: G closes them" }, true);
                events.write("walls", fields! { "closed": closed });
            }
            Command::Map => self.toggle_map(connection, events),
            Command::Storey { up } if self.map.open => self.map.change_storey(up),
            Command::Storey { .. } => {}
            Command::Escape if self.hud.help.open => self.toggle_help(events),
            Command::Escape if self.map.open => self.toggle_map(connection, events),
            Command::Escape if self.settings_open => self.toggle_settings(connection, events),
            Command::Escape => self.capture(false, events),
        }
        false
    }

    fn tell(&mut self, text: &str, good: bool) {
        self.hud.banners.show_message(text.to_owned(), good);
    }

    fn toggle_help(&mut self, events: &mut Events) {
        self.started = true;
        self.hud.help.open = !self.hud.help.open;
        events.write("help", fields! { "open": self.hud.help.open });
    }

    fn next_view(&mut self, back: bool, events: &mut Events) {
        if !self.settings.developer {
            return self.tell("views for developers are switched on in the settings (F3)", false);
        }
        self.shows = self.shows.next(back);
        self.render_thread.show(self.shows);
        self.tell(self.shows.legend(), true);
        events.write("view", fields! { "shows": self.shows });
    }

    fn toggle_settings(&mut self, connection: &ServerConnection, events: &mut Events) {
        if self.map.open {
            // The map would cover the settings.
            self.toggle_map(connection, events);
        }
        self.started = true;
        self.hud.help.open = false;
        self.settings_open = !self.settings_open;
        match self.settings_open {
            true => self.capture(false, events),
            false => self.save_settings(),
        }
        events.write("settings", fields! { "open": self.settings_open });
    }

    /// Applies the settings to the pictures and the window.
    pub(super) fn apply_settings(&mut self) {
        self.render_thread.apply_settings(&self.settings);
        if self.settings.full_screen != self.window.fullscreen().is_some() {
            self.window.set_fullscreen(self.settings.full_screen.then_some(Fullscreen::Borderless(None)));
        }
    }

    /// Writes the settings to their file.
    pub(super) fn save_settings(&mut self) {
        if let Err(e) = self.settings_file.save(&self.settings) {
            tracing::warn!("{e}");
            self.hud.banners.show_message(e, false);
        }
    }

    /// Copies a link to the view.
    fn copy_link(&mut self, events: &mut Events) {
        let Some(picture) = &self.picture else { return };
        let link = ViewLink { server: self.server.clone(), pose: Some(picture.pose) }.to_string();
        println!("{link}");
        events.write("link", fields! { "text": &link });
        self.hud.banners.show_message(format!("copied {link}"), true);
        self.copy = Some(link);
    }

    /// Shows a message and logs its event.
    pub(super) fn announce(&mut self, described: Announcement, events: &mut Events) {
        self.hud.banners.show_message(described.text, described.good);
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

    /// Opens or closes the map.
    pub(super) fn toggle_map(&mut self, connection: &ServerConnection, events: &mut Events) {
        self.started = true;
        self.hud.help.open = false;
        self.map.toggle();
        connection.others().set_wanted(self.map.open);
        (self.last_reported.map, self.last_reported.others) = (false, None);
        if self.map.open {
            if std::mem::take(&mut self.settings_open) {
                self.save_settings();
                events.write("settings", fields! { "open": false });
            }
            self.capture_again = self.captured;
            self.capture(false, events);
        } else {
            events.write("map", fields! { "open": false });
            self.capture(self.capture_again, events);
        }
    }

    /// Moves to a place on the map, and closes it.
    pub(super) fn go_to_map_place(&mut self, there: Pose, connection: &ServerConnection, events: &mut Events) {
        self.render_thread.place(there);
        let position = there.position.to_array();
        events.write("teleport", fields! { "position": position, "yaw_deg": there.yaw_deg });
        self.toggle_map(connection, events);
    }
}
