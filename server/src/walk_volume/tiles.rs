//! The tiles of a scene that are worth looking for floors in: those near its detail.
//!
//! In: cluster instances. Out: square tiles of [`LINES`] x [`LINES`] lines, each with the cluster
//! instances above and below it.
//!
//! Detail is counted in blocks, as large as a tile and [`BLOCK_M`] high. A block counts if it
//! holds at least [`LEAST_DETAIL`] of the triangles of the block that bounds the coarsest
//! [`COARSE`] of all triangles: the large triangles of far hills and of a sea do not, and one very
//! fine object does not make the rest of the scene look empty. Around a block that counts,
//! [`AROUND`] blocks to each side and one above and below are taken: floors are looked for there.

use super::lines::{Raster, Window};
use crate::{
    octree::{Clusters, Octree},
    scene::Scene,
};
use glam::{DVec2, DVec3};
use ldi_protocol::Aabb;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Lines along a side of a tile: 16 m. Larger tiles bring more of a backdrop along; smaller ones
/// cost more in bookkeeping.
pub(super) const LINES: u32 = 64;
/// Share of the triangles, those of the emptiest blocks, that do not set the measure. Larger: one
/// fine object empties the rest of the scene; smaller: a backdrop of many triangles counts as
/// detail.
const COARSE: f64 = 0.25;
/// Least triangles of a block, as a share of the measure. Larger: outskirts are lost; smaller:
/// backdrops come in.
const LEAST_DETAIL: f64 = 1.0 / 16.0;
/// Blocks around a block that counts, on each side: people step back from what they look at.
const AROUND: i64 = 2;
/// Height of a block, metres. Larger: a sea below a town comes in.
const BLOCK_M: f64 = 8.0;
/// Most tiles, about a square kilometre: bounds memory. The most detailed ones are taken.
const MOST: usize = 4096;

/// A tile and what lies over it.
#[derive(Debug, Clone, Default)]
pub(super) struct Tile {
    /// Place along x and z, in tiles.
    pub place: [u32; 2],
    /// Cluster instances whose bounds reach over it: (instance, cluster).
    pub content: Vec<(u32, u32)>,
    /// Heights above the scene's foot between which floors are looked for, metres, ascending;
    /// none: anywhere.
    pub heights_m: Vec<[f32; 2]>,
}

/// Which tiles are taken.
#[derive(Debug, Clone, Copy)]
pub(super) enum Wanted<'a> {
    /// Those near detail, and those within a distance of some places.
    Detail {
        /// World positions where people start, and where cameras of the file stand.
        starts: &'a [DVec3],
    },
    /// Those within a distance of some places alone.
    Near {
        /// World positions.
        places: &'a [DVec3],
        /// Metres.
        within_m: f64,
    },
}

/// How far around a start tiles are taken, metres.
const AROUND_START_M: f64 = 48.0;

/// Tiles, and the number of those that were left out because there would be too many.
pub(super) fn tiles(
    scene: &Scene,
    clusters: &Clusters,
    octree: &Octree,
    raster: &Raster,
    wanted: Wanted<'_>,
) -> (Vec<Tile>, usize) {
    let size = raster.size.map(|n| n.div_ceil(LINES));
    let pieces = pieces(scene, clusters, octree, raster, size);
    let (mut blocks, mut left_out) = (BTreeMap::new(), 0);
    let mut anywhere: Vec<[u32; 2]> = Vec::new();
    let around = |places: &[DVec3], within_m: f64, chosen: &mut Vec<[u32; 2]>| {
        let edge = raster.pitch_m * f64::from(LINES);
        for p in places {
            let at = (DVec2::new(p.x, p.z) - raster.origin) / edge;
            let reach = within_m / edge;
            // Saturating conversions.
            let span = |x: f64, n: u32| (x - reach).max(0.0) as u32..(((x + reach).max(-1.0) + 1.0) as u32).min(n);
            let columns = span(at.x, size[0]);
            chosen.extend(span(at.y, size[1]).flat_map(|k| columns.clone().map(move |i| [i, k])));
        }
    };
    match wanted {
        Wanted::Near { places, within_m } => around(places, within_m, &mut anywhere),
        Wanted::Detail { starts } => {
            (blocks, left_out) = detailed(&pieces, size);
            around(starts, AROUND_START_M, &mut anywhere);
        }
    }
    for [i, k] in anywhere {
        blocks.insert([k, i], Vec::new());
    }
    let number: HashMap<[u32; 2], usize> = blocks.keys().map(|[k, i]| [*i, *k]).zip(0..).collect();
    let tile = |([k, i], heights_m): ([u32; 2], Vec<[f32; 2]>)| Tile { place: [i, k], content: Vec::new(), heights_m };
    let mut tiles: Vec<Tile> = blocks.into_iter().map(tile).collect();
    for piece in &pieces {
        let [i, k] = [0, 1].map(|axis| piece.window.from[axis]..piece.window.to[axis]);
        let of = (piece.instance, piece.cluster);
        // A backdrop's pieces reach over more tiles than are taken.
        if i.len() * k.len() > tiles.len() {
            let over = tiles.iter_mut().filter(|t| i.contains(&t.place[0]) && k.contains(&t.place[1]));
            over.for_each(|t| t.content.push(of));
        } else {
            let found = k.flat_map(|k| i.clone().map(move |i| [i, k])).filter_map(|place| number.get(&place));
            found.for_each(|t| tiles[*t].content.push(of));
        }
    }
    (tiles, left_out)
}

