//! The window that people walk in.
//!
//! In: a server. Out: pictures on a display, at its rate, from poses that keys and mouse make. Three threads that never wait for
//! each other, each taking the newest that another has left:
//!
//! ```text
//!   link     connects, keeps the line, connects again          (client/src/stream does the rest on threads of its own)
//!     |  index, cache                        ^ where the eye looks
//!   drawing  moves the walker, draws, adapts the size           
//!     |  finished pictures                   ^ keys, mouse, size
//!   window   events, one texture to the display, interface      (the main thread: systems want it there)
//! ```
//!
//! - `motion`: keys and time to poses within the walk volume; `collision`: what stands in the way; `scale`: milliseconds to sizes; `start_search`: where a visit begins. All pure.
//! - `screen`: wgpu; the only file here that knows it. Nothing of it is loaded before a window is asked for. What draws is the engine's painter, on the processor or a
//!   graphics card (`client/src/gpu`), whose pictures come back to the processor before they are shown.
//! - `hud`, `map` with its `plan`, `start`: what is drawn over the picture. `kept`: walks (`record`) and places (`bookmarks`) that are kept; `settings`: what can be chosen. `keys`, `gamepad`, `shot`, `numbered`, `events`, `frame_times`: small parts.
//! - `walk_link`: the same line for a walk without a window.

mod bookmarks;
mod collision;
mod dynamic_resolution;
mod events;
mod floor_plan;
mod frame_times;
mod gamepad;
mod headless_connection;
mod hud;
mod keys;
mod map;
mod overlay;
mod recording;
mod recordings_and_bookmarks;
mod render_loop;
mod render_mailbox;
mod screen;
mod screenshot;
mod server_connection;
mod settings;
mod software_present;
mod software_upscale;
mod start_pose;
mod start_screen;
mod unique_file;
mod walker;
mod window;
mod window_state;

pub use gamepad::GamepadAt;
pub use headless_connection::HeadlessConnection;
pub use screen::ScreenError;
pub use window::run;

use crate::stream::{ConnectConfig, ConnectError};
use ldi_protocol::{Pose, path::Walk};
use std::{
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
};

/// What to open.
#[derive(Debug, Clone)]
pub struct AppConfig {
    /// The server, whom to trust, the cache.
    pub connect: ConnectConfig,
    /// Size of the window, pixels.
    pub size: (u32, u32),
    /// Time for a frame while moving, milliseconds.
    pub frame_ms: f64,
    /// Where to begin; None for a place of the client's choice.
    pub begin: Option<Pose>,
    /// Folder of the screenshots.
    pub screenshots: PathBuf,
    /// A walk to walk once the first view is complete, and again with P.
    pub replay: Option<Walk>,
    /// The gamepad to walk with, too.
    pub gamepad: GamepadAt,
    /// File of the places that are kept; None for one named after the scene in the user's configuration folder.
    pub bookmarks: Option<PathBuf>,
    /// Where to write what happens, a JSON object per line.
    pub events: Option<PathBuf>,
    /// Becomes true when the window is to be closed: the process was asked to end.
    pub stop: Arc<AtomicBool>,
}

/// Why there is no window, or no longer one.
#[derive(Debug, thiserror::Error)]
pub enum AppError {
    /// No display.
    #[error("no window can be opened: {0}; is there a display? Without one, use `ldi-client walk`")]
    NoDisplay(String),
    /// No driver.
    #[error(transparent)]
    Screen(#[from] ScreenError),
    /// The server does not let this client in, or sends what cannot be used.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The file of `--events`.
    #[error("{path}: {source}; give --events a file that can be written")]
    Events {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: std::io::Error,
    },
    /// The system gives no thread.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
}

impl AppError {
    /// What the window library said, without where in its source.
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
            Self::NoDisplay(_) | Self::Screen(_) | Self::Thread(_) => 1,
        }
    }
}
