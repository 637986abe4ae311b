//! The rasterizer against a brute-force f64 ray caster and against closed forms.

use super::*;
use crate::test_support::{Memory, dataset, loose_cluster, plain_material, quad_cluster};
use glam::{DAffine3, DVec3, Vec3};
use ldi_protocol::{
    Aabb,
    index::{TextureChunk, TextureEntry},
    mesh::{Alpha, CellGeometry, ClusterInstance, ClusterRef, Material},
    need,
    texture::{MipLevel, Texture},
};
use proptest::prelude::*;
use std::sync::Arc;

const CAMERA: OutputCamera = OutputCamera { width: 96, height: 72, fov_deg: 60.0 };
const AHEAD: Pose = Pose { position: DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 };

fn all_cells(index: &Index) -> Vec<DrawnCell> {
    DrawnCell::all_full(0..index.cells.len() as u32)
}

fn draw(index: &Index, memory: &Memory, camera: &OutputCamera, pose: &Pose) -> (Frame, Vec<u32>, NearStats) {
    let (mut rasterizer, mut frame) = (Rasterizer::default(), Frame::default());
    let stats = rasterizer.draw(index, memory, &all_cells(index), camera, pose, &mut frame);
    (frame, rasterizer.ids, stats)
}

/// The nearest triangle in front of the near plane that the ray through pixel coordinates (x, y)
/// meets: (number, disparity, disparity of the next one).
fn cast(triangles: &[[Vec3; 3]], camera: &OutputCamera, pose: &Pose, x: f64, y: f64) -> Option<(usize, f64, f64)> {
    let ray = camera.ray(&pose.basis(), x, y);
    let mut hits: Vec<(f64, usize)> = triangles
        .iter()
        .enumerate()
        .filter_map(|(i, t)| {
            let [p, q, r] = t.map(|v| v.as_dvec3() - pose.position);
            let (e1, e2) = (q - p, r - p);
            let n = ray.cross(e2);
            let det = e1.dot(n);
            let u = -p.dot(n) / det;
            let m = (-p).cross(e1);
            let v = ray.dot(m) / det;
            let depth = e2.dot(m) / det;
            (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && depth >= NEAR_PLANE_M).then_some((1.0 / depth, i))
        })
        .collect();
    hits.sort_by(|a, b| b.0.total_cmp(&a.0));
    hits.first().map(|h| (h.1, h.0, hits.get(1).map_or(0.0, |s| s.0)))
}

/// Corners are taken to a 256th of a pixel, so an edge is off by half of that at most, across and
/// down.
const OFF_PX: f64 = 1.0 / 512.0 + 1e-6;

/// Compares a frame with the ray caster wherever the caster gives one answer within [`OFF_PX`]
/// around the centre.
fn compare(triangles: &[[Vec3; 3]], drawn: &[[Vec3; 3]], pose: &Pose) -> Result<usize, TestCaseError> {
    let (index, memory) =
        dataset(CAMERA, vec![plain_material()], drawn.iter().map(|t| loose_cluster(0, &[*t])).collect());
    let (frame, ids, stats) = draw(&index, &memory, &CAMERA, pose);
    prop_assert_eq!(stats.triangles, drawn.len() as u64);
    let mut compared = 0;
    for row in 0..CAMERA.height {
        for column in 0..CAMERA.width {
            let (x, y) = (f64::from(column) + 0.5, f64::from(row) + 0.5);
            // The centre first.
            let around = [0.0, -OFF_PX, OFF_PX];
            let answers: Vec<_> =
                around.iter().flat_map(|dx| around.map(|dy| cast(triangles, &CAMERA, pose, x + dx, y + dy))).collect();
            let number = answers[0].map(|a| a.0);
            if answers.iter().any(|a| a.map(|a| a.0) != number) {
                continue;
            }
            let i = (row * CAMERA.width + column) as usize;
            let drawn = (ids[i] != triangle_setup::NO_TRIANGLE).then_some((ids[i] >> 8) as usize);
            let drawn_disparity = f64::from(frame.disparity[i]);
            if let Some((_, nearest, second)) = answers[0] {
                // Within f32 rounding of each other either may win.
                if nearest - second < 1e-4 * nearest {
                    continue;
                }
                let error = (drawn_disparity - nearest).abs() / nearest;
                prop_assert!(
                    error < 1e-3,
                    "disparity {} instead of {} at {},{}",
                    drawn_disparity,
                    nearest,
                    column,
                    row
                );
            }
            compared += 1;
            prop_assert_eq!(drawn, number, "at column {} row {}", column, row);
        }
    }
    Ok(compared)
}

