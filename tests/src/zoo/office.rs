//! Office storeys as building models bring: every door is closed, and no stairs lead to the upper
//! storey.

use super::Specimen;
use super::furniture::Furniture;
use super::kit::{Pattern, Shape, Shapes, Site, at};
use glam::{DAffine3, DQuat, DVec3};

/// From storey to storey, metres.
const STOREY_M: f64 = 3.6;
/// Underside of the suspended ceilings.
const CEILING_M: f64 = 2.7;
/// Thickness of floors.
const SLAB_M: f64 = 0.3;
/// Rooms along each side of the corridor, and their size.
const ROOMS: i32 = 6;
const WIDE_M: f64 = 4.6;
const DEEP_M: f64 = 4.8;
/// Half the corridor's width.
const CORRIDOR_M: f64 = 1.1;
/// Half the storey's length without the lift.
const LONG_M: f64 = WIDE_M * ROOMS as f64 * 0.5;
/// The lift shaft behind the corridor's end: x range.
const SHAFT_M: [f64; 2] = [LONG_M, LONG_M + 2.2];

/// Middle of a room on one side (-1 or 1) of the corridor.
fn room(side: f64, k: i32) -> DVec3 {
    at(-LONG_M + (f64::from(k) + 0.5) * WIDE_M, 0.0, side * (CORRIDOR_M + DEEP_M * 0.5))
}

struct Finish {
    facade: u32,
    wall: u32,
    carpet: u32,
    ceiling: u32,
    slab: u32,
    leaf: u32,
    steel: u32,
    duct: u32,
    glass: u32,
}

