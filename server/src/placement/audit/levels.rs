//! The audit of deviations: stored levels of detail against the stored cells in full.
//!
//! In: the index and decoded chunks. Out: [`LevelAudit`]. Points are drawn at random over both
//! surfaces, by area; the distance of each from the other surface is at most what the index says
//! of the level. Nothing that the build computed is used but that number.

use super::Random;
use crate::levels::SurfaceTree;
use glam::DVec3;
use ldi_protocol::{
    index::{DrawnCell, Index},
    mesh::{CellGeometry, ClusterRef},
};
use rayon::prelude::*;
use serde::Serialize;
use std::{borrow::Cow, collections::BTreeMap};

/// Points of each surface at which a level is looked at.
const POINTS_PER_SIDE: u64 = 50;
/// Positions of what is in full are rounded as well, and so are numbers.
const SLACK_M: f64 = 3e-4;
/// The same, as a share of how far coordinates are from zero.
const SLACK_SHARE: f64 = 1e-6;

/// What the audit of deviations found.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct LevelAudit {
    /// Levels looked at.
    pub levels: u64,
    /// Points looked at.
    pub points: u64,
    /// Levels that lie farther from the cell in full, or it from them, than the index says.
    pub violations: u64,
    /// The largest share of a level's deviation that was found.
    pub largest_share: f64,
    /// The first levels that do: cell, level, metres found, metres promised.
    pub worst: Vec<(u32, u8, f64, f64)>,
}

/// World triangles of a cell at a level; None where a chunk is missing.
fn triangles(index: &Index, drawn: DrawnCell, chunk: &dyn Fn(u32) -> Option<CellGeometry>) -> Option<Vec<[DVec3; 3]>> {
    let mesh = index.mesh_of(drawn)?;
    let own = chunk(mesh.chunk)?;
    let bundles: BTreeMap<u32, CellGeometry> =
        mesh.bundles.iter().map(|b| Some((*b, chunk(*b)?))).collect::<Option<_>>()?;
    let range = mesh.instances.map_or(0..own.instances.len(), |r| r.start as usize..r.end as usize);
    let mut out = Vec::new();
    for instance in own.instances.get(range)? {
        let cluster = match instance.cluster {
            ClusterRef::Own(k) => own.clusters.get(k as usize),
            ClusterRef::Shared { chunk, cluster } => bundles.get(&chunk)?.clusters.get(cluster as usize),
        }?;
        let corner = |v: u16| {
            let at = cluster.origin + cluster.positions[usize::from(v)].as_dvec3();
            instance.world_from_mesh.transform_point3(at)
        };
        out.extend(cluster.triangles.iter().map(|t| t.map(corner)));
    }
    Some(out)
}

/// The largest distance of random points of some triangles from others.
fn farthest(from: &[[DVec3; 3]], to: &SurfaceTree, random: &mut Random) -> f64 {
    let mut before = Vec::with_capacity(from.len());
    let mut sum = 0.0;
    for [a, b, c] in from {
        sum += (b - a).cross(c - a).length();
        before.push(sum);
    }
    let mut farthest = 0.0f64;
    for _ in 0..POINTS_PER_SIDE {
        let at = random.unit() * sum;
        let [a, b, c] = from[before.partition_point(|s| *s < at).min(from.len() - 1)];
        let (mut u, mut v) = (random.unit(), random.unit());
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        farthest = farthest.max(to.distance(a * (1.0 - u - v) + b * u + c * v));
    }
    farthest
}

