//! Rasterization: the nearest triangle at each pixel centre of a band.
//!
//! In a row a triangle covers an interval of columns. Its ends are found in f64 from the edge
//! functions, so that the loop over the columns contains only the depth test, without branches.
//! Alpha is tested at eight pixels at a time, where the triangle is nearer.

use super::{
    attributes::Attributes,
    gather::Gathered,
    lane_math::centres,
    triangle_setup::{BAND_ROWS, Projection, Task, Triangle},
};
use crate::simd::{LANES, Lanes, Portable};

/// One band of the frame's disparity and triangle numbers.
pub(super) struct Band<'a> {
    number: usize,
    first_row: usize,
    width: usize,
    disparity: &'a mut [f32],
    ids: &'a mut [u32],
}

/// The edges of a triangle, prepared for finding the covered columns of a row.
struct Edges<'a> {
    triangle: &'a Triangle,
    /// 1 / a; not used where a is 0.
    inverse: [f64; 3],
    /// Whether pixels exactly on the edge belong to the triangle: left edges and top edges.
    owns: [bool; 3],
}

impl<'a> Edges<'a> {
    fn new(triangle: &'a Triangle) -> Self {
        let (a, b) = (&triangle.a, &triangle.b);
        Self {
            triangle,
            inverse: a.map(|a| 1.0 / a),
            owns: std::array::from_fn(|i| a[i] > 0.0 || (a[i] == 0.0 && b[i] > 0.0)),
        }
    }

    /// The columns of [left, right) whose centres in the row at `centre` are inside.
    ///
    /// The sign of `a x + (b y + c)`, as f64 rounds it, decides. The neighbour across an edge
    /// evaluates the same expression with every term negated and gets the exact opposite: no gap,
    /// no overlap. The division only estimates where the sign changes; the sign itself is evaluated
    /// near the estimate.
    #[inline(always)]
    fn columns(&self, centre: f64, left: usize, right: usize) -> (usize, usize) {
        let (mut left, mut right) = (left, right);
        for i in 0..3 {
            let (a, at_zero) = (self.triangle.a[i], self.triangle.b[i] * centre + self.triangle.c[i]);
            let inside = |column: usize| {
                let e = a * (column as f64 + 0.5) + at_zero;
                e > 0.0 || (e == 0.0 && self.owns[i])
            };
            if a == 0.0 {
                if !inside(0) {
                    return (0, 0);
                }
                continue;
            }
            // The saturating cast takes everything left of the picture, and NaN, to 0.
            let mut border = ((0.5 - at_zero * self.inverse[i]) as usize).clamp(left, right);
            if a > 0.0 {
                while border < right && !inside(border) {
                    border += 1;
                }
                while border > left && inside(border - 1) {
                    border -= 1;
                }
                left = border;
            } else {
                while border > left && !inside(border - 1) {
                    border -= 1;
                }
                while border < right && inside(border) {
                    border += 1;
                }
                right = border;
            }
        }
        (left, right)
    }
}

/// A triangle's disparity along one row.
struct Row {
    slope: f32,
    at_zero: f32,
    range: [f32; 2],
}

impl Row {
    /// [`at`](Self::at) of eight columns by their centres.
    #[inline(always)]
    fn at8<L: Lanes>(&self, x: L::F) -> L::F {
        let d = L::add(L::mul(L::splat(self.slope), x), L::splat(self.at_zero));
        L::min(L::max(d, L::splat(self.range[0])), L::splat(self.range[1]))
    }

    #[inline(always)]
    fn at(&self, column: usize) -> f32 {
        // Through i32: the conversion from usize does not vectorize on x86-64 before AVX-512.
        let d = self.slope * (column as i32 as f32 + 0.5) + self.at_zero;
        // Not `clamp`, `max` or `min`, whose NaN handling takes more instructions.
        let d = if d > self.range[0] { d } else { self.range[0] };
        if d < self.range[1] { d } else { self.range[1] }
    }
}

impl<'a> Band<'a> {
    pub fn new(number: usize, width: usize, disparity: &'a mut [f32], ids: &'a mut [u32]) -> Self {
        Self { number, first_row: number * BAND_ROWS, width, disparity, ids }
    }

    /// Draws a task's triangles in this band, either those with an alpha test or those without.
    pub fn draw(&mut self, task: &Task, masked: bool, scene: &Gathered<'_>, projection: &Projection) {
        if masked && !task.any_masked {
            return;
        }
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: AVX2 was detected.
            return unsafe { self.draw_avx2(task, masked, scene, projection) };
        }
        self.draw_with::<Portable>(task, masked, scene, projection);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn draw_avx2(&mut self, task: &Task, masked: bool, scene: &Gathered<'_>, projection: &Projection) {
        self.draw_with::<crate::simd::Avx2>(task, masked, scene, projection);
    }

