//! Pictures: encoded bytes in, sRGB texels out.
//!
//! Read: PNG, JPEG, WebP, GIF, BMP, TIFF, TGA, PNM, ICO, QOI (the crate `image`), DDS and PCX
//! (`image-extras` of the same project), JPEG 2000 (`hayro-jpeg2000`), Basis Universal in KTX2 or
//! alone (`basisu`). What a picture is its bytes say, not its name.
//!
//! Sizes are read from all headers first and compared with the limits, one by one and together;
//! only then are the pictures decoded, in parallel, in order. A header which promises more than
//! its bytes can hold ([`PIXELS_PER_BYTE`]) is refused before its picture is allocated.

use std::borrow::Cow;
use std::io::Cursor;

use basisu::{DecodeFlags, TargetFormat, Transcoder};
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, RgbaImage};
use image_extras::{dds::DdsDecoder, pcx::PCXDecoder};
use ldi_protocol::codec::texture::PIXELS_PER_BYTE;
use ldi_protocol::mesh::{Alpha, Material};
use ldi_protocol::texture::{MipLevel, Texture};
use rayon::prelude::*;

use super::error::Fault;
use super::files::Files;
use super::guard::guarded;
use super::limits::Limits;
use super::model::{Note, Scene, SceneTexture};

/// Bytes of one decoded pixel while decoding: 16 bits in each of four channels.
const BYTES_PER_PIXEL: u64 = 8;
/// Pixels that a picture may have however few its bytes are: one of a single colour takes 40 bytes
/// in WebP. Not for PNG and JPEG, whose bound is known.
const FREE_PIXELS: u64 = 1 << 20;
/// Most pixels of a JPEG 2000 picture: decoding takes several floats for each channel of each.
const MOST_JPEG_2000: u64 = 1 << 26;

/// A picture as the scene file has it.
#[derive(Debug)]
pub(super) struct EncodedImage<'a> {
    /// Name for people.
    pub(super) name: String,
    /// Where it comes from, for messages.
    pub(super) place: String,
    /// The encoded picture; None where it could not be read and need not be.
    pub(super) bytes: Option<Cow<'a, [u8]>>,
    /// Whether something that is drawn shows it.
    pub(super) needed: bool,
}

/// A picture that cannot be read: what it is multiplied with shows.
const PLAIN: [u8; 4] = [255; 4];

/// Decodes all pictures, in order; those that were not read or cannot be decoded are plain.
/// Whether that is a fault is for [`Files::verdict`].
pub(super) fn decode_all(images: &[EncodedImage<'_>], files: &mut Files, limits: &Limits) -> Vec<SceneTexture> {
    let mut pixels_left = limits.image_pixels;
    let mut sound = Vec::with_capacity(images.len());
    for image in images {
        let checked = match image.bytes {
            None => None,
            Some(_) => files.dispensable(image.check(pixels_left, limits), image.needed),
        };
        pixels_left -= checked.unwrap_or(0);
        sound.push(checked.is_some());
    }
    let decoded: Vec<Option<Result<SceneTexture, Fault>>> =
        images.par_iter().zip(&sound).map(|(image, sound)| sound.then(|| image.decode(limits))).collect();
    let texture = |(image, decoded): (&EncodedImage<'_>, Option<Result<SceneTexture, Fault>>)| {
        let plain =
            || SceneTexture { name: image.name.clone(), width: 1, height: 1, rgba: vec![PLAIN], file: Vec::new() };
        decoded.and_then(|d| files.dispensable(d, image.needed)).unwrap_or_else(plain)
    };
    images.iter().zip(decoded).map(texture).collect()
}

const REMEDY: &str = "open the image in an editor and save it as PNG or JPEG again";
const CONVERT: &str = "convert the image to PNG or JPEG";

/// Who decodes a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Codec {
    Usual(ImageFormat),
    Dds,
    Pcx,
    Jpeg2000,
    Basis,
}

/// Pictures that are not read, by their first bytes.
const FOREIGN: [(&[u8], &str); 10] = [
    (b"8BPS", "a Photoshop file"),
    (b"#?R", "a Radiance picture (.hdr), whose light has no upper end"),
    (b"\x76\x2f\x31\x01", "an OpenEXR picture, whose light has no upper end"),
    (b"gimp xcf", "a GIMP file"),
    (b"\xabKTX 11", "a KTX 1 texture"),
    (b"\xff\x0a", "a JPEG XL picture"),
    (b"\0\0\0\x0cJXL ", "a JPEG XL picture"),
    (b"%PDF", "a PDF file"),
    (b"<svg", "an SVG drawing"),
    (b"<?xml", "an SVG drawing"),
];

