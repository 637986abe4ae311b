//! Chunks of the LDI tree: the nodes of a brood, as planes of residuals.
//!
//! ```text
//!   "LDO" version | nodes | per node: faces (bits), samples | sections: occupancy, layers, depths, slopes, alphas, colours, filtered
//! ```
//!
//! Samples come by node, face, row, column, depth. Depth is predicted by the sample of the same rank in the pixel on the left along its slope, or above, or
//! by the one before in the same pixel; the rest by the same neighbour's. On a wall every residual but the colour's is 0.

use super::{
    CodecError,
    bytes::{Reader, Writer, put_varint, unzigzag, zigzag},
};
use crate::tree::{Brood, DEPTH_STEPS, MAX_LAYERS, NodeSamples, OPAQUE, SIDE, TreeSample};

const MAGIC: [u8; 3] = *b"LDO";
const VERSION: u8 = 1;
/// Pixels of a face.
const PIXELS: usize = (SIDE * SIDE) as usize;
/// Most samples of a chunk: eight nodes with every pixel of every face twice.
const MAX_SAMPLES: usize = 8 * 6 * PIXELS * 2;

/// What the samples of a face predict each other by.
struct Neighbours {
    /// First sample and number of samples of each pixel of the row above and of this row.
    rows: [[(usize, usize); SIDE as usize]; 2],
}

impl Neighbours {
    fn new() -> Self {
        Self { rows: [[(0, 0); SIDE as usize]; 2] }
    }
    fn next_row(&mut self) {
        self.rows.swap(0, 1);
        self.rows[1] = [(0, 0); SIDE as usize];
    }
    /// The sample that predicts the one of this rank, and its depth carried on to the pixel.
    fn predict(&self, samples: &[TreeSample], column: usize, rank: usize) -> Option<(TreeSample, i64)> {
        let (own_first, own) = self.rows[1][column];
        let left = if column > 0 { self.rows[1][column - 1] } else { (0, 0) };
        let above = self.rows[0][column];
        let of = |(first, count): (usize, usize)| samples[first + rank.min(count - 1)];
        if left.1 > rank || (left.1 > 0 && above.1 <= rank) {
            let s = of(left);
            return Some((s, i64::from(s.depth) + i64::from(s.slope[0])));
        }
        if above.1 > 0 {
            let s = of(above);
            return Some((s, i64::from(s.depth) + i64::from(s.slope[1])));
        }
        (own > 0).then(|| samples[own_first + own - 1]).map(|s| (s, i64::from(s.depth)))
    }
}

/// What stands where nothing predicts.
const NOTHING: TreeSample =
    TreeSample { face: 0, column: 0, row: 0, alpha: OPAQUE, depth: 0, slope: [0; 2], rgb: [128; 3], filtered: true };

