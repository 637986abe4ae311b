//! The plan of a dataset as a picture: its floor plans ([`mod@storeys`]), or where people walk,
//! where they do not and why, rooms, grid points, and a path.
//!
//! In: an index, or a walk volume alone, the [`WalkReport`] of its build, perhaps a path. Out: SVG
//! or PNG. Without floor plans one sheet stands below another. A sheet holds floors that do not lie
//! above each other ([`mod@sheets`]): the storeys of a building, the decks of a bridge.

mod draw;
pub(crate) mod png;
mod sheets;
mod storeys;

use crate::walk_volume::WalkReport;
use draw::{Drawing, Ink};
use glam::{DVec2, DVec3};
use ldi_protocol::{Aabb, floor_plan::FloorPlan, path::Walk, rooms::Rooms, volume::WalkVolume};
use sheets::{Sheet, sheets};

/// Border around each sheet, pixels.
const BORDER_PX: f64 = 28.0;
/// Most pixels per metre: a closet is not drawn like a hall.
const MOST_PX_PER_M: f64 = 24.0;
/// Most sheets: the largest ones are drawn.
const MOST_SHEETS: usize = 12;
/// Area of a drawing, pixels, within which sheets are as large as can be.
const AREA_PX: f64 = 3.0e6;
/// Left out floors are drawn with a sheet whose heights they come within, metres.
const BESIDE_M: f64 = 1.5;
/// Letters are so high, pixels.
const LETTER_PX: f64 = 8.0;

/// What a plan shows.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// Title.
    pub title: &'a str,
    /// Where people walk.
    pub volume: &'a WalkVolume,
    /// Nominal eye height, metres; None for flying.
    pub eye_height_m: Option<f64>,
    /// What was left out, and why.
    pub report: Option<&'a WalkReport>,
    /// Rooms.
    pub rooms: Option<&'a Rooms>,
    /// Grid points.
    pub points: &'a [DVec3],
    /// A path to draw over it.
    pub path: Option<&'a Walk>,
    /// Floor plans; if there are any, they are drawn instead of what people walk on and why.
    pub plans: &'a [FloorPlan],
}

/// A drawn plan.
pub struct Plan(Drawing);

impl Plan {
    /// As SVG.
    pub fn svg(&self) -> String {
        self.0.svg()
    }

    /// As PNG.
    ///
    /// # Errors
    /// If the picture cannot be encoded.
    pub fn png(&self) -> Result<Vec<u8>, image::ImageError> {
        self.0.png()
    }
}

/// Share of a path's poses that lie in a volume, and how many there are.
pub fn inside(volume: &WalkVolume, path: &Walk) -> (f64, usize) {
    let all = path.poses.len();
    let inside = path.poses.iter().filter(|p| volume.contains(p.pose.position)).count();
    (inside as f64 / all.max(1) as f64, all)
}

/// Colour of what was left out, by its reason.
fn ink_of(why: &str) -> Ink {
    match why {
        "roof" => [214, 160, 190],
        "top of furniture" => [190, 120, 60],
        "inside of a solid" => [150, 150, 150],
        w if w.starts_with("above a ceiling") => [200, 190, 230],
        _ => [238, 200, 120],
    }
}

/// Colour of a floor: light at the top of the sheet's heights, dark at their foot.
fn ink_at(height: f64, [low, high]: [f64; 2]) -> Ink {
    let at = if high - low < 0.5 { 0.5 } else { ((height - low) / (high - low)).clamp(0.0, 1.0) };
    // Few tones, so that neighbours join into one rectangle.
    let at = (at * 12.0).round() / 12.0;
    let mix = |from: f64, to: f64| (from + (to - from) * at) as u8;
    [mix(60.0, 190.0), mix(120.0, 225.0), mix(170.0, 245.0)]
}

/// Colour of a pose of a path: red outside of the volume.
fn path_ink(volume: &WalkVolume, p: DVec3) -> Ink {
    if volume.contains(p) { [0, 130, 40] } else { [220, 0, 0] }
}

