//! Tours of built-in scenes, and of shared ones where these are there.

use super::*;
use crate::{
    octree::{Clusters, Octree},
    placement::test_scenes::{block, scene_of},
    render::{CellSet, Ray},
    scene::{self, Scene},
    walk_volume::{WalkOptions, walk_volume},
};
use glam::DVec3;
use ldi_protocol::Aabb;
use std::{path::PathBuf, sync::Arc};

struct Site {
    caster: Caster,
    volume: WalkVolume,
    eye_height_m: Option<f64>,
}

impl Site {
    fn new(scene: Scene, eye_height_m: Option<f64>) -> Self {
        let scene = Arc::new(scene);
        let clusters = Clusters::build(&scene);
        let octree = Octree::build(&scene, &clusters, (scene.triangles() / 10).max(1));
        let caster = Caster::new(scene, &clusters, &octree);
        let options = WalkOptions { eye_height_m, ..WalkOptions::default() };
        let volume = walk_volume(&caster, &clusters, &octree, &options).expect("a walk volume").0;
        Self { caster, volume, eye_height_m }
    }

    fn tour(&self, seconds: f64, seed: u64) -> Walk {
        let options = TourOptions { seconds, seed, eye_height_m: self.eye_height_m };
        tour(&self.caster, &self.volume, &options).expect("a tour")
    }

    /// Checks all poses; returns the length, metres.
    fn check(&self, name: &str, walk: &Walk, seconds: f64) -> f64 {
        assert_eq!(walk.poses.len(), (seconds * 60.0) as usize, "{name}");
        let all = CellSet::all();
        let mut length = 0.0;
        for pair in walk.poses.windows(2) {
            let [a, b] = [pair[0].pose, pair[1].pose];
            assert!(self.volume.contains(b.position), "{name}: {:?} at {} s", b.position, pair[1].t_s);
            let step = a.position.distance(b.position);
            assert!(step <= 1.5 / 60.0 + 2e-4, "{name}: a step of {step} m at {} s", pair[0].t_s);
            let turn = (b.yaw_deg - a.yaw_deg + 180.0).rem_euclid(360.0) - 180.0;
            assert!(turn.abs() <= 1.6 && b.pitch_deg.abs() <= 60.0, "{name}: a turn of {turn} at {} s", pair[0].t_s);
            let ray = Ray { origin: a.position, direction: b.position - a.position, t_min: 0.0, t_max: 1.0 };
            assert!(!self.caster.occluded(&ray, &all), "{name}: through a wall at {} s", pair[0].t_s);
            length += step;
        }
        // Nothing is nearer than half a body, and the floor is where it should be. Pipes have none.
        for pose in walk.poses.iter().step_by(30) {
            let eye = pose.pose.position;
            for n in 0..16 {
                let (sin, cos) = (f64::from(n) * std::f64::consts::TAU / 16.0).sin_cos();
                let ray = Ray { origin: eye, direction: DVec3::new(sin, 0.0, cos), t_min: 0.0, t_max: 0.12 };
                assert!(!self.caster.occluded(&ray, &all), "{name}: close to a wall at {} s", pose.t_s);
            }
            let Some(height) = self.eye_height_m.filter(|_| name != "pipes") else { continue };
            let down = Ray { origin: eye, direction: -DVec3::Y, t_min: 0.0, t_max: height + 1.0 };
            let above = self.caster.trace(&down, &all).map_or(f64::INFINITY, |hit| hit.t);
            assert!((above - height).abs() <= 0.5, "{name}: {above} m above the floor at {} s", pose.t_s);
        }
        length
    }
}

#[test]
fn tours_of_built_in_scenes_keep_to_the_walk_volume() {
    for (name, least_m) in [("house", 30.0), ("plant", 20.0), ("island", 30.0), ("church", 20.0), ("pipes", 10.0)] {
        let scene = scene::load(&format!("builtin:{name}?triangles=40000&seed=1")).expect("a scene");
        let site = Site::new(scene, Some(1.6));
        let walk = site.tour(60.0, 3);
        let length = site.check(name, &walk, 60.0);
        assert!(length >= least_m, "{name}: {length} m");
        assert_eq!(site.tour(60.0, 3), walk, "{name}: the same seed, the same tour");
    }
}

