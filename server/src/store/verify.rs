//! Checking every byte of a dataset.
//!
//! From the outside in: the root's checksum, the hash of every page, the rules of the index, the
//! length of every pack, the hash of every chunk, the source ranges; then every intact chunk is
//! decoded and compared with what the index says of it. One flipped byte anywhere gives one fault
//! that names the file and the chunk, and checking goes on as far as what is left allows: without
//! its pages nothing is known about chunks.

use super::{
    StoreError,
    dataset::read_root,
    elements,
    files::{self, DataFiles},
    packs::{self, Pack},
    report, source,
};
use ldi_protocol::{
    codec::{self, CodecError},
    index::{ChunkHash, ChunkKind, DrawnCell, Index},
    manifest::{
        self, Root,
        layout::{Layout, Location},
    },
    mesh::CellGeometry,
};
use rayon::prelude::*;
use serde::Serialize;
use std::{collections::BTreeMap, ops::Range, path::Path};

/// One fault of a dataset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Fault {
    /// The file, relative to the dataset.
    pub file: String,
    /// What is faulty: `manifest`, `page`, `pack`, `source`, or the kind of chunk.
    pub kind: String,
    /// Number of the page or chunk.
    pub number: Option<u32>,
    /// Its name.
    pub hash: Option<String>,
    /// First byte of it in the file.
    pub offset: Option<u64>,
    /// What is wrong.
    pub problem: String,
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.file, self.kind)?;
        if let Some(n) = self.number {
            write!(f, " {n}")?;
        }
        if let Some(h) = &self.hash {
            write!(f, " {h}")?;
        }
        if let Some(o) = self.offset {
            write!(f, " at byte {o}")?;
        }
        write!(f, ": {}", self.problem)
    }
}

/// What [`verify`] found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Default)]
pub struct Verification {
    /// Pages whose hash was compared.
    pub pages: usize,
    /// Chunks whose hash was compared.
    pub chunks: usize,
    /// Chunks that were decoded and compared with the index.
    pub decoded: usize,
    /// Whether all chunks are known: their list lies in the pages.
    pub all_known: bool,
    /// Bytes hashed.
    pub bytes: u64,
    /// Everything that is wrong, by file and place.
    pub faults: Vec<Fault>,
}

/// Checks the dataset in `path`. Damage is no error but a fault in the result.
///
/// # Errors
/// If there is no dataset, it has another version, or the operating system refuses to read.
pub fn verify(path: &Path) -> Result<Verification, StoreError> {
    verify_heard(path, &|_| {}, &|| {})
}

/// [`verify`], of which progress is heard: first the number of chunks, then each chunk.
///
/// # Errors
/// As [`verify`].
pub fn verify_heard(
    path: &Path,
    begin: &dyn Fn(usize),
    advance: &(dyn Fn() + Sync),
) -> Result<Verification, StoreError> {
    let (root_bytes, manifest_path) = read_root(path)?;
    let mut out = Verification { bytes: root_bytes.len() as u64, ..Verification::default() };
    let root = match manifest::decode_root(&root_bytes) {
        Ok(root) => root,
        Err(e @ CodecError::Version { .. }) => return Err(StoreError::format(&manifest_path)(e)),
        Err(e) => {
            out.faults.push(fault_of_file(files::MANIFEST, "manifest", e.to_string()));
            return Ok(out);
        }
    };
    let files = DataFiles::find(path, &root.hash);
    let source_name = name_in(path, files.source());
    match source::read(files.source()) {
        Ok(Some(_)) => {}
        Ok(None) => out.faults.push(fault_of_file(&source_name, "source", "the file is missing".into())),
        Err(StoreError::Format { source, .. }) => {
            out.faults.push(fault_of_file(&source_name, "source", source.to_string()))
        }
        Err(other) => return Err(other),
    }
    match elements::read(&files.elements()) {
        Ok(_) => {}
        Err(StoreError::Format { path: file, source }) => {
            out.faults.push(fault_of_file(&name_in(path, &file), "elements", source.to_string()))
        }
        Err(other) => return Err(other),
    }
    match report::read(path, !files.are_old()) {
        // A dataset is whole without it; `inspect` says that it is missing.
        Ok(_) => {}
        Err(StoreError::Format { source, .. }) => {
            out.faults.push(fault_of_file(files::REPORT, "report", source.to_string()));
        }
        Err(other) => return Err(other),
    }
    let packs = Packs { opened: packs::open_all(&files)?, dataset: path, files };
    let mut layout = Layout::default();
    let Some(index) = check_pages(&root, &mut layout, &packs, &mut out) else { return Ok(out) };
    out.all_known = true;
    let locations = layout.place_chunks(&index.chunks);
    packs.check_lengths(layout.pack_bytes(), &mut out);
    let places = Places { index: &index, packs: &packs, locations: &locations };
    begin(index.chunks.len());
    let check = |k| {
        let fault = places.check_hash(k);
        advance();
        fault
    };
    let hashed: Vec<Option<Fault>> = (0..index.chunks.len()).into_par_iter().map(check).collect();
    let read = || locations.iter().filter(|l| packs.reach(l));
    out.chunks = read().count();
    out.bytes += read().map(|l| u64::from(l.bytes)).sum::<u64>();
    let intact: Vec<bool> = hashed.iter().map(Option::is_none).collect();
    out.faults.extend(hashed.into_iter().flatten());
    places.check_contents(&intact, &mut out);
    Ok(out)
}

