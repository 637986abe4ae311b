//! Rooms in a dataset: which of its cells lie in which room, and which images show what lies
//! beyond which portal.
//!
//! "Room" is a cell of [`Rooms`] here, or the outside; "cell" is a cell of the octree, the unit of
//! near geometry. A cell lies in every room that it touches, so a wall lies in two; it is stored
//! once and drawn once per frame.
//!
//! A portal has two sides. On each there may be placements for eyes of some boxes
//! ([`Placement::users`](crate::index::Placement::users)): their images hold everything that is
//! seen through the portal from there, but the cells of the room before it, which are drawn with
//! that room. Of those eyes only the ones that face the portal use them ([`is_faced`]).
//!
//! Besides these, or instead, a side may have the images of Rafferty, Aliaga, Popescu and Lastra
//! 1998 ([`SideImages`]): depth images from a semicircle before the portal, and one layered image
//! merged from them. Which of all these a frame shows is told by [`ShowPortals`].

use crate::{
    index::Placement,
    rooms::{CellId, Portal, Rooms},
};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Most placements on one side of a portal.
pub const MAX_PLACEMENTS: usize = 4096;

/// Eyes that see a portal more askew than this have no image of it: the distance from its plane
/// over that from the portal, the sine of 30 degrees. What such eyes see through it is at most
/// half as wide as the portal, and is geometry. Smaller: images for ever flatter views, each with
/// more samples at its sides.
pub const LEAST_SINE: f64 = 0.5;

/// Most reference images on one side of a portal: one for each degree of the semicircle (Rafferty
/// et al. 1998, section 2.2: popping is gone at about one per degree).
pub const MAX_REFERENCES: usize = 181;

/// What shows beyond a portal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PortalImages {
    /// What the dataset offers: [`PortalImages::Zones`], or else [`PortalImages::Layered`].
    #[default]
    Offered,
    /// Layered images made for boxes of eyes, each with a bound on its samples' footprint.
    Zones,
    /// The colours of the central reference image, painted onto the portal (Rafferty et al. 1998,
    /// section 2.2).
    Texture,
    /// Those of the nearest reference image.
    Textures,
    /// The nearest reference image, warped (section 3).
    Reference,
    /// The two nearest (section 3.3).
    TwoReferences,
    /// The layered image merged from all reference images (section 4).
    Layered,
}

impl PortalImages {
    /// Whether it needs a dataset with [`BuiltImages::Paper`]'s images.
    pub fn is_paper(self) -> bool {
        !matches!(self, Self::Offered | Self::Zones)
    }

    /// Whether colours are painted onto the portal instead of being warped.
    pub fn is_texture(self) -> bool {
        matches!(self, Self::Texture | Self::Textures)
    }
}

/// How portals are shown in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
pub struct ShowPortals {
    /// What shows beyond them.
    #[serde(default)]
    pub images: PortalImages,
    /// Images wherever a portal has one for the eye, as in the system of 1998, even where geometry
    /// would fit the budget.
    #[serde(default)]
    pub everywhere: bool,
}

/// Which images of portals a dataset was built with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BuiltImages {
    /// Those for boxes of eyes, [`RoomIndex::placements`].
    #[default]
    Ours,
    /// Those of 1998, [`RoomIndex::sides`].
    Paper,
    /// Both.
    Both,
}

impl BuiltImages {
    /// All, in the order of their numbers in a manifest.
    pub const ALL: [Self; 3] = [Self::Ours, Self::Paper, Self::Both];

    /// Whether images of a kind were to be made, be there any or not.
    pub fn offer(self, images: PortalImages) -> bool {
        match images {
            PortalImages::Offered => true,
            PortalImages::Zones => self != Self::Paper,
            _ => self != Self::Ours,
        }
    }
}

/// The images of one side of a portal as of Rafferty et al. 1998; each is a placement of one
/// image, parallel to the portal.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SideImages {
    /// Placements of the reference images, from left to right along the semicircle; empty where no
    /// eye can be before the portal.
    pub references: Range<u32>,
    /// The reference image that looks most nearly straight at the portal: one of `references`.
    pub central: u32,
    /// The placement of the layered image merged from them.
    pub layered: Option<u32>,
}

/// Whether an eye may have an image of a portal seen from one of its sides: far enough and not too
/// askew.
pub fn is_faced(portal: &Portal, side: usize, eye: DVec3, near_m: f64) -> bool {
    let before = (portal.corners[0] - eye).dot(portal.normal()) * if side == 0 { 1.0 } else { -1.0 };
    let distance = portal.distance_m(eye);
    distance >= near_m && before >= LEAST_SINE * distance
}

