//! Trees of analytic scenes, and the cases that numbers break on.

use super::*;
use crate::octree::{Clusters, Octree};
use crate::render::test_scenes::{plain, quad, scene, soup};
use crate::scene::Scene;
use glam::Vec3;
use ldi_protocol::{
    tree::{Brood, PARTS, TreeSample, WHOLE, across},
    volume::WalkVolume,
};
use std::sync::Arc;

/// References at these places, grown and shaped.
fn built(scene: Scene, places: &[DVec3], side: u32, max_level: u8) -> (BuiltTree, Vec<Reference>) {
    let scene = Arc::new(scene);
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, 1000);
    let caster = Caster::new(Arc::clone(&scene), &clusters, &octree).with_mips();
    let (origin, edge_m) = cube(&scene.bounds());
    let mut forest = Forest::new(origin, edge_m, max_level);
    let references: Vec<Reference> =
        places.iter().map(|p| Reference::take(&caster, *p, &[0, 1, 2, 3, 4, 5], side)).collect();
    forest.splat(&references);
    let tree = shape::shape(forest.filter(&caster), origin, edge_m, 0).expect("it can be encoded");
    tree.tree.check().expect("a good tree");
    (tree, references)
}

/// All samples with their places in the world, by node.
fn samples(built: &BuiltTree) -> Vec<(u8, TreeSample, DVec3)> {
    let mut out = Vec::new();
    for (chunk, nodes) in built.tree.broods() {
        let brood: Brood = built.tree.decode(nodes.clone(), &built.chunks[chunk as usize].bytes).expect("as encoded");
        assert_eq!(brood.decoded_bytes(), built.chunks[chunk as usize].decoded_bytes);
        for (number, node) in nodes.zip(&brood.nodes) {
            let entry = &built.tree.nodes[number as usize];
            let pitch = built.tree.pitch_of(entry.level);
            for s in &node.samples {
                let axis = usize::from(s.face / 2);
                let [a, b] = across(axis);
                let mut p = built.tree.corner_of(entry);
                p[axis] += (f64::from(s.depth) + 0.5) * pitch / 64.0;
                p[a] += (f64::from(s.column) + 0.5) * pitch;
                p[b] += (f64::from(s.row) + 0.5) * pitch;
                out.push((entry.level, *s, p));
            }
        }
    }
    out
}

/// A wall of 4 x 4 m in the plane z = -2, seen from the origin's side.
fn wall(z: f32) -> Scene {
    let part = quad(Vec3::new(-2.0, 2.0, z), Vec3::X * 4.0, Vec3::NEG_Y * 4.0);
    scene(vec![(part, plain([0.8, 0.4, 0.2, 1.0]))], Vec::new())
}

#[test]
fn a_wall_is_covered_once_on_every_level_down_to_its_stamp() {
    let (tree, references) = built(wall(-2.0), &[DVec3::new(0.3, 0.1, 0.2)], 128, 6);
    let found = samples(&tree);
    let levels = tree.figures.samples_by_level.len();
    // 2.2 m x 2 / 128 = 34 mm in front, more askew; the pitch of level 0 is 65 mm.
    assert!((1..=2).contains(&levels), "{:?}", tree.figures.samples_by_level);
    for level in 0..levels as u8 {
        let of_level: Vec<_> = found.iter().filter(|f| f.0 == level).collect();
        assert!(of_level.iter().all(|(_, s, p)| s.face == 5 && (p.z + 2.0).abs() < tree.tree.pitch_of(level) / 64.0));
        // The wall looks to +z, one layer, and inside its border each pixel of the root is covered.
        let pitch = tree.tree.pitch_of(level);
        let inner = |p: &DVec3| p.x.abs().max(p.y.abs()) < 2.0 - pitch;
        if level == 0 {
            let covered = of_level.iter().filter(|(_, s, p)| inner(p) && s.covers == WHOLE).count() as f64;
            let pixels = (4.0 - 2.0 * pitch).powi(2) / pitch.powi(2);
            assert!((covered / pixels - 1.0).abs() < 0.05, "{covered} of {pixels}");
        }
        let mut places: Vec<[i64; 2]> =
            of_level.iter().map(|(_, _, p)| [(p.x / pitch).round() as i64, (p.y / pitch).round() as i64]).collect();
        let n = places.len();
        places.sort_unstable();
        places.dedup();
        assert_eq!(places.len(), n, "one layer on level {level}");
    }
    assert!(found.iter().all(|(_, s, _)| s.rgb == found[0].1.rgb), "one colour stays one");
    // Unfiltered: what a reference pixel chose. All of the deepest level is.
    assert!(found.iter().filter(|f| usize::from(f.0) + 1 == levels).all(|(_, s, _)| !s.filtered));
    assert!(found.iter().any(|(l, s, _)| *l == 0 && s.filtered) || levels == 1);
    assert!(references[0].points.len() > 1000);
}

