//! Occlusion-compatible order: painting without a z-buffer.
//!
//! In: the tiles that reach a band. Out: their samples, painted so that of two on one pixel the
//! nearer comes last.
//!
//! **Theory** (McMillan; as used for LDIs by Shade et al. and Rafferty et al.). Let E = C2 - C1 be
//! the eye seen from the image's centre, e its projection, the epipole. What may land on one output
//! pixel lies on one ray C2 + t r, whose image is p(t) = e + (r - e r_z) t / (E_z + t r_z): a line
//! through e. With the eye ahead of the centre (E_z > 0) near points lie closer to e, so samples
//! are drawn toward it; with the eye behind (E_z < 0) near points lie farther from it, and they are
//! drawn away from it. An eye in the plane of the centre (E_z = 0) puts e at infinity on the side
//! of E, which a large finite e stands for. Column and row distances from e are monotone along
//! every such line, so the on the side of E, which a large finite e represents. Column and row
//! distances from e are monotone along every such line, so the image falls into up to four sheets
//! at e, each drawn row by row. Deeper layers of a pixel come first. **Practice.** The same
//! argument holds for tiles, and then within tiles: tiles are sorted by distance of their rows,
//! then of their columns; within a tile rows, then columns, then layers. The samples of all layers
//! are laid out again for this ([`Streams`]): row by row in painting order, once for rising and
//! once for falling columns, so that painting reads memory sequentially without comparisons.
//! Threads share the output's rows as with the z-buffer; the papers cut sheets into fragments
//! instead, whose borders meet in the picture. Stamps larger than 2 x 2 would overpaint nearer
//! samples, and are refused.

use super::{
    Stamp,
    cull::{Blocks, Reach},
    matrix::WarpMatrix,
    quad_raster::Target,
    stamps::own_rows,
    tile_builder::pad,
    tiles::{Part, TILE_COLUMNS, TILE_ROWS, Tile},
    transform::{Inside, Largest, Points, Slopes, TileTransform, first_lanes},
};
use crate::simd::{LANES, Lanes};
use ldi_protocol::{Pose, ldi::LdiCamera};
use std::collections::BTreeMap;

/// Distance of an epipole at infinity, LDI pixels: far beyond any image, small enough for f64 to
/// distinguish columns.
const INFINITE: f64 = 1e9;

/// Where the eye lies in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Epipole {
    /// Column coordinate, LDI pixels.
    u: f64,
    /// Row coordinate, LDI pixels.
    v: f64,
    /// Whether to draw toward it.
    toward: bool,
}

impl Epipole {
    /// The epipole of an eye in an image.
    pub fn new(camera: &LdiCamera, pose: &Pose) -> Self {
        let e = pose.position - camera.cop;
        let (right, down, ahead) = (e.dot(camera.basis.right), -e.dot(camera.basis.up), e.dot(camera.basis.forward));
        // Not -0, which would put the epipole on the wrong side.
        let ahead = ahead + 0.0;
        // An eye beside the centre has no extent along the axis in question: lines run along the
        // other, any order does.
        let coordinate = |p: f64, origin: i32| {
            let at = p / ahead * camera.pixels_per_unit - f64::from(origin);
            if at.is_nan() { 0.0 } else { at.clamp(-INFINITE, INFINITE) }
        };
        Self { u: coordinate(right, camera.left), v: coordinate(down, camera.top), toward: ahead >= 0.0 }
    }

    /// The quadrant around an image position, in LDI pixels, that is nearest to the eye: bit 0 the
    /// right half, bit 1 the lower one. The opposite one is the farthest.
    pub fn first_quadrant(&self, [u, v]: [f64; 2]) -> usize {
        let toward_epipole = usize::from(self.u >= u) | usize::from(self.v >= v) << 1;
        // Painting toward the epipole ends there.
        if self.toward { toward_epipole } else { toward_epipole ^ 3 }
    }

    /// Sorts by distance from `e`: toward it the farthest first, away from it the nearest first.
    fn sort<T>(&self, items: &mut [T], distance: impl Fn(&T) -> f64) {
        items.sort_by(|a, b| {
            let order = distance(a).total_cmp(&distance(b));
            if self.toward { order.reverse() } else { order }
        });
    }

