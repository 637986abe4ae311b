//! Scaling of pictures to the window's size by the CPU, for software adapters.
//!
//! In: packed sRGB codes, red in the lowest byte, rows from the top; the window's size. Out: codes
//! of the window's pixels, blue in the lowest byte. Bilinear between pixel centres, clamped at the
//! borders. Codes are interpolated directly: linear light (as in `picture.wgsl`) would need tables,
//! for a difference that moving pictures do not show.

/// Unit of weights.
const ONE: u16 = 256;
/// One byte in each of four lanes of 16 bits, which hold a byte times [`ONE`].
const BYTES: u64 = 0x00ff_00ff_00ff_00ff;
/// Half a code in each lane.
const HALF: u64 = 0x0080_0080_0080_0080;

/// Scales pictures; keeps buffers between them.
#[derive(Debug, Default)]
pub struct SoftwareUpscaler {
    /// Source columns of each target column, and the weight of the right one.
    columns: Vec<([u32; 2], u64)>,
    /// A source row, in lanes.
    source: Vec<u64>,
    /// The two source rows around the last target row, scaled horizontally, four lanes per pixel;
    /// and their numbers.
    rows: [(Option<usize>, Vec<u16>); 2],
}

impl SoftwareUpscaler {
    /// Scales a picture of size `from` to `out` of size `to`; no side may be 0. Swaps red and blue.
    pub fn stretch(&mut self, codes: &[u32], from: [u32; 2], out: &mut [u32], to: [u32; 2]) {
        if from == to {
            out.iter_mut().zip(codes).for_each(|(out, c)| *out = c & 0xff00_ff00 | (c & 0xff) << 16 | c >> 16 & 0xff);
            return;
        }
        let (w, width) = (from[0] as usize, to[0] as usize);
        self.columns.clear();
        self.columns.extend((0..to[0]).map(|x| {
            let (neighbours, weight) = neighbours(x, from[0], to[0]);
            (neighbours, u64::from(weight))
        }));
        self.rows.iter_mut().for_each(|r| r.0 = None);
        for (y, out) in out.chunks_exact_mut(width.max(1)).enumerate() {
            let (numbers, weight) = neighbours(y as u32, from[1], to[1]);
            let numbers = numbers.map(|n| n as usize);
            if self.rows[1].0 == Some(numbers[0]) {
                self.rows.swap(0, 1);
            }
            for (row, number) in self.rows.iter_mut().zip(numbers) {
                if row.0 == Some(number) {
                    continue;
                }
                row.0 = Some(number);
                row.1.resize(4 * width, 0);
                self.source.clear();
                self.source.extend(codes[number * w..(number + 1) * w].iter().map(|c| lanes(*c)));
                for (out, ([left, right], weight)) in row.1.chunks_exact_mut(4).zip(&self.columns) {
                    let (left, right) = (self.source[*left as usize], self.source[*right as usize]);
                    let mixed = (left * (u64::from(ONE) - weight) + right * weight + HALF) >> 8 & BYTES;
                    for (lane, out) in out.iter_mut().enumerate() {
                        *out = (mixed >> (16 * lane)) as u16;
                    }
                }
            }
            let (above, below) = (&self.rows[0].1, &self.rows[1].1);
            let bytes: &mut [u8] = bytemuck::cast_slice_mut(out);
            for ((out, a), b) in bytes.iter_mut().zip(above).zip(below) {
                *out = ((a * (ONE - weight) + b * weight + 128) >> 8) as u8;
            }
        }
    }
}

/// The source pixels around target pixel `n`, and the weight of the second.
fn neighbours(n: u32, from: u32, to: u32) -> ([u32; 2], u16) {
    let at = ((f64::from(n) + 0.5) * f64::from(from) / f64::from(to) - 0.5).clamp(0.0, f64::from(from - 1));
    ([at as u32, (at as u32 + 1).min(from - 1)], (at.fract() * f64::from(ONE)).round() as u16)
}

/// The channels as lanes, in the order of the window's bytes.
fn lanes(code: u32) -> u64 {
    let [red, green, blue, alpha] = code.to_le_bytes().map(u64::from);
    blue | green << 16 | red << 32 | alpha << 48
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Reference in f64, for one channel.
    fn reference(codes: &[u32], from: [u32; 2], to: [u32; 2], [x, y]: [u32; 2], shift: u32) -> f64 {
        let place = |n: u32, axis: usize| {
            let at = (f64::from(n) + 0.5) * f64::from(from[axis]) / f64::from(to[axis]) - 0.5;
            let at = at.clamp(0.0, f64::from(from[axis] - 1));
            (at.floor() as u32, (at.floor() as u32 + 1).min(from[axis] - 1), at.fract())
        };
        let ((l, r, u), (a, b, v)) = (place(x, 0), place(y, 1));
        let code = |x: u32, y: u32| f64::from(codes[(y * from[0] + x) as usize] >> shift & 0xff);
        (code(l, a) * (1.0 - u) + code(r, a) * u) * (1.0 - v) + (code(l, b) * (1.0 - u) + code(r, b) * u) * v
    }

    proptest! {
        #[test]
        fn it_is_bilinear_in_codes(
            seed in any::<u32>(), from in [1u32..9, 1u32..9], to in [1u32..20, 1u32..20],
        ) {
            let code = |i: u32| (seed ^ i).wrapping_mul(0x9e37_79b9) ^ (seed ^ i).wrapping_mul(0x85eb_ca6b) >> 13;
            let codes: Vec<u32> = (0..from[0] * from[1]).map(code).collect();
            let mut stretcher = SoftwareUpscaler::default();
            // Buffers of a previous picture must not show.
            stretcher.stretch(&codes, from, &mut [0; 35], [7, 5]);
            let mut pixels = vec![0; (to[0] * to[1]) as usize];
            stretcher.stretch(&codes, from, &mut pixels, to);
            for (i, got) in pixels.iter().enumerate() {
                let at = [i as u32 % to[0], i as u32 / to[0]];
                for (shift, source) in [0, 8, 16, 24].into_iter().zip([16, 8, 0, 24]) {
                    let want = reference(&codes, from, to, at, source);
                    // Error bound: rounding of half a code, and of weights by half a 256th of 255,
                    // twice.
                    prop_assert!((f64::from(got >> shift & 0xff) - want).abs() <= 2.0, "{:?}: {} is not {}", at, got >> shift & 0xff, want);
                }
            }
        }
    }

    #[test]
    fn pictures_as_large_as_the_window_keep_their_codes() {
        let mut pixels = [0; 2];
        SoftwareUpscaler::default().stretch(&[0xff01_0203, 0xff0a_0b0c], [2, 1], &mut pixels, [2, 1]);
        assert_eq!(pixels, [0xff03_0201, 0xff0c_0b0a]);
    }
}