impl Codec {
    fn of(bytes: &[u8]) -> Result<Self, String> {
        use ImageFormat::{Bmp, Gif, Ico, Jpeg, Png, Pnm, Qoi, Tga, Tiff, WebP};
        match image::guess_format(bytes) {
            Ok(format @ (Png | Jpeg | WebP | Gif | Bmp | Tiff | Pnm | Ico | Qoi)) => return Ok(Self::Usual(format)),
            Ok(ImageFormat::Dds) => return Ok(Self::Dds),
            _ => {}
        }
        if bytes.starts_with(b"\0\0\0\x0cjP  ") || bytes.starts_with(b"\xff\x4f\xff\x51") {
            return Ok(Self::Jpeg2000);
        }
        if bytes.starts_with(b"\xabKTX 20\xbb\r\n\x1a\n") || bytes.starts_with(b"sB") {
            return Ok(Self::Basis);
        }
        if let Some((_, what)) = FOREIGN.iter().find(|f| bytes.starts_with(f.0)) {
            return Err(format!("image is {what}, which is not read"));
        }
        if bytes.get(4..8) == Some(b"ftyp") {
            return Err("image is an AVIF or HEIF picture, which is not read".into());
        }
        match bytes {
            [0x0a, version @ 0..=5, 0..=1, 1 | 2 | 4 | 8, ..] if *version != 1 && bytes.len() >= 128 => Ok(Self::Pcx),
            // No word at the start tells a TGA file; its fields bind one another.
            [_, 0, 2 | 3 | 10 | 11, 0, 0, 0, 0, 0, _, _, _, _, w, w2, h, h2, 8 | 15 | 16 | 24 | 32, ..]
            | [_, 1, 1 | 9, _, _, _, _, 8 | 15 | 16 | 24 | 32, _, _, _, _, w, w2, h, h2, 8 | 16, ..]
            | [_, 0 | 1, 2 | 3 | 10 | 11, _, _, _, _, _, _, _, _, _, w, w2, h, h2, 8 | 15 | 16 | 24 | 32, ..]
                if (w | w2) != 0 && (h | h2) != 0 =>
            {
                Ok(Self::Usual(Tga))
            }
            _ => Err("image is of no format that is read".into()),
        }
    }
}

