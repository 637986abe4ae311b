//! Seeded changes to valid inputs, and seeded damage.

/// A generator of 64-bit numbers (xorshift64*), the same on every machine.
#[derive(Debug, Clone)]
pub struct Random(u64);

impl Random {
    /// Starts at a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }
    /// The next number.
    pub fn bits(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }
    /// A number from 0 to `n - 1`; 0 for `n = 0`.
    pub fn below(&mut self, n: usize) -> usize {
        ((self.bits() >> 33) as usize) % n.max(1)
    }
    /// One of a list.
    pub fn pick<'a, T>(&mut self, list: &'a [T]) -> &'a T {
        &list[self.below(list.len())]
    }
}

/// Values at which decoders go wrong: limits of integers, LEB128 numbers, digits, brackets, NaN.
static PIECES: [&[u8]; 22] = [
    &[0],
    &[1],
    &[0x7f],
    &[0x80],
    &[0xff],
    &[0xff; 2],
    &[0xff; 4],
    &[0xff; 8],
    &[0; 4],
    &[0, 0, 0, 0x80],
    &[0xff, 0xff, 0xff, 0x7f],
    &[0xff, 0xff, 0xff, 0xff, 0x0f],
    &[0x80, 0x80, 0x80, 0x80, 0x08],
    &[0, 0, 0, 0, 0, 0, 0xf8, 0x7f],
    &[0, 0, 0xc0, 0x7f],
    b"4294967295",
    b"-1",
    b"1e999",
    b"nan",
    b"[",
    b"\"",
    b"\n",
];

/// Longest input: a few seeds joined.
const LONGEST: usize = 1 << 20;

/// A valid input with one to six changes: bits, bytes, pieces, cuts, copies, parts of other seeds.
pub fn mutated(seeds: &[Vec<u8>], random: &mut Random) -> Vec<u8> {
    let mut bytes = random.pick(seeds).clone();
    for _ in 0..1 + random.below(6) {
        change(&mut bytes, seeds, random);
    }
    bytes.truncate(LONGEST);
    bytes
}

fn change(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], random: &mut Random) {
    // Heads decide most: every second change is there.
    let within = if random.below(2) == 0 { bytes.len().min(64) } else { bytes.len() };
    let at = random.below(within);
    let most = 1 << random.below(8);
    let length = (1 + random.below(most)).min(bytes.len() - at.min(bytes.len()));
    match random.below(12) {
        _ if bytes.is_empty() => bytes.extend_from_slice(PIECES[random.below(PIECES.len())]),
        0..=2 => bytes[at] ^= 1 << random.below(8),
        3 => bytes[at] = random.bits() as u8,
        4 => bytes[at] = bytes[at].wrapping_add(1).wrapping_sub(2 * random.below(2) as u8),
        5 => bytes[at] = b'0' + random.below(10) as u8,
        6 => {
            let piece = PIECES[random.below(PIECES.len())];
            let end = (at + piece.len()).min(bytes.len());
            bytes.splice(at..end, piece.iter().copied());
        }
        7 => drop(bytes.splice(at..at, PIECES[random.below(PIECES.len())].iter().copied())),
        8 => drop(bytes.drain(at..at + length)),
        9 => {
            let copy = bytes[at..at + length].to_vec();
            let to = random.below(bytes.len());
            bytes.splice(to..to, copy);
        }
        10 => {
            let other = random.pick(seeds);
            let from = random.below(other.len());
            let part = &other[from..(from + length).min(other.len())];
            let end = (at + part.len()).min(bytes.len());
            bytes.splice(at..end, part.iter().copied());
        }
        _ if random.below(4) == 0 => bytes.truncate(at),
        _ => {
            let to = random.below(bytes.len());
            bytes.swap(at, to);
        }
    }
}
