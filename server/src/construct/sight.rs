//! Where eyes see replaced cells at all, and from where they see what others do not.
//!
//! Cells that stay are drawn from any eye, and hide what lies behind them: on the clinic at a tenth of its triangles more than four fifths of what
//! the faces of a near box could hold is behind walls that are drawn anyway. So before an image is made, rays go out from places where eyes stand,
//! through a coarse raster of their pictures and through everything there is. Where the first thing they meet is replaced, or is nothing, the
//! eye needs the image. The image is made there alone, with a margin.
//!
//! ```text
//!   eye ──────────── wall (stays) ░░░░ hidden: no sample, no ray
//!      ╲─── door ─────────────── far wall (replaced): needed
//! ```
//!
//! From one eye to the next little changes, and much in the end: many eyes with few rays each find more than few eyes with many. What they met
//! also says which of them the construction images are best made from, and in which part of their pictures: each piece of surface from one.
//!
//! In: a caster, a rig, places where eyes stand. Out: the pixels of the image to look at ([`Looked`]); later, knowing the central image, the cameras.

use super::{
    caster::{Met, SubsetCaster},
    sample::{Sample, Tolerance},
    view::{ConstructionCamera, Rig, View, Window},
};
use crate::render::Ray;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Side of a raster square of an eye's picture, pixels of its construction camera (two of the image's); one ray goes through each. Larger: quicker,
/// and what few eyes see through narrow gaps is overlooked.
pub(super) const SQUARE: usize = 16;
/// Side of the blocks of the image that are kept or left out, pixels. By judgement: half a square, so that borders follow what is seen.
const BLOCK: usize = 16;
/// What is seen is kept with this many pixels around it: eyes between those tried see a little further around things.
const MARGIN: f64 = 16.0;
/// Rays begin this far before the eye, metres: the viewer's near plane.
const NEAR_M: f64 = 0.02;
/// Most construction cameras of an image. By judgement; those that bring most come first.
const MOST_CAMERAS: usize = 48;
/// Side of a piece of surface, pixels: a square of the raster. Half of it found no more on the test scenes.
const PIECE: f64 = 32.0;
/// Two hits this much apart in depth, relatively, are different pieces. By judgement: smaller takes slanted surfaces to pieces, larger takes what stands
/// before a wall for the wall.
const PIECE_DEPTH: f64 = 0.1;
/// A hit that differs from the plane of the central sample in its place by at most this many steps of disparity is held: one output pixel
/// for the worst eye.
const HELD_STEPS: f32 = 8.0;

/// Squares of an eye's picture in which it sees something new, from the corner of its camera's window.
#[derive(Debug, Clone)]
pub(super) struct Open {
    /// How many such squares lie above and left of each corner of a square: one row and one column more than squares.
    sums: Vec<u32>,
    columns: usize,
}

impl Open {
    /// Of squares, row-major.
    fn new(squares: &[bool], columns: usize) -> Self {
        let width = columns + 1;
        let mut sums = vec![0; width];
        for (row, line) in squares.chunks_exact(columns).enumerate() {
            let mut left = 0;
            sums.push(0);
            for (column, open) in line.iter().enumerate() {
                left += u32::from(*open);
                sums.push(sums[row * width + column + 1] + left);
            }
        }
        Self { sums, columns }
    }

    /// Whether the pixel of the camera is in such a square.
    #[inline]
    pub fn holds(&self, column: usize, row: usize) -> bool {
        self.any(column..column + 1, row..row + 1)
    }

    /// Whether one of the pixels is in such a square; the ranges are not empty.
    #[inline]
    pub fn any(&self, columns: Range<usize>, rows: Range<usize>) -> bool {
        let (left, right) = (columns.start / SQUARE, (columns.end - 1) / SQUARE + 1);
        let (top, bottom) = (rows.start / SQUARE, (rows.end - 1) / SQUARE + 1);
        let sum = |row: usize, column: usize| self.sums[row * (self.columns + 1) + column];
        sum(bottom, right) + sum(top, left) != sum(top, right) + sum(bottom, left)
    }
}

/// Pixels of the image that someone may look at; of blocks from the corner of its window.
#[derive(Debug, Clone)]
pub(super) struct Looked {
    blocks: Vec<bool>,
    columns: usize,
}

