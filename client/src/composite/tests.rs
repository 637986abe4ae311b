//! The composite on frames of a few pixels, and against the warp's analytic scenes.
use super::*;
use crate::{
    frame::pack_rgb,
    warp::{
        PreparedLdi, WarpOptions,
        analytic::{ldi_camera, scene},
        warp,
    },
};
use glam::DVec3;
use ldi_protocol::ldi::LdiCamera;

const CAMERA: OutputCamera = OutputCamera { width: 160, height: 120, fov_deg: 60.0 };

fn ahead() -> Pose {
    Pose { position: DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 }
}

fn image(name: &str) -> Ldi {
    scene(name).ldi(ldi_camera(DVec3::ZERO, 320, 240, 90.0), 3)
}

/// The window that an image holds: left, right, bottom, top, as tangents.
fn window(ldi: &Ldi) -> [f64; 4] {
    let c = &ldi.camera;
    let [l, r] = [0, c.width].map(|x| (f64::from(c.left) + f64::from(x)) / c.pixels_per_unit);
    let [t, b] = [0, c.height].map(|y| -(f64::from(c.top) + f64::from(y)) / c.pixels_per_unit);
    [l, r, b, t]
}

/// An image that holds all that was planned.
fn as_planned(ldi: &Ldi) -> FarImage<'_> {
    FarImage::Here(ldi, window(ldi))
}

fn warped(ldi: &Ldi, pose: &Pose) -> FarFrame {
    let mut picture = FarFrame::new(CAMERA.width, CAMERA.height);
    warp(&PreparedLdi::new(ldi), pose, &CAMERA, &WarpOptions::default(), &mut picture).unwrap();
    picture
}

/// A frame whose left half is a near surface at this disparity.
fn half_near(disparity: f32) -> Frame {
    let mut frame = Frame::new(CAMERA.width, CAMERA.height);
    for at in (0..frame.len()).filter(|at| at % 160 < 80) {
        frame.colour[at] = pack_rgb([255, 0, 0]);
        frame.disparity[at] = disparity;
        frame.source[at] = Source::Near;
    }
    frame
}

fn near_after(ldi: &Ldi, near_disparity: f32, pose: &Pose) -> (Frame, CompositeStats) {
    with_step(ldi, ldi.codes.step, near_disparity, pose)
}

/// Composites as if the disparity codes had this step, 1/m.
fn with_step(ldi: &Ldi, step: f64, near_disparity: f32, pose: &Pose) -> (Frame, CompositeStats) {
    let picture = warped(ldi, pose);
    let mut ldi = ldi.clone();
    ldi.codes.step = step;
    let ldi = &ldi;
    let mut frame = half_near(near_disparity);
    let far = Far::Images { picture: &picture, images: &[as_planned(ldi)], sky: None };
    let stats = composite(&mut frame, far, pose, &CAMERA, &CompositeOptions::default());
    (frame, stats)
}

#[test]
fn the_nearer_surface_wins_within_the_step() {
    // The wall is at 10 m; its disparity codes have some step.
    let ldi = image("frontal");
    let half = u64::from(CAMERA.width * CAMERA.height) / 2;
    for (disparity, near_wins) in [(0.2, true), (0.1, true), (0.09992, true), (0.0997, false), (0.05, false)] {
        let (_, stats) = with_step(&ldi, 1e-4, disparity, &ahead());
        assert_eq!(stats.near, if near_wins { half } else { 0 }, "near at {disparity}");
        assert_eq!(stats.near + stats.far, stats.pixels);
    }
    // Halfway to the wall the same step is twice as large: 0.2 +- 2e-4.
    let closer = Pose { position: DVec3::new(0.0, 0.0, -5.0), ..ahead() };
    for (disparity, near_wins) in [(0.19985, true), (0.1997, false)] {
        assert_eq!(
            with_step(&ldi, 1e-4, disparity, &closer).1.near,
            if near_wins { half } else { 0 },
            "near at {disparity}"
        );
    }
}