    /// Tiles in drawing order.
    pub fn sort_tiles(&self, tiles: &mut [Reach<'_>]) {
        let gap =
            |from: u32, size: usize, e: f64| (f64::from(from) - e).max(e - f64::from(from) - size as f64).max(0.0);
        // Stable sorts, the least significant key first.
        tiles.sort_by_key(|t| (t.tile.row, t.tile.column));
        self.sort(tiles, |t| gap(t.tile.column, TILE_COLUMNS, self.u));
        self.sort(tiles, |t| gap(t.tile.row, TILE_ROWS, self.v));
    }

    /// Rows of a tile in drawing order.
    fn rows(&self, tile: &Tile) -> Vec<usize> {
        let mut rows: Vec<usize> = (0..TILE_ROWS).collect();
        self.sort(&mut rows, |i| (f64::from(tile.row) + *i as f64 + 0.5 - self.v).abs());
        rows
    }
}

/// An image's samples in the order of painting.
#[derive(Debug)]
pub struct Streams {
    /// Columns rise, and fall; of one pixel the deepest sample comes first in both. Their tiles
    /// hold all layers and have the same numbers.
    parts: [Vec<Part>; 2],
    /// Of the tiles of the first.
    blocks: Blocks,
}

impl Streams {
    /// Lays out the samples of all layers.
    pub fn new(parts: &[Part]) -> Self {
        // Tiles by place, deepest layer first.
        let mut places: BTreeMap<(u32, u32), Vec<(&Part, &Tile)>> = BTreeMap::new();
        for part in parts.iter().rev() {
            for tile in &part.tiles {
                places.entry((tile.row, tile.column)).or_default().push((part, tile));
            }
        }
        let places: Vec<_> = places.into_values().collect();
        let stream = |falling: bool| {
            let of_row = places.chunk_by(|a, b| a[0].1.row == b[0].1.row);
            of_row.map(|places| Self::part(places, falling)).filter(|p| !p.tiles.is_empty()).collect::<Vec<_>>()
        };
        let parts = [stream(false), stream(true)];
        Self { blocks: Blocks::new(&parts[0]), parts }
    }

    fn part(places: &[Vec<(&Part, &Tile)>], falling: bool) -> Part {
        let mut out = Part::default();
        for place in places {
            let first = place[0].1;
            let mut tile = Tile::new(first.row as usize, first.column as usize, &mut out);
            let mut rows: [Vec<(u8, &Part, usize)>; TILE_ROWS] = Default::default();
            for (part, of_layer) in place {
                tile.bounds.join(&of_layer.bounds);
                for (row, samples) in rows.iter_mut().zip(own_rows(part, of_layer)) {
                    let at = |i: usize| of_layer.first + i;
                    row.extend(samples.map(|i| (part.column[at(i)], *part, at(i))));
                }
            }
            for (row, samples) in rows.iter_mut().enumerate() {
                // Stable: the layers of a pixel stay as they are.
                samples.sort_by_key(|(column, ..)| if falling { u8::MAX - column } else { *column });
                tile.row_start[row] = (out.column.len() - tile.first) as u32;
                for (column, part, at) in samples.iter() {
                    out.column.push(*column);
                    out.disparity.push(part.disparity[*at]);
                    out.colour.push(part.colour[*at]);
                }
                tile.own += samples.len() as u32;
            }
            tile.row_start[TILE_ROWS..].fill((out.column.len() - tile.first) as u32);
            if tile.own > 0 {
                out.tiles.push(tile);
            }
        }
        pad(&mut out);
        out
    }

    /// The tiles that may reach a picture, as [`Blocks::reaching`].
    pub fn reaching(&self, matrix: &WarpMatrix, within: [u32; 4], all: bool) -> Vec<Reach<'_>> {
        self.blocks.reaching(&self.parts[0], matrix, within, all)
    }
}