fn point() -> impl Strategy<Value = Vec3> {
    (-6.0f32..6.0, -5.0f32..5.0, -9.0f32..1.0).prop_map(|(x, y, z)| Vec3::new(x, y, z))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Random triangles, many of them through the near plane or behind the eye.
    #[test]
    fn coverage_and_depth_match_the_ray_caster(
        triangles in proptest::collection::vec([point(), point(), point()], 1..12),
        yaw in -180.0f64..180.0,
        pitch in -60.0f64..60.0,
    ) {
        for pose in [AHEAD, Pose { position: DVec3::new(0.3, -0.2, -2.0), yaw_deg: yaw, pitch_deg: pitch }] {
            compare(&triangles, &triangles, &pose)?;
        }
    }
}

#[test]
fn the_comparison_can_fail() {
    let triangles = [[Vec3::new(-1.0, -1.0, -3.0), Vec3::new(1.0, -1.0, -3.0), Vec3::new(0.0, 1.0, -3.0)]];
    let compared = compare(&triangles, &triangles, &AHEAD).expect("alike");
    assert!(compared as u32 > CAMERA.width * CAMERA.height * 9 / 10, "{compared}");
    // A shift of 0.3 pixels is found somewhere along the edges.
    let moved = triangles.map(|t| t.map(|v| v + Vec3::X * (0.3 * 3.0 / CAMERA.focal_px() as f32)));
    assert!(compare(&triangles, &moved, &AHEAD).is_err());
}

/// A sheet at depth f / 64 whose vertices lie on multiples of 1/2 px, many exactly on pixel
/// centres, cut into triangles both ways.
#[test]
fn shared_edges_cover_each_pixel_once() {
    let focal = CAMERA.focal_px();
    let mut seed = 12345u32;
    let mut random = |n: u32| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 16) % n
    };
    let (columns, rows) = (14usize, 10usize);
    let mut vertices = Vec::new();
    for row in 0..=rows {
        for column in 0..=columns {
            let jitter = |r: &mut dyn FnMut(u32) -> u32| f64::from(r(11)) * 0.5 - 2.5;
            let x = column as f64 * 8.0 - 8.0 + jitter(&mut random);
            let y = row as f64 * 9.0 - 8.0 + jitter(&mut random);
            // Different depths, so that the projection has something to do.
            let z = 2.0 + f64::from(random(100)) * 0.05;
            vertices.push(
                DVec3::new(
                    (x - f64::from(CAMERA.width) * 0.5) * z / focal,
                    -(y - f64::from(CAMERA.height) * 0.5) * z / focal,
                    -z,
                )
                .as_vec3(),
            );
        }
    }
    let mut triangles = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let at = |r: usize, c: usize| vertices[(row + r) * (columns + 1) + column + c];
            if random(2) == 0 {
                triangles.extend([[at(0, 0), at(0, 1), at(1, 1)], [at(0, 0), at(1, 1), at(1, 0)]]);
            } else {
                triangles.extend([[at(0, 1), at(1, 1), at(1, 0)], [at(1, 0), at(0, 0), at(0, 1)]]);
            }
        }
    }
    let mut covered = vec![0; (CAMERA.width * CAMERA.height) as usize];
    for t in &triangles {
        let (index, memory) = dataset(CAMERA, vec![plain_material()], vec![loose_cluster(0, &[*t])]);
        let (frame, ..) = draw(&index, &memory, &CAMERA, &AHEAD);
        for (n, s) in covered.iter_mut().zip(&frame.source) {
            *n += u32::from(*s == Source::Near);
        }
    }
    // Folded cells would cover twice; jitter is below half a cell, so there are none.
    let interior = |i: usize| {
        let (c, r) = (i as u32 % CAMERA.width, i as u32 / CAMERA.width);
        (4..CAMERA.width - 4).contains(&c) && (4..CAMERA.height - 4).contains(&r)
    };
    for (i, n) in covered.iter().enumerate().filter(|(i, _)| interior(*i)) {
        assert_eq!(*n, 1, "pixel {} {}", i as u32 % CAMERA.width, i as u32 / CAMERA.width);
    }
}

