//! The map (M): the floor plan of a storey with the names of its rooms, the walker and the way
//! here, other walkers, north and a scale.
//!
//! The plans come with the dataset. -Z is up on the map, +X to the right: yaw 0 points up. The
//! wheel zooms, dragging moves, Page Up and Page Down change the storey. The pointer shows where a
//! click would go, and which way one would look there.

use super::{
    map_plan::{self, PlanPicture},
    map_view::{self, MapProjection},
    render_mailbox::Picture,
    server_connection::Scene,
    text_block::{self, SHADE, TEXT},
    walker,
};
use egui::{Align2, Color32, CornerRadius, FontId, Painter, Pos2, Rect, Shape, Stroke, pos2, vec2};
use glam::DVec3;
use ldi_protocol::{Pose, floor_plan::FloorPlan, index::Index, volume::WalkVolume, wire::Other};
use std::sync::Arc;

/// Largest difference in eye height between walkers of one storey, metres.
const STOREY_M: f64 = 1.5;
/// Largest number of characters of another walker's or a room's name.
const LONGEST_NAME: usize = 32;
/// Distance of the points of the track, metres.
const TRACK_STEP_M: f64 = 0.3;
/// Most points of the track; beyond them every other one is dropped.
const MOST_TRACK: usize = 4096;
/// Points of the pointer's wheel per doubling of the scale.
const WHEEL_DOUBLES: f64 = 220.0;
/// Longest scale bar, points.
const SCALE_POINTS: f64 = 140.0;

const PAPER: Color32 = Color32::from_rgb(196, 202, 207);
const FLOOR: Color32 = Color32::from_rgb(250, 248, 242);
const OWN: Color32 = Color32::from_rgb(213, 40, 40);
const OTHERS: Color32 = Color32::from_rgb(0, 138, 100);
const THERE: Color32 = Color32::from_rgb(20, 90, 200);
const NAMES: Color32 = Color32::from_rgb(70, 78, 92);

/// The map's state.
#[derive(Default)]
pub struct Map {
    /// Whether it is shown.
    pub open: bool,
    /// The chosen storey; None for the walker's.
    chosen: Option<usize>,
    /// The storey shown last.
    shown: usize,
    /// Number of storeys.
    storeys: usize,
    /// The index of the picture, and the picture of its plan.
    picture: Option<(Arc<Index>, PlanPicture)>,
    /// The projection used last.
    pub sheet: Option<MapProjection>,
    /// Places where the walker was.
    track: Vec<DVec3>,
}

/// What the map shows of a dataset.
struct Ground<'a> {
    index: &'a Arc<Index>,
    volume: &'a WalkVolume,
    /// None for flying, and until the plans have arrived.
    plan: Option<&'a FloorPlan>,
    eye_height_m: f64,
}

impl Map {
    /// Opens or closes the map.
    pub fn toggle(&mut self) {
        self.open = !self.open;
        self.chosen = None;
        self.sheet = None;
    }

    /// Chooses the next storey up or down.
    pub fn change_storey(&mut self, up: bool) {
        let next = if up { Some(self.shown + 1) } else { self.shown.checked_sub(1) };
        self.chosen = next.filter(|n| *n < self.storeys).or(self.chosen);
    }

    /// Notes a place where the walker is.
    pub fn track(&mut self, p: DVec3) {
        if self.track.last().is_some_and(|last| last.distance(p) < TRACK_STEP_M) {
            return;
        }
        if self.track.len() >= MOST_TRACK {
            let mut odd = false;
            self.track.retain(|_| {
                odd = !odd;
                odd
            });
        }
        self.track.push(p);
    }

