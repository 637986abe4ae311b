//! The octree's cells as this stage needs them.
//!
//! Cells come in Morton order, so a run of them is compact: what lies wholly in or out of view is
//! decided for runs of 16, 256, 4,096 ... cells at once.

use super::{
    arcs::{ArcSet, BandPlanes},
    bin_planes::{Behind, BinPlanes},
    cell_mask::CellMask,
};
use crate::levels::{Level, Levels};
use crate::octree::{Cell, Octree};
use glam::DVec3;
use ldi_protocol::Aabb;
use std::{ops::Range, sync::Arc};

/// Cells in a run of the lowest level, and runs of a level in one of the next, as a power of 2.
const RUN_BITS: usize = 4;

/// Cells as this stage needs them.
#[derive(Debug, Clone, Default)]
pub(super) struct Cells {
    /// World bounds.
    pub bounds: Vec<Aabb>,
    /// Triangles, instances counted.
    pub triangles: Vec<u32>,
    /// Runs of 16 cells, of 256, and so on; the last level is a single one.
    runs: Vec<Runs>,
    /// Triangles of the runs, no cell at a level of detail.
    full: RunSums,
    /// Levels of detail; empty without any.
    detail: Detail,
}

/// At which distances cells are drawn with fewer triangles.
#[derive(Debug, Clone, Default)]
struct Detail {
    /// Where the steps of each cell begin, and where the last ones end.
    first: Vec<u32>,
    /// (distance of the nearest eye from which on, metres, squared; triangles), near to far.
    steps: Vec<(f64, u32)>,
}

/// An eye may be this much nearer to a cell than the box of eyes that it was planned in, metres:
/// rounding, on both sides.
const NEARER_M: f64 = 1e-5;

/// Triangles of every run of cells as the eyes of a box draw them at most, per level of runs.
#[derive(Debug, Clone, Default)]
pub(super) struct RunSums(Arc<Vec<Vec<u64>>>);

impl RunSums {
    fn new(cells: impl Iterator<Item = u32>) -> Self {
        let mut below: Vec<u64> = cells.map(u64::from).collect();
        let mut levels = Vec::new();
        while levels.is_empty() || below.len() > 1 {
            below = below.chunks(1 << RUN_BITS).map(|run| run.iter().sum()).collect();
            levels.push(below.clone());
        }
        Self(Arc::new(levels))
    }

    /// A key that sums and their clones share, and no others that exist.
    pub fn key(&self) -> usize {
        Arc::as_ptr(&self.0) as usize
    }
}

/// The eyes of a box, which look in the directions of a bin.
#[derive(Debug, Clone, Copy)]
pub(super) struct Eyes<'a> {
    pub planes: &'a BinPlanes,
    pub eyes: &'a Aabb,
    /// Of these eyes or of a box around them: that counts more, but need not be made for every
    /// part of a box.
    pub sums: &'a RunSums,
}

/// A run of cells that some frames may show.
enum Found {
    /// All frames show all its cells.
    Run { triangles: u64 },
    /// The bits of cells of a run of the lowest level: all frames show those of `always`, some may
    /// show those of `maybe`.
    Cells { run: usize, always: u64, maybe: u64 },
}

/// Runs of as many cells each.
#[derive(Debug, Clone)]
struct Runs {
    bounds: Vec<Aabb>,
    /// Surface of a run's cells, over that of its own bounds.
    fill: Vec<f64>,
}

/// A cell (level 0) or a run of cells.
type Node = (usize, usize);

/// What frames show of the cells, as far as it was looked at: what holds for the frames of a part
/// of their eyes and directions follows from it ([`Cells::narrow`]).
#[derive(Debug, Clone, Default)]
pub(super) struct Shown {
    /// A bound on the triangles of any of the frames, without what is still open.
    pub triangles: u64,
    /// Triangles of runs that all frames show.
    sure: u64,
    /// Other runs of the lowest level, each with the bits of its cells that all frames show, and of
    /// those that some may show.
    cells: Vec<(u32, u16, u16)>,
    /// Nodes whose cells were not looked at yet.
    open: Vec<Node>,
}

/// The lowest `n` bits, at most a run's.
#[inline(always)]
fn ones(n: usize) -> u64 {
    (1 << n) - 1
}

