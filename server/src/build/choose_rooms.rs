//! Rooms, the grid, or both: at the same bound on footprints by what walks need. In, plans, not
//! yet made into images; out, a [`RoomWeighing`] and the plan that was chosen.
//!
//! 1. Random walks tell what walkers need in which room, by rooms and by the grid alone.
//! 2. Which rooms the grid should serve for walks to need least is searched for; where that saves
//!    enough, a plan is made in which it serves those.
//! 3. What breaks no promise and brings the least is taken.

use super::choose::{ImageBytes, megabytes, pixels_of};
use super::planning::{place, sees};
use super::rooms::{self, PortalOptions, RoomPlan, Site};
use super::{AUDITED_POSES, BuildError, BuildOptions, Progress, draft_index, planned_camera};
use crate::levels::Levels;
use crate::octree::Octree;
use crate::placement::{self, AuditReport, PlacementPlan, PlacementResult};
use crate::render::Caster;
use crate::scene::{Note, Scene};
use crate::store::DatasetWriter;
use ldi_protocol::{
    Pose,
    index::{BuildSettings, CellEntry, ChunkEntry, Index, TextureEntry},
    ldi::LdiCamera,
    need::{Sight, needed},
    room_index::{PortalImages, RoomIndex},
    rooms::Rooms,
    select::{CellGroups, Show, draw_list_of},
    stroll::{FPS, Random, stroll},
    volume::WalkVolume,
};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Walks that tell what is sent: an hour in all, whose poses take seconds to look at. Fewer: where
/// they happen to begin decides.
const WALKS: u64 = 64;
/// How long each is, seconds: the first minute is what people judge, and longer ones of random
/// turns hardly get farther.
const WALK_S: f64 = 60.0;
/// Poses that are looked at are so many apart: a quarter of a second, in which one walks a third
/// of a metre or turns by half of the picture.
const POSES_APART: usize = 15;

/// A minute each, from places all over the volume, not through walls.
struct Walks(Vec<Vec<Pose>>);

impl Walks {
    /// Always the same ones for the same scene.
    fn take(caster: &Caster, volume: &WalkVolume) -> Self {
        let free = |from, to| sees(caster, from, to);
        let walk = |stream| {
            let poses = stroll(volume, &mut Random::new(1, stream), (WALK_S * FPS) as usize, free);
            poses.into_iter().step_by(POSES_APART).collect()
        };
        Self((0..WALKS).into_par_iter().map(walk).collect())
    }

    /// What walks need of a plan. `index`: with the chunks of its geometry, its images as those of
    /// `plans`, not yet made.
    fn needs(&self, mut index: Index, plans: &[PlacementPlan], bytes_per_pixel: f64, rooms: Option<&Rooms>) -> Needs {
        // An image without chunks shows nothing, so nobody would need it: these have one, which is
        // none of the index's.
        index.images.iter_mut().for_each(|i| i.chunks = vec![u32::MAX]);
        let index = &index;
        let groups = CellGroups::of(&index.cells);
        let camera = &index.settings.camera;
        let half_tan = (camera.half_tan_x(), camera.half_tan_y());
        let outside = rooms.map_or(0, |r| r.cells().len());
        let of_walk = |walk: &Vec<Pose>| {
            let mut needs = BTreeMap::<usize, Needed>::new();
            for pose in walk {
                let room = rooms.and_then(|r| r.cell_at(pose.position)).map_or(outside, |c| c as usize);
                let list = draw_list_of(index, &groups, pose, half_tan, Show::default());
                let here = needs.entry(room).or_default();
                here.chunks.extend(needed(index, &[], &list.cells, &[], &Sight::new(pose, camera, 1)).all());
                here.images.extend(list.images);
            }
            needs
        };
        let image = |i| (bytes_per_pixel * pixels_of(i) as f64) as u64;
        Needs {
            walks: self.0.par_iter().map(of_walk).collect(),
            chunk_bytes: index.chunks.iter().map(|c| u64::from(c.stored_bytes)).collect(),
            image_bytes: plans.iter().flat_map(|p| &p.images).map(image).collect(),
            rooms: outside + 1,
        }
    }
}

/// Chunks of geometry and textures, and images, by number.
#[derive(Default)]
struct Needed {
    chunks: BTreeSet<u32>,
    images: BTreeSet<u32>,
}

/// What walks need.
struct Needs {
    /// Per walk, by the room of the eye, the outside last; without rooms all is the outside's.
    walks: Vec<BTreeMap<usize, Needed>>,
    /// Stored bytes.
    chunk_bytes: Vec<u64>,
    /// Likewise, expected.
    image_bytes: Vec<u64>,
    /// The outside included.
    rooms: usize,
}