    /// Draws the map. `others`: None if the server does not send them. Returns the pose at the
    /// place of a click.
    pub fn show(
        &mut self,
        ctx: &egui::Context,
        scene: &Scene,
        picture: &Picture,
        others: Option<&[Other]>,
    ) -> Option<Pose> {
        let pose = &picture.pose;
        let painter = ctx.layer_painter(egui::LayerId::new(egui::Order::Middle, egui::Id::unique("map")));
        let screen = ctx.content_rect();
        painter.rect_filled(screen, CornerRadius::ZERO, PAPER);
        let index = &scene.index;
        let Some(volume) = index.volume.as_ref().filter(|v| !v.is_empty()) else {
            let text = "this dataset has no walk volume to show";
            text_block::line(&painter, (screen.center(), Align2::CENTER_CENTER), text, Color32::WHITE, 16.0, 600.0);
            return None;
        };
        let eye_height_m = index.settings.eye_height_m.unwrap_or(0.0);
        let storey = map_plan::storey_of(&index.plans, pose.position.y, eye_height_m);
        self.storeys = index.plans.len();
        self.shown = self.chosen.filter(|n| *n < self.storeys).unwrap_or(storey);
        let ground = Ground { index, volume, plan: index.plans.get(self.shown), eye_height_m };
        let sheet = self.project(ctx, &ground, screen);
        self.draw_plan(ctx, &painter, &ground, &sheet);
        let level_m = ground.plan.filter(|p| !p.relief).map(|p| p.floor_m + eye_height_m);
        draw_track(&painter, &sheet, &self.track, level_m);
        others.unwrap_or_default().iter().for_each(|o| draw_other_walker(&painter, &sheet, o, level_m));
        draw_walker(&painter, &sheet, pose, picture.fov_deg);
        draw_north(&painter, sheet.area);
        draw_scale(&painter, &sheet);
        self.draw_help(&painter, screen, ground.plan, others);
        let (pointer, clicked) = ctx.input(|i| (i.pointer.hover_pos(), i.pointer.primary_clicked()));
        let at = pointer.filter(|at| sheet.area.contains(*at))?;
        let there = ground.pose_at(sheet.world(at), sheet.per_metre, pose);
        match &there {
            Some(there) => draw_there(&painter, &sheet, there),
            None => {
                let place = (at + vec2(14.0, 18.0), Align2::LEFT_TOP);
                text_block::line(&painter, place, "nobody can stand here", TEXT, 13.0, 300.0);
            }
        }
        there.filter(|_| clicked)
    }

    /// The projection after the pointer's drag and wheel.
    fn project(&mut self, ctx: &egui::Context, ground: &Ground<'_>, screen: Rect) -> MapProjection {
        let area = map_view::area_in(screen);
        let b = ground.volume.bounds();
        let all = ground.plan.map_or([b.min.x, b.min.z, b.max.x, b.max.z], FloorPlan::content);
        let fit = MapProjection::fit(all, area);
        let mut sheet = self.sheet.map_or(fit, |s| s.moved_to(area));
        let (drag, wheel, pinch, at) = ctx.input(|i| {
            let dragged = i.pointer.primary_down() && i.pointer.is_decidedly_dragging();
            let drag = if dragged { i.pointer.delta() } else { egui::Vec2::ZERO };
            (drag, i.smooth_scroll_delta().y, i.zoom_delta(), i.pointer.hover_pos())
        });
        sheet.drag(drag);
        let factor = f64::from(pinch) * (f64::from(wheel) / WHEEL_DOUBLES).exp2();
        if let Some(at) = at.filter(|_| factor != 1.0) {
            sheet.zoom(factor, at, &fit);
        }
        *self.sheet.insert(sheet)
    }

    /// Draws the plan and the names of its rooms; without one, the walk volume's box.
    fn draw_plan(&mut self, ctx: &egui::Context, painter: &Painter, ground: &Ground<'_>, sheet: &MapProjection) {
        let Some(plan) = ground.plan else {
            let b = ground.volume.bounds();
            let area = sheet.show_area([b.min.x, b.min.z, b.max.x, b.max.z]);
            painter.rect_filled(area, CornerRadius::ZERO, FLOOR);
            return;
        };
        let shown = self.shown;
        let fits = |(index, picture): &(Arc<Index>, PlanPicture)| {
            Arc::ptr_eq(index, ground.index) && picture.plan == shown && picture.is_for(plan, sheet.per_metre)
        };
        let kept = self.picture.take().filter(fits);
        let made = || (ground.index.clone(), PlanPicture::of(ctx, (shown, plan), sheet.per_metre));
        let (_, picture) = self.picture.insert(kept.unwrap_or_else(made));
        let painter = painter.with_clip_rect(sheet.area);
        picture.draw(&painter, sheet);
        for (name, area) in map_plan::room_names(ground.index, plan) {
            let area = sheet.show_area(area);
            let name: String = name.chars().filter(|c| !c.is_control()).take(LONGEST_NAME).collect();
            let text = painter.layout_no_wrap(name, FontId::proportional(12.0), NAMES);
            if text.size().x <= area.width() + 6.0 && text.size().y <= area.height() + 4.0 {
                painter.galley(area.center() - text.size() * 0.5, text, NAMES);
            }
        }
    }