impl Looked {
    /// Columns of a row that are looked at, as runs.
    pub fn runs(&self, row: usize, width: usize) -> impl Iterator<Item = Range<usize>> + '_ {
        let first = row / BLOCK * self.columns;
        let line = &self.blocks[first..first + self.columns];
        let mut at = 0;
        std::iter::from_fn(move || {
            let start = at + line[at..].iter().position(|b| *b)?;
            let end = start + line[start..].iter().take_while(|b| **b).count();
            at = end;
            Some(start * BLOCK..(end * BLOCK).min(width))
        })
    }

    fn everything(window: &Window) -> Self {
        let columns = (window.width as usize).div_ceil(BLOCK);
        Self { blocks: vec![true; columns * (window.height as usize).div_ceil(BLOCK)], columns }
    }
}

/// What eyes see of an image.
pub(super) struct Sight {
    /// The pixels to look at.
    pub looked: Looked,
    /// Rays cast.
    pub rays: u64,
    /// None: eyes may be anywhere.
    pictures: Option<Vec<Picture>>,
}

/// What one eye sees.
struct Picture {
    camera: ConstructionCamera,
    /// Squares of the camera's window per row.
    columns: usize,
    rows: usize,
    hits: Vec<Seen>,
}

/// Something replaced, or sky, that an eye sees.
struct Seen {
    /// Row-major in the eye's raster.
    square: u32,
    /// Absolute coordinates in the image, and disparity there; 0 is sky.
    at: [f64; 3],
    /// Half the side of the square there.
    half: f64,
}

impl Sight {
    /// What `eyes` see; cuts the rig's window to it. Without eyes everything is looked at. Err: nobody sees anything, found by this many rays.
    pub fn of<C: SubsetCaster>(caster: &C, rig: &mut Rig, eyes: &[DVec3]) -> Result<Self, u64> {
        if eyes.is_empty() {
            return Ok(Self { looked: Looked::everything(&rig.window), rays: 0, pictures: None });
        }
        let pictures: Vec<(Picture, u64)> = eyes
            .par_iter()
            .enumerate()
            .filter_map(|(number, eye)| {
                let camera = rig.camera_at(rig.lens.in_basis(*eye - rig.cop))?;
                Some(Picture::of(caster, rig, camera, number))
            })
            .collect();
        let rays = pictures.iter().map(|p| p.1).sum();
        let pictures: Vec<Picture> = pictures.into_iter().map(|p| p.0).filter(|p| !p.hits.is_empty()).collect();
        let looked = looked_at(&rig.window, pictures.iter().flat_map(|p| &p.hits));
        let (looked, window) = cropped(looked, &rig.window).ok_or(rays)?;
        rig.window = window;
        Ok(Self { looked, rays, pictures: Some(pictures) })
    }

    /// Rounds of cameras that together see every piece of surface that eyes see and the central image does not hold: always the eye that
    /// sees the most pieces that none before it did. Where eyes may be anywhere: the corners of the users' box.
    pub fn cameras(self, rig: &Rig, central: &[Sample], tolerance: &Tolerance) -> Vec<Vec<View>> {
        let Some(pictures) = self.pictures else { return rig.corner_cameras() };
        // Per eye, its pieces and the squares that show them.
        let pieces: Vec<BTreeMap<[i32; 3], Vec<u32>>> = pictures
            .par_iter()
            .map(|picture| {
                let mut pieces: BTreeMap<[i32; 3], Vec<u32>> = BTreeMap::new();
                for seen in picture.hits.iter().filter(|s| !held(rig, central, tolerance, s)) {
                    pieces.entry(piece(seen)).or_default().push(seen.square);
                }
                pieces
            })
            .collect();
        let mut gains: Vec<usize> = pieces.iter().map(BTreeMap::len).collect();
        let mut known: BTreeSet<[i32; 3]> = BTreeSet::new();
        let mut views = Vec::new();
        while views.len() < MOST_CAMERAS {
            // Gains only shrink: the largest is up to date once recounting leaves it the largest. Of equals the first.
            let (best, gain) = loop {
                let best = (0..gains.len()).rev().max_by_key(|i| gains[*i]);
                let Some(best) = best else { break (0, 0) };
                let fresh = pieces[best].keys().filter(|k| !known.contains(*k)).count();
                if fresh == gains[best] {
                    break (best, fresh);
                }
                gains[best] = fresh;
            };
            if gain == 0 {
                break;
            }
            let new = pieces[best].iter().filter(|(k, _)| !known.contains(*k));
            views.extend(pictures[best].view(new.flat_map(|(_, squares)| squares)));
            known.extend(pieces[best].keys());
            gains[best] = 0;
        }
        // A few at a time: what one finds, the next need not trace.
        views.chunks(4).map(<[View]>::to_vec).collect()
    }
}

