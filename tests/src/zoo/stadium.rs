//! A stadium: elliptical stands of steep rows around a pitch, a concourse below them and a roof
//! above.

use super::Specimen;
use super::furniture::Furniture;
use super::kit::{Pattern, Shape, Shapes, Site, at};
use glam::DVec3;
use std::f64::consts::TAU;

/// Rows of the stands: number, height and depth in metres.
const ROWS: u32 = 16;
const ROW_M: [f64; 2] = [0.45, 0.8];
/// Half axes of the ellipse at the foot of the stands, metres.
const INNER_M: [f64; 2] = [62.0, 46.0];
/// Sectors around; four gaps of [`GAP`] sectors lead from the concourse to the pitch.
const SECTORS: u32 = 112;
const GAP: u32 = 2;
/// Height of the roof's inner edge.
const ROOF_M: f64 = 13.0;

/// A point `out` metres outside the foot of the stands.
fn around(sector: f64, out: f64, y: f64) -> DVec3 {
    let (s, c) = (-sector / f64::from(SECTORS) * TAU).sin_cos();
    at((INNER_M[0] + out) * c, y, (INNER_M[1] + out) * s)
}

/// Middle of row `row`, on its tread; `place` from 0 at its front to 1.
fn on_row(sector: f64, row: u32, place: f64) -> DVec3 {
    around(sector, (f64::from(row) + place) * ROW_M[1], f64::from(row + 1) * ROW_M[0])
}

/// A closed ring section between two sectors: a closed profile of (out, height), counter-clockwise
/// with out to the right, and columns of it for the ends.
fn section(mut shape: Shape, from: u32, to: u32, profile: &[[f64; 2]], columns: &[[[f64; 2]; 4]]) -> Shape {
    for sector in from..to {
        let (a, b) = (f64::from(sector), f64::from(sector + 1));
        for k in 0..profile.len() {
            let ([r0, y0], [r1, y1]) = (profile[k], profile[(k + 1) % profile.len()]);
            shape = shape.quad([around(a, r0, y0), around(b, r0, y0), around(b, r1, y1), around(a, r1, y1)]);
        }
    }
    for c in columns {
        let end = |s: u32| c.map(|[r, y]| around(f64::from(s), r, y));
        let [a, b, c, d] = end(from);
        shape = shape.quad([a, b, c, d]);
        let [a, b, c, d] = end(to);
        shape = shape.quad([d, c, b, a]);
    }
    shape
}

