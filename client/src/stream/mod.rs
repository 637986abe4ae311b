//! The client's end of the wire: connects, says where the eye is, takes chunks in.
//!
//! In: poses and needs from the render thread. Out: decoded objects in the [`Cache`], statistics. The render thread never
//! waits for the network unless it asks to ([`Connection::wait_until_complete`]).
//!
//! One named thread runs a small async runtime with all of QUIC; a few more verify hashes and decode, what the view waits for first. Between
//! them bounded queues: when decoding falls behind, reading stops, and QUIC's windows stop the server.
//!
//! Between visits chunks may lie on disk ([`DiskCache`]); they count as held for the server, and come from there.
//!
//! A damaged chunk is asked for again [`MAX_RETRIES`] times, then given up; the walk goes on without it.

mod chunk_stream;
mod decode_backlog;
mod decoder;
mod disk;
mod disk_loader;
mod error;
mod handshake;
mod index_pages;
mod known_hosts;
mod other_walkers;
mod packet_queue;
mod pose_updates;
mod progress;
mod session;
mod simulated_link;
mod simulated_socket;
mod stats;
mod transport;
mod trust;

pub use decoder::DecodePool;
pub use disk::{DEFAULT_DISK_BYTES, DiskCache, DiskError};
pub use error::ConnectError;
pub use known_hosts::{Acquaintance, KnownHosts, KnownHostsError};
pub use other_walkers::OtherWalkers;
pub use packet_queue::PacketQueue;
pub use pose_updates::PoseClock;
pub use progress::{ConnectProgress, Phase};
pub use session::MAX_RETRIES;
pub use simulated_link::{Direction, Fate, HEADER_BYTES, LinkCounts, LinkError, LinkSpec, SimulatedLink};
pub use stats::{Arrival, Stats};
pub use transport::resolve;
pub use trust::Fingerprint;

use crate::cache::{Cache, Incomplete};
use disk_loader::DiskLoader;
use ldi_protocol::{
    Pose,
    index::{ChunkHash, Index},
    need::Needed,
    select::Show,
    wire::{Picture, Request},
};
use pose_updates::PoseUpdates;
use session::{Command, Ready, ReadyCallback};
use stats::Collector;
use std::{
    sync::Arc,
    thread::JoinHandle,
    time::{Duration, Instant},
};
use tokio::sync::{mpsc, oneshot};

/// Without progress for this long, what is missing is asked for by number. Shorter: chunks that are only slow come twice.
const ASK_AFTER: Duration = Duration::from_millis(300);

/// Whom to connect to, and how.
#[derive(Debug, Clone)]
pub struct ConnectConfig {
    /// HOST or HOST:PORT.
    pub server: String,
    /// The certificate to expect. None ends in [`ConnectError::UnknownServer`], which names the one found.
    pub fingerprint: Option<Fingerprint>,
    /// The certificate that may replace the expected one.
    pub next_fingerprint: Option<Fingerprint>,
    /// File of known servers that learns which certificate will replace the server's.
    pub known_hosts: Option<Arc<KnownHosts>>,
    /// Shared secret, when the server asks for one.
    pub token: Option<String>,
    /// The picture that will be drawn.
    pub picture: Picture,
    /// What will be shown: decides what the server sends.
    pub show: Show,
    /// Cap of the cache, decoded bytes.
    pub cache_bytes: u64,
    /// How far around the eye the server may push what no view has needed yet, metres; 0 for nothing. Larger: fewer gaps when
    /// the walk turns or hurries; more bytes that no frame uses.
    pub prefetch_m: f64,
    /// Shown on the server's page.
    pub name: String,
    /// What an earlier connection left: what it holds of the same dataset is not sent again.
    pub resume: Option<ResumeState>,
    /// Where chunks and manifests are kept between visits: what lies there is not sent again.
    pub disk: Option<Arc<DiskCache>>,
    /// Begin with what of the index is enough for a first picture, where there is an LDI tree; the rest follows ([`Index::is_whole`]).
    pub early: bool,
    /// The index of an earlier connection, to be shared instead of holding an equal one again.
    pub index: Option<Arc<Index>>,
    /// Threads that verify and decode, unless there is a pool.
    pub decode_threads: usize,
    /// Threads that several connections share.
    pub decode_pool: Option<Arc<DecodePool>>,
    /// False: chunks are verified and counted as held, but not decoded, so that nothing can be drawn. For load tests.
    pub decoding: bool,
    /// Is told of every chunk when the cache holds it.
    pub arrivals: Option<mpsc::UnboundedSender<(u32, Instant)>>,
    /// Behave as if this link lay between client and server.
    pub link: Option<LinkSpec>,
    /// Time for connecting, and for each step of fetching the manifest.
    pub timeout: Duration,
    /// Told how far connecting is, for whoever watches.
    pub progress: Arc<ConnectProgress>,
    /// Where other walkers are, for whoever shows it.
    pub others: Arc<OtherWalkers>,
}

