//! Placements for portals: what shows the rooms beyond.
//!
//! In: rooms, their cells, the walk volume. Out: [`PlacementPlan`]s as the grid's, each for eyes
//! of a zone (`zones`) on one side of a portal, with one image over what is seen through the
//! portal: of all cells but those of the room before it. Eyes are those of that room, and those
//! near its portals on the other side, for which it is geometry.

use super::leaks::Random;
use super::zones::{Gate, Zone, lookouts, outermost, zones};
use crate::placement::{DirectionRange, Footprint, Gaze, ImagePlan, PlacementPlan, spread};
use glam::DVec3;
use ldi_protocol::index::{BuildSettings, Index, Placement};
use ldi_protocol::room_index::{PortalImages, ShowPortals};
use ldi_protocol::rooms::Rooms;
use ldi_protocol::select::{Show, draw_list_showing};
use ldi_protocol::volume::WalkVolume;
use ldi_protocol::{Aabb, CellRuns, Pose};
use rayon::prelude::*;
use serde::Serialize;
use std::ops::Range;

/// Eyes nearer than this to a portal get no image of it unless told otherwise, metres: what lies
/// beyond is geometry. Smaller: fewer triangles in doorways, and many more zones, as lines of
/// sight to the corners of a door and distances to them differ more (at 1 m some 14 zones for a
/// door, at 1.5 m some 3).
pub const NEAR_M: f64 = 1.5;
/// Eyes of other rooms this far from a portal of the room, beyond `near_m`, may look through its
/// other portals, metres.
const BEYOND_NEAR_M: f64 = 0.5;
/// Places that an image is made from, beside the outermost. By judgement: a zone is a few metres
/// wide; the grid's near boxes take 256 for eyes of many rooms.
const MOST_EYES: usize = 48;
/// Most lookouts that a plan keeps: outdoors a zone is as wide as the place.
const MOST_LOOKOUTS: usize = 1024;

/// Eyes for which [`PortalPlans::keep_used`] looks around, and into how many directions. More:
/// fewer eyes that would use an image that was not made; planning takes longer.
const EYES_TRIED: usize = 3_000;
const YAWS_TRIED: usize = 9;

/// What was planned.
#[derive(Debug, Clone, Default)]
pub struct PortalPlans {
    /// By portal, then by side.
    pub plans: Vec<PlacementPlan>,
    /// Per portal and side, which of them.
    pub of_portal: Vec<[Range<u32>; 2]>,
    /// Figures.
    pub statistics: PortalStatistics,
}

/// Figures of the plan.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct PortalStatistics {
    /// Rooms.
    pub rooms: usize,
    /// Portals.
    pub portals: usize,
    /// Sides of portals that eyes may look through.
    pub sides: usize,
    /// Placements planned.
    pub planned: usize,
    /// Placements that some of the poses tried uses: the others are not made.
    pub placements: usize,
    /// Poses tried.
    pub poses_tried: usize,
    /// Sum of the cells of all rooms over the number of cells: in how many rooms a cell lies.
    pub rooms_per_cell: f64,
    /// Largest number of triangles that a room's cells have.
    pub largest_room_triangles: u64,
}

