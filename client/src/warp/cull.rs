//! Culling before the warp: the tiles that can reach the picture, and the rows they can reach.
//!
//! In: the tiles of an image, a warp. Out: tiles that may reach the picture, with their rows and
//! bounds.
//!
//! After the recursive clipping of columns by their smallest and largest disparity (Rafferty,
//! Aliaga, Popescu and Lastra 1998, section 4), with boxes instead of columns: u, v and disparity
//! of a block of tiles are bounded by a box. W is affine in them, and x and y are monotone in each
//! where W > 0, so that the box's eight corners bound its picture. A block that misses the picture
//! is rejected as a whole; one that may reach it is subdivided, down to single tiles. Boxes grow
//! only toward the root, so that no tile is lost that its own test would keep.

use super::{
    Stamp,
    bounds::Bounds,
    matrix::{WarpMatrix, largest_singular_value},
    tiles::{Part, Tile},
    transform::Window,
};
use std::ops::Range;

/// A tile that may reach the picture.
pub struct Reach<'a> {
    /// The part that holds the tile's arrays.
    pub part: &'a Part,
    /// The tile.
    pub tile: &'a Tile,
    /// Their numbers: part, tile.
    pub number: (u32, u32),
    /// What of it the picture can show.
    pub within: Within,
}

/// What a part of the picture can show of something.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Within {
    /// First row.
    pub from: u32,
    /// After the last row.
    pub to: u32,
    /// Bounds in the picture; None if the box may cross the eye's plane, where there are none.
    pub silhouette: Option<Silhouette>,
}

/// Bounds of something that lies ahead of the eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Silhouette {
    /// Upper left corner, output pixels.
    pub low: [f64; 2],
    /// Lower right corner, output pixels.
    pub high: [f64; 2],
    /// The largest disparity in the picture, 1/m.
    pub nearest: f64,
    /// Smallest and largest depth over that in its image.
    w: [f64; 2],
}

impl Silhouette {
    /// Upper bound of footprints in a window, output pixels: each entry of the Jacobian, (slope - p
    /// slope of W) / W, is bounded over the ranges of p and W; the largest singular value of the
    /// matrix of middles plus the norm of the half ranges bounds that of all matrices between
    /// (Weyl's inequality).
    pub fn largest_footprint(&self, matrix: &WarpMatrix, window: &Window) -> f64 {
        let (first, end) = (f64::from(window.first_row), f64::from(window.first_row + window.rows));
        let places = [
            [self.low[0].max(0.0), self.high[0].min(f64::from(window.width))],
            [self.low[1].max(first), self.high[1].min(end)],
        ];
        let [[xu, xv, ..], [yu, yv, ..], [wu, wv, ..]] = matrix.rows;
        let mut off2 = 0.0;
        let mut middle = |slope: f64, place: [f64; 2], slope_w: f64| {
            let [a, b] = place.map(|p| slope - p * slope_w);
            let (low, high) = (a.min(b), a.max(b));
            let [least_w, most_w] = self.w;
            let (low, high) =
                (low / if low < 0.0 { least_w } else { most_w }, high / if high < 0.0 { most_w } else { least_w });
            off2 += (0.5 * (high - low)).powi(2);
            0.5 * (low + high)
        };
        let [x, y] = places;
        let jacobian = [middle(xu, x, wu), middle(xv, x, wv), middle(yu, y, wu), middle(yv, y, wv)];
        largest_singular_value(jacobian) + off2.sqrt()
    }
}

/// Where a box lies.
enum Place {
    /// Behind the eye.
    Behind,
    /// On both sides of the eye's plane.
    Across,
    /// Ahead.
    Ahead(Silhouette),
}