/// Half the surface of a box.
fn half_area(b: &Aabb) -> f64 {
    let s = b.size();
    s.x * s.y + s.y * s.z + s.z * s.x
}

impl Cells {
    /// Cells from their bounds and triangles, in the octree's order.
    pub fn new(bounds: Vec<Aabb>, triangles: Vec<u32>) -> Self {
        let full = RunSums::new(triangles.iter().copied());
        let mut runs: Vec<Runs> = Vec::new();
        loop {
            let below = runs.last().map_or(&bounds, |l| &l.bounds);
            if runs.last().is_some_and(|l| l.bounds.len() <= 1) {
                break;
            }
            let join = |run: &[Aabb]| run.iter().fold(Aabb::EMPTY, |a, b| a.union(*b));
            let of: Vec<Aabb> = below.chunks(1 << RUN_BITS).map(join).collect();
            let area = |(b, cells): (&Aabb, &[Aabb])| {
                cells.iter().map(half_area).sum::<f64>() / half_area(b).max(f64::MIN_POSITIVE)
            };
            let fill = of.iter().zip(bounds.chunks(1 << (RUN_BITS * (runs.len() + 1)))).map(area).collect();
            runs.push(Runs { bounds: of, fill });
        }
        Self { bounds, triangles, runs, full, detail: Detail::default() }
    }

    /// The cells of an octree, drawn at levels of detail with `deviation_per_metre` of distance.
    pub fn of_octree(octree: &Octree, levels: &Levels, deviation_per_metre: f64) -> Self {
        let of = |f: fn(&Cell) -> u32| octree.cells.iter().map(f).collect();
        let mut cells = Self::new(octree.cells.iter().map(|c| c.bounds).collect(), of(|c| c.triangles));
        let step = |l: &Level| ((l.deviation_m / deviation_per_metre + NEARER_M).powi(2), l.triangles);
        if deviation_per_metre > 0.0 && levels.cells.iter().any(|l| !l.is_empty()) {
            let mut detail = Detail { first: vec![0], steps: Vec::new() };
            for of_cell in &levels.cells {
                detail.steps.extend(of_cell.iter().map(step));
                detail.first.push(detail.steps.len() as u32);
            }
            cells.detail = detail;
        }
        cells
    }

    /// Most triangles with which any eye of a box draws a cell.
    #[inline(always)]
    fn triangles_from(&self, cell: usize, eyes: &Aabb) -> u32 {
        let full = self.triangles[cell];
        let Some(&[first, end]) = self.detail.first.get(cell..cell + 2).and_then(|r| r.first_chunk::<2>()) else {
            return full;
        };
        if first == end {
            return full;
        }
        let b = &self.bounds[cell];
        let apart = (b.min - eyes.max).max(eyes.min - b.max).max(DVec3::ZERO).length_squared();
        let steps = &self.detail.steps[first as usize..end as usize];
        steps.iter().take_while(|s| s.0 <= apart).last().map_or(full, |s| s.1)
    }

    /// Most triangles with which any eye of a box draws each run of cells. A pass over all cells:
    /// for many counts.
    pub fn sums_from(&self, eyes: &Aabb) -> RunSums {
        if self.detail.steps.is_empty() {
            return self.full.clone();
        }
        RunSums::new((0..self.bounds.len()).map(|c| self.triangles_from(c, eyes)))
    }

    /// The node that holds all cells, in a list of those to be looked at.
    fn root(&self) -> Vec<Node> {
        // Nodes of every level wait beside the one that is looked at.
        let mut open = Vec::with_capacity((self.runs.len() << RUN_BITS) + 1);
        if !self.bounds.is_empty() {
            open.push((self.runs.len(), 0));
        }
        open
    }

    #[inline(always)]
    fn bounds_of(&self, (level, number): Node) -> &Aabb {
        if level == 0 { &self.bounds[number] } else { &self.runs[level - 1].bounds[number] }
    }

    /// The cells of a node.
    #[inline(always)]
    fn cells_of(&self, (level, number): Node) -> Range<usize> {
        let bits = RUN_BITS * level;
        number << bits..((number + 1) << bits).min(self.bounds.len())
    }

    /// Adds the parts of a run so that the first is looked at first.
    #[inline(always)]
    fn open(&self, (level, number): Node, open: &mut Vec<Node>) {
        let below = if level == 1 { self.bounds.len() } else { self.runs[level - 2].bounds.len() };
        let parts = number << RUN_BITS..((number + 1) << RUN_BITS).min(below);
        open.extend(parts.rev().map(|part| (level - 1, part)));
    }