impl ConnectConfig {
    /// The defaults for a server and a picture: 1 GiB of cache, 10 m of prefetch.
    pub fn new(server: impl Into<String>, picture: Picture) -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            server: server.into(),
            fingerprint: None,
            next_fingerprint: None,
            known_hosts: None,
            token: None,
            picture,
            show: Show::default(),
            cache_bytes: 1 << 30,
            prefetch_m: 10.0,
            name: format!("ldi-client {}", env!("CARGO_PKG_VERSION")),
            resume: None,
            disk: None,
            // Half: the other half draws.
            decode_threads: (threads / 2).clamp(1, 4),
            early: false,
            index: None,
            decode_pool: None,
            decoding: true,
            arrivals: None,
            link: None,
            timeout: Duration::from_secs(10),
            progress: Arc::default(),
            others: Arc::default(),
        }
    }
}

/// What a connection leaves for the next one.
#[derive(Debug, Clone)]
pub struct ResumeState {
    /// Name of the dataset.
    pub dataset: ChunkHash,
    /// What was received of it.
    pub cache: Arc<Cache>,
}

/// A connection. Dropping it says goodbye, and waits for its threads if it has any.
#[derive(Debug)]
pub struct Connection {
    dataset: ChunkHash,
    cache: Arc<Cache>,
    stats: Arc<Collector>,
    poses: Arc<PoseUpdates>,
    commands: mpsc::UnboundedSender<Command>,
    loader: Option<DiskLoader>,
    thread: Option<JoinHandle<()>>,
}

impl Connection {
    /// Connects with threads of its own, and returns when the whole manifest is there, or as much of it as a first picture takes ([`ConnectConfig::early`]).
    ///
    /// # Errors
    /// See [`ConnectError`].
    pub fn connect(config: ConnectConfig) -> Result<Self, ConnectError> {
        let stats = Arc::new(Collector::new());
        let poses = Arc::new(PoseUpdates::new());
        let poses_seen = poses.clone();
        let (commands, commands_seen) = mpsc::unbounded_channel();
        let (ready, connected) = std::sync::mpsc::channel();
        let collector = stats.clone();
        let say: ReadyCallback = Box::new(move |r| drop(ready.send(r)));
        let thread = std::thread::Builder::new()
            .name("ldi-stream".into())
            .spawn(move || session::run(config, collector, poses_seen, commands_seen, say))
            .map_err(|e| ConnectError::Local(e.to_string()))?;
        let ended = || Err(ConnectError::Local("the streaming thread ended".into()));
        let Ready { dataset, cache, loader } = connected.recv().unwrap_or_else(|_| ended())?;
        Ok(Self { dataset, cache, stats, poses, commands, loader, thread: Some(thread) })
    }

