//! The view-directions set of a grid point (Aliaga and Lastra 1999, section 3.3.1; row A5).
//!
//! In: a grid point, the cells, the bands of pitch in use. Out: per band the angular ranges of yaw over which the set of cells that
//! may be drawn stays the same, and the triangles of each. Ranges also end at the borders of yaw bins, so that each range lies in one
//! unit of the coverage certificate.

use super::{
    arcs::{Arc, ArcSet, BandPlanes},
    bands::{YAW_BIN_DEG, YAW_BINS},
    bin_planes::{Behind, BinPlanes},
};
use ldi_protocol::Aabb;

/// Neighbouring cells that are tested as one first. Cells come in Morton order, so a run of them is compact.
const GROUP: usize = 16;

/// Cells as this stage needs them.
#[derive(Debug, Clone, Default)]
pub(super) struct Cells {
    /// World bounds.
    pub bounds: Vec<Aabb>,
    /// Triangles, instances counted.
    pub triangles: Vec<u32>,
    /// Bounds of every [`GROUP`] cells.
    groups: Vec<Aabb>,
    /// Bounds of every [`GROUP`] groups.
    blocks: Vec<Aabb>,
    /// Triangles of the cells before each cell, and of all.
    before: Vec<u64>,
}

impl Cells {
    /// Cells from their bounds and triangles, in the octree's order.
    pub fn new(bounds: Vec<Aabb>, triangles: Vec<u32>) -> Self {
        let join =
            |b: &[Aabb]| b.chunks(GROUP).map(|g| g.iter().fold(Aabb::EMPTY, |a, b| a.union(*b))).collect::<Vec<_>>();
        let groups = join(&bounds);
        let blocks = join(&groups);
        let mut before = vec![0];
        triangles.iter().for_each(|t| before.push(before[before.len() - 1] + u64::from(*t)));
        Self { bounds, triangles, groups, blocks, before }
    }