fn sum(bytes: &[u64], of: &BTreeSet<u32>) -> u64 {
    of.iter().filter_map(|i| bytes.get(*i as usize)).sum()
}

impl Needs {
    /// Bytes of all walks.
    fn all(&self) -> u64 {
        (0..self.walks.len()).map(|walk| self.of_walk(walk, self, &[])).sum()
    }

    /// Bytes of a walk where `other` serves some rooms instead. What several rooms need counts
    /// once.
    fn of_walk(&self, walk: usize, other: &Self, by_other: &[bool]) -> u64 {
        let (mut chunks, mut images) = (BTreeSet::new(), [BTreeSet::new(), BTreeSet::new()]);
        let is_others = |room: usize| by_other.get(room) == Some(&true);
        let own = self.walks[walk].iter().filter(|(room, _)| !is_others(**room)).map(|(_, needs)| (0, needs));
        let others = other.walks[walk].iter().filter(|(room, _)| is_others(**room)).map(|(_, needs)| (1, needs));
        for (way, needs) in own.chain(others) {
            chunks.extend(&needs.chunks);
            images[way].extend(&needs.images);
        }
        sum(&self.chunk_bytes, &chunks) + sum(&self.image_bytes, &images[0]) + sum(&other.image_bytes, &images[1])
    }

    /// The rooms that `other` should serve for walks to need least, and what they then need: from
    /// none and from all rooms on, the one that saves most changes hands, until none saves
    /// anything.
    fn shared_with(&self, other: &Self) -> (Vec<bool>, u64) {
        let from = |start: bool| {
            let mut by_other = vec![start; self.rooms];
            let mut bytes: Vec<u64> = (0..self.walks.len()).map(|w| self.of_walk(w, other, &by_other)).collect();
            loop {
                let flip = |room: usize| {
                    let mut changed = by_other.clone();
                    changed[room] = !changed[room];
                    let through = (0..bytes.len()).filter(|walk| self.walks[*walk].contains_key(&room));
                    let new: Vec<(usize, u64)> =
                        through.map(|walk| (walk, self.of_walk(walk, other, &changed))).collect();
                    let saved: i64 = new.iter().map(|(walk, now)| bytes[*walk] as i64 - *now as i64).sum();
                    (saved, room, new)
                };
                let best = (0..self.rooms).into_par_iter().map(flip).max_by_key(|(saved, room, _)| (*saved, *room));
                let Some((_, room, new)) = best.filter(|(saved, ..)| *saved > 0) else { break };
                by_other[room] = !by_other[room];
                new.into_iter().for_each(|(walk, now)| bytes[walk] = now);
            }
            (by_other, bytes.iter().sum::<u64>())
        };
        let [none, all] = [false, true].map(from);
        if all.1 < none.1 { all } else { none }
    }
}

/// Share of what walks need by rooms alone or by the grid alone that has to be saved for another
/// plan, in which the grid serves some rooms: it takes minutes where rooms are many. By judgement.
const WORTH: f64 = 0.05;

/// The rooms that the grid should serve; none where that saves too little.
fn cheaper_by_grid(by_rooms: &Needs, by_grid: &Needs) -> Vec<bool> {
    let (grids, bytes) = by_rooms.shared_with(by_grid);
    let alone = by_rooms.all().min(by_grid.all());
    if bytes as f64 <= (1.0 - WORTH) * alone as f64 { grids } else { Vec::new() }
}

/// Rooms, with the grid where those are too much, against the grid alone, and against rooms with
/// the grid also where it alone would bring less: at the same bound on footprints, what brings a
/// walker fewer bytes. What all of it takes on the server's disk is told, too, and decides
/// nothing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RoomWeighing {
    /// `portals`, `grid` or `mixed`.
    pub chosen: &'static str,
    /// In words.
    pub why: String,
    /// By rooms.
    pub portals: Weight,
    /// By the grid alone.
    pub grid: Weight,
    /// By rooms, and by the grid in some of them; None where that could not save enough.
    pub mixed: Option<Mixed>,
    /// Random walks of a minute that tell what a walk needs.
    pub walks: usize,
    /// Poses of an audit of the plan by rooms, and in how many of them it breaks a promise; that
    /// of the grid alone is certified.
    pub poses: u64,
    /// See there.
    pub violations: u64,
}

