//! Chunks of the LDI tree: the nodes of a brood, as planes of residuals.
//!
//! ```text
//!   "LDO" version | nodes | per node: faces (bits), samples | sections: occupancy, layers, samples (residual streams), filtered
//! ```
//!
//! Samples come by node, face, row, column, depth. Depths are predicted by the first surface
//! behind the sample before that the pixel on the left, or above, carries on along its slope. The
//! depth tells which samples of the pixels on the left, above and in the corner between continue
//! the surface, those nearest in depth, and they predict the rest by the median-edge rule. On a
//! wall every residual but the colour's is 0.

use super::{
    CodecError,
    bytes::{Reader, Writer},
    residual::{Coder, Decoder, Encoder, median_edge},
};
use crate::tree::{Brood, DEPTH_STEPS, MAX_LAYERS, NodeSamples, PARTS, SIDE, TreeSample, WHOLE};

const MAGIC: [u8; 3] = *b"LDO";
const VERSION: u8 = 4;
/// Pixels of a face.
const PIXELS: usize = (SIDE * SIDE) as usize;
/// Most samples of a chunk: eight nodes with every pixel of every face twice.
const MAX_SAMPLES: usize = 8 * 6 * PIXELS * 2;

/// Contexts of depths: how far left and above disagree (4), only one of them, only the sample
/// before in the pixel, nothing.
const DEPTHS: usize = 8;
/// Contexts of each slope: how far left and above disagree (3), neither, one of them.
const SLOPES: usize = 5;
/// Contexts of coverage: absent, full or partial, on the left and above.
const COVERAGES: usize = 9;
/// Contexts of the rows of a coverage mask: the first row; the row above it empty, full, other.
const MASK_ROWS: usize = 4;
/// Contexts of each of G, R and B: how far the greens of left and above disagree (4), one of them,
/// neither.
const COLOURS: usize = 6;
/// Streams of [`walk`].
const STREAMS: usize = DEPTHS + 2 * SLOPES + COVERAGES + MASK_ROWS + 3 * COLOURS;
/// Most residuals of a sample: depth, slopes, form and rows of the mask, colour.
const MOST_VALUES: usize = 3 + 1 + PARTS as usize + 3;

/// Forms of a coverage mask.
const WHOLE_PIXEL: i32 = 0;
/// The mask of the neighbour on the left, or else above, that is partial.
const AS_BESIDE: i32 = 1;
/// None of these: the rows of the mask follow.
const BY_ROWS: i32 = 2;

/// What stands where nothing predicts.
const NOTHING: TreeSample =
    TreeSample { face: 0, column: 0, row: 0, covers: WHOLE, depth: 0, slope: [0; 2], rgb: [128; 3], filtered: true };

/// First sample and number of samples of a pixel.
type Pixel = (usize, usize);

/// Codes depth, slopes, coverage and colour of the samples of one face. A decoder passes samples
/// that have their places only, and gets the rest.
fn walk(samples: &mut [TreeSample], coder: &mut impl Coder) {
    // Per column, the pixel of the row above and of this row.
    let (mut above, mut here) = ([(0, 0); SIDE as usize], [(0, 0); SIDE as usize]);
    let (mut row, mut next) = (0, 0);
    while let Some(first) = samples.get(next).copied() {
        while row < first.row {
            above = std::mem::replace(&mut here, [(0, 0); SIDE as usize]);
            row += 1;
        }
        let place = |s: &TreeSample| (s.row, s.column) == (first.row, first.column);
        let count = samples[next..].iter().take_while(|s| place(s)).count();
        let column = usize::from(first.column);
        let left = |row: &[Pixel]| if column > 0 { row[column - 1] } else { (0, 0) };
        let sides = [left(&here), above[column], left(&above)];
        for i in next..next + count {
            let before = (i > next).then(|| samples[i - 1]);
            samples[i] = code(samples, sides, before, samples[i], coder);
        }
        here[column] = (next, count);
        next += count;
    }
}

