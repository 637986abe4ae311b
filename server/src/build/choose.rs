//! Which representation a build takes where several would do: at the same bound on the error the one with fewer bytes to send, or to keep.
//!
//! Rooms or the grid alone: by what walks need, [`RoomWeighing`]. Images or the LDI tree alone (row S7): in, a plan, not yet made into images; out, a [`Weighing`], and the tree if it was built for it.
//!
//! 1. Random eyes tell how fine samples have to be beyond the geometry ([`Probes`]).
//! 2. The images of a few placements are made; all are expected to take as much each.
//! 3. The samples that a tree would need are estimated from how near eyes come to every part of the scene. If they take more bytes than the images, that is all.
//! 4. Otherwise the tree is built, what samples it has at the probed points is looked up, and how many of them an eye draws is counted.

use super::{BuildError, BuildOptions, images};
use crate::pack::PackError;
use crate::placement::{AuditReport, ImagePlan, PlacementPlan};
use crate::render::Caster;
use crate::scene::Note;
use crate::store::DatasetWriter;
use crate::tree::{self, BuiltTree, Depth, Places, Probes};
use ldi_protocol::{
    Aabb, Pose,
    codec::ColourProfile,
    index::{BuildSettings, CellEntry, Index},
    need::needed,
    select::{CellGroups, Show, draw_list_of},
    stroll::{FPS, Random, stroll},
    volume::WalkVolume,
};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeSet;

/// Share of far points where samples may be larger than the bound, or missing: as many pixels as images may leave open.
pub const BEYOND: f64 = 0.001;
/// Placements whose images are made to tell what all take.
const SAMPLED: usize = 12;
/// Samples that an eye may draw per pixel of the picture: more than images warp, but not so many that frames take several times as long.
const DRAWN_PER_PIXEL: u64 = 3;
/// Bytes of a tree's sample, as measured where they are fine (docs/tree.md); coarse ones take up to four.
const BYTES_PER_SAMPLE: f64 = 0.6;
/// Samples that a tree can be grown with: some 100 bytes each while it grows.
const MAX_SAMPLES: f64 = 30e6;
/// Pixels along a side of a reference image: the picture's own density within 90 degrees is enough for what is as far from the reference as from the eye.
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
    /// Makes the images of [`SAMPLED`] placements, spread over all. Images differ in size by factors of hundreds, in bytes per pixel by few.
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
        let made = images::construct_all(caster, &sampled, settings, colour, scene_key, writer, &())?;
        let bytes: u64 = made.entries().map(|e| u64::from(e.stored_bytes)).sum();
        let pixels = |plans: &[PlacementPlan]| plans.iter().flat_map(|p| &p.images).map(pixels_of).sum::<u64>();
        let per_pixel = bytes as f64 / pixels(&sampled).max(1) as f64;
        Ok(Self { all: (per_pixel * pixels(plans) as f64) as u64, per_pixel, sampled: sampled.len() })
    }
}

/// As planned.
fn pixels_of(image: &ImagePlan) -> u64 {
    let camera = super::planned_camera(image);
    u64::from(camera.width) * u64::from(camera.height)
}

/// Walks that tell what is sent: an hour in all, whose poses take seconds to look at. Fewer: where they happen to begin decides.
const WALKS: u64 = 64;
/// How long each is, seconds: the first minute is what people judge, and longer ones of random turns hardly get farther.
const WALK_S: f64 = 60.0;
/// Poses that are looked at are so many apart: a quarter of a second, in which one walks a third of a metre or turns by half of the picture.
const POSES_APART: usize = 15;

/// A minute each, from places all over the volume, not through walls.
pub struct Walks(Vec<Vec<Pose>>);

impl Walks {
    /// Always the same ones for the same scene.
    pub fn take(caster: &Caster, volume: &WalkVolume) -> Self {
        let free = |from, to| super::sees(caster, from, to);
        let walk = |stream| {
            let poses = stroll(volume, &mut Random::new(1, stream), (WALK_S * FPS) as usize, free);
            poses.into_iter().step_by(POSES_APART).collect()
        };
        Self((0..WALKS).into_par_iter().map(walk).collect())
    }

