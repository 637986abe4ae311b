//! The views of a pose, with exactly the functions that the client renders with.

use super::planner::Views;
use ldi_protocol::{
    OutputCamera, Pose,
    index::{CellEntry, Index},
    need::{Needed, Sight, needed},
    select::{CellGroups, FarBy, Show, cells_before_tree, draw_list_of, draws_among},
    tree::{Lens, lacking, lacking_below},
};
use std::sync::{
    Arc,
    atomic::{AtomicU8, Ordering::Relaxed},
};

/// A guessed pose stands for those around it. Before the LDI tree some of them draw cells that the
/// budget keeps it from drawing: cells within so many budgets are looked for.
const GUESSED_BUDGET: f64 = 1.3;
/// And some of them lie nearer: levels of textures and of the LDI tree are looked for as pixels so
/// many times as fine show them.
pub const GUESSED_FINER: f64 = 1.1;

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
    picture: OutputCamera,
    picture_half_tan: (f64, f64),
    show: Show,
    /// Decoded bytes that the client's cache holds.
    cache_bytes: u64,
    /// A [`Known`]: the planner and its forecast share the views.
    known: AtomicU8,
}

impl SelectViews {
    /// Views of this index through this picture, shown as it is by default.
    pub fn new(index: Arc<Index>, picture: &OutputCamera) -> Self {
        let groups = Arc::new(CellGroups::of(&index.cells));
        Self::showing(index, groups, picture, Show::default())
    }

    /// The same shown otherwise, and with `groups` of the index's cells, which all who see it may
    /// share.
    pub fn showing(index: Arc<Index>, groups: Arc<CellGroups>, picture: &OutputCamera, show: Show) -> Self {
        Self {
            index,
            groups,
            picture: *picture,
            picture_half_tan: (picture.half_tan_x(), picture.half_tan_y()),
            show,
            cache_bytes: u64::MAX,
            known: AtomicU8::new(Known::Whole as u8),
        }
    }

    /// The same for a client whose cache holds so many decoded bytes.
    #[must_use]
    pub fn cached_in(self, cache_bytes: u64) -> Self {
        Self { cache_bytes, ..self }
    }

    fn sight(&self, pose: &Pose) -> Sight {
        Sight::new(pose, &self.picture, 1)
    }

    /// Of a pose that may come true or nearly.
    fn guessed(&self, pose: &Pose) -> Sight {
        self.sight(pose).finer(GUESSED_FINER)
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
            n if n == Known::Tree as u8 => return needed(&self.index, &[], &[], &[], &self.sight(pose)),
            _ => {}
        }
        let list = draw_list_of(&self.index, &self.groups, pose, self.picture_half_tan, self.show);
        let needed = needed(&self.index, &list.images, &list.cells, &list.tree, &self.sight(pose));
        needed.within(&self.index, self.cache_bytes)
    }

    /// Looks only at cells, images and nodes of the LDI tree that lack something: where most is
    /// there, a small part of the work. Where rooms decide what is drawn it looks at all.
    fn lacking(&self, poses: &[Pose], absent: &dyn Fn(u32) -> bool) -> Vec<Vec<u32>> {
        let index = &*self.index;
        let of = |n: Needed| -> Vec<u32> { n.now.into_iter().chain(n.fine).filter(|c| absent(*c)).collect() };
        let whole = self.known.load(Relaxed) == Known::Whole as u8;
        if let Some(tree) = index.tree.as_ref().filter(|_| whole && self.show.far.is_tree(index)) {
            let (half_tan_x, half_tan_y) = self.picture_half_tan;
            let lens = Lens { half_tan_x, half_tan_y, focal_px: index.settings.camera.focal_px() * GUESSED_FINER };
            let below = lacking_below(tree, absent);
            let of_pose = |pose: &Pose| {
                let cells = cells_before_tree(index, &self.groups, pose, self.picture_half_tan, GUESSED_BUDGET);
                let mut chunks = of(needed(index, &[], &cells, &[], &self.guessed(pose)));
                chunks.extend(lacking(tree, pose, &lens, &below, absent));
                chunks
            };
            return poses.iter().map(of_pose).collect();
        }
        let far = self.show.far;
        let by_grid = !index.points.is_empty() && index.rooms.is_none();
        if !whole || far == FarBy::Tree || far == FarBy::Offered && !by_grid {
            return poses.iter().map(|pose| of(self.needed(pose))).collect();
        }
        let textures: Vec<bool> = index.textures.iter().map(|t| t.chunks.iter().any(|c| absent(c.chunk))).collect();
        let lacks_texture = |material: &u32| {
            let texture = index.materials.get(*material as usize).and_then(|m| m.texture);
            texture.is_some_and(|t| textures.get(t as usize) == Some(&true))
        };
        let lacks_mesh = |chunk: u32, bundles: &[u32]| absent(chunk) || bundles.iter().any(|b| absent(*b));
        let lacks = |cell: &CellEntry| {
            lacks_mesh(cell.chunk, &cell.bundles)
                || cell.levels.iter().any(|level| lacks_mesh(level.chunk, &level.bundles))
                || cell.materials.iter().any(lacks_texture)
        };
        let cells = self.groups.some(index.cells.len(), |c| lacks(&index.cells[c]));
        let images: Vec<bool> = index.images.iter().map(|i| i.chunks.iter().any(|c| absent(*c))).collect();
        let of_pose = |pose: &Pose| {
            let (cells, images) = draws_among(index, &self.groups, (&cells, &images), pose, self.picture_half_tan, far);
            match cells.is_empty() && images.is_empty() {
                true => Vec::new(),
                false => of(needed(index, &images, &cells, &[], &self.guessed(pose))),
            }
        };
        poses.iter().map(of_pose).collect()
    }
}
