//! How fast a client's cache takes chunks in: verified, decoded and joined, by one thread.
//!
//! In: a dataset. Out: a [`Kind`] for each kind of chunk, by the median of several passes over the
//! same chunks.

use super::speed_error::median;
use anyhow::Result;
use ldi_client::cache::Cache;
use ldi_protocol::{
    index::{ChunkKind, Index},
    tree::TreeNode,
};
use ldi_server::store::Dataset;
use serde::Serialize;
use std::{collections::BTreeMap, fmt::Write as _, path::Path, time::Instant};

/// Chunks of one kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Kind {
    /// `image, first layer`, `image, deeper layers`, `geometry`, `texture` or `tree`.
    pub name: &'static str,
    /// How many were decoded.
    pub chunks: usize,
    /// Their stored bytes.
    pub stored_bytes: u64,
    /// Samples of images or of the tree; 0 of other kinds.
    pub samples: u64,
    /// Seconds for all of them, the median over passes.
    pub seconds: f64,
}

impl Kind {
    /// Stored bytes per second, in millions.
    pub fn mb_per_s(&self) -> f64 {
        self.stored_bytes as f64 * 1e-6 / self.seconds
    }
    /// Samples per second, in millions.
    pub fn msamples_per_s(&self) -> f64 {
        self.samples as f64 * 1e-6 / self.seconds
    }
}

/// Decodes all chunks of a dataset, `passes` times.
///
/// # Errors
/// A dataset that cannot be read or decoded.
pub fn run(dataset: &Path, passes: u32) -> Result<Vec<Kind>> {
    let dataset = Dataset::open(dataset)?;
    let index = dataset.index();
    let parts = parts(index);
    let mut kinds: BTreeMap<&'static str, Kind> = BTreeMap::new();
    for part in &parts {
        let empty = Kind { name: part.kind, chunks: 0, stored_bytes: 0, samples: 0, seconds: 0.0 };
        let kind = kinds.entry(part.kind).or_insert(empty);
        kind.chunks += 1;
        kind.stored_bytes += u64::from(index.chunks[part.chunk as usize].stored_bytes);
        kind.samples += part.samples;
    }
    let mut seconds: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
    for _ in 0..passes {
        let cache = Cache::new(index.clone(), u64::MAX);
        let mut pass: BTreeMap<&'static str, f64> = BTreeMap::new();
        for part in &parts {
            let stored = dataset.chunk(part.chunk)?;
            let begin = Instant::now();
            cache.insert(part.chunk, &stored)?;
            *pass.entry(part.kind).or_default() += begin.elapsed().as_secs_f64();
        }
        pass.into_iter().for_each(|(kind, s)| seconds.entry(kind).or_default().push(s));
    }
    for (kind, of_passes) in seconds {
        kinds.entry(kind).and_modify(|k| k.seconds = median(of_passes));
    }
    Ok(kinds.into_values().collect())
}

/// A chunk to decode.
struct Part {
    chunk: u32,
    kind: &'static str,
    samples: u64,
}

/// All chunks, each after what it is joined to.
fn parts(index: &Index) -> Vec<Part> {
    let mut out = Vec::new();
    for image in &index.images {
        let mut samples = image.samples_by_layer.iter().map(|n| u64::from(*n));
        for (k, &chunk) in image.chunks.iter().enumerate() {
            let (kind, samples) = match k {
                0 => ("image, first layer", samples.next().unwrap_or(0)),
                _ => ("image, deeper layers", samples.by_ref().sum()),
            };
            out.push(Part { chunk, kind, samples });
        }
    }
    if let Some(tree) = &index.tree {
        let mut brood = |chunk: u32, nodes: &[TreeNode]| {
            out.push(Part { chunk, kind: "tree", samples: nodes.iter().map(|n| u64::from(n.samples)).sum() });
        };
        brood(tree.root_chunk, &tree.nodes[..1]);
        for parent in tree.nodes.iter().filter(|n| n.children > 0) {
            let first = parent.first_child as usize;
            brood(parent.chunk, &tree.nodes[first..first + usize::from(parent.children)]);
        }
    }
    for (chunk, entry) in index.chunks.iter().enumerate() {
        let kind = match entry.kind {
            ChunkKind::Cell | ChunkKind::Bundle | ChunkKind::Levels => "geometry",
            ChunkKind::Texture => "texture",
            ChunkKind::Ldi | ChunkKind::Tree | ChunkKind::Page => continue,
        };
        out.push(Part { chunk: chunk as u32, kind, samples: 0 });
    }
    out
}

/// A table for the terminal.
pub fn table(kinds: &[Kind]) -> String {
    let mut out = String::from("| Kind | Chunks | MB | MB/s | M samples/s |\n|---|---|---|---|---|\n");
    for k in kinds {
        let rate = if k.samples > 0 { format!("{:.1}", k.msamples_per_s()) } else { String::new() };
        let (mb, mb_per_s) = (k.stored_bytes as f64 * 1e-6, k.mb_per_s());
        let _ = writeln!(out, "| {} | {} | {mb:.2} | {mb_per_s:.1} | {rate} |", k.name, k.chunks);
    }
    out
}
