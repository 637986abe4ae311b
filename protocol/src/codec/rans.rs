//! Sections of noise: range asymmetric numeral systems (Duda 2013), order 0, one table a section.
//!
//! Most bytes of a dataset are residuals sorted by context. What is left in one context repeats nothing, and few of its values are likely: there a code of whole
//! bits per value, as zstd's is, costs up to a bit more than their entropy. This one costs next to nothing more.
//!
//! ```text
//! METHOD | table | four states, u32 | words, u16
//! ```
//!
//! Table: how often each byte value occurs, in 4,096ths, ascending by value, LEB128; after a 0, how many more values after it do not occur either. It ends where the sum is
//! 4,096. Four states take turns, value by value, so that a processor works on four at once; they share the words, and end where the encoder began: a check of
//! the whole section.

use super::{
    CodecError,
    bytes::{Reader, put_varint},
};

/// First byte of such a section; zstd's frames begin with another.
pub(super) const METHOD: u8 = 1;

/// Frequencies are in parts of `1 << BITS`: finer is closer to the entropy, and a table that leaves the first-level cache.
const BITS: u32 = 12;
const PARTS: u32 = 1 << BITS;
/// States are at least this, and a word (16 bits) joins one that falls below.
const LOWEST: u32 = 1 << 16;
const STATES: usize = 4;

/// Codes bytes; at least one.
pub(super) fn encode(raw: &[u8]) -> Vec<u8> {
    let parts = parts_of(raw);
    let mut below = [0u32; 256];
    for value in 1..256 {
        below[value] = below[value - 1] + parts[value - 1];
    }
    let mut states = [LOWEST; STATES];
    let mut words: Vec<u16> = Vec::with_capacity(raw.len() / 3);
    // Backwards: the last value that goes in is the first that comes out.
    for (i, &value) in raw.iter().enumerate().rev() {
        let (part, state) = (parts[usize::from(value)], &mut states[i % STATES]);
        if u64::from(*state) >= u64::from(part) << (32 - BITS) {
            words.push(*state as u16);
            *state >>= 16;
        }
        *state = ((*state / part) << BITS) + *state % part + below[usize::from(value)];
    }
    let mut out = vec![METHOD];
    put_table(&mut out, &parts);
    states.iter().for_each(|s| out.extend_from_slice(&s.to_le_bytes()));
    words.iter().rev().for_each(|w| out.extend_from_slice(&w.to_le_bytes()));
    out
}