/// Plans the images of all portals.
///
/// `cells_of`: as [`super::cells_of_rooms`]; `cells`: their number; `near_m`: eyes nearer than
/// this to a portal get none.
pub fn plan_portals(
    rooms: &Rooms,
    cells_of: &[Vec<u32>],
    cells: usize,
    volume: &WalkVolume,
    settings: &BuildSettings,
    near_m: f64,
) -> PortalPlans {
    let footprint = Footprint::new(&settings.camera, settings.density, settings.max_footprint_px);
    let places: Vec<Aabb> = volume.boxes().collect();
    let sides: Vec<(usize, usize)> = (0..rooms.portals().len()).flat_map(|p| [(p, 0), (p, 1)]).collect();
    let found: Vec<Vec<PlacementPlan>> = sides
        .par_iter()
        .map(|&(portal, side)| {
            let p = &rooms.portals()[portal];
            let gate = Gate::new(p, side, near_m);
            let room = p.cells[side];
            let own = places_of(rooms, room, &places, near_m + BEYOND_NEAR_M);
            let before: Vec<Aabb> = own.into_iter().filter(|b| gate.may_serve(b)).collect();
            let stays = &cells_of[room.map_or(rooms.cells().len(), |c| c as usize)];
            let culled: CellRuns = (0..cells as u32).filter(|c| stays.binary_search(c).is_err()).collect();
            zones(&gate, &before, &footprint)
                .into_iter()
                .map(|zone| plan(&gate, &zone, &places, culled.clone(), settings, &footprint))
                .collect()
        })
        .collect();
    let mut out = PortalPlans::default();
    for pair in found.chunks(2) {
        let mut ranges = [0..0, 0..0];
        for (range, plans) in ranges.iter_mut().zip(pair) {
            let first = out.plans.len() as u32;
            out.plans.extend(plans.iter().cloned());
            *range = first..out.plans.len() as u32;
            out.statistics.sides += usize::from(!plans.is_empty());
        }
        out.of_portal.push(ranges);
    }
    out.statistics.rooms = rooms.cells().len();
    out.statistics.portals = rooms.portals().len();
    out.statistics.planned = out.plans.len();
    out.statistics.placements = out.plans.len();
    out.statistics.rooms_per_cell = cells_of.iter().map(Vec::len).sum::<usize>() as f64 / cells.max(1) as f64;
    out
}

impl PortalPlans {
    /// Plans nothing.
    pub fn leave_out(&mut self) {
        self.plans.clear();
        self.of_portal.iter_mut().for_each(|sides| *sides = [0..0, 0..0]);
        (self.statistics.sides, self.statistics.planned) = (0, 0);
    }

    /// Leaves out placements that `select` returns for none of many poses: for most portals what
    /// lies beyond fits the budget as geometry. `index`: with cells and settings, and of rooms all
    /// but the placements. An eye between those tried that would use one of them sees geometry
    /// instead, and where that exceeds the budget the LDI tree; the audit counts such poses.
    /// `everywhere`: those also that it returns when images are shown wherever a portal has one.
    /// `index` knows the placements that are left, afterwards.
    pub fn keep_used(&mut self, index: &mut Index, volume: &WalkVolume, everywhere: bool) {
        self.enter(index);
        let sampler = volume.sampler();
        let (camera, pitch) = (index.settings.camera, index.settings.pitch_deg);
        let half_tan = (camera.half_tan_x(), camera.half_tan_y());
        let known = &*index;
        let used: Vec<Vec<u32>> = (0..EYES_TRIED)
            .into_par_iter()
            .map(|number| {
                let mut random = Random(number as u64 + 1);
                let served = |p: &DVec3| known.rooms.as_ref().is_none_or(|r| !r.is_by_grid(*p));
                let position = sampler.point(std::array::from_fn(|_| random.unit())).filter(served);
                let Some(position) = position else { return Vec::new() };
                let turn = random.unit() * 360.0;
                let look = |k: usize| {
                    let yaw_deg = turn + 360.0 * k as f64 / YAWS_TRIED as f64;
                    // Level, mostly, as people look.
                    let pitch_deg = if k.is_multiple_of(3) { (random.unit() * 2.0 - 1.0) * pitch } else { 0.0 };
                    Pose { position, yaw_deg, pitch_deg }
                };
                let images = PortalImages::Zones;
                let ways = if everywhere { &[false, true][..] } else { &[false] };
                let lists: Vec<_> = (0..YAWS_TRIED)
                    .map(look)
                    .flat_map(|pose| ways.iter().map(move |everywhere| (pose, *everywhere)))
                    .map(|(pose, everywhere)| {
                        draw_list_showing(
                            known,
                            &pose,
                            half_tan,
                            Show { portals: ShowPortals { images, everywhere }, ..Show::default() },
                        )
                    })
                    .collect();
                // Where even that exceeds the budget the grid serves.
                let kept = lists.iter().filter(|l| l.dropped == 0);
                let mut used: Vec<u32> = kept.flat_map(|l| &l.portals).map(|p| p.placement).collect();
                used.sort_unstable();
                used.dedup();
                used
            })
            .collect();
        let mut keep = vec![false; self.plans.len()];
        used.iter().flatten().for_each(|p| keep[*p as usize] = true);
        // Old number to new.
        let before: Vec<u32> = keep.iter().scan(0, |n, k| Some(std::mem::replace(n, *n + u32::from(*k)))).collect();
        let kept = keep.iter().filter(|k| **k).count() as u32;
        let new = |old: u32| before.get(old as usize).copied().unwrap_or(kept);
        self.of_portal.iter_mut().flatten().for_each(|r| *r = new(r.start)..new(r.end));
        let mut keep = keep.into_iter();
        self.plans.retain(|_| keep.next().unwrap_or(false));
        self.statistics.placements = self.plans.len();
        self.statistics.poses_tried = EYES_TRIED * YAWS_TRIED;
        self.enter(index);
    }

