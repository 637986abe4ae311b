//! Prediction residuals, sorted into streams by context.
//!
//! A plane coder predicts each value from decoded neighbours and hands the difference to a
//! [`Coder`], together with a context: a small number that says how well the prediction is
//! expected to do, again from decoded neighbours only. Residuals of one context go to one stream,
//! and every stream is a section of its own. So the sections' tables ([`super::rans`], zstd) do
//! what the conditional coder of JPEG-LS (Weinberger, Seroussi, Sapiro 2000, section III-C) does:
//! nothing but a table lookup is done per symbol here. Where tables would take more than they
//! save, streams lie one after another in one section, as the encoder finds best ([`joined`]).
//!
//! Encoder and decoder run the same walk; only the coder differs. So they cannot disagree about a
//! prediction.
//!
//! With a step q > 1 coding is near-lossless: the residual is divided by q, rounded toward zero,
//! and the value *as decoded* becomes the neighbour of later ones, so that errors do not add up:
//! each stays below q. JPEG-LS (section III-F) rounds to the nearest, with half the error for a
//! step, but more bytes for an error (docs/adr/0015-bytes-per-sample-profiles.md). With step 1
//! residuals wrap at 256, so that they fit a byte.

use super::{
    CodecError,
    bytes::{BitReader, BitWriter, Reader, Writer, put_varint, unzigzag, zigzag},
    rans::{Counts, counts_of, estimate},
};

/// Either side of the coding of residuals.
pub(super) trait Coder {
    /// Codes one 8-bit value: returns the quantized residual and the value as decoded. A decoder
    /// ignores `actual`.
    fn byte<const LOSSLESS: bool>(&mut self, stream: usize, step: i32, predicted: i32, actual: i32) -> (i32, i32);
    /// Codes one 16-bit value exactly. A decoder ignores `actual`.
    fn word(&mut self, stream: usize, predicted: u16, actual: u16) -> u16;
}

/// The value that a quantized residual stands for.
#[inline]
fn restored<const LOSSLESS: bool>(step: i32, predicted: i32, q: i32) -> i32 {
    if LOSSLESS || step == 1 { (predicted + q) & 255 } else { (predicted + q * step).clamp(0, 255) }
}

/// Residuals of 16-bit values from here on, zigzagged, are written out in full: escape byte, then
/// two bytes elsewhere.
const ESCAPE: u64 = 255;
/// The escape byte as a residual.
const ESCAPED: i8 = -128;
/// Most streams of a [`Decoder`]: a power of two, so that none is looked for beyond the array.
const MOST_STREAMS: usize = 64;

/// Collects streams.
pub(super) struct Encoder {
    streams: Vec<Vec<u8>>,
    escaped: Vec<u8>,
}

impl Encoder {
    /// For values of so many contexts.
    pub fn new(contexts: usize) -> Self {
        Self { streams: vec![Vec::new(); contexts], escaped: Vec::new() }
    }
    /// Writes which section each stream is in, then lengths and sections.
    pub fn finish(self, w: &mut Writer, field: &'static str) -> Result<(), CodecError> {
        let packed = self.streams.iter().map(|raw| w.packed(field, raw)).collect::<Result<Vec<_>, _>>()?;
        let groups = self.streams.iter().zip(&packed).enumerate().map(|(stream, (raw, packed))| Group {
            streams: vec![stream],
            counts: counts_of(raw),
            bytes: packed.stored(raw).len() as f64 + LENGTHS,
        });
        let groups = joined(groups.collect());
        let mut map = BitWriter::default();
        let mut known = 0;
        for stream in 0..self.streams.len() {
            let group = groups.iter().position(|g| g.streams.contains(&stream)).map_or(0, |g| g as u32);
            map.put(group, bits_of(known));
            known = known.max(group + 1);
        }
        w.raw(&map.bytes);
        for group in &groups {
            if let [alone] = group.streams[..] {
                w.append(&self.streams[alone], &packed[alone]);
                continue;
            }
            let streams: Vec<&[u8]> = group.streams.iter().map(|s| &self.streams[*s][..]).collect();
            let (_, but_last) = streams.split_last().unwrap_or((&&[][..], &[]));
            but_last.iter().for_each(|s| w.varint(s.len() as u64));
            w.section(field, &streams.concat())?;
        }
        w.section(field, &self.escaped)
    }
}

