//! Regions: floors that steps join, and what surrounds them.
//!
//! In: the floors of all tiles. Out: the region of every floor, and per region its area, how much
//! of it is roof-like, what its border falls to, and which regions lie beyond a thin obstacle at
//! the same level (closed doors, thresholds).

use super::{
    floors::{Floor, STEP_M, TileFloors},
    tiles::LINES,
};
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};

/// A border that falls by at most this is that of furniture or a platform, metres: one can climb
/// or jump down.
const LOW_FALL_M: f32 = 2.0;
/// Heights above a floor at which walls are looked for, metres: above sills and tables, below
/// lintels. What leaves one of them free is no wall.
const CHEST_M: [f32; 3] = [0.9, 1.2, 1.55];
/// Head room of a place that people go to upright, metres: below it are voids above ceilings and
/// crawl spaces.
const DOOR_M: f64 = 2.0;
/// Highest ledge that people get up on where it is long, metres.
const LEDGE_M: f64 = 0.6;
/// Lines that a thin obstacle may hide: a wall with a door leaf of up to 0.75 m. Larger: rooms
/// join across shafts.
const OBSTACLE_LINES: u32 = 3;

/// Figures of a region. Areas and borders in lines.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Region {
    /// Floors.
    pub lines: u32,
    /// Floors under the open sky.
    pub sky: u32,
    /// Of these, floors with another one below.
    pub over_another: u32,
    /// Floors that are thin sheets over a room.
    pub sheets: u32,
    /// Floors with less head room than a door.
    pub low: u32,
    /// Floors that show their back.
    pub backs: u32,
    /// Sides of its floors where it ends.
    pub border: u32,
    /// Of these, sides with a lower floor beside them, at most [`LOW_FALL_M`] down.
    pub low_falls: u32,
    /// Of these, sides with floors much lower only.
    pub deep_falls: u32,
}

/// All floors of a scene's tiles, in regions.
pub(super) struct Regions {
    /// The tiles.
    pub tiles: Vec<TileFloors>,
    /// Position of a tile's first floor among all floors.
    first: Vec<u32>,
    by_place: HashMap<[u32; 2], u32>,
    /// Region of each floor.
    region_of: Vec<u32>,
    /// The regions, by their first floor.
    pub regions: Vec<Region>,
    /// Pairs of regions (smaller number first) beyond a thin obstacle at the same level, and on
    /// how many lines.
    pub doors: BTreeMap<(u32, u32), u32>,
    /// Pairs of regions beside each other on two heights, [`STEP_M`] to [`LEDGE_M`] apart, and on
    /// how many sides of lines.
    pub ledges: BTreeMap<(u32, u32), u32>,
}

impl Regions {
    /// Joins the floors of tiles. `is_open` says whether nothing stands between two places, given
    /// by line (place along x and z) and height; it is asked under roofs: lines alone miss thin
    /// walls.
    pub fn of(tiles: Vec<TileFloors>, is_open: &(dyn Fn([u32; 2], [u32; 2], f32) -> bool + Sync)) -> Self {
        let mut first = vec![0u32];
        for t in &tiles {
            first.push(first.last().copied().unwrap_or(0) + t.floors.len() as u32);
        }
        let by_place = tiles.iter().map(|t| t.place).zip(0..).collect();
        let floors = *first.last().unwrap_or(&0);
        let mut all = Self {
            tiles,
            first,
            by_place,
            region_of: Vec::new(),
            regions: Vec::new(),
            doors: BTreeMap::new(),
            ledges: BTreeMap::new(),
        };
        let mut sets = Sets::new(floors);
        let steps: Vec<Vec<[u32; 2]>> =
            (0..all.tiles.len()).into_par_iter().map(|t| all.steps_of(t, is_open)).collect();
        steps.iter().flatten().for_each(|[a, b]| sets.join(*a, *b));
        let mut region_of_root: HashMap<u32, u32> = HashMap::new();
        all.region_of = (0..floors)
            .map(|n| {
                let next = region_of_root.len() as u32;
                *region_of_root.entry(sets.root(n)).or_insert(next)
            })
            .collect();
        all.regions = vec![Region::default(); region_of_root.len()];
        for tile in 0..all.tiles.len() {
            for n in 0..all.tiles[tile].floors.len() {
                all.measure(tile, n);
            }
        }
        all
    }

