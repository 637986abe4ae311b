//! Construction judged on analytic scenes: where samples lie, what is missing, what is doubled, what is linked.

mod references;
mod scenes;

use super::{
    ConstructError, ConstructOptions, Constructed,
    central::central_image,
    construct, construct_subset,
    explain::{Coarse, State, states},
    sample::Tolerance,
    sight::{Face, Sight, Survey},
    view::{Reach, Rig, View},
};
use crate::octree::{Clusters, Octree};
use crate::placement::{Gaze, ImagePlan, PlacementPlan};
use crate::render::Caster;
use glam::DVec3;
use ldi_protocol::shade::srgb8_from_linear;
use ldi_protocol::{
    Aabb, ViewBasis,
    ldi::{END_PARTS, LINK_DOWN, LINK_RIGHT, Ldi, SIDES, SLOPE_CODES, Sliver, SliverCorner, end_of, is_loose},
};
use scenes::{Analytic, GREY, OUTPUT, RED, Random, plan, room};

/// As for datasets, but in one tile.
fn options() -> ConstructOptions {
    ConstructOptions { tile_pixels: 4_000_000, ..ConstructOptions::new(OUTPUT) }
}

fn made(scene: &Analytic, plan: &ImagePlan) -> Constructed {
    made_for(scene, plan, &[])
}

/// The image of a plan for these eyes, wherever they look.
fn made_for(scene: &Analytic, plan: &ImagePlan, eyes: &[DVec3]) -> Constructed {
    let survey = survey(scene, eyes);
    let made = construct_subset(scene, survey.as_ref(), plan, &options()).expect("the plan is sound");
    let [made] = <[Constructed; 1]>::try_from(made).expect("one tile");
    assert_eq!(made.ldi.check(), Ok(()));
    made
}

fn survey(scene: &Analytic, eyes: &[DVec3]) -> Option<Survey> {
    // As fine as the pixels of `plan_with_eyes`.
    Survey::of(scene, eyes, &Gaze::everywhere(3.0 * OUTPUT.focal_px()), &[])
}

/// (layer, column, row, disparity, rgb, links) of every sample.
fn samples(ldi: &Ldi) -> Vec<(usize, i64, i64, f64, [u8; 3], u8)> {
    let mut all = Vec::new();
    for (k, l) in ldi.layers.iter().enumerate() {
        for s in &l.segments {
            for i in s.first as usize..s.first as usize + usize::from(s.count) {
                let column = i64::from(s.column_base) + i64::from(l.column[i]);
                all.push((k, column, i64::from(s.row), ldi.codes.disparity(l.disparity[i]), l.rgb[i], l.links[i]));
            }
        }
    }
    all
}

/// Share of random points, seen by random eyes of the users, that have no sample of their plane within one pixel.
fn hole_fraction(scene: &Analytic, ldi: &Ldi, plan: &ImagePlan) -> f64 {
    // An output pixel of parallax for the worst eye.
    let pixel = 8.0 * Rig::new(plan, &OUTPUT).expect("sound").step();
    let mut by_pixel = std::collections::BTreeMap::<(i64, i64), Vec<f64>>::new();
    for (_, c, r, d, ..) in samples(ldi) {
        by_pixel.entry((c, r)).or_default().push(d);
    }
    let (mut random, mut seen, mut missing) = (Random(7), 0, 0);
    for _ in 0..20_000 {
        let eye = random.inside(&plan.users);
        let range = &plan.directions[0];
        let basis = ViewBasis::from_yaw_pitch(random.within(range.yaw_deg), random.within(range.pitch_deg));
        let (u, v) = (random.within([0.0, 160.0]), random.within([0.0, 120.0]));
        let direction = OUTPUT.ray(&basis, u, v);
        let Some(&(t, _, n)) = scene.all_hits(eye, direction).first() else { continue };
        if scene.first_stays(eye, direction) {
            continue;
        }
        let (u, v, d) = ldi.camera.project(eye + direction * t).expect("before the eye");
        let inside =
            u >= 1.0 && v >= 1.0 && u < f64::from(ldi.camera.width - 1) && v < f64::from(ldi.camera.height - 1);
        if !inside {
            continue;
        }
        seen += 1;
        let r = ldi.camera.ray(u, v);
        let slope = |along: DVec3| d * n.dot(along) / (ldi.camera.pixels_per_unit * n.dot(r));
        let (gu, gv) = (slope(ldi.camera.basis.right), -slope(ldi.camera.basis.up));
        let (c, r) = (u.floor() as i64, v.floor() as i64);
        let found = (-1..=1).any(|dy| {
            (-1..=1).any(|dx| {
                let at = |k: i64, d: i64| (k + d) as f64 + 0.5;
                let plane = d + gu * (at(c, dx) - u) + gv * (at(r, dy) - v);
                let slack = pixel + 0.5 * (gu.abs() + gv.abs());
                by_pixel.get(&(c + dx, r + dy)).is_some_and(|ds| ds.iter().any(|x| (x - plane).abs() <= slack))
            })
        });
        missing += u32::from(!found);
    }
    f64::from(missing) / f64::from(seen)
}

