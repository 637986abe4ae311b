//! A small dataset: written, opened, damaged byte by byte, stopped at every step.

pub(crate) mod faults;
mod publish;

use super::{files::DataFiles, *};
use crate::octree::SourceRange;
use glam::{DAffine3, DVec3, Vec2, Vec3};
use ldi_protocol::{
    Aabb, OutputCamera, ViewBasis,
    codec::{ColourMode, cell, cell::ClusterSteps, ldi as ldi_codec, texture as texture_codec},
    index::*,
    ldi::{DisparityCodes, Ldi, LdiCamera, LdiLayer, Segment},
    mesh::{Alpha, CellGeometry, Cluster, ClusterInstance, ClusterRef, Material, Wrap},
    texture::{MipLevel, Texture},
};
use serde_json::json;
use std::{
    borrow::Cow,
    fs,
    path::{Path, PathBuf},
};

/// A folder that goes away with the test.
struct Folder(PathBuf);
impl Folder {
    fn new(name: &str) -> Self {
        Self::below(&std::env::temp_dir(), name)
    }
    /// In memory, where there is such a place: what is synced often takes its time on a disk.
    fn quick(name: &str) -> Self {
        let memory = Path::new("/dev/shm");
        if memory.is_dir() { Self::below(memory, name) } else { Self::new(name) }
    }
    fn below(parent: &Path, name: &str) -> Self {
        let path = parent.join(format!("ldi-store-{}-{name}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        Self(path)
    }
}
impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn cluster(shift: f32) -> Cluster {
    Cluster {
        material: 0,
        positions: vec![Vec3::new(shift, 0.0, 0.0), Vec3::new(shift + 1.0, 0.0, 0.0), Vec3::new(shift, 1.0, 0.5)],
        origin: DVec3::ZERO,
        normals: vec![Vec3::Z; 3],
        uvs: vec![Vec2::ZERO, Vec2::X, Vec2::Y],
        colours: vec![],
        triangles: vec![[0, 1, 2], [0, 2, 1]],
    }
}

fn image() -> Ldi {
    let (width, height) = (40u32, 10u32);
    let layer = |code: u16, count: u16| {
        let rows = 0..height as u16;
        LdiLayer {
            segments: rows.map(|row| Segment { row, column_base: 0, first: u32::from(row * count), count }).collect(),
            column: (0..height).flat_map(|_| 0..count as u8).collect(),
            disparity: vec![code; (u32::from(count) * height) as usize],
            rgb: (0..u32::from(count) * height).map(|i| [(i * 7) as u8, (i * 3) as u8, 9]).collect(),
            links: vec![0; (u32::from(count) * height) as usize],
            ends: vec![],
            slopes: vec![],
        }
        .with_half_ends()
    };
    Ldi {
        camera: LdiCamera {
            cop: DVec3::ZERO,
            basis: ViewBasis::from_yaw_pitch(0.0, 0.0),
            pixels_per_unit: 50.0,
            left: -20,
            top: -5,
            width,
            height,
        },
        codes: DisparityCodes { smallest: 0.1, step: 0.001, largest_code: 300 },
        layers: vec![layer(200, 40), layer(100, 12)],
        sky: vec![0; height as usize],
        slivers: vec![],
    }
}

/// A dataset with one of everything: two cells, a bundle, an LDI of two chunks, a texture of one.
struct Sample {
    index: Index,
    chunks: Vec<Vec<u8>>,
    ranges: Vec<Vec<SourceRange>>,
}

fn sample() -> Sample {
    let steps = |n: usize| vec![ClusterSteps { position_log2: -14, uv_log2: -8 }; n];
    let bundle = CellGeometry { clusters: vec![cluster(0.0), cluster(2.0)], instances: vec![] };
    let at = |cluster, x: f64| ClusterInstance { cluster, world_from_mesh: DAffine3::from_translation(DVec3::X * x) };
    let shared = ClusterRef::Shared { chunk: 0, cluster: 1 };
    let near =
        CellGeometry { clusters: vec![cluster(0.5)], instances: vec![at(ClusterRef::Own(0), 0.0), at(shared, 1.0)] };
    let far = CellGeometry { clusters: vec![], instances: vec![at(shared, 5.0)] };
    let rgba = (0..20 * 9).map(|i| [i as u8, (i / 3) as u8, 77, 255]).collect();
    let pyramid =
        Texture::from_base(MipLevel { width: 20, height: 9, rgba }, false).levels.into_iter().flatten().collect();
    let texture = texture_codec::TextureLevels { width: 20, height: 9, first_level: 0, levels: pyramid };
    let ldi = image();
    let mut chunks = Vec::new();
    let mut entries = Vec::new();
    let mut add = |kind, bytes: Vec<u8>, decoded: usize| {
        let hash = ChunkHash(blake3::hash(&bytes).into());
        entries.push(ChunkEntry { hash, stored_bytes: bytes.len() as u32, decoded_bytes: decoded as u32, kind });
        chunks.push(bytes);
    };
    for (kind, g) in [(ChunkKind::Bundle, &bundle), (ChunkKind::Cell, &near), (ChunkKind::Cell, &far)] {
        add(kind, cell::encode(g, &steps(g.clusters.len()), 3).unwrap(), cell::decoded_bytes(g));
    }
    let [first, deeper] = ldi_codec::decoded_bytes(&ldi);
    add(ChunkKind::Ldi, ldi_codec::encode_first(&ldi, ColourMode::LOSSLESS, 3).unwrap(), first);
    add(ChunkKind::Ldi, ldi_codec::encode_deeper(&ldi, ColourMode::LOSSLESS, 3).unwrap().unwrap(), deeper);
    let encoded = texture_codec::encode(&texture, ColourMode::LOSSLESS, 3).unwrap();
    add(ChunkKind::Texture, encoded, texture_codec::decoded_bytes(&texture));
    let cell_entry = |chunk: u32, low: f64, high: f64, triangles: u32| CellEntry {
        bounds: Aabb { min: DVec3::new(low, 0.0, 0.0), max: DVec3::new(high, 1.0, 0.5) },
        triangles,
        chunk,
        bundles: vec![0],
        materials: vec![0],
        texel_density: vec![12],
        levels: Vec::new(),
    };
    let bounds = Aabb { min: DVec3::ZERO, max: DVec3::new(8.0, 1.0, 0.5) };
    let index = Index {
        scene: SceneInfo { name: "sample".into(), triangles: 6, unique_triangles: 6, instances: 3, bounds },
        settings: BuildSettings {
            budget: 4,
            optimize_budget: 3,
            camera: OutputCamera { width: 64, height: 36, fov_deg: 60.0 },
            max_footprint_px: 2.0,
            max_deviation_px: 0.5,
            pitch_deg: 60.0,
            density: 1.0,
            colour: "high".into(),
            grid: "paper".into(),
            eye_height_m: None,
        },
        chunks: entries,
        cells: vec![cell_entry(1, 0.5, 4.0, 4), cell_entry(2, 7.0, 8.0, 2)],
        materials: vec![Material {
            base_colour: [1.0; 4],
            texture: Some(0),
            alpha: Alpha::Opaque,
            unlit: false,
            double_sided: false,
            wrap: [Wrap::Repeat; 2],
        }],
        textures: vec![TextureEntry {
            width: 20,
            height: 9,
            chunks: vec![TextureChunk { chunk: 5, first_level: 0, last_level: 4 }],
        }],
        pitch_bands_deg: vec![-60.0, 60.0],
        points: vec![GridPoint {
            position: DVec3::ZERO,
            level: 0,
            radius: 1.0,
            bands: vec![vec![AngularRange { yaw_start_deg: 0.0, placement: Some(0) }]],
        }],
        placements: vec![Placement {
            grid_point: Some(0),
            cop: DVec3::ZERO,
            culled: [1].into_iter().collect(),
            footprint_px: 1.5,
            users: bounds,
            images: 0..1,
            sky: Default::default(),
        }],
        images: vec![ImageEntry {
            basis: ViewBasis::from_yaw_pitch(0.0, 0.0),
            plane_distance: 3.0,
            window: [-1.0, 1.0, -1.0, 1.0],
            stretch_p99_px: 1.0,
            chunks: vec![3, 4],
            samples_by_layer: vec![400, 120],
        }],
        volume: None,
        tree: None,
        rooms: None,
        plans: Vec::new(),
    };
    let range = |node, count| SourceRange { node, mesh: 0, primitive: 1, first: 300, count };
    Sample { index, chunks, ranges: vec![vec![range(1, 2), range(2, 2)], vec![range(70_000, 2)]] }
}

impl Sample {
    fn write(&self, path: &Path) -> Result<Written, StoreError> {
        DatasetWriter::open(path)?.finish(
            &self.index,
            |_, k| Ok(Cow::Borrowed(&self.chunks[k as usize][..])),
            &self.ranges,
            true,
            |w| json!({ "bytes": { "manifest": w.manifest_bytes }, "skipped": [{ "what": "portals", "why": "no rooms" }] }),
        )
    }
}

/// All files of a folder and below with their content, sorted.
fn contents(path: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut out = Vec::new();
    for entry in fs::read_dir(path).unwrap() {
        let entry = entry.unwrap().path();
        if entry.is_dir() { out.extend(contents(&entry)) } else { out.push((entry.clone(), fs::read(&entry).unwrap())) }
    }
    out.sort();
    out
}

#[test]
fn what_was_written_is_read() {
    let folder = Folder::new("read");
    let sample = sample();
    let written = sample.write(&folder.0).unwrap();
    let dataset = Dataset::open(&folder.0).unwrap();
    assert_eq!(**dataset.index(), sample.index);
    assert_eq!(dataset.hash(), written.hash);
    assert_eq!(dataset.pack_bytes(), written.pack_bytes);
    for (k, chunk) in sample.chunks.iter().enumerate() {
        assert_eq!(dataset.chunk(k as u32).unwrap(), *chunk);
    }
    assert!(matches!(dataset.chunk(6), Err(StoreError::NoSuch { .. })));
    for (k, page) in dataset.root().pages.iter().enumerate() {
        assert_eq!(ChunkHash(blake3::hash(&dataset.page(k as u32).unwrap()).into()), page.hash);
    }
    assert!(matches!(dataset.page(dataset.pages()), Err(StoreError::NoSuch { .. })));
    assert_eq!(dataset.source_ranges().unwrap().unwrap(), sample.ranges);
    assert!(!folder.0.join(files::WORK).exists(), "the work directory goes when the dataset is complete");
    let result = verify(&folder.0).unwrap();
    assert_eq!(result.faults, []);
    assert_eq!((result.chunks, result.decoded), (6, 6));
}

#[test]
fn equal_content_lies_once_and_equal_input_gives_equal_bytes() {
    let (a, b) = (Folder::new("once-a"), Folder::new("once-b"));
    let mut sample = sample();
    let before = sample.write(&a.0).unwrap();
    sample.write(&b.0).unwrap();
    let names = |f: &Folder| {
        contents(&f.0).into_iter().map(|(p, c)| (p.strip_prefix(&f.0).unwrap().to_owned(), c)).collect::<Vec<_>>()
    };
    assert_eq!(names(&a), names(&b));
    sample.chunks.push(sample.chunks[1].clone());
    sample.index.chunks.push(sample.index.chunks[1]);
    let after = sample.write(&b.0).unwrap();
    let growth = after.pack_bytes[0] - before.pack_bytes[0];
    assert!(growth < 100, "only the chunk table may grow, not by {growth} bytes");
    assert_eq!(Dataset::open(&b.0).unwrap().chunk(6).unwrap(), sample.chunks[1]);
}

/// The name of a pack in a dataset's folder.
fn name_of_pack(dataset: &Path, number: usize) -> String {
    let pack = files_of(dataset).pack(number);
    pack.strip_prefix(dataset).unwrap().display().to_string()
}

/// The name of the file of source ranges in a dataset's folder.
fn name_of_source(dataset: &Path) -> String {
    files_of(dataset).source().strip_prefix(dataset).unwrap().display().to_string()
}

fn files_of(dataset: &Path) -> DataFiles {
    let root = fs::read(dataset.join(files::MANIFEST)).unwrap();
    DataFiles::find(dataset, &ldi_protocol::manifest::dataset_hash(&root))
}

/// The faults after flipping a bit in one byte of a file.
fn faults_after_flip(folder: &Path, file: &str, at: usize) -> Vec<Fault> {
    let path = folder.join(file);
    let good = fs::read(&path).unwrap();
    let mut bad = good.clone();
    bad[at] ^= 1 << (at % 8);
    fs::write(&path, &bad).unwrap();
    let result = verify(folder);
    fs::write(&path, &good).unwrap();
    match result {
        Ok(v) => v.faults,
        Err(e @ StoreError::Format { .. }) => vec![Fault {
            file: "manifest".into(),
            kind: "manifest".into(),
            number: None,
            hash: None,
            offset: None,
            problem: e.to_string(),
        }],
        Err(e) => panic!("{e}"),
    }
}

#[test]
fn any_flipped_byte_is_named() {
    let folder = Folder::new("flip");
    let sample = sample();
    sample.write(&folder.0).unwrap();
    let dataset = Dataset::open(&folder.0).unwrap();
    let pages: usize = dataset.root().pages.iter().map(|p| p.stored_bytes as usize).sum();
    let pack = &name_of_pack(&folder.0, 0);
    let source = &name_of_source(&folder.0);
    let mut at = 0;
    for (number, p) in dataset.root().pages.iter().enumerate() {
        for byte in (at..at + p.stored_bytes as usize).step_by(7) {
            let faults = faults_after_flip(&folder.0, pack, byte);
            assert_eq!(faults.len(), 1);
            assert_eq!(
                (faults[0].kind.as_str(), faults[0].number, faults[0].file.as_str()),
                ("page", Some(number as u32), pack.as_str())
            );
        }
        at += p.stored_bytes as usize;
    }
    assert_eq!(at, pages);
    let kinds = ["bundle", "cell", "cell", "ldi", "ldi", "texture"];
    for (number, chunk) in sample.chunks.iter().enumerate() {
        for byte in (at..at + chunk.len()).step_by(5).chain([at + chunk.len() - 1]) {
            let faults = faults_after_flip(&folder.0, pack, byte);
            assert_eq!(faults.len(), 1, "byte {byte}: {faults:?}");
            let f = &faults[0];
            assert_eq!((f.kind.as_str(), f.number, f.offset), (kinds[number], Some(number as u32), Some(at as u64)));
            assert_eq!(f.hash.as_ref(), Some(&sample.index.chunks[number].hash.to_string()));
        }
        at += chunk.len();
    }
    assert_eq!(at as u64, dataset.pack_bytes()[0]);
    for byte in (0..dataset.manifest_root().len()).step_by(3) {
        let faults = faults_after_flip(&folder.0, "manifest", byte);
        assert_eq!((faults.len(), faults[0].kind.as_str()), (1, "manifest"));
    }
    for byte in (0..fs::metadata(folder.0.join(source)).unwrap().len() as usize).step_by(2) {
        let faults = faults_after_flip(&folder.0, source, byte);
        assert_eq!((faults.len(), faults[0].kind.as_str()), (1, "source"));
    }
    assert_eq!(verify(&folder.0).unwrap().faults, []);
}

#[test]
fn packs_that_are_missing_short_long_or_too_many_are_named() {
    let folder = Folder::new("packs");
    let sample = sample();
    sample.write(&folder.0).unwrap();
    let path = folder.0.join(name_of_pack(&folder.0, 0));
    let good = fs::read(&path).unwrap();
    fs::write(&path, [&good[..], &[0]].concat()).unwrap();
    assert_eq!(verify(&folder.0).unwrap().faults.len(), 1);
    assert!(matches!(Dataset::open(&folder.0), Err(StoreError::PackLength { .. })));
    fs::write(&path, &good[..good.len() - 1]).unwrap();
    let faults = verify(&folder.0).unwrap().faults;
    assert_eq!(faults.iter().map(|f| f.kind.as_str()).collect::<Vec<_>>(), ["pack", "texture"], "{faults:?}");
    fs::write(&path, &good).unwrap();
    fs::write(folder.0.join(name_of_pack(&folder.0, 1)), b"x").unwrap();
    assert_eq!(verify(&folder.0).unwrap().faults.len(), 1);
    fs::remove_file(&path).unwrap();
    assert!(!verify(&folder.0).unwrap().faults.is_empty());
    let error = Dataset::open(&folder.0).unwrap_err();
    assert!(error.permanent(), "{error}");
}

/// Chunks whose hashes are right but whose content contradicts the index.
#[test]
fn contents_that_contradict_the_index_are_named() {
    type Break = fn(&mut Sample);
    let breaks: [(&str, u32, Break); 6] = [
        ("cell", 1, |s| s.index.cells[0].triangles = 5),
        ("cell", 2, |s| s.index.cells[1].bounds.max.x = 7.5),
        ("ldi", 3, |s| s.index.images[0].samples_by_layer[1] = 119),
        ("ldi", 3, |s| s.index.images[0].basis = ViewBasis::from_yaw_pitch(1.0, 0.0)),
        ("texture", 5, |s| s.index.chunks[5].decoded_bytes += 1),
        ("texture", 5, |s| s.index.textures[0].width = 21),
    ];
    for (kind, number, damage) in breaks {
        let folder = Folder::new("contradict");
        let mut sample = sample();
        damage(&mut sample);
        sample.write(&folder.0).unwrap();
        let faults = verify(&folder.0).unwrap().faults;
        assert_eq!(faults.len(), 1, "{kind}: {faults:?}");
        assert_eq!((faults[0].kind.as_str(), faults[0].number), (kind, Some(number)), "{}", faults[0]);
    }
}

#[test]
fn a_stopped_build_goes_on_and_gives_the_same_bytes() {
    let (straight, stopped) = (Folder::new("straight"), Folder::new("stopped"));
    let sample = sample();
    sample.write(&straight.0).unwrap();
    let key = |k: usize| *blake3::hash(&[k as u8]).as_bytes();
    let mut made = 0;
    for stop in 0..=2 * sample.chunks.len() {
        // One run: makes what is not there, is stopped after `stop` steps in all.
        let writer = DatasetWriter::open(&stopped.0).unwrap();
        for (k, chunk) in sample.chunks.iter().enumerate().take(stop) {
            if writer.cached(&key(k)).is_none() {
                writer.store(&key(k), chunk).unwrap();
                made += 1;
            }
        }
        if let Some(fail_at) = stop.checked_sub(sample.chunks.len()) {
            let result = writer.finish(
                &sample.index,
                |_, k| {
                    if k as usize == fail_at {
                        return Err(StoreError::Chunk { number: k });
                    }
                    Ok(Cow::Borrowed(&sample.chunks[k as usize][..]))
                },
                &sample.ranges,
                true,
                |_| json!({}),
            );
            assert_eq!(result.is_err(), fail_at < sample.chunks.len());
        }
        let complete = stop == 2 * sample.chunks.len();
        assert_eq!(Dataset::open(&stopped.0).is_ok(), complete, "after step {stop}");
    }
    assert_eq!(made, sample.chunks.len(), "every piece is made once");
    for (path, bytes) in contents(&straight.0) {
        let name = path.strip_prefix(&straight.0).unwrap();
        if name != Path::new("report.json") {
            assert_eq!(fs::read(stopped.0.join(name)).unwrap(), bytes, "{}", name.display());
        }
    }
    assert_eq!(contents(&straight.0).len(), contents(&stopped.0).len(), "nothing is left over");
}

#[test]
fn torn_pieces_do_not_count() {
    let folder = Folder::new("torn");
    let writer = DatasetWriter::open(&folder.0).unwrap();
    let key = [7; 32];
    writer.store(&key, b"a piece of some length").unwrap();
    assert_eq!(writer.cached(&key).unwrap(), b"a piece of some length");
    assert_eq!(writer.cached(&[8; 32]), None);
    let (path, whole) = contents(&folder.0.join(files::WORK)).into_iter().find(|(_, c)| !c.is_empty()).unwrap();
    for n in 0..whole.len() {
        fs::write(&path, &whole[..n]).unwrap();
        assert_eq!(writer.cached(&key), None, "cut at {n}");
        let mut flipped = whole.clone();
        flipped[n] ^= 4;
        fs::write(&path, &flipped).unwrap();
        assert_eq!(writer.cached(&key), None, "flipped at {n}");
    }
    writer.store(&key, b"").unwrap();
    assert_eq!(writer.cached(&key).unwrap(), b"");
}

#[test]
fn a_new_dataset_replaces_the_old_one_whole() {
    let folder = Folder::new("replace");
    let mut sample = sample();
    sample.write(&folder.0).unwrap();
    fs::write(folder.0.join(name_of_pack(&folder.0, 7)), b"left over").unwrap();
    sample.index.settings.budget = 5;
    let written = sample.write(&folder.0).unwrap();
    assert_eq!(Dataset::open(&folder.0).unwrap().hash(), written.hash);
    assert_eq!(verify(&folder.0).unwrap().faults, []);
}

#[test]
fn directories_that_are_no_datasets_are_refused_with_a_remedy() {
    let folder = Folder::new("none");
    let refused = |path: &Path, word: &str| {
        for e in [Dataset::open(path).unwrap_err(), verify(path).unwrap_err()] {
            assert!(e.permanent() && e.to_string().contains(word), "{e}");
        }
    };
    refused(&folder.0, "no such directory");
    fs::create_dir_all(&folder.0).unwrap();
    refused(&folder.0, "no manifest");
    fs::write(folder.0.join("letter.txt"), "dear").unwrap();
    assert!(matches!(DatasetWriter::open(&folder.0), Err(StoreError::NotOurs { .. })), "never write among other files");
    fs::remove_file(folder.0.join("letter.txt")).unwrap();
    let writer = DatasetWriter::open(&folder.0).unwrap();
    refused(&folder.0, "not finished");
    assert!(matches!(DatasetWriter::open(&folder.0), Err(StoreError::Locked { .. })), "one build at a time");
    drop(writer);
    sample().write(&folder.0).unwrap();
    let manifest = folder.0.join("manifest");
    let mut other = fs::read(&manifest).unwrap();
    other[3] += 1;
    fs::write(&manifest, &other).unwrap();
    refused(&folder.0, &format!("format version {}", ldi_protocol::manifest::VERSION + 1));
    fs::write(&manifest, b"hello").unwrap();
    assert!(Dataset::open(&folder.0).unwrap_err().permanent());
}

#[test]
fn inspect_tells_what_is_in_it() {
    let folder = Folder::new("inspect");
    let sample = sample();
    sample.write(&folder.0).unwrap();
    let dataset = Dataset::open(&folder.0).unwrap();
    let value = inspect(&dataset, true).unwrap();
    assert_eq!(value["cells"][0]["ranges"], json!([[1, 0, 1, 300, 2], [2, 0, 1, 300, 2]]));
    assert_eq!(value["cells"][1]["bounds"]["max"], json!([8.0, 1.0, 0.5]));
    assert_eq!(value["cells"][1]["triangles"], 2);
    assert_eq!(
        value["samples"],
        json!({ "total": 520, "by_layer": [400, 120], "bytes_per_sample": value["samples"]["bytes_per_sample"] })
    );
    assert_eq!(value["grid"]["by_level"], json!([1]));
    assert_eq!(value["skipped"][0]["what"], "portals");
    assert_eq!(inspect(&dataset, false).unwrap().get("cells"), None);
    let text = inspect_text(&value);
    for word in ["6 triangles", "520, by layer [400,120]", "portals: no rooms", "budget 4"] {
        assert!(text.contains(word), "{word} is missing in\n{text}");
    }
}