/// Near geometry on the left, the image's wall at 10 m on the right, and a column between that
/// neither reaches, where the image knows sky.
#[test]
fn a_gap_of_one_pixel_between_near_geometry_and_an_image_of_it_is_no_sky() {
    let mut ldi = image("frontal");
    ldi.sky.fill(u64::MAX);
    let height = CAMERA.height as usize;
    for (disparity, gap, source) in
        [(0.102, 1, Source::Far), (0.098, 1, Source::Near), (0.15, 1, Source::Sky), (0.102, 2, Source::Sky)]
    {
        let mut picture = warped(&ldi, &ahead());
        picture.packed.iter_mut().enumerate().filter(|(at, _)| at % 160 < 80 + gap).for_each(|(_, p)| *p = 0);
        let mut frame = half_near(disparity);
        let far = Far::Images { picture: &picture, images: &[as_planned(&ldi)], sky: None };
        let stats = composite(&mut frame, far, &ahead(), &CAMERA, &CompositeOptions::default());
        for at in (0..frame.len()).filter(|at| (80..80 + gap).contains(&(at % 160))) {
            assert_eq!(frame.source[at], source, "near at {disparity}, gap of {gap}");
            let side = if source == Source::Near { at - 1 } else { at + 1 };
            let pixel = |at: usize| (frame.colour[at], frame.disparity[at]);
            assert!(source == Source::Sky || pixel(at) == pixel(side));
        }
        let count = |source| frame.count(source) as u64;
        let counted =
            CompositeStats { near: count(Source::Near), far: count(Source::Far), sky: count(Source::Sky), ..stats };
        assert_eq!(stats, counted);
        assert_eq!((stats.near + stats.far + stats.sky, stats.unpainted), (stats.pixels, 0));
        assert!(stats.far >= 78 * height as u64);
    }
}

/// A rug lies millimetres above its floor, and both are steep: less than half a pixel's slope
/// apart.
#[test]
fn steep_surfaces_get_no_more_tolerance_than_the_step() {
    let ldi = image("slanted");
    let pose = ahead();
    let picture = warped(&ldi, &pose);
    let at = 60 * 160 + 40;
    let here = picture.get(at).unwrap().1;
    let slope = (picture.get(at + 1).unwrap().1 - here).abs();
    assert!(slope > 1e-5);
    for (share, near_wins) in [(-0.1, true), (0.05, false), (0.4, false), (0.7, false)] {
        let (frame, _) = with_step(&ldi, 1e-9, here - share * slope, &pose);
        assert_eq!(frame.source[at] == Source::Near, near_wins, "{share} of a pixel's slope behind");
    }
    let (frame, _) = with_step(&ldi, f64::from(slope), here - 0.4 * slope, &pose);
    assert_eq!(frame.source[at], Source::Near, "within the step");
}

#[test]
fn sky_is_looked_up_by_rotation() {
    // Above the horizon there is nothing; turning and moving keeps it that way.
    let ldi = image("floor");
    for yaw_deg in [0.0, 8.0, -11.0] {
        let pose = Pose { position: DVec3::new(0.4, 0.2, -0.3), yaw_deg, pitch_deg: 0.0 };
        let mut frame = Frame::new(CAMERA.width, CAMERA.height);
        let picture = warped(&ldi, &pose);
        let far = Far::Images { picture: &picture, images: &[as_planned(&ldi)], sky: None };
        let stats = composite(&mut frame, far, &pose, &CAMERA, &CompositeOptions::default());
        for at in (0..frame.len()).filter(|at| at / 160 < 59) {
            assert_eq!((frame.source[at], frame.colour[at]), (Source::Sky, SKY));
        }
        assert_eq!(stats.unpainted, 0);
        assert!(stats.sky >= 160 * 59 && stats.far > 160 * 50);
    }
}

