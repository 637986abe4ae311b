//! The dataset's plan from above, as JSON for the page: scene bounds, cells, grid points, placements, counts.
//!
//! Lengths are metres, x to the right and z downward (a right-handed world seen from +Y), rounded to millimetres.

use super::source::Served;
use ldi_protocol::index::{ChunkKind, Index, Placement};
use serde_json::{Value, json};

fn mm(x: f64) -> f64 {
    (x * 1e3).round() / 1e3
}

/// The whole plan.
pub(super) fn to_json(served: &Served) -> Vec<u8> {
    let index = &**served.index();
    let bounds = &index.scene.bounds;
    let stored =
        |kind| -> u64 { index.chunks.iter().filter(|c| c.kind == kind).map(|c| u64::from(c.stored_bytes)).sum() };
    let count = |kind| index.chunks.iter().filter(|c| c.kind == kind).count();
    let kinds: Vec<Value> = [
        ("cells", ChunkKind::Cell),
        ("bundles", ChunkKind::Bundle),
        ("LDI layers", ChunkKind::Ldi),
        ("textures", ChunkKind::Texture),
    ]
    .map(|(name, kind)| json!({ "name": name, "chunks": count(kind), "bytes": stored(kind) }))
    .into();
    let cells: Vec<Value> = index
        .cells
        .iter()
        .map(|c| {
            let (a, b) = (c.bounds.min, c.bounds.max);
            json!([mm(a.x), mm(a.z), mm(b.x), mm(b.z), c.triangles, mm(a.y), mm(b.y)])
        })
        .collect();
    let points: Vec<Value> = index
        .points
        .iter()
        .map(|p| json!([mm(p.position.x), mm(p.position.z), mm(p.position.y), p.level, mm(p.radius)]))
        .collect();
    let placements: Vec<Value> = index.placements.iter().filter_map(|p| stroke(index, p)).collect();
    let plan = json!({
        "dataset": served.hash().to_string(),
        "scene": {
            "name": index.scene.name,
            "triangles": index.scene.triangles,
            "unique_triangles": index.scene.unique_triangles,
            "instances": index.scene.instances,
            "min": bounds.min.to_array().map(mm),
            "max": bounds.max.to_array().map(mm),
        },
        "settings": index.settings,
        "chunks": kinds,
        "cells": cells,
        "points": points,
        "placements": placements,
    });
    plan.to_string().into_bytes()
}

/// A placement as a stroke: where its image plane, cut to what the culled cells cover seen from the grid point, stands on
/// the plan. [x0, z0, x1, z1, grid point, culled cells, samples, footprint in pixels].
fn stroke(index: &Index, p: &Placement) -> Option<Value> {
    let point = index.points.get(p.grid_point as usize)?;
    // Widest half angle that a stroke shows: a cell beside the point would stretch it without end.
    const MAX_TANGENT: f64 = 2.0;
    let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
    for cell in p.culled.iter().filter_map(|c| index.cells.get(*c as usize)) {
        for corner in cell.bounds.corners() {
            let v = corner - point.position;
            let tangent = v.dot(p.basis.right) / v.dot(p.basis.forward).max(p.plane_distance).max(1e-6);
            left = left.min(tangent.max(-MAX_TANGENT));
            right = right.max(tangent.min(MAX_TANGENT));
        }
    }
    if left > right {
        return None;
    }
    let at = |t: f64| point.position + (p.basis.forward + p.basis.right * t) * p.plane_distance;
    let (a, b) = (at(left), at(right));
    let samples: u64 = p.samples_by_layer.iter().map(|s| u64::from(*s)).sum();
    Some(json!([mm(a.x), mm(a.z), mm(b.x), mm(b.z), p.grid_point, p.culled.len(), samples, mm(p.footprint_px)]))
}
