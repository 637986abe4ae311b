//! Constructs, encodes and keeps the images of all placements.

use super::{BuildError, Progress, key};
use crate::construct::{self, ConstructOptions, Constructed, MergeFigures};
use crate::pack::PackError;
use crate::placement::{ImagePlan, PlacementPlan};
use crate::portal::SidePlan;
use crate::render::Caster;
use crate::scene::Note;
use crate::store::DatasetWriter;
use ldi_protocol::CellRuns;
use ldi_protocol::codec::{ColourProfile, ldi};
use ldi_protocol::index::{BuildSettings, ChunkEntry, ChunkHash, ChunkKind, ImageEntry, Placement};
use ldi_protocol::ldi::Ldi;
use ldi_protocol::room_index::SideImages;
use ldi_protocol::sky::SkyMap;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// zstd level of images: beyond it, time grows faster than bytes shrink.
pub const IMAGE_LEVEL: i32 = 6;

/// Figures over all images.
#[derive(Debug, Clone, Default)]
pub struct ImageFigures {
    /// Images that hold something.
    pub images: u64,
    /// Images made in this run; the others were kept by one that was stopped.
    pub made: u64,
    /// Placements whose images were not made, because the time was over.
    pub unmade: u64,
    /// Samples per layer, over all images.
    pub samples_by_layer: Vec<u64>,
    /// Hits that no user can see.
    pub pruned: u64,
    /// Samples that were found and are in no image.
    pub lost: Lost,
    /// Slivers.
    pub slivers: u64,
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
    /// The ray through their pixel's centre misses their surface: silhouettes, and surfaces that
    /// the centre of projection sees edge-on, of which some become slivers.
    pub recast_missed: u64,
}

/// Steps of making an image.
pub const STEPS: [&str; 6] =
    ["sight", "central image", "construction images", "recast", "layers and colour", "encoding"];

/// The images of a placement, and the time that their steps took.
type Made = ((Kept, Vec<Vec<u8>>), [f64; STEPS.len()]);

/// What is kept of a placement's images besides their chunks.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Kept {
    pub images: Vec<KeptImage>,
    pub sight_rays: u64,
    pub sky: SkyMap,
    /// Of a side's reference images.
    pub merge: Option<MergeFigures>,
}

/// What is kept of an image besides its chunks.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct KeptImage {
    /// Position among the plan's images.
    pub planned: usize,
    pub window: [f64; 4],
    pub samples_by_layer: Vec<u32>,
    decoded_bytes: [u32; 2],
    pruned: u64,
    lost: Lost,
    slivers: u32,
    rays: u64,
    stretch_p99_px: f64,
    stretch_max_px: f64,
    quantization_error_px: f64,
    /// Lengths of its chunks; none if nobody sees anything of it.
    pub lengths: Vec<u32>,
}

/// All images of a build. Their bytes lie in the writer's pieces, one for each placement: images
/// may take more than the memory.
#[derive(Debug, Default)]
pub struct Images {
    /// Figures for the report.
    pub figures: ImageFigures,
    pub(super) all: Vec<Piece>,
}

/// The images of a placement.
#[derive(Debug, Clone, Default)]
pub(super) struct Piece {
    pub kept: Kept,
    pub key: [u8; 32],
    /// Of all chunks.
    pub hashes: Vec<ChunkHash>,
    /// The time was over before it was made.
    pub unmade: bool,
}

