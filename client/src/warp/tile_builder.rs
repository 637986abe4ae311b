//! The tile builder: constructs the micro-quads and border pieces of a layer.
//!
//! In: one layer of an [`Ldi`] and a row of tiles. Out: their [`Part`].
//!
//! **Micro-quads without cracks and without growth.** A sample is a cell around its centre: half a
//! pixel toward linked neighbours, and to the end of its surface elsewhere; a layer covers exactly
//! the union of its samples' cells. Consider the square between four neighbouring centres:
//!
//! ```text
//!     a --- b      each quarter of the square belongs to the nearest centre; all four linked:
//!     |  .  |      one quad a b e f, colour and disparity interpolated; nearly every square is
//!     e --- f      such a one
//! ```
//!
//! Otherwise only the quarters of existing samples are covered: linked pairs make a half square
//! (interpolated along the pair), single samples a quarter. A side between a linked pair is the
//! straight line between the two centres in the squares on both its sides, so that it cannot open.
//! Without a linked neighbour a cell continues on the plane given by the opposite link (planes are
//! linear in disparity), or frontal without one, plus the slope stored in the image, to the stored
//! end of the surface. [`OVERLAP`] is added outward, so that rounding and curvature do not open
//! seams between surfaces that meet.

use super::tiles::{OVERLAP, PADDING, Part, Pieces, Run, TILE_COLUMNS, TILE_ROWS, Tile, Vertex};
use crate::frame::{pack_rgb, unpack_rgb};
use ldi_protocol::ldi::{END_PARTS, LINK_DOWN, LINK_RIGHT, Ldi, SLOPE_CODES, Sliver, SliverCorner, end_of};
use std::ops::Range;

/// The slivers of an image: pieces, each in the tile that holds its first corner, in a part per row
/// of tiles.
pub fn slivers(ldi: &Ldi) -> Vec<Part> {
    let tile_of = |s: &Sliver| {
        let [c, ..] = s.corners;
        let along = |x: i32, side: u32, tile: usize| (x / Sliver::PARTS).clamp(0, side as i32 - 1) as usize / tile;
        (along(c.v, ldi.camera.height, TILE_ROWS), along(c.u, ldi.camera.width, TILE_COLUMNS))
    };
    let mut sorted: Vec<&Sliver> = ldi.slivers.iter().collect();
    sorted.sort_by_key(|s| tile_of(s));
    let mut parts: Vec<Part> = Vec::new();
    for of_row in sorted.chunk_by(|a, b| tile_of(a).0 == tile_of(b).0) {
        let mut part = Part { layer: ldi.layers.len(), ..Part::default() };
        for of_tile in of_row.chunk_by(|a, b| tile_of(a) == tile_of(b)) {
            let (row, column) = tile_of(of_tile[0]);
            let mut tile = Tile::new(row * TILE_ROWS, column * TILE_COLUMNS, &mut part);
            let on = |c: &SliverCorner| {
                let place = |x: i32| x as f32 / Sliver::PARTS as f32;
                let v = place(c.v);
                (place(c.u), v - tile.row as f32, ldi.codes.disparity(c.disparity) as f32)
            };
            for s in of_tile {
                let colour = pack_rgb(s.rgb);
                part.pieces.push(s.corners.each_ref().map(on).map(|(u, v, disparity)| Vertex {
                    u,
                    v,
                    disparity,
                    colour,
                }));
            }
            tile.finish(&mut part);
            part.tiles.push(tile);
        }
        pad(&mut part);
        parts.push(part);
    }
    parts
}

/// Elements past the end of a part's arrays.
pub(super) fn pad(part: &mut Part) {
    part.column.resize(part.column.len() + PADDING, 0);
    part.disparity.resize(part.disparity.len() + PADDING, 0.0);
    part.colour.resize(part.colour.len() + PADDING, 0);
}

/// Mean of two colours in approximately linear light (the square of the sRGB code).
fn mean_colour(a: u32, b: u32) -> u32 {
    if a == b {
        return a;
    }
    let (a, b) = (unpack_rgb(a), unpack_rgb(b));
    pack_rgb(std::array::from_fn(|i| {
        let square = (f32::from(a[i]).powi(2) + f32::from(b[i]).powi(2)) * 0.5;
        (square.sqrt() + 0.5) as u8
    }))
}

