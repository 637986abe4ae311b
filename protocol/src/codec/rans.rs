//! Sections of noise: range asymmetric numeral systems (Duda 2013), order 0, one table a section.
//!
//! Most bytes of a dataset are residuals sorted by context. What is left in one context repeats
//! nothing, and few of its values are likely: there a code of whole bits per value, as zstd's is,
//! costs up to a bit more than their entropy. This one costs next to nothing more.
//!
//! ```text
//! method | table | four states or one, u32 | words, u16
//! ```
//!
//! Four states take turns, value by value, so that a processor works on four at once; they share
//! the words, and end where the encoder began: a check of the whole section. [`FEW`] values and
//! less have one state, which takes twelve bytes less.
//!
//! Table: bits, low first. The largest value that occurs (8), how finely weights are told (2),
//! then the weight of each value up to it. Of a weight first its length in bits, as the difference
//! to the length of the weight before (0 at first): 0 is a bit of 0; others are a bit of 1, a bit
//! that says negative, and the size less one as so many bits of 1 and one of 0. Then the bits
//! after the leading one, as many as are told; halfway between what is told and the next is what
//! the others stand for. Residuals' frequencies fall evenly: a value takes three or four bits.
//! What a table leaves out costs less than it takes, and the encoder tries which is the best.
//! Frequencies are the weights scaled to 4,096ths ([`scaled`]).

use super::{
    CodecError,
    bytes::{BitReader, BitWriter, Reader},
};

/// First byte of such a section with four states; zstd's frames begin with another.
pub(super) const METHOD: u8 = 1;
/// The same with one state.
pub(super) const METHOD_OF_FEW: u8 = 2;
/// Most values that have one state: their wait for each other is no matter.
const FEW: usize = 1024;
/// How many bits of a weight after the leading one a table may tell.
const TOLD: [u32; 4] = [1, 2, 3, 6];
/// Bits of the largest weight, 4,096.
const LONGEST: u32 = BITS + 1;

/// Frequencies are in parts of `1 << BITS`: finer is closer to the entropy, and a table that
/// leaves the first-level cache.
const BITS: u32 = 12;
const PARTS: u32 = 1 << BITS;
/// States are at least this, and a word (16 bits) joins one that falls below.
const LOWEST: u32 = 1 << 16;
const STATES: usize = 4;

/// Codes bytes; at least one.
pub(super) fn encode(raw: &[u8]) -> Vec<u8> {
    let (parts, table) = best_table(&counts_of(raw));
    let states = if raw.len() <= FEW { 1 } else { STATES };
    let mut below = [0u32; 256];
    for value in 1..256 {
        below[value] = below[value - 1] + parts[value - 1];
    }
    let mut states = vec![LOWEST; states];
    let mut words: Vec<u16> = Vec::with_capacity(raw.len() / 3);
    // Backwards: the last value that goes in is the first that comes out.
    for (i, &value) in raw.iter().enumerate().rev() {
        let at = i % states.len();
        let (part, state) = (parts[usize::from(value)], &mut states[at]);
        if u64::from(*state) >= u64::from(part) << (32 - BITS) {
            words.push(*state as u16);
            *state >>= 16;
        }
        *state = ((*state / part) << BITS) + *state % part + below[usize::from(value)];
    }
    let mut out = vec![if states.len() == 1 { METHOD_OF_FEW } else { METHOD }];
    out.extend_from_slice(&table);
    states.iter().for_each(|s| out.extend_from_slice(&s.to_le_bytes()));
    words.iter().rev().for_each(|w| out.extend_from_slice(&w.to_le_bytes()));
    out
}

