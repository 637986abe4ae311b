//! Seeded damage to every file of a dataset: `verify` finds what changes a served byte, a reader
//! gets right bytes or an error, and a walk over a damaged dataset goes on and says so.

#[path = "../../client/src/cache/fixture.rs"]
#[allow(dead_code, reason = "shared with other tests, which use the rest")]
mod fixture;
#[path = "streaming/host.rs"]
#[allow(dead_code, reason = "shared with other tests, which use the rest")]
mod host;

use fixture::{LDI, Street, street};
use host::{PATIENCE, folder};
use ldi_client::{cache::Incomplete, stream::Connection};
use ldi_protocol::index::ChunkHash;
use ldi_server::{
    octree::SourceRange,
    store::{Dataset, DatasetWriter, Verification, verify},
};
use ldi_tests::fuzz::mutate::Random;
use serde_json::json;
use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

/// Damages in all, each of one file.
const DAMAGES: u64 = 340;

fn write(street: &Street, dataset: &Path) -> ChunkHash {
    let ranges =
        vec![vec![SourceRange { node: 0, mesh: 0, primitive: 0, first: 0, count: 2 }]; street.index.cells.len()];
    let writer = DatasetWriter::open(dataset).expect("a new folder");
    let chunk = |_: &DatasetWriter, k: u32| Ok(Cow::Borrowed(&street.chunks[k as usize][..]));
    writer.finish(&street.index, chunk, &ranges, true, |_| json!({ "skipped": [] })).expect("writable").hash
}

/// All files below a folder, in order.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut out = Vec::new();
    for entry in std::fs::read_dir(folder).expect("readable").map(|e| e.expect("readable").path()) {
        if entry.is_dir() { out.extend(files(&entry)) } else { out.push(entry) }
    }
    out.sort();
    out
}

/// What a dataset serves, or the error in place of it.
#[derive(PartialEq)]
struct Served(Result<(Vec<u8>, Vec<Result<Vec<u8>, String>>), String>);

impl Served {
    fn of(path: &Path) -> Self {
        let dataset = match Dataset::open(path) {
            Ok(dataset) => dataset,
            Err(e) => return Self(Err(e.to_string())),
        };
        let pages = (0..dataset.pages()).map(|k| dataset.page(k));
        let chunks = (0..dataset.index().chunks.len()).map(|k| dataset.chunk(k as u32));
        let parts = pages.chain(chunks).map(|part| part.map(|b| b.to_vec()).map_err(|e| e.to_string()));
        Self(Ok((dataset.manifest_root().to_vec(), parts.collect())))
    }
}

/// Whether a message is one line that names a file of the dataset.
fn names_a_file(message: &str, dataset: &Path) -> bool {
    !message.contains(char::is_control) && message.contains(&dataset.display().to_string())
}

/// Damages a file in one of eight ways. Returns which, or None where nothing changed.
fn damage(file: &Path, random: &mut Random) -> Option<&'static str> {
    let old = std::fs::read(file).expect("readable");
    let mut bytes = old.clone();
    let (at, length) = (random.below(old.len()), 1 + random.below(200));
    let kind = match random.below(8) {
        0 | 1 => {
            bytes[at] ^= 1 << random.below(8);
            "flipped bit"
        }
        2 => {
            bytes.truncate(at);
            "truncation"
        }
        3 => {
            bytes.extend((0..length).map(|_| random.bits() as u8));
            "extension"
        }
        4 => {
            let length = length.min(old.len() / 2).max(1);
            let to = random.below(old.len() + 1 - length);
            let from = random.below(old.len() + 1 - length);
            let (a, b) = (old[from..from + length].to_vec(), old[to..to + length].to_vec());
            bytes[from..from + length].copy_from_slice(&b);
            bytes[to..to + length].copy_from_slice(&a);
            "swapped ranges"
        }
        5 => {
            let page = at / 4096 * 4096;
            let end = (page + 4096).min(bytes.len());
            bytes[page..end].fill(0);
            "zeroed page"
        }
        6 => {
            std::fs::remove_file(file).expect("removable");
            return Some("removed file");
        }
        _ => {
            bytes = (0..old.len()).map(|_| random.bits() as u8).collect();
            "foreign file"
        }
    };
    std::fs::write(file, &bytes).expect("writable");
    (bytes != old).then_some(kind)
}