/// Colour `c` moved by both `a - c` and `b - c`.
fn bilinear_corner(c: u32, a: u32, b: u32) -> u32 {
    let (c, a, b) = (unpack_rgb(c), unpack_rgb(a), unpack_rgb(b));
    pack_rgb(std::array::from_fn(|i| (i32::from(a[i]) + i32::from(b[i]) - i32::from(c[i])).clamp(0, 255) as u8))
}

const NONE: u32 = u32::MAX;
/// Rows read for a row of tiles: one above, its own, the halo, and one more for the halo's slope.
const ROWS: usize = TILE_ROWS + 3;

/// How a sample is linked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Alone,
    /// Along its row only.
    InRow,
    /// Along its column only.
    InColumn,
    /// Along both.
    Inside,
}

/// Builds one part. Rows and columns in its methods are relative to the row of tiles: row -1 is the
/// one above.
pub struct Builder {
    layer_number: usize,
    first_row: usize,
    /// Samples by (row + 1, column + 1), a dense window with an empty column on either side.
    sample: Vec<u32>,
    /// Links whose far ends exist, same layout.
    link: Vec<u8>,
    /// Disparities, 1/m, same layout.
    disparity: Vec<f32>,
    /// Packed colours, same layout.
    colour: Vec<u32>,
    /// Where surfaces end, same layout.
    ends: Vec<u16>,
    /// Slope residual: gradient minus the linked neighbour's gradient, to the next column and row,
    /// 1/m; same layout.
    slopes: Vec<[f32; 2]>,
    stride: usize,
    /// Samples in the window.
    samples: usize,
    /// Columns of tiles that hold or border on samples.
    occupied: Vec<bool>,
}

/// Position of a corner relative to its sample, per axis: toward smaller coordinates, at the
/// centre, toward larger.
type Side = i32;

impl Builder {
    /// Collects the rows read for the row of tiles at `first_row`. Links to samples that do not
    /// exist are dropped.
    pub fn new(ldi: &Ldi, layer_number: usize, first_row: usize) -> Self {
        let layer = &ldi.layers[layer_number];
        let width = ldi.camera.width as usize;
        let stride = width + 2;
        let mut builder = Self {
            layer_number,
            first_row,
            sample: vec![NONE; stride * ROWS],
            link: vec![0; stride * ROWS],
            disparity: vec![0.0; stride * ROWS],
            colour: vec![0; stride * ROWS],
            ends: vec![0; stride * ROWS],
            slopes: vec![[0.0; 2]; stride * ROWS],
            stride,
            samples: 0,
            occupied: vec![false; width.div_ceil(TILE_COLUMNS)],
        };
        let begin = layer.segments.partition_point(|s| usize::from(s.row) + 1 < first_row);
        let end = layer.segments.partition_point(|s| usize::from(s.row) <= first_row + TILE_ROWS + 1);
        // Sparse layers are frequent: only existing samples are visited.
        let existing = || {
            layer.segments[begin..end].iter().flat_map(|s| {
                let (row, first) = (usize::from(s.row) + 1 - first_row, s.first as usize);
                let column = |i: usize| usize::from(s.column_base) + usize::from(layer.column[i]);
                let samples = first..first + usize::from(s.count);
                samples.map(move |i| (i, row, column(i))).filter(|(_, _, column)| *column < width)
            })
        };
        for (i, row, column) in existing() {
            builder.sample[row * stride + column + 1] = i as u32;
            builder.samples += 1;
            // Squares reach one column to either side.
            for column in [column.saturating_sub(1), column, (column + 1).min(width - 1)] {
                builder.occupied[column / TILE_COLUMNS] = true;
            }
        }
        let slope_unit = (ldi.codes.step * f64::from(SLOPE_CODES)) as f32;
        for (i, row, column) in existing() {
            let at = row * stride + column + 1;
            let exists = |at: usize| builder.sample.get(at).is_some_and(|n| *n != NONE);
            let mut bits = layer.links[i];
            if bits & LINK_RIGHT != 0 && !exists(at + 1) {
                bits &= !LINK_RIGHT;
            }
            if bits & LINK_DOWN != 0 && !exists(at + stride) {
                bits &= !LINK_DOWN;
            }
            builder.link[at] = bits;
            builder.disparity[at] = ldi.codes.disparity(layer.disparity[i]) as f32;
            builder.colour[at] = pack_rgb(layer.rgb[i]);
            builder.ends[at] = layer.ends[i];
            builder.slopes[at] = layer.slopes[i].map(|s| f32::from(s) * slope_unit);
        }
        builder
    }

