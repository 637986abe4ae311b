//! SIMD: eight lanes at a time.
//!
//! The kernels of `near` and `warp` are written once, over the trait [`Lanes`], and compiled twice:
//! for plain arrays, which run everywhere, and for AVX2 registers, chosen at run time on x86-64
//! (`dispatch`). Both perform the same IEEE operations in the same order (no fused multiply-add),
//! so that pictures do not depend on the machine; a test compares them. A comparison yields all
//! ones or all zeros per lane; NaN compares false.

/// Lanes in a group.
pub const LANES: usize = 8;

/// Eight f32 in `F`, eight 32-bit integers or masks in `I`.
pub trait Lanes: Copy {
    /// Eight f32.
    type F: Copy;
    /// Eight u32, or eight masks.
    type I: Copy;

    fn splat(x: f32) -> Self::F;
    fn splat_int(x: u32) -> Self::I;
    /// The first eight of `x`, which must have as many.
    fn load(x: &[f32]) -> Self::F;
    fn load_int(x: &[u32]) -> Self::I;
    /// Eight bytes, widened to f32.
    fn load_bytes(x: &[u8]) -> Self::F;
    fn store(x: Self::F, to: &mut [f32]);
    fn array(x: Self::F) -> [f32; LANES];
    fn array_int(x: Self::I) -> [u32; LANES];
    fn add(a: Self::F, b: Self::F) -> Self::F;
    fn sub(a: Self::F, b: Self::F) -> Self::F;
    fn mul(a: Self::F, b: Self::F) -> Self::F;
    fn div(a: Self::F, b: Self::F) -> Self::F;
    /// a < b ? a : b, so the second where one is NaN.
    fn min(a: Self::F, b: Self::F) -> Self::F;
    /// a > b ? a : b, so the second where one is NaN.
    fn max(a: Self::F, b: Self::F) -> Self::F;
    fn sqrt(a: Self::F) -> Self::F;
    fn floor(a: Self::F) -> Self::F;
    /// Mask a > b.
    fn gt(a: Self::F, b: Self::F) -> Self::I;
    /// Mask a >= b.
    fn ge(a: Self::F, b: Self::F) -> Self::I;
    fn and(a: Self::I, b: Self::I) -> Self::I;
    fn or(a: Self::I, b: Self::I) -> Self::I;
    /// mask ? a : b.
    fn select(mask: Self::I, a: Self::F, b: Self::F) -> Self::F;
    /// Truncates. The caller ensures the range.
    fn to_int(a: Self::F) -> Self::I;
    /// Below 2^24, exact.
    fn from_int(a: Self::I) -> Self::F;
    fn shift_left<const N: i32>(a: Self::I) -> Self::I;
    fn shift_right<const N: i32>(a: Self::I) -> Self::I;
    /// Sum modulo 2^32.
    fn add_int(a: Self::I, b: Self::I) -> Self::I;
    /// Low 32 bits of the product.
    fn mul_int(a: Self::I, b: Self::I) -> Self::I;
    /// Bits of the floats.
    fn bits(a: Self::F) -> Self::I;
    /// Floats of the bits.
    fn from_bits(a: Self::I) -> Self::F;
    /// Elements of a table that is not empty; the last one for places past its end.
    fn gather(table: &[f32], at: Self::I) -> Self::F;
    /// Bytes of a table of at least four; the last three must not be requested.
    fn gather_bytes(table: &[u8], at: Self::I) -> Self::I;
    /// Texels of a raster that is not empty, red in the lowest byte; the last one for places past
    /// its end.
    fn gather_texels(raster: &[[u8; 4]], at: Self::I) -> Self::I;
    /// Bit i is set where lane i of the mask is.
    fn mask_bits(a: Self::I) -> u32;
    /// 64-bit integers of low and high halves.
    fn joined(low: Self::I, high: Self::I) -> [u64; LANES];
}

/// Plain arrays: the fallback and the reference.
#[derive(Clone, Copy)]
pub struct Portable;

#[inline(always)]
fn each<A: Copy, B: Copy, C>(a: [A; LANES], b: [B; LANES], f: impl Fn(A, B) -> C) -> [C; LANES] {
    std::array::from_fn(|i| f(a[i], b[i]))
}

