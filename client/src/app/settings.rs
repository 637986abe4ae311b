//! User settings (F3).

use egui::{Align2, Context, Slider, Window, vec2};

/// Range of the frame time, milliseconds.
const FRAME_MS: std::ops::RangeInclusive<f64> = 5.0..=200.0;
/// Range of the mouse speed, relative to the default.
const LOOK: std::ops::RangeInclusive<f64> = 0.2..=5.0;

/// The settings, and whether their panel is open.
#[derive(Debug, Clone, PartialEq)]
pub struct UserSettings {
    /// Whether the panel is shown.
    pub open: bool,
    /// Intended frame time while moving, milliseconds.
    pub frame_ms: f64,
    /// Whether resting pictures get four samples per pixel.
    pub fine: bool,
    /// Mouse speed, relative to the default.
    pub look: f64,
    /// Whether the vertical axis of the mouse is inverted.
    pub inverted: bool,
}

impl UserSettings {
    /// The defaults, with the command line's frame time.
    pub fn new(frame_ms: f64) -> Self {
        Self { open: false, frame_ms, fine: true, look: 1.0, inverted: false }
    }

    /// Draws the panel. Returns whether a setting was changed.
    pub fn show(&mut self, ctx: &Context) -> bool {
        let before = self.clone();
        let mut open = self.open;
        let corner = vec2(-10.0, 10.0);
        let window = Window::new("Settings").open(&mut open).resizable(false).default_width(320.0);
        // The statistics occupy the other corner.
        window.anchor(Align2::RIGHT_TOP, corner).show(ctx, |ui| {
            let ms = Slider::new(&mut self.frame_ms, FRAME_MS).logarithmic(true).suffix(" ms");
            ui.add(ms.text("for a picture while moving")).on_hover_text("less is smoother, more is sharper");
            ui.checkbox(&mut self.fine, "four samples per pixel at rest");
            ui.add(Slider::new(&mut self.look, LOOK).logarithmic(true).text("speed of the mouse"));
            ui.checkbox(&mut self.inverted, "mouse forward looks down");
        });
        self.open = open;
        *self != before
    }

    /// Turn in degrees for a mouse movement in counts: left and up are positive.
    pub fn turn_deg(&self, (dx, dy): (f64, f64), deg_per_count: f64) -> (f64, f64) {
        let k = self.look * deg_per_count;
        (-dx * k, if self.inverted { dy * k } else { -dy * k })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mouse_turns_as_chosen() {
        let mut s = UserSettings::new(20.0);
        assert_eq!(s.turn_deg((10.0, 5.0), 0.1), (-1.0, -0.5));
        (s.look, s.inverted) = (2.0, true);
        assert_eq!(s.turn_deg((10.0, 5.0), 0.1), (-2.0, 1.0));
    }
}