/// Bytes of a section's lengths, about.
const LENGTHS: f64 = 3.0;

/// Bits in which a section is told among so many known ones and a new one.
fn bits_of(known: u32) -> u32 {
    u32::BITS - known.leading_zeros()
}

/// Streams that share a section.
struct Group {
    /// Ascending.
    streams: Vec<usize>,
    counts: Counts,
    /// What the section takes; where several share it about, and at most, as no count tells what
    /// repeats.
    bytes: f64,
}

impl Group {
    fn with(&self, other: &Self) -> Counts {
        std::array::from_fn(|value| self.counts[value] + other.counts[value])
    }
    /// What one section for both saves, bytes.
    fn saved_with(&self, other: &Self) -> f64 {
        self.bytes + other.bytes - LENGTHS - estimate(&self.with(other))
    }
}

/// Joins those two that save the most bytes by it, again and again. They stay ordered by their
/// first streams, so that a new section is always the next.
fn joined(mut groups: Vec<Group>) -> Vec<Group> {
    let row = |groups: &[Group], i: usize| (0..i).map(|j| groups[i].saved_with(&groups[j])).collect::<Vec<f64>>();
    // What groups i and j save, j before i.
    let mut saved: Vec<Vec<f64>> = (0..groups.len()).map(|i| row(&groups, i)).collect();
    loop {
        let pairs = saved.iter().enumerate().flat_map(|(i, row)| row.iter().enumerate().map(move |(j, s)| (i, j, *s)));
        let Some((i, j, _)) = pairs.filter(|p| p.2 > 0.0).max_by(|a, b| a.2.total_cmp(&b.2)) else { return groups };
        let other = groups.remove(i);
        let group = &mut groups[j];
        group.counts = group.with(&other);
        group.bytes = estimate(&group.counts) + LENGTHS;
        group.streams.extend(other.streams);
        group.streams.sort_unstable();
        saved.remove(i);
        for row in &mut saved[i..] {
            row.remove(i);
        }
        saved[j] = row(&groups, j);
        for k in j + 1..groups.len() {
            saved[k][j] = groups[k].saved_with(&groups[j]);
        }
    }
}

impl Coder for Encoder {
    #[inline]
    fn byte<const LOSSLESS: bool>(&mut self, stream: usize, step: i32, predicted: i32, actual: i32) -> (i32, i32) {
        let r = actual - predicted;
        // Toward the prediction: a rounded residual overshoots half the time, and what overshoots
        // is noise to all predictions after it.
        let q = if LOSSLESS || step == 1 { i32::from(r as i8) } else { r / step };
        self.streams[stream].push(zigzag(q.into()) as u8);
        (q, restored::<LOSSLESS>(step, predicted, q))
    }
    #[inline]
    fn word(&mut self, stream: usize, predicted: u16, actual: u16) -> u16 {
        let z = zigzag(i64::from(actual.wrapping_sub(predicted) as i16));
        self.streams[stream].push(z.min(ESCAPE) as u8);
        if z >= ESCAPE {
            put_varint(&mut self.escaped, z - ESCAPE);
        }
        actual
    }
}

/// Gives streams back. Reading past the end of a stream gives zeros and is found by
/// [`Decoder::finish`], so that the inner loops need no error path.
pub(super) struct Decoder {
    residuals: Vec<i8>,
    /// Per stream, the next of its residuals.
    next: [usize; MOST_STREAMS],
    /// Per stream, where its residuals end.
    ends: Vec<usize>,
    escaped: Vec<u8>,
    next_escaped: usize,
}

