//! The card's pictures against the processor's, on whatever adapter there is; a software one will
//! do.

use super::*;
use crate::{
    composite::{CompositeOptions, Far, FarImage, Fill, code_steps, downsample, finish, merge},
    frame::{Source, pack_rgb, unpack_rgb},
    near::Rasterizer,
    test_support::{Memory, dataset, plain_material, quad_cluster},
    warp::{ImageInView, Order, Stamp, analytic, warp_images},
};
use glam::{DAffine3, DVec3, Vec3};
use ldi_protocol::{
    mesh::{Alpha, CellGeometry, Material, Wrap},
    texture::{MipLevel, Texture},
};
use std::sync::Arc;

/// The bound on the difference of a card's and the processor's pictures.
const ALIKE_DB: f64 = 45.0;
const CAMERA: OutputCamera = OutputCamera { width: 320, height: 200, fov_deg: 70.0 };

/// A card, or None with the reason on the screen where this machine has none that could.
fn card(atomics: Atomics) -> Option<Gpu> {
    match Gpu::open_with(atomics) {
        Err(e @ (GpuError::NoAdapter(_) | GpuError::Lacking { .. })) => {
            eprintln!("SKIPPED: {e}");
            None
        }
        opened => Some(opened.expect("an adapter that draws")),
    }
}

fn validate(source: &str, capabilities: naga::valid::Capabilities) -> Result<usize, String> {
    let module = naga::front::wgsl::parse_str(source).map_err(|e| e.emit_to_string(source))?;
    let mut validator = naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities);
    validator.validate(&module).map(|_| module.entry_points.len()).map_err(|e| format!("{e:?}"))
}

#[test]
fn the_shaders_are_valid() {
    use naga::valid::Capabilities as C;
    assert_eq!(validate(include_str!("near.wgsl"), C::empty()), Ok(3));
    let with = |keep: &str| format!("{}\n{keep}", include_str!("warp.wgsl"));
    for keep in [include_str!("nearest_depth.wgsl"), include_str!("nearest_colour.wgsl")] {
        assert_eq!(validate(&with(keep), C::empty()), Ok(1));
    }
    let wide = with(include_str!("nearest_wide.wgsl"));
    assert_eq!(validate(&wide, C::SHADER_INT64 | C::SHADER_INT64_ATOMIC_MIN_MAX), Ok(1));
    assert!(validate(&wide, C::empty()).is_err(), "what a card must have for it is asked for");
    assert_eq!(validate(include_str!("composite.wgsl"), C::empty()), Ok(5));
    assert_eq!(validate(include_str!("depth_shading.wgsl"), C::empty()), Ok(3));
}

/// PSNR of two pictures' colours, dB.
fn psnr_db(a: &[u32], b: &[u32]) -> f64 {
    assert_eq!(a.len(), b.len());
    let error = |(a, b): (&u32, &u32)| -> u64 {
        unpack_rgb(*a).iter().zip(unpack_rgb(*b)).map(|(x, y)| u64::from(x.abs_diff(y)).pow(2)).sum()
    };
    let sum: u64 = a.iter().zip(b).map(error).sum();
    if sum == 0 { f64::INFINITY } else { 10.0 * (255.0f64.powi(2) * 3.0 * a.len() as f64 / sum as f64).log10() }
}

/// Shares of pixels where one picture has something and the other nothing.
fn disagree(a: &Frame, b: &Frame) -> f64 {
    let n = a.source.iter().zip(&b.source).filter(|(a, b)| a != b).count();
    n as f64 / a.len() as f64
}