    /// Pairs of floors, by number, that a step joins: those of a tile with their neighbours toward
    /// larger x and z.
    fn steps_of(&self, tile: usize, is_open: &(dyn Fn([u32; 2], [u32; 2], f32) -> bool + Sync)) -> Vec<[u32; 2]> {
        let mut out = Vec::new();
        let place = |tile: usize, line: u32| {
            let [i, k] = self.tiles[tile].place;
            [i * LINES + line % LINES, k * LINES + line / LINES]
        };
        for (n, f) in self.tiles[tile].floors.iter().enumerate() {
            for side in [[1, 0], [0, 1]] {
                let Some((other, line)) = self.neighbour(tile, u32::from(f.line), side, 1) else { continue };
                for o in self.tiles[other].of_line(line) {
                    let there = &self.tiles[other].floors[o];
                    if f64::from((there.y_m - f.y_m).abs()) > STEP_M {
                        continue;
                    }
                    let is_covered = f.above_m.is_finite() || there.above_m.is_finite();
                    let foot_m = f.y_m.max(there.y_m);
                    let [from, to] = [place(tile, u32::from(f.line)), place(other, line)];
                    if is_covered && !CHEST_M.iter().any(|chest_m| is_open(from, to, foot_m + chest_m)) {
                        continue;
                    }
                    out.push([self.first[tile] + n as u32, self.first[other] + o as u32]);
                }
            }
        }
        out
    }

    /// All floors with their region: (tile, floor, region).
    pub fn floors(&self) -> impl Iterator<Item = (&TileFloors, &Floor, u32)> {
        self.tiles.iter().zip(&self.first).flat_map(move |(t, first)| {
            t.floors.iter().enumerate().map(move |(n, f)| (t, f, self.region_of[*first as usize + n]))
        })
    }

    /// The floors of a line, given by its place in the raster, each with its region.
    pub fn at(&self, place: [u32; 2]) -> impl Iterator<Item = (&Floor, u32)> {
        let tile = self.by_place.get(&place.map(|p| p / LINES)).copied();
        let line = place[1] % LINES * LINES + place[0] % LINES;
        tile.into_iter().flat_map(move |t| {
            let (tile, first) = (&self.tiles[t as usize], self.first[t as usize] as usize);
            tile.of_line(line).map(move |n| (&tile.floors[n], self.region_of[first + n]))
        })
    }

    /// The tile and line some lines away; None outside of the tiles.
    fn neighbour(&self, tile: usize, line: u32, [di, dk]: [i32; 2], lines: u32) -> Option<(usize, u32)> {
        let (i, k) = ((line % LINES) as i32 + di * lines as i32, (line / LINES) as i32 + dk * lines as i32);
        let edge = LINES as i32;
        if (0..edge).contains(&i) && (0..edge).contains(&k) {
            return Some((tile, (k * edge + i) as u32));
        }
        let place = self.tiles[tile].place;
        let there =
            [place[0].checked_add_signed(i.div_euclid(edge))?, place[1].checked_add_signed(k.div_euclid(edge))?];
        let other = *self.by_place.get(&there)?;
        Some((other as usize, (k.rem_euclid(edge) * edge + i.rem_euclid(edge)) as u32))
    }

    /// Adds a floor to its region's figures.
    fn measure(&mut self, tile: usize, n: usize) {
        let f = self.tiles[tile].floors[n];
        let own = self.region_of[self.first[tile] as usize + n];
        let line = u32::from(f.line);
        let mut sides = [0u32; 3];
        let (mut door, mut ledges) = (None, Vec::new());
        for side in [[1, 0], [0, 1], [-1, 0], [0, -1]] {
            let Some((other, there)) = self.neighbour(tile, line, side, 1) else { continue };
            let of = &self.tiles[other];
            let beside = || of.of_line(there).map(|o| of.floors[o]);
            let level = of.of_line(there).find(|o| f64::from((of.floors[*o].y_m - f.y_m).abs()) <= STEP_M);
            if let Some(level) = level {
                // A wall between two lines.
                let region = self.region_of[self.first[other] as usize + level];
                if region != own && door.is_none() {
                    door = Some(region);
                }
                continue;
            }
            sides[0] += 1;
            let ledge = of.of_line(there).find(|o| f64::from((of.floors[*o].y_m - f.y_m).abs()) <= LEDGE_M);
            if let Some(o) = ledge {
                ledges.push(self.region_of[self.first[other] as usize + o]);
            }
            // The highest floor below, unless something stands above it that reaches higher than
            // this floor.
            if let Some(below) = beside().rfind(|o| o.y_m < f.y_m && o.above_m > f.y_m) {
                sides[if f.y_m - below.y_m <= LOW_FALL_M { 1 } else { 2 }] += 1;
                continue;
            }
            if side[0] + side[1] > 0 && door.is_none() {
                door = (2..=OBSTACLE_LINES + 1).find_map(|lines| self.level_with(tile, line, side, lines, f.y_m));
            }
        }
        let region = &mut self.regions[own as usize];
        region.lines += 1;
        region.sky += u32::from(f.above_m.is_infinite());
        region.over_another += u32::from(f.above_m.is_infinite() && n > self.tiles[tile].of_line(line).start);
        region.sheets += u32::from(f.is_sheet);
        region.backs += u32::from(f.is_back);
        region.low += u32::from(f64::from(f.above_m - f.y_m) < DOOR_M);
        region.border += sides[0];
        region.low_falls += sides[1];
        region.deep_falls += sides[2];
        for other in ledges.into_iter().filter(|other| *other != own) {
            *self.ledges.entry((own.min(other), own.max(other))).or_default() += 1;
        }
        if let Some(other) = door.filter(|other| *other != own) {
            *self.doors.entry((own.min(other), own.max(other))).or_default() += 1;
        }
    }

