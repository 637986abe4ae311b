//! A city of solid houses on an island, as city models bring: nothing is inside the houses.

use super::Specimen;
use super::furniture::Furniture;
use super::kit::{Pattern, Shape, Shapes, Site, at, smoothstep, spaced};
use glam::DVec3;

/// Blocks along each side.
const BLOCKS: i32 = 6;
/// From block to block: 8 m of street, 2 + 28 + 2 m of pavement and houses.
const PITCH_M: f64 = 40.0;
/// Height of the pavements above the streets.
const PAVEMENT_M: f64 = 0.15;
/// The island's edge on each side; the quay lies toward +Z.
const EDGE_M: f64 = 140.0;
/// Height of the sea.
const SEA_M: f64 = -1.5;

/// Height of the roof of house `h` in a block: three storeys or more.
fn roof_m(i: i32, k: i32, h: i32) -> f64 {
    PAVEMENT_M + 10.0 + 2.2 * f64::from((i * 5 + k * 3 + h * 7).rem_euclid(6))
}

/// Middle of a block.
fn block(i: i32, k: i32) -> DVec3 {
    let m = |i: i32| (f64::from(i) - 0.5 * f64::from(BLOCKS - 1)) * PITCH_M;
    at(m(i), PAVEMENT_M, m(k))
}