/// Whether the central image holds what is seen.
fn held(rig: &Rig, central: &[Sample], tolerance: &Tolerance, seen: &Seen) -> bool {
    let [u, v, d] = seen.at;
    let (column, row) = (u.floor() as i64 - i64::from(rig.window.left), v.floor() as i64 - i64::from(rig.window.top));
    let Some(at) = rig.window.index(column, row) else { return true };
    let s = &central[at];
    if s.disparity <= 0.0 {
        return f64::from(s.disparity) == d;
    }
    let (cu, cv) = rig.window.centre(at);
    let there = s.disparity + s.gradient[0] * (u - cu) as f32 + s.gradient[1] * (v - cv) as f32;
    (there - d as f32).abs() <= HELD_STEPS * tolerance.step
}

/// Hits with one such number show one piece of surface.
fn piece(seen: &Seen) -> [i32; 3] {
    let [u, v, d] = seen.at;
    let depth = if d > 0.0 { (d.ln() / PIECE_DEPTH).floor() as i32 } else { i32::MIN };
    [(u / PIECE).floor() as i32, (v / PIECE).floor() as i32, depth]
}

impl Picture {
    /// Casts the rays, and counts them.
    fn of<C: SubsetCaster>(caster: &C, rig: &Rig, camera: ConstructionCamera, number: usize) -> (Self, u64) {
        let (width, height) = (camera.window.width as usize, camera.window.height as usize);
        let (columns, rows) = (width.div_ceil(SQUARE), height.div_ceil(SQUARE));
        let back = camera.shift.reversed();
        let (mut hits, mut count) = (Vec::new(), 0);
        // Tiles of 8 by 8 rays: neighbours share most of their way.
        const TILE: usize = 8;
        for tile_row in (0..rows).step_by(TILE) {
            for tile_column in (0..columns).step_by(TILE) {
                let squares: Vec<(u32, f64, f64)> = (tile_row..(tile_row + TILE).min(rows))
                    .flat_map(|r| (tile_column..(tile_column + TILE).min(columns)).map(move |c| (r, c)))
                    .filter_map(|(r, c)| {
                        let [x, y] = scattered((number * rows + r) * columns + c);
                        let u = f64::from(camera.window.left) + (c as f64 + x) * SQUARE as f64;
                        let v = f64::from(camera.window.top) + (r as f64 + y) * SQUARE as f64;
                        let (u, v) = (u / camera.scale, v / camera.scale);
                        rig.may_hold(&camera, u, v).then_some(((r * columns + c) as u32, u, v))
                    })
                    .collect();
                let ray = |(_, u, v): &(u32, f64, f64)| Ray {
                    origin: camera.position,
                    direction: rig.lens.ray(*u, *v),
                    t_min: NEAR_M,
                    t_max: f64::INFINITY,
                };
                let rays: Vec<Ray> = squares.iter().map(ray).collect();
                let mut met = vec![Met::Nothing; rays.len()];
                caster.meet(&rays, &mut met);
                count += rays.len() as u64;
                for ((square, u, v), met) in squares.into_iter().zip(met) {
                    let d = match met {
                        Met::Stays => continue,
                        Met::Nothing => 0.0,
                        Met::Replaced(depth) => 1.0 / depth,
                    };
                    // Replaced cells that another image of the placement shows.
                    if d > 1.0 / camera.near_m {
                        continue;
                    }
                    let (u, v, home) = back.apply(u, v, d);
                    let growth = 1.0 / (1.0 - back.forward * d);
                    let half = 0.5 * SQUARE as f64 / camera.scale * growth;
                    if rig.in_reach(u, v, home) && rig.window.distance(u, v) <= half + MARGIN {
                        hits.push(Seen { square, at: [u, v, home], half });
                    }
                }
            }
        }
        (Self { camera, columns, rows, hits }, count)
    }

