//! A mine: tunnels at three depths below a terrain, joined by ramps.

use super::Specimen;
use super::furniture::Furniture;
use super::kit::{Pattern, Shape, Shapes, Site, at, smoothstep, spaced};
use glam::DVec3;

/// Edge of a cell of the galleries, metres; also the width of tunnels.
const CELL_M: f64 = 4.0;
/// Height of tunnels.
const HIGH_M: f64 = 3.4;
/// Slope of the ramps, as a tangent: 30 degrees.
const SLOPE: f64 = 0.577_350_269_189_625_8;
/// From level to level, metres.
const LEVEL_M: f64 = 20.0;
/// Horizontal length of a ramp between levels.
const RAMP_M: f64 = LEVEL_M / SLOPE;
/// Levels: cells of the main gallery, and the columns of those with side galleries.
const LEVELS: [(i32, [i32; 2]); 3] = [(10, [2, 7]), (6, [1, 4]), (5, [1, 3])];
/// Cells of a side gallery on each side of the main one.
const SIDE: i32 = 5;
/// The ramp's open cut: its ceiling begins here.
const CUT_M: f64 = 9.0;

/// Where a level's main gallery begins, on its floor.
fn level_start(level: usize) -> DVec3 {
    let before: i32 = LEVELS[..level].iter().map(|l| l.0).sum();
    let ramps = level as f64 + 1.0;
    at(ramps * RAMP_M + f64::from(before) * CELL_M, -LEVEL_M * ramps, 0.0)
}

/// Moves a point of the rock's surface, `above` metres over the floor: rough walls, a nearly even
/// floor.
fn rough(p: DVec3, above: f64) -> DVec3 {
    // Even where the rock meets the concrete of the open cut and of the shaft.
    let shaft = cell(0, SHAFT.0, SHAFT.1) + DVec3::Y * HIGH_M;
    let even = (p - shaft).abs().max_element() < CELL_M * 0.5 + 0.1 && p.y > shaft.y - 0.1;
    let wall = if even { 0.0 } else { 0.16 * smoothstep(0.0, 1.2, above) * smoothstep(CUT_M, CUT_M + 2.0, p.x) };
    let wave = |a: f64, b: f64, c: f64| (p.x * a + 1.3).sin() * (p.z * b + 0.4).cos() + (p.y * c + p.x * 0.9).sin();
    p + at(
        wall * 0.5 * wave(1.7, 2.1, 2.9),
        0.02 * wave(1.1, 1.5, 0.0) + wall * 0.4 * wave(2.3, 1.9, 1.1),
        wall * 0.5 * wave(2.6, 1.2, 2.3),
    )
}

/// A rock face from `a` along `du` and `dv`, seen from inside; `floor` is the floor's height at a
/// point.
fn face(shape: Shape, a: DVec3, du: DVec3, dv: DVec3, floor: &dyn Fn(DVec3) -> f64) -> Shape {
    let (nu, nv) = ((du.length() / 1.0).round().max(1.0) as u32, (dv.length() / 1.0).round().max(1.0) as u32);
    let place = |u: f64, v: f64| {
        let p = a + du * u + dv * v;
        rough(p, p.y - floor(p))
    };
    let e = 0.01;
    shape.patch(nu, nv, |u, v| {
        let normal = (place(u + e, v) - place(u - e, v)).cross(place(u, v + e) - place(u, v - e));
        (place(u, v), normal, (u * du.length(), v * dv.length()))
    })
}

/// The four faces of a tunnel along +X from the floor's middle `from`, `length` long and `drop`
/// deeper at its end.
fn tunnel(shape: Shape, from: DVec3, length: f64, drop: f64, roofed: bool) -> Shape {
    let along = at(length, -drop, 0.0);
    let half = DVec3::Z * CELL_M * 0.5;
    let up = DVec3::Y * HIGH_M;
    let floor = |p: DVec3| from.y - drop * (p.x - from.x) / length;
    let mut shape = face(shape, from - half, half * 2.0, along, &floor);
    shape = face(shape, from - half, along, up, &floor);
    shape = face(shape, from + half, up, along, &floor);
    if roofed { face(shape, from - half + up, along, half * 2.0, &floor) } else { shape }
}

