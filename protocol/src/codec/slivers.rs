//! Slivers of a chunk.
//!
//! Each is told relative to the one before it, and its corners relative to its first: three
//! streams of LEB128 numbers (places, disparities, colours), each a zstd section. A builder that
//! writes neighbours one after the other is rewarded.

use super::{
    CodecError,
    bytes::{Reader, Writer, put_varint, unzigzag, zigzag},
};
use crate::ldi::{Sliver, SliverCorner};

/// Appends all slivers.
pub(super) fn encode(w: &mut Writer, slivers: &[Sliver]) -> Result<(), CodecError> {
    if slivers.len() > Sliver::MOST {
        return Err(CodecError::range("slivers", slivers.len(), "an image has at most 2^18"));
    }
    w.varint(slivers.len() as u64);
    let (mut places, mut disparities, mut colours) = (Vec::new(), Vec::new(), Vec::new());
    let mut last = ORIGIN;
    for s in slivers {
        for c in &s.corners {
            put_varint(&mut places, zigzag(i64::from(c.u) - i64::from(last.u)));
            put_varint(&mut places, zigzag(i64::from(c.v) - i64::from(last.v)));
            put_varint(&mut disparities, zigzag(i64::from(c.disparity) - i64::from(last.disparity)));
            last = s.corners[0];
        }
        colours.extend(s.rgb);
    }
    w.section("places of slivers", &places)?;
    w.section("disparities of slivers", &disparities)?;
    w.section("colours of slivers", &colours)
}

/// Reads them.
pub(super) fn decode(r: &mut Reader<'_>) -> Result<Vec<Sliver>, CodecError> {
    let n = r.count("slivers", Sliver::MOST)?;
    // LEB128 numbers of at most 33 and 17 bits.
    let places = r.section("places of slivers", n * 8 * 5)?;
    let disparities = r.section("disparities of slivers", n * 4 * 3)?;
    let colours = r.section_of("colours of slivers", n * 3)?;
    let (mut places, mut disparities) = (Reader::new(&places), Reader::new(&disparities));
    let mut last = ORIGIN;
    let mut out = Vec::with_capacity(n);
    for rgb in colours.as_chunks().0 {
        let mut corners = [ORIGIN; 4];
        for (k, c) in corners.iter_mut().enumerate() {
            let mut place = |from: i32| {
                let moved = unzigzag(places.varint("place of a sliver", u64::from(u32::MAX))?);
                i32::try_from(i64::from(from) + moved)
                    .map_err(|_| CodecError::range("place of a sliver", moved, "it is beyond the image"))
            };
            (c.u, c.v) = (place(last.u)?, place(last.v)?);
            let moved = unzigzag(disparities.varint("disparity of a sliver", 1 << 18)?);
            c.disparity = u16::try_from(i64::from(last.disparity) + moved)
                .map_err(|_| CodecError::range("disparity of a sliver", moved, "no such code"))?;
            if k == 0 {
                last = *c;
            }
        }
        out.push(Sliver { corners, rgb: *rgb });
    }
    places.finish("places of slivers")?;
    disparities.finish("disparities of slivers")?;
    Ok(out)
}

const ORIGIN: SliverCorner = SliverCorner { u: 0, v: 0, disparity: 0 };