/// The middles of the parts that a tree's samples of a level and a face cover.
fn covered(built: &BuiltTree, level: u8, face: u8) -> Vec<DVec3> {
    let part = built.tree.pitch_of(level) / f64::from(PARTS);
    let of_sample = |(_, s, middle): (u8, TreeSample, DVec3)| {
        let [a, b] = across(usize::from(s.face / 2));
        (0..PARTS * PARTS).filter(move |k| s.covers >> k & 1 == 1).map(move |k| {
            let mut p = middle;
            p[a] += (f64::from(k % PARTS) - 1.5) * part;
            p[b] += (f64::from(k / PARTS) - 1.5) * part;
            p
        })
    };
    let all = samples(built).into_iter().filter(|(l, s, _)| *l == level && s.face == face);
    all.flat_map(of_sample).collect()
}

/// Outlines of walls end where the walls end, and what is thinner than a pixel does not fill it,
/// on every level.
#[test]
fn samples_cover_what_surfaces_cover() {
    let post = quad(Vec3::new(0.1, 1.5, -2.0), Vec3::X * 0.03, Vec3::NEG_Y * 3.0);
    let wall = quad(Vec3::new(-2.0, 2.0, -2.0), Vec3::X * 1.7, Vec3::NEG_Y * 4.0);
    let scene = scene(vec![(post, plain([0.1; 4])), (wall, plain([0.9; 4]))], Vec::new());
    let (tree, _) = built(scene, &[DVec3::new(-0.2, 0.1, -1.2)], 128, 6);
    let levels = tree.figures.samples_by_level.len() as u8;
    assert!(levels >= 2, "{:?}", tree.figures.samples_by_level);
    let parts = covered(&tree, 0, 5);
    let part_m = tree.tree.pitch_of(0) / f64::from(PARTS);
    // The middle of a covered part may lie beyond a rim by a quarter of the part.
    let within = |v: f64, first: f64, last: f64| (first - 0.26 * part_m..=last + 0.26 * part_m).contains(&v);
    let on_wall = |p: &DVec3| within(p.x, -2.0, -0.3) && within(p.y, -2.0, 2.0);
    let on_post = |p: &DVec3| within(p.x, 0.1, 0.13) && within(p.y, -1.5, 1.5);
    let on = |p: &DVec3| on_wall(p) || on_post(p);
    let off: Vec<&DVec3> = parts.iter().filter(|p| !on(p)).collect();
    assert!(off.is_empty(), "{} of {} parts are off the surfaces, as {:?}", off.len(), parts.len(), off[0]);
    let area_m2 = |on: &dyn Fn(&DVec3) -> bool| parts.iter().filter(|p| on(p)).count() as f64 * part_m.powi(2);
    let (wall_m2, post_m2) = (area_m2(&on_wall), area_m2(&on_post));
    assert!((wall_m2 / (1.7 * 4.0) - 1.0).abs() < 0.03, "{wall_m2} m² of the wall");
    // A part is 16 mm wide, the post 30 mm; a whole pixel is 65 mm.
    assert!((0.5..1.7).contains(&(post_m2 / (0.03 * 3.0))), "{post_m2} m² of the post");
}

/// The pixel of every reference is near a sample on each level from its own up to the root,
/// whatever the scene.
#[test]
fn every_reference_pixel_has_a_sample_on_each_level_above() {
    let scene = scene(vec![(soup(3, 200), plain([0.5, 0.7, 0.9, 1.0]))], Vec::new());
    let eyes = [DVec3::new(0.0, 0.1, 0.0), DVec3::new(0.7, -0.2, 0.4)];
    let (tree, references) = built(scene, &eyes, 48, 8);
    let found = samples(&tree);
    for level in 0..tree.figures.samples_by_level.len() as u8 {
        let pitch = tree.tree.pitch_of(level);
        let cells: std::collections::HashSet<[i64; 3]> =
            found.iter().filter(|f| f.0 == level).map(|f| f.2.to_array().map(|v| (v / pitch).floor() as i64)).collect();
        let near = |p: DVec3| {
            let c = p.to_array().map(|v| (v / pitch).floor() as i64);
            (0..27).any(|k| cells.contains(&[c[0] + k % 3 - 1, c[1] + k / 3 % 3 - 1, c[2] + k / 9 - 1]))
        };
        let own_or_above = |stamp: f32| f64::from(stamp) <= pitch;
        let of_level = references.iter().flat_map(|r| &r.points).filter(|p| own_or_above(p.stamp_m));
        let (mut all, mut lost) = (0, 0);
        for p in of_level {
            all += 1;
            lost += usize::from(!near(p.position));
        }
        // Slivers of triangles cover too little of a pixel to be kept.
        assert!(lost * 50 <= all, "level {level}: {lost} of {all}");
    }
}

