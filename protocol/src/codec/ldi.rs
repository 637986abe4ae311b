//! LDI chunks: an [`Ldi`] to two chunks and back.
//!
//! The first chunk holds the camera, the disparity codes, the sky bits and layer 0, so that it
//! alone is a useful picture; the second holds the deeper layers and the
//! [slivers](super::slivers). Per chunk: occupancy ([`runs`](super::runs)), links, ends, slopes
//! and disparities ([`surface`](super::surface)), colours ([`colour`](super::colour)); each stream
//! is a section shared by the chunk's layers, since deep layers are small. Disparities, links,
//! ends and slopes are exact; colours as the [`ColourMode`] says.

use super::{
    CodecError, ColourMode, ColourProfile,
    bytes::{Reader, Writer},
    colour,
    residual::{Decoder, Encoder},
    runs::{OccupancyWriter, Run, read_occupancy, runs_of_layer, segments_of_runs},
    slivers, surface,
};
use crate::{
    ViewBasis,
    ldi::{DisparityCodes, Ldi, LdiCamera, LdiLayer, SIDES},
};
use glam::DVec3;

/// Version of both LDI chunks.
pub const VERSION: u8 = 6;
/// Most samples in one chunk: bounds what a forged chunk can make a reader allocate, about 150 MB.
/// An LDI of the largest planned kind (2560 x 1440 at density 2) has 15 million.
pub const MAX_SAMPLES: usize = 1 << 24;

const FIRST: [u8; 3] = *b"LDF";
const DEEPER: [u8; 3] = *b"LDD";

/// Encodes an LDI as a profile asks: its first chunk and, if there are deeper layers or slivers,
/// its second. `level` is zstd's, 1 to 19.
///
/// # Errors
/// As [`encode_first`].
pub fn encode(ldi: &Ldi, profile: ColourProfile, level: i32) -> Result<Vec<Vec<u8>>, CodecError> {
    Ok(encode_all(&[ldi], profile, level)?.concat())
}

/// Encodes several LDIs as [`encode`] does one, with the bytes that they are granted together:
/// where one is plain, another may have exact textures. The chunks of each.
///
/// # Errors
/// As [`encode_first`].
pub fn encode_all(ldis: &[&Ldi], profile: ColourProfile, level: i32) -> Result<Vec<Vec<Vec<u8>>>, CodecError> {
    let granted = profile.bytes_per_sample() * ldis.iter().map(|ldi| ldi.samples()).sum::<usize>() as f64;
    // All but the colours is the same in every mode.
    let shapes: Vec<(Shape<'_>, Option<Shape<'_>>)> = ldis
        .iter()
        .map(|ldi| Ok((Shape::first(ldi, level)?, Shape::deeper(ldi, level)?)))
        .collect::<Result<_, CodecError>>()?;
    let coded = |mode: ColourMode| -> Result<_, CodecError> {
        let of_one = |(first, deeper): &(Shape<'_>, Option<Shape<'_>>)| {
            let mut chunks = vec![first.coloured(mode, level)?];
            if let Some(deeper) = deeper {
                chunks.push(deeper.coloured(mode, level)?);
            }
            Ok(chunks)
        };
        let chunks: Vec<Vec<Vec<u8>>> = shapes.iter().map(of_one).collect::<Result<_, CodecError>>()?;
        let fits = chunks.iter().flatten().map(Vec::len).sum::<usize>() as f64 <= granted;
        Ok((chunks, fits))
    };
    // Exact colours suit most images. Of the others each takes fewer bytes than the one before:
    // the first that fits is found by halving.
    let (mut best, mut fits) = coded(profile.modes()[0])?;
    let mut rest = if fits { &[] } else { &profile.modes()[1..] };
    while !rest.is_empty() {
        let middle = rest.len() / 2;
        let (chunks, these_fit) = coded(rest[middle])?;
        if these_fit || !fits {
            (best, fits) = (chunks, these_fit);
        }
        rest = if these_fit { &rest[..middle] } else { &rest[middle + 1..] };
    }
    Ok(best)
}

