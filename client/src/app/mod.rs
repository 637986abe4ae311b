//! The interactive window.
//!
//! In: a server. Out: pictures on a display, at its rate, from poses that keyboard, mouse and
//! gamepad control. Three threads exchange their latest state and never wait for each other:
//!
//! ```text
//!     connection  connects, reconnects               (`stream` has threads of its own)
//!       |  index, cache                        ^ the eye's pose
//!     render      moves the walker, renders, adapts the resolution
//!       |  finished pictures                   ^ intent, turn, window size
//!     window      events, one texture to the display, interface   (the main thread)
//! ```
//!
//! - `server_connection`: the connection thread. `headless_connection`: the same for a walk without
//!   a window.
//! - `render_loop`: the render thread; `render_mailbox`: its shared state; `render_thread`: its
//!   handle.
//! - `walker`: movement within the walk volume; `collision`: obstacles and floors;
//!   `dynamic_resolution`: picture size; `start_pose`: start pose. All pure.
//! - `window`: system events; `window_state`: all state of an open window; `screen`: surface and
//!   presentation with wgpu, opened only with a window; `software_present`, `software_upscale`,
//!   `overlay`: presentation by the CPU.
//! - `hud` with `banners`, `help` and `text_block`, `map` with its `map_view` and `map_plan`,
//!   `start_screen`, `settings_panel`: the interface. `settings`: what the user has chosen, kept in
//!   a `user_file`.
//! - `recordings_and_bookmarks` with `recording` and `bookmarks`: stored walks and poses.
//!   `screenshot`, `unique_file`, `events`, `frame_times`: files and figures. `keys`, `commands`,
//!   `gamepad`: input. `window_commands`: what commands do. `view_link`: links to views.

mod banners;
mod bookmarks;
mod collision;
mod commands;
mod dynamic_resolution;
mod events;
mod frame_times;
mod gamepad;
mod headless_connection;
mod help;
mod hud;
mod interface_pass;
mod keys;
mod map;
mod map_plan;
mod map_view;
mod overlay;
mod recording;
mod recordings_and_bookmarks;
mod render_loop;
mod render_mailbox;
mod render_thread;
mod screen;
mod screenshot;
mod server_connection;
mod settings;
mod settings_panel;
mod software_present;
mod software_upscale;
mod start_pose;
mod start_screen;
mod text_block;
mod unique_file;
mod user_file;
mod view_link;
mod walker;
mod window;
mod window_commands;
mod window_state;

pub use gamepad::GamepadAt;
pub use headless_connection::HeadlessConnection;
pub use screen::ScreenError;
pub use view_link::{ViewLink, parse_pose};
pub use window::run;

use crate::stream::{ConnectConfig, ConnectError};
use ldi_protocol::{Pose, path::Walk};
use std::{
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
};

/// Settings of the window.
#[derive(Debug, Clone)]
pub struct AppConfig {
    /// Settings of the connection.
    pub connect: ConnectConfig,
    /// Size of the window, pixels.
    pub size: (u32, u32),
    /// Intended frame time while moving, milliseconds; None for the one in the settings.
    pub frame_ms: Option<f64>,
    /// File of the settings; None for the one in the user's configuration folder.
    pub settings: Option<PathBuf>,
    /// Start pose; None for one chosen by the client.
    pub begin: Option<Pose>,
    /// Folder of the screenshots.
    pub screenshots: PathBuf,
    /// A walk that is replayed once the first view is complete, and again with P.
    pub replay: Option<Walk>,
    /// The gamepad.
    pub gamepad: GamepadAt,
    /// File of the bookmarks; None for one named after the scene in the user's configuration
    /// folder.
    pub bookmarks: Option<PathBuf>,
    /// File of the event log.
    pub events: Option<PathBuf>,
    /// Set when the process is asked to end.
    pub stop: Arc<AtomicBool>,
}

/// Reasons why a window cannot be opened, or had to be closed.
#[derive(Debug, thiserror::Error)]
pub enum AppError {
    /// No display.
    #[error(
        "no window can be opened: {0}; run this where there is a display, set DISPLAY or WAYLAND_DISPLAY to it (`ssh -X` does), or walk without a window by `ldi-client walk`"
    )]
    NoDisplay(String),
    /// No driver.
    #[error(transparent)]
    Screen(#[from] ScreenError),
    /// The server refuses the connection, or sends unusable data.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The file of `--events`.
    #[error("{path}: {source}; give --events a file that can be written")]
    Events {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The system gives no thread.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
}

impl AppError {
    /// The window library's message, without its source location.
    fn no_display(e: &dyn std::fmt::Display) -> Self {
        let text = e.to_string();
        let described =
            text.rsplit_once(".rs:").and_then(|(_, t)| t.split_once(": ")).map_or(text.as_str(), |(_, t)| t);
        Self::NoDisplay(described.trim_end_matches('.').to_owned())
    }

    /// The exit code of the command line: 2 for wrong usage, 1 when a retry may help, 42 when not.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Connect(e) => e.exit_code(),
            Self::Events { .. } => 2,
            Self::NoDisplay(_) | Self::Screen(ScreenError::NoAdapter(_)) => 42,
            Self::Screen(ScreenError::Driver { .. }) | Self::Thread(_) => 1,
        }
    }
}