/// One storey, its floor's top at y = 0: walls, closed leaves, ceilings, ducts, slab.
fn storey(f: &Finish, number: u32) -> Vec<Shape> {
    let (half, high) = (CORRIDOR_M + DEEP_M, STOREY_M - SLAB_M);
    let mut facade = Shape::new(f.facade);
    let mut glass = Shape::new(f.glass);
    let mut wall = Shape::new(f.wall);
    let mut leaf = Shape::new(f.leaf);
    let mut steel = Shape::new(f.steel);
    let mut duct = Shape::new(f.duct);
    let mut ceiling = Shape::new(f.ceiling);
    let middles: Vec<f64> = (0..ROOMS).map(|k| (f64::from(k) + 0.5) * WIDE_M).collect();
    let windows: Vec<[f64; 4]> = middles.iter().map(|m| [m + 0.2, 2.6, 0.9, 2.4]).collect();
    let doors: Vec<[f64; 4]> = middles.iter().map(|m| [m - 1.0, 0.95, 0.0, 2.1]).collect();
    for side in [-1.0, 1.0] {
        facade =
            facade.wall(at(-LONG_M - 0.2, 0.0, side * half), at(LONG_M + 0.2, 0.0, side * half), high, 0.3, &windows);
        wall = wall.wall(at(-LONG_M, 0.0, side * CORRIDOR_M), at(LONG_M, 0.0, side * CORRIDOR_M), high, 0.15, &doors);
        facade = facade
            .wall(at(side * LONG_M, 0.0, half - 0.15), at(side * LONG_M, 0.0, CORRIDOR_M + 0.08), high, 0.2, &[])
            .wall(at(side * LONG_M, 0.0, 0.15 - half), at(side * LONG_M, 0.0, -CORRIDOR_M - 0.08), high, 0.2, &[]);
        for k in 0..ROOMS {
            let c = room(side, k);
            let z = side * CORRIDOR_M;
            glass = glass.boxed(at(c.x, 1.65, side * half), at(1.3, 0.75, 0.015));
            // The leaf fills its opening; frames and handles on both sides.
            let door = at(c.x - 1.0, 0.0, z);
            leaf = leaf.boxed(door + DVec3::Y * 1.05, at(0.475, 1.05, 0.025));
            for face in [-0.05, 0.05] {
                steel = steel.rod(door + at(0.3, 1.05, face), door + at(0.4, 1.05, face), 0.012, 6);
                for x in [-0.45, 0.45] {
                    steel = steel.boxed(door + at(x, 1.05, face * 0.9), at(0.025, 1.05, 0.02));
                }
            }
            if k > 0 {
                let x = c.x - WIDE_M * 0.5;
                wall = wall.wall(
                    at(x, 0.0, side * (CORRIDOR_M + 0.08)),
                    at(x, 0.0, side * (half - 0.15)),
                    high,
                    0.12,
                    &[],
                );
            }
            // Panels hang in the rooms, and a branch of the duct above them.
            for i in 0..4 {
                for j in 0..4 {
                    let p = c + at((f64::from(i) - 1.5) * 1.1, CEILING_M, (f64::from(j) - 1.5) * 1.14);
                    ceiling = ceiling.boxed(p + DVec3::Y * 0.015, at(0.545, 0.015, 0.565));
                }
            }
            duct = duct.boxed(at(c.x + 0.8, 2.98, c.z), at(0.25, 0.14, DEEP_M * 0.45));
            steel = steel.rod(at(c.x - 1.4, 3.1, z), at(c.x - 1.4, 3.1, z + side * DEEP_M * 0.9), 0.06, 6);
            ceiling = ceiling.boxed(at(c.x + 0.8, CEILING_M - 0.012, c.z), at(0.25, 0.012, 0.25));
        }
    }
    ceiling =
        ceiling.solid(at(-LONG_M, CEILING_M, -CORRIDOR_M + 0.08), at(LONG_M, CEILING_M + 0.03, CORRIDOR_M - 0.08));
    duct = duct.boxed(at(0.0, 3.0, 0.0), at(LONG_M - 0.5, 0.18, 0.6));
    // The corridor ends at a window, and at the lift's closed doors.
    facade = facade.wall(
        at(-LONG_M, 0.0, -CORRIDOR_M - 0.08),
        at(-LONG_M, 0.0, CORRIDOR_M + 0.08),
        high,
        0.2,
        &[[1.2, 1.2, 0.9, 2.4]],
    );
    glass = glass.boxed(at(-LONG_M, 1.65, 0.0), at(0.015, 0.75, 0.6));
    facade = facade.wall(
        at(LONG_M, 0.0, -CORRIDOR_M - 0.08),
        at(LONG_M, 0.0, CORRIDOR_M + 0.08),
        high,
        0.2,
        &[[1.18, 1.0, 0.0, 2.1]],
    );
    steel =
        steel.boxed(at(LONG_M, 1.05, -0.25), at(0.03, 1.05, 0.25)).boxed(at(LONG_M, 1.05, 0.25), at(0.03, 1.05, 0.25));
    let [x0, x1] = SHAFT_M;
    facade = facade
        .wall(at(x0 + 0.1, 0.0, -1.1), at(x1, 0.0, -1.1), STOREY_M, 0.15, &[])
        .wall(at(x0 + 0.1, 0.0, 1.1), at(x1, 0.0, 1.1), STOREY_M, 0.15, &[])
        .wall(at(x1, 0.0, -1.17), at(x1, 0.0, 1.17), STOREY_M, 0.15, &[]);
    let mut slab =
        Shape::new(f.slab).solid(at(-LONG_M - 0.2, -SLAB_M, -half - 0.2), at(LONG_M + 0.1, -0.01, half + 0.2));
    if number == 0 {
        slab = slab.solid(at(x0 + 0.1, -1.5, -1.17), at(x1 + 0.07, -1.2, 1.17));
    }
    let carpet = Shape::new(f.carpet).solid(at(-LONG_M, -0.01, -half), at(LONG_M, 0.0, half));
    vec![facade, glass, wall, leaf, steel, duct, ceiling, slab, carpet]
}

