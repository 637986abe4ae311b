//! Storeys of a walk volume: the heights with most floor, and the floor of each as a raster.

use super::Grid;
use crate::walk_volume::BELOW_M;
use ldi_protocol::{floor_plan::MAX_PLANS, volume::WalkVolume};
use std::collections::BTreeMap;

/// Height of a bin of the histogram of floors, metres.
const BIN_M: f64 = 0.1;
/// Least distance between the floors of two storeys, metres: nobody can stand above another within
/// it.
const STOREY_M: f64 = 2.1;
/// A storey's level holds at least this share of the largest level, and this much floor, m²:
/// landings of stairs are no storeys.
const STOREY_SHARE: f64 = 0.04;
const LEAST_STOREY_M2: f64 = 3.0;
/// What lies at most this far below a storey's floor belongs to it, metres; what climbs is the
/// lower storey's until there.
const SUNK_M: f64 = 0.6;
/// Floors this close to a storey's own are level with it, metres.
const EVEN_M: f64 = 0.35;
/// Where less than this share of the floor is level with a storey, the ground has no storeys.
const LEAST_EVEN: f64 = 0.6;
/// Where less than this share of the upper storeys' floor lies above another floor, the storeys are
/// terraces of open ground.
const LEAST_STACKED: f64 = 0.3;

/// A storey.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Storey {
    /// Height of its floor, metres.
    pub floor_m: f64,
    /// Heights of the floors that belong to it, metres: from the first on, below the second.
    pub range_m: [f64; 2],
}

/// The storeys from below to above, or one for all ground, and whether the latter is the case.
pub(super) fn storeys(volume: &WalkVolume, eye_height_m: f64) -> (Vec<Storey>, bool) {
    let mut bins = BTreeMap::<i64, f64>::new();
    let (mut total, mut sum) = (0.0, 0.0);
    for b in volume.boxes() {
        let (size, floor_m) = (b.size(), b.min.y + BELOW_M - eye_height_m);
        let area = size.x * size.z;
        *bins.entry((floor_m / BIN_M).round() as i64).or_default() += area;
        (total, sum) = (total + area, sum + area * floor_m);
    }
    let within = |middle: i64, off: i64| bins.range(middle - off..=middle + off).map(|b| b.1).sum::<f64>();
    let mut levels: Vec<(i64, f64)> = bins.keys().map(|b| (*b, within(*b, 1))).collect();
    levels.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let least = LEAST_STOREY_M2.max(STOREY_SHARE * levels.first().map_or(0.0, |l| l.1));
    let mut floors: Vec<i64> = Vec::new();
    let apart = (STOREY_M / BIN_M) as i64;
    for (bin, area) in levels {
        let is_first = floors.is_empty();
        if (is_first || area >= least) && floors.len() < MAX_PLANS && floors.iter().all(|f| (f - bin).abs() >= apart) {
            floors.push(bin);
        }
    }
    floors.sort_unstable();
    let even: f64 = floors.iter().map(|f| within(*f, (EVEN_M / BIN_M) as i64)).sum();
    if even < LEAST_EVEN * total || stacked(volume, &floors, eye_height_m) < LEAST_STACKED {
        let all = Storey { floor_m: sum / total.max(1e-9), range_m: [f64::NEG_INFINITY, f64::INFINITY] };
        return (vec![all], true);
    }
    let floor_m = |n: usize| floors[n] as f64 * BIN_M;
    let low = |n: usize| if n == 0 { f64::NEG_INFINITY } else { floor_m(n) - SUNK_M };
    let high = |n: usize| if n + 1 == floors.len() { f64::INFINITY } else { floor_m(n + 1) - SUNK_M };
    let storey = |n: usize| Storey { floor_m: floor_m(n), range_m: [low(n), high(n)] };
    ((0..floors.len()).map(storey).collect(), false)
}

/// Share of the floor above the lowest storey that lies above another floor; 1 for one storey.
/// `floors`: bins of the storeys' floors, ascending.
fn stacked(volume: &WalkVolume, floors: &[i64], eye_height_m: f64) -> f64 {
    let Some(second) = floors.get(1) else { return 1.0 };
    let from_m = *second as f64 * BIN_M - SUNK_M - BELOW_M + eye_height_m;
    let (mut upper, mut over) = (0.0, 0.0);
    for b in volume.boxes().filter(|b| b.min.y >= from_m) {
        let (size, middle) = (b.size(), b.centre());
        let area = size.x * size.z;
        upper += area;
        if volume.heights(middle.x, middle.z).any(|[low, _]| low <= b.min.y - STOREY_M) {
            over += area;
        }
    }
    if upper > 0.0 { over / upper } else { 1.0 }
}

/// Heights of the floor of a storey in the cells of a raster; NaN where there is none. Of several
/// floors in a cell the one nearest to the storey's own; on open ground the lowest.
pub(super) fn floor(volume: &WalkVolume, eye_height_m: f64, all: &[Storey], n: usize, grid: &Grid) -> Vec<f32> {
    let Storey { floor_m, range_m: [low, high] } = all[n];
    let is_relief = low == f64::NEG_INFINITY && high == f64::INFINITY && all.len() == 1;
    let off = |f: f64| if is_relief { f } else { (f - floor_m).abs() };
    let mut out = vec![f32::NAN; grid.cells()];
    for b in volume.boxes() {
        let f = b.min.y + BELOW_M - eye_height_m;
        if !(low..high).contains(&f) {
            continue;
        }
        // Cells whose middle lies in the box.
        let first = |v: f64, axis: usize| ((v - grid.corner[axis]) / grid.pitch_m - 0.5).ceil().max(0.0) as usize;
        let rows = first(b.min.z, 1)..first(b.max.z, 1).min(grid.size[1]);
        for k in rows {
            for i in first(b.min.x, 0)..first(b.max.x, 0).min(grid.size[0]) {
                let cell = &mut out[k * grid.size[0] + i];
                if cell.is_nan() || off(f) < off(f64::from(*cell)) {
                    *cell = f as f32;
                }
            }
        }
    }
    out
}