/// Rows, benches, pitch, concourse and roof.
pub(super) fn stadium() -> Specimen {
    let mut site = Site::new();
    let concrete = site.paint(Pattern::Concrete, [0.85, 0.84, 0.8]);
    let seats = [site.plain([0.6, 0.08, 0.06]), site.plain([0.08, 0.2, 0.5])];
    let white = site.plain([0.85, 0.85, 0.85]);
    let steel = site.plain([0.35, 0.38, 0.42]);
    let turf = [site.plain([0.12, 0.36, 0.1]), site.plain([0.16, 0.44, 0.13])];
    let track = site.plain([0.5, 0.2, 0.14]);
    let paving = site.paint(Pattern::Tile, [0.55, 0.54, 0.5]);
    let kiosk = site.paint(Pattern::Wood, [0.8, 0.6, 0.4]);
    let screen = site.plain([0.03, 0.04, 0.06]);
    let pieces = Furniture::new(&mut site);

    // The stands: an underside that rises with them, then the steps from the top row down.
    let (rise, depth) = (ROW_M[0], ROW_M[1]);
    let top = f64::from(ROWS);
    let under = |k: f64| (k * rise - 0.5).max(0.0);
    let mut profile = vec![[0.0, 0.0], [0.5 / rise * depth, 0.0], [top * depth, under(top)]];
    let mut columns = Vec::new();
    for row in (0..ROWS).rev() {
        let (k, y) = (f64::from(row), f64::from(row + 1) * rise);
        profile.push([(k + 1.0) * depth, y]);
        profile.push([k * depth, y]);
        columns.push([
            [k * depth, under(k)],
            [(k + 1.0) * depth, under(k + 1.0)],
            [(k + 1.0) * depth, y],
            [k * depth, y],
        ]);
    }
    // The last point equals the first but for its height.
    let stand = SECTORS / 4 - GAP;
    for q in 0..4 {
        let from = q * SECTORS / 4 + GAP;
        let stands = section(Shape::new(concrete), from, from + stand, &profile, &columns);
        let mut steps = Shape::new(white);
        let mut benches = seats.map(Shape::new);
        for row in 0..ROWS {
            // Half steps of two aisles.
            for aisle in [7, 19] {
                let s = f64::from(from + aisle);
                let (a, b) = (s - 0.15, s + 0.15);
                let (r, y) = (f64::from(row) * depth, f64::from(row) * rise);
                let ring = |y: f64| [around(a, r - 0.4, y), around(b, r - 0.4, y), around(b, r, y), around(a, r, y)];
                steps = steps.block(ring(y.max(0.0)), ring(y + rise * 0.5));
            }
            // Benches along the back of every row but each fourth.
            if row % 4 != 3 {
                for sector in (1..stand - 1).filter(|s| ![6, 7, 18, 19].contains(s)) {
                    let (a, b) = (f64::from(from + sector) + 0.04, f64::from(from + sector) + 0.96);
                    let (r, y) = (f64::from(row) * depth + 0.48, f64::from(row + 1) * rise);
                    let ring =
                        |y: f64| [around(a, r, y), around(b, r, y), around(b, r + 0.3, y), around(a, r + 0.3, y)];
                    let kind = ((sector / 4 + q) % 2) as usize;
                    benches[kind] = std::mem::take(&mut benches[kind]).block(ring(y), ring(y + 0.4));
                }
            }
        }
        let mut rails = Shape::new(steel);
        for sector in from..from + stand {
            rails = rails.bar(
                around(f64::from(sector), top * depth - 0.1, top * rise),
                around(f64::from(sector + 1), top * depth - 0.1, top * rise),
                1.0,
                0.08,
            );
        }
        site.put("stand", [stands, steps, rails].into_iter().chain(benches));
    }

    // A roof over the stands on columns, and the outer wall with gates.
    let outer = top * depth + 7.0;
    let roof = [[3.0, ROOF_M], [outer + 1.0, ROOF_M + 2.0], [outer + 1.0, ROOF_M + 2.3], [3.0, ROOF_M + 0.3]];
    let mut pillars = Shape::new(steel);
    let mut wall = Shape::new(concrete);
    for sector in 0..SECTORS {
        let (s, next) = (f64::from(sector), f64::from(sector + 1));
        if sector % 4 == 2 {
            pillars = pillars.rod(around(s, outer - 1.0, 0.0), around(s, outer - 1.0, ROOF_M + 1.9), 0.35, 12);
        }
        let open: &[[f64; 4]] = if sector % 7 == 0 { &[[2.0, 2.4, 0.0, 2.6]] } else { &[[1.9, 1.2, 3.5, 6.0]] };
        wall = wall.wall(around(next, outer, 0.0), around(s, outer, 0.0), 9.0, 0.3, open);
    }
    site.put("roof", [section(Shape::new(steel), 0, SECTORS, &roof, &[]), pillars, wall]);

    // Ground: paving up to the track, the track, and a striped pitch.
    let mut floor = Shape::new(paving);
    let mut lane = Shape::new(track);
    for sector in 0..SECTORS {
        let (a, b) = (f64::from(sector), f64::from(sector + 1));
        let ring = |r0: f64, r1: f64| {
            [around(a, r0, 0.0), around(b, r0, 0.0), around(b, r1, 0.0), around(a, r1, 0.0)]
                .map(|p| p - DVec3::Y * 0.02)
        };
        let up = |[a, b, c, d]: [DVec3; 4]| [d, c, b, a];
        for (r0, r1) in [(0.0, 12.0), (12.0, outer), (outer, 60.0)] {
            floor = floor.quad(up(ring(r0, r1)));
        }
        lane = lane.quad(up(ring(-8.0, 0.0)));
        lane = lane.quad(up(ring(-44.0, -8.0)));
    }
    let mut grass = turf.map(Shape::new);
    for stripe in 0..14 {
        let x = -49.0 + 7.0 * f64::from(stripe);
        let kind = (stripe % 2) as usize;
        grass[kind] = std::mem::take(&mut grass[kind]).solid(at(x, -0.1, -32.0), at(x + 7.0, 0.02, 32.0));
    }
    let mut lines = Shape::new(white);
    for (a, b) in [
        ((-46.0, -30.0), (46.0, -30.0)),
        ((-46.0, 30.0), (46.0, 30.0)),
        ((-46.0, -30.0), (-46.0, 30.0)),
        ((46.0, -30.0), (46.0, 30.0)),
        ((0.0, -30.0), (0.0, 30.0)),
    ] {
        lines = lines.bar(at(a.0, 0.01, a.1), at(b.0, 0.01, b.1), 0.02, 0.15);
    }
    for k in 0..32 {
        let p = |k: i32| {
            let (s, c) = (f64::from(k) / 32.0 * TAU).sin_cos();
            at(9.15 * c, 0.01, 9.15 * s)
        };
        lines = lines.bar(p(k), p(k + 1), 0.02, 0.15);
    }
    for x in [-46.0, 46.0] {
        lines =
            lines.rod(at(x, 0.0, -3.6), at(x, 2.44, -3.6), 0.06, 10).rod(at(x, 0.0, 3.6), at(x, 2.44, 3.6), 0.06, 10);
        lines = lines.rod(at(x, 2.44, -3.6), at(x, 2.44, 3.6), 0.06, 10);
    }
    site.put("ground", [floor, lane, lines].into_iter().chain(grass));

    // Kiosks and tables in the concourse, a screen above the end of the stands.
    let stall = Shape::new(kiosk)
        .boxed(at(0.0, 0.5, 0.0), at(1.5, 0.5, 0.8))
        .boxed(at(0.0, 2.4, 0.0), at(1.7, 0.1, 1.0))
        .boxed(at(-1.45, 1.65, -0.75), at(0.05, 0.65, 0.05))
        .boxed(at(1.45, 1.65, -0.75), at(0.05, 0.65, 0.05))
        .boxed(at(0.0, 1.65, -0.75), at(1.4, 0.65, 0.02));
    let stall = site.draft.mesh("stall", [stall]);
    for k in 0..16 {
        let s = f64::from(7 * k + 4);
        let p = around(s, top * depth + 3.5, 0.0);
        site.place(stall, p, (-p.z).atan2(p.x).to_degrees() - 90.0);
        site.place(pieces.table, around(s + 2.0, top * depth + 1.0, 0.0), 30.0 * s);
        site.place(pieces.plant, around(s + 3.0, top * depth + 5.5, 0.0), 30.0 * s);
    }
    let end = around(0.0, top * depth + 3.0, 0.0);
    site.put("screen", [Shape::new(screen).boxed(at(end.x, 10.0, 0.0), at(0.3, 2.2, 6.0))]);

    let quarter = |q: u32, sector: f64| f64::from(q * SECTORS / 4 + GAP) + sector;
    site.stand([
        // Rows free of benches, and the free strip before benches.
        on_row(quarter(0, 10.5), 3, 0.5),
        on_row(quarter(1, 12.5), 7, 0.5),
        on_row(quarter(2, 4.5), 11, 0.5),
        on_row(quarter(3, 15.5), 6, 0.25),
        on_row(quarter(0, 3.5), 1, 0.25),
        on_row(quarter(2, 7.0), 12, 0.3),
        at(0.0, 0.02, 5.0),
        at(-30.0, 0.02, -20.0),
        at(40.0, 0.02, 10.0),
        around(1.0, -4.0, -0.02),
        around(1.0, 6.0, -0.02),
        around(29.0, top * depth + 2.0, -0.02),
        around(63.3, top * depth + 2.5, -0.02),
        around(100.0, top * depth - 2.0, -0.02),
        around(16.0, outer + 8.0, -0.02),
    ]);
    let cover = |s: f64, out: f64| around(s, out, ROOF_M + 0.3 + 2.0 * (out - 3.0) / (outer - 2.0));
    site.never_stand([cover(10.0, 8.0), cover(50.5, 12.0), cover(90.0, 4.5)]);
    // In the air before the roof.
    site.never_eye([around(30.0, -6.0, ROOF_M), at(0.0, 8.0, 0.0)]);
    site.specimen("stadium")
}
