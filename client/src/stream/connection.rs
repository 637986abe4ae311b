//! A connection as the render thread uses it: poses and needs go out, decoded objects come in.

use super::{
    config::{ConnectConfig, ResumeState},
    disk_loader::DiskLoader,
    error::ConnectError,
    pose_updates::PoseUpdates,
    session::{self, Command, Ready, ReadyCallback},
    stats::{Arrival, Collector, Stats},
};
use crate::cache::{Cache, Incomplete};
use ldi_protocol::{
    Pose,
    index::{ChunkHash, Index},
    need::Needed,
    wire::Request,
};
use std::{
    sync::Arc,
    thread::JoinHandle,
    time::{Duration, Instant},
};
use tokio::sync::{mpsc, oneshot};

/// Time without progress after which missing chunks are requested by number. Shorter: chunks that
/// are only slow arrive twice.
const ASK_AFTER: Duration = Duration::from_millis(300);

/// A connection. Dropping it sends a goodbye and waits for its threads.
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
    /// Connects with its own threads. Returns when the manifest has arrived, or the part that a
    /// first picture needs ([`ConnectConfig::early`]).
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

    /// Connects as a task on the current runtime, for many connections in one process. Dropping it
    /// does not wait.
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

    /// The reason why nothing will arrive any more; None while the connection is up.
    pub fn lost(&self) -> Option<String> {
        self.cache.disconnected()
    }

    /// The dataset's index, as far as it has arrived.
    pub fn index(&self) -> &Arc<Index> {
        self.cache.index()
    }
    /// The dataset's name.
    pub fn dataset(&self) -> ChunkHash {
        self.dataset
    }
    /// State for the next connection to the same server.
    pub fn kept(&self) -> ResumeState {
        ResumeState { dataset: self.dataset, cache: self.cache.clone() }
    }
    /// Decoded objects; implements [`crate::resident::Resident`].
    pub fn cache(&self) -> &Arc<Cache> {
        &self.cache
    }

    /// Sends the eye's pose. Only the latest is sent; a lost one is repeated.
    pub fn send_pose(&self, pose: &Pose) {
        self.poses.update_view(pose);
    }

    /// Starts a new frame: pins its needs, loads those on disk, and sends the pose.
    pub fn update_view(&self, pose: &Pose, needed: &Needed) {
        self.cache.pin(needed.all());
        if let Some(loader) = &self.loader {
            loader.load_needed(needed.all());
        }
        self.send_pose(pose);
    }

    /// Requests chunks by number, with the highest urgency.
    pub fn request(&self, chunks: &[u32]) {
        // Without a connection the thread is gone; `wait_until_complete` reports it.
        let _ = self.commands.send(Command::Want(chunks.to_vec()));
    }

    /// Waits until all of `needed` can be drawn. Call [`Connection::update_view`] first.
    ///
    /// # Errors
    /// Names the missing chunks and the reason. A frame can still be drawn without them.
    pub fn wait_until_complete(&self, needed: &[u32], timeout: Duration) -> Result<(), Incomplete> {
        let deadline = Instant::now() + timeout;
        loop {
            let before = self.stats.received();
            let left = deadline.saturating_duration_since(Instant::now());
            match self.cache.wait(needed, left.min(ASK_AFTER)) {
                Err(Incomplete::Timeout(missing)) if left > ASK_AFTER => {
                    // Keep-alives and acknowledgements do not count as progress.
                    if self.stats.received() < before + 4096 {
                        self.request(&missing);
                    }
                }
                end => return end,
            }
        }
    }

    /// Fetches a chunk's stored bytes by number or name, bypassing the cache: for tools and tests.
    ///
    /// # Errors
    /// If there is no such chunk, or the connection ends.
    pub fn fetch(&self, request: Request) -> Result<(u32, Vec<u8>), ConnectError> {
        let (answer, answered) = oneshot::channel();
        let lost = || ConnectError::Lost("the streaming thread ended".into());
        self.commands.send(Command::Fetch(request, answer)).map_err(|_| lost())?;
        answered.blocking_recv().unwrap_or_else(|_| Err(lost()))
    }

    /// The current statistics.
    pub fn stats(&self) -> Stats {
        self.stats.snapshot(self.cache.usage().useful_bytes)
    }

    /// Received bytes so far, UDP payload.
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
