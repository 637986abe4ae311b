//! The one shading function of ray caster, rasterizer and GPU, and the colour spaces around it.

/// sRGB colour where no geometry is.
pub const SKY_SRGB: [u8; 3] = [198, 214, 235];

/// Where the light comes from: normalize(0.4, 0.8, 0.45).
pub const LIGHT_FROM: [f32; 3] = [0.399_667_94, 0.799_335_9, 0.449_626_43];

/// Light that a surface with unit normal `n` reflects, in linear light: 0.35 + 0.25 (0.5 + 0.5
/// n_y) + 0.40 |n . l| with l = normalize(0.4, 0.8, 0.45). The normal is never flipped toward the
/// eye. Unlit materials take 1 instead.
#[inline]
pub fn light(n: [f32; 3]) -> f32 {
    let d = n[0] * LIGHT_FROM[0] + n[1] * LIGHT_FROM[1] + n[2] * LIGHT_FROM[2];
    0.35 + 0.25 * (0.5 + 0.5 * n[1]) + 0.40 * d.abs()
}

/// One sRGB channel in [0, 1] to linear light (IEC 61966-2-1).
#[inline]
pub fn linear_from_srgb(s: f32) -> f32 {
    if s <= 0.040_45 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
}

/// One linear channel to sRGB in [0, 1]; clamps first.
#[inline]
pub fn srgb_from_linear(l: f32) -> f32 {
    let l = l.clamp(0.0, 1.0);
    if l <= 0.003_130_8 { l * 12.92 } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 }
}

/// The 256 linear values of 8-bit sRGB codes.
pub fn linear_from_srgb8_table() -> &'static [f32; 256] {
    static TABLE: std::sync::LazyLock<[f32; 256]> =
        std::sync::LazyLock::new(|| std::array::from_fn(|i| linear_from_srgb(i as f32 / 255.0)));
    &TABLE
}

/// Linear light to the nearest 8-bit sRGB code, by table: at most one code from the exact
/// rounding, and exact for every value of [`linear_from_srgb8_table`].
#[inline]
pub fn srgb8_from_linear(l: f32) -> u8 {
    srgb8_table()[(l.clamp(0.0, 1.0).sqrt() * SRGB8_TABLE_SCALE + 0.5) as usize]
}

/// See [`srgb8_table`].
pub const SRGB8_TABLE_SCALE: f32 = SRGB8_STEPS as f32;
const SRGB8_STEPS: usize = 1 << 14;

/// The table behind [`srgb8_from_linear`]: the code of the light l is at sqrt(l) times
/// [`SRGB8_TABLE_SCALE`], rounded. Square-root spacing: the curve is steep near black, where a
/// uniform table would need 20 bits. Three bytes follow, so that four may be read anywhere.
#[inline]
pub fn srgb8_table() -> &'static [u8] {
    static TABLE: std::sync::LazyLock<Vec<u8>> = std::sync::LazyLock::new(|| {
        let code = |i: usize| (srgb_from_linear((i as f32 / SRGB8_TABLE_SCALE).powi(2)) * 255.0 + 0.5) as u8;
        (0..=SRGB8_STEPS).map(code).chain([0; 3]).collect()
    });
    &TABLE
}
