//! Two towers of eight storeys with stairs inside, joined by a bridge.

use super::Specimen;
use super::furniture::Furniture;
use super::kit::{Pattern, Shape, Shapes, Site, at, spaced};
use glam::DVec3;

/// Height of a storey: 20 risers of 0.16 m.
const STOREY_M: f64 = 3.2;
/// Number of storeys.
const STOREYS: u32 = 8;
/// Storey of the bridge, counted from 0.
const BRIDGE: u32 = 4;
/// Thickness of floors.
const SLAB_M: f64 = 0.25;
/// Half the edge of a tower.
const HALF_M: f64 = 6.0;
/// Between the towers' middles.
const APART_M: f64 = 30.0;
/// Tread: depth, rise, width.
const TREAD: DVec3 = DVec3::new(0.28, 0.16, 1.2);
/// The stairs' corner: x and z ranges.
const STAIRS: [[f64; 2]; 2] = [[3.2, 5.8], [-5.7, -1.7]];

struct Finish {
    wall: u32,
    inner: u32,
    floor: u32,
    stair: u32,
    rail: u32,
}

/// One storey, its floor's top at y = 0; `bridge` and `entrance` open the wall toward +X.
fn storey(f: &Finish, number: u32) -> Vec<Shape> {
    let [[x0, x1], [z0, z1]] = STAIRS;
    let (low, high) = (-SLAB_M, STOREY_M - SLAB_M);
    let windows = [[2.5, 1.6, 0.9, 2.2], [6.0, 1.6, 0.9, 2.2], [9.5, 1.6, 0.9, 2.2]];
    let bridge = [[6.0, 1.6, 0.0, 2.2]];
    let balcony = [[3.0, 1.6, 0.9, 2.2], [6.0, 1.0, 0.0, 2.2], [9.5, 1.6, 0.9, 2.2]];
    let (h, s) = (HALF_M, 0.125);
    let open: &[[f64; 4]] = if number == BRIDGE || number == 0 { &bridge } else { &[] };
    let wall = Shape::new(f.wall)
        .wall(at(-h - s, 0.0, -h), at(h + s, 0.0, -h), high, 0.25, &windows[..2])
        .wall(at(-h - s, 0.0, h), at(h + s, 0.0, h), high, 0.25, if number == 0 { &windows } else { &balcony })
        .wall(at(-h, 0.0, -h + s), at(-h, 0.0, h - s), high, 0.25, &windows)
        .wall(at(h, 0.0, -h + s), at(h, 0.0, h - s), high, 0.25, open);
    let inner = Shape::new(f.inner).wall(
        at(-1.0, 0.0, -h + s),
        at(-1.0, 0.0, h - s),
        high,
        0.12,
        &[[3.5, 1.0, 0.0, 2.1], [8.5, 1.0, 0.0, 2.1]],
    );
    let edge = h + s;
    let floor = Shape::new(f.floor);
    let floor = if number == 0 {
        floor.solid(at(-edge, low, -edge), at(edge, 0.0, edge))
    } else {
        floor
            .solid(at(-edge, low, z1), at(edge, 0.0, edge))
            .solid(at(-edge, low, -edge), at(x0, 0.0, z1))
            .solid(at(x1, low, -edge), at(edge, 0.0, z1))
            .solid(at(x0, low, -edge), at(x1, 0.0, z0))
    };
    let mut shapes = vec![wall, inner, floor];
    if number + 1 < STOREYS {
        // Nine treads, a landing, nine treads; the floors are the twentieth of each.
        let run = 9.0 * TREAD.x;
        let half = STOREY_M * 0.5;
        let stair = Shape::new(f.stair)
            .flight(at(x0 + 0.6, 0.0, z1), DVec3::NEG_Z, 9, TREAD)
            .solid(at(x0, half - 0.2, z0), at(x1, half, z1 - run))
            .flight(at(x1 - 0.6, half, z1 - run), DVec3::Z, 9, TREAD);
        shapes.push(stair);
    }
    if number > 0 {
        // The stairwell's edge beside the flight that arrives, and the balcony.
        let (bx, bz) = (1.6, edge + 1.5);
        let well = Shape::new(f.rail).railing(at(x0 - 0.05, 0.0, z0), at(x0 - 0.05, 0.0, z1));
        let balcony = Shape::new(f.floor).solid(at(-bx, low, edge), at(bx, 0.0, bz));
        let rails = well
            .railing(at(-bx + 0.05, 0.0, bz - 0.05), at(bx - 0.05, 0.0, bz - 0.05))
            .railing(at(-bx + 0.05, 0.0, edge), at(-bx + 0.05, 0.0, bz - 0.1))
            .railing(at(bx - 0.05, 0.0, edge), at(bx - 0.05, 0.0, bz - 0.1));
        shapes.extend([balcony, rails]);
    }
    shapes
}

