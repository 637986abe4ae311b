//! A still eye: the same picture as one long frame, in bounded steps, and never a coarser one.

use super::*;
use crate::{frame::unpack_rgb, test_support::Memory};
use glam::DVec3;
use ldi_protocol::tree::{Brood, DEPTH_STEPS, NodeSamples, SIDE, TreeNode, TreeSample, WHOLE};
use std::sync::Arc;

/// Narrow, and far enough off that the root's samples are smaller than eight pixels: coarser ones
/// would not stay, whatever the bound.
const CAMERA: OutputCamera = OutputCamera { width: 160, height: 100, fov_deg: 20.0 };
const LEVELS: u8 = 4;
const EDGE_M: f64 = 16.0;

/// A wall at z = -1 m through a cube of 16 m around the origin, on four levels; the picture on it
/// is a wave that only fine samples show.
fn wall() -> (Tree, Memory) {
    let wave =
        |x: f64, y: f64| [(128.0 + 120.0 * (9.0 * x).sin() * (7.0 * y).cos()) as u8, 90, (x * 15.0 + 120.0) as u8];
    let samples = |level: u8, cell: [u16; 3]| -> NodeSamples {
        let edge = EDGE_M / f64::from(1u32 << level);
        let pitch = edge / f64::from(SIDE);
        let corner = DVec3::from_array(cell.map(|c| f64::from(c) * edge)) - EDGE_M / 2.0;
        let depth = ((-1.0 - corner.z) / pitch * f64::from(DEPTH_STEPS) - 0.5).round() as u16;
        let places = (0..SIDE as u8).flat_map(|row| (0..SIDE as u8).map(move |column| (row, column)));
        let made = places.map(|(row, column)| {
            let at = |k: u8, c: f64| c + (f64::from(k) + 0.5) * pitch;
            let rgb = wave(at(column, corner.x), at(row, corner.y));
            TreeSample { face: 5, column, row, covers: WHOLE, depth, slope: [0, 0], rgb, filtered: level + 1 < LEVELS }
        });
        NodeSamples { samples: made.collect() }
    };
    let mut nodes: Vec<TreeNode> = Vec::new();
    let mut broods: Vec<Brood> = Vec::new();
    let node = |level: u8, cell| {
        let all = SIDE * SIDE;
        let unfiltered = if level + 1 < LEVELS { 0 } else { all };
        TreeNode { level, cell, samples: all, unfiltered, first_child: 0, children: 0, chunk: 0 }
    };
    nodes.push(node(0, [0; 3]));
    broods.push(Brood { nodes: vec![samples(0, [0; 3])] });
    let mut at = 0;
    while at < nodes.len() {
        let TreeNode { level, cell, .. } = nodes[at];
        if level + 1 < LEVELS {
            // Which of the two layers of cells the wall lies in.
            let half = EDGE_M / f64::from(1u32 << (level + 1));
            let z = ((-1.0 + EDGE_M / 2.0) / half) as u16;
            let cells: Vec<[u16; 3]> = (0..4u16).map(|o| [2 * cell[0] + (o & 1), 2 * cell[1] + (o >> 1), z]).collect();
            (nodes[at].first_child, nodes[at].children, nodes[at].chunk) = (nodes.len() as u32, 4, broods.len() as u32);
            broods.push(Brood { nodes: cells.iter().map(|c| samples(level + 1, *c)).collect() });
            nodes.extend(cells.into_iter().map(|c| node(level + 1, c)));
        }
        at += 1;
    }
    let tree = Tree { origin: DVec3::splat(-EDGE_M / 2.0), edge_m: EDGE_M, root_chunk: 0, pinned_levels: 1, nodes };
    tree.check().expect("a tree by the rules");
    let mut memory = Memory::default();
    memory.broods.extend((0..).zip(broods.into_iter().map(Arc::new)));
    (tree, memory)
}

const EYE: Pose = Pose { position: DVec3::new(0.3, -0.2, 30.0), yaw_deg: 3.0, pitch_deg: 1.0 };
const STEP: u64 = 3_000;

fn frame(
    painter: &mut ProgressivePainter,
    tree: &Tree,
    memory: &Memory,
    pose: &Pose,
    step: u64,
) -> (TreeStats, FarFrame) {
    let wanted = PixelMask::all(CAMERA.width, CAMERA.height);
    let (stats, picture) = painter.frame(tree, memory, pose, &CAMERA, step, wanted, &[], &|_, _| false);
    (stats, picture.clone())
}