/// Rooms, their cells and their portals' images.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RoomIndex {
    /// Rooms and portals.
    pub rooms: Rooms,
    /// Eyes nearer than this to a portal have no image of it, metres.
    pub near_m: f64,
    /// Per room the cells that touch it, ascending; those of the outside come last.
    pub cells_of: Vec<Vec<u32>>,
    /// Per portal and side the placements for eyes that look through it from there: side 0 from
    /// the portal's first room.
    pub placements: Vec<[Range<u32>; 2]>,
    /// Which images were to be made.
    pub built: BuiltImages,
    /// Per portal and side the images of 1998. Empty where none were to be made
    /// ([`BuiltImages::Ours`]).
    pub sides: Vec<[SideImages; 2]>,
    /// Per room, the outside last, whether its eyes are served by the grid although rooms would
    /// do: walks need less so. Empty: in none.
    #[serde(default)]
    pub by_grid: Vec<bool>,
}

impl RoomIndex {
    /// Position of a room in [`RoomIndex::cells_of`].
    pub fn slot(&self, room: CellId) -> usize {
        room.map_or(self.rooms.cells().len(), |c| c as usize)
    }

    /// Whether the grid serves an eye although rooms would do.
    pub fn is_by_grid(&self, eye: DVec3) -> bool {
        !self.by_grid.is_empty() && self.by_grid.get(self.slot(self.rooms.cell_at(eye))) == Some(&true)
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

    /// The kind of images that a wish comes to.
    pub fn resolve(&self, wanted: PortalImages) -> PortalImages {
        match wanted {
            PortalImages::Offered if self.built.offer(PortalImages::Zones) => PortalImages::Zones,
            PortalImages::Offered => PortalImages::Layered,
            given => given,
        }
    }

    /// The placements whose images show a portal to an eye on one of its sides, best first;
    /// `images` is not [`PortalImages::Offered`]. Empty: none may, so that it sees geometry.
    ///
    /// Of reference images the nearest is the one whose place lies most nearly in the eye's
    /// horizontal direction from the portal: for other eyes in that direction, however far away,
    /// the picture in the portal differs least.
    pub fn shown(&self, all: &[Placement], images: PortalImages, portal: u32, side: usize, eye: DVec3) -> Vec<u32> {
        if images == PortalImages::Zones {
            return self.placement_for(all, portal, side, eye).into_iter().collect();
        }
        let of_side = self.sides.get(portal as usize).and_then(|s| s.get(side));
        let (Some(own), Some(p)) = (of_side, self.rooms.portals().get(portal as usize)) else { return Vec::new() };
        if own.references.is_empty() || !is_faced(p, side, eye, self.near_m) {
            return Vec::new();
        }
        let count = match images {
            PortalImages::Texture => return vec![own.central],
            PortalImages::Layered => return own.layered.into_iter().collect(),
            PortalImages::TwoReferences => 2,
            _ => 1,
        };
        let direction = |q: DVec3| ((q - p.centre()) * DVec3::new(1.0, 0.0, 1.0)).normalize_or_zero();
        let toward = direction(eye);
        let apart = |n: u32| all.get(n as usize).map_or(f64::INFINITY, |r| direction(r.cop).distance_squared(toward));
        let mut nearest: Vec<(f64, u32)> = own.references.clone().map(|n| (apart(n), n)).collect();
        nearest.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        nearest.into_iter().take(count).map(|n| n.1).collect()
    }

    /// The rules: a list of cells for every room, ascending and of cells that exist; ranges of
    /// placements for every portal, of placements that no grid point has; images of 1998 for every
    /// portal or for none, each side's central one among its references.
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
        if !self.by_grid.is_empty() && self.by_grid.len() != rooms + 1 {
            return Err(format!(
                "{} rooms are told to be the grid's or not, of {rooms} and the outside",
                self.by_grid.len()
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
        self.check_sides(placements)
    }

    fn check_sides(&self, placements: &[Placement]) -> Result<(), String> {
        let wanted = if self.built == BuiltImages::Ours { 0 } else { self.rooms.portals().len() };
        if self.sides.len() != wanted {
            return Err(format!("reference images of {} portals, {wanted} were expected", self.sides.len()));
        }
        let of_portal =
            |n: u32| placements.get(n as usize).is_some_and(|p| p.grid_point.is_none() && p.images.len() == 1);
        for (portal, side) in self.sides.iter().enumerate().flat_map(|(p, sides)| sides.iter().map(move |s| (p, s))) {
            let r = &side.references;
            let sound = match r.is_empty() {
                true => r.start == r.end && side.layered.is_none(),
                false => r.len() <= MAX_REFERENCES && r.contains(&side.central) && r.clone().all(of_portal),
            };
            if !sound || side.layered.is_some_and(|l| !of_portal(l)) {
                return Err(format!("portal {portal} has reference images that do not exist or belong to grid points"));
            }
        }
        Ok(())
    }
}
