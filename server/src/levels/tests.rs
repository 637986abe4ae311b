use super::*;
use crate::placement::test_scenes::Random;
use crate::scene::{Instance, Mesh, Primitive, WHITE, builtin};
use glam::{DAffine3, DVec3, Vec3};
use ldi_protocol::mesh::Alpha;
use std::collections::{BTreeMap, BTreeSet};

/// World corners of what a cell places.
fn corners(scene: &Scene, clusters: &Clusters, levels: &Levels, content: &[(u32, u32)]) -> Vec<[DVec3; 3]> {
    let of = |(instance, piece): &(u32, u32)| {
        let piece = levels.piece(clusters, scene, *piece);
        let p = &scene.meshes[piece.mesh as usize].primitives[piece.primitive as usize];
        let world = scene.instances[*instance as usize].world_from_mesh;
        let corner = |v: u32| world.transform_point3(p.positions[v as usize].as_dvec3());
        piece.triangles.iter().map(|t| t.map(corner)).collect::<Vec<_>>()
    };
    content.iter().flat_map(of).collect()
}

/// Random points of both surfaces: none lies farther from the other than the level says.
#[test]
fn no_point_of_a_level_deviates_more_than_it_says() {
    let scene = builtin::build("plant", Some(60_000), 1).expect("builds").scene;
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, 60_000);
    let levels = Levels::build(&scene, &clusters, &octree);
    let (mut looked_at, mut closest, mut random) = (0, 0.0f64, Random::new(2));
    for (cell, of_cell) in octree.cells.iter().zip(&levels.cells) {
        let full = corners(&scene, &clusters, &levels, &cell.content);
        let (mut triangles, mut deviation_m) = (cell.triangles, 0.0);
        for level in of_cell {
            let coarse = corners(&scene, &clusters, &levels, &level.content);
            assert_eq!(coarse.len() as u32, level.triangles);
            assert!(level.triangles < triangles && level.deviation_m >= deviation_m, "{level:?}");
            assert!(coarse.iter().flatten().all(|c| cell.bounds.inflated(1e-6).contains(*c)));
            (triangles, deviation_m) = (level.triangles, level.deviation_m);
            for (from, to) in [(&full, &coarse), (&coarse, &full)] {
                let tree = SurfaceTree::new(to);
                for _ in 0..40 {
                    let t = from[random.bits() as usize % from.len()];
                    let (mut u, mut v) = (random.unit(), random.unit());
                    if u + v > 1.0 {
                        (u, v) = (1.0 - u, 1.0 - v);
                    }
                    let apart = tree.distance(t[0] * (1.0 - u - v) + t[1] * u + t[2] * v);
                    assert!(apart <= level.deviation_m, "{apart} m, but {} m is promised", level.deviation_m);
                    closest = closest.max(apart / level.deviation_m);
                    looked_at += 1;
                }
            }
        }
    }
    assert!(looked_at > 1000 && closest > 0.4, "{looked_at} points, the farthest at {closest} of the bound");
}

/// A hilly square of `side` x `side` quads, in one primitive.
fn hills(side: u32) -> Scene {
    let at = |i: u32, k: u32| {
        let (x, z) = (i as f32, k as f32);
        Vec3::new(x, 0.4 * (x * 0.3).sin() * (z * 0.23).cos(), z)
    };
    let number = |i: u32, k: u32| i * (side + 1) + k;
    let positions: Vec<Vec3> = (0..=side).flat_map(|i| (0..=side).map(move |k| at(i, k))).collect();
    let quads = (0..side).flat_map(|i| (0..side).map(move |k| (i, k)));
    let triangles = quads.flat_map(|(i, k)| {
        let [a, b, c, d] = [number(i, k), number(i, k + 1), number(i + 1, k + 1), number(i + 1, k)];
        [[a, b, c], [a, c, d]]
    });
    let primitive = Primitive {
        material: 0,
        normals: vec![Vec3::Y; positions.len()],
        positions,
        uvs: Vec::new(),
        colours: Vec::new(),
        triangles: triangles.collect(),
    };
    Scene {
        meshes: vec![Mesh { name: "hills".into(), primitives: vec![primitive] }],
        instances: vec![Instance { node: 0, mesh: 0, world_from_mesh: DAffine3::IDENTITY }],
        materials: vec![WHITE],
        ..Scene::default()
    }
}

/// What two cells share of a mesh is at every level of both, so that no crack opens between them.
#[test]
fn neighbours_meet_at_all_levels() {
    let scene = hills(64);
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, 60_000);
    let levels = Levels::build(&scene, &clusters, &octree);
    let vertices = |content: &[(u32, u32)]| -> BTreeSet<u32> {
        content.iter().flat_map(|(_, p)| levels.piece(&clusters, &scene, *p).triangles.to_vec()).flatten().collect()
    };
    let mut cells_of = BTreeMap::<u32, u32>::new();
    for cell in &octree.cells {
        vertices(&cell.content).into_iter().for_each(|v| *cells_of.entry(v).or_default() += 1);
    }
    let shared = cells_of.values().filter(|n| **n > 1).count();
    assert!(octree.cells.len() > 10 && shared > 100, "{} cells, {shared} shared vertices", octree.cells.len());
    let mut coarser = 0;
    for (cell, of_cell) in octree.cells.iter().zip(&levels.cells) {
        let borders: BTreeSet<u32> = vertices(&cell.content).into_iter().filter(|v| cells_of[v] > 1).collect();
        for level in of_cell {
            assert!(vertices(&level.content).is_superset(&borders));
            coarser += 1;
        }
    }
    assert!(coarser > octree.cells.len() / 2, "{coarser} levels");
}

#[test]
fn what_has_an_alpha_mask_stays_in_full() {
    let mut scene = hills(24);
    scene.materials[0].alpha = Alpha::Mask(0.5);
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, 60_000);
    assert!(Levels::build(&scene, &clusters, &octree).cells.iter().all(Vec::is_empty));
    scene.materials[0].alpha = Alpha::Opaque;
    assert!(!Levels::build(&scene, &clusters, &octree).cells.iter().all(Vec::is_empty));
}

#[test]
fn stretch_is_the_largest_singular_value_where_axes_are_square() {
    let turn = DMat3::from_rotation_y(0.7) * DMat3::from_rotation_x(-1.1);
    for scale in [0.001, 1.0, 25.4] {
        assert!((largest_stretch(&(turn * scale)) / scale - 1.0).abs() < 1e-12);
    }
    let flat = turn * DMat3::from_diagonal(DVec3::new(1.0, 3.0, 0.5));
    assert!((largest_stretch(&flat) - 3.0).abs() < 1e-12);
    let mut random = Random::new(4);
    for _ in 0..200 {
        let mut row = || DVec3::new(random.unit(), random.unit(), random.unit()) * 2.0 - 1.0;
        let m = DMat3::from_cols(row(), row(), row());
        let v = row().normalize();
        assert!((m * v).length() <= largest_stretch(&m) + 1e-12);
    }
}
