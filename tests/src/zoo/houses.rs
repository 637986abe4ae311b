//! Furnished houses: on a hill, with floors offset by half storeys, and far from the origin.

use super::Specimen;
use super::furniture::Furniture;
use super::kit::{Pattern, Shape, Shapes, Site, at, smoothstep, spaced};
use glam::DVec3;

/// Height of a room, metres.
const ROOM_M: f64 = 2.6;
/// Opening of an inner door at a distance along its wall.
const fn door(middle: f64) -> [f64; 4] {
    [middle, 0.95, 0.0, 2.1]
}
/// Opening of a window at a distance along its wall.
const fn window(middle: f64) -> [f64; 4] {
    [middle, 1.4, 0.9, 2.2]
}

/// Materials of a house.
struct Finish {
    outer: u32,
    inner: u32,
    floor: u32,
    roof: u32,
    wood: u32,
    stone: u32,
    grass: u32,
}

impl Finish {
    fn new(site: &mut Site) -> Self {
        Self {
            outer: site.paint(Pattern::Brick, [0.9, 0.8, 0.7]),
            inner: site.paint(Pattern::Plaster, [0.9, 0.88, 0.8]),
            floor: site.paint(Pattern::Wood, [0.9, 0.75, 0.6]),
            roof: site.paint(Pattern::Tile, [0.6, 0.25, 0.2]),
            wood: site.paint(Pattern::Wood, [0.5, 0.35, 0.25]),
            stone: site.paint(Pattern::Tile, [0.7, 0.7, 0.68]),
            grass: site.plain([0.25, 0.4, 0.15]),
        }
    }
}

/// A gable roof over a rectangle about the origin: two slabs and two gables, all closed. Nobody can
/// stand below it.
fn gable(roof: Shape, half_x: f64, half_z: f64, eaves_y: f64) -> Shape {
    let (over, rise, thick) = (0.5, half_z * 0.3, DVec3::Y * 0.15);
    let slope = rise / half_z;
    let mut roof = roof;
    for side in [-1.0, 1.0] {
        let edge = |x: f64| at(x, eaves_y - over * slope, side * (half_z + over));
        let ridge = |x: f64| at(x, eaves_y + rise, 0.0);
        let x = half_x + over;
        // Counter-clockwise seen from above.
        let lower = if side > 0.0 {
            [edge(-x), edge(x), ridge(x), ridge(-x)]
        } else {
            [edge(x), edge(-x), ridge(-x), ridge(x)]
        };
        roof = roof.block(lower, lower.map(|p| p + thick));
        // A gable, its upper edge no wider than the ridge.
        let (a, b) = (side * half_x - 0.12, side * half_x + 0.12);
        let rectangle = |y: f64, z: f64| [at(a, y, z), at(b, y, z), at(b, y, -z), at(a, y, -z)];
        roof = roof.block(rectangle(eaves_y, half_z), rectangle(eaves_y + rise, 0.01));
    }
    roof
}