/// Pixels whose colour differs from `best` by more than rounding.
fn wrong(picture: &FarFrame, best: &FarFrame) -> usize {
    let colour = |f: &FarFrame, at| f.get(at).map(|(c, _)| unpack_rgb(c).map(i32::from));
    (0..best.packed.len())
        .filter(|at| match (colour(picture, *at), colour(best, *at)) {
            (Some(a), Some(b)) => a.iter().zip(&b).any(|(a, b)| (a - b).abs() > 2),
            (a, b) => a != b,
        })
        .count()
}

#[test]
fn a_still_eye_sees_more_and_more_in_bounded_steps_until_it_sees_what_one_long_frame_shows() {
    let (tree, memory) = wall();
    let (long, best) = frame(&mut ProgressivePainter::default(), &tree, &memory, &EYE, u64::MAX);
    assert!(!long.limited && long.samples > 10 * STEP, "{long:?}");
    let mut painter = ProgressivePainter::default();
    let (mut before, mut shown, mut pictures) = (usize::MAX, 0, 1);
    for number in 0..200 {
        let (stats, picture) = frame(&mut painter, &tree, &memory, &EYE, STEP);
        let node = u64::from(SIDE * SIDE);
        assert!(stats.samples <= STEP + 2 * node, "frame {number} looked at {}", stats.samples);
        let now = wrong(&picture, &best);
        assert!(now <= before && stats.shown >= shown, "frame {number}: {now} pixels wrong, {before} before");
        pictures += usize::from(now < before && before < usize::MAX);
        (before, shown) = (now, stats.shown);
        if !stats.limited {
            break;
        }
    }
    assert_eq!(before, 0, "in the end all is as in one long frame");
    assert!(pictures >= 3, "it sharpened in {pictures} steps");
    assert_eq!(frame(&mut painter, &tree, &memory, &EYE, STEP).0.samples, 0, "then nothing is left to do");
}

#[test]
fn an_eye_that_moves_starts_anew_and_data_that_arrives_sharpens_a_still_one() {
    let (tree, mut memory) = wall();
    let mut painter = ProgressivePainter::default();
    for _ in 0..30 {
        frame(&mut painter, &tree, &memory, &EYE, STEP);
    }
    let turned = Pose { yaw_deg: 20.0, ..EYE };
    let (stats, picture) = frame(&mut painter, &tree, &memory, &turned, STEP);
    let (_, alone) = frame(&mut ProgressivePainter::default(), &tree, &memory, &turned, STEP);
    assert!(stats.limited && stats.samples > 0);
    assert_eq!(wrong(&picture, &alone), 0, "the picture of the new view, not of the old one");

    // Without the finest level, whatever the bound.
    let finest: Vec<u32> = tree.nodes.iter().filter(|n| n.level + 2 == LEVELS).map(|n| n.chunk).collect();
    let held: Vec<_> = finest.iter().map(|c| (*c, memory.broods.remove(c).expect("there"))).collect();
    let mut painter = ProgressivePainter::default();
    for _ in 0..3 {
        assert!(!frame(&mut painter, &tree, &memory, &EYE, u64::MAX).0.limited);
    }
    memory.broods.extend(held);
    let (_, picture) = frame(&mut painter, &tree, &memory, &EYE, u64::MAX);
    let (_, best) = frame(&mut ProgressivePainter::default(), &tree, &memory, &EYE, u64::MAX);
    assert_eq!(wrong(&picture, &best), 0);
}

#[test]
fn pixels_that_were_not_wanted_before_are_drawn() {
    let (tree, memory) = wall();
    let mut painter = ProgressivePainter::default();
    let n = (CAMERA.width * CAMERA.height) as usize;
    let left = |at: &usize| at % (CAMERA.width as usize) < 100;
    let some = || PixelMask::new(CAMERA.width, CAMERA.height, (0..n).map(|at| left(&at)).collect(), &[]);
    for _ in 0..3 {
        painter.frame(&tree, &memory, &EYE, &CAMERA, u64::MAX, some(), &[], &|_, _| false);
    }
    let (_, picture) = frame(&mut painter, &tree, &memory, &EYE, u64::MAX);
    assert!((0..n).all(|at| picture.get(at).is_some()), "all of the wall");
    // What hid samples is gone.
    let mut painter = ProgressivePainter::default();
    let hidden = vec![1.0; n];
    for _ in 0..3 {
        let all = PixelMask::new(CAMERA.width, CAMERA.height, vec![true; n], &hidden);
        let (_, picture) = painter.frame(&tree, &memory, &EYE, &CAMERA, u64::MAX, all, &hidden, &|_, _| true);
        assert!((0..n).all(|at| picture.get(at).is_none()), "hidden 1 m from the eye, the wall is 31 m off");
    }
    let (_, picture) = frame(&mut painter, &tree, &memory, &EYE, u64::MAX);
    assert!((0..n).all(|at| picture.get(at).is_some()));
}