#[test]
fn every_sample_lies_on_the_surface() {
    let (scene, plan) = (room(), plan(9.0, [2.0, 1.0, 2.0]));
    let ldi = made(&scene, &plan).ldi;
    assert!(ldi.layers.len() >= 3 && ldi.samples() > 10_000);
    for (layer, c, r, d, ..) in samples(&ldi) {
        let direction = ldi.camera.ray(c as f64 + 0.5, r as f64 + 0.5);
        let error =
            scene.all_hits(plan.cop, direction).iter().map(|h| (1.0 / h.0 - d).abs()).fold(f64::INFINITY, f64::min);
        // Half a step of rounding, and f32.
        assert!(error <= 0.5 * ldi.codes.step + 1e-6 * d, "layer {layer} ({c}, {r}): off by {error}");
    }
}

#[test]
fn what_users_see_is_there_and_one_image_alone_has_holes() {
    let (scene, wide) = (room(), plan(9.0, [2.0, 1.0, 2.0]));
    let ldi = made(&scene, &wide).ldi;
    let holes = hole_fraction(&scene, &ldi, &wide);
    assert!(holes < 0.003, "{holes}");
    // Construction cameras for a tiny box of eyes see what the central image sees.
    let narrow = made(&scene, &plan(9.0, [1e-6; 3])).ldi;
    let without = hole_fraction(&scene, &narrow, &wide);
    assert!(without > 0.03, "{without}");
}

#[test]
fn a_slanted_plane_is_one_layer() {
    // From 10 m to 100 m away, seen at 3 degrees and less.
    let floor = Analytic::default().rect([-200.0, -1.0, -100.0], [400.0, 0.0, 0.0], [0.0, 0.2, 90.0], None, GREY);
    for scale in [0.5, 1.0, 2.0] {
        let mut plan = plan(9.0, [2.0, 0.6, 3.0]);
        plan.pixels_per_unit *= scale;
        let counts = made(&floor, &plan).stats.samples_by_layer;
        assert_eq!(counts.len(), 1, "{counts:?}");
    }
}

#[test]
fn links_join_planes_and_creases_but_no_two_surfaces() {
    let ldi = made(&room(), &plan(9.0, [2.0, 1.0, 2.0])).ldi;
    let all = samples(&ldi);
    let at: std::collections::BTreeMap<_, _> = all.iter().map(|s| ((s.0, s.1, s.2), s)).collect();
    let (mut linked, mut pairs, mut crease) = (0, 0, 0);
    for s in &all {
        for (dc, dr, bit) in [(1, 0, LINK_RIGHT), (0, 1, LINK_DOWN)] {
            let next = at.get(&(s.0, s.1 + dc, s.2 + dr));
            let joined = s.5 & bit != 0;
            let Some(next) = next else {
                assert!(!joined);
                continue;
            };
            // Wall and ball, wall and back wall, ball and back wall lie metres apart.
            let far = (1.0 / s.3 - 1.0 / next.3).abs() > 1.0;
            assert!(!(joined && far), "({}, {}) is linked across a depth edge", s.1, s.2);
            if s.4 == next.4 && !far {
                pairs += 1;
                linked += usize::from(joined);
            } else if !far {
                crease += usize::from(joined);
            }
        }
    }
    assert!(linked as f64 > 0.995 * pairs as f64, "{linked} of {pairs}");
    assert!(crease > 20, "floor and back wall meet: {crease}");
}

#[test]
fn a_surface_that_passes_behind_a_post_stays_linked() {
    // The wall behind the post changes from layer 0 to layer 1; a bridge joins the two.
    let scene = Analytic::default().rect([-30.0, -20.0, -20.0], [60.0, 0.0, 0.0], [0.0, 40.0, 0.0], None, GREY).rect(
        [-0.4, -30.0, -10.0],
        [0.8, 0.0, 0.0],
        [0.0, 60.0, 0.0],
        None,
        RED,
    );
    let ldi = made(&scene, &plan(9.0, [3.0, 0.5, 1.0])).ldi;
    let row = i64::from(ldi.camera.height / 2);
    let behind: Vec<_> = samples(&ldi).into_iter().filter(|s| s.0 == 1 && s.2 == row).collect();
    assert!(behind.len() >= 8);
    assert!(behind.windows(2).all(|w| w[0].1 + 1 == w[1].1 && w[0].5 & LINK_RIGHT != 0), "{behind:?}");
    let front = samples(&ldi).into_iter().filter(|s| s.0 == 0 && s.2 == row).collect::<Vec<_>>();
    for end in [behind.first(), behind.last()].into_iter().flatten() {
        assert!(front.iter().any(|f| f.1 == end.1 && f.3 == end.3), "the bridge repeats a sample of layer 0");
    }
}

/// How far a surface goes on from a pixel's centre, by many rays; at most 1.
fn end_by_rays(scene: &Analytic, ldi: &Ldi, surface: usize, (column, row): (i64, i64), side: [i32; 2]) -> f64 {
    const STEPS: i32 = 64;
    let on = |k: &i32| {
        let beyond = f64::from(*k) / f64::from(STEPS);
        let (u, v) =
            (column as f64 + 0.5 + beyond * f64::from(side[0]), row as f64 + 0.5 + beyond * f64::from(side[1]));
        scene.all_hits(ldi.camera.cop, ldi.camera.ray(u, v)).iter().any(|h| h.1 == surface)
    };
    f64::from((1..=STEPS).take_while(on).count() as i32) / f64::from(STEPS)
}