/// A furnished house with a terrace on a hill, in a terrain 2 km wide of few large triangles.
pub(super) fn hill_house() -> Specimen {
    let mut site = Site::new();
    let f = Finish::new(&mut site);
    let pieces = Furniture::new(&mut site);

    // Walls: five rooms, the bathroom (x > 2.5, z < 0) behind a closed door.
    let front = [[3.5, 1.6, 0.0, 2.2], [9.5, 1.6, 0.9, 2.2]];
    let outer = Shape::new(f.outer)
        .wall(at(-6.125, 0.0, 4.5), at(6.125, 0.0, 4.5), ROOM_M, 0.25, &front)
        .wall(at(-6.125, 0.0, -4.5), at(6.125, 0.0, -4.5), ROOM_M, 0.25, &[window(2.5), window(6.6), window(10.4)])
        .wall(at(-6.0, 0.0, -4.375), at(-6.0, 0.0, 4.375), ROOM_M, 0.25, &[window(2.2), window(6.5)])
        .wall(at(6.0, 0.0, -4.375), at(6.0, 0.0, 4.375), ROOM_M, 0.25, &[window(6.5)]);
    let inner = Shape::new(f.inner)
        .wall(at(-5.875, 0.0, 0.0), at(5.875, 0.0, 0.0), ROOM_M, 0.12, &[door(1.9), door(6.4), door(10.4)])
        .wall(at(-1.5, 0.0, -4.375), at(-1.5, 0.0, -0.06), ROOM_M, 0.12, &[])
        .wall(at(2.5, 0.0, -4.375), at(2.5, 0.0, -0.06), ROOM_M, 0.12, &[])
        .wall(at(1.0, 0.0, 0.06), at(1.0, 0.0, 4.375), ROOM_M, 0.12, &[[2.2, 1.4, 0.0, 2.2]]);
    let leaf = Shape::new(f.wood).boxed(at(4.525, 1.05, 0.0), at(0.475, 1.05, 0.03)).blob(
        at(4.15, 1.0, 0.06),
        at(0.05, 0.03, 0.04),
        10,
        6,
    );
    let floor = Shape::new(f.floor).solid(at(-6.125, -1.2, -4.625), at(6.125, 0.0, 4.625));
    let ceiling = Shape::new(f.inner).solid(at(-6.125, ROOM_M, -4.625), at(6.125, ROOM_M + 0.2, 4.625));
    let roof = gable(Shape::new(f.roof), 6.125, 4.625, ROOM_M + 0.2);
    site.put("house", [outer, inner, leaf, floor, ceiling, roof]);

    // The terrace, and three risers of 0.2 m down to the garden.
    let mut terrace = Shape::new(f.stone).solid(at(-6.0, -1.2, 4.625), at(2.0, 0.0, 8.5));
    for (k, y) in [(1.0, -0.2), (0.0, -0.4)] {
        terrace = terrace.solid(at(-4.0, -1.2, 8.5), at(0.0, y, 9.2 - k * 0.35));
    }
    let rails = Shape::new(f.wood)
        .railing(at(-5.95, 0.0, 4.7), at(-5.95, 0.0, 8.45))
        .railing(at(1.95, 0.0, 4.7), at(1.95, 0.0, 8.45))
        .railing(at(0.1, 0.0, 8.45), at(1.9, 0.0, 8.45));
    site.put("terrace", [terrace, rails]);

    // Flat for 30 m around the house, then down the hill; more hills far away.
    let height = |x: f64, z: f64| {
        let out = (x.abs().max(z.abs()) - 30.0).max(0.0);
        let hills = smoothstep(350.0, 750.0, out) * (70.0 + 40.0 * (x / 170.0).sin() * (z / 210.0).cos());
        -0.6 - 45.0 * smoothstep(0.0, 260.0, out) + hills
    };
    let half = [10.0, 20.0, 30.0, 45.0, 70.0, 110.0, 170.0, 250.0, 350.0, 470.0, 600.0, 750.0, 880.0, 1000.0];
    let lines: Vec<f64> = half.iter().rev().map(|x| -x).chain([0.0]).chain(half).collect();
    let land = Shape::new(f.grass).ground(&lines, &lines, height, |_, _| true);
    site.put("land", [land.shaded(|p| 0.8 + 0.2 * (p.x * 0.013).sin() * (p.z * 0.017).cos())]);

    let up = |x: f64, z: f64| at(x, 0.0, z);
    site.place(pieces.bed, up(-4.9, -3.2), 0.0);
    site.place(pieces.wardrobe, up(-1.95, -3.4), -90.0);
    site.place(pieces.lamp, up(-5.5, -1.4), 0.0);
    pieces.workplace(&mut site, up(0.5, -3.9), 0.0);
    site.place(pieces.shelf, up(2.2, -2.0), -90.0);
    site.place(pieces.shelf, up(-1.2, -2.4), 90.0);
    site.place(pieces.wardrobe, up(5.5, -3.0), -90.0);
    site.place(pieces.plant, up(3.0, -4.0), 0.0);
    site.place(pieces.sofa, up(-5.3, 2.2), 90.0);
    site.place(pieces.table, up(-3.6, 2.2), 90.0);
    site.place(pieces.shelf, up(-0.2, 0.35), 0.0);
    site.place(pieces.plant, up(0.5, 4.0), 0.0);
    pieces.dining(&mut site, up(4.0, 2.6), 0);
    site.place(pieces.shelf, up(1.3, 3.9), 90.0);
    pieces.dining(&mut site, up(0.2, 6.6), 1);
    site.place(pieces.sofa, up(-5.2, 6.6), 90.0);
    for k in 0..14 {
        let (s, c) = (f64::from(k) * 0.9).sin_cos();
        let r = 15.0 + 3.0 * f64::from(k % 4);
        site.place(pieces.tree, at(r * c, -0.6, r * s), f64::from(k) * 50.0);
    }

    site.stand([
        at(-2.9, 0.0, -2.0),
        at(0.4, 0.0, -2.0),
        at(4.0, 0.0, -2.0),
        at(-2.0, 0.0, 3.0),
        at(2.2, 0.0, 1.2),
        at(5.3, 0.0, 3.6),
        at(1.0, 0.0, 2.2),
        at(-2.6, 0.0, 4.5),
        at(-2.0, 0.0, 6.8),
        at(-2.0, -0.2, 8.67),
        at(-2.0, -0.6, 11.0),
        at(9.0, -0.6, 2.0),
        at(-9.0, -0.6, -3.0),
        at(1.0, -0.6, -7.5),
    ]);
    site.never_stand([
        at(-3.6, 0.75, 2.2),
        at(4.0, 0.75, 2.6),
        at(0.2, 0.75, 6.6),
        at(0.0, ROOM_M + 1.74, 0.0),
        at(2.0, ROOM_M + 1.05, 2.3),
        at(800.0, height(800.0, 0.0), 0.0),
        at(-20.0, height(-20.0, -800.0), -800.0),
    ]);
    site.specimen("hill_house")
}

