//! Texture chunks: ranges of mip levels, coarse ones first.
//!
//! One chunk holds every level whose longer side is at most [`COARSE_SIDE`] texels, so that a
//! texture is useful after a few kilobytes; each finer level is a chunk of its own
//! ([`chunk_ranges`]). Texels are coded like LDI colours (one run per row); alpha is a plane of
//! its own, written only where some texel is not opaque. Alpha is always exact: cutouts are tested
//! against it. Instead of the finest levels a chunk may hold the picture file that the texture was
//! read from ([`encode_picture`]): JPEG files and PNG files of few colours are often smaller than
//! any exact coding of what they decode to, even of every second row and column of it. Coarser
//! levels are made of it as the server makes them.

use super::{
    CodecError, ColourMode,
    bytes::{Reader, Writer},
    colour,
    residual::{Coder, Decoder, Encoder, median_edge},
    runs::Run,
};
use crate::texture::{MipLevel, Texture, level_count, level_size};
use image::{DynamicImage, ImageDecoder as _, ImageFormat, ImageReader};
use std::io::Cursor;
use std::ops::RangeInclusive;

/// Version of texture chunks.
pub const VERSION: u8 = 5;
/// Longer side of the finest level in a texture's first chunk. Larger delays the first useful
/// picture, smaller saves nothing.
pub const COARSE_SIDE: u32 = 64;
/// Largest side of a texture.
pub const MAX_SIDE: u32 = 16_384;
/// Most texels in a chunk: bounds what a forged chunk can make a reader allocate, to about 0.5 GB,
/// or 0.8 of a picture of 16 bits.
pub const MAX_TEXELS: usize = 1 << 26;
/// Most pixels that one byte of a PNG or JPEG file can hold. Deflate makes at most 1,032 bytes of
/// one, of eight 1-bit pixels each; JPEG takes at least one bit for the 64 pixels of a block.
pub const PIXELS_PER_BYTE: u64 = 1_032 * 8;

const MAGIC: [u8; 3] = *b"TEX";
/// Texels are coded like LDI colours.
const CODED: u8 = 0;
/// A PNG or JPEG file follows, of which coarser levels are means.
const PICTURE: u8 = 1;
/// The same, with alpha as weight.
const MASKED_PICTURE: u8 = 2;

/// Levels of a texture, decoded: a range of its pyramid.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TextureLevels {
    /// Columns of level 0.
    pub width: u32,
    /// Rows of level 0.
    pub height: u32,
    /// Number of the first entry of `levels`.
    pub first_level: u8,
    /// Finest first.
    pub levels: Vec<MipLevel>,
}

/// The level ranges of a texture's chunks, in the order of sending: first all levels up to
/// [`COARSE_SIDE`], then one finer level each. Empty without texels.
pub fn chunk_ranges(width: u32, height: u32) -> Vec<RangeInclusive<u8>> {
    if width == 0 || height == 0 {
        return Vec::new();
    }
    let last = level_count(width, height) as u8 - 1;
    let coarse = (0..=last).find(|&l| width.max(height) >> l <= COARSE_SIDE).unwrap_or(last);
    std::iter::once(coarse..=last).chain((0..coarse).rev().map(|l| l..=l)).collect()
}