/// A pixel centre exactly on a shared vertical, horizontal or diagonal edge belongs to one side.
#[test]
fn ties_go_to_one_triangle() {
    let focal = CAMERA.focal_px() as f32;
    let at = |x: f32, y: f32| Vec3::new((x - 48.0) * 4.0 / focal, -(y - 36.0) * 4.0 / focal, -4.0);
    let (c, r) = (40.5, 30.5);
    let fan = [at(c, r), at(c + 20.0, r), at(c + 20.0, r + 20.0), at(c, r + 20.0), at(c - 20.0, r), at(c, r - 20.0)];
    let order = [1usize, 2, 3, 4, 5, 1];
    let mut covered = 0;
    for pair in order.windows(2) {
        let (index, memory) =
            dataset(CAMERA, vec![plain_material()], vec![loose_cluster(0, &[[fan[0], fan[pair[0]], fan[pair[1]]]])]);
        let (frame, ..) = draw(&index, &memory, &CAMERA, &AHEAD);
        covered += u32::from(frame.source[30 * 96 + 40] == Source::Near);
    }
    assert_eq!(covered, 1);
}

fn gradient_texture(side: u32) -> Texture {
    let level = |n: u32| MipLevel {
        width: n,
        height: n,
        rgba: (0..n * n).map(|i| [(i % n * 255 / n) as u8, (i / n * 255 / n) as u8, 7, 255]).collect(),
    };
    Texture { levels: (0..=side.ilog2()).map(|k| Some(level(side >> k))).collect() }
}

/// Floor plane y = -1 with u = (x + 8) / 16, v = (z + 16) / 16: the shaded texel is the one that
/// the ray meets.
#[test]
fn texture_coordinates_are_perspective_correct() {
    let camera = OutputCamera { width: 160, height: 120, fov_deg: 75.0 };
    let material = Material { texture: Some(0), ..plain_material() };
    // The quad reaches behind the eye: attributes must not care that the near plane cuts it.
    let floor =
        quad_cluster(0, [[-8.0, -16.0], [8.0, -16.0], [8.0, 16.0], [-8.0, 16.0]].map(|[x, z]| Vec3::new(x, -1.0, z)));
    let (index, mut memory) = dataset(camera, vec![material], vec![floor]);
    memory.textures.insert(0, Arc::new(gradient_texture(1)));
    let pose = Pose { position: DVec3::new(0.25, 0.1, 0.5), yaw_deg: 20.0, pitch_deg: -25.0 };
    let view = triangle_setup::Projection::new(&camera, &pose);
    let scene = gather::gather(&index, &memory, &all_cells(&index));
    let (_, ids, _) = draw(&index, &memory, &camera, &pose);
    let mut seen = 0;
    for (i, id) in ids.iter().enumerate().filter(|(_, id)| **id != triangle_setup::NO_TRIANGLE) {
        let (x, y) = ((i % 160) as f64 + 0.5, (i / 160) as f64 + 0.5);
        let ray = camera.ray(&pose.basis(), x, y);
        let hit = pose.position + ray * ((-1.0 - pose.position.y) / ray.y);
        let uv = attributes::Attributes::new(&scene, &view, *id).expect("a triangle").uv_at(&view, x as f32, y as f32);
        let truth = ((hit.x + 8.0) / 16.0, (hit.z + 16.0) / 32.0);
        let error = (f64::from(uv.x) - truth.0).abs().max((f64::from(uv.y) - truth.1).abs());
        assert!(error < 2e-6 * hit.distance(pose.position).max(1.0), "{uv} instead of {truth:?} at {x} {y}");
        seen += 1;
    }
    assert!(seen > 8000, "{seen}");
}

