//! The view-directions set of a grid point (Aliaga and Lastra 1999, section 3.3.1; row A5).
//!
//! In: a grid point, the cells, the bands of pitch in use. Out: per band the angular ranges of yaw
//! over which the set of cells that may be drawn stays the same, and the triangles of each. Ranges
//! also end at the borders of yaw bins, so that each range lies in one unit of the coverage
//! certificate.

use super::{
    arcs::{Arc, BandPlanes},
    bands::{YAW_BIN_DEG, YAW_BINS},
    cell_mask::CellMask,
    cells::Cells,
};
use ldi_protocol::Aabb;

/// A cell may enter or leave at a yaw.
#[derive(Debug, Clone, Copy)]
struct Event {
    /// Radians in [0, 2 pi).
    yaw: f64,
    cell: u32,
    enters: bool,
}

/// One band's ranges.
#[derive(Debug, Clone, Default)]
pub(super) struct BandView {
    /// Arc and cell.
    arcs: Vec<(Arc, u32)>,
    events: Vec<Event>,
    /// Position in `events` of the first event of each range.
    first_event: Vec<u32>,
    /// Where each range starts, degrees, ascending from 0.
    pub start_deg: Vec<f64>,
    /// Triangles that may be drawn in each range when nothing is culled.
    pub triangles: Vec<u64>,
}

impl BandView {
    /// The ranges over a band for frusta whose apexes lie in a box of eyes: a grid point in the
    /// paper's scheme, all users of a view cell in the other. A plane keeps a cell for some eye of
    /// the box exactly if it keeps, for an eye at the origin, the box of all differences between
    /// points of the cell and eyes.
    pub fn new(cells: &Cells, planes: &BandPlanes, eyes: &Aabb) -> Self {
        let mut view = Self::default();
        cells.arcs(planes, eyes, |cell, set| {
            for arc in set.arcs() {
                view.arcs.push((*arc, cell));
                if arc.length < std::f64::consts::TAU {
                    let end = arc.start + arc.length;
                    let end = if end >= std::f64::consts::TAU { end - std::f64::consts::TAU } else { end };
                    view.events.push(Event { yaw: arc.start, cell, enters: true });
                    view.events.push(Event { yaw: end, cell, enters: false });
                }
            }
        });
        // At equal yaws cells enter before others leave: nothing is missed on the border itself.
        view.events
            .sort_unstable_by(|a, b| a.yaw.total_cmp(&b.yaw).then(b.enters.cmp(&a.enters)).then(a.cell.cmp(&b.cell)));
        view.cut();
        view.triangles = view.count(cells, &CellMask::default());
        view
    }

    /// Places range borders at the events and at the bins' borders.
    fn cut(&mut self) {
        let mut borders: Vec<f64> = self.events.iter().map(|e| e.yaw.to_degrees()).collect();
        borders.extend((0..YAW_BINS).map(|b| b as f64 * YAW_BIN_DEG));
        borders.sort_unstable_by(f64::total_cmp);
        // Ranges thinner than rounding join the one before: arcs are widened by far more.
        borders.dedup_by(|b, a| *b - *a < 1e-9);
        borders.retain(|b| *b < 360.0 - 1e-9);
        let mut at = 0;
        for start in borders {
            while at < self.events.len() && self.events[at].yaw.to_degrees() < start {
                at += 1;
            }
            self.start_deg.push(start);
            self.first_event.push(at as u32);
        }
    }

    /// Number of ranges.
    pub fn len(&self) -> usize {
        self.start_deg.len()
    }

    /// End of a range, degrees; the last one ends at 360.
    pub fn end_deg(&self, range: usize) -> f64 {
        self.start_deg.get(range + 1).copied().unwrap_or(360.0)
    }

    /// The middle of a range, degrees.
    pub fn middle_deg(&self, range: usize) -> f64 {
        (self.start_deg[range] + self.end_deg(range)) * 0.5
    }

