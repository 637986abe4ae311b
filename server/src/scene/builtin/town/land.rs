//! The land around the town: streets of cobbles, wooded hills, a castle on one of them.

use super::super::draw::{Draft, Shape};
use super::super::paint::Pattern;
use super::super::random::Random;
use super::Paints;
use super::market::Furniture;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use std::f64::consts::TAU;

/// How far the hills reach beyond the town, metres.
const HILLS: f64 = 460.0;
/// Trees on the hills.
const FOREST: usize = 1200;

/// Where the avenue runs along X, on the west side; it goes on as a street of the town.
const AVENUE_Z: f64 = 26.0;
/// Half the avenue's width, metres.
const AVENUE_HALF: f64 = 5.0;
/// Length of a piece of it, metres.
const PIECE: f64 = 8.0;

/// Height of the land beyond a town of half the edge `edge`.
fn height(x: f64, z: f64, edge: f64) -> f64 {
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let out = ((x.abs().max(z.abs()) - edge) / HILLS).clamp(0.0, 1.0);
    let wave = 0.75 + 0.25 * (x * 0.013).sin() * (z * 0.011).cos() + 0.2 * (x * 0.031 + z * 0.023).sin();
    // The avenue descends evenly.
    let beside = if x < 0.0 { ((z - AVENUE_Z).abs() - AVENUE_HALF).max(0.0) } else { f64::INFINITY };
    let even = smooth((1.0 - beside / 150.0).clamp(0.0, 1.0));
    smooth(out) * 85.0 * (2.2 * wave + (0.85 - 2.2 * wave) * even)
}

/// Adds ground, hills, forest and castle.
pub fn build(draft: &mut Draft, random: &mut Random, paints: &Paints, detail: u32, edge: f64) {
    let cells = (edge / 4.0) as u32;
    let ground = Shape::new(paints.cobble).patch(cells, cells, |u, v| {
        let p = DVec3::new((v - 0.5) * 2.0 * edge, 0.0, (u - 0.5) * 2.0 * edge);
        (p, DVec3::Y, (p.x * 0.5, p.z * 0.5))
    });
    let ground = draft.mesh("streets", [ground]);
    draft.place(ground, DVec3::ZERO, 0.0, 1.0);
    let side = 2.0 * (edge + HILLS);
    let hills = Shape::new(paints.grass).patch(128, 128, |u, v| {
        let at = |u: f64, v: f64| {
            let (x, z) = ((v - 0.5) * side, (u - 0.5) * side);
            let y = height(x, z, edge);
            // Below the streets, so that the two do not coincide.
            DVec3::new(x, y - if x.abs().max(z.abs()) < edge { 0.4 } else { 0.05 }, z)
        };
        let e = 1e-4;
        let n = (at(u + e, v) - at(u - e, v)).cross(at(u, v + e) - at(u, v - e));
        (at(u, v), n, (v * side / 6.0, u * side / 6.0))
    });
    let hills = draft.mesh("hills", [hills.shaded(|p| 0.8 + 0.2 * (p.x * 0.02).sin() * (p.z * 0.027).cos())]);
    draft.place(hills, DVec3::ZERO, 0.0, 1.0);
    let kinds: Vec<u32> = (0..3).map(|_| tree(draft, random, detail)).collect();
    let mut placed = 0;
    while placed < FOREST {
        let (x, z) = (random.within(-0.47, 0.47) * side, random.within(-0.47, 0.47) * side);
        let outside = x.abs().max(z.abs()) > edge + 20.0;
        let castle = (x - edge - 170.0).hypot(z - 26.0) < 45.0;
        // The view from the avenue to the town stays open.
        let view = x < 0.0 && (z - AVENUE_Z).abs() < 20.0 + 0.55 * (x + edge + 260.0).max(0.0);
        if outside && !castle && !view {
            let at = DVec3::new(x, height(x, z, edge) - 0.3, z);
            draft.place(kinds[random.below(3)], at, random.within(0.0, 360.0), random.within(1.0, 2.0));
            placed += 1;
        }
    }
    let castle = castle(draft, paints, detail);
    let (x, z) = (edge + 170.0, 26.0);
    draft.place(castle, DVec3::new(x, height(x, z, edge) - 3.0, z), 0.0, 1.0);
}

