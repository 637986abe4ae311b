//! The warp against analytic scenes, against its f64 reference, and against itself.

use super::{
    analytic::*,
    tiles::{OVERLAP, TILE_SAMPLES},
    transform::{Largest, Scratch, Wanted, Window, transform_tile},
    *,
};
use crate::frame::{pack_rgb, unpack_rgb};
use crate::simd::Portable;
use glam::DVec3;
use ldi_protocol::{
    OutputCamera, Pose,
    ldi::{
        DisparityCodes, END_BITS, END_PARTS, LINK_DOWN, LINK_RIGHT, Ldi, LdiLayer, SLOPE_CODES, Segment, Sliver,
        SliverCorner, is_loose,
    },
};

pub(super) const SCENES: [&str; 5] = ["frontal", "slanted", "sphere", "fence", "floor"];
pub(super) const CAMERA: OutputCamera = OutputCamera { width: 160, height: 120, fov_deg: 60.0 };

pub(super) fn pose(x: f64, y: f64, z: f64, yaw_deg: f64, pitch_deg: f64) -> Pose {
    Pose { position: DVec3::new(x, y, z), yaw_deg, pitch_deg }
}

pub(super) fn poses() -> [Pose; 3] {
    [pose(0., 0., 0., 0., 0.), pose(0.6, 0.3, -1.0, 5.0, -3.0), pose(-0.5, 0.2, 0.7, -10.0, 5.0)]
}

pub(super) fn image(name: &str) -> Ldi {
    scene(name).ldi(ldi_camera(DVec3::ZERO, 320, 240, 90.0), 4)
}

fn render(ldi: &Ldi, pose: &Pose, options: &WarpOptions) -> (FarFrame, WarpStats) {
    let mut frame = FarFrame::new(CAMERA.width, CAMERA.height);
    let stats = warp(&PreparedLdi::new(ldi), pose, &CAMERA, options, &mut frame).unwrap();
    (frame, stats)
}

pub(super) fn with(stamp: Stamp) -> WarpOptions {
    WarpOptions { stamp, ..WarpOptions::default() }
}

/// How two pictures differ, pixel by pixel.
#[derive(Debug, Clone, Copy, Default)]
struct Difference {
    pixels: usize,
    /// Painted in one only.
    one_only: usize,
    /// Painted in both, disparities more than a tenth apart.
    other_surface: usize,
    /// Mean colour difference in codes, and largest, over the same surface.
    mean: f64,
    largest: u8,
}

fn compare(a: impl Iterator<Item = Option<(u32, f32)>>, b: impl Iterator<Item = Option<(u32, f32)>>) -> Difference {
    let mut d = Difference::default();
    let mut same = 0;
    for (a, b) in a.zip(b) {
        d.pixels += 1;
        match (a, b) {
            (Some((ca, da)), Some((cb, db))) if (da / db - 1.0).abs() <= 0.1 => {
                let channels = unpack_rgb(ca).into_iter().zip(unpack_rgb(cb)).map(|(a, b)| a.abs_diff(b));
                let largest = channels.clone().max().unwrap_or(0);
                d.mean += channels.map(f64::from).sum::<f64>() / 3.0;
                d.largest = d.largest.max(largest);
                same += 1;
            }
            (Some(_), Some(_)) => d.other_surface += 1,
            (None, None) => {}
            _ => d.one_only += 1,
        }
    }
    d.mean /= f64::from(same.max(1));
    d
}

fn pixels(frame: &FarFrame) -> impl Iterator<Item = Option<(u32, f32)>> + '_ {
    (0..frame.packed.len()).map(|i| frame.get(i))
}

fn against_truth(name: &str, pose: &Pose, stamp: Stamp) -> Difference {
    let truth = scene(name).truth(pose, &CAMERA);
    let truth = truth.into_iter().map(|t| t.map(|t| (pack_rgb(t.rgb), (1.0 / t.depth) as f32)));
    compare(pixels(&render(&image(name), pose, &with(stamp)).0), truth)
}

#[test]
fn quads_match_the_truth_from_shifted_eyes() {
    for name in SCENES {
        for p in &poses() {
            let d = against_truth(name, p, Stamp::Quads);
            // The floor's texture is finer than a pixel near the horizon, where no sampling agrees
            // with another.
            let mean = if name == "floor" { 5.0 } else { 0.3 };
            assert!(d.mean < mean, "{name}: {d:?}");
            assert_eq!(d.one_only, 0, "{name}: no holes inside, nothing outside: {d:?}");
            // Silhouettes: less than a pixel along every edge; fences have 10 to 20 edges of 120
            // pixels.
            assert!(d.other_surface <= 120, "{name}: {d:?}");
        }
    }
}