/// Streets, pavements and docks around solid houses; sea floor, sea and far hills.
pub(super) fn island_city() -> Specimen {
    let mut site = Site::new();
    let asphalt = site.plain([0.12, 0.12, 0.13]);
    let slabs = site.paint(Pattern::Tile, [0.55, 0.54, 0.52]);
    let quay = site.paint(Pattern::Concrete, [0.8, 0.78, 0.72]);
    let planks = site.paint(Pattern::Wood, [0.6, 0.5, 0.4]);
    let walls = [
        site.paint(Pattern::Plaster, [0.85, 0.7, 0.5]),
        site.paint(Pattern::Brick, [0.8, 0.7, 0.65]),
        site.paint(Pattern::Plaster, [0.6, 0.7, 0.75]),
        site.paint(Pattern::Plaster, [0.8, 0.55, 0.45]),
    ];
    let frame = site.plain([0.85, 0.83, 0.78]);
    let glass = site.plain([0.08, 0.12, 0.18]);
    let door = site.plain([0.3, 0.12, 0.08]);
    let water = site.plain([0.05, 0.16, 0.22]);
    let sand = site.plain([0.45, 0.4, 0.28]);
    let hill = site.plain([0.2, 0.32, 0.16]);
    let metal = site.plain([0.2, 0.22, 0.22]);
    let pieces = Furniture::new(&mut site);

    let ground = Shape::new(asphalt).solid(at(-EDGE_M, -22.0, -EDGE_M), at(EDGE_M, 0.0, EDGE_M - 16.0));
    let quay = Shape::new(quay).solid(at(-EDGE_M, -22.0, EDGE_M - 16.0), at(EDGE_M, 0.0, EDGE_M));
    site.put("island", [ground, quay]);
    let flat =
        |y: f64| [at(-1500.0, y, 1500.0), at(1500.0, y, 1500.0), at(1500.0, y, -1500.0), at(-1500.0, y, -1500.0)];
    site.put("sea", [Shape::new(water).quad(flat(SEA_M)), Shape::new(sand).quad(flat(SEA_M - 20.0))]);
    let hills = Shape::new(hill).ground(
        &spaced(-1500.0, 1500.0, 20),
        &spaced(-1500.0, -800.0, 8),
        |x, z| {
            let inland = smoothstep(-850.0, -1300.0, z);
            -22.0 + inland * (110.0 + 50.0 * (x * 0.006).sin() + 25.0 * (x * 0.017 + z * 0.01).cos())
        },
        |_, _| true,
    );
    site.put("hills", [hills.shaded(|p| 0.7 + 0.3 * (p.x * 0.02).sin() * (p.z * 0.03).cos())]);

    // A window: a frame and a pane, both closed boxes, half sunk into the wall (toward -Z).
    let pane = site.draft.mesh(
        "window",
        [
            Shape::new(frame).boxed(at(0.0, 0.0, 0.0), at(0.6, 0.75, 0.06)),
            Shape::new(glass).boxed(at(0.0, 0.0, 0.02), at(0.5, 0.65, 0.06)),
        ],
    );
    let leaf = site.draft.mesh(
        "door",
        [
            Shape::new(frame).boxed(at(0.0, 1.1, 0.0), at(0.65, 1.1, 0.06)),
            Shape::new(door).boxed(at(0.0, 1.02, 0.02), at(0.5, 1.02, 0.06)),
        ],
    );
    let lamp = site.draft.mesh(
        "street lamp",
        [
            Shape::new(metal).lathe(&[(0.0, 0.0), (0.12, 0.0), (0.06, 0.6), (0.05, 4.0), (0.0, 4.0)], 8, 1, false),
            Shape::new(frame).blob(at(0.0, 4.15, 0.0), at(0.22, 0.2, 0.22), 8, 5),
        ],
    );
    for i in 0..BLOCKS {
        for k in 0..BLOCKS {
            let middle = block(i, k);
            let mut pavement =
                vec![Shape::new(slabs).solid(middle - at(16.0, 0.15, 16.0), middle + at(16.0, 0.0, 16.0))];
            for h in 0..4 {
                let (sx, sz) = (f64::from(h % 2 * 2 - 1), f64::from(h / 2 * 2 - 1));
                let centre = middle + at(8.0 * sx, 0.0, 8.0 * sz);
                let roof = roof_m(i, k, h);
                let wall = walls[(i * 2 + k + h).rem_euclid(4) as usize];
                pavement.push(
                    Shape::new(wall).solid(centre - at(6.0, 0.0, 6.0), at(centre.x + 6.0, roof, centre.z + 6.0)).solid(
                        at(centre.x - 6.2, roof, centre.z - 6.2),
                        at(centre.x + 6.2, roof + 0.3, centre.z + 6.2),
                    ),
                );
                // Windows toward the two streets, doors toward one.
                for (out, yaw) in [(at(sx, 0.0, 0.0), 90.0 * sx), (at(0.0, 0.0, sz), 90.0 - 90.0 * sz)] {
                    let along = at(out.z, 0.0, out.x);
                    for storey in 0..3 {
                        for &column in if storey < 2 { &[-3.0, 3.0][..] } else { &[0.0] } {
                            let place =
                                centre + out * 6.0 + along * column + DVec3::Y * (1.7 + 3.1 * f64::from(storey));
                            site.place(pane, place, yaw);
                        }
                    }
                    if out.x != 0.0 {
                        site.place(leaf, centre + out * 6.0, yaw);
                    }
                }
            }
            site.put("block", pavement);
            site.place(lamp, middle + at(15.3, 0.0, 15.3), 0.0);
            if (i + k) % 2 == 0 {
                site.place(pieces.tree, middle + at(-15.2, 0.0, 0.0), 40.0 * f64::from(i + 3 * k));
            }
        }
    }

    // The dock: planks on piles, 0.3 m above the quay and out over the sea.
    let mut dock = Shape::new(planks).solid(at(-30.0, 0.1, EDGE_M - 5.0), at(30.0, 0.3, EDGE_M + 4.0));
    dock = dock.solid(at(-3.0, 0.1, EDGE_M + 4.0), at(3.0, 0.3, EDGE_M + 40.0));
    let mut piles = Shape::new(metal);
    for k in 0..9 {
        let x = -28.0 + 7.0 * f64::from(k);
        let z = EDGE_M + 8.0 + 4.0 * f64::from(k);
        piles = piles.rod(at(x, -21.5, EDGE_M + 3.5), at(x, 0.9, EDGE_M + 3.5), 0.2, 8);
        for x in [-2.8, 2.8] {
            piles = piles.rod(at(x, -21.5, z.min(EDGE_M + 39.5)), at(x, 0.9, z.min(EDGE_M + 39.5)), 0.15, 8);
        }
    }
    let mut crates = Shape::new(door);
    for (x, z, s) in
        [(-25.0, 137.0, 0.6), (-23.4, 137.3, 0.5), (-25.0, 139.0, 0.45), (18.0, 131.0, 0.8), (20.0, 131.0, 0.6)]
    {
        let y = if z > EDGE_M - 5.0 { 0.3 } else { 0.0 };
        crates = crates.boxed(at(x, y + s, z), at(s, s, s));
    }
    site.put("dock", [dock, piles, crates]);

    let street = |x: f64, z: f64| at(x, 0.0, z);
    site.stand([
        street(0.0, 0.0),
        street(0.0, 55.0),
        street(-80.0, 20.0),
        street(40.0, 0.0),
        street(80.0, -90.0),
        block(3, 3) + at(15.0, 0.0, 4.0),
        block(1, 4) + at(3.0, 0.0, -15.0),
        // The alleys between the houses of a block.
        block(2, 2),
        block(3, 1) + at(0.0, 0.0, 9.0),
        street(-60.0, EDGE_M - 8.0),
        at(10.0, 0.3, EDGE_M),
        at(-12.0, 0.3, EDGE_M + 2.0),
        at(0.0, 0.3, EDGE_M + 25.0),
    ]);
    let house = |i: i32, k: i32, h: i32, y: f64| {
        let m = block(i, k) + at(f64::from(h % 2 * 2 - 1) * 8.0, 0.0, f64::from(h / 2 * 2 - 1) * 8.0);
        at(m.x, y, m.z)
    };
    site.never_stand([
        house(2, 2, 0, roof_m(2, 2, 0) + 0.3),
        house(3, 4, 3, roof_m(3, 4, 3) + 0.3),
        house(0, 0, 1, roof_m(0, 0, 1) + 0.3),
        house(2, 2, 0, PAVEMENT_M),
        house(4, 1, 2, PAVEMENT_M),
        house(3, 3, 1, PAVEMENT_M),
        at(0.0, SEA_M - 20.0, EDGE_M + 60.0),
        at(-400.0, SEA_M - 20.0, 0.0),
        at(0.0, SEA_M - 20.0, EDGE_M + 20.0),
    ]);
    site.specimen("island_city")
}