impl Bounds {
    /// Bounds in the picture. W is affine in u, v and disparity, and x, y and disparity over W are
    /// monotone in each of them where W > 0, so that the corners bound everything.
    fn place(&self, matrix: &WarpMatrix) -> Place {
        let [u0, v0, u1, v1] = self.place.map(f64::from);
        let mut out = Silhouette { low: [f64::MAX; 2], high: [f64::MIN; 2], nearest: 0.0, w: [f64::MAX, 0.0] };
        let mut behind = 0;
        for d in self.disparity.map(f64::from) {
            for (u, v) in [(u0, v0), (u1, v0), (u0, v1), (u1, v1)] {
                let [x, y, w] = matrix.homogeneous(u, v, d);
                if w <= 0.0 {
                    behind += 1;
                    continue;
                }
                for (axis, p) in [x / w, y / w].into_iter().enumerate() {
                    out.low[axis] = out.low[axis].min(p);
                    out.high[axis] = out.high[axis].max(p);
                }
                out.nearest = out.nearest.max(d / w);
                out.w = [out.w[0].min(w), out.w[1].max(w)];
            }
        }
        match behind {
            8 => Place::Behind,
            0 => Place::Ahead(out),
            _ => Place::Across,
        }
    }

    /// The part of a box that a rectangle of the output (left, top, right, bottom) can show; None
    /// if it reaches no pixel.
    pub fn within(&self, matrix: &WarpMatrix, [left, top, right, bottom]: [u32; 4]) -> Option<Within> {
        let silhouette = match self.place(matrix) {
            Place::Behind => return None,
            Place::Across => return Some(Within { from: top, to: bottom, silhouette: None }),
            Place::Ahead(silhouette) => silhouette,
        };
        let margin = Stamp::LARGEST_REACH_PX;
        let [x0, y0] = silhouette.low.map(|p| p - margin);
        let [x1, y1] = silhouette.high.map(|p| p + margin);
        if x1 < f64::from(left) || y1 < f64::from(top) || x0 > f64::from(right) || y0 > f64::from(bottom) {
            return None;
        }
        // Saturating conversions.
        let (from, to) = ((y0.floor().max(0.0) as u32).max(top), (y1.ceil().max(0.0) as u32).min(bottom));
        Some(Within { from, to, silhouette: Some(silhouette) })
    }
}

/// Tiles in a block that is not divided further.
const TILES_PER_BLOCK: usize = 4;

/// A tree of blocks of tiles, parents before children.
#[derive(Debug, Default)]
pub struct Blocks {
    blocks: Vec<Block>,
    /// Tiles (part, tile) in the order of the blocks.
    tiles: Vec<[u32; 2]>,
}

#[derive(Debug)]
struct Block {
    bounds: Bounds,
    /// The next block that is not part of this one.
    next: usize,
    /// Its tiles if it is not divided.
    tiles: Range<usize>,
}

impl Blocks {
    /// Divides the tiles of an image.
    pub fn new(parts: &[Part]) -> Self {
        let numbers = |p: usize, part: &Part| (0..part.tiles.len()).map(move |t| [p as u32, t as u32]);
        let tiles = parts.iter().enumerate().flat_map(|(p, part)| numbers(p, part)).collect();
        let mut blocks = Self { blocks: Vec::new(), tiles };
        blocks.divide(parts, 0..blocks.tiles.len());
        blocks
    }

    fn divide(&mut self, parts: &[Part], range: Range<usize>) {
        let tile = |[part, tile]: &[u32; 2]| &parts[*part as usize].tiles[*tile as usize];
        let mut bounds = Bounds::NONE;
        self.tiles[range.clone()].iter().for_each(|t| bounds.join(&tile(t).bounds));
        let at = self.blocks.len();
        let whole = range.len() <= TILES_PER_BLOCK;
        self.blocks.push(Block { bounds, next: 0, tiles: if whole { range.clone() } else { 0..0 } });
        if !whole {
            let [u0, v0, u1, v1] = bounds.place;
            let middle = range.start + range.len() / 2;
            let wide = u1 - u0 >= v1 - v0;
            let place = |t: &[u32; 2]| if wide { tile(t).column } else { tile(t).row };
            // Ties are broken by number, so that blocks do not depend on the sorting algorithm.
            self.tiles[range.clone()].select_nth_unstable_by_key(range.len() / 2, |t| (place(t), *t));
            self.divide(parts, range.start..middle);
            self.divide(parts, middle..range.end);
        } else {
            self.tiles[range].sort_unstable();
        }
        self.blocks[at].next = self.blocks.len();
    }

