//! Constructs, encodes and keeps the images of all placements.

use super::{BuildError, Progress, key};
use crate::construct::{self, ConstructOptions};
use crate::pack::PackError;
use crate::placement::{ImagePlan, PlacementPlan};
use crate::render::Caster;
use crate::scene::Note;
use crate::store::DatasetWriter;
use ldi_protocol::codec::{ColourMode, ldi};
use ldi_protocol::index::{BuildSettings, ChunkEntry, ChunkHash, ChunkKind, ImageEntry, Placement};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// zstd level of images: beyond it, time grows faster than bytes shrink.
const LEVEL: i32 = 6;

/// Figures over all images.
#[derive(Debug, Clone, Default)]
pub struct ImageFigures {
    /// Images that hold something.
    pub images: u64,
    /// Images made in this run; the others were kept by one that was stopped.
    pub made: u64,
    /// Samples per layer, over all images.
    pub samples_by_layer: Vec<u64>,
    /// Hits that no user can see.
    pub pruned: u64,
    /// Samples that were found and are in no image.
    pub lost: Lost,
    /// Largest extent of a sample along its surface, output pixels.
    pub stretch_max_px: f64,
    /// Largest error that rounding disparity causes, output pixels.
    pub quantization_error_px: f64,
    /// Rays cast.
    pub rays: u64,
    /// Wall time of the stage.
    pub seconds: f64,
    /// Seconds of one thread per step, as in [`STEPS`].
    pub step_seconds: [f64; STEPS.len()],
}

/// Samples that were found and are in no image.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Lost {
    /// Their pixel had all its layers.
    pub too_deep: u64,
    /// The ray through their pixel's centre misses their surface: silhouettes, and surfaces that the centre of projection sees edge-on.
    pub recast_missed: u64,
}

/// Steps of making an image.
pub const STEPS: [&str; 6] =
    ["sight", "central image", "construction images", "recast", "layers and colour", "encoding"];

/// An image as it was made, and the time that its steps took.
type Made = ((Kept, Vec<Vec<u8>>), [f64; STEPS.len()]);

/// What is kept of an image besides its chunks.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Kept {
    samples_by_layer: Vec<u32>,
    decoded_bytes: [u32; 2],
    pruned: u64,
    lost: Lost,
    rays: u64,
    stretch_p99_px: f64,
    stretch_max_px: f64,
    quantization_error_px: f64,
    /// Lengths of the chunks that follow.
    lengths: Vec<u32>,
}

/// All images of a build. Their bytes lie in the writer's pieces: images may take more than the memory.
#[derive(Debug, Default)]
pub struct Images {
    /// Figures for the report.
    pub figures: ImageFigures,
    all: Vec<Image>,
}

/// One image.
#[derive(Debug, Clone, Default)]
struct Image {
    kept: Kept,
    /// Of its piece.
    key: [u8; 32],
    /// Of its chunks; none if nobody sees anything of it.
    hashes: Vec<ChunkHash>,
}

