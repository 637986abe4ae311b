//! The sampler against a direct f64 evaluation, the pyramid against hand-computed and brute-force
//! means.

use super::*;
use crate::shade::linear_from_srgb;
use proptest::prelude::*;

/// Deterministic noise texels.
fn noise(width: u32, height: u32, seed: u32) -> MipLevel {
    let mut s = seed.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let mut next = || {
        s = s.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (s >> 24) as u8
    };
    let rgba = (0..width * height).map(|_| std::array::from_fn(|_| next())).collect();
    MipLevel { width, height, rgba }
}

/// Bilinear by the definition, in f64, with wrapping texel by texel.
fn bilinear_f64(l: &MipLevel, uv: Vec2, wrap: [Wrap; 2]) -> [f64; 4] {
    let (w, h) = (i64::from(l.width), i64::from(l.height));
    let x = f64::from(uv.x) * w as f64 - 0.5;
    let y = f64::from(uv.y) * h as f64 - 0.5;
    let (x0, y0) = (x.floor(), y.floor());
    let mut sum = [0.0; 4];
    for (dy, wy) in [(0, 1.0 - (y - y0)), (1, y - y0)] {
        for (dx, wx) in [(0, 1.0 - (x - x0)), (1, x - x0)] {
            let i = wrap_texel(x0 as i64 + dx, w, wrap[0]);
            let j = wrap_texel(y0 as i64 + dy, h, wrap[1]);
            let t = l.rgba[j * l.width as usize + i];
            for k in 0..3 {
                sum[k] += f64::from(linear_from_srgb(f32::from(t[k]) / 255.0)) * wx * wy;
            }
            sum[3] += f64::from(t[3]) / 255.0 * wx * wy;
        }
    }
    sum
}

proptest! {
    #[test]
    fn sampler_is_bilinear_for_every_wrap(
        u in -3.0f32..3.0, v in -3.0f32..3.0, w in 1u32..9, h in 1u32..9, seed: u32, wraps in 0usize..9,
    ) {
        const ALL: [Wrap; 3] = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];
        let wrap = [ALL[wraps / 3], ALL[wraps % 3]];
        let level = noise(w, h, seed);
        let want = bilinear_f64(&level, Vec2::new(u, v), wrap);
        let texture = Texture { levels: vec![Some(level)] };
        let (colour, alpha) = sample_bilinear(&texture, Vec2::new(u, v), wrap);
        // 9 texels at |uv| <= 3 in f32: coordinate error about 3e-6 texels.
        for k in 0..3 {
            prop_assert!((f64::from(colour[k]) - want[k]).abs() < 2e-5, "{colour:?} {want:?}");
        }
        prop_assert!((f64::from(alpha) - want[3]).abs() < 2e-5);
        prop_assert!((sample_alpha(&texture, Vec2::new(u, v), wrap) - alpha).abs() < 2e-6);
    }

    #[test]
    fn alpha_tests_say_what_the_sampler_says(
        u in -3.0f32..3.0, v in -3.0f32..3.0, w in 1u32..9, h in 1u32..9, seed: u32, wraps in 0usize..9,
        cutoff in 0.0f32..1.1, factor in -0.5f32..1.5, contrast in 0u8..3,
    ) {
        const ALL: [Wrap; 3] = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];
        let wrap = [ALL[wraps / 3], ALL[wraps % 3]];
        let mut level = noise(w, h, seed);
        // Leaves: mostly there or not there.
        level.rgba.iter_mut().filter(|_| contrast > 0).for_each(|t| t[3] = if t[3] < 85 * contrast { 0 } else { 255 });
        let texture = Texture { levels: vec![Some(level)] };
        let test = AlphaTest::new(&texture, wrap, factor, cutoff);
        // Also at the borders of texels, and on both sides of them.
        for uv in [Vec2::new(u, v), Vec2::new((u * w as f32).round() / w as f32, ((v * h as f32).round() + 0.5) / h as f32)] {
            let alpha = sample_alpha(&texture, uv, wrap) * factor;
            prop_assert_eq!(test.passes(&texture, uv), !(alpha < cutoff), "{} at {:?}", alpha, uv);
        }
    }

    #[test]
    fn every_level_keeps_the_mean_of_an_opaque_texture(w in 1u32..40, h in 1u32..40, seed: u32) {
        let mut base = noise(w, h, seed);
        base.rgba.iter_mut().for_each(|t| t[3] = 255);
        let mean = |l: &MipLevel, k: usize| {
            l.rgba.iter().map(|t| f64::from(linear_from_srgb(f32::from(t[k]) / 255.0))).sum::<f64>() / l.rgba.len() as f64
        };
        let want: [f64; 3] = std::array::from_fn(|k| mean(&base, k));
        let texture = Texture::from_base(base, false);
        prop_assert_eq!(texture.levels.len(), level_count(w, h) as usize);
        for (k, level) in texture.levels.iter().enumerate() {
            let level = level.as_ref().expect("a full pyramid");
            prop_assert_eq!((level.width, level.height), level_size(w, h, k as u32));
            for (c, want) in want.iter().enumerate() {
                // One 8-bit code near white is 0.009 in linear light; rounding is at most half of
                // one.
                prop_assert!((mean(level, c) - want).abs() < 0.0046, "level {k}");
            }
        }
    }

    #[test]
    fn hostile_coordinates_do_not_panic(u in prop::num::f32::ANY, v in prop::num::f32::ANY, lod in prop::num::f32::ANY) {
        let texture = Texture::from_base(noise(5, 3, 1), true);
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            sample(&texture, Vec2::new(u, v), lod, [wrap; 2]);
            sample_alpha(&texture, Vec2::new(u, v), [wrap; 2]);
        }
    }
}

