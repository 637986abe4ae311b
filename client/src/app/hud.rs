//! The head-up display: statistics (F1), the help line, messages.

use super::{
    render_mailbox::Picture,
    server_connection::{ConnectionState, ConnectionSummary},
};
use crate::engine::DisplayMode;
use egui::{Align2, Color32, CornerRadius, FontId, Pos2, Rect, Stroke, pos2, vec2};
use ldi_protocol::index::Index;
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

/// Frames in the graph.
const GRAPH: usize = 120;
/// Top of the graph, milliseconds.
const GRAPH_MS: f32 = 50.0;
/// Display time of a message.
const MESSAGE: Duration = Duration::from_secs(5);
/// Background of text.
pub const SHADE: Color32 = Color32::from_black_alpha(170);
const TEXT: Color32 = Color32::from_gray(235);
const GOOD: Color32 = Color32::from_rgb(120, 220, 150);
const BAD: Color32 = Color32::from_rgb(255, 180, 90);

/// Keys, in one line.
pub const HELP: &str = "click: look  |  W A S D: walk  |  Shift: run  |  wheel: speed  |  M: map  |  G: walls  |  R, P: record, replay  |  Ctrl+1, 1: keep a place, go there  |  F1: figures  |  F2: views  |  F3: settings  |  F12: picture  |  Esc: free the pointer  |  Ctrl+Q: leave";

/// State of the display.
#[derive(Debug)]
pub struct Hud {
    /// Whether statistics are shown.
    pub figures: bool,
    /// Milliseconds of the latest frames, and when they were finished.
    pictures: VecDeque<(f32, Instant)>,
    message: Option<(String, bool, Instant)>,
    /// Whether the help line is shown. It disappears after some walking, and returns with the
    /// statistics.
    pub help: bool,
}

impl Default for Hud {
    fn default() -> Self {
        Self { figures: true, pictures: VecDeque::new(), message: None, help: true }
    }
}

/// Shown where the dataset has no images for the eye's position.
const UNPLANNED: &str = "No images were made for this place: what is far away looks softer";

impl Hud {
    /// Records a new picture.
    pub fn picture(&mut self, p: &Picture) {
        let ms = &p.stats.frame_stats.ms;
        if self.pictures.len() == GRAPH {
            self.pictures.pop_front();
        }
        self.pictures.push_back(((ms.total + ms.prepare) as f32, p.at));
    }

    /// Shows a message for a few seconds.
    pub fn show_message(&mut self, text: String, good: bool) {
        self.message = Some((text, good, Instant::now()));
    }

    /// Pictures per second over the last second; None if hardly any were drawn because nothing
    /// changed.
    fn per_second(&self) -> Option<f64> {
        let recent = || self.pictures.iter().map(|p| p.1).filter(|at| at.elapsed() < Duration::from_secs(1));
        let span = recent().next_back()?.duration_since(recent().next()?).as_secs_f64();
        let n = recent().count();
        (n > 4).then(|| (n - 1) as f64 / span.max(1e-3))
    }

    /// Draws the display.
    pub fn show(
        &mut self,
        ctx: &egui::Context,
        shown: Option<(&Picture, &Index)>,
        line: &ConnectionSummary,
        state: &ConnectionState,
        speed_m_per_s: f64,
    ) {
        let screen = ctx.content_rect();
        let painter = ctx.layer_painter(egui::LayerId::new(egui::Order::Foreground, egui::Id::unique("hud")));
        if self.figures {
            let lines = match shown {
                Some((picture, index)) => self.lines(picture, index, line, speed_m_per_s),
                None => vec![format!("network    {:.1} Mbit/s, {:.1} MB", line.mbit_per_s, line.bytes as f64 * 1e-6)],
            };
            let area = block(&painter, pos2(10.0, 10.0), &lines.join("\n"));
            if shown.is_some() {
                self.graph(&painter, Rect::from_min_size(area.left_bottom() + vec2(0.0, 6.0), vec2(240.0, 50.0)));
            }
        }
        if self.help || self.figures {
            centred(&painter, pos2(screen.center().x, screen.bottom() - 18.0), HELP, TEXT, 12.0, screen.width() - 24.0);
        }
        if shown.is_some_and(|(picture, _)| picture.stats.unplanned) {
            let at = pos2(screen.center().x, screen.bottom() - 36.0);
            centred(&painter, at, UNPLANNED, TEXT, 13.0, screen.width() * 0.8);
        }
        if let Some(text) = trouble(state) {
            centred(&painter, pos2(screen.center().x, screen.top() + 34.0), &text, BAD, 16.0, screen.width() * 0.7);
        }
        if let Some((text, good, since)) = &self.message {
            if since.elapsed() > MESSAGE {
                self.message = None;
            } else {
                let colour = if *good { GOOD } else { BAD };
                let at = pos2(screen.center().x, screen.bottom() - 60.0);
                centred(&painter, at, text, colour, 15.0, screen.width() * 0.8);
            }
        }
    }

