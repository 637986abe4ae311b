//! The walk volume: where eyes may be. What every promise of a dataset is made for.
//!
//! By definition an eye is in the volume if the first surface below it lies between eye height -
//! 0.5 m and eye height + 0.4 m down and it keeps 0.05 m from surfaces, or, for flying, if it is
//! in the scene's box. What is stored is a superset made of upright boxes: columns on a square
//! grid, each with runs of layers. The build certifies exactly this superset, so that a pose for
//! which [`WalkVolume::contains`] holds has every guarantee.
//!
//! ```text
//!   layer  ^          ██    <- run (first, end) of column (i, k)
//!          |   ████   ██       x in origin.x + i pitch .. + pitch, cut to `bounds`
//!          |   ████   ██       y in origin.y + first layer_m .. origin.y + end layer_m
//!          +------------------> column, row-major: k * columns_x + i
//! ```

use crate::Aabb;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Upright boxes that together hold every allowed eye. Sparse: only columns with eyes are stored,
/// row by row, so that a wide scene costs what its walkable places cost. Serialized in a packed
/// form (about three bytes per column).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(into = "Packed", try_from = "Packed")]
pub struct WalkVolume {
    /// Horizontal cut and the smallest and largest height in use. Empty when there is no eye.
    bounds: Aabb,
    /// Smallest corner of column (0, 0), layer 0.
    origin: DVec3,
    /// Edge of a column, metres.
    pitch_m: f64,
    /// Height of a layer, metres.
    layer_m: f64,
    /// Columns along x and z.
    columns: [u32; 2],
    /// Per row (along z) the position of its first stored column, and one more: the number of
    /// stored columns.
    first_column: Vec<u32>,
    /// Place of each stored column along x, ascending within a row.
    column_x: Vec<u32>,
    /// Per stored column the position of its first run, and one more: the number of runs.
    first_run: Vec<u32>,
    /// First layer and the one after the last; ascending and disjoint within a column.
    runs: Vec<[u16; 2]>,
}

/// The runs of one column of a [`WalkVolume`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColumnRuns {
    /// Place along x and z.
    pub place: [u32; 2],
    /// First layer and the one after the last; ascending and disjoint.
    pub runs: Vec<[u16; 2]>,
}