    /// Draws the line of help, and the storey.
    fn draw_help(&self, painter: &Painter, screen: Rect, plan: Option<&FloorPlan>, others: Option<&[Other]>) {
        let storey = match plan {
            Some(p) if p.relief => format!("open ground, a contour line every {} m", p.contour_m()),
            Some(_) if self.storeys > 1 => format!("storey {} of {}: Page Up, Page Down", self.shown + 1, self.storeys),
            Some(_) => "one storey".into(),
            None => "no floor plan".into(),
        };
        let others = match others.map_or(0, <[Other]>::len) {
            0 => String::new(),
            1 => "  |  green: another walker".into(),
            n => format!("  |  green: {n} other walkers"),
        };
        let text = format!("click: go there  |  wheel: zoom  |  drag: move  |  {storey}{others}  |  M or Esc: close");
        let at = (pos2(screen.center().x, screen.bottom() - 8.0), Align2::CENTER_BOTTOM);
        text_block::line(painter, at, &text, TEXT, 13.0, screen.width() * 0.9 - 20.0);
    }
}

impl Ground<'_> {
    /// Where one would stand and look after a click.
    fn pose_at(&self, [x, z]: [f64; 2], per_metre: f64, pose: &Pose) -> Option<Pose> {
        match self.plan {
            Some(plan) => map_plan::standing_pose(plan, self.volume, self.eye_height_m, [x, z], per_metre),
            None => {
                let position = walker::nearest(self.volume, DVec3::new(x, pose.position.y, z))?;
                Some(Pose { position, ..*pose })
            }
        }
    }
}

/// Draws the way that the walker came; on other storeys dim.
fn draw_track(painter: &Painter, sheet: &MapProjection, track: &[DVec3], level_m: Option<f64>) {
    let painter = painter.with_clip_rect(sheet.area);
    for pair in track.windows(2) {
        // A jump is no way.
        if pair[0].distance(pair[1]) > 10.0 * TRACK_STEP_M {
            continue;
        }
        let strength = if is_on(pair[1].y, level_m) { 0.75 } else { 0.2 };
        let points = [sheet.show(pair[0]), sheet.show(pair[1])];
        painter.line_segment(points, Stroke::new(2.0, OWN.gamma_multiply(strength)));
    }
}

/// Whether an eye is on the storey with eyes at `level_m`; None: there are no storeys.
fn is_on(eye_y: f64, level_m: Option<f64>) -> bool {
    level_m.is_none_or(|level| (eye_y - level).abs() <= STOREY_M)
}

/// Draws the walker: field of view, and an arrow.
fn draw_walker(painter: &Painter, sheet: &MapProjection, pose: &Pose, fov_deg: f64) {
    let at = sheet.show(pose.position);
    if !sheet.area.contains(at) {
        return;
    }
    draw_view(painter, at, pose.yaw_deg, fov_deg, OWN);
    painter.add(arrow(at, pose.yaw_deg, 1.0, OWN));
}

/// Draws where one would stand after a click.
fn draw_there(painter: &Painter, sheet: &MapProjection, there: &Pose) {
    let at = sheet.show(there.position);
    draw_view(painter, at, there.yaw_deg, 50.0, THERE);
    painter.circle(at, 5.0, THERE, Stroke::new(1.5, Color32::WHITE));
}

/// Draws a field of view.
fn draw_view(painter: &Painter, at: Pos2, yaw_deg: f64, fov_deg: f64, colour: Color32) {
    let view = vec![at, toward(at, yaw_deg + fov_deg / 2.0, 46.0), toward(at, yaw_deg - fov_deg / 2.0, 46.0)];
    painter.add(Shape::convex_polygon(view, colour.gamma_multiply(0.3), Stroke::NONE));
}