/// Pixels whose disparities differ by more than rounding and places of corners explain; alpha tests
/// and edges may differ in single ones.
///
/// Cards round corners to a 256th of a pixel. Some lay the plane of depths through the rounded
/// corners, others, and the processor, through the exact ones: up to a 512th of what disparity
/// changes by from pixel to pixel, along each axis.
fn far_off(a: &Frame, b: &Frame) -> usize {
    let (width, d) = (a.width as usize, &a.disparity);
    // The smaller of the changes to both sides, where there are both: the other one may lead over
    // an edge.
    let step = |at: usize, apart: usize| {
        let changes = [at.checked_sub(apart), Some(at + apart)].map(|o| Some((d[at] - d.get(o?)?).abs()));
        changes.into_iter().flatten().fold(f32::INFINITY, f32::min)
    };
    let differs = |at: &usize| {
        let allowed = 1e-5 * d[*at].max(b.disparity[*at]) + (step(*at, 1) + step(*at, width)) / 256.0;
        (d[*at] - b.disparity[*at]).abs() > allowed
    };
    (0..a.len()).filter(differs).count()
}

/// Blobs of colour and alpha on an odd-sized texture, with its mip levels.
fn texture() -> Texture {
    let (width, height) = (93u32, 70u32);
    let rgba = (0..width * height)
        .map(|i| {
            let (x, y) = ((i % width) as f32, (i / width) as f32);
            let wave = |a: f32, b: f32| (((x * a).sin() * (y * b).cos() * 0.5 + 0.5) * 255.0) as u8;
            [wave(0.21, 0.13), wave(0.1, 0.32), wave(0.05, 0.07), wave(0.15, 0.11)]
        })
        .collect();
    Texture::from_base(MipLevel { width, height, rgba }, true)
}

