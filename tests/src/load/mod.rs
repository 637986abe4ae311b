//! Load: many simulated walkers on one server, each with a QUIC connection, a cache and a
//! planner's model of it, as the real ones have.
//!
//! In: a server, a path file or a seed, a number of walkers. Out: a report after the contract, and
//! a page with plots.
//!
//! - [`track`]: where walkers go; pure. [`walker`]: one of them, a task.
//! - [`hostile`]: who comes to harm the server; [`stranger`]: how they get in.
//! - [`process`]: processor time and memory of the server. [`raw`]: a bare QUIC transfer in the
//!   same run to compare with.
//! - [`soak`]: how fast the server's memory, descriptors and threads grow.
//! - [`report`], [`page`]: what is left.
//! - [`rehearsal`]: a walk over a link in virtual time, to compare ways to send ahead;
//!   [`hindsight`]: what it is compared with; [`eviction`]: what leaves a full cache.

pub mod eviction;
pub mod hindsight;
pub mod hostile;
pub mod page;
pub mod process;
pub mod raw;
pub mod rehearsal;
pub mod report;
pub mod soak;
pub mod stranger;
pub mod track;
pub mod walker;

use hostile::{Manner, Siege, Toll};
use ldi_client::stream::{ConnectConfig, ConnectError, Connection, DecodePool, resolve};
use ldi_protocol::{index::Index, wire::Picture};
use process::Process;
use raw::Raw;
use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};
use tokio::task::JoinSet;
use track::{Route, Scenario};
use walker::{Course, Latencies, Outcome};

/// A load test cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// Nobody comes in.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// No place to walk.
    #[error("the dataset has no walk volume to walk in at random: give --path PATH.json")]
    NoVolume,
    /// No such process.
    #[error(
        "--server-pid {0}: no such process on this machine; give the number of `ldi-server serve`, or leave it out"
    )]
    NoProcess(u32),
    /// The transfer to compare with failed.
    #[error("the bare QUIC transfer failed: {0}")]
    Raw(String),
    /// No threads.
    #[error("cannot start: {0}")]
    Local(#[from] std::io::Error),
}

impl LoadError {
    /// The exit code: 2 for wrong usage, 1 when a retry may help, 42 when not.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Connect(e) => e.exit_code(),
            Self::NoVolume | Self::NoProcess(_) => 2,
            Self::Raw(_) | Self::Local(_) => 1,
        }
    }
}

/// What to do.
#[derive(Debug)]
pub struct Load {
    /// Server, fingerprint, token, link, cache; the seed of the link is counted up from walker to
    /// walker.
    pub config: ConnectConfig,
    /// How many.
    pub walkers: usize,
    /// How long, after the last has come in.
    pub seconds: f64,
    /// Time over which they come in.
    pub ramp_s: f64,
    /// Connections that want no good, beside the walkers and from the begin on.
    pub hostile: usize,
    /// How those behave, one after another.
    pub manners: Vec<Manner>,
    /// Where they go.
    pub route: Route,
    /// How.
    pub scenario: Scenario,
    /// The server's process, when it runs on this machine.
    pub server: Option<Process>,
    /// Whether to measure a bare transfer.
    pub raw: bool,
}

/// The server's process at one second.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ServerSecond {
    /// Seconds since the run began.
    pub at_s: f64,
    /// Processor seconds so far, since the run began.
    pub cpu_s: f64,
    /// Resident bytes.
    pub rss_bytes: u64,
    /// Resident bytes without mapped files, as the dataset is.
    pub anonymous_bytes: u64,
    /// Open file descriptors; None for a process of another user.
    pub descriptors: Option<u64>,
    /// Threads.
    pub threads: u64,
}

/// What was seen.
#[derive(Debug)]
pub struct Seen {
    /// One per walker.
    pub walkers: Vec<Outcome>,
    /// Of all.
    pub latencies: Latencies,
    /// Second by second, the last at the end; empty without --server-pid.
    pub server: Vec<ServerSecond>,
    /// Before the first walker.
    pub server_before: ServerSecond,
    /// What became of the hostile connections, by manner.
    pub hostile: Vec<(Manner, Toll)>,
    /// This program's own processor seconds.
    pub load_cpu_s: Option<f64>,
    /// The bare transfer, or why there is none.
    pub raw: Result<Raw, String>,
}