/// Pictures are the same without the levels that a view does not need, and seldom without one more.
#[test]
fn levels_that_no_pixel_shows_make_no_difference() {
    const SIDE: u32 = 512;
    let material = Material { texture: Some(0), ..plain_material() };
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let (mut index, mut memory) =
        dataset(CAMERA, vec![material], vec![quad_cluster(0, corners.map(|[x, y]| Vec3::new(x, y, 0.0)))]);
    index.cells[0].texel_density = vec![(4.0 * f64::from(SIDE / 2).log2()) as i8];
    let code = |i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8;
    let rgba = (0..SIDE * SIDE).map(|i| [code(i), code(i + 7), code(i + 77), 255]).collect();
    let whole = Texture::from_base(MipLevel { width: SIDE, height: SIDE, rgba }, false);
    // A chunk of its own for each level, the coarsest first.
    let (first, levels) = (index.chunks.len() as u32, whole.levels.len() as u32);
    let chunks =
        (0..levels).rev().map(|l| TextureChunk { chunk: first + l, first_level: l as u8, last_level: l as u8 });
    index.textures.push(TextureEntry { width: SIDE, height: SIDE, chunks: chunks.collect() });
    index.chunks.extend((0..levels).map(|_| index.chunks[0]).collect::<Vec<_>>());
    let mut with = |texture: Texture, pose: &Pose| {
        memory.textures.insert(0, Arc::new(texture));
        draw(&index, &memory, &CAMERA, pose).0.colour
    };
    let (mut spared, mut differ, mut tried) = (0, 0, 0);
    for i in 0..400u32 {
        let random = |n: u32| f64::from((4 * i + n + 1).wrapping_mul(2_654_435_761)) / f64::from(u32::MAX);
        let away = 0.3 + 10.0 * random(0);
        let position = DVec3::new(away * (random(1) - 0.5), away * (random(2) - 0.5), away);
        let pose = Pose { position, yaw_deg: 50.0 * (random(3) - 0.5), pitch_deg: 30.0 * (random(1) - 0.5) };
        let needed = need::needed(&index, &[], &[DrawnCell::full(0)], &[], &need::Sight::new(&pose, &CAMERA, 1));
        let finest = (needed.now.iter().chain(&needed.fine)).filter(|c| **c >= first).map(|c| c - first).min();
        let finest = finest.expect("the coarsest level") as usize;
        let all = with(whole.clone(), &pose);
        let mut fewer = whole.clone();
        fewer.levels[..finest].fill(None);
        assert!(all == with(fewer.clone(), &pose), "without {finest} levels from {pose:?}");
        fewer.levels[finest] = None;
        spared += finest;
        differ += usize::from(all != with(fewer, &pose));
        tried += usize::from(all.iter().any(|c| *c != crate::frame::SKY));
    }
    assert!(tried > 200 && spared > 600 && differ > tried / 3, "{tried} {spared} {differ}");
}

