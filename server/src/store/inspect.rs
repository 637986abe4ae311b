//! What is in a dataset, as JSON and as text.

use super::{Dataset, StoreError};
use ldi_protocol::{
    Aabb,
    index::{ChunkKind, Index},
    manifest,
    room_index::RoomIndex,
};
use serde_json::{Value, json};

/// Everything worth knowing about a dataset. With `per_cell`, `cells` lists for every cell its
/// bounds, its triangles and its `[node, mesh, primitive, first, count]` ranges into the source
/// scene, and `elements` what these nodes are.
///
/// # Errors
/// If the file of source ranges or that of elements is damaged or does not fit the cells.
pub fn inspect(dataset: &Dataset, per_cell: bool) -> Result<Value, StoreError> {
    let index = dataset.index();
    let report = dataset.report();
    let from_report = |key: &str| report.as_ref().and_then(|r| r.get(key)).cloned().unwrap_or(Value::Null);
    let page_bytes: u64 = dataset.root().pages.iter().map(|p| u64::from(p.stored_bytes)).sum();
    let samples_by_layer = samples_by_layer(dataset);
    let samples: u64 = samples_by_layer.iter().sum();
    let ldi = kind_sizes(dataset, ChunkKind::Ldi);
    let mut levels = Vec::new();
    for p in &index.points {
        let level = usize::from(p.level);
        if levels.len() <= level {
            levels.resize(level + 1, 0u64);
        }
        levels[level] += 1;
    }
    let footprint = index.placements.iter().map(|p| p.footprint_px).fold(0.0, f64::max);
    let mut out = json!({
        "dataset": dataset.path().display().to_string(),
        "hash": dataset.hash().to_string(),
        "format_version": manifest::VERSION,
        "scene": {
            "name": index.scene.name,
            "triangles": index.scene.triangles,
            "unique_triangles": index.scene.unique_triangles,
            "instances": index.scene.instances,
            "bounds": bounds(&index.scene.bounds),
        },
        "settings": index.settings,
        "bytes": {
            "total": dataset.pack_bytes().iter().sum::<u64>() + dataset.manifest_root().len() as u64,
            "manifest_root": dataset.manifest_root().len(),
            "manifest_pages": page_bytes,
            "packs": dataset.pack_bytes(),
        },
        "chunks": {
            "cell": kind_json(kind_sizes(dataset, ChunkKind::Cell)),
            "bundle": kind_json(kind_sizes(dataset, ChunkKind::Bundle)),
            "levels": kind_json(kind_sizes(dataset, ChunkKind::Levels)),
            "ldi": kind_json(ldi),
            "texture": kind_json(kind_sizes(dataset, ChunkKind::Texture)),
            "tree": kind_json(kind_sizes(dataset, ChunkKind::Tree)),
        },
        "cell_count": index.cells.len(),
        "cell_levels": index.cells.iter().map(|c| c.levels.len()).sum::<usize>(),
        "cell_triangles": index.cells.iter().map(|c| u64::from(c.triangles)).sum::<u64>(),
        "materials": index.materials.len(),
        "textures": index.textures.len(),
        "grid": {
            "points": index.points.len(),
            "by_level": levels,
            "pitch_bands_deg": index.pitch_bands_deg,
            "walk_volume": index.volume.as_ref().map(|v| bounds(v.bounds())),
        },
        "placements": {
            "count": index.placements.len(),
            "images": index.images.len(),
            "empty_images": index.images.iter().filter(|i| i.chunks.is_empty()).count(),
            "max_footprint_px": footprint,
            "culled_cells_mean": mean(index.placements.iter().map(|p| p.culled.len() as f64)),
        },
        "samples": {
            "total": samples,
            "by_layer": samples_by_layer,
            "bytes_per_sample": if samples == 0 { Value::Null } else { json!(ldi.1 as f64 / samples as f64) },
        },
        "tree": index.tree.as_ref().map(|t| json!({
            "nodes": t.nodes.len(),
            "levels": t.nodes.iter().map(|n| n.level + 1).max(),
            "pinned_levels": t.pinned_levels,
            "samples": t.nodes.iter().map(|n| u64::from(n.samples)).sum::<u64>(),
        })),
        "rooms": index.rooms.as_ref().map(|r| rooms(index, r)),
        "skipped": from_report("skipped"),
        "grid_skipped": report.as_ref().and_then(|r| r.pointer("/grid/skipped")).cloned().unwrap_or(Value::Null),
        "report_found": report.is_some(),
    });
    if per_cell {
        out["cells"] = cells(dataset)?;
        out["elements"] = json!(dataset.elements()?);
    }
    Ok(out)
}

fn cells(dataset: &Dataset) -> Result<Value, StoreError> {
    let ranges = dataset.source_ranges()?.unwrap_or_default();
    let list = dataset.index().cells.iter().enumerate().map(|(k, c)| {
        let ranges = ranges
            .get(k)
            .map(|list| list.iter().map(|r| [r.node, r.mesh, r.primitive, r.first, r.count]).collect::<Vec<_>>());
        json!({ "cell": k, "bounds": bounds(&c.bounds), "triangles": c.triangles, "ranges": ranges })
    });
    Ok(list.collect())
}

