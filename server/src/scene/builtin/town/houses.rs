//! Houses of the town: 10 m wide, 9.4 m deep, the front in the plane z = 0 facing +Z.

use super::super::draw::{Draft, Shape};
use super::super::paint::Pattern;
use super::super::random::Random;
use super::{BLOCK, KERB, Paints};
use glam::{DAffine3, DQuat, DVec3};
use std::f64::consts::PI;

/// Width and depth of a house, metres.
const WIDTH: f64 = 10.0;
const DEPTH: f64 = 9.4;
/// Height of the ground floor and of each floor above, metres.
const GROUND: f64 = 3.8;
const FLOOR: f64 = 3.0;

/// What one kind of house looks like.
struct Style {
    floors: u32,
    bays: u32,
    rise: f64,
    shutters: bool,
    balcony: bool,
    shop: bool,
    wall: u32,
    trim: u32,
    roof: u32,
    leaf: u32,
}

/// A house of a kind of its own.
pub fn house(draft: &mut Draft, random: &mut Random, paints: &Paints, detail: u32) -> u32 {
    const WALLS: [[f32; 3]; 7] = [
        [0.86, 0.72, 0.5],
        [0.8, 0.5, 0.38],
        [0.9, 0.86, 0.76],
        [0.62, 0.68, 0.6],
        [0.72, 0.6, 0.6],
        [0.6, 0.66, 0.74],
        [0.9, 0.78, 0.66],
    ];
    const LEAVES: [[f32; 3]; 4] = [[0.2, 0.36, 0.28], [0.36, 0.2, 0.15], [0.22, 0.3, 0.42], [0.5, 0.5, 0.46]];
    let brick = random.below(4) == 0;
    let pattern = if brick { Pattern::Brick } else { Pattern::Plaster };
    let tint = if brick { [0.9; 3] } else { WALLS[random.below(WALLS.len())] };
    let red = random.within(0.75, 1.0) as f32;
    let style = Style {
        floors: 1 + random.below(4) as u32,
        bays: 3 + random.below(2) as u32,
        rise: random.within(3.2, 5.2),
        shutters: random.below(3) > 0,
        balcony: random.below(2) == 0,
        shop: random.below(2) == 0,
        wall: draft.paint(pattern, tint),
        trim: paints.stone,
        roof: draft.paint(Pattern::Plaster, [0.62 * red, 0.3 * red, 0.2 * red]),
        leaf: draft.paint(Pattern::Wood, LEAVES[random.below(LEAVES.len())]),
    };
    let mut parts = Parts {
        wall: Shape::new(style.wall),
        trim: Shape::new(style.trim),
        glass: Shape::new(paints.glass),
        wood: Shape::new(style.leaf),
        iron: Shape::new(paints.iron),
    };
    let top = GROUND + FLOOR * f64::from(style.floors);
    let around = 4 + detail / 12;
    front(&mut parts, &style, detail);
    back(&mut parts, &style, top);
    for side in [-1.0, 1.0] {
        gable(&mut parts, side * WIDTH * 0.5, top, style.rise);
    }
    // A gutter along the eaves, a downpipe, a chimney.
    let gutter = DAffine3::from_rotation_translation(
        DQuat::from_rotation_y(PI * 0.5),
        DVec3::new(-WIDTH * 0.5, top - 0.05, 0.42),
    );
    parts.iron = parts.iron.with(Shape::new(paints.iron).tube(0.07, WIDTH, around, 1).moved(gutter));
    parts.iron = parts.iron.with(
        Shape::new(paints.iron)
            .lathe(&[(0.05, 0.0), (0.05, top)], around, 1, false)
            .moved(DAffine3::from_translation(DVec3::new(WIDTH * 0.5 - 0.12, 0.0, 0.1))),
    );
    let chimney = DVec3::new(random.within(-3.5, 3.5), top + style.rise * 0.4, -DEPTH * 0.5 - random.within(0.5, 1.5));
    let mut stack =
        Shape::new(style.wall).cuboid(chimney, chimney + DVec3::new(0.8, style.rise * 0.6 + 1.0, 0.6)).cuboid(
            chimney + DVec3::new(-0.08, style.rise * 0.6 + 0.85, -0.08),
            chimney + DVec3::new(0.88, style.rise * 0.6 + 1.0, 0.68),
        );
    for pot in [0.2, 0.6] {
        stack = stack.with(
            Shape::new(style.wall)
                .lathe(&[(0.11, 0.0), (0.09, 0.5), (0.12, 0.55)], around, 1, false)
                .moved(DAffine3::from_translation(chimney + DVec3::new(pot, style.rise * 0.6 + 1.0, 0.3))),
        );
    }
    let roof = roof(style.roof, DVec3::new(-WIDTH * 0.5, top, 0.4), WIDTH, DEPTH + 0.8, style.rise, detail);
    draft.mesh("house", [parts.wall, parts.trim, parts.glass, parts.wood, parts.iron, stack, roof])
}

