//! Surfaces in images: what is linked, where it ends, and what is seen edge-on.

use super::*;

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
    // A wall behind a slanted board that is turned away: its own ends, and what lies behind
    // reaches under it.
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
        // Its plane passes a little below the centre's, so that it is seen from above or below,
        // but hardly.
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
    // A screen hides it from the centre; the eyes in the left front corners see it past the
    // screen, eight columns of the image in a pixel of theirs.
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
    // A post whose side is a third of a pixel wide for the centre of projection, with no pixel's
    // centre on it; eyes beside it see it at 8 degrees and less.
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
    // A part of a pixel at 14 m; along the wall as much more as it is askew to a camera, and a
    // camera's pixel.
    let part = 14.0 / (ldi.camera.pixels_per_unit * f64::from(Sliver::PARTS));
    for p in of_wall.iter().flatten() {
        let inside = p.y.abs() < 1.0 + 32.0 * part && (z[0] - 1.5..z[1] + 1.5).contains(&p.z);
        assert!((p.x - x).abs() < part && inside, "{p}");
    }
    let (mut random, mut held, mut of_layers) = (Random(5), 0, 0);
    for _ in 0..2000 {
        // To its very ends: a pixel of a camera is 0.7 m of the wall, and without going on a tenth
        // of it were missing.
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
