//! The tree's picture against analytic scenes and against the reference of lists per pixel.

use super::*;
use crate::{frame::unpack_rgb, test_support::Memory};
use glam::DVec3;
use ldi_protocol::tree::{Brood, DEPTH_STEPS, NodeSamples, SIDE, TreeNode, TreeSample, WHOLE};
use std::sync::Arc;

const CAMERA: OutputCamera = OutputCamera { width: 160, height: 120, fov_deg: 60.0 };

/// A root cube of `edge` around the origin, and samples put there by hand.
struct Made {
    tree: Tree,
    memory: Memory,
}

impl Made {
    fn new(edge: f64, samples: Vec<TreeSample>) -> Self {
        let unfiltered = samples.iter().filter(|s| !s.filtered).count() as u32;
        let n = samples.len() as u32;
        let root = TreeNode { level: 0, cell: [0; 3], samples: n, unfiltered, first_child: 0, children: 0, chunk: 0 };
        let origin = DVec3::splat(-edge / 2.0);
        let tree = Tree { origin, edge_m: edge, root_chunk: 0, pinned_levels: 1, nodes: vec![root] };
        let mut memory = Memory::default();
        memory.broods.insert(0, Arc::new(Brood { nodes: vec![NodeSamples { samples }] }));
        Self { tree, memory }
    }

    fn draw(&self, pose: &Pose, options: &TreeOptions) -> (FarFrame, TreeStats) {
        let mut out = FarFrame::default();
        let mut wanted = PixelMask::all(CAMERA.width, CAMERA.height);
        let stats = TreePainter::default().draw(
            &self.tree,
            &self.memory,
            pose,
            &CAMERA,
            options,
            &mut wanted,
            &|_, _| false,
            &mut out,
        );
        (out, stats)
    }
}

/// A wall that fills the plane z = `depth` steps of the root's +z face, sloping by `slope`,
/// coloured by column.
fn wall(depth: f64, slope: [i8; 2], colour: impl Fn(u8, u8) -> [u8; 3]) -> Vec<TreeSample> {
    let mut out = Vec::new();
    for row in 0..SIDE as u8 {
        for column in 0..SIDE as u8 {
            let middle = f64::from(SIDE) / 2.0 - 0.5;
            let (c, r) = (f64::from(column) - middle, f64::from(row) - middle);
            let at = depth + c * f64::from(slope[0]) + r * f64::from(slope[1]);
            if (0.0..f64::from(SIDE * DEPTH_STEPS)).contains(&at) {
                let rgb = colour(column, row);
                out.push(TreeSample {
                    face: 5,
                    column,
                    row,
                    covers: WHOLE,
                    depth: at as u16,
                    slope,
                    rgb,
                    filtered: false,
                });
            }
        }
    }
    out
}

fn ahead(z: f64) -> Pose {
    Pose { position: DVec3::new(0.0, 0.0, z), yaw_deg: 0.0, pitch_deg: 0.0 }
}

const ONCE: TreeOptions =
    TreeOptions { cut: CutOptions { stamp_px: 1.0, max_samples: u64::MAX, coarsest_px: f64::INFINITY }, gap_passes: 0 };

#[test]
fn a_wall_has_no_holes_and_the_plane_s_own_depth_at_every_pixel() {
    for (slope, z) in [([0i8, 0i8], 30.0), ([20, -7], 12.0), ([60, 33], 9.0), ([0, 0], 5.2)] {
        let made = Made::new(10.0, wall(2048.0, slope, |_, _| [90, 120, 150]));
        let (picture, stats) = made.draw(&ahead(z), &ONCE);
        let plane = |u: f64, v: f64| {
            // World: z = x s0 + y' s1, with rows along +y.
            let f = CAMERA.focal_px();
            let ray = DVec3::new((u - 80.0) / f, -(v - 60.0) / f, -1.0);
            let (a, b) = (f64::from(slope[0]) / 64.0, f64::from(slope[1]) / 64.0);
            // position + t ray on z - a x - b y = 0.
            let t = z / -(ray.z - a * ray.x - b * ray.y);
            (t, (DVec3::new(0.0, 0.0, z) + ray * t))
        };
        let mut seen = 0;
        for row in 0..CAMERA.height as usize {
            for column in 0..CAMERA.width as usize {
                let (depth, at) = plane(column as f64 + 0.5, row as f64 + 0.5);
                let steep = at.z.abs() < 4.5;
                if depth > 0.05 && at.x.abs().max(at.y.abs()) < 4.7 && steep {
                    let got = picture.get(row * CAMERA.width as usize + column);
                    let (colour, disparity) =
                        got.unwrap_or_else(|| panic!("a hole at {column}, {row}, slope {slope:?}"));
                    assert_eq!(unpack_rgb(colour), [90, 120, 150]);
                    let wrong = (1.0 / f64::from(disparity) - depth).abs();
                    assert!(wrong < 10.0 / 64.0 / 32.0 * 2.0, "{wrong} m at {column}, {row}, slope {slope:?}");
                    seen += 1;
                }
            }
        }
        assert!(seen > 500 && stats.painted >= seen, "{seen} of {}", stats.painted);
    }
}