#[test]
fn coarser_stamps_are_worse_and_a_wrong_pose_is_much_worse() {
    for p in &poses()[1..] {
        let [one, two, three, square, turned, ewa, quads] = [
            Stamp::OnePixel,
            Stamp::TwoByTwo,
            Stamp::ThreeByThree,
            Stamp::Footprint,
            Stamp::Parallelogram,
            Stamp::Ewa,
            Stamp::Quads,
        ]
        .map(|stamp| against_truth("fence", p, stamp));
        assert!(turned.mean < square.mean && ewa.mean < turned.mean, "{square:?} {turned:?} {ewa:?}");
        assert!(quads.mean * 3.0 < one.mean && one.mean < two.mean && two.mean < three.mean);
        assert!(quads.other_surface < one.other_surface && one.other_surface < three.other_surface);
        let wrong = Pose { yaw_deg: p.yaw_deg + 0.5, ..*p };
        let truth = scene("fence").truth(p, &CAMERA);
        let truth = truth.into_iter().map(|t| t.map(|t| (pack_rgb(t.rgb), (1.0 / t.depth) as f32)));
        let d = compare(pixels(&render(&image("fence"), &wrong, &WarpOptions::default()).0), truth);
        assert!(d.mean > quads.mean * 3.0, "half a degree shows: {d:?}");
    }
}

#[test]
fn fast_equals_reference() {
    for name in SCENES {
        let ldi = image(name);
        for p in &poses() {
            for stamp in Stamp::ALL {
                let fast = render(&ldi, p, &with(stamp)).0;
                let d = compare(pixels(&fast), pixels(&reference::warp(&ldi, p, &CAMERA, stamp)));
                // Pixel centres within rounding or slack of an edge may go either way.
                let undecided = d.one_only + d.other_surface;
                assert!(undecided * 500 <= d.pixels, "{name} {stamp}: {d:?}");
                let mean = if stamp == Stamp::Quads { 0.05 } else { 0.1 };
                assert!(d.mean < mean, "{name} {stamp}: {d:?}");
            }
        }
        let other = compare(
            pixels(&render(&ldi, &poses()[1], &WarpOptions::default()).0),
            pixels(&reference::warp(&ldi, &poses()[2], &CAMERA, Stamp::Quads)),
        );
        let undecided = other.one_only + other.other_surface;
        assert!(undecided * 500 > other.pixels || other.mean > 1.0, "different poses differ: {other:?}");
    }
}

/// The image with surfaces that end anywhere between pixels, at any slope, and slivers before it.
pub(super) fn with_ends_and_slivers(mut ldi: Ldi) -> Ldi {
    let mut state = 5u64;
    let mut below = |n: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % n
    };
    for layer in &mut ldi.layers {
        let sides = layer.linked_sides();
        for ((ends, slopes), linked) in layer.ends.iter_mut().zip(&mut layer.slopes).zip(sides) {
            let open = (0..4).filter(|side| linked >> side & 1 == 0);
            *ends = open.map(|side| (below(u64::from(END_PARTS) + 1) as u16) << (side * END_BITS)).sum();
            for axis in (0..2).filter(|axis| is_loose(*ends, *axis)) {
                slopes[axis] = below(41) as i8 - 20;
            }
        }
    }
    let (width, height) = (ldi.camera.width as i32 * Sliver::PARTS, ldi.camera.height as i32 * Sliver::PARTS);
    for k in 0..60 {
        // Edge-on: narrow, and near at one end and far at the other.
        let (u, v) = (below(width as u64) as i32, below(height as u64) as i32);
        let far = 1 + below(u64::from(ldi.codes.largest_code) / 2) as u16;
        let near = far + below(u64::from(ldi.codes.largest_code / 3)) as u16;
        let corner = |u: i32, v: i32, disparity: u16| SliverCorner { u, v, disparity };
        let tall = 8 + below(800) as i32;
        let corners =
            [corner(u, v, far), corner(u + 9, v, near), corner(u, v + tall, far), corner(u + 9, v + tall, near)];
        ldi.slivers.push(Sliver { corners, rgb: [200, k, 40] });
    }
    assert_eq!(ldi.check(), Ok(()));
    ldi
}