fn fault_of_file(file: &str, kind: &str, problem: String) -> Fault {
    Fault { file: file.into(), kind: kind.into(), number: None, hash: None, offset: None, problem }
}

/// The name of a file as faults show it.
fn name_in(dataset: &Path, file: &Path) -> String {
    file.strip_prefix(dataset).unwrap_or(file).display().to_string()
}

/// All packs that are there, whatever their length.
struct Packs<'a> {
    dataset: &'a Path,
    files: DataFiles,
    opened: Vec<Pack>,
}

impl Packs<'_> {
    fn name(&self, number: usize) -> String {
        name_in(self.dataset, &self.files.pack(number))
    }

    /// Whether there are bytes to be hashed.
    fn reach(&self, at: &Location) -> bool {
        self.opened.get(at.pack as usize).is_some_and(|p| at.offset + u64::from(at.bytes) <= p.bytes())
    }

    /// What lies somewhere, if it is intact; else what is wrong.
    fn read(&self, at: &Location, hash: &ChunkHash) -> Result<Vec<u8>, String> {
        let pack = self.opened.get(at.pack as usize).ok_or("its pack is missing")?;
        pack.read(at, hash)
    }

    fn check_lengths(&self, expected: &[u64], out: &mut Verification) {
        for number in 0..expected.len().max(self.opened.len()) {
            let problem = match (self.opened.get(number).map(Pack::bytes), expected.get(number)) {
                (None, _) => "the file is missing".to_owned(),
                (Some(_), None) => "no such pack belongs to the dataset".to_owned(),
                (Some(found), Some(&wanted)) if found != wanted => format!("{found} bytes instead of {wanted}"),
                _ => continue,
            };
            out.faults.push(fault_of_file(&self.name(number), "pack", problem));
        }
    }
}

/// Checks the pages' hashes and joins them; None when that cannot be done.
fn check_pages(root: &Root, layout: &mut Layout, packs: &Packs<'_>, out: &mut Verification) -> Option<Index> {
    let before = out.faults.len();
    let mut pages = Vec::new();
    for (number, (entry, location)) in root.pages.iter().zip(layout.place_pages(&root.pages)).enumerate() {
        match packs.read(&location, &entry.hash) {
            Ok(bytes) => pages.push(bytes),
            Err(problem) => out.faults.push(Fault {
                file: packs.name(location.pack as usize),
                kind: "page".into(),
                number: Some(number as u32),
                hash: Some(entry.hash.to_string()),
                offset: Some(location.offset),
                problem,
            }),
        }
        out.bytes += u64::from(entry.stored_bytes);
    }
    out.pages = root.pages.len();
    if out.faults.len() > before {
        return None;
    }
    manifest::assemble(root, &pages)
        .map_err(|e| out.faults.push(fault_of_file(files::MANIFEST, "manifest", e.to_string())))
        .ok()
}

/// Everything needed to look at chunks.
struct Places<'a> {
    index: &'a Index,
    packs: &'a Packs<'a>,
    locations: &'a [Location],
}