/// A house of four floors, each half a storey above the last, joined by short stairs; the highest
/// is a mezzanine.
pub(super) fn split_level() -> Specimen {
    let mut site = Site::new();
    let f = Finish::new(&mut site);
    let pieces = Furniture::new(&mut site);
    const TOP_M: f64 = 6.8;
    // Floors: west at 0 and 2.8, east at 1.4 and, for z < 0, 4.2.
    let upper = |m: f64| [m, 1.4, 3.7, 5.2];
    let east = |m: f64| [m, 1.4, 2.3, 3.6];
    let outer = Shape::new(f.outer)
        .wall(at(-6.0, 0.0, -4.375), at(-6.0, 0.0, 4.375), TOP_M, 0.25, &[[2.0, 1.4, 0.9, 2.2], [5.2, 1.1, 0.0, 2.1]])
        .wall(at(6.0, 0.0, -4.375), at(6.0, 0.0, 4.375), TOP_M, 0.25, &[east(2.0), east(6.5)])
        .wall(at(-6.125, 0.0, -4.5), at(6.125, 0.0, -4.5), TOP_M, 0.25, &[upper(2.5), east(8.5)])
        .wall(at(-6.125, 0.0, 4.5), at(6.125, 0.0, 4.5), TOP_M, 0.25, &[upper(2.5), east(9.5)]);
    let roof = Shape::new(f.roof).solid(at(-6.5, TOP_M, -5.0), at(6.5, TOP_M + 0.25, 5.0));
    let floors = Shape::new(f.floor)
        .solid(at(-6.125, -0.5, -4.625), at(0.0, 0.0, 4.625))
        .solid(at(0.0, -0.5, -4.625), at(6.125, 1.4, 4.625))
        // The west upper floor leaves a hole over the first stairs.
        .solid(at(-5.875, 2.55, -4.375), at(0.0, 2.8, 3.0))
        .solid(at(-5.875, 2.55, 3.0), at(-2.6, 2.8, 4.375))
        .solid(at(0.0, 3.95, -4.375), at(5.875, 4.2, 0.0));
    let step = at(0.27, 0.175, 1.1);
    let stairs = Shape::new(f.wood)
        .flight(at(-1.89, 0.0, 3.7), DVec3::X, 7, step)
        .flight(at(1.89, 1.4, 2.2), DVec3::NEG_X, 7, step)
        .flight(at(-1.89, 2.8, -3.7), DVec3::X, 7, step);
    let rails = Shape::new(f.wood)
        .railing(at(-0.05, 2.8, -3.05), at(-0.05, 2.8, 1.6))
        .railing(at(-2.6, 2.8, 2.95), at(-0.05, 2.8, 2.95))
        .railing(at(-2.65, 2.8, 3.0), at(-2.65, 2.8, 4.35))
        .railing(at(0.05, 4.2, -0.05), at(5.85, 4.2, -0.05))
        .railing(at(0.05, 4.2, -3.05), at(0.05, 4.2, -0.1));
    site.put("house", [outer, roof, floors, stairs, rails]);
    let lawn =
        Shape::new(f.grass).ground(&spaced(-30.0, 30.0, 20), &spaced(-30.0, 30.0, 20), |_, _| -0.05, |_, _| true);
    site.put("lawn", [lawn.shaded(|p| 0.8 + 0.2 * (p.x * 0.7).sin() * (p.z * 0.9).cos())]);

    site.place(pieces.sofa, at(-5.3, 0.0, -2.6), 90.0);
    site.place(pieces.table, at(-3.9, 0.0, -2.6), 90.0);
    site.place(pieces.shelf, at(-2.0, 0.0, -4.1), 0.0);
    site.place(pieces.lamp, at(-5.4, 0.0, -4.0), 0.0);
    pieces.dining(&mut site, at(4.2, 1.4, 0.2), 1);
    site.place(pieces.shelf, at(3.0, 1.4, 4.1), 180.0);
    site.place(pieces.plant, at(5.4, 1.4, 4.0), 0.0);
    site.place(pieces.wardrobe, at(4.5, 1.4, -4.0), 0.0);
    site.place(pieces.bed, at(-4.9, 2.8, -1.0), 90.0);
    site.place(pieces.wardrobe, at(-4.6, 2.8, -4.0), 0.0);
    site.place(pieces.plant, at(-5.4, 2.8, 4.0), 0.0);
    pieces.workplace(&mut site, at(3.6, 4.2, -3.9), 0.0);
    site.place(pieces.shelf, at(5.6, 4.2, -1.5), -90.0);
    site.place(pieces.sofa, at(1.5, 4.2, -3.0), 90.0);
    for k in 0..8 {
        let (s, c) = (f64::from(k) * 0.85 + 0.3).sin_cos();
        site.place(pieces.tree, at(15.0 * c, -0.05, 13.0 * s), f64::from(k) * 50.0);
    }

    site.stand([
        at(-2.5, 0.0, -1.0),
        at(-4.5, 0.0, 0.8),
        at(-3.0, 0.0, 3.7),
        at(-0.95, 0.7, 3.7),
        at(1.0, 1.4, 3.6),
        at(2.0, 1.4, -2.0),
        at(0.95, 2.1, 2.2),
        at(-1.0, 2.8, 2.2),
        at(-2.5, 2.8, -2.0),
        at(-0.95, 3.5, -3.7),
        at(2.5, 4.2, -1.2),
        at(-9.0, -0.05, 0.8),
        at(0.0, -0.05, -9.0),
    ]);
    site.never_stand([
        at(-3.9, 0.75, -2.6),
        at(4.2, 2.15, 0.2),
        at(0.0, TOP_M + 0.25, 0.0),
        at(-4.0, TOP_M + 0.25, 3.0),
        // In the air before the mezzanine.
        at(3.0, 4.2, 2.2),
    ]);
    site.specimen("split_level")
}

