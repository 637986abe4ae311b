//! Text on a dark background, as all of the interface over a picture is written.

use egui::{Align2, Color32, CornerRadius, FontId, Pos2, Rect, vec2};

/// Background of text.
pub const SHADE: Color32 = Color32::from_black_alpha(170);
/// Colour of text.
pub const TEXT: Color32 = Color32::from_gray(235);

/// Draws lines of fixed-width text on a background. Returns the area.
pub fn block(painter: &egui::Painter, at: Pos2, text: &str) -> Rect {
    let galley = painter.layout_no_wrap(text.to_owned(), FontId::monospace(12.5), TEXT);
    let area = Rect::from_min_size(at, galley.size() + vec2(16.0, 12.0));
    painter.rect_filled(area, CornerRadius::same(4), SHADE);
    painter.galley(at + vec2(8.0, 6.0), galley, TEXT);
    area
}

/// Draws wrapped text on a background, with this point of its area at `at`. Returns the area.
pub fn line(
    painter: &egui::Painter,
    (at, point): (Pos2, Align2),
    text: &str,
    colour: Color32,
    size: f32,
    width: f32,
) -> Rect {
    let galley = painter.layout(text.to_owned(), FontId::proportional(size), colour, width);
    let area = point.anchor_size(at, galley.size() + vec2(20.0, 10.0));
    painter.rect_filled(area, CornerRadius::same(5), SHADE);
    painter.galley(area.min + vec2(10.0, 5.0), galley, colour);
    area
}
