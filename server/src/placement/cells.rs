//! The octree's cells as this stage needs them, and sets of them.

use super::{
    arcs::{ArcSet, BandPlanes},
    bin_planes::{Behind, BinPlanes},
};
use glam::DVec3;
use ldi_protocol::Aabb;

/// Neighbouring cells that are tested as one first. Cells come in Morton order, so a run of them
/// is compact.
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
    /// Surface of the cells of each group and of each block, over that of its own bounds.
    fill: [Vec<f64>; 2],
    /// Triangles of the cells before each cell, and of all.
    before: Vec<u64>,
}

/// Half the surface of a box.
fn half_area(b: &Aabb) -> f64 {
    let s = b.size();
    s.x * s.y + s.y * s.z + s.z * s.x
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
        let fill = [(&groups, GROUP), (&blocks, GROUP * GROUP)].map(|(of, cells)| {
            let area = |(b, cells): (&Aabb, &[Aabb])| {
                cells.iter().map(half_area).sum::<f64>() / half_area(b).max(f64::MIN_POSITIVE)
            };
            of.iter().zip(bounds.chunks(cells)).map(area).collect()
        });
        Self { bounds, triangles, groups, blocks, fill, before }
    }

    /// The cells that some eye in the box may draw in some direction of a bin, added to `out`;
    /// returns their triangles. Blocks and groups of cells that are wholly in or out of view are
    /// decided at once.
    pub fn seen(&self, planes: &BinPlanes, eyes: &Aabb, out: &mut CellMask) -> u64 {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide(cells: &Cells, planes: &BinPlanes, eyes: &Aabb, out: &mut CellMask) -> u64 {
                cells.see(planes, eyes, out)
            }
            if std::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2.
                return unsafe { wide(self, planes, eyes, out) };
            }
        }
        self.see(planes, eyes, out)
    }

    /// [`Cells::seen`] with the vectors of whoever calls it. The same bits either way, as no
    /// operation is fused.
    #[inline(always)]
    fn see(&self, planes: &BinPlanes, eyes: &Aabb, out: &mut CellMask) -> u64 {
        let n = self.bounds.len();
        let mut triangles = 0;
        // No iterator's closures here and in `count_in`: they would be compiled without the widest
        // vectors.
        for (k, block) in self.blocks.iter().enumerate() {
            let first = k * GROUP;
            match planes.show(eyes, block) {
                Behind::Never => {}
                Behind::Always => triangles += self.take(first * GROUP, ((first + GROUP) * GROUP).min(n), out),
                Behind::Maybe => {
                    for g in first..(first + GROUP).min(self.groups.len()) {
                        let first = g * GROUP;
                        match planes.show(eyes, &self.groups[g]) {
                            Behind::Never => {}
                            Behind::Always => triangles += self.take(first, (first + GROUP).min(n), out),
                            Behind::Maybe => {
                                for c in first..(first + GROUP).min(n) {
                                    if planes.show(eyes, &self.bounds[c]) != Behind::Never {
                                        triangles += self.take(c, c + 1, out);
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

    /// Adds the cells `from .. to` to `out`; returns their triangles.
    fn take(&self, from: usize, to: usize, out: &mut CellMask) -> u64 {
        (from..to).for_each(|c| out.insert(c as u32));
        self.before[to] - self.before[from]
    }

    /// The empty set.
    pub fn none(&self) -> CellMask {
        CellMask { words: vec![0; self.bounds.len().div_ceil(64)] }
    }

    /// The cells that touch a box.
    pub fn touching(&self, b: &Aabb) -> CellMask {
        let mut out = self.none();
        let touches = |c: &Aabb| c.min.cmple(b.max).all() && c.max.cmpge(b.min).all();
        for (g, group) in self.groups.iter().enumerate() {
            if touches(group) {
                let first = g * GROUP;
                let cells = self.bounds[first..].iter().take(GROUP).enumerate();
                cells.filter(|(_, c)| touches(c)).for_each(|(k, _)| out.insert((first + k) as u32));
            }
        }
        out
    }

    /// Triangles of those cells `among` these that some eye in the box may draw in some direction
    /// of a bin.
    pub fn count(&self, planes: &BinPlanes, eyes: &Aabb, among: &CellMask) -> u64 {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide(cells: &Cells, planes: &BinPlanes, eyes: &Aabb, among: &CellMask) -> u64 {
                cells.count_in(planes, eyes, among)
            }
            if std::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2.
                return unsafe { wide(self, planes, eyes, among) };
            }
        }
        self.count_in(planes, eyes, among)
    }

    /// [`Cells::count`] with the vectors of whoever calls it.
    #[inline(always)]
    fn count_in(&self, planes: &BinPlanes, eyes: &Aabb, among: &CellMask) -> u64 {
        let mut triangles = 0;
        for (k, words) in among.words.chunks(GROUP * GROUP / 64).enumerate() {
            if words.iter().all(|w| *w == 0) || planes.show(eyes, &self.blocks[k]) == Behind::Never {
                continue;
            }
            for g in k * GROUP..((k + 1) * GROUP).min(self.groups.len()) {
                let mut bits = words.get(g % GROUP / 4).map_or(0, |w| w >> (g % 4 * GROUP) & 0xffff);
                if bits == 0 {
                    continue;
                }
                let verdict = planes.show(eyes, &self.groups[g]);
                while bits != 0 && verdict != Behind::Never {
                    let cell = g * GROUP + bits.trailing_zeros() as usize;
                    bits &= bits - 1;
                    if verdict == Behind::Always || planes.show(eyes, &self.bounds[cell]) != Behind::Never {
                        triangles += u64::from(self.triangles[cell]);
                    }
                }
            }
        }
        triangles
    }

    /// Calls `found` with boxes around all cells `among` these, each with the surface of its cells
    /// over its own. Neighbouring cells come in one box where that is at most `compact` times as
    /// large as it is distant from the eye.
    pub fn compacted(&self, among: &CellMask, eye: DVec3, compact: f64, mut found: impl FnMut(&Aabb, f64)) {
        let is_compact = |b: &Aabb| b.size().max_element() <= compact * b.distance(eye);
        // The cells of a group or block that are not among these count as like those that are.
        let share = |bits: u32, cells: usize| f64::from(bits) / cells as f64;
        for (k, words) in among.words.chunks(GROUP * GROUP / 64).enumerate() {
            let bits: u32 = words.iter().map(|w| w.count_ones()).sum();
            if bits == 0 {
                continue;
            }
            if is_compact(&self.blocks[k]) {
                let cells = (self.bounds.len() - k * GROUP * GROUP).min(GROUP * GROUP);
                found(&self.blocks[k], self.fill[1][k] * share(bits, cells));
                continue;
            }
            for g in k * GROUP..((k + 1) * GROUP).min(self.groups.len()) {
                let mut bits = words.get(g % GROUP / 4).map_or(0, |w| w >> (g % 4 * GROUP) & 0xffff);
                if bits.count_ones() > 1 && is_compact(&self.groups[g]) {
                    let cells = (self.bounds.len() - g * GROUP).min(GROUP);
                    found(&self.groups[g], self.fill[0][g] * share(bits.count_ones(), cells));
                    continue;
                }
                while bits != 0 {
                    found(&self.bounds[g * GROUP + bits.trailing_zeros() as usize], 1.0);
                    bits &= bits - 1;
                }
            }
        }
    }

    /// Calls `found` for every cell that some eye in the box may draw in the band, with its arcs
    /// of yaw, in ascending order.
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

    /// Sums the triangles of the cells for which `keep` holds; groups for which `may_keep` does
    /// not hold are skipped.
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

/// A set of cells.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct CellMask {
    words: Vec<u64>,
}

impl CellMask {
    /// The set of these cells out of `n`.
    pub fn of(n: usize, cells: &[u32]) -> Self {
        let mut out = Self { words: vec![0; n.div_ceil(64)] };
        cells.iter().for_each(|c| out.insert(*c));
        out
    }
    /// Adds a cell.
    #[inline]
    pub fn insert(&mut self, cell: u32) {
        self.words[cell as usize / 64] |= 1 << (cell % 64);
    }
    /// Whether a cell is in it.
    #[inline]
    pub fn has(&self, cell: u32) -> bool {
        self.words.get(cell as usize / 64).is_some_and(|w| w >> (cell % 64) & 1 == 1)
    }
    /// Takes all cells out.
    pub fn clear(&mut self) {
        self.words.fill(0);
    }
    /// Adds the cells of another set.
    pub fn add(&mut self, other: &Self) {
        self.words.iter_mut().zip(&other.words).for_each(|(a, b)| *a |= b);
    }
    /// Takes out the cells of another set.
    pub fn remove(&mut self, other: &Self) {
        self.words.iter_mut().zip(&other.words).for_each(|(a, b)| *a &= !b);
    }
    /// Number of its cells.
    pub fn count(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }
    /// Its cells, ascending.
    pub fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        self.words.iter().enumerate().flat_map(|(w, word)| {
            let mut bits = *word;
            std::iter::from_fn(move || {
                let bit = (bits != 0).then(|| bits.trailing_zeros())?;
                bits &= bits - 1;
                Some(w as u32 * 64 + bit)
            })
        })
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
            let sum = cells.seen(&planes, &eyes, &mut set);
            let has = |c: usize| set.has(c as u32);
            let some: Vec<u32> = (0..700).filter(|_| random.unit() < 0.3).collect();
            let of_some: u64 =
                some.iter().filter(|c| set.has(**c)).map(|c| u64::from(cells.triangles[*c as usize])).sum();
            assert_eq!(cells.count(&planes, &eyes, &CellMask::of(700, &some)), of_some);
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

    #[test]
    fn sets_add_and_remove() {
        let mut a = CellMask::of(200, &[1, 64, 199]);
        a.add(&CellMask::of(200, &[2, 64]));
        assert_eq!(a.iter().collect::<Vec<_>>(), [1, 2, 64, 199]);
        a.remove(&CellMask::of(200, &[2, 199]));
        assert_eq!(a.iter().collect::<Vec<_>>(), [1, 64]);
        a.clear();
        assert_eq!(a.iter().count(), 0);
    }
}
