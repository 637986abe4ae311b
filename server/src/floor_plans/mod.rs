//! Floor plans: a horizontal section of the scene 1.2 m above each storey's floor.
//!
//! In: the scene, its clusters and octree, the walk volume and the eye height. Out: one
//! [`FloorPlan`] per storey, or one relief where the ground has no storeys.
//!
//! ```text
//!   storeys   heights with most floor; the floor of each storey as a raster
//!   cuts      per cell the height of the section: above the storey's floor, on stairs and open
//!             ground above the nearest floor
//!   section   lines of the triangles that cross the section, culled by cells and clusters
//!   fill      what lies between two faces of a wall is filled; closed spaces are marked
//! ```
//!
//! Cost grows with the geometry at the height of the sections near the walk volume: cells of the
//! octree and clusters whose boxes no section crosses are passed over. All plans of a dataset have
//! the same raster, so that a map keeps its place when the storey changes.

mod fill;
mod section;
mod storeys;

#[cfg(test)]
mod tests;

use crate::octree::{Clusters, Octree};
use crate::scene::Scene;
use glam::DVec2;
use ldi_protocol::Aabb;
use ldi_protocol::floor_plan::{FLOOR, FloorPlan, MAX_CELLS, MAX_SIDE, SECTION_M};
use ldi_protocol::volume::WalkVolume;
use section::Cuts;
use storeys::Storey;

/// Finest cell, metres: a wall of 5 cm keeps two faces.
const FINEST_M: f64 = 0.025;
/// Border around the walk volume, metres: it holds the walls around the outermost rooms.
const BORDER_M: f64 = 1.5;
/// Floors this close to the storey's own are cut at the storey's height, metres. More: the section
/// of a mezzanine has the height of the floor below.
const LEVEL_M: f64 = 0.5;
/// On open ground the section is followed this far from where people walk, metres.
const RELIEF_REACH_M: f64 = 3.0;
/// Height of a unit of cut heights, metres.
const CUT_M: f64 = 0.1;

/// A raster over x and z.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Grid {
    corner: DVec2,
    pitch_m: f64,
    size: [usize; 2],
}

impl Grid {
    /// The raster of all plans: as fine as the number of cells allows.
    fn of(volume: &WalkVolume, plans: usize) -> Self {
        // The volume's own bounds are those of the scene.
        let b = volume.boxes().fold(Aabb::EMPTY, |b, o| b.union(o)).inflated(BORDER_M);
        let (corner, size) = (DVec2::new(b.min.x, b.min.z), DVec2::new(b.size().x, b.size().z));
        // A row and a column more than the size, by rounding up.
        let per_plan = (MAX_CELLS / plans.max(1)) as f64 * 0.98;
        let side = f64::from(MAX_SIDE) - 2.0;
        let pitch_m = FINEST_M.max((size.x * size.y / per_plan).sqrt()).max(size.max_element() / side);
        Self { corner, pitch_m, size: (size / pitch_m).ceil().to_array().map(|n| n.max(1.0) as usize) }
    }

    fn cells(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// The up to four neighbours of a cell.
    fn beside(&self, cell: usize) -> impl Iterator<Item = usize> + use<> {
        let ([w, _], n) = (self.size, self.cells());
        let i = cell % w;
        [
            (i > 0).then(|| cell - 1),
            (i + 1 < w).then_some(cell + 1),
            cell.checked_sub(w),
            (cell + w < n).then_some(cell + w),
        ]
        .into_iter()
        .flatten()
    }
}

/// Makes the floor plans, from below to above. None for flying: there are no floors.
pub fn floor_plans(
    scene: &Scene,
    clusters: &Clusters,
    octree: &Octree,
    volume: &WalkVolume,
    eye_height_m: Option<f64>,
) -> Vec<FloorPlan> {
    let Some(eye_height_m) = eye_height_m.filter(|_| !volume.is_empty()) else { return Vec::new() };
    let (storeys, relief) = storeys::storeys(volume, eye_height_m);
    let grid = Grid::of(volume, storeys.len());
    let plan = |n: usize| {
        let mut floor = storeys::floor(volume, eye_height_m, &storeys, n, &grid);
        let cuts = cuts(&floor, &storeys[n], &grid, relief);
        let mut lines = section::section(scene, (clusters, octree), &grid, &cuts, relief);
        fill::fill(&mut lines, &mut floor, &grid, relief);
        assemble(&storeys[n], &grid, &floor, lines, relief)
    };
    // One after the other: each is made by all threads, and holds several bytes per cell.
    (0..storeys.len()).map(plan).collect()
}

/// The heights of the section, from the floor of each cell (NaN: none).
fn cuts(floor: &[f32], storey: &Storey, grid: &Grid, relief: bool) -> Cuts {
    let cut = |floor_m: f64| match !relief && (floor_m - storey.floor_m).abs() <= LEVEL_M {
        true => storey.floor_m + SECTION_M,
        false => floor_m + SECTION_M,
    };
    let unit = |m: f64| ((m / CUT_M).round() as i32).min(i32::MAX - 1);
    let mut of_cell: Vec<i32> =
        floor.iter().map(|f| if f.is_nan() { i32::MAX } else { unit(cut(f64::from(*f))) }).collect();
    // The nearest floor decides where there is none.
    let mut front: Vec<usize> = (0..of_cell.len()).filter(|c| of_cell[*c] != i32::MAX).collect();
    let reach = if relief { (RELIEF_REACH_M / grid.pitch_m).ceil() as usize } else { usize::MAX };
    for _ in 0..reach {
        let mut next = Vec::new();
        for &cell in &front {
            for other in grid.beside(cell) {
                if of_cell[other] == i32::MAX {
                    of_cell[other] = of_cell[cell];
                    next.push(other);
                }
            }
        }
        if next.is_empty() {
            break;
        }
        front = next;
    }
    Cuts::new(of_cell, grid)
}

/// Joins floors and lines.
fn assemble(storey: &Storey, grid: &Grid, floor: &[f32], lines: Vec<u8>, relief: bool) -> FloorPlan {
    let heights = || floor.iter().copied().filter(|f| !f.is_nan()).map(f64::from);
    let (low, high) = heights().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), f| (l.min(f), h.max(f)));
    let low = if low.is_finite() { low } else { storey.floor_m };
    // As fine as the layers of the walk volume, unless a byte does not hold the range.
    let step_m = CUT_M.max((high - low) / f64::from(u8::MAX - FLOOR));
    let value = |(line, floor): (u8, &f32)| match line {
        0 if !floor.is_nan() => FLOOR + ((f64::from(*floor) - low) / step_m).round() as u8,
        line => line,
    };
    FloorPlan {
        floor_m: storey.floor_m,
        ground_m: low,
        step_m,
        corner: grid.corner.to_array(),
        pitch_m: grid.pitch_m,
        size: grid.size.map(|n| n as u32),
        relief,
        cells: lines.into_iter().zip(floor).map(value).collect(),
    }
}