    /// Stored bytes that a walk needs, mean of all. `index`: with the chunks of its geometry, its images as those of `plans`, not yet made.
    fn bytes(&self, mut index: Index, plans: &[PlacementPlan], bytes_per_pixel: f64) -> u64 {
        // An image without chunks shows nothing, so nobody would need it: these have one, which is none of the index's.
        index.images.iter_mut().for_each(|i| i.chunks = vec![u32::MAX]);
        let index = &index;
        let pixels: Vec<u64> = plans.iter().flat_map(|p| &p.images).map(pixels_of).collect();
        let groups = CellGroups::of(&index.cells);
        let camera = &index.settings.camera;
        let half_tan = (camera.half_tan_x(), camera.half_tan_y());
        let of_walk = |walk: &Vec<Pose>| {
            let (mut images, mut chunks) = (BTreeSet::new(), BTreeSet::new());
            for pose in walk {
                let list = draw_list_of(index, &groups, pose, half_tan, Show::default());
                chunks.extend(needed(index, &[], &list.cells, &[]).all());
                images.extend(list.images);
            }
            let geometry: u64 = chunks.iter().map(|c| u64::from(index.chunks[*c as usize].stored_bytes)).sum();
            let pixels: u64 = images.iter().filter_map(|i| pixels.get(*i as usize)).sum();
            geometry + (bytes_per_pixel * pixels as f64) as u64
        };
        self.0.par_iter().map(of_walk).sum::<u64>() / self.0.len().max(1) as u64
    }
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}

/// Rooms, with the grid where those are too much, against the grid alone: at the same bound on footprints, what brings a walker fewer bytes. What all of it takes
/// on the server's disk is told, too, and decides nothing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RoomWeighing {
    /// `portals` or `grid`.
    pub chosen: &'static str,
    /// In words.
    pub why: String,
    /// By rooms.
    pub portals: Weight,
    /// By the grid alone.
    pub grid: Weight,
    /// Random walks of a minute that tell what a walk needs.
    pub walks: usize,
    /// Poses of an audit of the plan by rooms, and in how many of them it breaks a promise; that of the grid alone is certified.
    pub poses: u64,
    /// See there.
    pub violations: u64,
}

/// Of one of them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Weight {
    /// Bytes that a walk of a minute is expected to need, in the mean.
    pub walk_bytes_expected: u64,
    /// Bytes that its images are expected to take.
    pub images_bytes_expected: u64,
    /// Placements whose images were made to tell.
    pub placements_sampled: usize,
}

impl Weight {
    /// Weighs a plan; `index` as of [`Walks::bytes`].
    pub(super) fn of(walks: &Walks, index: Index, plans: &[PlacementPlan], images: ImageBytes) -> Self {
        Self {
            walk_bytes_expected: walks.bytes(index, plans, images.per_pixel),
            images_bytes_expected: images.all,
            placements_sampled: images.sampled,
        }
    }
}

impl RoomWeighing {
    /// A choice.
    pub const PORTALS: &'static str = "portals";
    /// A choice.
    pub const GRID: &'static str = "grid";

    /// Weighs.
    pub(super) fn of(audit: &AuditReport, walks: &Walks, portals: Weight, grid: Weight) -> Self {
        let (poses, violations) = (audit.all_poses(), audit.violations);
        let takes = |w: &Weight| {
            let [walk, images] = [w.walk_bytes_expected, w.images_bytes_expected].map(megabytes);
            format!("{walk} ({images} of images in all)")
        };
        let bytes = format!(
            "a walk of a minute is expected to need {} by rooms, {} by the grid alone",
            takes(&portals),
            takes(&grid)
        );
        let (chosen, why) = match (violations, portals.walk_bytes_expected <= grid.walk_bytes_expected) {
            (0, true) => (Self::PORTALS, bytes),
            (0, false) => (Self::GRID, bytes),
            _ => (Self::GRID, format!("by rooms {violations} of {poses} poses would break a promise; {bytes}")),
        };
        Self { chosen, why, portals, grid, walks: walks.0.len(), poses, violations }
    }

