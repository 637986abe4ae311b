//! Reading and writing little-endian fields, LEB128 numbers and compressed sections.
//!
//! A *section* is `raw length (LEB128) | stored length (LEB128) | stored bytes`. Where the two
//! lengths are equal the bytes are stored as they are, else they are one zstd frame or coded by
//! [`rans`], whichever is shorter: the one finds what repeats, the other costs noise no more than
//! its entropy. The reader is told the largest raw length that makes sense at this place and
//! refuses a larger one before it allocates. Planes of different statistics go into sections of
//! their own, since each has one table.

use super::{CodecError, rans};

/// Sections shorter than this are stored: zstd's frame and tables would cost more than they gain.
const SMALLEST_COMPRESSED: usize = 24;

/// Appends fields to a chunk.
pub(crate) struct Writer {
    /// What was written so far.
    pub bytes: Vec<u8>,
    /// None: sections are stored as they are.
    zstd: Option<zstd::bulk::Compressor<'static>>,
}

impl Writer {
    /// An empty chunk whose sections are compressed at this zstd level, 1 to 19; 0 stores them
    /// uncompressed, for tests that damage what is in them.
    pub fn new(level: i32) -> Result<Self, CodecError> {
        let failed = |e: std::io::Error| CodecError::Compression { field: "compressor", reason: e.to_string() };
        let zstd = || zstd::bulk::Compressor::new(level.clamp(1, 19)).map_err(failed);
        Ok(Self { bytes: Vec::new(), zstd: if level == 0 { None } else { Some(zstd()?) } })
    }
    pub fn raw(&mut self, b: &[u8]) {
        self.bytes.extend_from_slice(b);
    }
    pub fn u8(&mut self, v: u8) {
        self.bytes.push(v);
    }
    pub fn u16(&mut self, v: u16) {
        self.raw(&v.to_le_bytes());
    }
    pub fn u32(&mut self, v: u32) {
        self.raw(&v.to_le_bytes());
    }
    pub fn i32(&mut self, v: i32) {
        self.raw(&v.to_le_bytes());
    }
    pub fn f64(&mut self, v: f64) {
        self.raw(&v.to_le_bytes());
    }
    pub fn varint(&mut self, v: u64) {
        put_varint(&mut self.bytes, v);
    }
    /// Appends a section.
    pub fn section(&mut self, field: &'static str, raw: &[u8]) -> Result<(), CodecError> {
        self.packed(field, raw).map(|packed| self.append(raw, &packed))
    }
    /// Compresses a section that is not appended yet.
    pub fn packed(&mut self, field: &'static str, raw: &[u8]) -> Result<Packed, CodecError> {
        if let Some(zstd) = self.zstd.as_mut().filter(|_| raw.len() >= SMALLEST_COMPRESSED) {
            let failed = |e: std::io::Error| CodecError::Compression { field, reason: e.to_string() };
            let (zstd, coded) = (zstd.compress(raw).map_err(failed)?, rans::encode(raw));
            let packed = if coded.len() < zstd.len() { coded } else { zstd };
            return Ok(Packed((packed.len() < raw.len()).then_some(packed)));
        }
        Ok(Packed(None))
    }
    /// Appends a section that was compressed.
    pub fn append(&mut self, raw: &[u8], packed: &Packed) {
        let stored = packed.stored(raw);
        self.varint(raw.len() as u64);
        self.varint(stored.len() as u64);
        self.raw(stored);
    }
}

/// A section's bytes where they are fewer than what was written.
pub(crate) struct Packed(Option<Vec<u8>>);

impl Packed {
    /// The bytes to store for what was packed.
    pub fn stored<'a>(&'a self, raw: &'a [u8]) -> &'a [u8] {
        self.0.as_deref().unwrap_or(raw)
    }
}

/// Bits packed eight to a byte, first bit lowest.
#[derive(Default)]
pub(crate) struct BitWriter {
    /// What was written so far; the last byte may hold fewer.
    pub bytes: Vec<u8>,
    /// Bits in all.
    pub bits: usize,
}

impl BitWriter {
    /// Appends one.
    #[inline]
    pub fn push(&mut self, bit: bool) {
        if self.bits.is_multiple_of(8) {
            self.bytes.push(0);
        }
        if let Some(last) = self.bytes.last_mut() {
            *last |= u8::from(bit) << (self.bits % 8);
        }
        self.bits += 1;
    }
    /// Appends the lowest of a number, low ones first.
    pub fn put(&mut self, value: u32, count: u32) {
        (0..count).for_each(|k| self.push(value >> k & 1 == 1));
    }
}

