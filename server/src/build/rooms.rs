//! Rooms of a build: whose they are, which cells lie in them, what is planned for their portals.

use super::references::ReferenceFigures;
use super::{BuildError, Progress};
use crate::placement::{self, PlacementError, PlacementResult};
use crate::portal::{self, PortalPlans, PortalStatistics, Semicircle, SemicircleStatistics, SidePlan};
use crate::render::Caster;
use crate::scene::{Note, Scene};
use ldi_protocol::Aabb;
use ldi_protocol::index::Index;
use ldi_protocol::room_index::{BuiltImages, PortalImages, RoomIndex, SideImages};
use ldi_protocol::rooms::{MAX_JSON_BYTES, Rooms};
use ldi_protocol::volume::WalkVolume;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// Where rooms come from.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum RoomSource {
    /// The scene's annotation; found where it has none.
    #[default]
    Scene,
    /// Found, whatever the scene says.
    Found,
    /// A file as `ldi-server rooms --json` writes it, corrected or not.
    File(PathBuf),
}

/// What a build shows of portals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PortalOptions {
    /// Eyes nearer than this to a portal see geometry beyond it, metres.
    pub near_m: f64,
    /// Which images are made.
    pub images: BuiltImages,
    /// Where reference images are taken from.
    pub semicircle: Semicircle,
    /// Depths that differ by at most this share are one in merging.
    pub same_depth: f64,
}

impl Default for PortalOptions {
    fn default() -> Self {
        Self {
            near_m: portal::NEAR_M,
            images: BuiltImages::Ours,
            semicircle: Semicircle::default(),
            same_depth: crate::construct::SAME_DEPTH,
        }
    }
}

/// Figures of rooms for the report.
#[derive(Debug, Clone, Default, Serialize)]
pub struct RoomFigures {
    /// Of the plan.
    #[serde(flatten)]
    pub plan: PortalStatistics,
    /// Eyes nearer than this to a portal see geometry beyond it, metres.
    pub portal_near_m: f64,
    /// Which images of portals were made.
    pub images: BuiltImages,
    /// The semicircle, and what was planned on it; None without images of 1998.
    pub semicircle: Option<(Semicircle, SemicircleStatistics)>,
    /// What was made of it.
    pub references: Option<ReferenceFigures>,
    /// Where the grid takes over.
    pub grid: GridUnderRooms,
    /// Seconds until rooms were known.
    pub find_seconds: f64,
    /// Seconds to find their cells.
    pub cells_seconds: f64,
    /// Seconds to plan images.
    pub plan_seconds: f64,
}

/// The part of the walk volume where the grid serves: what has to be geometry of rooms exceeds the
/// budget, or walks need less so.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct GridUnderRooms {
    /// Boxes of the walk volume whose eyes the grid serves.
    pub places: usize,
    /// Boxes of the walk volume.
    pub of: usize,
    /// Grid points.
    pub points: usize,
    /// Placements of theirs.
    pub placements: usize,
}

impl GridUnderRooms {
    /// What was left out, and why.
    pub fn note(&self) -> Note {
        let Self { places, of, .. } = *self;
        Note {
            what: format!("the grid's images for {} of {of} places", of - places),
            why: "the rooms of an eye there, and what portals without an image show, fit the budget as geometry".into(),
        }
    }
}

/// Rooms with their plan.
pub(super) struct RoomPlan {
    /// Its placements are the plan's first.
    pub index: RoomIndex,
    /// Reference images.
    pub sides: Vec<SidePlan>,
    pub figures: RoomFigures,
    /// Per box of the walk volume whether rooms are too much for the budget.
    over: Vec<bool>,
}

impl RoomPlan {
    /// The index with the placements of reference images, which come as the plan's sides do.
    pub fn index_with(self, sides: Vec<SideImages>) -> RoomIndex {
        let mut index = self.index;
        for (plan, images) in self.sides.iter().zip(sides) {
            if let Some(of_portal) = index.sides.get_mut(plan.portal) {
                of_portal[plan.side] = images;
            }
        }
        index
    }
}

/// Rooms, and what lies in them.
pub(super) struct Site {
    rooms: Rooms,
    cells_of: Vec<Vec<u32>>,
    find_seconds: f64,
    cells_seconds: f64,
}

impl Site {
    /// Finds which of so many cells lie in which room.
    pub fn of(caster: &Caster, Known { rooms, seconds }: Known, cells: usize, progress: &dyn Progress) -> Self {
        progress.stage("cells of rooms", 0);
        let start = Instant::now();
        let cells_of = portal::cells_of_rooms(caster, &rooms, cells);
        Self { rooms, cells_of, find_seconds: seconds, cells_seconds: start.elapsed().as_secs_f64() }
    }