    fn lines(&self, picture: &Picture, index: &Index, line: &ConnectionSummary, speed_m_per_s: f64) -> Vec<String> {
        let f = &picture.stats;
        let (ms, warp) = (&f.frame_stats.ms, f.frame_stats.warp.as_ref());
        let rate = self.per_second().map_or("resting".into(), |fps| format!("{fps:.0} fps"));
        let fine = if f.supersample > 1 { ", 4 samples per pixel" } else { "" };
        let missing = match f.frame_stats.missing_chunks.len() {
            0 => "nothing".to_owned(),
            n => format!("{n} chunks, {:.2} MB", f.missing_bytes as f64 * 1e-6),
        };
        let waiting = if f.frame_stats.waiting > 0 {
            format!(", {} to be laid out or uploaded", f.frame_stats.waiting)
        } else {
            String::new()
        };
        let place = f.selection.grid_point.map_or("none".into(), |p| p.to_string());
        let image = f.selection.placement.map_or("none".into(), |p| p.to_string());
        let p = picture.pose.position;
        let dropped = if f.dropped_cells > 0 { format!(", {} cells left out", f.dropped_cells) } else { String::new() };
        let mut lines = vec![
            format!(
                "{rate}, {:.1} ms, {} x {}{fine}",
                ms.total + ms.prepare,
                picture.frame.width,
                picture.frame.height
            ),
            format!(
                "ms         select {:.1}  near {:.1}  layout {:.1}  warp {:.1}  composite {:.1}",
                ms.select + ms.cull,
                ms.near,
                ms.prepare,
                ms.warp,
                ms.composite
            ),
            match &f.card {
                Some((name, bytes)) => format!("drawn by   {name}, {:.0} MB on it", *bytes as f64 * 1e-6),
                None => "drawn by   the CPU".into(),
            },
            format!("triangles  {} of {}{dropped}", grouped(f.frame_stats.triangles), grouped(index.settings.budget)),
            format!("samples    {} warped", grouped(warp.map_or(0, |w| w.samples_warped))),
            format!(
                "cache      {:.0} of {:.0} MB, {} objects",
                line.cache.bytes as f64 * 1e-6,
                line.cache.cap_bytes as f64 * 1e-6,
                grouped(line.cache.objects as u64)
            ),
            format!(
                "network    {:.1} Mbit/s, {:.1} MB, round trip {:.1} ms",
                line.mbit_per_s,
                line.bytes as f64 * 1e-6,
                line.rtt_ms
            ),
            format!("missing    {missing}{waiting}"),
            format!("place      grid point {place}, placement {image}"),
            format!(
                "eye        {:.2} {:.2} {:.2}, yaw {:.0}, pitch {:.0}, {speed_m_per_s:.1} m/s",
                p.x, p.y, p.z, picture.pose.yaw_deg, picture.pose.pitch_deg
            ),
        ];
        if f.shows != DisplayMode::Scene {
            lines.push(format!("view       {}", f.shows.legend()));
        }
        lines
    }

    /// Draws the graph of frame times.
    fn graph(&self, painter: &egui::Painter, area: Rect) {
        painter.rect_filled(area, CornerRadius::same(4), SHADE);
        let y = |ms: f32| area.bottom() - (ms / GRAPH_MS).min(1.0) * area.height();
        let sixty = y(1000.0 / 60.0);
        painter.line_segment(
            [pos2(area.left(), sixty), pos2(area.right(), sixty)],
            Stroke::new(1.0, Color32::from_gray(110)),
        );
        let width = area.width() / GRAPH as f32;
        for (i, (ms, _)) in self.pictures.iter().enumerate() {
            let x = area.left() + i as f32 * width;
            let colour = if *ms > GRAPH_MS { BAD } else { GOOD };
            painter.rect_filled(
                Rect::from_min_max(pos2(x, y(*ms)), pos2(x + width - 0.5, area.bottom())),
                CornerRadius::ZERO,
                colour,
            );
        }
    }
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

/// Draws lines of fixed-width text on a background. Returns the area.
pub fn block(painter: &egui::Painter, at: Pos2, text: &str) -> Rect {
    let galley = painter.layout_no_wrap(text.to_owned(), FontId::monospace(12.5), TEXT);
    let area = Rect::from_min_size(at, galley.size() + vec2(16.0, 12.0));
    painter.rect_filled(area, CornerRadius::same(4), SHADE);
    painter.galley(at + vec2(8.0, 6.0), galley, TEXT);
    area
}

/// Draws wrapped, centred text on a background.
pub fn centred(painter: &egui::Painter, at: Pos2, text: &str, colour: Color32, size: f32, width: f32) -> Rect {
    let galley = painter.layout(text.to_owned(), FontId::proportional(size), colour, width);
    let area = Align2::CENTER_CENTER.anchor_size(at, galley.size() + vec2(20.0, 10.0));
    painter.rect_filled(area, CornerRadius::same(5), SHADE);
    painter.galley(area.min + vec2(10.0, 5.0), galley, colour);
    area
}

/// Formats a number with digits in groups of three.
fn grouped(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(c);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_grouped() {
        let shown = [0, 999, 1000, 1_349_733].map(grouped);
        assert_eq!(shown, ["0", "999", "1,000", "1,349,733"]);
    }

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
}
