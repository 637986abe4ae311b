//! The manifest: an [`Index`] to one small root and pages, and back.
//!
//! The root names the dataset: version, scene, settings, counts and the list of pages with their
//! hashes; it ends in a checksum of its own, and its BLAKE3 is the dataset's hash. Everything long
//! lies in pages of at most about a thousand entries, each a chunk by its BLAKE3 like any other,
//! so that the root stays below 256 kB however large the scene is.
//!
//! ```text
//!   root: "LDM" version | scene, settings | pitch bands | counts | page list | BLAKE3 of all before
//!   page: "LDP" version | kind | first | count | sections
//! ```
//!
//! Encoding is exact: what comes back equals the index that went in, bit for bit (cell bounds must
//! be f32 values, which the octree makes them). Decoding validates everything ([`validate()`]), so
//! that later code may index without looking.
//!
//! Where a chunk lies in the packs is not written anywhere: [`layout`] says it, from the list of
//! pages and the chunk table.

mod content;
mod early;
pub mod layout;
mod pages;
mod validate;

pub use content::{
    check_bundle, check_cell, check_cell_content, check_decoded_bytes, check_ldi, check_levels, check_texture,
};
pub use early::early;
pub use validate::validate;

use crate::{
    codec::{
        CodecError,
        bytes::{Reader, Writer},
    },
    index::{BuildSettings, ChunkHash, Index, SceneInfo},
};

/// Version of root and pages. Raised with every change that an older reader would misunderstand.
/// 10: sections of all chunks and pages may be coded by rANS.
pub const VERSION: u8 = 16;
/// Stored bytes of all pages of a manifest together: what a reader holds of them before it decodes
/// them.
pub const MAX_PAGE_BYTES: u64 = 64 << 20;
/// Largest root that a build writes.
pub const MAX_ROOT_BYTES: usize = 256_000;

const ROOT: [u8; 3] = *b"LDM";
/// Entries of a page where that gives at most [`MAX_PAGES`] pages. Larger: a flipped byte costs
/// more to fetch again and pages take longer to decode; smaller: the root grows.
const ENTRIES_PER_PAGE: usize = 1024;
/// Most pages: 40 to 50 bytes of root each.
const MAX_PAGES: usize = 4096;
/// zstd level of pages: they are small and read often.
const LEVEL: i32 = 9;
/// Longest packed scene and settings in a root: names are the only part without a fixed size.
const MAX_SETTINGS_BYTES: usize = 64 * 1024;
/// Most entries of any kind: bounds what a forged root can make a reader expect.
const MAX_ENTRIES: u64 = 1 << 26;

/// What a page holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum PageKind {
    /// Chunk table.
    Chunks,
    /// Cells.
    Cells,
    /// Materials.
    Materials,
    /// Textures.
    Textures,
    /// Grid points.
    Points,
    /// Placements.
    Placements,
    /// The walk volume; always one entry.
    Volume,
    /// The LDI tree but its nodes; at most one entry.
    Tree,
    /// Nodes of the LDI tree.
    TreeNodes,
    /// Rooms, the outside last.
    Rooms,
    /// Portals.
    Portals,
    /// Floor plans.
    Plans,
}

impl PageKind {
    /// All kinds in the order of the page list.
    pub const ALL: [Self; 12] = [
        Self::Chunks,
        Self::Cells,
        Self::Materials,
        Self::Textures,
        Self::Points,
        Self::Placements,
        Self::Volume,
        Self::Tree,
        Self::TreeNodes,
        Self::Rooms,
        Self::Portals,
        Self::Plans,
    ];
}

/// A page as the root lists it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageEntry {
    /// What it holds.
    pub kind: PageKind,
    /// Number of its first entry among those of its kind.
    pub first: u32,
    /// Number of its entries.
    pub count: u32,
    /// Its name.
    pub hash: ChunkHash,
    /// Its stored bytes.
    pub stored_bytes: u32,
}

/// The decoded root: everything but the pages' content.
#[derive(Debug, Clone, PartialEq)]
pub struct Root {
    /// The source.
    pub scene: SceneInfo,
    /// How it was built.
    pub settings: BuildSettings,
    /// Borders of the pitch bands.
    pub pitch_bands_deg: Vec<f64>,
    /// Entries per kind, in the order of [`PageKind::ALL`].
    pub counts: [u32; PageKind::ALL.len()],
    /// The pages, by kind, then by first entry; they cover all entries once.
    pub pages: Vec<PageEntry>,
    /// BLAKE3 of the root's bytes: the dataset's name.
    pub hash: ChunkHash,
}

