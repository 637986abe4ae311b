//! The part of the world that the map shows: zoomed by the wheel, moved by dragging.

use egui::{Pos2, Rect, pos2, vec2};
use glam::DVec3;

/// Most points per metre: more shows the cells of a plan and nothing else.
const MOST_PER_METRE: f64 = 400.0;
/// Least points per metre, as a share of those at which everything fits.
const LEAST_OF_FIT: f64 = 0.5;
/// Smallest extent that is fitted into the window, metres.
const SMALLEST_M: f64 = 2.0;

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
    /// The largest projection with all of a part of the world, `[x0, z0, x1, z1]`.
    pub fn fit([x0, z0, x1, z1]: [f64; 4], area: Rect) -> Self {
        let size = [x1 - x0, z1 - z0].map(|s| s.max(SMALLEST_M));
        let per_metre = (f64::from(area.width()) / size[0]).min(f64::from(area.height()) / size[1]);
        Self::around([(x0 + x1) * 0.5, (z0 + z1) * 0.5], per_metre.clamp(1e-6, MOST_PER_METRE), area)
    }

    /// The projection with a world position in the middle of the area.
    fn around([x, z]: [f64; 2], per_metre: f64, area: Rect) -> Self {
        let half = |points: f32| f64::from(points) * 0.5 / per_metre;
        Self { area, corner: [x - half(area.width()), z - half(area.height())], per_metre }
    }

    /// Position of a place on the display.
    pub fn show(&self, p: DVec3) -> Pos2 {
        let at = |v: f64, corner: f64| ((v - corner) * self.per_metre) as f32;
        self.area.min + vec2(at(p.x, self.corner[0]), at(p.z, self.corner[1]))
    }

    /// Area on the display of a part of the world, `[x0, z0, x1, z1]`.
    pub fn show_area(&self, [x0, z0, x1, z1]: [f64; 4]) -> Rect {
        Rect::from_min_max(self.show(DVec3::new(x0, 0.0, z0)), self.show(DVec3::new(x1, 0.0, z1)))
    }

    /// World x and z of a position on the display.
    pub fn world(&self, at: Pos2) -> [f64; 2] {
        let d = at - self.area.min;
        [self.corner[0] + f64::from(d.x) / self.per_metre, self.corner[1] + f64::from(d.y) / self.per_metre]
    }

    /// Zooms by a factor about a position on the display, which keeps its place. `fit`: the
    /// projection with everything.
    pub fn zoom(&mut self, factor: f64, at: Pos2, fit: &Self) {
        let [x, z] = self.world(at);
        let least = (fit.per_metre * LEAST_OF_FIT).min(MOST_PER_METRE);
        self.per_metre = (self.per_metre * factor).clamp(least, MOST_PER_METRE);
        let d = at - self.area.min;
        self.corner = [x - f64::from(d.x) / self.per_metre, z - f64::from(d.y) / self.per_metre];
    }

    /// Moves what is shown by a distance on the display.
    pub fn drag(&mut self, by: egui::Vec2) {
        self.corner[0] -= f64::from(by.x) / self.per_metre;
        self.corner[1] -= f64::from(by.y) / self.per_metre;
    }

    /// The same part of the world in another area: its middle stays.
    pub fn moved_to(&self, area: Rect) -> Self {
        if area == self.area { *self } else { Self::around(self.world(self.area.center()), self.per_metre, area) }
    }

    /// Length of the scale bar, metres: 1, 2 or 5 times a power of ten, at most `points` long.
    pub fn scale_m(&self, points: f64) -> f64 {
        let most = points / self.per_metre;
        let power = 10f64.powf(most.log10().floor());
        [5.0, 2.0, 1.0].map(|m| m * power).into_iter().find(|m| *m <= most).unwrap_or(power)
    }
}

/// The area of the map in a window.
pub fn area_in(screen: Rect) -> Rect {
    let inner = screen.shrink2(vec2(24.0, 44.0));
    // A window may be smaller than the borders.
    if inner.is_positive() { inner } else { Rect::from_min_size(pos2(0.0, 0.0), vec2(1.0, 1.0)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit() -> MapProjection {
        let area = Rect::from_min_size(pos2(10.0, 20.0), vec2(800.0, 400.0));
        MapProjection::fit([0.0, -2.0, 4.0, 2.0], area)
    }

    #[test]
    fn the_projection_goes_there_and_back() {
        let sheet = fit();
        assert!((sheet.per_metre - 100.0).abs() < 1e-9);
        let p = DVec3::new(1.0, 1.6, 1.0);
        let [x, z] = sheet.world(sheet.show(p));
        assert!((x - p.x).abs() < 1e-3 && (z - p.z).abs() < 1e-3);
        // -Z is up, and the middle is in the middle.
        assert!(sheet.show(DVec3::ZERO).y < sheet.show(p).y);
        assert_eq!(sheet.show(DVec3::new(2.0, 0.0, 0.0)), sheet.area.center());
    }

    #[test]
    fn zooming_keeps_the_place_under_the_pointer_and_has_limits() {
        let (all, mut sheet) = (fit(), fit());
        let at = pos2(300.0, 100.0);
        let before = sheet.world(at);
        sheet.zoom(2.5, at, &all);
        let after = sheet.world(at);
        assert!((before[0] - after[0]).abs() < 1e-9 && (before[1] - after[1]).abs() < 1e-9);
        assert_eq!(sheet.per_metre, 250.0);
        sheet.zoom(1e9, at, &all);
        assert_eq!(sheet.per_metre, MOST_PER_METRE);
        sheet.zoom(1e-9, at, &all);
        assert_eq!(sheet.per_metre, all.per_metre * LEAST_OF_FIT);
    }

    #[test]
    fn dragging_moves_along_and_the_scale_is_round() {
        let mut sheet = fit();
        let before = sheet.world(pos2(100.0, 100.0));
        sheet.drag(vec2(50.0, -20.0));
        let after = sheet.world(pos2(150.0, 80.0));
        assert!((before[0] - after[0]).abs() < 1e-6 && (before[1] - after[1]).abs() < 1e-6);
        assert_eq!(sheet.scale_m(120.0), 1.0);
        assert_eq!(MapProjection { per_metre: 3.0, ..sheet }.scale_m(120.0), 20.0);
    }
}
