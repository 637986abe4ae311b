//! The dataset as JSON for the page: floor plans and rooms, scene bounds, counts, and for the
//! technical layers cells, grid points and placements.
//!
//! Lengths are metres, x to the right and z downward (a right-handed world seen from +Y), rounded
//! to millimetres.

use super::source::Served;
use crate::plan::png;
use base64::Engine as _;
use ldi_protocol::{
    floor_plan::FloorPlan,
    index::{ChunkKind, ImageEntry, Placement},
    rooms::Cell,
};
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
        ("levels of detail", ChunkKind::Levels),
        ("LDI layers", ChunkKind::Ldi),
        ("textures", ChunkKind::Texture),
        ("LDI tree", ChunkKind::Tree),
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
    let strokes = |p: &Placement| {
        let of_placement = &index.images[p.images.start as usize..p.images.end as usize];
        of_placement.iter().filter(|i| !i.chunks.is_empty()).map(|i| stroke(p, i)).collect::<Vec<_>>()
    };
    let images: Vec<Value> = index.placements.iter().flat_map(strokes).collect();
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
        "plans": index.plans.iter().map(storey).collect::<Vec<_>>(),
        "rooms": index.rooms.iter().flat_map(|r| r.rooms.cells()).map(room).collect::<Vec<_>>(),
        "chunks": kinds,
        "cells": cells,
        "points": points,
        "images": images,
    });
    plan.to_string().into_bytes()
}

/// A floor plan with its picture. Page and picture come in one answer, so that they are of the same
/// dataset.
fn storey(plan: &FloorPlan) -> Value {
    let picture = png::encode(plan.size, plan.picture().as_flattened()).unwrap_or_default();
    let picture = base64::engine::general_purpose::STANDARD.encode(picture);
    json!({
        "floor_m": mm(plan.floor_m),
        "area": plan.area().map(mm),
        "content": plan.content().map(mm),
        "pitch_m": plan.pitch_m,
        "relief": plan.relief,
        "contour_m": plan.contour_m(),
        "picture": format!("data:image/png;base64,{picture}"),
    })
}

/// A room: its name and the boxes that it consists of, [x0, z0, x1, z1, y0, y1].
fn room(room: &Cell) -> Value {
    let boxes = room.boxes.iter().map(|b| {
        let (low, high) = (b.min, b.max);
        [low.x, low.z, high.x, high.z, low.y, high.y].map(mm)
    });
    json!({ "name": room.name, "boxes": boxes.collect::<Vec<_>>() })
}

/// An image as a stroke: where its plane stands on the plan, seen from above.
/// [x0, z0, x1, z1, grid point, culled cells, samples, footprint in pixels].
fn stroke(p: &Placement, i: &ImageEntry) -> Value {
    let at = |t: f64| p.cop + (i.basis.forward + i.basis.right * t) * i.plane_distance;
    let (a, b) = (at(i.window[0]), at(i.window[1]));
    let samples: u64 = i.samples_by_layer.iter().map(|s| u64::from(*s)).sum();
    json!([mm(a.x), mm(a.z), mm(b.x), mm(b.z), p.grid_point, p.culled.len(), samples, mm(p.footprint_px)])
}
