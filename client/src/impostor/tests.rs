//! Cached images against geometry drawn anew.

use super::*;
use crate::{
    frame::Source,
    test_support::{Memory, dataset, loose_cluster, plain_material},
};
use glam::Vec3;

const CAMERA: OutputCamera = OutputCamera { width: 320, height: 240, fov_deg: 60.0 };

/// Groups of small coloured triangles far off, one cell each, and some nearby.
fn scene() -> (Index, Memory) {
    let mut state = 3u64;
    let mut unit = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u32 << 24) as f32
    };
    let mut clusters = Vec::new();
    for i in 0..24 {
        let distance = if i < 4 { 8.0 } else { 60.0 + 20.0 * (i / 6) as f32 };
        let centre = Vec3::new((i % 6) as f32 * 9.0 - 22.0, 0.0, -distance);
        let triangles: Vec<[Vec3; 3]> = (0..250)
            .map(|_| {
                let at = centre + Vec3::new(unit() * 4.0 - 2.0, unit() * 6.0 - 3.0, unit() * 4.0 - 2.0);
                [at, at + Vec3::new(0.5 * unit() + 0.2, 0.2, 0.0), at + Vec3::new(0.1, 0.5 * unit() + 0.2, 0.2)]
            })
            .collect();
        clusters.push(loose_cluster((i % 3) as u32, &triangles));
    }
    let coloured =
        |c: [f32; 3]| ldi_protocol::mesh::Material { base_colour: [c[0], c[1], c[2], 1.0], ..plain_material() };
    dataset(CAMERA, vec![coloured([0.8, 0.1, 0.1]), coloured([0.1, 0.7, 0.1]), coloured([0.1, 0.1, 0.9])], clusters)
}

fn at(x: f64) -> Pose {
    Pose { position: DVec3::new(x, 0.5, 0.0), yaw_deg: 0.0, pitch_deg: 0.0 }
}

/// One that believes geometry to be dear, so that all that may be cached is.
fn eager(error_px: f64) -> Impostors {
    let settings = ImpostorSettings { error_px, spare_ms: 1e6, leaf_triangles: 250, ..ImpostorSettings::default() };
    Impostors { settings, costs: Costs::fixed(1e-2), ..Impostors::default() }
}

fn draw(impostors: &mut Impostors, scene: &(Index, Memory), pose: &Pose) -> (Frame, NearStats, ImpostorStats) {
    let mut frame = Frame::default();
    let (stats, drawn) = impostors.draw((&scene.0, &scene.1), (&CAMERA, pose), true, &mut frame);
    (frame, stats, drawn)
}

fn anew(scene: &(Index, Memory), pose: &Pose) -> Frame {
    let mut frame = Frame::default();
    let cells = DrawnCell::all_full(0..scene.0.cells.len() as u32);
    Rasterizer::default().draw(&scene.0, &scene.1, &cells, &CAMERA, pose, &mut frame);
    frame
}

/// Share of pixels that show something in one of both frames and nothing within `around` pixels in
/// the other.
fn strays(a: &Frame, b: &Frame, around: i64) -> f64 {
    let shows = |f: &Frame, x: i64, y: i64| {
        x >= 0
            && y >= 0
            && x < f.width.into()
            && y < f.height.into()
            && f.disparity[(y * i64::from(f.width) + x) as usize] > 0.0
    };
    let mut strays = 0;
    for y in 0..i64::from(a.height) {
        for x in 0..i64::from(a.width) {
            let near = |f: &Frame| (-around..=around).any(|dy| (-around..=around).any(|dx| shows(f, x + dx, y + dy)));
            strays += usize::from(shows(a, x, y) && !near(b) || shows(b, x, y) && !near(a));
        }
    }
    strays as f64 / a.len() as f64
}

#[test]
fn far_groups_come_from_images_and_stay_where_they_are() {
    let scene = scene();
    let mut impostors = eager(2.0);
    let mut first = Frame::default();
    let (stats, drawn) = impostors.draw((&scene.0, &scene.1), (&CAMERA, &at(0.0)), false, &mut first);
    let all = stats.triangles;
    assert_eq!((drawn.images, drawn.made), (0, 0), "while something is missing all is geometry");
    assert_eq!(first, anew(&scene, &at(0.0)));
    let mut shown = 0;
    for step in 1..40 {
        let pose = at(f64::from(step) * 0.02);
        let (frame, stats, drawn) = draw(&mut impostors, &scene, &pose);
        let truth = anew(&scene, &pose);
        if step > 3 {
            assert!(drawn.images > 0 && stats.triangles < all, "step {step}: {drawn:?}, {} triangles", stats.triangles);
        }
        shown += drawn.images;
        // Where corners may be two pixels off, and images are filtered.
        assert!(strays(&frame, &truth, 3) < 2e-4, "step {step}: {}", strays(&frame, &truth, 3));
        let far = frame.source.iter().filter(|s| **s == Source::Far).count();
        assert!(drawn.images == 0 || far > 300, "step {step}: {far} pixels of {} images", drawn.images);
    }
    assert!(shown > 40, "{shown}");
}