/// Runs a load test. Progress, as seconds of the run and walkers inside, goes to `progress` once a
/// second.
///
/// # Errors
/// When not even a first connection stands. What befalls single walkers later is in their outcomes.
pub async fn run(load: &Load, mut progress: impl FnMut(f64, usize)) -> Result<Seen, LoadError> {
    if let Some(p) = load.server
        && p.cpu_s().is_none()
    {
        return Err(LoadError::NoProcess(p.0));
    }
    // Says what is wrong before everybody comes, and brings the index that all share.
    let probe = Connection::open(ConnectConfig { link: None, name: "ldi-load probe".into(), ..load.config.clone() });
    let probe = probe.await?;
    let index = probe.index().clone();
    drop(probe);
    let raw = match load.raw {
        true => raw::measure().await.map_err(|e| e.to_string()),
        false => Err("left out by --no-raw".into()),
    };
    let tracks =
        track::tracks(&load.route, load.scenario, load.walkers, load.seconds + load.ramp_s, index.volume.as_ref())?;
    let mut far = vec![false; index.chunks.len()];
    for chunk in index.images.iter().flat_map(|i| &i.chunks) {
        far[*chunk as usize] = true;
    }
    let start = Instant::now();
    let course = Arc::new(Course {
        camera: load.config.picture.camera(&index.settings),
        far,
        latencies: Mutex::default(),
        start,
        end: start + Duration::from_secs_f64(load.ramp_s + load.seconds),
        index: index.clone(),
    });
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let pool = Arc::new(DecodePool::new(threads)?);
    // None without a process, or when it has ended.
    let server_now = || {
        let p = load.server?;
        let cpu_s = p.cpu_s()?;
        let (rss_bytes, anonymous_bytes) = (p.rss_bytes()?, p.anonymous_bytes()?);
        let (descriptors, threads) = (p.descriptors(), p.threads()?);
        Some(ServerSecond {
            at_s: start.elapsed().as_secs_f64(),
            cpu_s,
            rss_bytes,
            anonymous_bytes,
            descriptors,
            threads,
        })
    };
    let server_before = server_now().unwrap_or_default();
    let own_cpu_before = Process::this().cpu_s();
    let mut tasks = JoinSet::new();
    let mut enemies = besiege(load, &index, course.end)?;
    for (i, track) in tracks.into_iter().enumerate() {
        let mut config = ConnectConfig {
            name: format!("ldi-load {}", i + 1),
            index: Some(index.clone()),
            decode_pool: Some(pool.clone()),
            ..load.config.clone()
        };
        if let Some(link) = &mut config.link {
            link.seed = link.seed.wrapping_add(i as u64);
        }
        let at = start + Duration::from_secs_f64(load.ramp_s * i as f64 / load.walkers as f64);
        let course = course.clone();
        tasks.spawn(async move {
            tokio::time::sleep_until(at.into()).await;
            walker::walk(course, config, track).await
        });
    }
    let mut server = Vec::new();
    let look = |server: &mut Vec<ServerSecond>| {
        if let Some(now) = server_now() {
            server.push(ServerSecond { cpu_s: now.cpu_s - server_before.cpu_s, ..now });
        }
    };
    let mut second = tokio::time::interval_at((start + Duration::from_secs(1)).into(), Duration::from_secs(1));
    let mut walkers = Vec::new();
    let mut hostile: Vec<(Manner, Toll)> = load.manners.iter().map(|m| (*m, Toll::default())).collect();
    while !tasks.is_empty() || !enemies.is_empty() {
        tokio::select! {
            _ = second.tick() => {
                look(&mut server);
                progress(start.elapsed().as_secs_f64(), tasks.len());
            }
            Some(done) = tasks.join_next() => {
                // A walker does not panic; one that did would be missing from the report.
                walkers.extend(done.ok());
            }
            Some(done) = enemies.join_next() => {
                if let Ok((manner, toll)) = done {
                    hostile.iter_mut().filter(|(m, _)| *m == manner).for_each(|(_, t)| *t += toll);
                }
            }
        }
    }
    look(&mut server);
    let load_cpu_s = own_cpu_before.and_then(|before| Some(Process::this().cpu_s()? - before));
    if !walkers.iter().any(|w| w.refused.is_none())
        && let Some(e) = walkers.iter_mut().find_map(|w| w.refused.take())
    {
        return Err(e.into());
    }
    let latencies = std::mem::take(&mut *course.latencies.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
    Ok(Seen { walkers, latencies, server, server_before, hostile, load_cpu_s, raw })
}

/// Sends the hostile connections, all from one socket.
fn besiege(load: &Load, index: &Index, end: Instant) -> Result<JoinSet<(Manner, Toll)>, LoadError> {
    let mut tasks = JoinSet::new();
    if load.hostile == 0 {
        return Ok(tasks);
    }
    let server = resolve(&load.config.server)?[0];
    let endpoint = stranger::endpoint(hostile::address(server))?;
    let mut chunks: Vec<u32> = (0..index.chunks.len() as u32).collect();
    chunks.sort_by_key(|c| std::cmp::Reverse(index.chunks[*c as usize].stored_bytes));
    let (token, picture) = (load.config.token.clone(), load.config.picture);
    let siege = Arc::new(Siege { server, token, picture, chunks, end });
    let seconds = load.seconds + load.ramp_s;
    let tracks = track::tracks(&load.route, Scenario::Teleport, load.hostile, seconds, index.volume.as_ref())?;
    for (number, (track, manner)) in tracks.into_iter().zip(load.manners.iter().cycle().copied()).enumerate() {
        let (siege, endpoint) = (siege.clone(), endpoint.clone());
        tasks.spawn(async move { (manner, siege.send(endpoint, manner, number, track).await) });
    }
    Ok(tasks)
}

/// The picture that walkers say they draw.
pub const PICTURE: Picture = Picture { width: 1280, height: 720, fov_deg: None };

/// Whether so many walkers can hold their decoded chunks in this machine's memory, half of it at
/// most.
pub fn decoding_fits(walkers: usize, cache_bytes: u64) -> bool {
    process::available_bytes().is_none_or(|available| (walkers as u64).saturating_mul(cache_bytes) <= available / 2)
}