impl Decoder {
    /// Reads `streams` streams that hold `values` residuals altogether.
    pub fn new(r: &mut Reader<'_>, field: &'static str, streams: usize, values: usize) -> Result<Self, CodecError> {
        let decoder = Self::of_at_most(r, field, streams, values)?;
        let residuals = decoder.residuals.len();
        if residuals == values {
            Ok(decoder)
        } else {
            Err(CodecError::mismatch(field, format!("{residuals} residuals for {values} values")))
        }
    }
    /// The same for a number of values that is known later, but not larger than `most`.
    pub fn of_at_most(
        r: &mut Reader<'_>,
        field: &'static str,
        streams: usize,
        most: usize,
    ) -> Result<Self, CodecError> {
        assert!(streams <= MOST_STREAMS, "{streams} streams");
        let groups = r.bits(field, |map| read_groups(map, streams))?;
        let groups = groups.ok_or_else(|| CodecError::range(field, streams, "sections are not told in order"))?;
        let (mut bytes, mut next, mut ends) = (Vec::new(), [0; MOST_STREAMS], vec![0; streams]);
        for group in groups {
            let mut end = bytes.len();
            for (k, stream) in group.iter().enumerate() {
                next[*stream] = end;
                if k + 1 < group.len() {
                    end += r.count(field, most - end)?;
                    ends[*stream] = end;
                    continue;
                }
                let section = r.section(field, most - bytes.len())?;
                if bytes.is_empty() {
                    bytes = section
                } else {
                    bytes.extend_from_slice(&section)
                }
                if bytes.len() < end {
                    return Err(CodecError::mismatch(field, "streams are longer than their section"));
                }
                ends[*stream] = bytes.len();
            }
        }
        // An escaped residual takes at most three bytes.
        let escaped = r.section(field, bytes.len() * 3)?;
        let residuals = bytes.into_iter().map(|z| unzigzag(z.into()) as i8).collect();
        Ok(Self { residuals, next, ends, escaped, next_escaped: 0 })
    }
    /// Checks that every stream was read to its end and not beyond.
    pub fn finish(self, field: &'static str) -> Result<(), CodecError> {
        let unlike = self.ends.iter().zip(&self.next).position(|(end, next)| next != end);
        match unlike.or((self.next_escaped != self.escaped.len()).then_some(self.ends.len())) {
            None => Ok(()),
            Some(i) => {
                Err(CodecError::mismatch(field, format!("stream {i} has another length than the values ask for")))
            }
        }
    }
    #[inline]
    fn next(&mut self, stream: usize) -> i8 {
        let next = &mut self.next[stream % MOST_STREAMS];
        let residual = self.residuals.get(*next).copied().unwrap_or(0);
        *next += 1;
        residual
    }
    /// An escaped residual's excess; at most three bytes are looked at.
    #[cold]
    fn next_escaped(&mut self) -> u64 {
        let mut v = 0;
        for shift in [0, 7, 14] {
            let byte = self.escaped.get(self.next_escaped).copied().unwrap_or(0);
            self.next_escaped += 1;
            v |= u64::from(byte & 127) << shift;
            if byte < 128 {
                break;
            }
        }
        v
    }
}

/// Streams by sections; none where a section is not the next new one.
fn read_groups(map: &mut BitReader<'_>, streams: usize) -> Option<Vec<Vec<usize>>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for stream in 0..streams {
        let group = map.take(bits_of(groups.len() as u32)) as usize;
        if group == groups.len() {
            groups.push(Vec::new());
        }
        groups.get_mut(group)?.push(stream);
    }
    Some(groups)
}

impl Coder for Decoder {
    #[inline]
    fn byte<const LOSSLESS: bool>(&mut self, stream: usize, step: i32, predicted: i32, _: i32) -> (i32, i32) {
        let q = self.next(stream).into();
        (q, restored::<LOSSLESS>(step, predicted, q))
    }
    #[inline]
    fn word(&mut self, stream: usize, predicted: u16, _: u16) -> u16 {
        match self.next(stream) {
            ESCAPED => predicted.wrapping_add(unzigzag(ESCAPE + self.next_escaped()) as u16),
            residual => predicted.wrapping_add_signed(residual.into()),
        }
    }
}