/// Reads fields of a chunk in order; every method fails with the field's name instead of reading
/// past the end.
pub(crate) struct Reader<'a> {
    rest: &'a [u8],
    /// Raw bytes that sections may still hold.
    room: usize,
    zstd: Option<zstd::bulk::Decompressor<'static>>,
}

impl<'a> Reader<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self::with_room(bytes, usize::MAX)
    }
    /// Sections may hold this many raw bytes together.
    pub fn with_room(bytes: &'a [u8], room: usize) -> Self {
        Self { rest: bytes, room, zstd: None }
    }
    /// What is left of it.
    pub fn room(&self) -> usize {
        self.room
    }
    /// Bytes not read yet.
    pub fn remaining(&self) -> usize {
        self.rest.len()
    }
    /// The next bytes as they are.
    pub fn take(&mut self, n: usize, field: &'static str) -> Result<&'a [u8], CodecError> {
        let (head, rest) = self
            .rest
            .split_at_checked(n)
            .ok_or(CodecError::Truncated { field, missing: n.saturating_sub(self.rest.len()) })?;
        self.rest = rest;
        Ok(head)
    }
    /// What is told in bits, up to the end of a byte.
    pub fn bits<T>(
        &mut self,
        field: &'static str,
        read: impl FnOnce(&mut BitReader<'_>) -> T,
    ) -> Result<T, CodecError> {
        let mut bits = BitReader { bytes: self.rest, at: 0 };
        let told = read(&mut bits);
        let used = bits.at.div_ceil(8);
        self.take(used, field).map(|_| told)
    }
    /// A fixed number of bytes.
    pub fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], CodecError> {
        let (head, rest) = self
            .rest
            .split_first_chunk::<N>()
            .ok_or(CodecError::Truncated { field, missing: N.saturating_sub(self.rest.len()) })?;
        self.rest = rest;
        Ok(*head)
    }
    /// Checks the four bytes that name the kind of data and its version.
    pub fn magic(&mut self, what: &'static str, magic: [u8; 3], version: u8) -> Result<(), CodecError> {
        let found = self.array::<4>("magic")?;
        if found[..3] != magic {
            return Err(CodecError::Magic { expected: what, found });
        }
        if found[3] != version {
            return Err(CodecError::Version { what, found: found[3].into(), expected: version.into() });
        }
        Ok(())
    }
    pub fn u8(&mut self, field: &'static str) -> Result<u8, CodecError> {
        Ok(self.array::<1>(field)?[0])
    }
    pub fn u16(&mut self, field: &'static str) -> Result<u16, CodecError> {
        Ok(u16::from_le_bytes(self.array(field)?))
    }
    pub fn u32(&mut self, field: &'static str) -> Result<u32, CodecError> {
        Ok(u32::from_le_bytes(self.array(field)?))
    }
    pub fn i32(&mut self, field: &'static str) -> Result<i32, CodecError> {
        Ok(i32::from_le_bytes(self.array(field)?))
    }
    pub fn f64(&mut self, field: &'static str) -> Result<f64, CodecError> {
        Ok(f64::from_le_bytes(self.array(field)?))
    }
    /// An f64 that must be finite.
    pub fn finite(&mut self, field: &'static str) -> Result<f64, CodecError> {
        let v = self.f64(field)?;
        if v.is_finite() { Ok(v) } else { Err(CodecError::range(field, v, "it must be finite")) }
    }
    /// A LEB128 number of at most `max`.
    pub fn varint(&mut self, field: &'static str, max: u64) -> Result<u64, CodecError> {
        let mut v = 0u64;
        for shift in (0..64).step_by(7) {
            let byte = self.u8(field)?;
            v |= u64::from(byte & 127) << shift;
            if byte < 128 {
                return if v <= max {
                    Ok(v)
                } else {
                    Err(CodecError::range(field, v, "it is larger than this place allows"))
                };
            }
        }
        Err(CodecError::range(field, "a number of more than 64 bits", "it is larger than this place allows"))
    }
    /// A LEB128 number of at most `max`, for counts and positions.
    pub fn count(&mut self, field: &'static str, max: usize) -> Result<usize, CodecError> {
        Ok(self.varint(field, max as u64)? as usize)
    }
    /// A section of at most `max` raw bytes.
    pub fn section(&mut self, field: &'static str, max: usize) -> Result<Vec<u8>, CodecError> {
        let raw_len = self.count(field, max.min(self.room))?;
        self.room -= raw_len;
        let stored_len = self.count(field, raw_len)?;
        let stored = self.take(stored_len, field)?;
        if stored_len == raw_len {
            return Ok(stored.to_vec());
        }
        if let [method @ (rans::METHOD | rans::METHOD_OF_FEW), coded @ ..] = stored {
            return rans::decode(coded, *method == rans::METHOD_OF_FEW, raw_len, field);
        }
        let failed = |reason: String| CodecError::Compression { field, reason };
        let zstd = match &mut self.zstd {
            Some(z) => z,
            none => none.insert(zstd::bulk::Decompressor::new().map_err(|e| failed(e.to_string()))?),
        };
        let raw = zstd.decompress(stored, raw_len).map_err(|e| failed(e.to_string()))?;
        if raw.len() != raw_len {
            return Err(failed(format!("{} bytes instead of {raw_len}", raw.len())));
        }
        Ok(raw)
    }
    /// A section of exactly `len` raw bytes.
    pub fn section_of(&mut self, field: &'static str, len: usize) -> Result<Vec<u8>, CodecError> {
        let raw = self.section(field, len)?;
        if raw.len() == len {
            Ok(raw)
        } else {
            Err(CodecError::mismatch(field, format!("{} bytes, but {len} are needed", raw.len())))
        }
    }
    /// Checks that everything was read.
    pub fn finish(self, what: &'static str) -> Result<(), CodecError> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(CodecError::mismatch(what, format!("{} bytes too many at the end", self.rest.len())))
        }
    }
}

