//! `church`: a nave with fluted columns, vaults, pews and altars, in place of the church of Chang
//! et al. 1999.

use super::Builtin;
use super::draw::{Draft, Shape};
use super::paint::Pattern;
use super::random::Random;
use glam::{DAffine3, DVec3};
use std::f64::consts::{PI, TAU};

const LENGTH: f64 = 48.0;
const WIDTH: f64 = 18.0;
const EAVES: f64 = 9.0;
/// Half distance between the two rows of columns.
const AISLE: f64 = 4.5;
/// Distance between neighbouring columns of a row.
const BAY: f64 = 6.0;

/// Builds the church with this detail.
pub fn build(detail: u32, seed: u64) -> Builtin {
    let mut draft = Draft::default();
    let mut random = Random::new(seed, 5);
    let stone = draft.paint(Pattern::Concrete, [0.95, 0.9, 0.8]);
    let brick = draft.paint(Pattern::Brick, [0.9, 0.85, 0.8]);
    let floor = draft.paint(Pattern::Tile, [0.8, 0.72, 0.65]);
    let wood = draft.paint(Pattern::Wood, [0.55, 0.42, 0.3]);
    let (around, along) = (8 + 2 * detail, 1 + detail / 4);
    let half = DVec3::new(WIDTH * 0.5, 0.0, LENGTH * 0.5);

    let mut walls =
        Shape::new(brick).rect(DVec3::new(-half.x, 0.0, -half.z), DVec3::X * WIDTH, DVec3::Y * (EAVES + 6.0));
    walls = walls.rect(DVec3::new(half.x, 0.0, half.z), DVec3::X * -WIDTH, DVec3::Y * (EAVES + 6.0));
    let bays = (LENGTH / BAY) as i32;
    for k in 0..bays {
        // Each bay's wall leaves a window; coloured glass stands in it.
        let z = -half.z + f64::from(k) * BAY;
        for side in [-1.0, 1.0] {
            let x = side * half.x;
            let mut panel = |z0: f64, z1: f64, y0: f64, y1: f64, paint: Option<u32>| {
                let (a, b) = if side < 0.0 { (z1, z0) } else { (z0, z1) };
                let s = Shape::new(paint.unwrap_or(brick)).rect(
                    DVec3::new(x, y0, a),
                    DVec3::Z * (b - a),
                    DVec3::Y * (y1 - y0),
                );
                if paint.is_some() {
                    let m = draft.mesh("window", [s]);
                    draft.place(m, DVec3::ZERO, 0.0, 1.0);
                } else {
                    walls = std::mem::take(&mut walls).with(s);
                }
            };
            panel(z, z + 2.2, 0.0, EAVES, None);
            panel(z + 3.8, z + BAY, 0.0, EAVES, None);
            panel(z + 2.2, z + 3.8, 0.0, 2.5, None);
            panel(z + 2.2, z + 3.8, 7.5, EAVES, None);
        }
    }
    let mut glass = Vec::new();
    for _ in 0..6 {
        glass.push(draft.paint(
            Pattern::Tile,
            [random.within(0.2, 1.0) as f32, random.within(0.2, 0.9) as f32, random.within(0.3, 1.0) as f32],
        ));
    }
    for k in 0..bays {
        for side in [-1.0, 1.0] {
            let z = -half.z + f64::from(k) * BAY;
            let (a, b) = if side < 0.0 { (z + 3.8, z + 2.2) } else { (z + 2.2, z + 3.8) };
            let pane = Shape::new(glass[random.below(glass.len())]).rect(
                DVec3::new(side * half.x, 2.5, a),
                DVec3::Z * (b - a),
                DVec3::Y * 5.0,
            );
            let m = draft.mesh("window", [pane]);
            draft.place(m, DVec3::ZERO, 0.0, 1.0);
        }
    }
    let ground = Shape::new(floor).rect(DVec3::new(-half.x, 0.0, -half.z), DVec3::Z * LENGTH, DVec3::X * WIDTH);
    // The vault: a barrel with ribs, seen from below.
    let vault = Shape::new(stone).patch(8 + detail, 12 * along, |u, v| {
        let (s, c) = (PI * u).sin_cos();
        let z = -half.z + v * LENGTH;
        let rib = 0.25 * (TAU * z / BAY).cos().max(0.0).powi(8);
        (DVec3::new(half.x * c, EAVES + (6.0 - rib) * s, z), DVec3::new(-c, -s, 0.0), (u * 28.0, v * LENGTH))
    });
    let shell = draft.mesh("shell", [walls, ground, vault]);
    draft.place(shell, DVec3::ZERO, 0.0, 1.0);

    // A fluted column with base and capital.
    let shaft = Shape::new(stone).patch(around * 2, 2 * along, |u, v| {
        let angle = -u * TAU;
        let flute = 0.03 * (12.0 * angle).cos();
        let r = 0.42 - 0.06 * v + flute;
        let (s, c) = angle.sin_cos();
        let slope = 0.36 * (12.0 * angle).sin();
        (
            DVec3::new(r * c, 0.5 + 7.3 * v, r * s),
            DVec3::new(c * r - s * slope, 0.0, s * r + c * slope),
            (u * 3.0, v * 7.3),
        )
    });
    let ends = Shape::new(stone)
        .lathe(&[(0.0, 0.0), (0.7, 0.0), (0.7, 0.2), (0.5, 0.35), (0.55, 0.45), (0.45, 0.5)], around, along, true)
        .with(Shape::new(stone).lathe(
            &[(0.4, 7.8), (0.55, 8.1), (0.75, 8.4), (0.8, 8.6), (0.0, 8.6)],
            around,
            along,
            true,
        ));
    let column = draft.mesh("column", [shaft, ends]);
    for k in 1..bays {
        for side in [-1.0, 1.0] {
            draft.place(
                column,
                DVec3::new(side * AISLE, 0.0, -half.z + f64::from(k) * BAY),
                random.within(0.0, 30.0),
                1.0,
            );
        }
    }
    let seat = |s: Shape, min: [f64; 3], max: [f64; 3]| s.cuboid(DVec3::from_array(min), DVec3::from_array(max));
    let mut pew = seat(Shape::new(wood), [-1.4, 0.42, -0.2], [1.4, 0.47, 0.25]);
    pew = seat(pew, [-1.4, 0.45, 0.25], [1.4, 0.95, 0.29]);
    pew = seat(seat(pew, [-1.45, 0.0, -0.25], [-1.4, 0.95, 0.3]), [1.4, 0.0, -0.25], [1.45, 0.95, 0.3]);
    for k in 0..5 {
        let knob = Shape::new(wood).ball(DVec3::new(-1.42 + 0.71 * f64::from(k), 1.0, 0.27), 0.05, around, along * 2);
        pew = pew.with(knob);
    }
    let pew = draft.mesh("pew", [pew]);
    for row in 0..14 {
        for side in [-1.0, 1.0] {
            draft.place(pew, DVec3::new(side * 2.4, 0.0, 14.0 - 1.6 * f64::from(row)), random.within(-1.5, 1.5), 1.0);
        }
    }
    altars(&mut draft, &mut random, stone, around, along);
    let eye = |x: f64, z: f64| DVec3::new(x, 1.6, z);
    let waypoints = vec![
        eye(0.0, 21.0),
        eye(0.0, -14.0),
        eye(6.8, -14.0),
        eye(6.8, 18.0),
        eye(0.0, 19.0),
        eye(-6.8, 18.0),
        eye(-6.8, -14.0),
        eye(0.0, -16.0),
    ];
    Builtin { scene: draft.scene, waypoints }
}

