use super::*;
use crate::{OutputCamera, Pose, codec};

/// A tree of a full octree's levels, one octant in two missing; chunks are numbered from 0 on.
fn tree(levels: u8) -> Tree {
    let mut nodes =
        vec![TreeNode { level: 0, cell: [0; 3], samples: 100, unfiltered: 10, first_child: 0, children: 0, chunk: 0 }];
    let mut chunks = 1;
    let mut at = 0;
    while at < nodes.len() {
        let parent = nodes[at];
        if parent.level + 1 < levels {
            nodes[at].first_child = nodes.len() as u32;
            nodes[at].chunk = chunks;
            chunks += 1;
            for octant in (0..8u16).filter(|o| (u32::from(*o) + at as u32).is_multiple_of(2)) {
                let cell = std::array::from_fn(|k| 2 * parent.cell[k] + (octant >> k & 1));
                nodes.push(TreeNode { level: parent.level + 1, cell, first_child: 0, children: 0, chunk: 0, ..parent });
                nodes[at].children += 1;
            }
        }
        at += 1;
    }
    Tree { origin: DVec3::new(-4.0, -4.0, -4.0), edge_m: 8.0, root_chunk: 0, pinned_levels: 2, nodes }
}

const CAMERA: OutputCamera = OutputCamera { width: 640, height: 400, fov_deg: 60.0 };

#[test]
fn a_tree_knows_its_cubes_and_its_chunks() {
    let t = tree(4);
    t.check().unwrap();
    assert_eq!(t.pinned_chunks().collect::<Vec<_>>(), [0, 1]);
    assert_eq!(t.broods().count(), 1 + 1 + 4 + 16);
    for n in &t.nodes {
        let b = t.bounds_of(n);
        assert!((b.size() - t.edge_of(n.level)).abs().max_element() < 1e-12);
        let inside = (n.first_child..n.first_child + u32::from(n.children)).all(|c| {
            let c = t.bounds_of(&t.nodes[c as usize]);
            b.contains(c.min) && b.contains(c.max)
        });
        assert!(inside);
    }
}

#[test]
fn a_damaged_tree_is_refused() {
    let damages: [fn(&mut Tree); 9] = [
        |t| t.pinned_levels = MAX_LEVEL + 2,
        |t| t.nodes.clear(),
        |t| t.edge_m = f64::NAN,
        |t| t.nodes[0].level = 1,
        |t| t.nodes[0].children = 3,
        |t| t.nodes[1].cell = [7; 3],
        |t| t.nodes.swap(1, 2),
        |t| t.nodes[3].unfiltered = 101,
        |t| {
            t.nodes.pop();
        },
    ];
    for (k, damage) in damages.into_iter().enumerate() {
        let mut t = tree(3);
        damage(&mut t);
        assert!(t.check().is_err(), "damage {k}");
    }
}

fn pose(x: f64, y: f64, z: f64) -> Pose {
    Pose { position: DVec3::new(x, y, z), yaw_deg: 0.0, pitch_deg: 0.0 }
}

#[test]
fn a_cut_has_fine_nodes_near_the_eye_and_coarse_ones_far_away() {
    let t = tree(6);
    let far = cut(&t, &pose(0.0, 0.0, 2_000.0), &Lens::from(&CAMERA), &CutOptions::default(), |_| true);
    assert_eq!(far.nodes.len(), 1);
    assert!(far.nodes[0].filtered && far.nodes[0].node == 0 && far.missing.is_empty());
    let near = cut(
        &t,
        &pose(0.0, 0.0, 4.5),
        &Lens::from(&CAMERA),
        &CutOptions { stamp_px: 8.0, ..CutOptions::default() },
        |_| true,
    );
    for c in &near.nodes {
        let n = &t.nodes[c.node as usize];
        assert!(!c.filtered || c.stamp_px <= 8.0 || n.children == 0, "a node too coarse is a leaf or gave way");
        assert!(c.filtered || n.unfiltered > 0);
    }
    let levels: Vec<u8> = near.nodes.iter().filter(|c| c.filtered).map(|c| t.nodes[c.node as usize].level).collect();
    assert!(levels.first() > levels.last(), "near to far: {levels:?}");
    // The eye within: always down to the leaves beside it.
    let within = cut(
        &t,
        &pose(0.1, 0.1, 0.1),
        &Lens::from(&CAMERA),
        &CutOptions { stamp_px: 1e6, ..CutOptions::default() },
        |_| true,
    );
    assert!(
        within
            .nodes
            .iter()
            .filter(|c| c.filtered && c.stamp_px.is_infinite())
            .all(|c| t.nodes[c.node as usize].children == 0)
    );
}

