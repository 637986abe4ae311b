//! Banners: lines that say what is out of the ordinary for as long as it lasts, and messages that
//! disappear by themselves.
//!
//! In: the state of the connection, of the recording and of the picture. Out: two stacks of lines,
//! from the top down and from the bottom up, in which no line overlaps another.

use super::{
    server_connection::ConnectionState,
    text_block::{self, TEXT},
};
use egui::{Align2, Color32, Rect, pos2};
use std::time::{Duration, Instant};

/// Display time of a message.
const MESSAGE: Duration = Duration::from_secs(5);
/// Space between lines, points.
const GAP: f32 = 6.0;
const GOOD: Color32 = Color32::from_rgb(120, 220, 150);
const BAD: Color32 = Color32::from_rgb(255, 180, 90);
const RECORDING: Color32 = Color32::from_rgb(255, 120, 110);
/// Shown when the server has a new build of the dataset.
const REPLACED: &str = "A new version of this scene is served: F5 connects again and shows it";
/// Shown where the dataset has no images for the eye's position.
const UNPLANNED: &str = "No images were made for this place: what is far away looks softer";

/// A line of text on a background.
#[derive(Debug, Clone, PartialEq)]
struct Line {
    text: String,
    colour: Color32,
}

/// States of the window that have a line at the top.
#[derive(Debug, Clone, Copy)]
pub struct Conditions<'a> {
    /// State of the connection.
    pub connection: &'a ConnectionState,
    /// Time since a recording was started, if one is in progress.
    pub recording: Option<Duration>,
    /// Whether a recorded walk is being replayed.
    pub replaying: bool,
    /// Whether no image was made for the eye's position.
    pub unplanned: bool,
    /// Whether the server has a new build of the dataset.
    pub replaced: bool,
}

impl Conditions<'_> {
    /// The lines at the top.
    fn lines(&self) -> Vec<Line> {
        let line = |text: String, colour| Line { text, colour };
        let recording = |time: Duration| {
            let s = time.as_secs();
            line(format!("recording {}:{:02}; R saves it", s / 60, s % 60), RECORDING)
        };
        let mut lines: Vec<Line> = trouble(self.connection).map(|t| line(t, BAD)).into_iter().collect();
        lines.extend(self.recording.map(recording));
        lines.extend(self.replaying.then(|| line("walking by itself; P or any step ends it".into(), GOOD)));
        lines.extend(self.replaced.then(|| line(REPLACED.into(), GOOD)));
        lines.extend(self.unplanned.then(|| line(UNPLANNED.into(), TEXT)));
        lines
    }
}

/// The banners of a window.
#[derive(Debug, Default)]
pub struct Banners {
    message: Option<(Line, Instant, Duration)>,
}

impl Banners {
    /// Shows a message for a few seconds.
    pub fn show_message(&mut self, text: String, good: bool) {
        self.show_for(text, good, MESSAGE);
    }

    /// Shows a message for a time.
    pub fn show_for(&mut self, text: String, good: bool, time: Duration) {
        self.message = Some((Line { text, colour: if good { GOOD } else { BAD } }, Instant::now(), time));
    }

    /// Draws the lines at the top. Returns the bottom of the last.
    pub fn show_top(&self, painter: &egui::Painter, screen: Rect, conditions: &Conditions<'_>) -> f32 {
        let mut top = screen.top() + 10.0;
        for line in conditions.lines() {
            top = draw(painter, screen, &line, top, Align2::CENTER_TOP).bottom() + GAP;
        }
        top
    }

    /// Draws the message above `bottom`.
    pub fn show_message_above(&mut self, painter: &egui::Painter, screen: Rect, bottom: f32) {
        self.message.take_if(|(_, since, time)| since.elapsed() > *time);
        if let Some((line, ..)) = &self.message {
            draw(painter, screen, line, bottom, Align2::CENTER_BOTTOM);
        }
    }
}

/// Draws a line, wrapped where it is too long. Returns its area.
fn draw(painter: &egui::Painter, screen: Rect, line: &Line, y: f32, align: Align2) -> Rect {
    let at = (pos2(screen.center().x, y), align);
    text_block::line(painter, at, &line.text, line.colour, 15.0, screen.width() * 0.9 - 20.0)
}

