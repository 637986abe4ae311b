//! Depth shading on pictures of planes, whose disparities are known exactly.

use super::*;
use crate::frame::{Frame, pack_rgb, unpack_rgb};
use glam::DVec3;
use ldi_protocol::OutputCamera;
use proptest::prelude::*;

const CAMERA: OutputCamera = OutputCamera { width: 160, height: 90, fov_deg: 60.0 };
const WALL: [u8; 3] = [188, 182, 170];

/// A plane through `at` with a normal, in the eye's frame: x right, y down, z ahead.
#[derive(Clone, Copy, Debug)]
struct Plane {
    at: DVec3,
    normal: DVec3,
}

fn plane(at: [f64; 3], normal: [f64; 3]) -> Plane {
    Plane { at: at.into(), normal: normal.into() }
}

fn ray(column: usize, row: usize) -> DVec3 {
    let focal = CAMERA.focal_px();
    let [x, y] = [(column as f64 + 0.5 - 80.0) / focal, (row as f64 + 0.5 - 45.0) / focal];
    DVec3::new(x, y, 1.0)
}

/// The disparity of a plane; 0 behind the eye.
fn disparity(p: &Plane, direction: DVec3) -> f64 {
    (p.normal.dot(direction) / p.normal.dot(p.at)).max(0.0)
}

/// A picture in one colour with the disparity that `of` gives to each pixel.
fn picture(of: impl Fn(usize, usize) -> f64) -> Frame {
    let mut frame = Frame::new(CAMERA.width, CAMERA.height);
    frame.colour.fill(pack_rgb(WALL));
    for (i, d) in frame.disparity.iter_mut().enumerate() {
        *d = of(i % 160, i / 160) as f32;
    }
    frame
}

/// A room: the nearest of walls that enclose the eye is the farthest along a ray, the one with the
/// largest disparity.
fn room(walls: &[Plane]) -> Frame {
    picture(|x, y| walls.iter().map(|w| disparity(w, ray(x, y))).fold(0.0, f64::max))
}

fn shaded(mut frame: Frame, noise: [f32; 2]) -> Frame {
    DepthShading::default().shade(&mut frame, &DepthLens::new(&CAMERA, noise));
    frame
}

fn red(frame: &Frame, column: usize, row: usize) -> u8 {
    unpack_rgb(frame.colour[row * 160 + column])[0]
}

/// A corner between two walls, 3 m ahead, turned by this angle.
fn corner(turned_deg: f64) -> Frame {
    let [a, b] = [turned_deg - 45.0, turned_deg + 45.0].map(f64::to_radians);
    let at = [0.0, 0.0, 3.0];
    room(&[plane(at, [a.sin(), 0.0, a.cos()]), plane(at, [b.sin(), 0.0, b.cos()])])
}

proptest! {
    #[test]
    fn a_flat_wall_stays_as_it_is(
        yaw in -80.0f64..80.0, pitch in -80.0f64..80.0, distance in 0.3f64..60.0,
    ) {
        let (yaw, pitch) = (yaw.to_radians(), pitch.to_radians());
        let normal = DVec3::new(yaw.sin() * pitch.cos(), pitch.sin(), yaw.cos() * pitch.cos());
        let wall = Plane { at: normal * distance, normal };
        let frame = picture(|x, y| disparity(&wall, ray(x, y)));
        // A wall that ends within the picture has a border.
        prop_assume!(frame.disparity.iter().all(|d| *d > 0.0));
        let after = shaded(frame.clone(), [0.0; 2]);
        prop_assert!(after.colour == frame.colour, "a wall at {distance} m");
    }
}

#[test]
fn a_corner_is_darker_than_its_walls() {
    for turned_deg in [0.0, 30.0, -40.0] {
        let frame = shaded(corner(turned_deg), [0.0; 2]);
        let (middle, wall) = (red(&frame, 80, 45), red(&frame, 3, 45).max(red(&frame, 156, 45)));
        assert!(u32::from(middle) * 100 < 85 * u32::from(WALL[0]), "{turned_deg}: {middle}");
        assert_eq!(wall, WALL[0], "far from the corner");
        let beside = red(&frame, 77, 45).min(red(&frame, 83, 45));
        assert!(beside + 2 <= WALL[0], "a shadow, and not the line alone: {beside}");
    }
}