/// Adds the avenue down to the town, with low walls, lamps and trees; returns the walk down it.
pub fn avenue(
    draft: &mut Draft,
    paints: &Paints,
    furniture: &Furniture,
    trees: &[u32],
    detail: u32,
    edge: f64,
) -> Vec<DVec3> {
    let floor = |out: f64| height(-edge - out, AVENUE_Z, edge);
    let at = |out: f64, side: f64| DVec3::new(-edge - out, floor(out), AVENUE_Z + side * AVENUE_HALF);
    let piece = avenue_piece(draft, paints, detail);
    for k in 0..36 {
        let near = PIECE * f64::from(k);
        // Sheared along the slope: X points to the town.
        let start = at(near + PIECE, 0.0);
        let along = (at(near, 0.0) - start) / PIECE;
        let map = DAffine3 { matrix3: DMat3::from_cols(along, DVec3::Y, DVec3::Z), translation: start };
        draft.place_by(piece, map);
        for side in [-1.0, 1.0] {
            draft.place(furniture.lamp, at(near + 2.0, side * 0.9) + DVec3::Y * 0.1, 0.0, 1.0);
            draft.place(furniture.bench, at(near + 6.0, side * 0.8) + DVec3::Y * 0.1, 90.0 + 90.0 * side, 1.0);
            let (x, z) = (-edge - near - 4.0, AVENUE_Z + side * (AVENUE_HALF + 4.0));
            let tree = trees[(k % 3) as usize];
            draft.place(tree, DVec3::new(x, height(x, z, edge) - 0.2, z), 50.0 * f64::from(k), 1.0);
        }
    }
    let eye = |out: f64, side: f64| at(out, side) + DVec3::Y * 1.72;
    vec![eye(250.0, -0.3), eye(235.0, 0.3), eye(220.0, -0.2), eye(205.0, 0.1)]
}

/// A level piece of the avenue along X: the road and a low balustrade on either side of it.
fn avenue_piece(draft: &mut Draft, paints: &Paints, detail: u32) -> u32 {
    let around = 8 + detail / 6;
    let road = Shape::new(paints.cobble).patch(4, 4, |u, v| {
        let p = DVec3::new(PIECE * v, 0.12, (2.0 * u - 1.0) * AVENUE_HALF);
        (p, DVec3::Y, (p.x * 0.5, p.z * 0.5))
    });
    let mut wall = Shape::new(paints.stone);
    for z in [-AVENUE_HALF, AVENUE_HALF] {
        let rail = |low: f64, high: f64, half: f64| (DVec3::new(0.0, low, z - half), DVec3::new(PIECE, high, z + half));
        for (low, high) in [rail(-0.6, 0.15, 0.15), rail(0.48, 0.56, 0.18)] {
            wall = wall.cuboid(low, high);
        }
        let profile = [(0.07, 0.15), (0.05, 0.2), (0.085, 0.27), (0.04, 0.4), (0.07, 0.48)];
        for k in 0..32 {
            let foot = DVec3::new(0.125 + 0.25 * f64::from(k), 0.0, z);
            let post = Shape::new(paints.stone).lathe(&profile, around, 1, true);
            wall = wall.with(post.moved(DAffine3::from_translation(foot)));
        }
    }
    draft.mesh("avenue", [road, wall])
}

