//! The panel of the user settings (F3).

use super::settings::{FOV_DEG, FRAME_MS, LOOK, RAISE_M, SPEED_M_PER_S, Shading, UserSettings};
use egui::{Align2, Context, Slider, Ui, Window, vec2};

/// Height kept free below the panel for messages, points.
const FREE_BELOW: f32 = 110.0;

/// Draws the panel below `top`, until it is closed. Returns whether a setting was changed.
/// `widest_deg`: the dataset's field of view, if it is known.
pub fn show(ctx: &Context, top: f32, open: &mut bool, settings: &mut UserSettings, widest_deg: Option<f64>) -> bool {
    let before = settings.clone();
    let window = Window::new("Settings").open(open).resizable(false).default_width(320.0);
    let window = window.anchor(Align2::RIGHT_TOP, vec2(-10.0, top)).vscroll(true);
    window.max_height((ctx.content_rect().height() - top - FREE_BELOW).max(80.0)).show(ctx, |ui| {
        ui.strong("Eye");
        eye(ui, settings, widest_deg);
        ui.separator();
        ui.strong("Picture");
        picture(ui, settings);
        ui.separator();
        ui.strong("Pointer and window");
        let look = Slider::new(&mut settings.look, LOOK).logarithmic(true);
        ui.add(look.text("speed of the mouse"));
        ui.checkbox(&mut settings.inverted, "mouse forward looks down");
        ui.checkbox(&mut settings.full_screen, "full screen (F11)");
        ui.checkbox(&mut settings.developer, "views for developers (F2)");
    });
    *settings != before
}

fn eye(ui: &mut Ui, settings: &mut UserSettings, widest_deg: Option<f64>) {
    let widest = widest_deg.unwrap_or(*FOV_DEG.end()).clamp(*FOV_DEG.start() + 1.0, *FOV_DEG.end());
    let mut fov_deg = settings.fov_deg.min(widest);
    let slider = Slider::new(&mut fov_deg, *FOV_DEG.start()..=widest).suffix("\u{b0}").fixed_decimals(0);
    let field = ui.add(slider.text("field of view"));
    field.clone().on_hover_text("at most that of the dataset; less is a longer lens, and coarser");
    if field.changed() {
        // The widest of this dataset means the widest of every dataset.
        settings.fov_deg = if fov_deg >= widest - 0.5 { *FOV_DEG.end() } else { fov_deg };
    }
    ui.add(Slider::new(&mut settings.raise_m, RAISE_M).suffix(" m").fixed_decimals(2).text("eye higher or lower"));
    let speed = Slider::new(&mut settings.speed_m_per_s, SPEED_M_PER_S).logarithmic(true).suffix(" m/s");
    ui.add(speed.fixed_decimals(1).text("walking speed"));
}

fn picture(ui: &mut Ui, settings: &mut UserSettings) {
    let ms = Slider::new(&mut settings.frame_ms, FRAME_MS).logarithmic(true).suffix(" ms").fixed_decimals(1);
    ui.add(ms.text("for a picture while moving")).on_hover_text("less is smoother, more is sharper");
    ui.checkbox(&mut settings.fine, "four samples per pixel at rest");
    ui.horizontal(|ui| {
        ui.label("shadows and outlines");
        for (choice, name) in [(Shading::Auto, "auto"), (Shading::On, "on"), (Shading::Off, "off")] {
            ui.selectable_value(&mut settings.shading, choice, name);
        }
    })
    .response
    .on_hover_text("auto: where the scene has few textures");
    ui.checkbox(&mut settings.horizon, "sky with a horizon");
}