fn mask(b: bool) -> u32 {
    if b { u32::MAX } else { 0 }
}

#[inline(always)]
fn first<T: Copy>(x: &[T]) -> [T; LANES] {
    std::array::from_fn(|i| x[i])
}

impl Lanes for Portable {
    type F = [f32; LANES];
    type I = [u32; LANES];

    #[inline(always)]
    fn splat(x: f32) -> Self::F {
        [x; LANES]
    }
    #[inline(always)]
    fn splat_int(x: u32) -> Self::I {
        [x; LANES]
    }
    #[inline(always)]
    fn load(x: &[f32]) -> Self::F {
        first(x)
    }
    #[inline(always)]
    fn load_int(x: &[u32]) -> Self::I {
        first(x)
    }
    #[inline(always)]
    fn load_bytes(x: &[u8]) -> Self::F {
        first(x).map(f32::from)
    }
    #[inline(always)]
    fn store(x: Self::F, to: &mut [f32]) {
        to[..LANES].copy_from_slice(&x);
    }
    #[inline(always)]
    fn array(x: Self::F) -> [f32; LANES] {
        x
    }
    #[inline(always)]
    fn array_int(x: Self::I) -> [u32; LANES] {
        x
    }
    #[inline(always)]
    fn add(a: Self::F, b: Self::F) -> Self::F {
        each(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(a: Self::F, b: Self::F) -> Self::F {
        each(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(a: Self::F, b: Self::F) -> Self::F {
        each(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn div(a: Self::F, b: Self::F) -> Self::F {
        each(a, b, |a, b| a / b)
    }
    #[inline(always)]
    fn min(a: Self::F, b: Self::F) -> Self::F {
        each(a, b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(a: Self::F, b: Self::F) -> Self::F {
        each(a, b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn sqrt(a: Self::F) -> Self::F {
        a.map(f32::sqrt)
    }
    #[inline(always)]
    fn floor(a: Self::F) -> Self::F {
        a.map(f32::floor)
    }
    #[inline(always)]
    fn gt(a: Self::F, b: Self::F) -> Self::I {
        each(a, b, |a, b| mask(a > b))
    }
    #[inline(always)]
    fn ge(a: Self::F, b: Self::F) -> Self::I {
        each(a, b, |a, b| mask(a >= b))
    }
    #[inline(always)]
    fn and(a: Self::I, b: Self::I) -> Self::I {
        each(a, b, |a, b| a & b)
    }
    #[inline(always)]
    fn or(a: Self::I, b: Self::I) -> Self::I {
        each(a, b, |a, b| a | b)
    }
    #[inline(always)]
    fn select(mask: Self::I, a: Self::F, b: Self::F) -> Self::F {
        std::array::from_fn(|i| if mask[i] != 0 { a[i] } else { b[i] })
    }
    #[inline(always)]
    fn to_int(a: Self::F) -> Self::I {
        a.map(|x| x as i32 as u32)
    }
    #[inline(always)]
    fn from_int(a: Self::I) -> Self::F {
        a.map(|x| x as i32 as f32)
    }
    #[inline(always)]
    fn shift_left<const N: i32>(a: Self::I) -> Self::I {
        a.map(|x| x << N)
    }
    #[inline(always)]
    fn shift_right<const N: i32>(a: Self::I) -> Self::I {
        a.map(|x| x >> N)
    }
    #[inline(always)]
    fn add_int(a: Self::I, b: Self::I) -> Self::I {
        each(a, b, u32::wrapping_add)
    }
    #[inline(always)]
    fn mul_int(a: Self::I, b: Self::I) -> Self::I {
        each(a, b, u32::wrapping_mul)
    }
    #[inline(always)]
    fn bits(a: Self::F) -> Self::I {
        a.map(f32::to_bits)
    }
    #[inline(always)]
    fn from_bits(a: Self::I) -> Self::F {
        a.map(f32::from_bits)
    }
    #[inline(always)]
    fn gather(table: &[f32], at: Self::I) -> Self::F {
        at.map(|i| table[(i as usize).min(table.len() - 1)])
    }
    #[inline(always)]
    fn gather_bytes(table: &[u8], at: Self::I) -> Self::I {
        at.map(|i| u32::from(table[(i as usize).min(table.len() - 4)]))
    }
    #[inline(always)]
    fn gather_texels(raster: &[[u8; 4]], at: Self::I) -> Self::I {
        at.map(|i| u32::from_le_bytes(raster[(i as usize).min(raster.len() - 1)]))
    }
    #[inline(always)]
    fn mask_bits(a: Self::I) -> u32 {
        a.iter().enumerate().fold(0, |bits, (i, m)| bits | (m >> 31) << i)
    }
    #[inline(always)]
    fn joined(low: Self::I, high: Self::I) -> [u64; LANES] {
        each(low, high, |low, high| u64::from(high) << 32 | u64::from(low))
    }
}

#[cfg(target_arch = "x86_64")]
pub use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{LANES, Lanes};
    use std::arch::x86_64::*;

    /// AVX2 registers. Only used inside functions that are compiled with AVX2 enabled and entered
    /// after `is_x86_feature_detected!("avx2")`: the kernels' `dispatch`.
    #[derive(Clone, Copy)]
    pub struct Avx2;

    /// One intrinsic per method.
    macro_rules! forward {
        ($($name:ident($($arg:ident: $kind:ty),*) -> $out:ty = $body:expr;)*) => {$(
            #[inline(always)]
            fn $name($($arg: $kind),*) -> $out {
                // SAFETY: the type is only used where AVX2 is present (see its documentation); no
                // memory is touched.
                unsafe { $body }
            }
        )*};
    }

    /// Limits indices to `last`, below 2^31, as gathers take signed indices.
    #[inline(always)]
    fn held(at: __m256i, last: u32) -> __m256i {
        // SAFETY: only called where AVX2 is present; no memory is touched.
        unsafe { _mm256_min_epu32(at, _mm256_set1_epi32(last.min(i32::MAX as u32) as i32)) }
    }

    impl Lanes for Avx2 {
        type F = __m256;
        type I = __m256i;

        forward! {
            splat(x: f32) -> __m256 = _mm256_set1_ps(x);
            splat_int(x: u32) -> __m256i = _mm256_set1_epi32(x as i32);
            add(a: __m256, b: __m256) -> __m256 = _mm256_add_ps(a, b);
            sub(a: __m256, b: __m256) -> __m256 = _mm256_sub_ps(a, b);
            mul(a: __m256, b: __m256) -> __m256 = _mm256_mul_ps(a, b);
            div(a: __m256, b: __m256) -> __m256 = _mm256_div_ps(a, b);
            min(a: __m256, b: __m256) -> __m256 = _mm256_min_ps(a, b);
            max(a: __m256, b: __m256) -> __m256 = _mm256_max_ps(a, b);
            sqrt(a: __m256) -> __m256 = _mm256_sqrt_ps(a);
            floor(a: __m256) -> __m256 = _mm256_floor_ps(a);
            gt(a: __m256, b: __m256) -> __m256i = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_GT_OQ>(a, b));
            ge(a: __m256, b: __m256) -> __m256i = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_GE_OQ>(a, b));
            and(a: __m256i, b: __m256i) -> __m256i = _mm256_and_si256(a, b);
            or(a: __m256i, b: __m256i) -> __m256i = _mm256_or_si256(a, b);
            select(mask: __m256i, a: __m256, b: __m256) -> __m256 = _mm256_blendv_ps(b, a, _mm256_castsi256_ps(mask));
            to_int(a: __m256) -> __m256i = _mm256_cvttps_epi32(a);
            from_int(a: __m256i) -> __m256 = _mm256_cvtepi32_ps(a);
            add_int(a: __m256i, b: __m256i) -> __m256i = _mm256_add_epi32(a, b);
            mul_int(a: __m256i, b: __m256i) -> __m256i = _mm256_mullo_epi32(a, b);
            bits(a: __m256) -> __m256i = _mm256_castps_si256(a);
            from_bits(a: __m256i) -> __m256 = _mm256_castsi256_ps(a);
            mask_bits(a: __m256i) -> u32 = _mm256_movemask_ps(_mm256_castsi256_ps(a)) as u32;
        }

        #[inline(always)]
        fn joined(low: __m256i, high: __m256i) -> [u64; LANES] {
            let mut to = [0; LANES];
            // SAFETY: AVX2 is present; there is room for eight integers; the stores may be
            // unaligned.
            unsafe {
                let (even, odd) = (_mm256_unpacklo_epi32(low, high), _mm256_unpackhi_epi32(low, high));
                _mm256_storeu_si256(to.as_mut_ptr().cast(), _mm256_permute2x128_si256::<0x20>(even, odd));
                _mm256_storeu_si256(to[4..].as_mut_ptr().cast(), _mm256_permute2x128_si256::<0x31>(even, odd));
            }
            to
        }
        #[inline(always)]
        fn shift_left<const N: i32>(a: __m256i) -> __m256i {
            // SAFETY: AVX2 is present; no memory is touched.
            unsafe { _mm256_slli_epi32::<N>(a) }
        }
        #[inline(always)]
        fn shift_right<const N: i32>(a: __m256i) -> __m256i {
            // SAFETY: AVX2 is present; no memory is touched.
            unsafe { _mm256_srli_epi32::<N>(a) }
        }
        #[inline(always)]
        fn gather(table: &[f32], at: __m256i) -> __m256 {
            let last = u32::try_from(table.len() - 1).unwrap_or(i32::MAX as u32);
            // SAFETY: AVX2 is present; places are held within the table, whose length fits 31 bits
            // where it matters.
            unsafe { _mm256_i32gather_ps::<4>(table.as_ptr(), held(at, last)) }
        }
        #[inline(always)]
        fn gather_bytes(table: &[u8], at: __m256i) -> __m256i {
            let last = u32::try_from(table.len() - 4).unwrap_or(i32::MAX as u32);
            // SAFETY: AVX2 is present; four bytes from any place that is held so are in the table.
            unsafe {
                let words = _mm256_i32gather_epi32::<1>(table.as_ptr().cast(), held(at, last));
                _mm256_and_si256(words, _mm256_set1_epi32(255))
            }
        }
        #[inline(always)]
        fn gather_texels(raster: &[[u8; 4]], at: __m256i) -> __m256i {
            let last = u32::try_from(raster.len() - 1).unwrap_or(i32::MAX as u32);
            // SAFETY: AVX2 is present; places are held within the raster; the reads may be
            // unaligned.
            unsafe { _mm256_i32gather_epi32::<4>(raster.as_ptr().cast(), held(at, last)) }
        }
        #[inline(always)]
        fn load(x: &[f32]) -> __m256 {
            let x = &x[..LANES];
            // SAFETY: AVX2 is present; eight floats are there; the load may be unaligned.
            unsafe { _mm256_loadu_ps(x.as_ptr()) }
        }
        #[inline(always)]
        fn load_int(x: &[u32]) -> __m256i {
            let x = &x[..LANES];
            // SAFETY: AVX2 is present; eight integers are there; the load may be unaligned.
            unsafe { _mm256_loadu_si256(x.as_ptr().cast()) }
        }
        #[inline(always)]
        fn load_bytes(x: &[u8]) -> __m256 {
            let x = &x[..LANES];
            // SAFETY: AVX2 is present; eight bytes are there; the load may be unaligned.
            unsafe { _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64(x.as_ptr().cast()))) }
        }
        #[inline(always)]
        fn store(x: __m256, to: &mut [f32]) {
            let to = &mut to[..LANES];
            // SAFETY: AVX2 is present; there is room for eight floats; the store may be unaligned.
            unsafe { _mm256_storeu_ps(to.as_mut_ptr(), x) }
        }
        #[inline(always)]
        fn array(x: __m256) -> [f32; LANES] {
            let mut to = [0.0; LANES];
            Self::store(x, &mut to);
            to
        }
        #[inline(always)]
        fn array_int(x: __m256i) -> [u32; LANES] {
            let mut to = [0; LANES];
            // SAFETY: AVX2 is present; there is room for eight integers; the store may be
            // unaligned.
            unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), x) };
            to
        }
    }
}
