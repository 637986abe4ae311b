//! The caster against brute force in f64, against itself on other paths, and against scenes with
//! known answers.

use super::*;
use crate::{
    render::test_scenes::{Noise, plain, quad, scene, soup, sphere},
    scene::{Instance, Primitive, SceneTexture},
};
use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};
use ldi_protocol::{
    CellRuns, OutputCamera, ViewBasis,
    mesh::{Alpha, Material},
    shade::light,
};
use proptest::prelude::*;

fn caster(scene: Scene) -> Caster {
    caster_with(scene, MOST_EXPANDED)
}

/// A caster of one level, or of two where `most_expanded` is 0 and meshes repeat.
fn caster_with(scene: Scene, most_expanded: u64) -> Caster {
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, 20_000);
    let geometry = Geometry::new(Arc::new(scene), Some((&clusters, &octree)));
    Caster::from_geometry(geometry, Some(&clusters), false, most_expanded)
}

/// A scene of loose triangles, and its caster: in one mesh, or in a mesh of its own and one that
/// stands in four places, turned, sheared, scaled and mirrored.
fn soup_caster(seed: u64, triangles: usize, repeated: bool) -> Caster {
    if !repeated {
        return caster(scene(vec![(soup(seed, triangles), plain([1.0; 4]))], vec![]));
    }
    let once = (soup(seed ^ 7, triangles / 5 + 1), plain([1.0; 4]));
    let mut s = scene(vec![(soup(seed, triangles / 5 + 1), plain([1.0; 4])), once], vec![]);
    let mut noise = Noise(seed ^ 3);
    for node in 0..3 {
        let matrix3 = DMat3::from_cols(noise.point(1.0), noise.point(1.0), noise.point(1.0));
        // Far from flat, so that f32 corners hold it.
        let matrix3 = if matrix3.determinant().abs() > 0.1 { matrix3 } else { DMat3::from_diagonal(noise.point(2.0)) };
        let world_from_mesh = DAffine3 { matrix3, translation: noise.point(4.0) };
        s.instances.push(Instance { node: node + 2, mesh: 0, world_from_mesh });
    }
    let c = caster_with(s, 0);
    assert!(c.bvh.items.len() >= 4 && !c.bvh.world.blocks.is_empty(), "two levels");
    c
}

/// All hits of a ray by Moeller and Trumbore in f64, with the least barycentric weight of each.
fn all_hits(c: &Caster, ray: &Ray) -> Vec<(f64, u32, f64)> {
    let hit = |triangle| {
        let [a, b, d] = c.corners_world(triangle);
        let (ab, ac, ao) = (b - a, d - a, ray.origin - a);
        let det = -ab.cross(ac).dot(ray.direction);
        let q = ao.cross(ray.direction);
        let (t, u, v) = (ab.cross(ac).dot(ao) / det, ac.dot(q) / det, -ab.dot(q) / det);
        let inside = u.min(v).min(1.0 - u - v);
        (inside > -1e-4 && t >= ray.t_min - 1e-4 && t <= ray.t_max + 1e-4).then_some((t, triangle, inside))
    };
    (0..c.triangle_count()).filter_map(hit).collect()
}

/// Whether a hit is the nearest of all, as far as f32 traversal can know: hits within a hair of an
/// edge, or of another's depth, may go either way.
fn is_nearest(c: &Caster, ray: &Ray, cells: &CellSet, hit: Option<Hit>) -> Result<(), String> {
    let all: Vec<_> = all_hits(c, ray).into_iter().filter(|h| cells.contains(c.cell_of(h.1))).collect();
    let tolerance = |t: f64| 1e-4 * (1.0 + t.abs());
    let surest = all
        .iter()
        .filter(|h| h.2 > 1e-4 && h.0 > ray.t_min + 1e-4 && h.0 < ray.t_max - 1e-4)
        .map(|h| h.0)
        .fold(f64::INFINITY, f64::min);
    match hit {
        None if surest < f64::INFINITY => Err(format!("missed the one at {surest}")),
        Some(h) if h.t > surest + tolerance(surest) => Err(format!("{h:?} behind the one at {surest}")),
        Some(h) => {
            let same = all.iter().find(|a| a.1 == h.triangle).ok_or(format!("{h:?} is no hit"))?;
            // f32 corners over 20 m are exact to 1e-6 m; grazing hits turn that into more along
            // the ray.
            if (same.0 - h.t).abs() < tolerance(h.t) { Ok(()) } else { Err(format!("{h:?} is at {}", same.0)) }
        }
        None => Ok(()),
    }
}

