//! Links, ends, slopes and disparities of LDI layers.
//!
//! Links come first: they tell which neighbours continue the sample's surface, and disparity is
//! affine in the image on a planar surface (that is why disparity is stored and not depth), so the
//! linked neighbours predict it:
//!
//! ```text
//!   corner -- up          left and up linked:  left + up - corner      (the plane through the three)
//!     |       |           left only:           left, or 2 left - (left of left) while the run of links goes on
//!   left -- sample        up only:             up, or 2 up - (above up)
//!                         neither:             median-edge of whatever is there: a silhouette
//! ```
//!
//! Each case is a context of its own. A link bit can only be set where the neighbour exists, so
//! only those bits are written, as "broken" bits: almost all are 0. Breaks run along silhouettes,
//! so what the neighbours' links do decides which of several bit streams a bit goes to (6% fewer
//! bytes on buildings than one stream per direction).

use super::{
    CodecError,
    bytes::{BitWriter, Reader, Writer},
    residual::{Coder, median_edge},
    runs::Run,
};
use crate::ldi::{END_BITS, END_PARTS, LINK_DOWN, LINK_RIGHT, SIDES, end_of, is_loose};

/// The left neighbour exists and is linked to this sample.
const LEFT: u8 = 1;
/// The upper neighbour exists and is linked to this sample.
const UP: u8 = 2;
/// Left or up is itself linked to the corner sample, so that the three lie on one surface.
const CORNER: u8 = 4;

/// Streams that [`walk_disparity`] uses.
pub(super) const STREAMS: usize = 6;

/// Either side of the coding of link bits.
pub(super) trait LinkCoder {
    /// Codes whether a link is broken, in the stream of its context.
    fn broken(&mut self, context: usize, actual: bool) -> bool;
    /// How many of the next bits of a stream, at most [`AT_ONCE`], are 0: an encoder is told, a
    /// decoder looks.
    fn whole(&self, context: usize, actual: impl FnOnce() -> usize) -> usize;
    /// Codes so many bits that are 0.
    fn pass(&mut self, context: usize, bits: usize);
}

/// Contexts of links to the left: what the row above does at this place (3), and whether the left
/// neighbour goes on upward.
const LEFT_CONTEXTS: usize = 6;
/// Contexts of links to the row above: whether the sample is linked to the left, and whether the
/// left and the upper neighbour go on upward.
const UP_CONTEXTS: usize = 8;

/// Collects link bits.
#[derive(Default)]
pub(super) struct LinkEncoder([BitWriter; LEFT_CONTEXTS + UP_CONTEXTS]);

impl LinkEncoder {
    /// Writes the sections.
    pub fn finish(self, w: &mut Writer) -> Result<(), CodecError> {
        self.0.iter().try_for_each(|bits| w.section("links", &bits.bytes))
    }
}

impl LinkCoder for LinkEncoder {
    #[inline]
    fn broken(&mut self, context: usize, actual: bool) -> bool {
        self.0[context].push(actual);
        actual
    }
    #[inline]
    fn whole(&self, _: usize, actual: impl FnOnce() -> usize) -> usize {
        actual()
    }
    #[inline]
    fn pass(&mut self, context: usize, bits: usize) {
        let stream = &mut self.0[context];
        stream.bits += bits;
        stream.bytes.resize(stream.bits.div_ceil(8), 0);
    }
}

/// Gives link bits back; reading past the end gives zeros and is found by [`LinkDecoder::finish`].
pub(super) struct LinkDecoder(Vec<(Vec<u8>, usize)>);

impl LinkDecoder {
    /// Reads the sections of a chunk with this many samples.
    pub fn new(r: &mut Reader<'_>, samples: usize) -> Result<Self, CodecError> {
        let max = samples.div_ceil(8);
        Ok(Self(
            (0..LEFT_CONTEXTS + UP_CONTEXTS)
                .map(|_| Ok((r.section("links", max)?, 0)))
                .collect::<Result<_, CodecError>>()?,
        ))
    }
    /// Checks that all bits were used and none was missing.
    pub fn finish(self) -> Result<(), CodecError> {
        match self.0.iter().find(|(bytes, bits)| bytes.len() != bits.div_ceil(8)) {
            None => Ok(()),
            Some((bytes, bits)) => Err(CodecError::mismatch("links", format!("{} bytes for {bits} bits", bytes.len()))),
        }
    }
}

