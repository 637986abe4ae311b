//! Cell chunks: bounds of the quantizers, exactness where promised, damage.

use super::super::normal::MOST_OFF;
use super::*;
use crate::mesh::{ClusterInstance, ClusterRef};
use glam::DAffine3;
use proptest::prelude::*;

const STEPS: ClusterSteps = ClusterSteps { position_log2: -14, uv_log2: -12 };

/// A bent grid of `n` x `n` quads with everything a cluster can have.
fn cluster(n: u16, origin: DVec3, full: bool) -> Cluster {
    let side = n + 1;
    let at = |i: u16| (f32::from(i % side) * 0.25, f32::from(i / side) * 0.25);
    let vertices = 0..side * side;
    let quads = (0..n * n).map(|q| q / n * side + q % n);
    Cluster {
        material: 3,
        positions: vertices.clone().map(at).map(|(x, y)| Vec3::new(x, (x * 1.7).sin() + y * 0.3, y)).collect(),
        origin,
        normals: vertices.clone().map(at).map(|(x, y)| Vec3::new(x - 1.0, 0.4 - y, 0.3).normalize()).collect(),
        uvs: if full {
            vertices.clone().map(at).map(|(x, y)| Vec2::new(x * 3.0 - 1.0, y * 0.7)).collect()
        } else {
            vec![]
        },
        colours: if full { vertices.map(at).map(|(x, y)| [x.fract(), y.fract(), 0.5]).collect() } else { vec![] },
        triangles: quads.flat_map(|v| [[v, v + side, v + 1], [v + 1, v + side, v + side + 1]]).collect(),
    }
}

fn cell() -> (CellGeometry, Vec<ClusterSteps>) {
    let clusters = vec![
        cluster(11, DVec3::new(10.0, -3.0, 2.0), true),
        cluster(4, DVec3::ZERO, false),
        cluster(1, DVec3::splat(1e3), true),
    ];
    let t = DAffine3::from_rotation_y(0.4) * DAffine3::from_translation(DVec3::new(4.0, 5.0, 1e4 / 3.0));
    let shared = |cluster| ClusterRef::Shared { chunk: 77, cluster };
    let refs = [(ClusterRef::Own(0), t), (ClusterRef::Own(2), t), (shared(4), DAffine3::IDENTITY), (shared(0), t)];
    let instances =
        refs.into_iter().map(|(cluster, world_from_mesh)| ClusterInstance { cluster, world_from_mesh }).collect();
    (CellGeometry { clusters, instances }, vec![STEPS; 3])
}

#[test]
fn corners_come_back_within_their_steps() {
    let (g, steps) = cell();
    let out = decode(&encode(&g, &steps, 3).unwrap()).unwrap();
    assert_eq!(out.instances, g.instances);
    assert_eq!(out.clusters.len(), g.clusters.len());
    for (a, b) in g.clusters.iter().zip(&out.clusters) {
        assert_eq!(
            (a.material, a.triangles.len(), a.positions.len()),
            (b.material, b.triangles.len(), b.positions.len())
        );
        assert_eq!((a.uvs.is_empty(), a.colours.is_empty()), (b.uvs.is_empty(), b.colours.is_empty()));
        // Vertices are renumbered, so corners are compared, in the order of triangles.
        for (&i, &j) in a.triangles.as_flattened().iter().zip(b.triangles.as_flattened()) {
            let (i, j) = (usize::from(i), usize::from(j));
            let (p, q) = (a.origin + a.positions[i].as_dvec3(), b.origin + b.positions[j].as_dvec3());
            assert!((p - q).abs().max_element() <= 0.5 * 2f64.powi(-14) + 1e-12, "{p} became {q}");
            let degrees = f64::from(a.normals[i].dot(b.normals[j]).clamp(-1.0, 1.0)).acos().to_degrees();
            assert!(degrees < 0.06, "a normal turned by {degrees} degrees");
            assert!((b.normals[j].length() - 1.0).abs() < 1e-6);
            if !a.uvs.is_empty() {
                assert!((a.uvs[i] - b.uvs[j]).abs().max_element() <= 0.5 * 2f32.powi(-12) + 1e-7);
            }
            if !a.colours.is_empty() {
                assert!((0..3).all(|k| (a.colours[i][k] - b.colours[j][k]).abs() < 1e-5));
            }
        }
    }
}

#[test]
fn decoded_geometry_encodes_to_the_same_bytes() {
    let (g, steps) = cell();
    let bytes = encode(&g, &steps, 3).unwrap();
    let out = decode(&bytes).unwrap();
    assert_eq!(encode(&out, &steps, 3).unwrap(), bytes);
    assert_eq!(decode(&encode(&CellGeometry::default(), &[], 3).unwrap()).unwrap(), CellGeometry::default());
}