/// 64 rays of one pinhole within some pixels.
fn fan(noise: &mut Noise, spread: f64) -> Vec<Ray> {
    let origin = noise.point(12.0);
    let ahead = (noise.point(5.0) - origin).normalize();
    (0..64).map(|_| Ray::new(origin, (ahead + noise.point(spread)) * (0.5 + noise.next()))).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn hits_are_the_nearest(seed: u64, triangles in 1usize..400, every_cell: bool, repeated: bool) {
        let c = soup_caster(seed, triangles, repeated);
        let mut noise = Noise(seed ^ 1);
        let count = c.geometry.cell_count as u32;
        let some: CellRuns = (0..count).filter(|_| noise.next() < 0.5).collect();
        let cells = if every_cell { CellSet::all() } else { c.cell_set(&some) };
        let mut rays = fan(&mut noise, 0.01);
        rays.extend((0..64).map(|_| Ray::new(noise.point(12.0), noise.point(1.0))));
        let limited: Vec<Ray> = rays.iter().step_by(7).map(|r| Ray { t_min: 3.0, t_max: 8.0, ..*r }).collect();
        rays.extend(limited);
        let mut hits = vec![None; rays.len()];
        c.trace_batch(&rays, &cells, &mut hits);
        for (ray, hit) in rays.iter().zip(hits.iter().copied()) {
            let verdict = is_nearest(&c, ray, &cells, hit);
            prop_assert!(verdict.is_ok(), "{ray:?}: {verdict:?}");
            prop_assert_eq!(c.occluded(ray, &cells), hit.is_some());
        }
        let (nearest, mut some) = (hits, vec![None; rays.len()]);
        c.trace_any(&rays, &cells, &mut some);
        for ((ray, nearest), some) in rays.iter().zip(nearest).zip(some) {
            prop_assert_eq!(nearest.is_some(), some.is_some(), "{:?}", ray);
            prop_assert!(nearest.zip(some).is_none_or(|(n, s)| n.t <= s.t && cells.contains(c.cell_of(s.triangle))));
        }
        let others = c.cells_besides(&cells);
        prop_assert!((0..count).all(|cell| others.contains(cell) != cells.contains(cell)));
    }

    #[test]
    fn every_path_gives_the_same_hits(
        seed: u64,
        triangles in 1usize..3000,
        spread in 0.0f64..0.2,
        rays in 1usize..200,
        repeated: bool,
    ) {
        let make = || soup_caster(seed, triangles, repeated);
        let (fast, portable) = (make(), make().on(Isa::Portable));
        let mut noise = Noise(seed ^ 2);
        let rays: Vec<Ray> = (0..4).flat_map(|_| fan(&mut noise, spread)).take(rays).collect();
        let all = CellSet::all();
        let single: Vec<_> = rays.iter().map(|r| fast.trace(r, &all)).collect();
        let mut batch = vec![None; rays.len()];
        fast.trace_batch(&rays, &all, &mut batch);
        prop_assert!(batch == single, "packets differ from single rays");
        portable.trace_batch(&rays, &all, &mut batch);
        prop_assert!(batch == single, "plain Rust differs from SIMD");
        let limited = fast.cell_set(&CellRuns::below(fast.geometry.cell_count as u32));
        fast.trace_batch(&rays, &limited, &mut batch);
        prop_assert!(batch == single, "the set of all cells differs from no set");
        // Short rays from one origin, each over another part of its way.
        let short = |r: &Ray| {
            let t_min = 4.0 * noise.next();
            Ray { t_min, t_max: t_min + 2.0 * noise.next(), ..*r }
        };
        let rays: Vec<Ray> = rays.iter().map(short).collect();
        let single: Vec<_> = rays.iter().map(|r| fast.trace(r, &all)).collect();
        fast.trace_batch(&rays, &all, &mut batch);
        prop_assert!(batch == single, "packets of short rays differ from single ones");
    }
}