/// Encodes camera, codes, sky bits and layer 0. `level` is zstd's, 1 to 19.
///
/// # Errors
/// If the LDI breaks its own rules or is larger than [`Ldi::MAX_SIDE`] or [`MAX_SAMPLES`].
pub fn encode_first(ldi: &Ldi, mode: ColourMode, level: i32) -> Result<Vec<u8>, CodecError> {
    Shape::first(ldi, level)?.coloured(mode, level)
}

/// Encodes the layers behind layer 0, and the slivers; None when there are none of either. `level`
/// is zstd's, 1 to 19.
///
/// # Errors
/// As [`encode_first`].
pub fn encode_deeper(ldi: &Ldi, mode: ColourMode, level: i32) -> Result<Option<Vec<u8>>, CodecError> {
    Shape::deeper(ldi, level)?.map(|shape| shape.coloured(mode, level)).transpose()
}

/// A chunk without its colours.
struct Shape<'a> {
    layers: &'a [LdiLayer],
    runs: Vec<Vec<Run>>,
    width: u32,
    /// What stands before the colour mode, between it and the colours, and after them.
    before: Vec<u8>,
    between: Vec<u8>,
    after: Vec<u8>,
}

impl<'a> Shape<'a> {
    /// Of a first chunk.
    fn first(ldi: &'a Ldi, level: i32) -> Result<Self, CodecError> {
        let mut w = Writer::new(level)?;
        w.raw(&FIRST);
        w.u8(VERSION);
        let c = &ldi.camera;
        check_size(c.width, c.height)?;
        for v in [c.cop, c.basis.right, c.basis.up, c.basis.forward] {
            v.to_array().into_iter().for_each(|x| w.f64(x));
        }
        w.f64(c.pixels_per_unit);
        w.i32(c.left);
        w.i32(c.top);
        w.u32(c.width);
        w.u32(c.height);
        w.f64(ldi.codes.smallest);
        w.f64(ldi.codes.step);
        w.u16(ldi.codes.largest_code);
        let sky: Vec<u8> = ldi.sky.iter().flat_map(|word| word.to_le_bytes()).collect();
        if ldi.sky.len() != ldi.sky_words_per_row() * c.height as usize {
            return Err(CodecError::mismatch("sky bits", "not one bit per pixel"));
        }
        w.section("sky bits", &sky)?;
        Self::new(w, ldi, ldi.layers.get(..1).unwrap_or_default())
    }

    /// Of a second chunk; None when there are neither deeper layers nor slivers.
    fn deeper(ldi: &'a Ldi, level: i32) -> Result<Option<Self>, CodecError> {
        let layers = ldi.layers.get(1..).unwrap_or_default();
        if layers.is_empty() && ldi.slivers.is_empty() {
            return Ok(None);
        }
        let mut w = Writer::new(level)?;
        w.raw(&DEEPER);
        w.u8(VERSION);
        w.u32(ldi.camera.width);
        w.u32(ldi.camera.height);
        let mut after = Writer::new(level)?;
        slivers::encode(&mut after, &ldi.slivers)?;
        Ok(Some(Self { after: after.bytes, ..Self::new(w, ldi, layers)? }))
    }

    /// Of layers, after what was written.
    fn new(mut w: Writer, ldi: &Ldi, layers: &'a [LdiLayer]) -> Result<Self, CodecError> {
        let (width, height) = (ldi.camera.width, ldi.camera.height);
        let total: usize = layers.iter().map(LdiLayer::len).sum();
        if total > MAX_SAMPLES || layers.len() > Ldi::MAX_LAYERS {
            return Err(CodecError::range("samples", total, "a chunk holds at most 2^24 samples in 32 layers"));
        }
        let before = std::mem::take(&mut w.bytes);
        w.u8(layers.len() as u8);
        layers.iter().for_each(|l| w.varint(l.len() as u64));

        let runs: Vec<Vec<Run>> =
            layers.iter().map(|layer| runs_of_layer(layer, width, height)).collect::<Result<_, CodecError>>()?;
        let mut occupancy = OccupancyWriter::default();
        let mut links = surface::LinkEncoder::default();
        let mut ends = Encoder::new(surface::END_STREAMS);
        let mut slopes = Encoder::new(surface::SLOPE_STREAMS);
        let mut disparities = Encoder::new(surface::STREAMS);
        for (layer, runs) in layers.iter().zip(&runs) {
            occupancy.layer(runs, height);
            let joined = surface::walk_links(runs, &mut layer.links.clone(), &mut links);
            surface::walk_ends(runs, width, &joined, &layer.links, &mut layer.ends.clone(), &mut ends);
            let open = (&layer.links[..], &layer.ends[..]);
            surface::walk_slopes(runs, width, &joined, open, &mut layer.slopes.clone(), &mut slopes);
            surface::walk_disparity(runs, width, &joined, &mut layer.disparity.clone(), &mut disparities);
        }
        occupancy.finish(&mut w)?;
        links.finish(&mut w)?;
        ends.finish(&mut w, "ends")?;
        slopes.finish(&mut w, "slopes")?;
        disparities.finish(&mut w, "disparities")?;
        Ok(Self { layers, runs, width, before, between: w.bytes, after: Vec::new() })
    }