/// A small furnished house at coordinates of a national grid; vertices are local, nodes are
/// translated.
pub(super) fn far_origin() -> Specimen {
    let mut site = Site::new();
    let f = Finish::new(&mut site);
    let pieces = Furniture::new(&mut site);
    let outer = Shape::new(f.outer)
        .wall(at(-4.125, 0.0, 3.0), at(4.125, 0.0, 3.0), ROOM_M, 0.25, &[[2.0, 1.2, 0.0, 2.1], [6.0, 1.6, 0.9, 2.2]])
        .wall(at(-4.125, 0.0, -3.0), at(4.125, 0.0, -3.0), ROOM_M, 0.25, &[window(2.0), window(6.3)])
        .wall(at(-4.0, 0.0, -2.875), at(-4.0, 0.0, 2.875), ROOM_M, 0.25, &[window(2.9)])
        .wall(at(4.0, 0.0, -2.875), at(4.0, 0.0, 2.875), ROOM_M, 0.25, &[window(2.9)]);
    let inner = Shape::new(f.inner).wall(at(0.3, 0.0, -2.875), at(0.3, 0.0, 2.875), ROOM_M, 0.12, &[door(3.6)]);
    let floor = Shape::new(f.floor).solid(at(-4.125, -0.4, -3.125), at(4.125, 0.0, 3.125));
    let ceiling = Shape::new(f.inner).solid(at(-4.125, ROOM_M, -3.125), at(4.125, ROOM_M + 0.2, 3.125));
    let roof = gable(Shape::new(f.roof), 4.125, 3.125, ROOM_M + 0.2);
    site.put("house", [outer, inner, floor, ceiling, roof]);
    let lines = spaced(-30.0, 30.0, 24);
    let lawn = Shape::new(f.grass).ground(
        &lines,
        &lines,
        |x, z| -0.1 - 0.012 * (x.hypot(z) - 8.0).max(0.0).powi(2) / 4.0,
        |_, _| true,
    );
    site.put("lawn", [lawn.shaded(|p| 0.8 + 0.2 * (p.x * 0.7).sin() * (p.z * 0.9).cos())]);

    site.place(pieces.sofa, at(-3.3, 0.0, -1.6), 90.0);
    site.place(pieces.table, at(-2.0, 0.0, -1.6), 90.0);
    site.place(pieces.shelf, at(-0.2, 0.0, -2.6), 0.0);
    site.place(pieces.lamp, at(-3.5, 0.0, 0.4), 0.0);
    site.place(pieces.plant, at(-0.3, 0.0, 2.4), 0.0);
    site.place(pieces.bed, at(3.1, 0.0, -1.8), 0.0);
    site.place(pieces.wardrobe, at(3.55, 0.0, 1.0), -90.0);
    pieces.workplace(&mut site, at(1.2, 0.0, -2.45), 0.0);
    pieces.dining(&mut site, at(7.0, -0.1, 2.0), 0);
    for k in 0..8 {
        let (s, c) = (f64::from(k) * 0.8 + 0.3).sin_cos();
        let (x, z) = (15.0 * c, 13.0 * s);
        site.place(pieces.tree, at(x, -0.4, z), f64::from(k) * 50.0);
    }
    site.stand([
        at(-2.1, 0.0, 0.8),
        at(-1.0, 0.0, -0.6),
        at(0.3, 0.0, 0.725),
        at(1.6, 0.0, 1.2),
        at(2.0, 0.0, -0.5),
        at(-2.1, 0.0, 3.0),
        at(-2.1, -0.1, 5.0),
        at(0.0, -0.1, -5.5),
    ]);
    site.never_stand([at(-2.0, 0.75, -1.6), at(7.0, 0.65, 2.0), at(0.0, 3.89, 0.0), at(0.0, -30.0, 0.0)]);
    site.translate(at(450_000.0, 120.0, -5_700_000.0));
    site.specimen("far_origin")
}