/// A broad-leaved tree about 7 m high; its leaves are opaque.
pub fn tree(draft: &mut Draft, random: &mut Random, detail: u32) -> u32 {
    let bark = draft.paint(Pattern::Wood, [0.4, 0.32, 0.25]);
    let (red, green) = (random.within(0.55, 0.85) as f32, random.within(0.5, 0.65) as f32);
    let leaf = draft.paint(Pattern::Grass, [red, green, 0.4]);
    draft.scene.materials[leaf as usize].double_sided = true;
    let around = 4 + detail / 16;
    let mut wood =
        Shape::new(bark).lathe(&[(0.3, 0.0), (0.18, 1.2), (0.14, 3.0), (0.02, 6.0)], around, 1 + detail / 32, true);
    let mut leaves = Shape::new(leaf);
    for _ in 0..16 {
        let start = DVec3::Y * random.within(2.0, 4.6);
        let turn = DQuat::from_euler(glam::EulerRot::YXZ, random.within(0.0, TAU), random.within(-0.9, -0.1), 0.0);
        let length = random.within(1.2, 2.4);
        wood = wood.with(
            Shape::new(bark).tube(0.04, length, around, 1).moved(DAffine3::from_rotation_translation(turn, start)),
        );
        let tip = start + turn * (DVec3::Z * length);
        for _ in 0..4 + detail * 5 / 2 {
            // A cluster around the tip of a branch, leaves turned outward.
            let out = DVec3::new(random.within(-1.0, 1.0), random.within(-1.0, 1.0), random.within(-1.0, 1.0));
            let p = tip + out.normalize_or(DVec3::Y) * random.within(0.3, 1.1);
            let card = DQuat::from_euler(glam::EulerRot::YXZ, random.within(0.0, TAU), random.within(-1.2, 1.2), 0.0);
            leaves = leaves.rect(p, card * DVec3::X * 0.24, card * DVec3::Y * 0.16);
        }
    }
    draft.mesh("tree", [wood, leaves])
}

/// Walls with battlements, four towers and a keep.
fn castle(draft: &mut Draft, paints: &Paints, detail: u32) -> u32 {
    let around = 12 + detail / 4;
    let walls = draft.paint(Pattern::Plaster, [0.62, 0.58, 0.5]);
    let (mut stone, mut slate) = (Shape::new(walls), Shape::new(paints.slate));
    let half = 28.0;
    for side in 0..4 {
        let by = DAffine3::from_rotation_y(f64::to_radians(90.0 * f64::from(side)));
        let mut wall = Shape::new(walls).cuboid(DVec3::new(-half, 0.0, half - 1.5), DVec3::new(half, 12.0, half));
        for k in 0..28 {
            let x = -half + 2.0 * f64::from(k);
            wall = wall.cuboid(DVec3::new(x, 12.0, half - 0.6), DVec3::new(x + 1.1, 13.2, half));
        }
        stone = stone.with(wall.moved(by));
        let corner = by * DAffine3::from_translation(DVec3::new(half, 0.0, half));
        let shaft = [(4.2, 0.0), (4.0, 15.0), (4.6, 16.0), (4.6, 18.0), (4.2, 18.0)];
        stone = stone.with(Shape::new(walls).lathe(&shaft, around, 2, false).moved(corner));
        slate = slate.with(
            Shape::new(paints.slate).lathe(&[(4.9, 17.9), (0.1, 26.0), (0.0, 26.1)], around, 2, false).moved(corner),
        );
    }
    stone = stone.cuboid(DVec3::new(-9.0, 0.0, -8.0), DVec3::new(9.0, 26.0, 8.0));
    for k in 0..9 {
        for z in [-8.0, 7.2] {
            let x = -9.0 + 2.1 * f64::from(k);
            stone = stone.cuboid(DVec3::new(x, 26.0, z), DVec3::new(x + 1.1, 27.4, z + 0.8));
        }
    }
    let keep = [(3.4, 26.0), (3.4, 36.0), (3.9, 37.0), (3.9, 38.5)];
    stone = stone.with(Shape::new(walls).lathe(&keep, around, 2, false));
    slate = slate.with(Shape::new(paints.slate).lathe(&[(4.2, 38.4), (0.1, 50.0), (0.0, 50.1)], around, 2, false));
    draft.mesh("castle", [stone, slate])
}