#[test]
fn ends_and_slivers_are_drawn_as_by_the_reference() {
    let mut tried = 0;
    for name in SCENES {
        let plain = image(name);
        // Where there is one disparity alone, slivers and surfaces would be equally near.
        if plain.codes.disparity(plain.codes.largest_code) < 1.1 * plain.codes.smallest {
            continue;
        }
        tried += 1;
        let ldi = with_ends_and_slivers(plain.clone());
        for p in &poses()[1..] {
            let fast = render(&ldi, p, &WarpOptions::default()).0;
            let d = compare(pixels(&fast), pixels(&reference::warp(&ldi, p, &CAMERA, Stamp::Quads)));
            assert!((d.one_only + d.other_surface) * 500 <= d.pixels && d.mean < 0.05, "{name}: {d:?}");
            let plain = compare(pixels(&fast), pixels(&render(&plain, p, &WarpOptions::default()).0));
            assert!((plain.one_only + plain.other_surface) * 1000 > plain.pixels, "{name}: they show: {plain:?}");
        }
    }
    assert!(tried > 2);
}

#[test]
fn threads_kernels_and_culling_do_not_change_a_bit() {
    for name in ["fence", "floor"] {
        let prepared = PreparedLdi::new(&with_ends_and_slivers(image(name)));
        for p in &poses() {
            for stamp in [Stamp::OnePixel, Stamp::Footprint, Stamp::Parallelogram, Stamp::Ewa, Stamp::Quads] {
                let run = |threads: usize, options: WarpOptions| {
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                    let mut frame = FarFrame::new(CAMERA.width, CAMERA.height);
                    let stats = pool.install(|| warp(&prepared, p, &CAMERA, &options, &mut frame).unwrap());
                    (frame, stats)
                };
                // What counts as hidden depends on where threads share the picture.
                let visible = WarpOptions { keep_hidden: true, ..with(stamp) };
                let one = run(1, visible);
                for threads in [2, 3, 7] {
                    assert_eq!(one, run(threads, visible), "{threads} threads");
                    assert_eq!(one.0, run(threads, with(stamp)).0, "{threads} threads, without what is hidden");
                }
                assert_eq!(one, run(1, WarpOptions { portable: true, ..visible }), "portable kernels");
                let all = run(2, WarpOptions { keep_all_tiles: true, ..visible });
                assert_eq!(one.0, all.0, "culled tiles would have painted nothing");
                assert_eq!(all.1.samples_culled, 0);
                assert_eq!(one.1.samples, one.1.samples_culled + one.1.samples_warped);
            }
        }
        let turned = pose(0.0, 0.0, 0.0, 40.0, 0.0);
        let (_, stats) = render(&image(name), &turned, &WarpOptions::default());
        assert!(stats.samples_culled * 4 > stats.samples, "{name}: culling culls: {stats:?}");
    }
}

/// A slanted, textured plane without borders in view.
#[test]
fn no_cracks_at_any_magnification() {
    let s = scene("slanted");
    for side in [160, 230, 320, 480, 640] {
        // A 90-degree image of `side` samples under a 60-degree picture of 160 pixels.
        let ldi = s.ldi(ldi_camera(DVec3::ZERO, side, side * 3 / 4, 90.0), 1);
        for p in &poses() {
            let (frame, stats) = render(&ldi, p, &WarpOptions::default());
            let holes = (0..frame.packed.len()).filter(|i| frame.get(*i).is_none()).count();
            assert_eq!(holes, 0, "{side} samples: footprint {}", stats.footprint_max_px);
        }
    }
    let ldi = s.ldi(ldi_camera(DVec3::ZERO, 160, 120, 90.0), 1);
    let (frame, stats) = render(&ldi, &poses()[1], &with(Stamp::OnePixel));
    assert!(stats.footprint_max_px > 1.5);
    assert!(frame.painted() < frame.packed.len() * 2 / 3, "single pixels do leave cracks");
}

/// An image of one layer from (row, column, links).
fn small(samples: &[(u16, u8, u8)], disparity: f64) -> Ldi {
    let mut layer = LdiLayer::default();
    for (i, (row, column, links)) in samples.iter().enumerate() {
        layer.segments.push(Segment { row: *row, column_base: 0, first: i as u32, count: 1 });
        layer.column.push(*column);
        layer.disparity.push(1);
        layer.rgb.push([100, 150, 200]);
        layer.links.push(*links);
    }
    let mut camera = ldi_camera(DVec3::ZERO, 16, 12, 60.0);
    camera.pixels_per_unit *= 1.0 + 1e-9;
    Ldi {
        camera,
        codes: DisparityCodes { smallest: disparity, step: 1e-3, largest_code: 2 },
        layers: vec![layer.with_half_ends()],
        sky: vec![0; 12],
        slivers: vec![],
    }
}

