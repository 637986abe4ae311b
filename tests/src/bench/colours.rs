//! Colour profiles: bytes per sample against error.
//!
//! In: views of a dataset with exact colours. Out: a [`ColourRow`] per profile. The images of the
//! views are coded anew in each profile, decoded, and drawn in the place of the exact ones;
//! nothing else differs.

use super::speed_error::{OneView, PLAIN, median, resident};
use anyhow::Result;
use ldi_client::{
    cache::Cache,
    engine::{FrameRenderer, Scores, view_of},
    frame::Frame,
    report::StageMs,
    resident::Resident,
};
use ldi_protocol::{
    OutputCamera,
    codec::{ColourProfile, ldi},
    ldi::Ldi,
    mesh::CellGeometry,
    need::Sight,
    texture::Texture,
    tree::Brood,
};
use ldi_server::{build::IMAGE_LEVEL, store::Dataset};
use serde::Serialize;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Instant,
};

/// A profile over all views of a scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ColourRow {
    /// Scene.
    pub scene: String,
    /// Density of its dataset.
    pub density: f64,
    /// Profile.
    pub profile: &'static str,
    /// Images of the views.
    pub images: usize,
    /// Their samples.
    pub samples: u64,
    /// Their bytes over their samples.
    pub bytes_per_sample: f64,
    /// What of that colours take: the bytes beyond those of the same images in black.
    pub colour_bytes_per_sample: f64,
    /// Millions of samples decoded per second by one thread.
    pub decoded_msamples_per_s: f64,
    /// Decibels lost of the mean over views.
    pub db_lost: f64,
    /// Mean FLIP over that with exact colours.
    pub flip_ratio: f64,
    /// The same over pixels that came from images.
    pub flip_far_ratio: f64,
}

/// A cache whose images are others.
struct Recoded<'a> {
    cache: &'a Cache,
    images: &'a BTreeMap<u32, Arc<Ldi>>,
}

impl Resident for Recoded<'_> {
    fn cell(&self, cell: u32) -> Option<Arc<CellGeometry>> {
        self.cache.cell(cell)
    }
    fn bundle(&self, chunk: u32) -> Option<Arc<CellGeometry>> {
        self.cache.bundle(chunk)
    }
    fn texture(&self, texture: u32) -> Option<Arc<Texture>> {
        self.cache.texture(texture)
    }
    fn ldi(&self, image: u32) -> Option<Arc<Ldi>> {
        self.images.get(&image).cloned()
    }
    fn brood(&self, chunk: u32) -> Option<Arc<Brood>> {
        self.cache.brood(chunk)
    }
}

/// Codes the images of some views in every profile. Nothing, if the dataset's colours are not
/// exact.
///
/// # Errors
/// A dataset that cannot be read.
pub fn compare(scene: &str, dataset: &Dataset, camera: &OutputCamera, views: &[OneView]) -> Result<Vec<ColourRow>> {
    let index = dataset.index();
    if index.settings.colour != ColourProfile::Lossless.name() {
        return Ok(vec![]);
    }
    let options = PLAIN.walk_options((camera.width, camera.height));
    let seen = views
        .iter()
        .map(|v| {
            let view = view_of(index, &v.pose, camera, options.method, &mut StageMs::default());
            Ok((resident(dataset, &view, &Sight::new(&v.pose, camera, 1))?, view))
        })
        .collect::<Result<Vec<_>>>()?;
    let numbers: BTreeSet<u32> = seen.iter().flat_map(|(_, view)| view.images.iter().copied()).collect();
    let exact: BTreeMap<u32, Arc<Ldi>> =
        numbers.iter().filter_map(|n| Some((*n, seen.iter().find_map(|(cache, _)| cache.ldi(*n))?))).collect();
    let samples: u64 = exact.values().map(|l| l.samples() as u64).sum();
    let black = coded(exact.values().map(|l| in_black(l)), ColourProfile::Lossless)?.0;
    let mut rows: Vec<(ColourRow, [f64; 3])> = Vec::new();
    for profile in ColourProfile::ALL {
        let (bytes, seconds, decoded) = coded(exact.values().map(|l| Ldi::clone(l)), profile)?;
        let images = exact.keys().copied().zip(decoded).collect();
        let (mut renderer, mut picture) = (FrameRenderer::default(), Frame::default());
        let verdicts = views
            .iter()
            .zip(&seen)
            .map(|(v, (cache, view))| {
                let shown = Recoded { cache, images: &images };
                renderer.render(index, &shown, view, &v.pose, camera, &options, StageMs::default(), &mut picture)?;
                Ok(v.truth.evaluate(&picture, renderer.full(), None)?)
            })
            .collect::<Result<Vec<_>>>()?;
        let mean = |of: fn(&Scores) -> Option<f64>| {
            let known: Vec<f64> = verdicts.iter().filter_map(of).collect();
            known.iter().sum::<f64>() / known.len().max(1) as f64
        };
        let found = [mean(|v| v.psnr_db), mean(|v| v.flip), mean(|v| v.flip_far)];
        let base = rows.first().map_or(found, |r| r.1);
        let per_sample = |bytes: u64| bytes as f64 / samples.max(1) as f64;
        let row = ColourRow {
            scene: scene.into(),
            density: index.settings.density,
            profile: profile.name(),
            images: exact.len(),
            samples,
            bytes_per_sample: per_sample(bytes),
            colour_bytes_per_sample: per_sample(bytes.saturating_sub(black)),
            decoded_msamples_per_s: samples as f64 / seconds / 1e6,
            db_lost: base[0] - found[0],
            flip_ratio: found[1] / base[1],
            flip_far_ratio: found[2] / base[2],
        };
        rows.push((row, found));
    }
    Ok(rows.into_iter().map(|r| r.0).collect())
}

/// Bytes of images in a profile, seconds to decode them (of three times the median), and what they
/// become.
fn coded(images: impl Iterator<Item = Ldi>, profile: ColourProfile) -> Result<(u64, f64, Vec<Arc<Ldi>>)> {
    let (mut bytes, mut seconds, mut out) = (0, 0.0, Vec::new());
    for image in images {
        let chunks = ldi::encode(&image, profile, IMAGE_LEVEL)?;
        bytes += chunks.iter().map(|c| c.len() as u64).sum::<u64>();
        let mut times = Vec::new();
        let mut decoded = None;
        for _ in 0..3 {
            let start = Instant::now();
            let mut image = ldi::decode_first(&chunks[0])?;
            chunks.get(1).map(|d| ldi::decode_deeper(d, &mut image)).transpose()?;
            times.push(start.elapsed().as_secs_f64());
            decoded = Some(Arc::new(image));
        }
        seconds += median(times);
        out.extend(decoded);
    }
    Ok((bytes, seconds, out))
}

fn in_black(image: &Ldi) -> Ldi {
    let mut image = image.clone();
    image.layers.iter_mut().for_each(|l| l.rgb.fill([0; 3]));
    image
}
