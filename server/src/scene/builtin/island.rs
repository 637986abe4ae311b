//! `island`: a terrain of 131,072 triangles with 1117 instanced trees of about 36,230 triangles
//! each, after Shade et al. 1996.

use super::Builtin;
use super::draw::{Draft, Shape};
use super::paint::Pattern;
use super::random::Random;
use glam::{DAffine3, DQuat, DVec3};
use std::f64::consts::TAU;

/// Edge of the square terrain, metres.
const SIZE: f64 = 600.0;
/// The paper's number of trees.
const TREES: usize = 1117;
/// Quads along an edge of the paper's terrain: 2 * 256 * 256 = 131,072 triangles.
const CELLS: u32 = 256;

/// Builds the island: trees of this detail. A target below about 1.3 million triangles also takes
/// a coarser terrain.
pub fn build(detail: u32, target: u64, seed: u64) -> Builtin {
    let mut draft = Draft::default();
    let mut random = Random::new(seed, 4);
    let grass = draft.paint(Pattern::Grass, [0.9, 0.95, 0.75]);
    let cells = if target < 1_300_000 { ((target as f64 / 20.0).sqrt() as u32).clamp(8, CELLS) } else { CELLS };
    let terrain = Shape::new(grass).patch(cells, cells, |u, v| {
        let at = |u: f64, v: f64| {
            let (x, z) = ((v - 0.5) * SIZE, (u - 0.5) * SIZE);
            DVec3::new(x, height(x, z), z)
        };
        let e = 1e-4;
        let n = (at(u + e, v) - at(u - e, v)).cross(at(u, v + e) - at(u, v - e));
        (at(u, v), n, (v * SIZE / 4.0, u * SIZE / 4.0))
    });
    let terrain = draft.mesh("terrain", [terrain.shaded(|p| 0.75 + 0.25 * (p.y * 0.4 + p.x * 0.05).sin())]);
    draft.place(terrain, DVec3::ZERO, 0.0, 1.0);
    let kinds: Vec<u32> = (0..3).map(|_| tree(&mut draft, &mut random, detail)).collect();
    let mut placed = 0;
    while placed < TREES {
        let (x, z) = (random.within(-0.5, 0.5) * SIZE, random.within(-0.5, 0.5) * SIZE);
        let y = height(x, z);
        // On dry land, off the track along the circle of the walk.
        if y > 1.0 && ((x * x + z * z).sqrt() - WALK_RADIUS).abs() > 4.0 {
            draft.place(
                kinds[random.below(kinds.len())],
                DVec3::new(x, y - 0.1, z),
                random.within(0.0, 360.0),
                random.within(0.7, 1.3),
            );
            placed += 1;
        }
    }
    let waypoints = (0..=24)
        .map(|k| {
            let (s, c) = (f64::from(k) / 24.0 * TAU).sin_cos();
            let (x, z) = (WALK_RADIUS * c, WALK_RADIUS * s);
            DVec3::new(x, height(x, z) + 1.6, z)
        })
        .collect();
    Builtin { scene: draft.scene, waypoints }
}

const WALK_RADIUS: f64 = 120.0;

/// Height of the terrain: a dome with hills that sinks below 0 at the shore.
fn height(x: f64, z: f64) -> f64 {
    let r = (x * x + z * z).sqrt() / (SIZE * 0.5);
    18.0 * (1.0 - r * r) + 3.0 * (x * 0.021).sin() * (z * 0.017).cos() + 0.8 * (x * 0.09 + z * 0.05).sin()
}

/// A tree: trunk, branches, and leaf cards whose number follows the detail's square.
fn tree(draft: &mut Draft, random: &mut Random, detail: u32) -> u32 {
    let bark = draft.paint(Pattern::Wood, [random.within(0.3, 0.5) as f32, random.within(0.25, 0.35) as f32, 0.2]);
    let leaf = draft.paint(
        Pattern::Leaf,
        [random.within(0.7, 1.0) as f32, random.within(0.8, 1.0) as f32, random.within(0.5, 0.9) as f32],
    );
    let around = 3 + detail / 8;
    let mut wood =
        Shape::new(bark).lathe(&[(0.28, 0.0), (0.2, 1.5), (0.12, 4.0), (0.02, 7.0)], around, 1 + detail / 20, true);
    let mut leaves = Shape::new(leaf);
    let branches = 12 + detail / 4;
    // Chosen so that detail 100 or so gives the paper's 36,230 triangles.
    let cards = (2 + detail * detail * 17 / 10 / branches).max(2);
    for _ in 0..branches {
        let start = DVec3::Y * random.within(1.8, 6.0);
        let turn = DQuat::from_euler(glam::EulerRot::YXZ, random.within(0.0, TAU), random.within(-0.7, 0.1), 0.0);
        let length = random.within(1.2, 2.6) * (1.2 - start.y / 8.0);
        wood = wood.with(
            Shape::new(bark).tube(0.035, length, around, 1).moved(DAffine3::from_rotation_translation(turn, start)),
        );
        for _ in 0..cards {
            let p = start
                + turn * (DVec3::Z * (length * random.within(0.3, 1.1)))
                + DVec3::new(random.within(-0.5, 0.5), random.within(-0.4, 0.4), random.within(-0.5, 0.5));
            let card = DQuat::from_euler(glam::EulerRot::YXZ, random.within(0.0, TAU), random.within(-1.2, 1.2), 0.0);
            leaves = leaves.rect(p, card * DVec3::X * 0.3, card * DVec3::Y * 0.3);
        }
    }
    draft.mesh("tree", [wood, leaves])
}