/// Encodes a brood; samples must be in order, by face, row, column, depth.
///
/// # Errors
/// A sample out of range or order, too many of them, or zstd.
pub fn encode(brood: &Brood, level: i32) -> Result<Vec<u8>, CodecError> {
    let mut w = Writer::new(level)?;
    w.raw(&MAGIC);
    w.u8(VERSION);
    w.varint(brood.nodes.len() as u64);
    let (mut occupied, mut layers, mut depths) = (Vec::new(), Vec::new(), Vec::new());
    let mut planes: [Vec<u8>; 6] = Default::default();
    let mut flags = Vec::new();
    for node in &brood.nodes {
        let faces = node.samples.iter().fold(0u8, |bits, s| bits | 1 << s.face.min(7));
        w.u8(faces);
        w.varint(node.samples.len() as u64);
        let key = |s: &TreeSample| (s.face, s.row, s.column, s.depth);
        let fits = |s: &TreeSample| {
            s.face < 6
                && u32::from(s.column) < SIDE
                && u32::from(s.row) < SIDE
                && u32::from(s.depth) < SIDE * DEPTH_STEPS
                && (1..=OPAQUE).contains(&s.alpha)
        };
        if !node.samples.iter().all(fits) || !node.samples.is_sorted_by(|a, b| key(a) <= key(b)) {
            return Err(CodecError::mismatch("tree samples", "out of range or order"));
        }
        for face in node.samples.chunk_by(|a, b| a.face == b.face) {
            let mut bits = [0u8; PIXELS / 8];
            let mut neighbours = Neighbours::new();
            let mut row = 0;
            let mut at = 0;
            for pixel in face.chunk_by(|a, b| (a.row, a.column) == (b.row, b.column)) {
                while row < pixel[0].row {
                    neighbours.next_row();
                    row += 1;
                }
                let column = usize::from(pixel[0].column);
                let number = usize::from(row) * SIDE as usize + column;
                bits[number / 8] |= 1 << (number % 8);
                if pixel.len() > MAX_LAYERS {
                    return Err(CodecError::range("tree layers", pixel.len(), "a pixel has at most 128 samples"));
                }
                layers.push(pixel.len() as u8);
                for (rank, s) in pixel.iter().enumerate() {
                    let (by, depth) = neighbours.predict(face, column, rank).unwrap_or((NOTHING, 0));
                    put_varint(&mut depths, zigzag(i64::from(s.depth) - depth));
                    let green = s.rgb[1].wrapping_sub(by.rgb[1]);
                    let residuals = [
                        s.slope[0].wrapping_sub(by.slope[0]) as u8,
                        s.slope[1].wrapping_sub(by.slope[1]) as u8,
                        s.alpha.wrapping_sub(by.alpha),
                        green,
                        s.rgb[0].wrapping_sub(by.rgb[0]).wrapping_sub(green),
                        s.rgb[2].wrapping_sub(by.rgb[2]).wrapping_sub(green),
                    ];
                    planes.iter_mut().zip(residuals).for_each(|(p, r)| p.push(r));
                    flags.push(s.filtered);
                    at += 1;
                    neighbours.rows[1][column] = (at - rank - 1, rank + 1);
                }
            }
            occupied.extend(bits);
        }
    }
    if flags.len() > MAX_SAMPLES {
        return Err(CodecError::range("tree samples", flags.len(), "a chunk holds fewer"));
    }
    w.section("tree occupancy", &occupied)?;
    w.section("tree layers", &layers)?;
    w.section("tree depths", &depths)?;
    for plane in &planes {
        w.section("tree planes", plane)?;
    }
    let packed: Vec<u8> =
        flags.chunks(8).map(|c| c.iter().enumerate().fold(0, |bits, (k, f)| bits | u8::from(*f) << k)).collect();
    w.section("tree filtered", &packed)?;
    Ok(w.bytes)
}