/// Decodes `raw_len` bytes from what follows the method, with one state if they are `few`.
pub(super) fn decode(coded: &[u8], few: bool, raw_len: usize, field: &'static str) -> Result<Vec<u8>, CodecError> {
    let mut r = Reader::new(coded);
    let mut steps = [Step::default(); PARTS as usize];
    read_table(&mut r, field, &mut steps)?;
    let mut states = [LOWEST; STATES];
    for s in states.iter_mut().take(if few { 1 } else { STATES }) {
        *s = r.u32(field)?;
    }
    let words = r.take(r.remaining(), field)?.as_chunks::<2>();
    if !words.1.is_empty() {
        return Err(CodecError::mismatch(field, "half a word at the end"));
    }
    let (words, mut next) = (words.0, 0);
    let mut value_of = |state: &mut u32| {
        let step = steps[(*state & (PARTS - 1)) as usize];
        // At most 2^12 times 2^20, less one: no overflow.
        *state = step.part() * (*state >> BITS) + step.offset();
        // Past the end come zeros, and the check below fails.
        let word = words.get(next).map_or(0, |w| u32::from(u16::from_le_bytes(*w)));
        let low = *state < LOWEST;
        *state = if low { *state << 16 | word } else { *state };
        next += usize::from(low);
        step.value()
    };
    let mut out = vec![0; raw_len];
    let (fours, rest) = if few { (&mut [][..], &mut out[..]) } else { out.as_chunks_mut::<STATES>() };
    // States in registers: through memory each value would wait for the one four before it to be
    // stored.
    let [mut a, mut b, mut c, mut d] = states;
    for four in fours {
        *four = [value_of(&mut a), value_of(&mut b), value_of(&mut c), value_of(&mut d)];
    }
    let mut states = [a, b, c, d];
    if few {
        rest.iter_mut().for_each(|value| *value = value_of(&mut states[0]));
    } else {
        rest.iter_mut().zip(&mut states).for_each(|(value, state)| *value = value_of(state));
    }
    if next == words.len() && states == [LOWEST; STATES] {
        Ok(out)
    } else {
        Err(CodecError::mismatch(field, "its states do not end where they must"))
    }
}

/// What a slot stands for: a value, its share of all slots less one, and which of them this one
/// is: 8, 12 and 12 bits, so that the table is one load and half of a first-level cache.
#[derive(Clone, Copy, Default)]
struct Step(u32);

impl Step {
    fn new(value: usize, part: usize, offset: usize) -> Self {
        Self(((part as u32 - 1) << BITS | offset as u32) << 8 | value as u32)
    }
    fn value(self) -> u8 {
        self.0 as u8
    }
    fn part(self) -> u32 {
        (self.0 >> (8 + BITS)) + 1
    }
    fn offset(self) -> u32 {
        self.0 >> 8 & (PARTS - 1)
    }
}

/// How often each value occurs.
pub(super) type Counts = [u32; 256];

/// Of some bytes.
pub(super) fn counts_of(raw: &[u8]) -> Counts {
    let mut counts = [0; 256];
    raw.iter().for_each(|&value| counts[usize::from(value)] += 1);
    counts
}

/// About how many bytes such a section takes, or at most as they are.
pub(super) fn estimate(counts: &Counts) -> f64 {
    let all: u32 = counts.iter().sum();
    let weights = weights_of(counts);
    let states = if all as usize <= FEW { 1 } else { STATES };
    // The method, and of each state what it does not hold.
    let fixed = 1.0 + 2.0 * states as f64;
    let coded = fixed + table_of(&weights, 1).len() as f64 + bytes_of(counts, &weights);
    coded.min(f64::from(all))
}

/// The frequencies and the table with which so many values take the fewest bytes together.
fn best_table(counts: &Counts) -> ([u32; 256], Vec<u8>) {
    let weights = weights_of(counts);
    let of = |told: usize| {
        let parts = scaled(&weights.map(|w| rounded(w, TOLD[told])));
        (parts, table_of(&weights, told))
    };
    let bytes = |(parts, table): &([u32; 256], Vec<u8>)| table.len() as f64 + bytes_of(counts, parts);
    let first = of(0);
    (1..TOLD.len()).map(of).fold(first, |best, other| if bytes(&other) < bytes(&best) { other } else { best })
}

/// What values take with these frequencies.
fn bytes_of(counts: &Counts, parts: &[u32; 256]) -> f64 {
    let bits = |(n, part): (&u32, &u32)| f64::from(*n) * (f64::from(PARTS) / f64::from(*part)).log2();
    counts.iter().zip(parts).filter(|(n, _)| **n > 0).map(bits).sum::<f64>() / 8.0
}

/// How often values occur, in 4,096ths, at least one for what occurs.
fn weights_of(counts: &Counts) -> [u32; 256] {
    let all = counts.iter().map(|n| u64::from(*n)).sum::<u64>().max(1);
    let part = |n: u32| ((u64::from(n) * u64::from(PARTS) + all / 2) / all).max(1) as u32;
    counts.map(|n| if n == 0 { 0 } else { part(n) })
}