/// The pavement of a block, with a court of grass.
pub fn pavement(draft: &mut Draft, paints: &Paints) -> u32 {
    let half = BLOCK * 0.5 + 2.0;
    let mut slab = Shape::new(paints.stone);
    // Strips of a few metres: what is drawn near is then near.
    for strip in 0..11 {
        let x = -half + 4.0 * f64::from(strip);
        slab = slab.cuboid(DVec3::new(x, -0.05, -half), DVec3::new(x + 4.0, KERB, half));
    }
    let court = Shape::new(paints.grass).rect(DVec3::new(-10.0, KERB + 0.02, -10.0), DVec3::Z * 20.0, DVec3::X * 20.0);
    draft.mesh("pavement", [slab, court])
}

/// A house under construction, by material.
struct Parts {
    wall: Shape,
    trim: Shape,
    glass: Shape,
    wood: Shape,
    iron: Shape,
}

/// Adds a box to a shape in place.
fn add(shape: &mut Shape, min: DVec3, max: DVec3) {
    *shape = std::mem::take(shape).cuboid(min, max);
}

/// Adds a rectangle that faces +Z to a shape in place.
fn face(shape: &mut Shape, min: DVec3, width: f64, height: f64) {
    *shape = std::mem::take(shape).rect(min, DVec3::X * width, DVec3::Y * height);
}

/// The street front: floors of bays, a band between floors, a cornice with dentils.
fn front(parts: &mut Parts, style: &Style, detail: u32) {
    let bay = WIDTH / f64::from(style.bays);
    for floor in 0..=style.floors {
        let (y, height) = if floor == 0 { (0.0, GROUND) } else { (GROUND + FLOOR * f64::from(floor - 1), FLOOR) };
        for k in 0..style.bays {
            let x = -WIDTH * 0.5 + bay * f64::from(k);
            let door = floor == 0 && k == 1;
            let (width, sill, tall) = match (floor, door) {
                (0, true) => (1.2, 0.0, 2.6),
                (0, false) if style.shop => (bay - 0.7, 0.6, 2.2),
                (0, false) => (1.1, 1.0, 1.7),
                _ => (1.05, 0.9, 1.6),
            };
            let low = DVec3::new(x + (bay - width) * 0.5, y + sill, 0.0);
            let (left, above) = (low.x - x, y + height - low.y - tall);
            face(&mut parts.wall, DVec3::new(x, y, 0.0), left, height);
            face(&mut parts.wall, DVec3::new(low.x + width, y, 0.0), bay - left - width, height);
            face(&mut parts.wall, DVec3::new(low.x, low.y + tall, 0.0), width, above);
            if sill > 0.0 {
                face(&mut parts.wall, DVec3::new(low.x, y, 0.0), width, sill);
            }
            opening(parts, low, width, tall, door);
            if floor > 0 && style.shutters {
                shutters(parts, low, width, tall, detail);
            }
            if floor == 1 && k == 1 && style.balcony {
                balcony(parts, DVec3::new(x + bay * 0.5, y, 0.0), bay * 0.9, detail);
            }
        }
        add(
            &mut parts.trim,
            DVec3::new(-WIDTH * 0.5, y + height - 0.16, -0.05),
            DVec3::new(WIDTH * 0.5, y + height, 0.09),
        );
    }
    let top = GROUND + FLOOR * f64::from(style.floors);
    for k in 0..25 {
        let x = -WIDTH * 0.5 + 0.1 + 0.4 * f64::from(k);
        add(&mut parts.trim, DVec3::new(x, top - 0.34, 0.0), DVec3::new(x + 0.2, top - 0.16, 0.2));
    }
}