#[test]
fn nothing_slips_through_shared_edges() {
    nothing_slips_out(&caster(scene(vec![(sphere(24), plain([1.0; 4]))], vec![])));
}

#[test]
fn nothing_slips_through_shared_edges_of_instances() {
    let mut s = scene(vec![(sphere(24), plain([1.0; 4]))], vec![]);
    // A turned sphere is one, too, within the same sagitta.
    s.instances[0].world_from_mesh = DAffine3::from_rotation_y(0.3) * DAffine3::from_rotation_x(1.1);
    let far = DAffine3::from_translation(DVec3::new(30.0, 5.0, -8.0));
    s.instances.push(Instance { node: 1, mesh: 0, world_from_mesh: far });
    let c = caster_with(s, 0);
    assert!(!c.bvh.items.is_empty() && c.bvh.world.blocks.is_empty());
    nothing_slips_out(&c);
}

/// From within a unit sphere around the origin every ray hits it.
fn nothing_slips_out(c: &Caster) {
    let all = CellSet::all();
    let eye = DVec3::new(0.1, -0.2, 0.3);
    let mut noise = Noise(3);
    let mut targets: Vec<DVec3> = (0..2000).map(|_| noise.point(1.0)).collect();
    // Straight at corners and along edges, where cracks would be.
    for t in 0..c.triangle_count() {
        let [a, b, d] = c.corners_world(t);
        if a.length() > 2.0 {
            continue;
        }
        targets.extend([a, (a + b) * 0.5, b + (d - b) * noise.next()].map(|p| p - eye));
    }
    let rays: Vec<Ray> = targets.iter().map(|t| Ray::new(eye, *t)).collect();
    let mut hits = vec![None; rays.len()];
    c.trace_batch(&rays, &all, &mut hits);
    for (ray, hit) in rays.iter().zip(hits) {
        let hit = hit.unwrap_or_else(|| panic!("{ray:?} escapes"));
        // The mesh lies between the sphere and its inscribed polyhedron: sagitta 1 - cos(pi / 48)
        // on both angles.
        let radius = ray.at(hit.t).length();
        assert!(radius < 1.0 + 1e-6 && radius > 1.0 - 0.0045, "{radius}");
    }
}

#[test]
fn depth_of_a_plane_is_exact() {
    // 40 m to the side the scene goes on, so that its middle is elsewhere.
    let far = quad(Vec3::new(80.0, -1.0, 5.0), Vec3::X, Vec3::Y);
    let wall = quad(Vec3::new(-20.0, 20.0, -7.3), Vec3::X * 40.0, Vec3::NEG_Y * 40.0);
    let c = caster(scene(vec![(wall, plain([1.0; 4])), (far, plain([1.0; 4]))], vec![]));
    let camera = OutputCamera { width: 64, height: 36, fov_deg: 90.0 };
    let basis = ViewBasis::from_yaw_pitch(10.0, -5.0);
    let eye = DVec3::new(0.3, 0.2, 0.1);
    for (u, v) in [(0.5, 0.5), (31.7, 12.0), (63.5, 35.5), (32.0, 18.0)] {
        let ray = Ray::new(eye, camera.ray(&basis, u, v));
        let want = (f64::from(-7.3f32) - eye.z) / ray.direction.z;
        let hit = c.trace(&ray, &CellSet::all()).expect("the wall is everywhere ahead");
        assert!((hit.t - want).abs() <= 1e-6 * want, "{} {want}", hit.t);
        let s = c.surface(&hit, &ray);
        assert!((s.position_world.z + 7.3).abs() < 1e-5);
        assert!((s.geometric_normal.abs() - DVec3::Z).length() < 1e-9);
    }
}