#[test]
fn a_bound_on_samples_leaves_none_that_are_large() {
    let t = tree(6);
    let largest = |coarsest_px| {
        let options = CutOptions { max_samples: 1, coarsest_px, ..CutOptions::default() };
        let found = cut(&t, &pose(0.0, 0.0, 4.5), &Lens::from(&CAMERA), &options, |_| true);
        assert!(found.limited);
        let inner = found.nodes.iter().filter(|c| c.filtered && t.nodes[c.node as usize].children > 0);
        inner.map(|c| c.stamp_px).fold(0.0, f64::max)
    };
    assert!(largest(f64::INFINITY) > 16.0);
    let bounded = largest(8.0);
    assert!(bounded <= 8.0 && bounded > 1.0, "{bounded}");
}

/// Each place in view is drawn by exactly one node with filtered samples, whatever is at hand and
/// however few samples are allowed.
#[test]
fn a_cut_covers_every_place_in_view_once() {
    let t = tree(6);
    let eye = pose(0.3, 0.2, 3.0);
    for (keep, most) in [(1, u64::MAX), (3, u64::MAX), (5, u64::MAX), (1, 700), (2, 1500)] {
        let held = |c: u32| c == 0 || c.is_multiple_of(keep);
        let found = cut(
            &t,
            &eye,
            &Lens::from(&CAMERA),
            &CutOptions { max_samples: most, coarsest_px: f64::INFINITY, ..CutOptions::default() },
            held,
        );
        assert!(found.samples <= most.max(100));
        for k in 0..2000u64 {
            let coordinate = |s: u64| ((k * s) % 1000) as f64 / 125.0 - 4.0;
            let p = DVec3::new(coordinate(7), coordinate(313), coordinate(631));
            let basis = eye.basis();
            let frustum = crate::camera::Frustum::new(eye.position, &basis, CAMERA.half_tan_x(), CAMERA.half_tan_y());
            // The deepest node there.
            let (mut at, mut path) = (0usize, vec![0u32]);
            loop {
                let n = t.nodes[at];
                let child = (n.first_child..n.first_child + u32::from(n.children))
                    .find(|c| t.bounds_of(&t.nodes[*c as usize]).contains(p));
                match child {
                    Some(c) => {
                        at = c as usize;
                        path.push(c);
                    }
                    None => break,
                }
            }
            if t.nodes[at].children > 0 || !frustum.contains(p) {
                continue;
            }
            let drawn = found.nodes.iter().filter(|c| c.filtered && path.contains(&c.node)).count();
            assert_eq!(drawn, 1, "at {p}");
        }
    }
    let nothing = cut(&t, &eye, &Lens::from(&CAMERA), &CutOptions::default(), |_| false);
    assert!(nothing.nodes.is_empty() && nothing.missing == [0]);
}