#[test]
fn surfaces_end_between_pixels_where_they_do() {
    // A wall behind a slanted board that is turned away: its own ends, and what lies behind reaches under it.
    let scene = Analytic::default().rect([-30.0, -20.0, -20.0], [60.0, 0.0, 0.0], [0.0, 40.0, 0.0], None, GREY).rect(
        [-2.0, -1.5, -12.0],
        [3.0, 0.7, -2.0],
        [0.4, 2.5, 0.3],
        None,
        RED,
    );
    let ldi = made(&scene, &plan(9.0, [1.0, 0.6, 1.0])).ldi;
    let mut found = [[0; 5]; 2];
    for layer in &ldi.layers {
        let linked = layer.linked_sides();
        for s in &layer.segments {
            for i in s.first as usize..s.first as usize + usize::from(s.count) {
                let at = (i64::from(s.column_base) + i64::from(layer.column[i]), i64::from(s.row));
                let direction = ldi.camera.ray(at.0 as f64 + 0.5, at.1 as f64 + 0.5);
                let d = ldi.codes.disparity(layer.disparity[i]);
                let hits = scene.all_hits(ldi.camera.cop, direction);
                let off = |h: &(f64, usize, DVec3)| (1.0 / h.0 - d).abs();
                let surface = hits.iter().min_by(|a, b| off(a).total_cmp(&off(b))).expect("a sample lies on one").1;
                for side in (0..4).filter(|side| linked[i] >> side & 1 == 0) {
                    let end = end_of(layer.ends[i], side);
                    let want = end_by_rays(&scene, &ldi, surface, at, SIDES[side]);
                    // Rays every quarter of a pixel, the first an eighth beyond the centre.
                    let error = (f64::from(end) / f64::from(END_PARTS) - want).abs();
                    assert!(error <= 0.125 + 2.0 / 64.0, "surface {surface} at {at:?}, side {side}: {end}, not {want}");
                    found[surface][usize::from(end)] += 1;
                }
            }
        }
    }
    assert!(found[1].iter().all(|n| *n > 5), "the board ends anywhere: {found:?}");
    assert!(found[0][4] > 50, "the wall goes on behind it: {found:?}");
}

#[test]
fn what_is_a_pixel_wide_tells_the_slope_of_its_plane() {
    // Shelves that the centre sees nearly edge-on, each less than a row high in its picture.
    let slope = 0.05;
    let shelf = |scene: Analytic, k: i32| {
        let y = f64::from(k) * 0.31;
        // Its plane passes a little below the centre's, so that it is seen from above or below, but hardly.
        scene.rect([-2.0, y, -12.0], [4.0, 0.0, 0.0], [0.0, y * 0.22 + slope, -3.0], None, RED)
    };
    let scene = (-9..=9).fold(Analytic::default(), shelf);
    let ldi = made(&scene, &plan(9.0, [1.0, 0.6, 1.0])).ldi;
    let (mut told, mut steepest) = (0, 0);
    for layer in &ldi.layers {
        let linked = layer.linked_sides();
        for s in &layer.segments {
            for i in s.first as usize..s.first as usize + usize::from(s.count) {
                let (u, v) = (f64::from(s.column_base) + f64::from(layer.column[i]) + 0.5, f64::from(s.row) + 0.5);
                let ray = ldi.camera.ray(u, v);
                let d = ldi.codes.disparity(layer.disparity[i]);
                let hits = scene.all_hits(ldi.camera.cop, ray);
                // d = n . r / (n . P), and r moves by a pixel down. Shelves may meet in a pixel.
                let unit = ldi.codes.step * f64::from(SLOPE_CODES);
                let of = |(t, _, n): &(f64, usize, DVec3)| {
                    let slope = -n.dot(ldi.camera.basis.up) / (ldi.camera.pixels_per_unit * n.dot(ray) * t);
                    // Steeper ones are not believed.
                    slope.clamp(-d, d) / unit
                };
                let wanted: Vec<f64> =
                    hits.iter().filter(|h| (1.0 / h.0 - d).abs() <= ldi.codes.step).map(of).collect();
                let got = f64::from(layer.slopes[i][1]);
                let open = is_loose(layer.ends[i], 1) && linked[i] & 12 == 0;
                if open && wanted.iter().all(|w| w.abs() < 127.0) {
                    assert!(wanted.iter().any(|w| (got - w).abs() <= 0.51), "{got} at {u}, {v}, not {wanted:?}");
                    told += 1;
                    steepest = steepest.max(layer.slopes[i][1].unsigned_abs());
                }
            }
        }
    }
    assert!(told > 100 && steepest > 10, "{told} slopes, up to {steepest}");
}