#[test]
fn outside_the_image_is_sky_and_a_missing_image_is_not() {
    let ldi = image("frontal");
    let back = Pose { yaw_deg: 180.0, ..ahead() };
    let (frame, _) = near_after(&ldi, 1.0, &back);
    assert_eq!(frame.count(Source::Sky), frame.len() / 2);
    let options = CompositeOptions::default();
    // A window that reaches farther right than the image: nobody looked there, so it is not known
    // to be sky.
    let mut narrow = ldi.clone();
    narrow.layers.clear();
    narrow.camera.width /= 2;
    narrow.sky = vec![u64::MAX; narrow.sky_words_per_row() * narrow.camera.height as usize];
    let picture = FarFrame::new(CAMERA.width, CAMERA.height);
    let mut frame = Frame::new(CAMERA.width, CAMERA.height);
    let images = [FarImage::Here(&narrow, window(&ldi))];
    let far = Far::Images { picture: &picture, images: &images, sky: None };
    composite(&mut frame, far, &ahead(), &CAMERA, &CompositeOptions { fill: Fill::Off, ..options });
    for at in 0..frame.len() {
        let want = if at % 160 < 80 { Source::Sky } else { Source::Unpainted };
        assert_eq!(frame.source[at], want, "column {}", at % 160);
    }
    for (far, source) in [(Far::Nothing, Source::Sky), (Far::Missing, Source::Unpainted)] {
        let mut frame = half_near(1.0);
        let stats = composite(&mut frame, far, &ahead(), &CAMERA, &options);
        assert_eq!(frame.count(source), frame.len() / 2);
        assert_eq!(stats.unpainted, if source == Source::Sky { 0 } else { frame.len() as u64 / 2 });
    }
}

#[test]
fn holes_take_the_farther_neighbour() {
    let mut frame = Frame::new(9, 1);
    let mut put = |at: usize, grey: u8, disparity: f32, source| {
        frame.colour[at] = pack_rgb([grey; 3]);
        frame.disparity[at] = disparity;
        frame.source[at] = source;
    };
    put(0, 10, 0.5, Source::Far);
    put(3, 20, 0.1, Source::Far);
    put(6, 198, 0.0, Source::Sky);
    put(8, 30, 0.2, Source::Near);
    assert_eq!(hole_fill::fill(&mut frame), 5);
    let grey: Vec<u32> = frame.colour.iter().map(|c| c & 255).collect();
    // Between 0 and 3 the farther; between 3 and sky the surface; right of the sky the triangle.
    assert_eq!(grey, [10, 20, 20, 20, 20, 20, 198, 30, 30]);
    assert_eq!(frame.count(Source::Filled), 5);
    // Nothing to fill from.
    assert_eq!(hole_fill::fill(&mut Frame::new(3, 3)), 0);
}

#[test]
fn a_hole_amid_sky_is_sky() {
    // Rows: sky, hole, surface; the hole's ends are sky and a surface.
    for (right, expected) in [(Source::Sky, SKY), (Source::Near, pack_rgb([30; 3]))] {
        let mut frame = Frame::new(3, 3);
        frame.colour.fill(pack_rgb([30; 3]));
        frame.disparity.fill(0.2);
        frame
            .source
            .copy_from_slice(&[[Source::Sky; 3], [Source::Near, Source::Unpainted, right], [Source::Near; 3]].concat());
        assert_eq!(hole_fill::fill(&mut frame), 1);
        assert_eq!((frame.colour[4], frame.source[4]), (expected, Source::Filled));
    }
}

