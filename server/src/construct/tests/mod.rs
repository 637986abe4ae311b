//! Construction judged on analytic scenes: where samples lie, what is missing, what is doubled,
//! what is linked.

mod references;
mod scenes;
mod surfaces;

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

/// Share of random points, seen by random eyes of the users, that have no sample of their plane
/// within one pixel.
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
    // A plate in the open: sky all around it, and behind it only where the plate is narrower than
    // the parallax.
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

/// Sky is a direction: where an eye sees it, and where none does, away from the borders by the
/// distance of rays.
#[test]
fn the_sky_of_a_survey_is_what_its_eyes_see() {
    // A wall ahead, up to a height; nothing else.
    let scene = Analytic::default().rect([-50.0, -2.0, -10.0], [100.0, 0.0, 0.0], [0.0, 4.0, 0.0], None, GREY);
    let eyes: Vec<DVec3> = (0..64).map(|k| DVec3::new(f64::from(k % 8) * 0.1, f64::from(k / 8) * 0.1, 0.0)).collect();
    let sky = survey(&scene, &eyes).expect("there are eyes").sky(&scene, &[], &[]).0;
    let ahead = |elevation: f64| sky.holds(DVec3::new(0.3, elevation, -10.0));
    // The highest eye, at 0.7 m, sees the wall's upper border 1.3 m above itself, the lowest 2 m.
    assert!((-19..12).all(|k| !ahead(f64::from(k) * 0.1)), "the wall, for every eye");
    assert!((15..100).all(|k| ahead(f64::from(k) * 0.1)), "above it, for some");
    assert!(sky.holds(DVec3::Z) && sky.holds(DVec3::Y), "behind and above");
}

#[test]
fn the_sky_through_a_slit_is_whole() {
    // A slit between two walls, narrower than the rays of a survey are apart, and as high as many
    // of them: two eyes find some of its squares.
    let wall = |scene: Analytic, x: f64| scene.rect([x, -20.0, -10.0], [20.0, 0.0, 0.0], [0.0, 40.0, 0.0], None, GREY);
    let scene = wall(wall(Analytic::default(), -20.1), 0.1);
    let survey = survey(&scene, &[DVec3::ZERO, DVec3::new(0.01, 0.0, 0.0)]).expect("there are eyes");
    let (sky, rays) = survey.sky(&scene, &[], &[]);
    assert!((-150..150).all(|k| sky.holds(DVec3::new(0.001, f64::from(k) * 0.1, -10.0))), "the slit");
    assert!((-150..150).all(|k| !sky.holds(DVec3::new(0.5, f64::from(k) * 0.1, -10.0))), "beside it");
    assert!(rays > 300, "{rays}");
}

/// An opening of a near wall and one of a far wall, aside: an eye at x sees sky with dx/dz between
/// (x - 1) / 2 and x / 2, and between x / 6 and (x + 1) / 6. Of the one between 5/12 and 1/2 only
/// places beyond x = 1.5 see some, and each another part.
#[test]
fn sky_that_only_lookouts_see_is_known_within_the_polygon() {
    let wall =
        |scene: Analytic, x: f64, z: f64| scene.rect([x, -20.0, -z], [20.0, 0.0, 0.0], [0.0, 40.0, 0.0], None, GREY);
    let near = wall(wall(Analytic::default(), -20.0, 2.0), 1.0, 2.0);
    let scene = wall(wall(near, -21.0, 6.0), 0.0, 6.0);
    let at = |x: f64| DVec3::new(x, 0.0, 0.0);
    let survey = survey(&scene, &[at(1.0), at(1.5)]).expect("there are eyes");
    let lookouts: Vec<DVec3> = (0..40).map(|k| at(1.0 + 0.025 * f64::from(k))).collect();
    let upper = [[0.0, 0.0], [1.0, 0.0], [1.0, 4.0], [0.0, 4.0]].map(|[x, y]| DVec3::new(x, y, -2.0));
    let [none, all, above] = [(&[][..], &[][..]), (&lookouts, &[]), (&lookouts, &upper)]
        .map(|(lookouts, through)| survey.sky(&scene, lookouts, through).0);
    for (slope, by_survey, by_lookouts) in
        [(0.25, true, true), (0.40, true, true), (0.44, false, true), (0.47, false, true), (0.52, false, false)]
    {
        for elevation in [-0.2, 0.2] {
            let holds = |sky: &ldi_protocol::sky::SkyMap| sky.holds(DVec3::new(-slope, elevation, -1.0));
            assert_eq!(holds(&none), by_survey, "{slope} {elevation}");
            assert_eq!(holds(&all), by_lookouts, "{slope} {elevation}");
            // What the survey itself met, wherever its rays went, is known below the polygon, too.
            assert!(holds(&above) == (by_lookouts && elevation > 0.0) || by_survey, "{slope} {elevation}");
        }
    }
}

#[test]
fn the_same_image_from_any_number_of_threads() {
    let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads start");
    let (scene, plan) = (room(), plan(9.0, [2.0, 1.0, 2.0]));
    let one = pool(1).install(|| made(&scene, &plan).ldi);
    let many = pool(5).install(|| made(&scene, &plan).ldi);
    assert!(one == many);
}

/// The bound on d(output pixel)/d(disparity) against finite differences over random eyes and
/// directions.
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
    let rays = [&behind, &open].map(|made| made.stats.rays.total() - made.stats.rays.hidden);
    assert!(rays[0] * 2 < rays[1], "{:?} of {:?}", behind.stats, open.stats);
    // One eye alone overlooks what others see.
    let one = made_for(&scene, &plan, &[DVec3::new(0.6, 0.0, 0.4)]);
    let missing = hole_fraction(&scene, &one.ldi, &plan);
    assert!(missing > 10.0 * holes, "{missing} {holes}");
}

/// Every sample is seen by an eye or lies beside one that is, and fewer than half are not seen.
#[test]
fn what_no_eye_sees_past_what_stays_is_not_kept() {
    let (plan, eyes) = plan_with_eyes(64);
    let scene = next_door();
    let ldi = made_for(&scene, &plan, &eyes).ldi;
    let all = samples(&ldi);
    let is_seen = |c: i64, r: i64, d: f64| {
        let place = plan.cop + ldi.camera.ray(c as f64 + 0.5, r as f64 + 0.5) / d;
        eyes.iter().any(|eye| !scene.first_stays(*eye, place - *eye))
    };
    let mut seen = std::collections::BTreeSet::new();
    seen.extend(all.iter().filter(|(_, c, r, d, ..)| is_seen(*c, *r, *d)).map(|(_, c, r, ..)| (*c, *r)));
    // A bridge repeats a sample beyond.
    let reach = super::hidden::AROUND as i64 + 1;
    for (layer, c, r, ..) in &all {
        let near = (-reach..=reach).any(|dc| seen.range((c + dc, r - reach)..=(c + dc, r + reach)).next().is_some());
        assert!(near, "layer {layer} ({c}, {r})");
    }
    assert!(seen.len() > 5_000 && all.len() < 2 * seen.len(), "{} of {}", seen.len(), all.len());
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

/// As the paper's grid may plan it: what is replaced lies in the planning square, but in nobody's
/// picture.
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
        lookouts: vec![],
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
