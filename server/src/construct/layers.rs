//! From samples by pixel to layers: ranks, links, codes.
//!
//! The k-th nearest sample of a pixel goes to layer k. Two neighbours of one layer are linked
//! where the second continues the first's surface ([`Tolerance::continuous`]), so that the warp
//! may join them by a micro-quad; sky is never a sample, so no link reaches it.
//!
//! Where a surface passes behind an occluder its samples change layer, and a link cannot follow.
//! There the deeper layer repeats the last sample before the change (a bridge), as the format
//! allows: a few samples per occluder, and no crack along its border.

use super::{
    merge::Known,
    sample::{Prediction, Tolerance},
    view::Rig,
};
use ldi_protocol::ldi::{DisparityCodes, LINK_DOWN, LINK_RIGHT, Ldi, LdiLayer, SIDES, SLOPE_CODES, Segment, is_loose};
use rayon::prelude::*;

/// A layer before coding: samples by pixel, each with its links.
#[derive(Debug, Clone, Default)]
pub(super) struct RawLayer {
    pub samples: Vec<Prediction>,
    pub links: Vec<u8>,
    /// As in [`LdiLayer::ends`].
    pub ends: Vec<u16>,
    /// Change of disparity per column and per row up to where the surface ends, 1/m; 0 where it
    /// does not go on without a link.
    pub slopes: Vec<[f64; 2]>,
}

/// Samples that no layer took.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Dropped {
    /// Beyond [`Ldi::MAX_LAYERS`].
    pub too_deep: u64,
    /// In no user's picture.
    pub out_of_reach: u64,
}

/// Ranks the samples of each pixel into layers and links them.
pub(super) fn rank(known: &Known, rig: &Rig, tolerance: &Tolerance, bridges: bool) -> (Vec<RawLayer>, Dropped) {
    let width = rig.window.width;
    let solid = known.central.par_iter().enumerate().filter(|(_, s)| s.disparity > 0.0);
    let kept = solid.filter(|(p, s)| {
        let (u, v) = rig.window.centre(*p);
        rig.in_reach(u, v, f64::from(s.disparity))
    });
    let first: Vec<Prediction> = kept.map(|(p, s)| (p as u32, *s)).collect();
    let solid = known.central.iter().filter(|s| s.disparity > 0.0).count();
    let mut dropped = Dropped { too_deep: 0, out_of_reach: (solid - first.len()) as u64 };
    let mut layers = vec![RawLayer { samples: first, ..RawLayer::default() }];
    let mut start = 0;
    while start < known.deeper.len() {
        let pixel = known.deeper[start].0;
        let count = known.deeper[start..].iter().take_while(|d| d.0 == pixel).count();
        for (k, sample) in known.deeper[start..start + count].iter().enumerate() {
            if k + 1 >= Ldi::MAX_LAYERS {
                dropped.too_deep += 1;
                continue;
            }
            if layers.len() <= k + 1 {
                layers.push(RawLayer::default());
            }
            layers[k + 1].samples.push(*sample);
        }
        start += count;
    }
    if bridges {
        build_bridges(known, &mut layers, width, tolerance);
    }
    for layer in &mut layers {
        layer.links = links(&layer.samples, width, tolerance);
    }
    (layers, dropped)
}

/// Repeats, in each deeper layer, samples of the layers above that continue one of its samples.
fn build_bridges(known: &Known, layers: &mut [RawLayer], width: u32, tolerance: &Tolerance) {
    let rows = known.central.len() as u32 / width;
    for layer in layers.iter_mut().skip(1) {
        let mut bridges = Vec::new();
        for (pixel, s) in &layer.samples {
            let (column, row) = (pixel % width, pixel / width);
            let neighbours = [
                (column + 1 < width).then(|| (pixel + 1, 0, true)),
                (column > 0).then(|| (pixel - 1, 0, false)),
                (row + 1 < rows).then(|| (pixel + width, 1, true)),
                (row > 0).then(|| (pixel - width, 1, false)),
            ];
            for (there, axis, forward) in neighbours.into_iter().flatten() {
                // A bridge must end the pixel's list: whatever lies deeper there would be nearer
                // than a layer before it.
                let last = known.behind(there).last().map_or(&known.central[there as usize], |d| &d.1);
                let joined = last.disparity > 0.0
                    && if forward { tolerance.continuous(s, last, axis) } else { tolerance.continuous(last, s, axis) };
                if joined && layer.samples.binary_search_by_key(&there, |x| x.0).is_err() {
                    bridges.push((there, *last));
                }
            }
        }
        layer.samples.extend(bridges);
        layer.samples.sort_by_key(|s| s.0);
        layer.samples.dedup_by_key(|s| s.0);
    }
}