#[test]
fn means_are_taken_in_linear_light() {
    let base = MipLevel { width: 2, height: 1, rgba: vec![[0, 0, 0, 255], [255, 255, 255, 255]] };
    let texture = Texture::from_base(base, false);
    let top = texture.levels[1].as_ref().expect("level 1");
    // Half the light of white is sRGB code 188, not 128.
    assert_eq!(top.rgba, vec![[188, 188, 188, 255]]);
}

#[test]
fn colour_behind_the_mask_does_not_bleed() {
    let base = MipLevel { width: 2, height: 1, rgba: vec![[255, 0, 0, 0], [0, 255, 0, 255]] };
    let masked = Texture::from_base(base.clone(), true);
    assert_eq!(masked.levels[1].as_ref().expect("level 1").rgba, vec![[0, 255, 0, 128]]);
    let plain = Texture::from_base(base, false);
    assert_eq!(plain.levels[1].as_ref().expect("level 1").rgba, vec![[188, 188, 0, 128]]);
    let clear = MipLevel { width: 2, height: 1, rgba: vec![[255, 0, 0, 0], [255, 0, 0, 0]] };
    assert_eq!(Texture::from_base(clear, true).levels[1].as_ref().expect("level 1").rgba, vec![[255, 0, 0, 0]]);
}

#[test]
fn missing_levels_fall_back_to_coarser_ones() {
    let mut texture = Texture::from_base(noise(8, 8, 7), false);
    let coarse = sample(&texture, Vec2::new(0.3, 0.6), 2.0, [Wrap::Repeat; 2]);
    let fine = sample(&texture, Vec2::new(0.3, 0.6), 0.0, [Wrap::Repeat; 2]);
    assert_ne!(fine, coarse);
    texture.levels[0] = None;
    texture.levels[1] = None;
    assert_eq!(sample(&texture, Vec2::new(0.3, 0.6), 0.0, [Wrap::Repeat; 2]), coarse);
    assert_eq!(sample(&texture, Vec2::new(0.3, 0.6), 0.7, [Wrap::Repeat; 2]), coarse);
    assert_eq!(texture.size(), Some((8, 8)));
    assert_eq!(sample(&Texture::default(), Vec2::ZERO, 0.0, [Wrap::Repeat; 2]), ([1.0; 3], 1.0));
}

#[test]
fn trilinear_blends_two_levels() {
    let texture = Texture::from_base(noise(16, 16, 3), false);
    let at = |lod| sample(&texture, Vec2::new(0.41, 0.77), lod, [Wrap::Repeat; 2]).0;
    let (a, b, mid) = (at(1.0), at(2.0), at(1.25));
    for k in 0..3 {
        assert!((mid[k] - (a[k] * 0.75 + b[k] * 0.25)).abs() < 1e-6);
    }
    assert_eq!(at(100.0), at(4.0));
}

#[test]
fn level_of_detail_counts_texels_per_pixel() {
    let lod = lod_of((256, 64), Vec2::new(4.0 / 256.0, 0.0), Vec2::new(0.0, 2.0 / 64.0));
    assert!((lod - 2.0).abs() < 1e-6);
    assert_eq!(lod_of((256, 64), Vec2::ZERO, Vec2::ZERO), 0.0);
    assert_eq!(lod_of((256, 64), Vec2::new(f32::NAN, 0.0), Vec2::new(f32::NAN, 0.0)), 0.0);
}