#[test]
fn a_hole_behind_a_sphere_is_filled_with_the_wall() {
    // One layer only, so that the wall behind the sphere is unknown.
    let s = scene("sphere");
    let ldi = s.ldi(ldi_camera(DVec3::ZERO, 320, 240, 90.0), 1);
    let pose = Pose { position: DVec3::new(1.0, 0.0, 0.0), ..ahead() };
    let picture = warped(&ldi, &pose);
    let far = Far::Images { picture: &picture, images: &[as_planned(&ldi)], sky: None };
    let last = vec![pack_rgb([1, 2, 3]); 160 * 120];
    let run = |fill: Fill, last: &[u32]| {
        let mut frame = Frame::new(CAMERA.width, CAMERA.height);
        let options = CompositeOptions { fill, last, ..CompositeOptions::default() };
        let stats = composite(&mut frame, far, &pose, &CAMERA, &options);
        (frame, stats)
    };
    let (_, without) = run(Fill::Off, &[]);
    let (frame, with) = run(Fill::Surface, &[]);
    assert!(without.hole_before_fill > 50 && without.unpainted == without.hole_before_fill && without.filled == 0);
    assert_eq!(
        (with.hole_before_fill, with.filled, with.unpainted),
        (without.hole_before_fill, without.hole_before_fill, 0)
    );
    for at in (0..frame.len()).filter(|at| frame.source[*at] == Source::Filled) {
        assert!((frame.disparity[at] - 0.05).abs() < 1e-3, "the wall is at 20 m");
    }
    let (over, stats) = run(Fill::Last, &last);
    assert_eq!((stats.filled, stats.unpainted), (without.hole_before_fill, 0));
    for at in 0..frame.len() {
        assert_eq!(frame.source[at] == Source::Filled, over.colour[at] == last[at], "holes alone show the last frame");
    }
    let (_, none) = run(Fill::Last, &last[1..]);
    assert_eq!(none.unpainted, without.hole_before_fill, "a frame of another size is none");
}

#[test]
fn a_picture_that_is_mostly_holes_is_not_invented() {
    let ldi = image("frontal");
    let run = |columns: usize| {
        // The warp reached only the first columns.
        let mut picture = warped(&ldi, &ahead());
        picture.packed.iter_mut().enumerate().filter(|(at, _)| at % 160 >= columns).for_each(|(_, p)| *p = 0);
        let mut frame = Frame::new(CAMERA.width, CAMERA.height);
        let far = Far::Images { picture: &picture, images: &[as_planned(&ldi)], sky: None };
        composite(&mut frame, far, &ahead(), &CAMERA, &CompositeOptions::default())
    };
    let (few, many) = (run(130), run(60));
    assert_eq!((few.filled, few.unpainted), (30 * 120, 0));
    assert_eq!((many.filled, many.unpainted), (0, 100 * 120));
}

#[test]
fn smoothing_keeps_edges_and_flat_colour() {
    let mut frame = Frame::new(6, 6);
    for at in 0..36 {
        let right = at % 6 >= 3;
        frame.colour[at] = pack_rgb(if right { [200; 3] } else { [20; 3] });
        frame.disparity[at] = if right { 0.2 } else { 0.1 };
        frame.source[at] = Source::Far;
    }
    let before = frame.clone();
    smooth::smooth(&mut frame);
    assert_eq!(frame, before, "different surfaces do not mix");
    frame.disparity.fill(0.1);
    smooth::smooth(&mut frame);
    assert_ne!(frame, before, "one surface does");
    assert_eq!((frame.colour[0], frame.colour[5]), (before.colour[0], before.colour[5]));
}

#[test]
fn downsampling_equals_the_definition() {
    let mut frame = Frame::new(34, 18);
    let mut state = 7u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 8
    };
    for at in 0..frame.len() {
        frame.colour[at] = if random() % 3 == 0 { 0x10_20_30 } else { random() & 0xff_ffff };
        frame.disparity[at] = (random() % 1000) as f32 * 1e-3;
        frame.source[at] =
            [Source::Sky, Source::Near, Source::Far, Source::Filled, Source::Unpainted][random() as usize % 5];
    }
    let (mut fast, mut slow) = (Frame::default(), Frame::default());
    for factor in [1, 2, 3] {
        downsample(&frame, factor, &mut fast);
        frame.resolve(factor, &mut slow);
        assert_eq!(fast, slow, "factor {factor}");
    }
    frame.colour[5] ^= 0x40;
    downsample(&frame, 2, &mut fast);
    frame.colour[5] ^= 0x40;
    frame.resolve(2, &mut slow);
    assert_ne!(fast, slow);
}

