//! `house`: one furnished storey with 19 cells and 52 portals, after the model of Rafferty et al.
//! 1998 (Brooks House).
//!
//! Five by four rooms of 5 m by 4.5 m, two of them merged into a living room. Doors in the middle
//! of every inner wall, windows in every outer one (two in the corner rooms' long walls): 30 + 22
//! = 52 openings. Furniture stands in the corners, so that the lines between doors stay free.

use super::Builtin;
use super::draw::{Draft, Shape};
use super::paint::Pattern;
use super::random::Random;
use crate::scene::{PortalAnnotation, RoomAnnotation};
use glam::DVec3;
use ldi_protocol::Aabb;

const COLUMNS: usize = 5;
const ROWS: usize = 4;
const ROOM: DVec3 = DVec3::new(5.0, 2.8, 4.5);
const WALL: f64 = 0.2;
const DOOR: (f64, f64) = (1.1, 2.1);
/// Window: width, sill height, top.
const WINDOW: (f64, f64, f64) = (1.2, 0.9, 2.2);
const OUTSIDE: &str = "outside";

/// Builds the house with furniture of this detail.
pub fn build(detail: u32, seed: u64) -> Builtin {
    let mut draft = Draft::default();
    let mut random = Random::new(seed, 2);
    shell(&mut draft, &mut random);
    furnish(&mut draft, &mut random, detail);
    // A serpentine through the rooms' middles, by the doors.
    let mut waypoints = Vec::new();
    for r in 0..ROWS {
        for c in 0..COLUMNS {
            let c = if r.is_multiple_of(2) { c } else { COLUMNS - 1 - c };
            waypoints.push(middle(c, r) + DVec3::Y * 1.6);
        }
    }
    Builtin { scene: draft.scene, waypoints }
}

/// Floor point in the middle of a room of the raster.
fn middle(column: usize, row: usize) -> DVec3 {
    DVec3::new(
        (column as f64 + 0.5 - COLUMNS as f64 * 0.5) * ROOM.x,
        0.0,
        (row as f64 + 0.5 - ROWS as f64 * 0.5) * ROOM.z,
    )
}

/// The living room takes two places of the raster.
fn name(column: usize, row: usize) -> String {
    if row == 1 && (column == 1 || column == 2) {
        "living".into()
    } else {
        format!("room {}{}", (b'A' + column as u8) as char, row + 1)
    }
}

fn shell(draft: &mut Draft, random: &mut Random) {
    for r in 0..ROWS {
        for c in 0..COLUMNS {
            let half = DVec3::new(ROOM.x, 0.0, ROOM.z) * 0.5;
            let bounds = Aabb { min: middle(c, r) - half, max: middle(c, r) + half + DVec3::Y * ROOM.y };
            match draft.scene.rooms.iter_mut().find(|room| room.name == name(c, r)) {
                Some(room) => room.bounds = room.bounds.union(bounds),
                None => draft.scene.rooms.push(RoomAnnotation { name: name(c, r), bounds }),
            }
            let floor = [Pattern::Wood, Pattern::Tile, Pattern::Cloth][random.below(3)];
            let tone = random.within(0.6, 1.0) as f32;
            let floor = draft.paint(floor, [tone, tone, tone]);
            let ceiling = draft.paint(Pattern::Plaster, [0.95, 0.95, 0.93]);
            let m = draft.mesh(
                "floor and ceiling",
                [
                    Shape::new(floor).rect(bounds.min, DVec3::Z * ROOM.z, DVec3::X * ROOM.x),
                    Shape::new(ceiling).rect(bounds.min + DVec3::Y * ROOM.y, DVec3::X * ROOM.x, DVec3::Z * ROOM.z),
                ],
            );
            draft.place(m, DVec3::ZERO, 0.0, 1.0);
        }
    }
    // Walls on the raster's lines: `along` the wall, `across` from room a to room b.
    for r in 0..ROWS {
        for line in 0..=COLUMNS {
            let at = |c: usize| (c < COLUMNS).then(|| name(c, r));
            let (a, b) = (line.checked_sub(1).and_then(at), at(line));
            let centre = middle(0, r) + DVec3::X * ((line as f64 - 0.5) * ROOM.x);
            wall(draft, random, centre, DVec3::Z, ROOM.z, a, b, false);
        }
    }
    for c in 0..COLUMNS {
        for line in 0..=ROWS {
            let at = |r: usize| (r < ROWS).then(|| name(c, r));
            let (a, b) = (line.checked_sub(1).and_then(at), at(line));
            let centre = middle(c, 0) + DVec3::Z * ((line as f64 - 0.5) * ROOM.z);
            let corner = c == 0 || c == COLUMNS - 1;
            wall(draft, random, centre, DVec3::X, ROOM.x, a, b, corner);
        }
    }
    let grass = draft.paint(Pattern::Grass, [0.9, 1.0, 0.8]);
    let size = DVec3::new(60.0, 0.0, 60.0);
    let garden = draft
        .mesh("garden", [Shape::new(grass).rect(size * -0.5 - DVec3::Y * 0.05, DVec3::Z * size.z, DVec3::X * size.x)]);
    draft.place(garden, DVec3::ZERO, 0.0, 1.0);
}

