//! What of a manifest is enough for a first picture: the walk volume, the LDI tree and where its
//! pinned chunks lie.
//!
//! The pages of cells and chunks grow with the scene, those of the tree's coarse levels do not. So
//! the few come first, a walk begins with an index that knows of nothing else, and the rest
//! follows while the first pictures are drawn. Numbers are the same in both: the index of the few
//! has a place for every chunk.

use super::{PageEntry, PageKind, Root, check_page_hash, pages, validate::validate_early};
use crate::{
    codec::CodecError,
    index::{ChunkEntry, ChunkHash, ChunkKind, Index},
    tree::Tree,
};

/// Most chunks of which a walk begins early: each has an entry of 44 bytes in memory before its
/// page came. Thirty times as many as the largest scene has so far.
const MAX_CHUNKS: u32 = 1 << 20;

/// A chunk of which nothing is known but that it exists. Of no kind that anything refers to.
const UNKNOWN: ChunkEntry =
    ChunkEntry { hash: ChunkHash([0; 32]), stored_bytes: 0, decoded_bytes: 0, kind: ChunkKind::Page };

/// Whether a page is needed whatever the tree is.
fn is_base(kind: PageKind) -> bool {
    matches!(kind, PageKind::Volume | PageKind::Tree | PageKind::TreeNodes)
}

/// The tree's pinned chunks, ascending: a forged tree may have very many, and each page looks for
/// its own.
fn pinned(tree: &Tree) -> Vec<u32> {
    let mut chunks: Vec<u32> = tree.pinned_chunks().collect();
    chunks.sort_unstable();
    chunks
}

impl PageEntry {
    /// Those of ascending chunks that it says of where they lie.
    fn listed<'a>(&self, chunks: &'a [u32]) -> &'a [u32] {
        let before = |end: u32| chunks.partition_point(|c| *c < end);
        let own = before(self.first)..before(self.first.saturating_add(self.count));
        if self.kind == PageKind::Chunks { &chunks[own] } else { &[] }
    }
}

impl Root {
    /// Numbers of all pages in the order in which they are sent, and how many of them are enough
    /// for a first picture; all, where there is no tree.
    pub fn sending_order(&self, tree: Option<&Tree>) -> (Vec<u32>, usize) {
        let pinned = tree.map(pinned);
        let early = |p: &PageEntry| pinned.as_ref().is_none_or(|c| is_base(p.kind) || !p.listed(c).is_empty());
        let numbered = || (0u32..).zip(&self.pages);
        let first = numbered().filter(|(_, p)| early(p)).map(|(n, _)| n);
        let rest = numbered().filter(|(_, p)| !early(p)).map(|(n, _)| n);
        (first.chain(rest).collect(), numbered().filter(|(_, p)| early(p)).count())
    }
}

/// The index for a first picture, from the pages that are here, in the order of the root's list.
/// None: it takes more of them, or there is no tree.
///
/// It has the tree, the walk volume and the pinned chunks; entries of other chunks are empty, of
/// kind [`ChunkKind::Page`], which says that it is not whole ([`Index::is_whole`]). No cells,
/// images or rooms.
///
/// # Errors
/// As [`super::assemble`], of the pages that it takes.
pub fn early<B: AsRef<[u8]>>(root: &Root, pages: &[Option<B>]) -> Result<Option<Index>, CodecError> {
    let count = |kind: PageKind| root.counts[kind as usize];
    let listed = || root.pages.iter().zip(pages);
    if count(PageKind::Tree) == 0
        || count(PageKind::Chunks) > MAX_CHUNKS
        || listed().any(|(entry, page)| is_base(entry.kind) && page.is_none())
    {
        return Ok(None);
    }
    let mut index = root.without_entries();
    let mut room = pages::Room::of_index();
    let mut decode = |index: &mut Index, entry: &PageEntry, page: &B| {
        check_page_hash(entry, page.as_ref())?;
        pages::decode_into(index, entry, page.as_ref(), &mut room)
    };
    for (entry, page) in listed().filter(|(entry, _)| is_base(entry.kind)) {
        page.iter().try_for_each(|p| decode(&mut index, entry, p))?;
    }
    let Some(tree) = index.tree.take() else { return Ok(None) };
    let pinned = pinned(&tree);
    let mut chunks = vec![UNKNOWN; count(PageKind::Chunks) as usize];
    for (entry, page) in listed().filter(|(entry, _)| !entry.listed(&pinned).is_empty()) {
        let Some(page) = page else { return Ok(None) };
        decode(&mut index, entry, page)?;
        // A page has as many entries as the root says, and the root's pages lie within its count.
        for chunk in entry.listed(&pinned) {
            chunks[*chunk as usize] = index.chunks[(chunk - entry.first) as usize];
        }
        index.chunks.clear();
    }
    index.chunks = chunks;
    index.tree = Some(tree);
    validate_early(&index)?;
    Ok(Some(index))
}