/// Encodes consecutive levels of the pyramid over a base of `width` x `height` texels. `level` is
/// zstd's, 1 to 19.
///
/// # Errors
/// If a level's size is not what the pyramid has there, or there are too many texels.
pub fn encode(texture: &TextureLevels, mode: ColourMode, level: i32) -> Result<Vec<u8>, CodecError> {
    let t = texture;
    let mode_bytes = mode.bytes()?;
    let sizes = sizes(t.width, t.height, t.first_level, t.levels.len())?;
    if let Some(l) =
        t.levels.iter().zip(&sizes).position(|(l, &s)| (l.width, l.height) != s || l.rgba.len() != texels(s))
    {
        return Err(CodecError::mismatch("levels", format!("entry {l} has not the size of its level")));
    }
    let opaque = t.levels.iter().all(|l| l.rgba.iter().all(|p| p[3] == 255));
    let mut w = header((t.width, t.height), t.first_level, t.levels.len() as u8, CODED, level)?;
    w.raw(&mode_bytes);
    w.u8(u8::from(!opaque));
    let walker = colour::Walker::new(mode);
    let mut colours = Encoder::new(colour::STREAMS);
    let mut alphas = Encoder::new(1);
    for l in &t.levels {
        let mut rgb: Vec<[u8; 3]> = l.rgba.iter().map(|p| [p[0], p[1], p[2]]).collect();
        walker.walk(&rows((l.width, l.height)), l.width, &mut rgb, &mut colours);
        if !opaque {
            walk_alpha(l.width, &mut l.rgba.clone(), &mut alphas);
        }
    }
    colours.finish(&mut w, "colours")?;
    if !opaque {
        alphas.finish(&mut w, "alpha")?;
    }
    Ok(w.bytes)
}

/// The finest `count` levels of a texture as the `file`, PNG or JPEG, that its `width` x `height`
/// texels were decoded from; `masked` as in [`Texture::from_base`]. What [`decode`] makes of a
/// JPEG file may differ by a code from processor to processor.
///
/// # Errors
/// If there are too many texels, or not so many levels.
pub fn encode_picture(width: u32, height: u32, count: u8, masked: bool, file: &[u8]) -> Result<Vec<u8>, CodecError> {
    sizes(width, height, 0, count.into())?;
    let mut w = header((width, height), 0, count, if masked { MASKED_PICTURE } else { PICTURE }, 1)?;
    w.raw(file);
    Ok(w.bytes)
}

fn header((width, height): (u32, u32), first_level: u8, count: u8, form: u8, level: i32) -> Result<Writer, CodecError> {
    let mut w = Writer::new(level)?;
    w.raw(&MAGIC);
    w.u8(VERSION);
    w.u32(width);
    w.u32(height);
    w.u8(first_level);
    w.u8(count);
    w.u8(form);
    Ok(w)
}

/// Decodes a chunk. Whether it is the chunk that was asked for is for the caller to compare.
///
/// # Errors
/// If anything is missing, out of range or left over.
pub fn decode(bytes: &[u8]) -> Result<TextureLevels, CodecError> {
    let mut r = Reader::new(bytes);
    r.magic("texture", MAGIC, VERSION)?;
    let (width, height) = (r.u32("width")?, r.u32("height")?);
    let (first_level, count) = (r.u8("first level")?, r.u8("levels")?);
    let sizes = sizes(width, height, first_level, count.into())?;
    let levels = match r.u8("form")? {
        CODED => coded_levels(r, &sizes)?,
        form @ (PICTURE | MASKED_PICTURE) if first_level == 0 => {
            let base = picture(r.take(r.remaining(), "picture")?, width, height)?;
            Texture::finest(base, form == MASKED_PICTURE, count.into()).levels.into_iter().flatten().collect()
        }
        other => return Err(CodecError::range("form", other, "it is 0, or 1 or 2 with levels from 0 on")),
    };
    Ok(TextureLevels { width, height, first_level, levels })
}

/// A PNG or JPEG file of this size. Both are known to be within [`MAX_TEXELS`].
fn picture(file: &[u8], width: u32, height: u32) -> Result<MipLevel, CodecError> {
    let fault = |e: image::ImageError| CodecError::mismatch("picture", e.to_string());
    if texels((width, height)) as u64 > file.len() as u64 * PIXELS_PER_BYTE {
        return Err(CodecError::mismatch("picture", format!("{} bytes hold no {width} x {height} pixels", file.len())));
    }
    let format = image::guess_format(file).map_err(fault)?;
    if !matches!(format, ImageFormat::Png | ImageFormat::Jpeg) {
        return Err(CodecError::mismatch("picture", format!("it is {format:?}, neither PNG nor JPEG")));
    }
    let mut reader = ImageReader::with_format(Cursor::new(file), format);
    let mut limits = image::Limits::no_limits();
    // 16 bits in each of four channels.
    limits.max_alloc = Some(texels((width, height)) as u64 * 8);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(fault)?;
    if decoder.dimensions() != (width, height) {
        let (w, h) = decoder.dimensions();
        return Err(CodecError::mismatch("picture", format!("it has {w} x {h} pixels, the level {width} x {height}")));
    }
    let rgba = DynamicImage::from_decoder(decoder).map_err(fault)?.into_rgba8();
    Ok(MipLevel { width, height, rgba: rgba.as_raw().as_chunks::<4>().0.to_vec() })
}

