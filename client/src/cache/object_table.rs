//! The table from chunks to objects: an LDI and a texture arrive in several chunks, a cell, a
//! bundle and levels of detail in one.

use ldi_protocol::index::{ChunkKind, Index, TextureChunk};
use std::{collections::BTreeMap, ops::Range};

/// Largest number of chunks per object: bits of a mask.
pub(super) const MAX_PARTS: usize = 32;

/// Kind of an object.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum ObjectKind {
    /// The cell with this number.
    Cell(u32),
    /// Clusters shared by cells.
    Bundle,
    /// Levels of detail of cells.
    Levels,
    /// The LDI of the image with this number, and perhaps of others.
    Ldi(u32),
    /// The texture with this number.
    Texture(u32),
    /// These nodes of the LDI tree.
    Brood(Range<u32>),
}

/// An object: its kind and its chunks, in the order of sending.
#[derive(Debug)]
pub(super) struct ObjectEntry {
    pub kind: ObjectKind,
    pub chunks: Vec<u32>,
}

/// A chunk as part of an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Part {
    pub object: u32,
    pub part: u8,
}

/// The objects of an index. Numbers are positions in `objects`.
#[derive(Debug)]
pub(super) struct ObjectTable {
    pub objects: Vec<ObjectEntry>,
    /// Objects of each chunk. Equal bytes are one chunk, so that it may belong to several textures.
    pub parts_of_chunk: Vec<Vec<Part>>,
    /// Cell, bundle or levels of each chunk.
    pub geometry_of_chunk: Vec<Option<u32>>,
    /// Object of each texture.
    pub of_texture: Vec<Option<u32>>,
    /// Object of each image.
    pub of_image: Vec<Option<u32>>,
    /// LDI tree object of each chunk.
    pub brood_of_chunk: Vec<Option<u32>>,
}

impl ObjectTable {
    pub fn new(index: &Index) -> Self {
        let n = index.chunks.len();
        let mut table = Self {
            objects: Vec::new(),
            parts_of_chunk: vec![Vec::new(); n],
            geometry_of_chunk: vec![None; n],
            of_texture: Vec::new(),
            of_image: Vec::new(),
            brood_of_chunk: vec![None; n],
        };
        // Tree objects come first: a partial index has only these, under the same numbers.
        for (chunk, nodes) in index.tree.iter().flat_map(|t| t.broods()) {
            // Equal chunks are one chunk, whichever nodes list it.
            if table.brood_of_chunk.get(chunk as usize) == Some(&None) {
                table.brood_of_chunk[chunk as usize] = table.add(ObjectKind::Brood(nodes), vec![chunk]);
            }
        }
        for (number, cell) in (0u32..).zip(&index.cells) {
            let object = table.add(ObjectKind::Cell(number), vec![cell.chunk]);
            if let Some(slot) = table.geometry_of_chunk.get_mut(cell.chunk as usize) {
                *slot = object;
            }
        }
        for (chunk, entry) in (0u32..).zip(&index.chunks) {
            let kind = match entry.kind {
                ChunkKind::Bundle => ObjectKind::Bundle,
                ChunkKind::Levels => ObjectKind::Levels,
                _ => continue,
            };
            table.geometry_of_chunk[chunk as usize] = table.add(kind, vec![chunk]);
        }
        for (number, texture) in (0u32..).zip(&index.textures) {
            let chunks = texture.chunks.iter().map(|c: &TextureChunk| c.chunk).collect();
            let object = table.add(ObjectKind::Texture(number), chunks);
            table.of_texture.push(object);
        }
        // Equal images share an object.
        let mut by_chunks = BTreeMap::<&[u32], Option<u32>>::new();
        for (number, image) in (0u32..).zip(&index.images) {
            let object = match by_chunks.get(&image.chunks[..]) {
                Some(known) => *known,
                None => {
                    let object = table.add(ObjectKind::Ldi(number), image.chunks.clone());
                    by_chunks.insert(&image.chunks, object);
                    object
                }
            };
            table.of_image.push(object);
        }
        table
    }

    /// Adds an object. None without chunks, with too many, or with chunks that do not exist.
    fn add(&mut self, kind: ObjectKind, chunks: Vec<u32>) -> Option<u32> {
        let known = chunks.iter().all(|c| (*c as usize) < self.parts_of_chunk.len());
        if chunks.is_empty() || chunks.len() > MAX_PARTS || !known {
            return None;
        }
        let object = self.objects.len() as u32;
        for (part, chunk) in chunks.iter().enumerate() {
            self.parts_of_chunk[*chunk as usize].push(Part { object, part: part as u8 });
        }
        self.objects.push(ObjectEntry { kind, chunks });
        Some(object)
    }

    /// The object parts that a chunk is; empty beyond the index.
    pub fn parts(&self, chunk: u32) -> &[Part] {
        self.parts_of_chunk.get(chunk as usize).map_or(&[], Vec::as_slice)
    }
}