/// Decodes `raw_len` bytes from what follows the method.
pub(super) fn decode(coded: &[u8], raw_len: usize, field: &'static str) -> Result<Vec<u8>, CodecError> {
    let mut r = Reader::new(coded);
    let mut steps = [Step::default(); PARTS as usize];
    read_table(&mut r, field, &mut steps)?;
    let mut states = [0; STATES];
    for s in &mut states {
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
    let (fours, rest) = out.as_chunks_mut::<STATES>();
    // States in registers: through memory each value would wait for the one four before it to be stored.
    let [mut a, mut b, mut c, mut d] = states;
    for four in fours {
        *four = [value_of(&mut a), value_of(&mut b), value_of(&mut c), value_of(&mut d)];
    }
    let mut states = [a, b, c, d];
    rest.iter_mut().zip(&mut states).for_each(|(value, state)| *value = value_of(state));
    if next == words.len() && states == [LOWEST; STATES] {
        Ok(out)
    } else {
        Err(CodecError::mismatch(field, "its states do not end where they must"))
    }
}

/// What a slot stands for: a value, its share of all slots less one, and which of them this one is: 8, 12 and 12 bits, so that the table is one load and half of a
/// first-level cache.
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

/// Frequencies in 4,096ths, at least one for what occurs, their sum exact.
fn parts_of(raw: &[u8]) -> [u32; 256] {
    let mut counts = [0u64; 256];
    raw.iter().for_each(|&value| counts[usize::from(value)] += 1);
    let all = raw.len().max(1) as u64;
    let mut parts = counts.map(|n| if n == 0 { 0 } else { ((n * u64::from(PARTS) + all / 2) / all).max(1) as u32 });
    // Rounding and the parts of rare values are made up for where that costs the fewest bits.
    let bits = |n: u64, from: u32, to: u32| n as f64 * (f64::from(from) / f64::from(to)).log2();
    let mut sum: u32 = parts.iter().sum();
    while sum != PARTS {
        let step = if sum > PARTS { -1 } else { 1 };
        let cost = |v: &usize| bits(counts[*v], parts[*v], parts[*v].wrapping_add_signed(step));
        // What occurs keeps a part.
        let may = |v: &usize| parts[*v] > u32::from(step < 0);
        let Some(v) = (0..256).filter(may).min_by(|a, b| cost(a).total_cmp(&cost(b))) else { break };
        parts[v] = parts[v].wrapping_add_signed(step);
        sum = sum.wrapping_add_signed(step);
    }
    parts
}

fn put_table(out: &mut Vec<u8>, parts: &[u32; 256]) {
    let (mut value, mut sum) = (0, 0);
    while sum < PARTS && value < parts.len() {
        put_varint(out, parts[value].into());
        sum += parts[value];
        if parts[value] == 0 {
            let more = parts[value + 1..].iter().take_while(|p| **p == 0).count();
            put_varint(out, more as u64);
            value += more;
        }
        value += 1;
    }
}

/// One step per slot.
fn read_table(r: &mut Reader<'_>, field: &'static str, steps: &mut [Step]) -> Result<(), CodecError> {
    let (mut value, mut sum) = (0, 0);
    while sum < steps.len() {
        if value > 255 {
            return Err(CodecError::range(field, value, "a table has at most 256 values"));
        }
        let part = r.count(field, steps.len() - sum)?;
        for (offset, step) in steps[sum..sum + part].iter_mut().enumerate() {
            *step = Step::new(value, part, offset);
        }
        sum += part;
        value += 1 + if part == 0 { r.count(field, 255)? } else { 0 };
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
        assert_eq!(coded[0], METHOD);
        decode(&coded[1..], raw_len, "s")
    }

    #[test]
    fn costs_little_more_than_the_entropy() {
        for zeros in [0.02, 0.2, 0.5, 0.8, 0.95, 0.995] {
            let raw = residuals(200_000, zeros, 7);
            let coded = encode(&raw);
            assert_eq!(decoded(&coded, raw.len()).unwrap(), raw);
            let least = entropy_bytes(&raw);
            // Of the entropy what 4,096ths miss, and the table.
            assert!((coded.len() as f64) < 1.005 * least + 420.0, "{} for {least} at {zeros}", coded.len());
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
            let parts = parts_of(&raw);
            prop_assert_eq!(parts.iter().sum::<u32>(), PARTS);
            prop_assert!(raw.iter().all(|v| parts[usize::from(*v)] > 0));
            prop_assert_eq!(decoded(&encode(&raw), raw.len()).unwrap(), raw);
        }

        #[test]
        fn forged_bytes_are_refused_or_give_as_many(bytes in prop::collection::vec(any::<u8>(), 0..600), n in 0usize..2000) {
            if let Ok(out) = decode(&bytes, n, "s") {
                prop_assert_eq!(out.len(), n);
            }
        }
    }

    /// It is no check of its own, chunks have hashes: two values may lead from different states to the same one, so that a bit which turns the one into the other is not noticed (2 of 11,840 here).
    #[test]
    fn hardly_a_flipped_bit_behind_the_table_goes_unnoticed() {
        let raw = residuals(4000, 0.3, 3);
        let coded = encode(&raw);
        let mut table = Vec::new();
        put_table(&mut table, &parts_of(&raw));
        let bits = 8 * (1 + table.len())..8 * coded.len();
        let mut unnoticed = 0;
        for bit in bits.clone() {
            let mut flipped = coded.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            if let Ok(other) = decoded(&flipped, raw.len()) {
                unnoticed += 1;
                assert_eq!(other.iter().zip(&raw).filter(|(a, b)| a != b).count(), 1, "bit {bit}");
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