    /// Connects on the runtime that this is called in, as a task: many connections in one process. Dropping it does not wait.
    ///
    /// # Errors
    /// See [`ConnectError`].
    pub async fn open(config: ConnectConfig) -> Result<Self, ConnectError> {
        let stats = Arc::new(Collector::new());
        let poses = Arc::new(PoseUpdates::new());
        let poses_seen = poses.clone();
        let (commands, commands_seen) = mpsc::unbounded_channel();
        let (ready, connected) = oneshot::channel();
        let say: ReadyCallback = Box::new(move |r| drop(ready.send(r)));
        tokio::spawn(session::stream(config, stats.clone(), poses_seen, commands_seen, say));
        let ended = |_| Err(ConnectError::Local("the streaming task ended".into()));
        let Ready { dataset, cache, loader } = connected.await.unwrap_or_else(ended)?;
        Ok(Self { dataset, cache, stats, poses, commands, loader, thread: None })
    }

    /// Why nothing will arrive any more; None while the connection stands.
    pub fn lost(&self) -> Option<String> {
        self.cache.disconnected()
    }

    /// The dataset's index, as far as it is here.
    pub fn index(&self) -> &Arc<Index> {
        self.cache.index()
    }
    /// The dataset's name.
    pub fn dataset(&self) -> ChunkHash {
        self.dataset
    }
    /// For the next connection to the same server.
    pub fn kept(&self) -> ResumeState {
        ResumeState { dataset: self.dataset, cache: self.cache.clone() }
    }
    /// Decoded objects; implements [`crate::resident::Resident`].
    pub fn cache(&self) -> &Arc<Cache> {
        &self.cache
    }

    /// The eye is here now. The latest wins; a lost one is repeated.
    pub fn send_pose(&self, pose: &Pose) {
        self.poses.update_view(pose);
    }

    /// A new frame: pins what it needs, has it read where it lies on disk, and tells the server where the eye is.
    pub fn update_view(&self, pose: &Pose, needed: &Needed) {
        self.cache.pin(needed.all());
        if let Some(loader) = &self.loader {
            loader.load_needed(needed.all());
        }
        self.send_pose(pose);
    }

    /// Asks for chunks by number, before anything else.
    pub fn request(&self, chunks: &[u32]) {
        // The thread is gone when the connection is: `wait_until_complete` says so.
        let _ = self.commands.send(Command::Want(chunks.to_vec()));
    }

    /// Waits until all of `needed` can be drawn. Call [`Connection::update_view`] first.
    ///
    /// # Errors
    /// What is missing and why; a frame can still be drawn without it.
    pub fn wait_until_complete(&self, needed: &[u32], timeout: Duration) -> Result<(), Incomplete> {
        let deadline = Instant::now() + timeout;
        loop {
            let before = self.stats.received();
            let left = deadline.saturating_duration_since(Instant::now());
            match self.cache.wait(needed, left.min(ASK_AFTER)) {
                Err(Incomplete::Timeout(missing)) if left > ASK_AFTER => {
                    // Keep-alives and poses' acknowledgements are no progress.
                    if self.stats.received() < before + 4096 {
                        self.request(&missing);
                    }
                }
                end => return end,
            }
        }
    }

    /// Fetches a chunk's stored bytes by number or name, past the cache: for tools and tests.
    ///
    /// # Errors
    /// If there is no such chunk or the connection ends.
    pub fn fetch(&self, request: Request) -> Result<(u32, Vec<u8>), ConnectError> {
        let (answer, answered) = oneshot::channel();
        let lost = || ConnectError::Lost("the streaming thread ended".into());
        self.commands.send(Command::Fetch(request, answer)).map_err(|_| lost())?;
        answered.blocking_recv().unwrap_or_else(|_| Err(lost()))
    }

    /// The statistics now.
    pub fn stats(&self) -> Stats {
        self.stats.snapshot(self.cache.usage().useful_bytes)
    }

    /// Bytes received on the wire so far.
    pub fn received_bytes(&self) -> u64 {
        self.stats.received()
    }

    /// Round trip, milliseconds.
    pub fn rtt_ms(&self) -> f64 {
        self.stats.rtt_ms()
    }

    /// All arrivals so far, in order.
    pub fn arrivals(&self) -> Vec<Arrival> {
        self.stats.arrivals()
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        let _ = self.commands.send(Command::Close);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