#[test]
fn a_wall_that_eyes_see_at_a_grazing_angle_has_no_slits() {
    // A screen hides it from the centre; the eyes in the left front corners see it past the screen, eight columns of the image in a pixel of theirs.
    let scene = Analytic::default().rect([-0.88, -3.0, -9.5], [1.4, 0.0, 0.0], [0.0, 6.0, 0.0], None, RED).rect(
        [-1.0, -3.0, -11.0],
        [1.2, 0.0, -6.0],
        [0.0, 6.0, 0.0],
        None,
        GREY,
    );
    let mut plan = plan(9.0, [2.0, 1.0, 2.0]);
    plan.pixels_per_unit *= 4.0;
    let ldi = made(&scene, &plan).ldi;
    let mut columns = std::collections::BTreeMap::<i64, Vec<i64>>::new();
    let middle = i64::from(ldi.camera.height) / 2;
    let of_wall = |s: &(usize, i64, i64, f64, [u8; 3], u8)| s.0 > 0 && s.3 < 1.0 / 11.5 && (s.2 - middle).abs() < 50;
    for (_, column, row, ..) in samples(&ldi).into_iter().filter(of_wall) {
        columns.entry(row).or_default().push(column);
    }
    assert_eq!(columns.len(), 99);
    for (row, columns) in columns {
        assert!(columns.len() > 30, "row {row} holds {} columns of the wall", columns.len());
        let slit = columns.windows(2).find(|c| c[1] > c[0] + 1);
        assert_eq!(slit, None, "row {row}");
    }
}

#[test]
fn an_image_of_one_column_is_sound() {
    let pixel = 1.0 / OUTPUT.focal_px();
    let narrow = ImagePlan { window: [0.2 * pixel, 0.8 * pixel, -0.5, 0.5], ..plan(9.0, [1.0, 0.6, 1.0]) };
    let ldi = made(&room(), &narrow).ldi;
    assert!(ldi.camera.width == 1 && ldi.layers[0].links.contains(&LINK_DOWN));
}

/// Where a sliver's corner lies.
fn world(ldi: &Ldi, c: &SliverCorner) -> DVec3 {
    let place = |x: i32| f64::from(x) / f64::from(Sliver::PARTS);
    ldi.camera.cop + ldi.camera.ray(place(c.u), place(c.v)) / ldi.codes.disparity(c.disparity)
}

#[test]
fn where_a_surface_turns_back_on_itself_its_sides_are_joined() {
    // The eyes in the corners see three pixels beyond the silhouette of the centre.
    let (centre, radius) = (DVec3::new(0.3, 0.1, -12.0), 2.0);
    let scene = Analytic::default().rect([-30.0, -20.0, -20.0], [60.0, 0.0, 0.0], [0.0, 40.0, 0.0], None, GREY).sphere(
        centre.into(),
        radius,
        RED,
    );
    let mut plan = plan(9.0, [6.0, 6.0, 1.0]);
    plan.pixels_per_unit *= 4.0;
    let ldi = made(&scene, &plan).ldi;
    // Squares of a camera's picture are slivers too, but wider.
    let part = Sliver::PARTS / i32::from(END_PARTS);
    let folds = ldi.slivers.iter().filter(|s| {
        let [a, b, e, f] = &s.corners;
        [(a, b), (e, f)].iter().all(|(a, b)| a.u.abs_diff(b.u) + a.v.abs_diff(b.v) <= part as u32)
    });
    let folds: Vec<[DVec3; 4]> = folds.map(|s| s.corners.each_ref().map(|c| world(&ldi, c))).collect();
    // Within a pixel of the silhouette a sphere is as deep as this.
    let pixel = (centre - ldi.camera.cop).length() / ldi.camera.pixels_per_unit;
    let deep = (2.0 * radius * pixel).sqrt();
    for p in folds.iter().flatten() {
        let ray = (*p - ldi.camera.cop).normalize();
        let aside = (centre - ldi.camera.cop).cross(ray).length() - radius;
        let off = p.distance(centre) - radius;
        assert!(aside.abs() < 1.5 * pixel && off.abs() < deep, "{p} is {aside} m beside the silhouette, {off} m off");
    }
    // The circle in which rays from the centre of projection touch it.
    let to = centre - ldi.camera.cop;
    let middle = centre - to * (radius / to.length()).powi(2);
    let [a, b] = [to.any_orthonormal_vector(), to.cross(to.any_orthonormal_vector()).normalize()];
    let around = (radius.powi(2) - middle.distance_squared(centre)).sqrt();
    let closed = (0..1000)
        .filter(|k| {
            let (sin, cos) = (f64::from(*k) * 2e-3 * std::f64::consts::PI).sin_cos();
            let p = middle + (a * cos + b * sin) * around;
            folds.iter().any(|fold| {
                let bounds = fold.iter().fold(Aabb::EMPTY, |b, c| b.grown_to(*c));
                bounds.inflated(pixel).contains(p) && bounds.size().z < 2.0 * deep
            })
        })
        .count();
    assert!(closed > 700, "{closed} of 1000 places on the silhouette, {} folds", folds.len());
}