    fn at(&self, row: i32, column: i32) -> usize {
        (row + 1) as usize * self.stride + (column + 1) as usize
    }

    /// The neighbour one step along an axis, if linked.
    fn neighbour(&self, at: usize, step: usize, bit: u8, side: Side) -> Option<usize> {
        if side > 0 {
            (self.link[at] & bit != 0).then_some(at + step)
        } else {
            let back = at.checked_sub(step)?;
            (self.link[back] & bit != 0).then_some(back)
        }
    }

    /// Half a cell along an axis: extent in pixels, change of disparity, colour there.
    #[inline]
    fn half(&self, at: usize, step: usize, bit: u8, side: Side) -> (f32, f32, u32) {
        let (here, own) = (self.disparity[at], self.colour[at]);
        if side == 0 {
            return (0.0, 0.0, own);
        }
        if let Some(n) = self.neighbour(at, step, bit, side) {
            return (0.5 * side as f32, (self.disparity[n] - here) * 0.5, mean_colour(own, self.colour[n]));
        }
        let axis = usize::from(bit == LINK_DOWN);
        let extent =
            f32::from(end_of(self.ends[at], 2 * axis + usize::from(side > 0))) / f32::from(END_PARTS) + OVERLAP;
        let linked = self.neighbour(at, step, bit, -side).map_or(0.0, |n| here - self.disparity[n]);
        let slope = linked + self.slopes[at][axis] * side as f32;
        (extent * side as f32, slope * extent, own)
    }

    /// The corner of a sample's cell on the given sides.
    #[inline]
    fn vertex(&self, row: i32, column: i32, across: Side, down: Side) -> Vertex {
        let at = self.at(row, column);
        let (here, own) = (self.disparity[at], self.colour[at]);
        let (du, slope_u, colour_u) = self.half(at, 1, LINK_RIGHT, across);
        let (dv, slope_v, colour_v) = self.half(at, self.stride, LINK_DOWN, down);
        Vertex {
            u: column as f32 + 0.5 + du,
            v: row as f32 + 0.5 + dv,
            // Never at or behind infinity.
            disparity: (here + slope_u + slope_v).max(here * 0.25),
            colour: match (colour_u == own, colour_v == own) {
                (_, true) => colour_u,
                (true, false) => colour_v,
                (false, false) => bilinear_corner(own, colour_u, colour_v),
            },
        }
    }

    fn kind(&self, at: usize) -> Kind {
        let linked = |step: usize, bit: u8| {
            self.link[at] & bit != 0 || at.checked_sub(step).is_some_and(|back| self.link[back] & bit != 0)
        };
        match (linked(1, LINK_RIGHT), linked(self.stride, LINK_DOWN)) {
            (false, false) => Kind::Alone,
            (true, false) => Kind::InRow,
            (false, true) => Kind::InColumn,
            (true, true) => Kind::Inside,
        }
    }

