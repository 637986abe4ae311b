//! Every fuzz target on its seeds, its corpus and seeded changes of the seeds: no panic, bounded
//! memory, and both ways out taken.
//!
//! `LDI_FUZZ_SECONDS=3600 LDI_FUZZ_TARGET=cell cargo test --release -p ldi-tests --test fuzz` runs
//! one target for an hour, from another seed each second.

use ldi_protocol::{
    index::ChunkHash,
    manifest::{self, PageEntry, PageKind},
};
use ldi_tests::{
    allocation::{Counting, peak_of},
    fuzz::{
        BYTES_PER_BYTE, TARGETS, Target,
        mutate::{Random, mutated},
        street::street,
        tidy,
    },
};
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Most bytes that decoding one forged page may take: the entries of all pages (192 MiB), one raw
/// section (64 MiB), and what lists need to grow.
const MOST_PAGES: usize = 300 << 20;
/// Changed inputs per target in a usual run.
const ROUNDS: u64 = 20_000;

/// What a target did so far.
#[derive(Default)]
struct Run {
    inputs: u64,
    accepted: u64,
    largest_peak: usize,
}

impl Run {
    /// Runs one input. One that breaks a promise is kept in a file that the message names.
    fn input(&mut self, target: &Target, bytes: &[u8]) -> bool {
        let (result, peak) = peak_of(|| catch_unwind(AssertUnwindSafe(|| (target.run)(bytes))));
        let most = target.most_bytes + BYTES_PER_BYTE * bytes.len();
        if result.is_err() || peak > most {
            let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("fuzz-{}", target.name));
            std::fs::write(&kept, bytes).expect("writable");
            let what = if result.is_err() { "panics".into() } else { format!("takes {peak} bytes, at most {most}") };
            panic!("{} {what}; the input is in {}: once mended, keep it in tests/corpus", target.name, kept.display());
        }
        self.inputs += 1;
        self.largest_peak = self.largest_peak.max(peak);
        let accepted = result.unwrap_or(false);
        self.accepted += u64::from(accepted);
        accepted
    }
}

/// Files of a target's corpus: inputs that once broke a promise.
fn corpus(target: &Target) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target.name);
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    entries.map(|e| e.expect("readable").path()).collect()
}

fn fuzz(target: &Target, seconds: Option<u64>) {
    let seeds = (target.seeds)();
    let mut run = Run::default();
    for (number, seed) in seeds.iter().enumerate() {
        assert!(run.input(target, seed), "{}: seed {number} is refused", target.name);
    }
    for file in corpus(target) {
        run.input(target, &std::fs::read(&file).expect("readable"));
    }
    run = Run::default();
    let began = Instant::now();
    let goes_on = |round: u64| match seconds {
        Some(seconds) => began.elapsed() < Duration::from_secs(seconds),
        None => round < ROUNDS,
    };
    let mut random = Random::new(seconds.map_or(1, |_| std::process::id().into()));
    for round in 0.. {
        if !goes_on(round) {
            break;
        }
        run.input(target, &mutated(&seeds, &mut random));
    }
    let Run { inputs, accepted, largest_peak } = run;
    println!("{}: {inputs} inputs, {accepted} accepted, at most {largest_peak} bytes", target.name);
    // Changes that are all harmless or all fatal at once would test nothing.
    assert!(accepted > 0 && accepted < inputs, "{}: {accepted} of {inputs} accepted", target.name);
}

#[test]
fn decoders_take_anything() {
    let seconds = std::env::var("LDI_FUZZ_SECONDS").ok().map(|s| s.parse().expect("a number of seconds"));
    let only = std::env::var("LDI_FUZZ_TARGET").ok();
    let chosen: Vec<&Target> = TARGETS.iter().filter(|t| only.as_deref().is_none_or(|o| o == t.name)).collect();
    assert!(!chosen.is_empty(), "LDI_FUZZ_TARGET is one of {:?}", TARGETS.each_ref().map(|t| t.name));
    chosen.into_iter().for_each(|target| fuzz(target, seconds));
    tidy();
}

/// Appends a LEB128 number.
fn put(out: &mut Vec<u8>, mut v: u64) {
    while v >= 128 {
        out.push(v as u8 | 128);
        v >>= 7;
    }
    out.push(v as u8);
}

