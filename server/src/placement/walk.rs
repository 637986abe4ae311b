//! The walk volume of a scene (DESIGN, "Only what a scene needs"): grid points are kept only where an eye can select them, so
//! the smaller the volume, the fewer the images.
//!
//! In: the scene and an eye height. Out: a [`WalkVolume`] that holds every eye from eye height - 0.5 m to + 0.4 m above a floor
//! ([`floors`]), 0.05 m clear of the next surface above. Vertical lines at [`LINES_PER_COLUMN`] squared places per column give the
//! heights; each counts for its neighbours as well, so that eyes between the lines are included. What is narrower than a raster
//! cell can still hide between lines: an eye that stands on such a thing may lie outside, where only the frame cost is promised.

use super::{
    Corridor, PlacementError, columns,
    corridor::Columns,
    floors::{self, Floor},
};
use crate::scene::Scene;
use glam::{DVec2, DVec3};
use ldi_protocol::{Aabb, volume::WalkVolume};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// How far below and above the nominal eye height an eye may be, metres (CONTRACTS).
const BELOW_M: f64 = 0.5;
/// See [`BELOW_M`].
const ABOVE_M: f64 = 0.4;
/// An eye keeps this far from the surface above it, metres.
const CLEAR_M: f64 = 0.05;
/// Edge of a column, metres. Smaller follows walls and furniture more closely at more memory; the slab between floor
/// and ceiling is what limits users, so half a metre is enough.
const COLUMN_M: f64 = 0.5;
/// Most columns: larger scenes get wider ones.
const MOST_COLUMNS: f64 = 250_000.0;
/// Vertical lines along each axis of a column.
const LINES_PER_COLUMN: u32 = 4;
/// Height of a layer, metres.
const LAYER_M: f64 = 0.1;

/// The walk volume of `scene` for an eye at `eye_height_m`, or the whole box, raised by 1.6 m, when None (flying); `along` keeps walkers near a path.
/// And what was left out, by reason.
pub(super) fn walk_volume(
    scene: &Scene,
    bounds: &Aabb,
    eye_height_m: Option<f64>,
    along: Option<&Corridor>,
) -> Result<(WalkVolume, BTreeMap<String, u64>), PlacementError> {
    let Some(eye_height_m) = eye_height_m else {
        let mut b = *bounds;
        b.max.y += 1.6;
        return Ok((WalkVolume::of_box(&b)?, BTreeMap::new()));
    };
    let size = bounds.size();
    let column_m = COLUMN_M.max((size.x * size.z / MOST_COLUMNS).sqrt());
    let count = |s: f64| (s / column_m).floor() as u32 + 1;
    let columns = [count(size.x), count(size.z)];
    let raster = columns::Raster {
        origin: DVec2::new(bounds.min.x, bounds.min.z),
        pitch_m: column_m / f64::from(LINES_PER_COLUMN),
        size: [columns[0] * LINES_PER_COLUMN, columns[1] * LINES_PER_COLUMN],
    };
    // One layer of slack below the lowest possible eye, and layers thick enough that 16 bits count them.
    let origin = DVec3::new(bounds.min.x, bounds.min.y + eye_height_m - BELOW_M - LAYER_M, bounds.min.z);
    let layer_m = LAYER_M.max((size.y + 2.0) / 60_000.0);
    let mesh_bounds = columns::mesh_bounds(scene);
    let strips: Vec<u32> = (0..raster.size[1]).step_by(ROWS_PER_STRIP as usize).collect();
    let heights: Vec<Vec<(u32, f32)>> = strips
        .par_iter()
        .map(|&k| {
            let mut hits = columns::heights(scene, &mesh_bounds, &raster, k..(k + ROWS_PER_STRIP).min(raster.size[1]));
            hits.iter_mut().for_each(|h| h.0 += k * raster.size[0]);
            hits
        })
        .collect();
    let (floors, mut skipped) = floors::floors(&heights.concat(), &raster, eye_height_m + CLEAR_M);
    let mut runs: Vec<Vec<[u16; 2]>> = vec![Vec::new(); columns[0] as usize * columns[1] as usize];
    for f in &floors {
        add_floor(&mut runs, f, &raster, columns, eye_height_m, |y| (y - origin.y) / layer_m);
    }
    if let Some(corridor) = along {
        skipped.extend(corridor.cut(&mut runs, &Columns { origin, pitch_m: column_m, layer_m, count: columns }));
        if runs.iter().all(Vec::is_empty) {
            return Err(PlacementError::NowhereAlong { within_m: corridor.within_m(), eye_height_m });
        }
    }
    let volume = WalkVolume::new(origin, column_m, layer_m, columns, &runs, bounds)?;
    if volume.is_empty() {
        return Err(PlacementError::EmptyVolume { scene: scene.name.clone(), eye_height_m });
    }
    Ok((volume, skipped))
}