    /// The pieces of a square that is not full, into `to`. Samples without links along one axis are
    /// left to [`Self::thin`].
    fn square(&self, row: i32, column: i32, to: &mut Pieces) {
        let a = self.at(row, column);
        let at = [a, a + 1, a + self.stride, a + self.stride + 1];
        let kinds = at.map(|i| (self.sample[i] != NONE).then(|| self.kind(i)));
        let inside = kinds.map(|k| k == Some(Kind::Inside));
        if inside == [false; 4] {
            return;
        }
        let down = row + 1;
        let right = column + 1;
        // A pair takes part unless both are thin.
        let pair = |i: usize, j: usize, bit: u8| self.link[at[i]] & bit != 0 && (inside[i] || inside[j]);
        let (ab, ef) = (pair(0, 1, LINK_RIGHT), pair(2, 3, LINK_RIGHT));
        let (ae, bf) = (pair(0, 2, LINK_DOWN), pair(1, 3, LINK_DOWN));
        let mut done = [false; 4];
        if ab || ef {
            for (pair, row, side, members) in [(ab, row, 1, [0, 1]), (ef, down, -1, [2, 3])] {
                if pair {
                    let ends = |side: Side| [self.vertex(row, column, 0, side), self.vertex(row, right, 0, side)];
                    let ([p, q], [r, s]) = (ends(0.min(side)), ends(0.max(side)));
                    to.push([p, q, r, s]);
                    members.into_iter().for_each(|m| done[m] = true);
                }
            }
        } else {
            for (pair, column, side, members) in [(ae, column, 1, [0, 2]), (bf, right, -1, [1, 3])] {
                if pair {
                    let ends = |side: Side| [self.vertex(row, column, side, 0), self.vertex(down, column, side, 0)];
                    let ([p, r], [q, s]) = (ends(0.min(side)), ends(0.max(side)));
                    to.push([p, q, r, s]);
                    members.into_iter().for_each(|m| done[m] = true);
                }
            }
        }
        // Members of a pair along the axis that the square was not split along get their quarters
        // as well.
        let owed = [inside[0] || ab || ae, inside[1] || ab || bf, inside[2] || ef || ae, inside[3] || ef || bf];
        for i in (0..4).filter(|i| owed[*i] && !done[*i]) {
            let (c, across) = if i & 1 == 0 { (column, 1) } else { (right, -1) };
            let (r, below) = if i & 2 == 0 { (row, 1) } else { (down, -1) };
            to.push(self.cell(r, c, [0.min(across), 0.max(across)], [0.min(below), 0.max(below)]));
        }
    }

    /// The pieces of a sample that has no links along one axis or none at all: as high, or as wide,
    /// as its cell, which is what the two halves in the squares on either side would cover. Thin
    /// things and foliage consist of them.
    fn thin(&self, row: i32, column: i32, to: &mut Pieces) {
        let at = self.at(row, column);
        if self.sample[at] == NONE {
            return;
        }
        let all = [-1, 1];
        let kind = self.kind(at);
        let (step, bit) = match kind {
            Kind::Inside => return,
            Kind::Alone => return to.push(self.cell(row, column, all, all)),
            Kind::InRow => (1, LINK_RIGHT),
            Kind::InColumn => (self.stride, LINK_DOWN),
        };
        let part = |sides: [Side; 2]| match kind {
            Kind::InColumn => self.cell(row, column, all, sides),
            _ => self.cell(row, column, sides, all),
        };
        if self.neighbour(at, step, bit, -1).is_none() {
            to.push(part([-1, 0]));
        }
        match self.neighbour(at, step, bit, 1) {
            None => to.push(part([0, 1])),
            Some(next) if self.kind(next) == kind => {
                let v = |row, column, across, down| self.vertex(row, column, across, down);
                to.push(match kind {
                    Kind::InColumn => {
                        let below = row + 1;
                        [v(row, column, -1, 0), v(row, column, 1, 0), v(below, column, -1, 0), v(below, column, 1, 0)]
                    }
                    _ => {
                        let right = column + 1;
                        [v(row, column, 0, -1), v(row, right, 0, -1), v(row, column, 0, 1), v(row, right, 0, 1)]
                    }
                });
            }
            Some(_) => {}
        }
    }

    /// Part of a sample's cell between the given sides.
    fn cell(&self, row: i32, column: i32, across: [Side; 2], down: [Side; 2]) -> [Vertex; 4] {
        [
            self.vertex(row, column, across[0], down[0]),
            self.vertex(row, column, across[1], down[0]),
            self.vertex(row, column, across[0], down[1]),
            self.vertex(row, column, across[1], down[1]),
        ]
    }

