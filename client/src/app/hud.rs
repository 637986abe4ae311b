//! The head-up display: statistics (F1), banners, the help line.

use super::{
    banners::{Banners, Conditions},
    help::Help,
    render_mailbox::Picture,
    server_connection::ConnectionSummary,
    text_block::{SHADE, block},
};
use crate::engine::DisplayMode;
use egui::{Color32, CornerRadius, Rect, Stroke, pos2, vec2};
use ldi_protocol::index::Index;
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

/// Frames in the graph.
const GRAPH: usize = 120;
/// Top of the graph, milliseconds.
const GRAPH_MS: f32 = 50.0;
const GOOD: Color32 = Color32::from_rgb(120, 220, 150);
const BAD: Color32 = Color32::from_rgb(255, 180, 90);

/// State of the display.
#[derive(Debug, Default)]
pub struct Hud {
    /// Whether statistics are shown.
    pub figures: bool,
    /// Milliseconds of the latest frames, and when they were finished.
    pictures: VecDeque<(f32, Instant)>,
    /// Banners and messages.
    pub banners: Banners,
    /// Help.
    pub help: Help,
}

/// What the display shows.
#[derive(Debug, Clone, Copy)]
pub struct Shown<'a> {
    /// The newest picture and its dataset.
    pub picture: Option<(&'a Picture, &'a Index)>,
    /// Transfer rates and counts.
    pub line: &'a ConnectionSummary,
    /// What is out of the ordinary.
    pub conditions: Conditions<'a>,
    /// The chosen walking speed, m/s.
    pub speed_m_per_s: f64,
    /// Whether a panel takes the place of the statistics.
    pub covered: bool,
    /// Height at the bottom that something else takes, points.
    pub taken: f32,
}

impl Hud {
    /// Records a new picture.
    pub fn picture(&mut self, p: &Picture) {
        let ms = &p.stats.frame_stats.ms;
        if self.pictures.len() == GRAPH {
            self.pictures.pop_front();
        }
        self.pictures.push_back(((ms.total + ms.prepare) as f32, p.at));
    }

    /// Pictures per second over the last second; None if hardly any were drawn because nothing
    /// changed.
    fn per_second(&self) -> Option<f64> {
        let recent = || self.pictures.iter().map(|p| p.1).filter(|at| at.elapsed() < Duration::from_secs(1));
        let span = recent().next_back()?.duration_since(recent().next()?).as_secs_f64();
        let n = recent().count();
        (n > 4).then(|| (n - 1) as f64 / span.max(1e-3))
    }

    /// Draws the display. Returns the bottom of the banners.
    pub fn show(&mut self, ctx: &egui::Context, shown: &Shown<'_>) -> f32 {
        let screen = ctx.content_rect();
        let painter = ctx.layer_painter(egui::LayerId::new(egui::Order::Foreground, egui::Id::unique("hud")));
        let top = self.banners.show_top(&painter, screen, &shown.conditions);
        if self.figures && !shown.covered {
            let line = shown.line;
            let lines = match shown.picture {
                Some((picture, index)) => self.lines(picture, index, line, shown.speed_m_per_s),
                None => vec![format!("network    {:.1} Mbit/s, {:.1} MB", line.mbit_per_s, line.bytes as f64 * 1e-6)],
            };
            let area = block(&painter, pos2(screen.left() + 10.0, top), &lines.join("\n"));
            if shown.picture.is_some() {
                self.graph(&painter, Rect::from_min_size(area.left_bottom() + vec2(0.0, 6.0), vec2(240.0, 50.0)));
            }
        }
        let bottom = self.help.show_line(&painter, screen, screen.bottom() - 8.0 - shown.taken);
        self.banners.show_message_above(&painter, screen, bottom);
        top
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
}