/// Takes bits from bytes, low ones first. Past the end come zeros, and [`Reader::bits`] fails.
pub(crate) struct BitReader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl BitReader<'_> {
    /// The next bits, at least 57.
    #[inline]
    fn ahead(&self) -> u64 {
        let rest = self.bytes.get(self.at / 8..).unwrap_or_default();
        let word = rest.first_chunk().copied().unwrap_or_else(|| {
            let mut word = [0; 8];
            word[..rest.len()].copy_from_slice(rest);
            word
        });
        u64::from_le_bytes(word) >> (self.at % 8)
    }
    /// A number of at most 32 bits.
    #[inline]
    pub fn take(&mut self, count: u32) -> u32 {
        let value = self.ahead() & ((1 << count) - 1);
        self.at += count as usize;
        value as u32
    }
    /// How many bits of 1, at most 32, come before the next of 0, which is taken with them.
    #[inline]
    pub fn ones(&mut self) -> u32 {
        let ones = self.ahead().trailing_ones().min(32);
        self.at += ones as usize + 1;
        ones
    }
}

/// Appends a LEB128 number: seven bits a byte, low bits first, the high bit set on all bytes but
/// the last.
pub(crate) fn put_varint(out: &mut Vec<u8>, mut v: u64) {
    while v >= 128 {
        out.push(v as u8 | 128);
        v >>= 7;
    }
    out.push(v as u8);
}

/// Maps small signed numbers to small unsigned ones: 0, -1, 1, -2, ... to 0, 1, 2, 3, ...
#[inline]
pub(crate) fn zigzag(v: i64) -> u64 {
    ((v << 1) ^ (v >> 63)) as u64
}

/// Inverse of [`zigzag`].
#[inline]
pub(crate) fn unzigzag(v: u64) -> i64 {
    (v >> 1) as i64 ^ -((v & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_sections_come_back() {
        let mut w = Writer::new(3).unwrap();
        let numbers = [0, 1, 127, 128, 300, u64::from(u32::MAX), u64::MAX];
        for n in numbers {
            w.varint(n);
        }
        let long: Vec<u8> = (0..5000).map(|i| (i % 7) as u8).collect();
        for s in [&long[..], &long[..5], &[]] {
            w.section("s", s).unwrap();
        }
        assert!(w.bytes.len() < 300, "the long section must be compressed: {}", w.bytes.len());
        let mut r = Reader::new(&w.bytes);
        for n in numbers {
            assert_eq!(r.varint("n", u64::MAX).unwrap(), n);
        }
        assert_eq!(r.section("s", 5000).unwrap(), long);
        assert_eq!(r.section_of("s", 5).unwrap(), &long[..5]);
        assert_eq!(r.section("s", 0).unwrap(), &[] as &[u8]);
        r.finish("test").unwrap();
    }

    #[test]
    fn too_large_is_refused_before_it_is_read() {
        let mut w = Writer::new(3).unwrap();
        w.section("s", &[7; 1000]).unwrap();
        assert!(matches!(Reader::new(&w.bytes).section("s", 999), Err(CodecError::Range { field: "s", .. })));
        let endless = [255u8; 12];
        assert!(Reader::new(&endless).varint("n", u64::MAX).is_err());
    }

    #[test]
    fn zigzag_is_one_to_one() {
        for v in [0, -1, 1, -2, 2, i64::MAX, i64::MIN] {
            assert_eq!(unzigzag(zigzag(v)), v);
        }
        assert_eq!([0, -1, 1, -2].map(zigzag), [0, 1, 2, 3]);
    }
}