    /// The row of tiles.
    pub fn build(&self) -> Part {
        let mut part = Part { layer: self.layer_number, ..Part::default() };
        if self.samples == 0 {
            return part;
        }
        let width = self.stride - 2;
        let room = self.samples + self.samples / 16;
        part.column.reserve(room);
        part.disparity.reserve(room);
        part.colour.reserve(room);
        for tile in (0..self.occupied.len()).filter(|tile| self.occupied[*tile]) {
            let column = tile * TILE_COLUMNS;
            self.tile(column, (width - column).min(TILE_COLUMNS + 1), &mut part);
        }
        pad(&mut part);
        part
    }

    /// Appends the tile at `first_column`, `columns` wide with its halo, if it draws anything.
    fn tile(&self, first_column: usize, columns: usize, part: &mut Part) {
        let first = part.column.len();
        let mut local = [[0u16; TILE_COLUMNS + 1]; TILE_ROWS + 1];
        let mut tile = Tile::new(self.first_row, first_column, part);
        for (row, local) in local.iter_mut().enumerate() {
            tile.row_start[row] = (part.column.len() - first) as u32;
            let start = self.at(row as i32, first_column as i32);
            let window = &self.sample[start..start + columns];
            let (mut leftmost, mut rightmost) = (usize::MAX, 0);
            for ((c, sample), local) in window.iter().enumerate().zip(local.iter_mut()) {
                if *sample == NONE {
                    continue;
                }
                *local = (part.column.len() - first) as u16;
                let d = self.disparity[start + c];
                part.column.push(c as u8);
                part.disparity.push(d);
                part.colour.push(self.colour[start + c]);
                let [least, most] = tile.bounds.disparity;
                tile.bounds.disparity = [least.min(d), most.max(d)];
                leftmost = leftmost.min(c);
                rightmost = c;
            }
            if leftmost == usize::MAX {
                continue;
            }
            let count = part.column.len() - first - tile.row_start[row] as usize;
            if row < TILE_ROWS {
                tile.own += (count - usize::from(rightmost == TILE_COLUMNS)) as u32;
            }
            let v = (self.first_row + row) as f32;
            let d = tile.bounds.disparity[0];
            tile.bounds.grow((first_column + leftmost) as f32, v, d);
            tile.bounds.grow((first_column + rightmost + 1) as f32, v + 1.0, d);
        }
        tile.row_start[TILE_ROWS + 1] = (part.column.len() - first) as u32;
        // Squares belong to the tile of their upper left pixel; the image's border squares to the
        // first tiles.
        let top = if self.first_row == 0 { -1 } else { 0 };
        let left = if first_column == 0 { -1 } else { 0 };
        let both = LINK_RIGHT | LINK_DOWN;
        for row in top..TILE_ROWS as i32 {
            let start = self.at(row, first_column as i32 + left);
            let count = columns.min(TILE_COLUMNS) + usize::from(left < 0);
            let upper = start..start + count + 1;
            let lower = start + self.stride..start + self.stride + count + 1;
            // Most rows of deep layers are empty.
            let empty = |range: &Range<usize>| self.sample[range.clone()].iter().all(|i| *i == NONE);
            if part.column.len() == first || (empty(&upper) && empty(&lower)) {
                continue;
            }
            let squares = self.link[upper].windows(2).zip(&self.link[lower]);
            let mut run: Option<Run> = None;
            for ((ab, e), column) in squares.zip(left..) {
                // A square is one quad when a is linked to both b and e, and these to f.
                if row >= 0 && column >= 0 && ab[0] & both == both && ab[1] & LINK_DOWN != 0 && e & LINK_RIGHT != 0 {
                    match &mut run {
                        Some(run) => run.count += 1,
                        None => {
                            let (r, c) = (row as usize, column as usize);
                            run = Some(Run { top: local[r][c], bottom: local[r + 1][c], count: 1 });
                        }
                    }
                    continue;
                }
                part.runs.extend(run.take());
                let image_column = first_column as i32 + column;
                self.square(row, image_column, &mut part.pieces);
                if row >= 0 && column >= 0 {
                    self.thin(row, image_column, &mut part.pieces);
                }
            }
            part.runs.extend(run.take());
        }
        tile.finish(part);
        if tile.own > 0 || !tile.runs.is_empty() || tile.pieces > 0 {
            part.tiles.push(tile);
        } else {
            part.column.truncate(first);
            part.disparity.truncate(first);
            part.colour.truncate(first);
        }
    }
}
