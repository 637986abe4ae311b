//! Builds the LDI tree (Chang, Bishop, Lastra 1999) from reference images taken where eyes can be.
//!
//! In: a caster and the walk volume. Out: a [`Tree`] with its chunks.
//!
//! 1. [`places`]: reference positions, chosen so that together they see as much as all of many
//!    candidates do.
//! 2. [`mod@reference`]: six square images of 90 degrees at each; of every pixel the point, the
//!    normal, the colour and the stamp.
//! 3. [`grow`]: each pixel goes to the level whose pitch matches its stamp (section 3.1),
//!    bilinearly; filtered copies go up, level by level.
//! 4. [`coverage`]: which parts of its pixel every sample covers, by rays of its own.
//! 5. [`shape`]: what was grown, as nodes and chunks.
//! 6. [`probe`]: how fine it has to be, and is, where random eyes look.
//!
//! Where it differs from the paper: six faces per node instead of one (see
//! [`ldi_protocol::tree`]); the stamp is measured along the surface, not across the ray, so that
//! floors seen at a grazing angle do not fall apart; a pixel's filtered copies come from the level
//! below and not from the pixel itself, which is the same sum in another order; the coverage of a
//! sample is measured, not summed.

mod coverage;
mod grow;
mod places;
mod probe;
mod reference;
mod shape;
#[cfg(test)]
mod tests;

pub use places::{Places, choose};
pub use probe::{FarPoint, Probes};

use crate::pack::{Chunk, PackError};
use crate::render::Caster;
use glam::DVec3;
use grow::Forest;
use ldi_protocol::{
    Aabb,
    tree::{MAX_LEVEL, SIDE, Tree},
};
use rayon::prelude::*;
use reference::Reference;

/// Samples that the finest pinned level is planned for: about two bytes each, and a third more for
/// the levels above.
const PINNED_SAMPLES: f64 = 650_000.0;
/// The pinned levels take at most this many bytes: less than a second over 20 Mbit/s.
pub const PINNED_BYTES: u64 = 2_000_000;
/// Pixels of all reference images of a base layer: some twenty for every sample of its finest
/// level, ten to twenty seconds on two cores.
const BASE_PIXELS: f64 = 24e6;
/// Pixels along a side of a reference image, at least and at most.
const REFERENCE_SIDES: [f64; 2] = [16.0, 512.0];
/// References that are held in memory at a time, pixels of a point each.
const BATCH_POINTS: usize = 2_000_000;

/// How fine the tree is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Depth {
    /// As fine as the pinned levels can be: the base layer of a dataset that has other
    /// representations.
    Base,
    /// Samples as fine as this, metres, wherever a reference sees that finely (the paper's
    /// smallest feature d, equation for H in section 3.6); with reference images of so many pixels
    /// along a side.
    Fine {
        /// Smallest pitch, metres.
        pitch_m: f64,
        /// Pixels along a side of a reference image.
        side: u32,
    },
}

/// What the build of a tree found.
#[derive(Debug, Clone, Default, serde::Serialize, serde::Deserialize)]
pub struct TreeFigures {
    /// Reference positions.
    pub references: usize,
    /// Coarse ones, for eyes outside of the walk volume.
    pub references_outside: usize,
    /// Candidates among which they were chosen.
    pub candidates: usize,
    /// How much of what all candidates see the references see, 0 to 1.
    pub coverage: f64,
    /// Pixels along a side of each of a reference's six images.
    pub reference_side: u32,
    /// Reference pixels with a surface.
    pub reference_pixels: u64,
    /// Nodes.
    pub nodes: usize,
    /// Samples by level.
    pub samples_by_level: Vec<u64>,
    /// Stored bytes by level.
    pub bytes_by_level: Vec<u64>,
    /// Levels that are pinned.
    pub pinned_levels: u8,
    /// Their stored bytes.
    pub pinned_bytes: u64,
    /// Pitch of the finest level, metres.
    pub finest_pitch_m: f64,
    /// Samples of all levels over reference pixels; the paper's about 5.
    pub samples_per_reference_pixel: f64,
    /// Rays cast.
    pub rays: u64,
}

/// A tree and its chunks; its chunk numbers count from `first_chunk`.
pub struct BuiltTree {
    /// For the index.
    pub tree: Tree,
    /// In the order of their numbers.
    pub chunks: Vec<Chunk>,
    /// For the report.
    pub figures: TreeFigures,
}

/// The cube of a tree around a scene's bounds: shifted by an odd part of a pitch, so that walls
/// and floors at round numbers do not lie on the borders of cells.
fn cube(bounds: &Aabb) -> (DVec3, f64) {
    let edge = bounds.size().max_element().max(1e-3) * (1.0 + 3.0 / f64::from(SIDE));
    (bounds.min - DVec3::new(0.731, 0.617, 0.853) * (edge / f64::from(SIDE)), edge)
}