/// Two towers with real treads, balconies and a bridge at storey 5.
pub(super) fn two_towers() -> Specimen {
    let mut site = Site::new();
    let f = Finish {
        wall: site.paint(Pattern::Plaster, [0.8, 0.62, 0.5]),
        inner: site.paint(Pattern::Plaster, [0.85, 0.88, 0.85]),
        floor: site.paint(Pattern::Concrete, [0.9, 0.88, 0.85]),
        stair: site.paint(Pattern::Concrete, [0.6, 0.65, 0.75]),
        rail: site.plain([0.2, 0.25, 0.3]),
    };
    let paving = site.paint(Pattern::Tile, [0.6, 0.58, 0.55]);
    let pieces = Furniture::new(&mut site);
    let storeys: Vec<u32> = (0..STOREYS).map(|n| site.draft.mesh("storey", storey(&f, n))).collect();
    let top = f64::from(STOREYS) * STOREY_M;
    let edge = HALF_M + 0.125;
    let mut roof = Shape::new(f.floor).solid(at(-edge, -SLAB_M, -edge), at(edge, 0.0, edge));
    for (from, to) in [(at(-edge, 0.0, 6.0), at(edge, 0.0, 6.0)), (at(-edge, 0.0, -6.0), at(edge, 0.0, -6.0))] {
        roof = roof.bar(from, to, 0.5, 0.2);
    }
    let roof = site.draft.mesh("roof", [roof]);

    // The second tower is the first one, turned to face it.
    let towers = [(DVec3::ZERO, 0.0), (DVec3::X * APART_M, 180.0)];
    let world = |tower: usize, p: DVec3| {
        let (at, yaw) = towers[tower];
        at + glam::DQuat::from_rotation_y(f64::to_radians(yaw)) * p
    };
    for tower in 0..2 {
        for n in 0..STOREYS {
            let y = f64::from(n) * STOREY_M;
            let yaw = towers[tower].1;
            let mut put =
                |mesh: u32, x: f64, z: f64, turn: f64| site.place(mesh, world(tower, at(x, y, z)), yaw + turn);
            put(storeys[n as usize], 0.0, 0.0, 0.0);
            // One room is furnished for living or working, the other, with the stairs, sparsely.
            if (n + tower as u32).is_multiple_of(2) {
                put(pieces.sofa, -5.3, 1.5, 90.0);
                put(pieces.table, -3.8, 1.5, 90.0);
                put(pieces.bed, -4.0, -4.7, 0.0);
                put(pieces.lamp, -0.6, -5.4, 0.0);
            } else {
                put(pieces.desk, -5.4, 0.5, 90.0);
                put(pieces.chair, -4.8, 0.5, -90.0);
                put(pieces.desk, -5.4, -3.0, 90.0);
                put(pieces.shelf, -1.3, 0.0, -90.0);
                put(pieces.shelf, -4.0, 5.6, 180.0);
            }
            if n == 1 {
                put(pieces.table, 4.8, 5.0, 0.0);
            }
        }
        site.place(roof, world(tower, DVec3::Y * top), towers[tower].1);
    }

    let y = f64::from(BRIDGE) * STOREY_M;
    let (from, to) = (edge, APART_M - edge);
    let deck = Shape::new(f.floor).solid(at(from, y - SLAB_M, -1.2), at(to, y, 1.2));
    let rails =
        Shape::new(f.rail).railing(at(from, y, -1.15), at(to, y, -1.15)).railing(at(from, y, 1.15), at(to, y, 1.15));
    site.put("bridge", [deck, rails]);
    let lines = spaced(-35.0, 65.0, 20);
    let plaza = Shape::new(paving).ground(&lines, &spaced(-40.0, 40.0, 16), |_, _| -0.1, |_, _| true);
    site.put("plaza", [plaza]);
    for k in 0..12 {
        let (s, c) = (f64::from(k) * 0.55).sin_cos();
        site.place(pieces.tree, at(15.0 + 30.0 * c, -0.1, 24.0 * s), 50.0 * f64::from(k));
    }

    for tower in 0..2 {
        for n in 0..STOREYS {
            let y = f64::from(n) * STOREY_M;
            site.stand([at(2.0, y, 1.5), at(-2.4, y, -1.5)].map(|p| world(tower, p)));
            if n > 0 {
                site.stand([world(tower, at(0.3, y, 6.8))]);
            }
        }
        for n in [0, 3, 6] {
            // The middle of the fifth tread of each flight, and the landing.
            let y = f64::from(n) * STOREY_M;
            let z = STAIRS[1][1] - 4.5 * TREAD.x;
            site.stand([at(3.8, y + 0.8, z), at(5.2, y + 2.4, z), at(4.5, y + 1.6, -5.0)].map(|p| world(tower, p)));
        }
        site.never_stand([at(0.0, top, 0.0), at(-3.0, top, 3.0)].map(|p| world(tower, p)));
        site.never_stand([world(tower, at(4.8, STOREY_M + 0.75, 5.0))]);
    }
    site.stand([at(9.0, y, 0.0), at(15.0, y, 0.4), at(21.0, y, 0.0), at(15.0, -0.1, 8.0), at(-12.0, -0.1, 0.0)]);
    // In the air beside the towers and under the bridge.
    site.never_eye([at(15.0, y + 5.0, 0.0), at(15.0, 8.0, 0.0), at(10.0, y + 1.6, 4.0)]);
    site.specimen("two_towers")
}
