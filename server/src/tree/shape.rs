//! From layers to nodes and chunks.

use super::{BuiltTree, PINNED_BYTES, TreeFigures, grow::Grown};
use crate::pack::{Chunk, PackError};
use glam::DVec3;
use ldi_protocol::{
    codec,
    index::ChunkKind,
    shade::srgb8_from_linear,
    tree::{Brood, DEPTH_STEPS, NodeSamples, SIDE, Tree, TreeNode, TreeSample},
};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// zstd level of chunks.
const LEVEL: i32 = 9;

/// Samples by cell of one level.
type Cells = BTreeMap<[u16; 3], Vec<TreeSample>>;

/// Makes nodes and chunks.
pub fn shape(grown: Grown, origin: DVec3, edge_m: f64, first_chunk: u32) -> Result<BuiltTree, PackError> {
    let mut levels: Vec<Cells> = grown.layers.into_par_iter().map(cells_of).collect();
    while levels.len() > 1 && levels.last().is_some_and(Cells::is_empty) {
        levels.pop();
    }
    for k in (1..levels.len()).rev() {
        let parents: Vec<[u16; 3]> = levels[k].keys().map(|c| c.map(|v| v / 2)).collect();
        parents.into_iter().for_each(|p| {
            levels[k - 1].entry(p).or_default();
        });
    }
    levels[0].entry([0; 3]).or_default();

    let mut nodes: Vec<TreeNode> = Vec::new();
    // Per chunk, the level of its nodes and the nodes.
    let mut broods: Vec<(u8, Brood)> = Vec::new();
    let add = |level: u8, cell: [u16; 3], cells: &mut Cells, nodes: &mut Vec<TreeNode>| {
        let samples = cells.remove(&cell).unwrap_or_default();
        let unfiltered = samples.iter().filter(|s| !s.filtered).count() as u32;
        let (samples_n, chunk) = (samples.len() as u32, 0);
        nodes.push(TreeNode { level, cell, samples: samples_n, unfiltered, first_child: 0, children: 0, chunk });
        NodeSamples { samples }
    };
    let root = add(0, [0; 3], &mut levels[0], &mut nodes);
    broods.push((0, Brood { nodes: vec![root] }));
    let mut at = 0;
    while at < nodes.len() {
        let TreeNode { level, cell, .. } = nodes[at];
        if let Some(below) = levels.get_mut(usize::from(level) + 1) {
            let octants = (0..8u16).map(|o| std::array::from_fn(|k| 2 * cell[k] + (o >> k & 1)));
            let present: Vec<[u16; 3]> = octants.filter(|c| below.contains_key(c)).collect();
            if !present.is_empty() {
                nodes[at].first_child = nodes.len() as u32;
                nodes[at].children = present.len() as u8;
                nodes[at].chunk = first_chunk + broods.len() as u32;
                let children = present.into_iter().map(|c| add(level + 1, c, below, &mut nodes)).collect();
                broods.push((level + 1, Brood { nodes: children }));
            }
        }
        at += 1;
    }

    let failed = |source| PackError { what: "the LDI tree".into(), source };
    let chunks: Vec<Chunk> = broods
        .par_iter()
        .map(|(_, brood)| {
            let bytes = codec::tree::encode(brood, LEVEL).map_err(failed)?;
            Ok(Chunk { kind: ChunkKind::Tree, bytes, decoded_bytes: brood.decoded_bytes() })
        })
        .collect::<Result<_, PackError>>()?;
    let mut figures = TreeFigures {
        nodes: nodes.len(),
        samples_by_level: vec![0; levels.len()],
        bytes_by_level: vec![0; levels.len()],
        ..TreeFigures::default()
    };
    nodes.iter().for_each(|n| figures.samples_by_level[usize::from(n.level)] += u64::from(n.samples));
    broods.iter().zip(&chunks).for_each(|((level, _), c)| {
        figures.bytes_by_level[usize::from(*level)] += c.bytes.len() as u64;
    });
    for bytes in &figures.bytes_by_level {
        if figures.pinned_levels > 0 && figures.pinned_bytes + bytes > PINNED_BYTES {
            break;
        }
        figures.pinned_bytes += bytes;
        figures.pinned_levels += 1;
    }
    let tree = Tree { origin, edge_m, root_chunk: first_chunk, pinned_levels: figures.pinned_levels, nodes };
    Ok(BuiltTree { tree, chunks, figures })
}

/// The samples of a level's cells, in the order of the format.
fn cells_of(layers: Vec<super::grow::Layer>) -> Cells {
    let mut cells = Cells::new();
    for l in &layers {
        let steps = (l.depth * DEPTH_STEPS as f32).floor().clamp(0.0, (SIDE * DEPTH_STEPS - 1) as f32);
        let slope = l.slope.map(|s| (s * DEPTH_STEPS as f32).round().clamp(-127.0, 127.0) as i8);
        cells.entry(l.pixel.cell()).or_default().push(TreeSample {
            face: l.pixel.face() as u8,
            column: (l.pixel.column() % SIDE) as u8,
            row: (l.pixel.row() % SIDE) as u8,
            covers: l.covers,
            depth: steps as u16,
            slope,
            rgb: l.colour.map(srgb8_from_linear),
            filtered: l.filtered,
        });
    }
    let key = |s: &TreeSample| (s.face, s.row, s.column, s.depth, s.rgb, s.slope, s.covers);
    cells.values_mut().for_each(|samples| samples.sort_unstable_by_key(key));
    cells
}