/// Bits of a weight, 0 of none.
fn length(weight: u32) -> u32 {
    u32::BITS - weight.leading_zeros()
}

/// A weight of which `told` bits after the leading one are told.
fn rounded(weight: u32, told: u32) -> u32 {
    match length(weight).saturating_sub(1).saturating_sub(told) {
        0 => weight,
        untold => (weight >> untold << untold) + (1 << (untold - 1)),
    }
}

/// Frequencies in 4,096ths, at least one for what has a weight: rounded to the nearest, and while
/// the sum is not 4,096 the largest, of several the first, is changed by what is missing or too
/// much, but by a sixteenth of it at most.
fn scaled(weights: &[u32; 256]) -> [u32; 256] {
    let all = weights.iter().sum::<u32>().max(1);
    let mut parts = weights.map(|w| if w == 0 { 0 } else { ((w * PARTS + all / 2) / all).max(1) });
    let mut missing = PARTS as i32 - parts.iter().sum::<u32>() as i32;
    while missing != 0 {
        let largest = (1..parts.len()).fold(0, |best, v| if parts[v] > parts[best] { v } else { best });
        let most = (parts[largest] / 16).max(1) as i32;
        let change = missing.clamp(-most, most);
        parts[largest] = parts[largest].saturating_add_signed(change);
        missing -= change;
    }
    parts
}

/// The table of weights, [`TOLD`] of `told` bits of each.
fn table_of(weights: &[u32; 256], told: usize) -> Vec<u8> {
    let mut bits = BitWriter::default();
    let last = weights.iter().rposition(|w| *w > 0).unwrap_or(0);
    bits.put(last as u32, 8);
    bits.put(told as u32, 2);
    let mut before = 0;
    for weight in &weights[..=last] {
        let length = length(*weight);
        let change = length as i32 - before as i32;
        bits.put(u32::from(change != 0), 1);
        if change != 0 {
            bits.put(u32::from(change < 0), 1);
            (1..change.unsigned_abs()).for_each(|_| bits.put(1, 1));
            bits.put(0, 1);
        }
        let untold = length.saturating_sub(1).saturating_sub(TOLD[told]);
        let after_first = length.saturating_sub(1);
        bits.put((weight & !(u32::MAX << after_first)) >> untold, after_first - untold);
        before = length;
    }
    bits.bytes
}

/// The weights that [`table_of`] told.
fn read_weights(bits: &mut BitReader<'_>) -> Result<[u32; 256], CodecError> {
    let last = bits.take(8) as usize;
    let told = TOLD[bits.take(2) as usize];
    let (mut weights, mut length) = ([0u32; 256], 0u32);
    for weight in &mut weights[..=last] {
        if bits.take(1) == 1 {
            let negative = bits.take(1) == 1;
            let change = bits.ones() + 1;
            let changed = if negative { length.checked_sub(change) } else { Some(length + change) };
            let bad = || CodecError::range("table", change, "no weight has so many bits");
            length = changed.filter(|bits| *bits <= LONGEST).ok_or_else(bad)?;
        }
        if let Some(after_first) = length.checked_sub(1) {
            let untold = after_first.saturating_sub(told);
            let half = if untold > 0 { 1 << (untold - 1) } else { 0 };
            *weight = 1 << after_first | bits.take(after_first - untold) << untold | half;
        }
    }
    Ok(weights)
}

