//! Whether a decoded chunk is what the index says: for readers of chunks from elsewhere, and for
//! `verify`.

use crate::{
    Aabb,
    codec::{CodecError, texture::TextureLevels},
    index::{ChunkKind, DrawnCell, Index, TextureChunk, TextureEntry},
    ldi::Ldi,
    mesh::{CellGeometry, Cluster, ClusterRef},
};
use glam::DVec3;

/// How far quantized vertices may lie outside a cell's bounds, metres, beside a millionth of the
/// coordinates' size: half a step of 0.1 mm, for instances of any turn.
const BOUNDS_MARGIN_M: f64 = 1e-3;

/// Checks the cell's own chunk: materials exist, shared clusters lie in the cell's bundles.
///
/// # Errors
/// What contradicts the index.
pub fn check_cell(index: &Index, cell: u32, geometry: &CellGeometry) -> Result<(), CodecError> {
    let entry =
        index.cells.get(cell as usize).ok_or_else(|| CodecError::range("cell", cell, "the index has no such cell"))?;
    check_materials(index, geometry)?;
    for instance in &geometry.instances {
        if let ClusterRef::Shared { chunk, .. } = instance.cluster
            && entry.bundles.binary_search(&chunk).is_err()
        {
            return Err(CodecError::range("bundles", chunk, "the cell does not list this bundle"));
        }
    }
    Ok(())
}

/// Checks a bundle's chunk: materials exist, and it has no instances.
///
/// # Errors
/// What contradicts the index.
pub fn check_bundle(index: &Index, geometry: &CellGeometry) -> Result<(), CodecError> {
    if !geometry.instances.is_empty() {
        return Err(CodecError::range("instances", geometry.instances.len(), "a bundle has none"));
    }
    check_materials(index, geometry)
}

/// Checks a chunk of levels of detail: materials exist, and shared clusters lie in bundles.
///
/// # Errors
/// What contradicts the index.
pub fn check_levels(index: &Index, geometry: &CellGeometry) -> Result<(), CodecError> {
    check_materials(index, geometry)?;
    let is_bundle = |chunk: u32| index.chunks.get(chunk as usize).is_some_and(|c| c.kind == ChunkKind::Bundle);
    for instance in &geometry.instances {
        if let ClusterRef::Shared { chunk, .. } = instance.cluster
            && !is_bundle(chunk)
        {
            return Err(CodecError::range("bundles", chunk, "the index has no such bundle"));
        }
    }
    Ok(())
}

fn check_materials(index: &Index, geometry: &CellGeometry) -> Result<(), CodecError> {
    match geometry.clusters.iter().find(|c| c.material as usize >= index.materials.len()) {
        Some(c) => Err(CodecError::range("material", c.material, "the index has no such material")),
        None => Ok(()),
    }
}

