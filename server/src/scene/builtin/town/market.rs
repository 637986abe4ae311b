//! The market in the middle of the town: church, fountain, stalls; and what stands in streets.

use super::super::draw::{Draft, Shape};
use super::super::paint::Pattern;
use super::super::random::Random;
use super::{BLOCK, KERB, Paints, houses};
use glam::{DAffine3, DQuat, DVec3};

/// Meshes that stand in streets and on the market.
pub struct Furniture {
    pub lamp: u32,
    pub bench: u32,
    bollard: u32,
    pub table: u32,
    stalls: Vec<u32>,
}

/// Makes the furniture.
pub fn furniture(draft: &mut Draft, paints: &Paints, detail: u32) -> Furniture {
    let around = 6 + detail / 6;
    let pole = [(0.16, 0.0), (0.16, 0.3), (0.07, 0.45), (0.05, 3.2), (0.12, 3.3), (0.03, 3.4)];
    let lantern = [(0.1, 3.4), (0.2, 3.9), (0.24, 3.95), (0.05, 4.2), (0.0, 4.25)];
    let white = draft.paint(Pattern::Plaster, [1.0, 0.95, 0.8]);
    let lamp = draft.mesh(
        "lamp",
        [
            Shape::new(paints.iron).lathe(&pole, around, 1, true).lathe(&lantern[2..], around, 1, false),
            Shape::new(white).lathe(&lantern[..3], around, 1, false),
        ],
    );
    let mut planks = Shape::new(paints.wood);
    for k in 0..6 {
        let z = 0.09 * f64::from(k);
        planks = planks.cuboid(DVec3::new(-0.9, 0.42, z), DVec3::new(0.9, 0.46, z + 0.07));
        let y = 0.5 + 0.09 * f64::from(k);
        planks = planks.cuboid(DVec3::new(-0.9, y, -0.04), DVec3::new(0.9, y + 0.07, 0.0));
    }
    let mut legs = Shape::new(paints.iron);
    for x in [-0.7, 0.65] {
        legs = legs
            .cuboid(DVec3::new(x, 0.0, -0.05), DVec3::new(x + 0.05, 1.0, 0.0))
            .cuboid(DVec3::new(x, 0.0, 0.45), DVec3::new(x + 0.05, 0.42, 0.5));
    }
    let bench = draft.mesh("bench", [planks, legs]);
    let profile = [(0.14, 0.0), (0.14, 0.15), (0.09, 0.2), (0.08, 0.75), (0.12, 0.8), (0.1, 0.9), (0.0, 0.95)];
    let bollard = draft.mesh("bollard", [Shape::new(paints.iron).lathe(&profile, around, 1, true)]);
    let table = table(draft, paints, around);
    let stalls = [[0.8, 0.2, 0.15], [0.2, 0.4, 0.65], [0.85, 0.7, 0.25], [0.25, 0.5, 0.3]]
        .map(|tint| stall(draft, paints, tint, detail))
        .to_vec();
    Furniture { lamp, bench, bollard, table, stalls }
}

/// A round table with four chairs.
fn table(draft: &mut Draft, paints: &Paints, around: u32) -> u32 {
    let top = [(0.25, 0.0), (0.25, 0.03), (0.03, 0.06), (0.03, 0.7), (0.4, 0.7), (0.4, 0.73), (0.0, 0.73)];
    let tables = Shape::new(paints.iron).lathe(&top, around, 1, false);
    let mut chairs = Shape::new(paints.wood);
    for turn in 0..4 {
        let mut chair = Shape::new(paints.wood).cuboid(DVec3::new(-0.2, 0.43, 0.0), DVec3::new(0.2, 0.46, 0.4));
        for (x, z, y) in [(-0.2, 0.0, 0.43), (0.17, 0.0, 0.43), (-0.2, 0.37, 0.9), (0.17, 0.37, 0.9)] {
            chair = chair.cuboid(DVec3::new(x, 0.0, z), DVec3::new(x + 0.03, y, z + 0.03));
        }
        for k in 0..4 {
            let y = 0.55 + 0.1 * f64::from(k);
            chair = chair.cuboid(DVec3::new(-0.18, y, 0.375), DVec3::new(0.18, y + 0.05, 0.395));
        }
        let yaw = DQuat::from_rotation_y(f64::to_radians(90.0 * f64::from(turn) + 20.0));
        chairs = chairs.with(chair.moved(DAffine3::from_rotation_translation(yaw, yaw * (DVec3::Z * 0.55))));
    }
    draft.mesh("table", [tables, chairs])
}