/// Textured, masked, lit, coloured and absent things, some turned and scaled, `far_m` metres from
/// the world's origin along each axis.
fn scene(far_m: f64) -> (Index, Memory) {
    let at = DVec3::splat(far_m);
    let lit = Material { unlit: false, base_colour: [0.9, 0.5, 0.3, 1.0], ..plain_material() };
    let textured = Material { texture: Some(0), unlit: false, ..plain_material() };
    let masked =
        Material { texture: Some(0), alpha: Alpha::Mask(0.5), wrap: [Wrap::Mirror, Wrap::Clamp], ..plain_material() };
    let absent = Material { texture: Some(1), ..plain_material() };
    let wall = |m: u32, x: f32, y: f32, z: f32, half: f32| {
        let mut c = quad_cluster(
            m,
            [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[a, b]| Vec3::new(x + a * half, y + b * half, z)),
        );
        c.uvs.iter_mut().for_each(|t| *t = *t * 2.5 - 0.7);
        c
    };
    let mut floor = quad_cluster(
        0,
        [[-30.0, -30.0], [30.0, -30.0], [30.0, 30.0], [-30.0, 30.0]].map(|[a, b]| Vec3::new(a, -1.5, b)),
    );
    floor.colours = vec![[1.0, 0.2, 0.2], [0.2, 1.0, 0.2], [0.2, 0.2, 1.0], [1.0; 3]];
    let mut ball = quad_cluster(0, [Vec3::ZERO; 4]);
    let on_ball = |i: usize, j: usize| {
        let (a, b) = (i as f32 * std::f32::consts::TAU / 12.0, j as f32 * std::f32::consts::PI / 8.0);
        Vec3::new(a.cos() * b.sin(), b.cos(), a.sin() * b.sin())
    };
    (ball.positions, ball.uvs) = ((0..9 * 13).map(|k| on_ball(k % 13, k / 13)).collect(), Vec::new());
    ball.normals = ball.positions.clone();
    let corner = |i: usize, j: usize| (j * 13 + i) as u16;
    ball.triangles = (0..12 * 8)
        .flat_map(|k| {
            let (i, j) = (k % 12, k / 12);
            let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect();
    let mut clusters = vec![
        floor,
        ball,
        wall(1, -2.0, 0.5, -6.0, 1.5),
        wall(2, 0.8, 0.0, -4.0, 1.2),
        wall(3, 3.0, 1.0, -9.0, 2.0),
        wall(1, 0.0, 3.0, -40.0, 12.0),
    ];
    clusters.iter_mut().for_each(|c| c.origin = DVec3::new(0.0, 0.0, 0.25));
    let (index, mut memory) = dataset(CAMERA, vec![lit, textured, masked, absent], clusters);
    memory.textures.insert(0, Arc::new(texture()));
    for (number, cell) in &mut memory.cells {
        let mut moved: CellGeometry = (**cell).clone();
        let turned = match number {
            1 => DAffine3::from_scale_rotation_translation(
                DVec3::new(1.0, 0.6, 1.4),
                glam::DQuat::from_rotation_y(0.7),
                DVec3::new(0.5, 0.2, -7.0),
            ),
            _ => DAffine3::IDENTITY,
        };
        moved.instances[0].world_from_mesh = DAffine3::from_translation(at) * turned;
        *cell = Arc::new(moved);
    }
    (index, memory)
}

fn poses(far_m: f64) -> Vec<Pose> {
    let from = |x: f64, y: f64, z: f64, yaw_deg: f64, pitch_deg: f64| Pose {
        position: DVec3::splat(far_m) + DVec3::new(x, y, z),
        yaw_deg,
        pitch_deg,
    };
    vec![from(0.0, 0.1, 0.0, 0.0, 0.0), from(0.7, -0.4, -1.0, 18.0, -24.0), from(-1.1, 0.3, -2.2, -31.0, 9.0)]
}

fn drawn(gpu: &mut Gpu, index: &Index, memory: &Memory, pose: &Pose) -> (Frame, NearStats) {
    let cells = DrawnCell::all_full(0..index.cells.len() as u32);
    let mut frame = Frame::default();
    let stats = gpu.draw(index, memory, &cells, &CAMERA, pose).expect("drawn");
    gpu.read_near(&CAMERA, &mut frame).expect("read back");
    (frame, stats)
}

#[test]
fn near_geometry_is_the_processors() {
    let Some(mut gpu) = card(Atomics::Best) else { return };
    let (index, memory) = scene(0.0);
    let cells = DrawnCell::all_full(0..index.cells.len() as u32);
    let mut rasterizer = Rasterizer::default();
    let mut worst = f64::INFINITY;
    for pose in poses(0.0) {
        let (on_card, stats) = drawn(&mut gpu, &index, &memory, &pose);
        let mut frame = Frame::default();
        assert_eq!(rasterizer.draw(&index, &memory, &cells, &CAMERA, &pose, &mut frame), stats);
        assert_eq!(stats.missing_textures, [1]);
        let near = frame.count(Source::Near);
        assert!(near > frame.len() / 3 && near < frame.len(), "{near}: surfaces and sky");
        let db = psnr_db(&frame.colour, &on_card.colour);
        assert!(db >= ALIKE_DB, "{pose:?}: {db} dB");
        assert!(disagree(&frame, &on_card) < 1e-3, "{}", disagree(&frame, &on_card));
        let off = far_off(&frame, &on_card);
        assert!((off as f64) < 1e-3 * frame.len() as f64, "{pose:?}: {off} pixels");
        worst = worst.min(db);
        // The comparison can fail: the same from a third of a pixel beside.
        let beside = Pose { yaw_deg: pose.yaw_deg + 0.07, ..pose };
        let other = drawn(&mut gpu, &index, &memory, &beside).0;
        assert!(psnr_db(&frame.colour, &other.colour) < ALIKE_DB);
        let nearer = Pose { position: pose.position + DVec3::splat(0.002), ..pose };
        let off = far_off(&frame, &drawn(&mut gpu, &index, &memory, &nearer).0);
        assert!(off > near / 2, "{off} of {near}");
    }
    println!("{}: near geometry at least {worst:.1} dB alike", gpu.adapter());
}

#[test]
fn far_from_the_worlds_origin_it_looks_the_same() {
    let Some(mut gpu) = card(Atomics::Best) else { return };
    for far_m in [1e6, 1e7] {
        // Whole numbers of these sizes are exact in f64.
        let (here, there) = (scene(0.0), scene(far_m));
        for (a, b) in poses(0.0).iter().zip(poses(far_m)) {
            let (a, b) = (drawn(&mut gpu, &here.0, &here.1, a).0, drawn(&mut gpu, &there.0, &there.1, &b).0);
            let db = psnr_db(&a.colour, &b.colour);
            assert!(db >= ALIKE_DB, "{far_m} m away: {db} dB");
        }
    }
}

#[test]
fn finer_levels_replace_coarser_ones() {
    let Some(mut gpu) = card(Atomics::Best) else { return };
    let (index, mut memory) = scene(0.0);
    let whole = memory.textures[&0].clone();
    let mut coarse = (*whole).clone();
    coarse.levels[..3].fill(None);
    let cells = DrawnCell::all_full(0..index.cells.len() as u32);
    let (pose, mut pictures) = (poses(0.0)[0], Vec::new());
    for texture in [Arc::new(coarse), whole] {
        memory.textures.insert(0, texture);
        let (on_card, stats) = drawn(&mut gpu, &index, &memory, &pose);
        let mut frame = Frame::default();
        assert_eq!(Rasterizer::default().draw(&index, &memory, &cells, &CAMERA, &pose, &mut frame), stats);
        let db = psnr_db(&frame.colour, &on_card.colour);
        assert!(db >= ALIKE_DB, "{db} dB with {} levels", stats.coarse_textures.len());
        pictures.push(on_card);
    }
    assert!(psnr_db(&pictures[0].colour, &pictures[1].colour) < ALIKE_DB, "levels make a difference");
}

fn image(name: &str, side: u32) -> PreparedLdi {
    PreparedLdi::new(&analytic::scene(name).ldi(analytic::ldi_camera(DVec3::ZERO, side, side, 80.0), 3))
}

fn warped(gpu: &mut Gpu, images: &[&PreparedLdi], pose: &Pose, stamp: Stamp) -> (FarFrame, WarpStats) {
    let images: Vec<ImageInView<'_>> = images.iter().map(|i| ImageInView::from(*i)).collect();
    let mut far = FarFrame::new(CAMERA.width, CAMERA.height);
    let options = WarpOptions { stamp, ..WarpOptions::default() };
    let stats = gpu.warp_images(&images, pose, &CAMERA, &options).expect("warped");
    gpu.read_warped(&mut far).expect("read back");
    (far, stats)
}

/// Colours of a far picture, black where nothing is.
fn colours(far: &FarFrame) -> Vec<u32> {
    far.packed.iter().map(|p| *p as u32).collect()
}

#[test]
fn warped_images_are_the_processors() {
    for atomics in [Atomics::Wide, Atomics::Narrow] {
        let Some(mut gpu) = card(atomics) else { continue };
        let mut worst = f64::INFINITY;
        for name in ["frontal", "slanted", "sphere", "fence", "floor"] {
            let laid_out = image(name, 384);
            for pose in poses(0.0) {
                for stamp in [Stamp::Quads, Stamp::OnePixel, Stamp::TwoByTwo, Stamp::Cross, Stamp::ThreeByThree] {
                    let (far, stats) = warped(&mut gpu, &[&laid_out], &pose, stamp);
                    let mut expected = FarFrame::new(CAMERA.width, CAMERA.height);
                    // The card's own depth test leaves out what is hidden.
                    let options = WarpOptions { stamp, keep_hidden: true, ..WarpOptions::default() };
                    let of_processor = warp_images(
                        &[ImageInView::from(&laid_out)],
                        &[],
                        &pose,
                        &CAMERA,
                        &options,
                        &mut expected,
                        &mut FarFrame::default(),
                    )
                    .expect("by depth");
                    assert!(of_processor.samples_warped > 1000, "{name}: something is seen");
                    let counts = |s: &WarpStats| (s.samples, s.samples_warped, s.samples_culled, s.primitives, s.bytes);
                    assert_eq!(counts(&stats), counts(&of_processor));
                    let footprints = (stats.footprint_max_px, of_processor.footprint_max_px);
                    assert!(
                        (footprints.0 - footprints.1).abs() < 1e-3 * footprints.1,
                        "{name} {stamp}: {footprints:?}"
                    );
                    // One sample on the other side of a pixel's border moves a whole stamp; a
                    // quad's pixels hardly change.
                    let lost =
                        far.packed.iter().zip(&expected.packed).filter(|(a, b)| (**a == 0) != (**b == 0)).count();
                    assert!((lost as f64) < 1e-3 * far.packed.len() as f64, "{name} {stamp}: {lost} pixels");
                    if stamp == Stamp::Quads {
                        let db = psnr_db(&colours(&far), &colours(&expected));
                        assert!(db >= ALIKE_DB, "{name} {stamp}: {db} dB");
                        worst = worst.min(db);
                        let (p, q) = (stats.stretch.quantile_px(0.99), of_processor.stretch.quantile_px(0.99));
                        assert!((p - q).abs() <= 0.25, "{name}: {p} {q}");
                    }
                }
            }
        }
        println!("{} {atomics:?}: warped images at least {worst:.1} dB alike", gpu.adapter());
    }
}

#[test]
fn both_ways_to_keep_the_nearest_sample_give_the_same_picture() {
    let (Some(mut wide), Some(mut narrow)) = (card(Atomics::Wide), card(Atomics::Narrow)) else { return };
    assert_eq!((wide.atomics(), narrow.atomics()), (Atomics::Wide, Atomics::Narrow));
    let (a, b) = (image("sphere", 256), image("fence", 200));
    for pose in poses(0.0) {
        for stamp in [Stamp::Quads, Stamp::ThreeByThree] {
            let images = [&a, &b];
            let (one, two) = (warped(&mut wide, &images, &pose, stamp), warped(&mut narrow, &images, &pose, stamp));
            assert!(one.0.painted() > 10_000);
            assert_eq!(one, two, "{stamp}");
        }
    }
}

/// What stands in for the tree: every seventh pixel that nothing reached, and none of the leftmost
/// columns, which stay for the fill.
fn lay_some(frame: &mut Frame) -> u64 {
    let open = |frame: &Frame, at: usize| frame.source[at] == Source::Unpainted && at as u32 % frame.width > 40;
    let given: Vec<usize> = (0..frame.len()).filter(|at| at % 7 == 0 && open(frame, *at)).collect();
    for at in &given {
        frame.colour[*at] = pack_rgb([*at as u8, 200, 30]);
        (frame.disparity[*at], frame.source[*at]) = (1.0 / 3.0 + (*at % 5) as f32, Source::Tree);
    }
    given.len() as u64
}

#[test]
fn what_the_card_joins_is_what_the_processor_joins() {
    for atomics in [Atomics::Wide, Atomics::Narrow] {
        let Some(mut gpu) = card(atomics) else { continue };
        let (index, memory) = scene(0.0);
        let cells = DrawnCell::all_full(0..index.cells.len() as u32);
        let mut ldi = analytic::scene("slanted").ldi(analytic::ldi_camera(DVec3::ZERO, 96, 64, 40.0), 3);
        let laid_out = PreparedLdi::new(&ldi);
        // Coarser than it is, so that near geometry often lies within a step.
        ldi.codes.step = 0.1;
        let shown = [FarImage::Here(&ldi, [-0.7, 0.7, -0.5, 0.5])];
        // Whether near wins by a step, whether seams, sky and holes are there: each has to happen
        // somewhere.
        let (mut by_step, mut seams, mut sky, mut filled_in_all, mut from_tree) = (0, 0, 0, 0, 0);
        for (number, pose) in poses(0.0).into_iter().enumerate() {
            for (warped, drawn) in [(true, true), (true, false), (false, true)] {
                let cells = if drawn { &cells[..] } else { &[] };
                // Of every other pose samples as small as a pixel, between which the picture has
                // gaps.
                let stamp = if number % 2 == 0 { Stamp::OnePixel } else { Stamp::default() };
                let options = WarpOptions { stamp, ..WarpOptions::default() };
                gpu.draw(&index, &memory, cells, &CAMERA, &pose).expect("drawn");
                let mut frame = Frame::default();
                gpu.read_near(&CAMERA, &mut frame).expect("read back");
                let mut picture = FarFrame::new(CAMERA.width, CAMERA.height);
                if warped {
                    gpu.warp_images(&[ImageInView::from(&laid_out)], &pose, &CAMERA, &options).expect("warped");
                    gpu.read_warped(&mut picture).expect("read back");
                }
                let untouched = FarFrame::new(CAMERA.width, CAMERA.height);
                let far = |picture| match warped {
                    true => Far::Images { picture, images: &shown, sky: None },
                    false => Far::Nothing,
                };
                let steps = code_steps(if warped { &shown } else { &[] }, &pose, &CAMERA);
                assert_eq!(steps.len(), usize::from(warped));
                for (factor, fill) in [(1, true), (2, true), (2, false)] {
                    // The processor.
                    let mut full = frame.clone();
                    let mut stats = merge(&mut full, far(&picture), &pose, &CAMERA);
                    by_step += (0..full.len())
                        .filter(|at| full.source[*at] == Source::Near)
                        .filter(|at| picture.get(*at).is_some_and(|(_, far)| far > full.disparity[*at]))
                        .count();
                    seams += (0..full.len())
                        .filter(|at| matches!(full.source[*at], Source::Near | Source::Far))
                        .filter(|at| frame.source[*at] == Source::Unpainted && picture.get(*at).is_none())
                        .count();
                    stats.unpainted -= lay_some(&mut full);
                    let settings = if fill { Fill::Surface } else { Fill::Off };
                    finish(&mut full, true, &mut stats, &CompositeOptions { fill: settings, ..Default::default() });
                    let mut expected = Frame::default();
                    downsample(&full, factor, &mut expected);

                    // The card.
                    let mut open = Vec::new();
                    gpu.merge(warped, &steps, &CAMERA, &mut open).expect("merged");
                    let mut found = Frame::default();
                    found.reset_open(CAMERA.width, CAMERA.height, &open);
                    let mut stats = merge(&mut found, far(&untouched), &pose, &CAMERA);
                    sky += stats.sky;
                    let given = lay_some(&mut found);
                    (stats.unpainted, from_tree) = (stats.unpainted - given, from_tree + given);
                    let fill = fill && stats.is_worth_filling(true);
                    let mut out = Frame::default();
                    let filled = gpu
                        .finish(&open, &found, &Finishing { fill, factor, shading: None }, &mut out)
                        .expect("finished");
                    assert_eq!(filled, full.count(Source::Filled) as u64);
                    filled_in_all += filled;

                    let case = format!("{atomics:?} {number} {warped} {drawn} {factor} {fill}");
                    assert_eq!((out.width, out.height), (expected.width, expected.height), "{case}");
                    assert!(out.source == expected.source, "{case}: sources");
                    let off = |(a, b): (&u32, &u32)| {
                        let (a, b) = (unpack_rgb(*a), unpack_rgb(*b));
                        a.into_iter().zip(b).map(|(a, b)| a.abs_diff(b)).max()
                    };
                    let most = out.colour.iter().zip(&expected.colour).filter_map(off).max();
                    // Means are rounded by a table here and exactly there.
                    assert!(most <= Some(if factor == 1 { 0 } else { 1 }), "{case}: {most:?}");
                }
            }
        }
        assert!(
            by_step > 100 && seams > 1000 && sky > 1000 && filled_in_all > 1000 && from_tree > 1000,
            "{by_step} {seams} {sky} {filled_in_all} {from_tree}"
        );
        println!("{} {atomics:?}: joined alike", gpu.adapter());
    }
}

#[test]
fn pictures_larger_than_the_card_are_the_processors() {
    let Some(gpu) = card(Atomics::Best) else { return };
    let of = |width, height| OutputCamera { width, height, ..CAMERA };
    let side = gpu.card.device.limits().max_texture_dimension_2d;
    assert!(gpu.fits(&of(1920, 1080)));
    assert!(!gpu.fits(&of(side + 1, 2)));
    let rows = gpu.card.device.limits().max_storage_buffer_binding_size / u64::from(side) / 8;
    assert!(rows >= u64::from(side) || !gpu.fits(&of(side, rows as u32 + 1)));
}

#[test]
fn images_stay_on_the_card() {
    let Some(mut gpu) = card(Atomics::Best) else { return };
    let (a, b) = (image("sphere", 64), image("sphere", 64));
    let mut brought = |laid_out: &PreparedLdi| {
        let before = gpu.uploaded_bytes();
        assert!(gpu.upload_image(laid_out, &mut None, false).expect("brought"));
        gpu.uploaded_bytes() > before
    };
    assert_eq!([&a, &a, &b, &a, &b].map(&mut brought), [true, false, true, false, false], "each layout once");
}

/// Each frame sends what it may; until all is there, nothing is shown of geometry and images, and
/// small levels of a texture.
#[test]
fn what_is_large_goes_to_the_card_in_slices() {
    let Some(mut gpu) = card(Atomics::Best) else { return };
    // In so many frames, of which each sends `allowed` bytes at most, and a row.
    let mut frames = |allowed: u64, bring: &mut dyn FnMut(&mut Gpu) -> bool| {
        let mut sent = Vec::new();
        loop {
            gpu.begin_frame(allowed);
            let there = bring(&mut gpu);
            sent.push(gpu.uploaded_bytes());
            if there {
                return sent;
            }
            assert!(sent.len() < 1000, "{sent:?}");
        }
    };
    let picture = image("sphere", 64);
    let (mut whole, mut sliced) =
        (FarFrame::new(CAMERA.width, CAMERA.height), FarFrame::new(CAMERA.width, CAMERA.height));
    let sent = frames(10_000, &mut |gpu| gpu.upload_image(&picture, &mut None, false).expect("brought"));
    let bytes = Packed::new(&picture).bytes();
    assert!(sent.len() as u64 == bytes.div_ceil(10_000) && sent.iter().sum::<u64>() == bytes, "{sent:?} of {bytes}");
    let (_, memory) = scene(0.0);
    let ball = &memory.cells[&1];
    let sent = frames(1000, &mut |gpu| gpu.upload_geometry(ball, false).expect("brought"));
    assert!(sent.len() > 3 && sent.iter().all(|s| *s <= 1000), "{sent:?}");
    let (width, height) = (1000, 300);
    let rgba = (0..width * height).map(|i| [(i % 251) as u8, (i / width) as u8, 0, 255]).collect();
    let large = Arc::new(Texture::from_base(MipLevel { width, height, rgba }, false));
    let mut arrived = Vec::new();
    let sent = frames(100_000, &mut |gpu| {
        arrived.push(gpu.upload_texture(5, &large).expect("brought"));
        arrived.last() == Some(&TextureUpload::All)
    });
    // Small levels are 250 x 75 texels, a third more in all; else up to a row too many.
    assert!(sent.len() > 10 && sent.iter().all(|s| *s <= 104_000), "{sent:?}");
    assert!(arrived[..arrived.len() - 1].iter().all(|a| *a == TextureUpload::Coarse), "{arrived:?}");
    // Levels that are not as large as they say are not sent.
    let level = |width, height, texels| Some(MipLevel { width, height, rgba: vec![[0; 4]; texels] });
    let faulty = Arc::new(Texture { levels: vec![level(8, 8, 63), level(4, 4, 16), level(2, 2, 0), level(1, 1, 1)] });
    let sent = frames(1000, &mut |gpu| gpu.upload_texture(6, &faulty).expect("brought") == TextureUpload::All);
    assert_eq!(sent, [4 * (16 + 1)]);
    // What came in slices is what comes at once.
    let warp = |gpu: &mut Gpu, into: &mut FarFrame| {
        let images = [ImageInView::from(&picture)];
        gpu.warp_images(&images, &poses(0.0)[0], &CAMERA, &WarpOptions::default()).expect("warped");
        gpu.read_warped(into).expect("read");
    };
    warp(&mut gpu, &mut sliced);
    gpu.forget();
    warp(&mut gpu, &mut whole);
    assert!(whole.packed == sliced.packed && whole.packed.iter().any(|p| *p != 0));
}

/// What nobody wants any more before it is there is left; ahead comes only what has room.
#[test]
fn what_is_not_seen_yet_does_not_drive_out_what_is() {
    let Some(mut gpu) = card(Atomics::Best) else { return };
    let images: Vec<PreparedLdi> = (0..3).map(|_| image("sphere", 64)).collect();
    let bytes = Packed::new(&images[0]).bytes();
    gpu.warp.images.kept_bytes = 2 * bytes;
    let bring = |gpu: &mut Gpu, i: usize, ahead| gpu.upload_image(&images[i], &mut None, ahead).expect("brought");
    gpu.begin_frame(u64::MAX);
    assert!(bring(&mut gpu, 0, false) && bring(&mut gpu, 1, true));
    assert!(!bring(&mut gpu, 2, true), "there is no room");
    assert_eq!((gpu.held_bytes(), gpu.holds(&images[2])), (2 * bytes, false));
    gpu.begin_frame(100);
    assert!(bring(&mut gpu, 0, false));
    assert!(!bring(&mut gpu, 2, true) && gpu.uploaded_bytes() == 100, "begun instead of the one that nobody wants now");
    assert!(gpu.warp.images.has(images[2].serial));
    for _ in 0..=PATIENCE + 1 {
        gpu.begin_frame(100);
        assert!(bring(&mut gpu, 0, false));
    }
    assert_eq!([0, 1, 2].map(|i| gpu.warp.images.has(images[i].serial)), [true, false, false]);
}

/// Of images that are seen one after the other those seen last stay, as many as there is room for.
#[test]
fn images_that_were_not_seen_for_long_leave_the_card() {
    let Some(mut gpu) = card(Atomics::Best) else { return };
    let images: Vec<PreparedLdi> = (0..4).map(|_| image("sphere", 64)).collect();
    let mut bytes = Vec::new();
    for image in &images {
        gpu.begin_frame(u64::MAX);
        warped(&mut gpu, &[image], &poses(0.0)[0], Stamp::Quads);
        bytes.push(gpu.held_bytes());
    }
    assert!(bytes[0] > 0 && bytes[3] == 4 * bytes[0], "{bytes:?}");
    gpu.warp.images.kept_bytes = 2 * bytes[0];
    gpu.begin_frame(u64::MAX);
    warped(&mut gpu, &[&images[0]], &poses(0.0)[0], Stamp::Quads);
    gpu.begin_frame(u64::MAX);
    assert_eq!(gpu.held_bytes(), 2 * bytes[0]);
    assert_eq!([0, 1, 2, 3].map(|i| gpu.holds(&images[i])), [true, false, false, true]);
    gpu.forget();
    assert_eq!(gpu.held_bytes(), 0);
}

#[test]
fn what_only_the_processor_can_is_refused_by_name() {
    let options = |stamp, order| WarpOptions { stamp, order, ..WarpOptions::default() };
    assert_eq!(Gpu::can_warp(&options(Stamp::Quads, Order::Z)), Ok(()));
    assert_eq!(Gpu::can_warp(&options(Stamp::Ewa, Order::Z)), Err(GpuError::Stamp(Stamp::Ewa)));
    let refused = Gpu::can_warp(&options(Stamp::OnePixel, Order::Epipole)).expect_err("by depth only");
    assert!(refused.to_string().contains("--renderer cpu"), "{refused}");
}

#[test]
fn the_calibration_takes_the_callers_word_or_the_faster() {
    let Some(mut gpu) = card(Atomics::Best) else { return };
    for (on, warps) in [(WarpOn::Cpu, false), (WarpOn::Gpu, true)] {
        gpu.calibrate(on).expect("nothing is drawn");
        assert_eq!(gpu.warps(), warps);
    }
    let found = gpu.calibrate(WarpOn::Auto).expect("both warp");
    assert_eq!(Some(found.on_card), found.card_ms.zip(found.processor_ms).map(|(card, processor)| card < processor));
    println!("{}: {found}", gpu.adapter());
}
