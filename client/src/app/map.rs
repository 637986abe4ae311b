//! The map (M): floor plan, the walker, other walkers, grid points. A click moves the eye.
//!
//! The plan ([`floor_plan`]) is drawn on its own thread, and again when more of the scene has
//! arrived. -Z is up on the map, +X to the right: yaw 0 points up. One storey is bright, the others
//! dim; Page Up and Page Down change the storey.

use super::{
    floor_plan::{self, STOREY_M},
    render_mailbox::Picture,
    server_connection::Scene,
    text_block::{self, SHADE, TEXT},
    walker,
};
use egui::{
    Align2, Color32, ColorImage, CornerRadius, Pos2, Rect, Shape, Stroke, TextureHandle, TextureOptions, pos2, vec2,
};
use glam::DVec3;
use ldi_protocol::{Pose, index::Index, select::Selection, volume::WalkVolume, wire::Other};
use std::{
    collections::BTreeMap,
    sync::mpsc,
    time::{Duration, Instant},
};

/// Levels below this share of the largest level's area are landings, not storeys.
const SMALLEST_STOREY: f64 = 0.04;
/// Interval at which the plan is drawn again while data arrives.
const AGAIN_AFTER: Duration = Duration::from_secs(2);
/// Largest number of characters of another walker's name.
const LONGEST_NAME: usize = 24;
/// Largest number of grid points drawn.
const MOST_POINTS: usize = 20_000;

/// The projection from the world to the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapProjection {
    /// Area of the map on the display, points.
    pub area: Rect,
    /// World x and z of its upper left corner, metres.
    pub corner: [f64; 2],
    /// Points per metre.
    pub per_metre: f64,
}

impl MapProjection {
    /// The largest projection that fits into `room`.
    fn fit(volume: &WalkVolume, room: Rect) -> Self {
        let (b, size) = (volume.bounds(), volume.bounds().size().max(DVec3::splat(0.1)));
        let per_metre = (f64::from(room.width()) / size.x).min(f64::from(room.height()) / size.z);
        let area =
            Rect::from_center_size(room.center(), vec2((size.x * per_metre) as f32, (size.z * per_metre) as f32));
        Self { area, corner: [b.min.x, b.min.z], per_metre }
    }

    /// Position of a place on the display.
    pub fn show(&self, p: DVec3) -> Pos2 {
        let at = |v: f64, corner: f64| ((v - corner) * self.per_metre) as f32;
        self.area.min + vec2(at(p.x, self.corner[0]), at(p.z, self.corner[1]))
    }

    /// World x and z of a position on the display.
    pub fn world(&self, at: Pos2) -> [f64; 2] {
        let d = at - self.area.min;
        [self.corner[0] + f64::from(d.x) / self.per_metre, self.corner[1] + f64::from(d.y) / self.per_metre]
    }
}

/// The map's state.
#[derive(Default)]
pub struct Map {
    /// Whether it is shown.
    pub open: bool,
    /// Eye height of the chosen storey; None for the walker's storey.
    chosen_m: Option<f64>,
    drawn_map: Option<DrawnMap>,
    /// The projection used last.
    pub sheet: Option<MapProjection>,
}

struct DrawnMap {
    scene: Scene,
    storeys_m: Vec<f64>,
    storey_m: f64,
    /// The plan requested last: storey, bytes in the cache, time.
    asked: Option<(f64, u64, Instant)>,
    /// Receives the plan.
    coming: Option<mpsc::Receiver<ColorImage>>,
    texture: Option<TextureHandle>,
}

impl Map {
    /// Opens or closes the map.
    pub fn toggle(&mut self) {
        self.open = !self.open;
        self.chosen_m = None;
        self.sheet = None;
    }

    /// Chooses the next storey up or down.
    pub fn change_storey(&mut self, up: bool) {
        let Some(d) = &self.drawn_map else { return };
        let mut next =
            d.storeys_m.iter().copied().filter(|s| if up { *s > d.storey_m + 0.1 } else { *s < d.storey_m - 0.1 });
        self.chosen_m = if up { next.next() } else { next.next_back() }.or(self.chosen_m);
    }