/// Decodes a brood. `nodes` are the numbers of samples and of unfiltered samples that the index lists.
///
/// # Errors
/// Anything that [`encode`] does not write, or other numbers of samples than listed.
pub fn decode(bytes: &[u8], nodes: &[(u32, u32)]) -> Result<Brood, CodecError> {
    let mut r = Reader::new(bytes);
    r.magic("tree chunk", MAGIC, VERSION)?;
    let count = r.count("tree nodes", 8)?;
    if count != nodes.len() {
        return Err(CodecError::mismatch("tree nodes", format!("{count}, but the index lists {}", nodes.len())));
    }
    let mut heads = Vec::with_capacity(count);
    for (listed, _) in nodes {
        let faces = r.u8("tree faces")?;
        let samples = r.count("tree samples", MAX_SAMPLES)?;
        if samples != *listed as usize || faces >= 1 << 6 {
            return Err(CodecError::mismatch("tree samples", format!("{samples}, but the index lists {listed}")));
        }
        heads.push((faces, samples));
    }
    let total: usize = heads.iter().map(|h| h.1).sum();
    if total > MAX_SAMPLES {
        return Err(CodecError::range("tree samples", total, "a chunk holds fewer"));
    }
    let faces: usize = heads.iter().map(|h| h.0.count_ones() as usize).sum();
    let occupied = r.section_of("tree occupancy", faces * PIXELS / 8)?;
    let pixels: usize = occupied.iter().map(|b| b.count_ones() as usize).sum();
    let layers = r.section_of("tree layers", pixels)?;
    if layers.iter().map(|l| usize::from(*l)).sum::<usize>() != total || layers.contains(&0) {
        return Err(CodecError::mismatch("tree layers", "they do not add up to the samples"));
    }
    let depths = r.section("tree depths", total * 3)?;
    let mut planes: [Vec<u8>; 6] = Default::default();
    for plane in &mut planes {
        *plane = r.section_of("tree planes", total)?;
    }
    let flags = r.section_of("tree filtered", total.div_ceil(8))?;
    r.finish("tree chunk")?;

    let mut depths = Reader::new(&depths);
    let (mut layers, mut occupied) = (layers.into_iter(), occupied.chunks_exact(PIXELS / 8));
    let mut number = 0;
    let mut brood = Brood::default();
    for ((faces, samples), (_, unfiltered)) in heads.into_iter().zip(nodes) {
        let mut out: Vec<TreeSample> = Vec::with_capacity(samples);
        for face in (0..6u8).filter(|f| faces >> f & 1 == 1) {
            let bits = occupied.next().unwrap_or_default();
            let first = out.len();
            let mut neighbours = Neighbours::new();
            for row in 0..SIDE as u8 {
                for column in 0..SIDE as u8 {
                    let pixel = usize::from(row) * SIDE as usize + usize::from(column);
                    if bits[pixel / 8] >> (pixel % 8) & 1 == 0 {
                        continue;
                    }
                    let count = usize::from(layers.next().unwrap_or(0));
                    if number + count > total {
                        return Err(CodecError::mismatch("tree layers", "more than the node's samples"));
                    }
                    for rank in 0..count {
                        let predicted = neighbours.predict(&out[first..], usize::from(column), rank);
                        let (by, predicted) = predicted.unwrap_or((NOTHING, 0));
                        let depth = predicted + unzigzag(depths.varint("tree depth", u32::MAX.into())?);
                        let r: [u8; 6] = std::array::from_fn(|k| planes[k][number]);
                        let alpha = by.alpha.wrapping_add(r[2]);
                        if !(0..i64::from(SIDE * DEPTH_STEPS)).contains(&depth) || !(1..=OPAQUE).contains(&alpha) {
                            return Err(CodecError::mismatch("tree samples", "depth or coverage out of range"));
                        }
                        let colour = |k: usize, residual: u8| by.rgb[k].wrapping_add(residual).wrapping_add(r[3]);
                        out.push(TreeSample {
                            face,
                            column,
                            row,
                            alpha,
                            depth: depth as u16,
                            slope: [by.slope[0].wrapping_add(r[0] as i8), by.slope[1].wrapping_add(r[1] as i8)],
                            rgb: [colour(0, r[4]), colour(1, 0), colour(2, r[5])],
                            filtered: flags[number / 8] >> (number % 8) & 1 == 1,
                        });
                        number += 1;
                        let at = out.len() - first;
                        neighbours.rows[1][usize::from(column)] = (at - rank - 1, rank + 1);
                    }
                    let of_pixel = &out[out.len() - count..];
                    if !of_pixel.is_sorted_by_key(|s| s.depth) {
                        return Err(CodecError::mismatch("tree samples", "depths of a pixel do not ascend"));
                    }
                }
                neighbours.next_row();
            }
        }
        let found = out.iter().filter(|s| !s.filtered).count();
        if out.len() != samples || found != *unfiltered as usize {
            return Err(CodecError::mismatch(
                "tree samples",
                format!("{} of {samples}, {found} of {unfiltered} unfiltered", out.len()),
            ));
        }
        brood.nodes.push(NodeSamples { samples: out });
    }
    depths.finish("tree depths")?;
    Ok(brood)
}
