//! What something nearer hides may be left out: what shows is the same, whatever is before, from
//! wherever it is seen.

use super::{
    tests::{CAMERA, SCENES, image, pose, poses, with, with_ends_and_slivers},
    *,
};
use ldi_protocol::Pose;

/// Rectangles of near geometry: columns and rows as shares of the picture, disparity from 1/m at
/// the left to 1/m at the right.
fn near_geometry(rectangles: &[([f32; 4], [f32; 2])]) -> Vec<f32> {
    let (w, h) = (CAMERA.width as f32, CAMERA.height as f32);
    let mut near = vec![0.0f32; (CAMERA.width * CAMERA.height) as usize];
    for (at, pixel) in near.iter_mut().enumerate() {
        let (x, y) = ((at % CAMERA.width as usize) as f32 / w, (at / CAMERA.width as usize) as f32 / h);
        for ([x0, y0, x1, y1], [left, right]) in rectangles {
            if x >= *x0 && x < *x1 && y >= *y0 && y < *y1 {
                *pixel = pixel.max(left + (right - left) * x);
            }
        }
    }
    near
}

/// Warps an image behind near geometry with and without what is hidden; the pixels that show must
/// be the same. The share of the samples in reach that was left out.
fn hidden(image: &PreparedLdi, near: &[f32], pose: &Pose, stamp: Stamp) -> f64 {
    let warped = |options: WarpOptions| {
        let (mut far, mut spare) = (FarFrame::new(CAMERA.width, CAMERA.height), FarFrame::default());
        let stats =
            warp_images(&[ImageInView::from(image)], near, pose, &CAMERA, &options, &mut far, &mut spare).unwrap();
        (far, stats)
    };
    let all = warped(WarpOptions { keep_hidden: true, ..with(stamp) });
    let culled = warped(with(stamp));
    let shows = |packed: u64, near: f32| FarFrame::unpack(packed).filter(|(_, disparity)| *disparity >= near);
    for ((a, b), near) in all.0.packed.iter().zip(&culled.0.packed).zip(near) {
        assert_eq!(shows(*a, *near), shows(*b, *near), "{stamp} from {pose:?}");
    }
    assert_eq!(all.1.samples_hidden, 0);
    assert_eq!(culled.1.samples_warped + culled.1.samples_hidden, all.1.samples_warped);
    assert_eq!(culled.1.samples_warped + culled.1.samples_culled, culled.1.samples);
    culled.1.samples_hidden as f64 / all.1.samples_warped as f64
}

#[test]
fn what_near_geometry_hides_is_not_warped() {
    let prepared = PreparedLdi::new(&image("fence"));
    let straight = &poses()[0];
    for stamp in Stamp::ALL {
        let share = |near: &[f32]| hidden(&prepared, near, straight, stamp);
        // A wall before everything, before the right half, behind everything.
        let full = share(&near_geometry(&[([0.0, 0.0, 1.0, 1.0], [10.0, 10.0])]));
        let half = share(&near_geometry(&[([0.5, 0.0, 1.0, 1.0], [10.0, 10.0])]));
        let none = share(&near_geometry(&[([0.0, 0.0, 1.0, 1.0], [0.01, 0.01])]));
        assert!(full == 1.0 && half > none + 0.1 && half < 0.95, "{stamp}: {full} {half} {none}");
    }
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(60))]

    #[test]
    fn leaving_out_what_is_hidden_changes_nothing_that_shows(
        scene in 0usize..SCENES.len(),
        rectangles in proptest::collection::vec(
            (proptest::array::uniform4(0.0f32..1.0), proptest::array::uniform2(0.02f32..0.3)), 0..6),
        eye in proptest::array::uniform3(-1.0f64..1.0),
        yaw in -40.0f64..40.0,
    ) {
        static IMAGES: std::sync::LazyLock<Vec<PreparedLdi>> =
            std::sync::LazyLock::new(|| SCENES.iter().map(|s| PreparedLdi::new(&with_ends_and_slivers(image(s)))).collect());
        let spread = |([a, b, c, d], disparity): ([f32; 4], [f32; 2])| ([a.min(c), b.min(d), a.max(c), b.max(d)], disparity);
        let near = near_geometry(&rectangles.into_iter().map(spread).collect::<Vec<_>>());
        for stamp in Stamp::ALL {
            hidden(&IMAGES[scene], &near, &pose(eye[0], eye[1], eye[2], yaw, 0.0), stamp);
        }
    }
}