#[test]
fn what_an_absent_image_would_show_is_unknown_and_the_rest_sky() {
    let entry = ImageEntry {
        basis: ViewBasis::from_yaw_pitch(0.0, 0.0),
        plane_distance: 5.0,
        window: [-0.2, 0.3, -0.1, 0.2],
        stretch_p99_px: f64::NAN,
        chunks: vec![0],
        samples_by_layer: vec![1],
    };
    let picture = FarFrame::new(CAMERA.width, CAMERA.height);
    let mut frame = Frame::new(CAMERA.width, CAMERA.height);
    let far = Far::Images { picture: &picture, images: &[FarImage::Absent(&entry)], sky: None };
    composite(&mut frame, far, &ahead(), &CAMERA, &CompositeOptions::default());
    let f = CAMERA.focal_px();
    for at in 0..frame.len() {
        let (x, y) = (((at % 160) as f64 + 0.5 - 80.0) / f, (60.0 - (at / 160) as f64 - 0.5) / f);
        let inside = (-0.2..=0.3).contains(&x) && (-0.1..=0.2).contains(&y);
        assert_eq!(frame.source[at], if inside { Source::Unpainted } else { Source::Sky }, "({x}, {y})");
    }
}

/// Windows of faces overlap: far places belong to one of them, and the other says nothing of them.
#[test]
fn sky_that_one_image_knows_is_sky_unless_one_is_missing() {
    let mut knowing = image("frontal");
    knowing.layers.clear();
    let mut silent = knowing.clone();
    knowing.sky.fill(u64::MAX);
    silent.sky.fill(0);
    let window = as_planned(&knowing);
    let FarImage::Here(_, tangents) = window else { panic!("it is here") };
    let entry = ImageEntry {
        basis: ViewBasis::from_yaw_pitch(0.0, 0.0),
        plane_distance: 5.0,
        window: tangents,
        stretch_p99_px: f64::NAN,
        chunks: vec![0],
        samples_by_layer: vec![1],
    };
    let picture = FarFrame::new(CAMERA.width, CAMERA.height);
    for (images, sky) in [
        ([window, as_planned(&silent)], true),
        ([as_planned(&silent), window], true),
        ([as_planned(&silent), as_planned(&silent)], false),
        ([window, FarImage::Absent(&entry)], false),
    ] {
        let mut frame = Frame::new(CAMERA.width, CAMERA.height);
        composite(
            &mut frame,
            Far::Images { picture: &picture, images: &images, sky: None },
            &ahead(),
            &CAMERA,
            &CompositeOptions::default(),
        );
        let middle = frame.source[frame.len() / 2 + 80];
        assert_eq!(middle, if sky { Source::Sky } else { Source::Unpainted });
    }
}

/// Directions that no image holds: sky where the placement's map says so, and nowhere else.
#[test]
fn sky_beside_the_images_is_sky() {
    let mut silent = image("frontal");
    silent.sky.fill(0);
    let picture = FarFrame::new(CAMERA.width, CAMERA.height);
    let mut squares = vec![false; SkyMap::SQUARES as usize];
    let right = |column: usize| column >= 80;
    for (row, column) in (0..120).flat_map(|r| (0..160).map(move |c| (r, c))).filter(|(_, c)| right(*c)) {
        let at = (f64::from(column as u32) + 0.5, f64::from(row as u32) + 0.5);
        squares[SkyMap::square(CAMERA.ray(&ahead().basis(), at.0, at.1)) as usize] = true;
    }
    let map = SkyMap::of(&squares);
    for (sky, expected) in [(None, [false, false]), (Some(&map), [false, true])] {
        let mut frame = Frame::new(CAMERA.width, CAMERA.height);
        let far = Far::Images { picture: &picture, images: &[as_planned(&silent)], sky };
        let options = CompositeOptions { fill: Fill::Off, ..CompositeOptions::default() };
        composite(&mut frame, far, &ahead(), &CAMERA, &options);
        for (at, source) in frame.source.iter().enumerate() {
            let known = expected[usize::from(right(at % 160))];
            assert_eq!(*source, if known { Source::Sky } else { Source::Unpainted }, "{at}");
        }
    }
}

