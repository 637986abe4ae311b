//! The interface through which the renderer reads decoded objects.

use glam::DAffine3;
use ldi_protocol::{
    index::{DrawnCell, Index},
    ldi::Ldi,
    mesh::{CellGeometry, Cluster, ClusterInstance, ClusterRef},
    texture::Texture,
    tree::Brood,
};
use std::sync::Arc;

/// Decoded data that is resident now. Absent data is None: the frame is drawn without it, and says
/// so.
pub trait Resident: Sync {
    /// Geometry of a cell.
    fn cell(&self, cell: u32) -> Option<Arc<CellGeometry>>;
    /// A bundle of shared clusters or levels of detail, by chunk number.
    fn bundle(&self, chunk: u32) -> Option<Arc<CellGeometry>>;
    /// A texture with the levels that have arrived; None without any.
    fn texture(&self, texture: u32) -> Option<Arc<Texture>>;
    /// The LDI of an image with the layers that have arrived; None without the first.
    fn ldi(&self, image: u32) -> Option<Arc<Ldi>>;
    /// Nodes of the LDI tree, by chunk number.
    fn brood(&self, chunk: u32) -> Option<Arc<Brood>>;
}

/// The geometry of a cell at a level, without its bundles: the chunk's content and its number.
pub fn mesh(index: &Index, resident: &dyn Resident, drawn: DrawnCell) -> Option<Arc<CellGeometry>> {
    match drawn.level {
        0 => resident.cell(drawn.cell),
        _ => resident.bundle(index.mesh_of(drawn)?.chunk),
    }
}

/// The instances of a cell at a level, in the content of the level's chunk.
pub fn instances<'a>(index: &Index, geometry: &'a CellGeometry, drawn: DrawnCell) -> &'a [ClusterInstance] {
    let range = index.mesh_of(drawn).and_then(|m| m.instances);
    let range = range.map_or(0..geometry.instances.len(), |r| r.start as usize..r.end as usize);
    geometry.instances.get(range).unwrap_or_default()
}

/// True if the chunk of a cell at a level is resident, with all its bundles.
pub fn has_mesh(index: &Index, resident: &dyn Resident, drawn: DrawnCell) -> bool {
    let has_bundles = || index.mesh_of(drawn).is_some_and(|m| m.bundles.iter().all(|b| resident.bundle(*b).is_some()));
    mesh(index, resident, drawn).is_some() && has_bundles()
}

/// Calls `found` with the resident clusters of a cell at its finest resident level, each with its
/// placement in the world.
pub fn each_cluster(index: &Index, resident: &dyn Resident, cell: u32, mut found: impl FnMut(&Cluster, &DAffine3)) {
    let levels = index.cells.get(cell as usize).map_or(0, |c| c.levels.len() as u8);
    let mut finest = (0..=levels).map(|level| DrawnCell { cell, level });
    let Some((drawn, geometry)) = finest.find_map(|d| Some((d, mesh(index, resident, d)?))) else { return };
    for instance in instances(index, &geometry, drawn) {
        let held: Option<Arc<CellGeometry>> = match instance.cluster {
            ClusterRef::Own(_) => Some(geometry.clone()),
            ClusterRef::Shared { chunk, .. } => resident.bundle(chunk),
        };
        let (ClusterRef::Own(n) | ClusterRef::Shared { cluster: n, .. }) = instance.cluster;
        if let Some(cluster) = held.as_ref().and_then(|g| g.clusters.get(n as usize)) {
            found(cluster, &instance.world_from_mesh);
        }
    }
}
