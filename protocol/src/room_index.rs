//! Rooms in a dataset: which of its cells lie in which room, and which images show what lies beyond which portal.
//!
//! "Room" is a cell of [`Rooms`] here, or the outside; "cell" is a cell of the octree, the unit of near geometry. A cell lies in every room that it
//! touches, so a wall lies in two; it is stored once and drawn once per frame.
//!
//! A portal has two sides. On each there may be placements for eyes of some boxes ([`Placement::users`](crate::index::Placement::users)): their images hold everything
//! that is seen through the portal from there, but the cells of the room before it, which are drawn with that room. Of those eyes only the ones that face the portal
//! use them ([`is_faced`]).

use crate::{
    index::Placement,
    rooms::{CellId, Portal, Rooms},
};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Most placements on one side of a portal.
pub const MAX_PLACEMENTS: usize = 4096;

/// Eyes that see a portal more askew than this have no image of it: the distance from its plane over that from the portal, the sine of 30 degrees. What such eyes see
/// through it is at most half as wide as the portal, and is geometry. Smaller: images for ever flatter views, each with more samples at its sides.
pub const LEAST_SINE: f64 = 0.5;

/// Whether an eye may have an image of a portal seen from one of its sides: far enough and not too askew.
pub fn is_faced(portal: &Portal, side: usize, eye: DVec3, near_m: f64) -> bool {
    let before = (portal.corners[0] - eye).dot(portal.normal()) * if side == 0 { 1.0 } else { -1.0 };
    let distance = portal.distance_m(eye);
    distance >= near_m && before >= LEAST_SINE * distance
}

/// Rooms, their cells and their portals' images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RoomIndex {
    /// Rooms and portals.
    pub rooms: Rooms,
    /// Eyes nearer than this to a portal have no image of it, metres.
    pub near_m: f64,
    /// Per room the cells that touch it, ascending; those of the outside come last.
    pub cells_of: Vec<Vec<u32>>,
    /// Per portal and side the placements for eyes that look through it from there: side 0 from the portal's first room.
    pub placements: Vec<[Range<u32>; 2]>,
}

impl RoomIndex {
    /// Position of a room in [`RoomIndex::cells_of`].
    pub fn slot(&self, room: CellId) -> usize {
        room.map_or(self.rooms.cells().len(), |c| c as usize)
    }

    /// The cells of a room.
    pub fn cells(&self, room: CellId) -> &[u32] {
        self.cells_of.get(self.slot(room)).map_or(&[], Vec::as_slice)
    }

    /// The placement that an eye may use to look through a portal from one of its sides.
    pub fn placement_for(&self, all: &[Placement], portal: u32, side: usize, eye: DVec3) -> Option<u32> {
        let range = self.placements.get(portal as usize)?.get(side)?.clone();
        let faced = is_faced(self.rooms.portals().get(portal as usize)?, side, eye, self.near_m);
        if range.is_empty() || !faced {
            return None;
        }
        range.into_iter().find(|p| all.get(*p as usize).is_some_and(|p| p.users.contains(eye)))
    }

    /// The rules: a list of cells for every room, ascending and of cells that exist; ranges of placements for every portal, of placements that
    /// no grid point has.
    ///
    /// # Errors
    /// The first broken rule, in words.
    pub fn check(&self, cells: usize, placements: &[Placement]) -> Result<(), String> {
        let (rooms, portals) = (self.rooms.cells().len(), self.rooms.portals().len());
        if !(0.0..=1000.0).contains(&self.near_m) {
            return Err(format!("{} m is no distance between an eye and a portal", self.near_m));
        }
        if self.cells_of.len() != rooms + 1 || self.placements.len() != portals {
            return Err(format!(
                "{} lists of cells for {rooms} rooms and the outside, placements of {} portals for {portals}",
                self.cells_of.len(),
                self.placements.len()
            ));
        }
        for (room, list) in self.cells_of.iter().enumerate() {
            let ascend = list.windows(2).all(|w| w[0] < w[1]);
            if !ascend || list.last().is_some_and(|c| *c as usize >= cells) {
                return Err(format!("the cells of room {room} do not ascend or do not exist"));
            }
        }
        for (portal, range) in
            self.placements.iter().enumerate().flat_map(|(p, sides)| sides.iter().map(move |r| (p, r)))
        {
            let of_portal = (range.start <= range.end)
                .then(|| placements.get(range.start as usize..range.end as usize))
                .flatten()
                .filter(|some| some.len() <= MAX_PLACEMENTS && some.iter().all(|p| p.grid_point.is_none()));
            if of_portal.is_none() {
                return Err(format!("portal {portal} has placements that do not exist or belong to grid points"));
            }
        }
        Ok(())
    }
}