    /// The yaw bin of a range.
    pub fn bin(&self, range: usize) -> usize {
        ((self.middle_deg(range) / YAW_BIN_DEG) as usize).min(YAW_BINS - 1)
    }

    /// Triangles per range without the cells in `culled`. Arcs are widened beyond what is visible,
    /// so that the cells of a range's inside are those of its borders too.
    pub fn count(&self, cells: &Cells, culled: &CellMask) -> Vec<u64> {
        let weight = |cell: u32| if culled.has(cell) { 0 } else { i64::from(cells.triangles[cell as usize]) };
        let mut now: i64 = self.arcs.iter().filter(|(a, _)| a.contains(0.0)).map(|(_, c)| weight(*c)).sum();
        // An arc that starts at exactly 0 is counted above already.
        let mut out = Vec::with_capacity(self.len());
        for range in 0..self.len() {
            let from = self.first_event[range] as usize;
            let to = self.first_event.get(range + 1).map_or(self.events.len(), |e| *e as usize);
            for e in &self.events[from..to] {
                if e.enters {
                    now += if e.yaw == 0.0 { 0 } else { weight(e.cell) };
                } else {
                    now -= weight(e.cell);
                }
            }
            out.push(now.max(0) as u64);
        }
        out
    }

    /// The cells visible anywhere in a range, ascending.
    pub fn visible(&self, range: usize) -> Vec<u32> {
        let middle = self.middle_deg(range).to_radians();
        let mut out: Vec<u32> = self.arcs.iter().filter(|(a, _)| a.contains(middle)).map(|(_, c)| *c).collect();
        out.sort_unstable();
        out.dedup();
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::test_scenes::Random;
    use glam::DVec3;
    use ldi_protocol::{ViewBasis, camera::Frustum};

    const T: f64 = 0.577_350_269_189_625_8;

    #[test]
    fn counts_bound_what_any_direction_draws_and_equal_their_cells() {
        let mut random = Random::new(3);
        let (mut bounds, mut triangles) = (Vec::new(), Vec::new());
        for i in 0..300 {
            let min =
                DVec3::new(random.unit(), random.unit() * 0.3, random.unit()) * 40.0 - DVec3::new(20.0, 6.0, 20.0);
            bounds.push(Aabb { min, max: min + DVec3::new(random.unit(), random.unit(), random.unit()) * 5.0 });
            triangles.push(100 + i);
        }
        let cells = Cells::new(bounds, triangles);
        let band = [-15.0, -5.0];
        let eyes = Aabb { min: DVec3::splat(-1.0), max: DVec3::new(1.0, 0.5, 2.0) };
        let view = BandView::new(&cells, &BandPlanes::new(band, T), &eyes);
        let culled: Vec<u32> = (0..300).step_by(3).collect();
        let set = CellMask::of(300, &culled);
        let counts = view.count(&cells, &set);
        for range in 0..view.len() {
            let sum = |skip: &CellMask| -> u64 {
                view.visible(range)
                    .iter()
                    .filter(|c| !skip.has(**c))
                    .map(|c| u64::from(cells.triangles[*c as usize]))
                    .sum()
            };
            assert_eq!((counts[range], view.triangles[range]), (sum(&set), sum(&CellMask::default())), "range {range}");
        }
        for _ in 0..3000 {
            let (yaw, pitch) = (random.unit() * 360.0, band[0] + random.unit() * 10.0);
            let range = view.start_deg.partition_point(|s| *s <= yaw) - 1;
            let eye = eyes.min + eyes.size() * DVec3::new(random.unit(), random.unit(), random.unit());
            let frustum = Frustum::new(eye, &ViewBasis::from_yaw_pitch(yaw, pitch), T, T);
            let drawn: u64 = (0..300)
                .filter(|c| frustum.may_intersect(&cells.bounds[*c]))
                .map(|c| u64::from(cells.triangles[c]))
                .sum();
            assert!(drawn <= view.triangles[range], "{drawn} drawn, {} counted", view.triangles[range]);
        }
    }
}
