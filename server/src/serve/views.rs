//! The views of a pose, with exactly the functions that the client renders with.

use super::planner::Views;
use ldi_protocol::{
    OutputCamera, Pose,
    index::Index,
    need::{Needed, needed},
    room_index::ShowPortals,
    select::draw_list_showing,
};
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering::Relaxed},
};

/// What is drawn for a pose and what that needs, for one picture.
pub struct SelectViews {
    index: Arc<Index>,
    picture_half_tan: (f64, f64),
    show: ShowPortals,
    /// The client knows the whole index.
    whole: AtomicBool,
}

impl SelectViews {
    /// Views of this index through this picture, portals shown as they are by default.
    pub fn new(index: Arc<Index>, picture: &OutputCamera) -> Self {
        Self::showing(index, picture, ShowPortals::default())
    }

    /// The same with portals shown otherwise.
    pub fn showing(index: Arc<Index>, picture: &OutputCamera, show: ShowPortals) -> Self {
        Self {
            index,
            picture_half_tan: (picture.half_tan_x(), picture.half_tan_y()),
            show,
            whole: AtomicBool::new(true),
        }
    }

    /// Whether the client knows the whole index; before, its views are those of the LDI tree's pinned levels.
    pub fn know_whole(&self, whole: bool) {
        self.whole.store(whole, Relaxed);
    }
}

impl Views for SelectViews {
    fn needed(&self, pose: &Pose) -> Needed {
        if !self.whole.load(Relaxed) {
            return needed(&self.index, &[], &[], &[]);
        }
        let list = draw_list_showing(&self.index, pose, self.picture_half_tan, self.show);
        needed(&self.index, &list.images, &list.cells, &list.tree)
    }
}