/// Codes one sample; `sides`: the pixels on the left, above and in the corner between; `before`:
/// the sample before in the pixel.
fn code(
    samples: &[TreeSample],
    sides: [Pixel; 3],
    before: Option<TreeSample>,
    mut s: TreeSample,
    coder: &mut impl Coder,
) -> TreeSample {
    let behind = before.map_or(-1, |b| i32::from(b.depth));
    let carried = |axis: usize| {
        let (first, count) = sides[axis];
        let depths = samples[first..first + count].iter().map(|q| i32::from(q.depth) + i32::from(q.slope[axis]));
        depths.filter(|d| *d > behind).min()
    };
    let (predicted, context) = match (carried(0), carried(1)) {
        (Some(left), Some(up)) => (left, class(left - up, [0, 2, 16])),
        (Some(left), None) => (left, 4),
        (None, Some(up)) => (up, 5),
        (None, None) => (behind.max(0), if before.is_some() { 6 } else { 7 }),
    };
    s.depth = coder.word(context, predicted.clamp(0, i32::from(u16::MAX)) as u16, s.depth);

    let around = Around::nearest(samples, sides, before, s.depth);
    let mut stream = DEPTHS;
    for axis in 0..2 {
        let slope = |q: &TreeSample| i32::from(q.slope[axis]);
        let context = match around.apart(slope) {
            Some(apart) => class(apart, [0, 3, i32::MAX]),
            None if around.is_empty() => 3,
            None => 4,
        };
        let [predicted, actual] = [around.predict(slope), slope(&s)].map(|x| i32::from(x as u8));
        s.slope[axis] = coder.byte::<true>(stream + context, 1, predicted, actual).1 as u8 as i8;
        stream += SLOPES;
    }
    s.covers = code_mask(&around, s.covers, stream, coder);
    stream += COVERAGES + MASK_ROWS;

    let green = |q: &TreeSample| i32::from(q.rgb[1]);
    let context = match around.apart(green) {
        Some(apart) => class(apart, [2, 8, 24]),
        None if around.is_empty() => 5,
        None => 4,
    };
    s.rgb[1] = coder.byte::<true>(stream + context, 1, around.predict(green), green(&s)).1 as u8;
    for k in [0, 2] {
        stream += COLOURS;
        let over_green = |q: &TreeSample| i32::from(q.rgb[k]) - i32::from(q.rgb[1]);
        let predicted = (green(&s) + around.predict(over_green)).clamp(0, 255);
        s.rgb[k] = coder.byte::<true>(stream + context, 1, predicted, i32::from(s.rgb[k])).1 as u8;
    }
    s
}

/// Codes a coverage mask, in streams from `stream` on.
fn code_mask(around: &Around<'_>, mask: u16, stream: usize, coder: &mut impl Coder) -> u16 {
    let kind = |q: Option<&TreeSample>| q.map_or(0, |q| if q.covers == WHOLE { 1 } else { 2 });
    let context = stream + 3 * kind(around.left) + kind(around.up);
    let partial = |q: Option<&TreeSample>| q.map(|q| q.covers).filter(|covers| *covers != WHOLE);
    let beside = partial(around.left).or(partial(around.up)).unwrap_or(WHOLE);
    let form = match mask {
        WHOLE => WHOLE_PIXEL,
        _ if mask == beside => AS_BESIDE,
        _ => BY_ROWS,
    };
    match coder.byte::<true>(context, 1, 0, form).1 {
        WHOLE_PIXEL => return WHOLE,
        AS_BESIDE => return beside,
        _ => {}
    }
    let full = (1 << PARTS) - 1;
    let (mut out, mut context) = (0, 0);
    for shift in (0..PARTS * PARTS).step_by(PARTS as usize) {
        let row = coder.byte::<true>(stream + COVERAGES + context, 1, 0, i32::from(mask >> shift) & full).1;
        context = match row & full {
            0 => 1,
            row if row == full => 2,
            _ => 3,
        };
        out |= ((row & full) as u16) << shift;
    }
    out
}

/// What continues a sample's surface on the left, above and in the corner between, as far as its
/// depth tells.
struct Around<'a> {
    left: Option<&'a TreeSample>,
    up: Option<&'a TreeSample>,
    corner: Option<&'a TreeSample>,
    /// What predicts where left and above are not both there.
    alone: TreeSample,
}

impl<'a> Around<'a> {
    #[inline]
    fn nearest(samples: &'a [TreeSample], sides: [Pixel; 3], before: Option<TreeSample>, depth: u16) -> Self {
        let [left, up, corner] = sides.map(|(first, count)| match &samples[first..first + count] {
            [] => None,
            [one] => Some(one),
            many => many.iter().min_by_key(|q| q.depth.abs_diff(depth)),
        });
        Self { left, up, corner, alone: left.or(up).copied().or(before).unwrap_or(NOTHING) }
    }
    fn is_empty(&self) -> bool {
        self.left.is_none() && self.up.is_none()
    }
    /// The median-edge rule for one number of a sample.
    #[inline]
    fn predict(&self, of: impl Fn(&TreeSample) -> i32) -> i32 {
        match (self.left, self.up, self.corner) {
            (Some(left), Some(up), Some(corner)) => median_edge(of(left), of(up), of(corner)),
            (Some(left), Some(up), None) => (of(left) + of(up)) / 2,
            _ => of(&self.alone),
        }
    }
    /// By how much left exceeds above, where both are there.
    #[inline]
    fn apart(&self, of: impl Fn(&TreeSample) -> i32) -> Option<i32> {
        self.left.zip(self.up).map(|(left, up)| of(left) - of(up))
    }
}

/// 0 to 3: how many of the limits it exceeds, either way.
fn class(v: i32, limits: [i32; 3]) -> usize {
    limits.iter().filter(|limit| v.abs() > **limit).count()
}

