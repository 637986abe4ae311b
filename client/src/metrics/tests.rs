//! Known values: identical pictures, constant offsets, and SSIM by its definition.

use super::*;

fn picture(width: u32, height: u32, f: impl Fn(u32, u32, u32) -> u8) -> RgbImage {
    let rgb = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .flat_map(|(x, y)| [f(x, y, 0), f(x, y, 1), f(x, y, 2)])
        .collect();
    RgbImage::new(width, height, rgb).expect("three bytes per pixel")
}

/// Any texture will do.
fn noise(x: u32, y: u32, c: u32) -> u8 {
    ((x * 7919 + y * 104_729 + c * 1_299_709).wrapping_mul(2_654_435_761) >> 24) as u8
}

#[test]
fn identical_pictures_score_best() {
    let p = picture(40, 30, noise);
    assert_eq!(psnr_db(&p, &p), Ok(LARGEST_DB));
    assert!((ssim(&p, &p).expect("same size").expect("large enough") - 1.0).abs() < 1e-6);
    assert!(FlipMap::new(&p, &p).expect("same size").mean() < 1e-6);
}

#[test]
fn psnr_of_a_constant_offset() {
    let (a, b) = (picture(16, 16, |_, _, _| 100), picture(16, 16, |_, _, _| 110));
    // 20 log10(255 / 10).
    assert!((psnr_db(&a, &b).expect("same size") - 28.130_803_608_679_1).abs() < 1e-9);
    let one = picture(1920, 1080, |x, y, c| u8::from(x + y + c == 0));
    let none = picture(1920, 1080, |_, _, _| 0);
    let db = psnr_db(&one, &none).expect("same size");
    assert!(db < LARGEST_DB && db > 110.0, "{db}");
}

/// Equation 13 straight from its definition, in f64, every window on its own.
fn ssim_by_definition(a: &RgbImage, b: &RgbImage) -> f64 {
    let luma = |p: &RgbImage, x: usize, y: usize| {
        let c = &p.rgb()[3 * (y * p.size().0 as usize + x)..];
        0.299 * f64::from(c[0]) + 0.587 * f64::from(c[1]) + 0.114 * f64::from(c[2])
    };
    let g = |i: usize| (-((i as f64) - 5.0).powi(2) / 4.5).exp();
    let total: f64 = (0..11).flat_map(|i| (0..11).map(move |j| (i, j))).map(|(i, j)| g(i) * g(j)).sum();
    let (w, h) = (a.size().0 as usize, a.size().1 as usize);
    let (mut sum, mut n) = (0.0, 0.0);
    for y in 0..=h - 11 {
        for x in 0..=w - 11 {
            let mean = |f: &dyn Fn(usize, usize) -> f64| -> f64 {
                (0..11)
                    .flat_map(|i| (0..11).map(move |j| (i, j)))
                    .map(|(i, j)| g(i) * g(j) / total * f(x + i, y + j))
                    .sum()
            };
            let (ma, mb) = (mean(&|x, y| luma(a, x, y)), mean(&|x, y| luma(b, x, y)));
            let va = mean(&|x, y| (luma(a, x, y) - ma).powi(2));
            let vb = mean(&|x, y| (luma(b, x, y) - mb).powi(2));
            let cov = mean(&|x, y| (luma(a, x, y) - ma) * (luma(b, x, y) - mb));
            sum +=
                (2.0 * ma * mb + 6.5025) * (2.0 * cov + 58.5225) / ((ma * ma + mb * mb + 6.5025) * (va + vb + 58.5225));
            n += 1.0;
        }
    }
    sum / n
}

#[test]
fn ssim_matches_its_definition() {
    let a = picture(31, 24, noise);
    let b = picture(31, 24, |x, y, c| noise(x, y, c) / 2 + noise(y, x, c) / 3);
    let flat = picture(31, 24, |_, _, _| 250);
    for other in [&b, &flat] {
        let fast = ssim(&a, other).expect("same size").expect("large enough");
        let slow = ssim_by_definition(&a, other);
        assert!((fast - slow).abs() < 1e-5, "{fast} instead of {slow}");
        assert!(fast < 0.9);
    }
    assert_eq!(ssim(&picture(10, 40, noise), &picture(10, 40, noise)), Ok(None));
}

#[test]
fn flip_knows_black_from_white_and_where() {
    let black = picture(48, 32, |_, _, _| 0);
    let half = picture(48, 32, |x, _, _| if x < 24 { 0 } else { 255 });
    let map = FlipMap::new(&black, &half).expect("same size");
    let left = map.mean_where(|i| i % 48 < 10).expect("some");
    let right = map.mean_where(|i| i % 48 > 36).expect("some");
    assert!(left < 0.05 && right > 0.9, "{left} {right}");
    assert_eq!(map.mean_where(|_| false), None);
    assert_eq!(map.errors().len(), 48 * 32);
}

#[test]
fn sizes_and_lengths_are_checked() {
    assert!(matches!(RgbImage::new(2, 2, vec![0; 11]), Err(MetricError::Length { bytes: 11, .. })));
    let (a, b) = (picture(12, 11, noise), picture(11, 12, noise));
    assert!(matches!(psnr_db(&a, &b), Err(MetricError::Size(..))));
    assert!(ssim(&a, &b).is_err() && FlipMap::new(&a, &b).is_err());
}