/// Paints a tile; `largest` sees the footprints.
#[inline(always)]
pub fn paint_tile<L: Lanes>(
    target: &mut Target<'_>,
    matrix: &WarpMatrix,
    epipole: &Epipole,
    streams: &Streams,
    reach: &Reach<'_>,
    stamp: Stamp,
    largest: &mut Largest<L>,
) {
    let transform = TileTransform::new(matrix, reach.tile);
    let slopes = Slopes::<L>::new(&transform);
    let inside = Inside::<L>::new(&target.window);
    // Columns whose centres lie left of the epipole come from the stream that ends at it.
    let split = (epipole.u - f64::from(reach.tile.column) + 0.5).floor().clamp(0.0, TILE_COLUMNS as f64) as u8;
    let (part_number, tile_number) = reach.number;
    for row in epipole.rows(reach.tile) {
        let constants = transform.row_constants(matrix, row).map(L::splat);
        for (left, falling) in [(true, !epipole.toward), (false, epipole.toward)] {
            let part = &streams.parts[usize::from(falling)][part_number as usize];
            let tile = &part.tiles[tile_number as usize];
            let (from, to) = (tile.row_start[row] as usize, tile.row_start[row + 1] as usize);
            let columns = &part.column[tile.first + from..tile.first + to];
            let cut = from + columns.partition_point(|c| (*c < split) != falling);
            // Left ones come first where columns rise, last where they fall.
            let range = if left != falling { from..cut } else { cut..to };
            for i in range.clone().step_by(LANES) {
                let at = tile.first + i;
                let p = slopes.warp(constants, L::load_bytes(&part.column[at..]), L::load(&part.disparity[at..]));
                let on = first_lanes::<L>(range.end - i);
                let seen = L::and(inside.test(&p), on);
                largest.see(seen, &slopes.stretch(&p));
                let colours = &part.colour[at..at + LANES];
                match stamp {
                    Stamp::TwoByTwo => two_by_two::<L>(target, &p, on, colours),
                    _ => one_pixel::<L>(target, &p, seen, colours),
                }
            }
        }
    }
}

/// Writes the pixels that contain the points of a mask, all inside of the window, one by one.
#[inline(always)]
fn one_pixel<L: Lanes>(target: &mut Target<'_>, p: &Points<L>, seen: L::I, colours: &[u32]) {
    let mut bits = L::mask_bits(seen);
    if bits == 0 {
        return;
    }
    let row = L::to_int(L::sub(p.y, L::splat(target.window.first_row as f32)));
    let at = L::array_int(L::add_int(L::mul_int(row, L::splat_int(target.window.width)), L::to_int(p.x)));
    let disparities = L::array_int(L::bits(p.disparity));
    while bits != 0 {
        let lane = bits.trailing_zeros() as usize & (LANES - 1);
        target.set(at[lane] as usize, disparities[lane], colours[lane]);
        bits &= bits - 1;
    }
}

/// Writes two by two pixels around the points of a mask, one by one.
#[inline(always)]
fn two_by_two<L: Lanes>(target: &mut Target<'_>, p: &Points<L>, on: L::I, colours: &[u32]) {
    let window = target.window;
    let mut bits = L::mask_bits(L::and(on, L::gt(p.disparity, L::splat(0.0))));
    if bits == 0 {
        return;
    }
    let half = L::splat(0.5);
    let (x, y) = (L::array(L::floor(L::sub(p.x, half))), L::array(L::floor(L::sub(p.y, half))));
    let disparities = L::array_int(L::bits(p.disparity));
    while bits != 0 {
        let lane = bits.trailing_zeros() as usize & (LANES - 1);
        bits &= bits - 1;
        // Saturating conversions: far outside stays outside.
        let (left, top) = (x[lane] as i32, (y[lane] as i32).saturating_sub(window.first_row as i32));
        for row in top.max(0)..top.saturating_add(2).min(window.rows as i32) {
            for column in left.max(0)..left.saturating_add(2).min(window.width as i32) {
                let at = row as usize * window.width as usize + column as usize;
                target.set(at, disparities[lane], colours[lane]);
            }
        }
    }
}
