//! Levels of cells from the chains of their parts.
//!
//! A level is a threshold: every part is drawn by the coarsest mesh of its chain whose deviation,
//! in the world, is at most that. Thresholds are chosen so that each level has clearly fewer
//! triangles than the one before.

use super::{Level, Levels, Piece, largest_stretch, parts::Parts, position_steps_log2, simplify};
use crate::octree::{Clusters, up_to_f32};
use crate::scene::Scene;
use ldi_protocol::{Aabb, index::MOST_LEVELS, mesh::MAX_CLUSTER_TRIANGLES};
use rayon::prelude::*;
use simplify::Coarse;
use std::ops::Range;

/// A level has at most this share of the triangles of the one before. Larger: more levels, of which
/// the one that is drawn is the closer to what may be drawn.
const SHARE: f64 = 0.7;
/// The same of the last one, after which nothing coarser comes.
const LAST_SHARE: f64 = 0.85;
/// And so many fewer. Smaller: entries of levels cost more than they save.
const FEWER: u64 = 24;

/// Joins chains to levels.
pub(super) fn assemble(scene: &Scene, clusters: &Clusters, parts: &Parts, chains: Vec<Vec<Coarse>>) -> Levels {
    let steps = position_steps_log2(scene);
    let of_cell: Vec<Vec<Chosen>> =
        parts.of_cell.par_iter().map(|drawn| thresholds(scene, clusters, parts, &chains, &steps, drawn)).collect();
    // Meshes that some level uses, cut into pieces.
    let mut is_used: Vec<Vec<bool>> = chains.iter().map(|c| vec![false; c.len()]).collect();
    for (drawn, chosen) in parts.of_cell.iter().zip(&of_cell) {
        for level in chosen {
            for ((_, part), k) in drawn.iter().zip(&level.meshes) {
                if let Some(k) = k.checked_sub(1) {
                    is_used[*part as usize][usize::from(k)] = true;
                }
            }
        }
    }
    let mut pieces: Vec<Piece<'static>> = Vec::new();
    let next = |pieces: &Vec<Piece<'_>>| (clusters.clusters.len() + pieces.len()) as u32;
    let mut numbers: Vec<Vec<Range<u32>>> = Vec::with_capacity(chains.len());
    for ((part, chain), is_used) in parts.parts.iter().zip(chains).zip(is_used) {
        let of = chain.into_iter().zip(is_used).map(|(coarse, is_used)| {
            let first = next(&pieces);
            if is_used {
                pieces.extend(cut(scene, (part.mesh, part.primitive), &coarse));
            }
            first..next(&pieces)
        });
        numbers.push(of.collect());
    }
    let with_pieces = |(drawn, chosen): (&Vec<(u32, u32)>, Vec<Chosen>)| -> Vec<Level> {
        let level = |c: Chosen| {
            let mut content = Vec::new();
            for ((instance, part), k) in drawn.iter().zip(&c.meshes) {
                match k.checked_sub(1) {
                    None => content.extend(parts.parts[*part as usize].clusters.iter().map(|c| (*instance, *c))),
                    Some(k) => content.extend(numbers[*part as usize][usize::from(k)].clone().map(|p| (*instance, p))),
                }
            }
            Level { deviation_m: c.deviation_m, triangles: c.triangles, content }
        };
        chosen.into_iter().map(level).collect()
    };
    let cells = parts.of_cell.par_iter().zip(of_cell).map(with_pieces).collect();
    Levels { pieces, cells, position_steps_log2: steps }
}

/// A level before its pieces are known.
struct Chosen {
    deviation_m: f64,
    triangles: u32,
    /// Per part that the cell draws: 0: in full; k: number k - 1 of its chain.
    meshes: Vec<u8>,
}

/// The levels of one cell.
fn thresholds(
    scene: &Scene,
    clusters: &Clusters,
    parts: &Parts,
    chains: &[Vec<Coarse>],
    steps: &[i8],
    drawn: &[(u32, u32)],
) -> Vec<Chosen> {
    // (deviation in the world, part drawn, mesh of its chain, triangles fewer)
    let mut events: Vec<(f64, usize, u8, u64)> = Vec::new();
    let mut triangles = 0u64;
    // Vertices are rounded, whichever level is drawn.
    let mut rounding_m = 0.0f64;
    for (at, (instance, part)) in drawn.iter().enumerate() {
        let scale = largest_stretch(&scene.instances[*instance as usize].world_from_mesh.matrix3);
        let part_entry = &parts.parts[*part as usize];
        let full: u64 = part_entry.clusters.iter().map(|c| clusters.clusters[*c as usize].triangles.len() as u64).sum();
        triangles += full;
        let mut before = full;
        let step = 2f64.powi(steps[part_entry.mesh as usize].into());
        rounding_m = rounding_m.max(0.5 * 3f64.sqrt() * step * scale);
        for (k, coarse) in (1u8..).zip(chains[*part as usize].iter().take(usize::from(u8::MAX) - 1)) {
            let fewer = before.saturating_sub(coarse.triangles.len() as u64);
            before = coarse.triangles.len() as u64;
            events.push((coarse.deviation * scale, at, k, fewer));
        }
    }
    events.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut meshes = vec![0u8; drawn.len()];
    let mut levels: Vec<Chosen> = Vec::new();
    let mut last = triangles;
    for (number, (deviation_m, at, k, fewer)) in events.iter().enumerate() {
        meshes[*at] = *k;
        triangles -= fewer;
        let is_last = number + 1 == events.len();
        let next_is_farther = events.get(number + 1).is_none_or(|next| next.0 > *deviation_m);
        let share = if is_last { LAST_SHARE } else { SHARE };
        let is_worth = triangles as f64 <= share * last as f64 && triangles + FEWER <= last;
        if next_is_farther && is_worth && levels.len() < MOST_LEVELS {
            let deviation_m = up_to_f32(deviation_m + rounding_m);
            if let Ok(count) = u32::try_from(triangles) {
                levels.push(Chosen { deviation_m, triangles: count, meshes: meshes.clone() });
                last = triangles;
            }
        }
    }
    levels
}

/// A simplified mesh as compact pieces: along its longest axis.
fn cut(scene: &Scene, (mesh, primitive): (u32, u32), coarse: &Coarse) -> Vec<Piece<'static>> {
    let p = &scene.meshes[mesh as usize].primitives[primitive as usize];
    let mut order: Vec<u32> = (0..coarse.triangles.len() as u32).collect();
    if order.len() > MAX_CLUSTER_TRIANGLES {
        let centre = |number: &u32| simplify::centre(p, &coarse.triangles[*number as usize]);
        let axis = Aabb::from_points(order.iter().map(centre)).size().max_position();
        order.sort_by(|a, b| centre(a)[axis].total_cmp(&centre(b)[axis]));
    }
    let piece = |of: &[u32]| {
        let turned = (0u32..).zip(of).flat_map(|(new, old)| {
            let first = coarse.turned.partition_point(|(corner, _)| *corner < 3 * old);
            let of_triangle = coarse.turned[first..].iter().take_while(move |(corner, _)| *corner < 3 * old + 3);
            of_triangle.map(move |(corner, normal)| (corner - 3 * old + 3 * new, *normal))
        });
        Piece {
            mesh,
            primitive,
            triangles: of.iter().map(|old| coarse.triangles[*old as usize]).collect(),
            turned: turned.collect(),
        }
    };
    order.chunks(MAX_CLUSTER_TRIANGLES).map(piece).collect()
}