impl LinkCoder for LinkDecoder {
    #[inline]
    fn broken(&mut self, context: usize, _: bool) -> bool {
        let (bytes, bits) = &mut self.0[context];
        let byte = bytes.get(*bits / 8).copied().unwrap_or(0);
        let bit = byte >> (*bits % 8) & 1;
        *bits += 1;
        bit == 1
    }
    #[inline]
    fn whole(&self, context: usize, _: impl FnOnce() -> usize) -> usize {
        let (bytes, next) = &self.0[context];
        // Past the end come zeros, as above.
        let mut word = [0; 8];
        if let Some(rest) = bytes.get(next / 8..) {
            let n = rest.len().min(8);
            word[..n].copy_from_slice(&rest[..n]);
        }
        (u64::from_le_bytes(word) >> (next % 8)).trailing_zeros().min(AT_ONCE as u32) as usize
    }
    #[inline]
    fn pass(&mut self, context: usize, bits: usize) {
        self.0[context].1 += bits;
    }
}

/// A row or column that is before none.
const NOWHERE: u32 = u32::MAX - 1;
/// Most samples that are looked at together: bits that one load of eight bytes holds, wherever it
/// begins. What is looked at again after a break is bounded by it.
const AT_ONCE: usize = 56;

/// Samples of one row in neighbouring columns, all with a sample above them in the next row up, or
/// all without.
struct Piece {
    /// Number of the first sample.
    first: usize,
    count: usize,
    /// Whether the sample before the first lies in the column before it.
    goes_on: bool,
    /// Number of the sample above the first.
    upper: Option<usize>,
}

/// Cuts runs into pieces, in order.
fn pieces(runs: &[Run], mut f: impl FnMut(Piece)) {
    // The runs of the row above that may still have samples above this run, and the number of the
    // first sample of the first of them.
    let (mut above, mut above_first) = (0, 0);
    let mut first = 0;
    for run in runs {
        let end = run.column + run.count;
        let mut column = run.column;
        while column < end {
            while runs[above].row + 1 < run.row
                || runs[above].row + 1 == run.row && runs[above].column + runs[above].count <= column
            {
                above_first += runs[above].count as usize;
                above += 1;
            }
            let (upper, stop) = match &runs[above] {
                r if r.row + 1 != run.row || r.column >= end => (None, end),
                r if r.column > column => (None, r.column),
                r => (Some(above_first + (column - r.column) as usize), end.min(r.column + r.count)),
            };
            let count = (stop - column) as usize;
            f(Piece { first, count, goes_on: column > run.column, upper });
            first += count;
            column = stop;
        }
    }
}

/// How many bytes from the first on have all of these bits.
#[inline]
fn leading_with(bits: u8, bytes: &[u8]) -> usize {
    let wanted = u64::from_le_bytes([bits; 8]);
    let (words, rest) = bytes.as_chunks::<8>();
    for (k, word) in words.iter().enumerate() {
        let missing = !u64::from_le_bytes(*word) & wanted;
        if missing != 0 {
            return 8 * k + missing.trailing_zeros() as usize / 8;
        }
    }
    8 * words.len() + rest.iter().take_while(|byte| *byte & bits == bits).count()
}

