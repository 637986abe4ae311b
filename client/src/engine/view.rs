//! What a pose draws: the cells, images and portals that the selection shows.

use super::options::Method;
use crate::{
    report::StageMs,
    resident::{Resident, has_mesh},
};
use ldi_protocol::{
    OutputCamera, Pose,
    index::{DrawnCell, Index},
    need::{Needed, Sight, needed},
    room_index::PortalImages,
    rooms::{CellId, Portal},
    select::{DrawFrusta, DrawList, FarBy, Selection, ShownPortal, draw_list_showing, is_planned, select},
};
use std::time::Instant;

/// The objects that a pose draws.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Selected grid point and placement.
    pub selection: Selection,
    /// Cells to draw, near to far.
    pub cells: Vec<DrawnCell>,
    /// Images of the placement in view, nearest to the line of sight first.
    pub images: Vec<u32>,
    /// Cells left out because they exceed the budget; 0 wherever the build guarantees the budget.
    pub dropped: u32,
    /// Distance below which `cells` holds all geometry in view, metres; see
    /// [`DrawList::complete_m`].
    pub complete_m: f64,
    /// Triangles of all cells in the frustum, drawn or culled; 0 unless [`view_of`] counted them.
    pub triangles_in_frustum: u64,
    /// Whether the LDI tree shows everything except `cells`.
    pub by_tree: bool,
    /// Chunks that refine the LDI tree.
    pub tree: Vec<u32>,
    /// Rooms drawn as geometry; empty in a dataset without rooms.
    pub rooms: Vec<CellId>,
    /// Portals shown by images, nearest first.
    pub portals: Vec<ShownPortal>,
    /// The kind of portal images shown.
    pub portal_images: PortalImages,
}

impl View {
    /// Whether the dataset has images but none for this eye position, so that geometry and the LDI
    /// tree are shown.
    pub fn is_unplanned(&self, index: &Index, pose: &Pose) -> bool {
        !self.by_tree && !index.placements.is_empty() && !is_planned(index, pose)
    }
}

/// Milliseconds since a moment.
pub(super) fn ms_since(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

/// Selects the objects that a pose draws, with the statistics of a walk's report: times go to `ms`,
/// and [`View::triangles_in_frustum`] is counted. Costs more than [`select_view`].
pub fn view_of(index: &Index, pose: &Pose, camera: &OutputCamera, method: Method, ms: &mut StageMs) -> View {
    if method.show().far == FarBy::Offered {
        // The draw list includes the selection: its time is measured separately.
        let start = Instant::now();
        std::hint::black_box(select(index, pose));
        ms.select = ms_since(start);
    }
    let start = Instant::now();
    let view = select_view(index, pose, camera, method);
    ms.cull = (ms_since(start) - ms.select).max(0.0);
    let in_frustum = cells_in_frustum(index, pose, (camera.half_tan_x(), camera.half_tan_y()));
    let triangles = in_frustum.iter().map(|c| u64::from(index.cells[*c as usize].triangles));
    View { triangles_in_frustum: triangles.sum(), ..view }
}

/// Selects the objects that a pose draws. [`View::triangles_in_frustum`] is 0.
pub fn select_view(index: &Index, pose: &Pose, camera: &OutputCamera, method: Method) -> View {
    let show = method.show();
    let list = draw_list_showing(index, pose, (camera.half_tan_x(), camera.half_tan_y()), show);
    let by_tree = show.far.is_tree(index);
    let DrawList { selection, cells, images, dropped, complete_m, tree, rooms, portals, .. } = list;
    let wanted = show.portals.images;
    let portal_images = index.rooms.as_ref().map_or(wanted, |r| r.resolve(wanted));
    View {
        selection,
        cells,
        images,
        dropped,
        complete_m,
        triangles_in_frustum: 0,
        by_tree,
        tree,
        rooms,
        portals,
        portal_images,
    }
}

/// The cells of a view that can be drawn, as far as data is here.
#[derive(Debug, Default)]
pub(super) struct Drawable {
    /// At the level of the view, or another one that is here.
    pub cells: Vec<DrawnCell>,
    /// Absent texture chunks that prevent other cells from being drawn. While the LDI tree shows a
    /// cell in its colours, untextured geometry would look worse.
    pub lacking_textures: Vec<u32>,
    /// Absent chunks of cells that are drawn at another level.
    pub lacking_levels: Vec<u32>,
}

/// Levels of detail that a frame draws.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LevelStats {
    /// Triangles of cells that are not drawn in full.
    pub triangles: u64,
    /// Largest deviation that a level may show, pixels of the picture.
    pub deviation_px: f64,
}

