//! Open land: a quarry, and hills with a cliff.

use super::Specimen;
use super::furniture::Furniture;
use super::kit::{Pattern, Shape, Shapes, Site, at, smoothstep, spaced};
use glam::DVec3;
use std::f64::consts::TAU;

/// Depth of the pit.
const DEPTH_M: f64 = 60.0;
/// Radius of the pit's floor; the rim is [`DEPTH_M`] farther out.
const FLOOR_M: f64 = 60.0;
/// Slope of the haul road.
const ROAD_SLOPE: f64 = 0.1;
/// Half the width of the haul road.
const ROAD_HALF_M: f64 = 7.0;

/// Benches, as a height by radius: faces of 12 m over 4 m, benches 10 m wide but for the face at
/// the rim.
fn bench_m(r: f64) -> f64 {
    let out = (r - FLOOR_M).clamp(0.0, DEPTH_M);
    let bench = (out / 14.0).floor();
    -DEPTH_M + 12.0 * (bench + ((out - 14.0 * bench) / 4.0).min(1.0))
}

/// Direction, in radians, of the road where it has come down to `y`.
fn road_angle(y: f64) -> f64 {
    // ds = radius * d(angle), radius = rim + y, y = -slope * s.
    let rim = FLOOR_M + DEPTH_M;
    (rim / (rim + y)).ln() / ROAD_SLOPE
}

/// The point of the road's middle where it has come down to `y`.
fn road(y: f64) -> DVec3 {
    let (s, c) = road_angle(y).sin_cos();
    let r = FLOOR_M + DEPTH_M + y;
    at(r * c, y, r * s)
}

/// Height of the quarry and the land around it.
fn quarry_m(r: f64, angle: f64) -> f64 {
    let mut y = bench_m(r);
    // The road passes a direction once, or twice near its ends.
    for turn in 0..2 {
        let a = angle.rem_euclid(TAU) + TAU * f64::from(turn);
        let rim = FLOOR_M + DEPTH_M;
        let road_y = rim * ((-a * ROAD_SLOPE).exp() - 1.0);
        if road_y < -DEPTH_M {
            continue;
        }
        let off = (r - (rim + road_y)).abs();
        y += (road_y - y) * (1.0 - smoothstep(ROAD_HALF_M, ROAD_HALF_M + 4.0, off));
    }
    if r > 140.0 {
        y += 12.0 * smoothstep(160.0, 420.0, r) * (1.2 + (3.0 * angle).sin() + 0.5 * (r * 0.02 + angle).cos());
    }
    y
}

