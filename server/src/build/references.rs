//! Reference images of portals and what is merged from them, kept as they are finished.

use super::images::{Images, Kept, KeptImage, Piece, coded, pack, unpack};
use super::{BuildError, Progress, key};
use crate::construct::{self, ConstructOptions, MergeFigures};
use crate::portal::{EVERYWHERE, SidePlan};
use crate::render::Caster;
use crate::store::DatasetWriter;
use ldi_protocol::codec::ColourProfile;
use ldi_protocol::index::{BuildSettings, ChunkHash};
use rayon::prelude::*;
use serde::Serialize;

/// Makes the reference images of every side of a portal that are not kept yet, and the layered
/// ones merged from them (`construct::construct_side`): they follow the placements' in `images`.
#[expect(clippy::too_many_arguments, reason = "as of construct_all, and what is merged")]
pub fn construct_references(
    images: &mut Images,
    caster: &Caster,
    plans: &[SidePlan],
    same_depth: f64,
    settings: &BuildSettings,
    colour: ColourProfile,
    scene_key: &[u8; 32],
    writer: &DatasetWriter,
    progress: &dyn Progress,
) -> Result<ReferenceFigures, BuildError> {
    let start = std::time::Instant::now();
    let options = ConstructOptions::new(settings.camera);
    let one = |plan: &SidePlan| -> Result<(Kept, Vec<Vec<u8>>), BuildError> {
        let fault = |source| BuildError::Construct { number: plan.portal, total: plans.len(), source };
        let made = construct::construct_side(caster, plan, &options, same_depth).map_err(fault)?;
        let mut kept = Kept { sight_rays: made.rays, sky: made.sky, merge: Some(made.merge), ..Kept::default() };
        let mut chunks = Vec::new();
        for (planned, ldi) in made.references.iter().chain([&made.layered]).enumerate() {
            let mut image = KeptImage::over(planned, EVERYWHERE);
            if let Some(ldi) = ldi {
                image.samples_by_layer = ldi.layers.iter().map(|l| l.len() as u32).collect();
                let coded = coded(&[ldi], colour, &format!("a reference image of portal {}", plan.portal))?.concat();
                image.take(ldi, coded, &mut chunks);
            }
            kept.images.push(image);
        }
        Ok((kept, chunks))
    };
    let made: Vec<Result<(Piece, bool), BuildError>> = plans
        .par_iter()
        .with_max_len(1)
        .map(|plan| {
            let key = key::images_key(scene_key, settings, &(plan, same_depth));
            let found = writer.cached(&key).and_then(|bytes| unpack(&bytes));
            let new = found.is_none();
            let (kept, chunks) = match found {
                Some(found) => found,
                None => {
                    let made = one(plan)?;
                    writer.store(&key, &pack(&made))?;
                    made
                }
            };
            progress.advance(1);
            let hashes = chunks.iter().map(|bytes| ChunkHash(*blake3::hash(bytes).as_bytes())).collect();
            Ok((Piece { kept, key, hashes, unmade: false }, new))
        })
        .collect();
    let mut figures = ReferenceFigures::default();
    for made in made {
        let (piece, new) = made?;
        figures.add(&piece.kept, new);
        images.all.push(piece);
    }
    figures.seconds = start.elapsed().as_secs_f64();
    Ok(figures)
}

/// Figures over all reference images and what was merged from them.
#[derive(Debug, Clone, Default, Serialize)]
pub struct ReferenceFigures {
    /// Reference images that hold something.
    pub references: u64,
    /// Their samples.
    pub reference_samples: u64,
    /// Their bytes.
    pub reference_bytes: u64,
    /// Layered images.
    pub layered: u64,
    /// Samples of those, by layer (Figure 5 of Rafferty et al. 1998).
    pub layered_samples: Vec<u64>,
    /// Their bytes.
    pub layered_bytes: u64,
    /// What became of samples in merging.
    pub merge: MergeFigures,
    /// Rays cast in this run.
    pub rays: u64,
    /// Wall time.
    pub seconds: f64,
}

impl ReferenceFigures {
    fn add(&mut self, kept: &Kept, new: bool) {
        self.rays += if new { kept.sight_rays } else { 0 };
        kept.merge.iter().for_each(|m| self.merge.add(m));
        let Some((layered, references)) = kept.images.split_last() else { return };
        let bytes = |i: &KeptImage| i.lengths.iter().map(|l| u64::from(*l)).sum::<u64>();
        for image in references {
            self.references += u64::from(!image.lengths.is_empty());
            self.reference_samples += image.samples_by_layer.iter().map(|n| u64::from(*n)).sum::<u64>();
            self.reference_bytes += bytes(image);
        }
        self.layered += u64::from(!layered.lengths.is_empty());
        self.layered_bytes += bytes(layered);
        if self.layered_samples.len() < layered.samples_by_layer.len() {
            self.layered_samples.resize(layered.samples_by_layer.len(), 0);
        }
        self.layered_samples.iter_mut().zip(&layered.samples_by_layer).for_each(|(a, b)| *a += u64::from(*b));
    }
}