/// A stall: posts, a striped roof of cloth, crates of fruit.
fn stall(draft: &mut Draft, paints: &Paints, tint: [f32; 3], detail: u32) -> u32 {
    let cloth = draft.paint(Pattern::Cloth, tint);
    let pale = draft.paint(Pattern::Cloth, [0.95, 0.93, 0.88]);
    let fruit = draft.paint(Pattern::Plaster, [tint[0] * 1.1, tint[1] * 0.9, tint[2] * 0.5]);
    let mut wood = Shape::new(paints.wood).cuboid(DVec3::new(-1.4, 0.75, -0.8), DVec3::new(1.4, 0.8, 0.8));
    for (x, z) in [(-1.45, -0.85), (1.4, -0.85), (-1.45, 0.8), (1.4, 0.8)] {
        wood = wood.cuboid(DVec3::new(x, 0.0, z), DVec3::new(x + 0.05, 2.3, z + 0.05));
    }
    let mut stripes = [Shape::new(cloth), Shape::new(pale)];
    for k in 0..12u32 {
        let x = -1.7 + 0.2833 * f64::from(k);
        let roof = |s: Shape| {
            s.patch(1, 6, |u, v| {
                // It hangs through a little between the beams.
                let sag = 0.12 * (v * 6.0 * std::f64::consts::PI / 6.0).sin();
                let p = DVec3::new(x + 0.2833 * u, 2.75 - 0.45 * (2.0 * v - 1.0).abs() - sag, 1.1 - 2.2 * v);
                (p, DVec3::Y, (p.x, p.z))
            })
            .cuboid(DVec3::new(x, 2.1, 1.09), DVec3::new(x + 0.2833, 2.31, 1.1))
        };
        let stripe = &mut stripes[(k % 2) as usize];
        *stripe = roof(std::mem::take(stripe));
    }
    let mut fruits = Shape::new(fruit);
    let balls = 6 + detail / 30;
    for crate_at in 0..3 {
        let low = DVec3::new(-1.3 + 0.9 * f64::from(crate_at), 0.8, -0.6);
        for (a, b) in [
            (DVec3::ZERO, DVec3::new(0.8, 0.25, 0.02)),
            (DVec3::Z * 1.18, DVec3::new(0.8, 0.25, 1.2)),
            (DVec3::ZERO, DVec3::new(0.02, 0.25, 1.2)),
            (DVec3::X * 0.78, DVec3::new(0.8, 0.25, 1.2)),
        ] {
            wood = wood.cuboid(low + a, low + b);
        }
        for i in 0..6 {
            for k in 0..9 {
                let at = low + DVec3::new(0.1 + 0.12 * f64::from(i), 0.2, 0.1 + 0.125 * f64::from(k));
                fruits = fruits.ball(at, 0.058, balls, balls / 2 + 1);
            }
        }
    }
    let [a, b] = stripes;
    draft.mesh("stall", [wood, a, b, fruits])
}

