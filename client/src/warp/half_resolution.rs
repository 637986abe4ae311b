//! An image at half its resolution, for pictures at half the size that it was made for: its samples
//! then keep the footprint bound, and are a quarter as many.
//!
//! In: an [`Ldi`]. Out: another one from the same centre of projection, whose pixels are 2 x 2 of
//! the first one's. Linked samples of a layer's block become one sample of mean disparity, which is
//! exact within a plane, and mean colour; others go to a layer of their own. Sky is not halved, as
//! layouts do not use it.

use ldi_protocol::ldi::{
    END_BITS, END_PARTS, LINK_DOWN, LINK_RIGHT, Ldi, LdiCamera, LdiLayer, SIDES, SLOPE_CODES, Segment, Sliver, end_of,
    is_loose,
};

/// Columns of a segment's block.
const BLOCK: u32 = 256;
const NONE: u32 = u32::MAX;

/// Halves an image. Links to samples that do not exist are ignored.
pub fn halved(ldi: &Ldi) -> Ldi {
    let camera = half_camera(&ldi.camera);
    let layers = ldi.layers.iter().flat_map(|l| halved_layer(l, &ldi.camera, &camera)).collect();
    let shift = |fine: i32, coarse: i32| {
        i64::from(fine) * i64::from(Sliver::PARTS) - 2 * i64::from(coarse) * i64::from(Sliver::PARTS)
    };
    let (across, down) = (shift(ldi.camera.left, camera.left), shift(ldi.camera.top, camera.top));
    let mut slivers = ldi.slivers.clone();
    for corner in slivers.iter_mut().flat_map(|s| &mut s.corners) {
        corner.u = (i64::from(corner.u) + across).div_euclid(2) as i32;
        corner.v = (i64::from(corner.v) + down).div_euclid(2) as i32;
    }
    let sky = vec![0; (camera.width as usize).div_ceil(64) * camera.height as usize];
    Ldi { camera, codes: ldi.codes, layers, sky, slivers }
}

/// Pixels with the same place on the image plane, two by two.
fn half_camera(fine: &LdiCamera) -> LdiCamera {
    let span = |from: i32, length: u32| {
        let first = from.div_euclid(2);
        let end = (i64::from(from) + i64::from(length) + 1).div_euclid(2);
        (first, (end - i64::from(first)) as u32)
    };
    let ((left, width), (top, height)) = (span(fine.left, fine.width), span(fine.top, fine.height));
    LdiCamera { pixels_per_unit: fine.pixels_per_unit * 0.5, left, top, width, height, ..*fine }
}

/// The samples that become one: up to four, by position in the block: upper left, upper right,
/// lower left, lower right.
type Members = [u32; 4];

/// One layer in the making.
#[derive(Default)]
struct Coarse {
    layer: LdiLayer,
    members: Vec<Members>,
}

impl Coarse {
    fn push(&mut self, row: u32, column: u32, members: Members) {
        let first = self.members.len() as u32;
        let (row, column_base) = (row as u16, (column / BLOCK * BLOCK) as u16);
        match self.layer.segments.last_mut() {
            Some(s) if (s.row, s.column_base) == (row, column_base) => s.count += 1,
            _ => self.layer.segments.push(Segment { row, column_base, first, count: 1 }),
        }
        self.layer.column.push((column % BLOCK) as u8);
        self.members.push(members);
    }
}

fn halved_layer(fine: &LdiLayer, camera: &LdiCamera, half: &LdiCamera) -> Vec<LdiLayer> {
    let linked = fine.linked_sides();
    let below = below(fine, &linked);
    // The new layer of each sample.
    let mut rank = vec![0u8; fine.len()];
    let mut out: [Coarse; 4] = Default::default();
    let (odd_column, odd_row) = (camera.left.rem_euclid(2) as u32, camera.top.rem_euclid(2) as u32);
    // Upper and lower row of a row of blocks; the blocks with samples, in order.
    let mut rows = [vec![NONE; 2 * half.width as usize], vec![NONE; 2 * half.width as usize]];
    let mut touched: Vec<u32> = Vec::new();
    let row_of = |s: &Segment| (u32::from(s.row) + odd_row) / 2;
    for of_row in fine.segments.chunk_by(|a, b| row_of(a) == row_of(b)) {
        for s in of_row {
            let line = (u32::from(s.row) + odd_row) % 2;
            for i in s.first..s.first + u32::from(s.count) {
                let column = u32::from(s.column_base) + u32::from(fine.column[i as usize]) + odd_column;
                if let Some(slot) = rows[line as usize].get_mut(column as usize) {
                    *slot = i;
                    touched.push(column / 2);
                }
            }
        }
        touched.sort_unstable();
        touched.dedup();
        for block in touched.drain(..) {
            let at = 2 * block as usize;
            let four = [rows[0][at], rows[0][at + 1], rows[1][at], rows[1][at + 1]];
            (rows[0][at], rows[0][at + 1], rows[1][at], rows[1][at + 1]) = (NONE, NONE, NONE, NONE);
            for (r, members) in groups(&four, &linked).into_iter().enumerate().take_while(|g| g.1 != [NONE; 4]) {
                members.iter().filter(|i| **i != NONE).for_each(|i| rank[*i as usize] = r as u8);
                out[r].push(row_of(&of_row[0]), block, members);
            }
        }
    }
    let same = |from: u32, to: u32| rank.get(to as usize) == Some(&rank[from as usize]);
    for Coarse { layer, members } in &mut out {
        for m in members.iter() {
            let there = |place: usize| Some(m[place]).filter(|i| *i != NONE);
            let right = [1, 3].into_iter().filter_map(there).any(|i| linked[i as usize] & 2 != 0 && same(i, i + 1));
            let down =
                [2, 3].into_iter().filter_map(there).any(|i| linked[i as usize] & 8 != 0 && same(i, below[i as usize]));
            layer.links.push(if right { LINK_RIGHT } else { 0 } | if down { LINK_DOWN } else { 0 });
            let all = || m.iter().filter(|i| **i != NONE).map(|i| *i as usize);
            let n = all().count() as u32;
            let disparity: u32 = all().map(|i| u32::from(fine.disparity[i])).sum();
            layer.disparity.push(((disparity + n / 2) / n) as u16);
            // In approximately linear light, the square of the code, as the warp mixes.
            let mean = |c: usize| (all().map(|i| f32::from(fine.rgb[i][c]).powi(2)).sum::<f32>() / n as f32).sqrt();
            layer.rgb.push(std::array::from_fn(|c| (mean(c) + 0.5) as u8));
        }
        let sides = layer.linked_sides();
        layer.ends = members.iter().zip(&sides).map(|(m, sides)| ends(m, *sides, fine, &linked)).collect();
        let slope = |((m, sides), ends): ((&Members, &u8), &u16)| {
            [0, 1].map(|axis| if is_loose(*ends, axis) { slope(m, axis, sides >> (2 * axis) & 3, fine) } else { 0 })
        };
        layer.slopes = members.iter().zip(&sides).zip(&layer.ends).map(slope).collect();
    }
    out.into_iter().map(|c| c.layer).filter(|l| !l.is_empty()).collect()
}

