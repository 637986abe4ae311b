//! A dataset opened for reading.

use super::{
    StoreError, elements,
    files::{self, DataFiles},
    folder,
    packs::{self, Pack},
    report, source,
};
use crate::octree::SourceRange;
use crate::scene::SceneElement;
use bytes::Bytes;
use ldi_protocol::{
    index::{ChunkHash, Index},
    manifest::{
        self, Root,
        layout::{Layout, Location},
    },
};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// A complete dataset: its manifest decoded and checked, its packs opened. A page or a chunk is
/// read and checked when it is asked for: whatever happens to the files, it is what the manifest
/// names, or an error.
#[derive(Debug)]
pub struct Dataset {
    path: PathBuf,
    root_bytes: Vec<u8>,
    root: Root,
    index: Arc<Index>,
    files: DataFiles,
    packs: Vec<Pack>,
    layout: Layout,
    pages: Vec<Location>,
    chunks: Vec<Location>,
}

/// What to do with a file that is named where a dataset is needed.
fn build_first(file: &Path) -> String {
    let (scene, dataset) = (file.display(), file.with_extension("ldi"));
    format!(
        "it is a file; if it is a scene, build a dataset of it first: ldi-server build {scene} -o {}",
        dataset.display()
    )
}

/// Reads the manifest's root.
pub(super) fn read_root(path: &Path) -> Result<(Vec<u8>, PathBuf), StoreError> {
    let not = |why: &str| StoreError::NotADataset { path: path.to_owned(), why: why.to_owned() };
    if path.is_file() {
        return Err(StoreError::NotADataset { path: path.to_owned(), why: build_first(path) });
    }
    if !path.is_dir() {
        return Err(not("there is no such directory; build one with `ldi-server build SCENE -o DATASET`"));
    }
    let manifest = path.join(files::MANIFEST);
    match files::read_if_there(&manifest, manifest::MAX_ROOT_BYTES as u64)? {
        Some(bytes) => Ok((bytes, manifest)),
        None if path.join(files::WORK).is_dir() || folder::is_marked(path)? => {
            Err(not("its build was not finished; run the same `ldi-server build` again, it goes on where it was"))
        }
        None => Err(not("it has no manifest; name a directory that `ldi-server build` made")),
    }
}

impl Dataset {
    /// Opens a dataset.
    ///
    /// # Errors
    /// If it is none, unfinished, of another version, or its manifest or the length of a pack
    /// shows damage.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let (root_bytes, manifest_path) = read_root(path)?;
        let root = manifest::decode_root(&root_bytes).map_err(StoreError::format(&manifest_path))?;
        let files = DataFiles::find(path, &root.hash);
        let packs = packs::open_all(&files)?;
        let mut layout = Layout::default();
        let pages = layout.place_pages(&root.pages);
        // The chunk table, and with it the length of the packs, is known once the pages are read.
        let read = |(number, (location, entry))| read((&files, &packs), ("page", number), location, entry);
        let hashes = root.pages.iter().map(|p| &p.hash);
        let page_bytes = (0..).zip(pages.iter().zip(hashes)).map(read).collect::<Result<Vec<_>, _>>()?;
        let index = manifest::assemble(&root, &page_bytes).map_err(StoreError::format(&manifest_path))?;
        let chunks = layout.place_chunks(&index.chunks);
        for (number, &expected) in layout.pack_bytes().iter().enumerate() {
            match packs.get(number) {
                None => return Err(StoreError::NoPack { path: files.pack(number) }),
                Some(pack) if pack.bytes() != expected => {
                    let (path, found) = (pack.path().to_owned(), pack.bytes());
                    return Err(StoreError::PackLength { path, found, expected });
                }
                Some(_) => {}
            }
        }
        Ok(Self {
            path: path.to_owned(),
            root_bytes,
            root,
            index: Arc::new(index),
            files,
            packs,
            layout,
            pages,
            chunks,
        })
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

    /// A page as stored and sent.
    ///
    /// # Errors
    /// If there is none of this number, or its file was damaged or changed.
    pub fn page(&self, number: u32) -> Result<Bytes, StoreError> {
        let at = self.pages.get(number as usize).zip(self.root.pages.get(number as usize));
        let (location, entry) = at.ok_or(StoreError::NoSuch { what: "page", number })?;
        self.read(("page", number), location, &entry.hash)
    }
    /// A chunk as stored and sent.
    ///
    /// # Errors
    /// If there is none of this number, or its file was damaged or changed.
    pub fn chunk(&self, number: u32) -> Result<Bytes, StoreError> {
        let at = self.chunks.get(number as usize).zip(self.index.chunks.get(number as usize));
        let (location, entry) = at.ok_or(StoreError::NoSuch { what: "chunk", number })?;
        self.read(("chunk", number), location, &entry.hash)
    }
    /// The triangles of the source scene in each cell; None when the dataset does not say.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn source_ranges(&self) -> Result<Option<Vec<Vec<SourceRange>>>, StoreError> {
        source::read(self.files.source())
    }
    /// What the source scene's files say about its nodes; empty when they name none.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn elements(&self) -> Result<Vec<SceneElement>, StoreError> {
        elements::read(&self.files.elements())
    }
    /// The build's report; None when it is missing, damaged, or of another dataset.
    pub fn report(&self) -> Option<serde_json::Value> {
        let report = report::read(&self.path, !self.files.are_old()).ok()??;
        report::is_of(&report, &self.root.hash).then_some(report)
    }

    fn read(&self, what: (&'static str, u32), at: &Location, hash: &ChunkHash) -> Result<Bytes, StoreError> {
        read((&self.files, &self.packs), what, at, hash).map(Bytes::from)
    }
}

/// Reads a page or a chunk and checks it.
fn read(
    (files, packs): (&DataFiles, &[Pack]),
    (what, number): (&'static str, u32),
    at: &Location,
    hash: &ChunkHash,
) -> Result<Vec<u8>, StoreError> {
    let path = || files.pack(at.pack as usize);
    let pack = packs.get(at.pack as usize).ok_or_else(|| StoreError::NoPack { path: path() })?;
    let damaged = |why| StoreError::Damaged { path: path(), what, number, offset: at.offset, why };
    pack.read(at, hash).map_err(damaged)
}
