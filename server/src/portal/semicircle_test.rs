//! A door in a wall between two rooms, judged by trigonometry.

use super::*;
use crate::placement::test_scenes::settings;
use ldi_protocol::rooms::{Cell, Portal, PortalKind};

/// Rooms of 8 m by 8 m on both sides of the plane x = 0, floor at 0; a door of 1 m by 2 m at z
/// = 0. Eyes from 1.1 to 2 m, a quarter of a metre from the walls.
fn place() -> (Rooms, WalkVolume) {
    let room = |name: &str, x: f64| Cell {
        name: name.into(),
        boxes: vec![Aabb { min: DVec3::new(x, 0.0, -4.0), max: DVec3::new(x + 8.0, 3.0, 4.0) }],
    };
    let corners = [(0.0, -0.5), (0.0, 0.5), (2.0, 0.5), (2.0, -0.5)].map(|(y, z)| DVec3::new(0.0, y, z)).to_vec();
    let hatch = [(-3.0, -1.0), (-3.0, 1.0), (-2.0, 1.0), (-2.0, -1.0)].map(|(x, z)| DVec3::new(x, 3.0, z)).to_vec();
    let door = Portal { cells: [Some(0), Some(1)], kind: PortalKind::Door, corners };
    let door = if door.normal().x > 0.0 { door } else { Portal { cells: [Some(1), Some(0)], ..door } };
    let hatch = Portal { cells: [Some(0), None], kind: PortalKind::Hatch, corners: hatch };
    let rooms = Rooms::new(0.1, vec![room("west", -8.0), room("east", 0.0)], vec![door, hatch]).expect("sound");
    let runs: Vec<Vec<[u16; 2]>> = vec![vec![[0, 9]]; 32 * 16];
    let cut = Aabb { min: DVec3::new(-7.75, 0.0, -3.75), max: DVec3::new(7.75, 0.0, 3.75) };
    let volume = WalkVolume::new(DVec3::new(-8.0, 1.1, -4.0), 0.5, 0.1, [32, 16], &runs, &cut).expect("sound");
    (rooms, volume)
}

fn planned(
    semicircle: Semicircle,
    sees: &(dyn Fn(DVec3, DVec3) -> bool + Sync),
) -> (Vec<SidePlan>, SemicircleStatistics) {
    let (rooms, volume) = place();
    let settings = BuildSettings { eye_height_m: Some(1.6), ..settings(1000) };
    plan_semicircles(&rooms, &volume, &settings, 1.5, &semicircle, sees)
}

#[test]
fn references_stand_on_the_semicircle_at_eye_height_and_look_through_the_door() {
    let (plans, statistics) = planned(Semicircle::default(), &|_, _| true);
    assert_eq!((statistics.sides, statistics.horizontal, statistics.references), (2, 2, 26), "{statistics:?}");
    assert_eq!((statistics.pulled_in, statistics.skipped), (0, 0));
    for plan in &plans {
        assert_eq!((plan.portal, plan.references.len(), plan.central), (0, 13, 6));
        // West of the door, eyes look east.
        let east = if plan.references[0].cop.x < 0.0 { 1.0 } else { -1.0 };
        for (k, image) in plan.references.iter().enumerate() {
            let angle = ((k as f64 - 6.0) * 120.0 / 13.0).to_radians();
            // To the right of a look to the east is south: larger z.
            let wanted = DVec3::new(-east * 2.0 * angle.cos(), 1.6, east * 2.0 * angle.sin());
            assert!(image.cop.distance(wanted) < 1e-9, "{k}: {} instead of {wanted}", image.cop);
            assert!(image.basis.forward.distance(DVec3::X * east) < 1e-9);
            // The door's corners lie on the border of the window, within a pixel.
            let (x, y, depth) = (1.0 / image.pixels_per_unit, [-1.6, 0.4], 2.0 * angle.cos());
            for (at, z) in [(0, -0.5), (1, 0.5)] {
                let side = (z - image.cop.z * east) / depth;
                assert!((image.window[at] - side).abs() <= x * 1.001, "{k}: {:?}, {side}", image.window);
                assert!((image.window[2 + at] - y[at] / depth).abs() <= x * 1.001, "{k}: {:?}", image.window);
            }
            assert!((image.plane_distance / depth - 1.0).abs() < 2e-3);
            // As many pixels to a metre of the door, whatever the angle.
            assert!((image.pixels_per_unit / depth - plan.layered.pixels_per_unit / 2.0).abs() < 1e-6);
        }
        assert_eq!(plan.layered.cop, plan.references[6].cop);
        assert_eq!(plan.layered.window, [-WIDEST, WIDEST, -WIDEST, WIDEST]);
        // No eye that faces the door is nearer before its plane than half the distance.
        assert!((plan.ahead_m - (2.0 - 0.75)).abs() < 0.01);
    }
}