/// One step per slot.
fn read_table(r: &mut Reader<'_>, field: &'static str, steps: &mut [Step]) -> Result<(), CodecError> {
    let weights = r.bits(field, read_weights)??;
    let mut next = 0;
    for (value, part) in scaled(&weights).into_iter().enumerate() {
        let part = part as usize;
        for (offset, step) in steps[next..next + part].iter_mut().enumerate() {
            *step = Step::new(value, part, offset);
        }
        next += part;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Bytes of a geometric distribution, as residuals have, from a seed.
    fn residuals(n: usize, zeros: f64, seed: u64) -> Vec<u8> {
        let mut x = seed | 1;
        let mut random = move || {
            x ^= x << 13;
            x ^= x >> 7;
            x ^= x << 17;
            (x >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..n).map(|_| ((1.0 - random()).ln() / (1.0 - zeros).ln()).min(255.0) as u8).collect()
    }

    fn entropy_bytes(raw: &[u8]) -> f64 {
        let mut counts = [0.0f64; 256];
        raw.iter().for_each(|v| counts[usize::from(*v)] += 1.0);
        counts.iter().filter(|n| **n > 0.0).map(|n| n * (raw.len() as f64 / n).log2() / 8.0).sum()
    }

    fn decoded(coded: &[u8], raw_len: usize) -> Result<Vec<u8>, CodecError> {
        assert!([METHOD, METHOD_OF_FEW].contains(&coded[0]));
        decode(&coded[1..], coded[0] == METHOD_OF_FEW, raw_len, "s")
    }

    #[test]
    fn costs_little_more_than_the_entropy() {
        for zeros in [0.02, 0.2, 0.5, 0.8, 0.95, 0.995] {
            let raw = residuals(200_000, zeros, 7);
            let coded = encode(&raw);
            assert_eq!(decoded(&coded, raw.len()).unwrap(), raw);
            let least = entropy_bytes(&raw);
            // Of the entropy what 4,096ths miss, and the table.
            assert!((coded.len() as f64) < 1.005 * least + 200.0, "{} for {least} at {zeros}", coded.len());
        }
    }

    proptest! {
        #[test]
        fn every_section_comes_back(raw in prop::collection::vec(any::<u8>(), 1..3000), spread in 1u8..=255) {
            let raw: Vec<u8> = raw.iter().map(|v| v % spread).collect();
            prop_assert_eq!(decoded(&encode(&raw), raw.len()).unwrap(), raw);
        }

        #[test]
        fn rare_values_beside_one_that_is_not(rare in prop::collection::vec(any::<u8>(), 0..300), often in 0usize..60_000) {
            let mut raw = rare;
            raw.resize(raw.len() + often + 1, 9);
            let counts = counts_of(&raw);
            let (parts, table) = best_table(&counts);
            prop_assert_eq!(parts.iter().sum::<u32>(), PARTS);
            prop_assert!(raw.iter().all(|v| parts[usize::from(*v)] > 0));
            let mut steps = [Step::default(); PARTS as usize];
            let mut reader = Reader::new(&table);
            read_table(&mut reader, "s", &mut steps).unwrap();
            prop_assert_eq!(reader.remaining(), 0);
            let read: Vec<usize> = (0..256).map(|v| steps.iter().filter(|s| usize::from(s.value()) == v).count()).collect();
            prop_assert_eq!(read, parts.map(|p| p as usize).to_vec());
            prop_assert_eq!(decoded(&encode(&raw), raw.len()).unwrap(), raw);
        }

        #[test]
        fn forged_bytes_are_refused_or_give_as_many(
            bytes in prop::collection::vec(any::<u8>(), 0..600), few in any::<bool>(), n in 0usize..2000
        ) {
            if let Ok(out) = decode(&bytes, few, n, "s") {
                prop_assert_eq!(out.len(), n);
            }
        }
    }

    /// It is no check of its own, chunks have hashes: what two states differ by shrinks with each
    /// value, as the likelier values keep less of it, so that a flipped bit may change some values
    /// and not be noticed (6 of 11,856 here: one value, two, in one case seven).
    #[test]
    fn hardly_a_flipped_bit_behind_the_table_goes_unnoticed() {
        let raw = residuals(4000, 0.3, 3);
        let coded = encode(&raw);
        let (_, table) = best_table(&counts_of(&raw));
        let bits = 8 * (1 + table.len())..8 * coded.len();
        let mut unnoticed = 0;
        for bit in bits.clone() {
            let mut flipped = coded.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            if let Ok(other) = decoded(&flipped, raw.len()) {
                unnoticed += 1;
                assert!(other != raw, "bit {bit}");
            }
        }
        assert!(unnoticed * 1000 < bits.len(), "{unnoticed} of {}", bits.len());
    }

    #[test]
    fn what_is_cut_off_or_too_long_is_refused() {
        let raw = residuals(1000, 0.4, 1);
        let coded = encode(&raw);
        for n in [1, 5, 20, coded.len() / 2, coded.len() - 1] {
            assert!(decoded(&coded[..n], raw.len()).is_err(), "cut to {n}");
        }
        for other in [raw.len() - 1, raw.len() + 1] {
            assert!(decoded(&coded, other).is_err(), "{other} values");
        }
        let longer = [&coded[..], &[0, 0]].concat();
        assert!(decoded(&longer, raw.len()).is_err());
    }
}