#[test]
fn rays_along_axes_and_in_planes() {
    let c = caster(scene(
        vec![(quad(Vec3::new(-1.0, 1.0, -2.0), Vec3::X * 2.0, Vec3::NEG_Y * 2.0), plain([1.0; 4]))],
        vec![],
    ));
    let t = |o: DVec3, d: DVec3| c.trace(&Ray::new(o, d), &CellSet::all()).map(|h| h.t);
    assert_eq!(t(DVec3::ZERO, DVec3::NEG_Z), Some(2.0));
    assert_eq!(t(DVec3::new(1.0, 1.0, 0.0), DVec3::NEG_Z * 0.5), Some(4.0), "a corner belongs to the quad");
    assert_eq!(t(DVec3::ZERO, DVec3::Z), None, "it lies behind");
    assert_eq!(t(DVec3::new(0.0, 0.0, -4.0), DVec3::Z), Some(2.0), "back faces are hit");
    assert_eq!(t(DVec3::new(-3.0, 0.0, -2.0), DVec3::X), None, "edge on it is nothing");
    assert_eq!(t(DVec3::ZERO, DVec3::new(f64::NAN, 0.0, 1.0)), None);
}

#[test]
fn limits_of_a_ray() {
    let wall = |z| (quad(Vec3::new(-1.0, 1.0, z), Vec3::X * 2.0, Vec3::NEG_Y * 2.0), plain([1.0; 4]));
    let c = caster(scene(vec![wall(-1.0), wall(-2.0), wall(-3.0)], vec![]));
    let within = |t_min, t_max| {
        let ray = Ray { t_min, t_max, ..Ray::new(DVec3::ZERO, DVec3::NEG_Z) };
        assert_eq!(c.occluded(&ray, &CellSet::all()), c.trace(&ray, &CellSet::all()).is_some());
        c.trace(&ray, &CellSet::all()).map(|h| h.t)
    };
    assert_eq!(within(0.0, f64::INFINITY), Some(1.0));
    assert_eq!(within(1.5, f64::INFINITY), Some(2.0));
    assert_eq!(within(2.0, 2.0), Some(2.0), "limits belong to the ray");
    assert_eq!(within(2.1, 2.9), None);
}

#[test]
fn triangles_have_sources_and_cells_in_order() {
    let c = soup_caster(11, 600, true);
    let mut number = 0;
    for (i, instance) in c.scene().instances.iter().enumerate() {
        for (k, p) in c.scene().meshes[instance.mesh as usize].primitives.iter().enumerate() {
            for triangle in 0..p.triangles.len() as u32 {
                let want = TriangleSource { instance: i as u32, mesh: instance.mesh, primitive: k as u32, triangle };
                assert_eq!(c.source(number), want);
                number += 1;
            }
        }
    }
    assert_eq!(number, c.triangle_count());
    // By the cells' own content.
    let clusters = Clusters::build(c.scene());
    let octree = Octree::build(c.scene(), &clusters, 20_000);
    for (cell, content) in octree.cells.iter().enumerate() {
        for (instance, cluster) in &content.content {
            let cluster = &clusters.clusters[*cluster as usize];
            let first = c.geometry.first_triangle(*instance, cluster.primitive);
            assert!(cluster.triangles.iter().all(|t| c.cell_of(first + t) == cell as u32));
        }
    }
}