/// Raster rows that are met with lines at a time: bounds the work of one task.
const ROWS_PER_STRIP: u32 = 64;

/// Adds the eyes above a floor to the columns around its line: the line counts for the raster cells beside it too.
fn add_floor(
    runs: &mut [Vec<[u16; 2]>],
    f: &Floor,
    raster: &columns::Raster,
    columns: [u32; 2],
    eye_height_m: f64,
    layer: impl Fn(f64) -> f64,
) {
    let n = LINES_PER_COLUMN;
    let (i, k) = (f.line % raster.size[0], f.line / raster.size[0]);
    let low = f64::from(f.y) + eye_height_m - BELOW_M;
    let high = (f64::from(f.y) + eye_height_m + ABOVE_M).min(f64::from(f.above) - CLEAR_M);
    let run = [layer(low).floor() as u16, layer(high).ceil() as u16];
    for k in k.saturating_sub(1) / n..=((k + 1) / n).min(columns[1] - 1) {
        for i in i.saturating_sub(1) / n..=((i + 1) / n).min(columns[0] - 1) {
            add_run(&mut runs[(k * columns[0] + i) as usize], run);
        }
    }
}

/// Adds a run to a sorted, disjoint list, joining what touches.
fn add_run(runs: &mut Vec<[u16; 2]>, mut run: [u16; 2]) {
    let from = runs.partition_point(|r| r[1] < run[0]);
    let to = runs.partition_point(|r| r[0] <= run[1]);
    if from < to {
        run = [run[0].min(runs[from][0]), run[1].max(runs[to - 1][1])];
    }
    runs.splice(from..to, [run]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::test_scenes::{block, scene_of};

    #[test]
    fn runs_join_when_they_touch() {
        let mut r = vec![];
        for run in [[5, 7], [1, 2], [9, 12], [7, 9], [2, 3]] {
            add_run(&mut r, run);
        }
        assert_eq!(r, vec![[1, 3], [5, 12]]);
    }

    #[test]
    fn eyes_stand_on_the_floor_but_neither_on_nor_under_a_table() {
        // A floor of 16 x 16 m at y = 0 and a table top of 2 x 2 m at y = 0.8 on it.
        let floor = Aabb { min: DVec3::new(0.0, -0.1, 0.0), max: DVec3::new(16.0, 0.0, 16.0) };
        let table = Aabb { min: DVec3::new(3.0, 0.7, 3.0), max: DVec3::new(5.0, 0.8, 5.0) };
        let scene = scene_of(&[block(&floor), block(&table)]);
        let v = walk_volume(&scene, &scene.bounds(), Some(1.6), None).unwrap().0;
        let inside = |x: f64, y: f64, z: f64| v.contains(DVec3::new(x, y, z));
        assert!(inside(1.0, 1.6, 1.0) && inside(1.0, 1.11, 1.0) && inside(7.9, 1.99, 7.9));
        assert!(!inside(1.0, 0.9, 1.0) && !inside(1.0, 2.3, 1.0));
        assert!(!inside(4.0, 2.4, 4.0), "standing on the table");
        assert!(!inside(4.0, 1.6, 4.0), "0.8 m above the table is too low");
        assert!(!inside(-0.1, 1.6, 1.0), "outside the scene");
    }
}