/// A wall with its openings: a door where both sides are rooms, windows to the outside, nothing
/// inside one room.
#[expect(clippy::too_many_arguments, reason = "a wall is just these eight things, and the call sites read as a plan")]
fn wall(
    draft: &mut Draft,
    random: &mut Random,
    centre: DVec3,
    along: DVec3,
    length: f64,
    a: Option<String>,
    b: Option<String>,
    two_windows: bool,
) {
    if a == b {
        return;
    }
    let outer = a.is_none() || b.is_none();
    let openings: Vec<(f64, f64, f64, f64)> = if !outer {
        vec![(0.0, DOOR.0, 0.0, DOOR.1)]
    } else if two_windows {
        vec![(-1.1, WINDOW.0, WINDOW.1, WINDOW.2), (1.1, WINDOW.0, WINDOW.1, WINDOW.2)]
    } else {
        vec![(0.0, WINDOW.0, WINDOW.1, WINDOW.2)]
    };
    let tint = [random.within(0.55, 1.0) as f32, random.within(0.55, 1.0) as f32, random.within(0.5, 0.95) as f32];
    let paint = draft.paint(if outer { Pattern::Brick } else { Pattern::Plaster }, tint);
    let across = DVec3::new(along.z, 0.0, along.x) * (WALL * 0.5);
    let mut shape = Shape::new(paint);
    let mut block = |from: f64, to: f64, low: f64, high: f64| {
        if to - from > 1e-6 && high - low > 1e-6 {
            let (p, q) =
                (centre + along * from - across + DVec3::Y * low, centre + along * to + across + DVec3::Y * high);
            shape = std::mem::take(&mut shape).cuboid(p.min(q), p.max(q));
        }
    };
    let mut from = -length * 0.5;
    for (at, width, low, high) in &openings {
        block(from, at - width * 0.5, 0.0, ROOM.y);
        block(at - width * 0.5, at + width * 0.5, 0.0, *low);
        block(at - width * 0.5, at + width * 0.5, *high, ROOM.y);
        from = at + width * 0.5;
    }
    block(from, length * 0.5, 0.0, ROOM.y);
    let m = draft.mesh("wall", [shape]);
    draft.place(m, DVec3::ZERO, 0.0, 1.0);
    for (at, width, low, high) in openings {
        let corner = |s: f64, y: f64| centre + along * (at + s * width * 0.5) + DVec3::Y * y;
        let side = |r: &Option<String>| r.clone().unwrap_or_else(|| OUTSIDE.into());
        draft.scene.portals.push(PortalAnnotation {
            rooms: [side(&a), side(&b)],
            corners: vec![corner(-1.0, low), corner(1.0, low), corner(1.0, high), corner(-1.0, high)],
        });
    }
}

fn furnish(draft: &mut Draft, random: &mut Random, detail: u32) {
    let pieces = pieces(draft, random, detail);
    for r in 0..ROWS {
        for c in 0..COLUMNS {
            for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                let jitter = DVec3::new(random.within(-0.1, 0.1), 0.0, random.within(-0.1, 0.1));
                let corner = middle(c, r) + DVec3::new(sx * 1.6, 0.0, sz * 1.4) + jitter;
                let turn = 90.0 * random.below(4) as f64 + random.within(-8.0, 8.0);
                draft.place(pieces[random.below(pieces.len())], corner, turn, random.within(0.9, 1.05));
            }
        }
    }
}

