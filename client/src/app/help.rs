//! Help: one line that fades, and a panel of all keys (H).

use super::text_block::{SHADE, TEXT};
use egui::{Align2, Color32, CornerRadius, FontId, Rect, pos2, vec2};
use std::time::{Duration, Instant};

/// The line: short enough for a narrow window.
pub const LINE: &str = "click: look around  |  W A S D: walk  |  M: map  |  H: all keys";
/// Time for which the line is shown. Longer: it stands over the picture; shorter: it is not read.
const SHOWN: Duration = Duration::from_secs(12);
/// Time in which it fades.
const FADE: Duration = Duration::from_secs(2);

/// Keys and what they do, in the order of the panel: two columns of one half each.
pub const KEYS: [(&str, &str); 25] = [
    ("click", "look around with the mouse"),
    ("Esc", "free the pointer, close panels"),
    ("W A S D", "walk"),
    ("arrows", "walk and turn"),
    ("Shift", "run"),
    ("wheel", "walk faster or slower"),
    ("Q, E", "down and up, where you fly"),
    ("G", "ignore walls, or respect them"),
    ("M", "map: a click goes there"),
    ("1 to 9", "go to a kept place"),
    ("Ctrl+1 to 9", "keep this place"),
    ("0", "go to where the last visit ended"),
    ("R", "record the walk, and save it"),
    ("P", "walk it again"),
    ("F12", "save a picture"),
    ("Ctrl+C", "copy a link to this view"),
    ("H or ?", "these keys"),
    ("F1", "figures"),
    ("F2", "views for developers (F3)"),
    ("F3", "settings"),
    ("F5", "show a newer build of the scene"),
    ("F11", "full screen"),
    ("Ctrl+Q", "leave"),
    ("gamepad", "sticks walk and look, A runs"),
    ("", "Y opens the map, X saves a picture"),
];

/// The help of a window.
#[derive(Debug, Default)]
pub struct Help {
    /// Whether the panel is shown.
    pub open: bool,
    /// The time since which the line is shown.
    line_since: Option<Instant>,
}

impl Help {
    /// Draws the line above `bottom`, until it has faded. Returns the line's top.
    pub fn show_line(&mut self, painter: &egui::Painter, screen: Rect, bottom: f32) -> f32 {
        let strength = strength(self.line_since.get_or_insert_with(Instant::now).elapsed());
        if strength <= 0.0 {
            return bottom;
        }
        let font = FontId::proportional(13.0);
        let text = painter.layout_no_wrap(LINE.to_owned(), font, TEXT.gamma_multiply(strength));
        let at = pos2(screen.center().x, bottom);
        let area = Align2::CENTER_BOTTOM.anchor_size(at, text.size() + vec2(20.0, 8.0));
        painter.rect_filled(area, CornerRadius::same(5), SHADE.gamma_multiply(strength));
        painter.galley(area.min + vec2(10.0, 4.0), text, TEXT);
        area.top() - 6.0
    }

    /// Draws the panel.
    pub fn show_panel(ctx: &egui::Context) {
        let painter = ctx.layer_painter(egui::LayerId::new(egui::Order::Foreground, egui::Id::unique("keys")));
        let screen = ctx.content_rect();
        let rows = KEYS.len().div_ceil(2);
        let size = vec2(740.0, 60.0 + 22.0 * rows as f32);
        // In a window that is too small everything gets smaller.
        let scale = (screen.width() / (size.x + 20.0)).min(screen.height() / (size.y + 20.0)).min(1.0);
        let card = Rect::from_center_size(screen.center(), size * scale);
        painter.rect_filled(card, CornerRadius::same(8), Color32::from_rgba_unmultiplied_const(20, 24, 30, 240));
        let write = |x: f32, y: f32, px: f32, colour: Color32, text: &str| {
            let font = FontId::proportional(px * scale);
            painter.text(card.min + vec2(x, y) * scale, Align2::LEFT_TOP, text, font, colour);
        };
        write(24.0, 16.0, 18.0, Color32::WHITE, "Keys");
        for (i, (key, action)) in KEYS.iter().enumerate() {
            let (x, y) = (24.0 + 360.0 * (i / rows) as f32, 50.0 + 22.0 * (i % rows) as f32);
            write(x, y, 14.0, Color32::from_rgb(150, 200, 240), key);
            write(x + 104.0, y, 14.0, TEXT, action);
        }
    }
}

/// Opacity of the line, 0 to 1.
fn strength(shown: Duration) -> f32 {
    let left = (SHOWN + FADE).saturating_sub(shown).as_secs_f32();
    (left / FADE.as_secs_f32()).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_fades() {
        let at = |ms| strength(Duration::from_millis(ms));
        assert_eq!([at(0), at(12_000), at(14_000), at(60_000)], [1.0, 1.0, 0.0, 0.0]);
        assert!((at(13_000) - 0.5).abs() < 1e-6);
    }
}