/// Makes the images of every placement that are not kept yet; after `deadline` none is begun any
/// more.
#[expect(clippy::too_many_arguments, reason = "each is another thing that images depend on")]
pub fn construct_all(
    caster: &Caster,
    plans: &[PlacementPlan],
    settings: &BuildSettings,
    colour: ColourProfile,
    scene_key: &[u8; 32],
    writer: &DatasetWriter,
    deadline: Option<Instant>,
    progress: &dyn Progress,
) -> Result<Images, BuildError> {
    let start = Instant::now();
    let options = ConstructOptions::new(settings.camera);
    // One image after the other leaves a core idle whenever one is encoded; rayon balances
    // placements and their rows alike.
    let made: Vec<Result<(Piece, Option<[f64; STEPS.len()]>), BuildError>> = plans
        .par_iter()
        .with_max_len(1)
        .enumerate()
        .map(|(number, plan)| {
            let key = key::images_key(scene_key, settings, plan);
            let found = writer.cached(&key).and_then(|bytes| unpack(&bytes));
            let ((kept, chunks), seconds) = match found {
                Some(found) => {
                    progress.skip(1);
                    (found, None)
                }
                None if deadline.is_some_and(|d| Instant::now() >= d) => {
                    return Ok((Piece { key, unmade: true, ..Piece::default() }, None));
                }
                None => {
                    let (made, seconds) = one(caster, plan, &options, colour, (number, plans.len()))?;
                    writer.store(&key, &pack(&made))?;
                    progress.advance(1);
                    (made, Some(seconds))
                }
            };
            let hashes = chunks.iter().map(|bytes| ChunkHash(*blake3::hash(bytes).as_bytes())).collect();
            Ok((Piece { kept, key, hashes, unmade: false }, seconds))
        })
        .collect();
    let mut images = Images::default();
    for made in made {
        let (piece, seconds) = made?;
        images.figures.add(&piece.kept, seconds.as_ref());
        images.figures.unmade += u64::from(piece.unmade);
        images.all.push(piece);
    }
    images.figures.seconds = start.elapsed().as_secs_f64();
    Ok(images)
}

impl ImageFigures {
    /// Adds a placement's images; `seconds` of those made in this run.
    fn add(&mut self, kept: &Kept, seconds: Option<&[f64; STEPS.len()]>) {
        seconds.into_iter().for_each(|s| self.step_seconds.iter_mut().zip(s).for_each(|(a, b)| *a += b));
        // Rays of an earlier run took no time in this one.
        let of_this_run = u64::from(seconds.is_some());
        self.rays += of_this_run * (kept.sight_rays + kept.images.iter().map(|i| i.rays).sum::<u64>());
        for image in &kept.images {
            let holds_something = u64::from(!image.lengths.is_empty());
            self.images += holds_something;
            self.made += of_this_run * holds_something;
            self.pruned += image.pruned;
            self.slivers += u64::from(image.slivers);
            self.lost.too_deep += image.lost.too_deep;
            self.lost.recast_missed += image.lost.recast_missed;
            self.stretch_max_px = self.stretch_max_px.max(image.stretch_max_px);
            self.quantization_error_px = self.quantization_error_px.max(image.quantization_error_px);
            if self.samples_by_layer.len() < image.samples_by_layer.len() {
                self.samples_by_layer.resize(image.samples_by_layer.len(), 0);
            }
            self.samples_by_layer.iter_mut().zip(&image.samples_by_layer).for_each(|(a, b)| *a += u64::from(*b));
        }
    }
}

fn one(
    caster: &Caster,
    plan: &PlacementPlan,
    options: &ConstructOptions,
    colour: ColourProfile,
    (number, total): (usize, usize),
) -> Result<Made, BuildError> {
    let made = construct::construct(caster, plan, options).map_err(|source| BuildError::Construct {
        number,
        total,
        source,
    })?;
    let mut seconds = [0.0; STEPS.len()];
    seconds[0] = made.sight_seconds;
    let mut kept = Kept { images: Vec::new(), sight_rays: made.sight_rays, sky: made.sky, merge: None };
    let mut chunks = Vec::new();
    let holds_something = |ldi: &Ldi| ldi.samples() > 0 || !ldi.slivers.is_empty();
    for (planned, tiles) in made.images.iter().enumerate() {
        let start = Instant::now();
        // Tiles of a face are granted their bytes together: a textured one is not coarser for
        // being cut off from plain ones.
        let full: Vec<&Ldi> = tiles.iter().map(|t| &t.ldi).filter(|ldi| holds_something(ldi)).collect();
        let mut of_full = coded(&full, colour, &format!("an image of placement {number}"))?.into_iter();
        seconds[STEPS.len() - 1] += start.elapsed().as_secs_f64();
        for Constructed { window, ldi, stats } in tiles {
            let mut image = KeptImage {
                planned,
                window: *window,
                samples_by_layer: stats.samples_by_layer.clone(),
                pruned: stats.pruned,
                lost: Lost { too_deep: stats.too_deep, recast_missed: stats.recast_missed },
                slivers: stats.slivers,
                stretch_max_px: stats.stretch_max_px,
                rays: stats.rays.total(),
                stretch_p99_px: stats.stretch_p99_px,
                ..KeptImage::default()
            };
            seconds[1..].iter_mut().zip(stats.seconds).for_each(|(a, b)| *a += b);
            if holds_something(ldi) {
                // Of no samples it says nothing.
                image.quantization_error_px = stats.quantization_error_px;
                image.take(ldi, of_full.next().unwrap_or_default(), &mut chunks);
            }
            kept.images.push(image);
        }
    }
    Ok(((kept, chunks), seconds))
}