#[test]
fn an_image_seen_from_its_own_eye_is_the_picture() {
    let scene = scene();
    let mut impostors = eager(2.0);
    draw(&mut impostors, &scene, &at(0.0));
    for _ in 0..6 {
        draw(&mut impostors, &scene, &at(0.0));
    }
    for turn in [0.0, 7.0, -20.0] {
        let pose = Pose { yaw_deg: turn, ..at(0.0) };
        let (frame, stats, drawn) = draw(&mut impostors, &scene, &pose);
        assert!(drawn.images > 0 && stats.triangles <= 4 * 250 + 250, "{turn}: {} triangles", stats.triangles);
        let truth = anew(&scene, &pose);
        assert!(strays(&frame, &truth, 1) < 2e-4, "{turn}: {}", strays(&frame, &truth, 1));
        // Depths too: of pixels with the same in both and around them.
        let both = frame.disparity.iter().zip(&truth.disparity).filter(|(a, b)| **a > 0.0 && **b > 0.0);
        let off = both.clone().filter(|(a, b)| (*a - *b).abs() > 0.12 * *b).count();
        assert!(off * 20 < both.count(), "{turn}: {off}");
    }
}

/// A wall that is its image's own plane, so that every depth has a closed form, for an eye that
/// came nearer, stepped aside and turned.
#[test]
fn images_know_how_far_away_things_are_for_another_eye() {
    let wall_z = -60.0;
    let half = DVec3::new(8.0, 5.0, 0.0);
    let bounds = Aabb { min: DVec3::new(0.0, 0.0, wall_z) - half, max: DVec3::new(0.0, 0.0, wall_z) + half };
    let framing = Framing::new(&bounds, DVec3::ZERO, &CAMERA).expect("far ahead");
    let mut drawing = Frame::new(framing.camera.width, framing.camera.height);
    drawing.disparity.fill(-1.0 / wall_z as f32);
    drawing.colour.fill(0x0033_2211);
    let picture = ImpostorImage::new(framing, &drawing);
    let pose = Pose { position: DVec3::new(3.0, 1.0, -9.0), yaw_deg: 6.0, pitch_deg: -3.0 };
    let mut frame = Frame::new(CAMERA.width, CAMERA.height);
    picture.draw(&CAMERA, &pose, &mut frame);
    let basis = pose.basis();
    let mut painted = 0;
    for at in 0..frame.len() {
        let (x, y) = ((at % CAMERA.width as usize) as f64 + 0.5, (at / CAMERA.width as usize) as f64 + 0.5);
        let ray = CAMERA.ray(&basis, x, y);
        let depth = (wall_z - pose.position.z) / ray.z;
        let hit = pose.position + ray * depth;
        // Within the wall and away from its edge; the image is a pixel wider.
        if hit.x.abs() < half.x && hit.y.abs() < half.y {
            assert!((f64::from(frame.disparity[at]) * depth - 1.0).abs() < 1e-4, "{at}: {}", frame.disparity[at]);
            assert_eq!((frame.colour[at], frame.source[at]), (0x0033_2211, Source::Far));
            painted += 1;
        } else if hit.x.abs() > half.x + 1.0 || hit.y.abs() > half.y + 1.0 {
            assert_eq!(frame.source[at], Source::Unpainted, "{at}");
        }
    }
    assert!(painted > 3000, "{painted}");
    // Nothing shows through what is nearer.
    let mut hidden = Frame::new(CAMERA.width, CAMERA.height);
    hidden.disparity.fill(1.0);
    let before = hidden.clone();
    picture.draw(&CAMERA, &pose, &mut hidden);
    assert_eq!(hidden, before);
}

