//! Seeded conversations that break the protocol, on both ends: the peer ends them or goes on, holds
//! bounded memory, says why in one line, and serves or walks beside them.

#[path = "hostile/fake_server.rs"]
mod fake_server;
#[path = "../../client/src/cache/fixture.rs"]
#[allow(dead_code, reason = "shared with other tests, which use the rest")]
mod fixture;
#[path = "streaming/host.rs"]
#[allow(dead_code, reason = "shared with other tests, which use the rest")]
mod host;

use fake_server::{FakeServer, Script, Step, page_stream};
use fixture::{FIRST_CELL, street};
use host::{Host, Memory};
use ldi_client::stream::{ConnectConfig, ConnectError, Connection};
use ldi_protocol::wire::{self, ClientMessage, PoseDatagram, Request, StreamHeader};
use ldi_tests::{
    allocation::{Counting, process_peak_of},
    fuzz::{
        Target,
        mutate::{Random, mutated},
    },
    load::stranger,
};
use quinn::VarInt;
use std::{
    collections::BTreeSet,
    net::{IpAddr, SocketAddr},
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Held by each test here, as memory is counted for the whole process.
static ALONE: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Most bytes that one end takes over any conversation with a small dataset: QUIC's windows, the
/// bytes of streams that are under way, a runtime.
const MOST_BYTES: usize = 96 << 20;

/// What an error says: one line without control characters, short enough to read.
fn line_of(e: &ConnectError) -> String {
    let line = e.to_string();
    assert!(!line.contains(char::is_control) && line.len() < 2_000, "{line:?}");
    line
}

/// The client's side of a conversation: connects, waits for chunks, asks for one. Returns what went
/// wrong.
fn visit(config: ConnectConfig) -> Result<(), ConnectError> {
    let connection = Connection::connect(config)?;
    let chunks: Vec<u32> = (0..connection.index().chunks.len() as u32).collect();
    connection.request(&chunks);
    let _ = connection.cache().wait(&chunks, Duration::from_millis(100));
    connection.fetch(Request::Number(FIRST_CELL)).map(drop)
}

#[test]
fn a_client_survives_any_server() {
    let _alone = alone();
    let server = FakeServer::start();
    let (mut fine, mut lines) = (0, BTreeSet::new());
    for seed in 0..80 {
        let script = Script::honest(street(3, 16).with_tree()).broken(&mut Random::new(seed));
        server.plays(script);
        let (result, peak) = process_peak_of(|| visit(server.config()));
        assert!(peak < MOST_BYTES, "seed {seed}: {peak} bytes");
        match result {
            Ok(()) => fine += 1,
            Err(e) => drop(lines.insert(line_of(&e))),
        }
    }
    // The scripts are neither harmless nor all broken in one way.
    assert!(fine > 0 && lines.len() >= 12, "{fine} fine, {lines:#?}");
    // And the client is as good as before.
    server.plays(Script::honest(street(3, 16).with_tree()));
    let patient = ConnectConfig { timeout: host::PATIENCE, ..server.config() };
    visit(patient).expect("an honest conversation");
}

/// Appends a LEB128 number.
fn put(out: &mut Vec<u8>, mut v: u64) {
    while v >= 128 {
        out.push(v as u8 | 128);
        v >>= 7;
    }
    out.push(v as u8);
}

/// A page of four cells whose lists hold more numbers than any dataset, in a few bytes.
fn forged_cells() -> Vec<u8> {
    let mut page = b"LDP".to_vec();
    page.extend([ldi_protocol::manifest::VERSION, 1, 0, 4]);
    let mut numbers = Vec::new();
    for _ in 0..4 {
        // Triangles, chunk, one run of bundles, no materials.
        [2, FIRST_CELL.into(), 1, 0, 40_000_000, 0].into_iter().for_each(|n| put(&mut numbers, n));
    }
    for section in [&[0; 96][..], &numbers] {
        put(&mut page, section.len() as u64);
        put(&mut page, section.len() as u64);
        page.extend(section);
    }
    page
}

#[test]
fn forged_manifests_are_refused_before_they_take_memory() {
    let _alone = alone();
    let server = FakeServer::start();
    // Pages that are announced with more bytes than all pages may have together.
    let mut script = Script::honest(street(3, 16).with_tree());
    script.forge(|entries| entries.iter_mut().for_each(|e| e.1 = 60 << 20));
    server.plays(script);
    let (result, peak) = process_peak_of(|| visit(server.config()));
    let line = line_of(&result.expect_err("too large"));
    assert!(line.contains("all pages together have at most 64 MiB") && peak < MOST_BYTES, "{line}: {peak} bytes");
    // Pages that decode to more than an index may hold.
    let mut script = Script::honest(street(4, 16).with_tree());
    let cells = forged_cells();
    let number = script.page_of_kind(1);
    script.forge(|entries| entries[number] = (blake3::hash(&cells).into(), cells.len() as u64));
    script.replace(page_stream(number as u32, &cells), |s| matches!(s, Step::Uni(b) if is_page(b, number as u32)));
    server.plays(script);
    let (result, peak) = process_peak_of(|| visit(server.config()));
    let line = line_of(&result.expect_err("too large"));
    assert!(line.contains("decode to at most 192 MiB"), "{line}");
    assert!(peak < 300 << 20, "{peak} bytes");
}

fn is_page(stream: &[u8], number: u32) -> bool {
    let head = stream.first_chunk().and_then(|h| StreamHeader::decode(h).ok());
    head.is_some_and(|h| h.number == number && h.kind == wire::StreamKind::Page)
}

/// A client that does a few seeded things that none does, and leaves some of them half done.
async fn misbehave(server: SocketAddr, seed: u64) -> bool {
    let mut random = Random::new(seed);
    let from = IpAddr::from([127, 0, 1, 1 + seed as u8]);
    let endpoint = stranger::endpoint(from).expect("an address of this machine");
    let Ok((connection, mut send, _recv)) = stranger::connect(&endpoint, server).await else { return false };
    let first = stranger::hello(wire::VERSION, None, host::PICTURE);
    if random.below(4) > 0 {
        let _ = send.write_all(&wire::encode(&first).expect("encodes")).await;
    }
    let seeds = |name| (Target::named(name).seeds)();
    let (messages, requests, poses) = (seeds("client_message"), seeds("request"), seeds("pose_datagram"));
    // Streams that nobody finishes.
    let mut open = Vec::new();
    for _ in 0..40 {
        match random.below(7) {
            0 => {
                let body = mutated(&messages, &mut random);
                let _ = send.write_all(&wire::frame(&body, 1 << 20).expect("short")).await;
            }
            1 => {
                let announced = *random.pick(&[0, 1, 65_536, 65_537, u32::MAX]);
                let _ = send.write_all(&announced.to_le_bytes()).await;
            }
            2 | 3 => {
                let opened = tokio::time::timeout(Duration::from_millis(50), connection.open_bi()).await;
                let Ok(Ok((mut ask, answer))) = opened else { continue };
                let body = mutated(&requests, &mut random);
                let _ = ask.write_all(&wire::frame(&body, 1 << 20).expect("short")).await;
                match random.below(3) {
                    0 => drop(ask.finish()),
                    1 => drop(ask.reset(VarInt::from_u32(77))),
                    _ => open.push((ask, answer)),
                }
            }
            4 => {
                let _ = connection.send_datagram(mutated(&poses, &mut random).into());
            }
            5 => {
                for sequence in 0..50 {
                    let pose = ldi_protocol::Pose { position: glam::DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 };
                    let datagram = PoseDatagram { sequence, sent_us: 0, pose };
                    let _ = connection.send_datagram(datagram.encode().to_vec().into());
                }
            }
            _ => {
                let chunks = (0..random.below(9_000) as u32).collect();
                let want = wire::encode(&ClientMessage::Want { chunks });
                let _ = send.write_all(&want.unwrap_or_default()).await;
            }
        }
    }
    if random.below(2) == 0 {
        connection.close(VarInt::from_u32(random.below(1000) as u32), b"\x1b[2J\nbye");
    }
    endpoint.wait_idle().await;
    true
}

#[test]
fn a_server_survives_any_client_and_serves_the_others() {
    let _alone = alone();
    let host = Host::start("conversations", Memory::new(street(4, 32)));
    let server = host.server().quic();
    let honest = Connection::connect(host.config()).expect("let in");
    let (came_in, peak) = process_peak_of(|| {
        let mut came_in = 0;
        for seeds in (0..48u64).collect::<Vec<_>>().chunks(6) {
            let visits: Vec<bool> = host.runtime.block_on(async {
                let mut tasks = tokio::task::JoinSet::new();
                seeds.iter().for_each(|seed| drop(tasks.spawn(misbehave(server, *seed))));
                // Those that the server has not ended by then are left to it.
                let mut done = Vec::new();
                while let Ok(Some(visit)) = tokio::time::timeout(Duration::from_millis(500), tasks.join_next()).await {
                    done.push(visit.expect("no panic"));
                }
                done
            });
            came_in += visits.iter().filter(|v| **v).count();
            // Who was there stays, and who comes is let in.
            honest.fetch(Request::Number(FIRST_CELL)).expect("served beside them");
            let newcomer = Connection::connect(host.config()).expect("let in beside them");
            newcomer.fetch(Request::Number(FIRST_CELL)).expect("and served");
        }
        came_in
    });
    assert!(came_in >= 20, "{came_in} conversations");
    assert!(peak < 2 * MOST_BYTES, "{peak} bytes");
    assert!(host.get("/healthz").0.starts_with("HTTP/1.1 200"));
}
