//! What a construction camera would see that is known already: it need not be traced again.
//!
//! The central image knows more than its surfaces: everything in front of them is empty. Draw it
//! as seen from the construction camera as a closed skin: each sample as the piece of plane in its
//! pixel, each depth edge as the sheet that joins near to far.
//!
//! ```text
//!   C ────────────┐ near surface
//!        sheet →  │░░░░░░░░░░░░░░ unknown: hidden from C
//!   ──────────────┴──── far surface
//!   C' a ray that meets a surface first travelled through known emptiness only: explained.
//!      a ray that meets a sheet first enters the unknown: it is traced.
//! ```
//!
//! Tracing all of these would be exact and wasteful: mostly the surface or the sky behind the
//! sheet is what is seen. So of each block of 3 x 3 unexplained pixels the middle one is traced,
//! then, as long as rays bring something new, all around them ([`Unexplained::around`]); holes
//! whose block's middle is explained are traced at once. Where the middle saw sky, so do the
//! block's holes that nobody asked for. In later rounds a pixel counts as explained where the
//! surface behind the sheet is one that an earlier construction camera found.

use super::{
    sample::{Sample, Tolerance, bounded},
    sight::Open,
    view::{COARSENESS, ConstructionCamera, Rig, View, Window},
};
use std::ops::Range;

/// Cells of curved surfaces do not quite meet; they are drawn larger by this many pixels. Larger
/// hides thin holes, smaller traces rays into cracks.
const OVERLAP_PX: f32 = 0.15;
/// The central image with one sample in every cell of [`COARSENESS`] by [`COARSENESS`] pixels,
/// drawn instead of all: the cameras' own pixels are that large.
pub(super) struct Coarse {
    samples: Vec<Sample>,
    width: usize,
    /// Of each block of [`CELLS`] by [`CELLS`] cells, row-major: smallest and largest disparity
    /// that is drawn for them.
    ranges: Vec<[f32; 2]>,
}

/// Side of the blocks of cells that are drawn or skipped as one, cells. By judgement.
const CELLS: usize = 16;

impl Coarse {
    /// Takes the first sample of each cell, with its plane carried to the cell's middle.
    pub fn new(central: &[Sample], width: usize) -> Self {
        let rows = central.chunks_exact(width).step_by(COARSENESS);
        let to_middle = 0.5 * (COARSENESS - 1) as f32;
        let sample = |s: &Sample| {
            let change = to_middle * (s.gradient[0] + s.gradient[1]);
            let disparity = if s.disparity > 0.0 { bounded(s, change) } else { s.disparity };
            Sample { disparity, gradient: s.gradient.map(|g| g * COARSENESS as f32), ..*s }
        };
        let samples: Vec<Sample> = rows.flat_map(|r| r.iter().step_by(COARSENESS).map(sample)).collect();
        let width = width.div_ceil(COARSENESS);
        let ranges = Self::ranges(&samples, width);
        Self { samples, width, ranges }
    }

    /// Sheets join a cell to the next ones: those of the neighbouring blocks count too.
    fn ranges(samples: &[Sample], width: usize) -> Vec<[f32; 2]> {
        let height = samples.len() / width;
        let mut ranges = Vec::with_capacity(height.div_ceil(CELLS) * width.div_ceil(CELLS));
        for top in (0..height).step_by(CELLS) {
            for left in (0..width).step_by(CELLS) {
                let mut range = [f32::INFINITY, f32::NEG_INFINITY];
                for row in top..(top + CELLS + 1).min(height) {
                    for s in &samples[row * width + left..row * width + (left + CELLS + 1).min(width)] {
                        if s.disparity >= 0.0 {
                            let change = 0.5 * (s.gradient[0].abs() + s.gradient[1].abs());
                            let [low, high] =
                                if s.disparity > 0.0 { [-change, change].map(|c| bounded(s, c)) } else { [0.0; 2] };
                            range = [range[0].min(low), range[1].max(high)];
                        }
                    }
                }
                ranges.push(range);
            }
        }
        ranges
    }
}
/// A sheet begins at the surface's edge: held back by this factor so that the surface wins there.
const SHEET_BIAS: f32 = 1.0 - 1e-4;

