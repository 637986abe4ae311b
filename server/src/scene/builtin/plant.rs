//! `plant`: storeys of steel frames with gratings, pipe runs, tanks and stairs, in place of the
//! power plant of Aliaga and Lastra 1999.

use super::Builtin;
use super::draw::{Draft, Shape};
use super::paint::Pattern;
use super::random::Random;
use glam::{DAffine3, DQuat, DVec3};
use std::f64::consts::FRAC_PI_2;

/// Bay of the steel frame: width, storey height, depth, metres.
const BAY: DVec3 = DVec3::new(6.0, 4.5, 6.0);

struct Parts {
    column: u32,
    beam: u32,
    slab: u32,
    rail: u32,
    stairs: u32,
    tanks: Vec<u32>,
    runs: Vec<u32>,
    elbows: Vec<u32>,
    valves: Vec<u32>,
}

/// Builds the plant: the target sets its size, the detail its tessellation.
pub fn build(detail: u32, target: u64, seed: u64) -> Builtin {
    let bays = ((target as f64 / 2e6).powf(1.0 / 3.0) * 7.0).round().clamp(4.0, 16.0) as i32;
    let storeys = ((target as f64 / 2e6).powf(1.0 / 3.0) * 4.0).round().clamp(2.0, 9.0) as i32;
    let mut draft = Draft::default();
    let mut random = Random::new(seed, 3);
    let parts = parts(&mut draft, detail);
    let corner = DVec3::new(-f64::from(bays) * 0.5 * BAY.x, 0.0, -f64::from(bays) * 0.5 * BAY.z);
    let node = |i: i32, j: i32, k: i32| corner + DVec3::new(f64::from(i), f64::from(j), f64::from(k)) * BAY;
    for j in 0..storeys {
        for i in 0..=bays {
            for k in 0..=bays {
                draft.place(parts.column, node(i, j, k), 0.0, 1.0);
                if i < bays {
                    draft.place(parts.beam, node(i, j + 1, k), 0.0, 1.0);
                }
                if k < bays {
                    draft.place(parts.beam, node(i, j + 1, k), -90.0, 1.0);
                }
            }
        }
        for i in 0..bays {
            for k in 0..bays {
                let bay = node(i, j, k);
                // The stairwell has no slab above its lowest floor; the walk goes round by the
                // outer aisle.
                let stairwell = i == bays / 2 && k == bays / 2;
                if stairwell {
                    draft.place(parts.stairs, bay, 0.0, 1.0);
                }
                if !stairwell || j == 0 {
                    draft.place(parts.slab, bay, 0.0, 1.0);
                }
                if i == 0 || i == bays - 1 || k == 0 || k == bays - 1 {
                    rails(&mut draft, &parts, bay, (i == 0, i == bays - 1, k == 0, k == bays - 1));
                } else if !stairwell {
                    equip(&mut draft, &parts, &mut random, bay);
                }
            }
        }
    }
    let concrete = draft.paint(Pattern::Concrete, [0.7, 0.7, 0.68]);
    let ground = draft.mesh(
        "ground",
        [Shape::new(concrete).rect(
            corner * 1.6 - DVec3::Y * 0.02,
            DVec3::Z * (-3.2 * corner.z),
            DVec3::X * (-3.2 * corner.x),
        )],
    );
    draft.place(ground, DVec3::ZERO, 0.0, 1.0);
    // Round the outer aisle of the ground floor, then of the next one up.
    let aisle = |i: i32, k: i32, j: i32| node(i, j, k) + DVec3::new(BAY.x * 0.5, 1.6, BAY.z * 0.5);
    let last = bays - 1;
    let ring = |j: i32| [aisle(0, 0, j), aisle(last, 0, j), aisle(last, last, j), aisle(0, last, j), aisle(0, 0, j)];
    Builtin { scene: draft.scene, waypoints: ring(0).into_iter().chain(ring(1)).collect() }
}

fn rails(draft: &mut Draft, parts: &Parts, bay: DVec3, sides: (bool, bool, bool, bool)) {
    let (x, z) = (DVec3::X * BAY.x, DVec3::Z * BAY.z);
    for (wanted, at, turn) in
        [(sides.0, bay, -90.0), (sides.1, bay + x, -90.0), (sides.2, bay, 0.0), (sides.3, bay + z, 0.0)]
    {
        if wanted {
            draft.place(parts.rail, at, turn, 1.0);
        }
    }
}

/// Fills a bay: a tank or a valve station on the floor, pipe runs with elbows below the ceiling.
fn equip(draft: &mut Draft, parts: &Parts, random: &mut Random, bay: DVec3) {
    let centre = bay + DVec3::new(BAY.x * 0.5, 0.0, BAY.z * 0.5);
    if random.below(3) == 0 {
        draft.place(
            parts.tanks[random.below(parts.tanks.len())],
            centre,
            90.0 * random.below(4) as f64,
            random.within(0.8, 1.0),
        );
    } else {
        for _ in 0..2 + random.below(4) {
            let at = centre + DVec3::new(random.within(-2.0, 2.0), 0.0, random.within(-2.0, 2.0));
            draft.place(
                parts.valves[random.below(parts.valves.len())],
                at,
                90.0 * random.below(4) as f64,
                random.within(0.8, 1.2),
            );
        }
    }
    for lane in 0..6 {
        let y = 3.0 + 0.22 * f64::from(lane / 2);
        let run = parts.runs[random.below(parts.runs.len())];
        if lane % 2 == 0 {
            let x = 0.6 + 0.8 * random.below(6) as f64;
            draft.place(run, bay + DVec3::new(x, y, 0.0), 0.0, 1.0);
            let elbow = parts.elbows[random.below(parts.elbows.len())];
            draft.place_by(
                elbow,
                DAffine3::from_rotation_translation(
                    DQuat::from_rotation_x(FRAC_PI_2),
                    bay + DVec3::new(x, y + 0.3, random.within(1.0, 5.0)),
                ),
            );
        } else {
            draft.place(run, bay + DVec3::new(0.0, y + 0.11, 0.6 + 0.8 * random.below(6) as f64), 90.0, 1.0);
        }
    }
}

