//! Which cells rays can see.

use super::{
    bvh::{Bvh, EMPTY, ITEM, LEAF},
    geometry::Geometry,
};
use ldi_protocol::CellRuns;
use rayon::prelude::*;

/// A set of cells, prepared for one [`Caster`](super::Caster) (see
/// [`Caster::cell_set`](super::Caster::cell_set)). Triangles of other cells are transparent, and
/// whole branches of the hierarchy without a cell of the set are not even visited: rays that start
/// among many hidden triangles cost no more than if those were not there.
#[derive(Debug, Clone)]
pub struct CellSet {
    /// None stands for all.
    some: Option<Prepared>,
}

#[derive(Debug, Clone)]
struct Prepared {
    /// One bit per cell, 64 to a word.
    words: Vec<u64>,
    masks: Masks,
}

/// What of the hierarchy rays can see.
#[derive(Debug, Clone)]
pub(super) struct Masks {
    /// Per node of the scene's own hierarchy: bits of the children with something to see.
    pub children: Vec<u8>,
    /// Per block in world space: bits of the triangles to be seen.
    pub lanes: Vec<u8>,
}

impl CellSet {
    /// Every cell: the fast path.
    pub fn all() -> Self {
        Self { some: None }
    }

    /// These cells; numbers that the octree does not have are ignored. Takes a pass over the
    /// triangles: some milliseconds per million.
    pub(super) fn of(cells: &CellRuns, geometry: &Geometry, bvh: &Bvh) -> Self {
        let mut words = vec![0; geometry.cell_count.div_ceil(64)];
        for c in cells.iter().take_while(|c| (*c as usize) < geometry.cell_count) {
            words[c as usize / 64] |= 1 << (c % 64);
        }
        Self::prepared(words, geometry, bvh)
    }

    /// All cells that are not in another set.
    pub(super) fn besides(other: &Self, geometry: &Geometry, bvh: &Bvh) -> Self {
        let words = match &other.some {
            Some(prepared) => prepared.words.iter().map(|w| !w).collect(),
            None => vec![0; geometry.cell_count.div_ceil(64)],
        };
        Self::prepared(words, geometry, bvh)
    }

    fn prepared(words: Vec<u64>, geometry: &Geometry, bvh: &Bvh) -> Self {
        let seen = |cells: &[u32; 4]| (0..4).fold(0, |bits, i| bits | u8::from(holds(&words, cells[i])) << i);
        let lanes: Vec<u8> = match geometry.has_cells() {
            true => bvh.cells.par_iter().map(seen).collect(),
            false => vec![if holds(&words, 0) { 0xf } else { 0 }; bvh.world.blocks.len()],
        };
        let mut children = vec![0; bvh.world.nodes.len()];
        let is_seen = |child: u32, children: &[u8]| match child {
            EMPTY => false,
            item if item & (LEAF | ITEM) == LEAF | ITEM => {
                holds(&words, bvh.items[(item & !(LEAF | ITEM)) as usize].cell)
            }
            leaf if leaf & LEAF != 0 => lanes[(leaf & !LEAF) as usize] != 0,
            inner => children[inner as usize] != 0,
        };
        // Children come after their parents.
        for (number, node) in bvh.world.nodes.iter().enumerate().rev() {
            let seen = |b: u8, (i, child): (usize, &u32)| b | u8::from(is_seen(*child, &children)) << i;
            children[number] = node.children.iter().enumerate().fold(0, seen);
        }
        Self { some: Some(Prepared { words, masks: Masks { children, lanes } }) }
    }

    /// Whether the set holds this cell.
    #[inline]
    pub fn contains(&self, cell: u32) -> bool {
        self.some.as_ref().is_none_or(|s| holds(&s.words, cell))
    }

    /// Whether this is [`CellSet::all`].
    pub fn is_all(&self) -> bool {
        self.some.is_none()
    }

    #[inline]
    pub(super) fn masks(&self) -> Option<&Masks> {
        self.some.as_ref().map(|s| &s.masks)
    }
}

fn holds(words: &[u64], cell: u32) -> bool {
    words.get(cell as usize / 64).is_some_and(|w| w >> (cell % 64) & 1 == 1)
}
