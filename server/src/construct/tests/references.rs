//! Portal images of 1998 over an analytic room: what they hold, by lines through the scene in f64.

use super::super::{
    ConstructOptions, SAME_DEPTH,
    references::{SideImages, construct_side_of},
};
use super::scenes::Analytic;
use crate::portal::{Semicircle, SidePlan, plan_semicircles};
use glam::DVec3;
use ldi_protocol::{
    Aabb, OutputCamera,
    index::BuildSettings,
    ldi::Ldi,
    rooms::{Cell, Portal, PortalKind, Rooms},
    volume::WalkVolume,
};

const OUTPUT: OutputCamera = OutputCamera { width: 160, height: 128, fov_deg: 60.0 };

/// East of a door in the plane x = 0: floor, back wall with a window to the sky, side wall, and a
/// post before them.
fn room() -> Analytic {
    Analytic::default()
        .rect([0.0, 0.0, -4.0], [6.0, 0.0, 0.0], [0.0, 0.0, 8.0], None, [0.2, 0.2, 0.2])
        .rect([5.0, 0.0, -4.0], [0.0, 3.0, 0.0], [0.0, 0.0, 8.0], Some([0.5, 0.7, 0.4, 0.6]), [0.6, 0.1, 0.1])
        .rect([0.0, 0.0, 1.5], [5.0, 0.0, 0.0], [0.0, 3.0, 0.0], None, [0.1, 0.6, 0.1])
        .rect([1.5, 0.0, -0.1], [0.0, 3.0, 0.0], [0.0, 0.0, 0.4], None, [0.1, 0.1, 0.6])
}

/// The side of the door that is seen from the west.
fn plan() -> SidePlan {
    let cell = |name: &str, x: f64| Cell {
        name: name.into(),
        boxes: vec![Aabb { min: DVec3::new(x, 0.0, -4.0), max: DVec3::new(x + 6.0, 3.0, 4.0) }],
    };
    let corners = [(0.0, -0.5), (0.0, 0.5), (2.0, 0.5), (2.0, -0.5)].map(|(y, z)| DVec3::new(0.0, y, z)).to_vec();
    let door = Portal { cells: [Some(0), Some(1)], kind: PortalKind::Door, corners };
    let flipped = Portal { cells: [Some(1), Some(0)], ..door.clone() };
    let door = if door.normal().x > 0.0 { door } else { flipped };
    let rooms = Rooms::new(0.1, vec![cell("west", -6.0), cell("east", 0.0)], vec![door]).expect("sound");
    let cut = Aabb { min: DVec3::new(-5.75, 0.0, -3.75), max: DVec3::new(-0.25, 0.0, 3.75) };
    let runs = vec![vec![[0u16, 9]]; 12 * 16];
    let volume = WalkVolume::new(DVec3::new(-6.0, 1.1, -4.0), 0.5, 0.1, [12, 16], &runs, &cut).expect("sound");
    let settings =
        BuildSettings { camera: OUTPUT, eye_height_m: Some(1.6), ..crate::placement::test_scenes::settings(1000) };
    let (mut plans, _) = plan_semicircles(&rooms, &volume, &settings, 1.5, &Semicircle::default(), &|_, _| true);
    assert_eq!(plans.len(), 1, "nobody is in the east");
    plans.remove(0)
}

fn made(plan: &SidePlan) -> SideImages {
    construct_side_of(&room(), plan, &ConstructOptions::new(OUTPUT), SAME_DEPTH).expect("it can be made")
}

/// (layer, column, row, disparity, colour) of all samples.
fn samples(ldi: &Ldi) -> Vec<(usize, u32, u32, f64, [u8; 3])> {
    let mut out = Vec::new();
    for (k, layer) in ldi.layers.iter().enumerate() {
        for s in &layer.segments {
            for i in s.first as usize..s.first as usize + usize::from(s.count) {
                let column = u32::from(s.column_base) + u32::from(layer.column[i]);
                out.push((k, column, s.row.into(), ldi.codes.disparity(layer.disparity[i]), layer.rgb[i]));
            }
        }
    }
    out
}

/// What a line of sight through the door meets beyond it.
fn beyond(eye: DVec3, toward: DVec3) -> Option<DVec3> {
    let first = room().all_hits(eye, toward).into_iter().find(|h| (eye + toward * h.0).x > 0.0)?;
    Some(eye + toward * first.0)
}

