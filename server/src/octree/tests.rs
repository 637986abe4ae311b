//! Random scenes against brute force; what the checker must notice.

use super::{cluster::extent, tree::leaf_limit, *};
use crate::scene::{Instance, Mesh, Primitive, Scene};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use ldi_protocol::Aabb;
use proptest::prelude::*;

/// Deterministic values in [0, 1).
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / (1u64 << 24) as f64
    }
    fn point(&mut self, size: f64) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next()) * size
    }
}

/// Triangles of widely different sizes, all at random places.
fn soup(noise: &mut Noise, triangles: usize) -> Primitive {
    let mut p = Primitive::default();
    for _ in 0..triangles {
        let (centre, size) = (noise.point(10.0), 0.01 * 1000f64.powf(noise.next()));
        let first = p.positions.len() as u32;
        p.positions.extend((0..3).map(|_| (centre + noise.point(size)).as_vec3()));
        p.triangles.push([first, first + 1, first + 2]);
    }
    p.normals = vec![Vec3::Y; p.positions.len()];
    p
}

fn scene(seed: u64, triangles: usize, instances: usize) -> Scene {
    let mut noise = Noise(seed);
    let meshes: Vec<Mesh> = (0..3)
        .map(|_| Mesh {
            primitives: (0..2).map(|k| soup(&mut noise, triangles * (k + 1) / 3)).collect(),
            ..Mesh::default()
        })
        .collect();
    let instances = (0..instances)
        .map(|i| Instance {
            node: 100 + i as u32,
            mesh: (i % 3) as u32,
            world_from_mesh: DAffine3::from_scale_rotation_translation(
                DVec3::splat(0.2 + noise.next()),
                DQuat::from_euler(glam::EulerRot::YXZ, noise.next() * 6.0, noise.next(), 0.0),
                noise.point(100.0),
            ),
        })
        .collect();
    Scene { meshes, instances, ..Scene::default() }
}

/// World corners of all triangles of an instance's primitive.
fn corners(scene: &Scene, instance: u32, primitive: u32, triangle: u32) -> [DVec3; 3] {
    let i = &scene.instances[instance as usize];
    let p = &scene.meshes[i.mesh as usize].primitives[primitive as usize];
    p.triangles[triangle as usize].map(|v| i.world_from_mesh.transform_point3(p.positions[v as usize].as_dvec3()))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_triangle_is_in_exactly_one_cell(seed: u64, triangles in 3usize..1500, instances in 1usize..9, budget in 0u64..200_000) {
        let scene = scene(seed, triangles, instances);
        let clusters = Clusters::build(&scene);
        let octree = Octree::build(&scene, &clusters, budget);
        prop_assert_eq!(octree.check(&scene, &clusters), Ok(()));
        prop_assert_eq!(octree.cells.iter().map(|c| u64::from(c.triangles)).sum::<u64>(), scene.triangles());
        for cell in &octree.cells {
            let limit = leaf_limit(budget) as u32;
            let together = cell.content.iter().all(|c| c.0 == cell.content[0].0)
                && u64::from(cell.triangles) <= tree::together_limit(budget);
            let is_one = cell.content.len() == 1 || together;
            prop_assert!(cell.triangles <= limit || is_one, "{} of {limit}", cell.triangles);
        }
    }

    #[test]
    fn cells_are_tight_and_ranges_name_their_triangles(seed: u64, triangles in 3usize..600) {
        let scene = scene(seed, triangles, 4);
        let clusters = Clusters::build(&scene);
        let octree = Octree::build(&scene, &clusters, 20_000);
        let mut left: std::collections::BTreeSet<(u32, u32, u32)> = (0..4u32)
            .flat_map(|i| {
                let mesh = &scene.meshes[scene.instances[i as usize].mesh as usize];
                mesh.primitives.iter().enumerate()
                    .flat_map(move |(k, p)| (0..p.triangles.len() as u32).map(move |t| (i, k as u32, t)))
                    .collect::<Vec<_>>()
            })
            .collect();
        for number in 0..octree.cells.len() {
            let mut bounds = Aabb::EMPTY;
            for r in octree.ranges(&scene, &clusters, number) {
                let instance = r.node - 100;
                prop_assert_eq!(scene.instances[instance as usize].mesh, r.mesh);
                for t in r.first..r.first + r.count {
                    prop_assert!(left.remove(&(instance, r.primitive, t)), "{r:?} holds a triangle twice");
                    bounds = bounds.union(Aabb::from_points(corners(&scene, instance, r.primitive, t)));
                }
            }
            prop_assert_eq!(tree::outward_f32(&bounds), octree.cells[number].bounds);
        }
        prop_assert!(left.is_empty(), "{} triangles in no cell", left.len());
    }

    #[test]
    fn recounting_finds_what_is_wrong(seed: u64, triangles in 60usize..600) {
        let scene = scene(seed, triangles, 4);
        let clusters = Clusters::build(&scene);
        let octree = Octree::build(&scene, &clusters, 20_000);
        let ranges: Vec<_> = (0..octree.cells.len()).map(|c| octree.ranges(&scene, &clusters, c)).collect();
        let bounds: Vec<Aabb> = octree.cells.iter().map(|c| c.bounds).collect();
        let counts: Vec<u64> = octree.cells.iter().map(|c| u64::from(c.triangles)).collect();
        prop_assert_eq!(recount(&scene, &ranges, &bounds), Ok(counts));
        let number = (seed % ranges.len() as u64) as usize;
        let changed = |change: &dyn Fn(&mut Vec<SourceRange>)| {
            let mut ranges = ranges.clone();
            change(&mut ranges[number]);
            recount(&scene, &ranges, &bounds).unwrap_err()
        };
        let twice = changed(&|r| r.push(r[0]));
        prop_assert!(matches!(twice, RecountError::Twice { cell, .. } if cell == number), "{twice}");
        let gone = changed(&|r| { r.pop(); });
        prop_assert!(matches!(gone, RecountError::Missing(_)), "{gone}");
        let beyond = changed(&|r| r[0].count = u32::MAX);
        prop_assert!(matches!(beyond, RecountError::NotThere { .. }), "{beyond}");
        let nobody = changed(&|r| r[0].node += 1000);
        prop_assert!(matches!(nobody, RecountError::NotThere { .. }), "{nobody}");
        let mut small = bounds.clone();
        small[number] = Aabb { min: bounds[number].max, max: bounds[number].max };
        let outside = recount(&scene, &ranges, &small).unwrap_err();
        prop_assert!(matches!(outside, RecountError::Outside { cell, .. } if cell == number), "{outside}");
    }
}

