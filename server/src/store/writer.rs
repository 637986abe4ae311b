//! Writing a dataset.

use super::{
    StoreError,
    files::{self, PendingFile},
    source,
    work::WorkDirectory,
};
use crate::octree::SourceRange;
use ldi_protocol::{
    index::{ChunkHash, Index},
    manifest::{self, layout::Layout},
};
use std::{
    borrow::Cow,
    fs,
    path::{Path, PathBuf},
};

/// A dataset under construction: first a place for finished pieces, at the end the dataset itself.
#[derive(Debug)]
pub struct DatasetWriter {
    path: PathBuf,
    work: WorkDirectory,
}

/// What was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// The dataset's name: BLAKE3 of its manifest's root.
    pub hash: ChunkHash,
    /// Bytes of the manifest's root and pages.
    pub manifest_bytes: u64,
    /// Bytes of each pack, pages included.
    pub pack_bytes: Vec<u64>,
    /// Bytes of the manifest's root, and of the file `source`.
    pub other_bytes: u64,
}

impl Written {
    /// Bytes of all files but `report.json`.
    pub fn total_bytes(&self) -> u64 {
        self.pack_bytes.iter().sum::<u64>() + self.other_bytes
    }
}

impl DatasetWriter {
    /// Starts a dataset, or goes on with one that was stopped. An existing dataset in `path` stays as it is until
    /// [`DatasetWriter::finish`].
    ///
    /// # Errors
    /// If the directory holds anything else, another build is writing here, or it cannot be written.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        fs::create_dir_all(path).map_err(StoreError::io(path, "create it"))?;
        let mut foreign = false;
        let mut ours = false;
        for entry in fs::read_dir(path).map_err(StoreError::io(path, "list it"))? {
            let name = entry.map_err(StoreError::io(path, "list it"))?.file_name();
            ours |= [files::MANIFEST, files::PACKS, files::WORK].iter().any(|n| name == *n);
            foreign = true;
        }
        if foreign && !ours {
            return Err(StoreError::NotADataset {
                path: path.to_owned(),
                why: "the directory holds other files; name an empty or a new one",
            });
        }
        Ok(Self { path: path.to_owned(), work: WorkDirectory::open(path)? })
    }

    /// The piece that was stored under this key by this or an earlier run; None if there is none or it is torn.
    pub fn cached(&self, key: &[u8; 32]) -> Option<Vec<u8>> {
        self.work.cached(key)
    }

    /// Keeps a finished piece for this and later runs until the dataset is complete. The key is the hash of all that the piece
    /// depends on. May be called from several threads, each with its own keys.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn store(&self, key: &[u8; 32], piece: &[u8]) -> Result<(), StoreError> {
        self.work.store(key, piece)
    }

    /// Ends without a dataset; a directory that holds nothing is removed again.
    pub fn give_up(self) {
        self.work.remove_if_empty();
        let _ = fs::remove_dir(&self.path);
    }

    /// Writes the dataset and, if it `is_whole`, removes the pieces: a build that goes on later needs them. `chunk` gives the bytes of a chunk by number and is called once per different
    /// content, in order, with the writer, as it may lie in a piece; `ranges` has one entry per cell; `report` makes `report.json` from what was written.
    ///
    /// The old manifest goes first and the new one comes last: a stop in between leaves no dataset, but all pieces.
    ///
    /// # Errors
    /// If the index breaks a rule, a chunk's bytes are not those that the index lists, or a file cannot be written. The pieces are kept.
    pub fn finish<'a>(
        self,
        index: &Index,
        mut chunk: impl FnMut(&Self, u32) -> Result<Cow<'a, [u8]>, StoreError>,
        ranges: &[Vec<SourceRange>],
        is_whole: bool,
        report: impl FnOnce(&Written) -> serde_json::Value,
    ) -> Result<Written, StoreError> {
        let manifest_path = self.path.join(files::MANIFEST);
        let encoded = manifest::encode(index).map_err(StoreError::format(&manifest_path))?;
        let root = manifest::decode_root(&encoded.root).map_err(StoreError::format(&manifest_path))?;
        files::remove_if_there(&manifest_path)?;
        files::sync_directory(&self.path)?;

        let folder = self.path.join(files::PACKS);
        fs::create_dir_all(&folder).map_err(StoreError::io(&folder, "create it"))?;
        let mut packs = PackWriter { dataset: &self.path, layout: Layout::default(), open: None };
        for (entry, page) in root.pages.iter().zip(&encoded.pages) {
            packs.append(entry.hash, entry.stored_bytes, || Ok(Cow::Borrowed(page)), None)?;
        }
        for (number, entry) in index.chunks.iter().enumerate() {
            let number = number as u32;
            packs.append(entry.hash, entry.stored_bytes, || chunk(&self, number), Some(number))?;
        }
        let pack_bytes = packs.finish()?;
        remove_other_packs(&folder, pack_bytes.len())?;
        files::sync_directory(&folder)?;

        let source_path = self.path.join(files::SOURCE);
        let source = source::encode(ranges).map_err(StoreError::io(&source_path, "compress it"))?;
        files::write_file(&source_path, &source)?;
        let pages: u64 = encoded.pages.iter().map(|p| p.len() as u64).sum();
        let root_bytes = encoded.root.len() as u64;
        let written = Written {
            hash: root.hash,
            manifest_bytes: root_bytes + pages,
            pack_bytes,
            other_bytes: root_bytes + source.len() as u64,
        };
        let report_path = self.path.join(files::REPORT);
        let text = serde_json::to_vec_pretty(&report(&written))
            .map_err(|e| StoreError::io(&report_path, "write it as JSON")(e.into()))?;
        files::write_file(&report_path, &text)?;
        files::sync_directory(&self.path)?;
        files::write_file(&manifest_path, &encoded.root)?;
        files::sync_directory(&self.path)?;
        if is_whole {
            self.work.remove()?;
        }
        Ok(written)
    }
}

