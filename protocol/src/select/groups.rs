//! Bounds of neighbouring cells, so that most of a large scene is left out of a view without a look at each cell.
//!
//! Cells come in Morton order: a run of them is compact. A plane that keeps no point of a group's bounds keeps none of its cells', and rounding does not change that, as a box's
//! support only grows with the box. So what is found is the same, cell by cell and in the same order.

use crate::{Aabb, index::CellEntry};

/// Cells in a group, and groups in a block.
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
        let join = |bounds: &mut dyn Iterator<Item = Aabb>| {
            let mut out: Vec<Aabb> = Vec::new();
            for (k, b) in bounds.enumerate() {
                if k % GROUP == 0 {
                    out.push(Aabb::EMPTY);
                }
                if let Some(last) = out.last_mut() {
                    *last = last.union(b);
                }
            }
            out
        };
        let groups = join(&mut cells.iter().map(|c| c.bounds));
        let blocks = join(&mut groups.iter().copied());
        Self { groups, blocks }
    }

    /// Whether there are none: then each cell is looked at.
    pub fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    /// Calls `found` with every one of `cells` (those that the groups are of, or any if there are no groups) whose bounds are admitted, ascending.
    pub(super) fn each<'a>(
        &self,
        cells: &'a [CellEntry],
        admit: impl Fn(&Aabb) -> bool,
        mut found: impl FnMut(u32, &'a CellEntry),
    ) {
        let mut look = |from: usize, to: usize| {
            for (k, cell) in cells.iter().enumerate().take(to).skip(from) {
                if admit(&cell.bounds) {
                    found(k as u32, cell);
                }
            }
        };
        if self.is_empty() {
            return look(0, cells.len());
        }
        for (b, block) in self.blocks.iter().enumerate() {
            if admit(block) {
                for (g, group) in self.groups.iter().enumerate().skip(b * GROUP).take(GROUP) {
                    if admit(group) {
                        look(g * GROUP, (g + 1) * GROUP);
                    }
                }
            }
        }
    }
}
