//! Things without a floor: a spaceship and a statue, looked at from around them.

use super::Specimen;
use super::kit::{EYE_M, Pattern, Shape, Shapes, Site, at, spaced};
use glam::{DAffine3, DQuat, DVec3};
use std::f64::consts::{PI, TAU};

/// Ends of the hull along Z.
const HULL_M: [f64; 2] = [-28.0, 28.0];

/// Half height and half width of the hull's cross-section: lenses that stand on edge.
fn hull(z: f64) -> [f64; 2] {
    let t = (z - HULL_M[0]) / (HULL_M[1] - HULL_M[0]);
    let swell = (4.0 * t * (1.0 - t)).max(0.0).powf(0.7);
    [0.3 + 6.5 * swell, 0.1 + 2.3 * swell]
}

/// A point of the hull: side -1 or 1, `h` from -1 at its lower to 1 at its upper edge, `off` metres
/// outside.
fn on_hull(side: f64, z: f64, h: f64, off: f64) -> DVec3 {
    let [high, wide] = hull(z);
    at(side * (wide * (1.0 - h * h) + off), high * h, z)
}

/// A closed curved plate on the hull between two lengths and two heights.
fn plate(mut shape: Shape, side: f64, z: [f64; 2], h: [f64; 2], thick: f64) -> Shape {
    let place = |u: f64, v: f64, off: f64| on_hull(side, z[0] + (z[1] - z[0]) * u, h[0] + (h[1] - h[0]) * v, off);
    let normal = |u: f64, v: f64| {
        let e = 1e-3;
        (place(u + e, v, 0.0) - place(u - e, v, 0.0)).cross(place(u, v + e, 0.0) - place(u, v - e, 0.0)) * -side
    };
    let n = 5;
    // The outer face; u runs the way that turns its front outward.
    let way = |u: f64| if side > 0.0 { 1.0 - u } else { u };
    shape = shape.patch(n, n, |u, v| (place(way(u), v, thick), normal(way(u), v), (u, v)));
    shape = shape.patch(n, n, |u, v| (place(1.0 - way(u), v, -0.05), -normal(1.0 - way(u), v), (u, v)));
    // The rim, edge by edge, in the order that the outer face runs around.
    let corner = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
    for k in 0..4 {
        let (a, b) = (corner[k], corner[(k + 1) % 4]);
        for i in 0..n {
            let point = |t: f64, off: f64| place(way(a.0 + (b.0 - a.0) * t), a.1 + (b.1 - a.1) * t, off);
            let (t, s) = (f64::from(i) / f64::from(n), f64::from(i + 1) / f64::from(n));
            shape = shape.quad([point(t, -0.05), point(s, -0.05), point(s, thick), point(t, thick)]);
        }
    }
    shape
}