/// Places church, fountain, stalls, tables and trees on the block around the origin.
pub fn build(
    draft: &mut Draft,
    random: &mut Random,
    paints: &Paints,
    furniture: &Furniture,
    trees: &[u32],
    detail: u32,
) {
    let church = church(draft, paints, detail);
    draft.place(church, DVec3::new(2.0, 0.0, -10.0), 0.0, 1.0);
    let fountain = fountain(draft, paints, detail);
    draft.place(fountain, DVec3::new(-2.0, 0.0, 17.0), 0.0, 1.0);
    // Two rows of stalls, and a passage between them for the walk.
    for k in 0..5 {
        for (z, yaw) in [(5.6, 0.0), (14.6, 180.0)] {
            let x = -11.0 + 4.6 * f64::from(k);
            if z < 10.0 || !(-6.0..2.0).contains(&x) {
                let at = DVec3::new(x, 0.0, z + random.within(-0.3, 0.3));
                draft.place(furniture.stalls[random.below(4)], at, yaw + random.within(-4.0, 4.0), 1.0);
            }
        }
    }
    for k in 0..6 {
        let at = DVec3::new(-18.5 + random.within(-0.4, 0.4), 0.0, -16.0 + 3.2 * f64::from(k));
        draft.place(furniture.table, at, random.within(0.0, 90.0), 1.0);
        draft.place(furniture.table, at + DVec3::X * 3.0, random.within(0.0, 90.0), 1.0);
    }
    for k in 0..5 {
        let z = -18.0 + 8.0 * f64::from(k);
        draft.place(trees[random.below(trees.len())], DVec3::new(18.5, 0.0, z), 70.0 * f64::from(k), 1.0);
        draft.place(furniture.bench, DVec3::new(17.0, 0.0, z + 4.0), -90.0, 1.0);
    }
    for k in 0..14 {
        let along = -19.5 + 3.0 * f64::from(k);
        for at in [DVec3::new(along, 0.0, 20.5), DVec3::new(along, 0.0, -20.5)] {
            draft.place(furniture.bollard, at, 0.0, 1.0);
        }
    }
}

/// What stands on the pavement around a block.
pub fn street(draft: &mut Draft, random: &mut Random, furniture: &Furniture, trees: &[u32], centre: DVec3) {
    let edge = BLOCK * 0.5 + 1.5;
    for side in 0..4 {
        let yaw = 90.0 * f64::from(side);
        let turn = DQuat::from_rotation_y(yaw.to_radians());
        for k in 0..5 {
            let along = -16.0 + 8.0 * f64::from(k) + random.within(-0.5, 0.5);
            let at = centre + turn * DVec3::new(along, KERB, edge);
            match (k + side) % 3 {
                0 => draft.place(furniture.lamp, at, 0.0, 1.0),
                1 if random.below(2) == 0 => draft.place(trees[random.below(trees.len())], at, yaw, 0.6),
                1 => draft.place(furniture.bench, at - turn * (DVec3::Z * 0.6), yaw, 1.0),
                _ => draft.place(furniture.bollard, at, 0.0, 1.0),
            }
        }
    }
}

fn fountain(draft: &mut Draft, paints: &Paints, detail: u32) -> u32 {
    let around = 16 + detail / 3;
    let basin = [(2.4, 0.0), (2.4, 0.5), (2.5, 0.55), (2.5, 0.65), (2.2, 0.65), (2.2, 0.35), (0.5, 0.35)];
    let column = [(0.5, 0.3), (0.3, 0.6), (0.22, 1.6), (1.0, 1.9), (1.05, 2.0), (0.2, 1.95), (0.12, 2.7), (0.0, 2.9)];
    let water = draft.paint(Pattern::Plaster, [0.25, 0.4, 0.45]);
    let mesh = [
        Shape::new(paints.stone).lathe(&basin, around, 1, false).lathe(&column, around, 2, true),
        Shape::new(water).lathe(&[(2.3, 0.48), (0.3, 0.48)], around, 1, false),
    ];
    draft.mesh("fountain", mesh)
}