/// The cells of a level: column along x, row along z.
fn cells(level: usize) -> Vec<(i32, i32)> {
    let (length, sides) = LEVELS[level];
    let main = (0..length).map(|i| (i, 0));
    let side = sides.into_iter().flat_map(|i| (1..=SIDE).flat_map(move |k| [(i, k), (i, -k)]));
    main.chain(side).collect()
}

/// The cell of the first level that lies below the shaft.
const SHAFT: (i32, i32) = (LEVELS[0].1[1], -SIDE);

/// Middle of a cell's floor.
fn cell(level: usize, i: i32, k: i32) -> DVec3 {
    level_start(level) + at((f64::from(i) + 0.5) * CELL_M, 0.0, f64::from(k) * CELL_M)
}

/// Rock around the cells of a level; the ramps join at both ends of its main gallery.
fn galleries(mut rock: Shape, level: usize) -> Shape {
    let open = cells(level);
    let half = CELL_M * 0.5;
    let up = DVec3::Y * HIGH_M;
    for &(i, k) in &open {
        let c = cell(level, i, k);
        let floor = |_: DVec3| c.y;
        let corner = |x: f64, z: f64| c + at(x * half, 0.0, z * half);
        let (x, z) = (DVec3::X * CELL_M, DVec3::Z * CELL_M);
        rock = face(rock, corner(-1.0, -1.0), z, x, &floor);
        if level != 0 || (i, k) != SHAFT {
            rock = face(rock, corner(-1.0, -1.0) + up, x, z, &floor);
        }
        let last = LEVELS[level].0 - 1;
        let joins =
            |i: i32, k: i32| open.contains(&(i, k)) || k == 0 && (i < 0 || i > last && level + 1 < LEVELS.len());
        if !joins(i - 1, k) {
            rock = face(rock, corner(-1.0, -1.0), up, z, &floor);
        }
        if !joins(i + 1, k) {
            rock = face(rock, corner(1.0, -1.0), z, up, &floor);
        }
        if !joins(i, k - 1) {
            rock = face(rock, corner(-1.0, -1.0), x, up, &floor);
        }
        if !joins(i, k + 1) {
            rock = face(rock, corner(-1.0, 1.0), up, x, &floor);
        }
    }
    rock
}