/// A plan in which the grid serves some rooms.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Mixed {
    /// What it takes.
    #[serde(flatten)]
    pub weight: Weight,
    /// The rooms that the grid serves, by name; the outside has none.
    pub grid_rooms: Vec<String>,
    /// Of as many poses as of the plan by rooms.
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
    /// Weighs a plan.
    fn of(needs: &Needs, images: ImageBytes) -> Self {
        Self {
            walk_bytes_expected: needs.all() / needs.walks.len().max(1) as u64,
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

    /// A choice.
    pub const MIXED: &'static str = "mixed";

    /// Weighs.
    fn of(audit: &AuditReport, walks: &Walks, portals: Weight, grid: Weight, mixed: Option<Mixed>) -> Self {
        let (poses, violations) = (audit.all_poses(), audit.violations);
        let takes = |w: &Weight| {
            let [walk, images] = [w.walk_bytes_expected, w.images_bytes_expected].map(megabytes);
            format!("{walk} ({images} of images in all)")
        };
        let mut bytes = format!(
            "a walk of a minute is expected to need {} by rooms, {} by the grid alone",
            takes(&portals),
            takes(&grid)
        );
        if let Some(m) = &mixed {
            bytes += &format!(", {} by rooms and in {} of them by the grid", takes(&m.weight), m.grid_rooms.len());
            if m.violations > 0 {
                bytes += &format!(", where {} of {poses} poses would break a promise", m.violations);
            }
        }
        let sound = mixed.iter().filter(|m| m.violations == 0).map(|m| (Self::MIXED, &m.weight));
        let by_rooms = (violations == 0).then_some((Self::PORTALS, &portals));
        // Of equals the first.
        let all = by_rooms.into_iter().chain([(Self::GRID, &grid)]).chain(sound);
        let (chosen, _) = all.min_by_key(|(_, w)| w.walk_bytes_expected).unwrap_or((Self::GRID, &grid));
        let why = match violations {
            0 => bytes,
            _ => format!("by rooms {violations} of {poses} poses would break a promise; {bytes}"),
        };
        Self { chosen, why, portals, grid, mixed, walks: walks.0.len(), poses, violations }
    }

    /// What was left out, and why.
    pub fn note(&self) -> Note {
        let what = match self.chosen {
            Self::PORTALS => "the grid alone: rooms",
            Self::GRID => "rooms: the grid alone",
            _ => "the grid alone, and rooms alone: each where walks need less",
        };
        Note { what: what.into(), why: self.why.clone() }
    }
}

/// What plans are made of.
pub(super) struct Ground<'a> {
    pub options: &'a BuildOptions,
    pub caster: &'a Caster,
    pub scene: &'a Scene,
    pub octree: &'a Octree,
    pub levels: &'a Levels,
    pub settings: &'a BuildSettings,
    pub cells: &'a [CellEntry],
    pub chunks: &'a [ChunkEntry],
    pub textures: &'a [TextureEntry],
    pub scene_key: &'a [u8; 32],
    pub writer: &'a DatasetWriter,
    pub progress: &'a dyn Progress,
}

impl Ground<'_> {
    /// With the chunks of geometry and textures.
    fn index(&self, plan: &PlacementResult, rooms: Option<&RoomIndex>) -> Index {
        Index {
            chunks: self.chunks.to_vec(),
            textures: self.textures.to_vec(),
            ..draft_index(self.options, self.scene, self.settings, plan, self.cells.to_vec(), rooms)
        }
    }

    fn weigh(
        &self,
        walks: &Walks,
        plan: &PlacementResult,
        rooms: Option<&RoomIndex>,
        site: &Site,
    ) -> Result<(Weight, Needs), BuildError> {
        let Self { caster, settings, scene_key, writer, .. } = self;
        let images = ImageBytes::expected(caster, &plan.plans, settings, self.options.colour, scene_key, writer)?;
        let needs = walks.needs(self.index(plan, rooms), &plan.plans, images.per_pixel, Some(site.rooms()));
        Ok((Weight::of(&needs, images), needs))
    }

    fn audit(&self, plan: &PlacementResult, rooms: &RoomIndex) -> AuditReport {
        let counts: Vec<u64> = self.cells.iter().map(|c| u64::from(c.triangles)).collect();
        let cameras: Vec<LdiCamera> = plan.plans.iter().flat_map(|p| &p.images).map(planned_camera).collect();
        let camera = |i| cameras.get(i as usize).copied();
        placement::audit(&self.index(plan, Some(rooms)), &counts, &camera, AUDITED_POSES, 1)
    }

    /// The plan by rooms in which the grid serves those of `by_grid` as well.
    fn mixed(
        &self,
        (plan, by_rooms, site): (&PlacementResult, &RoomPlan, &Site),
        portals: &PortalOptions,
        by_grid: Vec<bool>,
    ) -> Result<(PlacementResult, RoomPlan), BuildError> {
        let Self { options, caster, scene, octree, levels, settings, progress, .. } = *self;
        let nothing = PlacementResult { points: Vec::new(), plans: Vec::new(), ..plan.clone() };
        let draft = draft_index(options, scene, settings, &nothing, self.cells.to_vec(), None);
        let grid = |volume| place(scene, (octree, levels), settings, caster, volume, progress);
        let share = rooms::Share { by_grid, before: Some(by_rooms) };
        let (mut mixed, found) = rooms::plan_rooms(caster, site, portals, draft, share, &grid, progress)?;
        mixed.statistics.skipped.clone_from(&plan.statistics.skipped);
        Ok((mixed, found))
    }
}