#[test]
fn masked_texels_let_through_what_lies_behind() {
    // Left half of the texture is cut out.
    let texels = (0..64).map(|i| if i % 8 < 4 { [255, 0, 0, 0] } else { [255, 0, 0, 255] }).collect();
    let texture = Texture { levels: vec![Some(MipLevel { width: 8, height: 8, rgba: texels })] };
    let masked = Material {
        texture: Some(0),
        alpha: Alpha::Mask(0.5),
        wrap: [ldi_protocol::mesh::Wrap::Clamp; 2],
        ..plain_material()
    };
    let quad = |z: f32, m: u32| {
        quad_cluster(
            m,
            [Vec3::new(-1.0, -1.0, z), Vec3::new(1.0, -1.0, z), Vec3::new(1.0, 1.0, z), Vec3::new(-1.0, 1.0, z)],
        )
    };
    let (index, mut memory) = dataset(CAMERA, vec![masked, plain_material()], vec![quad(-3.0, 0), quad(-4.0, 1)]);
    memory.textures.insert(0, Arc::new(texture));
    let (frame, _, stats) = draw(&index, &memory, &CAMERA, &AHEAD);
    let at = |column: usize| crate::frame::unpack_rgb(frame.colour[36 * 96 + column]);
    assert_eq!((at(38), at(58)), ([255; 3], [255, 0, 0]));
    assert_eq!(stats.coarse_textures, Vec::<u32>::new());
    // Without the texture nothing is known of the alpha: the triangle is drawn whole, and the lack
    // is reported.
    memory.textures.clear();
    let (_, _, stats) = draw(&index, &memory, &CAMERA, &AHEAD);
    assert_eq!(stats.missing_textures, vec![0]);
}

/// Lit and textured surfaces of all wraps, near and far, smooth and facetted: eight pixels at a
/// time, with AVX2 or without, show what one at a time shows.
#[test]
fn eight_pixels_at_a_time_are_shaded_as_one() {
    use ldi_protocol::mesh::Wrap;
    let camera = OutputCamera { width: 203, height: 151, fov_deg: 75.0 };
    let noise = |n: u32| MipLevel {
        width: n,
        height: n,
        rgba: (0..n * n).map(|i| i.wrapping_mul(2_654_435_761).to_le_bytes()).collect(),
    };
    let texture = Texture::from_base(noise(128), false);
    let (mut materials, mut clusters) = (Vec::new(), Vec::new());
    for (k, wrap) in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp].into_iter().enumerate() {
        for unlit in [false, true] {
            let m = materials.len() as u32;
            materials.push(Material {
                texture: (k > 0 || unlit).then_some(0),
                unlit,
                wrap: [wrap, Wrap::Repeat],
                ..plain_material()
            });
            let x = m as f32 * 1.2 - 3.6;
            let mut quad = quad_cluster(
                m,
                [[0.0, -2.0, -2.5], [1.2, -2.0, -2.0], [1.2, 1.5, -9.0], [0.0, 2.5, -30.0]]
                    .map(|[a, b, z]| Vec3::new(x + a, b, z)),
            );
            quad.uvs.iter_mut().for_each(|t| *t = *t * 3.0 - 1.1);
            quad.normals =
                [[0.3, 0.9, 0.1], [-0.5, 0.4, 0.7], [0.0, -1.0, 0.2], [0.9, 0.1, 0.1]].map(Vec3::from).to_vec();
            quad.colours = vec![[1.0, 0.4, 0.2], [0.1, 0.9, 0.3], [0.8; 3], [0.2, 0.2, 1.0]];
            clusters.push(quad);
        }
    }
    let (index, mut memory) = dataset(camera, materials, clusters);
    // A finest level that is not here is replaced by the next.
    for finest in [0, 2] {
        let mut texture = texture.clone();
        texture.levels[..finest].fill(None);
        memory.textures.insert(0, Arc::new(texture));
        let pose = Pose { position: DVec3::new(0.2, 0.3, 0.4), yaw_deg: 4.0, pitch_deg: -6.0 };
        let (_, ids, _) = draw(&index, &memory, &camera, &pose);
        let scene = gather::gather(&index, &memory, &all_cells(&index));
        let view = triangle_setup::Projection::new(&camera, &pose);
        let mut alone = vec![0; ids.len()];
        for (i, id) in ids.iter().enumerate().filter(|(_, id)| **id != triangle_setup::NO_TRIANGLE) {
            let attributes = attributes::Attributes::new(&scene, &view, *id).expect("a triangle");
            alone[i] = attributes.shade(&view, (i % 203) as f32 + 0.5, (i / 203) as f32 + 0.5);
        }
        let mut portable = vec![0; ids.len()];
        shade::shade_band_with::<crate::simd::Portable>(&scene, &view, 0, &ids, &mut portable);
        let mut dispatched = vec![0; ids.len()];
        shade::shade_band(&scene, &view, 0, &ids, &mut dispatched);
        assert_eq!(portable, dispatched, "the picture does not depend on the machine");
        let covered = ids.iter().filter(|id| **id != triangle_setup::NO_TRIANGLE).count();
        assert!(covered > ids.len() / 3, "{covered}");
        let off = |a: u32, b: u32| (0..3).map(|k| a.to_le_bytes()[k].abs_diff(b.to_le_bytes()[k])).max().unwrap_or(0);
        let worst = portable.iter().zip(&alone).map(|(a, b)| off(*a, *b)).max();
        assert!(worst <= Some(1), "{worst:?} codes");
        let others = portable.iter().zip(&alone).filter(|(a, b)| a != b).count();
        assert!(others * 100 < covered, "{others} of {covered}");
    }
}