/// The sample that one is linked to downward, if it exists.
fn below(layer: &LdiLayer, linked: &[u8]) -> Vec<u32> {
    let mut out = vec![NONE; layer.len()];
    // Both have the same order: the k-th that is linked down goes to the k-th that is linked up.
    let down = (0..out.len()).filter(|i| linked[*i] & 8 != 0);
    let up = (0u32..).zip(linked).filter(|(_, l)| **l & 4 != 0).map(|(i, _)| i);
    down.zip(up).for_each(|(from, to)| out[from] = to);
    out
}

/// The samples of a block grouped by links within it, largest group first.
fn groups(four: &Members, linked: &[u8]) -> [Members; 4] {
    let is = |place: usize, side: u8, other: usize| {
        four[place] != NONE && four[other] != NONE && linked[four[place] as usize] & side != 0
    };
    let mut group = [0, 1, 2, 3];
    for (a, side, b) in [(0, 2, 1), (2, 2, 3), (0, 8, 2), (1, 8, 3)] {
        if is(a, side, b) {
            let (from, to) = (group[b], group[a]);
            group.iter_mut().filter(|g| **g == from).for_each(|g| *g = to);
        }
    }
    let mut out: [Members; 4] =
        std::array::from_fn(|g| std::array::from_fn(|p| if group[p] == g { four[p] } else { NONE }));
    out.sort_by_key(|m| m.iter().filter(|i| **i == NONE).count());
    out
}

/// [`LdiLayer::slopes`] of a group along an axis: from its two halves, or from its members.
/// `linked`: the sides of that axis on which it is linked.
fn slope(members: &Members, axis: usize, linked: u8, fine: &LdiLayer) -> i8 {
    let mean = |places: [usize; 2], of: &dyn Fn(usize) -> f64| {
        let there = || places.into_iter().map(|p| members[p]).filter(|i| *i != NONE).map(|i| of(i as usize));
        let n = there().count();
        (n > 0).then(|| there().sum::<f64>() / n as f64)
    };
    let code = |i: usize| f64::from(fine.disparity[i]) / f64::from(SLOPE_CODES);
    let told = |i: usize| f64::from(fine.slopes.get(i).map_or(0, |s| s[axis]));
    let [low, high] = if axis == 0 { [[0, 2], [1, 3]] } else { [[0, 1], [2, 3]] };
    let per_pixel = match (linked, mean(low, &code), mean(high, &code)) {
        (0, Some(a), Some(b)) => b - a,
        // Slopes toward the open side; the link is the group's own.
        (2, ..) => mean(low, &told).or(mean(high, &told)).unwrap_or(0.0),
        _ => mean(high, &told).or(mean(low, &told)).unwrap_or(0.0),
    };
    (2.0 * per_pixel).round() as i8
}

/// Extent of a group's surface beyond the middle of its block.
fn ends(members: &Members, sides: u8, fine: &LdiLayer, linked: &[u8]) -> u16 {
    let mut out = 0;
    for (side, toward) in SIDES.iter().enumerate().filter(|(side, _)| sides >> side & 1 == 0) {
        let reach = |(place, i): (usize, &u32)| {
            let centre = [place as i32 % 2 * 2 - 1, place as i32 / 2 * 2 - 1];
            let along = f64::from(centre[0] * toward[0] + centre[1] * toward[1]) * 0.5;
            let end = match linked[*i as usize] >> side & 1 {
                0 => f64::from(end_of(fine.ends.get(*i as usize).copied().unwrap_or(0), side)) / f64::from(END_PARTS),
                // The neighbour is in the block, or has moved to another layer.
                _ => 0.5,
            };
            along + end
        };
        let most = members.iter().enumerate().filter(|(_, i)| **i != NONE).map(reach).fold(0.0, f64::max);
        let parts = (most * 0.5 * f64::from(END_PARTS)).round().min(f64::from(END_PARTS)) as u16;
        out |= parts << (side * END_BITS);
    }
    out
}