/// A cluster instance and the tiles that it reaches over.
struct Piece {
    instance: u32,
    cluster: u32,
    triangles: u32,
    window: Window,
    /// Blocks that it reaches over, from and to, counted from the scene's foot.
    heights: [u32; 2],
}

fn pieces(scene: &Scene, clusters: &Clusters, octree: &Octree, raster: &Raster, size: [u32; 2]) -> Vec<Piece> {
    let edge = raster.pitch_m * f64::from(LINES);
    let foot_m = octree.cells.iter().map(|c| c.bounds.min.y).fold(f64::INFINITY, f64::min);
    let piece = |&(instance, cluster): &(u32, u32)| {
        let world_from_mesh = &scene.instances[instance as usize].world_from_mesh;
        let of = &clusters.clusters[cluster as usize];
        let b = Aabb::from_points(of.bounds.corners().map(|c| world_from_mesh.transform_point3(c)));
        let low = (DVec2::new(b.min.x, b.min.z) - raster.origin) / edge;
        let high = (DVec2::new(b.max.x, b.max.z) - raster.origin) / edge;
        let place = |x: f64, axis: usize| (x.floor().max(0.0) as u32).min(size[axis] - 1);
        let window =
            Window { from: [place(low.x, 0), place(low.y, 1)], to: [place(high.x, 0) + 1, place(high.y, 1) + 1] };
        let height = |y: f64| ((y - foot_m) / BLOCK_M).floor().max(0.0) as u32;
        let heights = [height(b.min.y), height(b.max.y) + 1];
        Piece { instance, cluster, triangles: of.triangles.len() as u32, window, heights }
    };
    octree.cells.iter().flat_map(|c| &c.content).map(piece).collect()
}