#[test]
fn a_layer_covers_the_union_of_its_cells() {
    // The output is ten times finer than the image: a cell is a square of 10 pixels, more by the
    // overlap.
    let (r, d) = (LINK_RIGHT, LINK_DOWN);
    let shapes: [&[(u16, u8, u8)]; 7] = [
        &[(5, 7, 0)],
        &[(5, 7, r), (5, 8, 0)],
        &[(5, 7, d), (6, 7, 0)],
        &[(5, 7, r | d), (5, 8, 0), (6, 7, 0)],
        &[(5, 7, r | d), (5, 8, d), (6, 7, r), (6, 8, 0)],
        &[(5, 7, 0), (5, 8, 0), (6, 7, 0), (6, 8, 0)],
        &[(0, 0, r), (0, 1, r | d), (0, 2, 0), (1, 1, 0)],
    ];
    let grow = (10.0 * OVERLAP).ceil() as i32;
    for shape in shapes {
        let (frame, _) = render(&small(shape, 0.1), &poses()[0], &WarpOptions::default());
        for at in 0..frame.packed.len() {
            let (x, y) = ((at % 160) as i32, (at / 160) as i32);
            let near = |grow: i32| {
                shape.iter().any(|(row, column, _)| {
                    let (dx, dy) = (x - i32::from(*column) * 10, y - i32::from(*row) * 10);
                    (-grow..10 + grow).contains(&dx) && (-grow..10 + grow).contains(&dy)
                })
            };
            if near(0) {
                assert!(frame.get(at).is_some(), "{shape:?}: hole at {x} {y}");
            } else if !near(grow) {
                assert!(frame.get(at).is_none(), "{shape:?}: grown to {x} {y}");
            }
        }
    }
}

#[test]
fn a_strip_as_wide_as_its_pixels_lies_on_its_slope() {
    // Along a row, and along a column. The picture is ten times finer and sees the strip from its
    // centre: disparity is affine across it.
    for (shape, axis) in [([(5, 7, LINK_RIGHT), (5, 8, 0)], 1), ([(5, 7, LINK_DOWN), (6, 7, 0)], 0)] {
        let mut ldi = small(&shape, 0.1);
        for slopes in &mut ldi.layers[0].slopes {
            slopes[axis] = 3;
        }
        let per_pixel = 3.0 * f64::from(SLOPE_CODES) * ldi.codes.step;
        let fast = render(&ldi, &poses()[0], &WarpOptions::default()).0;
        for frame in [fast, reference::warp(&ldi, &poses()[0], &CAMERA, Stamp::Quads)] {
            let mut found = 0;
            for at in 0..frame.packed.len() {
                let Some((_, disparity)) = frame.get(at) else { continue };
                let place = [at % 160, at / 160][axis] as f64;
                let want = 0.1 + per_pixel * ((place + 0.5) / 10.0 - [7.5, 5.5][axis]);
                assert!((f64::from(disparity) - want).abs() < 1e-5, "{disparity} at {place}, not {want}");
                found += 1;
            }
            assert!(found >= 200);
        }
    }
}

#[test]
fn strips_keep_their_slope_at_half_the_resolution() {
    // One row that tells its slope; two rows whose disparities tell it.
    let mut one = small(&[(4, 6, LINK_RIGHT), (4, 7, 0)], 0.1);
    one.layers[0].slopes = vec![[0, 5]; 2];
    assert_eq!(halved(&one).layers[0].slopes, [[0, 10]]);
    let (r, d) = (LINK_RIGHT, LINK_DOWN);
    let mut two = small(&[(4, 6, r | d), (4, 7, d), (5, 6, r), (5, 7, 0)], 0.1);
    two.codes.largest_code = 100;
    two.layers[0].disparity = vec![10, 12, 34, 36];
    assert_eq!(halved(&two).layers[0].slopes, [[1, 6]]);
}

#[test]
fn links_to_nothing_are_ignored() {
    let plain = render(&small(&[(5, 7, 0), (11, 15, 0)], 0.1), &poses()[1], &WarpOptions::default());
    let dangling = small(&[(5, 7, LINK_DOWN | LINK_RIGHT), (11, 15, LINK_DOWN | LINK_RIGHT)], 0.1);
    assert_eq!(plain, render(&dangling, &poses()[1], &WarpOptions::default()));
}

