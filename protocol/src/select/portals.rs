//! `select` in a dataset with rooms (Rafferty, Aliaga, Popescu and Lastra 1998, section 2).
//!
//! Pose -> rooms of the eye -> portal culling. The room of the eye is geometry. What lies beyond a
//! portal is geometry as well, or comes from an image of that portal: an eye may use one if it is
//! among the eyes of a placement ([`RoomIndex::shown`]); others, nearer ones above all, see
//! geometry, which is what the image's footprint bound asks for.
//!
//! ```text
//!        geometry        | image          1. rooms of the eye
//!   +-----------+--------+--+             2. and every room that is seen through a portal without an image for this eye, and so on
//!   |  eye o    p1   B   p2 | C           3. if all that may be seen fits the budget: all of it
//!   +-----------+-----------+             4. else room by room, the nearest portal first, as long as what (2) adds to each fits
//! ```
//!
//! With [`ShowPortals::everywhere`], 3 and 4 are left out, as in the system of 1998 (section 5):
//! what may be an image is one.
//!
//! Where even 1 and 2 exceed the budget, the farthest cells are left out and counted
//! ([`DrawList::dropped`](super::DrawList::dropped)): the LDI tree shows through there.

use super::{DrawFrusta, DrawList, Selection, images_within, level_at, near_to_far, tree_chunks, within_budget};
use crate::{
    Pose,
    camera::Frustum,
    index::{DrawnCell, Index},
    portal_view::{Cone, PortalView, VISITS_PER_VIEW, portal_view_within},
    room_index::{PortalImages, RoomIndex, ShowPortals},
    rooms::CellId,
};

/// Rooms that are tried as geometry beyond what must be. Larger: more of the budget is used where
/// many rooms are in view; each try is a view of its own.
const MOST_TRIES: usize = 24;

/// A portal whose image shows what lies beyond.
#[derive(Debug, Clone, PartialEq)]
pub struct ShownPortal {
    /// Position in [`Rooms::portals`](crate::rooms::Rooms::portals).
    pub portal: u32,
    /// Which of the portal's two rooms it is seen from.
    pub side: usize,
    /// The placement whose images are used.
    pub placement: u32,
    /// A second one, for [`PortalImages::TwoReferences`].
    pub second: Option<u32>,
    /// Their images that may be seen, as positions in [`Index::images`].
    pub images: Vec<u32>,
    /// What may be seen of the portal, one for each way to it.
    pub cones: Vec<Cone>,
}

struct Search<'a> {
    index: &'a Index,
    rooms: &'a RoomIndex,
    pose: &'a Pose,
    frusta: DrawFrusta,
    /// The picture's frustum.
    picture: Frustum,
    start: Vec<CellId>,
    /// What is shown; not [`PortalImages::Offered`].
    images: PortalImages,
    everywhere: bool,
}

/// Rooms that are geometry, and what they draw.
struct State {
    geometry: Vec<bool>,
    view: PortalView,
    /// With their distances.
    cells: Vec<(f64, DrawnCell)>,
    triangles: u64,
}

/// As [`super::draw_list`].
pub(super) fn draw_list(
    index: &Index,
    rooms: &RoomIndex,
    pose: &Pose,
    half_tan: (f64, f64),
    show: ShowPortals,
) -> DrawList {
    let search = Search::new(index, rooms, pose, half_tan, show);
    let state = search.run();
    let portals = search.portals(&state.view);
    let State { view, cells, triangles, .. } = state;
    let mut images: Vec<u32> = Vec::new();
    for image in portals.iter().flat_map(|p| &p.images) {
        if !images.contains(image) {
            images.push(*image);
        }
    }
    let seen = view.cells.iter().map(|c| c.cell).collect();
    let selection = Selection { grid_point: None, placement: None };
    let (cells, tree) = (near_to_far(cells), Vec::new());
    // Beyond portals it lies anywhere.
    let complete_m = 0.0;
    let list = DrawList { selection, cells, images, triangles, dropped: 0, complete_m, tree, rooms: seen, portals };
    let mut list = within_budget(index, pose.position, list);
    if list.dropped > 0 {
        list.tree = tree_chunks(index, pose, half_tan);
    }
    list
}

/// Triangles of what has to be geometry (1 and 2).
pub(super) fn least(index: &Index, rooms: &RoomIndex, pose: &Pose, half_tan: (f64, f64)) -> u64 {
    let search = Search::new(index, rooms, pose, half_tan, ShowPortals::default());
    search.least().triangles
}

impl<'a> Search<'a> {
    fn new(index: &'a Index, rooms: &'a RoomIndex, pose: &'a Pose, half_tan: (f64, f64), show: ShowPortals) -> Self {
        Self {
            index,
            rooms,
            pose,
            frusta: DrawFrusta::new(&index.settings, pose, half_tan),
            picture: Frustum::new(pose.position, &pose.basis(), half_tan.0, half_tan.1),
            start: rooms.rooms.cells_near(pose.position, rooms.rooms.margin_m()),
            images: rooms.resolve(show.images),
            everywhere: show.everywhere,
        }
    }

