//! The whole stage on small scenes.

use super::*;
use crate::placement::test_scenes::{block, scene_of};
use std::sync::Arc;

/// The walk volume over boxes, given by two corners each.
fn walked(boxes: &[([f64; 3], [f64; 3])], options: &WalkOptions) -> Result<(WalkVolume, WalkReport), WalkError> {
    let blocks = boxes.iter().map(|(min, max)| Aabb { min: (*min).into(), max: (*max).into() });
    walked_with(boxes_scene(blocks), options)
}

fn boxes_scene(blocks: impl Iterator<Item = Aabb>) -> crate::scene::Scene {
    scene_of(&blocks.map(|b| block(&b)).collect::<Vec<_>>())
}

fn walked_with(scene: crate::scene::Scene, options: &WalkOptions) -> Result<(WalkVolume, WalkReport), WalkError> {
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, 1000);
    let caster = Caster::new(Arc::new(scene), &clusters, &octree);
    walk_volume(&caster, &clusters, &octree, options)
}

fn on_foot() -> WalkOptions {
    WalkOptions { eye_height_m: Some(1.6), ..WalkOptions::default() }
}

#[test]
fn runs_join_when_they_touch() {
    let mut r = vec![];
    for run in [[5, 7], [1, 2], [9, 12], [7, 9], [2, 3]] {
        add_run(&mut r, run);
    }
    assert_eq!(r, vec![[1, 3], [5, 12]]);
}

#[test]
fn eyes_stand_on_the_floor_but_neither_on_nor_under_a_table() {
    // A floor of 16 x 16 m at y = 0 and a table top of 2 x 2 m at y = 0.8 on it.
    let boxes = [([0.0, -0.1, 0.0], [16.0, 0.0, 16.0]), ([3.0, 0.7, 3.0], [5.0, 0.8, 5.0])];
    let v = walked(&boxes, &on_foot()).unwrap().0;
    let inside = |x: f64, y: f64, z: f64| v.contains(DVec3::new(x, y, z));
    assert!(inside(1.0, 1.6, 1.0) && inside(1.0, 1.11, 1.0) && inside(7.9, 1.99, 7.9));
    assert!(!inside(1.0, 0.9, 1.0) && !inside(1.0, 2.3, 1.0));
    assert!(!inside(4.0, 2.4, 4.0), "standing on the table");
    assert!(!inside(4.0, 1.6, 4.0), "0.8 m above the table is too low");
    assert!(!inside(-0.1, 1.6, 1.0), "outside the scene");
}

/// A room of 8 x 8 m behind a wall with a closed door, beside a corridor, under a roof; a solid
/// block beside them.
const CLOSED_ROOM: [([f64; 3], [f64; 3]); 9] = [
    ([0.0, -0.2, 0.0], [20.0, 0.0, 8.0]),
    ([0.0, 2.8, 0.0], [20.0, 3.0, 8.0]),
    ([8.0, 0.0, 0.0], [8.2, 2.8, 8.0]),
    ([0.0, 0.0, -0.2], [20.0, 2.8, 0.0]),
    ([0.0, 0.0, 8.0], [20.0, 2.8, 8.2]),
    ([-0.2, 0.0, 0.0], [0.0, 2.8, 8.0]),
    ([12.0, 0.0, 0.0], [12.2, 2.8, 8.0]),
    ([2.0, 0.0, 2.0], [3.0, 1.0, 3.0]),
    ([14.0, 0.0, 1.0], [19.0, 2.5, 7.0]),
];

#[test]
fn rooms_behind_closed_doors_are_walked_in_but_not_roofs_or_solids() {
    let (v, report) = walked(&CLOSED_ROOM, &on_foot()).unwrap();
    let inside = |x: f64, y: f64, z: f64| v.contains(DVec3::new(x, y, z));
    assert!(inside(4.0, 1.6, 6.0) && inside(10.0, 1.6, 4.0), "{:?}", report.area_m2);
    assert!(!inside(10.0, 4.6, 4.0), "on the roof");
    assert!(!inside(16.0, 1.6, 4.0), "inside of the block: {report:?}");
    assert!(report.area_m2.contains_key("roof"), "{:?}", report.area_m2);
    assert!(report.regions.iter().any(|r| !r.kept && !r.patches.is_empty()));
}

#[test]
fn people_walk_where_they_get_to_from_a_start() {
    // Two floors far apart, the second one larger.
    let boxes = [([0.0, -0.1, 0.0], [8.0, 0.0, 8.0]), ([60.0, -0.1, 0.0], [80.0, 0.0, 20.0])];
    let start = |place: DVec3| walked(&boxes, &WalkOptions { starts: vec![place], ..on_foot() });
    let first = start(DVec3::new(2.0, 1.6, 2.0)).unwrap().0;
    assert!(first.contains(DVec3::new(5.0, 1.6, 5.0)) && !first.contains(DVec3::new(70.0, 1.6, 5.0)));
    let second = start(DVec3::new(70.0, 0.0, 5.0)).unwrap().0;
    assert!(!second.contains(DVec3::new(5.0, 1.6, 5.0)) && second.contains(DVec3::new(70.0, 1.6, 5.0)));
    let nowhere = start(DVec3::new(40.0, 1.6, 5.0)).unwrap_err();
    assert!(nowhere.to_string().contains("(40.00, 1.60, 5.00)"), "{nowhere}");
}