    /// The chunk.
    fn coloured(&self, mode: ColourMode, level: i32) -> Result<Vec<u8>, CodecError> {
        let mut w = Writer::new(level)?;
        w.raw(&self.before);
        w.raw(&mode.bytes()?);
        w.raw(&self.between);
        let walker = colour::Walker::new(mode);
        let mut colours = Encoder::new(colour::STREAMS);
        for (layer, runs) in self.layers.iter().zip(&self.runs) {
            walker.walk(runs, self.width, &mut layer.rgb.clone(), &mut colours);
        }
        colours.finish(&mut w, "colours")?;
        w.raw(&self.after);
        Ok(w.bytes)
    }
}

/// Decodes a first chunk: an LDI with at most one layer.
///
/// # Errors
/// If anything is missing, out of range or left over.
pub fn decode_first(bytes: &[u8]) -> Result<Ldi, CodecError> {
    let mut r = Reader::new(bytes);
    r.magic("LDI", FIRST, VERSION)?;
    let mut vector = |field| Ok(DVec3::new(r.finite(field)?, r.finite(field)?, r.finite(field)?));
    let cop = vector("centre of projection")?;
    let basis = ViewBasis { right: vector("right")?, up: vector("up")?, forward: vector("forward")? };
    let camera = LdiCamera {
        cop,
        basis,
        pixels_per_unit: r.finite("pixels per unit")?,
        left: r.i32("left")?,
        top: r.i32("top")?,
        width: r.u32("width")?,
        height: r.u32("height")?,
    };
    check_size(camera.width, camera.height)?;
    let codes = DisparityCodes {
        smallest: r.finite("smallest disparity")?,
        step: r.finite("disparity step")?,
        largest_code: r.u16("largest disparity code")?,
    };
    let words = (camera.width as usize).div_ceil(64) * camera.height as usize;
    let sky = r.section_of("sky bits", words * 8)?;
    let sky = sky.as_chunks().0.iter().map(|b| u64::from_le_bytes(*b)).collect();
    let mut ldi = Ldi { camera, codes, layers: Vec::new(), sky, slivers: Vec::new() };
    ldi.layers = decode_layers(&mut r, (camera.width, camera.height), 1)?;
    r.finish("LDI")?;
    check(&ldi)?;
    Ok(ldi)
}

/// Decodes the deeper layers and appends them to the LDI whose first chunk was decoded before.
///
/// # Errors
/// If the chunk is malformed, belongs to an image of another size, or the LDI has its deeper
/// layers already. Then `ldi` is as before.
pub fn decode_deeper(bytes: &[u8], ldi: &mut Ldi) -> Result<(), CodecError> {
    let mut r = Reader::new(bytes);
    r.magic("deeper LDI layers", DEEPER, VERSION)?;
    if (r.u32("width")?, r.u32("height")?) != (ldi.camera.width, ldi.camera.height) {
        return Err(CodecError::mismatch("width", "the deeper layers belong to another image"));
    }
    if ldi.layers.len() != 1 || !ldi.slivers.is_empty() {
        return Err(CodecError::mismatch(
            "layers",
            format!("{} layers are there, not just the first", ldi.layers.len()),
        ));
    }
    let layers = decode_layers(&mut r, (ldi.camera.width, ldi.camera.height), Ldi::MAX_LAYERS - 1)?;
    let slivers = slivers::decode(&mut r)?;
    r.finish("deeper LDI layers")?;
    ldi.layers.extend(layers);
    ldi.slivers = slivers;
    check(ldi).inspect_err(|_| {
        ldi.layers.truncate(1);
        ldi.slivers.clear();
    })
}

