//! Bounds of neighbouring cells, so that most of a large scene is left out of a view without a
//! look at each cell.
//!
//! Cells come in Morton order: a run of them is compact. A plane that keeps no point of a group's
//! bounds keeps none of its cells', and rounding does not change that, as a box's support only
//! grows with the box. So what is found is the same, cell by cell and in the same order.

use crate::{Aabb, index::CellEntry};
use std::ops::Range;

/// Cells in a group, and groups in a block: as planning groups them. Smaller: more groups to look
/// at; larger: looser bounds.
const GROUP: usize = 16;

/// Bounds of every [`GROUP`] cells, and of every [`GROUP`] of those.
#[derive(Debug, Clone, Default)]
pub struct CellGroups {
    groups: Vec<Aabb>,
    blocks: Vec<Aabb>,
}

impl CellGroups {
    /// Groups of these cells, in their order.
    pub fn of(cells: &[CellEntry]) -> Self {
        let union = |a: Aabb, b: Aabb| a.union(b);
        let groups: Vec<Aabb> =
            cells.chunks(GROUP).map(|g| g.iter().map(|c| c.bounds).fold(Aabb::EMPTY, union)).collect();
        let blocks = groups.chunks(GROUP).map(|b| b.iter().copied().fold(Aabb::EMPTY, union)).collect();
        Self { groups, blocks }
    }

    /// Some of the cells these are groups of, `count` in all.
    pub fn some(&self, count: usize, wanted: impl Fn(usize) -> bool) -> SomeCells {
        let cells: Vec<bool> = (0..count).map(wanted).collect();
        let any = |c: &[bool]| c.contains(&true);
        let groups: Vec<bool> = cells.chunks(GROUP).map(any).collect();
        let blocks = groups.chunks(GROUP).map(any).collect();
        SomeCells { cells, groups, blocks }
    }

    /// Those of `some` cells whose groups are admitted, ascending.
    pub(super) fn each_of(&self, some: &SomeCells, admit: impl Fn(&Aabb) -> bool, mut found: impl FnMut(usize)) {
        for block in (0..self.blocks.len()).filter(|b| some.blocks[*b] && admit(&self.blocks[*b])) {
            for group in block * GROUP..((block + 1) * GROUP).min(self.groups.len()) {
                if some.groups[group] && admit(&self.groups[group]) {
                    let end = ((group + 1) * GROUP).min(some.cells.len());
                    (group * GROUP..end).filter(|c| some.cells[*c]).for_each(&mut found);
                }
            }
        }
    }

    /// Runs of the cells (`count` of them) whose groups are admitted, ascending; all of them if
    /// there are no groups.
    pub(super) fn runs(&self, count: usize, admit: impl Fn(&Aabb) -> bool) -> impl Iterator<Item = Range<usize>> {
        let whole = self.blocks.is_empty().then_some(0..count);
        let groups_of = |b: usize| b * GROUP..((b + 1) * GROUP).min(self.groups.len());
        let blocks = (0..self.blocks.len()).filter(|b| admit(&self.blocks[*b]));
        let groups: Vec<usize> = blocks.flat_map(groups_of).filter(|g| admit(&self.groups[*g])).collect();
        whole.into_iter().chain(groups.into_iter().map(move |g| g * GROUP..((g + 1) * GROUP).min(count)))
    }
}

/// Some cells of an index, and which groups hold any: see [`CellGroups::some`].
#[derive(Debug, Clone)]
pub struct SomeCells {
    cells: Vec<bool>,
    groups: Vec<bool>,
    blocks: Vec<bool>,
}