    #[inline(always)]
    fn draw_with<L: Lanes>(&mut self, task: &Task, masked: bool, scene: &Gathered<'_>, projection: &Projection) {
        for &i in task.band(self.number) {
            let triangle = &task.triangles[i as usize];
            if (triangle.cutoff >= 0.0) == masked {
                self.draw_triangle::<L>(triangle, scene, projection);
            }
        }
    }

    #[inline(always)]
    fn draw_triangle<L: Lanes>(&mut self, t: &Triangle, scene: &Gathered<'_>, projection: &Projection) {
        let rows = self.ids.len() / self.width;
        let first = (t.rows[0] as usize).max(self.first_row);
        let last = (t.rows[1] as usize).min(self.first_row + rows);
        let edges = Edges::new(t);
        let mut mask = Mask { triangle: t, scene, projection, attributes: None };
        for y in first..last {
            let centre = y as f64 + 0.5;
            let (left, right) = edges.columns(centre, t.columns[0] as usize, t.columns[1] as usize);
            if left >= right {
                continue;
            }
            let row = Row {
                slope: t.disparity_a,
                at_zero: (f64::from(t.disparity_b) * centre + t.disparity_c) as f32,
                range: t.disparity_range,
            };
            let offset = (y - self.first_row) * self.width;
            let disparity = &mut self.disparity[offset + left..offset + right];
            let ids = &mut self.ids[offset + left..offset + right];
            match t.cutoff >= 0.0 {
                false => solid_row(&row, left, disparity, ids, t.id),
                true => masked_row::<L>(&row, (left, centre as f32), disparity, ids, &mut mask),
            }
        }
    }
}

/// The alpha test of a triangle. Its attributes are found when a pixel needs them.
struct Mask<'a> {
    triangle: &'a Triangle,
    scene: &'a Gathered<'a>,
    projection: &'a Projection,
    attributes: Option<Attributes<'a>>,
}

impl Mask<'_> {
    /// Which of eight pixels with centres `x` pass, of those whose bits are set in `wanted`.
    #[inline(always)]
    fn passes8<L: Lanes>(&mut self, x: L::F, y: f32, wanted: u32) -> u32 {
        if self.attributes.is_none() {
            self.attributes = Attributes::new(self.scene, self.projection, self.triangle.id);
        }
        match &self.attributes {
            Some(attributes) => attributes.passes8::<L>(self.projection.rays8::<L>(x, y), self.triangle.cutoff, wanted),
            None => 0,
        }
    }
}

/// Writes every pixel where the triangle is nearer.
#[inline(always)]
fn solid_row(row: &Row, left: usize, disparity: &mut [f32], ids: &mut [u32], id: u32) {
    for (i, (d, n)) in disparity.iter_mut().zip(ids).enumerate() {
        let new = row.at(left + i);
        // Masks instead of an `if`, which the compiler turns into a branch per pixel.
        let visible = u32::from(new > *d).wrapping_neg();
        *d = f32::from_bits((new.to_bits() & visible) | (d.to_bits() & !visible));
        *n = (id & visible) | (*n & !visible);
    }
}

/// As [`solid_row`], for pixels that pass the alpha test.
#[inline(always)]
fn masked_row<L: Lanes>(
    row: &Row,
    (left, y): (usize, f32),
    disparity: &mut [f32],
    ids: &mut [u32],
    mask: &mut Mask<'_>,
) {
    let columns = (left..).step_by(LANES);
    for (column, (disparity, ids)) in columns.zip(disparity.chunks_mut(LANES).zip(ids.chunks_mut(LANES))) {
        let x = centres::<L>(column);
        let new = row.at8::<L>(x);
        // Nothing is nearer than what lies beyond the end of a row.
        let mut old = [f32::INFINITY; LANES];
        old[..disparity.len()].copy_from_slice(disparity);
        let nearer = L::mask_bits(L::gt(new, L::load(&old)));
        if nearer == 0 {
            continue;
        }
        let mut there = mask.passes8::<L>(x, y, nearer);
        let new = L::array(new);
        while there != 0 {
            let i = there.trailing_zeros() as usize & (LANES - 1);
            there &= there - 1;
            if let (Some(d), Some(id)) = (disparity.get_mut(i), ids.get_mut(i)) {
                (*d, *id) = (new[i], mask.triangle.id);
            }
        }
    }
}