/// Why a stored walk volume was refused.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("walk volume: {0}; the manifest is damaged, build or fetch the dataset again")]
pub struct VolumeError(&'static str);

impl WalkVolume {
    /// Most columns with eyes: bounds the memory that a manifest can ask for.
    pub const MAX_COLUMNS: u64 = 1 << 23;
    /// Most columns along x and along z.
    pub const MAX_SIDE: u32 = 1 << 20;
    /// Most runs of layers.
    pub const MAX_RUNS: u64 = 1 << 23;

    /// A volume from runs per column (ascending, disjoint, `first < end`), row-major over
    /// `columns`. `cut` limits x and z.
    pub fn new(
        origin: DVec3,
        pitch_m: f64,
        layer_m: f64,
        columns: [u32; 2],
        runs_of_column: &[Vec<[u16; 2]>],
        cut: &Aabb,
    ) -> Result<Self, VolumeError> {
        if runs_of_column.len() as u64 != u64::from(columns[0]) * u64::from(columns[1]) {
            return Err(VolumeError("number of columns out of range"));
        }
        let places = (0..columns[1]).flat_map(|k| (0..columns[0]).map(move |i| [i, k]));
        let stored = places.zip(runs_of_column).map(|(place, runs)| ColumnRuns { place, runs: runs.clone() });
        Self::of_columns(origin, pitch_m, layer_m, columns, stored, cut)
    }

    /// A volume from columns in the order of rows (z, then x), each at most once; those without
    /// runs are left out.
    pub fn of_columns(
        origin: DVec3,
        pitch_m: f64,
        layer_m: f64,
        columns: [u32; 2],
        stored: impl IntoIterator<Item = ColumnRuns>,
        cut: &Aabb,
    ) -> Result<Self, VolumeError> {
        let mut rows = Rows::default();
        for column in stored.into_iter().filter(|c| !c.runs.is_empty()) {
            rows.push(column.place, &column.runs);
        }
        let Rows { mut first_column, column_x, mut first_run, runs, .. } = rows;
        if first_column.len() > columns[1] as usize || columns.iter().any(|n| *n > Self::MAX_SIDE) {
            return Err(VolumeError("number of columns out of range"));
        }
        first_column.resize(columns[1] as usize + 1, column_x.len() as u32);
        first_run.push(runs.len() as u32);
        let low = runs.iter().map(|r| r[0]).min().map_or(f64::INFINITY, |l| origin.y + f64::from(l) * layer_m);
        let high = runs.iter().map(|r| r[1]).max().map_or(f64::NEG_INFINITY, |l| origin.y + f64::from(l) * layer_m);
        let bounds = Aabb { min: DVec3::new(cut.min.x, low, cut.min.z), max: DVec3::new(cut.max.x, high, cut.max.z) };
        Self { bounds, origin, pitch_m, layer_m, columns, first_column, column_x, first_run, runs }.checked()
    }

    /// The volume that is one box: flying.
    pub fn of_box(b: &Aabb) -> Result<Self, VolumeError> {
        const LAYERS: u16 = 1000;
        let size = b.size();
        Self::new(
            b.min,
            size.x.max(size.z).max(1e-3) * (1.0 + 1e-9),
            size.y.max(1e-3) / f64::from(LAYERS),
            [1, 1],
            &[vec![[0, LAYERS]]],
            b,
        )
    }

    /// Box around all eyes.
    pub fn bounds(&self) -> &Aabb {
        &self.bounds
    }

    /// Whether there is no eye at all.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    /// Whether an eye may be here.
    pub fn contains(&self, p: DVec3) -> bool {
        if !self.bounds.contains(p) {
            return false;
        }
        let (i, k) = self.column_at(p.x, p.z);
        let layer = (p.y - self.origin.y) / self.layer_m;
        self.runs_of(i, k).iter().any(|r| layer >= f64::from(r[0]) && layer <= f64::from(r[1]))
    }

    /// Heights that eyes may have at (x, z): pairs of the lowest and the highest, metres,
    /// ascending and disjoint. None outside.
    pub fn heights(&self, x: f64, z: f64) -> impl Iterator<Item = [f64; 2]> + '_ {
        let b = &self.bounds;
        let inside = (b.min.x..=b.max.x).contains(&x) && (b.min.z..=b.max.z).contains(&z);
        let (i, k) = self.column_at(x, z);
        let runs = if inside { self.runs_of(i, k) } else { &[] };
        runs.iter().map(|r| r.map(|layer| self.origin.y + f64::from(layer) * self.layer_m))
    }

    /// Edge of a column, metres.
    pub fn pitch_m(&self) -> f64 {
        self.pitch_m
    }

    /// Smallest x and z of column (0, 0), metres: columns are `pitch_m` apart from there.
    pub fn corner(&self) -> [f64; 2] {
        [self.origin.x, self.origin.z]
    }

    /// The column over (x, z), or the nearest one.
    fn column_at(&self, x: f64, z: f64) -> (u32, u32) {
        let cell = |v: f64, n: u32| ((v / self.pitch_m).floor().max(0.0) as u32).min(n - 1);
        (cell(x - self.origin.x, self.columns[0]), cell(z - self.origin.z, self.columns[1]))
    }

    /// The runs of a column.
    fn runs_of(&self, i: u32, k: u32) -> &[[u16; 2]] {
        let row = self.first_column[k as usize] as usize..self.first_column[k as usize + 1] as usize;
        match self.column_x[row.clone()].binary_search(&i) {
            Ok(at) => self.runs_at(row.start + at),
            Err(_) => &[],
        }
    }

    /// The runs of a stored column, by its position.
    fn runs_at(&self, column: usize) -> &[[u16; 2]] {
        &self.runs[self.first_run[column] as usize..self.first_run[column + 1] as usize]
    }

    /// Places of the stored columns along x and z, in order.
    fn places(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        self.first_column
            .windows(2)
            .zip(0..)
            .flat_map(|(row, k)| self.column_x[row[0] as usize..row[1] as usize].iter().map(move |i| [*i, k]))
    }

    /// All boxes, column by column in the order of rows.
    pub fn boxes(&self) -> impl Iterator<Item = Aabb> + '_ {
        self.places().zip(0..).flat_map(move |([i, k], column)| {
            let x = self.origin.x + f64::from(i) * self.pitch_m;
            let z = self.origin.z + f64::from(k) * self.pitch_m;
            self.runs_at(column).iter().map(move |r| Aabb {
                min: DVec3::new(
                    x.max(self.bounds.min.x),
                    self.origin.y + f64::from(r[0]) * self.layer_m,
                    z.max(self.bounds.min.z),
                ),
                max: DVec3::new(
                    (x + self.pitch_m).min(self.bounds.max.x),
                    self.origin.y + f64::from(r[1]) * self.layer_m,
                    (z + self.pitch_m).min(self.bounds.max.z),
                ),
            })
        })
    }

    /// The same with some of its boxes only: those whose position among [`WalkVolume::boxes`]
    /// `keep` takes.
    #[must_use]
    pub fn only(&self, keep: impl Fn(usize) -> bool) -> Self {
        let mut rows = Rows::default();
        for (place, column) in self.places().zip(0..) {
            let first = self.first_run[column] as usize;
            let of_column = self.runs_at(column).iter().enumerate();
            let kept: Vec<[u16; 2]> = of_column.filter(|(n, _)| keep(first + n)).map(|(_, run)| *run).collect();
            if !kept.is_empty() {
                rows.push(place, &kept);
            }
        }
        let Rows { mut first_column, column_x, mut first_run, runs, .. } = rows;
        first_column.resize(self.first_column.len(), column_x.len() as u32);
        first_run.push(runs.len() as u32);
        Self { first_column, column_x, first_run, runs, ..self.clone() }
    }

    /// Draws points uniformly over the volume.
    pub fn sampler(&self) -> VolumeSampler {
        let mut total = 0.0;
        let (mut boxes, mut cumulated) = (Vec::new(), Vec::new());
        for b in self.boxes() {
            total += b.size().max(DVec3::splat(1e-9)).element_product();
            boxes.push(b);
            cumulated.push(total);
        }
        VolumeSampler { boxes, cumulated }
    }

    /// Checks what the rest of this file relies on.
    fn checked(self) -> Result<Self, VolumeError> {
        let fail = |what| Err(VolumeError(what));
        if self.columns.iter().any(|n| !(1..=Self::MAX_SIDE).contains(n))
            || self.column_x.len() as u64 > Self::MAX_COLUMNS
            || self.first_column.len() != self.columns[1] as usize + 1
            || self.first_column.last().copied() != Some(self.column_x.len() as u32)
            || self.first_run.len() != self.column_x.len() + 1
        {
            return fail("number of columns out of range");
        }
        if !(self.pitch_m > 0.0 && self.layer_m > 0.0 && self.pitch_m.is_finite() && self.layer_m.is_finite())
            || !self.origin.is_finite()
        {
            return fail("pitch, layer height or origin out of range");
        }
        if self.runs.len() as u64 > Self::MAX_RUNS || self.first_run.last().copied() != Some(self.runs.len() as u32) {
            return fail("number of runs out of range");
        }
        if self.first_column.windows(2).any(|row| row[0] > row[1]) {
            return fail("rows out of order");
        }
        let row = |w: &[u32]| &self.column_x[w[0] as usize..w[1] as usize];
        let unsorted = |w: &[u32]| row(w).windows(2).any(|x| x[0] >= x[1]);
        if self.first_column.windows(2).any(|w| unsorted(w) || row(w).last().is_some_and(|x| *x >= self.columns[0])) {
            return fail("columns out of order");
        }
        if self.first_run.windows(2).any(|w| w[0] > w[1]) || self.runs.iter().any(|r| r[0] >= r[1]) {
            return fail("runs out of order");
        }
        if !self.runs.is_empty() && !(self.bounds.min.is_finite() && self.bounds.max.is_finite()) {
            return fail("bounds not finite");
        }
        Ok(self)
    }
}

