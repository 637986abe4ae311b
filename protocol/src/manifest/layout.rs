//! Where chunks lie in the packs: a rule instead of a table.
//!
//! Packs are the stored bytes of the pages in the order of the root's list, then of the chunks in
//! the order of the chunk table, one after the other, each content once: a hash that came before
//! lies where it came first. A chunk that would make a pack that already has content exceed
//! [`PACK_BYTES`] starts the next pack.

use super::PageEntry;
use crate::index::{ChunkEntry, ChunkHash};
use std::collections::HashMap;

/// Packs grow up to this size. Larger: fewer files, more to copy again when one is damaged.
pub const PACK_BYTES: u64 = 64 << 20;

/// Where a chunk lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Location {
    /// Number of the pack.
    pub pack: u32,
    /// First byte in it.
    pub offset: u64,
    /// Stored bytes.
    pub bytes: u32,
}

/// Hands out locations in order.
#[derive(Debug, Default)]
pub struct Layout {
    seen: HashMap<ChunkHash, Location>,
    pack_bytes: Vec<u64>,
}

impl Layout {
    /// The location of the next page or chunk, and whether its bytes are new there.
    pub fn place(&mut self, hash: ChunkHash, bytes: u32) -> (Location, bool) {
        if let Some(&location) = self.seen.get(&hash) {
            return (location, false);
        }
        if self.pack_bytes.last().is_none_or(|&n| n > 0 && n + u64::from(bytes) > PACK_BYTES) {
            self.pack_bytes.push(0);
        }
        let pack = self.pack_bytes.len() - 1;
        let location = Location { pack: pack as u32, offset: self.pack_bytes[pack], bytes };
        self.pack_bytes[pack] += u64::from(bytes);
        self.seen.insert(hash, location);
        (location, true)
    }

    /// Locations of all pages; to be called first.
    pub fn place_pages(&mut self, pages: &[PageEntry]) -> Vec<Location> {
        pages.iter().map(|p| self.place(p.hash, p.stored_bytes).0).collect()
    }

    /// Locations of all chunks; to be called after the pages.
    pub fn place_chunks(&mut self, chunks: &[ChunkEntry]) -> Vec<Location> {
        chunks.iter().map(|c| self.place(c.hash, c.stored_bytes).0).collect()
    }

    /// Bytes of every pack so far.
    pub fn pack_bytes(&self) -> &[u64] {
        &self.pack_bytes
    }

    /// Where a chunk or page of this name lies.
    pub fn find(&self, hash: &ChunkHash) -> Option<Location> {
        self.seen.get(hash).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packs_fill_up_and_contents_lie_once() {
        let mut layout = Layout::default();
        let hash = |k: u8| ChunkHash([k; 32]);
        let half = (PACK_BYTES / 2) as u32;
        assert_eq!(layout.place(hash(0), half), (Location { pack: 0, offset: 0, bytes: half }, true));
        assert_eq!(layout.place(hash(1), half), (Location { pack: 0, offset: half.into(), bytes: half }, true));
        assert_eq!(layout.place(hash(2), 1), (Location { pack: 1, offset: 0, bytes: 1 }, true));
        assert_eq!(layout.place(hash(1), half), (Location { pack: 0, offset: half.into(), bytes: half }, false));
        let long = u32::MAX;
        assert_eq!(
            layout.place(hash(3), long),
            (Location { pack: 2, offset: 0, bytes: long }, true),
            "a long chunk alone"
        );
        assert_eq!(layout.pack_bytes(), [PACK_BYTES, 1, long.into()]);
        assert_eq!(layout.find(&hash(2)), Some(Location { pack: 1, offset: 0, bytes: 1 }));
    }
}
