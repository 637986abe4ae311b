//! Bad links by schedule: loss, reordering, duplication, black-outs, each from a seed. Every chunk
//! arrives intact or the connection ends with an error that says why, and then another one brings
//! the rest; nothing hangs.
//!
//! Server, client and link run in one thread in virtual time: waiting costs nothing, so a
//! black-out of a minute takes milliseconds. `LDI_SCHEDULES=1000` runs as many schedules; a few
//! run always.

#[path = "../../client/src/cache/fixture.rs"]
#[allow(dead_code, reason = "shared with other tests")]
mod fixture;
#[path = "streaming/host.rs"]
#[allow(dead_code, reason = "shared with other tests")]
mod host;

use fixture::{STEP_M, street};
use host::{Memory, PICTURE, folder, named};
use ldi_client::stream::{ConnectConfig, ConnectError, Connection, LinkSpec, ResumeState};
use ldi_protocol::Pose;
use ldi_server::serve::{SelectViews, ServeConfig, Server, planner::Views};
use std::{collections::BTreeMap, net::SocketAddr, time::Duration};
use tokio::time::{Instant, sleep};

/// Virtual time for one schedule: several times what the worst of them needs.
const LIMIT: Duration = Duration::from_secs(600);

/// A schedule from a seed: every kind of trouble, alone and together, mild and grave.
fn schedule(seed: u64) -> LinkSpec {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mut draw = |below: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    };
    let ms = Duration::from_millis;
    LinkSpec {
        rate_bit_s: [None, Some(1e6), Some(5e6), Some(50e6)][draw(4) as usize],
        delay: ms(draw(120)),
        jitter: ms([0, 3, 40][draw(3) as usize]),
        loss: [0.0, 0.02, 0.1, 0.25][draw(4) as usize],
        duplicates: [0.0, 0.01, 0.3][draw(3) as usize],
        // Some end the connection: QUIC gives up after 30 s of silence.
        blackout: [None, Some(300), Some(4_000), Some(45_000)][draw(4) as usize].map(|l| (ms(draw(3_000)), ms(l))),
        queue: ms([20, 100, 400][draw(3) as usize]),
        seed,
    }
}

/// How a schedule ended.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
struct Ended {
    connections: u32,
    lost: u32,
    refused: u32,
    /// Chunks received over all connections; each only once.
    chunks: u64,
}

/// Walks over a link until all is there, connecting again as often as it takes.
async fn walk(config: &ConnectConfig, link: LinkSpec) -> Result<Ended, String> {
    let mut ended = Ended::default();
    let mut kept: Option<ResumeState> = None;
    let begin = Instant::now();
    let mut trouble = BTreeMap::<String, u32>::new();
    loop {
        if begin.elapsed() > LIMIT {
            return Err(format!("hangs: {ended:?}, {trouble:?}"));
        }
        // A link of its own for each: what is dark is dark for all, so a later one begins later.
        let blackout = link.blackout.and_then(|(start, length)| {
            let passed = begin.elapsed();
            let left = (start + length).checked_sub(passed)?;
            Some((start.saturating_sub(passed), left.min(length)))
        });
        let link = LinkSpec { blackout, seed: link.seed.wrapping_add(u64::from(ended.connections) << 32), ..link };
        let config = ConnectConfig { resume: kept.clone(), link: Some(link), ..config.clone() };
        ended.connections += 1;
        let connection = match Connection::open(config).await {
            Ok(c) => c,
            // Typed, and worth another try.
            Err(e @ (ConnectError::Unreachable { .. } | ConnectError::Lost(_))) => {
                *trouble.entry(e.to_string()).or_default() += 1;
                ended.refused += 1;
                continue;
            }
            Err(e) => return Err(format!("a bad link is no reason for {e:?}")),
        };
        let cache = connection.cache().clone();
        kept = Some(connection.kept());
        while !connection.index().is_whole() && connection.lost().is_none() {
            if begin.elapsed() > LIMIT {
                return Err(format!("hangs before the index is whole: {ended:?}, {trouble:?}"));
            }
            sleep(Duration::from_millis(16)).await;
        }
        let views = SelectViews::new(connection.index().clone(), &PICTURE.camera(&connection.index().settings));
        let mut whole = true;
        'stops: for (z, yaw_deg) in [(0.0, 0.0), (-1.5, 90.0), (-2.5, 180.0)] {
            let here = Pose { position: glam::DVec3::new(0.0, 0.0, z * STEP_M), yaw_deg, pitch_deg: 0.0 };
            let needed = views.needed(&here);
            whole &= connection.index().is_whole();
            loop {
                connection.update_view(&here, &needed);
                if whole && cache.missing(needed.all()).is_empty() {
                    break;
                }
                if let Some(reason) = connection.lost() {
                    *trouble.entry(reason).or_default() += 1;
                    ended.lost += 1;
                    whole = false;
                    break 'stops;
                }
                if begin.elapsed() > LIMIT {
                    return Err(format!("hangs amid a connection: {ended:?}, {trouble:?}"));
                }
                sleep(Duration::from_millis(16)).await;
            }
        }
        let stats = connection.stats();
        ended.chunks += stats.chunks;
        if stats.damaged > 0 {
            return Err(format!("damaged chunks: {stats:?}"));
        }
        drop(connection);
        if whole {
            cache.check()?;
            let held = cache.held().len() as u64;
            // What was held when a connection was lost did not come again, but for what was just
            // being decoded then.
            if ended.chunks < held || ended.chunks > held + u64::from(ended.lost) {
                return Err(format!("{} chunks came, {held} are held: {ended:?}", ended.chunks));
            }
            return Ok(ended);
        }
    }
}

#[test]
fn whatever_the_link_does_every_chunk_arrives_or_an_error_says_why() {
    let count: u64 = std::env::var("LDI_SCHEDULES").ok().and_then(|n| n.parse().ok()).unwrap_or(40);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().start_paused(true).build().unwrap();
    let folder = folder("schedules");
    let mut totals = Ended::default();
    runtime.block_on(async {
        let any = SocketAddr::from(([127, 0, 0, 1], 0));
        let street = street(4, 64).with_tree();
        let config = ServeConfig {
            listen: any,
            http: any.into(),
            identity: Some(folder.join("identity")),
            ..Default::default()
        };
        let server = Server::start(named(Memory::new(street)), &config).await.unwrap();
        let mut connect = ConnectConfig::new(server.quic().to_string(), PICTURE);
        connect.fingerprint = Some(server.fingerprint().parse().unwrap());
        connect.decode_threads = 1;
        for seed in 0..count {
            let link = schedule(seed);
            // Half of them begin before the whole manifest is there.
            let connect = ConnectConfig { early: seed % 2 == 1, ..connect.clone() };
            match walk(&connect, link).await {
                Ok(e) => {
                    totals.connections += e.connections;
                    totals.lost += e.lost;
                    totals.refused += e.refused;
                    totals.chunks += e.chunks;
                }
                Err(e) => panic!("seed {seed}, {link}: {e}"),
            }
        }
        server.shutdown().await;
    });
    let _ = std::fs::remove_dir_all(folder);
    eprintln!("{count} schedules: {totals:?}");
    // The schedules are not all harmless.
    assert!(totals.lost > 0 && totals.refused > 0, "{totals:?}");
}