#[test]
fn what_the_centre_sees_edge_on_is_held_by_slivers() {
    // A post whose side is a third of a pixel wide for the centre of projection, with no pixel's centre on it; eyes beside it see it at 8 degrees and less.
    let (x, z) = (0.1, [-14.0, -10.0]);
    let post = |behind: Analytic| {
        behind.rect([-x, -1.0, z[1]], [2.0 * x, 0.0, 0.0], [0.0, 2.0, 0.0], None, GREY).rect(
            [x, -1.0, z[1]],
            [0.0, 0.0, z[0] - z[1]],
            [0.0, 2.0, 0.0],
            None,
            RED,
        )
    };
    let wall = Analytic::default().rect([-30.0, -20.0, -20.0], [60.0, 0.0, 0.0], [0.0, 40.0, 0.0], None, GREY);
    slivers_hold(&post(wall), x, z);
    // Rays beside it meet nothing.
    slivers_hold(&post(Analytic::default()), x, z);
}

/// The red side of a post, at this place across and from end to end along the view.
fn slivers_hold(scene: &Analytic, x: f64, z: [f64; 2]) {
    let ldi = made(scene, &plan(9.0, [1.5, 0.6, 1.0])).ldi;
    let red = ldi.slivers.iter().filter(|s| s.rgb[0] > s.rgb[1] + 50);
    let of_wall: Vec<[DVec3; 4]> = red.map(|s| s.corners.each_ref().map(|c| world(&ldi, c))).collect();
    assert!(!of_wall.is_empty());
    // A part of a pixel at 14 m; along the wall as much more as it is askew to a camera, and a camera's pixel.
    let part = 14.0 / (ldi.camera.pixels_per_unit * f64::from(Sliver::PARTS));
    for p in of_wall.iter().flatten() {
        let inside = p.y.abs() < 1.0 + 32.0 * part && (z[0] - 1.5..z[1] + 1.5).contains(&p.z);
        assert!((p.x - x).abs() < part && inside, "{p}");
    }
    let (mut random, mut held, mut of_layers) = (Random(5), 0, 0);
    for _ in 0..2000 {
        // To its very ends: a pixel of a camera is 0.7 m of the wall, and without going on a tenth of it were missing.
        let p = DVec3::new(x, random.within([-0.9, 0.9]), random.within(z));
        let around = |corners: &[DVec3; 4]| {
            let bounds = corners.iter().fold(Aabb::EMPTY, |b, c| b.grown_to(DVec3::new(x, c.y, c.z)));
            bounds.inflated(part).contains(p)
        };
        held += u32::from(of_wall.iter().any(around));
        let (u, v, d) = ldi.camera.project(p).expect("ahead");
        let near = |s: &(usize, i64, i64, f64, [u8; 3], u8)| {
            (s.1, s.2) == (u.floor() as i64, v.floor() as i64) && (s.3 / d - 1.0).abs() < 0.01
        };
        of_layers += u32::from(samples(&ldi).iter().any(near));
    }
    assert!(held > 1900, "{held} of 2000 points in slivers");
    assert!(of_layers < 1000, "{of_layers} of 2000 in layers: no slivers would be needed");
}

#[test]
fn colours_are_averaged_over_the_pixel_where_they_change() {
    // Two coplanar halves; their border runs through the middle of a pixel.
    let edge = 0.5 / OUTPUT.focal_px() * 10.0;
    let scene = Analytic::default()
        .rect([-20.0, -20.0, -10.0], [20.0 + edge, 0.0, 0.0], [0.0, 40.0, 0.0], None, [1.0, 1.0, 1.0])
        .rect([edge, -20.0, -10.0], [20.0, 0.0, 0.0], [0.0, 40.0, 0.0], None, [0.0, 0.0, 0.0]);
    let made = made(&scene, &plan(9.0, [1e-6; 3]));
    let column = -i64::from(made.ldi.camera.left);
    for s in samples(&made.ldi) {
        let expected = match s.1.cmp(&column) {
            std::cmp::Ordering::Less => 255,
            std::cmp::Ordering::Equal => 188, // sRGB of one half
            std::cmp::Ordering::Greater => 0,
        };
        assert_eq!(s.4, [expected; 3], "column {} against {column}", s.1);
    }
    let border = samples(&made.ldi).iter().filter(|s| s.1 == column || s.1 + 1 == column).count() as u64;
    assert_eq!(made.stats.rays.colour, border * 4, "only the border's two columns are averaged");
}

#[test]
fn textures_are_averaged_over_the_pixel_and_no_more() {
    let metres_per_pixel = 10.0 / OUTPUT.focal_px();
    // Half a period is less than two pixels: every pixel has a neighbour of another colour.
    let period = 3.3 * metres_per_pixel;
    let wall = Analytic::default().rect([-20.0, -20.0, -10.0], [40.0, 0.0, 0.0], [0.0, 40.0, 0.0], None, [1.0; 3]);
    let ldi = made(&Analytic { grating_m: Some(period), ..wall }, &plan(9.0, [1e-6; 3])).ldi;
    for s in samples(&ldi) {
        let left = (s.1 + i64::from(ldi.camera.left)) as f64 * metres_per_pixel;
        let expected = srgb8_from_linear(scenes::lit_share(period, left, left + metres_per_pixel));
        assert!(s.4.iter().all(|c| c.abs_diff(expected) <= 1), "column {}: {:?}, not {expected}", s.1, s.4);
    }
}