/// An open pit with benches, a haul road down to its floor, machines and buildings.
pub(super) fn pit() -> Specimen {
    let mut site = Site::new();
    let rock = site.paint(Pattern::Concrete, [1.0, 0.78, 0.56]);
    let yellow = site.plain([0.75, 0.5, 0.05]);
    let black = site.plain([0.04, 0.04, 0.045]);
    let steel = site.paint(Pattern::Metal, [0.55, 0.6, 0.65]);
    let red = site.plain([0.5, 0.1, 0.06]);
    let pieces = Furniture::new(&mut site);

    const SECTORS: u32 = 180;
    let mut radii = vec![0.0, 15.0, 30.0, 45.0, 54.0];
    radii.extend(spaced(58.0, 134.0, 38));
    radii.extend([145.0, 165.0, 195.0, 240.0, 300.0, 380.0, 480.0]);
    let mut land = Shape::new(rock);
    for r in radii.windows(2) {
        land = land.patch(1, SECTORS, |u, v| {
            let (r, a) = (if u < 0.5 { r[0] } else { r[1] }, -v * TAU);
            let place = |r: f64, a: f64| at(r * a.cos(), quarry_m(r, a), r * a.sin());
            let e = 0.02;
            let normal = (place(r + 1.0, a) - place(r.max(1.0) - 1.0, a))
                .cross(place(r.max(1.0), a - e) - place(r.max(1.0), a + e));
            {
                let p = place(r, a);
                (p, normal, (0.15 * p.x + 0.1 * p.y, 0.15 * p.z + 0.1 * p.y))
            }
        });
    }
    let layers = |p: glam::Vec3| 0.72 + 0.16 * (p.y * 0.9).sin() + 0.1 * (p.x * 0.31).sin() * (p.z * 0.27).cos();
    site.put("quarry", [land.shaded(layers)]);

    // A lorry: wheels of 1.6 m, a bed 2.4 m above the ground.
    let wheel = |shape: Shape, x: f64, z: f64, r: f64| shape.rod(at(x, r, z - 0.4), at(x, r, z + 0.4), r, 20);
    let mut tyres = Shape::new(black);
    for (x, z) in [(-2.6, -1.6), (-2.6, 1.6), (2.4, -1.6), (2.4, 1.6)] {
        tyres = wheel(tyres, x, z, 0.8);
    }
    let body = Shape::new(yellow)
        .boxed(at(0.0, 1.3, 0.0), at(3.8, 0.3, 1.1))
        .boxed(at(2.9, 2.3, 0.0), at(0.8, 0.7, 1.5))
        .block(
            [at(-4.0, 1.8, 1.6), at(1.6, 1.8, 1.6), at(1.6, 1.8, -1.6), at(-4.0, 1.8, -1.6)],
            [at(-4.6, 2.4, 2.0), at(1.9, 2.4, 2.0), at(1.9, 2.4, -2.0), at(-4.6, 2.4, -2.0)],
        )
        .boxed(at(-1.4, 2.8, 1.9), at(3.2, 0.4, 0.1))
        .boxed(at(-1.4, 2.8, -1.9), at(3.2, 0.4, 0.1));
    let lorry = site.draft.mesh("lorry", [tyres, body]);

    let mut tracks = Shape::new(black);
    for z in [-1.5, 1.5] {
        tracks = tracks.boxed(at(0.0, 0.5, z), at(1.8, 0.45, 0.35));
        for x in [-1.8, -0.9, 0.0, 0.9, 1.8] {
            tracks = tracks.rod(at(x, 0.5, z - 0.4), at(x, 0.5, z + 0.4), 0.48, 16);
        }
    }
    let arm = Shape::new(red)
        .boxed(at(-0.4, 2.0, 0.0), at(2.0, 0.9, 1.5))
        .boxed(at(1.2, 2.6, 1.0), at(0.7, 0.9, 0.5))
        .rod(at(1.4, 2.0, -0.3), at(5.0, 5.2, -0.3), 0.3, 14)
        .rod(at(5.0, 5.2, -0.3), at(7.2, 1.6, -0.3), 0.22, 14)
        .blob(at(7.0, 1.2, -0.3), at(0.7, 0.6, 0.9), 14, 8);
    let digger = site.draft.mesh("digger", [tracks, arm]);

    // A hall, open toward +Z, and containers.
    let hall = Shape::new(steel)
        .wall(at(-8.0, 0.0, -6.0), at(8.0, 0.0, -6.0), 6.0, 0.3, &[])
        .wall(at(-8.0, 0.0, 6.0), at(8.0, 0.0, 6.0), 6.0, 0.3, &[[8.0, 6.0, 0.0, 5.0]])
        .wall(at(-7.85, 0.0, -5.85), at(-7.85, 0.0, 5.85), 6.0, 0.3, &[[6.0, 3.0, 1.0, 2.5]])
        .wall(at(7.85, 0.0, -5.85), at(7.85, 0.0, 5.85), 6.0, 0.3, &[[6.0, 3.0, 1.0, 2.5]])
        .solid(at(-8.5, 6.0, -6.5), at(8.5, 6.3, 6.5));
    let hall = site.draft.mesh("hall", [hall]);
    let container = Shape::new(red).boxed(at(0.0, 1.3, 0.0), at(3.0, 1.3, 1.2));
    let container = site.draft.mesh("container", [container]);
    let down = |x: f64, z: f64| at(x, -DEPTH_M, z);
    for (mesh, place, yaw) in [
        (lorry, down(10.0, -12.0), 30.0),
        (lorry, down(-22.0, 8.0), 200.0),
        (lorry, down(30.0, 20.0), 100.0),
        (digger, down(20.0, -28.0), 80.0),
        (digger, down(-35.0, -10.0), 10.0),
        (hall, down(-10.0, -30.0), 0.0),
        (container, down(-12.0, 25.0), 0.0),
        (container, down(-12.0, 28.0), 0.0),
        (container, down(0.0, 30.0), 90.0),
    ] {
        site.place(mesh, place, yaw);
    }
    pieces.workplace(&mut site, down(-14.0, -34.0), 0.0);
    pieces.workplace(&mut site, down(-10.0, -34.0), 0.0);
    site.place(pieces.shelf, down(-16.9, -30.0), 90.0);
    for k in 0..90 {
        let (a, r) = (f64::from(k) * 2.4, 44.0 + 1.2 * f64::from(k % 9));
        let size = 0.4 + 0.13 * f64::from(k % 7);
        let boulder = site.draft.mesh(
            "boulder",
            [Shape::new(rock)
                .blob(at(0.0, size * 0.4, 0.0), at(size, size * 0.8, size * 1.2), 8, 6)
                .shaded(move |p| 0.7 + 0.3 * (p.x * 4.0 + p.y * 5.0).sin())],
        );
        site.place(boulder, down(r * a.cos(), r * a.sin()), 20.0 * f64::from(k));
    }
    for k in 0..24 {
        let (a, r) = (f64::from(k) * 0.27 + 0.1, 150.0 + 12.0 * f64::from(k % 5));
        site.place(pieces.tree, at(r * a.cos(), quarry_m(r, a), r * a.sin()), 40.0 * f64::from(k));
    }

    site.stand([-5.0, -15.0, -25.0, -35.0, -45.0, -54.0].map(road));
    site.stand([down(0.0, 0.0), down(5.0, -20.0), down(-10.0, -27.0), down(25.0, 0.0), down(-30.0, 20.0)]);
    for a in [1.0, 3.0, 4.6] {
        site.stand([at(136.0 * f64::cos(a), 0.0, 136.0 * f64::sin(a))]);
    }
    // Halfway up the faces, away from the road.
    for (r, a) in [(62.0, 1.5), (76.0, 2.0), (118.0, 4.5)] {
        site.never_stand([at(r * f64::cos(a), quarry_m(r, a), r * f64::sin(a))]);
    }
    site.never_stand([down(-10.0, -30.0) + DVec3::Y * 6.3, down(-12.0, 25.0) + DVec3::Y * 2.6]);
    site.never_eye([at(0.0, EYE_OVER_PIT_M, 0.0)]);
    site.specimen("pit")
}