#[test]
fn big_triangles_do_not_inflate_clusters_of_small_ones() {
    let mut noise = Noise(5);
    let mut p = Primitive::default();
    // A thousand small triangles everywhere and one across the whole.
    for i in 0..1000u32 {
        let corner = noise.point(100.0);
        p.positions.extend([corner, corner + DVec3::X * 0.1, corner + DVec3::Y * 0.1].map(|v| v.as_vec3()));
        p.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    p.positions.extend([Vec3::ZERO, Vec3::splat(100.0), Vec3::new(100.0, 0.0, 0.0)]);
    p.triangles.push([3000, 3001, 3002]);
    let instances = vec![Instance { node: 0, mesh: 0, world_from_mesh: DAffine3::IDENTITY }];
    let scene = Scene { meshes: vec![Mesh { primitives: vec![p], ..Mesh::default() }], instances, ..Scene::default() };
    let clusters = Clusters::build(&scene);
    let with_big: Vec<_> = clusters.clusters.iter().filter(|c| c.triangles.contains(&1000)).collect();
    assert_eq!(with_big[0].triangles, vec![1000], "the big one stays alone");
    for c in clusters.clusters.iter().filter(|c| !c.triangles.contains(&1000)) {
        assert!(extent(&c.bounds) <= 100.0 / 32.0, "{:?}", c.bounds);
    }
}

#[test]
fn coinciding_triangles_are_split_by_count() {
    let mut p = Primitive { positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y], ..Primitive::default() };
    p.triangles = vec![[0, 1, 2]; 1000];
    let instances = vec![Instance { node: 0, mesh: 0, world_from_mesh: DAffine3::IDENTITY }];
    let scene = Scene { meshes: vec![Mesh { primitives: vec![p], ..Mesh::default() }], instances, ..Scene::default() };
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, 1000);
    assert_eq!(octree.check(&scene, &clusters), Ok(()));
    assert!(clusters.clusters.len() >= 4);
}

#[test]
fn an_empty_scene_has_no_cells() {
    let scene = Scene::default();
    let octree = Octree::build(&scene, &Clusters::build(&scene), 1000);
    assert_eq!((octree.cells.len(), octree.largest_cell()), (0, 0));
}

#[test]
fn the_check_notices_faults() {
    let scene = scene(1, 300, 3);
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, 30_000);
    assert_eq!(octree.check(&scene, &clusters), Ok(()));
    let mut lost = octree.clone();
    lost.cells.pop();
    assert!(matches!(lost.check(&scene, &clusters), Err(OctreeFault::Instances { .. })));
    let mut twice = octree.clone();
    twice.cells.push(octree.cells[0].clone());
    assert!(matches!(twice.check(&scene, &clusters), Err(OctreeFault::Instances { .. })));
    let mut narrow = octree.clone();
    narrow.cells[0].bounds.max.x -= 0.25;
    assert_eq!(narrow.check(&scene, &clusters), Err(OctreeFault::Bounds(0)));
    let mut miscounted = octree.clone();
    miscounted.cells[0].triangles += 1;
    assert_eq!(miscounted.check(&scene, &clusters), Err(OctreeFault::Cell(0)));
    let mut cut = clusters.clone();
    cut.clusters[0].triangles.pop();
    assert!(octree.check(&scene, &cut).is_err());
}