/// Describes a problem of the connection; None if there is none.
pub fn trouble(state: &ConnectionState) -> Option<String> {
    match state {
        ConnectionState::Up | ConnectionState::Connecting { after: None, .. } => None,
        ConnectionState::Connecting { after: Some(reason), .. } => {
            Some(format!("{reason}; connecting again; you can go on where you have been"))
        }
        ConnectionState::Waiting { reason, until } => {
            let seconds = until.saturating_duration_since(Instant::now()).as_secs_f64().ceil();
            Some(format!("{reason}; trying again in {seconds:.0} s; you can go on where you have been"))
        }
        ConnectionState::Refused(e) => Some(format!("{e}. Trying again would not help; Ctrl+Q leaves")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui::vec2;

    #[test]
    fn trouble_is_said_with_what_follows() {
        let connecting =
            |attempt, after: Option<&str>| ConnectionState::Connecting { attempt, after: after.map(Into::into) };
        assert_eq!((trouble(&ConnectionState::Up), trouble(&connecting(1, None))), (None, None));
        let text = trouble(&connecting(2, Some("the server stops"))).expect("trouble");
        assert!(text.contains("the server stops") && text.contains("again"), "{text}");
        let waiting = ConnectionState::Waiting { reason: "the server stops".into(), until: Instant::now() };
        let text = trouble(&waiting).expect("trouble");
        assert!(text.contains("the server stops") && text.contains("trying again"), "{text}");
        let refused = ConnectionState::Refused(crate::stream::ConnectError::Busy);
        assert!(trouble(&refused).expect("trouble").contains("would not help"));
    }

    #[test]
    fn every_condition_has_its_line() {
        let waiting = ConnectionState::Waiting { reason: "the server stops".into(), until: Instant::now() };
        let all = Conditions {
            connection: &waiting,
            recording: Some(Duration::from_secs(75)),
            replaying: true,
            unplanned: true,
            replaced: true,
        };
        let lines = all.lines();
        for (line, part) in lines.iter().zip(["the server stops", "recording 1:15", "by itself", "F5", "No images"]) {
            assert!(line.text.contains(part), "{line:?}");
        }
        assert_eq!(lines.len(), 5);
        let none = Conditions {
            connection: &ConnectionState::Up,
            recording: None,
            replaying: false,
            unplanned: false,
            replaced: false,
        };
        assert_eq!(none.lines(), []);
    }

    /// Lays the lines out in a window of this size, on a context without a screen.
    fn areas(size: [f32; 2]) -> Vec<Rect> {
        let waiting = ConnectionState::Waiting { reason: "a long reason ".repeat(9), until: Instant::now() };
        let recording = Some(Duration::from_secs(1));
        let conditions =
            Conditions { connection: &waiting, recording, replaying: true, unplanned: true, replaced: true };
        let mut areas = Vec::new();
        let screen = Rect::from_min_size(pos2(0.0, 0.0), vec2(size[0], size[1]));
        let input = egui::RawInput { screen_rect: Some(screen), ..egui::RawInput::default() };
        let mut output = egui::Context::default().run_pass(input, |ctx| {
            let painter = ctx.debug_painter();
            let mut top = 10.0;
            for line in conditions.lines() {
                areas.push(draw(&painter, screen, &line, top, Align2::CENTER_TOP));
                top = areas[areas.len() - 1].bottom() + GAP;
            }
            let mut help = super::super::help::Help::default();
            let bottom = help.show_line(&painter, screen, screen.bottom() - 8.0);
            let message = Line { text: "saved a picture".into(), colour: GOOD };
            areas.push(draw(&painter, screen, &message, bottom, Align2::CENTER_BOTTOM));
        });
        // Nobody draws them.
        output.textures_delta.clear();
        areas
    }

    #[test]
    fn no_line_overlaps_another_or_leaves_the_window() {
        for size in [[800.0, 500.0], [640.0, 360.0], [1280.0, 720.0]] {
            let areas = areas(size);
            assert_eq!(areas.len(), 6);
            let screen = Rect::from_min_size(pos2(0.0, 0.0), vec2(size[0], size[1]));
            for (i, a) in areas.iter().enumerate() {
                assert!(screen.contains_rect(*a), "{size:?}: {a:?}");
                assert!(areas[..i].iter().all(|b| !b.intersects(*a)), "{size:?}: {areas:?}");
            }
        }
    }
}