/// An index as bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Encoded {
    /// The root: the content of the file `manifest`.
    pub root: Vec<u8>,
    /// The pages in the order of the root's list.
    pub pages: Vec<Vec<u8>>,
}

/// Encodes an index, after validating it.
///
/// # Errors
/// If the index breaks a rule of [`validate()`], a value has no exact stored form, or the pages
/// exceed what a reader takes.
pub fn encode(index: &Index) -> Result<Encoded, CodecError> {
    encode_at(index, LEVEL)
}

/// [`encode`] at a zstd level of 1 to 19; 0 stores sections uncompressed, for tests that damage
/// what is in them.
///
/// # Errors
/// As [`encode`].
pub fn encode_at(index: &Index, level: i32) -> Result<Encoded, CodecError> {
    validate(index)?;
    let lengths = [
        index.chunks.len(),
        index.cells.len(),
        index.materials.len(),
        index.textures.len(),
        index.points.len(),
        index.placements.len(),
        usize::from(index.volume.is_some()),
        usize::from(index.tree.is_some()),
        index.tree.as_ref().map_or(0, |t| t.nodes.len()),
        pages::room_count(index),
        index.rooms.as_ref().map_or(0, |r| r.rooms.portals().len()),
        index.plans.len(),
    ];
    let total: usize = lengths.iter().sum();
    // The page list may need one more page per kind than the division gives.
    let per_page = ENTRIES_PER_PAGE.max(total.div_ceil(MAX_PAGES - PageKind::ALL.len()));
    let mut pages = Vec::new();
    let mut entries = Vec::new();
    for (kind, &length) in PageKind::ALL.into_iter().zip(&lengths) {
        for first in (0..length).step_by(per_page) {
            let range = first..length.min(first + per_page);
            let bytes = pages::encode(index, kind, range.clone(), level)?;
            entries.push(PageEntry {
                kind,
                first: first as u32,
                count: range.len() as u32,
                hash: ChunkHash(blake3::hash(&bytes).into()),
                stored_bytes: u32::try_from(bytes.len())
                    .map_err(|_| CodecError::range("page bytes", bytes.len(), "a page has less than 4 GiB"))?,
            });
            pages.push(bytes);
        }
    }
    let mut w = Writer::new(level)?;
    w.raw(&ROOT);
    w.u8(VERSION);
    let settings = rmp_serde::to_vec(&(&index.scene, &index.settings))
        .map_err(|e| CodecError::mismatch("settings", e.to_string()))?;
    w.section("settings", &settings)?;
    w.varint(index.pitch_bands_deg.len() as u64);
    index.pitch_bands_deg.iter().for_each(|b| w.f64(*b));
    lengths.iter().for_each(|n| w.varint(*n as u64));
    w.varint(entries.len() as u64);
    for e in &entries {
        w.u8(e.kind as u8);
        w.varint(e.first.into());
        w.varint(e.count.into());
        w.raw(&e.hash.0);
        w.varint(e.stored_bytes.into());
    }
    let checksum = blake3::hash(&w.bytes);
    w.raw(checksum.as_bytes());
    if w.bytes.len() > MAX_ROOT_BYTES {
        return Err(CodecError::range("manifest", w.bytes.len(), "the root has at most 256,000 bytes"));
    }
    // What no reader takes is found by the build, not by those who come to walk.
    assemble(&decode_root(&w.bytes)?, &pages)?;
    Ok(Encoded { root: w.bytes, pages })
}