    /// Draws the map. `others`: None if the server does not send them. Returns the eye's new
    /// position after a click.
    pub fn show(
        &mut self,
        ctx: &egui::Context,
        scene: &Scene,
        picture: &Picture,
        others: Option<&[Other]>,
    ) -> Option<DVec3> {
        let (pose, selection) = (&picture.pose, &picture.stats.selection);
        let painter = ctx.layer_painter(egui::LayerId::new(egui::Order::Middle, egui::Id::unique("map")));
        let screen = ctx.content_rect();
        painter.rect_filled(screen, CornerRadius::ZERO, Color32::from_black_alpha(190));
        let Some(volume) = scene.index.volume.as_ref().filter(|v| !v.is_empty()) else {
            let text = "this dataset has no walk volume to show";
            text_block::line(&painter, (screen.center(), Align2::CENTER_CENTER), text, Color32::WHITE, 16.0, 600.0);
            return None;
        };
        let drawn_map = self.draw(ctx, scene, volume, pose);
        let sheet = MapProjection::fit(volume, screen.shrink2(vec2(40.0, 60.0)));
        let whole = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
        if let Some(texture) = &drawn_map.texture {
            painter.image(texture.id(), sheet.area, whole, Color32::WHITE);
        }
        draw_grid_points(&painter, &sheet, &scene.index, drawn_map.storey_m, selection);
        let storey_m = drawn_map.storey_m;
        others.unwrap_or_default().iter().for_each(|o| draw_other_walker(&painter, &sheet, o, storey_m));
        draw_walker(&painter, &sheet, pose, picture.fov_deg);
        let storeys = match drawn_map.storeys_m.len() {
            0 | 1 => String::new(),
            n => {
                let number = drawn_map.storeys_m.iter().filter(|s| **s <= drawn_map.storey_m + 0.1).count();
                format!("  |  storey {number} of {n}: Page Up, Page Down")
            }
        };
        let others = match others.map_or(0, <[Other]>::len) {
            0 => String::new(),
            1 => "  |  green: another walker".into(),
            n => format!("  |  green: {n} other walkers"),
        };
        let text =
            format!("click: go there  |  M or Esc: close{storeys}  |  dots: grid points, orange: in use{others}");
        let at = (pos2(screen.center().x, screen.bottom() - 8.0), Align2::CENTER_BOTTOM);
        text_block::line(&painter, at, &text, TEXT, 13.0, screen.width() * 0.9 - 20.0);
        self.sheet = Some(sheet);
        let clicked = ctx.input(|i| i.pointer.primary_clicked().then(|| i.pointer.interact_pos()).flatten())?;
        let [x, z] = sheet.area.contains(clicked).then(|| sheet.world(clicked))?;
        let level_m = if flying(scene) { pose.position.y } else { storey_m };
        Some(standing_place(volume, x, z, level_m, flying(scene)))
    }

    /// Updates the plan as far as it has been drawn.
    fn draw(&mut self, ctx: &egui::Context, scene: &Scene, volume: &WalkVolume, pose: &Pose) -> &DrawnMap {
        let mut drawn_map = self.drawn_map.take().filter(|d| d.scene.is(scene)).unwrap_or_else(|| DrawnMap {
            scene: scene.clone(),
            storeys_m: storeys(volume),
            storey_m: f64::NAN,
            asked: None,
            coming: None,
            texture: None,
        });
        let height = self.chosen_m.unwrap_or(pose.position.y);
        if flying(scene) {
            // Flying datasets have a storey at every height, rounded so that small movements do not
            // redraw the plan.
            drawn_map.storeys_m = vec![(height * 2.0).round() * 0.5];
        }
        let storeys = drawn_map.storeys_m.iter().copied();
        let storey_m = storeys.min_by(|a, b| (a - height).abs().total_cmp(&(b - height).abs())).unwrap_or(height);
        if drawn_map.storey_m != storey_m {
            (drawn_map.storey_m, drawn_map.texture, drawn_map.coming, drawn_map.asked) = (storey_m, None, None, None);
        }
        if let Some(picture) = drawn_map.coming.as_ref().and_then(|c| c.try_recv().ok()) {
            drawn_map.texture = Some(ctx.load_texture("plan", picture, TextureOptions::LINEAR));
            drawn_map.coming = None;
        }
        let bytes = scene.cache.usage().bytes;
        let stale = drawn_map.asked.is_none_or(|(_, b, at)| b != bytes && at.elapsed() > AGAIN_AFTER);
        if stale && drawn_map.coming.is_none() {
            drawn_map.asked = Some((storey_m, bytes, Instant::now()));
            drawn_map.coming = ask(scene, storey_m);
        }
        self.drawn_map.insert(drawn_map)
    }
}

