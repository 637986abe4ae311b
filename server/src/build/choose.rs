//! Images or the LDI tree alone (row S7): at the same bound on the error what takes fewer bytes.
//! In, a plan, not yet made into images; out, a [`Weighing`], and the tree if it was built for it.
//!
//! 1. Random eyes tell how fine samples have to be beyond the geometry ([`Probes`]).
//! 2. The images of a few placements are made; all are expected to take as much each.
//! 3. The samples that a tree would need are estimated from how near eyes come to every part of
//!    the scene. If they take more bytes than the images, that is all.
//! 4. Otherwise the tree is built, what samples it has at the probed points is looked up, and how
//!    many of them an eye draws is counted.

use super::{BuildError, BuildOptions, images, kept_tree::TreeInput};
use crate::pack::PackError;
use crate::placement::{ImagePlan, PlacementPlan};
use crate::render::Caster;
use crate::scene::Note;
use crate::store::DatasetWriter;
use crate::tree::{BuiltTree, Depth, Probes};
use ldi_protocol::{
    codec::ColourProfile,
    index::{BuildSettings, CellEntry},
    volume::WalkVolume,
};
use serde::Serialize;

/// Share of far points where samples may be larger than the bound, or missing: as many pixels as
/// images may leave open.
pub const BEYOND: f64 = 0.001;
/// Placements whose images are made to tell what all take.
const SAMPLED: usize = 12;
/// Samples that an eye may draw per pixel of the picture: more than images warp, but not so many
/// that frames take several times as long.
const DRAWN_PER_PIXEL: u64 = 3;
/// Bytes of a tree's sample, as measured where they are fine (docs/benchmarks/tree.md); coarse
/// ones take up to four.
const BYTES_PER_SAMPLE: f64 = 0.6;
/// Samples that a tree can be grown with: some 100 bytes each while it grows.
const MAX_SAMPLES: f64 = 30e6;
/// Pixels along a side of a reference image: the picture's own density within 90 degrees is enough
/// for what is as far from the reference as from the eye.
const SIDES: [f64; 2] = [256.0, 1024.0];
/// Pixels of all reference images: some minutes on two cores.
const MAX_PIXELS: f64 = 1e9;

/// What was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Weighing {
    /// `grid` or `tree`.
    pub chosen: &'static str,
    /// In words.
    pub why: String,
    /// Probed points beyond the geometry.
    pub far_points: usize,
    /// Distance of samples that keeps the bound at all of them but [`BEYOND`], metres.
    pub needed_pitch_m: f64,
    /// Bytes that all images are expected to take.
    pub images_bytes_expected: u64,
    /// Placements whose images were made to tell.
    pub placements_sampled: usize,
    /// Bytes that a tree as fine as that is expected to take.
    pub tree_bytes_expected: u64,
    /// Bytes of the tree that was built; None if it was not worth a try.
    pub tree_bytes: Option<u64>,
    /// Share of probed points where that tree's samples are larger than the bound, or missing.
    pub tree_beyond_bound: Option<f64>,
    /// Samples of it that nine of ten probed eyes draw at most.
    pub tree_samples_drawn: Option<u64>,
}

impl Weighing {
    /// What was left out, and why.
    pub fn note(&self) -> Note {
        let what = if self.chosen == "tree" {
            "images: the LDI tree alone"
        } else {
            "the LDI tree alone: images over its coarse levels"
        };
        Note { what: what.into(), why: self.why.clone() }
    }
}

/// What the images of some plans are expected to take, by those of a few of them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImageBytes {
    /// Of all.
    pub all: u64,
    /// Per pixel of an image as planned.
    pub per_pixel: f64,
    /// Placements whose images were made to tell.
    pub sampled: usize,
}

impl ImageBytes {
    /// Makes the images of [`SAMPLED`] placements, spread over all. Images differ in size by
    /// factors of hundreds, in bytes per pixel by few.
    pub fn expected(
        caster: &Caster,
        plans: &[PlacementPlan],
        settings: &BuildSettings,
        colour: ColourProfile,
        scene_key: &[u8; 32],
        writer: &DatasetWriter,
    ) -> Result<Self, BuildError> {
        let step = (plans.len() / SAMPLED).max(1);
        let sampled: Vec<PlacementPlan> = plans.iter().step_by(step).cloned().collect();
        if sampled.is_empty() {
            return Ok(Self::default());
        }
        let made = images::construct_all(caster, &sampled, settings, colour, scene_key, writer, None, &())?;
        let bytes: u64 = made.entries().map(|e| u64::from(e.stored_bytes)).sum();
        let pixels = |plans: &[PlacementPlan]| plans.iter().flat_map(|p| &p.images).map(pixels_of).sum::<u64>();
        let per_pixel = bytes as f64 / pixels(&sampled).max(1) as f64;
        Ok(Self { all: (per_pixel * pixels(plans) as f64) as u64, per_pixel, sampled: sampled.len() })
    }
}