#[test]
fn the_same_tree_whatever_the_number_of_threads() {
    let make = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let scene = scene(vec![(soup(5, 300), plain([0.2, 0.7, 0.4, 1.0]))], Vec::new());
            let (tree, _) = built(scene, &[DVec3::ZERO, DVec3::splat(0.3)], 32, 7);
            (tree.tree, tree.chunks.into_iter().map(|c| c.bytes).collect::<Vec<_>>())
        })
    };
    assert!(make(1) == make(4));
}

/// A wall exactly on the border between cells of every level neither doubles nor vanishes.
#[test]
fn a_wall_on_a_border_of_cells_is_one_wall() {
    // A wall where the cells of level 1 meet, within a root that another wall spans.
    let far = quad(Vec3::new(-2.0, 2.0, -4.0), Vec3::X * 4.0, Vec3::NEG_Y * 4.0);
    let near = quad(Vec3::new(-2.0, 2.0, 0.0), Vec3::X * 4.0, Vec3::NEG_Y * 4.0);
    let both = scene(vec![(far.clone(), plain([1.0; 4])), (near.clone(), plain([1.0; 4]))], Vec::new());
    let (origin, root) = cube(&both.bounds());
    let border = (origin.z + root / 2.0) as f32;
    let on_border = quad(Vec3::new(-2.0, 2.0, border), Vec3::X * 4.0, Vec3::NEG_Y * 4.0);
    let all = scene(
        vec![(far, plain([1.0; 4])), (near, plain([1.0; 4])), (on_border, plain([0.1, 0.9, 0.1, 1.0]))],
        Vec::new(),
    );
    let (tree, _) = built(all, &[DVec3::new(0.1, 0.2, f64::from(border) + 1.0)], 96, 3);
    let found = samples(&tree);
    let pitch = tree.tree.pitch_of(0);
    let on_root = found.iter().filter(|(l, s, p)| *l == 0 && s.face == 5 && (p.z - f64::from(border)).abs() < pitch);
    let (mut count, mut cover) = (0, 0.0);
    for (_, s, p) in on_root.filter(|(_, _, p)| p.x.abs().max(p.y.abs()) < 2.0 - pitch) {
        count += 1;
        cover += f64::from(s.coverage());
        assert!((p.z - f64::from(border)).abs() < pitch / 32.0);
    }
    let pixels = (4.0 - 2.0 * pitch).powi(2) / pitch.powi(2);
    assert!((cover / pixels - 1.0).abs() < 0.06 && f64::from(count) / pixels < 1.1, "{cover}, {count} of {pixels}");
}

/// Hard cases: none panics, every number is in range (`Tree::check`, the decoder), and something
/// is there.
#[test]
fn scenes_that_numbers_break_on() {
    let tiny = quad(Vec3::new(0.0, 0.0, -1.0), Vec3::X * 1e-4, Vec3::NEG_Y * 1e-4);
    let deep = {
        // A corridor of 1 m x 1 m, 1,000 km long.
        let floor = quad(Vec3::new(-0.5, -0.5, 0.0), Vec3::X, Vec3::NEG_Z * 1e6);
        scene(vec![(floor, plain([0.5; 4]))], Vec::new())
    };
    let cases: [(&str, Scene, DVec3); 4] = [
        ("one point", scene(vec![(tiny, plain([1.0; 4]))], Vec::new()), DVec3::new(5e-5, -5e-5, -0.5)),
        ("1e6 times deeper than wide", deep, DVec3::new(0.0, 0.0, -10.0)),
        ("edge-on", wall(-2.0), DVec3::new(0.0, 0.0, -1.999)),
        ("in the plane", wall(-2.0), DVec3::new(-3.0, 0.0, -2.0)),
    ];
    for (name, scene, eye) in cases {
        let (tree, references) = built(scene, &[eye], 64, MAX_LEVEL);
        let found = samples(&tree);
        let seen = references[0].points.len();
        assert!(
            found.is_empty() == (seen == 0) || name == "one point",
            "{name}: {seen} points, {} samples",
            found.len()
        );
        assert!(found.iter().all(|(_, _, p)| p.is_finite()), "{name}");
        assert!(references[0].points.iter().all(|p| p.stamp_m > 0.0 && p.area_m2.is_finite()), "{name}");
    }
}