/// Starts drawing a plan. None if the system gives no thread; the map then works without a plan.
fn ask(scene: &Scene, storey_m: f64) -> Option<mpsc::Receiver<ColorImage>> {
    let (sender, receiver) = mpsc::channel();
    let scene = scene.clone();
    let work = move || {
        if let Some(volume) = &scene.index.volume {
            // The map may have been closed.
            let _ = sender.send(floor_plan::draw(&scene, volume, storey_m));
        }
    };
    std::thread::Builder::new().name("ldi-plan".into()).spawn(work).ok().map(|_| receiver)
}

/// Whether the dataset is for flying: its volume is one box.
fn flying(scene: &Scene) -> bool {
    scene.index.settings.eye_height_m.is_none()
}

/// The eye position that a click selects: on the displayed storey if possible.
fn standing_place(volume: &WalkVolume, x: f64, z: f64, storey_m: f64, flying: bool) -> DVec3 {
    let here = if flying { Vec::new() } else { walker::storeys(volume, x, z) };
    let y = here.into_iter().min_by(|a, b| (a - storey_m).abs().total_cmp(&(b - storey_m).abs()));
    let p = DVec3::new(x, y.unwrap_or(storey_m), z);
    walker::nearest(volume, p).unwrap_or(p)
}

/// Eye heights of the storeys, ascending.
fn storeys(volume: &WalkVolume) -> Vec<f64> {
    let mut area = BTreeMap::<i64, f64>::new();
    for b in volume.boxes() {
        let size = b.size();
        *area.entry((walker::nominal([b.min.y, b.max.y]) * 5.0).round() as i64).or_default() += size.x * size.z;
    }
    let most = area.values().copied().fold(0.0, f64::max);
    let mut by_area: Vec<(f64, f64)> = area.into_iter().map(|(h, a)| (h as f64 * 0.2, a)).collect();
    by_area.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut out: Vec<f64> = Vec::new();
    for (height, area) in by_area {
        if area >= SMALLEST_STOREY * most && out.iter().all(|o| (o - height).abs() > 2.0 * STOREY_M) {
            out.push(height);
        }
    }
    out.sort_by(f64::total_cmp);
    out
}

/// Draws the grid points of the storey, the one in use, and the zone of eyes of its images.
fn draw_grid_points(
    painter: &egui::Painter,
    sheet: &MapProjection,
    index: &Index,
    storey_m: f64,
    selection: &Selection,
) {
    let used = selection.grid_point;
    let near = index.points.iter().filter(|p| (p.position.y - storey_m).abs() <= STOREY_M);
    for p in near.take(MOST_POINTS) {
        painter.circle_filled(sheet.show(p.position), 1.5, Color32::from_rgb(90, 140, 190));
    }
    let orange = Color32::from_rgb(230, 159, 0);
    if let Some(placement) = selection.placement.and_then(|p| index.placements.get(p as usize)) {
        let users = Rect::from_two_pos(sheet.show(placement.users.min), sheet.show(placement.users.max));
        painter.rect_stroke(users, CornerRadius::ZERO, Stroke::new(1.5, orange), egui::StrokeKind::Outside);
    }
    if let Some(p) = used.and_then(|u| index.points.get(u as usize)) {
        painter.circle_filled(sheet.show(p.position), 3.5, orange);
    }
}