    /// Adds the cells that some eye in the box may draw in some direction of a bin to `out`.
    pub fn add_seen(&self, planes: &BinPlanes, eyes: &Aabb, out: &mut CellMask) {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide(cells: &Cells, planes: &BinPlanes, eyes: &Aabb, out: &mut CellMask) {
                cells.see(planes, eyes, out)
            }
            if std::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2.
                return unsafe { wide(self, planes, eyes, out) };
            }
        }
        self.see(planes, eyes, out)
    }

    /// [`Cells::add_seen`] with the vectors of whoever calls it. The same bits either way, as no
    /// operation is fused.
    #[inline(always)]
    fn see(&self, planes: &BinPlanes, eyes: &Aabb, out: &mut CellMask) {
        // No iterator's closures around the tests here and in `count_in`: they would be compiled
        // without the widest vectors.
        let mut open = self.root();
        while let Some(node) = open.pop() {
            let cells = self.cells_of(node);
            if out.has_all(cells.clone()) {
                continue;
            }
            match planes.show(eyes, self.bounds_of(node)) {
                Behind::Never => {}
                Behind::Maybe if node.0 > 1 => self.open(node, &mut open),
                Behind::Maybe => {
                    let mut bits = !out.bits_from(cells.start) & ones(cells.len());
                    while bits != 0 {
                        let cell = cells.start + bits.trailing_zeros() as usize;
                        bits &= bits - 1;
                        if planes.show(eyes, &self.bounds[cell]) != Behind::Never {
                            out.insert(cell as u32);
                        }
                    }
                }
                Behind::Always => out.insert_all(cells),
            }
        }
    }

    /// The empty set.
    pub fn none(&self) -> CellMask {
        CellMask::none(self.bounds.len())
    }

    /// The cells that touch a box.
    pub fn touching(&self, b: &Aabb) -> CellMask {
        let mut out = self.none();
        let mut open = self.root();
        while let Some(node) = open.pop() {
            let c = self.bounds_of(node);
            if c.min.cmple(b.max).all() && c.max.cmpge(b.min).all() {
                if node.0 == 0 {
                    out.insert(node.1 as u32);
                } else {
                    self.open(node, &mut open);
                }
            }
        }
        out
    }

    /// Triangles, at the levels of the nearest eye, of those cells `among` these (None: all) that
    /// some eye may draw; None if they are more than `most`.
    pub fn count(&self, seen_by: Eyes<'_>, among: Option<&CellMask>, most: u64) -> Option<u64> {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide(cells: &Cells, seen_by: Eyes<'_>, among: Option<&CellMask>, most: u64) -> Option<u64> {
                cells.count_in(seen_by, among, most)
            }
            if std::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2.
                return unsafe { wide(self, seen_by, among, most) };
            }
        }
        self.count_in(seen_by, among, most)
    }

    /// [`Cells::count`] with the vectors of whoever calls it.
    #[inline(always)]
    fn count_in(&self, seen_by: Eyes<'_>, among: Option<&CellMask>, most: u64) -> Option<u64> {
        let triangles = self.add_up(seen_by, among, most, &mut self.root(), 0, |_| ());
        (triangles <= most).then_some(triangles)
    }

    /// Adds up the triangles of what some eye may draw of the cells of the nodes `open` until
    /// they are more than `most`; what is left stays there. Returns their sum with `triangles`, and
    /// calls `found` for the runs that are shown.
    #[inline(always)]
    fn add_up(
        &self,
        Eyes { planes, eyes, sums }: Eyes<'_>,
        among: Option<&CellMask>,
        most: u64,
        open: &mut Vec<Node>,
        mut triangles: u64,
        mut found: impl FnMut(Found),
    ) -> u64 {
        while triangles <= most
            && let Some(node) = open.pop()
        {
            let cells = self.cells_of(node);
            if among.is_some_and(|a| !a.has_any(cells.clone())) {
                continue;
            }
            let behind = planes.show(eyes, self.bounds_of(node));
            let all = behind == Behind::Always;
            if behind == Behind::Never {
                continue;
            }
            if all && among.is_none_or(|a| a.has_all(cells.clone())) {
                let of_run = sums.0[node.0 - 1][node.1];
                found(Found::Run { triangles: of_run });
                triangles += of_run;
            } else if node.0 > 1 {
                self.open(node, open);
            } else {
                let held = among.map_or(u64::MAX, |a| a.bits_from(cells.start)) & ones(cells.len());
                let (always, maybe) = if all { (held, 0) } else { self.shown_of(planes, eyes, cells.start, held) };
                triangles += self.sum_of(cells.start, always | maybe, eyes);
                found(Found::Cells { run: node.1, always, maybe });
            }
        }
        triangles
    }

    /// Of the cells `bits` from `first` on those that every eye draws in all directions of a bin,
    /// and others that some eye may draw in some.
    #[inline(always)]
    fn shown_of(&self, planes: &BinPlanes, eyes: &Aabb, first: usize, mut bits: u64) -> (u64, u64) {
        let (mut always, mut maybe) = (0, 0);
        while bits != 0 {
            let bit = bits & bits.wrapping_neg();
            bits ^= bit;
            match planes.show(eyes, &self.bounds[first + bit.trailing_zeros() as usize]) {
                Behind::Never => {}
                Behind::Maybe => maybe |= bit,
                Behind::Always => always |= bit,
            }
        }
        (always, maybe)
    }

    /// Most triangles with which any eye of a box draws the cells `bits` from `first` on.
    #[inline(always)]
    fn sum_of(&self, first: usize, mut bits: u64, eyes: &Aabb) -> u64 {
        let mut triangles = 0;
        while bits != 0 {
            triangles += u64::from(self.triangles_from(first + bits.trailing_zeros() as usize, eyes));
            bits &= bits - 1;
        }
        triangles
    }

    /// Before anything was looked at: any of the cells may be shown.
    pub fn unknown(&self) -> Shown {
        Shown { open: self.root(), ..Shown::default() }
    }

    /// What frames show of the cells `among` these (None: all), given what `shown` says of frames
    /// that they are among: only what is not known of those is looked at. More than `most`
    /// triangles are not counted to the end.
    pub fn narrow(&self, seen_by: Eyes<'_>, among: Option<&CellMask>, shown: &Shown, most: u64) -> Shown {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide(cells: &Cells, seen_by: Eyes<'_>, among: Option<&CellMask>, shown: &Shown, most: u64) -> Shown {
                cells.narrow_in(seen_by, among, shown, most)
            }
            if std::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2.
                return unsafe { wide(self, seen_by, among, shown, most) };
            }
        }
        self.narrow_in(seen_by, among, shown, most)
    }

    /// [`Cells::narrow`] with the vectors of whoever calls it.
    #[inline(always)]
    fn narrow_in(&self, seen_by: Eyes<'_>, among: Option<&CellMask>, shown: &Shown, most: u64) -> Shown {
        let Eyes { planes, eyes, .. } = seen_by;
        let mut cells = Vec::with_capacity(shown.cells.len());
        let (mut triangles, mut sure) = (shown.sure, shown.sure);
        for (i, &(run, always, maybe)) in shown.cells.iter().enumerate() {
            if triangles > most {
                cells.extend_from_slice(&shown.cells[i..]);
                break;
            }
            let first = (run as usize) << RUN_BITS;
            let (more, maybe) = self.shown_of(planes, eyes, first, u64::from(maybe));
            let always = u64::from(always) | more;
            if always | maybe != 0 {
                triangles += self.sum_of(first, always | maybe, eyes);
                cells.push((run, always as u16, maybe as u16));
            }
        }
        let mut open = shown.open.clone();
        let found = |found: Found| match found {
            Found::Run { triangles } => sure += triangles,
            Found::Cells { always: 0, maybe: 0, .. } => {}
            Found::Cells { run, always, maybe } => cells.push((run as u32, always as u16, maybe as u16)),
        };
        let triangles = self.add_up(seen_by, among, most, &mut open, triangles, found);
        Shown { triangles, sure, cells, open }
    }

    /// Calls `found` with boxes around all cells `among` these, each with the surface of its cells
    /// over its own. Neighbouring cells come in one box where that is at most `compact` times as
    /// large as it is distant from the eye.
    pub fn compacted(&self, among: &CellMask, eye: DVec3, compact: f64, mut found: impl FnMut(&Aabb, f64)) {
        let mut open = self.root();
        while let Some(node) = open.pop() {
            let cells = self.cells_of(node);
            let held = among.count_in(cells.clone());
            let b = self.bounds_of(node);
            match node {
                _ if held == 0 => {}
                (0, _) => found(b, 1.0),
                (level, run) if held > 1 && b.size().max_element() <= compact * b.distance(eye) => {
                    // The cells of a run that are not among these count as like those that are.
                    found(b, self.runs[level - 1].fill[run] * f64::from(held) / cells.len() as f64);
                }
                _ => self.open(node, &mut open),
            }
        }
    }

    /// Calls `found` for every cell that some eye in the box may draw in the band, with its arcs
    /// of yaw, in ascending order.
    pub fn arcs(&self, planes: &BandPlanes, eyes: &Aabb, mut found: impl FnMut(u32, &ArcSet)) {
        let mut open = self.root();
        while let Some(node) = open.pop() {
            let b = self.bounds_of(node);
            let set = planes.arcs(b.min - eyes.max, b.max - eyes.min);
            match node {
                // Arcs only grow with the box.
                _ if set.arcs().is_empty() => {}
                (0, cell) => found(cell as u32, &set),
                _ => self.open(node, &mut open),
            }
        }
    }

    /// A bound on the triangles of the cells `among` these, by the sums of runs that hold any.
    pub fn sum_among(&self, among: &CellMask, sums: &RunSums) -> u64 {
        let mut triangles = 0;
        let mut open = self.root();
        while let Some(node) = open.pop() {
            let cells = self.cells_of(node);
            if !among.has_any(cells.clone()) {
                continue;
            }
            match node.0 {
                1 => triangles += sums.0[0][node.1],
                level if among.has_all(cells) => triangles += sums.0[level - 1][node.1],
                _ => self.open(node, &mut open),
            }
        }
        triangles
    }

    /// Sums the triangles of the cells for which `keep` holds; runs for which `may_keep` does not
    /// hold are skipped.
    pub fn sum(&self, may_keep: impl Fn(&Aabb) -> bool, keep: impl Fn(&Aabb) -> bool) -> u64 {
        let mut sum = 0;
        let mut open = self.root();
        while let Some(node) = open.pop() {
            match node {
                (0, cell) if keep(&self.bounds[cell]) => sum += u64::from(self.triangles[cell]),
                (0, _) => {}
                _ if may_keep(self.bounds_of(node)) => self.open(node, &mut open),
                _ => {}
            }
        }
        sum
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
            let mut set = cells.none();
            let planes = BinPlanes::new(yaw, pitch, T, T);
            cells.add_seen(&planes, &eyes, &mut set);
            let has = |c: usize| set.has(c as u32);
            let some: Vec<u32> = (0..700).filter(|_| random.unit() < 0.3).collect();
            let of_some: u64 =
                some.iter().filter(|c| set.has(**c)).map(|c| u64::from(cells.triangles[*c as usize])).sum();
            let mask = CellMask::of(700, &some);
            let seen_by = Eyes { planes: &planes, eyes: &eyes, sums: &cells.sums_from(&eyes) };
            let count = |among, most| cells.count(seen_by, among, most);
            assert_eq!(count(Some(&mask), of_some), Some(of_some));
            assert_eq!(count(Some(&mask), of_some.wrapping_sub(1)), (of_some == 0).then_some(0));
            let of_all = (0..700).filter(|c| has(*c)).map(|c| u64::from(cells.triangles[c])).sum::<u64>();
            assert_eq!(count(None, u64::MAX), Some(of_all));
            // What is there already stays, and hides nothing that is not.
            let mut more = mask.clone();
            cells.add_seen(&planes, &eyes, &mut more);
            assert!(more.iter().eq((0..700).filter(|c| set.has(*c) || mask.has(*c))));
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

    /// Whatever eye of a box draws at the levels that its own distances allow is no more than what
    /// was counted for the box, and the count is less than that of cells in full.
    #[test]
    fn no_eye_draws_more_than_what_was_counted_at_levels_of_detail() {
        const PER_METRE: f64 = 1e-3;
        let mut random = Random::new(6);
        let (mut octree, mut levels) = (Octree::default(), Levels::default());
        for i in 0..700u32 {
            let at =
                DVec3::new(f64::from(i % 26), random.unit(), f64::from(i / 26)) * 2.0 - DVec3::new(26.0, 3.0, 26.0);
            let bounds = Aabb { min: at, max: at + DVec3::new(random.unit(), random.unit(), random.unit()) * 3.0 };
            octree.cells.push(Cell { bounds, triangles: 400 + i, depth: 0, content: Vec::new() });
            // Levels from so many metres on.
            let level =
                |metres: f64, triangles| Level { deviation_m: metres * PER_METRE, triangles, content: Vec::new() };
            let first = 1.0 + 8.0 * random.unit();
            let of_cell = vec![level(first, 200 + i / 2), level(first * 2.0, 100), level(first * 2.5, 30)];
            levels.cells.push(of_cell.into_iter().take(i as usize % 4).collect());
        }
        let cells = Cells::of_octree(&octree, &levels, PER_METRE);
        let full = Cells::of_octree(&octree, &levels, 0.0);
        let eyes = Aabb { min: DVec3::splat(-1.0), max: DVec3::new(1.0, 0.5, 2.0) };
        let everything = CellMask::of(700, &(0..700).collect::<Vec<_>>());
        let directions = Directions::new(60.0);
        let (mut fewer, mut closest) = (0, 0.0f64);
        for unit in (0..directions.units()).step_by(5) {
            let (yaw, pitch) = directions.unit(unit);
            let planes = BinPlanes::new(yaw, pitch, T, T);
            let count = |cells: &Cells, around: &Aabb, among| {
                let seen_by = Eyes { planes: &planes, eyes: &eyes, sums: &cells.sums_from(around) };
                cells.count(seen_by, among, u64::MAX).expect("no more than most")
            };
            let counted = count(&cells, &eyes, None);
            let by_cell = (0..700)
                .filter(|c| planes.show(&eyes, &cells.bounds[*c]) != Behind::Never)
                .map(|c| u64::from(cells.triangles_from(c, &eyes)));
            assert_eq!(by_cell.sum::<u64>(), counted);
            assert_eq!(count(&cells, &eyes, Some(&everything)), counted);
            assert!(count(&cells, &Aabb { min: eyes.min - 1.0, max: eyes.max + 1.0 }, None) >= counted);
            fewer += usize::from(counted * 3 < count(&full, &eyes, None) * 2);
            for _ in 0..40 {
                let d = ViewBasis::from_yaw_pitch(yaw[0] + 10.0 * random.unit(), pitch[0] + 10.0 * random.unit());
                let eye = eyes.min + eyes.size() * DVec3::new(random.unit(), random.unit(), random.unit());
                let frustum = Frustum::new(eye, &d, T, T);
                let drawn: u64 = octree
                    .cells
                    .iter()
                    .zip(&levels.cells)
                    .filter(|(c, _)| frustum.may_intersect(&c.bounds))
                    .map(|(c, levels)| {
                        let allowed = |l: &&Level| l.deviation_m <= c.bounds.distance(eye) * PER_METRE;
                        u64::from(levels.iter().take_while(allowed).last().map_or(c.triangles, |l| l.triangles))
                    })
                    .sum();
                assert!(drawn <= counted, "unit {unit}: {drawn} drawn, {counted} counted");
                closest = closest.max(drawn as f64 / counted as f64);
            }
        }
        assert!(fewer > 20 && closest > 0.5, "{fewer} units, at most {closest} of what was counted");
    }

    #[test]
    fn cells_that_touch_a_box_are_those_that_are_beyond_none_of_its_faces() {
        let mut random = Random::new(4);
        let mut vector = |scale: f64| DVec3::new(random.unit(), random.unit(), random.unit()) * scale;
        let bounds: Vec<Aabb> = (0..500).map(|_| vector(20.0)).map(|min| Aabb { min, max: min + 1.5 }).collect();
        let cells = Cells::new(bounds.clone(), vec![1; 500]);
        for _ in 0..50 {
            let min = vector(15.0);
            let b = Aabb { min, max: min + vector(8.0) };
            let beyond = |c: &Aabb| c.min.cmpgt(b.max).any() || c.max.cmplt(b.min).any();
            let want: Vec<u32> = (0..500).filter(|c| !beyond(&bounds[*c as usize])).collect();
            assert_eq!(cells.touching(&b).iter().collect::<Vec<_>>(), want);
        }
    }
}