/// Builds the tree. None: no eye sees any surface.
///
/// # Errors
/// If a chunk cannot be encoded.
pub fn build_tree(
    caster: &Caster,
    bounds: &Aabb,
    chosen: &Places,
    depth: Depth,
    first_chunk: u32,
    heard: &dyn Fn(&str),
) -> Result<Option<BuiltTree>, PackError> {
    let (finest, side) = match depth {
        Depth::Base => {
            let pitch = (chosen.area_m2 / PINNED_SAMPLES).sqrt();
            let side = (BASE_PIXELS / (6 * chosen.positions.len().max(1)) as f64).sqrt();
            (pitch, side.clamp(REFERENCE_SIDES[0], REFERENCE_SIDES[1]) as u32)
        }
        Depth::Fine { pitch_m, side } => (pitch_m, side),
    };
    let mut grower = Grower::new(bounds, finest);
    let batch = (BATCH_POINTS / (6 * (side * side) as usize)).max(2);
    for (k, positions) in chosen.positions.chunks(batch).enumerate() {
        let places: Vec<Vec<(DVec3, usize)>> = positions.iter().map(|p| (0..6).map(|f| (*p, f)).collect()).collect();
        grower.add_together(caster, &places, side);
        heard(&format!("{} of {} references", (k * batch + positions.len()), chosen.positions.len()));
    }
    // What only eyes outside of the walk volume see shows coarsely.
    let coarse_side = (side / 2).max(REFERENCE_SIDES[0] as u32);
    for positions in chosen.outside.chunks(4 * batch) {
        let places: Vec<Vec<(DVec3, usize)>> = positions.iter().map(|p| (0..6).map(|f| (*p, f)).collect()).collect();
        grower.add_together(caster, &places, coarse_side);
    }
    if grower.reference_pixels == 0 {
        return Ok(None);
    }
    let mut built = grower.finish(caster, first_chunk)?;
    built.figures = TreeFigures {
        references: chosen.positions.len(),
        references_outside: chosen.outside.len(),
        candidates: chosen.candidates,
        coverage: chosen.coverage,
        reference_side: side,
        rays: built.figures.rays + chosen.rays,
        ..built.figures
    };
    Ok(Some(built))
}

/// A tree that grows by reference images.
pub struct Grower {
    forest: Forest,
    origin: DVec3,
    edge_m: f64,
    reference_pixels: u64,
    rays: u64,
}

impl Grower {
    /// A tree for a scene, with samples at most this far apart on its finest level: one level
    /// deeper is at most four times the samples.
    pub fn new(bounds: &Aabb, pitch_m: f64) -> Self {
        let (origin, edge_m) = cube(bounds);
        let max_level = (0..=MAX_LEVEL).find(|l| pitch_of(edge_m, *l) <= pitch_m).unwrap_or(MAX_LEVEL);
        Self { forest: Forest::new(origin, edge_m, max_level), origin, edge_m, reference_pixels: 0, rays: 0 }
    }

    /// Adds images of 90 degrees, `side` pixels wide: places and faces (0 to 5: -x, +x, -y, +y,
    /// -z, +z).
    pub fn add(&mut self, caster: &Caster, images: &[(DVec3, usize)], side: u32) {
        let one_by_one: Vec<Vec<(DVec3, usize)>> = images.iter().map(|i| vec![*i]).collect();
        self.add_together(caster, &one_by_one, side);
    }

    /// Adds references of several images from one place each.
    fn add_together(&mut self, caster: &Caster, places: &[Vec<(DVec3, usize)>], side: u32) {
        let take = |images: &Vec<(DVec3, usize)>| {
            let faces: Vec<usize> = images.iter().map(|i| i.1).collect();
            Reference::take(caster, images[0].0, &faces, side)
        };
        let references: Vec<Reference> = places.par_iter().map(take).collect();
        self.forest.splat(&references);
        self.reference_pixels += references.iter().map(|r| r.points.len() as u64).sum::<u64>();
        self.rays += references.iter().map(|r| r.rays).sum::<u64>();
    }

    /// Pixels so far that met a surface.
    pub fn reference_pixels(&self) -> u64 {
        self.reference_pixels
    }

    /// The tree; its chunk numbers count from `first_chunk`.
    ///
    /// # Errors
    /// If a chunk cannot be encoded.
    pub fn finish(self, caster: &Caster, first_chunk: u32) -> Result<BuiltTree, PackError> {
        let mut built = shape::shape(self.forest.filter(caster), self.origin, self.edge_m, first_chunk)?;
        let figures = &mut built.figures;
        let samples: u64 = figures.samples_by_level.iter().sum();
        figures.reference_pixels = self.reference_pixels;
        figures.rays = self.rays;
        figures.samples_per_reference_pixel = samples as f64 / self.reference_pixels.max(1) as f64;
        figures.finest_pitch_m = pitch_of(self.edge_m, figures.samples_by_level.len().saturating_sub(1) as u8);
        Ok(built)
    }
}

/// Pitch of a level of a root cube.
fn pitch_of(edge_m: f64, level: u8) -> f64 {
    edge_m / f64::from(SIDE) / f64::from(1u32 << level)
}