#[test]
fn absent_chunks_are_named_and_the_rest_is_drawn() {
    let quad = |z: f32| {
        quad_cluster(
            0,
            [Vec3::new(-1.0, -1.0, z), Vec3::new(1.0, -1.0, z), Vec3::new(1.0, 1.0, z), Vec3::new(-1.0, 1.0, z)],
        )
    };
    let (index, mut memory) = dataset(CAMERA, vec![plain_material()], vec![quad(-3.0), quad(-4.0), quad(-5.0)]);
    let shared =
        ClusterInstance { cluster: ClusterRef::Shared { chunk: 9, cluster: 0 }, world_from_mesh: DAffine3::IDENTITY };
    memory.cells.insert(1, Arc::new(CellGeometry { clusters: Vec::new(), instances: vec![shared.clone(), shared] }));
    memory.cells.remove(&2);
    let (frame, _, stats) = draw(&index, &memory, &CAMERA, &AHEAD);
    assert_eq!((stats.missing_chunks, stats.triangles, stats.clusters), (vec![2, 9], 2, 1));
    assert!(frame.count(Source::Near) > 500);
    memory.bundles.insert(9, Arc::new(CellGeometry { clusters: vec![quad(-2.0)], instances: Vec::new() }));
    let (_, _, stats) = draw(&index, &memory, &CAMERA, &AHEAD);
    assert_eq!((stats.missing_chunks, stats.triangles, stats.clusters), (vec![2], 6, 3));
}

#[test]
fn one_thread_and_three_give_the_same_picture() {
    let mut clusters = Vec::new();
    for i in 0..300u32 {
        let p = |k: u32| {
            let h = (i * 3 + k).wrapping_mul(2_654_435_761);
            Vec3::new(
                (h >> 8 & 255) as f32 / 32.0 - 4.0,
                (h >> 16 & 255) as f32 / 42.0 - 3.0,
                -1.0 - (h >> 24) as f32 / 40.0,
            )
        };
        clusters.push(loose_cluster(0, &[[p(0), p(1), p(2)], [p(0), p(2), p(1)]]));
    }
    let (index, memory) = dataset(CAMERA, vec![plain_material()], clusters);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| draw(&index, &memory, &CAMERA, &AHEAD))
    };
    let (one, three) = (with(1), with(3));
    assert_eq!(one.0, three.0);
    assert_eq!(one.1, three.1);
}

