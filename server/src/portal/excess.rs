//! Where rooms are too much: the eyes for which what has to be geometry exceeds the budget. The
//! grid takes over there.
//!
//! In: an index with rooms and their placements. Out: the boxes of the walk volume that hold such
//! eyes ([`over_budget`]).
//!
//! 1. From a place in every box, some level views and some up and down.
//! 2. Around boxes where one exceeds the budget, more places and views, until no box is added.
//! 3. The boxes next to those, since eyes between the tried ones were not.
//! 4. Random views from all other boxes, again and again, until none of them exceeds it: what is
//!    seen of few places in few directions.
//!
//! This is a sample, so what comes close to the budget counts as too much ([`SHARE`]). What it
//! misses is what the audit counts; a frame there keeps its budget all the same, and shows the LDI
//! tree beyond it.

use super::leaks::Random;
use glam::DVec3;
use ldi_protocol::{Aabb, Pose, index::Index, select::least_by_rooms};
use rayon::prelude::*;
use std::collections::HashMap;

/// Share of the budget that views of a sample may use. Less: fewer views between those tried
/// exceed the budget; more images.
const SHARE: f64 = 0.9;
/// Places tried in every box. More: fewer eyes are overlooked, and planning takes longer: with
/// four, the clinic was not done after seven minutes of two cores.
const PLACES: usize = 1;
/// Views from a place: as many yaws, spread evenly; one of three looks up or down.
const YAWS: usize = 12;
/// Places tried in a box near others that exceed the budget.
const CLOSER: usize = 4;
/// Random views of a pass. More: rarer views are found, and planning takes longer. As many as find
/// none of 110,000 audited poses of the built-in house left.
const RANDOM_VIEWS: usize = 40_000;
/// Most passes of random views: bounds the time where there is always one more. By judgement.
const PASSES: usize = 6;
/// Boxes so close to one that exceeds the budget are looked at more closely, metres: about a
/// stride.
const NEAR_M: f64 = 1.0;
/// Boxes so close to one belong to the grid, tried or not, metres: those that touch it.
const BESIDE_M: f64 = 0.01;

/// Per box of the walk volume whether the grid has to serve its eyes. Nothing without a walk
/// volume or rooms.
pub fn over_budget(index: &Index) -> Vec<bool> {
    let (Some(volume), Some(_)) = (&index.volume, &index.rooms) else { return Vec::new() };
    let boxes: Vec<Aabb> = volume.boxes().collect();
    let most = (index.settings.budget as f64 * SHARE) as u64;
    let near = Neighbours::of(&boxes);
    let exceeds = |number: usize, places: usize| {
        let mut random = Random(number as u64 * 64 + places as u64);
        (0..places).any(|_| exceeds_in(index, &boxes[number], most, &mut random))
    };
    let mut over: Vec<bool> = (0..boxes.len()).into_par_iter().map(|b| exceeds(b, PLACES)).collect();
    let mut tried = over.clone();
    let mut front: Vec<usize> = (0..boxes.len()).filter(|b| over[*b]).collect();
    while !front.is_empty() {
        let mut next: Vec<usize> =
            front.iter().flat_map(|b| near.within(&boxes, *b, NEAR_M)).filter(|b| !tried[*b]).collect();
        next.sort_unstable();
        next.dedup();
        next.iter().for_each(|b| tried[*b] = true);
        front = next.into_par_iter().filter(|b| exceeds(*b, CLOSER)).collect();
        front.iter().for_each(|b| over[*b] = true);
    }
    let with_beside = |found: &[usize], over: &mut [bool]| {
        for b in found {
            over[*b] = true;
            near.within(&boxes, *b, BESIDE_M).for_each(|beside| over[beside] = true);
        }
    };
    let found: Vec<usize> = (0..boxes.len()).filter(|b| over[*b]).collect();
    with_beside(&found, &mut over);
    for pass in 0..PASSES {
        let one = |k: usize| {
            let mut random = Random(((pass + 1) << 32 | k) as u64);
            let number = ((random.unit() * boxes.len() as f64) as usize).min(boxes.len().checked_sub(1)?);
            let position = place_in(&boxes[number], &mut random);
            let pitch_deg = (random.unit() * 2.0 - 1.0) * index.settings.pitch_deg;
            let pose = Pose { position, yaw_deg: 360.0 * random.unit(), pitch_deg };
            (!over[number] && exceeds_from(index, &pose, most)).then_some(number)
        };
        let found: Vec<usize> = (0..RANDOM_VIEWS).into_par_iter().filter_map(one).collect();
        if found.is_empty() {
            break;
        }
        with_beside(&found, &mut over);
    }
    over
}