/// Columns as they are stored, while they are gathered.
#[derive(Default)]
struct Rows {
    first_column: Vec<u32>,
    column_x: Vec<u32>,
    first_run: Vec<u32>,
    runs: Vec<[u16; 2]>,
}

impl Rows {
    /// Adds the next column in the order of rows. One that is out of order is caught by
    /// [`WalkVolume::checked`].
    fn push(&mut self, [i, k]: [u32; 2], runs: &[[u16; 2]]) {
        let rows = (k.min(WalkVolume::MAX_SIDE) as usize + 1).max(self.first_column.len());
        self.first_column.resize(rows, self.column_x.len() as u32);
        self.column_x.push(i);
        self.first_run.push(self.runs.len() as u32);
        self.runs.extend_from_slice(runs);
    }
}

/// Draws eyes from a [`WalkVolume`]; see [`WalkVolume::sampler`].
#[derive(Debug, Clone)]
pub struct VolumeSampler {
    boxes: Vec<Aabb>,
    cumulated: Vec<f64>,
}

impl VolumeSampler {
    /// A point from four numbers in [0, 1); None when the volume is empty.
    pub fn point(&self, uniform: [f64; 4]) -> Option<DVec3> {
        let total = *self.cumulated.last()?;
        let at = self.cumulated.partition_point(|c| *c <= uniform[0] * total).min(self.boxes.len() - 1);
        let b = &self.boxes[at];
        Some(b.min + b.size() * DVec3::new(uniform[1], uniform[2], uniform[3]))
    }
}