impl KeptImage {
    /// Nothing yet, over a window.
    pub fn over(planned: usize, window: [f64; 4]) -> Self {
        Self { planned, window, ..Self::default() }
    }

    /// Takes an image's chunks: they go to the end of `chunks`.
    pub fn take(&mut self, ldi: &Ldi, coded: Vec<Vec<u8>>, chunks: &mut Vec<Vec<u8>>) {
        self.decoded_bytes = ldi::decoded_bytes(ldi).map(|b| u32::try_from(b).unwrap_or(u32::MAX));
        self.lengths = coded.iter().map(|c| c.len() as u32).collect();
        chunks.extend(coded);
    }
}

/// The chunks of images, which are granted their bytes together.
pub(super) fn coded(ldis: &[&Ldi], colour: ColourProfile, what: &str) -> Result<Vec<Vec<Vec<u8>>>, BuildError> {
    Ok(ldi::encode_all(ldis, colour, IMAGE_LEVEL).map_err(|source| PackError { what: what.into(), source })?)
}

pub(super) fn pack((kept, chunks): &(Kept, Vec<Vec<u8>>)) -> Vec<u8> {
    // Figures that fail to serialize cannot occur: numbers and vectors of them.
    let head = serde_json::to_vec(kept).unwrap_or_default();
    let mut out = (head.len() as u32).to_le_bytes().to_vec();
    out.extend(head);
    out.extend(chunks.iter().flatten());
    out
}

pub(super) fn unpack(bytes: &[u8]) -> Option<(Kept, Vec<Vec<u8>>)> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let (head, mut rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    let kept: Kept = serde_json::from_slice(head).ok()?;
    let mut chunks = Vec::new();
    for length in kept.images.iter().flat_map(|i| &i.lengths) {
        let (chunk, after) = rest.split_at_checked(*length as usize)?;
        chunks.push(chunk.to_vec());
        rest = after;
    }
    rest.is_empty().then_some((kept, chunks))
}

/// A placement's images as the index names them.
pub struct Indexed<'a> {
    /// Placements.
    pub placements: Vec<Placement>,
    /// Images.
    pub images: Vec<ImageEntry>,
    /// Per image, the plan that it is a part of.
    pub plans: Vec<&'a ImagePlan>,
    /// Per planned side of a portal the placements of its images of 1998.
    pub sides: Vec<SideImages>,
}

impl Images {
    /// Images of plans before any is made: all empty.
    pub fn none_of(plans: &[PlacementPlan]) -> Self {
        Self { figures: ImageFigures::default(), all: vec![Piece::default(); plans.len()] }
    }