/// A wall of many triangles before a crowd: with the crowd in later batches most of it is rejected
/// unseen, and the picture is the one that a depth buffer alone gives.
#[test]
fn what_is_hidden_makes_no_difference() {
    let mut clusters = Vec::new();
    // Two thirds of the picture, in more triangles than the first batch holds.
    for i in 0..(FIRST_BATCH_TRIANGLES / 200 + 2) as u32 {
        let x = -2.0 + i as f32 * 0.04;
        let tile = |k: u32| {
            let y = -2.0 + k as f32 * 0.02;
            let z = -2.0 - (k % 3) as f32 * 0.01;
            [Vec3::new(x, y, z), Vec3::new(x + 0.05, y, z), Vec3::new(x, y + 0.05, z)]
        };
        clusters.push(loose_cluster(0, &(0..200).map(tile).collect::<Vec<_>>()));
    }
    for i in 0..500u32 {
        let p = |k: u32| {
            let h = (i * 3 + k).wrapping_mul(2_654_435_761);
            Vec3::new(
                (h >> 8 & 255) as f32 / 32.0 - 4.0,
                (h >> 16 & 255) as f32 / 42.0 - 3.0,
                -1.9 - (h >> 24) as f32 / 40.0,
            )
        };
        clusters.push(loose_cluster(0, &[[p(0), p(1), p(2)]]));
    }
    let (index, memory) = dataset(CAMERA, vec![plain_material()], clusters);
    let (frame, ids, _) = draw(&index, &memory, &CAMERA, &AHEAD);
    // The reference: every cell alone, joined by depth in the same order.
    let mut best = vec![(0.0f32, triangle_setup::NO_TRIANGLE); frame.len()];
    let (mut rasterizer, mut one) = (Rasterizer::default(), Frame::default());
    for cell in all_cells(&index) {
        rasterizer.draw(&index, &memory, &[cell], &CAMERA, &AHEAD, &mut one);
        for (best, (d, id)) in best.iter_mut().zip(one.disparity.iter().zip(&rasterizer.ids)) {
            if *id != triangle_setup::NO_TRIANGLE && *d > best.0 {
                *best = (*d, cell.cell << 8 | id & 255);
            }
        }
    }
    assert!(ids.iter().zip(&best).all(|(id, best)| *id == best.1));
    // Both show: the wall, and those of the crowd that stand beside it.
    let crowd = best
        .iter()
        .filter(|b| b.1 >> 8 >= (FIRST_BATCH_TRIANGLES / 200 + 2) as u32 && b.1 != triangle_setup::NO_TRIANGLE)
        .count();
    assert!(crowd > 200 && crowd < 6000, "{crowd}");
}

/// Against the corners of each cluster's box, turned and stretched.
#[test]
fn what_touches_a_box_is_gathered_and_nothing_else() {
    let mut state = 11u64;
    let mut unit = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u32 << 24) as f32
    };
    let mut point = |by: f32| Vec3::new(unit() - 0.5, unit() - 0.5, unit() - 0.5) * by;
    let clusters: Vec<_> = (0..300)
        .map(|_| {
            let at = point(20.0);
            loose_cluster(0, &[[at + point(4.0), at + point(4.0), at + point(4.0)]])
        })
        .collect();
    let (index, mut memory) = dataset(CAMERA, vec![plain_material()], clusters);
    let mut corners = Vec::new();
    for number in 0..300 {
        let mut cell = (*memory.cells[&number]).clone();
        let (axis, shift) = (point(1.0).as_dvec3(), point(8.0).as_dvec3());
        let turned = DAffine3::from_axis_angle(axis.normalize(), 6.0 * axis.x);
        let placed = DAffine3::from_translation(shift) * turned * DAffine3::from_scale(axis + 0.7);
        cell.instances[0].world_from_mesh = placed;
        let own = Aabb::from_points(cell.clusters[0].positions.iter().map(|p| p.as_dvec3()));
        corners.push(own.corners().map(|c| placed.transform_point3(c)));
        memory.cells.insert(number, Arc::new(cell));
    }
    for _ in 0..20 {
        let within = Aabb::from_points([point(20.0).as_dvec3(), point(20.0).as_dvec3()]);
        let gathered = gather::gather_within(&index, &memory, &all_cells(&index), &within);
        let expected = corners.iter().filter(|c| Aabb::from_points(**c).intersects(&within)).count();
        assert_eq!(gathered.draws.len(), expected, "{within:?}");
        assert!(expected < 300 && gathered.stats.clusters == expected as u64);
    }
}
