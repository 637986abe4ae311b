//! Pictures against sums written out, sample by sample.

use super::*;
use crate::render::test_scenes::{plain, quad, scene, soup};
use glam::Vec3;
use ldi_protocol::path;

fn options(width: u32, height: u32, samples: u32) -> RenderOptions {
    let camera = OutputCamera { width, height, fov_deg: 60.0 };
    RenderOptions { camera, samples, mips: false, depth: true, every: 1 }
}

fn pose() -> Pose {
    Pose { position: DVec3::new(0.5, 0.2, 14.0), yaw_deg: 3.0, pitch_deg: -2.0 }
}

#[test]
fn pixels_are_means_of_single_rays() {
    let parts = vec![(soup(7, 300), plain([0.9, 0.4, 0.1, 1.0])), (soup(8, 300), plain([0.1, 0.2, 0.8, 1.0]))];
    let caster = Caster::of_scene(scene(parts, vec![]).into(), false);
    let table = linear_from_srgb8_table();
    // Sizes that no block divides.
    for (width, height, samples) in [(19, 13, 1), (19, 13, 4), (10, 9, 9), (9, 5, 16), (5, 3, 100)] {
        let o = options(width, height, samples);
        let frame = render_frame(&caster, &pose(), &o);
        let n = samples.isqrt();
        let (mut sky, mut finite) = (0, 0);
        for y in 0..height {
            for x in 0..width {
                let mut sum = [0.0f64; 3];
                for j in 0..n {
                    for i in 0..n {
                        let (u, v) = (
                            f64::from(x) + (f64::from(i) + 0.5) / f64::from(n),
                            f64::from(y) + (f64::from(j) + 0.5) / f64::from(n),
                        );
                        let ray = Ray::new(pose().position, o.camera.ray(&pose().basis(), u, v));
                        let colour = caster
                            .trace(&ray, &CellSet::all())
                            .map_or(SKY_SRGB.map(|c| table[usize::from(c)]), |h| caster.shade(&h, &ray, None));
                        sum = std::array::from_fn(|k| sum[k] + f64::from(colour[k]));
                    }
                }
                let at = (y * width + x) as usize;
                let want = sum.map(|s| srgb8_from_linear((s / f64::from(n * n)) as f32));
                let off = (0..3).map(|k| want[k].abs_diff(frame.rgb[at][k])).max();
                assert!(off <= Some(1), "{x} {y} of {samples}: {want:?} {:?}", frame.rgb[at]);
                let centre = o.camera.ray(&pose().basis(), f64::from(x) + 0.5, f64::from(y) + 0.5);
                let hit = caster.trace(&Ray::new(pose().position, centre), &CellSet::all());
                assert_eq!(frame.depth_m[at], hit.map_or(f32::INFINITY, |h| h.t as f32));
                if hit.is_some() { finite += 1 } else { sky += 1 }
            }
        }
        assert!(sky > 0 && finite > 0, "the scene shows both");
    }
}

#[test]
fn a_pixel_half_covered_is_half_the_light() {
    // White left of the picture's middle, black right of it; the middle column of three is half of
    // each.
    let white = quad(Vec3::new(-9.0, 9.0, -5.0), Vec3::X * 9.0, Vec3::NEG_Y * 18.0);
    let black = quad(Vec3::new(0.0, 9.0, -5.0), Vec3::X * 9.0, Vec3::NEG_Y * 18.0);
    let caster = Caster::of_scene(
        scene(vec![(white, plain([1.0; 4])), (black, plain([0.0, 0.0, 0.0, 1.0]))], vec![]).into(),
        false,
    );
    let straight = Pose { position: DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 };
    let frame = render_frame(&caster, &straight, &options(3, 3, 16));
    assert_eq!(frame.rgb[3..6], [[255; 3], [188; 3], [0; 3]], "half the light of white is code 188");
    assert!(frame.depth_m.iter().all(|d| (d - 5.0).abs() < 1e-5), "eye-space depth, not distance");
}

#[test]
fn threads_do_not_change_a_byte() {
    let caster = Caster::of_scene(scene(vec![(soup(9, 500), plain([0.7; 4]))], vec![]).into(), false);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| render_frame(&caster, &pose(), &options(70, 50, 4)))
    };
    let (one, three) = (on(1), on(3));
    assert!(one == three);
    assert!(
        one != render_frame(&caster, &Pose { yaw_deg: 4.0, ..pose() }, &options(70, 50, 4)),
        "another pose differs"
    );
}

#[test]
fn a_walk_leaves_numbered_files() {
    let dir = std::env::temp_dir().join(format!("ldi-truth-{}", std::process::id()));
    std::fs::create_dir_all(&dir).expect("a folder");
    let caster = Caster::of_scene(scene(vec![(soup(1, 50), plain([0.7; 4]))], vec![]).into(), false);
    let mut walk = path::parse(r#"{"waypoints": [[0,0,14],[0,0,10]]}"#).expect("a path");
    walk.poses.truncate(7);
    let mut heard = Vec::new();
    let o = RenderOptions { every: 3, ..options(16, 12, 1) };
    let numbers = render_path(&caster, &walk, &o, &dir, &mut |done, all| heard.push((done, all))).expect("frames");
    assert_eq!(numbers, [0, 3, 6]);
    assert_eq!(heard, [(1, 3), (2, 3), (3, 3)]);
    for n in numbers {
        let want = render_frame(&caster, &walk.poses[n].pose, &o);
        let png = image::open(dir.join(format!("frame_{n:05}.png"))).expect("a picture").to_rgb8();
        assert_eq!(png.as_raw().as_slice(), want.rgb.as_flattened());
        let depth = std::fs::read(dir.join(format!("frame_{n:05}.f32"))).expect("depth");
        assert_eq!(depth, want.depth_m.iter().flat_map(|d| d.to_le_bytes()).collect::<Vec<_>>());
    }
    std::fs::remove_dir_all(&dir).expect("the folder goes");
    let gone = render_path(&caster, &walk, &o, &dir, &mut |_, _| {});
    assert!(gone.expect_err("no folder").to_string().contains("frame_00000.png"));
}

#[test]
fn settings_out_of_range_are_named() {
    assert!(options(16, 9, 16).check().is_ok());
    let named = |o: RenderOptions| o.check().expect_err("out of range").to_string();
    assert!(named(options(16, 9, 2)).contains("samples"));
    assert!(named(options(16, 9, 0)).contains("samples"));
    assert!(named(options(0, 9, 1)).contains("width"));
    assert!(named(options(16, 99_999, 1)).contains("height"));
    assert!(named(RenderOptions { every: 0, ..options(16, 9, 1) }).contains("every"));
    let camera = OutputCamera { width: 16, height: 9, fov_deg: f64::NAN };
    assert!(named(RenderOptions { camera, ..options(16, 9, 1) }).contains("field of view"));
}
