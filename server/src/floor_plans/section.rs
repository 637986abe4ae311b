//! The section: lines in which the scene's triangles cross it.
//!
//! In: per cell of the raster the height of the section. Out: per cell [`WALL`] or 0. On open
//! ground masked surfaces are left out, which are mostly leaves; walkers pass through them as well.

use super::{CUT_M, Grid};
use crate::octree::{Clusters, Octree};
use crate::scene::Scene;
use glam::{DVec2, DVec3, Vec3Swizzles as _};
use ldi_protocol::{Aabb, floor_plan::WALL, mesh::Alpha};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU8, Ordering::Relaxed};

/// Cells along a side of a tile of [`Cuts`].
const TILE: usize = 16;

/// Heights of a section, in units of [`CUT_M`].
pub(super) struct Cuts {
    /// Per cell; [`i32::MAX`] without.
    of_cell: Vec<i32>,
    /// Lowest and highest cut per tile, row by row; the first is above the second without any.
    of_tile: Vec<[i32; 2]>,
    /// Tiles along x and z.
    tiles: [usize; 2],
    /// All heights that occur, ascending.
    heights: Vec<i32>,
}

impl Cuts {
    pub(super) fn new(of_cell: Vec<i32>, grid: &Grid) -> Self {
        let tiles = grid.size.map(|n| n.div_ceil(TILE));
        let mut of_tile = vec![[i32::MAX, i32::MIN]; tiles[0] * tiles[1]];
        for (cell, cut) in of_cell.iter().enumerate().filter(|(_, c)| **c != i32::MAX) {
            let (i, k) = (cell % grid.size[0] / TILE, cell / grid.size[0] / TILE);
            let tile = &mut of_tile[k * tiles[0] + i];
            *tile = [tile[0].min(*cut), tile[1].max(*cut)];
        }
        let mut heights: Vec<i32> = of_tile.iter().flatten().copied().collect();
        heights.extend(of_cell.iter().copied());
        heights.sort_unstable();
        heights.dedup();
        heights.retain(|h| *h != i32::MAX && *h != i32::MIN);
        Self { of_cell, of_tile, tiles, heights }
    }

    /// Whether the section may cross a box.
    fn crosses(&self, b: &Aabb, grid: &Grid) -> bool {
        let tile = |v: f64, axis: usize| {
            let tile = (v - grid.corner[axis]) / (grid.pitch_m * TILE as f64);
            tile.floor().clamp(-1.0, self.tiles[axis] as f64)
        };
        let range = |low: f64, high: f64, axis: usize| {
            let (low, high) = (tile(low, axis), tile(high, axis));
            low.max(0.0) as usize..(high + 1.0).max(0.0).min(self.tiles[axis] as f64) as usize
        };
        let (low, high) = (b.min.y / CUT_M, b.max.y / CUT_M);
        range(b.min.z, b.max.z, 1).any(|k| {
            let row = &self.of_tile[k * self.tiles[0]..][..self.tiles[0]];
            row[range(b.min.x, b.max.x, 0)].iter().any(|t| f64::from(t[0]) <= high && low <= f64::from(t[1]))
        })
    }

    /// The heights between two, the lower one excluded.
    fn between(&self, low: f64, high: f64) -> &[i32] {
        let before = |y: f64| self.heights.partition_point(|h| f64::from(*h) * CUT_M <= y);
        let (from, to) = (before(low), before(high));
        &self.heights[from..to.max(from)]
    }
}

/// Draws the section of a scene.
pub(super) fn section(
    scene: &Scene,
    (clusters, octree): (&Clusters, &Octree),
    grid: &Grid,
    cuts: &Cuts,
    relief: bool,
) -> Vec<u8> {
    // Marks only grow, so the order of the threads does not matter.
    let is_masked =
        |material: u32| matches!(scene.materials.get(material as usize), Some(m) if m.alpha != Alpha::Opaque);
    let marks: Vec<AtomicU8> = (0..grid.cells()).map(|_| AtomicU8::new(0)).collect();
    let crossed = octree.cells.par_iter().filter(|c| cuts.crosses(&c.bounds, grid));
    crossed.flat_map_iter(|c| &c.content).for_each(|&(instance, cluster)| {
        let world_from_mesh = scene.instances[instance as usize].world_from_mesh;
        let cluster = &clusters.clusters[cluster as usize];
        let corners = cluster.bounds.corners().map(|c| world_from_mesh.transform_point3(c));
        let primitive = &scene.meshes[cluster.mesh as usize].primitives[cluster.primitive as usize];
        if (relief && is_masked(primitive.material)) || !cuts.crosses(&Aabb::from_points(corners), grid) {
            return;
        }
        for t in &cluster.triangles {
            let corner = |v: u32| world_from_mesh.transform_point3(primitive.positions[v as usize].as_dvec3());
            triangle(primitive.triangles[*t as usize].map(corner), grid, cuts, &marks);
        }
    });
    marks.into_iter().map(AtomicU8::into_inner).collect()
}

/// Draws the lines in which a triangle crosses the section.
fn triangle(t: [DVec3; 3], grid: &Grid, cuts: &Cuts, marks: &[AtomicU8]) {
    let low = t[0].y.min(t[1].y).min(t[2].y);
    let high = t[0].y.max(t[1].y).max(t[2].y);
    for height in cuts.between(low, high) {
        if let Some([a, b]) = cut(t, f64::from(*height) * CUT_M) {
            let to_cells = |p: DVec2| (p - grid.corner) / grid.pitch_m;
            line(to_cells(a), to_cells(b), grid, |cell| {
                if cuts.of_cell[cell] == *height {
                    marks[cell].store(WALL, Relaxed);
                }
            });
        }
    }
}

/// Intersection of a triangle with the plane at height `y`: two points of x and z.
pub(super) fn cut(t: [DVec3; 3], y: f64) -> Option<[DVec2; 2]> {
    let mut ends = [(0, 1), (1, 2), (2, 0)].into_iter().filter_map(|(i, j)| {
        let (a, b) = (t[i], t[j]);
        // A corner on the plane counts as above it, so that every section has two ends.
        ((a.y < y) != (b.y < y)).then(|| a.lerp(b, (y - a.y) / (b.y - a.y)).xz())
    });
    Some([ends.next()?, ends.next()?])
}

/// Calls `mark` with every cell along a line, given in cells.
fn line(from: DVec2, to: DVec2, grid: &Grid, mut mark: impl FnMut(usize)) {
    let size = DVec2::new(grid.size[0] as f64, grid.size[1] as f64);
    let Some([from, to]) = clipped(from, to, size) else { return };
    let steps = ((to - from).abs().max_element() * 2.0).ceil().max(1.0);
    for n in 0..=steps as usize {
        let p = from.lerp(to, n as f64 / steps);
        // Clipped ends may lie on the far border.
        let [i, k] = [p.x as usize, p.y as usize];
        if i < grid.size[0] && k < grid.size[1] {
            mark(k * grid.size[0] + i);
        }
    }
}

/// The part of a line within a rectangle from the origin to `size` (Liang and Barsky 1984).
fn clipped(from: DVec2, to: DVec2, size: DVec2) -> Option<[DVec2; 2]> {
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    let d = to - from;
    for axis in 0..2 {
        for (slope, room) in [(-d[axis], from[axis]), (d[axis], size[axis] - from[axis])] {
            if slope == 0.0 && room < 0.0 {
                return None;
            }
            if slope < 0.0 {
                enter = enter.max(room / slope);
            } else if slope > 0.0 {
                leave = leave.min(room / slope);
            }
        }
    }
    (enter <= leave).then(|| [from + d * enter, from + d * leave])
}
