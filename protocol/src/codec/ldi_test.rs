//! LDI chunks on a synthetic image: two slanted walls, a sparse deep layer, holes, textured and
//! noisy colours.

use super::*;
use crate::ldi::{END_BITS, LINK_DOWN, LINK_RIGHT, Sliver, SliverCorner, end_of, is_loose};
use proptest::prelude::*;

/// xorshift64*: small, seeded, the same everywhere.
struct Random(u64);
impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }
    fn below(&mut self, n: u64) -> u64 {
        (self.next() >> 33) % n
    }
}

/// A layer of the pixels that `code` gives a disparity for, with random links where they are
/// allowed.
fn layer(width: u32, height: u32, random: &mut Random, code: impl Fn(u32, u32) -> Option<u16>) -> LdiLayer {
    let mut runs: Vec<Run> = Vec::new();
    let mut out = LdiLayer::default();
    for row in 0..height {
        for column in 0..width {
            let Some(d) = code(column, row) else { continue };
            match runs.last_mut() {
                Some(r) if r.row == row && r.column + r.count == column => r.count += 1,
                _ => runs.push(Run { row, column, count: 1 }),
            }
            out.disparity.push(d);
            let texture = ((column * 7 + row * 3) % 64) as u8;
            out.rgb.push([texture + random.below(8) as u8, texture * 2, 40 + random.below(3) as u8 * 90]);
            let right = column + 1 < width && code(column + 1, row).is_some() && random.below(10) > 0;
            let down = row + 1 < height && code(column, row + 1).is_some() && random.below(10) > 0;
            out.links.push((u8::from(right) * LINK_RIGHT) | (u8::from(down) * LINK_DOWN));
        }
    }
    (out.segments, out.column) = segments_of_runs(&runs, out.disparity.len());
    out = out.with_half_ends();
    for ends in &mut out.ends {
        let open = (0..4).filter(|side| end_of(*ends, *side) > 0).collect::<Vec<_>>();
        *ends = open.into_iter().map(|side| (random.below(5) as u16) << (side * END_BITS)).sum();
    }
    for (slopes, ends) in out.slopes.iter_mut().zip(&out.ends) {
        for axis in (0..2).filter(|axis| is_loose(*ends, *axis)) {
            slopes[axis] = random.next() as i8;
        }
    }
    out
}

fn image(width: u32, height: u32, layers: usize, seed: u64) -> Ldi {
    let mut random = Random(seed | 1);
    let camera = LdiCamera {
        cop: DVec3::new(1.5, -2.0, 3.25),
        basis: ViewBasis::from_yaw_pitch(33.0, -12.0),
        pixels_per_unit: 700.0,
        left: -(width as i32) / 2,
        top: -7,
        width,
        height,
    };
    let holes: Vec<u64> = (0..64).map(|_| random.next()).collect();
    let hole =
        |k: usize, x: u32, y: u32| holes[(y as usize / 3 + 5 * k) % 64] >> ((x / 5 + 11 * k as u32) % 64) & 1 == 1;
    let layers: Vec<LdiLayer> = (0..layers)
        .map(|k| {
            let code = |x: u32, y: u32| {
                let d = if x < width / 2 { 60_000 - x - 2 * y } else { 30_000 + 3 * x - y } as u16;
                (!hole(k, x, y) && (k == 0 || (x + y).is_multiple_of(3 * k as u32))).then_some(d - 1000 * k as u16)
            };
            layer(width, height, &mut random, code)
        })
        .collect();
    let codes = DisparityCodes { smallest: 0.01, step: 1e-5, largest_code: 65_000 };
    let words = (width as usize).div_ceil(64);
    let padding = if width.is_multiple_of(64) { !0 } else { (1u64 << (width % 64)) - 1 };
    let sky = (0..words * height as usize)
        .map(|i| random.next() & random.next() & if i % words == words - 1 { padding } else { !0 })
        .collect();
    let mut within = |low: i32, high: i32| low + random.below((high - low) as u64) as i32;
    let mut corner = || SliverCorner {
        u: within(-Sliver::MARGIN * Sliver::PARTS, width as i32 * Sliver::PARTS),
        v: within(0, (height as i32 + Sliver::MARGIN) * Sliver::PARTS),
        disparity: within(1, 65_001) as u16,
    };
    let most = if layers.is_empty() { 0 } else { 50 };
    let slivers =
        (0..most).map(|k| Sliver { corners: std::array::from_fn(|_| corner()), rgb: [k, 0, 255 - k] }).collect();
    Ldi { camera, codes, layers, sky, slivers }
}