#[test]
fn samples_at_and_behind_the_eye_never_paint() {
    // The only sample lies on the axis at 10 m (half a sample aside). Eyes at it, beyond it, and in
    // the image's plane.
    let ldi = small(&[(6, 8, 0)], 0.1);
    for stamp in Stamp::ALL {
        // Culling would hide what the kernels do with such samples.
        let options = WarpOptions { keep_all_tiles: true, ..with(stamp) };
        for z in [-10.0, -10.0 - 1e-9, -11.0, -1e6] {
            for yaw in [0.0, 37.0] {
                let (frame, stats) = render(&ldi, &pose(0.1, 0.0, z, yaw, 0.0), &options);
                let behind = matches!(yaw, 0.0) || z < -11.5;
                assert!(!behind || frame.painted() == 0, "{stamp} from {z}");
                assert!(stats.footprint_max_px.is_finite());
            }
        }
        let (frame, _) = render(&ldi, &pose(0.0, 0.0, -9.0, 0.0, 0.0), &options);
        assert!(frame.painted() > 0, "{stamp}: a metre before the sample it shows");
        let (frame, _) = render(&ldi, &pose(0.0, 0.0, 0.0, 180.0, 0.0), &options);
        assert_eq!(frame.painted(), 0, "{stamp}: looking away");
    }
    // A wall with the eye in its plane, and just behind it.
    let wall = image("frontal");
    for z in [-10.0, -10.001] {
        for yaw in [0.0, 90.0, 45.0] {
            let options = WarpOptions { keep_all_tiles: true, ..WarpOptions::default() };
            let (frame, _) = render(&wall, &pose(0.0, 0.0, z, yaw, 0.0), &options);
            if z < -10.0 && yaw == 0.0 {
                assert_eq!(frame.painted(), 0);
            }
            assert!(pixels(&frame).flatten().all(|(_, d)| d > 0.0 && !d.is_nan()));
        }
    }
}

#[test]
fn f32_rows_of_8192_stay_within_their_bound() {
    // A slanted surface far from the world's origin, on rows as long as they come.
    for offset in [DVec3::ZERO, DVec3::new(1e6, -3e5, 1e6)] {
        let mut s = scene("slanted");
        if let Surface::Rectangle { point, .. } = &mut s.surfaces[0] {
            *point += offset;
        }
        let mut ldi = s.ldi(ldi_camera(offset, 8192, 3, 90.0), 1);
        ldi.camera.top = 700;
        let camera = OutputCamera { width: 4096, height: 2304, fov_deg: 60.0 };
        for p in poses() {
            let p = Pose { position: p.position + offset, ..p };
            let matrix = WarpMatrix::new(&ldi.camera, &p, &camera);
            let prepared = PreparedLdi::new(&ldi);
            let window = Window { width: camera.width, first_row: 0, rows: camera.height };
            let mut scratch = Scratch::default();
            let (mut worst_px, mut worst_relative, mut checked) = (0.0f64, 0.0f64, 0);
            for (part, tile) in prepared.parts.iter().flat_map(|p| p.tiles.iter().map(move |t| (p, t))) {
                let wanted = Wanted { halo: true, footprints: true, largest: true };
                transform_tile::<Portable>(&matrix, part, tile, (&window, wanted), &mut scratch, &mut Largest::none());
                for row in 0..3 {
                    for i in tile.row_start[row] as usize..tile.row_start[row + 1] as usize {
                        let at = tile.first + i;
                        let u = f64::from(tile.column) + f64::from(part.column[at]) + 0.5;
                        let v = f64::from(tile.row) + row as f64 + 0.5;
                        let d = f64::from(part.disparity[at]);
                        let footprint = matrix.footprint(u, v, d);
                        let (Some(w), Some(footprint)) = (matrix.warp(u, v, d), footprint) else { continue };
                        if w.x.abs() > 4096.0 || w.y.abs() > 4096.0 || footprint > 4.0 {
                            continue;
                        }
                        let off = (f64::from(scratch.x[i]) - w.x).hypot(f64::from(scratch.y[i]) - w.y);
                        worst_px = worst_px.max(off);
                        worst_relative =
                            worst_relative.max((f64::from(scratch.disparity[i]) / w.disparity - 1.0).abs());
                        assert!((f64::from(scratch.footprint2[i]).sqrt() / footprint - 1.0).abs() < 1e-3);
                        checked += 1;
                    }
                }
            }
            assert!(checked > 3000, "{checked}");
            assert!(worst_px < 1.0 / 64.0 && worst_relative < 2f64.powi(-18), "{worst_px} {worst_relative}");
            assert!(worst_px > 1e-9, "f32 does round");
        }
    }
    assert!(TILE_SAMPLES < usize::from(u16::MAX));
}

#[test]
fn far_from_the_origin_the_picture_is_the_same() {
    let ldi = image("sphere");
    let offset = DVec3::new(1048576.0, -262144.0, 524288.0);
    let mut far = ldi.clone();
    far.camera.cop += offset;
    for p in poses() {
        let here = render(&ldi, &p, &WarpOptions::default()).0;
        let there = render(&far, &Pose { position: p.position + offset, ..p }, &WarpOptions::default()).0;
        let d = compare(pixels(&here), pixels(&there));
        assert!(d.mean < 0.02 && d.one_only == 0 && d.other_surface <= 2, "{d:?}");
    }
}