fn altars(draft: &mut Draft, random: &mut Random, stone: u32, around: u32, along: u32) {
    let gold = draft.paint(Pattern::Metal, [0.95, 0.75, 0.3]);
    let cloth = draft.paint(Pattern::Cloth, [0.8, 0.15, 0.2]);
    let table = Shape::new(stone).cuboid(DVec3::new(-1.5, 0.0, -0.5), DVec3::new(1.5, 1.0, 0.5));
    let cover = Shape::new(cloth).cuboid(DVec3::new(-0.6, 1.0, -0.51), DVec3::new(0.6, 1.02, 0.51));
    let mut light = Shape::new(gold);
    for k in 0..6 {
        let at = DAffine3::from_translation(DVec3::new(-1.25 + 0.5 * f64::from(k), 1.0, -0.3));
        light = light.with(
            Shape::new(gold)
                .lathe(
                    &[
                        (0.0, 0.0),
                        (0.1, 0.0),
                        (0.03, 0.06),
                        (0.02, 0.3),
                        (0.05, 0.33),
                        (0.015, 0.36),
                        (0.015, 0.6),
                        (0.0, 0.62),
                    ],
                    around,
                    along,
                    true,
                )
                .moved(at),
        );
    }
    light = light.with(Shape::new(gold).ball(DVec3::new(0.0, 2.2, -0.4), 0.35, around * 2, along * 6));
    let altar = draft.mesh("altar", [table, cover, light]);
    for (x, z, turn) in [(0.0, -20.0, 0.0), (-7.5, -19.0, 20.0), (7.5, -19.0, -20.0)] {
        draft.place(altar, DVec3::new(x, 0.0, z), turn + random.within(-3.0, 3.0), 1.0);
    }
}