fn place_in(within: &Aabb, random: &mut Random) -> DVec3 {
    within.min + within.size() * DVec3::new(random.unit(), random.unit(), random.unit())
}

/// Whether in a view more triangles than `most` have to be geometry.
fn exceeds_from(index: &Index, pose: &Pose, most: u64) -> bool {
    let camera = &index.settings.camera;
    least_by_rooms(index, pose, (camera.half_tan_x(), camera.half_tan_y())).is_some_and(|triangles| triangles > most)
}

/// Whether in one of the views from a random place in a box more triangles than `most` have to be
/// geometry.
fn exceeds_in(index: &Index, within: &Aabb, most: u64, random: &mut Random) -> bool {
    let position = place_in(within, random);
    let turn = random.unit() * 360.0;
    (0..YAWS).any(|k| {
        let pitch_deg = if k % 3 == 2 { (random.unit() * 2.0 - 1.0) * index.settings.pitch_deg } else { 0.0 };
        let pose = Pose { position, yaw_deg: (turn + 360.0 * k as f64 / YAWS as f64) % 360.0, pitch_deg };
        exceeds_from(index, &pose, most)
    })
}

/// Boxes by the square of the plan that their middle lies in.
struct Neighbours {
    /// Edge of a square, metres: boxes within [`NEAR_M`] of each other have their middles in the
    /// same square or in squares side by side.
    square_m: f64,
    squares: HashMap<[i64; 2], Vec<usize>>,
}

impl Neighbours {
    fn of(boxes: &[Aabb]) -> Self {
        let widest_m = boxes.iter().map(|b| b.size().x.max(b.size().z)).fold(0.0, f64::max);
        let mut near = Self { square_m: widest_m + NEAR_M, squares: HashMap::new() };
        for (number, b) in boxes.iter().enumerate() {
            near.squares.entry(near.square(b.centre())).or_default().push(number);
        }
        near
    }

    fn square(&self, p: DVec3) -> [i64; 2] {
        [p.x, p.z].map(|x| (x / self.square_m).floor() as i64)
    }