/// The bound on footprints is what differences measure for the nearest eye that may use an image.
#[test]
fn footprints_are_bounded() {
    let (plans, statistics) = planned(Semicircle::default(), &|_, _| true);
    let image = &plans[0].references[0];
    let camera = settings(1000).camera;
    let east = image.basis.forward.x;
    let mut largest = 0.0_f64;
    // Beside the line of sight by up to 25 degrees: within the picture, to its border.
    for (along, z, aside) in [(1.5, 0.0, 0.0), (0.75, 1.3, 25.0), (0.8, -1.35, -25.0), (1.5, 0.3, 20.0)] {
        let eye = DVec3::new(-east * along, 1.6, z);
        // Just beyond the door, where samples are largest.
        let p = DVec3::new(east * 0.01, 1.0, 0.1);
        let toward = p - eye;
        let view = ViewBasis::from_yaw_pitch((-toward.x).atan2(-toward.z).to_degrees() + aside, -15.0);
        let project = |q: DVec3| {
            let v = q - eye;
            glam::DVec2::new(v.dot(view.right), v.dot(view.up)) * (camera.focal_px() / v.dot(view.forward))
        };
        let step = (p - image.cop).dot(image.basis.forward) / image.pixels_per_unit * 1e-4;
        let [a, b] = [image.basis.right, image.basis.up].map(|s| (project(p + s * step) - project(p)) / 1e-4);
        let (sum, det) = (a.length_squared() + b.length_squared(), a.perp_dot(b));
        largest = largest.max((0.5 * (sum + (sum * sum - 4.0 * det * det).max(0.0).sqrt())).sqrt());
    }
    assert!(largest > 1.0 && largest <= statistics.footprint_px, "{largest} px, bound {}", statistics.footprint_px);
}

#[test]
fn places_that_are_none_are_pulled_in_or_left_out() {
    // Walls 3.75 m to the sides cut a semicircle of 5 m: sin(55.4 degrees) x 5 m is 4.1 m.
    let wide = Semicircle { radius_m: 5.0, ..Semicircle::default() };
    let (plans, statistics) = planned(wide, &|_, _| true);
    let far =
        |p: &SidePlan| p.references.iter().map(|i| (i.cop - DVec3::new(0.0, 1.6, 0.0)).length()).collect::<Vec<_>>();
    let nearer = far(&plans[0]).iter().filter(|r| **r < 4.99).count();
    assert_eq!((statistics.pulled_in, statistics.skipped, nearer), (4, 0, 2), "{:?}", far(&plans[0]));
    // A cupboard hides the southern half of each semicircle from the door.
    let (plans, statistics) = planned(Semicircle::default(), &|eye, _| eye.z < 0.1);
    assert_eq!((statistics.references, statistics.skipped), (14, 12));
    // West of the door the straight one is the last, seen from east the first.
    let mut central: Vec<usize> = plans.iter().map(|p| p.central).collect();
    central.sort_unstable();
    assert_eq!(central, [0, 6]);
    // Nothing sees the door.
    let (plans, statistics) = planned(Semicircle::default(), &|_, _| false);
    assert_eq!((plans.len(), statistics.no_place), (0, 2));
}

#[test]
fn settings_out_of_range_are_named() {
    let of = |references, radius_m, arc_deg| Semicircle { references, radius_m, arc_deg }.check();
    assert_eq!(of(13, 2.0, 180.0), Ok(()));
    assert!(of(12, 2.0, 120.0).unwrap_err().contains("odd"));
    assert!(of(183, 2.0, 120.0).unwrap_err().contains("181"));
    assert!(of(13, f64::NAN, 120.0).unwrap_err().contains("radius"));
    assert!(of(13, 2.0, 181.0).unwrap_err().contains("arc"));
    let angles: Vec<f64> = Semicircle { references: 3, radius_m: 1.0, arc_deg: 180.0 }.angles_deg().collect();
    assert!(angles.iter().zip([-60.0, 0.0, 60.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{angles:?}");
}