/// Checks what a cell draws at a level once its bundles are at hand: shared clusters exist and lie
/// in bundles that the level lists, the triangles are as many as the index says and lie within the
/// cell's bounds. `geometry` is the content of the level's chunk; `bundle` gives a bundle by chunk
/// number.
///
/// # Errors
/// What contradicts the index.
pub fn check_cell_content<'a>(
    index: &Index,
    cell: DrawnCell,
    geometry: &'a CellGeometry,
    bundle: impl Fn(u32) -> Option<&'a CellGeometry>,
) -> Result<(), CodecError> {
    let (Some(entry), Some(mesh)) = (index.cells.get(cell.cell as usize), index.mesh_of(cell)) else {
        return Err(CodecError::range("cell", cell.cell, "the index has no such cell or level of it"));
    };
    let range = mesh.instances.map_or(0..geometry.instances.len(), |r| r.start as usize..r.end as usize);
    let Some(instances) = geometry.instances.get(range.clone()) else {
        return Err(CodecError::range("instances", range.end, "the chunk has fewer"));
    };
    let mut triangles = 0u64;
    let mut bounds = Aabb::EMPTY;
    for instance in instances {
        if let ClusterRef::Shared { chunk, .. } = instance.cluster
            && mesh.bundles.binary_search(&chunk).is_err()
        {
            return Err(CodecError::range("bundles", chunk, "the cell does not list this bundle"));
        }
        let cluster: Option<&Cluster> = match instance.cluster {
            ClusterRef::Own(k) => geometry.clusters.get(k as usize),
            ClusterRef::Shared { chunk, cluster } => bundle(chunk).and_then(|b| b.clusters.get(cluster as usize)),
        };
        let cluster = cluster
            .ok_or_else(|| CodecError::mismatch("instances", format!("no such cluster: {:?}", instance.cluster)))?;
        triangles += cluster.triangles.len() as u64;
        for p in &cluster.positions {
            bounds = bounds.grown_to(instance.world_from_mesh.transform_point3(cluster.origin + p.as_dvec3()));
        }
    }
    if triangles != u64::from(mesh.triangles) {
        return Err(CodecError::mismatch("triangles", format!("{triangles}, but the index says {}", mesh.triangles)));
    }
    let allowed = entry.bounds.inflated(BOUNDS_MARGIN_M + 1e-6 * entry.bounds.max_distance(DVec3::ZERO));
    let within = bounds.is_empty() || (allowed.contains(bounds.min) && allowed.contains(bounds.max));
    if !within {
        return Err(CodecError::mismatch("bounds", format!("{bounds:?} exceeds the index's {:?}", entry.bounds)));
    }
    Ok(())
}

/// Checks an LDI as far as it is here: as many samples in each layer as its entry says, and its
/// orientation.
///
/// # Errors
/// What contradicts the index.
pub fn check_ldi(index: &Index, image: u32, ldi: &Ldi) -> Result<(), CodecError> {
    let entry = index
        .images
        .get(image as usize)
        .ok_or_else(|| CodecError::range("image", image, "the index has no such image"))?;
    for (k, layer) in ldi.layers.iter().enumerate() {
        let listed = entry.samples_by_layer.get(k).copied().unwrap_or(0);
        if layer.len() != listed as usize {
            let reason = format!("{} samples in layer {k}, but the index says {listed}", layer.len());
            return Err(CodecError::mismatch("samples", reason));
        }
    }
    let (a, b) = (&ldi.camera.basis, &entry.basis);
    let turned = (a.right - b.right).length() + (a.up - b.up).length() + (a.forward - b.forward).length();
    if turned > 1e-9 {
        return Err(CodecError::mismatch("basis", "the image has another orientation than its entry"));
    }
    Ok(())
}

/// Checks that a decoded chunk takes as many bytes as the index says: caches count by that number.
///
/// # Errors
/// If it does not.
pub fn check_decoded_bytes(index: &Index, chunk: u32, found: usize) -> Result<(), CodecError> {
    let listed = index
        .chunks
        .get(chunk as usize)
        .ok_or_else(|| CodecError::range("chunk", chunk, "the index has no such chunk"))?
        .decoded_bytes;
    if found == listed as usize {
        Ok(())
    } else {
        Err(CodecError::mismatch("decoded bytes", format!("{found} bytes in memory, but the index says {listed}")))
    }
}

/// Checks a texture chunk: size and levels are those of its entry.
///
/// # Errors
/// What contradicts the index.
pub fn check_texture(entry: &TextureEntry, chunk: &TextureChunk, levels: &TextureLevels) -> Result<(), CodecError> {
    let count = usize::from(chunk.last_level - chunk.first_level.min(chunk.last_level)) + 1;
    if (levels.width, levels.height) != (entry.width, entry.height)
        || levels.first_level != chunk.first_level
        || levels.levels.len() != count
    {
        return Err(CodecError::mismatch("levels", "the chunk holds other levels than the index says"));
    }
    Ok(())
}