/// Decodes a root and checks its checksum and its page list.
///
/// # Errors
/// If it is no manifest, of another version, damaged, or lists pages that do not cover its entries.
pub fn decode_root(bytes: &[u8]) -> Result<Root, CodecError> {
    let mut r = Reader::new(bytes);
    r.magic("manifest", ROOT, VERSION)?;
    let body = bytes
        .len()
        .checked_sub(32)
        .ok_or(CodecError::Truncated { field: "manifest", missing: 36 - bytes.len().min(36) })?;
    if bytes.len() > MAX_ROOT_BYTES {
        return Err(CodecError::range("manifest", bytes.len(), "the root has at most 256,000 bytes"));
    }
    if blake3::hash(&bytes[..body]).as_bytes()[..] != bytes[body..] {
        return Err(CodecError::mismatch("manifest", "its checksum is wrong: it was damaged or cut off"));
    }
    let settings = r.section("settings", MAX_SETTINGS_BYTES)?;
    let (scene, settings): (SceneInfo, BuildSettings) =
        rmp_serde::from_slice(&settings).map_err(|e| CodecError::mismatch("settings", e.to_string()))?;
    let bands = r.count("pitch bands", 1024)?;
    let pitch_bands_deg = (0..bands).map(|_| r.finite("pitch bands")).collect::<Result<_, _>>()?;
    let mut counts = [0; PageKind::ALL.len()];
    for c in &mut counts {
        *c = r.varint("counts", MAX_ENTRIES)? as u32;
    }
    let listed = r.count("pages", MAX_PAGES)?;
    let mut pages = Vec::with_capacity(listed);
    for _ in 0..listed {
        let kind = r.u8("page kind")?;
        let kind = *PageKind::ALL
            .get(usize::from(kind))
            .ok_or_else(|| CodecError::range("page kind", kind, "there are twelve kinds, from 0 on"))?;
        pages.push(PageEntry {
            kind,
            first: r.varint("page first", MAX_ENTRIES)? as u32,
            count: r.varint("page count", MAX_ENTRIES)? as u32,
            hash: ChunkHash(r.array("page hash")?),
            stored_bytes: r.varint("page bytes", u32::MAX.into())? as u32,
        });
    }
    r.take(32, "checksum")?;
    r.finish("manifest")?;
    let root = Root { scene, settings, pitch_bands_deg, counts, pages, hash: dataset_hash(bytes) };
    root.check_pages()?;
    Ok(root)
}

/// The name of a dataset: BLAKE3 of its root.
pub fn dataset_hash(root: &[u8]) -> ChunkHash {
    ChunkHash(blake3::hash(root).into())
}

/// Decodes all pages, given in the order of the root's list, and joins them to the index.
///
/// # Errors
/// If a page is missing, has another hash than listed, is malformed, or the whole breaks a rule of
/// [`validate()`].
pub fn assemble<B: AsRef<[u8]>>(root: &Root, pages: &[B]) -> Result<Index, CodecError> {
    if pages.len() != root.pages.len() {
        return Err(CodecError::mismatch("pages", format!("{} of {} pages", pages.len(), root.pages.len())));
    }
    let mut index = root.without_entries();
    let mut room = pages::Room::of_index();
    for (entry, bytes) in root.pages.iter().zip(pages) {
        check_page_hash(entry, bytes.as_ref())?;
        pages::decode_into(&mut index, entry, bytes.as_ref(), &mut room)?;
    }
    room.finish(&mut index)?;
    validate(&index)?;
    Ok(index)
}

/// Checks a page's length and hash.
///
/// # Errors
/// If either differs from what the root lists.
pub fn check_page_hash(entry: &PageEntry, bytes: &[u8]) -> Result<(), CodecError> {
    if bytes.len() == entry.stored_bytes as usize && blake3::hash(bytes).as_bytes() == &entry.hash.0 {
        Ok(())
    } else {
        Err(CodecError::mismatch("page", format!("it is not the page {} that the root lists", entry.hash)))
    }
}

impl Root {
    /// The index but for what lies in pages.
    fn without_entries(&self) -> Index {
        Index {
            scene: self.scene.clone(),
            settings: self.settings.clone(),
            chunks: Vec::new(),
            cells: Vec::new(),
            materials: Vec::new(),
            textures: Vec::new(),
            pitch_bands_deg: self.pitch_bands_deg.clone(),
            points: Vec::new(),
            placements: Vec::new(),
            images: Vec::new(),
            volume: None,
            tree: None,
            rooms: None,
            plans: Vec::new(),
        }
    }

    /// Pages come by kind and cover every entry once, in order.
    fn check_pages(&self) -> Result<(), CodecError> {
        let mut next = [0u64; PageKind::ALL.len()];
        let mut last = 0;
        for p in &self.pages {
            let kind = p.kind as usize;
            if kind < last || u64::from(p.first) != next[kind] || p.count == 0 {
                return Err(CodecError::mismatch("pages", "they are out of order"));
            }
            last = kind;
            next[kind] += u64::from(p.count);
        }
        if next != self.counts.map(u64::from)
            || [PageKind::Volume, PageKind::Tree].iter().any(|k| self.counts[*k as usize] > 1)
        {
            return Err(CodecError::mismatch("pages", "they do not cover all entries"));
        }
        // Before anything is fetched. Sections that do not shrink are stored as they are.
        let stored: u64 = self.pages.iter().map(|p| u64::from(p.stored_bytes)).sum();
        if stored > MAX_PAGE_BYTES {
            return Err(CodecError::range("page bytes", stored, "all pages together have at most 64 MiB"));
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "manifest/manifest_test.rs"]
mod tests;
