//! The views of a pose, with exactly the functions that the client renders with.

use super::planner::Views;
use ldi_protocol::{
    OutputCamera, Pose,
    index::Index,
    need::{Needed, needed},
    select::draw_list,
};
use std::sync::Arc;

/// What is drawn for a pose and what that needs, for one picture.
pub struct SelectViews {
    index: Arc<Index>,
    picture_half_tan: (f64, f64),
}

impl SelectViews {
    /// Views of this index through this picture.
    pub fn new(index: Arc<Index>, picture: &OutputCamera) -> Self {
        Self { index, picture_half_tan: (picture.half_tan_x(), picture.half_tan_y()) }
    }
}

impl Views for SelectViews {
    fn needed(&self, pose: &Pose) -> Needed {
        let list = draw_list(&self.index, pose, self.picture_half_tan);
        needed(&self.index, &list.images, &list.cells, &list.tree)
    }
}