    /// The tiles that may reach a rectangle of the picture (left, top, right, bottom), always in
    /// the same order; with `all` every tile, as if it could
    /// reach every row.
    pub fn reaching<'a>(&self, parts: &'a [Part], matrix: &WarpMatrix, within: [u32; 4], all: bool) -> Vec<Reach<'a>> {
        let mut out = Vec::new();
        let everywhere = Within { from: within[1], to: within[3], silhouette: None };
        let shown = |bounds: &Bounds| if all { Some(everywhere) } else { bounds.within(matrix, within) };
        let mut at = 0;
        while let Some(block) = self.blocks.get(at) {
            if shown(&block.bounds).is_none() {
                at = block.next;
                continue;
            }
            at += 1;
            for [p, t] in &self.tiles[block.tiles.clone()] {
                let part = &parts[*p as usize];
                let tile = &part.tiles[*t as usize];
                let number = (*p, *t);
                out.extend(shown(&tile.bounds).map(|within| Reach { part, tile, number, within }));
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use ldi_protocol::{OutputCamera, Pose};
    use proptest::prelude::*;

    const SIZE: (u32, u32) = (160, 120);
    const WHOLE: [u32; 4] = [0, 0, SIZE.0, SIZE.1];
    const WINDOW: Window = Window { width: SIZE.0, first_row: 0, rows: SIZE.1 };

    fn rows(bounds: &Bounds, matrix: &WarpMatrix) -> Option<(u32, u32)> {
        bounds.within(matrix, WHOLE).map(|w| (w.from, w.to))
    }

    /// A part of tiles with nothing but bounds.
    fn part_of(tiles: &[Bounds]) -> Part {
        let mut part = Part::default();
        for bounds in tiles {
            let mut tile = Tile::new(bounds.place[1] as usize, bounds.place[0] as usize, &mut part);
            tile.bounds = *bounds;
            part.tiles.push(tile);
        }
        part
    }

    fn bounds() -> impl Strategy<Value = Bounds> {
        ((0.0f32..320.0, 0.0f32..240.0), (0.1f32..70.0, 0.1f32..20.0), (0.01f32..2.0, 0.0f32..2.0))
            .prop_map(|((u, v), (w, h), (d, more))| Bounds { place: [u, v, u + w, v + h], disparity: [d, d + more] })
    }

    fn matrix(eye: [f64; 3], yaw_deg: f64, pitch_deg: f64) -> WarpMatrix {
        let camera = super::super::analytic::ldi_camera(DVec3::ZERO, 320, 240, 90.0);
        let pose = Pose { position: DVec3::from_array(eye), yaw_deg, pitch_deg };
        WarpMatrix::new(&camera, &pose, &OutputCamera { width: SIZE.0, height: SIZE.1, fov_deg: 60.0 })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        /// Blocks keep exactly the tiles that their own bounds keep, and no point of a dropped one
        /// lands on the picture or above its rows.
        #[test]
        fn what_is_clipped_cannot_be_seen(
            tiles in proptest::collection::vec(bounds(), 1..60),
            eye in prop::array::uniform3(-3.0f64..3.0),
            yaw in -180.0f64..180.0,
            pitch in -60.0f64..60.0,
            inside in prop::array::uniform3(0.0f32..1.0),
        ) {
            let matrix = matrix(eye, yaw, pitch);
            let parts = [part_of(&tiles)];
            let kept = Blocks::new(&parts).reaching(&parts, &matrix, WHOLE, false);
            let mut alone: Vec<_> = tiles.iter().filter_map(|b| rows(b, &matrix)).collect();
            let mut found: Vec<_> = kept.iter().map(|r| (r.within.from, r.within.to)).collect();
            alone.sort_unstable();
            found.sort_unstable();
            prop_assert_eq!(alone, found);
            // A part of the picture: nothing is lost there, and nothing is drawn beside its rows.
            let part = [30, 20, 110, 90];
            for b in &tiles {
                let mix = |from: f32, to: f32, t: f32| f64::from(from + (to - from) * t);
                let [u0, v0, u1, v1] = b.place;
                let at = (mix(u0, u1, inside[0]), mix(v0, v1, inside[1]), mix(b.disparity[0], b.disparity[1], inside[2]));
                let Some(p) = matrix.warp(at.0, at.1, at.2) else { continue };
                let on_picture = p.x >= 0.0 && p.x < f64::from(SIZE.0) && p.y >= 0.0 && p.y < f64::from(SIZE.1);
                let whole = b.within(&matrix, WHOLE);
                let rows = whole.map(|w| (w.from, w.to));
                let in_part = p.x >= 30.0 && p.x < 110.0 && p.y >= 20.0 && p.y < 90.0;
                let rows_of_part = b.within(&matrix, part).map(|w| (w.from, w.to));
                prop_assert!(!in_part || rows_of_part.is_some_and(|(from, to)| p.y >= f64::from(from) && p.y < f64::from(to)));
                prop_assert!(rows_of_part.is_none_or(|(from, to)| from >= 20 && to <= 90));
                prop_assert!(!on_picture || rows.is_some_and(|(from, to)| p.y >= f64::from(from) && p.y < f64::from(to)));
                if let Some(s) = whole.and_then(|w| w.silhouette) {
                    let slack = 1e-9 * (1.0 + p.x.abs() + p.y.abs());
                    prop_assert!(p.x >= s.low[0] - slack && p.x <= s.high[0] + slack, "{p:?} {s:?}");
                    prop_assert!(p.y >= s.low[1] - slack && p.y <= s.high[1] + slack, "{p:?} {s:?}");
                    prop_assert!(p.disparity <= s.nearest * (1.0 + 1e-9), "{p:?} {s:?}");
                    let footprint = matrix.footprint(at.0, at.1, at.2).unwrap();
                    let bound = s.largest_footprint(&matrix, &WINDOW);
                    prop_assert!(!on_picture || footprint <= bound * (1.0 + 1e-9), "{footprint} {bound} {s:?}");
                }
            }
        }
    }

    #[test]
    fn the_bound_of_footprints_is_near_where_little_varies() {
        // A tile of a wall whose disparity changes by a hundredth.
        let bounds = Bounds { place: [128.0, 96.0, 192.0, 112.0], disparity: [0.1, 0.101] };
        for (eye, yaw) in [([0.0; 3], 0.0), ([1.0, 0.5, -3.0], 20.0), ([-2.0, 0.0, 2.0], -35.0)] {
            let matrix = matrix(eye, yaw, 10.0);
            let silhouette = bounds.within(&matrix, WHOLE).and_then(|w| w.silhouette).unwrap();
            let on_picture = |(u, v): &(f64, f64)| {
                let p = matrix.warp(*u, *v, 0.101).unwrap();
                p.x >= 0.0 && p.x < f64::from(SIZE.0) && p.y >= 0.0 && p.y < f64::from(SIZE.1)
            };
            let points = (0..=16).flat_map(|y| (0..=64).map(move |x| (128.0 + f64::from(x), 96.0 + f64::from(y))));
            let footprints = points.filter(on_picture).map(|(u, v)| matrix.footprint(u, v, 0.101).unwrap());
            let largest = footprints.fold(0.0, f64::max);
            let bound = silhouette.largest_footprint(&matrix, &WINDOW);
            assert!(largest > 0.0 && bound >= largest && bound < 1.3 * largest, "{bound} {largest}");
        }
    }

    #[test]
    fn most_of_a_large_image_is_clipped_without_looking_at_its_tiles() {
        // 100 x 100 tiles of a frontal wall, of which the picture shows a corner.
        let tiles: Vec<Bounds> = (0..10_000u32)
            .map(|i| {
                let (u, v) = ((i % 100) as f32 * 64.0, (i / 100) as f32 * 16.0);
                Bounds { place: [u, v, u + 64.0, v + 16.0], disparity: [0.1, 0.1] }
            })
            .collect();
        let parts = [part_of(&tiles)];
        let matrix = matrix([0.0; 3], 0.0, 0.0);
        let blocks = Blocks::new(&parts);
        let kept = blocks.reaching(&parts, &matrix, WHOLE, false).len();
        assert!(kept > 10 && kept < 200, "{kept}");
        let mut looked_at = 0;
        let mut at = 0;
        while let Some(block) = blocks.blocks.get(at) {
            looked_at += 1;
            at = if rows(&block.bounds, &matrix).is_some() { at + 1 } else { block.next };
        }
        assert!(looked_at < 4 * kept, "{looked_at} blocks for {kept} tiles");
        assert_eq!(blocks.reaching(&parts, &matrix, WHOLE, true).len(), 10_000);
    }
}