/// What a construction camera knows of its pixels before it traces.
pub(super) struct Unexplained {
    /// What to trace first, ascending.
    pub first: Vec<u32>,
    /// Row-major; pixels that were handed out are [`State::Explained`].
    states: Vec<State>,
    width: usize,
}

/// Side of the blocks. Larger overlooks thin things behind thin occluders, smaller costs rays.
const BLOCK: usize = 3;

/// The pixels of the construction camera that have to be traced.
pub(super) fn unexplained(
    rig: &Rig,
    view: &View,
    known: (&[Sample], &Coarse, &[(u32, Sample)]),
    tolerance: &Tolerance,
) -> Unexplained {
    let width = view.camera.window.width as usize;
    let states = states(rig, view, known, tolerance);
    let first = first_pixels(&states, width);
    let mut found = Unexplained { first, states, width };
    for pixel in &found.first {
        found.states[*pixel as usize] = State::Explained;
    }
    found
}

/// What is known of every pixel, row-major; all is explained where the camera does not look.
pub(super) fn states(
    rig: &Rig,
    View { camera, open }: &View,
    (central, coarse, deeper): (&[Sample], &Coarse, &[(u32, Sample)]),
    tolerance: &Tolerance,
) -> Vec<State> {
    let pixels = camera.window.pixels();
    let mut skin = Skin { rig, camera, open: open.as_ref(), front: vec![0; pixels], surfaces: vec![0; pixels] };
    skin.draw_sky(central);
    skin.draw_known(coarse, deeper, tolerance);
    let width = camera.window.width as usize;
    let closed = |p: usize| open.as_ref().is_some_and(|o| !o.holds(p % width, p / width));
    (0..pixels).map(|p| if closed(p) { State::Explained } else { skin.state(p) }).collect()
}

/// The middles of blocks that are unexplained, and the holes of blocks whose middle is explained
/// or outside.
fn first_pixels(states: &[State], width: usize) -> Vec<u32> {
    let mut first = Vec::new();
    for (row, line) in states.chunks_exact(width).enumerate() {
        let middle_row = row / BLOCK * BLOCK + BLOCK / 2;
        let middles = states.get(middle_row * width..(middle_row + 1) * width);
        for (block, cells) in line.chunks(BLOCK).enumerate() {
            if cells.iter().all(|s| *s == State::Explained) {
                continue;
            }
            let middle_column = block * BLOCK + BLOCK / 2;
            let open = middles.and_then(|m| m.get(middle_column)).is_some_and(|s| *s != State::Explained);
            for (k, s) in cells.iter().enumerate() {
                let column = block * BLOCK + k;
                let is_middle = row == middle_row && column == middle_column;
                if *s != State::Explained && is_middle || *s == State::Hole && !open {
                    first.push((row * width + column) as u32);
                }
            }
        }
    }
    first
}

impl Unexplained {
    /// The pixels around those that brought something new, ascending; each is handed out once.
    pub fn around(&mut self, new: &[u32]) -> Vec<u32> {
        let mut next = Vec::new();
        for pixel in new {
            self.take(*pixel, BLOCK - 1, |s| s != State::Explained, &mut next);
        }
        next.sort_unstable();
        next
    }

    /// The holes never handed out around pixels that saw sky.
    pub fn holes_around(&mut self, sky: &[u32]) -> Vec<u32> {
        let mut holes = Vec::new();
        for pixel in sky {
            self.take(*pixel, BLOCK / 2, |s| s == State::Hole, &mut holes);
        }
        holes
    }

    fn take(&mut self, pixel: u32, reach: usize, wanted: impl Fn(State) -> bool, out: &mut Vec<u32>) {
        let height = self.states.len() / self.width;
        let (row, column) = (pixel as usize / self.width, pixel as usize % self.width);
        for r in row.saturating_sub(reach)..=(row + reach).min(height - 1) {
            for c in column.saturating_sub(reach)..=(column + reach).min(self.width - 1) {
                let i = r * self.width + c;
                if wanted(self.states[i]) {
                    self.states[i] = State::Explained;
                    out.push(i as u32);
                }
            }
        }
    }
}