/// Per place (k, i) of the tiles near detail the heights at which floors are looked for, and the
/// number of tiles left out.
fn detailed(pieces: &[Piece], size: [u32; 2]) -> (BTreeMap<[u32; 2], Vec<[f32; 2]>>, usize) {
    let mut triangles: HashMap<[u32; 3], f64> = HashMap::new();
    for piece in pieces {
        let [i, k] = [0, 1].map(|axis| piece.window.from[axis]..piece.window.to[axis]);
        let j = piece.heights[0]..piece.heights[1];
        let share = f64::from(piece.triangles) / (i.len() * k.len() * j.len()) as f64;
        for k in k {
            for i in i.clone() {
                j.clone().for_each(|j| *triangles.entry([k, i, j]).or_default() += share);
            }
        }
    }
    // In a fixed order, so that sums do not depend on the map's.
    let mut blocks: Vec<([u32; 3], f64)> = triangles.into_iter().collect();
    blocks.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let mut left = (1.0 - COARSE) * blocks.iter().map(|b| b.1).sum::<f64>();
    let measure = blocks.iter().find(|(_, n)| {
        left -= n;
        left <= 0.0
    });
    let least = LEAST_DETAIL * measure.map_or(0.0, |m| m.1);
    tracing::debug!(blocks = blocks.len(), least, counting = blocks.partition_point(|b| b.1 >= least), "detail");
    let mut taken: BTreeMap<[u32; 2], BTreeSet<u32>> = BTreeMap::new();
    let mut left_out: BTreeSet<[u32; 2]> = BTreeSet::new();
    for ([k, i, j], _) in blocks.iter().take_while(|t| t.1 >= least) {
        for dk in -AROUND..=AROUND {
            for di in -AROUND..=AROUND {
                let at = [i64::from(*i) + di, i64::from(*k) + dk];
                if (0..2).any(|axis| at[axis] < 0 || at[axis] >= i64::from(size[axis])) {
                    continue;
                }
                let place = [at[1] as u32, at[0] as u32];
                if taken.len() >= MOST && !taken.contains_key(&place) {
                    left_out.insert(place);
                    continue;
                }
                taken.entry(place).or_default().extend(j.saturating_sub(1)..=j + 1);
            }
        }
    }
    let ranges = |of: BTreeSet<u32>| {
        let mut out: Vec<[f32; 2]> = Vec::new();
        for j in of {
            let [low, high] = [j, j + 1].map(|j| (f64::from(j) * BLOCK_M) as f32);
            match out.last_mut() {
                Some(last) if last[1] == low => last[1] = high,
                _ => out.push([low, high]),
            }
        }
        out
    };
    (taken.into_iter().map(|(place, of)| (place, ranges(of))).collect(), left_out.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::test_scenes::{block, scene_of};

    /// A house of 100 boxes around the origin amid a backdrop of four boxes a kilometre wide.
    fn house_in_a_backdrop() -> (Scene, Raster) {
        let mut blocks: Vec<Aabb> = (0..100)
            .map(|n| DVec3::new(f64::from(n % 10) * 1.5, 0.0, f64::from(n / 10) * 1.5))
            .map(|at| Aabb { min: at, max: at + 0.5 })
            .collect();
        for (x, z) in [(-1000.0, -1000.0), (0.0, -1000.0), (-1000.0, 0.0), (0.0, 0.0)] {
            blocks.push(Aabb { min: DVec3::new(x, -2.0, z), max: DVec3::new(x + 1000.0, -0.1, z + 1000.0) });
        }
        let scene = scene_of(&blocks.iter().map(block).collect::<Vec<_>>());
        let raster = Raster { origin: DVec2::splat(-1000.0), pitch_m: 0.25, size: [8001; 2] };
        (scene, raster)
    }

    fn found(wanted: Wanted<'_>) -> Vec<Tile> {
        let (scene, raster) = house_in_a_backdrop();
        let clusters = Clusters::build(&scene);
        let octree = Octree::build(&scene, &clusters, 1000);
        tiles(&scene, &clusters, &octree, &raster, wanted).0
    }

    #[test]
    fn a_backdrop_takes_no_tiles_but_lies_under_those_of_the_house() {
        let tiles = found(Wanted::Detail { starts: &[] });
        assert!((25..64).contains(&tiles.len()), "{} tiles", tiles.len());
        assert!(tiles.iter().all(|t| (58..70).contains(&t.place[0]) && (58..70).contains(&t.place[1])));
        assert!(tiles.iter().all(|t| !t.content.is_empty()), "the backdrop is under all of them");
        let far = [DVec3::new(900.0, 0.0, -900.0)];
        let more = found(Wanted::Detail { starts: &far });
        assert!(more.len() > tiles.len() && more.iter().any(|t| t.place == [118, 6]), "the start's surroundings too");
    }

    #[test]
    fn tiles_near_places_alone() {
        let places = [DVec3::new(-999.0, 3.0, -980.0)];
        let near: Vec<[u32; 2]> =
            found(Wanted::Near { places: &places, within_m: 3.0 }).into_iter().map(|t| t.place).collect();
        assert_eq!(near, [[0, 1]]);
        let near = found(Wanted::Near { places: &places, within_m: 5.0 });
        assert_eq!(near.len(), 2, "one more row within reach");
    }
}
