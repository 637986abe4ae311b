//! Triangles per cell, counted over the scene itself: nothing that a build stored is believed.

use super::SourceRange;
use crate::scene::Scene;
use ldi_protocol::Aabb;
use std::collections::BTreeMap;

/// Why stored ranges and a scene do not fit together.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RecountError {
    /// A range names triangles that the scene does not have.
    #[error(
        "cell {cell} names triangles {first} to {last} of primitive {primitive} of node {node}, which the scene does not have"
    )]
    NotThere {
        /// Cell.
        cell: usize,
        /// Node of the source.
        node: u32,
        /// Position in the mesh's primitives.
        primitive: u32,
        /// First triangle.
        first: u32,
        /// Last triangle.
        last: u64,
    },
    /// A triangle is in two cells.
    #[error("triangle {triangle} of primitive {primitive} of node {node} is in cell {cell}, and elsewhere too")]
    Twice {
        /// Cell.
        cell: usize,
        /// Node of the source.
        node: u32,
        /// Position in the mesh's primitives.
        primitive: u32,
        /// Triangle.
        triangle: u32,
    },
    /// A triangle reaches out of its cell's bounds, so that it would be missed when the cell is
    /// out of view.
    #[error(
        "triangle {triangle} of primitive {primitive} of node {node} reaches out of cell {cell}, whose bounds are {bounds}"
    )]
    Outside {
        /// Cell.
        cell: usize,
        /// Node of the source.
        node: u32,
        /// Position in the mesh's primitives.
        primitive: u32,
        /// Triangle.
        triangle: u32,
        /// The cell's bounds, as text.
        bounds: String,
    },
    /// Triangles that no cell holds.
    #[error("{0} triangles of the scene are in no cell")]
    Missing(u64),
}

/// Triangles per cell. Each triangle of each instance must be in exactly one cell, and within its
/// bounds.
///
/// # Errors
/// [`RecountError`] names the first that is not, or how many are in no cell.
pub fn recount(scene: &Scene, ranges: &[Vec<SourceRange>], bounds: &[Aabb]) -> Result<Vec<u64>, RecountError> {
    let instances: BTreeMap<(u32, u32), usize> =
        scene.instances.iter().enumerate().map(|(i, x)| ((x.node, x.mesh), i)).collect();
    // Per instance and primitive, which triangles some cell has.
    let mut seen: Vec<Vec<Vec<bool>>> = scene
        .instances
        .iter()
        .map(|i| scene.meshes[i.mesh as usize].primitives.iter().map(|p| vec![false; p.triangles.len()]).collect())
        .collect();
    let mut counts = Vec::with_capacity(ranges.len());
    for (cell, of_cell) in ranges.iter().enumerate() {
        let mut count = 0;
        for r in of_cell {
            let (node, primitive, last) = (r.node, r.primitive, u64::from(r.first) + u64::from(r.count));
            let not_there =
                RecountError::NotThere { cell, node, primitive, first: r.first, last: last.saturating_sub(1) };
            let Some(&number) = instances.get(&(node, r.mesh)) else { return Err(not_there) };
            let instance = &scene.instances[number];
            let Some(p) = scene.meshes[instance.mesh as usize].primitives.get(primitive as usize) else {
                return Err(not_there);
            };
            if last > p.triangles.len() as u64 {
                return Err(not_there);
            }
            for triangle in r.first..last as u32 {
                if std::mem::replace(&mut seen[number][primitive as usize][triangle as usize], true) {
                    return Err(RecountError::Twice { cell, node, primitive, triangle });
                }
                let corners = p.triangles[triangle as usize]
                    .map(|v| instance.world_from_mesh.transform_point3(p.positions[v as usize].as_dvec3()));
                if !bounds.get(cell).is_some_and(|b| corners.iter().all(|c| b.contains(*c))) {
                    let bounds = bounds.get(cell).map_or_else(String::new, |b| format!("{} to {}", b.min, b.max));
                    return Err(RecountError::Outside { cell, node, primitive, triangle, bounds });
                }
                count += 1;
            }
        }
        counts.push(count);
    }
    let missing = seen.iter().flatten().flatten().filter(|s| !**s).count();
    if missing > 0 { Err(RecountError::Missing(missing as u64)) } else { Ok(counts) }
}