/// Draws a plan; x to the right, z downward.
pub fn draw(s: &Subject<'_>) -> Plan {
    if !s.plans.is_empty() {
        return storeys::draw(s, s.plans);
    }
    let floor_of = |b: &Aabb| match s.eye_height_m {
        Some(eye_height_m) => b.min.y + 0.5 - eye_height_m,
        None => b.min.y,
    };
    let boxes: Vec<(Aabb, f64)> = s.volume.boxes().map(|b| (b, floor_of(&b))).collect();
    let mut all = sheets(&boxes, s.volume);
    all.sort_by_key(|s| std::cmp::Reverse(s.boxes.len()));
    let left_out = all.len().saturating_sub(MOST_SHEETS);
    all.truncate(MOST_SHEETS);
    all.sort_by(|a, b| a.middle_m.total_cmp(&b.middle_m));

    let mut extent = boxes.iter().fold(Aabb::EMPTY, |e, (b, _)| e.union(*b));
    if extent.is_empty() {
        extent = Aabb { min: DVec3::ZERO, max: DVec3::splat(1.0) };
    }
    let around = (extent.size().max_element() * 0.1).max(2.0);
    let extent = extent.inflated(around);
    let size = extent.size();
    let scale = (AREA_PX / (all.len().max(1) as f64 * size.x * size.z)).sqrt().min(MOST_PX_PER_M);
    let head = legend_height(s);
    let sheet = DVec2::new(size.x * scale + BORDER_PX, size.z * scale + BORDER_PX + 2.0 * LETTER_PX);
    // As many beside each other as make the whole about as wide as high.
    let across = ((all.len() as f64 * sheet.y / sheet.x).sqrt().round() as usize).clamp(1, all.len().max(1));
    let down = all.len().div_ceil(across).max(1);
    let width = (sheet.x * across as f64).max(900.0) + BORDER_PX;
    let mut out = Drawing::new(width, head + sheet.y * down as f64 + BORDER_PX);
    legend(&mut out, s, scale, left_out);
    for (n, of) in all.iter().enumerate() {
        let corner = DVec2::new(BORDER_PX + (n % across) as f64 * sheet.x, head + (n / across) as f64 * sheet.y);
        let place = |x: f64, z: f64| {
            corner + DVec2::new((x - extent.min.x) * scale, 2.0 * LETTER_PX + (z - extent.min.z) * scale)
        };
        draw_sheet(&mut out, s, of, (corner, n == 0, n + 1 == all.len()), &boxes, &place);
    }
    Plan(out)
}

fn draw_sheet(
    out: &mut Drawing,
    s: &Subject<'_>,
    sheet: &Sheet,
    (corner, is_lowest, is_highest): (DVec2, bool, bool),
    boxes: &[(Aabb, f64)],
    place: &dyn Fn(f64, f64) -> DVec2,
) {
    let [low, high] = sheet.heights_m;
    let belongs = |y: f64| (y >= low - BESIDE_M || is_lowest) && (y <= high + BESIDE_M || is_highest);
    for r in s.report.into_iter().flat_map(|r| &r.regions).filter(|r| !r.kept) {
        for [x0, x1, z0, z1, _] in r.patches.iter().filter(|p| belongs(f64::from(p[4]))).map(|p| p.map(f64::from)) {
            out.rectangle(place(x0, z0), place(x1, z1), ink_of(&r.why));
        }
    }
    for &n in &sheet.boxes {
        let (b, floor) = &boxes[n];
        out.rectangle(place(b.min.x, b.min.z), place(b.max.x, b.max.z), ink_at(*floor, sheet.heights_m));
    }
    for cell in s.rooms.into_iter().flat_map(Rooms::cells) {
        let b = cell.bounds();
        if b.min.y > high + 1.0 || b.max.y < low + 1.0 {
            continue;
        }
        out.frame(place(b.min.x, b.min.z), place(b.max.x, b.max.z), [120, 60, 160]);
    }
    let eye_m = s.eye_height_m.unwrap_or(0.0);
    for p in s.points.iter().filter(|p| belongs(p.y - eye_m)) {
        out.dot(place(p.x, p.z), 2.0, [40, 40, 40]);
    }
    for pose in s.path.into_iter().flat_map(|p| &p.poses) {
        let p = pose.pose.position;
        if belongs(p.y - eye_m) {
            out.dot(place(p.x, p.z), 1.5, path_ink(s.volume, p));
        }
    }
    let area = sheet.boxes.iter().map(|n| boxes[*n].0.size()).map(|size| size.x * size.z).sum::<f64>();
    let text = match s.eye_height_m {
        Some(_) => format!("floors at {low:.1} to {high:.1} m, {area:.0} m2"),
        None => "flying: the whole box".into(),
    };
    out.text(corner + DVec2::Y * LETTER_PX, &text, [0, 0, 0]);
}

/// Rows of the legend.
fn entries(s: &Subject<'_>) -> Vec<(Option<Ink>, String)> {
    let mut rows = vec![(None, s.title.to_string())];
    if let Some(r) = s.report {
        let kept: f64 = r.regions.iter().filter(|r| r.kept).map(|r| r.area_m2).sum();
        rows.push((
            Some(ink_at(1.0, [0.0, 2.0])),
            format!(
                "people walk here: {kept:.0} m2 and more in smaller places; {:.0}% of the triangles are seen from near",
                r.detail * 100.0
            ),
        ));
        let kept_words: Vec<&str> = r.regions.iter().filter(|r| r.kept).map(|r| r.why.as_str()).collect();
        for (why, area) in r.area_m2.iter().filter(|(why, _)| !kept_words.contains(&why.as_str())) {
            rows.push((Some(ink_of(why)), format!("nobody walks here: {area:.0} m2 {why}")));
        }
    }
    if !s.points.is_empty() {
        rows.push((Some([40, 40, 40]), format!("{} grid points", s.points.len())));
    }
    if let Some(path) = s.path {
        let (share, of) = inside(s.volume, path);
        rows.push((
            Some([0, 130, 40]),
            format!("path: {:.1}% of {of} poses are inside; red ones are outside", share * 100.0),
        ));
    }
    rows
}