/// What is known of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum State {
    /// A known surface or sky is what it sees.
    Explained,
    /// It enters the unknown, and no known surface lies beyond.
    Hole,
    /// It enters the unknown, and a known surface lies beyond.
    Doubtful,
}

/// Depth buffers of the skin. An entry is a disparity's bits (positive floats order like integers)
/// with the lowest bit replaced by a flag; 0 is nothing.
struct Skin<'a> {
    rig: &'a Rig,
    camera: &'a ConstructionCamera,
    /// Where the camera looks; None is everywhere.
    open: Option<&'a Open>,
    /// Nearest of the central surfaces, sky (flag 1), and sheets (flag 0).
    front: Vec<i32>,
    /// Nearest of all surfaces and sky, flag 1 if a deeper one.
    surfaces: Vec<i32>,
}

/// Sky in `surfaces`: farther than any surface, but not nothing; flag 0.
const SKY_BEHIND: i32 = 2;

/// What is drawn.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Central,
    Sheet,
}

/// A corner: pixel coordinates in the camera's window, and disparity from it.
type Corner = [f32; 3];

impl Skin<'_> {
    fn state(&self, pixel: usize) -> State {
        let (front, behind) = (self.front[pixel], self.surfaces[pixel]);
        let could_be_stored = || {
            let (u, v) = self.camera.centre(pixel);
            self.rig.may_hold(self.camera, u, v)
        };
        if front & 1 == 1 || behind & 1 == 1 {
            State::Explained
        } else if behind != 0 {
            State::Doubtful
        } else if front != 0 || could_be_stored() {
            State::Hole
        } else {
            State::Explained
        }
    }

    /// Sky keeps its directions.
    fn draw_sky(&mut self, central: &[Sample]) {
        let (w, c, scale) = (self.rig.window, self.camera.window, self.camera.scale);
        // The central column or row that holds the middle of each of the camera's.
        let place = |first: i32, n: u32, w_first: i32, w_n: u32| {
            let at =
                move |k: u32| (((f64::from(first) + f64::from(k) + 0.5) / scale).floor() as i64) - i64::from(w_first);
            (0..n).map(move |k| usize::try_from(at(k)).ok().filter(|x| *x < w_n as usize)).collect::<Vec<_>>()
        };
        let columns = place(c.left, c.width, w.left, w.width);
        let rows = place(c.top, c.height, w.top, w.height);
        let width = c.width as usize;
        let lines = self.front.chunks_exact_mut(width).zip(self.surfaces.chunks_exact_mut(width)).zip(rows);
        for ((front, behind), row) in lines {
            let Some(row) = row else { continue };
            let samples = &central[row * w.width as usize..(row + 1) * w.width as usize];
            for ((front, behind), column) in front.iter_mut().zip(behind).zip(&columns) {
                if column.is_some_and(|x| samples[x].disparity == 0.0) {
                    (*front, *behind) = (1, SKY_BEHIND);
                }
            }
        }
    }

    /// Draws the samples, with the widest vectors there are: long spans of sheets are half of the
    /// time. The same bits either way, as no operation is fused.
    fn draw_known(&mut self, central: &Coarse, deeper: &[(u32, Sample)], tolerance: &Tolerance) {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide(skin: &mut Skin<'_>, central: &Coarse, deeper: &[(u32, Sample)], tolerance: &Tolerance) {
                skin.draw_central(central, tolerance);
                skin.draw_deeper(deeper);
            }
            if std::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2.
                unsafe { wide(self, central, deeper, tolerance) };
                return;
            }
        }
        self.draw_central(central, tolerance);
        self.draw_deeper(deeper);
    }

    /// Block by block: what does not show where the camera looks is skipped.
    #[inline(always)]
    fn draw_central(&mut self, central: &Coarse, tolerance: &Tolerance) {
        let (width, height) = (central.width, central.samples.len() / central.width);
        let across = width.div_ceil(CELLS);
        for (block_row, ranges) in central.ranges.chunks_exact(across).enumerate() {
            let rows = block_row * CELLS..(block_row * CELLS + CELLS).min(height);
            let shows: Vec<bool> =
                ranges.iter().enumerate().map(|(c, r)| self.may_show(c * CELLS, rows.start, *r)).collect();
            // Neighbouring blocks are drawn as one.
            let mut first = 0;
            for run in shows.chunk_by(|a, b| a == b) {
                let columns = first * CELLS..((first + run.len()) * CELLS).min(width);
                if run[0] {
                    rows.clone().for_each(|row| self.draw_cells(central, row, columns.clone(), tolerance));
                }
                first += run.len();
            }
        }
    }

    /// Whether anything of a block of cells, with these disparities, may lie where the camera
    /// looks.
    #[inline(always)]
    fn may_show(&self, column: usize, row: usize, [low, high]: [f32; 2]) -> bool {
        if low > high {
            return false;
        }
        let (mut x, mut y) = ([f32::INFINITY, f32::NEG_INFINITY], [f32::INFINITY, f32::NEG_INFINITY]);
        // Linear in the place, monotonic in disparity: extremes are at corners.
        for d in [low, high] {
            for (c, r) in [(0, 0), (CELLS + 1, 0), (0, CELLS + 1), (CELLS + 1, CELLS + 1)] {
                let p = self.corner(column + c, row + r, d);
                (x, y) = ([x[0].min(p[0]), x[1].max(p[0])], [y[0].min(p[1]), y[1].max(p[1])]);
            }
        }
        let Window { width, height, .. } = self.camera.window;
        let columns = centres(x[0] - 1.0, x[1] + 1.0, width);
        let rows = centres(y[0] - 1.0, y[1] + 1.0, height);
        !columns.is_empty() && !rows.is_empty() && self.open.is_none_or(|o| o.any(columns, rows))
    }

    /// Some cells of a row: their surfaces, and the sheets to their right and below.
    #[inline(always)]
    fn draw_cells(&mut self, central: &Coarse, row: usize, columns: Range<usize>, tolerance: &Tolerance) {
        let (width, central) = (central.width, &central.samples);
        let samples = &central[row * width..(row + 1) * width];
        // Cells of one triangle are one strip.
        let mut start = columns.start;
        while start < columns.end {
            let triangle = samples[start].triangle;
            let same = |s: &&Sample| s.disparity > 0.0 && s.triangle == triangle;
            let run = samples[start..columns.end].iter().take_while(same).count();
            if run > 0 {
                self.strip(row, start, start + run - 1, &samples[start], &samples[start + run - 1]);
            }
            start += run.max(1);
        }
        for column in columns.start..columns.end.min(width - 1) {
            let (a, b) = (&samples[column], &samples[column + 1]);
            if torn(a, b, 0, tolerance) {
                self.sheet(row, column, a, b);
            }
        }
        if let Some(below) = central.get((row + 1) * width..(row + 2) * width) {
            let pairs = |c: usize| (&samples[c], &below[c]);
            let mut start = columns.start;
            while start < columns.end {
                let (a, b) = pairs(start);
                if !torn(a, b, 1, tolerance) {
                    start += 1;
                    continue;
                }
                // Sheets between the same two triangles are one.
                let alike = |c: &usize| {
                    let (p, q) = pairs(*c);
                    p.triangle == a.triangle && q.triangle == b.triangle && torn(p, q, 1, tolerance)
                };
                let run = (start + 1..columns.end).take_while(alike).count();
                let last = start + run;
                self.sheet_below(row, start, last, [a, b], [&samples[last], &below[last]]);
                start = last + 1;
            }
        }
    }

    #[inline(always)]
    fn draw_deeper(&mut self, deeper: &[(u32, Sample)]) {
        let width = self.rig.window.width as usize;
        // A pixel of the camera holds several samples: their middles cover it.
        let (w, c, scale) = (self.rig.window, self.camera.window, self.camera.scale);
        for (pixel, s) in deeper {
            let (row, column) = (*pixel as usize / width, *pixel as usize % width);
            let (u, v) = (f64::from(w.left) + column as f64 + 0.5, f64::from(w.top) + row as f64 + 0.5);
            let (u, v, d) = self.camera.shift.apply(u, v, f64::from(s.disparity));
            let (column, row) = (u * scale - f64::from(c.left), v * scale - f64::from(c.top));
            if let Some(at) = c.index(column.floor() as i64, row.floor() as i64) {
                self.surfaces[at] = self.surfaces[at].max(to_entry(d as f32, 1));
            }
        }
    }

    /// The pieces of plane in the cells `first ..= last` of a row, whose samples are `a` and `b`.
    #[inline(always)]
    fn strip(&mut self, row: usize, first: usize, last: usize, a: &Sample, b: &Sample) {
        let left = |down: f32| bounded(a, -0.5 * a.gradient[0] + down * a.gradient[1]);
        let right = |down: f32| bounded(b, 0.5 * b.gradient[0] + down * b.gradient[1]);
        let corners = [
            self.corner(first, row, left(-0.5)),
            self.corner(last + 1, row, right(-0.5)),
            self.corner(last + 1, row + 1, right(0.5)),
            self.corner(first, row + 1, left(0.5)),
        ];
        self.fill(&corners, Kind::Central);
    }

    /// The sheet from cell `a` to its right neighbour `b`, over their common border.
    #[inline(always)]
    fn sheet(&mut self, row: usize, column: usize, a: &Sample, b: &Sample) {
        let edge = |s: &Sample, toward: f32, down: f32| bounded(s, toward * s.gradient[0] + down * s.gradient[1]);
        let corners = [
            self.corner(column + 1, row, edge(a, 0.5, -0.5)),
            self.corner(column + 1, row + 1, edge(a, 0.5, 0.5)),
            self.corner(column + 1, row + 1, edge(b, -0.5, 0.5)),
            self.corner(column + 1, row, edge(b, -0.5, -0.5)),
        ];
        self.fill(&corners, Kind::Sheet);
    }

    /// The sheet from cells `first ..= last` of a row to those below; the (upper, lower) samples
    /// of both ends.
    #[inline(always)]
    fn sheet_below(&mut self, row: usize, first: usize, last: usize, left: [&Sample; 2], right: [&Sample; 2]) {
        let edge = |s: &Sample, toward: f32, across: f32| bounded(s, toward * s.gradient[1] + across * s.gradient[0]);
        let corners = [
            self.corner(first, row + 1, edge(left[0], 0.5, -0.5)),
            self.corner(last + 1, row + 1, edge(right[0], 0.5, 0.5)),
            self.corner(last + 1, row + 1, edge(right[1], -0.5, 0.5)),
            self.corner(first, row + 1, edge(left[1], -0.5, -0.5)),
        ];
        self.fill(&corners, Kind::Sheet);
    }

    /// Corner (column, row) of the cells of the central window at a disparity, in the camera's
    /// window.
    #[inline(always)]
    fn corner(&self, column: usize, row: usize, disparity: f32) -> Corner {
        let (w, c) = (&self.rig.window, &self.camera.window);
        let d = f64::from(disparity).min(1.0 / self.rig.near_m);
        let (u, v, d) = self.camera.shift.apply(
            f64::from(w.left) + (column * COARSENESS) as f64,
            f64::from(w.top) + (row * COARSENESS) as f64,
            d,
        );
        let scale = self.camera.scale;
        [(u * scale - f64::from(c.left)) as f32, (v * scale - f64::from(c.top)) as f32, d as f32]
    }

    /// Writes the pixel centres inside a quadrilateral, one span per row, disparity linear.
    #[inline(always)]
    fn fill(&mut self, q: &[Corner; 4], kind: Kind) {
        let Window { width, height, .. } = self.camera.window;
        let [(x0, x1), (y0, y1), (z0, z1)] = std::array::from_fn(|k| {
            let x = q.map(|p| p[k]);
            (x[0].min(x[1]).min(x[2].min(x[3])), x[0].max(x[1]).max(x[2].max(x[3])))
        });
        let overlap = if kind == Kind::Sheet { 0.0 } else { OVERLAP_PX };
        let rows = centres(y0 - overlap, y1 + overlap, height);
        let columns = centres(x0 - overlap, x1 + overlap, width);
        if rows.is_empty() || columns.is_empty() || self.open.is_some_and(|o| !o.any(columns, rows.clone())) {
            return;
        }
        // dz/dx and dz/dy of the plane through three corners; flat where they are in line.
        let [ax, ay, az] = [q[1][0] - q[0][0], q[1][1] - q[0][1], q[1][2] - q[0][2]];
        let [bx, by, bz] = [q[3][0] - q[0][0], q[3][1] - q[0][1], q[3][2] - q[0][2]];
        let det = ax * by - ay * bx;
        let (zx, zy) =
            if det.abs() > 1e-6 { ((az * by - ay * bz) / det, (ax * bz - az * bx) / det) } else { (0.0, 0.0) };
        for row in rows {
            let y = (row as f32 + 0.5).clamp(y0, y1);
            let (mut x0, mut x1) = (f32::INFINITY, f32::NEG_INFINITY);
            for i in 0..4 {
                let (p, r) = (&q[i], &q[(i + 1) & 3]);
                if (p[1] - y) * (r[1] - y) <= 0.0 {
                    let dy = r[1] - p[1];
                    let xs = if dy == 0.0 { [p[0], r[0]] } else { [p[0] + (r[0] - p[0]) * ((y - p[1]) / dy); 2] };
                    x0 = x0.min(xs[0]).min(xs[1]);
                    x1 = x1.max(xs[0]).max(xs[1]);
                }
            }
            let columns = centres(x0 - overlap, x1 + overlap, width);
            let first = columns.start;
            let span = row * width as usize + columns.start..row * width as usize + columns.end;
            let z_first = q[0][2] + zy * (y - q[0][1]) + zx * (first as f32 + 0.5 - q[0][0]);
            let z = |k: usize| (z_first + zx * k as f32).clamp(z0, z1);
            // One plain loop per kind, so that the compiler may vectorize it.
            match kind {
                Kind::Sheet => raise(&mut self.front[span], |k| to_entry(z(k) * SHEET_BIAS, 0)),
                Kind::Central => {
                    raise(&mut self.front[span.clone()], |k| to_entry(z(k), 1));
                    raise(&mut self.surfaces[span], |k| to_entry(z(k), 0));
                }
            }
        }
    }
}