    /// The camera cut to some squares and those around them.
    fn view<'a>(&self, some: impl Iterator<Item = &'a u32>) -> Option<View> {
        let (columns, rows) = (self.columns, self.rows);
        let mut wide = vec![false; columns * rows];
        let (mut c, mut r) = ([usize::MAX, 0], [usize::MAX, 0]);
        for at in some {
            let (row, column) = (*at as usize / columns, *at as usize % columns);
            for row in row.saturating_sub(1)..(row + 2).min(rows) {
                for column in column.saturating_sub(1)..(column + 2).min(columns) {
                    wide[row * columns + column] = true;
                    c = [c[0].min(column), c[1].max(column + 1)];
                    r = [r[0].min(row), r[1].max(row + 1)];
                }
            }
        }
        if c[0] >= c[1] {
            return None;
        }
        let squares = (r[0]..r[1]).flat_map(|row| &wide[row * columns + c[0]..row * columns + c[1]]);
        let open = Open::new(&squares.copied().collect::<Vec<_>>(), c[1] - c[0]);
        let mut camera = self.camera;
        camera.window = part(&camera.window, c, r, SQUARE);
        Some(View { camera, open: Some(open) })
    }
}

/// Columns and rows of squares of a window, from and to, as a window.
fn part(w: &Window, columns: [usize; 2], rows: [usize; 2], side: usize) -> Window {
    let span =
        |x: [usize; 2], limit: u32| ((x[0] * side) as i32, ((x[1] * side) as u32).min(limit) - (x[0] * side) as u32);
    let ((left, width), (top, height)) = (span(columns, w.width), span(rows, w.height));
    Window { left: w.left + left, top: w.top + top, width, height }
}

/// A place in the unit square, another for each number: regular rasters overlook regular gaps.
fn scattered(number: usize) -> [f64; 2] {
    // SplitMix64's mixing step.
    let mut z = (number as u64).wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^= z >> 31;
    [z >> 40, z >> 16 & 0xFF_FFFF].map(|b| b as f64 / f64::from(1u32 << 24))
}

/// The blocks that hold what is seen, and a margin.
fn looked_at<'a>(window: &Window, hits: impl Iterator<Item = &'a Seen>) -> Looked {
    let columns = (window.width as usize).div_ceil(BLOCK);
    let rows = (window.height as usize).div_ceil(BLOCK);
    let mut blocks = vec![false; columns * rows];
    let span = |at: f64, half: f64, first: i32, n: usize| {
        let place = |x: f64| ((x - f64::from(first)) / BLOCK as f64).floor();
        let (low, high) = (place(at - half - MARGIN), place(at + half + MARGIN));
        // Beside the window: an empty range.
        (low.max(0.0) as usize)..((high + 1.0).clamp(0.0, n as f64) as usize)
    };
    for Seen { at: [u, v, _], half, .. } in hits {
        for row in span(*v, *half, window.top, rows) {
            for column in span(*u, *half, window.left, columns) {
                blocks[row * columns + column] = true;
            }
        }
    }
    Looked { blocks, columns }
}

/// The smallest window around what is looked at; None if nothing is.
fn cropped(looked: Looked, window: &Window) -> Option<(Looked, Window)> {
    let columns = looked.columns;
    let (mut c, mut r) = ([usize::MAX, 0], [usize::MAX, 0]);
    for at in (0..looked.blocks.len()).filter(|at| looked.blocks[*at]) {
        c = [c[0].min(at % columns), c[1].max(at % columns + 1)];
        r = [r[0].min(at / columns), r[1].max(at / columns + 1)];
    }
    if c[0] >= c[1] {
        return None;
    }
    let blocks =
        (r[0]..r[1]).flat_map(|row| &looked.blocks[row * columns + c[0]..row * columns + c[1]]).copied().collect();
    Some((Looked { blocks, columns: c[1] - c[0] }, part(window, c, r, BLOCK)))
}
