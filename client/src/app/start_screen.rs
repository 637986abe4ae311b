//! The start screen: progress of connecting, until the first picture.

use super::{
    banners, help,
    render_mailbox::Picture,
    server_connection::{ConnectionState, ServerConnection},
    text_block,
};
use crate::stream::{ConnectError, Phase};
use egui::{Align2, Color32, CornerRadius, FontId, Rect, pos2, vec2};
use ldi_protocol::said::escaped;

/// Size of the panel, points.
const CARD: egui::Vec2 = vec2(560.0, 230.0);
const CARD_FILL: Color32 = Color32::from_rgba_unmultiplied_const(24, 28, 34, 235);
const BAR: Color32 = Color32::from_rgb(90, 160, 220);

/// Draws the panel. `server`: the address given by the user.
pub fn show(ctx: &egui::Context, server: &str, connection: &ServerConnection, picture: Option<&Picture>) {
    let painter = ctx.layer_painter(egui::LayerId::new(egui::Order::Middle, egui::Id::unique("start")));
    let screen = ctx.content_rect();
    painter.rect_filled(screen, CornerRadius::ZERO, Color32::from_black_alpha(120));
    let card = Rect::from_center_size(screen.center(), CARD.min(screen.size() - vec2(20.0, 20.0)));
    painter.rect_filled(card, CornerRadius::same(10), CARD_FILL);
    let line = |at: f32, size: f32, colour: Color32, text: &str| {
        painter.text(
            pos2(card.left() + 28.0, card.top() + at),
            Align2::LEFT_TOP,
            text,
            FontId::proportional(size),
            colour,
        );
    };
    let scene = connection.scene();
    let title = scene.as_ref().map_or(server.to_owned(), |s| escaped(&s.index.scene.name).into_owned());
    line(22.0, 24.0, Color32::WHITE, &title);
    let about = scene.as_ref().map_or_else(String::new, |s| {
        format!(
            "{:.2} million triangles, at most {} of them drawn per picture; from {server}",
            s.index.scene.triangles as f64 * 1e-6,
            s.index.settings.budget
        )
    });
    line(56.0, 13.0, Color32::GRAY, &about);
    let (text, share) = step(connection, picture);
    line(104.0, 16.0, Color32::WHITE, &text);
    let bar = Rect::from_min_size(pos2(card.left() + 28.0, card.top() + 134.0), vec2(card.width() - 56.0, 10.0));
    painter.rect_filled(bar, CornerRadius::same(5), Color32::from_gray(60));
    if let Some(share) = share {
        let done = Rect::from_min_size(bar.min, vec2(bar.width() * share.clamp(0.0, 1.0), bar.height()));
        painter.rect_filled(done, CornerRadius::same(5), BAR);
    }
    let stats = connection.summary();
    if stats.bytes > 0 {
        let carried = format!("{:.1} MB received, {:.1} Mbit/s", stats.bytes as f64 * 1e-6, stats.mbit_per_s);
        line(152.0, 13.0, Color32::GRAY, &carried);
    }
    if let Some(text) = banners::trouble(&connection.state()) {
        let at = (card.center_bottom() + vec2(0.0, 10.0), Align2::CENTER_TOP);
        text_block::line(&painter, at, &text, Color32::from_rgb(255, 180, 90), 15.0, card.width());
    }
    let help =
        painter.layout(help::LINE.to_owned(), FontId::proportional(13.0), Color32::from_gray(190), card.width() - 56.0);
    painter.galley(pos2(card.left() + 28.0, card.top() + 186.0), help, Color32::GRAY);
}

/// Who refuses whom.
fn refusal(e: &ConnectError) -> &'static str {
    match e {
        ConnectError::Fingerprint { .. } | ConnectError::UnknownServer { .. } => {
            "this client does not trust the server's certificate"
        }
        ConnectError::Refused { .. } | ConnectError::Busy => "the server does not let this client in",
        _ => "nothing can be walked in here",
    }
}

/// The current step, and its progress from 0 to 1.
fn step(connection: &ServerConnection, picture: Option<&Picture>) -> (String, Option<f32>) {
    let share = |done: u64, all: u64| (all > 0).then(|| done as f32 / all as f32);
    let first_view = |p: &Picture| {
        let f = &p.stats;
        let here = f.needed_bytes.saturating_sub(f.missing_bytes);
        (
            format!("the first view: {:.2} of {:.2} MB", here as f64 * 1e-6, f.needed_bytes as f64 * 1e-6),
            share(here, f.needed_bytes),
        )
    };
    let index = || {
        let (done, all) = connection.progress().1;
        let text = format!("the dataset's index: {:.2} of {:.2} MB", done as f64 * 1e-6, all as f64 * 1e-6);
        (text, share(done, all))
    };
    match connection.state() {
        ConnectionState::Up if picture.is_some_and(|p| !p.stats.frame_stats.whole) => index(),
        ConnectionState::Up => picture.map_or(("drawing the first view".into(), None), first_view),
        ConnectionState::Waiting { .. } => ("no connection".into(), None),
        ConnectionState::Refused(e) => (refusal(&e).into(), None),
        ConnectionState::Connecting { .. } => match connection.progress().0 {
            Phase::Idle | Phase::Dialling => ("looking for the server".into(), None),
            Phase::Asking => ("asking to be let in".into(), None),
            Phase::Index => index(),
            Phase::Assembling => ("putting the index together".into(), Some(1.0)),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ldi_protocol::wire::RefusalCode;

    #[test]
    fn it_is_said_who_refuses() {
        let wrong = ConnectError::Fingerprint { expected: "ab".into(), found: "cd".into() };
        assert!(refusal(&wrong).starts_with("this client"));
        let token = ConnectError::Refused { code: RefusalCode::Token, message: String::new() };
        assert!(refusal(&token).starts_with("the server"));
    }
}