/// Ramps, tunnels with props and tracks, and a shaft, below a terrain.
pub(super) fn mine() -> Specimen {
    let mut site = Site::new();
    let stone = site.paint(Pattern::Concrete, [0.95, 0.85, 0.72]);
    let earth = site.plain([0.3, 0.38, 0.18]);
    let timber = site.paint(Pattern::Wood, [0.6, 0.45, 0.3]);
    let steel = site.plain([0.25, 0.25, 0.28]);
    let rust = site.plain([0.4, 0.16, 0.08]);
    let concrete = site.paint(Pattern::Concrete, [0.8, 0.8, 0.78]);
    let glow = site.plain([0.95, 0.8, 0.4]);
    let pieces = Furniture::new(&mut site);
    let half = CELL_M * 0.5;

    // Ramps and galleries. The first ramp begins as an open cut whose walls reach the ground.
    let mut rock =
        tunnel(Shape::new(stone), at(CUT_M, -CUT_M * SLOPE, 0.0), RAMP_M - CUT_M, (RAMP_M - CUT_M) * SLOPE, true);
    for level in 0..LEVELS.len() {
        rock = galleries(rock, level);
        if level + 1 < LEVELS.len() {
            let end = level_start(level) + DVec3::X * f64::from(LEVELS[level].0) * CELL_M;
            rock = tunnel(rock, end, RAMP_M, LEVEL_M, true);
        }
    }
    let tone = |p: glam::Vec3| 0.65 + 0.2 * (p.x * 2.3 + p.y).sin() * (p.z * 2.9).cos() + 0.15 * (p.y * 3.1).sin();
    site.put("rock", [rock.shaded(tone)]);
    let deep = -CUT_M * SLOPE;
    let mut cut = Shape::new(concrete).quad([
        at(0.0, 0.0, -half),
        at(0.0, 0.0, half),
        at(CUT_M, deep, half),
        at(CUT_M, deep, -half),
    ]);
    for z in [-half, half] {
        let wall = [at(0.0, 0.0, z), at(CUT_M, deep, z), at(CUT_M, 0.0, z)];
        let [a, b, c] = if z < 0.0 { wall } else { [wall[0], wall[2], wall[1]] };
        cut = cut.quad([a, b, c, c.midpoint(a)]);
    }
    let lintel = at(CUT_M, deep + HIGH_M, 0.0);
    cut = cut.quad([lintel - DVec3::Z * half, lintel + DVec3::Z * half, at(CUT_M, 0.0, half), at(CUT_M, 0.0, -half)]);
    // Kerbs keep people from the cut.
    let kerb = Shape::new(concrete)
        .bar(at(0.0, 0.0, -half - 0.2), at(CUT_M + 0.3, 0.0, -half - 0.2), 1.0, 0.3)
        .bar(at(0.0, 0.0, half + 0.2), at(CUT_M + 0.3, 0.0, half + 0.2), 1.0, 0.3)
        .bar(at(CUT_M + 0.15, 0.0, -half - 0.05), at(CUT_M + 0.15, 0.0, half + 0.05), 1.0, 0.3);
    site.put("mouth", [cut, kerb]);

    // The shaft, with a headframe over it.
    let foot = cell(0, SHAFT.0, SHAFT.1);
    let rise = DVec3::Y * (-foot.y - HIGH_M);
    let mut shaft = Shape::new(concrete);
    for turn in 0..4 {
        let by = glam::DAffine3::from_rotation_translation(
            glam::DQuat::from_rotation_y(f64::from(turn) * std::f64::consts::FRAC_PI_2),
            foot + DVec3::Y * HIGH_M,
        );
        shaft = shaft.with(
            Shape::new(0)
                .quad([
                    at(-half, 0.0, -half),
                    at(half, 0.0, -half),
                    at(half, 0.0, -half) + rise,
                    at(-half, 0.0, -half) + rise,
                ])
                .moved(by),
        );
    }
    let mouth = at(foot.x, 0.0, foot.z);
    let mut frame = Shape::new(steel).rod(mouth + at(0.0, 9.0, -0.3), mouth + at(0.0, 9.0, 0.3), 1.4, 24);
    let mut fence = Shape::new(rust);
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
        frame = frame.rod(mouth + at(sx * 2.6, 0.0, sz * 2.6), mouth + at(sx * 0.4, 9.0, sz * 0.4), 0.16, 10);
        let (a, b) = (at(sx * 2.3, 0.0, sz * 2.3), at(-sz * 2.3, 0.0, sx * 2.3));
        fence = fence.railing(mouth + a, mouth + b);
    }
    site.put("headframe", [shaft, frame, fence]);

    // The terrain leaves out the cut and the shaft.
    let lines = |from: f64, to: f64, cuts: &[f64]| {
        let mut all = spaced(from, to, ((to - from) / 14.0) as u32);
        all.retain(|x| cuts.iter().all(|c| (c - x).abs() > 3.0));
        all.extend(cuts);
        all.sort_by(f64::total_cmp);
        all
    };
    let xs = lines(-80.0, 260.0, &[0.0, CUT_M, foot.x - half, foot.x + half]);
    let zs = lines(-140.0, 140.0, &[-half, half, foot.z - half, foot.z + half]);
    let height = |x: f64, z: f64| {
        let out = (x - 60.0).abs().max(z.abs()) - 90.0;
        9.0 * smoothstep(0.0, 60.0, out) * (1.3 + (x * 0.05).sin() * (z * 0.06).cos())
    };
    let hole = |x: f64, z: f64| {
        (0.0..CUT_M).contains(&x) && z.abs() < half || (x - foot.x).abs() < half && (z - foot.z).abs() < half
    };
    let land = Shape::new(earth).ground(&xs, &zs, height, |x, z| !hole(x, z));
    site.put("land", [land.shaded(|p| 0.75 + 0.25 * (p.x * 0.21).sin() * (p.z * 0.17).cos())]);

    // Props at the cells' edges, tracks in the main galleries, lamps and carts.
    let prop = Shape::new(timber)
        .rod(at(0.0, 0.0, -1.6), at(0.0, 2.9, -1.6), 0.13, 10)
        .rod(at(0.0, 0.0, 1.6), at(0.0, 2.9, 1.6), 0.13, 10)
        .rod(at(0.0, 3.0, -1.75), at(0.0, 3.0, 1.75), 0.14, 10);
    let prop = site.draft.mesh("prop", [prop]);
    let mut rails = Shape::new(steel);
    let mut sleepers = Shape::new(timber);
    for z in [-0.4, 0.4] {
        rails = rails.boxed(at(0.0, 0.1, z), at(half, 0.05, 0.03));
    }
    for k in 0..5 {
        sleepers = sleepers.boxed(at(-1.6 + 0.8 * f64::from(k), 0.03, 0.0), at(0.1, 0.03, 0.65));
    }
    let track = site.draft.mesh("track", [rails, sleepers]);
    let mut wheels = Shape::new(steel);
    for (x, z) in [(-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (-0.4, 0.4)] {
        wheels = wheels.rod(at(x, 0.32, z - 0.05), at(x, 0.32, z + 0.05), 0.17, 14);
    }
    let tub = Shape::new(rust)
        .block(
            [at(-0.6, 0.45, 0.35), at(0.6, 0.45, 0.35), at(0.6, 0.45, -0.35), at(-0.6, 0.45, -0.35)],
            [at(-0.8, 1.2, 0.5), at(0.8, 1.2, 0.5), at(0.8, 1.2, -0.5), at(-0.8, 1.2, -0.5)],
        )
        .blob(at(0.0, 1.2, 0.0), at(0.7, 0.25, 0.45), 14, 8);
    let cart = site.draft.mesh("cart", [wheels, tub]);
    let lamp = site.draft.mesh(
        "lamp",
        [
            Shape::new(steel).rod(at(0.0, 2.6, 0.0), at(0.0, 3.0, 0.0), 0.02, 6),
            Shape::new(glow).blob(at(0.0, 2.5, 0.0), at(0.12, 0.14, 0.12), 12, 8),
        ],
    );
    for level in 0..LEVELS.len() {
        for (i, k) in cells(level) {
            let c = cell(level, i, k);
            let side = k != 0;
            if !LEVELS[level].1.contains(&i) || side {
                site.place(prop, c, if side { 90.0 } else { 0.0 });
            }
            site.place(track, c, if side { 90.0 } else { 0.0 });
            if (i + k) % 3 == 0 {
                site.place(lamp, c + at(if side { 0.0 } else { 0.6 }, 0.0, if side { 0.6 } else { 0.0 }), 0.0);
            }
        }
        let (length, [first, second]) = LEVELS[level];
        site.place(cart, cell(level, length - 1, 0), 0.0);
        site.place(cart, cell(level, first, 4), 90.0);
        site.place(cart, cell(level, second, -3), 90.0);
    }
    for k in 0..16 {
        let (s, c) = (f64::from(k) * 0.39).sin_cos();
        site.place(pieces.tree, at(60.0 + 75.0 * c, 0.0, 70.0 * s), 50.0 * f64::from(k));
    }

    site.stand([3.0, 12.0, 20.0, 30.0].map(|x| at(x, -x * SLOPE, 0.0)));
    for level in 0..LEVELS.len() {
        let [first, second] = LEVELS[level].1;
        site.stand([
            cell(level, 0, 0) + at(1.2, 0.0, 0.8),
            cell(level, first, 0),
            cell(level, first, 2),
            cell(level, second, -2),
        ]);
        site.stand([cell(level, second, 5) + at(0.7, 0.0, 0.0)]);
        if level > 0 {
            site.stand([level_start(level) + at(-RAMP_M * 0.5, LEVEL_M * 0.5, 0.3)]);
        }
    }
    site.stand([at(-8.0, 0.0, 0.0), at(-3.0, 0.0, 8.0), at(20.0, 0.0, 12.0)]);
    // In the rock between the galleries and above them, and in the shaft.
    site.never_stand([
        cell(0, 5, 3),
        cell(1, 3, -3),
        cell(0, 4, 0) + DVec3::Y * 8.0,
        foot + DVec3::Y * 9.0,
        cell(2, 8, 0),
    ]);
    site.specimen("mine")
}