#[test]
fn footprint_is_the_measured_magnification() {
    // Halfway to a frontal wall samples are twice as large.
    let ldi = image("frontal");
    let ratio = CAMERA.focal_px() / ldi.camera.pixels_per_unit;
    for (z, magnification) in [(0.0, 1.0), (-5.0, 2.0), (5.0, 2.0 / 3.0)] {
        let (_, stats) = render(&ldi, &pose(0.0, 0.0, z, 0.0, 0.0), &WarpOptions::default());
        let expected = (ratio * magnification) as f32;
        assert!((stats.footprint_max_px / expected - 1.0).abs() < 1e-4, "{} {expected}", stats.footprint_max_px);
        let stretch = stats.stretch.quantile_px(0.99);
        assert!((stretch - expected).abs() <= 0.13, "{stretch} {expected}");
    }
    // By finite differences, with both planes turned.
    let matrix = WarpMatrix::new(&ldi.camera, &poses()[1], &CAMERA);
    for (u, v, d) in [(160.0, 120.0, 0.1), (30.0, 200.0, 0.3), (300.0, 10.0, 0.02)] {
        let h = 1e-4;
        let p = matrix.warp(u, v, d).unwrap();
        let largest = (0..3600)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 3600.0).sin_cos();
                let q = matrix.warp(u + h * cos, v + h * sin, d).unwrap();
                (q.x - p.x).hypot(q.y - p.y) / h
            })
            .fold(0.0, f64::max);
        let footprint = matrix.footprint(u, v, d).unwrap();
        assert!((footprint / largest - 1.0).abs() < 1e-3, "{footprint} {largest}");
    }
}

#[test]
fn matrix_agrees_with_the_cameras() {
    // Through the world: the LDI's ray to the point, then the output camera's projection of it.
    let camera = image("frontal").camera;
    for p in poses() {
        let matrix = WarpMatrix::new(&camera, &p, &CAMERA);
        for (u, v, d) in [(0.5, 0.5, 0.2), (160.0, 120.0, 0.1), (310.0, 31.0, 0.02)] {
            let point = camera.cop + camera.ray(u, v) / d;
            let w = matrix.warp(u, v, d).unwrap();
            let depth = (point - p.position).dot(p.basis().forward);
            let back = p.position + CAMERA.ray(&p.basis(), w.x, w.y) * depth;
            assert!((back - point).length() < 1e-9 && (w.disparity * depth - 1.0).abs() < 1e-12);
        }
    }
}

#[test]
fn occlusion_compatible_order_agrees_with_depth() {
    // Eyes ahead of the image's centre, behind it, in its plane, at it; epipoles inside, beside and
    // at infinity.
    let eyes = [
        pose(0.0, 0.0, -1.5, 0.0, 0.0),
        pose(0.9, 0.2, -1.0, 6.0, 0.0),
        pose(0.1, -0.1, 1.5, 0.0, 0.0),
        pose(-0.8, 0.0, 0.9, -4.0, 2.0),
        pose(0.9, 0.3, 0.0, 3.0, 0.0),
        pose(0.0, -0.9, 0.0, 0.0, -3.0),
        pose(0.0, 0.0, 0.0, 0.0, 0.0),
    ];
    let options = |stamp, order| WarpOptions { stamp, order, ..WarpOptions::default() };
    for name in ["fence", "sphere"] {
        let ldi = image(name);
        for p in &eyes {
            for stamp in [Stamp::OnePixel, Stamp::TwoByTwo] {
                let z = render(&ldi, p, &options(stamp, Order::Z));
                let painter = render(&ldi, p, &options(stamp, Order::Epipole));
                let d = compare(pixels(&z.0), pixels(&painter.0));
                // One pixel: where the picture is coarser than the image, two lines meet in a
                // pixel. 2 x 2: a stamp of a farther sample may come after a nearer neighbour, at
                // silhouettes.
                let allowed = if stamp == Stamp::OnePixel { 4 } else { d.pixels / 12 };
                assert!(d.one_only == 0 && d.other_surface <= allowed, "{name} {stamp} {p:?}: {d:?}");
                // Its tiles hold all layers of their place, so that fewer are clipped.
                assert!(z.1.samples_warped <= painter.1.samples_warped);
                assert!((z.1.footprint_max_px / painter.1.footprint_max_px - 1.0).abs() < 1e-6);
            }
        }
        // The mirrored eye's order is the wrong one.
        let mirrored = Pose { position: -eyes[1].position, ..eyes[1] };
        let z = render(&ldi, &eyes[1], &options(Stamp::OnePixel, Order::Z)).0;
        let mut wrong = FarFrame::new(CAMERA.width, CAMERA.height);
        let prepared = PreparedLdi::new(&ldi);
        row_bands::warp_in_order(&prepared, &eyes[1], &mirrored, &CAMERA, &mut wrong);
        let d = compare(pixels(&z), pixels(&wrong));
        assert!(d.other_surface > 200, "{name}: {d:?}");
    }
    let prepared = PreparedLdi::new(&image("frontal"));
    let mut frame = FarFrame::new(CAMERA.width, CAMERA.height);
    let refused = warp(&prepared, &eyes[0], &CAMERA, &options(Stamp::Quads, Order::Epipole), &mut frame);
    assert_eq!(refused.unwrap_err(), WarpError::OrderWithStamp(Stamp::Quads));
}