/// Levels of these sizes.
fn coded_levels(mut r: Reader<'_>, sizes: &[(u32, u32)]) -> Result<Vec<MipLevel>, CodecError> {
    let mode = ColourMode::read(&mut r)?;
    let alpha = r.u8("alpha flag")?;
    if alpha > 1 {
        return Err(CodecError::range("alpha flag", alpha, "it is 0 or 1"));
    }
    let total = sizes.iter().map(|&s| texels(s)).sum::<usize>();
    let mut colours = Decoder::new(&mut r, "colours", colour::STREAMS, total * 3)?;
    let mut alphas = if alpha == 1 { Some(Decoder::new(&mut r, "alpha", 1, total)?) } else { None };
    r.finish("texture")?;
    let walker = colour::Walker::new(mode);
    let mut levels = Vec::with_capacity(sizes.len());
    for &size in sizes {
        let mut rgb = vec![[0; 3]; texels(size)];
        walker.walk(&rows(size), size.0, &mut rgb, &mut colours);
        let mut rgba: Vec<[u8; 4]> = rgb.iter().map(|&[r, g, b]| [r, g, b, 255]).collect();
        if let Some(alphas) = &mut alphas {
            walk_alpha(size.0, &mut rgba, alphas);
        }
        levels.push(MipLevel { width: size.0, height: size.1, rgba });
    }
    colours.finish("colours")?;
    if let Some(alphas) = alphas {
        alphas.finish("alpha")?;
    }
    Ok(levels)
}

/// Bytes that decoded levels take in memory, for [`crate::index::ChunkEntry::decoded_bytes`].
pub fn decoded_bytes(texture: &TextureLevels) -> usize {
    texture.levels.iter().map(|l| size_of_val(&l.rgba[..]) + size_of::<MipLevel>()).sum()
}

fn texels((width, height): (u32, u32)) -> usize {
    width as usize * height as usize
}

fn rows((width, height): (u32, u32)) -> Vec<Run> {
    (0..height).map(|row| Run { row, column: 0, count: width }).collect()
}

/// Sizes of `count` levels from `first` on, if the pyramid has them and they are few enough to
/// allocate.
fn sizes(width: u32, height: u32, first: u8, count: usize) -> Result<Vec<(u32, u32)>, CodecError> {
    for (field, side) in [("width", width), ("height", height)] {
        if !(1..=MAX_SIDE).contains(&side) {
            return Err(CodecError::range(field, side, "textures have 1 to 16384 columns and rows"));
        }
    }
    let levels = level_count(width, height) as usize;
    if count == 0 || usize::from(first) + count > levels {
        return Err(CodecError::range("levels", count, "the pyramid has not that many"));
    }
    let sizes: Vec<_> = (0..count).map(|k| level_size(width, height, u32::from(first) + k as u32)).collect();
    let total: usize = sizes.iter().map(|&s| texels(s)).sum();
    if total > MAX_TEXELS {
        return Err(CodecError::range("texels", total, "a chunk holds at most 2^26"));
    }
    Ok(sizes)
}