/// Rooms and what each takes; the outside comes last.
fn rooms(index: &Index, r: &RoomIndex) -> Value {
    let name = |k: usize| r.rooms.cells().get(k).map_or("outside", |c| c.name.as_str());
    let of_room = |(k, cells): (usize, &Vec<u32>)| {
        let triangles: u64 = cells.iter().map(|c| u64::from(index.cells[*c as usize].triangles)).sum();
        let id = (k < r.rooms.cells().len()).then_some(k as u32);
        json!({ "name": name(k), "cells": cells.len(), "triangles": triangles, "portals": r.rooms.portals_of(id).len() })
    };
    let placements: usize = r.placements.iter().flatten().map(|p| p.len()).sum();
    json!({
        "portals": r.rooms.portals().len(),
        "placements": placements,
        "images": r.built,
        "references": r.sides.iter().flatten().map(|s| s.references.len()).sum::<usize>(),
        "layered": r.sides.iter().flatten().filter(|s| s.layered.is_some()).count(),
        "margin_m": r.rooms.margin_m(),
        "list": r.cells_of.iter().enumerate().map(of_room).collect::<Vec<_>>(),
    })
}

fn bounds(b: &Aabb) -> Value {
    json!({ "min": b.min.to_array(), "max": b.max.to_array() })
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len();
    if n == 0 { 0.0 } else { values.sum::<f64>() / n as f64 }
}

/// Number, stored and decoded bytes of the chunks of a kind.
fn kind_sizes(dataset: &Dataset, kind: ChunkKind) -> (u64, u64, u64) {
    let of_kind = dataset.index().chunks.iter().filter(|c| c.kind == kind);
    of_kind.fold((0, 0, 0), |(n, s, d), c| (n + 1, s + u64::from(c.stored_bytes), d + u64::from(c.decoded_bytes)))
}

fn kind_json((count, stored, decoded): (u64, u64, u64)) -> Value {
    json!({ "count": count, "stored_bytes": stored, "decoded_bytes": decoded })
}

fn samples_by_layer(dataset: &Dataset) -> Vec<u64> {
    let mut sums: Vec<u64> = Vec::new();
    for i in &dataset.index().images {
        sums.resize(sums.len().max(i.samples_by_layer.len()), 0);
        sums.iter_mut().zip(&i.samples_by_layer).for_each(|(sum, n)| *sum += u64::from(*n));
    }
    sums
}

/// The same for people, from the value that [`inspect`] gives.
pub fn inspect_text(value: &Value) -> String {
    let at = |path: &str| value.pointer(path).cloned().unwrap_or(Value::Null);
    let number = |path: &str| at(path).as_u64().unwrap_or(0);
    let mut out = String::new();
    let mut line = |label: &str, text: String| out.push_str(&format!("{label:<12} {text}\n"));
    let words = |v: Value| v.as_str().map_or_else(|| v.to_string(), str::to_owned);
    line("dataset", words(at("/dataset")));
    line("hash", words(at("/hash")));
    line(
        "scene",
        format!(
            "{}: {} triangles ({} unique), {} instances",
            words(at("/scene/name")),
            number("/scene/triangles"),
            number("/scene/unique_triangles"),
            number("/scene/instances")
        ),
    );
    line(
        "built for",
        format!(
            "budget {}, {}x{} at {} degrees, footprint {} px, density {}, colour {}, pitch {} degrees",
            number("/settings/budget"),
            number("/settings/camera/width"),
            number("/settings/camera/height"),
            at("/settings/camera/fov_deg"),
            at("/settings/max_footprint_px"),
            at("/settings/density"),
            words(at("/settings/colour")),
            at("/settings/pitch_deg"),
        ),
    );
    line("cells", format!("{} with {} triangles", number("/cell_count"), number("/cell_triangles")));
    if let Some(list) = at("/rooms/list").as_array() {
        let largest = list.iter().filter(|r| r["name"] != "outside").filter_map(|r| r["triangles"].as_u64()).max();
        line(
            "rooms",
            format!(
                "{} and the outside, {} portals with {} placements, {} reference images and {} merged ones, at most {} triangles in a room",
                list.len().saturating_sub(1),
                number("/rooms/portals"),
                number("/rooms/placements"),
                number("/rooms/references"),
                number("/rooms/layered"),
                largest.unwrap_or(0)
            ),
        );
    }
    line("materials", format!("{}, {} textures", number("/materials"), number("/textures")));
    line("grid points", format!("{}, by level {}", number("/grid/points"), at("/grid/by_level")));
    line(
        "placements",
        format!(
            "{} with {} images ({} empty), largest footprint {} px",
            number("/placements/count"),
            number("/placements/images"),
            number("/placements/empty_images"),
            at("/placements/max_footprint_px").as_f64().map_or("-".into(), |px| format!("{px:.2}"))
        ),
    );
    line(
        "samples",
        format!(
            "{}, by layer {}, {} bytes each",
            number("/samples/total"),
            at("/samples/by_layer"),
            at("/samples/bytes_per_sample").as_f64().map_or("-".into(), |b| format!("{b:.2}"))
        ),
    );
    for kind in ["cell", "bundle", "levels", "texture", "tree", "ldi"] {
        let n = |field: &str| number(&format!("/chunks/{kind}/{field}"));
        line(
            kind,
            format!("{} chunks, {} stored, {} decoded", n("count"), size(n("stored_bytes")), size(n("decoded_bytes"))),
        );
    }
    line(
        "manifest",
        format!("root {}, pages {}", size(number("/bytes/manifest_root")), size(number("/bytes/manifest_pages"))),
    );
    line("total", size(number("/bytes/total")));
    for skipped in at("/skipped").as_array().into_iter().flatten() {
        let field = |key: &str| skipped.get(key).and_then(Value::as_str).unwrap_or("?").to_owned();
        line("skipped", format!("{}: {}", field("what"), field("why")));
    }
    if at("/report_found") == Value::Bool(false) {
        line("skipped", "unknown: report.json is missing or damaged".into());
    }
    out
}

fn size(bytes: u64) -> String {
    match bytes {
        0..10_000 => format!("{bytes} B"),
        10_000..10_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        _ => format!("{:.1} MB", bytes as f64 / 1e6),
    }
}