/// A window or a door in an opening at `low`: surround, pane, bars; a sill below windows.
fn opening(parts: &mut Parts, low: DVec3, width: f64, tall: f64, door: bool) {
    let high = low + DVec3::new(width, tall, 0.0);
    let z = |depth: f64| DVec3::Z * depth;
    let surround = 0.12;
    for x in [low.x - surround, high.x] {
        add(&mut parts.trim, DVec3::new(x, low.y, -0.2), DVec3::new(x + surround, high.y, 0.06));
    }
    add(
        &mut parts.trim,
        DVec3::new(low.x - surround, high.y, -0.2),
        DVec3::new(high.x + surround, high.y + surround, 0.08),
    );
    if door {
        face(&mut parts.wood, low - z(0.12), width, tall);
        for k in 0..6 {
            let at = low + DVec3::new(0.12 + 0.52 * f64::from(k % 2), 0.2 + 0.8 * f64::from(k / 2), -0.12);
            add(&mut parts.wood, at, at + DVec3::new(0.44, 0.66, 0.04));
        }
        add(&mut parts.trim, low - DVec3::new(0.3, 0.0, 0.2), low + DVec3::new(width + 0.3, 0.1, 0.25));
        return;
    }
    face(&mut parts.glass, low - z(0.14), width, tall);
    let columns = (width / 0.5).round().max(2.0) as u32;
    for k in 0..=columns {
        let x = low.x + (width - 0.05) * f64::from(k) / f64::from(columns);
        add(&mut parts.wood, DVec3::new(x, low.y, -0.14), DVec3::new(x + 0.05, high.y, -0.08));
    }
    for k in 0..=3 {
        let y = low.y + (tall - 0.05) * f64::from(k) / 3.0;
        add(&mut parts.wood, DVec3::new(low.x, y, -0.14), DVec3::new(high.x, y + 0.05, -0.085));
    }
    add(&mut parts.trim, DVec3::new(low.x - 0.2, low.y - 0.1, -0.2), DVec3::new(high.x + 0.2, low.y, 0.16));
}

/// A pair of open shutters with slats beside a window.
fn shutters(parts: &mut Parts, low: DVec3, width: f64, tall: f64, detail: u32) {
    let leaf = width * 0.5;
    let slats = 3 + detail / 6;
    for x in [low.x - 0.14 - leaf, low.x + width + 0.14] {
        let at = DVec3::new(x, low.y, 0.02);
        for edge in [0.0, leaf - 0.06] {
            add(&mut parts.wood, at + DVec3::X * edge, at + DVec3::new(edge + 0.06, tall, 0.05));
        }
        for edge in [0.0, tall - 0.06] {
            add(&mut parts.wood, at + DVec3::Y * edge, at + DVec3::new(leaf, edge + 0.06, 0.045));
        }
        for k in 0..slats {
            let y = 0.06 + (tall - 0.12) * f64::from(k) / f64::from(slats);
            let slat = at + DVec3::new(0.06, y, 0.0);
            add(&mut parts.wood, slat, slat + DVec3::new(leaf - 0.12, (tall - 0.12) / f64::from(slats) * 0.7, 0.03));
        }
    }
}

/// A balcony with a railing of bars, its floor at the height of `at`.
fn balcony(parts: &mut Parts, at: DVec3, width: f64, detail: u32) {
    let low = at - DVec3::X * (width * 0.5);
    add(&mut parts.trim, low - DVec3::Y * 0.15, low + DVec3::new(width, 0.0, 0.9));
    let around = 4 + detail / 20;
    let mut bar = |foot: DVec3| {
        let bar = [(0.012, 0.0), (0.012, 0.4), (0.03, 0.5), (0.012, 0.6), (0.012, 1.0)];
        parts.iron = std::mem::take(&mut parts.iron)
            .with(Shape::default().lathe(&bar, around, 1, true).moved(DAffine3::from_translation(foot)));
    };
    let bars = (width / 0.12) as u32;
    for k in 0..=bars {
        bar(low + DVec3::new(width * f64::from(k) / f64::from(bars), 0.0, 0.86));
    }
    for k in 0..7 {
        for x in [0.0, width] {
            bar(low + DVec3::new(x, 0.0, 0.86 * f64::from(k) / 7.0));
        }
    }
    add(&mut parts.iron, low + DVec3::new(-0.03, 1.0, 0.83), low + DVec3::new(width + 0.03, 1.05, 0.9));
    for x in [-0.03, width - 0.03] {
        add(&mut parts.iron, low + DVec3::new(x, 1.0, 0.0), low + DVec3::new(x + 0.06, 1.05, 0.86));
    }
}