impl Places<'_> {
    fn fault(&self, chunk: usize, problem: String) -> Fault {
        let (entry, location) = (&self.index.chunks[chunk], &self.locations[chunk]);
        Fault {
            file: self.packs.name(location.pack as usize),
            kind: format!("{:?}", entry.kind).to_lowercase(),
            number: Some(chunk as u32),
            hash: Some(entry.hash.to_string()),
            offset: Some(location.offset),
            problem,
        }
    }

    /// A chunk that was intact when its hash was compared; else none, which no decoder takes.
    fn bytes(&self, chunk: u32) -> Vec<u8> {
        let (at, entry) = (&self.locations[chunk as usize], &self.index.chunks[chunk as usize]);
        self.packs.read(at, &entry.hash).unwrap_or_default()
    }

    fn check_hash(&self, chunk: usize) -> Option<Fault> {
        let read = self.packs.read(&self.locations[chunk], &self.index.chunks[chunk].hash);
        read.err().map(|problem| self.fault(chunk, problem))
    }

    /// Decodes every intact chunk and compares it with the entries that use it.
    fn check_contents(&self, intact: &[bool], out: &mut Verification) {
        let is_intact = |c: &u32| intact[*c as usize];
        let of_kind = |kind: ChunkKind| -> Vec<u32> {
            (0..self.index.chunks.len() as u32)
                .filter(|c| self.index.chunks[*c as usize].kind == kind)
                .filter(is_intact)
                .collect()
        };
        let bundles: Vec<(u32, Result<CellGeometry, CodecError>)> =
            of_kind(ChunkKind::Bundle).into_par_iter().map(|c| (c, self.bundle(c))).collect();
        out.decoded += bundles.len();
        let mut good = BTreeMap::new();
        for (chunk, result) in bundles {
            match result {
                Ok(bundle) => drop(good.insert(chunk, bundle)),
                Err(e) => out.faults.push(self.fault(chunk as usize, e.to_string())),
            }
        }
        let mut check = |count: usize, results: Vec<Result<(), Fault>>| {
            out.decoded += count;
            out.faults.extend(results.into_iter().filter_map(Result::err));
        };
        let cells: Vec<u32> = (0..self.index.cells.len() as u32)
            .filter(|k| is_intact(&self.index.cells[*k as usize].chunk))
            // A cell cannot be judged without its bundles; those have faults of their own.
            .filter(|k| self.index.cells[*k as usize].bundles.iter().all(|b| good.contains_key(b)))
            .collect();
        check(cells.len(), cells.par_iter().map(|&k| self.check_cell(k, &good)).collect());
        let levels = of_kind(ChunkKind::Levels);
        let of_chunk = self.levels_by_chunk(&good);
        let results = levels.par_iter().map(|c| self.check_levels(*c, of_chunk.get(c).map_or(&[][..], |l| l), &good));
        check(levels.len(), results.collect());
        let images: Vec<u32> = (0..self.index.images.len() as u32)
            .filter(|k| self.index.images[*k as usize].chunks.iter().all(is_intact))
            .collect();
        let chunks = images.iter().map(|k| self.index.images[*k as usize].chunks.len()).sum();
        check(chunks, images.par_iter().map(|&k| self.check_image(k)).collect());
        let textures: Vec<(usize, usize)> = (0..self.index.textures.len())
            .flat_map(|t| (0..self.index.textures[t].chunks.len()).map(move |k| (t, k)))
            .filter(|&(t, k)| is_intact(&self.index.textures[t].chunks[k].chunk))
            .collect();
        check(textures.len(), textures.par_iter().map(|&(t, k)| self.check_texture(t, k)).collect());
        if let Some(tree) = &self.index.tree {
            let broods: Vec<(u32, Range<u32>)> = tree.broods().filter(|(c, _)| is_intact(c)).collect();
            let results = broods.into_par_iter().map(|(chunk, nodes)| {
                let decoded = tree
                    .decode(nodes, &self.bytes(chunk))
                    .and_then(|brood| manifest::check_decoded_bytes(self.index, chunk, brood.decoded_bytes()));
                decoded.map_err(|e| self.fault(chunk as usize, format!("LDI tree: {e}")))
            });
            let results: Vec<_> = results.collect();
            check(results.len(), results);
        }
    }

    fn bundle(&self, chunk: u32) -> Result<CellGeometry, CodecError> {
        let bundle = codec::cell::decode(&self.bytes(chunk))?;
        manifest::check_bundle(self.index, &bundle)?;
        manifest::check_decoded_bytes(self.index, chunk, codec::cell::decoded_bytes(&bundle))?;
        Ok(bundle)
    }

    fn check_cell(&self, cell: u32, bundles: &BTreeMap<u32, CellGeometry>) -> Result<(), Fault> {
        let chunk = self.index.cells[cell as usize].chunk;
        let check = || {
            let geometry = codec::cell::decode(&self.bytes(chunk))?;
            manifest::check_decoded_bytes(self.index, chunk, codec::cell::decoded_bytes(&geometry))?;
            manifest::check_cell_content(self.index, DrawnCell::full(cell), &geometry, |b| bundles.get(&b))
        };
        check().map_err(|e| self.fault(chunk as usize, format!("cell {cell}: {e}")))
    }

    /// Levels of detail of cells by their chunks, those whose bundles are there.
    fn levels_by_chunk(&self, bundles: &BTreeMap<u32, CellGeometry>) -> BTreeMap<u32, Vec<DrawnCell>> {
        let mut of_chunk = BTreeMap::<u32, Vec<DrawnCell>>::new();
        for (cell, entry) in (0u32..).zip(&self.index.cells) {
            for (level, l) in (1u8..).zip(&entry.levels) {
                if l.bundles.iter().all(|b| bundles.contains_key(b)) {
                    of_chunk.entry(l.chunk).or_default().push(DrawnCell { cell, level });
                }
            }
        }
        of_chunk
    }

    fn check_levels(
        &self,
        chunk: u32,
        drawn: &[DrawnCell],
        bundles: &BTreeMap<u32, CellGeometry>,
    ) -> Result<(), Fault> {
        let check = || {
            let geometry = codec::cell::decode(&self.bytes(chunk))?;
            manifest::check_levels(self.index, &geometry)?;
            manifest::check_decoded_bytes(self.index, chunk, codec::cell::decoded_bytes(&geometry))?;
            drawn.iter().try_for_each(|c| manifest::check_cell_content(self.index, *c, &geometry, |b| bundles.get(&b)))
        };
        check().map_err(|e| self.fault(chunk as usize, format!("levels of detail: {e}")))
    }

    fn check_image(&self, image: u32) -> Result<(), Fault> {
        let entry = &self.index.images[image as usize];
        let (first, deeper) = match entry.chunks[..] {
            [] => return Ok(()),
            [first] => (first, None),
            [first, deeper, ..] => (first, Some(deeper)),
        };
        let wrap = |chunk: u32| move |e: CodecError| self.fault(chunk as usize, format!("image {image}: {e}"));
        let mut ldi = codec::ldi::decode_first(&self.bytes(first)).map_err(wrap(first))?;
        let first_bytes = codec::ldi::decoded_bytes(&ldi)[0];
        manifest::check_decoded_bytes(self.index, first, first_bytes).map_err(wrap(first))?;
        if let Some(deeper) = deeper {
            codec::ldi::decode_deeper(&self.bytes(deeper), &mut ldi).map_err(wrap(deeper))?;
            manifest::check_decoded_bytes(self.index, deeper, codec::ldi::decoded_bytes(&ldi)[1])
                .map_err(wrap(deeper))?;
        }
        manifest::check_ldi(self.index, image, &ldi).map_err(wrap(first))?;
        if ldi.layers.len() < entry.samples_by_layer.len() {
            let reason = format!("{} layers, but the index says {}", ldi.layers.len(), entry.samples_by_layer.len());
            return Err(wrap(deeper.unwrap_or(first))(CodecError::Mismatch { field: "layers", reason }));
        }
        Ok(())
    }

    fn check_texture(&self, texture: usize, part: usize) -> Result<(), Fault> {
        let entry = &self.index.textures[texture];
        let listed = &entry.chunks[part];
        let check = || {
            let levels = codec::texture::decode(&self.bytes(listed.chunk))?;
            manifest::check_decoded_bytes(self.index, listed.chunk, codec::texture::decoded_bytes(&levels))?;
            manifest::check_texture(entry, listed, &levels)
        };
        check().map_err(|e| self.fault(listed.chunk as usize, format!("texture {texture}: {e}")))
    }
}
