//! Summed-area table: how many of a block of squares hold, in four lookups (Crow 1984).

use std::ops::Range;

/// Counts over blocks of a raster of squares.
#[derive(Debug, Clone)]
pub(super) struct Sums {
    /// How many of the squares above and left of each corner of a square hold: one row and one
    /// column more than squares.
    sums: Vec<u32>,
    columns: usize,
}

impl Sums {
    /// Of squares, row-major.
    pub fn new(squares: &[bool], columns: usize) -> Self {
        let width = columns + 1;
        let mut sums = vec![0; width];
        for (row, line) in squares.chunks_exact(columns).enumerate() {
            let mut left = 0;
            sums.push(0);
            for (column, holds) in line.iter().enumerate() {
                left += u32::from(*holds);
                sums.push(sums[row * width + column + 1] + left);
            }
        }
        Self { sums, columns }
    }

    /// How many squares of a block hold.
    #[inline]
    pub fn count(&self, columns: Range<usize>, rows: Range<usize>) -> u32 {
        let sum = |row: usize, column: usize| self.sums[row * (self.columns + 1) + column];
        sum(rows.end, columns.end) + sum(rows.start, columns.start)
            - sum(rows.start, columns.end)
            - sum(rows.end, columns.start)
    }

    /// The smallest block around the squares of a block that hold; None if none does.
    pub fn tight(&self, columns: Range<usize>, rows: Range<usize>) -> Option<(Range<usize>, Range<usize>)> {
        let column = |c: &usize| self.count(*c..*c + 1, rows.clone()) > 0;
        let (left, right) = (columns.clone().find(column)?, columns.clone().rev().find(column)?);
        let row = |r: &usize| self.count(columns.clone(), *r..*r + 1) > 0;
        let (top, bottom) = (rows.clone().find(row)?, rows.clone().rev().find(row)?);
        Some((left..right + 1, top..bottom + 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_those_of_adding_up() {
        let squares: Vec<bool> = (0..7 * 5).map(|i| i * i % 11 < 3).collect();
        let sums = Sums::new(&squares, 7);
        for (c0, c1) in (0..=7).flat_map(|a| (a..=7).map(move |b| (a, b))) {
            for (r0, r1) in (0..=5).flat_map(|a| (a..=5).map(move |b| (a, b))) {
                let inside: Vec<(usize, usize)> =
                    (c0..c1).flat_map(|c| (r0..r1).map(move |r| (c, r))).filter(|(c, r)| squares[r * 7 + c]).collect();
                assert_eq!(sums.count(c0..c1, r0..r1), inside.len() as u32);
                let span = |v: Vec<usize>| Some(*v.iter().min()?..*v.iter().max()? + 1);
                let tight = span(inside.iter().map(|i| i.0).collect()).zip(span(inside.iter().map(|i| i.1).collect()));
                assert_eq!(sums.tight(c0..c1, r0..r1), tight);
            }
        }
    }
}