const LOSSY: ColourMode = ColourMode { green_step: 5, red_blue_step: 7, exact_contexts: 1 };

fn round_trip(ldi: &Ldi, mode: ColourMode) -> Ldi {
    let first = encode_first(ldi, mode, 3).unwrap();
    let mut out = decode_first(&first).unwrap();
    if let Some(deeper) = encode_deeper(ldi, mode, 3).unwrap() {
        decode_deeper(&deeper, &mut out).unwrap();
    }
    out
}

#[test]
fn lossless_comes_back_exactly() {
    let ldi = image(300, 70, 4, 5);
    ldi.check().unwrap();
    assert!(ldi.layers.iter().all(|l| l.len() > 300), "the test image must be worth testing");
    assert_eq!(round_trip(&ldi, ColourMode::LOSSLESS), ldi);
}

#[test]
fn an_image_is_exact_as_long_as_its_profile_grants_the_bytes() {
    // All but colours takes little.
    let mut flat = image(257, 90, 2, 9);
    flat.slivers.clear();
    for l in &mut flat.layers {
        l.disparity.fill(500);
        l.links.fill(0);
        l.ends.fill(0);
        l.slopes.fill([0; 2]);
    }
    let mut noisy = flat.clone();
    flat.layers.iter_mut().for_each(|l| l.rgb.fill([90, 80, 70]));
    for (k, rgb) in noisy.layers.iter_mut().flat_map(|l| &mut l.rgb).enumerate() {
        *rgb = std::array::from_fn(|c| (k.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> (20 + 9 * c)) as u8);
    }
    for profile in ColourProfile::ALL {
        assert_eq!(ColourProfile::from_name(profile.name()), Some(profile));
        let coded = |ldi: &Ldi| {
            let chunks = encode(ldi, profile, 3).unwrap();
            let mut out = decode_first(&chunks[0]).unwrap();
            decode_deeper(&chunks[1], &mut out).unwrap();
            (chunks.iter().map(Vec::len).sum::<usize>(), out)
        };
        let ((_, cheap), (bytes, dear)) = (coded(&flat), coded(&noisy));
        assert!(cheap == flat);
        assert_eq!(dear == noisy, profile == ColourProfile::Lossless, "{profile:?}");
        // The last of its modes, as no other is small enough.
        let last = *profile.modes().last().unwrap();
        assert!(dear == round_trip(&noisy, last), "{profile:?}");
        assert!(
            bytes as f64 > profile.bytes_per_sample() * noisy.samples() as f64 || profile == ColourProfile::Lossless
        );
    }
    assert_eq!(ColourProfile::from_name("exact"), None);
    // Noise of less and less contrast: the first mode that fits, as trying all of them in order
    // finds it.
    let mut found = std::collections::BTreeSet::new();
    for contrast in [3, 5, 6, 8, 11, 16, 40] {
        let mut faint = noisy.clone();
        faint.layers.iter_mut().flat_map(|l| &mut l.rgb).flatten().for_each(|c| *c = 100 + *c % contrast);
        for profile in ColourProfile::ALL {
            let size = |chunks: &[Vec<u8>]| chunks.iter().map(Vec::len).sum::<usize>() as f64;
            let in_mode =
                |m: ColourMode| [encode_first(&faint, m, 3).unwrap(), encode_deeper(&faint, m, 3).unwrap().unwrap()];
            let granted = profile.bytes_per_sample() * faint.samples() as f64;
            let modes = profile.modes();
            let first = modes.iter().position(|m| size(&in_mode(*m)) <= granted).unwrap_or(modes.len() - 1);
            found.insert(first);
            assert!(encode(&faint, profile, 3).unwrap() == in_mode(modes[first]), "{profile:?} at {contrast}: {first}");
        }
    }
    // Granted together, noise has what plain images leave; and two as noisy are as coarse as one.
    let profile = ColourProfile::High;
    let plain = vec![&flat; 40];
    let together = encode_all(&[&plain[..], &[&noisy]].concat(), profile, 3).unwrap();
    let exact = [encode_first(&noisy, ColourMode::LOSSLESS, 3).unwrap()];
    assert!(together.len() == 41 && together[40][..1] == exact && encode(&noisy, profile, 3).unwrap()[..1] != exact);
    assert!(encode_all(&[&noisy, &noisy], profile, 3).unwrap()[1] == encode(&noisy, profile, 3).unwrap());
    assert!(found.len() > 4, "modes between the first and the last are among them: {found:?}");
}