/// Two storeys of a corridor and twelve rooms each, all doors closed.
pub(super) fn closed_doors() -> Specimen {
    let mut site = Site::new();
    let f = Finish {
        facade: site.paint(Pattern::Concrete, [0.85, 0.82, 0.76]),
        wall: site.paint(Pattern::Plaster, [0.85, 0.87, 0.9]),
        carpet: site.paint(Pattern::Cloth, [0.3, 0.36, 0.45]),
        ceiling: site.paint(Pattern::Plaster, [0.92, 0.92, 0.9]),
        slab: site.paint(Pattern::Concrete, [0.7, 0.7, 0.7]),
        leaf: site.paint(Pattern::Wood, [0.75, 0.55, 0.4]),
        steel: site.plain([0.4, 0.42, 0.45]),
        duct: site.paint(Pattern::Metal, [0.7, 0.72, 0.75]),
        glass: site.plain([0.35, 0.5, 0.6]),
    };
    let pieces = Furniture::new(&mut site);
    for n in 0..2 {
        let up = DVec3::Y * STOREY_M * f64::from(n);
        let mesh = site.draft.mesh("storey", storey(&f, n));
        site.place(mesh, up, 0.0);
        for k in 0..ROOMS {
            for side in [-1.0, 1.0] {
                let c = room(side, k) + up;
                // Rooms are turned so that +Z is away from the corridor.
                let (turn, yaw) = if side > 0.0 { (1.0, 0.0) } else { (-1.0, 180.0) };
                let p = |x: f64, z: f64| c + at(x * turn, 0.0, z * turn);
                match (k + n as i32) % 3 {
                    0 => {
                        pieces.workplace(&mut site, p(-1.2, 1.2), yaw + 90.0);
                        pieces.workplace(&mut site, p(1.6, 1.2), yaw - 90.0);
                        if n == 0 {
                            site.place(pieces.plant, p(0.2, 1.9), yaw);
                        }
                    }
                    1 => {
                        site.place(pieces.table, p(0.2, 0.9), yaw);
                        for (x, z, face) in [(-0.1, 0.3, 0.0), (0.5, 0.3, 0.0), (-0.1, 1.5, 180.0), (0.5, 1.5, 180.0)] {
                            site.place(pieces.chair, p(x, z), yaw + face);
                        }
                    }
                    _ => {
                        pieces.workplace(&mut site, p(0.8, 1.4), yaw + 180.0);
                        site.place(pieces.shelf, p(-2.0, 0.8), yaw + 90.0);
                    }
                }
                site.place(if k % 3 == 0 { pieces.shelf } else { pieces.wardrobe }, p(1.4, -1.98), yaw);
                site.stand([p(0.1, -0.9)]);
            }
        }
        site.stand([-11.0, -4.0, 0.0, 5.5, 12.0].map(|x| at(x, 0.0, 0.0) + up));
    }
    let top = 2.0 * STOREY_M;
    let half = CORRIDOR_M + DEEP_M;
    let roof = Shape::new(f.slab)
        .solid(at(-LONG_M - 0.2, top - SLAB_M, -half - 0.2), at(LONG_M + 0.1, top, half + 0.2))
        .solid(at(SHAFT_M[0] + 0.1, top, -1.17), at(SHAFT_M[1] + 0.07, top + 0.3, 1.17));
    let mut units = Shape::new(f.duct);
    for (x, z) in [(-8.0, -2.0), (-2.0, 2.5), (6.0, -1.5)] {
        units = units.boxed(at(x, top + 0.7, z), at(1.4, 0.7, 0.9));
        let fan = Shape::new(0).lathe(&[(0.0, 0.0), (0.6, 0.0), (0.6, 0.25), (0.5, 0.25), (0.0, 0.1)], 24, 1, false);
        units = units.with(fan.moved(DAffine3::from_rotation_translation(DQuat::IDENTITY, at(x, top + 1.4, z))));
    }
    site.put("roof", [roof, units]);

    // On the roof, on a table, in the ceiling voids over a room and over the corridor, and in the
    // lift shaft.
    site.never_stand([at(0.0, top, 0.0), at(-11.0, top, 3.0), at(9.0, top, 4.0)]);
    let table = room(1.0, 1);
    site.never_stand([table + at(0.2, 0.75, 0.9)]);
    site.never_eye([
        room(1.0, 2) + at(-0.2, 2.95, 0.0),
        room(-1.0, 4) + at(-0.2, STOREY_M + 2.95, 0.0),
        at(3.0, 3.0, 0.85),
        at(SHAFT_M[0] + 1.2, STOREY_M * 0.9, 0.0),
        at(SHAFT_M[0] + 1.2, STOREY_M + 0.6, 0.0),
        at(0.0, 1.6, half + 3.0),
    ]);
    site.specimen("closed_doors")
}
