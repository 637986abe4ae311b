//! Occlusion by earlier batches: the farthest depth per tile, against which later clusters and
//! triangles are rejected.
//!
//! In: the depth buffer after a batch. Out: a conservative test: rejected objects cannot win a
//! single pixel. After the hierarchical depth buffer of Greene, Kass and Miller ("Hierarchical
//! Z-Buffer Visibility", SIGGRAPH 1993), with one level instead of a pyramid: cells come near to
//! far, so that a batch of walls hides most of what follows, and a screen has few tiles. The
//! picture is the same with and without.
//! follows, and a screen has only some thousand tiles. The picture is the same with and without.

use rayon::prelude::*;

/// Pixels along a side of a tile. Larger: hides less behind small occluders; smaller: takes longer
/// to build and to query.
const TILE: usize = 16;

/// The farthest depths. Initially nothing is hidden.
#[derive(Debug, Default)]
pub(super) struct Horizon {
    columns: usize,
    /// Smallest disparity of each tile, row-major; 0 where a pixel is still empty.
    farthest: Vec<f32>,
}

impl Horizon {
    /// Resets to nothing hidden, for a picture of this size.
    pub fn reset(&mut self, width: usize, height: usize) {
        self.columns = width.div_ceil(TILE);
        self.farthest.clear();
        self.farthest.resize(self.columns * height.div_ceil(TILE), 0.0);
    }

    /// Updates from the depth buffer, rows of `width` disparities.
    pub fn update(&mut self, disparity: &[f32], width: usize) {
        self.farthest.par_chunks_mut(self.columns).zip(disparity.par_chunks(width * TILE)).for_each(|(tiles, rows)| {
            tiles.fill(f32::INFINITY);
            for row in rows.chunks(width) {
                for (tile, pixels) in tiles.iter_mut().zip(row.chunks(TILE)) {
                    // Not `f32::min`: its NaN handling does not vectorize.
                    *tile = pixels.iter().fold(*tile, |least, d| if *d < least { *d } else { least });
                }
            }
        });
    }

    /// Whether everything up to disparity `nearest` is hidden in the pixels of `columns` x `rows`
    /// (half-open).
    #[inline]
    pub fn hides(&self, columns: [usize; 2], rows: [usize; 2], nearest: f32) -> bool {
        if columns[0] >= columns[1] || rows[0] >= rows[1] {
            return true;
        }
        (rows[0] / TILE..=(rows[1] - 1) / TILE).all(|row| {
            let (first, last) = (row * self.columns + columns[0] / TILE, row * self.columns + (columns[1] - 1) / TILE);
            self.farthest.get(first..=last).is_some_and(|tiles| tiles.iter().all(|t| *t >= nearest))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hidden_means_that_every_pixel_is_nearer() {
        let (width, height) = (50usize, 37usize);
        let disparity: Vec<f32> =
            (0..width * height).map(|i| 0.5 + ((i as u32).wrapping_mul(2_654_435_761) >> 20) as f32 / 4096.0).collect();
        let mut horizon = Horizon::default();
        horizon.reset(width, height);
        assert!(!horizon.hides([3, 9], [2, 5], 0.1));
        horizon.update(&disparity, width);
        let (mut hidden, mut open) = (0, 0);
        for i in 0..4000usize {
            let (x, y) = (i * 7 % width, i * 11 % height);
            let (columns, rows) = ([x, (x + 1 + i % 20).min(width)], [y, (y + 1 + i % 13).min(height)]);
            let nearest = 0.45 + (i % 100) as f32 * 0.002;
            if horizon.hides(columns, rows, nearest) {
                hidden += 1;
                let all = (rows[0]..rows[1])
                    .all(|r| disparity[r * width + columns[0]..r * width + columns[1]].iter().all(|d| *d >= nearest));
                assert!(all, "{columns:?} {rows:?} {nearest}");
            } else {
                open += 1;
            }
        }
        assert!(hidden > 100 && open > 100, "{hidden} {open}");
    }
}
