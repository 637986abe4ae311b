//! A second visit: what was received once comes from the disk, sound or not at all.

#[path = "../../client/src/cache/fixture.rs"]
mod fixture;
#[path = "streaming/host.rs"]
#[allow(dead_code, reason = "shared with other tests")]
mod host;

use fixture::{FIRST_CELL, LDI, STEP_M, street};
use host::{Host, Memory, PATIENCE, PICTURE, folder};
use ldi_client::{
    resident::Resident,
    stream::{ConnectConfig, Connection, DiskCache},
};
use ldi_protocol::Pose;
use ldi_server::serve::{SelectViews, planner::Views};
use std::{path::Path, sync::Arc, time::Duration};

fn pose(z: f64, yaw_deg: f64) -> Pose {
    Pose { position: glam::DVec3::new(0.0, 0.0, z), yaw_deg, pitch_deg: 0.0 }
}

/// Three places and directions that between them need everything of the street.
const STOPS: [(f64, f64); 3] = [(0.0, 0.0), (-1.5, 90.0), (-2.5, 180.0)];

/// Walks by all stops. Returns the chunks that they needed.
fn walk(connection: &Connection) -> Vec<u32> {
    let camera = PICTURE.camera(&connection.index().settings);
    let views = SelectViews::new(connection.index().clone(), &camera);
    let mut all = Vec::new();
    for (z, yaw) in STOPS {
        let here = pose(z * STEP_M, yaw);
        let needed = views.needed(&here);
        connection.update_view(&here, &needed);
        let chunks: Vec<u32> = needed.all().collect();
        connection.wait_until_complete(&chunks, PATIENCE).expect("everything comes");
        all.extend(chunks);
    }
    all.sort_unstable();
    all.dedup();
    all
}

fn visit(host: &Host, disk: &Path) -> Connection {
    let disk = Some(Arc::new(DiskCache::open(disk, 1 << 30).expect("a folder")));
    let connection = Connection::connect(ConnectConfig { disk, ..host.config() }).expect("a connection");
    settle();
    connection
}

/// What a client holds is told on a stream, where it is in a datagram, which may overtake it: then
/// a few chunks come that it has.
fn settle() {
    std::thread::sleep(Duration::from_millis(300));
}