/// Draws another walker: a smaller arrow with number and name, dim on another storey.
fn draw_other_walker(painter: &Painter, sheet: &MapProjection, o: &Other, level_m: Option<f64>) {
    let p = DVec3::from_array(o.position);
    let at = sheet.show(p);
    if !sheet.area.contains(at) {
        return;
    }
    let dim = if is_on(p.y, level_m) { 1.0 } else { 0.4 };
    painter.add(arrow(at, f64::from(o.yaw_deg), 0.75, OTHERS.gamma_multiply(dim)));
    let name: String = o.name.chars().filter(|c| !c.is_control()).take(LONGEST_NAME).collect();
    let colour = Color32::WHITE.gamma_multiply(dim);
    let text = painter.layout_no_wrap(format!("{} {name}", o.walker), FontId::proportional(12.0), colour);
    let room = Align2::LEFT_CENTER.anchor_size(at + vec2(12.0, 0.0), text.size() + vec2(8.0, 2.0));
    painter.rect_filled(room, CornerRadius::same(3), SHADE.gamma_multiply(dim));
    painter.galley(room.min + vec2(4.0, 1.0), text, colour);
}

/// Draws the north arrow: yaw 0 points up.
fn draw_north(painter: &Painter, area: Rect) {
    let at = area.right_top() + vec2(-22.0, 34.0);
    painter.circle_filled(at, 20.0, SHADE);
    let needle = vec![at + vec2(0.0, -9.0), at + vec2(6.0, 12.0), at + vec2(0.0, 8.0), at + vec2(-6.0, 12.0)];
    painter.add(Shape::Path(egui::epaint::PathShape::convex_polygon(needle, TEXT, Stroke::NONE)));
    painter.text(at + vec2(0.0, -14.0), Align2::CENTER_CENTER, "N", FontId::proportional(11.0), TEXT);
}

/// Draws the scale bar.
fn draw_scale(painter: &Painter, sheet: &MapProjection) {
    let metres = sheet.scale_m(SCALE_POINTS);
    let length = (metres * sheet.per_metre) as f32;
    let left = sheet.area.left_bottom() + vec2(14.0, -14.0);
    painter.rect_filled(Rect::from_min_size(left + vec2(-8.0, -24.0), vec2(length + 16.0, 32.0)), 4, SHADE);
    let stroke = Stroke::new(1.5, TEXT);
    let right = left + vec2(length, 0.0);
    for [a, b] in [[left, right], [left, left - vec2(0.0, 6.0)], [right, right - vec2(0.0, 6.0)]] {
        painter.line_segment([a, b], stroke);
    }
    let text = if metres >= 1.0 { format!("{metres} m") } else { format!("{:.0} cm", metres * 100.0) };
    let middle = left + vec2(length * 0.5, -12.0);
    painter.text(middle, Align2::CENTER_CENTER, text, FontId::proportional(12.0), TEXT);
}

/// The position at a distance from `at` in a yaw's direction.
fn toward(at: Pos2, yaw_deg: f64, distance: f32) -> Pos2 {
    let (sin, cos) = yaw_deg.to_radians().sin_cos();
    at + vec2(-sin as f32, -cos as f32) * distance
}

/// An arrow in a yaw's direction.
fn arrow(at: Pos2, yaw_deg: f64, size: f32, colour: Color32) -> Shape {
    let corners = [(0.0, 16.0), (140.0, 10.0), (-140.0, 10.0)];
    let corners = corners.map(|(deg, distance)| toward(at, yaw_deg + deg, distance * size)).to_vec();
    Shape::convex_polygon(corners, colour, Stroke::new(1.0, Color32::WHITE))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_track_keeps_its_ends_and_its_size() {
        let mut map = Map::default();
        for n in 0..20_000 {
            map.track(DVec3::new(f64::from(n) * 0.1, 1.6, 0.0));
        }
        assert!(map.track.len() <= MOST_TRACK && map.track.len() > MOST_TRACK / 4, "{}", map.track.len());
        assert_eq!(map.track[0], DVec3::new(0.0, 1.6, 0.0));
        assert!(map.track.last().is_some_and(|p| p.x > 1999.0));
    }

    #[test]
    fn storeys_change_within_those_there_are() {
        let mut map = Map { storeys: 3, shown: 1, ..Map::default() };
        map.change_storey(true);
        assert_eq!(map.chosen, Some(2));
        (map.shown, map.storeys) = (2, 3);
        map.change_storey(true);
        assert_eq!(map.chosen, Some(2));
        map.shown = 0;
        map.change_storey(false);
        assert_eq!(map.chosen, Some(2), "below the lowest there is none");
    }
}
