//! Colours of the visible pixels of a band of rows.

use super::{
    attributes::Attributes,
    gather::Gathered,
    shade_simd::shade8,
    triangle_setup::{NO_TRIANGLE, Projection},
};
use crate::simd::{LANES, Lanes, Portable};

/// Slots of a band's attribute table; direct-mapped. A triangle spans several rows, and its
/// neighbours recur row after row. Fewer: attributes are computed again; more: more memory to
/// initialize.
const SLOTS: usize = 256;

/// Shades the covered pixels of a band that starts at `first_row`.
pub(super) fn shade_band(
    scene: &Gathered<'_>,
    projection: &Projection,
    first_row: usize,
    ids: &[u32],
    colour: &mut [u32],
) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: AVX2 was detected.
        return unsafe { shade_band_avx2(scene, projection, first_row, ids, colour) };
    }
    shade_band_with::<Portable>(scene, projection, first_row, ids, colour);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn shade_band_avx2(scene: &Gathered<'_>, projection: &Projection, first_row: usize, ids: &[u32], colour: &mut [u32]) {
    shade_band_with::<crate::simd::Avx2>(scene, projection, first_row, ids, colour);
}

/// Shorter runs of one triangle are shaded pixel by pixel, which is faster for them.
const SHORTEST_RUN: usize = 3;

#[inline(always)]
pub(super) fn shade_band_with<L: Lanes>(
    scene: &Gathered<'_>,
    projection: &Projection,
    first_row: usize,
    ids: &[u32],
    colour: &mut [u32],
) {
    let mut slots: Vec<Option<Attributes<'_>>> = vec![None; SLOTS];
    for (row, (ids, colour)) in ids.chunks(projection.width).zip(colour.chunks_mut(projection.width)).enumerate() {
        let y = (first_row + row) as f32 + 0.5;
        let mut column = 0;
        for run in ids.chunk_by(|a, b| a == b) {
            let (first, id) = (column, run[0]);
            column += run.len();
            if id == NO_TRIANGLE {
                continue;
            }
            let slot = &mut slots[slot_of(id)];
            if slot.as_ref().is_none_or(|s| s.id != id) {
                *slot = Attributes::new(scene, projection, id);
            }
            let Some(attributes) = slot else { continue };
            let colour = &mut colour[first..column];
            match attributes.constant {
                Some(constant) => colour.fill(constant),
                None if run.len() < SHORTEST_RUN => {
                    for (x, colour) in (first..).zip(colour) {
                        *colour = attributes.shade(projection, x as f32 + 0.5, y);
                    }
                }
                None => {
                    for (x, colour) in (first..).step_by(LANES).zip(colour.chunks_mut(LANES)) {
                        shade8::<L>(attributes, projection, x, y, colour);
                    }
                }
            }
        }
    }
}

/// Fibonacci hashing (Knuth 6.4): neighbouring numbers fall into different slots.
fn slot_of(id: u32) -> usize {
    (id.wrapping_mul(0x9E37_79B9) >> 24) as usize % SLOTS
}
