//! Which surfaces are floors? Those that somebody can stand on and walk to.
//!
//! In: the heights at which vertical lines of a raster meet the scene. Out: the floors among them,
//! with the surface above each, and how much was left out for which reason.
//!
//! - A floor has head room: an eye at the nominal height keeps its distance from the surface above.
//! - Floors of neighbouring lines join when a step leads from one to the other. Joined floors form
//!   a region; what is too small to walk about on, table tops and ducts, is left out, measured
//!   against the largest region.
//! - A region most of which lies under the open sky with another floor below it is a roof.
//!
//! Left out places cost no grid points and no images. An eye that gets there all the same lies
//! outside the walk volume: frames keep their budget, but may miss what is far, and say so.

use crate::walk_volume::lines::Raster;
use std::collections::BTreeMap;

/// Highest step that is climbed at once, metres: generous, as lines can miss a stair's tread.
const STEP_M: f64 = 0.5;
/// Smallest region, as a share of the largest one's area.
const SMALLEST_SHARE: f64 = 0.05;
/// A region is a roof when this share of it lies under the sky and above another floor.
const ROOF_SHARE: f64 = 0.7;

/// A floor on one line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Floor {
    /// Line, row-major over the raster.
    pub line: u32,
    /// Its height, metres.
    pub y: f32,
    /// Height of the next surface above; infinite under the sky.
    pub above: f32,
}

/// Finds the floors. `heights`: (line, height), ascending; `head_room_m`: least distance to the
/// surface above.
pub(crate) fn floors(heights: &[(u32, f32)], raster: &Raster, head_room_m: f64) -> (Vec<Floor>, BTreeMap<String, u64>) {
    let lines = raster.size[0] as usize * raster.size[1] as usize;
    let mut found: Vec<Floor> = Vec::new();
    // Position of each line's first floor, and one more.
    let mut first = vec![0u32; lines + 1];
    let mut low = 0u64;
    for (at, &(line, y)) in heights.iter().enumerate() {
        let above = heights.get(at + 1).filter(|h| h.0 == line).map_or(f32::INFINITY, |h| h.1);
        if f64::from(above) - f64::from(y) >= head_room_m {
            found.push(Floor { line, y, above });
            first[line as usize + 1] += 1;
        } else {
            low += 1;
        }
    }
    for k in 0..lines {
        first[k + 1] += first[k];
    }
    let mut regions = Regions::new(found.len());
    let width = raster.size[0];
    for (n, f) in found.iter().enumerate() {
        let mut join = |line: u32| {
            for o in first[line as usize]..first[line as usize + 1] {
                if f64::from((found[o as usize].y - f.y).abs()) <= STEP_M {
                    regions.join(n as u32, o);
                }
            }
        };
        if f.line % width + 1 < width {
            join(f.line + 1);
        }
        if (f.line + width) < lines as u32 {
            join(f.line + width);
        }
    }
    // Area and roof-like area per region, in lines.
    let mut area: BTreeMap<u32, [u64; 2]> = BTreeMap::new();
    for (n, f) in found.iter().enumerate() {
        let roof = f.above.is_infinite() && n as u32 > first[f.line as usize];
        let a = area.entry(regions.root(n as u32)).or_default();
        a[0] += 1;
        a[1] += u64::from(roof);
    }
    let is_roof = |a: &[u64; 2]| a[1] as f64 > ROOF_SHARE * a[0] as f64;
    // A scene of nothing but roofs keeps them.
    let all_roofs = area.values().all(is_roof);
    let largest = area.values().filter(|a| all_roofs || !is_roof(a)).map(|a| a[0]).max().unwrap_or(0);
    let mut skipped = BTreeMap::from([("surfaces without head room".to_string(), low)]);
    let mut keep = BTreeMap::new();
    for (root, a) in &area {
        let reason = if !all_roofs && is_roof(a) {
            Some("floor samples on roofs")
        } else if (a[0] as f64) < SMALLEST_SHARE * largest as f64 {
            Some("floor samples on surfaces too small to walk on")
        } else {
            None
        };
        if let Some(reason) = reason {
            *skipped.entry(reason.to_string()).or_default() += a[0];
        }
        keep.insert(*root, reason.is_none());
    }
    let kept = (0..found.len()).filter(|n| keep[&regions.root(*n as u32)]).map(|n| found[n]).collect();
    (kept, skipped)
}

/// Disjoint sets, the smallest member being the root.
struct Regions(Vec<u32>);

impl Regions {
    fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
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
    use glam::DVec2;

    /// A raster of 40 x 40 lines of 0.25 m, with surfaces given as height by (column, row).
    fn found(surfaces: &[&dyn Fn(u32, u32) -> Option<f32>]) -> Vec<Floor> {
        let raster = Raster { origin: DVec2::ZERO, pitch_m: 0.25, size: [40, 40] };
        let mut heights: Vec<(u32, f32)> =
            (0..1600).flat_map(|l| surfaces.iter().filter_map(move |s| s(l % 40, l / 40).map(|y| (l, y)))).collect();
        heights.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        floors(&heights, &raster, 1.65).0
    }

    #[test]
    fn a_table_is_no_floor_and_hides_what_is_below() {
        let table = |i: u32, k: u32| (i < 4 && k < 4).then_some(0.8);
        let kept = found(&[&|_, _| Some(0.0), &table]);
        assert_eq!(kept.len(), 1600 - 16);
        assert!(kept.iter().all(|f| f.y == 0.0));
    }

    #[test]
    fn stairs_join_storeys_and_a_roof_is_left_out() {
        // Two storeys joined by a ramp of stairs, under a roof.
        let upper = |i: u32, _: u32| (i >= 20).then_some(3.0);
        let stairs = |i: u32, k: u32| ((10..20).contains(&i) && k < 4).then(|| 0.3 * (i - 9) as f32);
        let kept = found(&[&|_, _| Some(0.0), &upper, &stairs, &|_, _| Some(6.0)]);
        assert!(kept.iter().any(|f| f.y == 3.0) && kept.iter().any(|f| f.y == 0.0));
        assert!(kept.iter().all(|f| f.y < 5.0), "the roof is no floor");
        // The same surface is a floor where nothing is below it.
        assert_eq!(found(&[&|_, _| Some(6.0)]).len(), 1600);
    }
}
