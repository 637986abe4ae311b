//! The floor plans of a dataset as a drawing: storey beside storey, with the names of the rooms, a
//! scale, north, and a path.

use super::{BORDER_PX, LETTER_PX, Plan, Subject, draw::Drawing, draw::Ink, inside, path_ink};
use glam::DVec2;
use ldi_protocol::floor_plan::FloorPlan;

/// Area of a drawing, pixels, within which storeys are as large as can be.
const AREA_PX: f64 = 4.0e6;
/// Most pixels per metre.
const MOST_PX_PER_M: f64 = 40.0;
/// Longest scale bar, pixels.
const SCALE_PX: f64 = 160.0;
/// Space above a storey for its title, pixels.
const TITLE_PX: f64 = 3.0 * LETTER_PX;
/// Width of a letter, pixels.
const LETTER_WIDTH_PX: f64 = 8.0;

const TEXT: Ink = [30, 36, 44];
const NAMES: Ink = [70, 80, 92];

/// Draws the floor plans; x to the right, z downward, north up.
pub(super) fn draw(s: &Subject<'_>, plans: &[FloorPlan]) -> Plan {
    let content = plans
        .iter()
        .map(FloorPlan::content)
        .reduce(|a, b| [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]);
    let [x0, z0, x1, z1] = content.unwrap_or([0.0, 0.0, 1.0, 1.0]);
    let size = DVec2::new(x1 - x0, z1 - z0).max(DVec2::splat(0.5));
    let scale = (AREA_PX / (plans.len() as f64 * size.x * size.y)).sqrt().min(MOST_PX_PER_M);
    let sheet = size * scale + DVec2::new(BORDER_PX, BORDER_PX + TITLE_PX);
    let across = ((plans.len() as f64 * sheet.y / sheet.x).sqrt().round() as usize).clamp(1, plans.len());
    let down = plans.len().div_ceil(across);
    let head = BORDER_PX * 2.0 + TITLE_PX;
    let mut out =
        Drawing::new((sheet.x * across as f64 + BORDER_PX).max(600.0), head + sheet.y * down as f64 + BORDER_PX);
    title(&mut out, s, scale);
    for (n, plan) in plans.iter().enumerate() {
        let corner = DVec2::new(BORDER_PX + (n % across) as f64 * sheet.x, head + (n / across) as f64 * sheet.y);
        let place = |x: f64, z: f64| corner + DVec2::new((x - x0) * scale, TITLE_PX + (z - z0) * scale);
        let name = match plan.relief {
            true => format!("open ground, a contour line every {} m", plan.contour_m()),
            false => format!("storey {} of {}, floor at {:.1} m", n + 1, plans.len(), plan.floor_m),
        };
        out.text(corner + DVec2::Y * LETTER_PX, &name, TEXT);
        let [left, top, right, bottom] = plan.area();
        // One texel per pixel, or more in SVG, where one may look closer.
        out.picture(place(left, top), place(right, bottom), [place(x0, z0), place(x1, z1)], plan.clone());
        rooms(&mut out, s, plan, scale, &place);
        path(&mut out, s, plan, &place);
    }
    Plan(out)
}

/// Title, share of the path, scale and north.
fn title(out: &mut Drawing, s: &Subject<'_>, scale: f64) {
    let mut text = s.title.to_string();
    if let Some(path) = s.path {
        let (share, of) = inside(s.volume, path);
        text += &format!("; path: {:.1}% of {of} poses are inside; red ones are outside", share * 100.0);
    }
    out.text(DVec2::new(BORDER_PX, BORDER_PX), &text, TEXT);
    let power = 10f64.powf((SCALE_PX / scale).log10().floor());
    let metres = [5.0, 2.0, 1.0].map(|m| m * power).into_iter().find(|m| m * scale <= SCALE_PX).unwrap_or(power);
    let at = DVec2::new(BORDER_PX, BORDER_PX + TITLE_PX);
    out.rectangle(at, at + DVec2::new(metres * scale, 3.0), TEXT);
    out.text(at + DVec2::new(metres * scale + 8.0, 5.0), &format!("{metres} m, north is up"), TEXT);
}

/// Names of the rooms that fit into them.
fn rooms(out: &mut Drawing, s: &Subject<'_>, plan: &FloorPlan, scale: f64, place: &dyn Fn(f64, f64) -> DVec2) {
    for room in s.rooms.into_iter().flat_map(ldi_protocol::rooms::Rooms::cells) {
        let area = |b: &ldi_protocol::Aabb| b.size().x * b.size().z;
        let cut = room.boxes.iter().filter(|b| plan.cuts(b));
        let Some(b) = cut.max_by(|a, b| area(a).total_cmp(&area(b))) else { continue };
        let width = room.name.chars().count() as f64 * LETTER_WIDTH_PX;
        if width <= b.size().x * scale && LETTER_PX <= b.size().z * scale {
            let middle = place(b.centre().x, b.centre().z);
            out.text(middle + DVec2::new(-width, LETTER_PX) * 0.5, &room.name, NAMES);
        }
    }
}

/// Poses of the path on this storey.
fn path(out: &mut Drawing, s: &Subject<'_>, plan: &FloorPlan, place: &dyn Fn(f64, f64) -> DVec2) {
    let eye_m = s.eye_height_m.unwrap_or(0.0);
    let storey = |y: f64| (y - eye_m - plan.floor_m).abs();
    for p in s.path.into_iter().flat_map(|p| &p.poses).map(|p| p.pose.position) {
        let nearest = s.plans.iter().map(|o| (p.y - eye_m - o.floor_m).abs()).fold(f64::INFINITY, f64::min);
        if storey(p.y) <= nearest {
            out.dot(place(p.x, p.z), 1.5, path_ink(s.volume, p));
        }
    }
}