/// What lies around a node shows in its image as far as the inflated box reaches, and no farther.
#[test]
fn neighbours_are_brought_in_within_the_box() {
    let bounds = Aabb { min: DVec3::new(-4.0, -4.0, -64.0), max: DVec3::new(4.0, 4.0, -56.0) };
    let framing = Framing::new(&bounds, DVec3::ZERO, &CAMERA).expect("far ahead");
    let (width, height) = (framing.camera.width, framing.camera.height);
    let shown = |own: f32, theirs: f32| {
        let (mut frame, mut other) = (Frame::new(width, height), Frame::new(width, height));
        frame.disparity.fill(own);
        other.disparity.fill(theirs);
        framing.bring_in(&bounds, &other, &mut frame);
        // The pixel in the middle.
        frame.disparity[(height / 2 * width + width / 2) as usize]
    };
    let [before, inside, behind] = [50.0, 60.0, 70.0].map(|z: f32| 1.0 / z);
    assert_eq!([shown(0.0, inside), shown(0.0, before), shown(0.0, behind)], [inside, 0.0, 0.0]);
    assert_eq!(shown(1.0 / 58.0, inside), 1.0 / 58.0, "what is nearer stays");
}

#[test]
fn a_smaller_error_costs_more_images() {
    let scene = scene();
    let made = |error_px: f64| {
        let mut impostors = eager(error_px);
        (0..60).map(|i| draw(&mut impostors, &scene, &at(f64::from(i) * 0.05)).2.made).sum::<u32>()
    };
    let (fine, coarse) = (made(0.5), made(8.0));
    assert!(fine > coarse && coarse > 0, "{fine} and {coarse}");
}

#[test]
fn nothing_is_made_of_what_is_not_here_and_memory_is_bounded() {
    let mut scene = scene();
    let settled = |scene: &(Index, Memory), pose: &Pose| {
        let mut impostors = eager(8.0);
        impostors.settings.leaf_triangles = 1500;
        (0..8).for_each(|_| {
            draw(&mut impostors, scene, pose);
        });
        impostors
    };
    let holds = |impostors: &Impostors, cell: u32| {
        let of = |node: &u32| {
            let mut found = false;
            impostors.nodes.tree.objects_of(*node, &mut |c| found |= c == cell);
            found
        };
        impostors.cached.keys().any(of)
    };
    // A cell that is out of view, but in an image with what is in view.
    let (pose, cell) = (0..12)
        .map(|i| Pose { yaw_deg: 5.0 * f64::from(i) - 30.0, ..at(0.0) })
        .find_map(|pose| {
            let impostors = settled(&scene, &pose);
            let half_tan = (CAMERA.half_tan_x(), CAMERA.half_tan_y());
            let frusta = DrawFrusta::new(&scene.0.settings, &pose, half_tan);
            let is_out = |c: &u32| !frusta.admit(&scene.0.cells[*c as usize].bounds);
            (0..24).filter(is_out).find(|c| holds(&impostors, *c)).map(|c| (pose, c))
        })
        .expect("images reach beyond the picture");
    scene.1.cells.remove(&cell);
    let mut impostors = settled(&scene, &pose);
    assert!(!impostors.cached.is_empty() && !holds(&impostors, cell));
    let (_, _, before) = draw(&mut impostors, &scene, &pose);
    impostors.settings.bytes = before.bytes - 1;
    let (_, _, drawn) = draw(&mut impostors, &scene, &pose);
    assert!(drawn.bytes < before.bytes, "{} of {}", drawn.bytes, before.bytes);
}

#[test]
fn images_wait_for_time_to_spare_which_grows_with_the_frame() {
    let scene = scene();
    let made = |spare_share: f64| {
        let mut impostors = eager(2.0);
        impostors.settings = ImpostorSettings { spare_ms: 0.0, spare_share, ..impostors.settings };
        (0..6).map(|_| draw(&mut impostors, &scene, &at(0.0)).2.made).sum::<u32>()
    };
    assert_eq!(made(0.0), 0);
    // Of whatever a frame takes here.
    assert!(made(1e9) > 0);
}

#[test]
fn shares_of_boxes_multiply_and_flat_ones_count_by_area() {
    let aabb = |min: [f64; 3], max: [f64; 3]| Aabb { min: DVec3::from(min), max: DVec3::from(max) };
    let unit = aabb([0.0; 3], [1.0; 3]);
    assert_eq!(share(&unit, &aabb([0.5, -1.0, 0.75], [3.0, 2.0, 3.0])), 0.125);
    assert_eq!([share(&unit, &aabb([2.0; 3], [3.0; 3])), share(&unit, &aabb([-1.0; 3], [3.0; 3]))], [0.0, 1.0]);
    assert_eq!(share(&aabb([0.0; 3], [1.0, 0.0, 1.0]), &aabb([0.5, -1.0, 0.0], [1.0, 1.0, 1.0])), 0.5);
}