fn parts(draft: &mut Draft, detail: u32) -> Parts {
    let (around, along) = (5 + detail, 1 + detail / 6);
    let steel = draft.paint(Pattern::Metal, [0.55, 0.3, 0.25]);
    let grating = draft.paint(Pattern::Tile, [0.5, 0.52, 0.55]);
    let yellow = draft.paint(Pattern::Metal, [0.9, 0.75, 0.15]);
    let i_profile = |length: DVec3| {
        // Two flanges and a web along `length`.
        let (l, side) = (length, if length.y > 0.0 { DVec3::X } else { DVec3::Y });
        let other = l.normalize().cross(side);
        let part = |s: Shape, a: f64, b: f64, c: f64, d: f64| {
            let (p, q) = (side * a + other * c, side * b + other * d + l);
            s.cuboid(p.min(q), p.max(q))
        };
        part(
            part(part(Shape::new(steel), -0.15, -0.13, -0.12, 0.12), 0.13, 0.15, -0.12, 0.12),
            -0.13,
            0.13,
            -0.01,
            0.01,
        )
    };
    let column = draft.mesh("column", [i_profile(DVec3::Y * BAY.y)]);
    let beam = draft.mesh("beam", [i_profile(DVec3::X * BAY.x).moved(DAffine3::from_translation(DVec3::Y * -0.2))]);
    let slab =
        draft.mesh("slab", [Shape::new(grating).cuboid(DVec3::new(0.0, -0.04, 0.0), DVec3::new(BAY.x, 0.0, BAY.z))]);
    let mut rail = Shape::new(yellow);
    for height in [0.55, 1.05] {
        rail = rail.with(
            Shape::new(yellow)
                .tube(0.025, BAY.x, 4 + around / 2, 1)
                .moved(DAffine3::from_rotation_translation(DQuat::from_rotation_y(FRAC_PI_2), DVec3::Y * height)),
        );
    }
    for post in 0..5 {
        rail = rail.with(
            Shape::new(yellow)
                .lathe(&[(0.025, 0.0), (0.025, 1.05)], 4 + around / 2, 1, false)
                .moved(DAffine3::from_translation(DVec3::X * (1.2 * f64::from(post) + 0.6))),
        );
    }
    let rail = draft.mesh("rail", [rail]);
    let mut stairs = Shape::new(grating);
    for step in 0..25 {
        let (y, x) = (BAY.y * f64::from(step + 1) / 25.0, 0.5 + 0.2 * f64::from(step));
        stairs = stairs.cuboid(DVec3::new(x, y - 0.04, 2.0), DVec3::new(x + 0.24, y, 4.0));
    }
    let stairs = draft.mesh("stairs", [stairs]);
    let (mut tanks, mut runs, mut elbows, mut valves) = (vec![], vec![], vec![], vec![]);
    for (n, tint) in [[0.75, 0.75, 0.78], [0.25, 0.5, 0.7], [0.7, 0.35, 0.2], [0.35, 0.6, 0.4]].into_iter().enumerate()
    {
        let paint = draft.paint(Pattern::Metal, tint);
        let tank = Shape::new(paint).lathe(
            &[(0.0, 0.3), (0.9, 0.3), (1.2, 0.6), (1.2, 2.2), (0.8, 2.6), (0.2, 2.75), (0.0, 2.75)],
            around * 2,
            along * 2,
            true,
        );
        tanks.push(draft.mesh(
            "tank",
            [
                tank,
                Shape::new(yellow).lathe(&[(1.22, 1.2), (1.28, 1.25), (1.22, 1.3)], around * 2, 1, false),
                Shape::new(steel).lathe(&[(0.9, 0.0), (0.9, 0.32)], around, 1, false),
            ],
        ));
        let radius = 0.06 + 0.03 * n as f64;
        runs.push(draft.mesh(
            "run",
            [
                Shape::new(paint).tube(radius, BAY.x, around, along * 2),
                Shape::new(steel).tube(radius * 1.4, 0.08, around, 1),
            ],
        ));
        elbows.push(draft.mesh("elbow", [Shape::new(paint).elbow(radius, 0.3, around, 2 + along)]));
        let body = Shape::new(paint).lathe(
            &[(0.12, 0.0), (0.12, 0.5), (0.2, 0.55), (0.2, 0.75), (0.05, 0.8), (0.03, 1.1)],
            around,
            along,
            false,
        );
        let wheel = Shape::new(yellow).lathe(
            &[(0.22, 1.08), (0.25, 1.1), (0.22, 1.12), (0.2, 1.1), (0.22, 1.08)],
            around,
            1,
            false,
        );
        valves
            .push(draft.mesh("valve", [body, wheel, Shape::new(steel).ball(DVec3::Y * 1.15, 0.06, around, along * 2)]));
    }
    Parts { column, beam, slab, rail, stairs, tanks, runs, elbows, valves }
}