    /// The rooms of the eye, and those that are seen through portals without an image.
    fn least(&self) -> State {
        let mut geometry = vec![false; self.rooms.cells_of.len()];
        self.start.iter().for_each(|room| geometry[self.rooms.slot(*room)] = true);
        self.closed(geometry)
    }

    fn run(&self) -> State {
        let budget = self.index.settings.budget;
        let all = || self.state(vec![true; self.rooms.cells_of.len()]);
        if let Some(everything) = (!self.everywhere).then(all).filter(|e| e.triangles <= budget) {
            return everything;
        }
        let mut best = self.least();
        let mut tried = vec![false; self.rooms.cells_of.len()];
        for _ in 0..if self.everywhere { 0 } else { MOST_TRIES } {
            if best.triangles >= budget {
                break;
            }
            let Some(room) = self.nearest(&best.view, &tried) else { break };
            tried[room] = true;
            let mut geometry = best.geometry.clone();
            geometry[room] = true;
            let more = self.closed(geometry);
            if more.triangles <= budget {
                best = more;
            }
        }
        best
    }

    /// The room beyond the nearest threshold that was not tried.
    fn nearest(&self, view: &PortalView, tried: &[bool]) -> Option<usize> {
        let portals = self.rooms.rooms.portals();
        let beyond = view.thresholds.iter().map(|t| {
            let portal = &portals[t.portal as usize];
            (portal.distance_m(self.pose.position), self.rooms.slot(portal.cells[1 - t.side]))
        });
        let open = beyond.filter(|(_, room)| !tried[*room]);
        open.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))).map(|(_, room)| room)
    }

    /// Adds rooms until every portal to one that is not geometry has an image for this eye.
    fn closed(&self, mut geometry: Vec<bool>) -> State {
        loop {
            let state = self.state(geometry);
            let portals = self.rooms.rooms.portals();
            let bare = |portal: u32, side| self.shown(portal, side).is_empty();
            let unserved = state.view.thresholds.iter().filter(|t| bare(t.portal, t.side));
            let rooms: Vec<usize> =
                unserved.map(|t| self.rooms.slot(portals[t.portal as usize].cells[1 - t.side])).collect();
            if rooms.is_empty() {
                return state;
            }
            geometry = state.geometry;
            rooms.into_iter().for_each(|room| geometry[room] = true);
        }
    }

    /// The placements that show a portal to the eye.
    fn shown(&self, portal: u32, side: usize) -> Vec<u32> {
        self.rooms.shown(&self.index.placements, self.images, portal, side, self.pose.position)
    }

    /// What is seen of these rooms.
    fn state(&self, geometry: Vec<bool>) -> State {
        let enters = |room: CellId| geometry[self.rooms.slot(room)];
        let view = portal_view_within(&self.rooms.rooms, &self.picture, &self.start, &enters, VISITS_PER_VIEW);
        let mut taken = vec![false; self.index.cells.len()];
        let (mut cells, mut triangles) = (Vec::new(), 0);
        for room in &view.cells {
            for &cell in self.rooms.cells(room.cell) {
                let entry = &self.index.cells[cell as usize];
                let seen = |cone: &Cone| cone.may_intersect(&entry.bounds);
                if !taken[cell as usize] && self.frusta.admit(&entry.bounds) && room.cones.iter().any(seen) {
                    taken[cell as usize] = true;
                    let level = level_at(self.index, cell, self.pose.position);
                    triangles += u64::from(entry.triangles_at(level));
                    cells.push((entry.bounds.distance(self.pose.position), DrawnCell { cell, level }));
                }
            }
        }
        State { geometry, view, cells, triangles }
    }

    /// The portals at which a view stops, with their images.
    fn portals(&self, view: &PortalView) -> Vec<ShownPortal> {
        let mut out: Vec<ShownPortal> = Vec::new();
        for t in &view.thresholds {
            if let Some(known) = out.iter_mut().find(|p| (p.portal, p.side) == (t.portal, t.side)) {
                known.cones.push(t.cone.clone());
                continue;
            }
            let found = self.shown(t.portal, t.side);
            let Some(&placement) = found.first() else { continue };
            let (images, cones) = (Vec::new(), vec![t.cone.clone()]);
            let second = found.get(1).copied();
            out.push(ShownPortal { portal: t.portal, side: t.side, placement, second, images, cones });
        }
        for p in &mut out {
            for placement in [Some(p.placement), p.second].into_iter().flatten() {
                for cone in &p.cones {
                    for image in images_within(self.index, placement, self.pose, &cone.normals) {
                        if !p.images.contains(&image) {
                            p.images.push(image);
                        }
                    }
                }
            }
        }
        let portals = self.rooms.rooms.portals();
        let distance = |p: &ShownPortal| portals[p.portal as usize].distance_m(self.pose.position);
        out.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then((a.portal, a.side).cmp(&(b.portal, b.side))));
        out
    }
}

#[cfg(test)]
#[path = "portals_test.rs"]
mod tests;