#[test]
fn references_hold_what_rays_through_the_door_meet() {
    let plan = plan();
    let images = made(&plan);
    assert_eq!(images.references.len(), 13);
    let (mut seen, mut sky) = (0, 0);
    for (image, ldi) in plan.references.iter().zip(&images.references) {
        let ldi = ldi.as_ref().expect("each sees the room");
        assert_eq!((ldi.check(), ldi.layers.len()), (Ok(()), 1));
        let camera = &ldi.camera;
        assert_eq!(camera.cop, image.cop);
        for (_, column, row, disparity, _) in samples(ldi) {
            let ray = camera.ray(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let p = beyond(camera.cop, ray).expect("something is there");
            let depth = (p - camera.cop).dot(camera.basis.forward);
            assert!((disparity * depth - 1.0).abs() < 1e-3, "depth {depth}, disparity {disparity}");
            let at_door = camera.cop + ray * (-camera.cop.x / ray.x);
            let pixel = 1.01 * (-camera.cop.x) / camera.pixels_per_unit;
            assert!(at_door.z.abs() <= 0.5 + pixel && at_door.y >= -pixel && at_door.y <= 2.0 + pixel, "{at_door}");
            seen += 1;
        }
        for row in 0..camera.height {
            for column in 0..camera.width {
                if ldi.is_sky(column.into(), row.into()) == Some(true) {
                    let ray = camera.ray(f64::from(column) + 0.5, f64::from(row) + 0.5);
                    assert_eq!(beyond(camera.cop, ray), None);
                    assert!(images.sky.holds(ray));
                    sky += 1;
                }
            }
        }
    }
    assert!(seen > 20_000 && sky > 500, "{seen} samples, {sky} of sky");
    assert_eq!(seen, images.merge.offered);
}

#[test]
fn the_central_image_stays_in_the_first_layer_and_others_add_what_it_does_not_see() {
    let plan = plan();
    let images = made(&plan);
    let central = images.references[plan.central].as_ref().expect("made");
    let layered = images.layered.as_ref().expect("made");
    assert_eq!(layered.check(), Ok(()));
    assert!(layered.layers.len() > 2, "{} layers", layered.layers.len());
    let (dx, dy) = (central.camera.left - layered.camera.left, central.camera.top - layered.camera.top);
    let all = samples(layered);
    let first: std::collections::HashMap<(i64, i64), (f64, [u8; 3])> =
        all.iter().filter(|s| s.0 == 0).map(|s| ((i64::from(s.1), i64::from(s.2)), (s.3, s.4))).collect();
    for (_, column, row, disparity, rgb) in samples(central) {
        let place = (i64::from(column) + i64::from(dx), i64::from(row) + i64::from(dy));
        let (found, colour) = first.get(&place).expect("the central sample is in the first layer");
        assert!((found - disparity).abs() < layered.codes.step + central.codes.step, "{found} {disparity}");
        assert_eq!(*colour, rgb);
    }
    let m = &images.merge;
    assert_eq!(m.kept, all.len() as u64);
    assert_eq!(m.offered, m.kept + m.lost + m.replaced + m.before_central + m.outside, "{m:?}");
    assert!(m.lost > 0 && m.replaced > 0, "{m:?}");
    assert!(m.kept < m.offered / 2, "what several images see is kept about once: {m:?}");
}

/// Of what eyes about the room see through the door: held by the layered image within a pixel and
/// a tenth of the depth, against held by the nearest image and by the central one.
#[test]
fn what_eyes_see_through_the_door_is_in_the_layered_image() {
    let plan = plan();
    let images = made(&plan);
    let sets = |ldi: &Ldi| {
        let mut places: std::collections::HashMap<(i64, i64), Vec<f64>> = std::collections::HashMap::new();
        samples(ldi).iter().for_each(|s| places.entry((s.1.into(), s.2.into())).or_default().push(s.3));
        places
    };
    let held = |ldi: &Ldi, places: &std::collections::HashMap<(i64, i64), Vec<f64>>, p: DVec3| {
        let (u, v, d) = ldi.camera.project(p).expect("beyond the door");
        let alike = |x: &f64| (x - d).abs() < 0.1 * d;
        (-1..=1).flat_map(|i| (-1..=1).map(move |j| (i, j))).any(|(i, j)| {
            places.get(&(u.floor() as i64 + i, v.floor() as i64 + j)).is_some_and(|l| l.iter().any(alike))
        })
    };
    let layered = images.layered.as_ref().expect("made");
    let central = images.references[plan.central].as_ref().expect("made");
    let (in_layered, in_central) = (sets(layered), sets(central));
    let (mut all, mut by_layered, mut by_central) = (0, 0, 0);
    for k in 0..40_000u32 {
        // A Weyl sequence over eyes that face the door and points of it.
        let unit = |n: f64| (f64::from(k) * n + 0.5).fract();
        let angle = (unit(0.754_877_666) * 110.0 - 55.0).to_radians();
        let r = 1.6 + 3.0 * unit(0.569_840_29);
        let eye = DVec3::new(-r * angle.cos(), 1.2 + 0.7 * unit(0.430_159_7), r * angle.sin());
        let door = DVec3::new(0.0, 2.0 * unit(0.618_033_98), unit(0.381_966_0) - 0.5);
        let Some(p) = beyond(eye, door - eye) else { continue };
        all += 1;
        by_layered += u32::from(held(layered, &in_layered, p));
        by_central += u32::from(held(central, &in_central, p));
    }
    let share = |n: u32| f64::from(n) / f64::from(all);
    assert!(share(by_layered) > 0.99, "{} of {all} points in the layered image", share(by_layered));
    assert!(share(by_central) < 0.9, "{} in the central image alone", share(by_central));
}