/// Chooses between a plan by rooms, one by the grid alone and, where that promises to be less, one
/// by both.
pub(super) fn choose_rooms(
    ground: &Ground<'_>,
    (plan, by_rooms, site): (PlacementResult, RoomPlan, &Site),
    grid_alone: PlacementResult,
    portals: &PortalOptions,
) -> Result<(RoomWeighing, PlacementResult, Option<RoomPlan>), BuildError> {
    let walks = Walks::take(ground.caster, &plan.volume);
    let audited = ground.audit(&plan, &by_rooms.index);
    let (portals_weight, needs_by_rooms) = ground.weigh(&walks, &plan, Some(&by_rooms.index), site)?;
    let (grid_weight, needs_by_grid) = ground.weigh(&walks, &grid_alone, None, site)?;
    let mut by_grid = cheaper_by_grid(&needs_by_rooms, &needs_by_grid);
    if !portals.images.offer(PortalImages::Zones) || audited.violations > 0 {
        by_grid.clear();
    }
    let mut both = None;
    if !by_grid.is_empty() {
        let name = |room: usize| site.rooms().cells().get(room).map_or_else(String::new, |c| c.name.clone());
        let grid_rooms: Vec<String> = (0..).zip(&by_grid).filter(|(_, b)| **b).map(|(room, _)| name(room)).collect();
        ground.progress.note(&format!("{} of {} rooms by the grid are tried", grid_rooms.len(), by_grid.len()));
        let (mixed, found) = ground.mixed((&plan, &by_rooms, site), portals, by_grid)?;
        let violations = ground.audit(&mixed, &found.index).violations;
        let (weight, _) = ground.weigh(&walks, &mixed, Some(&found.index), site)?;
        both = Some((Mixed { weight, grid_rooms, violations }, mixed, found));
    }
    let told = both.as_ref().map(|(m, ..)| m.clone());
    let found = RoomWeighing::of(&audited, &walks, portals_weight, grid_weight, told);
    ground.progress.note(&format!("{}: {}", found.chosen, found.why));
    Ok(match (found.chosen, both) {
        (RoomWeighing::GRID, _) => (found, grid_alone, None),
        (RoomWeighing::MIXED, Some((_, mixed, of_both))) => (found, mixed, Some(of_both)),
        _ => (found, plan, Some(by_rooms)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ldi_protocol::codec::ColourProfile;

    #[test]
    fn walks_need_geometry_and_images() {
        let options = BuildOptions {
            represent: crate::build::Represent::Grid,
            starts: Vec::new(),
            along: None,
            time_limit: None,
            // Of a budget that is told as a share the settings know nothing.
            budget: crate::build::BudgetRule::Share(0.3),
            scenes: vec!["builtin:house?triangles=20000".into()],
            output: "".into(),
            settings: placement::test_scenes::settings(0),
            colour: ColourProfile::Lossless,
        };
        let p = super::super::plan(&options, &mut Default::default(), &()).unwrap();
        let plan = &p.plan;
        assert_eq!(p.settings.budget, p.scene.triangles() * 3 / 10);
        let geometry = crate::pack::pack_geometry(&p.scene, &p.clusters, &p.octree, &p.levels, 0).unwrap();
        let index = Index {
            chunks: geometry.chunks.iter().map(super::super::chunk_entry).collect(),
            ..draft_index(&options, &p.scene, &p.settings, plan, geometry.cells.clone(), None)
        };
        let walks = Walks::take(&p.caster, &plan.volume);
        let bytes = |per_pixel| walks.needs(index.clone(), &plan.plans, per_pixel, None).all() / WALKS;
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
            let found =
                RoomWeighing::of(&audit(violations), &walks, weight(rooms, 9_000_000), weight(grid, 1_000_000), None);
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
        let mixed = |violations, bytes| {
            let m = Mixed { weight: weight(bytes, 1), grid_rooms: vec!["hall".into(), String::new()], violations };
            let walks = Walks(vec![Vec::new(); 2]);
            RoomWeighing::of(&audit(0), &walks, weight(2_000_000, 1), weight(3_000_000, 1), Some(m))
        };
        let found = mixed(0, 1_500_000);
        assert_eq!(found.chosen, "mixed");
        assert!(found.why.contains("1.5 MB") && found.why.contains("in 2 of them by the grid"), "{}", found.why);
        assert_eq!(mixed(0, 2_000_000).chosen, "portals", "without need it is not mixed");
        let broken = mixed(3, 1_500_000);
        assert_eq!(broken.chosen, "portals");
        assert!(broken.why.contains("3 of 1000 poses"), "{}", broken.why);
    }

    /// What walks need in each of three rooms: chunks of 100 bytes, and images.
    fn needs(walks: &[[(&[u32], &[u32]); 3]], image_bytes: u64) -> Needs {
        let set = |of: &[u32]| of.iter().copied().collect();
        let of_walk = |walk: &[(&[u32], &[u32]); 3]| {
            let rooms = walk.iter().map(|(chunks, images)| Needed { chunks: set(chunks), images: set(images) });
            rooms.enumerate().collect()
        };
        let walks = walks.iter().map(of_walk).collect();
        Needs { walks, chunk_bytes: vec![100; 10], image_bytes: vec![image_bytes; 10], rooms: 3 }
    }

    #[test]
    fn what_several_rooms_need_counts_once() {
        let n = needs(&[[(&[0, 1], &[0]), (&[1], &[0, 1]), (&[], &[])], [(&[2], &[]), (&[2], &[]), (&[2], &[])]], 10);
        assert_eq!(n.all(), 2 * 100 + 2 * 10 + 100);
        let other = needs(&[[(&[1], &[0]), (&[], &[]), (&[], &[])], [(&[3], &[]), (&[], &[]), (&[], &[])]], 1);
        let first = [true, false, false];
        assert_eq!(n.of_walk(0, &other, &first), 100 + 2 * 10 + 1, "chunk 1 once; images are each plan's own");
        assert_eq!(n.of_walk(1, &other, &first), 200);
    }

    #[test]
    fn the_grid_gets_rooms_where_walks_need_less_so() {
        // The grid is cheaper in the first room; in the others it would bring what nobody needs.
        let rooms = needs(&[[(&[0, 1, 2], &[]), (&[3], &[]), (&[4], &[])]], 10);
        let grid = needs(&[[(&[0], &[5]), (&[0, 1, 2, 3], &[5]), (&[4, 5, 6], &[])]], 10);
        assert_eq!(rooms.shared_with(&grid), (vec![true, false, false], 310));
        assert_eq!(cheaper_by_grid(&rooms, &grid), [true, false, false]);
        // A hundredth is not worth another plan.
        let rooms = needs(&[[(&[0, 1], &[]), (&[2], &[]), (&[3], &[])]], 10);
        let grid = needs(&[[(&[0], &[5]), (&[4], &[]), (&[5], &[])]], 96);
        assert_eq!(rooms.shared_with(&grid), (vec![true, false, false], 396));
        assert!(cheaper_by_grid(&rooms, &grid).is_empty());
    }

    #[test]
    fn no_single_room_that_changes_hands_saves_anything() {
        let mut random = Random::new(5, 0);
        for _ in 0..50 {
            let lists: Vec<Vec<u32>> = (0..24).map(|_| (0..10).filter(|_| random.uniform() < 0.3).collect()).collect();
            let plan = |at: usize| {
                let room = |k: usize| (&lists[at + 2 * k][..], &lists[at + 2 * k + 1][..]);
                needs(&[[room(0), room(1), room(2)], [room(3), room(4), room(5)]], 40)
            };
            let (own, other) = (plan(0), plan(12));
            let (shared, bytes) = own.shared_with(&other);
            let of = |by: &[bool]| (0..2).map(|walk| own.of_walk(walk, &other, by)).sum::<u64>();
            assert_eq!(bytes, of(&shared));
            for room in 0..3 {
                let mut changed = shared.clone();
                changed[room] = !changed[room];
                assert!(of(&changed) >= bytes, "{shared:?}, {room}");
            }
            assert!(bytes <= own.all().min(of(&[true; 3])));
        }
    }
}