    /// The rooms.
    pub fn rooms(&self) -> &Rooms {
        &self.rooms
    }
}

/// What is planned by rooms, and where else.
#[derive(Default)]
pub(super) struct Share<'a> {
    /// Per room, the outside last, whether the grid serves it although rooms would do; empty: none.
    pub by_grid: Vec<bool>,
    /// An earlier plan of the same rooms, none of which was the grid's.
    pub before: Option<&'a RoomPlan>,
}

/// Plans the images of portals, and those of the grid where rooms are too much, or the grid is to
/// serve.
///
/// `draft`: without chunks: cells, settings and the walk volume. `grid`: plans the grid for the
/// eyes of a volume.
pub(super) fn plan_rooms(
    caster: &Caster,
    site: &Site,
    options: &PortalOptions,
    mut draft: Index,
    share: Share<'_>,
    grid: &dyn Fn(WalkVolume) -> Result<PlacementResult, PlacementError>,
    progress: &dyn Progress,
) -> Result<(PlacementResult, RoomPlan), BuildError> {
    let Site { rooms, cells_of, .. } = site;
    let (cells, held) = (draft.cells.len(), Instant::now());
    progress.stage("images of portals", 0);
    let nowhere = || BuildError::Rooms { why: "there is no place where an eye may be".into() };
    let volume = draft.volume.clone().ok_or_else(nowhere)?;
    let PortalOptions { near_m, images, semicircle, .. } = *options;
    let mut plans = portal::plan_portals(rooms, cells_of, cells, &volume, &draft.settings, near_m);
    if !images.offer(PortalImages::Zones) {
        plans.leave_out();
    }
    let (mut sides, mut on_semicircle) = (Vec::new(), None);
    if images.offer(PortalImages::Layered) {
        let sees = |a, b| super::planning::sees(caster, a, b);
        let (planned, found) = portal::plan_semicircles(rooms, &volume, &draft.settings, near_m, &semicircle, &sees);
        (sides, on_semicircle) = (planned, Some((semicircle, found)));
    }
    let of_room = |list: &Vec<u32>| list.iter().map(|c| u64::from(draft.cells[*c as usize].triangles)).sum::<u64>();
    let inner = cells_of.len().saturating_sub(1);
    plans.statistics.largest_room_triangles = cells_of[..inner].iter().map(of_room).max().unwrap_or(0);
    let nothing = match images {
        BuiltImages::Ours => Vec::new(),
        _ => vec![Default::default(); rooms.portals().len()],
    };
    let mut index = RoomIndex {
        rooms: rooms.clone(),
        near_m,
        cells_of: cells_of.clone(),
        placements: Vec::new(),
        built: images,
        sides: nothing,
        by_grid: share.by_grid,
    };
    draft.rooms = Some(index.clone());
    plans.keep_used(&mut draft, &volume, images == BuiltImages::Both);
    index.placements.clone_from(&plans.of_portal);
    let plan_seconds = held.elapsed().as_secs_f64();
    let over = match share.before {
        Some(plan) => plan.over.clone(),
        // Images of 1998 promise no budget.
        None if images.offer(PortalImages::Zones) => portal::over_budget(&draft),
        None => vec![false; volume.boxes().count()],
    };
    let served: Vec<bool> = volume.boxes().zip(&over).map(|(b, over)| *over || touches_the_grids(&index, &b)).collect();
    let places = served.iter().filter(|s| **s).count();
    progress.note(&format!("{places} of {} places need the grid", served.len()));
    let there = match places {
        0 => None,
        _ => Some(grid(volume.only(|number| served[number]))?),
    };
    let under = GridUnderRooms {
        places,
        of: volume.boxes().count(),
        points: there.as_ref().map_or(0, |t| t.points.len()),
        placements: there.as_ref().map_or(0, |t| t.plans.len()),
    };
    let plan = joined(&plans, there, volume);
    let figures = RoomFigures {
        plan: plans.statistics,
        portal_near_m: near_m,
        images,
        semicircle: on_semicircle,
        references: None,
        find_seconds: site.find_seconds,
        cells_seconds: site.cells_seconds,
        grid: under,
        plan_seconds,
    };
    Ok((plan, RoomPlan { index, sides, figures, over }))
}

