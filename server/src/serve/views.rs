//! The views of a pose, with exactly the functions that the client renders with.

use super::planner::Views;
use ldi_protocol::{
    OutputCamera, Pose,
    index::Index,
    need::{Needed, needed},
    room_index::ShowPortals,
    select::{CellGroups, draw_list_of},
};
use std::sync::{
    Arc,
    atomic::{AtomicU8, Ordering::Relaxed},
};

/// What a client knows of an index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Known {
    /// Perhaps all of it, but it has not yet said what it holds: nothing is to be sent.
    Unsaid,
    /// The LDI tree: its pinned levels are to be sent.
    Tree,
    /// All of it.
    Whole,
}

/// What is drawn for a pose and what that needs, for one picture.
pub struct SelectViews {
    index: Arc<Index>,
    groups: Arc<CellGroups>,
    picture_half_tan: (f64, f64),
    show: ShowPortals,
    /// A [`Known`]: the planner and its forecast share the views.
    known: AtomicU8,
}

impl SelectViews {
    /// Views of this index through this picture, portals shown as they are by default.
    pub fn new(index: Arc<Index>, picture: &OutputCamera) -> Self {
        let groups = Arc::new(CellGroups::of(&index.cells));
        Self::showing(index, groups, picture, ShowPortals::default())
    }

    /// The same with portals shown otherwise, and with `groups` of the index's cells, which all who see it may share.
    pub fn showing(index: Arc<Index>, groups: Arc<CellGroups>, picture: &OutputCamera, show: ShowPortals) -> Self {
        Self {
            index,
            groups,
            picture_half_tan: (picture.half_tan_x(), picture.half_tan_y()),
            show,
            known: AtomicU8::new(Known::Whole as u8),
        }
    }

    /// How much the client knows of the index, which bounds what its views need.
    pub fn know(&self, known: Known) {
        self.known.store(known as u8, Relaxed);
    }
}

impl Views for SelectViews {
    fn needed(&self, pose: &Pose) -> Needed {
        match self.known.load(Relaxed) {
            n if n == Known::Unsaid as u8 => return Needed::default(),
            n if n == Known::Tree as u8 => return needed(&self.index, &[], &[], &[]),
            _ => {}
        }
        let list = draw_list_of(&self.index, &self.groups, pose, self.picture_half_tan, self.show);
        needed(&self.index, &list.images, &list.cells, &list.tree)
    }
}
