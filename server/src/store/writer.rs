//! Writing a dataset.

use super::{
    StoreError, elements,
    files::{self, DataFiles, PendingFile, SyncedFile},
    folder::DatasetFolder,
    report, source,
    work::WorkDirectory,
};
use crate::octree::SourceRange;
use crate::scene::SceneElement;
use ldi_protocol::{
    index::{ChunkHash, Index},
    manifest::{self, Encoded, MAX_ROOT_BYTES, Root, layout::Layout},
};
use std::{borrow::Cow, path::Path};

/// What a report and the names of files may take beside the files that are counted: far above any
/// real one.
const OTHER_BYTES: u64 = 4 << 20;

/// A dataset under construction: first a place for finished pieces, at the end the dataset itself.
#[derive(Debug)]
pub struct DatasetWriter {
    folder: DatasetFolder,
    work: WorkDirectory,
    elements: Vec<SceneElement>,
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
    /// Bytes of the manifest's root, and of the files `source` and `elements`.
    pub other_bytes: u64,
}

impl Written {
    /// Bytes of all files but `report.json`.
    pub fn total_bytes(&self) -> u64 {
        self.pack_bytes.iter().sum::<u64>() + self.other_bytes
    }
}

impl DatasetWriter {
    /// Starts a dataset, or goes on with one that was stopped. An existing dataset in `path` stays
    /// as it is until [`DatasetWriter::finish`] has written all of the new one.
    ///
    /// # Errors
    /// If the directory holds anything but what a build put there, another build is writing here,
    /// or it cannot be written.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let folder = DatasetFolder::claim(path)?;
        let work = WorkDirectory::open(folder.path())?;
        Ok(Self { folder, work, elements: Vec::new() })
    }

    /// The same beside other processes that store other pieces in the same folder; nothing can be
    /// finished by it.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_beside_others(path: &Path) -> Result<Self, StoreError> {
        let folder = DatasetFolder::claim_beside_others(path)?;
        let work = WorkDirectory::open_shared(folder.path())?;
        Ok(Self { folder, work, elements: Vec::new() })
    }

    /// Whether a piece was stored under this key; a torn one counts.
    pub fn holds(&self, key: &[u8; 32]) -> bool {
        self.work.holds(key)
    }

    /// The same, of a scene whose nodes are these elements.
    pub fn with_elements(self, elements: Vec<SceneElement>) -> Self {
        Self { elements, ..self }
    }

    /// The piece that was stored under this key by this or an earlier run; None if there is none
    /// or it is torn.
    pub fn cached(&self, key: &[u8; 32]) -> Option<Vec<u8>> {
        self.work.cached(key)
    }

    /// Keeps a finished piece for this and later runs until the dataset is complete. The key is
    /// the hash of all that the piece depends on. May be called from several threads, each with
    /// its own keys.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn store(&self, key: &[u8; 32], piece: &[u8]) -> Result<(), StoreError> {
        self.work.store(key, piece)
    }

    /// Ends without a dataset; what this run made is removed again unless there is something in it.
    pub fn give_up(self) {
        self.work.remove_if_empty();
        self.folder.give_back();
    }

    /// Writes the dataset and, if it `is_whole`, removes the pieces: a build that goes on later
    /// needs them. `chunk` gives the bytes of a chunk by number and is called once per different
    /// content, in order, with the writer, as it may lie in a piece; `ranges` has one entry per
    /// cell; `report` makes `report.json` from what was written.
    ///
    /// The new files lie beside the old ones, under names of their own, until the manifest is
    /// renamed. That is the one step between the old dataset and the new one; what belongs to the
    /// old one is removed after it.
    ///
    /// # Errors
    /// If the index breaks a rule, a chunk's bytes are not those that the index lists, or a file
    /// cannot be written. The pieces and the old dataset are kept.
    pub fn finish<'a>(
        self,
        index: &Index,
        chunk: impl FnMut(&Self, u32) -> Result<Cow<'a, [u8]>, StoreError>,
        ranges: &[Vec<SourceRange>],
        is_whole: bool,
        report: impl FnOnce(&Written) -> serde_json::Value,
    ) -> Result<Written, StoreError> {
        let path = self.folder.path();
        let manifest_path = path.join(files::MANIFEST);
        let encoded = manifest::encode(index).map_err(StoreError::format(&manifest_path))?;
        let root = manifest::decode_root(&encoded.root).map_err(StoreError::format(&manifest_path))?;
        let new = DataFiles::new(path, &root.hash);
        let source = source::encode(ranges).map_err(StoreError::io(new.source(), "compress it"))?;
        let elements = match self.elements.is_empty() {
            true => Vec::new(),
            false => elements::encode(&self.elements).map_err(StoreError::io(&new.elements(), "compress it"))?,
        };

        let old = files::read_if_there(&manifest_path, MAX_ROOT_BYTES as u64)?;
        let old = old.map(|bytes| DataFiles::new(path, &manifest::dataset_hash(&bytes)));
        // With a damaged manifest nobody knows which files are the dataset's.
        let knows_old = old.as_ref().is_none_or(|old| old.folder().is_dir());
        if knows_old {
            // What an earlier run left that was stopped here.
            remove_other_data(path, old.as_slice())?;
        }
        check_space(path, &root, index, source.len() + elements.len())?;
        let written = self.write_data(&new, (&root, &encoded), (index, chunk), (&source, &elements));
        let written = written.inspect_err(|_| {
            // The next run writes it anew, and needs the room.
            if knows_old && old.as_ref() != Some(&new) {
                let _ = files::remove_folder(new.folder(), files::is_data_file);
            }
        })?;

        let report_path = path.join(files::REPORT);
        let text = report::encode(report(&written), &root.hash)
            .map_err(|e| StoreError::io(&report_path, "write it as JSON")(e.into()))?;
        let report = files::write_file(&report_path, text.as_bytes())?;
        let manifest = files::write_file(&manifest_path, &encoded.root)?;
        files::sync_directory(path)?;
        manifest.publish()?;
        files::sync_directory(path)?;
        report.publish()?;
        // The new dataset is there: what cannot be removed is no reason to fail.
        let removed = remove_other_data(path, &[new]);
        let removed = removed.and_then(|()| if is_whole { self.work.remove() } else { Ok(()) });
        if let Err(e) = removed.and_then(|()| files::sync_directory(path)) {
            tracing::warn!("the dataset is complete, but something of an earlier one is left: {e}");
        }
        Ok(written)
    }

    /// Writes packs, source ranges and elements.
    fn write_data<'a>(
        &self,
        files: &DataFiles,
        (root, encoded): (&Root, &Encoded),
        (index, mut chunk): (&Index, impl FnMut(&Self, u32) -> Result<Cow<'a, [u8]>, StoreError>),
        (source, elements): (&[u8], &[u8]),
    ) -> Result<Written, StoreError> {
        files::make_directory(files.folder())?;
        let mut packs = PackWriter { files, layout: Layout::default(), open: None };
        for (entry, page) in root.pages.iter().zip(&encoded.pages) {
            packs.append(entry.hash, entry.stored_bytes, || Ok(Cow::Borrowed(page)), None)?;
        }
        for (number, entry) in index.chunks.iter().enumerate() {
            let number = number as u32;
            packs.append(entry.hash, entry.stored_bytes, || chunk(self, number), Some(number))?;
        }
        let pack_bytes = packs.finish()?;
        files::write_file(files.source(), source)?.publish()?;
        if !elements.is_empty() {
            files::write_file(&files.elements(), elements)?.publish()?;
        }
        remove_other_packs(files, pack_bytes.len(), !elements.is_empty())?;
        files::sync_directory(files.folder())?;
        let pages: u64 = encoded.pages.iter().map(|p| p.len() as u64).sum();
        let root_bytes = encoded.root.len() as u64;
        Ok(Written {
            hash: root.hash,
            manifest_bytes: root_bytes + pages,
            pack_bytes,
            other_bytes: root_bytes + (source.len() + elements.len()) as u64,
        })
    }
}