#[test]
fn sky_is_known_where_some_eye_sees_it() {
    // A plate in the open: sky all around it, and behind it only where the plate is narrower than the parallax.
    let scene = Analytic::default().rect([-2.0, -2.0, -10.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], None, GREY);
    let ldi = made(&scene, &plan(9.0, [1.0, 0.1, 1.0])).ldi;
    let at = |x: f64, y: f64| {
        let f = OUTPUT.focal_px();
        ldi.is_sky(
            (x * f).floor() as i64 - i64::from(ldi.camera.left),
            (y * f).floor() as i64 - i64::from(ldi.camera.top),
        )
        .expect("inside the image")
    };
    assert!(at(0.5, 0.0) && at(-0.5, 0.0), "beside the plate");
    assert!(at(0.15, 0.0) && at(-0.15, 0.0), "behind its edge, seen from one metre aside");
    assert!(!at(0.0, 0.0), "behind its middle");
}

/// Sky is a direction: where an eye sees it, and where none does, away from the borders by the distance of rays.
#[test]
fn the_sky_of_a_survey_is_what_its_eyes_see() {
    // A wall ahead, up to a height; nothing else.
    let scene = Analytic::default().rect([-50.0, -2.0, -10.0], [100.0, 0.0, 0.0], [0.0, 4.0, 0.0], None, GREY);
    let eyes: Vec<DVec3> = (0..64).map(|k| DVec3::new(f64::from(k % 8) * 0.1, f64::from(k / 8) * 0.1, 0.0)).collect();
    let sky = survey(&scene, &eyes).expect("there are eyes").sky(&scene).0;
    let ahead = |elevation: f64| sky.holds(DVec3::new(0.3, elevation, -10.0));
    // The highest eye, at 0.7 m, sees the wall's upper border 1.3 m above itself, the lowest 2 m.
    assert!((-19..12).all(|k| !ahead(f64::from(k) * 0.1)), "the wall, for every eye");
    assert!((15..100).all(|k| ahead(f64::from(k) * 0.1)), "above it, for some");
    assert!(sky.holds(DVec3::Z) && sky.holds(DVec3::Y), "behind and above");
}

#[test]
fn the_sky_through_a_slit_is_whole() {
    // A slit between two walls, narrower than the rays of a survey are apart, and as high as many of them: two eyes find some of its squares.
    let wall = |scene: Analytic, x: f64| scene.rect([x, -20.0, -10.0], [20.0, 0.0, 0.0], [0.0, 40.0, 0.0], None, GREY);
    let scene = wall(wall(Analytic::default(), -20.1), 0.1);
    let survey = survey(&scene, &[DVec3::ZERO, DVec3::new(0.01, 0.0, 0.0)]).expect("there are eyes");
    let (sky, rays) = survey.sky(&scene);
    assert!((-150..150).all(|k| sky.holds(DVec3::new(0.001, f64::from(k) * 0.1, -10.0))), "the slit");
    assert!((-150..150).all(|k| !sky.holds(DVec3::new(0.5, f64::from(k) * 0.1, -10.0))), "beside it");
    assert!(rays > 300, "{rays}");
}

#[test]
fn the_same_image_from_any_number_of_threads() {
    let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads start");
    let (scene, plan) = (room(), plan(9.0, [2.0, 1.0, 2.0]));
    let one = pool(1).install(|| made(&scene, &plan).ldi);
    let many = pool(5).install(|| made(&scene, &plan).ldi);
    assert!(one == many);
}

/// The bound on d(output pixel)/d(disparity) against finite differences over random eyes and directions.
#[test]
fn no_eye_exceeds_the_parallax_bound() {
    let plan = plan(9.0, [2.0, 1.0, 3.0]);
    let rig = Rig::new(&plan, &OUTPUT).expect("sound");
    let (mut random, mut largest) = (Random(3), 0.0_f64);
    let f = OUTPUT.focal_px();
    for _ in 0..200_000 {
        let eye = random.inside(&plan.users);
        let basis = ViewBasis::from_yaw_pitch(random.within([-40.0, 40.0]), random.within([-40.0, 40.0]));
        let ray = rig.lens.ray(random.within([-1.0, 1.0]) * f, random.within([-0.8, 0.8]) * f);
        let d = random.within([1e-3, 1.0 / 9.0]);
        let project = |d: f64| {
            let e = plan.cop + ray / d - eye;
            glam::DVec2::new(e.dot(basis.right), e.dot(basis.up)) * f / e.dot(basis.forward)
        };
        let at = project(d);
        if at.x.abs() <= 80.0 && at.y.abs() <= 60.0 && (plan.cop + ray / d - eye).dot(basis.forward) > 0.0 {
            let h = 1e-6 * d;
            largest = largest.max((project(d + h) - project(d - h)).length() / (2.0 * h));
        }
    }
    assert!(largest <= rig.parallax_bound, "{largest} > {}", rig.parallax_bound);
    // And the bound is no more than about twofold, else bits are wasted.
    assert!(largest > 0.4 * rig.parallax_bound, "{largest} against {}", rig.parallax_bound);
}