/// Codes the links of all samples; a decoder passes zeros. Returns per sample which neighbours its
/// surface continues from.
pub(super) fn walk_links(runs: &[Run], links: &mut [u8], coder: &mut impl LinkCoder) -> Vec<u8> {
    let mut joined = vec![0u8; links.len()];
    pieces(runs, |piece| {
        let mut k = 0;
        while k < piece.count {
            let i = piece.first + k;
            let has_left = k > 0 || piece.goes_on;
            let left_goes_up = has_left && joined[i - 1] & UP != 0;
            if let Some(a) = piece.upper.map(|a| a + k).filter(|_| left_goes_up) {
                // Amid a surface, where the left neighbour goes on upward and the upper ones both
                // ways, contexts stay as they are, and hardly a link is broken.
                const LEFT_CONTEXT: usize = 5;
                const UP_CONTEXT: usize = LEFT_CONTEXTS + 7;
                let n = (piece.count - k).min(AT_ONCE);
                let n = n.min(coder.whole(LEFT_CONTEXT, || leading_with(LINK_RIGHT, &links[i - 1..i - 1 + n])));
                let n = n.min(coder.whole(UP_CONTEXT, || leading_with(LINK_DOWN, &links[a..a + n])));
                let n = leading_with(LEFT | UP, &joined[a..a + n]);
                if n > 0 {
                    coder.pass(LEFT_CONTEXT, n);
                    coder.pass(UP_CONTEXT, n);
                    links[i - 1..i - 1 + n].iter_mut().for_each(|l| *l |= LINK_RIGHT);
                    links[a..a + n].iter_mut().for_each(|l| *l |= LINK_DOWN);
                    joined[i..i + n].fill(LEFT | UP | CORNER);
                    k += n;
                    continue;
                }
            }
            let left_goes_up = usize::from(left_goes_up);
            let upper = piece.upper.map(|a| a + k);
            let mut j = 0;
            if has_left {
                let row_above = upper.map_or(0, |a| 1 + usize::from(joined[a] & LEFT != 0));
                if !coder.broken(2 * row_above + left_goes_up, links[i - 1] & LINK_RIGHT == 0) {
                    links[i - 1] |= LINK_RIGHT;
                    j |= LEFT;
                }
            }
            if let Some(a) = upper {
                let upper_goes_up = usize::from(joined[a] & UP != 0);
                let context = LEFT_CONTEXTS + usize::from(j) + 2 * left_goes_up + 4 * upper_goes_up;
                if !coder.broken(context, links[a] & LINK_DOWN == 0) {
                    links[a] |= LINK_DOWN;
                    j |= UP;
                    if j & LEFT != 0 && (joined[a] & LEFT != 0 || joined[i - 1] & UP != 0) {
                        j |= CORNER;
                    }
                }
            }
            joined[i] = j;
            k += 1;
        }
    });
    joined
}

/// Streams of ends: for each side those with a neighbour to predict from, and those without.
pub(super) const END_STREAMS: usize = 2 * SIDES.len();

/// Codes the ends of all samples; a decoder passes zeros. An end to the left or right is predicted
/// from the same end in the row above, one up or down from the column before: borders run on.
pub(super) fn walk_ends(
    runs: &[Run],
    width: u32,
    joined: &[u8],
    links: &[u8],
    ends: &mut [u16],
    coder: &mut impl Coder,
) {
    const USUAL: u16 = END_PARTS / 2;
    // Per column, row and value of the last end to either side.
    let mut above = vec![[(NOWHERE, USUAL); 2]; width as usize];
    let mut i = 0;
    for run in runs {
        // The same for the sample before, by column.
        let mut before = [(NOWHERE, USUAL); 2];
        let stop = i + run.count as usize;
        let first = i;
        while i < stop {
            // Amid a surface nothing ends.
            let n = leading_with(LEFT | UP, &joined[i..stop.min(i + AT_ONCE)]);
            let n = leading_with(LINK_RIGHT | LINK_DOWN, &links[i..i + n]);
            if n > 0 {
                ends[i..i + n].fill(0);
                i += n;
                continue;
            }
            let column = run.column + (i - first) as u32;
            let above = &mut above[column as usize];
            let linked = [joined[i] & LEFT, links[i] & LINK_RIGHT, joined[i] & UP, links[i] & LINK_DOWN];
            let actual = ends[i];
            ends[i] = 0;
            for side in (0..SIDES.len()).filter(|side| linked[*side] == 0) {
                let (known, place) =
                    if side < 2 { (&mut above[side], run.row) } else { (&mut before[side - 2], column) };
                let neighbour = known.0 + 1 == place;
                let predicted = if neighbour { known.1 } else { USUAL };
                let stream = 2 * side + usize::from(neighbour);
                let (_, end) = coder.byte::<true>(stream, 1, i32::from(predicted), i32::from(end_of(actual, side)));
                // What a forged chunk holds beyond is found by the check.
                *known = (place, end as u16 & ((1 << END_BITS) - 1));
                ends[i] |= known.1 << (side * END_BITS);
            }
            i += 1;
        }
    }
}

