//! A storey's floor plan on the map: its picture as textures, its rooms, and where one would stand.

use super::{map_view::MapProjection, walker};
use egui::{Color32, ColorImage, Rect, TextureHandle, TextureOptions, pos2};
use glam::DVec3;
use ldi_protocol::{Pose, floor_plan::FloorPlan, index::Index, volume::WalkVolume};

/// Longest side of a texture: every graphics card takes it.
const TILE: u32 = 1024;
/// Distance that one keeps from walls after a click, metres.
const BODY_M: f64 = 0.35;
/// A click stands for a place within this distance, metres, or within as many points.
const REACH_M: f64 = 1.0;
const REACH_POINTS: f64 = 14.0;
/// Largest difference in height between an eye and the one that the plan's floor gives, metres.
const LEVEL_M: f64 = 0.8;

/// Textures of a plan.
pub struct PlanPicture {
    /// Position in [`Index::plans`].
    pub plan: usize,
    /// Cells of the plan per texel, along each side.
    factor: u32,
    tiles: Vec<(TextureHandle, [f64; 4])>,
}

impl PlanPicture {
    /// Cells per texel at a scale: lines of a cell stay visible in a small picture.
    fn factor_at(plan: &FloorPlan, per_metre: f64) -> u32 {
        let cells_per_point = 1.0 / (per_metre * plan.pitch_m).max(1e-6);
        1 << (cells_per_point.log2().floor().clamp(0.0, 8.0) as u32)
    }

    /// Whether the textures fit the scale.
    pub fn is_for(&self, plan: &FloorPlan, per_metre: f64) -> bool {
        self.factor == Self::factor_at(plan, per_metre)
    }

    /// Makes the textures of a plan.
    pub fn of(ctx: &egui::Context, (number, plan): (usize, &FloorPlan), per_metre: f64) -> Self {
        let factor = Self::factor_at(plan, per_metre);
        let coarse = plan.coarser(factor);
        let picture = coarse.picture();
        let [w, h] = coarse.size;
        let mut tiles = Vec::new();
        for z in (0..h).step_by(TILE as usize) {
            for x in (0..w).step_by(TILE as usize) {
                let size = [TILE.min(w - x), TILE.min(h - z)];
                let row = |k: u32| ((z + k) * w + x) as usize;
                let rows = (0..size[1]).flat_map(|k| &picture[row(k)..row(k) + size[0] as usize]);
                let pixels = rows.map(|[r, g, b, a]| Color32::from_rgba_unmultiplied(*r, *g, *b, *a)).collect();
                let image = ColorImage::new(size.map(|n| n as usize), pixels);
                let texture = ctx.load_texture("floor plan", image, TextureOptions::LINEAR);
                let at = |cell: u32, axis: usize| coarse.corner[axis] + f64::from(cell) * coarse.pitch_m;
                tiles.push((texture, [at(x, 0), at(z, 1), at(x + size[0], 0), at(z + size[1], 1)]));
            }
        }
        Self { plan: number, factor, tiles }
    }

    /// Draws the textures.
    pub fn draw(&self, painter: &egui::Painter, sheet: &MapProjection) {
        let whole = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
        for (texture, area) in &self.tiles {
            let area = sheet.show_area(*area);
            if area.intersects(sheet.area) {
                painter.image(texture.id(), area, whole, Color32::WHITE);
            }
        }
    }
}

/// Names of the rooms that a plan cuts, with the area of the largest box of each,
/// `[x0, z0, x1, z1]`.
pub fn room_names<'a>(index: &'a Index, plan: &'a FloorPlan) -> impl Iterator<Item = (&'a str, [f64; 4])> {
    let rooms = index.rooms.iter().flat_map(|r| r.rooms.cells());
    rooms.filter_map(|room| {
        let area = |b: &ldi_protocol::Aabb| b.size().x * b.size().z;
        let cut = room.boxes.iter().filter(|b| plan.cuts(b));
        let largest = cut.max_by(|a, b| area(a).total_cmp(&area(b)))?;
        Some((room.name.as_str(), [largest.min.x, largest.min.z, largest.max.x, largest.max.z]))
    })
}

/// The plan of the storey of an eye: the one whose floor lies nearest below.
pub fn storey_of(plans: &[FloorPlan], eye_y: f64, eye_height_m: f64) -> usize {
    let off = |p: &FloorPlan| (p.floor_m + eye_height_m - eye_y).abs();
    (0..plans.len()).min_by(|a, b| off(&plans[*a]).total_cmp(&off(&plans[*b]))).unwrap_or(0)
}