/// Pixels whose centres lie in `from ..= to`, within `0 .. limit`.
#[inline(always)]
fn centres(from: f32, to: f32, limit: u32) -> Range<usize> {
    // Casts truncate toward zero, saturate, and make 0 of NaN.
    let first = (from + 0.5).max(0.0) as usize;
    let end = ((to + 0.5).max(0.0) as usize).min(limit as usize);
    first.min(end)..end
}

/// A positive disparity with a flag in its lowest bit. Signed, as baseline x86-64 compares only
/// signed integers.
#[inline(always)]
fn to_entry(z: f32, flag: i32) -> i32 {
    (z.to_bits() as i32 & !1) | flag
}

#[inline(always)]
fn raise(buffer: &mut [i32], entry: impl Fn(usize) -> i32) {
    for (k, b) in buffer.iter_mut().enumerate() {
        *b = (*b).max(entry(k));
    }
}

/// Whether two neighbours of the central image leave something hidden between them.
#[inline]
fn torn(a: &Sample, b: &Sample, axis: usize, tolerance: &Tolerance) -> bool {
    if a.disparity <= 0.0 || b.disparity <= 0.0 {
        // Where nobody looks nothing is known, and the ray is traced for that.
        return a.disparity.max(b.disparity) > 0.0 && a.disparity.min(b.disparity) == 0.0;
    }
    a.triangle != b.triangle && !tolerance.continuous(a, b, axis)
}