/// A spaceship 60 m long: lens-shaped hull, nozzles, pipes and antennas; nothing to stand on.
pub(super) fn spaceship() -> Specimen {
    let mut site = Site::new();
    let tones = [
        site.paint(Pattern::Metal, [0.75, 0.76, 0.8]),
        site.paint(Pattern::Metal, [0.6, 0.63, 0.7]),
        site.paint(Pattern::Metal, [0.72, 0.4, 0.25]),
    ];
    let dark = site.plain([0.08, 0.09, 0.1]);
    let copper = site.plain([0.55, 0.3, 0.12]);
    let glass = site.plain([0.15, 0.5, 0.65]);
    let glow = site.plain([0.9, 0.6, 0.3]);

    // The hull below the plates, and the plates.
    let mut body = Shape::new(dark);
    for side in [-1.0, 1.0] {
        body = body.patch(48, 16, |u, v| {
            let z = |u: f64| HULL_M[0] + (HULL_M[1] - HULL_M[0]) * if side > 0.0 { 1.0 - u } else { u };
            let p = |u: f64, v: f64| on_hull(side, z(u), v * 2.0 - 1.0, 0.0);
            let e = 1e-3;
            let inside = |u: f64| u.clamp(2.0 * e, 1.0 - 2.0 * e);
            let (a, b) = (inside(u), inside(v));
            (p(u, v), (p(a + e, b) - p(a - e, b)).cross(p(a, b + e) - p(a, b - e)), (u * 50.0, v * 12.0))
        });
    }
    site.put("hull", [body]);
    let rows = spaced(-0.9, 0.9, 5);
    for (k, z) in spaced(-25.0, 25.0, 13).windows(2).enumerate() {
        let mut plates = tones.map(Shape::new);
        for (j, h) in rows.windows(2).enumerate() {
            for side in [-1.0, 1.0] {
                let kind = if (k * 3 + j) % 7 == 0 { 2 } else { (k + j) % 2 };
                let thick = 0.06 + 0.02 * ((k + 2 * j) % 3) as f64;
                plates[kind] = plate(
                    std::mem::take(&mut plates[kind]),
                    side,
                    [z[0] + 0.08, z[1] - 0.08],
                    [h[0] + 0.012, h[1] - 0.012],
                    thick,
                );
            }
        }
        site.put("plates", plates);
    }

    // Pipes climb the hull steeply; portholes; antennas.
    let mut pipes = Shape::new(copper);
    let mut holes = Shape::new(glass);
    let mut masts = Shape::new(dark);
    for side in [-1.0, 1.0] {
        for k in 0..9 {
            let z = -20.0 + 5.0 * f64::from(k);
            for i in 0..8 {
                let h = |i: i32| -0.7 + 0.15 * f64::from(i);
                let point = |i: i32| on_hull(side, z + 0.12 * f64::from(i), h(i), 0.28);
                pipes = pipes.rod(point(i), point(i + 1), 0.12, 10).blob(point(i + 1), DVec3::splat(0.15), 10, 6);
            }
            let p = on_hull(side, z + 2.5, 0.36, 0.08);
            holes = holes.blob(p, at(0.12, 0.35, 0.35), 14, 8);
        }
    }
    for (z, high) in [(-12.0, 3.0), (-4.0, 2.0), (6.0, 4.0), (14.0, 2.5)] {
        let foot = at(0.0, hull(z)[0] - 0.2, z);
        masts =
            masts.rod(foot, foot + DVec3::Y * high, 0.05, 8).blob(foot + DVec3::Y * high, DVec3::splat(0.14), 10, 8);
        // A dish that looks sideways.
        let dish = Shape::new(0).lathe(
            &[(0.0, 0.0), (0.3, 0.06), (0.45, 0.2), (0.43, 0.22), (0.28, 0.1), (0.0, 0.04)],
            16,
            1,
            false,
        );
        let turn = DQuat::from_rotation_z(-PI * 0.5);
        masts = masts.with(dish.moved(DAffine3::from_rotation_translation(turn, foot + DVec3::Y * (high * 0.6))));
    }
    site.put("fittings", [pipes, holes, masts]);

    // Nozzles: lens-shaped bells at the stern, closed, with a glowing rear.
    let mut bells = Shape::new(tones[1]);
    let mut fire = Shape::new(glow);
    for y in [-2.4, 0.0, 2.4] {
        let lens = |t: f64, a: f64, scale: f64| {
            // The lens of the hull, one metre high on each side.
            let h = (a / TAU * 4.0 - 1.0).clamp(-1.0, 3.0);
            let (side, h) = if h <= 1.0 { (1.0, h) } else { (-1.0, 2.0 - h) };
            let size = scale * (0.55 + 0.45 * t * t);
            at(side * 0.36 * size * (1.0 - h * h), y + size * h, 24.5 + 5.5 * t)
        };
        let around = 24;
        for i in 0..8 {
            for j in 0..around {
                let (t0, t1) = (f64::from(i) / 8.0, f64::from(i + 1) / 8.0);
                let (a0, a1) = (f64::from(j) / f64::from(around) * TAU, f64::from(j + 1) / f64::from(around) * TAU);
                bells = bells.quad([lens(t0, a0, 1.1), lens(t0, a1, 1.1), lens(t1, a1, 1.1), lens(t1, a0, 1.1)]);
            }
        }
        for j in 0..around {
            let (a0, a1) = (f64::from(j) / f64::from(around) * TAU, f64::from(j + 1) / f64::from(around) * TAU);
            let (p, q) = (lens(1.0, a0, 1.1), lens(1.0, a1, 1.1));
            let centre = at(0.0, y, p.z);
            fire = fire.quad([centre, p, p.midpoint(q), q]);
            let (p, q) = (lens(0.0, a0, 1.1), lens(0.0, a1, 1.1));
            bells = bells.quad([at(0.0, y, p.z), q, q.midpoint(p), p]);
        }
    }
    site.put("nozzles", [bells, fire]);

    // Eyes beside the hull, as high above its lowest point as people's are above their feet.
    let low = -hull(0.0)[0] + EYE_M;
    for (x, z) in
        [(4.0, 0.0), (-4.0, 0.0), (4.5, -12.0), (-4.5, 12.0), (3.5, 18.0), (-3.5, -18.0), (5.0, 8.0), (-5.0, -6.0)]
    {
        site.stand([at(x, low - EYE_M, z)]);
    }
    // In the hull, and far away.
    site.never_eye([at(0.0, 0.0, 0.0), at(0.0, 3.0, -8.0), at(300.0, low, 0.0), at(0.0, -80.0, 0.0)]);
    site.specimen("spaceship")
}

