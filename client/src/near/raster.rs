//! Rasterization: the nearest triangle at each pixel centre of a band.
//!
//! In a row a triangle covers an interval of columns. Its ends are found in f64 from the edge
//! functions, so that the loop over the columns contains only the depth test, without branches.

use super::{
    attributes::Attributes,
    gather::Gathered,
    triangle_setup::{BAND_ROWS, Projection, Task, Triangle},
};

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
    #[inline]
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
        for &i in task.band(self.number) {
            let triangle = &task.triangles[i as usize];
            if (triangle.cutoff >= 0.0) == masked {
                self.draw_triangle(triangle, scene, projection);
            }
        }
    }

    fn draw_triangle(&mut self, t: &Triangle, scene: &Gathered<'_>, projection: &Projection) {
        let rows = self.ids.len() / self.width;
        let first = (t.rows[0] as usize).max(self.first_row);
        let last = (t.rows[1] as usize).min(self.first_row + rows);
        let edges = Edges::new(t);
        // Attributes are needed only for the alpha test.
        let masked = (t.cutoff >= 0.0).then(|| Attributes::new(scene, projection, t.id)).flatten();
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
            match &masked {
                None => solid_row(&row, left, disparity, ids, t.id),
                Some(attributes) => masked_row(&row, left, disparity, ids, t.id, |column| {
                    attributes.passes(projection, column as f32 + 0.5, centre as f32, t.cutoff)
                }),
            }
        }
    }
}

/// Writes every pixel where the triangle is nearer.
#[inline]
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
fn masked_row(row: &Row, left: usize, disparity: &mut [f32], ids: &mut [u32], id: u32, there: impl Fn(usize) -> bool) {
    for (i, (d, n)) in disparity.iter_mut().zip(ids).enumerate() {
        let new = row.at(left + i);
        if new > *d && there(left + i) {
            (*d, *n) = (new, id);
        }
    }
}