    /// Boxes at most `apart_m` from a box, without itself; `apart_m` at most [`NEAR_M`].
    fn within<'a>(&'a self, boxes: &'a [Aabb], number: usize, apart_m: f64) -> impl Iterator<Item = usize> + 'a {
        let reach = boxes[number].inflated(apart_m);
        let [i, k] = self.square(boxes[number].centre());
        let squares = (i - 1..=i + 1).flat_map(move |i| (k - 1..=k + 1).map(move |k| [i, k]));
        let there = squares.filter_map(|s| self.squares.get(&s)).flatten().copied();
        there.filter(move |b| *b != number && boxes[*b].intersects(&reach))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::test_scenes::settings;
    use ldi_protocol::{
        index::{CellEntry, SceneInfo},
        room_index::RoomIndex,
        rooms::{Cell, Portal, PortalKind, Rooms},
        select::draw_list,
        volume::WalkVolume,
    };

    fn boxed(min: [f64; 3], max: [f64; 3]) -> Aabb {
        Aabb { min: DVec3::from(min), max: DVec3::from(max) }
    }

    /// Two rooms of 8 m by 8 m on either side of x = 0, with a door of 1 m at z = 4; 1,000
    /// triangles in the far corner of the one at x < 0.
    fn index(budget: u64) -> Index {
        let room =
            |name: &str, x: f64| Cell { name: name.into(), boxes: vec![boxed([x, 0.0, 0.0], [x + 8.0, 3.0, 8.0])] };
        let corners = [(0.0, 3.5), (2.0, 3.5), (2.0, 4.5), (0.0, 4.5)].map(|(y, z)| DVec3::new(0.0, y, z)).to_vec();
        let door = Portal { cells: [Some(0), Some(1)], kind: PortalKind::Door, corners };
        let rooms = Rooms::new(0.1, vec![room("full", -8.0), room("empty", 0.0)], vec![door]).unwrap();
        let cell = CellEntry {
            bounds: boxed([-8.0, 0.0, 0.0], [-7.0, 2.5, 1.0]),
            triangles: 1_000,
            chunk: 0,
            bundles: vec![],
            materials: vec![],
            texel_density: vec![],
            levels: Vec::new(),
        };
        let cut = boxed([-8.0, 0.0, 0.0], [8.0, 3.0, 8.0]);
        let runs = vec![vec![[0, 9]]; 32 * 16];
        let volume = WalkVolume::new(DVec3::new(-8.0, 1.1, 0.0), 0.5, 0.1, [32, 16], &runs, &cut).unwrap();
        Index {
            scene: SceneInfo {
                name: String::new(),
                triangles: 1_000,
                unique_triangles: 1_000,
                instances: 1,
                bounds: cut,
            },
            settings: settings(budget),
            chunks: vec![],
            cells: vec![cell],
            materials: vec![],
            textures: vec![],
            pitch_bands_deg: vec![],
            points: vec![],
            placements: vec![],
            images: vec![],
            volume: Some(volume),
            tree: None,
            plans: Vec::new(),
            rooms: Some(RoomIndex {
                rooms,
                near_m: 1.5,
                cells_of: vec![vec![0], vec![], vec![]],
                placements: vec![[0..0, 0..0]],
                ..Default::default()
            }),
        }
    }

    /// Against all pairs, for boxes narrower and wider than the distance.
    #[test]
    fn neighbours_are_those_of_all_pairs() {
        let mut random = Random(3);
        for side_m in [0.5, 3.0] {
            let boxes: Vec<Aabb> = (0..200)
                .map(|_| {
                    let min = DVec3::new(random.unit(), 0.1 * random.unit(), random.unit()) * 12.0 * side_m;
                    Aabb { min, max: min + side_m }
                })
                .collect();
            let near = Neighbours::of(&boxes);
            let mut pairs = 0;
            for number in 0..boxes.len() {
                for apart_m in [BESIDE_M, NEAR_M] {
                    let mut found: Vec<usize> = near.within(&boxes, number, apart_m).collect();
                    found.sort_unstable();
                    let reach = boxes[number].inflated(apart_m);
                    let all = (0..boxes.len()).filter(|b| *b != number && boxes[*b].intersects(&reach));
                    assert_eq!(found, all.collect::<Vec<_>>());
                    pairs += found.len();
                }
            }
            assert!(pairs > 500, "{pairs}");
        }
    }

    #[test]
    fn places_that_see_too_much_are_found() {
        let tight = index(990);
        let over = over_budget(&tight);
        let boxes: Vec<Aabb> = tight.volume.as_ref().unwrap().boxes().collect();
        assert_eq!(over.len(), boxes.len());
        // Against many more views: none exceeds the budget where nothing was found, and where
        // something was, some view there or next to it comes close.
        let mut random = Random(7);
        let mut most = |number: usize| {
            let view = |_| {
                let position =
                    boxes[number].min + boxes[number].size() * DVec3::new(random.unit(), random.unit(), random.unit());
                let pose = Pose { position, yaw_deg: 360.0 * random.unit(), pitch_deg: 60.0 * random.unit() - 30.0 };
                u64::from(draw_list(&tight, &pose, (0.577, 0.577)).dropped)
            };
            (0..200).map(view).max().unwrap()
        };
        let exceeds: Vec<bool> = (0..boxes.len()).map(|b| most(b) > 0).collect();
        for (number, b) in boxes.iter().enumerate() {
            assert!(over[number] || !exceeds[number], "{b:?}");
            let beside = boxes.iter().zip(&exceeds).any(|(o, e)| *e && o.intersects(&b.inflated(0.6)));
            assert!(!over[number] || beside, "{b:?}");
        }
        let found = over.iter().filter(|o| **o).count();
        assert!(found > 256 && found < 400, "{found} of {}", over.len());
        // All of it fits, but not by far: views between those tried could exceed the budget.
        assert_eq!(over_budget(&index(1_080)), over);
        assert!(over_budget(&index(1_200)).iter().all(|o| !o));
        assert!(over_budget(&Index { rooms: None, ..index(10) }).is_empty());
    }
}