#[test]
fn verify_finds_every_damage_that_changes_a_served_byte() {
    let dataset = folder("damage").join("dataset");
    let hash = write(&street(6, 48).with_tree(), &dataset);
    let good: Vec<(PathBuf, Vec<u8>)> =
        files(&dataset).into_iter().map(|f| (f.clone(), std::fs::read(&f).expect("readable"))).collect();
    assert!(good.len() >= 5, "a manifest, a marker, a report, a pack and source ranges: {good:?}");
    let before = Served::of(&dataset);
    let Ok((root, parts)) = &before.0 else { panic!("the dataset is sound") };
    assert!(verify(&dataset).expect("a dataset").faults.is_empty());
    let (mut found, mut harmless, mut done) = (0, Vec::new(), 0);
    for seed in 0.. {
        if done == DAMAGES {
            break;
        }
        let mut random = Random::new(seed);
        let (file, bytes) = &good[seed as usize % good.len()];
        let Some(kind) = damage(file, &mut random) else { continue };
        done += 1;
        let place = format!("seed {seed}, {kind} in {}", file.display());
        let after = Served::of(&dataset);
        match verify(&dataset) {
            Err(e) => {
                assert!(names_a_file(&e.to_string(), &dataset), "{place}: {e}");
                found += 1;
            }
            Ok(Verification { faults, .. }) if faults.is_empty() => {
                assert!(after == before, "{place}: it changes what is served, and verify finds nothing");
                harmless.push(place.clone());
            }
            Ok(Verification { faults, .. }) => {
                for fault in &faults {
                    assert!(!fault.to_string().contains(char::is_control), "{place}: {fault}");
                }
                found += 1;
            }
        }
        match &after.0 {
            Err(e) => assert!(names_a_file(e, &dataset), "{place}: {e}"),
            // What is read is what was written, or an error.
            Ok((now, read)) => {
                assert!(now == root && read.len() == parts.len(), "{place}");
                for (read, part) in read.iter().zip(parts) {
                    match read {
                        Ok(_) => assert!(read == part, "{place}: wrong bytes are served"),
                        Err(e) => assert!(names_a_file(e, &dataset), "{place}: {e}"),
                    }
                }
            }
        }
        std::fs::write(file, bytes).expect("writable");
    }
    assert!(found * 10 > DAMAGES * 6, "{found} of {DAMAGES} found");
    // The marker holds nothing that is served, and a report may be missing.
    for place in &harmless {
        assert!(place.contains("ldi-dataset") || place.contains("removed file in"), "{place} is not found");
    }
    assert!(!harmless.is_empty() && Dataset::open(&dataset).expect("whole again").hash() == hash);
}

/// A walk that needs a chunk which cannot be read gets all others, and says which one is missing.
#[test]
fn a_walk_over_damaged_chunks_goes_on_and_says_so() {
    let street = street(6, 48).with_tree();
    let dataset = folder("damage-walk").join("dataset");
    let hash = write(&street, &dataset);
    let pack = dataset.join(format!("packs-{}", &hash.to_string()[..16])).join("pack-00000.bin");
    let good = std::fs::read(&pack).expect("a pack");
    let chunks: Vec<u32> = (0..street.chunks.len() as u32).collect();
    for seed in 0..8 {
        let mut random = Random::new(seed);
        let hit = *random.pick(&[&LDI[1..], &chunks[..1], &chunks[5..]].concat());
        let bytes = &street.chunks[hit as usize];
        let at = good.windows(bytes.len()).position(|w| w == bytes).expect("the chunk lies in the pack");
        let mut damaged = good.clone();
        damaged[at + random.below(bytes.len())] ^= 1 << random.below(8);
        std::fs::write(&pack, &damaged).expect("writable");

        let opened = Dataset::open(&dataset).expect("its manifest is whole");
        let host = host::Host::start("damage-walk-server", opened);
        let connection = Connection::connect(host.config()).expect("the server runs");
        connection.request(&chunks);
        let missing = match connection.cache().wait(&chunks, PATIENCE) {
            Err(Incomplete::Damaged(missing)) => missing,
            other => panic!("seed {seed}: {other:?}"),
        };
        assert_eq!(missing, [hit], "seed {seed}");
        assert_eq!(connection.lost(), None, "seed {seed}: the walk goes on");
    }
}
