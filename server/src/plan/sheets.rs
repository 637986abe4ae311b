//! Sheets: boxes of a walk volume that do not lie above each other.
//!
//! In: the boxes of a volume, each with its floor. Out: sheets. Boxes beside each other whose
//! floors differ by a step stay together as long as none lies above another; a spiral ramp goes on
//! on the next sheet. Small patches join a sheet at about their height.

use glam::DVec2;
use ldi_protocol::{Aabb, volume::WalkVolume};
use std::collections::{HashMap, HashSet};

/// Floors of neighbours on one sheet differ by at most this, metres.
const STEP_M: f64 = 0.75;
/// Floors of one sheet that are not joined differ by at most this from its middle, metres.
const STOREY_M: f64 = 1.6;

/// Boxes drawn together.
pub(super) struct Sheet {
    /// Positions among the boxes.
    pub boxes: Vec<usize>,
    /// Lowest and highest floor, metres.
    pub heights_m: [f64; 2],
    /// Mean floor, metres.
    pub middle_m: f64,
    taken: HashSet<[i64; 2]>,
}

/// Sorts boxes (with their floors) into sheets.
pub(super) fn sheets(boxes: &[(Aabb, f64)], volume: &WalkVolume) -> Vec<Sheet> {
    let corner = DVec2::from_array(volume.corner());
    let column = |b: &Aabb| {
        let c = b.centre();
        ((DVec2::new(c.x, c.z) - corner) / volume.pitch_m()).floor().to_array().map(|x| x as i64)
    };
    let mut over: HashMap<[i64; 2], Vec<usize>> = HashMap::new();
    for (n, (b, _)) in boxes.iter().enumerate() {
        over.entry(column(b)).or_default().push(n);
    }
    let mut done = vec![false; boxes.len()];
    let mut patches: Vec<Sheet> = Vec::new();
    for first in 0..boxes.len() {
        if done[first] {
            continue;
        }
        let mut sheet = Sheet {
            boxes: vec![],
            heights_m: [f64::INFINITY, f64::NEG_INFINITY],
            middle_m: 0.0,
            taken: HashSet::new(),
        };
        let mut open = vec![first];
        while let Some(n) = open.pop() {
            let at = column(&boxes[n].0);
            if done[n] || !sheet.taken.insert(at) {
                continue;
            }
            done[n] = true;
            sheet.boxes.push(n);
            let floor = boxes[n].1;
            sheet.heights_m = [sheet.heights_m[0].min(floor), sheet.heights_m[1].max(floor)];
            for beside in [[1, 0], [-1, 0], [0, 1], [0, -1]] {
                let there = [at[0] + beside[0], at[1] + beside[1]];
                let found = over.get(&there).into_iter().flatten();
                open.extend(found.filter(|o| !done[**o] && (boxes[**o].1 - floor).abs() <= STEP_M));
            }
        }
        sheet.middle_m = sheet.boxes.iter().map(|n| boxes[*n].1).sum::<f64>() / sheet.boxes.len().max(1) as f64;
        patches.push(sheet);
    }
    patches.sort_by_key(|p| std::cmp::Reverse(p.boxes.len()));
    let mut out: Vec<Sheet> = Vec::new();
    for patch in patches {
        let fits = |s: &&mut Sheet| {
            let [low, high] = s.heights_m;
            let near = patch.middle_m > low - STOREY_M && patch.middle_m < high + STOREY_M;
            near && patch.taken.is_disjoint(&s.taken)
        };
        match out
            .iter_mut()
            .filter(fits)
            .min_by(|a, b| (a.middle_m - patch.middle_m).abs().total_cmp(&(b.middle_m - patch.middle_m).abs()))
        {
            Some(sheet) => {
                sheet.heights_m =
                    [sheet.heights_m[0].min(patch.heights_m[0]), sheet.heights_m[1].max(patch.heights_m[1])];
                sheet.boxes.extend(patch.boxes);
                sheet.taken.extend(patch.taken);
            }
            None => out.push(patch),
        }
    }
    out
}
