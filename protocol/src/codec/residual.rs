//! Prediction residuals, sorted into streams by context.
//!
//! A plane coder predicts each value from decoded neighbours and hands the difference to a [`Coder`], together with a
//! context: a small number that says how well the prediction is expected to do, again from decoded neighbours only.
//! Residuals of one context go to one stream, and every stream is a section of its own. So the sections' tables
//! ([`super::rans`], zstd) do what the conditional coder of JPEG-LS (Weinberger, Seroussi, Sapiro 2000, section III-C) does: nothing but a
//! table lookup is done per symbol here.
//!
//! Encoder and decoder run the same walk; only the coder differs. So they cannot disagree about a prediction.
//!
//! With a step q > 1 coding is near-lossless: the residual is divided by q, rounded toward zero, and the value *as decoded* becomes the
//! neighbour of later ones, so that errors do not add up: each stays below q. JPEG-LS (section III-F) rounds to the nearest, with half the error for a
//! step, but more bytes for an error (docs/decisions.md). With step 1 residuals wrap at 256, so that they fit a byte.

use super::{
    CodecError,
    bytes::{Reader, Writer, put_varint, unzigzag, zigzag},
};

/// Either side of the coding of residuals.
pub(super) trait Coder {
    /// Codes one 8-bit value: returns the quantized residual and the value as decoded. A decoder ignores `actual`.
    fn byte<const LOSSLESS: bool>(&mut self, stream: usize, step: i32, predicted: i32, actual: i32) -> (i32, i32);
    /// Codes one 16-bit value exactly. A decoder ignores `actual`.
    fn word(&mut self, stream: usize, predicted: u16, actual: u16) -> u16;
}

/// The value that a quantized residual stands for.
#[inline]
fn restored<const LOSSLESS: bool>(step: i32, predicted: i32, q: i32) -> i32 {
    if LOSSLESS || step == 1 { (predicted + q) & 255 } else { (predicted + q * step).clamp(0, 255) }
}

/// Residuals of 16-bit values from here on, zigzagged, are written out in full: escape byte, then two bytes elsewhere.
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
    pub fn new(streams: usize) -> Self {
        Self { streams: vec![Vec::new(); streams], escaped: Vec::new() }
    }
    /// Writes lengths and sections.
    pub fn finish(self, w: &mut Writer, field: &'static str) -> Result<(), CodecError> {
        for s in self.streams.iter().chain([&self.escaped]) {
            w.section(field, s)?;
        }
        Ok(())
    }
}

impl Coder for Encoder {
    #[inline]
    fn byte<const LOSSLESS: bool>(&mut self, stream: usize, step: i32, predicted: i32, actual: i32) -> (i32, i32) {
        let r = actual - predicted;
        // Toward the prediction: a rounded residual overshoots half the time, and what overshoots is noise to all predictions after it.
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

/// Gives streams back. Reading past the end of a stream gives zeros and is found by [`Decoder::finish`], so that the inner
/// loops need no error path.
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
    /// Reads the sections of `streams` streams that hold `values` residuals altogether.
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
        let (mut bytes, mut next, mut ends) = (Vec::new(), [0; MOST_STREAMS], Vec::with_capacity(streams));
        for stream in 0..streams {
            let section = r.section(field, most - bytes.len())?;
            next[stream] = bytes.len();
            if bytes.is_empty() {
                bytes = section
            } else {
                bytes.extend_from_slice(&section)
            }
            ends.push(bytes.len());
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

/// Median-edge prediction (LOCO-I): the smaller neighbour at an edge that brightens away from the corner, the larger at one
/// that darkens, else the plane through the three.
#[inline]
pub(super) fn median_edge(left: i32, up: i32, corner: i32) -> i32 {
    let (low, high) = (left.min(up), left.max(up));
    (left + up - corner).clamp(low, high)
}
