use super::*;
use ldi_protocol::volume::WalkVolume;
use ldi_server::{
    octree::{Clusters, Octree},
    walk_volume::{WalkOptions, WalkReport, walk_volume},
};
use std::{f64::consts::TAU, fmt::Write as _};

/// Clearance of every walked place, metres.
const CLEAR_M: f64 = 0.25;
/// Range of the distance from a walked eye down to the floor, metres.
const ABOVE_FLOOR_M: std::ops::Range<f64> = 1.1..2.1;
/// Specimens without a floor.
const FLOORLESS: [&str; 2] = ["spaceship", "statue"];

/// Distance to the first surface along a direction of unit length.
fn distance(caster: &Caster, from: DVec3, direction: DVec3) -> f64 {
    caster.trace(&Ray::new(from, direction), &CellSet::all()).map_or(f64::INFINITY, |h| h.t)
}

/// Smallest distance to a surface over directions spread evenly over the sphere.
fn clearance(caster: &Caster, from: DVec3) -> f64 {
    const DIRECTIONS: u32 = 1000;
    let golden = TAU / 1.618_033_988_749_895;
    (0..DIRECTIONS)
        .map(|k| {
            let y = 1.0 - 2.0 * (f64::from(k) + 0.5) / f64::from(DIRECTIONS);
            let (s, c) = (f64::from(k) * golden).sin_cos();
            let r = (1.0 - y * y).sqrt();
            distance(caster, from, DVec3::new(r * c, y, r * s))
        })
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn walked_places_stand_on_floors_and_are_free() {
    let mut wrong = String::new();
    for s in all() {
        let caster = Caster::of_scene(Arc::new(s.scene), false);
        for p in &s.walked {
            let below = distance(&caster, *p, DVec3::NEG_Y);
            if !FLOORLESS.contains(&s.name) && !ABOVE_FLOOR_M.contains(&below) {
                writeln!(wrong, "{}: {p} stands {below:.2} m above the surface below it", s.name).expect("a string");
            }
            let clear = clearance(&caster, *p);
            if clear < CLEAR_M {
                writeln!(wrong, "{}: {p} is only {clear:.2} m from a surface", s.name).expect("a string");
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn there_are_enough_places_and_none_is_both() {
    for s in all() {
        assert!(s.walked.len() >= 6, "{}: {} walked places", s.name, s.walked.len());
        assert!(s.unwalked.len() >= 3, "{}: {} unwalked places", s.name, s.unwalked.len());
        for u in &s.unwalked {
            let nearest = s.walked.iter().map(|w| w.distance(*u)).fold(f64::INFINITY, f64::min);
            assert!(nearest > 0.5, "{}: {u} is {nearest:.2} m from a walked place", s.name);
        }
    }
}

#[test]
fn scenes_are_valid_and_of_a_moderate_size() {
    let mut wrong = String::new();
    for s in all() {
        s.scene.check().unwrap_or_else(|e| panic!("{}: {e}", s.name));
        let n = s.scene.triangles();
        println!("{}: {n} triangles, {} materials", s.name, s.scene.materials.len());
        if !(5_000..=60_000).contains(&n) {
            writeln!(wrong, "{}: {n} triangles", s.name).expect("a string");
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn closed_shapes_face_outward() {
    // Vertex normals come from the shapes' formulas, windings from their corners.
    for s in all() {
        for p in s.scene.meshes.iter().flat_map(|m| &m.primitives) {
            for t in &p.triangles {
                let [a, b, c] = t.map(|i| p.positions[i as usize].as_dvec3());
                let n: DVec3 = t.iter().map(|i| p.normals[*i as usize].as_dvec3()).sum();
                let face = (b - a).cross(c - a);
                assert!(face.length() < 1e-6 || face.dot(n) > 0.0, "{}: {a} {b} {c} faces away", s.name);
            }
        }
    }
}

#[test]
fn nothing_on_the_spaceship_can_be_stood_on() {
    // Surfaces flatter than 50 degrees that face up, or down, summed over cubes of one metre.
    let s = specimen("spaceship").expect("known");
    let caster = Caster::of_scene(Arc::new(s.scene), false);
    let mut flat: std::collections::BTreeMap<[i64; 4], f64> = Default::default();
    for t in 0..caster.triangle_count() {
        let [a, b, c] = caster.corners_world(t);
        let n = (b - a).cross(c - a);
        if n.y.abs() > n.length() * 50_f64.to_radians().cos() {
            let cube = ((a + b + c) / 3.0).floor();
            *flat.entry([cube.x as i64, cube.y as i64, cube.z as i64, n.y.signum() as i64]).or_default() +=
                0.5 * n.y.abs();
        }
    }
    let (place, area) = flat.iter().max_by(|a, b| a.1.total_cmp(b.1)).expect("small ones");
    assert!(*area < 0.6, "{area:.2} square metres about {place:?}");
}

#[test]
fn cliffs_and_faces_are_steep() {
    for name in ["terrain", "pit"] {
        let s = specimen(name).expect("known");
        let caster = Caster::of_scene(Arc::new(s.scene), false);
        for eye in &s.unwalked[..3] {
            let hit = caster.trace(&Ray::new(*eye, DVec3::NEG_Y), &CellSet::all()).expect("a face below");
            let [a, b, c] = caster.corners_world(hit.triangle);
            let n = (b - a).cross(c - a).normalize();
            assert!(n.y < 0.5, "{name}: the slope below {eye} is {:.0} degrees", n.y.acos().to_degrees());
        }
    }
}

#[test]
fn generation_is_deterministic() {
    for (name, make) in SPECIMENS {
        let (a, b) = (make(), make());
        assert!(format!("{a:?}") == format!("{b:?}"), "{name}: two runs differ");
        assert_eq!(a.name, name);
    }
}

#[test]
fn written_files_load_again() {
    let dir = std::env::temp_dir().join(format!("ldi_zoo_{}", std::process::id()));
    std::fs::create_dir_all(&dir).expect("writable");
    for s in all() {
        let file = dir.join(format!("{}.glb", s.name));
        write_glb(&s, &file).expect("writes");
        let again = ldi_server::scene::load(file.to_str().expect("UTF-8")).expect("loads");
        assert_eq!(again.triangles(), s.scene.triangles(), "{}", s.name);
        ldi_protocol::path::parse(&walked_path(&s).to_string()).expect("a path file");
    }
    std::fs::remove_dir_all(&dir).expect("removes");
}

/// Where people walk in a specimen, with default settings.
fn walk(s: &Specimen) -> (WalkVolume, WalkReport) {
    let clusters = Clusters::build(&s.scene);
    let octree = Octree::build(&s.scene, &clusters, s.scene.triangles() / 10);
    let caster = Caster::new(Arc::new(s.scene.clone()), &clusters, &octree);
    let options = WalkOptions { eye_height_m: Some(s.eye_height_m), ..WalkOptions::default() };
    walk_volume(&caster, &clusters, &octree, &options).expect("no scene is refused")
}

#[test]
fn people_walk_where_they_should_and_nowhere_else() {
    let mut wrong = Vec::new();
    for s in all() {
        let (volume, report) = walk(&s);
        let missing = s.walked.iter().filter(|eye| !volume.contains(**eye));
        wrong.extend(missing.map(|eye| format!("{}: nobody walks at {eye}", s.name)));
        let more = s.unwalked.iter().filter(|eye| volume.contains(**eye));
        wrong.extend(more.map(|eye| format!("{}: people walk at {eye}", s.name)));
        if wrong.iter().any(|w| w.starts_with(s.name)) {
            wrong.push(format!("{}: {:?}", s.name, report.area_m2));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