/// Encodes a brood; samples must be in order, by face, row, column, depth.
///
/// # Errors
/// A sample out of range or order, too many of them, or zstd.
pub fn encode(brood: &Brood, level: i32) -> Result<Vec<u8>, CodecError> {
    let mut w = Writer::new(level)?;
    w.raw(&MAGIC);
    w.u8(VERSION);
    w.varint(brood.nodes.len() as u64);
    let (mut occupied, mut layers, mut flags) = (Vec::new(), Vec::new(), Vec::new());
    let mut residuals = Encoder::new(STREAMS);
    for node in &brood.nodes {
        let faces = node.samples.iter().fold(0u8, |bits, s| bits | 1 << s.face.min(7));
        w.u8(faces);
        w.varint(node.samples.len() as u64);
        let key = |s: &TreeSample| (s.face, s.row, s.column, s.depth);
        if !node.samples.iter().all(fits) || !node.samples.is_sorted_by(|a, b| key(a) <= key(b)) {
            return Err(CodecError::mismatch("tree samples", "out of range or order"));
        }
        flags.extend(node.samples.iter().map(|s| s.filtered));
        for face in node.samples.chunk_by(|a, b| a.face == b.face) {
            let mut bits = [0u8; PIXELS / 8];
            for pixel in face.chunk_by(|a, b| (a.row, a.column) == (b.row, b.column)) {
                let number = usize::from(pixel[0].row) * SIDE as usize + usize::from(pixel[0].column);
                bits[number / 8] |= 1 << (number % 8);
                if pixel.len() > MAX_LAYERS {
                    return Err(CodecError::range("tree layers", pixel.len(), "a pixel has at most 128 samples"));
                }
                layers.push(pixel.len() as u8);
            }
            occupied.extend(bits);
            walk(&mut face.to_vec(), &mut residuals);
        }
    }
    if flags.len() > MAX_SAMPLES {
        return Err(CodecError::range("tree samples", flags.len(), "a chunk holds fewer"));
    }
    w.section("tree occupancy", &occupied)?;
    w.section("tree layers", &layers)?;
    residuals.finish(&mut w, "tree samples")?;
    let packed: Vec<u8> =
        flags.chunks(8).map(|c| c.iter().enumerate().fold(0, |bits, (k, f)| bits | u8::from(*f) << k)).collect();
    w.section("tree filtered", &packed)?;
    Ok(w.bytes)
}

/// Whether all its numbers are within their ranges.
fn fits(s: &TreeSample) -> bool {
    s.face < 6
        && u32::from(s.column) < SIDE
        && u32::from(s.row) < SIDE
        && u32::from(s.depth) < SIDE * DEPTH_STEPS
        && s.covers != 0
}

/// Decodes a brood. `nodes` are the numbers of samples and of unfiltered samples that the index
/// lists.
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
    if layers.iter().map(|l| usize::from(*l)).sum::<usize>() != total
        || !layers.iter().all(|l| (1..=MAX_LAYERS).contains(&usize::from(*l)))
    {
        return Err(CodecError::mismatch("tree layers", "they do not add up to the samples, or a pixel has too many"));
    }
    let mut residuals = Decoder::of_at_most(&mut r, "tree samples", STREAMS, total * MOST_VALUES)?;
    let flags = r.section_of("tree filtered", total.div_ceil(8))?;
    r.finish("tree chunk")?;

    let (mut layers, mut occupied) = (layers.into_iter(), occupied.chunks_exact(PIXELS / 8));
    let mut number = 0;
    let mut brood = Brood::default();
    for ((faces, count), (_, unfiltered)) in heads.into_iter().zip(nodes) {
        let mut samples: Vec<TreeSample> = Vec::with_capacity(count);
        for face in (0..6u8).filter(|f| faces >> f & 1 == 1) {
            let bits = occupied.next().unwrap_or_default();
            let first = samples.len();
            for pixel in (0..PIXELS).filter(|p| bits[p / 8] >> (p % 8) & 1 == 1) {
                let (row, column) = ((pixel / SIDE as usize) as u8, (pixel % SIDE as usize) as u8);
                for _ in 0..layers.next().unwrap_or(0) {
                    let filtered = flags[number / 8] >> (number % 8) & 1 == 1;
                    samples.push(TreeSample { face, column, row, filtered, ..NOTHING });
                    number += 1;
                }
            }
            walk(&mut samples[first..], &mut residuals);
        }
        let key = |s: &TreeSample| (s.face, s.row, s.column, s.depth);
        if !samples.iter().all(fits) || !samples.is_sorted_by_key(key) {
            return Err(CodecError::mismatch("tree samples", "depth or coverage out of range or order"));
        }
        let found = samples.iter().filter(|s| !s.filtered).count();
        if samples.len() != count || found != *unfiltered as usize {
            return Err(CodecError::mismatch(
                "tree samples",
                format!("{} of {count}, {found} of {unfiltered} unfiltered", samples.len()),
            ));
        }
        brood.nodes.push(NodeSamples { samples });
    }
    residuals.finish("tree samples")?;
    Ok(brood)
}
