//! What is shown while a view's images or geometry are on their way, or its images are being laid out: the same pose by the placement before, which is at hand, as long as the eye
//! has not gone far from its users.
//!
//! The LDI tree would show there, too, but coarser and for longer: its pixels are those of a whole placement's images. Nothing is promised of a stand-in but the budget:
//! footprints and what is uncovered grow with the way from the users, so that way is bounded.

use super::frame_renderer::{View, drawable};
use crate::resident::Resident;
use ldi_protocol::{
    Pose,
    index::Index,
    select::{DrawList, draw_list_by},
};

/// How far the eye may be from the placement's users, as a share of the distance of its nearest image plane. There footprints are a third above the bound. Larger: what lies behind
/// corners is missing in more of the picture.
const AWAY: f64 = 0.25;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct FallbackView {
    /// The placement of the last view that had all it draws; None also where that was geometry alone.
    placement: Option<u32>,
}

impl FallbackView {
    /// A view had all it draws.
    pub fn remember_complete(&mut self, view: &View) {
        self.placement = view.selection.placement;
    }

    /// The placement before, for a view that lacks something. None where it would not do: too far away, itself not at hand, or above the budget. `is_ready`: whether an image can be
    /// warped now.
    pub fn view(
        &self,
        index: &Index,
        resident: &dyn Resident,
        view: &View,
        (pose, half_tan): (&Pose, (f64, f64)),
        is_ready: &dyn Fn(u32) -> bool,
    ) -> Option<View> {
        let number = self.placement.filter(|p| view.selection.placement != Some(*p))?;
        // An eye that no image was made for is shown none.
        if view.by_tree || !view.portals.is_empty() || view.is_unplanned(index, pose) {
            return None;
        }
        let is_whole =
            |v: &View| v.images.iter().all(|i| is_ready(*i)) && absent_chunks(index, resident, &v.cells).is_empty();
        let placement = index.placements.get(number as usize)?;
        // Without images nothing bounds the way, and what is culled shows nowhere.
        let plane_m = index.images_of(number).map(|(_, i)| i.plane_distance).min_by(f64::total_cmp)?;
        if placement.users.distance(pose.position) > AWAY * plane_m || is_whole(view) {
            return None;
        }
        let DrawList { selection, cells, images, dropped, complete_m, tree, rooms, portals, .. } =
            draw_list_by(index, number, pose, half_tan);
        let before = View { selection, cells, images, dropped, complete_m, tree, rooms, portals, ..view.clone() };
        (dropped == 0 && is_whole(&before)).then_some(before)
    }
}

/// The chunks for want of which these cells do not show.
pub(super) fn absent_chunks(index: &Index, resident: &dyn Resident, cells: &[u32]) -> Vec<u32> {
    let (_, mut absent) = drawable(index, resident, cells);
    for (cell, entry) in cells.iter().filter_map(|c| Some((*c, index.cells.get(*c as usize)?))) {
        absent.extend(resident.cell(cell).is_none().then_some(entry.chunk));
        absent.extend(entry.bundles.iter().filter(|b| resident.bundle(**b).is_none()));
    }
    absent
}
