//! Pictures: PNG and JPEG bytes in, sRGB texels out.
//!
//! Sizes are read from all headers first and compared with the limits, one by one and together;
//! only then are the pictures decoded, in parallel, in order. A header which promises more than
//! its bytes can hold ([`PIXELS_PER_BYTE`]) is refused before its picture is allocated.

use std::borrow::Cow;
use std::io::Cursor;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};
use ldi_protocol::codec::texture::PIXELS_PER_BYTE;
use rayon::prelude::*;

use super::error::Fault;
use super::files::Files;
use super::limits::Limits;
use super::model::SceneTexture;

/// Bytes of one decoded pixel while decoding: 16 bits in each of four channels.
const BYTES_PER_PIXEL: u64 = 8;

/// A picture as the scene file has it.
#[derive(Debug)]
pub(super) struct EncodedImage<'a> {
    /// Name for people.
    pub(super) name: String,
    /// Where it comes from, for messages.
    pub(super) place: String,
    /// PNG or JPEG; None where it could not be read and need not be.
    pub(super) bytes: Option<Cow<'a, [u8]>>,
}

/// A picture that cannot be read: what it is multiplied with shows.
const PLAIN: [u8; 4] = [255; 4];

/// Decodes all pictures, in order; those that were not read, and with [`Files::lenient`] those
/// that cannot be decoded, are plain.
pub(super) fn decode_all(
    images: &[EncodedImage<'_>],
    files: &mut Files,
    limits: &Limits,
) -> Result<Vec<SceneTexture>, Fault> {
    let mut pixels_left = limits.image_pixels;
    let mut sound = Vec::with_capacity(images.len());
    for image in images {
        let checked = match image.bytes {
            None => None,
            Some(_) => files.dispensable(image.check(pixels_left, limits))?,
        };
        pixels_left -= checked.unwrap_or(0);
        sound.push(checked.is_some());
    }
    let decoded: Vec<Option<Result<SceneTexture, Fault>>> =
        images.par_iter().zip(&sound).map(|(image, sound)| sound.then(|| image.decode(limits))).collect();
    let texture = |(image, decoded): (&EncodedImage<'_>, Option<Result<SceneTexture, Fault>>)| {
        let plain =
            || SceneTexture { name: image.name.clone(), width: 1, height: 1, rgba: vec![PLAIN], file: Vec::new() };
        Ok(decoded.map(|d| files.dispensable(d)).transpose()?.flatten().unwrap_or_else(plain))
    };
    images.iter().zip(decoded).map(texture).collect()
}

const REMEDY: &str = "open the image in an editor and save it as PNG or JPEG again";

impl EncodedImage<'_> {
    fn encoded(&self) -> &[u8] {
        self.bytes.as_deref().unwrap_or_default()
    }

    /// Pixels, of at most `pixels_left`.
    fn check(&self, pixels_left: u64, limits: &Limits) -> Result<u64, Fault> {
        let (width, height) = self.decoder(limits)?.dimensions();
        let pixels = u64::from(width) * u64::from(height);
        if width == 0 || height == 0 {
            return Err(Fault::invalid(&self.place, "image has no pixels", REMEDY));
        }
        if width.max(height) > limits.image_side {
            let size = format!("{width} x {height}");
            return Err(Fault::too_large(&self.place, "pixels in an image, whose sides", size, limits.image_side));
        }
        if pixels > self.encoded().len() as u64 * PIXELS_PER_BYTE {
            let problem =
                format!("header promises {width} x {height} pixels, more than {} bytes can hold", self.encoded().len());
            return Err(Fault::invalid(&self.place, problem, REMEDY));
        }
        match pixels <= pixels_left {
            true => Ok(pixels),
            false => {
                let (what, most) = ("or more pixels in all images together", limits.image_pixels);
                Err(Fault::too_large(&self.place, what, most, most))
            }
        }
    }

    fn decoder(&self, limits: &Limits) -> Result<impl ImageDecoder + '_, Fault> {
        let format = match image::guess_format(self.encoded()) {
            Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => format,
            Ok(other) => {
                let problem = format!("image format {other:?} is not read");
                return Err(Fault::unsupported(&self.place, problem, "convert the image to PNG or JPEG"));
            }
            Err(_) => {
                let problem = "image is neither PNG nor JPEG";
                return Err(Fault::unsupported(&self.place, problem, "convert the image to PNG or JPEG"));
            }
        };
        let mut reader = ImageReader::with_format(Cursor::new(self.encoded()), format);
        let mut allowed = image::Limits::no_limits();
        // Sides are compared by the caller, whose message is better; this one bounds what the
        // decoder may allocate.
        allowed.max_alloc = Some(u64::from(limits.image_side).pow(2) * BYTES_PER_PIXEL);
        reader.limits(allowed);
        reader.into_decoder().map_err(|e| self.undecodable(&e))
    }

    fn decode(&self, limits: &Limits) -> Result<SceneTexture, Fault> {
        let image = DynamicImage::from_decoder(self.decoder(limits)?).map_err(|e| self.undecodable(&e))?.into_rgba8();
        let (width, height) = image.dimensions();
        let rgba = image.as_raw().as_chunks::<4>().0.to_vec();
        Ok(SceneTexture { name: self.name.clone(), width, height, rgba, file: self.encoded().to_vec() })
    }

    fn undecodable(&self, error: &image::ImageError) -> Fault {
        Fault::invalid(&self.place, format!("image cannot be decoded: {error}"), REMEDY)
    }
}