#[test]
fn probed_samples_are_those_of_the_finest_level_that_covers_the_point() {
    let (tree, _) = built(wall(-2.0), &[DVec3::new(0.3, 0.1, 0.2)], 256, 6);
    let all = samples(&tree);
    let eye = DVec3::new(0.7, -0.4, 0.1);
    let seen = |x: f64, y: f64, z: f64, eye: DVec3| {
        let position = DVec3::new(x, y, z);
        FarPoint { position, towards: (eye - position).normalize(), depth_m: (eye.z - z).abs() }
    };
    let mut far: Vec<FarPoint> =
        (0..400).map(|k| seen((k % 20) as f64 * 0.19 - 1.8, (k / 20) as f64 * 0.19 - 1.8, -2.0, eye)).collect();
    far.push(seen(0.0, 0.0, -1.0, eye));
    far.push(seen(0.0, 0.0, -2.0, DVec3::new(0.0, 0.0, -9.0)));
    let probes = Probes { far, ..Probes::default() };
    let sizes = probes.footprints(&tree, 100.0).expect("it can be read back");
    assert!(sizes[400].is_infinite() && sizes[401].is_infinite(), "in the air; from behind");
    let mut levels = [0; 3];
    for (p, size) in probes.far[..400].iter().zip(&sizes) {
        // Over all samples, wherever they are kept.
        let covers = |level: u8| {
            let pitch = tree.tree.pitch_of(level);
            let weight = |at: &DVec3, s: &TreeSample| {
                let [x, y] = [0, 1].map(|k| (1.0 - (at[k] - p.position[k]).abs() / pitch).max(0.0));
                x * y * f64::from(s.coverage())
            };
            all.iter().filter(|(l, ..)| *l == level).map(|(_, s, at)| weight(at, s)).sum::<f64>() >= 0.4
        };
        let Some(level) = (0..3).rev().find(|l| covers(*l)) else {
            assert!(size.is_infinite(), "nothing covers {}", p.position);
            continue;
        };
        levels[usize::from(level)] += 1;
        let across = |axis: DVec3| (1.0 - axis.dot(p.towards).powi(2)).sqrt();
        let extent = tree.tree.pitch_of(level) * across(DVec3::X).max(across(DVec3::Y));
        assert!((size - extent * 100.0 / p.depth_m).abs() < 1e-9, "{size} at {}, level {level}", p.position);
    }
    assert!(levels[0] > 20 && levels[1] > 20, "points on both levels: {levels:?}");

    let depths = |n: u32| (1..=n).map(|k| FarPoint { depth_m: f64::from(k), ..probes.far[0] }).rev().collect();
    let probes = Probes { far: depths(1000), ..Probes::default() };
    assert_eq!(probes.needed_pitch_m(2.0, 500.0, 0.01), Some(11.0 * 2.0 / 500.0), "ten points are nearer");
    assert_eq!(Probes::default().needed_pitch_m(2.0, 500.0, 0.01), None);
}

#[test]
fn probes_look_beyond_what_the_budget_draws() {
    let scene = Arc::new(wall(-2.0));
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, 1000);
    let caster = Caster::new(Arc::clone(&scene), &clusters, &octree);
    let levels = crate::levels::Levels::none(&scene, &octree);
    let cells = crate::pack::pack_geometry(&scene, &clusters, &octree, &levels, 0).expect("it can be packed").cells;
    let volume = WalkVolume::of_box(&Aabb::from_points([DVec3::new(-1.0, -1.0, -1.0), DVec3::new(1.0, 1.0, 1.0)]));
    let volume = volume.expect("a volume");
    let look = |budget| {
        let settings = crate::placement::test_scenes::settings(budget);
        Probes::take(&caster, &volume, &cells, &settings)
    };
    let (none, all) = (look(1), look(10));
    assert!(none.surfaces > 1_000 && none.far.len() == none.surfaces, "{} of {}", none.far.len(), none.surfaces);
    assert!(none.far.iter().all(|p| (p.position.z + 2.0).abs() < 1e-9 && p.towards.z > 0.0 && p.depth_m < 5.0));
    assert!(
        all.far.is_empty() && all.surfaces > none.surfaces,
        "two triangles are within the budget: it looks on in vain"
    );
}
