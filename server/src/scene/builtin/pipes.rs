//! `pipes`: an array of instanced pipes, the procedural model of Aliaga and Lastra 1999 (their
//! Figure 18).
//!
//! A lattice of 2 m with upright pipes at its nodes and level ones below knee and above head
//! height, so that aisles stay free to walk. Three kinds of pipe in six colours.

use super::Builtin;
use super::draw::{Draft, Shape};
use super::paint::Pattern;
use super::random::Random;
use glam::{DAffine3, DQuat, DVec3};
use std::f64::consts::FRAC_PI_2;

/// Distance between neighbouring nodes of the lattice, metres.
const SPACING: f64 = 2.0;
/// Heights of the level pipes.
const LEVELS: [f64; 4] = [0.25, 2.6, 3.4, 4.2];

/// Builds the array: the target sets how many pipes, the detail how fine each is.
pub fn build(detail: u32, target: u64, seed: u64) -> Builtin {
    // About 20,000 pipes for the paper's million triangles; fewer, and so coarser scenes, for
    // small targets.
    let side = ((target as f64 / 2_600.0).sqrt().round() as i32).clamp(4, 40);
    let mut random = Random::new(seed, 1);
    let mut draft = Draft::default();
    let around = 5 + detail;
    let tints =
        [[0.75, 0.2, 0.15], [0.2, 0.45, 0.75], [0.8, 0.65, 0.2], [0.35, 0.6, 0.35], [0.7, 0.7, 0.72], [0.5, 0.35, 0.6]];
    let mut kinds = Vec::new();
    for tint in tints {
        let metal = draft.paint(Pattern::Metal, tint);
        for (radius, flanges) in [(0.09, 1), (0.14, 2), (0.2, 0)] {
            let mut shape = Shape::new(metal).tube(radius, SPACING, around, 1 + detail / 8);
            for k in 0..flanges {
                let z = SPACING * (0.3 + 0.4 * f64::from(k));
                let turned = DAffine3::from_rotation_translation(DQuat::from_rotation_x(FRAC_PI_2), DVec3::Z * z);
                shape = shape.with(
                    Shape::new(metal)
                        .lathe(
                            &[(radius, 0.0), (radius * 1.5, 0.0), (radius * 1.5, 0.06), (radius, 0.06)],
                            around,
                            1,
                            false,
                        )
                        .moved(turned),
                );
            }
            kinds.push(draft.mesh("pipe", [shape]));
        }
    }
    let floor = draft.paint(Pattern::Concrete, [0.8, 0.8, 0.8]);
    let tile = draft.mesh("floor", [Shape::new(floor).rect(DVec3::ZERO, DVec3::Z * SPACING, DVec3::X * SPACING)]);
    let half = f64::from(side) * SPACING * 0.5;
    let toward_z = DQuat::IDENTITY;
    let toward_x = DQuat::from_rotation_y(FRAC_PI_2);
    let upright = DQuat::from_rotation_x(-FRAC_PI_2);
    for i in 0..side {
        for k in 0..side {
            let node = DVec3::new(f64::from(i) * SPACING - half, 0.0, f64::from(k) * SPACING - half);
            draft.place(tile, node - DVec3::new(SPACING, 0.0, SPACING) * 0.5, 0.0, 1.0);
            let mut pipe = |rotation: DQuat, at: DVec3| {
                let kind = kinds[random.below(kinds.len())];
                draft.place_by(kind, DAffine3::from_rotation_translation(rotation, at));
            };
            for storey in 0..2 {
                pipe(upright, node + DVec3::Y * (f64::from(storey) * SPACING));
            }
            for (l, height) in LEVELS.iter().enumerate() {
                let at = node + DVec3::Y * *height;
                if l % 2 == 0 {
                    pipe(toward_z, at)
                } else {
                    pipe(toward_x, at)
                }
                if l == 0 {
                    pipe(toward_x, at + DVec3::Y * 0.12)
                }
            }
        }
    }
    // A tour through the aisles: out along one, across, back along another.
    let at =
        |i: i32, k: i32| DVec3::new((f64::from(i) + 0.5) * SPACING - half, 1.6, (f64::from(k) + 0.5) * SPACING - half);
    let (a, b) = (side / 4, side - 2 - side / 4);
    Builtin {
        scene: draft.scene,
        waypoints: vec![at(a, 0), at(a, side - 2), at(b, side - 2), at(b, 0), at(side / 2, 0), at(side / 2, side / 2)],
    }
}