#[test]
fn near_lossless_keeps_its_bound_and_everything_else() {
    let ldi = image(257, 40, 3, 9);
    let steps = |green_step, red_blue_step| ColourMode { green_step, red_blue_step, exact_contexts: 1 };
    for mode in ColourProfile::Compact.modes().iter().copied().chain([steps(4, 32), steps(1, 2), steps(3, 1)]) {
        let out = round_trip(&ldi, mode);
        let mut worst = [0; 3];
        for (a, b) in ldi.layers.iter().zip(&out.layers) {
            assert_eq!(
                (&a.segments, &a.column, &a.disparity, &a.links, &a.ends),
                (&b.segments, &b.column, &b.disparity, &b.links, &b.ends)
            );
            for (x, y) in a.rgb.iter().zip(&b.rgb) {
                for k in 0..3 {
                    worst[k] = worst[k].max(x[k].abs_diff(y[k]));
                }
            }
        }
        let bound = |step: u8| step - 1;
        for (k, step) in [mode.red_blue_step, mode.green_step, mode.red_blue_step].into_iter().enumerate() {
            // Differences of this image's greens are even.
            let off = worst[k] > 0 || step < 3;
            assert!(worst[k] <= bound(step) && off, "{mode:?}: {worst:?}");
        }
    }
}

/// The largest residuals there are: they do not fit a byte unless they wrap.
#[test]
fn the_strongest_contrasts_keep_the_bound_in_every_mode() {
    let mut ldi = image(130, 20, 2, 3);
    for (k, rgb) in ldi.layers.iter_mut().flat_map(|l| &mut l.rgb).enumerate() {
        *rgb = std::array::from_fn(|c| if (k * 0x9E37_79B9) >> (9 + c) & 1 == 0 { 0 } else { 255 });
    }
    for (green_step, red_blue_step) in [(1, 1), (1, 2), (1, 3), (2, 1), (3, 1), (3, 5), (32, 1), (1, 32)] {
        let out = round_trip(&ldi, ColourMode { green_step, red_blue_step, exact_contexts: 0 });
        for (a, b) in ldi.layers.iter().zip(&out.layers) {
            for (x, y) in a.rgb.iter().zip(&b.rgb) {
                for (k, step) in [red_blue_step, green_step, red_blue_step].into_iter().enumerate() {
                    assert!(x[k].abs_diff(y[k]) < step, "{green_step}, {red_blue_step}: {x:?}, {y:?}");
                }
            }
        }
    }
}

#[test]
fn an_image_without_samples_comes_back() {
    let mut ldi = image(10, 10, 1, 1);
    ldi.layers.clear();
    ldi.slivers.clear();
    assert_eq!(round_trip(&ldi, LOSSY), ldi);
    ldi.layers.push(LdiLayer::default());
    assert_eq!(round_trip(&ldi, LOSSY), ldi);
}

#[test]
fn planes_cost_little() {
    // A planar wall of one colour: a few hundred bytes for a quarter of a million samples.
    let mut random = Random(1);
    let mut ldi = image(512, 512, 1, 1);
    ldi.sky.fill(0);
    ldi.layers = vec![layer(512, 512, &mut random, |x, y| Some((20_000 + 3 * x + 5 * y) as u16))];
    let n = ldi.layers[0].len();
    ldi.layers[0].rgb.fill([120, 90, 60]);
    for (i, l) in ldi.layers[0].links.iter_mut().enumerate() {
        *l = (u8::from(i % 512 < 511) * LINK_RIGHT) | (u8::from(i / 512 < 511) * LINK_DOWN);
    }
    ldi.layers = vec![std::mem::take(&mut ldi.layers[0]).with_half_ends()];
    let bytes = encode_first(&ldi, ColourMode::LOSSLESS, 3).unwrap();
    assert!(bytes.len() < 1500, "{} bytes for {n} samples", bytes.len());
}

