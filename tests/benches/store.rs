//! Reading chunks from a pack: what positioned reads with a check cost against a memory map.
//!
//!     cargo bench -p ldi-tests --bench store
//!
//! A pack of 64 MiB with chunks of 48 KiB, in the page cache. A chunk that is sent is looked at
//! once, to be encrypted: so the bytes of the map are summed up here.

use divan::{Bencher, black_box, counter::BytesCount};
use memmap2::Mmap;
use std::{fs::File, os::unix::fs::FileExt, path::Path, sync::LazyLock};

const CHUNK_BYTES: usize = 48 << 10;
const CHUNKS: usize = (64 << 20) / CHUNK_BYTES;

static PACK: LazyLock<(File, Mmap)> = LazyLock::new(|| {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bench-pack.bin");
    let bytes: Vec<u8> = (0..CHUNKS * CHUNK_BYTES).map(|i| (i * 7 + i / 251) as u8).collect();
    std::fs::write(&path, bytes).expect("writable");
    let file = File::open(&path).expect("there");
    // SAFETY: nobody else writes to the file.
    let map = unsafe { Mmap::map(&file) }.expect("mapped");
    (file, map)
});

fn main() {
    divan::main();
}

/// Runs `read` for one chunk after another.
fn bench(bencher: Bencher, read: impl Fn(usize) -> u64 + Sync) {
    let _ = &*PACK;
    let mut next = 0;
    bencher.counter(BytesCount::new(CHUNK_BYTES)).bench_local(|| {
        next = (next + 1) % CHUNKS;
        read(next * CHUNK_BYTES)
    });
}

fn sum(bytes: &[u8]) -> u64 {
    let words = bytes.chunks_exact(8).map(|w| u64::from_le_bytes(w.try_into().expect("eight")));
    words.fold(0, u64::wrapping_add)
}

fn mapped(at: usize) -> &'static [u8] {
    &PACK.1[at..at + CHUNK_BYTES]
}

fn read(at: usize) -> Vec<u8> {
    let mut bytes = vec![0; CHUNK_BYTES];
    PACK.0.read_exact_at(&mut bytes, at as u64).expect("readable");
    bytes
}

#[divan::bench]
fn map(bencher: Bencher) {
    bench(bencher, |at| sum(mapped(at)));
}

#[divan::bench]
fn map_and_check(bencher: Bencher) {
    bench(bencher, |at| sum(mapped(at)) ^ u64::from(black_box(blake3::hash(mapped(at))).as_bytes()[0]));
}

#[divan::bench]
fn positioned_read(bencher: Bencher) {
    bench(bencher, |at| sum(&read(at)));
}

#[divan::bench]
fn positioned_read_and_check(bencher: Bencher) {
    bench(bencher, |at| {
        let bytes = read(at);
        sum(&bytes) ^ u64::from(black_box(blake3::hash(&bytes)).as_bytes()[0])
    });
}