#[test]
fn equal_depths_go_to_the_smallest_number() {
    let one = quad(Vec3::new(-1.0, 1.0, -1.0), Vec3::X * 2.0, Vec3::NEG_Y * 2.0);
    let c = caster(scene((0..40).map(|_| (one.clone(), plain([1.0; 4]))).collect(), vec![]));
    for x in [-0.7, 0.1, 0.6] {
        let hit = c.trace(&Ray::new(DVec3::ZERO, DVec3::new(x, 0.2, -1.0)), &CellSet::all()).expect("a hit");
        assert!(hit.triangle < 2, "{hit:?}");
    }
}

#[test]
fn empty_and_degenerate_scenes_are_never_hit() {
    let ray = Ray::new(DVec3::ZERO, DVec3::NEG_Z);
    assert_eq!(caster(Scene::default()).trace(&ray, &CellSet::all()), None);
    let line = Primitive {
        positions: vec![Vec3::new(-1.0, 0.0, -1.0), Vec3::new(0.0, 0.0, -1.0), Vec3::new(1.0, 0.0, -1.0)],
        triangles: vec![[0, 1, 2], [0, 0, 0]],
        ..Primitive::default()
    };
    assert_eq!(caster(scene(vec![(line, plain([1.0; 4]))], vec![])).trace(&ray, &CellSet::all()), None);
}

/// A texture of four texels: opaque red, clear, opaque green, opaque blue.
fn four_texels() -> SceneTexture {
    let rgba = vec![[255, 0, 0, 255], [9, 9, 9, 0], [0, 255, 0, 255], [0, 0, 255, 255]];
    SceneTexture { name: String::new(), width: 2, height: 2, rgba, file: Vec::new() }
}

#[test]
fn masks_cut_out_and_textures_colour() {
    masks_cut_out(false);
    masks_cut_out(true);
}

/// The same with the masked quad expanded and with it placed a second time, elsewhere.
fn masks_cut_out(repeated: bool) {
    let masked = Material { texture: Some(0), alpha: Alpha::Mask(0.5), ..plain([1.0; 4]) };
    let front = quad(Vec3::new(-1.0, 1.0, -1.0), Vec3::X * 2.0, Vec3::NEG_Y * 2.0);
    let behind = quad(Vec3::new(-9.0, 9.0, -3.0), Vec3::X * 18.0, Vec3::NEG_Y * 18.0);
    let grey = plain([0.25, 0.5, 0.75, 1.0]);
    let mut s = scene(vec![(front, masked), (behind, grey)], vec![four_texels()]);
    if repeated {
        let world_from_mesh = DAffine3::from_translation(DVec3::new(0.0, 0.0, 40.0));
        s.instances.push(Instance { node: 2, mesh: 0, world_from_mesh });
    }
    let c = caster_with(s, 0);
    assert_eq!(c.bvh.items.len(), if repeated { 2 } else { 0 });
    // Texel centres: red at top left, the hole at top right, green at bottom left, blue at bottom
    // right.
    let at = [(-0.5, 0.5), (0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)];
    let want = [([1.0, 0.0, 0.0], 1.0), ([0.25, 0.5, 0.75], 3.0), ([0.0, 1.0, 0.0], 1.0), ([0.0, 0.0, 1.0], 1.0)];
    for ((x, y), (colour, t)) in at.into_iter().zip(want) {
        let ray = Ray::new(DVec3::ZERO, DVec3::new(x, y, -1.0));
        let hit = c.trace(&ray, &CellSet::all()).expect("a hit");
        assert!((hit.t - t).abs() < 1e-6, "{x} {y}: {hit:?}");
        let got = c.shade(&hit, &ray, None);
        assert!(got.iter().zip(colour).all(|(a, b): (&f32, f32)| (a - b).abs() < 1e-5), "{x} {y}: {got:?}");
    }
    // A packet across the border of the hole agrees with single rays.
    let rays: Vec<Ray> =
        (0..64).map(|i| Ray::new(DVec3::ZERO, DVec3::new(-0.03 + 0.0008 * f64::from(i), 0.5, -1.0))).collect();
    let mut hits = vec![None; 64];
    c.trace_batch(&rays, &CellSet::all(), &mut hits);
    assert!(hits.iter().zip(&rays).all(|(h, r)| *h == c.trace(r, &CellSet::all())));
    let depths: Vec<f64> = hits.iter().map(|h| h.expect("a hit").t.round()).collect();
    assert!(depths.contains(&1.0) && depths.contains(&3.0), "{depths:?}");
}