#[test]
fn the_fast_path_shows_what_lists_show() {
    // A wall with stripes, a smaller one before it, and a half-covered one between.
    let mut samples = wall(1000.0, [3, 5], |c, _| if c % 8 < 4 { [200, 60, 40] } else { [40, 60, 200] });
    samples.extend(wall(3000.0, [0, 0], |_, _| [30, 160, 30]).into_iter().filter(|s| s.column > 20 && s.row < 40));
    samples.extend(
        wall(2000.0, [0, 0], |_, _| [240, 240, 0])
            .into_iter()
            .filter(|s| s.column < 12)
            .map(|s| TreeSample { covers: 0x0f33, ..s }),
    );
    let made = Made::new(10.0, samples);
    for pose in [ahead(14.0), Pose { yaw_deg: 15.0, pitch_deg: -6.0, position: DVec3::new(2.0, 1.0, 12.0) }] {
        let (fast, _) = made.draw(&pose, &ONCE);
        let (lists, length) = lists::draw(&made.tree, &made.memory, &pose, &CAMERA, &ONCE);
        assert!(length > 3.0);
        let (mut same, mut apart, mut only_one) = (0u32, 0u32, 0u32);
        for at in 0..fast.packed.len() {
            match (fast.get(at), lists.get(at)) {
                (Some((a, _)), Some((b, _))) => {
                    let off = unpack_rgb(a).into_iter().zip(unpack_rgb(b)).map(|(x, y)| x.abs_diff(y)).max();
                    *if off <= Some(2) { &mut same } else { &mut apart } += 1;
                }
                (None, None) => {}
                _ => only_one += 1,
            }
        }
        // Where one opaque surface is in front, to rounding. They differ under what is half
        // covered, and along outlines: lists end where they cover a quarter of a pixel, 0.75
        // pitches from the last sample's middle, opaque tiles 0.55 pitches. A pitch is 1.5 pixels
        // here, and outlines are some 700 pixels long.
        assert!(same > 6000 && apart * 5 < same && only_one < 300, "{same} same, {apart} apart, {only_one} in one");
    }
}

#[test]
fn gaps_are_filled_from_filtered_samples_and_only_there() {
    // Children of the root: one octant holds a wall, of which the root has a copy that goes on
    // beyond it.
    let coarse: Vec<TreeSample> =
        wall(2048.0, [0, 0], |_, _| [100, 100, 100]).into_iter().map(|s| TreeSample { filtered: true, ..s }).collect();
    let mut made = Made::new(10.0, coarse);
    // The upper right octant in front: its wall at the same place is at depth 0 of the child.
    let child: Vec<TreeSample> =
        wall(32.0, [0, 0], |_, _| [200, 50, 50]).into_iter().filter(|s| s.column < 40).collect();
    let n = child.len() as u32;
    made.tree.nodes[0] = TreeNode { first_child: 1, children: 1, chunk: 1, ..made.tree.nodes[0] };
    made.tree.nodes.push(TreeNode {
        level: 1,
        cell: [1; 3],
        samples: n,
        unfiltered: n,
        first_child: 0,
        children: 0,
        chunk: 0,
    });
    made.tree.check().unwrap();
    made.memory.broods.insert(1, Arc::new(Brood { nodes: vec![NodeSamples { samples: child }] }));
    let pose = ahead(12.0);
    let (bare, _) = made.draw(&pose, &ONCE);
    let (filled, stats) = made.draw(&pose, &TreeOptions { gap_passes: GAP_PASSES, ..ONCE });
    let red = |f: &FarFrame, at: usize| f.get(at).is_some_and(|(c, _)| unpack_rgb(c)[0] > 150);
    let (mut kept, mut gaps) = (0, 0u64);
    for at in 0..bare.packed.len() {
        match bare.get(at) {
            Some(_) => {
                assert_eq!(bare.get(at), filled.get(at), "what stands is left alone");
                kept += u32::from(red(&bare, at));
            }
            None => gaps += u64::from(filled.get(at).is_some()),
        }
    }
    assert!(kept > 500 && gaps > 2000 && stats.gaps_filled == gaps, "{kept}, {gaps}, {stats:?}");
    // From nearby the root's samples are larger than a gap may be: what they show may as well be
    // air.
    let near = ahead(5.5);
    let (bare, _) = made.draw(&near, &ONCE);
    let (filled, stats) = made.draw(&near, &TreeOptions { gap_passes: GAP_PASSES, ..ONCE });
    assert!(bare.packed == filled.packed && stats.gaps_filled == 0 && stats.painted > 500, "{stats:?}");
    let open = |f: &FarFrame| f.packed.iter().filter(|p| FarFrame::unpack(**p).is_none()).count();
    let (all, _) = made.draw(&near, &TreeOptions { gap_passes: ALL_GAP_PASSES, ..ONCE });
    assert!(open(&bare) > open(&all), "{} pixels open, {} of them after all passes", open(&bare), open(&all));
}