/// What the reach prunes, no user has in a picture.
#[test]
fn pruning_loses_nothing_that_a_user_sees() {
    let mut plan = plan(9.0, [2.0, 1.0, 3.0]);
    plan.directions[0].yaw_deg = [5.0, 25.0];
    plan.directions[0].pitch_deg = [-20.0, 10.0];
    let rig = Rig::new(&plan, &OUTPUT).expect("sound");
    let (mut random, mut pruned) = (Random(5), 0);
    for _ in 0..200_000 {
        let eye = random.inside(&plan.users);
        let basis = ViewBasis::from_yaw_pitch(random.within([5.0, 25.0]), random.within([-20.0, 10.0]));
        let x = eye
            + OUTPUT.ray(&basis, random.within([0.0, 160.0]), random.within([0.0, 120.0])) * random.within([8.0, 60.0]);
        let e = rig.lens.in_basis(x - plan.cop);
        let s = plan.pixels_per_unit / e.z;
        if e.z >= 9.0 {
            assert!(rig.in_reach(e.x * s, -e.y * s, 1.0 / e.z));
        }
        let far = DVec3::new(random.within([-40.0, 40.0]), random.within([-40.0, 40.0]), random.within([9.0, 40.0]));
        pruned += u32::from(!rig.in_reach(
            far.x / far.z * plan.pixels_per_unit,
            far.y / far.z * plan.pixels_per_unit,
            1.0 / far.z,
        ));
    }
    assert!(pruned > 20_000, "the test can fail: {pruned} of random points are beyond reach");
    plan.directions[0].yaw_deg = [0.0, 180.0];
    assert_eq!(Reach::of(&plan, &OUTPUT).u[0], f64::NEG_INFINITY);
}

/// `room`, seen through the door and the window of a wall that stays.
fn next_door() -> Analytic {
    let wall = |hole| Analytic::default().rect([-30.0, -30.0, -5.0], [60.0, 0.0, 0.0], [0.0, 60.0, 0.0], hole, GREY);
    room().behind(wall(Some([0.49, 0.51, 0.47, 0.52])))
}

/// The plan of an image, and eyes spread over its users' box.
fn plan_with_eyes(count: usize) -> (ImagePlan, Vec<DVec3>) {
    let mut plan = plan(9.0, [0.6, 0.2, 0.4]);
    // As wide as real images are, in squares of the raster.
    plan.pixels_per_unit *= 3.0;
    let mut random = Random(11);
    let eyes = plan.users.corners().into_iter().chain((8..count).map(|_| random.inside(&plan.users))).collect();
    (plan, eyes)
}

#[test]
fn what_stays_hides_and_what_shows_past_it_is_there() {
    let (plan, eyes) = plan_with_eyes(256);
    let scene = next_door();
    let behind = made_for(&scene, &plan, &eyes);
    let holes = hole_fraction(&scene, &behind.ldi, &plan);
    assert!(holes < 0.003, "{holes}");
    let open = made_for(&room(), &plan, &eyes);
    assert!(hole_fraction(&room(), &open.ldi, &plan) < 0.003);
    assert!(behind.ldi.samples() > 500, "something shows");
    assert!(behind.ldi.samples() * 2 < open.ldi.samples(), "{} of {}", behind.ldi.samples(), open.ldi.samples());
    assert!(behind.stats.rays.total() * 2 < open.stats.rays.total(), "{:?} of {:?}", behind.stats, open.stats);
    // One eye alone overlooks what others see.
    let one = made_for(&scene, &plan, &[DVec3::new(0.6, 0.0, 0.4)]);
    let missing = hole_fraction(&scene, &one.ldi, &plan);
    assert!(missing > 10.0 * holes, "{missing} {holes}");
}

#[test]
fn what_is_skipped_does_not_show_where_a_camera_looks() {
    let (plan, eyes) = plan_with_eyes(64);
    let scene = next_door();
    let mut rig = Rig::new(&plan, &OUTPUT).expect("sound");
    let tolerance = Tolerance { step: rig.step() as f32 };
    let face = survey(&scene, &eyes).map(|s| Face::of(&s, &plan, &rig));
    let sight = Sight::of(face.as_ref(), &mut rig).expect("something is seen");
    let (central, _) = central_image(&scene, &rig, &sight.looked);
    let coarse = Coarse::new(&central, rig.window.width as usize);
    let states = |view: &View| states(&rig, view, (&central, &coarse, &[]), &tolerance);
    let (mut open, mut closed, mut traced) = (0, 0, 0);
    for view in sight.cameras(&rig, &central, &tolerance).iter().flatten() {
        let width = view.camera.window.width as usize;
        let everywhere = states(&View { open: None, ..view.clone() });
        for (pixel, (some, all)) in states(view).into_iter().zip(everywhere).enumerate() {
            if view.open.as_ref().expect("eyes are known").holds(pixel % width, pixel / width) {
                assert_eq!(some, all, "pixel {pixel}");
                open += 1;
                traced += usize::from(some != State::Explained);
            } else {
                assert_eq!(some, State::Explained);
                closed += 1;
            }
        }
    }
    assert!(open > 2_000 && closed > 2_000 && traced > 200, "{open} {closed} {traced}");
}