    /// Makes the index know the placements.
    fn enter(&self, index: &mut Index) {
        let placement = |p: &PlacementPlan| Placement {
            grid_point: None,
            cop: p.cop,
            culled: CellRuns::default(),
            footprint_px: p.footprint_px,
            users: p.users,
            images: 0..0,
            sky: Default::default(),
        };
        index.placements = self.plans.iter().map(placement).collect();
        index.rooms.iter_mut().for_each(|rooms| rooms.placements.clone_from(&self.of_portal));
    }
}

/// Places in a room or, outside of it, close to one of its portals.
fn places_of(rooms: &Rooms, room: Option<u32>, places: &[Aabb], near_m: f64) -> Vec<Aabb> {
    let portals = rooms.portals_of(room);
    let boxes: Vec<Aabb> = match room {
        Some(c) => rooms.cells()[c as usize].boxes.clone(),
        None => Vec::new(),
    };
    let around = boxes.iter().fold(Aabb::EMPTY, |b, o| b.union(*o)).inflated(near_m);
    let within = |b: &Aabb| match room {
        Some(_) => boxes.iter().any(|o| o.intersects(b)),
        None => rooms.cell_at(b.centre()).is_none() || b.corners().iter().any(|c| rooms.cell_at(*c).is_none()),
    };
    let close = |b: &Aabb| portals.iter().any(|p| rooms.portals()[*p as usize].distance_m(b.centre()) <= near_m);
    let wanted = |b: &&Aabb| (room.is_none() || around.intersects(b)) && (within(b) || close(b));
    places.iter().filter(wanted).copied().collect()
}

fn plan(
    gate: &Gate,
    zone: &Zone,
    places: &[Aabb],
    culled: CellRuns,
    settings: &BuildSettings,
    footprint: &Footprint,
) -> PlacementPlan {
    let users = zone.users.inflated(1e-6);
    let mut lookouts = lookouts(gate, zone, places);
    let mut eyes = spread(&lookouts, zone.cop, MOST_EYES);
    eyes.extend(outermost(gate, zone, &lookouts));
    let every = lookouts.len().div_ceil(MOST_LOOKOUTS);
    lookouts = lookouts.into_iter().step_by(every.max(1)).collect();
    let [yaw, pitch] = zone.axis_deg;
    // Where eyes may look while the portal is in their picture: half the sphere at most.
    let directions = vec![DirectionRange {
        yaw_deg: [yaw - 90.0, yaw + 90.0],
        pitch_deg: [(pitch - 60.0).max(-settings.pitch_deg), (pitch + 60.0).min(settings.pitch_deg)],
    }];
    let image = ImagePlan {
        basis: zone.basis,
        cop: zone.cop,
        plane_distance: zone.plane_m,
        beside: [f64::INFINITY; 4],
        pixels_per_unit: footprint.pixels_per_unit(zone.scale),
        window: zone.window,
        users,
        directions,
        footprint_px: zone.footprint_px,
    };
    PlacementPlan {
        grid_point: None,
        cop: zone.cop,
        culled,
        users,
        eyes,
        lookouts,
        gaze: Gaze::everywhere(settings.camera.focal_px()),
        through: gate.portal.corners.clone(),
        footprint_px: zone.footprint_px,
        images: vec![image],
    }
}