/// Two halves of an image that overlap by two pixels each way, as tiles do, draw what the whole
/// draws.
#[test]
fn tiles_join_without_a_seam() {
    let whole = ldi_camera(DVec3::ZERO, 320, 240, 90.0);
    let left = LdiCamera { width: 162, ..whole };
    let right = LdiCamera { left: whole.left + 158, width: 162, ..whole };
    for name in ["frontal", "floor"] {
        let pose = Pose { position: DVec3::new(0.5, 0.3, -0.8), yaw_deg: 4.0, pitch_deg: -3.0 };
        let scene = scene(name);
        let (whole, tiles) = (scene.ldi(whole, 3), [scene.ldi(left, 3), scene.ldi(right, 3)]);
        let mut picture = warped(&tiles[0], &pose);
        let untouched = picture.packed.clone();
        picture.take_nearer(&warped(&tiles[1], &pose));
        assert_ne!(picture.packed, untouched);
        let draw = |picture: &FarFrame, images: &[FarImage<'_>]| {
            let mut frame = Frame::new(CAMERA.width, CAMERA.height);
            let far = Far::Images { picture, images, sky: None };
            composite(
                &mut frame,
                far,
                &pose,
                &CAMERA,
                &CompositeOptions { fill: Fill::Off, ..CompositeOptions::default() },
            );
            frame
        };
        let one = draw(&warped(&whole, &pose), &[as_planned(&whole)]);
        let two = draw(&picture, &tiles.each_ref().map(as_planned));
        assert!(one.count(Source::Far) > 5000);
        assert_eq!(one.source, two.source, "{name}");
        // Where both halves hold a surface their borders may round differently.
        let differing = one.colour.iter().zip(&two.colour).filter(|(a, b)| a != b).count();
        assert!(differing <= 2 * CAMERA.height as usize, "{name}: {differing} pixels differ");
    }
}

/// A portal's images answer for what is seen through it; beside it there is sky if all else was
/// drawn, and nothing is known if not.
#[test]
fn a_portal_answers_for_its_cone_alone() {
    let mut silent = image("frontal");
    silent.sky.fill(0);
    let picture = FarFrame::new(CAMERA.width, CAMERA.height);
    let nowhere = SkyMap::default();
    let everywhere = SkyMap::of(&vec![true; SkyMap::SQUARES as usize]);
    // The right half of the picture: a cone between its middle, its right border and beyond above
    // and below.
    let b = ahead().basis();
    let cone =
        Cone { apex: DVec3::ZERO, edges: vec![], normals: vec![b.right, (b.forward - b.right).normalize(), b.forward] };
    let cones = [cone];
    for (sky, complete, expected) in [
        (&nowhere, true, [Source::Sky, Source::Unpainted]),
        (&nowhere, false, [Source::Unpainted, Source::Unpainted]),
        (&everywhere, true, [Source::Sky, Source::Sky]),
        (&everywhere, false, [Source::Unpainted, Source::Sky]),
    ] {
        let mut frame = Frame::new(CAMERA.width, CAMERA.height);
        let images = [as_planned(&silent)];
        let portals = [FarPortal { cones: &cones, images: &images, sky }];
        let far = Far::Portals { picture: &picture, portals: &portals, complete };
        let options = CompositeOptions { fill: Fill::Off, ..CompositeOptions::default() };
        composite(&mut frame, far, &ahead(), &CAMERA, &options);
        for (at, source) in frame.source.iter().enumerate() {
            assert_eq!(*source, expected[usize::from(at % 160 >= 80)], "{at}, complete: {complete}");
        }
    }
}