#[test]
fn convex_edges_get_a_line_and_no_shadow() {
    // Seen from outside: the farther of the two planes is hidden.
    let walls = [plane([0.0, 0.0, 3.0], [-0.7, 0.0, 0.7]), plane([0.0, 0.0, 3.0], [0.7, 0.0, 0.7])];
    let edge = picture(|x, y| walls.iter().map(|w| disparity(w, ray(x, y))).fold(f64::INFINITY, f64::min));
    let frame = shaded(edge, [0.0; 2]);
    let row: Vec<u8> = (0..160).map(|x| red(&frame, x, 45)).collect();
    assert!(row[79].min(row[80]) < 160, "{row:?}");
    assert!(row[..78].iter().chain(&row[82..]).all(|c| *c == WALL[0]), "{row:?}");
}

#[test]
fn borders_get_a_line_on_the_nearer_side() {
    // A board 2 m away in front of a wall at 9 m.
    let frame = shaded(picture(|x, _| if (40..100).contains(&x) { 0.5 } else { 1.0 / 9.0 }), [0.0; 2]);
    let row: Vec<u8> = (0..160).map(|x| red(&frame, x, 45)).collect();
    assert!(row[40] < 140 && row[99] < 140, "{row:?}");
    assert!(row[42..98].iter().all(|c| *c == WALL[0]), "{row:?}");
    assert!(row[..40].iter().chain(&row[100..]).all(|c| *c > 180), "no line, hardly a rim: {row:?}");
}

#[test]
fn steps_of_codes_are_no_creases() {
    let step = 1e-3;
    let slanted = plane([0.0, 0.0, 6.0], [0.6, 0.2, 0.8]);
    let frame = picture(|x, y| (disparity(&slanted, ray(x, y)) / step).round() * step);
    // Away from the picture's corners, where samples are continued twice.
    let changed = |noise: f32| {
        let after = shaded(frame.clone(), [noise, 0.0]);
        let inner = |i: &usize| (12..148).contains(&(i % 160)) || (12..78).contains(&(i / 160));
        (0..frame.len()).filter(inner).filter(|i| after.colour[*i] != frame.colour[*i]).count()
    };
    assert_eq!(changed(0.5 * step as f32), 0);
    // The steps are there.
    assert!(changed(0.0) > 100);
}

#[test]
fn sky_has_no_lines_and_its_border_has() {
    let frame = shaded(picture(|_, y| if y < 30 { 0.0 } else { 0.25 }), [0.0; 2]);
    assert!((0..30).all(|y| red(&frame, 70, y) == WALL[0]));
    assert!(red(&frame, 70, 30) < 140 && red(&frame, 70, 33) == WALL[0]);
}

#[test]
fn the_picture_does_not_depend_on_threads_or_on_the_picture_before() {
    let in_pool = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| shaded(corner(20.0), [1e-5, 0.0]))
    };
    let one = in_pool(1);
    assert!(one == in_pool(3));
    let mut shading = DepthShading::default();
    let mut small = Frame::new(33, 7);
    small.disparity.iter_mut().enumerate().for_each(|(i, d)| *d = i as f32);
    shading.shade(&mut small, &DepthLens::new(&CAMERA, [0.0; 2]));
    let mut frame = corner(20.0);
    shading.shade(&mut frame, &DepthLens::new(&CAMERA, [1e-5, 0.0]));
    assert!(frame == one);
}

#[test]
fn colours_are_scaled_channel_by_channel() {
    let mut colours = [pack_rgb([200, 100, 50]), pack_rgb([255; 3]), pack_rgb([9, 8, 7])];
    darken(&[0.5, 0.0, 1.0], &mut colours);
    assert_eq!(colours.map(unpack_rgb), [[100, 50, 25], [255; 3], [0; 3]]);
}
