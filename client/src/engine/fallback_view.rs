//! The fallback view: the same pose drawn with the previous placement, while the images or geometry
//! of the current one are not ready yet.
//!
//! The fallback is used only while the eye is close to the users of the previous placement. The LDI
//! tree would be drawn instead otherwise, but coarser and for longer: its pixels replace those of
//! all images of a placement. The fallback keeps only the triangle budget. Footprints and uncovered
//! areas grow with the distance from the users, so that distance is bounded.

use super::view::{View, drawable};
use crate::resident::{self, Resident};
use ldi_protocol::{
    Pose,
    index::{DrawnCell, Index},
    select::{DrawList, draw_list_by},
};

/// Largest distance of the eye from the placement's users, as a share of the distance of its
/// nearest image plane. Larger: more of what lies behind corners is missing, and footprints exceed
/// their bound further. Smaller: the coarser LDI tree shows more often.
const AWAY: f64 = 0.25;

/// Remembers the last placement that was drawn completely.
#[derive(Debug, Default)]
pub(super) struct FallbackView {
    /// The placement of the last complete view; None if that view was geometry alone.
    placement: Option<u32>,
}

impl FallbackView {
    /// Records a view that was drawn completely.
    pub fn remember_complete(&mut self, view: &View) {
        self.placement = view.selection.placement;
    }

    /// The fallback for an incomplete view. None if the previous placement is too far away, not
    /// ready itself, or above the budget. `is_ready`: whether an image can be warped now.
    pub fn view(
        &self,
        index: &Index,
        resident: &dyn Resident,
        view: &View,
        (pose, half_tan): (&Pose, (f64, f64)),
        is_ready: &dyn Fn(u32) -> bool,
    ) -> Option<View> {
        let number = self.placement.filter(|p| view.selection.placement != Some(*p))?;
        // Outside of the planned area no placement applies.
        if view.by_tree || !view.portals.is_empty() || view.is_unplanned(index, pose) {
            return None;
        }
        let is_whole =
            |v: &View| v.images.iter().all(|i| is_ready(*i)) && absent_chunks(index, resident, &v.cells).is_empty();
        let placement = index.placements.get(number as usize)?;
        // Without images the distance is not bounded, and culled cells would not be shown by
        // anything.
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

/// The absent chunks that these cells need in order to be drawn.
pub(super) fn absent_chunks(index: &Index, resident: &dyn Resident, cells: &[DrawnCell]) -> Vec<u32> {
    let mut absent = drawable(index, resident, cells).lacking_textures;
    for (drawn, mesh) in cells.iter().filter_map(|c| Some((*c, index.mesh_of(*c)?))) {
        absent.extend(resident::mesh(index, resident, drawn).is_none().then_some(mesh.chunk));
        absent.extend(mesh.bundles.iter().filter(|b| resident.bundle(**b).is_none()));
    }
    absent
}