/// The stored form: a header and one compressed stream of tokens.
#[derive(Serialize, Deserialize)]
struct Packed {
    bounds: Aabb,
    origin: DVec3,
    pitch_m: f64,
    layer_m: f64,
    columns: [u32; 2],
    /// Columns with eyes.
    stored: u64,
    runs: u64,
    /// zstd over LEB128 numbers in five planes: per row its number of columns; per column the gap
    /// along x before it; per column its number of runs; per run the gap before it; per run its
    /// length.
    tokens: Vec<u8>,
}

fn put(out: &mut Vec<u8>, mut v: u32) {
    while v >= 0x80 {
        out.push(v as u8 | 0x80);
        v >>= 7;
    }
    out.push(v as u8);
}

fn take(bytes: &mut &[u8]) -> Option<u32> {
    let mut v = 0u32;
    for shift in (0..35).step_by(7) {
        let (&b, rest) = bytes.split_first()?;
        *bytes = rest;
        v |= u32::from(b & 0x7f).checked_shl(shift)?;
        if b < 0x80 {
            return Some(v);
        }
    }
    None
}

impl From<WalkVolume> for Packed {
    fn from(v: WalkVolume) -> Self {
        let [mut in_row, mut steps, mut counts, mut gaps, mut lengths] = [const { Vec::new() }; 5];
        for row in v.first_column.windows(2) {
            put(&mut in_row, row[1] - row[0]);
            let mut at = 0u32;
            for x in &v.column_x[row[0] as usize..row[1] as usize] {
                put(&mut steps, x - at);
                at = x + 1;
            }
        }
        for w in v.first_run.windows(2) {
            put(&mut counts, w[1] - w[0]);
            let mut at = 0u32;
            for r in &v.runs[w[0] as usize..w[1] as usize] {
                put(&mut gaps, u32::from(r[0]) - at);
                put(&mut lengths, u32::from(r[1] - r[0]));
                at = u32::from(r[1]);
            }
        }
        let raw = [in_row, steps, counts, gaps, lengths].concat();
        // Compression into memory cannot fail for want of space; an empty stream is refused on the
        // way back.
        let tokens = zstd::bulk::compress(&raw, 19).unwrap_or_default();
        Self {
            bounds: v.bounds,
            origin: v.origin,
            pitch_m: v.pitch_m,
            layer_m: v.layer_m,
            columns: v.columns,
            stored: v.column_x.len() as u64,
            runs: v.runs.len() as u64,
            tokens,
        }
    }
}