/// Writes packs one after the other.
struct PackWriter<'a> {
    dataset: &'a Path,
    layout: Layout,
    open: Option<(u32, PendingFile)>,
}

impl PackWriter<'_> {
    /// Appends a page or chunk unless its content is there already.
    fn append<'b>(
        &mut self,
        hash: ChunkHash,
        stored_bytes: u32,
        bytes: impl FnOnce() -> Result<Cow<'b, [u8]>, StoreError>,
        number: Option<u32>,
    ) -> Result<(), StoreError> {
        let (location, new) = self.layout.place(hash, stored_bytes);
        if !new {
            return Ok(());
        }
        let bytes = bytes()?;
        if bytes.len() != stored_bytes as usize || blake3::hash(&bytes).as_bytes() != &hash.0 {
            return Err(StoreError::Chunk { number: number.unwrap_or(u32::MAX) });
        }
        let file = match &mut self.open {
            Some((pack, file)) if *pack == location.pack => file,
            _ => {
                if let Some((_, full)) = self.open.take() {
                    full.publish()?;
                }
                let file = PendingFile::create(&files::pack_path(self.dataset, location.pack as usize))?;
                &mut self.open.insert((location.pack, file)).1
            }
        };
        file.write(&bytes)
    }

    fn finish(self) -> Result<Vec<u64>, StoreError> {
        if let Some((_, last)) = self.open {
            last.publish()?;
        }
        Ok(self.layout.pack_bytes().to_vec())
    }
}

/// Removes packs of an earlier dataset and unfinished files.
fn remove_other_packs(folder: &Path, keep: usize) -> Result<(), StoreError> {
    let kept: Vec<_> = (0..keep).map(|k| files::pack_path(Path::new(""), k)).collect();
    for entry in fs::read_dir(folder).map_err(StoreError::io(folder, "list it"))? {
        let entry = entry.map_err(StoreError::io(folder, "list it"))?;
        let name = entry.file_name();
        if kept.iter().all(|k| k.file_name() != Some(&name)) {
            files::remove_if_there(&entry.path())?;
        }
    }
    Ok(())
}
