//! The event log of `--events FILE`: one JSON object per line, for tests and for tools that drive
//! the window.
//!
//! Each line has `t_ms`, milliseconds since the log was opened, and `event`;
//! docs/user/client.md lists the events.

use serde_json::{Map, Value};
use std::{
    fs::File,
    io::Write as _,
    path::{Path, PathBuf},
    time::Instant,
};

/// Writes events, or drops them if there is no file.
#[derive(Debug)]
pub struct Events {
    file: Option<(File, PathBuf)>,
    start: Instant,
}

impl Events {
    /// Opens the file and empties it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn open(path: Option<&Path>) -> std::io::Result<Self> {
        let file = path.map(|p| File::create(p).map(|f| (f, p.to_owned()))).transpose()?;
        Ok(Self { file, start: Instant::now() })
    }

    /// Writes a line at once, so that readers of the file see it.
    pub fn write(&mut self, event: &str, mut more: Map<String, Value>) {
        let Some((file, path)) = &mut self.file else { return };
        more.insert("t_ms".into(), (self.start.elapsed().as_secs_f64() * 1e3).round().into());
        more.insert("event".into(), event.into());
        let line = Value::Object(more).to_string() + "\n";
        if let Err(e) = file.write_all(line.as_bytes()) {
            tracing::warn!("{}: {e}; no more events are written", path.display());
            self.file = None;
        }
    }
}

/// A JSON object from names and values.
macro_rules! fields {
    ($($name:literal: $value:expr),* $(,)?) => {{
        #[allow(unused_mut, reason = "some events have no fields")]
        let mut map = serde_json::Map::new();
        $(map.insert($name.into(), serde_json::json!($value));)*
        map
    }};
}
pub(super) use fields;