/// An eye at the height of the rim, over the middle of the pit.
const EYE_OVER_PIT_M: f64 = 1.6;

/// Height of the hills: slopes up to 35 degrees but for one cliff, 15 m high, which runs along x =
/// 70.
fn hills_m(x: f64, z: f64) -> f64 {
    let rolling = 4.5 * (x / 15.0).sin() * (z / 17.0).cos() + 1.33 * ((x + z) / 9.0).sin();
    let cliff = smoothstep(CLIFF_M[0], CLIFF_M[1], x - 6.0 * (z / 50.0).sin());
    // Gentle ground on both sides of the cliff, and a way up past its ends.
    let calm = 1.0 - 0.8 * (1.0 - smoothstep(8.0, 40.0, (x - 70.0).abs()));
    rolling * calm + 15.0 * cliff * (1.0 - smoothstep(90.0, 170.0, z.abs()))
}

/// Where the cliff begins and ends along x.
const CLIFF_M: [f64; 2] = [66.5, 73.5];

/// Rolling hills with one cliff, and nothing else.
pub(super) fn terrain() -> Specimen {
    let mut site = Site::new();
    let grass = site.paint(Pattern::Grass, [0.9, 0.95, 0.75]);
    let mut xs = spaced(-200.0, 56.0, 80);
    xs.extend(spaced(57.0, 84.0, 36));
    xs.extend(spaced(87.0, 200.0, 38));
    let zs = spaced(-200.0, 200.0, 130);
    let land = Shape::new(grass).ground(&xs, &zs, hills_m, |_, _| true);
    let tone = |p: glam::Vec3| 0.7 + 0.2 * (p.x * 0.9).sin() * (p.z * 0.8).cos() + 0.1 * (p.y * 2.0).sin();
    site.put("terrain", [land.shaded(tone)]);
    let on = |x: f64, z: f64| at(x, hills_m(x, z), z);
    site.stand([
        on(0.0, 0.0),
        on(-100.0, 50.0),
        on(-150.0, -150.0),
        on(40.0, 100.0),
        on(50.0, 0.0),
        on(95.0, 0.0),
        on(100.0, -60.0),
        on(150.0, 150.0),
        on(60.0, -190.0),
        on(-40.0, 120.0),
    ]);
    // On the cliff's face, and in the air before it.
    let face = |z: f64| on(70.0 + 6.0 * (z / 50.0).sin(), z);
    site.never_stand([face(0.0), face(-40.0), face(50.0)]);
    site.never_stand([on(55.0, 0.0) + DVec3::Y * 15.0, on(0.0, 0.0) - DVec3::Y * 10.0]);
    site.specimen("terrain")
}