/// World x of the pixels of the middle row on the plane z = 0, seen from z = 12.
fn across_the_middle(picture: &FarFrame) -> impl Iterator<Item = (f64, Option<u32>)> + '_ {
    let width = CAMERA.width as usize;
    let first = CAMERA.height as usize / 2 * width;
    let x = move |column: usize| (column as f64 + 0.5 - width as f64 / 2.0) / CAMERA.focal_px() * 12.0;
    (0..width).map(move |column| (x(column), picture.get(first + column).map(|(colour, _)| colour)))
}

#[test]
fn outlines_are_as_fine_as_coverage_masks() {
    // The left half of a wall before another one; its last column of samples covers a quarter.
    let before = wall(2048.0, [0, 0], |_, _| [200, 50, 50]).into_iter().filter(|s| s.column < 32);
    let rim = |s: TreeSample| TreeSample { covers: if s.column == 31 { 0x1111 } else { WHOLE }, ..s };
    let behind = wall(1000.0, [0, 0], |_, _| [40, 60, 200]);
    let pitch = 10.0 / 64.0;
    let edge = -5.0 + 31.25 * pitch;
    for backed in [true, false] {
        let samples = behind.iter().copied().filter(|_| backed).chain(before.clone().map(rim)).collect();
        let (picture, _) = Made::new(10.0, samples).draw(&ahead(12.0), &ONCE);
        let (mut on, mut off) = (0, 0);
        for (x, colour) in across_the_middle(&picture).filter(|(x, _)| x.abs() < 4.0 && (x - edge).abs() > 0.01) {
            let expected = match (x < edge, backed) {
                (true, _) => Some([200, 50, 50]),
                (false, true) => Some([40, 60, 200]),
                (false, false) => None,
            };
            assert_eq!(colour.map(unpack_rgb), expected, "at {x}, the edge is at {edge}");
            *if x < edge { &mut on } else { &mut off } += 1;
        }
        assert!(on > 30 && off > 30, "{on} and {off} pixels");
    }
}

#[test]
fn gaps_are_not_filled_beyond_outlines() {
    // Only the root has samples, of which its child lacks all: its last column covers a half.
    let half = |s: TreeSample| TreeSample { covers: if s.column == 31 { 0x3333 } else { WHOLE }, filtered: true, ..s };
    let coarse = wall(2048.0, [0, 0], |_, _| [100, 100, 100]).into_iter().filter(|s| s.column < 32).map(half);
    let mut made = Made::new(10.0, coarse.collect());
    made.tree.nodes[0] = TreeNode { first_child: 1, children: 1, chunk: 1, ..made.tree.nodes[0] };
    let child = TreeNode { level: 1, cell: [1; 3], samples: 0, unfiltered: 0, first_child: 0, children: 0, chunk: 0 };
    made.tree.nodes.push(child);
    made.memory.broods.insert(1, Arc::new(Brood { nodes: vec![NodeSamples::default()] }));
    let (bare, _) = made.draw(&ahead(12.0), &ONCE);
    assert_eq!(bare.painted(), 0, "filtered samples give way");
    let (filled, _) = made.draw(&ahead(12.0), &TreeOptions { gap_passes: GAP_PASSES, ..ONCE });
    let pitch = 10.0 / 64.0;
    let last = across_the_middle(&filled).filter(|(_, c)| c.is_some()).map(|(x, _)| x).fold(f64::MIN, f64::max);
    // The rim's parts are left out: within the half, a quarter.
    let edge = -5.0 + 31.25 * pitch;
    assert!((edge - last).abs() < 0.1 && last < edge, "filled up to {last}, not {edge}");
}