#[test]
fn debug_views_colour_what_they_say() {
    let ldi = image("fence");
    let seen =
        |ldi: &Ldi, at: usize| render(ldi, &poses()[0], &WarpOptions::default()).0.get(at).map(|p| unpack_rgb(p.0));
    // From the image's own centre only the first layer is seen; from the side the wall behind bars
    // as well.
    let layers = debug_colours::coloured_by_layer(&ldi);
    assert!((0..19_200).step_by(777).all(|at| seen(&layers, at) == Some(debug_colours::LAYER_COLOURS[0])));
    let side = render(&layers, &poses()[1], &WarpOptions::default()).0;
    let second = pack_rgb(debug_colours::LAYER_COLOURS[1]);
    assert!(pixels(&side).flatten().any(|(c, _)| c == second));
    // A frontal wall at its own centre: footprint 0.87; halfway there 1.73.
    let wall = image("frontal");
    let cold = seen(&debug_colours::coloured_by_footprint(&wall, &poses()[0], &CAMERA), 9_600).unwrap();
    let hot =
        seen(&debug_colours::coloured_by_footprint(&wall, &pose(0.0, 0.0, -5.0, 0.0, 0.0), &CAMERA), 9_600).unwrap();
    assert!(cold[2] > cold[0] && hot[0] == 255 && hot[2] < 100, "{cold:?} {hot:?}");
    let inner = seen(&debug_colours::coloured_by_links(&wall), 9_600).unwrap();
    assert_eq!(inner, [40; 3]);
}

#[test]
fn squares_of_codes_are_nearly_linear_light() {
    use ldi_protocol::shade::{linear_from_srgb, srgb_from_linear};
    let (mut by_squares, mut by_codes) = (0.0f32, 0.0f32);
    for a in 0..=255u8 {
        for b in a..=a.saturating_add(128) {
            let light = |c: u8| linear_from_srgb(f32::from(c) / 255.0);
            let exact = 255.0 * srgb_from_linear(0.5 * (light(a) + light(b)));
            let (a, b) = (f32::from(a), f32::from(b));
            by_squares = by_squares.max((((a * a + b * b) * 0.5).sqrt() - exact).abs());
            by_codes = by_codes.max((0.5 * (a + b) - exact).abs());
        }
    }
    assert!(by_squares < 4.5 && by_codes > 25.0, "{by_squares} {by_codes}");
}

#[test]
fn a_second_image_keeps_the_nearer_pixels() {
    let (wall, sphere) = (image("frontal"), image("sphere"));
    let mut both = FarFrame::new(CAMERA.width, CAMERA.height);
    for ldi in [&wall, &sphere] {
        warp(&PreparedLdi::new(ldi), &poses()[1], &CAMERA, &WarpOptions::default(), &mut both).unwrap();
    }
    let alone = [&wall, &sphere].map(|ldi| render(ldi, &poses()[1], &WarpOptions::default()).0);
    for at in 0..both.packed.len() {
        assert_eq!(both.packed[at], alone[0].packed[at].max(alone[1].packed[at]));
    }
    both.reset(CAMERA.width, CAMERA.height);
    assert_eq!((both.painted(), both.get(0)), (0, None));
}

#[test]
fn names_round_trip_and_errors_help() {
    for stamp in Stamp::ALL {
        assert_eq!(stamp.name().parse::<Stamp>().unwrap(), stamp);
    }
    assert!("4x4".parse::<Stamp>().unwrap_err().to_string().contains("footprint"));
    assert_eq!("epipole".parse::<Order>().unwrap(), Order::Epipole);
    assert!("zz".parse::<Order>().unwrap_err().to_string().contains("epipole"));
}

