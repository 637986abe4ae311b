//! Sets of cells as runs of consecutive numbers.
//!
//! Octree cells are numbered along the octree, so what lies together has numbers that follow each
//! other: the cells that a placement replaces are few runs, however many cells the scene has.

use serde::{Deserialize, Serialize};

/// A set of cell numbers. Memory grows with its runs, not with its numbers.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<[u32; 2]>", into = "Vec<[u32; 2]>")]
pub struct CellRuns {
    /// First number and last number of each run; ascending, at least one number apart.
    runs: Vec<[u32; 2]>,
}

impl CellRuns {
    /// The set of some runs, each its first and its last number. None: a run is empty, or they do
    /// not ascend, overlap or touch.
    pub fn of_runs(runs: Vec<[u32; 2]>) -> Option<Self> {
        let apart = |pair: &[[u32; 2]]| pair[0][1].checked_add(1).is_some_and(|next| next < pair[1][0]);
        let valid = runs.iter().all(|[first, last]| first <= last) && runs.windows(2).all(apart);
        valid.then_some(Self { runs })
    }

    /// All cells below `limit`.
    pub fn below(limit: u32) -> Self {
        Self { runs: limit.checked_sub(1).map(|last| vec![[0, last]]).unwrap_or_default() }
    }

    /// Runs, ascending: first and last cell number.
    pub fn runs(&self) -> &[[u32; 2]] {
        &self.runs
    }

    /// Whether the set is empty.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    /// Cells in the set.
    pub fn len(&self) -> usize {
        self.runs.iter().map(|[first, last]| (last - first) as usize + 1).sum()
    }

    /// The largest cell number; None in an empty set.
    pub fn last(&self) -> Option<u32> {
        self.runs.last().map(|run| run[1])
    }

    /// Whether `cell` is in the set.
    pub fn contains(&self, cell: u32) -> bool {
        self.runs.get(self.runs.partition_point(|run| run[1] < cell)).is_some_and(|run| run[0] <= cell)
    }

    /// Cell numbers, ascending.
    pub fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        self.runs.iter().flat_map(|[first, last]| *first..=*last)
    }

    /// The cell with `place` smaller ones before it; None beyond the last.
    pub fn nth(&self, mut place: usize) -> Option<u32> {
        for [first, last] in &self.runs {
            let length = (last - first) as usize + 1;
            if place < length {
                return Some(first + place as u32);
            }
            place -= length;
        }
        None
    }
}

/// Numbers in any order; repeated ones count once.
impl FromIterator<u32> for CellRuns {
    fn from_iter<I: IntoIterator<Item = u32>>(cells: I) -> Self {
        let mut runs: Vec<[u32; 2]> = Vec::new();
        let mut unsorted = Vec::new();
        for cell in cells {
            match runs.last_mut() {
                Some([_, last]) if last.checked_add(1) == Some(cell) => *last = cell,
                Some([_, last]) if *last >= cell => unsorted.push(cell),
                _ => runs.push([cell, cell]),
            }
        }
        let ascending = Self { runs };
        if unsorted.is_empty() {
            return ascending;
        }
        unsorted.extend(ascending.iter());
        unsorted.sort_unstable();
        unsorted.dedup();
        unsorted.into_iter().collect()
    }
}

impl TryFrom<Vec<[u32; 2]>> for CellRuns {
    type Error = &'static str;
    fn try_from(runs: Vec<[u32; 2]>) -> Result<Self, Self::Error> {
        Self::of_runs(runs).ok_or("runs of cells are empty, or do not ascend apart from each other")
    }
}

impl From<CellRuns> for Vec<[u32; 2]> {
    fn from(cells: CellRuns) -> Self {
        cells.runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    proptest! {
        #[test]
        fn agrees_with_a_set(cells in proptest::collection::vec(0u32..200, 0..150)) {
            let set: BTreeSet<u32> = cells.iter().copied().collect();
            let runs: CellRuns = cells.into_iter().collect();
            prop_assert_eq!(runs.iter().collect::<Vec<_>>(), set.iter().copied().collect::<Vec<_>>());
            prop_assert_eq!((runs.len(), runs.is_empty(), runs.last()), (set.len(), set.is_empty(), set.last().copied()));
            for cell in 0..=201 {
                prop_assert_eq!(runs.contains(cell), set.contains(&cell));
            }
            for place in 0..=set.len() {
                prop_assert_eq!(runs.nth(place), set.iter().nth(place).copied());
            }
            prop_assert_eq!(CellRuns::of_runs(runs.runs().to_vec()), Some(runs));
        }
    }

    #[test]
    fn only_separate_ascending_runs_are_a_set() {
        assert_eq!(CellRuns::below(0), CellRuns::default());
        assert_eq!(CellRuns::below(3).runs(), [[0, 2]]);
        let whole = CellRuns::of_runs(vec![[0, u32::MAX]]).expect("one run");
        assert!(whole.contains(u32::MAX) && whole.contains(0));
        for bad in
            [vec![[2, 1]], vec![[0, 1], [2, 3]], vec![[5, 6], [1, 2]], vec![[0, 4], [3, 9]], vec![[0, u32::MAX]; 2]]
        {
            assert_eq!(CellRuns::of_runs(bad.clone()), None, "{bad:?}");
        }
    }
}