/// Radius of the robe by height.
const ROBE: [(f64, f64); 12] = [
    (0.0, 0.42),
    (0.12, 0.44),
    (0.4, 0.36),
    (0.8, 0.29),
    (1.05, 0.25),
    (1.2, 0.22),
    (1.4, 0.27),
    (1.62, 0.29),
    (1.74, 0.22),
    (1.82, 0.1),
    (1.88, 0.075),
    (1.94, 0.08),
];

/// A statue 2.2 m high, of about 40,000 triangles, on no ground.
pub(super) fn statue() -> Specimen {
    let mut site = Site::new();
    let marble = site.plain([0.75, 0.73, 0.68]);
    let bronze = site.plain([0.42, 0.28, 0.14]);
    let radius = |y: f64| {
        let k = ROBE.iter().rposition(|p| p.0 <= y).unwrap_or(0).min(ROBE.len() - 2);
        let ((y0, r0), (y1, r1)) = (ROBE[k], ROBE[k + 1]);
        let t = ((y - y0) / (y1 - y0)).clamp(0.0, 1.0);
        r0 + (r1 - r0) * t * t * (3.0 - 2.0 * t)
    };
    // Folds that run down the robe and fade toward the neck.
    let robe = |a: f64, y: f64| {
        let fold = (1.0 - y / 1.9).max(0.0)
            * (0.09 * (9.0 * a + 2.0 * (y * 3.0).sin()).sin() + 0.04 * (23.0 * a + 5.0 * y).sin());
        let r = radius(y) * (1.0 + fold);
        at(r * a.cos(), y, 0.78 * r * a.sin())
    };
    let tone = |p: glam::Vec3| 0.82 + 0.18 * (p.y * 17.0 + (p.x * 11.0).sin() * 2.0).sin();
    let body = Shape::new(marble)
        .patch(120, 88, |u, v| {
            let (a, y) = (-u * TAU, v * 1.94);
            let e = 1e-3;
            let n = (robe(a - e, y) - robe(a + e, y)).cross(robe(a, y + e) - robe(a, y - e));
            (robe(a, y), n, (u, v))
        })
        .patch(120, 1, |u, v| {
            let a = u * TAU;
            (robe(a, 0.0) * (1.0 - v), DVec3::NEG_Y, (u, v))
        });
    let head = |shape: Shape| {
        shape.blob(at(0.0, 2.05, 0.01), at(0.105, 0.15, 0.125), 64, 40).blob(
            at(0.0, 2.03, 0.13),
            at(0.02, 0.035, 0.03),
            16,
            10,
        )
    };
    let mut arms = Shape::new(marble);
    for side in [-1.0, 1.0] {
        let (shoulder, elbow, hand) =
            (at(side * 0.25, 1.62, 0.0), at(side * 0.4, 1.3, 0.05), at(side * 0.18, 1.22, 0.33));
        for (a, b, r) in [(shoulder, elbow, 0.075), (elbow, hand, 0.06)] {
            arms =
                arms.rod(a, b, r, 24).blob(b, DVec3::splat(r * 1.02), 24, 14).blob(a, DVec3::splat(r * 1.02), 24, 14);
        }
    }
    let mut wreath = Shape::new(bronze);
    for k in 0..20 {
        let (s, c) = (f64::from(k) / 20.0 * TAU).sin_cos();
        wreath = wreath.blob(at(0.115 * c, 2.12, 0.01 + 0.135 * s), at(0.03, 0.025, 0.03), 14, 9);
    }
    wreath = wreath.blob(at(0.0, 1.22, 0.36), at(0.17, 0.07, 0.11), 40, 24);
    site.put("statue", [head(body.with(arms)).shaded(tone), wreath]);

    for k in 0..8 {
        let (s, c) = (f64::from(k) / 8.0 * TAU).sin_cos();
        let r = 1.5 + 0.2 * f64::from(k);
        site.stand([at(r * c, 0.0, r * s)]);
    }
    site.never_eye([at(0.0, 1.0, 0.0), at(0.0, 2.2 + EYE_M, 0.0), at(0.0, EYE_M, 60.0), at(0.0, -3.0, 2.0)]);
    site.specimen("statue")
}