/// Streams of slopes: for each axis those with a link along it, those with a linked neighbour to
/// predict from, and those with neither.
pub(super) const SLOPE_STREAMS: usize = 6;

/// Codes the slopes of all samples; a decoder passes zeros. A sample without a link along an axis
/// is predicted from the neighbour that it is linked to along the other: strips are one pixel wide
/// and many long.
pub(super) fn walk_slopes(
    runs: &[Run],
    width: u32,
    joined: &[u8],
    (links, ends): (&[u8], &[u16]),
    slopes: &mut [[i8; 2]],
    coder: &mut impl Coder,
) {
    // Number of the last sample seen in each column.
    let mut last = vec![0u32; width as usize];
    let mut first = 0;
    for run in runs {
        let last = &mut last[run.column as usize..(run.column + run.count) as usize];
        for (i, above) in (first..).zip(&mut *last) {
            if ends[i] == 0 {
                slopes[i] = [0; 2];
                continue;
            }
            let actual = slopes[i];
            slopes[i] = [0; 2];
            let [left, up] = [LEFT, UP].map(|bit| joined[i] & bit != 0);
            let linked = [left || links[i] & LINK_RIGHT != 0, up || links[i] & LINK_DOWN != 0];
            for axis in (0..2).filter(|axis| is_loose(ends[i], *axis)) {
                let neighbour = match axis {
                    _ if linked[axis] => None,
                    0 => up.then_some(*above as usize),
                    _ => left.then(|| i - 1),
                };
                let predicted = neighbour.map_or(0, |n| slopes[n][axis]);
                let stream = 3 * axis + if linked[axis] { 0 } else { 1 + usize::from(neighbour.is_none()) };
                let [predicted, actual] = [predicted, actual[axis]].map(|x| i32::from(x as u8));
                slopes[i][axis] = coder.byte::<true>(stream, 1, predicted, actual).1 as u8 as i8;
            }
        }
        last.iter_mut().zip(first as u32..).for_each(|(last, i)| *last = i);
        first += run.count as usize;
    }
}