#[test]
fn what_lies_under_a_path_stays_and_floating_poses_are_named() {
    // A path over a table that is no floor otherwise, and on into the air.
    let boxes = [([0.0, -0.1, 0.0], [16.0, 0.0, 16.0]), ([3.0, 0.7, 3.0], [5.0, 0.8, 5.0])];
    let along = |waypoints: &str| {
        let walk = path::parse(&format!(r#"{{"waypoints": {waypoints}}}"#)).unwrap();
        walked(&boxes, &WalkOptions { along: Some(Corridor::around(&walk, 0.5)), ..on_foot() })
    };
    let (v, report) = along("[[3.5, 2.4, 4.0], [4.5, 2.4, 4.0], [4.5, 9.0, 4.0]]").unwrap();
    assert!(v.contains(DVec3::new(4.0, 2.4, 4.0)) && !v.contains(DVec3::new(10.0, 1.6, 10.0)));
    assert!(report.floating_total > 50 && report.warnings.iter().any(|w| w.contains("have no floor")), "{report:?}");
    let error = along("[[3.5, 12.4, 4.0], [4.5, 12.4, 4.0]]").unwrap_err();
    assert!(error.to_string().contains("(3.50, 12.40, 4.00)"), "{error}");
}

#[test]
fn a_backdrop_coarsens_nothing() {
    let mut boxes: Vec<([f64; 3], [f64; 3])> = vec![([-1200.0, -60.0, -1200.0], [1200.0, -0.5, 1200.0])];
    // A street of houses with a lane of 3 m between them.
    boxes.push(([-20.0, -0.4, -20.0], [20.0, 0.0, 20.0]));
    for n in 0..8 {
        let z = f64::from(n) * 5.0 - 20.0;
        boxes.push(([-10.0, 0.0, z], [-1.5, 6.0, z + 4.0]));
        boxes.push(([1.5, 0.0, z], [10.0, 6.0, z + 4.0]));
    }
    let (v, report) = walked(&boxes, &on_foot()).unwrap();
    assert!(v.contains(DVec3::new(0.0, 1.6, 3.0)) && v.pitch_m() == 0.5, "{report:?}");
    assert!(!v.contains(DVec3::new(-5.0, 1.6, 2.0)) && !v.contains(DVec3::new(600.0, 1.1, 600.0)));
}

#[test]
fn a_thing_without_floors_is_walked_around() {
    let pillar = [([0.0, 50.0, 0.0], [0.3, 52.0, 0.3])];
    let (v, report) = walked(&pillar, &on_foot()).unwrap();
    assert!(v.contains(DVec3::new(2.5, 51.6, 0.0)) && v.contains(DVec3::new(0.0, 51.6, -3.0)));
    assert!(report.warnings.iter().any(|w| w.contains("--fly")), "{:?}", report.warnings);
}

#[test]
fn flying_eyes_are_anywhere() {
    let v = walked(&CLOSED_ROOM, &WalkOptions::default()).unwrap().0;
    assert!(v.contains(DVec3::new(1.0, 0.1, 1.0)) && v.contains(DVec3::new(1.0, 4.5, 1.0)));
}

#[test]
fn people_walk_where_a_camera_stands() {
    // A house of small things, and far from it a bare platform that nobody gets to.
    let mut boxes = vec![([0.0, -0.1, 0.0], [16.0, 0.0, 16.0]), ([60.0, 6.0, 0.0], [64.0, 6.1, 4.0])];
    boxes.extend((0..200).map(|n| {
        let (x, z) = (f64::from(n % 20) * 0.8, f64::from(n / 20) * 0.2 + 14.0);
        ([x, 0.0, z], [x + 0.1, 0.4, z + 0.1])
    }));
    let platform = |viewpoint: DVec3| {
        let blocks = boxes.iter().map(|(min, max)| Aabb { min: (*min).into(), max: (*max).into() });
        let mut scene = boxes_scene(blocks);
        scene.viewpoints.push(viewpoint);
        let (volume, report) = walked_with(scene, &on_foot()).unwrap();
        assert!(volume.contains(DVec3::new(8.0, 1.6, 6.0)), "{report:?}");
        volume.contains(DVec3::new(62.0, 7.7, 2.0))
    };
    assert!(platform(DVec3::new(62.0, 7.8, 2.0)));
    assert!(!platform(DVec3::new(62.0, 30.0, 2.0)), "a camera in the air names no floor");
}