/// The side of the court: a plain wall with windows on it.
fn back(parts: &mut Parts, style: &Style, top: f64) {
    let turned = |s: Shape| s.moved(DAffine3::from_rotation_translation(DQuat::from_rotation_y(PI), DVec3::Z * -DEPTH));
    let wall = Shape::default().rect(DVec3::X * (-WIDTH * 0.5), DVec3::X * WIDTH, DVec3::Y * top);
    parts.wall = std::mem::take(&mut parts.wall).with(turned(wall));
    let (mut panes, mut frames) = (Shape::default(), Shape::default());
    for floor in 0..=style.floors {
        for k in 0..3 {
            let low = DVec3::new(-3.6 + 3.0 * f64::from(k), 1.2 + FLOOR * f64::from(floor), 0.0);
            panes = panes.rect(low + DVec3::Z * 0.03, DVec3::X, DVec3::Y * 1.3);
            for x in [-0.06, 0.47, 1.0] {
                frames = frames.cuboid(low + DVec3::X * x, low + DVec3::new(x + 0.06, 1.3, 0.06));
            }
            for y in [-0.06, 0.62, 1.3] {
                frames = frames.cuboid(low + DVec3::new(-0.06, y, 0.0), low + DVec3::new(1.06, y + 0.06, 0.065));
            }
        }
    }
    parts.glass = std::mem::take(&mut parts.glass).with(turned(panes));
    parts.wood = std::mem::take(&mut parts.wood).with(turned(frames));
}

/// The wall of a side at `x` up to the ridge.
fn gable(parts: &mut Parts, x: f64, top: f64, rise: f64) {
    let out = DVec3::X * x.signum();
    let ridge = |v: f64| top + rise * (1.0 - (2.0 * v - 1.0).abs());
    parts.wall = std::mem::take(&mut parts.wall).patch(2, 1, |u, v| {
        // Seen from outside the wall runs from the back to the front on one side, and the other
        // way on the other.
        let along = if x > 0.0 { u } else { 1.0 - u };
        let p = DVec3::new(x, ridge(along) * v, -DEPTH * along);
        (p, out, (p.z, p.y))
    });
}

/// Two slopes of round tiles over a closed plane; `corner` is the left end of the front eaves, the
/// ridge runs along X.
pub fn roof(material: u32, corner: DVec3, width: f64, depth: f64, rise: f64, detail: u32) -> Shape {
    let eaves = DVec3::X * width;
    let slope = DVec3::new(0.0, rise, -depth * 0.5);
    let front = tiles(material, corner, eaves, slope, detail);
    let far = corner + eaves - DVec3::Z * depth;
    front.with(tiles(material, far, -eaves, DVec3::new(0.0, rise, depth * 0.5), detail))
}

/// One slope: rows of round tiles from `corner` along `eaves` and up `slope`, over a plane.
fn tiles(material: u32, corner: DVec3, eaves: DVec3, slope: DVec3, detail: u32) -> Shape {
    let (along, up) = (eaves.normalize(), slope.normalize());
    let normal = along.cross(up);
    let columns = (eaves.length() / 0.26).round() as u32;
    let rows = (slope.length() / 0.42).ceil() as u32;
    let (step, row) = (eaves.length() / f64::from(columns), slope.length() / f64::from(rows));
    let around = 2 + detail / 16;
    let mut shape = Shape::new(material).rect(corner, eaves, slope);
    for tile in 0..rows * columns {
        let (i, j) = (tile % columns, tile / columns);
        let foot = corner + along * (step * (f64::from(i) + 0.5)) + up * (row * f64::from(j));
        // Shades differ from tile to tile.
        let shade = f64::from((i * 7 + j * 13) % 11) * 0.23;
        shape = shape.patch(around, 1, |u, v| {
            let (s, c) = ((1.0 - u) * PI).sin_cos();
            let out = along * c + normal * s;
            // The lower end lies on the tile below it.
            let lift = normal * (0.05 * (1.0 - v));
            (foot + out * (step * 0.48) + lift + up * (row * 1.1 * v), out, (u * 0.3 + shade, v * 0.4 + shade))
        });
    }
    shape
}
