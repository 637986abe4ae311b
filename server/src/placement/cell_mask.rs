//! Sets of cells with a bit for each.

use std::ops::Range;

/// A set of cells.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct CellMask {
    words: Vec<u64>,
}

impl CellMask {
    /// The empty set of `n` cells.
    pub fn none(n: usize) -> Self {
        Self { words: vec![0; n.div_ceil(64)] }
    }
    /// The set of these cells out of `n`.
    pub fn of(n: usize, cells: &[u32]) -> Self {
        let mut out = Self::none(n);
        cells.iter().for_each(|c| out.insert(*c));
        out
    }
    /// Adds a cell.
    #[inline]
    pub fn insert(&mut self, cell: u32) {
        self.words[cell as usize / 64] |= 1 << (cell % 64);
    }
    /// Adds the cells `of`.
    pub fn insert_all(&mut self, of: Range<usize>) {
        spans(of).for_each(|(word, bits)| self.words[word] |= bits);
    }
    /// Whether all cells `of` are in it.
    #[inline]
    pub fn has_all(&self, of: Range<usize>) -> bool {
        spans(of).all(|(word, bits)| self.words[word] & bits == bits)
    }
    /// Whether any of the cells `of` is in it.
    #[inline]
    pub fn has_any(&self, of: Range<usize>) -> bool {
        spans(of).any(|(word, bits)| self.words[word] & bits != 0)
    }
    /// The bits of the cells from `first` on, up to the next multiple of 64.
    #[inline]
    pub fn bits_from(&self, first: usize) -> u64 {
        self.words[first / 64] >> (first % 64)
    }
    /// How many of the cells `of` are in it.
    #[inline]
    pub fn count_in(&self, of: Range<usize>) -> u32 {
        spans(of).map(|(word, bits)| (self.words[word] & bits).count_ones()).sum()
    }
    /// Whether a cell is in it.
    #[inline]
    pub fn has(&self, cell: u32) -> bool {
        self.words.get(cell as usize / 64).is_some_and(|w| w >> (cell % 64) & 1 == 1)
    }
    /// Adds the cells of another set.
    pub fn add(&mut self, other: &Self) {
        self.words.iter_mut().zip(&other.words).for_each(|(a, b)| *a |= b);
    }
    /// Takes out the cells of another set.
    pub fn remove(&mut self, other: &Self) {
        self.words.iter_mut().zip(&other.words).for_each(|(a, b)| *a &= !b);
    }
    /// Number of its cells.
    pub fn count(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }
    /// Its cells, ascending.
    pub fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        self.iter_in(0..self.words.len() * 64)
    }
    /// Those of the cells `of` that are in it, ascending.
    #[inline]
    pub fn iter_in(&self, of: Range<usize>) -> impl Iterator<Item = u32> + '_ {
        spans(of).flat_map(|(word, bits)| {
            let mut bits = self.words[word] & bits;
            std::iter::from_fn(move || {
                let bit = (bits != 0).then(|| bits.trailing_zeros())?;
                bits &= bits - 1;
                Some(word as u32 * 64 + bit)
            })
        })
    }
}

/// The words that hold the bits `of`, each with those of them that it holds.
#[inline]
fn spans(of: Range<usize>) -> impl Iterator<Item = (usize, u64)> {
    let words = if of.is_empty() { 0..0 } else { of.start / 64..of.end.div_ceil(64) };
    words.map(move |word| {
        let from = of.start.saturating_sub(word * 64);
        let to = (of.end - word * 64).min(64);
        (word, (u64::MAX >> (64 - to)) & (u64::MAX << from))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_add_and_remove() {
        let mut a = CellMask::of(200, &[1, 64, 199]);
        a.add(&CellMask::of(200, &[2, 64]));
        assert_eq!(a.iter().collect::<Vec<_>>(), [1, 2, 64, 199]);
        a.remove(&CellMask::of(200, &[2, 199]));
        assert_eq!(a.iter().collect::<Vec<_>>(), [1, 64]);
    }

    #[test]
    fn ranges_are_those_of_single_cells() {
        let cells: Vec<u32> = (0..300).filter(|c| c % 7 < 3 || (60..140).contains(c)).collect();
        let set = CellMask::of(300, &cells);
        for from in 0..300 {
            for to in from..=300 {
                let of: Vec<u32> = cells.iter().copied().filter(|c| (from..to).contains(&(*c as usize))).collect();
                assert_eq!(set.count_in(from..to) as usize, of.len());
                assert_eq!(set.has_all(from..to), of.len() == to - from);
                assert_eq!(set.has_any(from..to), !of.is_empty());
                assert!(set.iter_in(from..to).eq(of.iter().copied()));
            }
        }
        let mut some = CellMask::none(300);
        some.insert_all(62..130);
        some.insert_all(5..5);
        assert!(some.iter().eq(62..130));
    }
}