/// A manifest page of these raw sections, compressed.
fn page(kind: PageKind, count: u32, sections: &[Vec<u8>]) -> Vec<u8> {
    let mut out = b"LDP".to_vec();
    out.extend([manifest::VERSION, kind as u8, 0]);
    put(&mut out, count.into());
    for raw in sections {
        let packed = zstd::bulk::compress(raw, 3).expect("compresses");
        let stored = if packed.len() < raw.len() { &packed } else { raw };
        put(&mut out, raw.len() as u64);
        put(&mut out, stored.len() as u64);
        out.extend(stored);
    }
    out
}

/// Pages of a few bytes that would take more memory than a client has.
fn bombs() -> Vec<(PageKind, u32, Vec<Vec<u8>>)> {
    let numbers = |all: &[u64]| {
        let mut out = Vec::new();
        all.iter().for_each(|n| put(&mut out, *n));
        out
    };
    let zeros = |bytes: u32| vec![0; bytes as usize];
    // Triangles, chunk, one run of bundles, no materials.
    let cell = numbers(&[2, 0, 1, 0, 1 << 30, 0]);
    // Level and number of bands, all of them empty.
    let point = [numbers(&[0, 1024]), zeros(1024)].concat();
    // Two plans with as many cells as all may have.
    let plans = numbers(&[2048, 2048, 0, 2048, 2048, 0]);
    let ranges = numbers(&[0, 1, 60 << 20]);
    vec![
        (PageKind::Chunks, 1 << 26, vec![zeros(1 << 20)]),
        (PageKind::Cells, 1, vec![zeros(24), cell]),
        (PageKind::Materials, 40 << 20, vec![zeros(1 << 20)]),
        (PageKind::Textures, 20 << 20, vec![zeros(60 << 20)]),
        (PageKind::Points, 50_000, vec![zeros(32 * 50_000), point.repeat(50_000), vec![]]),
        (PageKind::Points, 1, vec![zeros(32), [ranges, zeros(60 << 20)].concat(), vec![]]),
        (PageKind::Placements, 800_000, vec![zeros(80 * 800_000)]),
        (PageKind::TreeNodes, 7 << 20, vec![zeros(63 << 20)]),
        (PageKind::Rooms, 20 << 20, vec![zeros(16), zeros(60 << 20)]),
        (PageKind::Portals, 1 << 20, vec![zeros(60 << 20)]),
        (PageKind::Plans, 1 << 20, vec![zeros(48 << 20)]),
        (PageKind::Plans, 2, vec![zeros(96), plans, zeros(1 << 22), zeros(1 << 22)]),
    ]
}

#[test]
fn forged_pages_are_refused_before_they_take_memory() {
    let valid = (Target::named("manifest_root").seeds)().remove(0);
    let checksum = blake3::hash(&valid);
    let sealed = [&valid[..], checksum.as_bytes()].concat();
    let mut root = manifest::decode_root(&sealed).expect("a root");
    let tree = root.pages.iter().find(|p| p.kind == PageKind::Tree).copied().expect("a page of the tree");
    let (scene, whole) = (street(4, 16).with_tree().index, root.pages.clone());
    let tree_page = manifest::encode(&scene).expect("encodes");
    let listed = manifest::decode_root(&tree_page.root).expect("decodes").pages;
    let at = listed.iter().position(|p| p.kind == PageKind::Tree).expect("a page of the tree");
    let tree_page = &tree_page.pages[at];
    for (kind, count, sections) in bombs() {
        let forged = page(kind, count, &sections);
        assert!(forged.len() < 100_000, "{kind:?}: {} bytes", forged.len());
        drop(sections);
        let entry = PageEntry { kind, first: 0, count, ..whole[0] };
        root.pages = vec![tree, entry];
        for (entry, bytes) in root.pages.iter_mut().zip([tree_page, &forged]) {
            (entry.hash, entry.stored_bytes) = (ChunkHash(blake3::hash(bytes).into()), bytes.len() as u32);
        }
        let (result, peak) = peak_of(|| manifest::assemble(&root, &[&tree_page[..], &forged]));
        let error = result.map(drop).expect_err("more than an index may hold").to_string();
        assert!(!error.contains(char::is_control), "{error:?}");
        assert!(peak < MOST_PAGES, "{kind:?}: {peak} bytes: {error}");
    }
}

#[test]
fn corpora_belong_to_targets() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    for entry in std::fs::read_dir(folder).expect("the corpora").map(|e| e.expect("readable")) {
        let name = entry.file_name().to_string_lossy().into_owned();
        assert!(name == "README.md" || TARGETS.iter().any(|t| t.name == name), "no target is called {name}");
    }
}