/// Makes every image that is not kept yet.
pub fn construct_all(
    caster: &Caster,
    plans: &[PlacementPlan],
    settings: &BuildSettings,
    colour: ColourMode,
    scene_key: &[u8; 32],
    writer: &DatasetWriter,
    progress: &dyn Progress,
) -> Result<Images, BuildError> {
    let start = std::time::Instant::now();
    let options = ConstructOptions::new(settings.camera);
    // One image after the other leaves a core idle whenever one is encoded; rayon balances images and their rows alike.
    let all: Vec<(&[u32], &ImagePlan)> =
        plans.iter().flat_map(|p| p.images.iter().map(|i| (p.culled.as_slice(), i))).collect();
    let made: Vec<Result<(Image, Option<[f64; STEPS.len()]>), BuildError>> = all
        .par_iter()
        .with_max_len(1)
        .enumerate()
        .map(|(number, (culled, plan))| {
            let key = key::image_key(scene_key, settings, culled, plan);
            let found = writer.cached(&key).and_then(|bytes| unpack(&bytes));
            let ((kept, chunks), seconds) = match found {
                Some(found) => (found, None),
                None => {
                    let (made, seconds) = one(caster, culled, plan, &options, colour, (number, all.len()))?;
                    writer.store(&key, &pack(&made))?;
                    (made, Some(seconds))
                }
            };
            progress.advance(1);
            let hashes = chunks.iter().map(|bytes| ChunkHash(*blake3::hash(bytes).as_bytes())).collect();
            Ok((Image { kept, key, hashes }, seconds))
        })
        .collect();
    let mut images = Images::default();
    for made in made {
        let (image, seconds) = made?;
        let (f, kept) = (&mut images.figures, &image.kept);
        f.images += u64::from(!image.hashes.is_empty());
        f.made += u64::from(seconds.is_some());
        seconds.iter().for_each(|s| f.step_seconds.iter_mut().zip(s).for_each(|(a, b)| *a += b));
        f.pruned += kept.pruned;
        f.lost.too_deep += kept.lost.too_deep;
        f.lost.recast_missed += kept.lost.recast_missed;
        f.stretch_max_px = f.stretch_max_px.max(kept.stretch_max_px);
        f.quantization_error_px = f.quantization_error_px.max(kept.quantization_error_px);
        // Rays of an earlier run took no time in this one.
        f.rays += if seconds.is_none() { 0 } else { kept.rays };
        if f.samples_by_layer.len() < kept.samples_by_layer.len() {
            f.samples_by_layer.resize(kept.samples_by_layer.len(), 0);
        }
        f.samples_by_layer.iter_mut().zip(&kept.samples_by_layer).for_each(|(a, b)| *a += u64::from(*b));
        images.all.push(image);
    }
    images.figures.seconds = start.elapsed().as_secs_f64();
    Ok(images)
}

fn one(
    caster: &Caster,
    culled: &[u32],
    plan: &ImagePlan,
    options: &ConstructOptions,
    colour: ColourMode,
    (number, total): (usize, usize),
) -> Result<Made, BuildError> {
    let [left, right, bottom, top] = plan.window;
    if left >= right || bottom >= top {
        // The replaced cells lie in the planning square but in nobody's picture.
        return Ok(((Kept::default(), Vec::new()), [0.0; STEPS.len()]));
    }
    let made = construct::construct(caster, culled, plan, options).map_err(|source| BuildError::Construct {
        number,
        total,
        source,
    })?;
    let mut kept = Kept {
        samples_by_layer: made.stats.samples_by_layer.clone(),
        pruned: made.stats.pruned,
        lost: Lost { too_deep: made.stats.too_deep, recast_missed: made.stats.recast_missed },
        stretch_max_px: made.stats.stretch_max_px,
        rays: made.stats.rays.total(),
        stretch_p99_px: made.stats.stretch_p99_px,
        ..Kept::default()
    };
    let [sight, central, construction, recast, colour_and_layers] = made.stats.seconds;
    let mut seconds = [sight, central, construction, recast, colour_and_layers, 0.0];
    if made.ldi.samples() == 0 {
        return Ok(((kept, Vec::new()), seconds));
    }
    // Of no samples it says nothing.
    kept.quantization_error_px = made.stats.quantization_error_px;
    let start = std::time::Instant::now();
    let pack_error = |source| PackError { what: format!("image {number}"), source };
    let mut chunks = vec![ldi::encode_first(&made.ldi, colour, LEVEL).map_err(pack_error)?];
    chunks.extend(ldi::encode_deeper(&made.ldi, colour, LEVEL).map_err(pack_error)?);
    kept.decoded_bytes = ldi::decoded_bytes(&made.ldi).map(|b| u32::try_from(b).unwrap_or(u32::MAX));
    kept.lengths = chunks.iter().map(|c| c.len() as u32).collect();
    seconds[5] = start.elapsed().as_secs_f64();
    Ok(((kept, chunks), seconds))
}

fn pack((kept, chunks): &(Kept, Vec<Vec<u8>>)) -> Vec<u8> {
    // Figures that fail to serialize cannot occur: numbers and vectors of them.
    let head = serde_json::to_vec(kept).unwrap_or_default();
    let mut out = (head.len() as u32).to_le_bytes().to_vec();
    out.extend(head);
    out.extend(chunks.iter().flatten());
    out
}