impl LevelStats {
    /// Counts the levels of these cells, and how far they may deviate as a camera sees them.
    pub(super) fn of(index: &Index, cells: &[DrawnCell], camera: &OutputCamera, pose: &Pose) -> Self {
        let mut stats = Self::default();
        for drawn in cells.iter().filter(|d| d.level > 0) {
            let (Some(entry), Some(mesh)) = (index.cells.get(drawn.cell as usize), index.mesh_of(*drawn)) else {
                continue;
            };
            let px = camera.displacement_px(mesh.deviation_m, entry.bounds.distance(pose.position));
            stats.triangles += u64::from(mesh.triangles);
            stats.deviation_px = stats.deviation_px.max(px);
        }
        stats
    }
}

/// Finds what can be drawn of these cells.
pub(super) fn drawable(index: &Index, resident: &dyn Resident, cells: &[DrawnCell]) -> Drawable {
    let mut out = Drawable::default();
    let triangles = |c: &DrawnCell| index.mesh_of(*c).map_or(0, |m| u64::from(m.triangles));
    let mut spare = index.settings.budget.saturating_sub(cells.iter().map(triangles).sum());
    let absent: Vec<Option<u32>> = (0u32..)
        .zip(&index.textures)
        .map(|(t, entry)| entry.chunks.first().filter(|_| resident.texture(t).is_none()).map(|c| c.chunk))
        .collect();
    for cell in cells {
        let materials = index.cells.get(cell.cell as usize).map_or(&[][..], |c| &c.materials);
        let textures = materials.iter().filter_map(|m| index.materials.get(*m as usize)?.texture);
        let wanted: Vec<u32> = textures.filter_map(|t| *absent.get(t as usize)?).collect();
        if !wanted.is_empty() && index.tree.is_some() {
            out.lacking_textures.extend(wanted);
            continue;
        }
        let drawn = at_hand(index, resident, *cell, spare);
        if drawn != *cell {
            spare = (spare + triangles(cell)).saturating_sub(triangles(&drawn));
            out.lacking_levels.extend(index.mesh_of(*cell).map(|m| m.chunk));
        }
        out.cells.push(drawn);
    }
    out
}

/// The cell at its level, or at the closest coarser one that is here, or the closest finer one if
/// that takes at most `spare` triangles more. The cell itself if none is here.
fn at_hand(index: &Index, resident: &dyn Resident, wanted: DrawnCell, spare: u64) -> DrawnCell {
    let Some(entry) = index.cells.get(wanted.cell as usize).filter(|c| !c.levels.is_empty()) else { return wanted };
    let coarser = wanted.level..=entry.levels.len() as u8;
    let most = u64::from(entry.triangles_at(wanted.level)) + spare;
    let finer = (0..wanted.level).rev().filter(|l| u64::from(entry.triangles_at(*l)) <= most);
    let mut all = coarser.chain(finer).map(|level| DrawnCell { level, ..wanted });
    all.find(|d| has_mesh(index, resident, *d)).unwrap_or(wanted)
}

fn cells_in_frustum(index: &Index, pose: &Pose, half_tan: (f64, f64)) -> Vec<u32> {
    let frusta = DrawFrusta::new(&index.settings, pose, half_tan);
    (0u32..).zip(&index.cells).filter(|(_, c)| frusta.admit(&c.bounds)).map(|(i, _)| i).collect()
}

impl View {
    /// The chunks that a complete view needs.
    pub fn needed(&self, index: &Index, sight: &Sight) -> Needed {
        needed(index, &self.images, &self.cells, &self.tree, sight)
    }

    /// The needed chunks, limited to a cache of `cap_bytes`.
    pub fn needed_within(&self, index: &Index, sight: &Sight, cap_bytes: u64) -> Needed {
        self.needed(index, sight).within(index, cap_bytes)
    }

    /// The portal that an image is drawn onto as a flat texture.
    pub(super) fn canvas<'a>(&self, index: &'a Index, image: u32) -> Option<&'a Portal> {
        let shown = self.portals.iter().find(|p| self.portal_images.is_texture() && p.images.contains(&image))?;
        index.rooms.as_ref()?.rooms.portals().get(shown.portal as usize)
    }
}