fn legend_height(s: &Subject<'_>) -> f64 {
    BORDER_PX + (entries(s).len() as f64 + 1.0) * 2.0 * LETTER_PX
}

fn legend(out: &mut Drawing, s: &Subject<'_>, scale: f64, left_out: usize) {
    let mut rows = entries(s);
    let more = if left_out > 0 { format!("; {left_out} smaller sheets are not drawn") } else { String::new() };
    rows.push((None, format!("10 m are {:.0} pixels{more}", 10.0 * scale)));
    for (n, (ink, text)) in rows.iter().enumerate() {
        let y = BORDER_PX * 0.5 + n as f64 * 2.0 * LETTER_PX;
        if let Some(ink) = ink {
            out.rectangle(DVec2::new(BORDER_PX, y), DVec2::new(BORDER_PX + 12.0, y + LETTER_PX), *ink);
        }
        out.text(DVec2::new(BORDER_PX + 18.0, y + LETTER_PX), text, [0, 0, 0]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::walk_volume::RegionReport;
    use ldi_protocol::floor_plan::{FLOOR, WALL};

    fn two_storeys() -> WalkVolume {
        let runs: Vec<Vec<[u16; 2]>> =
            (0..400).map(|c| if c % 20 < 10 { vec![[1, 10]] } else { vec![[1, 10], [31, 40]] }).collect();
        let cut = Aabb { min: DVec3::ZERO, max: DVec3::new(10.0, 0.0, 10.0) };
        WalkVolume::new(DVec3::new(0.0, 1.0, 0.0), 0.5, 0.1, [20, 20], &runs, &cut).unwrap()
    }

    #[test]
    fn a_plan_shows_storeys_what_was_left_out_and_the_path() {
        let volume = two_storeys();
        let table = RegionReport {
            kept: false,
            why: "top of furniture".into(),
            area_m2: 2.0,
            heights_m: [0.8; 2],
            place: [2.0, 0.8, 2.0],
            detail: 0.0,
            patches: vec![[2.0, 3.0, 2.0, 4.0, 0.8]],
        };
        let report = WalkReport {
            regions: vec![table],
            area_m2: [("top of furniture".to_string(), 2.0)].into(),
            ..WalkReport::default()
        };
        let path = ldi_protocol::path::parse(r#"{"waypoints": [[1, 1.6, 1], [30, 1.6, 1]]}"#).unwrap();
        let subject = Subject {
            title: "two <storeys>",
            volume: &volume,
            eye_height_m: Some(1.6),
            report: Some(&report),
            rooms: None,
            points: &[DVec3::new(5.0, 1.6, 5.0)],
            path: Some(&path),
            plans: &[],
        };
        let plan = draw(&subject);
        let svg = plan.svg();
        for wanted in ["floors at 0.0 to 0.0 m, 100 m2", "floors at 3.0 to 3.0 m, 50 m2", "two &lt;storeys&gt;"] {
            assert!(svg.contains(wanted), "{wanted} is missing");
        }
        assert!(svg.contains("#be783c"), "the table's colour");
        let picture = image::load_from_memory(&plan.png().unwrap()).unwrap().to_rgb8();
        let has = |ink: Ink| picture.pixels().any(|p| p.0 == ink);
        assert!(has([190, 120, 60]) && has([0, 130, 40]) && has([220, 0, 0]) && has([255, 255, 255]));
        assert!((inside(&volume, &path).0 - 9.0 / 29.0).abs() < 0.01);
        // With floor plans: a picture of each, walls dark and floors light.
        let storey = |floor_m| FloorPlan {
            floor_m,
            ground_m: floor_m,
            step_m: 0.1,
            corner: [0.0; 2],
            pitch_m: 0.1,
            size: [100, 100],
            relief: false,
            cells: (0..10_000).map(|n| if n % 100 == 50 { WALL } else { FLOOR }).collect(),
        };
        let plans = [storey(0.0), storey(3.0)];
        let plan = draw(&Subject { plans: &plans, ..subject });
        let svg = plan.svg();
        for wanted in ["storey 1 of 2, floor at 0.0 m", "storey 2 of 2", "data:image/png;base64,", "m, north is up"] {
            assert!(svg.contains(wanted), "{wanted} is missing");
        }
        let picture = image::load_from_memory(&plan.png().unwrap()).unwrap().to_rgb8();
        let share = |ink: Ink| picture.pixels().filter(|p| p.0 == ink).count() as f64 / picture.pixels().len() as f64;
        assert!(share([250, 248, 242]) > 0.5 && share([33, 40, 48]) > 0.003, "{}", share([33, 40, 48]));
        assert!(picture.pixels().any(|p| p.0 == [220, 0, 0]) && picture.pixels().any(|p| p.0 == [0, 130, 40]));
    }
}