    /// The region of a floor at this height some lines away.
    fn level_with(&self, tile: usize, line: u32, side: [i32; 2], lines: u32, y_m: f32) -> Option<u32> {
        let (other, there) = self.neighbour(tile, line, side, lines)?;
        let of = &self.tiles[other];
        let found = of.of_line(there).find(|o| f64::from((of.floors[*o].y_m - y_m).abs()) <= STEP_M)?;
        Some(self.region_of[self.first[other] as usize + found])
    }
}

/// Disjoint sets, the smallest member being the root.
struct Sets(Vec<u32>);

impl Sets {
    fn new(n: u32) -> Self {
        Self((0..n).collect())
    }
    fn root(&mut self, mut n: u32) -> u32 {
        while self.0[n as usize] != n {
            let up = self.0[self.0[n as usize] as usize];
            self.0[n as usize] = up;
            n = up;
        }
        n
    }
    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Floors over 2 x 2 tiles from surfaces given as (height, height above) by line.
    fn regions(surfaces: &[&dyn Fn(u32, u32) -> Option<(f32, f32)>]) -> Regions {
        let tile = |place: [u32; 2]| {
            let mut t = TileFloors { place, first: vec![0], ..Default::default() };
            for line in 0..LINES * LINES {
                let (i, k) = (place[0] * LINES + line % LINES, place[1] * LINES + line / LINES);
                let found = surfaces.iter().filter_map(|s| s(i, k));
                t.floors.extend(found.map(|(y_m, above_m)| Floor {
                    line: line as u16,
                    y_m,
                    above_m,
                    up: true,
                    above_up: false,
                    is_over_a_room: false,
                    is_sheet: false,
                    is_back: false,
                }));
                t.first.push(t.floors.len() as u32);
            }
            t
        };
        Regions::of([[3, 5], [4, 5], [3, 6], [4, 6]].map(tile).to_vec(), &|_, _, _| true)
    }

    fn shifted(f: impl Fn(u32, u32) -> Option<(f32, f32)>) -> impl Fn(u32, u32) -> Option<(f32, f32)> {
        move |i, k| f(i - 3 * LINES, k - 5 * LINES)
    }

    const SKY: f32 = f32::INFINITY;

    #[test]
    fn steps_join_floors_across_tiles() {
        let all = regions(&[&|_, _| Some((1.0, SKY))]);
        assert_eq!(all.regions.len(), 1);
        assert_eq!(all.regions[0].lines, 4 * LINES * LINES);
        assert_eq!(all.regions[0].border, 0, "nothing is known beyond the tiles");
        let cut = shifted(|i, _| (i != 64).then_some((1.0, 4.0)));
        let all = regions(&[&cut]);
        assert_eq!(all.regions.len(), 2, "a wall on the border of the tiles");
        assert_eq!(all.regions[0].border, 2 * LINES);
        assert_eq!(all.doors, BTreeMap::from([((0, 1), 2 * LINES)]), "which is thin");
        let thick = shifted(|i, _| (!(60..70).contains(&i)).then_some((1.0, 4.0)));
        assert!(regions(&[&thick]).doors.is_empty());
    }

    #[test]
    fn a_table_falls_to_the_floor_and_a_roof_lies_over_another() {
        let is_table = |i: u32, k: u32| (10..14).contains(&i) && (10..18).contains(&k);
        let floor = shifted(move |i, k| (!is_table(i, k)).then_some((0.0, 3.0)));
        let table = shifted(move |i, k| is_table(i, k).then_some((0.8, 3.0)));
        let roof = shifted(|_, _| Some((3.2, SKY)));
        let all = regions(&[&floor, &table, &roof]);
        assert_eq!(all.regions.len(), 3);
        let table = all.regions.iter().find(|r| r.lines == 32).expect("a table");
        assert_eq!((table.border, table.low_falls, table.deep_falls), (24, 24, 0));
        let roof = all.regions.iter().find(|r| r.over_another > 0).expect("a roof");
        assert_eq!(roof.over_another, roof.lines);
        let places: u32 =
            all.at([3 * LINES + 11, 5 * LINES + 11]).map(|(_, region)| all.regions[region as usize].lines).sum();
        assert_eq!(places, 32 + 4 * LINES * LINES, "table and roof on one line");
    }
}