fn walk_alpha(width: u32, rgba: &mut [[u8; 4]], coder: &mut impl Coder) {
    let mut above = vec![255i32; width as usize];
    for row in rgba.chunks_exact_mut(width as usize) {
        let mut corner = above[0];
        let mut left = corner;
        for (texel, up) in row.iter_mut().zip(&mut above) {
            let (_, alpha) = coder.byte::<true>(0, 1, median_edge(left, *up, corner), texel[3].into());
            texel[3] = alpha as u8;
            corner = *up;
            left = alpha;
            *up = alpha;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::ColourProfile;
    use proptest::prelude::*;

    fn pyramid(width: u32, height: u32, transparent: bool) -> Vec<MipLevel> {
        let rgba = (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                [
                    (x * 5) as u8,
                    (x ^ y) as u8,
                    (y * 3) as u8,
                    if transparent && (x / 3 + y) % 4 == 0 { 17 } else { 255 },
                ]
            })
            .collect();
        Texture::from_base(MipLevel { width, height, rgba }, true).levels.into_iter().flatten().collect()
    }

    fn chunks(width: u32, height: u32, levels: &[MipLevel], mode: ColourMode) -> Vec<(TextureLevels, Vec<u8>)> {
        chunk_ranges(width, height)
            .into_iter()
            .map(|range| {
                let (first, last) = (*range.start(), *range.end());
                let levels = levels[usize::from(first)..=usize::from(last)].to_vec();
                let t = TextureLevels { width, height, first_level: first, levels };
                let bytes = encode(&t, mode, 3).unwrap();
                (t, bytes)
            })
            .collect()
    }

    #[test]
    fn ranges_cover_every_level_once_coarse_first() {
        assert_eq!(chunk_ranges(256, 100), vec![2..=8, 1..=1, 0..=0]);
        assert_eq!(chunk_ranges(64, 64), vec![0..=6]);
        assert_eq!(chunk_ranges(1, 1), vec![0..=0]);
        assert_eq!(chunk_ranges(130, 1), vec![2..=7, 1..=1, 0..=0]);
        assert!(chunk_ranges(0, 5).is_empty());
    }

    #[test]
    fn alpha_is_exact_and_absent_when_opaque() {
        let levels = pyramid(90, 70, true);
        for (t, bytes) in chunks(90, 70, &levels, ColourProfile::Compact.of_textures()) {
            let out = decode(&bytes).unwrap();
            assert_ne!(out, t);
            for (a, b) in t.levels.iter().zip(&out.levels) {
                assert!(a.rgba.iter().zip(&b.rgba).all(|(a, b)| a[3] == b[3]));
                assert!(a.rgba.iter().zip(&b.rgba).all(|(a, b)| (0..3).all(|k| a[k].abs_diff(b[k]) <= 4)));
            }
        }
        let transparent: usize = chunks(90, 70, &levels, ColourMode::LOSSLESS).iter().map(|c| c.1.len()).sum();
        let opaque = pyramid(90, 70, false);
        let opaque: usize = chunks(90, 70, &opaque, ColourMode::LOSSLESS).iter().map(|c| c.1.len()).sum();
        assert!(opaque < transparent);
    }

    #[test]
    fn truncation_and_damage_never_panic() {
        for (_, bytes) in chunks(90, 70, &pyramid(90, 70, true), ColourMode::LOSSLESS) {
            for n in 0..bytes.len() {
                assert!(decode(&bytes[..n]).is_err(), "cut at {n}");
            }
            for i in 0..2000usize {
                let mut damaged = bytes.clone();
                let at = i * 7919 % bytes.len();
                damaged[at] ^= 1 + (i % 255) as u8;
                if let Ok(t) = decode(&damaged) {
                    assert!(sizes(t.width, t.height, t.first_level, t.levels.len()).is_ok());
                }
            }
        }
    }

    /// A picture file of these texels, without their alpha as JPEG.
    fn file(width: u32, height: u32, rgba: &[[u8; 4]], format: ImageFormat) -> Vec<u8> {
        let picture = image::RgbaImage::from_raw(width, height, rgba.as_flattened().to_vec()).unwrap();
        let mut out = Cursor::new(Vec::new());
        match format {
            ImageFormat::Jpeg => DynamicImage::from(picture).into_rgb8().write_to(&mut out, format),
            _ => picture.write_to(&mut out, format),
        }
        .unwrap();
        out.into_inner()
    }

    #[test]
    fn a_picture_file_gives_the_finest_levels() {
        let levels = pyramid(90, 70, true);
        let png = file(90, 70, &levels[0].rgba, ImageFormat::Png);
        for count in 1..=7 {
            let out = decode(&encode_picture(90, 70, count, true, &png).unwrap()).unwrap();
            let levels = levels[..count.into()].to_vec();
            assert_eq!(out, TextureLevels { width: 90, height: 70, first_level: 0, levels });
        }
        let plain = decode(&encode_picture(90, 70, 2, false, &png).unwrap()).unwrap();
        assert!(plain.levels[0] == levels[0] && plain.levels[1] != levels[1], "not weighted by alpha");

        let jpeg = file(90, 70, &levels[0].rgba, ImageFormat::Jpeg);
        let out = decode(&encode_picture(90, 70, 1, false, &jpeg).unwrap()).unwrap();
        let mean = |rgba: &[[u8; 4]], k: usize| rgba.iter().map(|p| f64::from(p[k])).sum::<f64>() / rgba.len() as f64;
        for k in 0..3 {
            assert!((mean(&out.levels[0].rgba, k) - mean(&levels[0].rgba, k)).abs() < 2.0);
        }
        assert!(out.levels[0].rgba.iter().all(|p| p[3] == 255));
    }

    #[test]
    fn pictures_of_another_size_kind_or_level_are_refused() {
        let levels = pyramid(90, 70, false);
        let png = file(90, 70, &levels[0].rgba, ImageFormat::Png);
        let refusal = |width, height, file: &[u8]| {
            decode(&encode_picture(width, height, 1, false, file).unwrap()).expect_err("refused").to_string()
        };
        assert!(refusal(70, 90, &png).contains("90 x 70 pixels, the level 70 x 90"));
        assert!(refusal(90, 70, b"GIF89a and more").contains("Gif"));
        assert!(refusal(8000, 8000, &png).contains("bytes hold no 8000 x 8000 pixels"));
        assert!(refusal(90, 70, b"").contains("picture"));
        for (width, height, count) in [(0, 70, 1), (MAX_SIDE, MAX_SIDE, 1), (90, 70, 0), (90, 70, 8)] {
            assert!(encode_picture(width, height, count, false, &png).is_err());
        }
        for (at, value) in [(12, 1), (14, 3)] {
            let mut bytes = encode_picture(90, 70, 1, false, &png).unwrap();
            bytes[at] = value;
            assert!(decode(&bytes).unwrap_err().to_string().starts_with("form is"), "byte {at}");
        }
    }

    #[test]
    fn damaged_pictures_never_panic() {
        let levels = pyramid(90, 70, true);
        for format in [ImageFormat::Png, ImageFormat::Jpeg] {
            let bytes = encode_picture(90, 70, 3, true, &file(90, 70, &levels[0].rgba, format)).unwrap();
            for n in 0..bytes.len() {
                assert!(n > 15 + 100 || decode(&bytes[..n]).is_err(), "cut at {n}");
            }
            for i in 0..4000usize {
                let mut damaged = bytes.clone();
                damaged[i * 7919 % bytes.len()] ^= 1 + (i % 255) as u8;
                if let Ok(t) = decode(&damaged) {
                    assert!(t.levels.iter().all(|l| l.rgba.len() == l.width as usize * l.height as usize));
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn lossless_comes_back(width in 1u32..200, height in 1u32..90, transparent in any::<bool>()) {
            for (t, bytes) in chunks(width, height, &pyramid(width, height, transparent), ColourMode::LOSSLESS) {
                prop_assert_eq!(decode(&bytes).unwrap(), t);
            }
        }
        #[test]
        fn any_bytes_are_survived(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let mut with_magic = [&MAGIC[..], &[VERSION]].concat();
            with_magic.extend(bytes);
            let _ = decode(&with_magic);
        }
    }
}