/// Bytes that an LDI takes in memory, for [`crate::index::ChunkEntry::decoded_bytes`]: of the
/// first chunk's part, and of the rest.
pub fn decoded_bytes(ldi: &Ldi) -> [usize; 2] {
    let layer = |l: &LdiLayer| l.len() * (1 + 2 + 3 + 1 + 2 + 2) + size_of_val(&l.segments[..]);
    let first = ldi.sky.len() * 8 + size_of::<Ldi>() + ldi.layers.first().map_or(0, layer);
    [first, ldi.layers.iter().skip(1).map(layer).sum::<usize>() + size_of_val(&ldi.slivers[..])]
}

/// The sizes that memory depends on; the rest is left to [`Ldi::check`].
fn check_size(width: u32, height: u32) -> Result<(), CodecError> {
    for (field, side) in [("width", width), ("height", height)] {
        if !(1..=Ldi::MAX_SIDE).contains(&side) {
            return Err(CodecError::range(field, side, "LDIs have 1 to 16384 columns and rows"));
        }
    }
    let pixels = u64::from(width) * u64::from(height);
    if pixels > Ldi::MAX_PIXELS {
        return Err(CodecError::range("pixels", pixels, "LDIs have at most 2^26 pixels"));
    }
    Ok(())
}

fn check(ldi: &Ldi) -> Result<(), CodecError> {
    ldi.check().map_err(|fault| CodecError::mismatch("LDI", fault.to_string()))
}

fn decode_layers(r: &mut Reader<'_>, (width, height): (u32, u32), most: usize) -> Result<Vec<LdiLayer>, CodecError> {
    let mode = ColourMode::read(r)?;
    let layers = usize::from(r.u8("layers")?);
    if layers > most {
        return Err(CodecError::range("layers", layers, "too many for this chunk"));
    }
    let pixels = (width as usize * height as usize).min(MAX_SAMPLES);
    let counts = (0..layers).map(|_| r.count("samples", pixels)).collect::<Result<Vec<_>, _>>()?;
    let total: usize = counts.iter().sum();
    if total > MAX_SAMPLES {
        return Err(CodecError::range("samples", total, "a chunk holds at most 2^24 samples"));
    }
    let occupancy = read_occupancy(r, (width, height), &counts)?;
    let mut links = surface::LinkDecoder::new(r, total)?;
    let mut ends = Decoder::of_at_most(r, "ends", surface::END_STREAMS, total * SIDES.len())?;
    let mut slopes = Decoder::of_at_most(r, "slopes", surface::SLOPE_STREAMS, total * 2)?;
    let mut disparities = Decoder::new(r, "disparities", surface::STREAMS, total)?;
    let mut colours = Decoder::new(r, "colours", colour::STREAMS, total * 3)?;
    let walker = colour::Walker::new(mode);
    let mut out = Vec::with_capacity(layers);
    for (runs, &n) in occupancy.iter().zip(&counts) {
        let (segments, column) = segments_of_runs(runs, n);
        let mut layer = LdiLayer {
            segments,
            column,
            disparity: vec![0; n],
            rgb: vec![[0; 3]; n],
            links: vec![0; n],
            ends: vec![0; n],
            slopes: vec![[0; 2]; n],
        };
        let joined = surface::walk_links(runs, &mut layer.links, &mut links);
        surface::walk_ends(runs, width, &joined, &layer.links, &mut layer.ends, &mut ends);
        let open = (&layer.links[..], &layer.ends[..]);
        surface::walk_slopes(runs, width, &joined, open, &mut layer.slopes, &mut slopes);
        surface::walk_disparity(runs, width, &joined, &mut layer.disparity, &mut disparities);
        walker.walk(runs, width, &mut layer.rgb, &mut colours);
        out.push(layer);
    }
    links.finish()?;
    ends.finish("ends")?;
    slopes.finish("slopes")?;
    disparities.finish("disparities")?;
    colours.finish("colours")?;
    Ok(out)
}

#[cfg(test)]
#[path = "ldi_test.rs"]
mod tests;