#[test]
fn deeper_layers_only_join_their_own_first() {
    let ldi = image(64, 32, 3, 2);
    let deeper = encode_deeper(&ldi, LOSSY, 3).unwrap().unwrap();
    let mut other = decode_first(&encode_first(&image(65, 32, 1, 2), LOSSY, 3).unwrap()).unwrap();
    let before = other.clone();
    assert!(decode_deeper(&deeper, &mut other).is_err());
    assert_eq!(other, before);
    let mut own = decode_first(&encode_first(&ldi, LOSSY, 3).unwrap()).unwrap();
    decode_deeper(&deeper, &mut own).unwrap();
    let whole = own.clone();
    assert!(decode_deeper(&deeper, &mut own).is_err(), "twice is once too often");
    assert_eq!(own, whole);
}

#[test]
fn every_truncation_and_random_damage_is_an_error_or_a_valid_image() {
    let ldi = image(150, 30, 3, 77);
    let first = encode_first(&ldi, LOSSY, 3).unwrap();
    let deeper = encode_deeper(&ldi, LOSSY, 3).unwrap().unwrap();
    let good = decode_first(&first).unwrap();
    for n in 0..first.len() {
        assert!(decode_first(&first[..n]).is_err(), "cut at {n}");
    }
    for n in 0..deeper.len() {
        assert!(decode_deeper(&deeper[..n], &mut good.clone()).is_err(), "cut at {n}");
    }
    let mut random = Random(3);
    let mut refused = 0;
    for _ in 0..2000 {
        let mut damaged = first.clone();
        let at = random.below(damaged.len() as u64) as usize;
        damaged[at] ^= 1 + random.below(255) as u8;
        match decode_first(&damaged) {
            Ok(l) => l.check().unwrap(),
            Err(_) => refused += 1,
        }
        let mut damaged = deeper.clone();
        let at = random.below(damaged.len() as u64) as usize;
        damaged[at] ^= 1 + random.below(255) as u8;
        let mut target = good.clone();
        match decode_deeper(&damaged, &mut target) {
            Ok(()) => target.check().unwrap(),
            Err(_) => {
                assert_eq!(target, good, "an error leaves the image as it was");
                refused += 1;
            }
        }
    }
    assert!(refused > 1000, "most damage must be noticed even without the hash: {refused}");
}

#[test]
fn forged_sizes_are_refused_before_they_are_allocated() {
    let bytes = encode_first(&image(64, 8, 1, 2), LOSSY, 3).unwrap();
    // Width and height follow magic, twelve vector components, the scale and two borders.
    let size_at = 4 + 13 * 8 + 8;
    let mut huge = bytes.clone();
    huge[size_at..size_at + 8].copy_from_slice(&[0, 64, 0, 0, 0, 64, 0, 0]);
    assert!(matches!(decode_first(&huge), Err(CodecError::Range { field: "pixels", .. })));
    let mut other = bytes.clone();
    other[3] = VERSION + 1;
    assert!(matches!(decode_first(&other), Err(CodecError::Version { .. })));
    assert!(matches!(decode_deeper(&bytes, &mut image(64, 8, 1, 2)), Err(CodecError::Magic { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn any_image_comes_back(width in 1u32..600, height in 1u32..20, layers in 0usize..5, seed in any::<u64>()) {
        let ldi = image(width, height, layers, seed);
        prop_assert_eq!(round_trip(&ldi, ColourMode::LOSSLESS), ldi);
    }
    #[test]
    fn any_bytes_are_survived(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = decode_first(&bytes);
        let mut with_magic = b"LDF\x01".to_vec();
        with_magic.extend(bytes);
        let _ = decode_first(&with_magic);
    }
}