/// Audits about `points` random points of levels of detail. `chunk`: a decoded chunk of geometry.
pub fn audit_levels(
    index: &Index,
    chunk: &(dyn Fn(u32) -> Option<CellGeometry> + Sync),
    points: u64,
    seed: u64,
) -> LevelAudit {
    let all: Vec<DrawnCell> = (0u32..)
        .zip(&index.cells)
        .flat_map(|(cell, c)| (1..=c.levels.len() as u8).map(move |level| DrawnCell { cell, level }))
        .collect();
    let mut random = Random(seed ^ 0x6c62_272e_07bb_0142);
    let wanted = points.div_ceil(2 * POINTS_PER_SIDE);
    let chosen: Cow<'_, [DrawnCell]> = match all.len() as u64 <= wanted {
        true => Cow::Borrowed(&all),
        false => (0..wanted).map(|_| all[random.below(all.len())]).collect(),
    };
    let look = |(number, drawn): (usize, &DrawnCell)| {
        let mut random = Random(seed.wrapping_add(number as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let promised = index.mesh_of(*drawn)?.deviation_m;
        let full = triangles(index, DrawnCell::full(drawn.cell), chunk)?;
        let coarse = triangles(index, *drawn, chunk)?;
        if full.is_empty() || coarse.is_empty() {
            return Some((*drawn, f64::INFINITY, promised, 0.0));
        }
        let there = farthest(&coarse, &SurfaceTree::new(&full), &mut random);
        let back = farthest(&full, &SurfaceTree::new(&coarse), &mut random);
        let slack = SLACK_M + SLACK_SHARE * index.cells[drawn.cell as usize].bounds.max_distance(DVec3::ZERO);
        Some((*drawn, there.max(back), promised, slack))
    };
    let found: Vec<_> = chosen.par_iter().enumerate().filter_map(look).collect();
    let mut audit = LevelAudit::default();
    for (drawn, farthest_m, promised_m, slack_m) in found {
        audit.levels += 1;
        audit.points += 2 * POINTS_PER_SIDE;
        audit.largest_share = audit.largest_share.max(farthest_m / (promised_m + slack_m));
        if farthest_m > promised_m + slack_m {
            audit.violations += 1;
            if audit.worst.len() < super::WORST {
                audit.worst.push((drawn.cell, drawn.level, farthest_m, promised_m));
            }
        }
    }
    audit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::levels::Levels;
    use crate::octree::{Clusters, Octree};
    use crate::placement::test_scenes;
    use crate::scene::builtin;
    use ldi_protocol::{Aabb, codec::cell, index::SceneInfo};

    #[test]
    fn a_level_that_lies_farther_than_it_says_is_found() {
        let scene = builtin::build("plant", Some(60_000), 1).expect("builds").scene;
        let clusters = Clusters::build(&scene);
        let octree = Octree::build(&scene, &clusters, 60_000);
        let levels = Levels::build(&scene, &clusters, &octree);
        let packed = crate::pack::pack_geometry(&scene, &clusters, &octree, &levels, 0).expect("packs");
        let mut index = Index {
            scene: SceneInfo {
                name: String::new(),
                triangles: scene.triangles(),
                unique_triangles: 0,
                instances: 0,
                bounds: Aabb::EMPTY,
            },
            settings: test_scenes::settings(60_000),
            chunks: vec![],
            cells: packed.cells,
            materials: vec![],
            textures: vec![],
            pitch_bands_deg: vec![],
            points: vec![],
            placements: vec![],
            images: vec![],
            volume: None,
            tree: None,
            rooms: None,
            plans: Vec::new(),
        };
        let chunk = |c: u32| cell::decode(&packed.chunks[c as usize].bytes).ok();
        let kept = audit_levels(&index, &chunk, u64::MAX, 1);
        assert_eq!((kept.violations, kept.worst.len()), (0, 0), "{kept:?}");
        assert!(kept.levels > 20 && kept.points >= 2000 && kept.largest_share > 0.3, "{kept:?}");
        let coarsest = |c: &ldi_protocol::index::CellEntry| c.levels.last().map_or(0.0, |l| l.deviation_m);
        let cell =
            (0..index.cells.len()).max_by(|a, b| coarsest(&index.cells[*a]).total_cmp(&coarsest(&index.cells[*b])));
        let level = index.cells[cell.unwrap()].levels.last_mut().unwrap();
        level.deviation_m *= 0.02;
        let broken = audit_levels(&index, &chunk, u64::MAX, 1);
        assert_eq!((broken.violations, broken.worst[0].0 as usize), (1, cell.unwrap()), "{broken:?}");
    }
}