/// Asks the disk before anything is written whether there is room.
fn check_space(dataset: &Path, root: &Root, index: &Index, beside: usize) -> Result<(), StoreError> {
    let mut layout = Layout::default();
    layout.place_pages(&root.pages);
    layout.place_chunks(&index.chunks);
    let needed = layout.pack_bytes().iter().sum::<u64>() + beside as u64 + OTHER_BYTES;
    match files::free_bytes(dataset) {
        Some(free) if free < needed => Err(StoreError::NoSpace { path: dataset.to_owned(), needed, free }),
        _ => Ok(()),
    }
}

/// Writes packs one after the other.
struct PackWriter<'a> {
    files: &'a DataFiles,
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
                self.close()?;
                let file = PendingFile::create(&self.files.pack(location.pack as usize))?;
                &mut self.open.insert((location.pack, file)).1
            }
        };
        file.write(&bytes)
    }

    fn close(&mut self) -> Result<(), StoreError> {
        self.open.take().map_or(Ok(()), |(_, full)| full.sync().and_then(SyncedFile::publish))
    }

    fn finish(mut self) -> Result<Vec<u64>, StoreError> {
        self.close()?;
        Ok(self.layout.pack_bytes().to_vec())
    }
}

/// Removes packs beyond the last one, and unfinished files, that an earlier run left.
fn remove_other_packs(files: &DataFiles, packs: usize, has_elements: bool) -> Result<(), StoreError> {
    let elements = has_elements.then(|| files.elements());
    let kept: Vec<_> = (0..packs).map(|k| files.pack(k)).chain([files.source().to_owned()]).chain(elements).collect();
    for entry in files::list(files.folder())? {
        let path = files.folder().join(&entry.name);
        if files::is_data_file(&entry.name) && entry.kind.is_file() && !kept.contains(&path) {
            files::remove_if_there(&path)?;
        }
    }
    Ok(())
}

/// Removes the folders of packs that belong to none of these.
fn remove_other_data(dataset: &Path, kept: &[DataFiles]) -> Result<(), StoreError> {
    for entry in files::list(dataset)? {
        let path = dataset.join(&entry.name);
        if files::is_data_folder(&entry.name) && entry.kind.is_dir() && kept.iter().all(|k| k.folder() != path) {
            files::remove_folder(&path, files::is_data_file)?;
        }
    }
    Ok(())
}