impl EncodedImage<'_> {
    fn encoded(&self) -> &[u8] {
        let bytes = self.bytes.as_deref().unwrap_or_default();
        png_of_icon(bytes).unwrap_or(bytes)
    }

    fn codec(&self) -> Result<Codec, Fault> {
        Codec::of(self.encoded()).map_err(|problem| Fault::unsupported(&self.place, problem, CONVERT))
    }

    fn undecodable(&self, error: &dyn std::fmt::Display) -> Fault {
        Fault::invalid(&self.place, format!("image cannot be decoded: {error}"), REMEDY)
    }

    /// Pixels, of at most `pixels_left`.
    fn check(&self, pixels_left: u64, limits: &Limits) -> Result<u64, Fault> {
        let codec = self.codec()?;
        let (width, height) = match codec {
            Codec::Basis => guarded(&self.place, || Ok(self.basis()?.base_dimensions()))?,
            _ => guarded(&self.place, || Ok(self.decoder(codec, limits)?.dimensions()))?,
        };
        let pixels = u64::from(width) * u64::from(height);
        if width == 0 || height == 0 {
            return Err(Fault::invalid(&self.place, "image has no pixels", REMEDY));
        }
        if width.max(height) > limits.image_side {
            let size = format!("{width} x {height}");
            return Err(Fault::too_large(&self.place, "pixels in an image, whose sides", size, limits.image_side));
        }
        let bound_is_known = matches!(codec, Codec::Usual(ImageFormat::Png | ImageFormat::Jpeg));
        let free = if bound_is_known { 0 } else { FREE_PIXELS };
        if pixels > free.max(self.encoded().len() as u64 * PIXELS_PER_BYTE) {
            let problem =
                format!("header promises {width} x {height} pixels, more than {} bytes can hold", self.encoded().len());
            return Err(Fault::invalid(&self.place, problem, REMEDY));
        }
        if codec == Codec::Jpeg2000 && pixels > MOST_JPEG_2000 {
            return Err(Fault::too_large(&self.place, "pixels in a JPEG 2000 picture", pixels, MOST_JPEG_2000));
        }
        match pixels <= pixels_left {
            true => Ok(pixels),
            false => {
                let (what, most) = ("or more pixels in all images together", limits.image_pixels);
                Err(Fault::too_large(&self.place, what, most, most))
            }
        }
    }

    fn decoder(&self, codec: Codec, limits: &Limits) -> Result<Box<dyn ImageDecoder + '_>, Fault> {
        let bytes = Cursor::new(self.encoded());
        let undecodable = |e: image::ImageError| self.undecodable(&e);
        // Sides are compared by the caller, whose message is better; this one bounds what the
        // decoder may allocate.
        let mut allowed = image::Limits::no_limits();
        allowed.max_alloc = Some(u64::from(limits.image_side).pow(2) * BYTES_PER_PIXEL);
        Ok(match codec {
            Codec::Usual(format) => {
                let mut reader = ImageReader::with_format(bytes, format);
                reader.limits(allowed);
                Box::new(reader.into_decoder().map_err(undecodable)?)
            }
            Codec::Dds => Box::new(DdsDecoder::new(bytes).map_err(undecodable)?),
            Codec::Pcx => Box::new(PCXDecoder::new(bytes).map_err(undecodable)?),
            Codec::Jpeg2000 | Codec::Basis => {
                let settings = hayro_jpeg2000::DecodeSettings::default();
                let picture = hayro_jpeg2000::Image::new(self.encoded(), &settings);
                Box::new(picture.map_err(|e| self.undecodable(&e))?)
            }
        })
    }

    fn basis(&self) -> Result<Transcoder<'_>, Fault> {
        Transcoder::new(self.encoded()).map_err(|e| {
            let problem = format!("image is no texture of Basis Universal, the only kind of KTX2 that is read: {e:?}");
            Fault::unsupported(&self.place, problem, CONVERT)
        })
    }

    fn decode(&self, limits: &Limits) -> Result<SceneTexture, Fault> {
        let codec = self.codec()?;
        let image = guarded(&self.place, || match codec {
            Codec::Basis => {
                let basis = self.basis()?;
                let (width, height) = basis.base_dimensions();
                let texels = basis.transcode(0, TargetFormat::Rgba32, DecodeFlags::NONE);
                let texels = texels.map_err(|e| self.undecodable(&format!("{e:?}")))?;
                RgbaImage::from_raw(width, height, texels).ok_or_else(|| self.undecodable(&"texels are missing"))
            }
            _ => {
                let image = DynamicImage::from_decoder(self.decoder(codec, limits)?);
                Ok(image.map_err(|e| self.undecodable(&e))?.into_rgba8())
            }
        })?;
        let (width, height) = image.dimensions();
        let rgba = image.as_raw().as_chunks::<4>().0.to_vec();
        // Datasets hold pictures of these two formats alone as they are.
        let file = match codec {
            Codec::Usual(ImageFormat::Png | ImageFormat::Jpeg) => self.encoded().to_vec(),
            _ => Vec::new(),
        };
        Ok(SceneTexture { name: self.name.clone(), width, height, rgba, file })
    }
}

/// The largest picture of an icon, if it is a PNG file: the icon decoder takes only those with
/// alpha.
fn png_of_icon(bytes: &[u8]) -> Option<&[u8]> {
    let count = bytes.strip_prefix(&[0, 0, 1, 0])?.first_chunk::<2>()?;
    let entries = bytes.get(6..)?.as_chunks::<16>().0.iter().take(u16::from_le_bytes(*count).into());
    // 0 stands for 256.
    let largest = entries.max_by_key(|e| e[0].wrapping_sub(1))?;
    let number =
        |at: usize| u32::from_le_bytes([largest[at], largest[at + 1], largest[at + 2], largest[at + 3]]) as usize;
    let (length, offset) = (number(8), number(12));
    let picture = bytes.get(offset..offset.checked_add(length)?)?;
    picture.starts_with(b"\x89PNG").then_some(picture)
}

