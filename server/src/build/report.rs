//! The report of a build, with the fields that others read.

use super::BuildFigures;
use crate::store::Written;
use ldi_protocol::index::{ChunkKind, ImageEntry, Index};
use serde_json::{Value, json};

/// The report as JSON.
pub fn report_json(f: &BuildFigures, written: &Written) -> Value {
    let index = &f.index;
    let bytes = |kind: ChunkKind| -> u64 {
        index.chunks.iter().filter(|c| c.kind == kind).map(|c| u64::from(c.stored_bytes)).sum()
    };
    let (ldi, textures) = (bytes(ChunkKind::Ldi), bytes(ChunkKind::Texture));
    let tree = bytes(ChunkKind::Tree);
    let levels = bytes(ChunkKind::Levels);
    let geometry = bytes(ChunkKind::Cell) + bytes(ChunkKind::Bundle) + levels;
    let samples: u64 = f.images.samples_by_layer.iter().sum();
    json!({
        "scene": {
            "name": index.scene.name,
            "triangles": index.scene.triangles,
            "unique_triangles": index.scene.unique_triangles,
            "instances": index.scene.instances,
            "bounds": { "min": index.scene.bounds.min.to_array(), "max": index.scene.bounds.max.to_array() },
        },
        "options": index.settings,
        "octree": f.octree,
        "walk": f.walk,
        "grid": {
            "points": index.points.len(),
            "by_level": f.placement.by_level,
            "skipped": f.placement.skipped,
            "spacing_m": f.placement.spacing_m,
            "paper_radius_m": f.placement.paper_radius_m,
            "largest_radius_ratio": f.placement.largest_radius_ratio,
            "rounds": f.placement.rounds,
        },
        "placements": index.placements.len(),
        "ldis": f.images.images,
        "placements_unmade": f.images.unmade,
        "forecast": f.forecast,
        "images_per_grid_point": images_per_grid_point(index, |image| !image.chunks.is_empty()),
        "popt_closeness": {
            "optimize_budget": index.settings.optimize_budget,
            "histogram_percent": f.placement.popt_closeness,
            "within_two_percent": f.placement.within_two_percent,
        },
        "samples": { "total": samples, "by_layer": f.images.samples_by_layer, "pruned": f.images.pruned, "lost": f.images.lost, "slivers": f.images.slivers },
        "bytes": {
            // What lies on the disk: equal chunks are stored once.
            "total": written.total_bytes(),
            "ldi": ldi, "geometry": geometry, "levels": levels, "textures": textures, "tree": tree, "manifest": written.manifest_bytes,
        },
        "tree": f.tree,
        "weighing": f.weighing,
        "room_weighing": f.room_weighing,
        "rooms": f.rooms,
        "budget_choice": f.budget,
        "bytes_per_sample": if samples > 0 { json!(ldi as f64 / samples as f64) } else { Value::Null },
        "guarantee": {
            "budget": index.settings.budget,
            "max_triangles_found": f.audit.max_triangles,
            "poses_checked": f.audit.all_poses(),
            "violations": f.audit.violations,
            "max_footprint_px": f.placement.max_footprint_px,
            "coverage_certified": f.placement.coverage_certified,
            // The certificate covers every pose: a bound on all of them, by so many boxes.
            "max_triangles_certified": f.placement.max_triangles,
            "certified_boxes": f.placement.certified_boxes,
            "stretch_p99_px": largest_stretch(index),
            "stretch_max_px": f.images.stretch_max_px,
            "quantization_error_px": f.images.quantization_error_px,
        },
        "seconds": f.seconds.iter().map(|(k, v)| ((*k).to_string(), json!(v))).collect::<serde_json::Map<_, _>>(),
        "placement_seconds": f.placement.seconds,
        // Wall time while other images share the threads, added up over images: shares are what it
        // tells.
        "image_step_seconds": super::images::STEPS.iter().zip(f.images.step_seconds).collect::<std::collections::BTreeMap<_, _>>(),
        "ldis_per_s": if f.images.seconds > 0.0 { f.images.made as f64 / f.images.seconds } else { 0.0 },
        "rays_per_s": if f.images.seconds > 0.0 { f.images.rays as f64 / f.images.seconds } else { 0.0 },
        "peak_rss_bytes": peak_rss_bytes(),
        "skipped": f.notes,
    })
}

/// How many grid points have 0, 1, 2 ... images that count.
pub fn images_per_grid_point(index: &Index, counts: impl Fn(&ImageEntry) -> bool) -> Vec<u32> {
    let mut histogram = Vec::new();
    for point in &index.points {
        let mut used: Vec<u32> = point.bands.iter().flatten().filter_map(|r| r.placement).collect();
        used.sort_unstable();
        used.dedup();
        let images = used.iter().flat_map(|p| index.images_of(*p)).filter(|(_, i)| counts(i)).count();
        if histogram.len() <= images {
            histogram.resize(images + 1, 0);
        }
        histogram[images] += 1;
    }
    histogram
}

fn largest_stretch(index: &Index) -> Option<f64> {
    index.images.iter().map(|i| i.stretch_p99_px).filter(|s| s.is_finite()).reduce(f64::max)
}

/// Largest resident size of this process so far, bytes; None where the system does not tell.
fn peak_rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.split_whitespace().next()?.parse::<u64>().ok().map(|kb| kb * 1024)
}