#[test]
fn a_flight_keeps_to_its_box() {
    let scene = scene::load("builtin:house?triangles=20000").expect("a scene");
    let site = Site::new(scene, None);
    site.check("flown house", &site.tour(30.0, 0), 30.0);
}

#[test]
fn tours_of_shared_scenes_keep_to_the_walk_volume() {
    let shared = std::env::var_os("LDI_SHARED")
        .map_or_else(|| concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared").into(), PathBuf::from);
    for name in ["small_house", "clinic", "black_forest"] {
        let file = shared.join("scenes").join(format!("{name}.glb"));
        if !file.is_file() {
            println!("SKIPPED: no {}", file.display());
            continue;
        }
        let site = Site::new(scene::load(&file.to_string_lossy()).expect("a scene"), Some(1.6));
        let length = site.check(name, &site.tour(120.0, 0), 120.0);
        assert!(length >= 40.0, "{name}: {length} m");
    }
}

/// Two rooms of 6 x 6 m with a door of 1 m between them, and stairs of 1.5 m to a gallery.
fn two_rooms() -> Scene {
    let mut boxes = vec![
        ([0.0, -0.2, 0.0], [14.0, 0.0, 6.0]),
        ([0.0, 5.0, 0.0], [14.0, 5.2, 6.0]),
        ([-0.2, 0.0, 0.0], [0.0, 5.0, 6.0]),
        ([14.0, 0.0, 0.0], [14.2, 5.0, 6.0]),
        ([0.0, 0.0, -0.2], [14.0, 5.0, 0.0]),
        ([0.0, 0.0, 6.0], [14.0, 5.0, 6.2]),
        // The wall and its door.
        ([6.0, 0.0, 0.0], [6.2, 5.0, 2.3]),
        ([6.0, 0.0, 3.7], [6.2, 5.0, 6.0]),
        ([6.0, 2.2, 2.3], [6.2, 5.0, 3.7]),
        // A table.
        ([2.0, 0.7, 2.0], [3.5, 0.75, 3.5]),
    ];
    boxes.extend((0..6).map(|n| {
        let (x, y) = (8.0 + f64::from(n) * 0.5, 0.2 * f64::from(n + 1));
        ([x, 0.0, 0.0], [if n == 5 { 14.0 } else { x + 0.5 }, y, 2.5])
    }));
    let blocks: Vec<_> = boxes
        .iter()
        .map(|(min, max)| block(&Aabb { min: DVec3::from_array(*min), max: DVec3::from_array(*max) }))
        .collect();
    scene_of(&blocks)
}

#[test]
fn a_tour_goes_through_doors_and_up_stairs() {
    let site = Site::new(two_rooms(), Some(1.6));
    let walk = site.tour(90.0, 0);
    site.check("two rooms", &walk, 90.0);
    let been = |place: &dyn Fn(DVec3) -> bool| walk.poses.iter().any(|p| place(p.pose.position));
    assert!(been(&|p| p.x < 5.0) && been(&|p| p.x > 8.0), "both rooms");
    assert!(been(&|p| p.y > 2.4), "the gallery");
    assert!(!been(&|p| p.x > 1.9 && p.x < 3.6 && p.z > 1.9 && p.z < 3.6), "not through the table");
    assert_ne!(site.tour(90.0, 1), walk, "another seed, another tour");
}

#[test]
fn nobody_walks_where_no_body_fits() {
    let floor = Aabb { min: DVec3::new(0.0, -0.1, 0.0), max: DVec3::new(8.0, 0.0, 8.0) };
    let open = Site::new(scene_of(&[block(&floor)]), Some(1.6));
    // Fences across the floor, 0.3 m apart.
    let fence = |n: u32| {
        let x = f64::from(n) * 0.3;
        block(&Aabb { min: DVec3::new(x, 0.0, 0.0), max: DVec3::new(x + 0.02, 2.0, 8.0) })
    };
    let fences: Vec<_> = (0..27).map(fence).chain([block(&floor)]).collect();
    let full = Caster::of_scene(Arc::new(scene_of(&fences)), false);
    let options = TourOptions { seconds: 5.0, seed: 0, eye_height_m: Some(1.6) };
    assert!(tour(&open.caster, &open.volume, &options).is_ok());
    assert!(matches!(tour(&full, &open.volume, &options), Err(TourError::Nowhere)));
}