    /// The cells that some eye in the box may draw in some direction of a bin, added to the bit set `out`; returns their triangles.
    /// Blocks and groups of cells that are wholly in or out of view are decided at once.
    pub fn seen(&self, planes: &BinPlanes, eyes: &Aabb, out: &mut [u64]) -> u64 {
        // Every plane keeps a cell for some eye exactly if it keeps the box of differences for an eye at the origin.
        let (middle, half) = (eyes.centre(), eyes.size() * 0.5);
        let test = |b: &Aabb| {
            let (w, h) = (b.centre() - middle, b.size() * 0.5 + half);
            planes.behind(w, h, (w.abs() + h).length())
        };
        let mut take = |from: usize, to: usize| {
            (from..to).for_each(|c| out[c / 64] |= 1 << (c % 64));
            self.before[to] - self.before[from]
        };
        let n = self.bounds.len();
        let mut triangles = 0;
        for (k, block) in self.blocks.iter().enumerate() {
            let first = k * GROUP;
            match test(block) {
                Behind::Never => {}
                Behind::Always => triangles += take(first * GROUP, ((first + GROUP) * GROUP).min(n)),
                Behind::Maybe => {
                    for (g, group) in self.groups[first..].iter().take(GROUP).enumerate() {
                        let first = (first + g) * GROUP;
                        match test(group) {
                            Behind::Never => {}
                            Behind::Always => triangles += take(first, (first + GROUP).min(n)),
                            Behind::Maybe => {
                                for c in first..(first + GROUP).min(n) {
                                    if test(&self.bounds[c]) != Behind::Never {
                                        triangles += take(c, c + 1);
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
        triangles
    }

    /// Calls `found` for every cell that some eye in the box may draw in the band, with its arcs of yaw, in ascending order.
    pub fn arcs(&self, planes: &BandPlanes, eyes: &Aabb, mut found: impl FnMut(u32, &ArcSet)) {
        for (g, group) in self.groups.iter().enumerate() {
            // Groups that the band cannot see at all are skipped: arcs only grow with the box.
            if planes.arcs(group.min - eyes.max, group.max - eyes.min).arcs().is_empty() {
                continue;
            }
            let first = g * GROUP;
            for (k, b) in self.bounds[first..].iter().take(GROUP).enumerate() {
                let set = planes.arcs(b.min - eyes.max, b.max - eyes.min);
                if !set.arcs().is_empty() {
                    found((first + k) as u32, &set);
                }
            }
        }
    }

    /// Sums the triangles of the cells for which `keep` holds; groups for which `may_keep` does not hold are skipped.
    pub fn sum(&self, may_keep: impl Fn(&Aabb) -> bool, keep: impl Fn(&Aabb) -> bool) -> u64 {
        let mut sum = 0;
        for (g, group) in self.groups.iter().enumerate() {
            if may_keep(group) {
                let first = g * GROUP;
                let cells = self.bounds[first..].iter().zip(&self.triangles[first..]).take(GROUP);
                sum += cells.filter(|(b, _)| keep(b)).map(|(_, t)| u64::from(*t)).sum::<u64>();
            }
        }
        sum
    }
}

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

/// A set of cells.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct CellSet {
    words: Vec<u64>,
}

impl CellSet {
    /// The set of these cells out of `n`.
    pub fn new(n: usize, cells: &[u32]) -> Self {
        let mut words = vec![0; n.div_ceil(64)];
        cells.iter().for_each(|c| words[*c as usize / 64] |= 1 << (c % 64));
        Self { words }
    }
    /// Whether a cell is in it.
    #[inline]
    pub fn has(&self, cell: u32) -> bool {
        self.words.get(cell as usize / 64).is_some_and(|w| w >> (cell % 64) & 1 == 1)
    }
}

impl BandView {
    /// The ranges over a band for frusta whose apexes lie in a box of eyes: a grid point in the paper's scheme, all users of a view
    /// cell in the other. A plane keeps a cell for some eye of the box exactly if it keeps, for an eye at the origin, the box of all
    /// differences between points of the cell and eyes.
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
        view.triangles = view.count(cells, &CellSet::default());
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

    /// Triangles per range without the cells in `culled`. Arcs are widened beyond what is visible, so that the cells of a range's inside
    /// are those of its borders too.
    pub fn count(&self, cells: &Cells, culled: &CellSet) -> Vec<u64> {
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
    use crate::placement::bands::Directions;
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
        let set = CellSet::new(300, &culled);
        let counts = view.count(&cells, &set);
        for range in 0..view.len() {
            let sum = |skip: &CellSet| -> u64 {
                view.visible(range)
                    .iter()
                    .filter(|c| !skip.has(**c))
                    .map(|c| u64::from(cells.triangles[*c as usize]))
                    .sum()
            };
            assert_eq!((counts[range], view.triangles[range]), (sum(&set), sum(&CellSet::default())), "range {range}");
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

    #[test]
    fn the_cells_of_a_bin_hold_all_that_any_eye_draws_in_any_of_its_directions() {
        let mut random = Random::new(11);
        let (mut bounds, mut triangles) = (Vec::new(), Vec::new());
        for i in 0..700u32 {
            // Rows of neighbours, as Morton order gives them, so that groups are compact.
            let at =
                DVec3::new(f64::from(i % 26), random.unit(), f64::from(i / 26)) * 2.0 - DVec3::new(26.0, 3.0, 26.0);
            bounds.push(Aabb { min: at, max: at + DVec3::new(random.unit(), random.unit(), random.unit()) * 3.0 });
            triangles.push(1 + i);
        }
        let cells = Cells::new(bounds, triangles);
        let eyes = Aabb { min: DVec3::splat(-1.0), max: DVec3::new(1.0, 0.5, 2.0) };
        let directions = Directions::new(60.0);
        for unit in (0..directions.units()).step_by(5) {
            let (yaw, pitch) = directions.unit(unit);
            let mut set = vec![0u64; 700usize.div_ceil(64)];
            let sum = cells.seen(&BinPlanes::new(yaw, pitch, T), &eyes, &mut set);
            let has = |c: usize| set[c / 64] >> (c % 64) & 1 == 1;
            assert_eq!(sum, (0..700).filter(|c| has(*c)).map(|c| u64::from(cells.triangles[c])).sum::<u64>());
            let mut drawn = 0;
            for _ in 0..40 {
                let d = ViewBasis::from_yaw_pitch(yaw[0] + 10.0 * random.unit(), pitch[0] + 10.0 * random.unit());
                let eye = eyes.min + eyes.size() * DVec3::new(random.unit(), random.unit(), random.unit());
                let frustum = Frustum::new(eye, &d, T, T);
                for c in (0..700).filter(|c| frustum.may_intersect(&cells.bounds[*c])) {
                    assert!(has(c), "unit {unit}, cell {c}");
                    drawn += 1;
                }
            }
            assert!(unit % 36 != 0 || drawn > 0 || pitch[0] > 20.0 || pitch[1] < -20.0);
        }
    }
}