impl TryFrom<Packed> for WalkVolume {
    type Error = VolumeError;
    fn try_from(p: Packed) -> Result<Self, VolumeError> {
        let [_, rows] = p.columns;
        if p.columns.iter().any(|n| !(1..=Self::MAX_SIDE).contains(n))
            || p.stored > Self::MAX_COLUMNS
            || p.runs > Self::MAX_RUNS
        {
            return Err(VolumeError("number of columns or runs out of range"));
        }
        // A number takes at most 5 bytes; gaps and lengths of runs at most 3.
        let most = u64::from(rows) * 5 + p.stored * 10 + p.runs * 6;
        let raw = zstd::bulk::decompress(&p.tokens, most as usize)
            .map_err(|_| VolumeError("the token stream does not decompress"))?;
        let mut rest = raw.as_slice();
        // Planes stay encoded: as vectors of numbers they would take several times the volume.
        let mut plane = |n: u64| -> Result<Plane<'_>, VolumeError> {
            let whole = rest;
            for _ in 0..n {
                take(&mut rest).ok_or(VolumeError("the token stream ends too early"))?;
            }
            Ok(Plane(&whole[..whole.len() - rest.len()]))
        };
        let first_column = ends(plane(u64::from(rows))?, rows as usize, p.stored)?;
        let mut steps = plane(p.stored)?;
        let first_run = ends(plane(p.stored)?, p.stored as usize, p.runs)?;
        let (mut gaps, mut lengths) = (plane(p.runs)?, plane(p.runs)?);
        if !rest.is_empty() {
            return Err(VolumeError("the token stream is too long"));
        }
        let mut column_x = Vec::with_capacity(p.stored as usize);
        for row in first_column.windows(2) {
            let mut at = 0u32;
            for step in steps.by_ref().take((row[1] - row[0]) as usize) {
                column_x.push(at.saturating_add(step));
                at = at.saturating_add(step).saturating_add(1);
            }
        }
        let mut runs = Vec::with_capacity(p.runs as usize);
        for w in first_run.windows(2) {
            let mut at = 0u32;
            for (gap, length) in gaps.by_ref().zip(lengths.by_ref()).take((w[1] - w[0]) as usize) {
                let first = at.saturating_add(gap);
                let end = first.saturating_add(length);
                let (Ok(first), Ok(end)) = (u16::try_from(first), u16::try_from(end)) else {
                    return Err(VolumeError("a run lies outside the layers"));
                };
                runs.push([first, end]);
                at = u32::from(end);
            }
        }
        Self {
            bounds: p.bounds,
            origin: p.origin,
            pitch_m: p.pitch_m,
            layer_m: p.layer_m,
            columns: p.columns,
            first_column,
            column_x,
            first_run,
            runs,
        }
        .checked()
    }
}

/// Numbers of the token stream that were found to be whole.
struct Plane<'a>(&'a [u8]);

impl Iterator for Plane<'_> {
    type Item = u32;
    fn next(&mut self) -> Option<u32> {
        take(&mut self.0)
    }
}