    /// What was left out, and why.
    pub fn note(&self) -> Note {
        let what = if self.chosen == Self::PORTALS { "the grid alone: rooms" } else { "rooms: the grid alone" };
        Note { what: what.into(), why: self.why.clone() }
    }
}

/// What there is to weigh.
pub struct Candidates<'a> {
    pub caster: &'a Caster,
    pub bounds: Aabb,
    pub places: &'a Places,
    pub volume: &'a WalkVolume,
    pub cells: &'a [CellEntry],
    pub plans: &'a [PlacementPlan],
    pub settings: &'a BuildSettings,
    pub scene_key: &'a [u8; 32],
    /// Number of the tree's first chunk.
    pub first_chunk: u32,
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
    let images = ImageBytes::expected(c.caster, c.plans, c.settings, options.colour, c.scene_key, writer)?;
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
    let samples = c.places.samples_at(bound, focal_px, pitch_m);
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
    let pixels_per_side = (MAX_PIXELS / (6 * c.places.positions.len().max(1)) as f64).sqrt();
    let side = (2.0 * focal_px / bound).clamp(SIDES[0], SIDES[1]).min(pixels_per_side) as u32;
    let depth = Depth::Fine { pitch_m, side };
    let Some(built) = tree::build_tree(c.caster, &c.bounds, c.places, depth, c.first_chunk, heard)? else {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walks_need_geometry_and_images() {
        let options = BuildOptions {
            represent: crate::build::Represent::Grid,
            along: None,
            // Of a budget that is told as a share the settings know nothing.
            budget_share: Some(0.3),
            scene: "builtin:house?triangles=20000".into(),
            output: "".into(),
            settings: crate::placement::test_scenes::settings(0),
            colour: ColourProfile::Lossless,
        };
        let p = super::super::plan(&options, &mut Default::default(), &()).unwrap();
        let plan = &p.plan;
        assert_eq!(p.settings.budget, p.scene.triangles() * 3 / 10);
        let geometry = crate::pack::pack_geometry(&p.scene, &p.clusters, &p.octree, 0).unwrap();
        let index = Index {
            chunks: geometry.chunks.iter().map(super::super::chunk_entry).collect(),
            ..super::super::draft_index(&options, &p.scene, &p.settings, plan, geometry.cells.clone(), None)
        };
        let walks = Walks::take(p.caster.as_ref().unwrap(), &plan.volume);
        let bytes = |per_pixel| walks.bytes(index.clone(), &plan.plans, per_pixel);
        let (without, with) = (bytes(0.0), bytes(1.0));
        let all: u64 = index.chunks.iter().map(|c| u64::from(c.stored_bytes)).sum();
        let pixels: u64 = plan.plans.iter().flat_map(|p| &p.images).map(pixels_of).sum();
        assert!(0 < without && without <= all, "{without} of {all} bytes of geometry");
        assert!(0 < with - without && with - without <= pixels, "{} of {pixels} pixels", with - without);
    }

    #[test]
    fn rooms_are_taken_where_they_keep_the_promises_and_walks_need_fewer_bytes() {
        let audit = |violations| AuditReport { poses: 1_000, violations, ..Default::default() };
        // Whatever they take in all.
        let weight = |walk_bytes_expected, images_bytes_expected| Weight {
            walk_bytes_expected,
            images_bytes_expected,
            placements_sampled: 3,
        };
        let chosen = |violations, rooms, grid| {
            let walks = Walks(vec![Vec::new(); 2]);
            let found = RoomWeighing::of(&audit(violations), &walks, weight(rooms, 9_000_000), weight(grid, 1_000_000));
            assert_eq!((found.poses, found.violations, found.walks), (1_000, violations, 2));
            (found.chosen, found.why)
        };
        assert_eq!(chosen(0, 2_000_000, 3_000_000).0, "portals");
        let (grid, why) = chosen(0, 4_000_000, 3_000_000);
        assert_eq!(grid, "grid");
        assert!(why.contains("4.0 MB") && why.contains("3.0 MB") && why.contains("9.0 MB of images"), "{why}");
        let (grid, why) = chosen(7, 2_000_000, 3_000_000);
        assert_eq!(grid, "grid");
        assert!(why.contains("7 of 1000 poses"), "{why}");
    }
}