/// Whether an eye of a box may be in a room of the grid's.
fn touches_the_grids(index: &RoomIndex, b: &Aabb) -> bool {
    if index.by_grid.is_empty() {
        return false;
    }
    let near = index.rooms.cells().iter().zip(&index.by_grid).filter(|(_, by_grid)| **by_grid);
    let inside = near.flat_map(|(c, _)| &c.boxes).any(|o| o.intersects(b));
    inside || b.corners().into_iter().chain([b.centre()]).any(|p| index.is_by_grid(p))
}

/// The placements of portals, then those of the grid.
fn joined(portals: &PortalPlans, grid: Option<PlacementResult>, volume: WalkVolume) -> PlacementResult {
    let first = portals.plans.len() as u32;
    let mut plan = grid.unwrap_or_else(|| PlacementResult {
        points: Vec::new(),
        plans: Vec::new(),
        pitch_bands_deg: Vec::new(),
        volume: volume.clone(),
        beyond_budget: Vec::new(),
        statistics: Default::default(),
    });
    for range in plan.points.iter_mut().flat_map(|p| p.bands.iter_mut().flatten()) {
        range.placement = range.placement.map(|p| p + first);
    }
    plan.plans = portals.plans.iter().cloned().chain(plan.plans).collect();
    plan.volume = placement::without(&volume, &plan.beyond_budget);
    // Where the grid takes over is sampled.
    plan.statistics.coverage_certified = false;
    // Of images that keep the bound; those of 1998 promise none.
    plan.statistics.max_footprint_px = plan.plans.iter().map(|p| p.footprint_px).fold(0.0, f64::max);
    plan
}

/// Whether there are rooms without looking for them, or they are to be looked for.
pub(super) fn are_given(scene: &Scene, source: &RoomSource) -> bool {
    *source != RoomSource::Scene || !scene.rooms.is_empty()
}

/// Why a build that nobody gives rooms is not by rooms.
pub(super) const NONE_GIVEN: &str =
    "the scene names no rooms; with --find-rooms they are looked for, with --rooms they are read";

/// A build that chose the grid because there are no rooms.
pub(super) fn without(why: String) -> Note {
    Note { what: "rooms and portals".into(), why }
}

/// Rooms, and how long it took to know them.
pub(super) struct Known {
    rooms: Rooms,
    seconds: f64,
}

/// Reads or finds rooms; they are looked for around where people walk.
///
/// # Errors
/// [`BuildError::NoRooms`] where there are none; [`BuildError::Rooms`] for faults of a file or an
/// annotation.
pub(super) fn rooms_of(caster: &Caster, source: &RoomSource, walked: &Aabb) -> Result<Known, BuildError> {
    let start = Instant::now();
    let fault = |why: String| BuildError::Rooms { why };
    let rooms = match source {
        RoomSource::File(file) => {
            let read = || -> std::io::Result<Vec<u8>> {
                let length = std::fs::metadata(file)?.len();
                if length > MAX_JSON_BYTES as u64 {
                    return Err(std::io::Error::other(format!("{length} bytes, at most {MAX_JSON_BYTES} are read")));
                }
                std::fs::read(file)
            };
            let text = read().map_err(|e| fault(format!("{}: {e}", file.display())))?;
            Rooms::from_json(&text).map_err(|e| fault(format!("{}: {e}", file.display())))?
        }
        RoomSource::Scene | RoomSource::Found => {
            let annotated = match source {
                RoomSource::Scene => portal::annotated_rooms(caster.scene()).map_err(|e| fault(e.to_string()))?,
                _ => None,
            };
            match annotated {
                Some(rooms) => rooms,
                None => {
                    let found = portal::find_rooms(caster, walked).map_err(|e| fault(e.to_string()))?;
                    if let Some(why) = found.statistics.no_cells {
                        return Err(BuildError::NoRooms { why });
                    }
                    found.rooms
                }
            }
        }
    };
    match rooms.cells().is_empty() {
        true => Err(BuildError::NoRooms { why: "none was found".into() }),
        false => Ok(Known { rooms, seconds: start.elapsed().as_secs_f64() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rooms_are_given_by_the_scene_or_by_whoever_builds() {
        let scene = |spec: &str| crate::scene::load(spec).unwrap();
        let (house, pipes) = (scene("builtin:house?triangles=20000"), scene("builtin:pipes?triangles=20000"));
        assert!(are_given(&house, &RoomSource::Scene) && !are_given(&pipes, &RoomSource::Scene));
        assert!(are_given(&pipes, &RoomSource::Found) && are_given(&pipes, &RoomSource::File("rooms.json".into())));
    }
}
