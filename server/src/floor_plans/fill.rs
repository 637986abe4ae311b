//! Fills walls: spaces between lines in which nobody can stand.
//!
//! In: lines, and the floor of each cell. Out: per cell [`WALL`], [`SOLID`], [`CLOSED`] or 0, and
//! floors without gaps indoors and without strips along outer walls.
//!
//! Spaces are the parts into which the lines divide the raster. One that is nowhere wide enough
//! for a person is the inside of a wall, a column or a piece of furniture. One without floor that
//! does not reach the raster's rim is closed: a shaft, a solid core, a room that no way leads to.

use super::Grid;
use ldi_protocol::floor_plan::{CLOSED, SOLID, WALL};

/// Spaces narrower than this are solid, metres. More: closets and lifts are walls. Less: thick
/// walls are not filled.
const THICKEST_WALL_M: f64 = 0.55;
/// Floors outdoors that are narrower than this are no floors, metres: the walk volume reaches a
/// little through outer walls.
const NARROWEST_FLOOR_M: f64 = 0.7;
/// Gaps in the floors of a space are closed this far from the floor, metres: what stands near walls
/// leaves such gaps. More: open wells look like floors.
const GAP_M: f64 = 0.6;
/// A space with floor in less than this share of its cells is closed: the walk volume reaches a
/// little into walls.
const LEAST_FLOOR: f64 = 0.35;
/// Length of a step to a neighbour and to a diagonal one in the distance transform, thirds of a
/// cell (Borgefors 1986).
const STEP: [u16; 2] = [3, 4];

/// Marks solids and closed spaces, and corrects the floors.
pub(super) fn fill(cells: &mut [u8], floor: &mut [f32], grid: &Grid, relief: bool) {
    let distance = distance(grid, |c| cells[c] == WALL);
    let mut outdoors = vec![false; cells.len()];
    // The distance is that of the middles of cells; a wall's face lies half a cell before its own.
    let thin = (THICKEST_WALL_M * 0.5 / grid.pitch_m + 0.5) * f64::from(STEP[0]);
    let mut seen = vec![false; cells.len()];
    let mut space = Vec::new();
    for first in 0..cells.len() {
        if seen[first] || cells[first] == WALL {
            continue;
        }
        space.clear();
        space.push(first);
        seen[first] = true;
        let (mut widest, mut on_rim, mut with_floor) = (0, false, 0usize);
        let mut next = 0;
        while let Some(&cell) = space.get(next) {
            next += 1;
            widest = widest.max(distance[cell]);
            with_floor += usize::from(!floor[cell].is_nan());
            let mut neighbours = 0;
            for other in grid.beside(cell) {
                neighbours += 1;
                if !seen[other] && cells[other] != WALL {
                    seen[other] = true;
                    space.push(other);
                }
            }
            on_rim |= neighbours < 4;
        }
        let mark = if on_rim {
            space.iter().for_each(|c| outdoors[*c] = true);
            continue;
        } else if f64::from(widest) < thin {
            SOLID
        } else if (with_floor as f64) < LEAST_FLOOR * space.len() as f64 {
            CLOSED
        } else {
            spread(&space, cells, floor, grid);
            continue;
        };
        space.iter().for_each(|c| cells[*c] = mark);
    }
    if !relief {
        remove_strips(&outdoors, floor, grid);
    }
}

/// Gives cells of a space without floor that of a near cell with one.
fn spread(space: &[usize], cells: &[u8], floor: &mut [f32], grid: &Grid) {
    let mut front: Vec<usize> = space.iter().copied().filter(|c| !floor[*c].is_nan()).collect();
    for _ in 0..(GAP_M / grid.pitch_m) as usize {
        let mut next = Vec::new();
        for &cell in &front {
            for other in grid.beside(cell).filter(|o| cells[*o] != WALL) {
                if floor[other].is_nan() {
                    floor[other] = floor[cell];
                    next.push(other);
                }
            }
        }
        front = next;
    }
}

/// Removes floors outdoors that are nowhere wide (a morphological opening).
fn remove_strips(outdoors: &[bool], floor: &mut [f32], grid: &Grid) {
    let radius = NARROWEST_FLOOR_M * 0.5 / grid.pitch_m * f64::from(STEP[0]);
    let inner = distance(grid, |c| !outdoors[c] || floor[c].is_nan());
    let from_inner = distance(grid, |c| f64::from(inner[c]) >= radius);
    for (cell, floor) in floor.iter_mut().enumerate() {
        if outdoors[cell] && f64::from(from_inner[cell]) > radius {
            *floor = f32::NAN;
        }
    }
}

/// Distance of every cell to the next one for which `is_zero` holds, thirds of a cell.
fn distance(grid: &Grid, is_zero: impl Fn(usize) -> bool) -> Vec<u16> {
    let [w, h] = grid.size;
    let mut d: Vec<u16> = (0..w * h).map(|c| if is_zero(c) { 0 } else { u16::MAX / 2 }).collect();
    let mut relax = |i: usize, k: usize, from: [(isize, isize, u16); 4]| {
        let mut least = d[k * w + i];
        for (di, dk, step) in from {
            if let (Some(i), Some(k)) = (i.checked_add_signed(di), k.checked_add_signed(dk))
                && i < w
                && k < h
            {
                least = least.min(d[k * w + i] + step);
            }
        }
        d[k * w + i] = least;
    };
    let [straight, diagonal] = STEP;
    for k in 0..h {
        for i in 0..w {
            relax(i, k, [(-1, 0, straight), (0, -1, straight), (-1, -1, diagonal), (1, -1, diagonal)]);
        }
    }
    for k in (0..h).rev() {
        for i in (0..w).rev() {
            relax(i, k, [(1, 0, straight), (0, 1, straight), (1, 1, diagonal), (-1, 1, diagonal)]);
        }
    }
    d
}