/// As planned.
pub(super) fn pixels_of(image: &ImagePlan) -> u64 {
    let camera = super::planned_camera(image);
    u64::from(camera.width) * u64::from(camera.height)
}

pub(super) fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}

/// What there is to weigh.
pub struct Candidates<'a> {
    pub caster: &'a Caster,
    pub tree_input: &'a TreeInput<'a>,
    pub volume: &'a WalkVolume,
    pub cells: &'a [CellEntry],
    pub plans: &'a [PlacementPlan],
    pub settings: &'a BuildSettings,
}

/// Weighs images against a tree. The tree comes with it if it is chosen.
pub fn weigh(
    c: &Candidates<'_>,
    options: &BuildOptions,
    writer: &DatasetWriter,
    heard: &dyn Fn(&str),
) -> Result<(Weighing, Option<BuiltTree>), BuildError> {
    let focal_px = c.settings.camera.focal_px();
    let bound = c.settings.max_footprint_px;
    let probes = Probes::take(c.caster, c.volume, c.cells, c.settings);
    let needed = probes.needed_pitch_m(bound, focal_px, BEYOND);
    heard(&format!("images of some of {} placements, to tell what all take", c.plans.len()));
    let images = ImageBytes::expected(c.caster, c.plans, c.settings, options.colour, c.tree_input.scene_key, writer)?;
    let images_bytes = images.all;
    let mut found = Weighing {
        chosen: "grid",
        why: String::new(),
        far_points: probes.far.len(),
        needed_pitch_m: needed.unwrap_or(0.0),
        images_bytes_expected: images_bytes,
        placements_sampled: images.sampled,
        tree_bytes_expected: 0,
        tree_bytes: None,
        tree_beyond_bound: None,
        tree_samples_drawn: None,
    };
    let Some(pitch_m) = needed else {
        found.why = "no probed eye sees anything beyond the geometry that it draws".into();
        return Ok((found, None));
    };
    let samples = c.tree_input.places.samples_at(bound, focal_px, pitch_m);
    found.tree_bytes_expected = (samples * BYTES_PER_SAMPLE) as u64;
    let images_take = megabytes(images_bytes);
    let expected = format!(
        "a tree with samples of {:.1} mm is expected to have {:.0} million of them and to take {}, images {images_take}",
        pitch_m * 1e3,
        samples / 1e6,
        megabytes(found.tree_bytes_expected)
    );
    if found.tree_bytes_expected >= images_bytes || samples > MAX_SAMPLES {
        let limit = if samples > MAX_SAMPLES {
            format!("; no more than {:.0} million can be grown", MAX_SAMPLES / 1e6)
        } else {
            String::new()
        };
        found.why = expected + &limit;
        return Ok((found, None));
    }
    heard(&format!("{expected}: it is tried"));
    let pixels_per_side = (MAX_PIXELS / (6 * c.tree_input.places.positions.len().max(1)) as f64).sqrt();
    let side = (2.0 * focal_px / bound).clamp(SIDES[0], SIDES[1]).min(pixels_per_side) as u32;
    let depth = Depth::Fine { pitch_m, side };
    let Some(built) = c.tree_input.tree(depth, writer, heard)? else {
        found.why = "no reference sees any surface".into();
        return Ok((found, None));
    };
    let bytes: u64 = built.figures.bytes_by_level.iter().sum();
    let decode = |source| PackError { what: "the LDI tree, read back".into(), source };
    let footprints = probes.footprints(&built, focal_px).map_err(decode)?;
    let beyond = footprints.iter().filter(|px| **px > bound).count() as f64 / footprints.len().max(1) as f64;
    let drawn = probes.samples_drawn(&built.tree, c.settings);
    (found.tree_bytes, found.tree_beyond_bound, found.tree_samples_drawn) = (Some(bytes), Some(beyond), Some(drawn));
    let most = DRAWN_PER_PIXEL * u64::from(c.settings.camera.width) * u64::from(c.settings.camera.height);
    let takes = format!("the tree takes {}, images {images_take}", megabytes(bytes));
    let draws = format!("an eye draws up to {:.1} million of its samples", drawn as f64 / 1e6);
    let larger =
        format!("at {:.3}% of the far surfaces its samples are larger than {bound} pixels or missing", beyond * 100.0);
    found.why = format!("{takes}; {larger}; {draws}");
    if beyond > BEYOND || bytes >= images_bytes || drawn > most {
        return Ok((found, None));
    }
    found.chosen = "tree";
    Ok((found, Some(built)))
}