/// Where one would stand and look after a click at (x, z) of the world: near, clear of walls, with
/// the longest free view ahead. None where nobody can stand.
pub fn standing_pose(
    plan: &FloorPlan,
    volume: &WalkVolume,
    eye_height_m: f64,
    [x, z]: [f64; 2],
    per_metre: f64,
) -> Option<Pose> {
    let eye = |[x, z]: [f64; 2]| {
        let wanted = plan.floor_at(x, z)? + eye_height_m;
        let off = |y: &f64| (y - wanted).abs();
        let heights = walker::storeys(volume, x, z).into_iter().filter(|y| off(y) <= LEVEL_M);
        let y = heights.min_by(|a, b| off(a).total_cmp(&off(b)))?;
        Some(DVec3::new(x, y, z)).filter(|p| volume.contains(*p))
    };
    let reach_m = REACH_M.max(REACH_POINTS / per_metre);
    // In narrow places less room than wanted is better than none.
    let near = |body_m| plan.place_near([x, z], reach_m, body_m, |p| eye(p).is_some());
    let place = near(BODY_M).or_else(|| near(BODY_M * 0.5))?;
    Some(Pose { position: eye(place)?, yaw_deg: plan.open_yaw_deg(place), pitch_deg: 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ldi_protocol::{
        Aabb,
        floor_plan::{FLOOR, WALL},
    };

    /// A walk volume of 4 x 4 m with eyes at 1.6 m, over a plan with a wall along x = 2.
    fn house() -> (WalkVolume, FloorPlan) {
        let runs = vec![vec![[11, 20]]; 64];
        let cut = Aabb { min: DVec3::ZERO, max: DVec3::new(4.0, 0.0, 4.0) };
        let volume = WalkVolume::new(DVec3::ZERO, 0.5, 0.1, [8, 8], &runs, &cut).unwrap();
        let is_wall = |n: u32| (19..=20).contains(&(n % 40));
        let plan = FloorPlan {
            floor_m: 0.0,
            ground_m: 0.0,
            step_m: 0.1,
            corner: [0.0; 2],
            pitch_m: 0.1,
            size: [40, 40],
            relief: false,
            cells: (0..1600).map(|n| if is_wall(n) { WALL } else { FLOOR }).collect(),
        };
        (volume, plan)
    }

    #[test]
    fn a_click_stands_clear_of_the_wall_and_faces_away_from_it() {
        let (volume, plan) = house();
        let pose = standing_pose(&plan, &volume, 1.6, [2.05, 2.0], 100.0).expect("a place");
        let p = pose.position;
        assert!(volume.contains(p) && (p.x - 2.0).abs() >= BODY_M && (p.x - 2.0).abs() < 0.6, "{p}");
        let ahead = ldi_protocol::ViewBasis::from_yaw_pitch(pose.yaw_deg, 0.0).forward;
        let view_m = plan.view_m([p.x, p.z], pose.yaw_deg);
        assert!(view_m > 1.5 && ahead.x * (p.x - 2.0) > -0.2, "{ahead} from {p}: {view_m} m");
        // Beyond the house there is nowhere to stand, unless the map is so small that it is meant.
        assert_eq!(standing_pose(&plan, &volume, 1.6, [7.0, 2.0], 100.0), None);
        assert!(standing_pose(&plan, &volume, 1.6, [7.0, 2.0], 4.0).is_some());
        // The volume decides as well.
        assert_eq!(standing_pose(&plan, &volume.only(|_| false), 1.6, [1.0, 2.0], 100.0), None);
    }

    #[test]
    fn the_storey_is_the_one_of_the_floor_below_the_eye() {
        let (_, plan) = house();
        let plans = [plan.clone(), FloorPlan { floor_m: 3.0, ..plan }];
        assert_eq!([1.6, 2.9, 3.4, 4.6].map(|y| storey_of(&plans, y, 1.6)), [0, 0, 1, 1]);
    }

    #[test]
    fn small_pictures_have_fewer_texels() {
        let (_, plan) = house();
        assert_eq!([100.0, 10.0, 4.0, 1.0].map(|k| PlanPicture::factor_at(&plan, k)), [1, 1, 2, 8]);
    }
}