/// A colour texture (or white) with its alpha from a mask: the mask's alpha where it has any, else
/// its luminance. As large as the larger of the two along each axis; the smaller one is repeated
/// texel by texel.
pub(super) fn masked(colour: Option<&SceneTexture>, mask: &SceneTexture) -> SceneTexture {
    let by_alpha = mask.rgba.iter().any(|texel| texel[3] < 255);
    let opacity = |[r, g, b, a]: [u8; 4]| match by_alpha {
        true => a,
        // Weights of ITU-R BT.601, which sum to 256.
        false => ((77 * u32::from(r) + 150 * u32::from(g) + 29 * u32::from(b)) >> 8) as u8,
    };
    let width = colour.map_or(1, |c| c.width).max(mask.width);
    let height = colour.map_or(1, |c| c.height).max(mask.height);
    let texel = |from: &SceneTexture, x: u32, y: u32| {
        let scaled = |at: u32, of: u32, to: u32| (u64::from(at) * u64::from(to) / u64::from(of)) as usize;
        from.rgba[scaled(y, height, from.height) * from.width as usize + scaled(x, width, from.width)]
    };
    let at = |(x, y)| {
        let [r, g, b, _] = colour.map_or(PLAIN, |c| texel(c, x, y));
        [r, g, b, opacity(texel(mask, x, y))]
    };
    let rgba = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(at).collect();
    let name = colour.map_or_else(|| mask.name.clone(), |c| format!("{} masked by {}", c.name, mask.name));
    SceneTexture { name, width, height, rgba, file: Vec::new() }
}

/// Halves every texture of more than `most` texels, columns times rows, until it has no more.
/// Gives a note for each.
pub(super) fn halved_to(scene: &mut Scene, most: usize) -> Vec<Note> {
    let mut notes = Vec::new();
    let is_masked = |number: usize| {
        let shows = |m: &Material| m.texture == Some(number as u32) && m.alpha != Alpha::Opaque;
        scene.materials.iter().any(shows)
    };
    let masked: Vec<bool> = (0..scene.textures.len()).map(is_masked).collect();
    for (t, masked) in scene.textures.iter_mut().zip(masked) {
        if t.width as usize * t.height as usize <= most {
            continue;
        }
        let base = MipLevel { width: t.width, height: t.height, rgba: std::mem::take(&mut t.rgba) };
        let levels = Texture::from_base(base, masked).levels.into_iter().flatten();
        let fits = |l: &MipLevel| l.width as usize * l.height as usize <= most;
        if let Some(level) = levels.into_iter().find(fits) {
            let what = format!("texture {} of {} x {} texels", t.name, t.width, t.height);
            notes.push(Note { what, why: format!("shown with {} x {}", level.width, level.height) });
            (t.width, t.height, t.rgba, t.file) = (level.width, level.height, level.rgba, Vec::new());
        }
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textures_are_halved_until_they_fit() {
        let texture = |width: u32, height: u32| SceneTexture {
            width,
            height,
            rgba: vec![[10, 20, 30, 255]; (width * height) as usize],
            file: vec![1],
            ..SceneTexture::default()
        };
        let mut scene = Scene { textures: vec![texture(8, 8), texture(64, 8), texture(9, 8)], ..Scene::default() };
        let notes = halved_to(&mut scene, 64);
        let sizes: Vec<_> = scene.textures.iter().map(|t| (t.width, t.height, t.rgba.len(), t.file.len())).collect();
        assert_eq!(sizes, [(8, 8, 64, 1), (16, 2, 32, 0), (4, 4, 16, 0)]);
        assert!(scene.textures.iter().flat_map(|t| &t.rgba).all(|texel| *texel == [10, 20, 30, 255]));
        assert!(notes.len() == 2 && notes[0].what.contains("64 x 8") && notes[0].why.contains("16 x 2"), "{notes:?}");
    }

    #[test]
    fn masks_give_alpha_by_alpha_or_luminance() {
        let texture = |width, rgba: Vec<[u8; 4]>| SceneTexture { width, height: 1, rgba, ..SceneTexture::default() };
        let red = texture(1, vec![[255, 0, 0, 255]]);
        let grey = texture(2, vec![[0, 0, 0, 255], [255, 255, 255, 255]]);
        assert_eq!(masked(Some(&red), &grey).rgba, [[255, 0, 0, 0], [255, 0, 0, 255]]);
        let cut = texture(2, vec![[255, 255, 255, 0], [255, 255, 255, 200]]);
        assert_eq!(masked(None, &cut).rgba, [[255, 255, 255, 0], [255, 255, 255, 200]]);
    }

    #[test]
    fn pictures_are_known_by_their_bytes() {
        let tga = [0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 16, 0, 16, 0, 24, 0, 1, 2, 3];
        assert_eq!(Codec::of(&tga), Ok(Codec::Usual(ImageFormat::Tga)));
        assert!(Codec::of(b"8BPS\0\x01").unwrap_err().contains("Photoshop"));
        assert!(Codec::of(&[7; 100]).unwrap_err().contains("no format"));
        assert!(Codec::of(b"").is_err());
    }
}