/// A church with a nave along X and a tower at its west end; about 46 m high.
fn church(draft: &mut Draft, paints: &Paints, detail: u32) -> u32 {
    let around = 12 + detail / 4;
    let (mut stone, mut glass) = (Shape::new(paints.stone), Shape::new(paints.glass));
    let (length, width, wall) = (18.0, 11.0, 9.0);
    stone = stone.cuboid(DVec3::new(-6.0, 0.0, -width * 0.5), DVec3::new(-6.0 + length, wall, width * 0.5));
    let roof = houses::roof(paints.slate, DVec3::new(-6.0, wall, width * 0.5 + 0.4), length, width + 0.8, 6.5, detail);
    // Gables, buttresses and tall windows with tracery.
    for x in [-6.0, -6.0 + length - 0.4] {
        for k in 0..20 {
            let (y, half) = (wall + 6.3 * f64::from(k) / 20.0, width * 0.5 * (1.0 - f64::from(k + 1) / 20.0));
            stone = stone.cuboid(DVec3::new(x, y, -half), DVec3::new(x + 0.4, y + 0.32, half));
        }
    }
    for k in 0..5 {
        let x = -4.0 + 3.5 * f64::from(k);
        for side in [-1.0, 1.0] {
            let z = side * width * 0.5;
            let (near, far) = (z - 0.02 * side, z + 0.9 * side);
            let b = |y: f64, out: f64| {
                (DVec3::new(x - 0.3, 0.0, near.min(z + out * side)), DVec3::new(x + 0.3, y, near.max(z + out * side)))
            };
            for (low, high) in [b(8.0, 0.5), b(5.0, (far - z).abs())] {
                stone = stone.cuboid(low, high);
            }
            let middle = x + 1.75;
            if k < 4 {
                let pane = z + 0.03 * side;
                let (a, c) = (DVec3::new(middle - 0.6, 2.5, pane.min(z)), DVec3::new(middle + 0.6, 7.0, pane.max(z)));
                glass = glass.cuboid(a, c);
                for bar in 0..4 {
                    let bx = middle - 0.65 + 0.4 * f64::from(bar);
                    let out = z + 0.1 * side;
                    stone = stone.cuboid(DVec3::new(bx, 2.4, out.min(z)), DVec3::new(bx + 0.1, 7.2, out.max(z)));
                }
            }
        }
    }
    // The tower, its bell windows and the spire.
    let tower = DVec3::new(-9.0, 0.0, 0.0);
    for (half, from, to) in [(3.4, 0.0, 9.0), (3.1, 9.0, 18.0), (3.2, 18.0, 18.5), (2.8, 18.5, 26.0), (3.1, 26.0, 26.6)]
    {
        stone = stone.cuboid(tower + DVec3::new(-half, from, -half), tower + DVec3::new(half, to, half));
    }
    for side in 0..4 {
        let turn = DQuat::from_rotation_y(f64::to_radians(90.0 * f64::from(side)));
        let by = DAffine3::from_rotation_translation(turn, tower);
        let (mut panes, mut bars) = (Shape::new(paints.glass), Shape::new(paints.stone));
        for x in [-1.6, 0.4] {
            panes = panes.cuboid(DVec3::new(x, 20.0, 2.8), DVec3::new(x + 1.2, 24.5, 2.83));
            for k in 0..10 {
                let y = 20.0 + 0.45 * f64::from(k);
                bars = bars.cuboid(DVec3::new(x, y, 2.8), DVec3::new(x + 1.2, y + 0.08, 2.95));
            }
        }
        let clock = Shape::new(paints.iron).lathe(&[(1.1, 0.0), (1.1, 0.08), (0.0, 0.08)], around, 1, false).moved(
            DAffine3::from_rotation_translation(
                DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2),
                DVec3::new(0.0, 14.5, 3.1),
            ),
        );
        glass = glass.with(panes.moved(by));
        stone = stone.with(bars.moved(by)).with(clock.moved(by));
        let pinnacle = Shape::new(paints.stone)
            .lathe(&[(0.35, 26.6), (0.35, 28.2), (0.45, 28.3), (0.0, 30.5)], 8, 1, false)
            .moved(by * DAffine3::from_translation(DVec3::new(2.6, 0.0, 2.6)));
        stone = stone.with(pinnacle);
    }
    let door = Shape::new(paints.wood).cuboid(DVec3::new(-12.5, 0.0, -1.1), DVec3::new(-12.38, 3.4, 1.1));
    let spire = Shape::new(paints.slate)
        .lathe(&[(2.9, 26.6), (2.2, 29.0), (1.2, 36.0), (0.1, 45.5), (0.0, 46.0)], 8 + detail / 8, 4, false)
        .moved(DAffine3::from_translation(tower));
    draft.mesh("church", [stone, glass, door, spire, roof])
}