#[test]
fn light_vertex_colour_and_instance_normals() {
    let mut p = quad(Vec3::new(-1.0, 1.0, -1.0), Vec3::X * 2.0, Vec3::NEG_Y * 2.0);
    p.colours = vec![[1.0, 0.5, 0.25]; 4];
    let lit = Material { unlit: false, ..plain([0.5, 0.5, 0.5, 1.0]) };
    let mut s = scene(vec![(p, lit)], vec![]);
    // Normals turn by the inverse transpose: under this shear and scale z stays z.
    s.instances[0].world_from_mesh.matrix3.z_axis = DVec3::new(0.0, 0.0, 4.0);
    let c = caster(s);
    let ray = Ray::new(DVec3::ZERO, DVec3::new(0.1, 0.1, -1.0));
    let hit = c.trace(&ray, &CellSet::all()).expect("a hit");
    assert!((hit.t - 4.0).abs() < 1e-6);
    let surface = c.surface(&hit, &ray);
    assert!((surface.shading_normal.abs() - Vec3::Z).length() < 1e-6);
    let l = light(surface.shading_normal.to_array());
    let want = [0.5 * l, 0.25 * l, 0.125 * l];
    let got = c.shade(&hit, &ray, None);
    assert!(got.iter().zip(want).all(|(a, b): (&f32, f32)| (a - b).abs() < 1e-6), "{got:?} {want:?}");
}

#[test]
fn footprints_choose_the_level() {
    // 256 x 256 texels over 2 m in black and white stripes of 16: level 4 still shows them, level
    // 5 is grey.
    let texel = |i: u32| if i % 32 < 16 { [255; 4] } else { [0, 0, 0, 255] };
    let rgba = (0..256 * 256).map(|i| texel(i % 256)).collect();
    let texture = SceneTexture { name: String::new(), width: 256, height: 256, rgba, file: Vec::new() };
    let wall = quad(Vec3::new(-1.0, 1.0, -1.0), Vec3::X * 2.0, Vec3::NEG_Y * 2.0);
    let textured = Material { texture: Some(0), ..plain([1.0; 4]) };
    let c = caster(scene(vec![(wall, textured)], vec![texture])).with_mips();
    // In the middle of a white stripe.
    let ray = Ray::new(DVec3::ZERO, DVec3::new(0.0625, 0.2, -1.0));
    let hit = c.trace(&ray, &CellSet::all()).expect("a hit");
    assert!(c.surface(&hit, &ray).uv.distance(Vec2::new(0.53125, 0.4)) < 1e-6);
    let grey = |dx: f64| {
        // The longer side of the footprint decides.
        let footprint = RayFootprint { direction_dx: DVec3::X * dx, direction_dy: DVec3::Y * 1e-5 };
        c.shade(&hit, &ray, Some(&footprint))[0]
    };
    assert_eq!(c.shade(&hit, &ray, None)[0], 1.0);
    assert_eq!(grey(1e-5), 1.0);
    // A pixel of 1/8 m covers 16 texels, one of 1/4 m 32.
    assert!((grey(0.125) - 1.0).abs() < 1e-3, "{}", grey(0.125));
    assert!((grey(0.25) - 0.5).abs() < 5e-3, "{}", grey(0.25));
}