fn unpack(bytes: &[u8]) -> Option<(Kept, Vec<Vec<u8>>)> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let (head, mut rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    let kept: Kept = serde_json::from_slice(head).ok()?;
    let mut chunks = Vec::new();
    for length in &kept.lengths {
        let (chunk, after) = rest.split_at_checked(*length as usize)?;
        chunks.push(chunk.to_vec());
        rest = after;
    }
    rest.is_empty().then_some((kept, chunks))
}

impl Images {
    /// Images of plans before any is made: all empty.
    pub fn none_of(plans: &[PlacementPlan]) -> Self {
        let count = plans.iter().map(|p| p.images.len()).sum();
        Self { figures: ImageFigures::default(), all: vec![Image::default(); count] }
    }

    /// Entries of all chunks, in order.
    pub fn entries(&self) -> impl Iterator<Item = ChunkEntry> + '_ {
        self.all.iter().flat_map(|Image { kept, hashes, .. }| {
            hashes.iter().zip(&kept.lengths).zip(kept.decoded_bytes).map(|((hash, length), decoded_bytes)| ChunkEntry {
                hash: *hash,
                stored_bytes: *length,
                decoded_bytes,
                kind: ChunkKind::Ldi,
            })
        })
    }

    /// Reads chunks back, by their numbers among [`Images::entries`]. Quick in ascending order: a piece is read once.
    pub fn reader(&self) -> impl FnMut(&DatasetWriter, usize) -> Option<Vec<u8>> + '_ {
        let of_image = |(image, i): (usize, &Image)| (0..i.hashes.len()).map(move |chunk| (image, chunk));
        let places: Vec<(usize, usize)> = self.all.iter().enumerate().flat_map(of_image).collect();
        let mut open: (usize, Vec<Vec<u8>>) = (usize::MAX, Vec::new());
        move |writer, number| {
            let (image, chunk) = *places.get(number)?;
            if open.0 != image {
                open = (image, unpack(&writer.cached(&self.all[image].key)?)?.1);
            }
            open.1.get(chunk).cloned()
        }
    }

    /// Placements and images as the index names them.
    pub fn placements(&self, plans: &[PlacementPlan], first_chunk: u32) -> (Vec<Placement>, Vec<ImageEntry>) {
        let (mut placements, mut images) = (Vec::new(), Vec::new());
        let mut next = first_chunk;
        let mut all = self.all.iter();
        for plan in plans {
            let first_image = images.len() as u32;
            for (image, Image { kept, hashes, .. }) in plan.images.iter().zip(&mut all) {
                let first = next;
                next += hashes.len() as u32;
                images.push(ImageEntry {
                    basis: image.basis,
                    plane_distance: image.plane_distance,
                    window: image.window,
                    stretch_p99_px: kept.stretch_p99_px,
                    chunks: (first..next).collect(),
                    samples_by_layer: kept.samples_by_layer.clone(),
                });
            }
            placements.push(Placement {
                grid_point: plan.grid_point,
                cop: plan.cop,
                culled: plan.culled.clone(),
                footprint_px: plan.footprint_px,
                users: plan.users,
                images: first_image..images.len() as u32,
            });
        }
        (placements, images)
    }

    /// What was left out.
    pub fn notes(&self) -> Vec<Note> {
        let empty = self.all.iter().filter(|i| i.hashes.is_empty()).count();
        let mut notes = Vec::new();
        if empty > 0 {
            notes.push(Note {
                what: format!("{empty} of {} images", self.all.len()),
                why: "no eye that may use them sees anything of the cells they replace".into(),
            });
        }
        notes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kept_work_survives_packing_and_torn_work_is_refused() {
        let kept = Kept { samples_by_layer: vec![3, 1], lengths: vec![2, 3], rays: 9, ..Kept::default() };
        let packed = pack(&(kept, vec![vec![1, 2], vec![3, 4, 5]]));
        let (back, chunks) = unpack(&packed).expect("whole");
        assert_eq!((back.rays, chunks), (9, vec![vec![1, 2], vec![3, 4, 5]]));
        for cut in 0..packed.len() {
            assert!(unpack(&packed[..cut]).is_none(), "cut at {cut}");
        }
    }
}