    /// Entries of all chunks, in order.
    pub fn entries(&self) -> impl Iterator<Item = ChunkEntry> + '_ {
        self.all.iter().flat_map(|Piece { kept, hashes, .. }| {
            let sizes = kept.images.iter().flat_map(|i| i.lengths.iter().copied().zip(i.decoded_bytes));
            hashes.iter().zip(sizes).map(|(hash, (stored_bytes, decoded_bytes))| ChunkEntry {
                hash: *hash,
                stored_bytes,
                decoded_bytes,
                kind: ChunkKind::Ldi,
            })
        })
    }

    /// Reads chunks back, by their numbers among [`Images::entries`]. Quick in ascending order: a
    /// piece is read once.
    pub fn reader(&self) -> impl FnMut(&DatasetWriter, usize) -> Option<Vec<u8>> + '_ {
        let of_piece = |(piece, p): (usize, &Piece)| (0..p.hashes.len()).map(move |chunk| (piece, chunk));
        let places: Vec<(usize, usize)> = self.all.iter().enumerate().flat_map(of_piece).collect();
        let mut open: (usize, Vec<Vec<u8>>) = (usize::MAX, Vec::new());
        move |writer, number| {
            let (piece, chunk) = *places.get(number)?;
            if open.0 != piece {
                open = (piece, unpack(&writer.cached(&self.all[piece].key)?)?.1);
            }
            open.1.get(chunk).cloned()
        }
    }

    /// Placements and images as the index names them. A planned image of which nobody sees
    /// anything is one without chunks.
    pub fn indexed<'a>(&self, plans: &'a [PlacementPlan], sides: &'a [SidePlan], first_chunk: u32) -> Indexed<'a> {
        let mut out = Indexed { placements: Vec::new(), images: Vec::new(), plans: Vec::new(), sides: Vec::new() };
        let mut next = first_chunk;
        for (plan, Piece { kept, unmade, .. }) in plans.iter().zip(&self.all) {
            let first_image = out.images.len() as u32;
            let mut tiles = kept.images.iter().peekable();
            // One without entries of images was not made.
            for (number, image) in plan.images.iter().enumerate().filter(|_| !unmade) {
                let nothing = KeptImage { window: image.window, ..KeptImage::default() };
                let mut of_image: Vec<&KeptImage> = Vec::new();
                of_image.extend(std::iter::from_fn(|| tiles.next_if(|t| t.planned == number)));
                for tile in if of_image.is_empty() { vec![&nothing] } else { of_image } {
                    let first = next;
                    next += tile.lengths.len() as u32;
                    out.images.push(ImageEntry {
                        basis: image.basis,
                        plane_distance: image.plane_distance,
                        window: tile.window,
                        stretch_p99_px: tile.stretch_p99_px,
                        chunks: (first..next).collect(),
                        samples_by_layer: tile.samples_by_layer.clone(),
                    });
                    out.plans.push(image);
                }
            }
            out.placements.push(Placement {
                grid_point: plan.grid_point,
                cop: plan.cop,
                // A portal's are all but those of the room before it.
                culled: if plan.through.is_empty() { plan.culled.clone() } else { CellRuns::default() },
                footprint_px: plan.footprint_px,
                users: plan.users,
                images: first_image..out.images.len() as u32,
                sky: kept.sky.clone(),
            });
        }
        for (side, Piece { kept, .. }) in sides.iter().zip(self.all.iter().skip(plans.len())) {
            let first = out.placements.len() as u32;
            for (plan, image) in side.references.iter().chain([&side.layered]).zip(&kept.images) {
                let (number, last) = (out.images.len() as u32, next + image.lengths.len() as u32);
                out.images.push(ImageEntry {
                    basis: plan.basis,
                    plane_distance: plan.plane_distance,
                    window: image.window,
                    stretch_p99_px: f64::NAN,
                    chunks: (next..last).collect(),
                    samples_by_layer: image.samples_by_layer.clone(),
                });
                next = last;
                out.plans.push(plan);
                out.placements.push(Placement {
                    grid_point: None,
                    cop: plan.cop,
                    culled: CellRuns::default(),
                    footprint_px: plan.footprint_px,
                    users: plan.users,
                    images: number..number + 1,
                    sky: kept.sky.clone(),
                });
            }
            let references = first..first + side.references.len() as u32;
            let (central, layered) = (first + side.central as u32, Some(references.end));
            out.sides.push(SideImages { references, central, layered });
        }
        out
    }

    /// What was left out.
    pub fn notes(&self, plans: &[PlacementPlan]) -> Vec<Note> {
        let made = || plans.iter().zip(&self.all).filter(|(_, piece)| !piece.unmade);
        let planned: usize = made().map(|(p, _)| p.images.len()).sum();
        let mut seen: Vec<(usize, usize)> = Vec::new();
        for (piece, number) in self.all.iter().zip(0..) {
            seen.extend(piece.kept.images.iter().filter(|i| !i.lengths.is_empty()).map(|i| (number, i.planned)));
        }
        seen.dedup();
        let empty = planned - seen.len();
        let mut notes = Vec::new();
        if self.figures.unmade > 0 {
            notes.push(Note {
                what: format!("the images of {} of {} placements", self.figures.unmade, plans.len()),
                why: "the time was over; there what is far is softer. The same command goes on".into(),
            });
        }
        if empty > 0 {
            notes.push(Note {
                what: format!("{empty} of {planned} planned images"),
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
        let image = |lengths| KeptImage { lengths, ..KeptImage::default() };
        let kept =
            Kept { images: vec![image(vec![2]), image(vec![]), image(vec![3])], sight_rays: 9, ..Kept::default() };
        let packed = pack(&(kept, vec![vec![1, 2], vec![3, 4, 5]]));
        let (back, chunks) = unpack(&packed).expect("whole");
        assert_eq!((back.sight_rays, chunks), (9, vec![vec![1, 2], vec![3, 4, 5]]));
        for cut in 0..packed.len() {
            assert!(unpack(&packed[..cut]).is_none(), "cut at {cut}");
        }
    }
}