/// Median-edge prediction (LOCO-I): the smaller neighbour at an edge that brightens away from the
/// corner, the larger at one that darkens, else the plane through the three.
#[inline]
pub(super) fn median_edge(left: i32, up: i32, corner: i32) -> i32 {
    let (low, high) = (left.min(up), left.max(up));
    (left + up - corner).clamp(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const CONTEXTS: usize = 26;

    /// Codes values of contexts, predicted as 100; the bytes, and in how many sections.
    fn coded(values: &[(usize, u8)]) -> (Vec<u8>, usize) {
        let mut encoder = Encoder::new(CONTEXTS);
        for (context, value) in values {
            encoder.byte::<true>(*context, 1, 100, (*value).into());
        }
        let mut w = Writer::new(3).unwrap();
        encoder.finish(&mut w, "s").unwrap();
        let sections = Reader::new(&w.bytes).bits("s", |map| read_groups(map, CONTEXTS)).unwrap().unwrap().len();
        (w.bytes, sections)
    }

    /// Values whose spread grows with the context.
    fn spread(n: usize, seed: u64) -> Vec<(usize, u8)> {
        let mut x = seed | 1;
        let mut random = move |most: u64| {
            x ^= x << 13;
            x ^= x >> 7;
            x ^= x << 17;
            (x >> 20) % most
        };
        (0..n)
            .map(|_| {
                let context = random(CONTEXTS as u64);
                let value = 100 + random(1 + 4 * context) as i64 - 2 * context as i64;
                (context as usize, value.clamp(0, 255) as u8)
            })
            .collect()
    }

    #[test]
    fn few_values_share_sections_and_many_have_their_own() {
        let (few, sections_of_few) = coded(&spread(700, 5));
        let (_, sections_of_many) = coded(&spread(200_000, 5));
        assert!(sections_of_few < 8 && sections_of_many > 15, "{sections_of_few} {sections_of_many}");
        // A stream each, as they would have without sharing.
        let mut w = Writer::new(3).unwrap();
        for context in 0..CONTEXTS {
            let one: Vec<u8> = spread(700, 5).iter().filter(|v| v.0 == context).map(|v| v.1).collect();
            w.section("s", &one).unwrap();
        }
        assert!(few.len() + 30 < w.bytes.len(), "{} {}", few.len(), w.bytes.len());
    }

    #[test]
    fn forged_sections_are_refused() {
        let decoder = |bytes: &[u8], most| Decoder::of_at_most(&mut Reader::new(bytes), "s", 3, most);
        // The second stream is in the first section (a bit of 0), the third in the second one (1)
        // or, which is not the next, in none.
        let good = [0b10u8, 1, 2, 2, 7, 7, 1, 1, 7, 0, 0];
        assert_eq!(decoder(&good, 3).unwrap().ends, [1, 2, 3]);
        assert!(decoder(&[0b111], 3).is_err(), "a section that is not the next");
        assert!(decoder(&[0b10, 3, 2, 2, 7, 7, 1, 1, 7, 0, 0], 3).is_err(), "a stream longer than its section");
        assert!(decoder(&good, 2).is_err(), "more than there may be");
    }

    proptest! {
        #[test]
        fn what_shares_sections_comes_back(
            values in prop::collection::vec((0..CONTEXTS, any::<u8>()), 0..400), n in 0usize..3000, seed in any::<u64>()
        ) {
            let values = [values, spread(n, seed)].concat();
            let (bytes, _) = coded(&values);
            let mut r = Reader::new(&bytes);
            let mut decoder = Decoder::new(&mut r, "s", CONTEXTS, values.len()).unwrap();
            prop_assert_eq!(r.remaining(), 0);
            for (context, value) in &values {
                prop_assert_eq!(decoder.byte::<true>(*context, 1, 100, 0).1, i32::from(*value));
            }
            prop_assert!(decoder.finish("s").is_ok());
        }
    }
}