/// Draws the walker: field of view, and an arrow.
fn draw_walker(painter: &egui::Painter, sheet: &MapProjection, pose: &Pose, fov_deg: f64) {
    let at = sheet.show(pose.position);
    let toward = |deg: f64, distance: f32| toward(at, pose.yaw_deg + deg, distance);
    let red = Color32::from_rgb(213, 40, 40);
    let view = vec![at, toward(fov_deg / 2.0, 46.0), toward(-fov_deg / 2.0, 46.0)];
    painter.add(Shape::convex_polygon(view, Color32::from_rgba_unmultiplied(213, 40, 40, 60), Stroke::NONE));
    painter.add(arrow(at, pose.yaw_deg, 1.0, red));
}

/// Draws another walker: a smaller arrow with number and name, dim on another storey.
fn draw_other_walker(painter: &egui::Painter, sheet: &MapProjection, o: &Other, storey_m: f64) {
    let p = DVec3::from_array(o.position);
    let at = sheet.show(p);
    let dim = if (p.y - storey_m).abs() <= STOREY_M { 1.0 } else { 0.4 };
    painter.add(arrow(at, f64::from(o.yaw_deg), 0.75, Color32::from_rgb(0, 158, 115).gamma_multiply(dim)));
    let name: String = o.name.chars().filter(|c| !c.is_control()).take(LONGEST_NAME).collect();
    let colour = Color32::WHITE.gamma_multiply(dim);
    let text = painter.layout_no_wrap(format!("{} {name}", o.walker), egui::FontId::proportional(12.0), colour);
    let room = Align2::LEFT_CENTER.anchor_size(at + vec2(12.0, 0.0), text.size() + vec2(8.0, 2.0));
    painter.rect_filled(room, CornerRadius::same(3), SHADE.gamma_multiply(dim));
    painter.galley(room.min + vec2(4.0, 1.0), text, colour);
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
    use ldi_protocol::Aabb;

    /// Two storeys of 4 x 4 m with eyes at 1.6 and 4.6 m, the upper one above the left half only.
    fn house() -> WalkVolume {
        let runs: Vec<Vec<[u16; 2]>> =
            (0..64).map(|c| if c % 8 < 4 { vec![[11, 20], [41, 50]] } else { vec![[11, 20]] }).collect();
        let cut = Aabb { min: DVec3::ZERO, max: DVec3::new(4.0, 0.0, 4.0) };
        WalkVolume::new(DVec3::ZERO, 0.5, 0.1, [8, 8], &runs, &cut).unwrap()
    }

    #[test]
    fn storeys_are_found_and_clicks_stay_on_them() {
        let v = house();
        let found = storeys(&v);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!((found[0] - 1.6).abs() < 0.11 && (found[1] - 4.6).abs() < 0.11, "{found:?}");
        let up = standing_place(&v, 1.0, 2.0, found[1], false);
        assert!((up.y - 4.6).abs() < 0.06 && up.x == 1.0 && v.contains(up), "{up}");
        // Above the right half there is only the lower one.
        let down = standing_place(&v, 3.0, 2.0, found[1], false);
        assert!((down.y - 1.6).abs() < 0.06 && down.x == 3.0 && v.contains(down), "{down}");
    }

    #[test]
    fn the_sheet_goes_there_and_back() {
        let room = Rect::from_min_size(pos2(10.0, 20.0), vec2(800.0, 400.0));
        let sheet = MapProjection::fit(&house(), room);
        assert!(room.contains_rect(sheet.area) && (sheet.per_metre - 100.0).abs() < 1e-3);
        let p = DVec3::new(1.0, 1.6, 3.0);
        let [x, z] = sheet.world(sheet.show(p));
        assert!((x - p.x).abs() < 1e-3 && (z - p.z).abs() < 1e-3);
        // -Z is up.
        assert!(sheet.show(DVec3::ZERO).y < sheet.show(p).y);
    }
}