/// A brood of two walls and noise.
fn brood() -> Brood {
    let mut state = 7u32;
    let mut random = move |n: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) % n
    };
    let mut nodes = vec![NodeSamples::default()];
    for kind in 0..2 {
        let mut samples = Vec::new();
        for face in [0u8, 3, 5] {
            for row in 0..64u8 {
                for column in 0..64u8 {
                    let layers = if kind == 0 { 1 } else { random(4) };
                    let mut depths: Vec<u16> = (0..layers)
                        .map(|_| if kind == 0 { 100 + 20 * u16::from(column) } else { random(4096) as u16 })
                        .collect();
                    depths.sort_unstable();
                    for depth in depths {
                        samples.push(TreeSample {
                            face,
                            column,
                            row,
                            covers: if kind == 0 { WHOLE } else { 1 + random(0xffff) as u16 },
                            depth,
                            slope: if kind == 0 { [20, 0] } else { [random(256) as u8 as i8, random(256) as u8 as i8] },
                            rgb: if kind == 0 { [200, 190, 180] } else { [random(256) as u8; 3] },
                            filtered: kind == 1 && random(2) == 1,
                        });
                    }
                }
            }
        }
        nodes.push(NodeSamples { samples });
    }
    Brood { nodes }
}

fn listed(b: &Brood) -> Vec<(u32, u32)> {
    let unfiltered = |n: &NodeSamples| n.samples.iter().filter(|s| !s.filtered).count() as u32;
    b.nodes.iter().map(|n| (n.samples.len() as u32, unfiltered(n))).collect()
}

#[test]
fn chunks_come_back_exactly_and_plain_walls_cost_next_to_nothing() {
    let b = brood();
    let bytes = codec::tree::encode(&b, 6).unwrap();
    assert!(codec::tree::decode(&bytes, &listed(&b)).unwrap() == b);
    let wall = Brood { nodes: vec![b.nodes[1].clone()] };
    let bytes = codec::tree::encode(&wall, 6).unwrap();
    assert!(bytes.len() < 600, "{} bytes for {} samples", bytes.len(), wall.nodes[0].samples.len());
}

#[test]
fn forged_chunks_are_refused() {
    let b = brood();
    let bytes = codec::tree::encode(&b, 6).unwrap();
    let sizes = listed(&b);
    for end in (0..bytes.len()).step_by(bytes.len() / 97) {
        assert!(codec::tree::decode(&bytes[..end], &sizes).is_err());
    }
    let mut more = sizes.clone();
    more[1].0 += 1;
    assert!(codec::tree::decode(&bytes, &more).is_err());
    more = sizes.clone();
    more[2].1 -= 1;
    assert!(codec::tree::decode(&bytes, &more).is_err());
    // Flipped bits are an error or other samples, never a panic.
    for at in (0..bytes.len()).step_by(bytes.len() / 1009) {
        let mut forged = bytes.clone();
        forged[at] ^= 0x55;
        let _ = codec::tree::decode(&forged, &sizes);
    }
    let mut bad = b.clone();
    bad.nodes[1].samples.swap(0, 1);
    assert!(codec::tree::encode(&bad, 1).is_err());
}

#[test]
fn what_a_view_lacks_of_a_tree_is_what_a_cut_descends_to_and_nobody_holds() {
    let t = tree(6);
    let lens = Lens::from(&CAMERA);
    let chunks = t.broods().count() as u32;
    let mut looked = 0;
    for seed in 0..200u32 {
        let random =
            |k: u32| (seed.wrapping_mul(2_654_435_761) ^ k.wrapping_mul(40_503)).wrapping_mul(2_246_822_519) >> 16;
        let along = |k: u32| f64::from(random(k) % 1_000) / 100.0 - 5.0;
        let pose = Pose {
            position: DVec3::new(along(1), along(2), along(3)),
            yaw_deg: 36.0 * along(4),
            pitch_deg: 5.0 * along(5),
        };
        let absent = |chunk: u32| random(chunk + 10) % (1 + seed % 5) == 0;
        let mut found = lacking(&t, &pose, &lens, &lacking_below(&t, absent), absent);
        found.sort_unstable();
        // What is held of a chunk shows in `missing` if nothing but this one is not.
        let wanted = (0..chunks)
            .filter(|c| absent(*c) && cut(&t, &pose, &lens, &CutOptions::default(), |x| x != *c).missing == [*c]);
        assert_eq!(found, wanted.collect::<Vec<_>>(), "seed {seed}");
        looked += found.len();
    }
    assert!(looked > 1_000, "{looked}");
}
