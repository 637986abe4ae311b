//! A dataset opened for reading.

use super::{StoreError, files, map::map_pack, source};
use crate::octree::SourceRange;
use ldi_protocol::{
    codec::CodecError,
    index::{ChunkHash, Index},
    manifest::{
        self, Root,
        layout::{Layout, Location},
    },
};
use memmap2::Mmap;
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// A complete dataset: its manifest decoded and checked, its packs mapped. Chunk contents are not read until asked for; whether
/// they are intact is for [`verify`](super::verify()) to say, and for the receiver, by their hashes.
#[derive(Debug)]
pub struct Dataset {
    path: PathBuf,
    root_bytes: Vec<u8>,
    root: Root,
    index: Arc<Index>,
    packs: Vec<Mmap>,
    layout: Layout,
    pages: Vec<Location>,
    chunks: Vec<Location>,
}

/// Reads the manifest's root.
pub(super) fn read_root(path: &Path) -> Result<(Vec<u8>, PathBuf), StoreError> {
    let not = |why| StoreError::NotADataset { path: path.to_owned(), why };
    if !path.is_dir() {
        return Err(not("there is no such directory; build one with `ldi-server build SCENE -o DATASET`"));
    }
    let manifest = path.join(files::MANIFEST);
    match files::read_if_there(&manifest, manifest::MAX_ROOT_BYTES as u64)? {
        Some(bytes) => Ok((bytes, manifest)),
        None if path.join(files::WORK).is_dir() => {
            Err(not("its build was not finished; run the same `ldi-server build` again, it goes on where it was"))
        }
        None => Err(not("it has no manifest; name a directory that `ldi-server build` made")),
    }
}

impl Dataset {
    /// Opens a dataset.
    ///
    /// # Errors
    /// If it is none, unfinished, of another version, or its manifest or the length of a pack shows damage.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let (root_bytes, manifest_path) = read_root(path)?;
        let root = manifest::decode_root(&root_bytes).map_err(StoreError::format(&manifest_path))?;
        let mut layout = Layout::default();
        let pages = layout.place_pages(&root.pages);
        // The chunk table, and with it the length of the packs, is known once the pages are read.
        let page_bytes = pages.iter().map(|l| read_part(path, l)).collect::<Result<Vec<_>, _>>()?;
        let index = manifest::assemble(&root, &page_bytes).map_err(StoreError::format(&manifest_path))?;
        let chunks = layout.place_chunks(&index.chunks);
        let packs = layout
            .pack_bytes()
            .iter()
            .enumerate()
            .map(|(k, &bytes)| map_pack(&files::pack_path(path, k), bytes))
            .collect::<Result<_, _>>()?;
        Ok(Self { path: path.to_owned(), root_bytes, root, index: Arc::new(index), packs, layout, pages, chunks })
    }

    /// Its directory.
    pub fn path(&self) -> &Path {
        &self.path
    }
    /// The decoded manifest.
    pub fn index(&self) -> &Arc<Index> {
        &self.index
    }
    /// The decoded root: page list, counts, hash.
    pub fn root(&self) -> &Root {
        &self.root
    }
    /// The root as stored and sent.
    pub fn manifest_root(&self) -> &[u8] {
        &self.root_bytes
    }
    /// The dataset's name.
    pub fn hash(&self) -> ChunkHash {
        self.root.hash
    }
    /// Number of pages.
    pub fn pages(&self) -> u32 {
        self.pages.len() as u32
    }
    /// Bytes of each pack.
    pub fn pack_bytes(&self) -> &[u64] {
        self.layout.pack_bytes()
    }

    /// A page as stored and sent; None beyond the last.
    pub fn page(&self, number: u32) -> Option<&[u8]> {
        self.at(self.pages.get(number as usize)?)
    }
    /// A chunk as stored and sent; None beyond the last.
    pub fn chunk(&self, number: u32) -> Option<&[u8]> {
        self.at(self.chunks.get(number as usize)?)
    }
    /// A page or chunk by name.
    pub fn by_hash(&self, hash: &ChunkHash) -> Option<&[u8]> {
        self.at(&self.layout.find(hash)?)
    }
    /// The triangles of the source scene in each cell; None when the dataset does not say.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn source_ranges(&self) -> Result<Option<Vec<Vec<SourceRange>>>, StoreError> {
        source::read(&self.path)
    }
    /// The build's report; None when it is missing or no JSON.
    pub fn report(&self) -> Option<serde_json::Value> {
        let bytes = files::read_if_there(&self.path.join(files::REPORT), 64 << 20).ok()??;
        serde_json::from_slice(&bytes).ok()
    }

    fn at(&self, l: &Location) -> Option<&[u8]> {
        let start = usize::try_from(l.offset).ok()?;
        self.packs.get(l.pack as usize)?.get(start..start.checked_add(l.bytes as usize)?)
    }
}

/// Reads a page before the packs are mapped.
pub(super) fn read_part(dataset: &Path, l: &Location) -> Result<Vec<u8>, StoreError> {
    use std::io::{Read, Seek, SeekFrom};
    let path = files::pack_path(dataset, l.pack as usize);
    let mut file = std::fs::File::open(&path).map_err(StoreError::io(&path, "open it"))?;
    file.seek(SeekFrom::Start(l.offset)).map_err(StoreError::io(&path, "read it"))?;
    let mut bytes = Vec::new();
    file.take(l.bytes.into()).read_to_end(&mut bytes).map_err(StoreError::io(&path, "read it"))?;
    if bytes.len() == l.bytes as usize {
        Ok(bytes)
    } else {
        let source = CodecError::Truncated { field: "page", missing: l.bytes as usize - bytes.len() };
        Err(StoreError::Format { path, source })
    }
}
