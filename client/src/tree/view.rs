//! The inputs of a drawing: the tree, its data, and the camera.

use crate::resident::Resident;
use ldi_protocol::{
    OutputCamera, Pose,
    tree::{Cut, CutOptions, Lens, Tree, cut},
};

/// The tree, its data and the camera of a drawing.
#[derive(Clone, Copy)]
pub(super) struct TreeView<'a> {
    pub tree: &'a Tree,
    pub resident: &'a dyn Resident,
    pub pose: &'a Pose,
    pub camera: &'a OutputCamera,
}

impl TreeView<'_> {
    pub fn holds(&self, chunk: u32) -> bool {
        self.resident.brood(chunk).is_some()
    }

    pub fn cut(&self, options: &CutOptions) -> Cut {
        cut(self.tree, self.pose, &Lens::from(self.camera), options, |chunk| self.holds(chunk))
    }
}