/// Tables laid with bowls, vases on stands, lamps, beds, shelves and plants; within 0.65 m of
/// their centre.
fn pieces(draft: &mut Draft, random: &mut Random, detail: u32) -> Vec<u32> {
    let (around, along) = (6 + detail, 1 + detail / 3);
    let mut pieces = Vec::new();
    for _ in 0..3 {
        let wood = draft.paint(
            Pattern::Wood,
            [random.within(0.4, 1.0) as f32, random.within(0.4, 0.9) as f32, random.within(0.3, 0.8) as f32],
        );
        let clay = draft.paint(
            Pattern::Plaster,
            [random.within(0.2, 0.9) as f32, random.within(0.2, 0.8) as f32, random.within(0.2, 0.9) as f32],
        );
        let cloth = draft.paint(
            Pattern::Cloth,
            [random.within(0.3, 1.0) as f32, random.within(0.2, 0.8) as f32, random.within(0.3, 0.9) as f32],
        );
        let leaf = draft.paint(Pattern::Leaf, [1.0; 3]);
        let box_at =
            |s: Shape, x: f64, y: f64, z: f64, h: DVec3| s.cuboid(DVec3::new(x, y, z) - h, DVec3::new(x, y, z) + h);
        let at = |p: DVec3| glam::DAffine3::from_translation(p);
        // Table with bowls.
        let mut table = box_at(Shape::new(wood), 0.0, 0.73, 0.0, DVec3::new(0.6, 0.02, 0.45));
        for (x, z) in [(-0.55, -0.4), (0.55, -0.4), (0.55, 0.4), (-0.55, 0.4)] {
            table = table.with(
                Shape::new(wood)
                    .lathe(&[(0.03, 0.0), (0.04, 0.4), (0.025, 0.71)], around / 2 + 3, along / 2 + 1, true)
                    .moved(at(DVec3::new(x, 0.0, z))),
            );
        }
        let mut bowls = Shape::new(clay);
        for k in 0..3 {
            let place = DVec3::new(-0.35 + 0.35 * f64::from(k), 0.75, random.within(-0.2, 0.2));
            bowls = bowls.with(
                Shape::new(clay)
                    .lathe(
                        &[(0.0, 0.0), (0.06, 0.0), (0.12, 0.07), (0.11, 0.07), (0.05, 0.02), (0.0, 0.02)],
                        around,
                        along,
                        true,
                    )
                    .moved(at(place)),
            );
        }
        pieces.push(draft.mesh("table", [table, bowls]));
        // Vase on a stand.
        let stand = box_at(Shape::new(wood), 0.0, 0.35, 0.0, DVec3::new(0.2, 0.35, 0.2));
        let vase = Shape::new(clay).lathe(
            &[(0.0, 0.7), (0.1, 0.7), (0.19, 0.9), (0.08, 1.15), (0.12, 1.25), (0.1, 1.25), (0.06, 1.15), (0.0, 0.9)],
            around,
            along,
            true,
        );
        pieces.push(draft.mesh("vase", [stand, vase]));
        // Lamp.
        let foot = Shape::new(wood).lathe(
            &[(0.0, 0.0), (0.16, 0.0), (0.16, 0.03), (0.015, 0.05), (0.015, 1.3)],
            around,
            along,
            false,
        );
        let shade = Shape::new(cloth).lathe(&[(0.24, 1.25), (0.14, 1.6), (0.0, 1.6)], around, along, false);
        pieces.push(draft.mesh("lamp", [foot, shade]));
        // Bed with cushions.
        let frame = box_at(Shape::new(wood), 0.0, 0.15, 0.0, DVec3::new(0.5, 0.15, 0.65));
        let bedding = box_at(Shape::new(cloth), 0.0, 0.4, 0.0, DVec3::new(0.48, 0.1, 0.62))
            .with(Shape::new(cloth).ball(DVec3::new(-0.2, 0.55, -0.4), 0.14, around, along * 3))
            .with(Shape::new(cloth).ball(DVec3::new(0.2, 0.55, -0.4), 0.14, around, along * 3));
        pieces.push(draft.mesh("bed", [frame, bedding]));
        // Shelf with books and jars.
        let mut shelf = Shape::new(wood);
        for k in 0..4 {
            shelf = box_at(shelf, 0.0, 0.05 + 0.45 * f64::from(k), 0.0, DVec3::new(0.5, 0.015, 0.16));
        }
        shelf = box_at(
            box_at(shelf, -0.5, 0.72, 0.0, DVec3::new(0.015, 0.7, 0.16)),
            0.5,
            0.72,
            0.0,
            DVec3::new(0.015, 0.7, 0.16),
        );
        let (mut books, mut jars) = (Shape::new(cloth), Shape::new(clay));
        for k in 0..3 {
            let y = 0.065 + 0.45 * f64::from(k);
            for b in 0..8 {
                let h = random.within(0.1, 0.17);
                books = box_at(books, -0.42 + 0.055 * f64::from(b), y + h, 0.0, DVec3::new(0.02, h, 0.1));
            }
            jars = jars.with(
                Shape::new(clay)
                    .lathe(&[(0.0, 0.0), (0.09, 0.0), (0.11, 0.15), (0.05, 0.25), (0.0, 0.26)], around, along, true)
                    .moved(at(DVec3::new(0.3, y, 0.0))),
            );
        }
        pieces.push(draft.mesh("shelf", [shelf, books, jars]));
        // Plant in a pot: alpha-tested leaves.
        let pot = Shape::new(clay).lathe(
            &[(0.0, 0.0), (0.12, 0.0), (0.18, 0.3), (0.15, 0.3), (0.14, 0.25), (0.0, 0.25)],
            around,
            along,
            false,
        );
        let mut leaves = Shape::new(leaf);
        for _ in 0..(20 + 2 * detail * detail / 5) {
            let p = DVec3::new(random.within(-0.3, 0.3), random.within(0.35, 1.2), random.within(-0.3, 0.3));
            let turn =
                glam::DQuat::from_euler(glam::EulerRot::YXZ, random.within(0.0, 6.3), random.within(-0.9, 0.9), 0.0);
            leaves = leaves.rect(p, turn * DVec3::X * 0.14, turn * DVec3::Y * 0.14);
        }
        pieces.push(draft.mesh("plant", [pot, leaves]));
    }
    pieces
}