#[test]
fn an_eye_within_a_cell_beside_a_wall_and_far_out_in_the_world_sees_it_whole() {
    for offset in [0.0, 1e6, 1e7] {
        let mut made = Made::new(10.0, wall(2048.0, [0, 0], |_, _| [90, 120, 150]));
        made.tree.origin += DVec3::splat(offset);
        // 0.1 m from the wall: tiles of 0.16 m, larger than the picture is wide at that distance,
        // some partly behind the eye.
        for (distance, yaw) in [(0.1, 0.0), (0.1, 60.0), (3.0, 0.0)] {
            let pose = Pose { position: DVec3::new(offset, offset, offset + distance), yaw_deg: yaw, pitch_deg: 0.0 };
            let (picture, _) = made.draw(&pose, &ONCE);
            let shown = (0..picture.packed.len()).filter(|at| picture.get(*at).is_some()).count();
            let f = CAMERA.focal_px();
            let (sy, cy) = f64::to_radians(yaw).sin_cos();
            let on_wall = |at: usize| {
                let (u, v) = ((at % 160) as f64 + 0.5 - 80.0, (at / 160) as f64 + 0.5 - 60.0);
                // Ray in the world.
                let (x, y, z) = (u / f * cy - sy, -v / f, -cy - u / f * sy);
                let t = distance / -z;
                z < 0.0 && (x * t).abs() < 4.5 && (y * t).abs() < 4.5
            };
            let expected = (0..picture.packed.len()).filter(|at| on_wall(*at)).count();
            assert!(
                shown >= expected * 99 / 100,
                "offset {offset}, {distance} m, {yaw} degrees: {shown} of {expected}"
            );
        }
    }
}

#[test]
fn what_turns_away_or_is_not_wanted_is_not_drawn() {
    let made = Made::new(10.0, wall(2048.0, [0, 0], |_, _| [90, 120, 150]));
    let behind = Pose { position: DVec3::new(0.0, 0.0, -12.0), yaw_deg: 180.0, pitch_deg: 0.0 };
    assert_eq!(made.draw(&behind, &ONCE).1.painted, 0);
    let mut wanted = PixelMask::new(160, 120, (0..160 * 120).map(|at| at % 160 < 40).collect(), &[]);
    let mut out = FarFrame::default();
    let stats = TreePainter::default().draw(
        &made.tree,
        &made.memory,
        &ahead(14.0),
        &CAMERA,
        &ONCE,
        &mut wanted,
        &|_, _| false,
        &mut out,
    );
    assert!(stats.painted > 0 && (0..out.packed.len()).all(|at| out.get(at).is_none() || at % 160 < 40));
    // The wall fills the picture, 7 to 8.6 m away.
    let painted_beyond = |metres: f32| {
        let mut wanted = PixelMask::all(160, 120).beyond(metres);
        let none = |_: usize, _: usize| true;
        let mut out = FarFrame::default();
        let mut painter = TreePainter::default();
        painter.draw(&made.tree, &made.memory, &ahead(7.0), &CAMERA, &ONCE, &mut wanted, &none, &mut out).painted
    };
    assert_eq!((painted_beyond(0.0), painted_beyond(6.5), painted_beyond(20.0)), (160 * 120, 160 * 120, 0));
    let ring = painted_beyond(7.8);
    assert!(ring > 0 && ring < 160 * 120, "{ring} pixels beyond 7.8 m");
    let nothing = Memory::default();
    let stats = TreePainter::default().draw(
        &made.tree,
        &nothing,
        &ahead(14.0),
        &CAMERA,
        &ONCE,
        &mut PixelMask::all(160, 120),
        &|_, _| false,
        &mut out,
    );
    assert_eq!((stats.painted, &stats.missing[..]), (0, &[0u32][..]));
}

#[test]
fn whether_something_shows_is_the_same_however_little_is_wanted() {
    let (width, height) = (150usize, 70usize);
    let mut state = 7u64;
    let mut random = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % n
    };
    for wanted_pixels in [0, 1, 5, 200, 5_000] {
        let mut pixels = vec![false; width * height];
        (0..wanted_pixels).for_each(|_| pixels[random(width * height)] = true);
        let hidden_below: Vec<f32> = (0..width * height).map(|_| random(1000) as f32 * 1e-3).collect();
        let wanted = PixelMask::new(width as u32, height as u32, pixels.clone(), &hidden_below);
        assert_eq!(wanted.count(), pixels.iter().filter(|w| **w).count() as u64);
        let mut shown = 0;
        for _ in 0..300 {
            let span = |a: usize, b: usize| [a.min(b) as i32, a.max(b) as i32];
            let columns = span(random(width), random(width));
            let rows = span(random(height), random(height));
            let disparity = random(1000) as f32 * 1e-3;
            // Blocks decide, not pixels.
            let block = |v: [i32; 2]| v[0] as usize / BLOCK..=v[1] as usize / BLOCK;
            let expected = (0..width * height).any(|at| {
                let (column, row) = (at % width / BLOCK, at / width / BLOCK);
                pixels[at]
                    && block(columns).contains(&column)
                    && block(rows).contains(&row)
                    && disparity >= hidden_below[at]
            });
            assert_eq!(wanted.any(columns, rows, disparity), expected, "{wanted_pixels}: {columns:?} {rows:?}");
            shown += usize::from(expected);
        }
        assert!(wanted_pixels == 0 || (5..300).contains(&shown), "{shown} of 300 with {wanted_pixels}");
    }
}