/// Positions where each of `parts` parts begins, and the end of the last, which must be `total`.
fn ends(counts: Plane<'_>, parts: usize, total: u64) -> Result<Vec<u32>, VolumeError> {
    let mut out = Vec::with_capacity(parts + 1);
    let mut at = 0u64;
    out.push(0);
    for n in counts {
        at += u64::from(n);
        if at > total {
            return Err(VolumeError("more columns or runs than announced"));
        }
        out.push(at as u32);
    }
    if at == total { Ok(out) } else { Err(VolumeError("fewer columns or runs than announced")) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn volume(columns: [u32; 2], runs: &[Vec<[u16; 2]>]) -> WalkVolume {
        let cut = Aabb { min: DVec3::new(-1.0, 0.0, -2.0), max: DVec3::new(9.0, 0.0, 8.0) };
        WalkVolume::new(DVec3::new(-1.0, 3.0, -2.0), 0.5, 0.1, columns, runs, &cut).unwrap()
    }

    #[test]
    fn contains_is_the_union_of_the_boxes() {
        let v = volume([2, 1], &[vec![[0, 10], [20, 21]], vec![[5, 7]]]);
        assert!(v.contains(DVec3::new(-0.9, 3.5, -1.9)));
        assert!(v.contains(DVec3::new(-0.9, 5.05, -1.9)));
        assert!(!v.contains(DVec3::new(-0.9, 4.5, -1.9)));
        assert!(!v.contains(DVec3::new(-0.4, 3.1, -1.9)), "second column starts at layer 5");
        assert!(!v.contains(DVec3::new(-1.1, 3.5, -1.9)), "left of the cut");
        assert_eq!(v.boxes().count(), 3);
    }

    #[test]
    fn some_of_the_boxes_are_a_volume_too() {
        let v = volume([2, 2], &[vec![[0, 10], [20, 21]], vec![[5, 7]], vec![], vec![[1, 2]]]);
        let boxes: Vec<Aabb> = v.boxes().collect();
        for keep in 0..1u32 << boxes.len() {
            let some = v.only(|b| keep >> b & 1 == 1);
            let kept: Vec<Aabb> = boxes.iter().zip(0..).filter(|(_, b)| keep >> b & 1 == 1).map(|(b, _)| *b).collect();
            assert_eq!(some.boxes().collect::<Vec<_>>(), kept);
            assert_eq!(some.is_empty(), keep == 0);
            assert!(boxes.iter().zip(0..).all(|(b, n)| some.contains(b.centre()) == (keep >> n & 1 == 1)));
        }
    }

    #[test]
    fn heights_are_those_of_the_column() {
        let v = volume([2, 1], &[vec![[0, 10], [20, 21]], vec![[5, 7]]]);
        let at = |x, z| v.heights(x, z).map(|h| h.map(|y| (y * 10.0).round() as i32)).collect::<Vec<_>>();
        assert_eq!(at(-0.9, -1.9), [[30, 40], [50, 51]]);
        assert_eq!(at(-0.4, -1.9), [[35, 37]]);
        assert!(at(-1.1, -1.9).is_empty() && at(-0.9, -2.1).is_empty(), "outside of the cut");
    }

    #[test]
    fn a_flying_box_is_one_box() {
        let b = Aabb { min: DVec3::new(-3.0, 1.0, 2.0), max: DVec3::new(4.0, 2.0, 11.0) };
        let v = WalkVolume::of_box(&b).unwrap();
        assert!(v.contains(b.centre()) && v.contains(b.min) && !v.contains(b.max + 0.1));
    }

    proptest! {
        #[test]
        fn packing_loses_nothing(raw in prop::collection::vec(prop::collection::vec((0u16..2000, 1u16..300), 0..4), 6)) {
            let runs: Vec<Vec<[u16; 2]>> = raw.iter().map(|column| {
                let mut at = 0;
                column.iter().map(|(gap, n)| { let f = at + gap; at = f + n; [f, at] }).collect()
            }).collect();
            let v = volume([3, 2], &runs);
            let bytes = rmp_serde::to_vec(&v).unwrap();
            prop_assert_eq!(&rmp_serde::from_slice::<WalkVolume>(&bytes).unwrap(), &v);
        }

        #[test]
        fn samples_lie_inside(u in prop::array::uniform4(0.0f64..1.0)) {
            let v = volume([2, 1], &[vec![[0, 10], [20, 21]], vec![[5, 7]]]);
            prop_assert!(v.contains(v.sampler().point(u).unwrap()));
        }

        #[test]
        fn damaged_tokens_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let packed = Packed {
                bounds: Aabb::EMPTY, origin: DVec3::ZERO, pitch_m: 1.0, layer_m: 1.0, columns: [3, 3], stored: 5, runs: 4,
                tokens: zstd::bulk::compress(&bytes, 1).unwrap(),
            };
            let _ = WalkVolume::try_from(packed);
        }
    }
}