/// A picture at half the size: drawn from an image at half the resolution it is as near to the
/// truth as drawn from the whole one, or nearly.
#[test]
fn an_image_at_half_its_resolution_shows_the_same_at_half_the_size() {
    for name in SCENES {
        for (left, top) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let mut camera = ldi_camera(DVec3::ZERO, 640, 480, 90.0);
            (camera.left, camera.top) = (camera.left + left, camera.top + top);
            let ldi = scene(name).ldi(camera, 4);
            let half = halved(&ldi);
            let share = half.samples() as f64 / ldi.samples() as f64;
            assert!((0.24..0.40).contains(&share), "{name}: {share} of the samples");
            for p in &poses() {
                let truth = scene(name).truth(p, &CAMERA).into_iter();
                let truth: Vec<_> = truth.map(|t| t.map(|t| (pack_rgb(t.rgb), (1.0 / t.depth) as f32))).collect();
                let against = |ldi: &Ldi| {
                    let (frame, stats) = render(ldi, p, &WarpOptions::default());
                    (compare(pixels(&frame), truth.iter().copied()), stats.footprint_max_px)
                };
                let ((whole, fine), (d, coarse)) = (against(&ldi), against(&half));
                let wrong = |d: &Difference| d.one_only + d.other_surface;
                assert!(wrong(&d) <= wrong(&whole) + d.pixels / 100, "{name}: {d:?}, {whole:?}");
                assert!(d.mean <= 1.5 * whole.mean + 1.0, "{name}: {d:?}, {whole:?}");
                assert!((coarse / fine - 2.0).abs() < 0.1, "{name}: {coarse}, {fine}");
            }
        }
    }
}

#[test]
fn a_plane_stays_the_plane_and_whole_at_half_its_resolution() {
    for (left, top) in [(0, 0), (1, 1)] {
        let mut camera = ldi_camera(DVec3::ZERO, 321, 239, 90.0);
        (camera.left, camera.top) = (camera.left + left, camera.top + top);
        let s = scene("slanted");
        let half = halved(&s.ldi(camera, 1));
        let [layer] = &half.layers[..] else { panic!("one layer") };
        let mut inner = 0;
        for segment in &layer.segments {
            for i in segment.first as usize..segment.first as usize + usize::from(segment.count) {
                let (column, row) =
                    (u32::from(segment.column_base) + u32::from(layer.column[i]), u32::from(segment.row));
                if column == 0 || row == 0 || column + 1 >= half.camera.width || row + 1 >= half.camera.height {
                    continue;
                }
                inner += 1;
                let ray = half.camera.ray(f64::from(column) + 0.5, f64::from(row) + 0.5);
                let depth = s.hits(DVec3::ZERO, ray)[0].depth;
                let off = half.codes.disparity(layer.disparity[i]) - 1.0 / depth;
                assert!(off.abs() <= 1.01 * half.codes.step, "{off} at {column}, {row}");
                assert_eq!(layer.links[i], LINK_RIGHT | LINK_DOWN);
            }
        }
        assert!(inner > 15_000);
        for p in &poses() {
            let (frame, _) = render(&half, p, &WarpOptions::default());
            assert_eq!(frame.painted(), frame.packed.len(), "no cracks");
        }
    }
}

#[test]
fn what_is_not_linked_stays_apart_at_half_the_resolution() {
    let (r, d) = (LINK_RIGHT, LINK_DOWN);
    // Two columns of one block that are linked within themselves; a lone sample; three in a corner.
    let shape = [(4, 6, d), (4, 7, d), (5, 6, 0), (5, 7, 0), (8, 8, 0), (8, 12, r | d), (8, 13, 0), (9, 12, 0)];
    let half = halved(&small(&shape, 0.1));
    let samples: Vec<usize> = half.layers.iter().map(LdiLayer::len).collect();
    assert_eq!(samples, [3, 1]);
    for layer in &half.layers {
        assert!(layer.links.iter().all(|l| *l == 0));
    }
    let mut slivers = with_ends_and_slivers(image("slanted"));
    slivers.camera.left += 1;
    let at = |ldi: &Ldi, c: &SliverCorner| {
        let place = |v: i32, from: i32| {
            (f64::from(from) + f64::from(v) / f64::from(Sliver::PARTS)) / ldi.camera.pixels_per_unit
        };
        DVec3::new(place(c.u, ldi.camera.left), place(c.v, ldi.camera.top), f64::from(c.disparity))
    };
    let half = halved(&slivers);
    assert_eq!(half.slivers.len(), slivers.slivers.len());
    let part = 1.0 / f64::from(Sliver::PARTS) / half.camera.pixels_per_unit;
    for (a, b) in slivers.slivers.iter().zip(&half.slivers) {
        for (a, b) in a.corners.iter().zip(&b.corners) {
            assert!(at(&slivers, a).distance(at(&half, b)) < 2.0 * part);
        }
    }
}
