//! Planes of integers: N interleaved numbers per element, delta-coded, cut into bytes.
//!
//! Numbers are zigzagged to 32 bits; byte 0 of all of them (first component first), then byte 1, 2
//! and 3 are sections. High bytes are almost always 0 and then cost a few bytes altogether.

use super::{
    CodecError,
    bytes::{Reader, Writer, unzigzag, zigzag},
};

/// Bytes per number.
const BYTES: usize = 4;

/// Collects elements of N numbers.
pub(super) struct PlaneWriter<const N: usize> {
    values: [Vec<u32>; N],
    last: [i64; N],
}

impl<const N: usize> Default for PlaneWriter<N> {
    fn default() -> Self {
        Self { values: std::array::from_fn(|_| Vec::new()), last: [0; N] }
    }
}

impl<const N: usize> PlaneWriter<N> {
    /// Appends numbers of at most 31 bits as they are.
    pub fn push(&mut self, v: [i64; N]) {
        self.values.iter_mut().zip(v).for_each(|(plane, v)| plane.push(zigzag(v) as u32));
    }
    /// Makes the next element a difference to 0.
    pub fn restart(&mut self) {
        self.last = [0; N];
    }
    /// Appends the difference to the element before.
    pub fn push_delta(&mut self, v: [i64; N]) {
        self.push(std::array::from_fn(|k| v[k] - self.last[k]));
        self.last = v;
    }
    /// Writes the sections.
    pub fn finish(self, w: &mut Writer, field: &'static str) -> Result<(), CodecError> {
        for byte in 0..BYTES {
            let raw: Vec<u8> = self.values.iter().flatten().map(|v| v.to_le_bytes()[byte]).collect();
            // A plane of zeros is an empty section.
            w.section(field, if raw.iter().all(|&b| b == 0) { &[] } else { &raw })?;
        }
        Ok(())
    }
}

/// Gives elements of N numbers back.
pub(super) struct PlaneReader<const N: usize> {
    bytes: [Vec<u8>; BYTES],
    elements: usize,
    next: usize,
    last: [i64; N],
    field: &'static str,
}

impl<const N: usize> PlaneReader<N> {
    /// Reads the sections of this many elements.
    pub fn new(r: &mut Reader<'_>, field: &'static str, elements: usize) -> Result<Self, CodecError> {
        let mut bytes: [Vec<u8>; BYTES] = Default::default();
        for b in &mut bytes {
            *b = r.section(field, elements * N)?;
            if !b.is_empty() && b.len() != elements * N {
                return Err(CodecError::mismatch(field, format!("{} bytes for {} numbers", b.len(), elements * N)));
            }
        }
        Ok(Self { bytes, elements, next: 0, last: [0; N], field })
    }
    /// The next element as it was pushed.
    #[inline]
    pub fn next(&mut self) -> Result<[i64; N], CodecError> {
        if self.next >= self.elements {
            return Err(CodecError::Truncated { field: self.field, missing: N });
        }
        let i = self.next;
        self.next += 1;
        Ok(std::array::from_fn(|k| {
            let at = k * self.elements + i;
            unzigzag(u32::from_le_bytes(std::array::from_fn(|b| self.bytes[b].get(at).copied().unwrap_or(0))).into())
        }))
    }
    /// Makes the next difference one to 0.
    pub fn restart(&mut self) {
        self.last = [0; N];
    }
    /// The next element that was pushed as a difference.
    #[inline]
    pub fn next_delta(&mut self) -> Result<[i64; N], CodecError> {
        let d = self.next()?;
        // At most 2^22 steps of 32 bits: no overflow in 64.
        self.last = std::array::from_fn(|k| self.last[k] + d[k]);
        Ok(self.last)
    }
}