/// Waits until so many chunks lie on the disk: they get there a moment after they are at hand.
fn wait_for_files(disk: &Path, chunks: &[u32], connection: &Connection) {
    let looks = DiskCache::open(disk, 1 << 30).expect("a folder");
    let entry = |c: &u32| connection.index().chunks[*c as usize];
    let there = || chunks.iter().map(entry).all(|e| looks.has(&e.hash, e.stored_bytes));
    for _ in 0..1000 {
        if there() {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("not all chunks are kept");
}

#[test]
fn a_second_visit_streams_next_to_nothing_and_shows_the_same() {
    let host = Host::start("disk-second", Memory::new(street(8, 256)));
    let disk = folder("disk-second-visit").join("cache");
    let first = visit(&host, &disk);
    let needed = walk(&first);
    let before = first.stats();
    assert!(before.chunk_bytes > 100_000 && before.disk_chunks == 0, "{before:?}");
    wait_for_files(&disk, &needed, &first);
    let image = first.cache().ldi(0).expect("an image");
    drop(first);

    let second = visit(&host, &disk);
    assert_eq!(walk(&second), needed);
    let after = second.stats();
    assert_eq!((after.chunks, after.disk_chunks as usize), (0, needed.len()), "{after:?}");
    assert!(after.bytes_total < 20_000, "handshake, poses and their acknowledgements: {after:?}");
    assert_eq!(after.wasted_bytes, 0, "{after:?}");
    assert_eq!(second.cache().ldi(0).expect("an image").layers, image.layers);
    second.cache().check().expect("sound accounts");
}

/// Without waiting until the server knows what lies here: with `early` it waits itself.
#[test]
fn a_second_visit_that_begins_at_once_is_sent_nothing() {
    let host = Host::start("disk-early", Memory::new(street(8, 64).with_tree()));
    let disk = folder("disk-early-cache").join("cache");
    let visit = || {
        let disk = Some(Arc::new(DiskCache::open(&disk, 1 << 30).expect("a folder")));
        let config = ConnectConfig { disk, early: true, ..host.config() };
        let connection = Connection::connect(config).expect("a connection");
        while !connection.index().is_whole() {
            std::thread::sleep(Duration::from_millis(1));
        }
        connection
    };
    let first = visit();
    let needed = walk(&first);
    wait_for_files(&disk, &needed, &first);
    drop(first);
    for _ in 0..5 {
        let again = visit();
        assert_eq!(walk(&again), needed);
        let stats = again.stats();
        assert_eq!((stats.chunks, stats.duplicates), (0, 0), "{stats:?}");
        assert!(stats.bytes_total < 20_000, "{stats:?}");
    }
}

#[test]
fn a_damaged_file_is_fetched_anew() {
    let host = Host::start("disk-damaged", Memory::new(street(6, 64)));
    let disk = folder("disk-damaged-cache").join("cache");
    let first = visit(&host, &disk);
    let needed = walk(&first);
    wait_for_files(&disk, &needed, &first);
    let path = |chunk: u32| {
        let name = first.index().chunks[chunk as usize].hash.to_string();
        disk.join("chunks").join(&name[..2]).join(name)
    };
    // One of the right length with a wrong byte, and one that is gone after the client has looked
    // what is there.
    let (wrong, gone) = (path(LDI[0]), path(FIRST_CELL));
    let mut bytes = std::fs::read(&wrong).expect("a file");
    bytes[20] ^= 4;
    std::fs::write(&wrong, bytes).expect("a file");
    drop(first);
    let second = visit(&host, &disk);
    std::fs::remove_file(gone).expect("a file");
    assert_eq!(walk(&second), needed);
    let stats = second.stats();
    assert_eq!((stats.chunks, stats.disk_chunks as usize), (2, needed.len() - 2), "{stats:?}");
    // And kept again.
    wait_for_files(&disk, &needed, &second);
}

#[test]
fn two_clients_share_a_folder_at_once() {
    let host = Host::start("disk-two", Memory::new(street(8, 64)));
    let disk = folder("disk-two-cache").join("cache");
    let needs: Vec<Vec<u32>> = std::thread::scope(|scope| {
        let walks: Vec<_> = (0..2).map(|_| scope.spawn(|| walk(&visit(&host, &disk)))).collect();
        walks.into_iter().map(|w| w.join().expect("a walk")).collect()
    });
    assert_eq!(needs[0], needs[1]);
    let third = visit(&host, &disk);
    wait_for_files(&disk, &needs[0], &third);
    let again = visit(&host, &disk);
    walk(&again);
    assert_eq!(again.stats().chunks, 0);
}

#[test]
fn an_eviction_from_memory_is_read_from_disk_again() {
    let street = street(8, 16);
    let size = |c: u32| u64::from(street.index.chunks[c as usize].decoded_bytes);
    let cache_bytes = (0..FIRST_CELL + 8).map(size).sum::<u64>() - 1;
    let host = Host::start("disk-evict", Memory::new(street));
    let disk = folder("disk-evict-cache").join("cache");
    let filled = visit(&host, &disk);
    wait_for_files(&disk, &walk(&filled), &filled);
    drop(filled);
    let disk = Some(Arc::new(DiskCache::open(&disk, 1 << 30).expect("a folder")));
    let small = Connection::connect(ConnectConfig { disk, cache_bytes, ..host.config() }).expect("a connection");
    settle();
    for _ in 0..3 {
        walk(&small);
        small.cache().check().expect("sound accounts");
    }
    assert_eq!(small.stats().chunks, 0, "{:?}", small.stats());
}