#[test]
fn two_cameras_look_at_what_many_eyes_see() {
    let (plan, _) = plan_with_eyes(8);
    let scene = next_door();
    let views = |eyes: &[DVec3]| {
        let mut rig = Rig::new(&plan, &OUTPUT).expect("sound");
        let tolerance = Tolerance { step: rig.step() as f32 };
        let face = survey(&scene, eyes).map(|s| Face::of(&s, &plan, &rig));
        let sight = Sight::of(face.as_ref(), &mut rig).expect("something is seen");
        let (central, _) = central_image(&scene, &rig, &sight.looked);
        sight.cameras(&rig, &central, &tolerance).iter().flatten().count()
    };
    let eye = DVec3::new(0.6, 0.0, 0.4);
    // Rays of an eye are random, so that of many some see pieces that others do not.
    assert_eq!([1, 2, 3].map(|eyes| views(&vec![eye; eyes])), [1, 2, 2]);
}

#[test]
fn samples_lie_where_they_would_without_what_stays() {
    let (plan, eyes) = plan_with_eyes(12);
    let (behind, open) = (made_for(&next_door(), &plan, &eyes).ldi, made_for(&room(), &plan, &eyes).ldi);
    let shift = (behind.camera.left - open.camera.left, behind.camera.top - open.camera.top);
    let all: std::collections::BTreeMap<(i64, i64), Vec<f64>> =
        samples(&open).into_iter().fold(Default::default(), |mut all, s| {
            all.entry((s.1, s.2)).or_insert_with(Vec::new).push(s.3);
            all
        });
    let found = samples(&behind);
    let same = found.iter().filter(|s| {
        let here = all.get(&(s.1 + i64::from(shift.0), s.2 + i64::from(shift.1)));
        here.is_some_and(|ds| ds.iter().any(|d| (d - s.3).abs() <= behind.codes.step + open.codes.step))
    });
    assert!(same.count() as f64 > 0.98 * found.len() as f64);
}

#[test]
fn an_image_that_nobody_sees_is_empty_and_costs_little() {
    let wall = Analytic::default().rect([-90.0, -90.0, -5.0], [180.0, 0.0, 0.0], [0.0, 180.0, 0.0], None, GREY);
    let (scene, (plan, eyes)) = (room().behind(wall), plan_with_eyes(12));
    let survey = survey(&scene, &eyes).expect("there are eyes");
    let made = construct_subset(&scene, Some(&survey), &plan, &options()).expect("sound");
    assert!(made.is_empty() && survey.rays > 0);
}

/// As the paper's grid may plan it: what is replaced lies in the planning square, but in nobody's picture.
#[test]
fn an_image_without_a_window_is_left_out_and_the_others_are_made() {
    let scene = std::sync::Arc::new(crate::scene::load("builtin:pipes?triangles=2000").expect("built in"));
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, 500);
    let caster = Caster::new(std::sync::Arc::clone(&scene), &clusters, &octree).with_mips();
    let middle = scene.bounds().centre();
    let image = ImagePlan { cop: middle, users: Aabb { min: middle, max: middle }, ..plan(0.5, [0.0; 3]) };
    let placement = PlacementPlan {
        grid_point: Some(0),
        cop: middle,
        culled: (0..octree.cells.len() as u32).collect(),
        users: image.users,
        eyes: vec![middle],
        gaze: Gaze::everywhere(OUTPUT.focal_px()),
        through: vec![],
        footprint_px: 2.0,
        images: vec![ImagePlan { window: [0.3, 0.3, -0.1, 0.1], ..image.clone() }, image],
    };
    let made = construct(&caster, &placement, &options()).expect("sound");
    assert!(made.images[0].is_empty() && made.sight_rays > 0);
    assert!(made.images[1].iter().any(|t| t.ldi.samples() > 0));
}

#[test]
fn an_empty_scene_is_all_sky() {
    let made = made(&Analytic::default(), &plan(9.0, [1.0; 3]));
    assert_eq!(made.ldi.samples(), 0);
    assert_eq!(made.stats.sky_pixels, u64::from(made.ldi.camera.width) * u64::from(made.ldi.camera.height));
}

#[test]
fn unusable_plans_are_refused() {
    let refuse = |change: fn(&mut ImagePlan)| {
        let mut plan = plan(9.0, [1.0; 3]);
        change(&mut plan);
        construct_subset(&Analytic::default(), None, &plan, &options()).map(|_| ()).expect_err("refused")
    };
    assert!(matches!(refuse(|p| p.window[0] = f64::NAN), ConstructError::Plan));
    assert!(matches!(refuse(|p| p.window[1] = p.window[0]), ConstructError::Plan));
    assert!(matches!(refuse(|p| p.plane_distance = 0.0), ConstructError::Plan));
    assert!(matches!(refuse(|p| p.users = Aabb::EMPTY), ConstructError::Plan));
    assert!(matches!(refuse(|p| p.window[1] = 1e9), ConstructError::Size { .. }));
    assert!(matches!(refuse(|p| p.pixels_per_unit = 1e5), ConstructError::Size { .. }));
}