#[test]
fn clusters_of_a_mesh_meet_exactly_whatever_their_origins() {
    // The same mesh-space point, stored from two origins.
    let point = DVec3::new(12.345_678, -0.333_333, 7.777_777);
    let at = |origin: DVec3| {
        let mut c = cluster(1, origin, false);
        c.positions[0] = (point - origin).as_vec3();
        let g = CellGeometry { clusters: vec![c], instances: vec![] };
        let c = decode(&encode(&g, &[STEPS], 3).unwrap()).unwrap().clusters.remove(0);
        let v = usize::from(c.triangles[0][0]);
        c.origin + c.positions[v].as_dvec3()
    };
    assert_eq!(at(DVec3::new(12.0, 0.0, 7.0)), at(DVec3::new(11.0, -2.5, 8.25)));
}

#[test]
fn axis_normals_are_exact_and_nonsense_becomes_up() {
    for n in [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z] {
        assert_eq!(normal_of(octahedral(n)), n);
    }
    for n in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY] {
        assert_eq!(normal_of(octahedral(n)), Vec3::Y);
    }
}

#[test]
fn steps_follow_extent_and_scale() {
    assert_eq!(position_step_log2(10.0, 1.0), -14, "a building part: 61 micrometres");
    assert_eq!(position_step_log2(10.0, 1000.0), -17, "a part drawn large is limited by its extent");
    assert!(position_step_log2(1e-3, 1.0) <= -23, "a tiny mesh keeps 14 bits");
    assert!(position_step_log2(1e5, 1.0) >= -4, "a landscape keeps to 20 bits");
    assert_eq!(uv_step_log2(1024), -14);
    assert_eq!(uv_step_log2(1000), -14);
}

#[test]
fn what_does_not_fit_is_refused() {
    let (mut g, steps) = cell();
    g.clusters[0].positions[0].x = f32::NAN;
    assert!(matches!(encode(&g, &steps, 3), Err(CodecError::Range { field: "positions", .. })));
    g.clusters[0].positions[0].x = 1e6;
    assert!(matches!(encode(&g, &steps, 3), Err(CodecError::Range { field: "positions", .. })));
    let (mut g, steps) = cell();
    g.clusters[1].triangles[0][0] = 9999;
    assert!(matches!(encode(&g, &steps, 3), Err(CodecError::Range { field: "indices", .. })));
    assert!(encode(&g, &steps[1..], 3).is_err());
}

#[test]
fn truncation_and_damage_never_panic() {
    let (g, steps) = cell();
    let bytes = encode(&g, &steps, 3).unwrap();
    for n in 0..bytes.len() {
        assert!(decode(&bytes[..n]).is_err(), "cut at {n}");
    }
    let mut refused = 0;
    for i in 0..2000usize {
        let mut damaged = bytes.clone();
        damaged[i * 7919 % bytes.len()] ^= 1 + (i * 31 % 255) as u8;
        match decode(&damaged) {
            Err(_) => refused += 1,
            Ok(g) => {
                for c in &g.clusters {
                    assert!(c.triangles.as_flattened().iter().all(|&v| usize::from(v) < c.positions.len()));
                    assert!(c.positions.iter().all(|p| p.is_finite()) && c.origin.is_finite());
                }
            }
        }
    }
    assert!(refused > 500, "{refused}");
}

/// Where octahedral coordinates are coarsest, around the middle of each face, at a tenth of a
/// step: the bound holds, and is nearly reached.
#[test]
fn normals_in_the_middles_of_faces_are_off_by_no_more_than_the_bound() {
    let mut most = 0f32;
    for face in 0..8 {
        let sign = |axis: i32| if face >> axis & 1 == 0 { 1.0 } else { -1.0 };
        for (i, k) in (-100..100).flat_map(|i| (-100..100).map(move |k| (i as f32, k as f32))) {
            let [x, y] = [i, k].map(|v| 1.0 / 3.0 + v * 0.1 / 2047.0);
            let n = (Vec3::new(x, y, 1.0 - x - y) * Vec3::new(sign(0), sign(1), sign(2))).normalize();
            most = most.max((n - normal_of(octahedral(n))).length());
        }
    }
    assert!((0.98 * MOST_OFF..MOST_OFF + 1e-6).contains(&most), "{most} of {MOST_OFF}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn any_normal_stays_close(x in -1f32..1.0, y in -1f32..1.0, z in -1f32..1.0) {
        let n = Vec3::new(x, y, z);
        prop_assume!(n.length() > 1e-3);
        let n = n.normalize();
        let m = normal_of(octahedral(n));
        prop_assert!((n - m).length() < MOST_OFF + 1e-6, "{} became {}", n, m);
    }
    #[test]
    fn any_bytes_are_survived(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let mut with_magic = b"CEL\x01".to_vec();
        with_magic.extend(bytes);
        let _ = decode(&with_magic);
    }
}