/// Links of samples that are sorted by pixel, one per pixel.
pub(super) fn links(samples: &[Prediction], width: u32, tolerance: &Tolerance) -> Vec<u8> {
    let mut below = 0;
    samples
        .iter()
        .enumerate()
        .map(|(i, (pixel, s))| {
            let mut bits = 0;
            let ends_row = pixel % width == width - 1;
            if samples.get(i + 1).is_some_and(|n| !ends_row && n.0 == pixel + 1 && tolerance.continuous(s, &n.1, 0)) {
                bits |= LINK_RIGHT;
            }
            while samples.get(below).is_some_and(|b| b.0 < pixel + width) {
                below += 1;
            }
            if samples.get(below).is_some_and(|b| b.0 == pixel + width && tolerance.continuous(s, &b.1, 1)) {
                bits |= LINK_DOWN;
            }
            bits
        })
        .collect()
}

/// Calls `f(i, j, axis)` for every linked pair of a layer; axis 0: j is in the next column, 1: in
/// the next row.
pub(super) fn for_each_link(layer: &RawLayer, width: u32, mut f: impl FnMut(usize, usize, usize)) {
    let mut below = 0;
    for (i, ((pixel, _), bits)) in layer.samples.iter().zip(&layer.links).enumerate() {
        if bits & LINK_RIGHT != 0 {
            f(i, i + 1, 0);
        }
        if bits & LINK_DOWN != 0 {
            while layer.samples[below].0 < pixel + width {
                below += 1;
            }
            f(i, below, 1);
        }
    }
}

/// Per sample the [`SIDES`] on which no link leads on.
pub(super) fn open_sides(layer: &RawLayer, width: u32) -> Vec<[bool; SIDES.len()]> {
    let mut open = vec![[true; SIDES.len()]; layer.samples.len()];
    for_each_link(layer, width, |i, j, axis| {
        (open[i][2 * axis + 1], open[j][2 * axis]) = (false, false);
    });
    open
}

/// Of no samples: any sound codes do.
pub(super) const NO_CODES: DisparityCodes = DisparityCodes { smallest: 1.0, step: 1.0, largest_code: 1 };

/// Disparity codes for all samples, and for `others`, 1/m.
pub(super) fn codes(rig: &Rig, layers: &[RawLayer], others: impl Iterator<Item = f64>) -> DisparityCodes {
    let (mut smallest, mut largest) = (f32::INFINITY, 0.0_f32);
    for s in layers.iter().flat_map(|l| &l.samples) {
        smallest = smallest.min(s.1.disparity);
        largest = largest.max(s.1.disparity);
    }
    let (mut smallest, mut largest) = (f64::from(smallest), f64::from(largest));
    for d in others {
        (smallest, largest) = (smallest.min(d), largest.max(d));
    }
    if largest == 0.0 {
        return NO_CODES;
    }
    rig.codes(smallest, largest)
}

/// The layer as it is stored.
pub(super) fn encode(layer: &RawLayer, width: u32, codes: &DisparityCodes) -> LdiLayer {
    let n = layer.samples.len();
    let mut out = LdiLayer {
        segments: Vec::new(),
        column: Vec::with_capacity(n),
        disparity: Vec::with_capacity(n),
        rgb: Vec::with_capacity(n),
        links: layer.links.clone(),
        ends: layer.ends.clone(),
        slopes: vec![[0; 2]; n],
    };
    for (pixel, s) in &layer.samples {
        let (row, column) = (pixel / width, pixel % width);
        let (row, base) = (row as u16, (column & !255) as u16);
        match out.segments.last_mut() {
            Some(l) if l.row == row && l.column_base == base => l.count += 1,
            _ => {
                let first = out.column.len() as u32;
                out.segments.push(Segment { row, column_base: base, first, count: 1 });
            }
        }
        out.column.push((column & 255) as u8);
        out.disparity.push(codes.code(f64::from(s.disparity)));
        out.rgb.push(s.rgb);
    }
    let mut told = vec![[0i32; 2]; n];
    for_each_link(layer, width, |i, j, axis| {
        let change = i32::from(out.disparity[j]) - i32::from(out.disparity[i]);
        (told[i][axis], told[j][axis]) = (change, change);
    });
    for (i, told) in told.iter().enumerate() {
        for axis in (0..2).filter(|axis| is_loose(out.ends[i], *axis)) {
            let slope = layer.slopes[i][axis] / codes.step;
            out.slopes[i][axis] = ((slope - f64::from(told[axis])) / f64::from(SLOPE_CODES)).round() as i8;
        }
    }
    out
}