/// Codes the disparities of all samples; a decoder passes any values and gets the true ones.
pub(super) fn walk_disparity(runs: &[Run], width: u32, joined: &[u8], disparity: &mut [u16], coder: &mut impl Coder) {
    // Per column, the last code seen and the change that led to it along a linked column (0 where
    // it was not linked).
    let mut above = vec![(0i32, 0i32); width as usize];
    let mut next = 0;
    let (mut row, mut left) = (u32::MAX, 0);
    for run in runs {
        let columns = run.column as usize..(run.column + run.count) as usize;
        let mut corner = above[columns.start].0;
        if run.row != row {
            left = corner;
            row = run.row;
        }
        let mut left_slope = 0;
        let samples = next..next + columns.len();
        next = samples.end;
        for ((above, value), &j) in above[columns].iter_mut().zip(&mut disparity[samples.clone()]).zip(&joined[samples])
        {
            let (up, up_slope) = *above;
            let (predicted, context) = match j & (LEFT | UP) {
                0 => (median_edge(left, up, corner), 5),
                LEFT => (left + left_slope, 3 + usize::from(left_slope != 0)),
                UP => (up + up_slope, 2),
                _ if j & CORNER != 0 => (left + up - corner, usize::from(left - corner != 0)),
                _ => ((left + up + 1) / 2, 2),
            };
            *value = coder.word(context, predicted.clamp(0, 65_535) as u16, *value);
            let here = i32::from(*value);
            left_slope = if j & LEFT != 0 { here - left } else { 0 };
            *above = (here, if j & UP != 0 { here - up } else { 0 });
            (corner, left) = (up, here);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// What [`walk_links`] writes, sample by sample.
    fn plainly(runs: &[Run], width: u32, links: &[u8]) -> (LinkEncoder, Vec<u8>) {
        let mut out = LinkEncoder::default();
        let mut joined = vec![0u8; links.len()];
        let mut last = vec![(NOWHERE, 0); width as usize];
        let mut i = 0;
        for run in runs {
            for k in 0..run.count {
                let above = &mut last[(run.column + k) as usize];
                let upper = (above.0 + 1 == run.row).then_some(above.1);
                let left_goes_up = usize::from(k > 0 && joined[i - 1] & UP != 0);
                if k > 0 {
                    let row_above = upper.map_or(0, |a: usize| 1 + usize::from(joined[a] & LEFT != 0));
                    let linked = links[i - 1] & LINK_RIGHT != 0;
                    out.broken(2 * row_above + left_goes_up, !linked);
                    joined[i] |= u8::from(linked) * LEFT;
                }
                if let Some(a) = upper {
                    let upper_goes_up = usize::from(joined[a] & UP != 0);
                    let left = usize::from(joined[i] & LEFT != 0);
                    let linked = links[a] & LINK_DOWN != 0;
                    out.broken(LEFT_CONTEXTS + left + 2 * left_goes_up + 4 * upper_goes_up, !linked);
                    joined[i] |= u8::from(linked) * UP;
                    if joined[i] == LEFT | UP && (joined[a] & LEFT != 0 || joined[i - 1] & UP != 0) {
                        joined[i] |= CORNER;
                    }
                }
                *above = (run.row, i);
                i += 1;
            }
        }
        (out, joined)
    }

    proptest! {
        /// Many samples at once change neither streams nor joints, wherever links break and runs
        /// end, and come back.
        #[test]
        fn links_are_coded_as_sample_by_sample(
            width in 1u32..300, height in 1u32..12, holes in 2u64..400, breaks in 2u64..400, seed in any::<u64>()
        ) {
            let mut x = seed | 1;
            let mut random = move || {
                x ^= x << 13;
                x ^= x >> 7;
                x ^= x << 17;
                x >> 20
            };
            let there: Vec<bool> = (0..width * height).map(|_| !random().is_multiple_of(holes)).collect();
            let at = |row: u32, column: u32| row < height && column < width && there[(row * width + column) as usize];
            let (mut runs, mut links): (Vec<Run>, _) = (Vec::new(), Vec::new());
            for (row, column) in (0..height).flat_map(|r| (0..width).map(move |c| (r, c))).filter(|p| at(p.0, p.1)) {
                match runs.last_mut() {
                    Some(r) if r.row == row && r.column + r.count == column => r.count += 1,
                    _ => runs.push(Run { row, column, count: 1 }),
                }
                let right = at(row, column + 1) && !random().is_multiple_of(breaks);
                let down = at(row + 1, column) && !random().is_multiple_of(breaks);
                links.push((u8::from(right) * LINK_RIGHT) | (u8::from(down) * LINK_DOWN));
            }
            let (plain, joined) = plainly(&runs, width, &links);
            let mut coded = LinkEncoder::default();
            prop_assert_eq!(&walk_links(&runs, &mut links.clone(), &mut coded), &joined);
            for (coded, plain) in coded.0.iter().zip(&plain.0) {
                prop_assert_eq!((coded.bits, &coded.bytes), (plain.bits, &plain.bytes));
            }
            let mut decoder = LinkDecoder(coded.0.into_iter().map(|bits| (bits.bytes, 0)).collect());
            let mut decoded = vec![0; links.len()];
            prop_assert_eq!(walk_links(&runs, &mut decoded, &mut decoder), joined);
            prop_assert_eq!(decoded, links);
            prop_assert!(decoder.finish().is_ok());
        }
    }
}
