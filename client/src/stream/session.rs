//! The session: one loop that owns the control stream, and one task per received stream.

use super::{
    ConnectConfig, ConnectError,
    chunk_stream::{self, StreamError},
    decode_backlog::DecodeBacklog,
    decoder::{Damage, DecodeJob, DecodePool, DecodeTarget},
    disk::DiskCache,
    disk_chunks::DiskChunks,
    disk_loader::DiskLoader,
    handshake::{self, Opened},
    index_pages::{IndexPages, is_listed},
    other_walkers::{OtherWalkers, OthersRequest},
    pose_updates::PoseUpdates,
    progress::ConnectProgress,
    stats::{Collector, SAMPLE_EVERY},
    transport::MAX_STREAMS,
};
use crate::cache::Cache;
use glam::DVec3;
use ldi_protocol::{
    Pose,
    index::{ChunkHash, Index},
    manifest::PageEntry,
    need::{PREFETCH_SHARE, Reach, near_to_far},
    wire::{self, Answer, ClientMessage, MAX_LIST, PoseDatagram, Request, ServerMessage, StreamKind, code},
};
use quinn::{Connection, RecvStream, SendStream, VarInt};
use std::{
    collections::HashMap,
    sync::{Arc, Mutex, atomic::AtomicUsize},
    time::{Duration, Instant},
};
use tokio::{
    sync::{mpsc, oneshot},
    task::{JoinHandle, JoinSet},
    time::{interval, timeout},
};

/// Number of retries of a damaged chunk. QUIC verifies its packets, so that the damage is nearly
/// always on the server's disk.
pub const MAX_RETRIES: u8 = 2;
/// Movement after which data around the eye is marked as used again, metres.
const TOUCH_STEP_M: f64 = 0.5;
/// Radius around the eye in which data is kept in memory and loaded from disk, metres.
const AROUND_M: f64 = 5.0;
/// Timeout of the goodbye.
const GOODBYE: Duration = Duration::from_millis(500);

/// Commands of the render thread.
pub(super) enum Command {
    Want(Vec<u32>),
    Fetch(Request, oneshot::Sender<Result<(u32, Vec<u8>), ConnectError>>),
    Close,
}

/// An established connection.
pub(super) struct Ready {
    pub dataset: ChunkHash,
    pub cache: Arc<Cache>,
    /// The disk loader, with a disk cache.
    pub loader: Option<DiskLoader>,
}

/// Receives the outcome of connecting, once.
pub(super) type ReadyCallback = Box<dyn FnOnce(Result<Ready, ConnectError>) + Send>;

/// Body of the streaming thread: a runtime with one connection.
pub(super) fn run(
    config: ConnectConfig,
    stats: Arc<Collector>,
    poses: Arc<PoseUpdates>,
    commands: mpsc::UnboundedReceiver<Command>,
    ready: ReadyCallback,
) {
    match tokio::runtime::Builder::new_current_thread().enable_all().build() {
        Ok(runtime) => runtime.block_on(stream(config, stats, poses, commands, ready)),
        Err(e) => ready(Err(ConnectError::Local(e.to_string()))),
    }
}

/// Runs one connection until it ends.
pub(super) async fn stream(
    config: ConnectConfig,
    stats: Arc<Collector>,
    poses: Arc<PoseUpdates>,
    commands: mpsc::UnboundedReceiver<Command>,
    ready: ReadyCallback,
) {
    let pool = match &config.decode_pool {
        Some(shared) => Ok(shared.clone()),
        None => DecodePool::new(config.decode_threads).map(Arc::new),
    };
    let pool = match pool {
        Ok(p) => p,
        Err(e) => return ready(Err(ConnectError::Local(e.to_string()))),
    };
    let mut opened = match handshake::open(&config).await {
        Ok(o) => o,
        Err(e) => return ready(Err(e)),
    };
    if let Some(known) = config.index.as_ref().filter(|i| **i == opened.index) {
        opened.index = known.clone();
    }
    let cache = cache_for(&config, &opened);
    let disk_chunks = config.disk.as_ref().map(|d| Arc::new(DiskChunks::new(d.clone(), cache.clone())));
    let (damaged, damage) = mpsc::unbounded_channel();
    let target = Arc::new(DecodeTarget {
        cache: cache.clone(),
        stats: stats.clone(),
        damaged,
        arrivals: config.arrivals.clone(),
        ahead_bytes: AtomicUsize::new(0),
        waiting_bytes: AtomicUsize::new(0),
        backlog: DecodeBacklog::default(),
        disk_chunks: disk_chunks.clone(),
        abandoned: Mutex::default(),
    });
    let loader = disk_chunks.map(|disk_chunks| DiskLoader { disk_chunks, target: target.clone(), pool: pool.clone() });
    stats.watch(opened.connection.clone(), opened.link.clone());
    cache.set_disconnected(None);
    ready(Ok(Ready { dataset: opened.dataset, cache: cache.clone(), loader: loader.clone() }));
    let endpoint = opened.endpoint.clone();
    let session = Session {
        connection: opened.connection.clone(),
        send: opened.send,
        cache: cache.clone(),
        stats,
        tries: HashMap::new(),
        sequence: 0,
        started: Instant::now(),
        touched_at: None,
        prefetch_m: config.prefetch_m,
        pool,
        target,
        loader,
        around: Vec::new(),
        disk: config.disk.clone(),
        progress: config.progress.clone(),
        rest: opened.rest,
        assembling: None,
        others: config.others.clone(),
        others_requested: opened.tells_others.then(OthersRequest::default),
    };
    let end = session.run(opened.recv, poses, commands, damage).await;
    let reason = end.map_or_else(|e| e.to_string(), |()| "the connection was closed".into());
    config.others.forget();
    cache.set_disconnected(Some(reason));
    opened.connection.close(VarInt::from_u32(code::BYE), b"bye");
    let _ = timeout(GOODBYE, endpoint.wait_idle()).await;
}

/// The cache of an earlier connection to the same dataset, or a new one.
fn cache_for(config: &ConnectConfig, opened: &Opened) -> Arc<Cache> {
    if let Some(old) = &config.resume
        && old.dataset == opened.dataset
        && old.cache.index().is_whole()
    {
        return old.cache.clone();
    }
    let make = if config.decoding { Cache::new } else { Cache::without_decoding };
    Arc::new(make(opened.index.clone(), config.cache_bytes))
}

struct Session {
    connection: Connection,
    send: SendStream,
    cache: Arc<Cache>,
    stats: Arc<Collector>,
    tries: HashMap<u32, u8>,
    sequence: u32,
    started: Instant,
    touched_at: Option<DVec3>,
    prefetch_m: f64,
    pool: Arc<DecodePool>,
    target: Arc<DecodeTarget>,
    loader: Option<DiskLoader>,
    /// Chunks around the eye, near to far, for the disk loader.
    around: Vec<u32>,
    disk: Option<Arc<DiskCache>>,
    progress: Arc<ConnectProgress>,
    /// The manifest, until all pages have arrived.
    rest: Option<IndexPages>,
    /// The task that assembles the complete index.
    assembling: Option<JoinHandle<Result<Index, ConnectError>>>,
    others: Arc<OtherWalkers>,
    /// The request that the server knows; None if the server does not send other walkers.
    others_requested: Option<OthersRequest>,
}

impl Session {
    async fn run(
        mut self,
        recv: RecvStream,
        poses: Arc<PoseUpdates>,
        mut commands: mpsc::UnboundedReceiver<Command>,
        mut damage: mpsc::UnboundedReceiver<Damage>,
    ) -> Result<(), ConnectError> {
        match self.rest {
            None => self.send_whole().await?,
            Some(_) => self.send_held().await?,
        }
        let (messages, mut received_messages) = mpsc::channel(16);
        let (page_sender, mut pages) = mpsc::channel(MAX_STREAMS as usize);
        let listed = self.rest.as_ref().map_or_else(Vec::new, IndexPages::listed);
        let intake =
            Arc::new(ChunkReceiver { target: self.target.clone(), pool: self.pool.clone(), listed, page_sender });
        let mut tasks = JoinSet::new();
        tasks.spawn(read_messages(recv, self.connection.clone(), messages));
        let mut tick = interval(SAMPLE_EVERY);
        loop {
            tokio::select! {
                // QUIC does not count streams that were read to the end: chunks that wait for
                // decoding are counted here.
                stream = self.connection.accept_uni(), if tasks.len() <= MAX_STREAMS as usize && !self.target.is_full() => {
                    let stream = stream.map_err(|e| handshake::lost(&e))?;
                    tasks.spawn(intake.clone().receive_chunk(stream));
                }
                pose = poses.next() => self.send_pose(pose),
                command = commands.recv() => match command {
                    Some(Command::Want(chunks)) => self.send_list(chunks, |chunks| ClientMessage::Want { chunks }).await?,
                    Some(Command::Fetch(request, answer)) => {
                        tasks.spawn(fetch(self.connection.clone(), request, answer));
                    }
                    Some(Command::Close) | None => {
                        if let Ok(bye) = wire::encode(&ClientMessage::Bye) {
                            let _ = self.send.write_all(&bye).await;
                        }
                        return Ok(());
                    }
                },
                Some((number, bytes)) = pages.recv() => self.on_page(number, bytes),
                index = assembled(&mut self.assembling) => self.on_whole_index(index?).await?,
                Some(message) = received_messages.recv() => self.on_message(message?),
                Some(damage) = damage.recv() => self.on_damage(damage).await?,
                _ = tick.tick() => self.sample(poses.newest()).await?,
                Some(_) = tasks.join_next() => {}
            }
        }
    }

    /// Tells the server which chunks are held.
    async fn send_held(&mut self) -> Result<(), ConnectError> {
        let mut have = self.cache.held();
        if let Some(loader) = &self.loader {
            have.extend(loader.disk_chunks.chunk_numbers());
            have.sort_unstable();
            have.dedup();
        }
        self.send_list(have, |chunks| ClientMessage::Have { chunks }).await
    }

    /// Adds a page. The last one starts a task that assembles the index.
    fn on_page(&mut self, number: u32, bytes: Vec<u8>) {
        let Some(rest) = &mut self.rest else { return };
        self.progress.page(bytes.len() as u64);
        rest.take(number, bytes);
        if let Some(pages) = self.rest.take_if(|r| r.are_whole()) {
            let disk = self.disk.clone();
            self.assembling = Some(tokio::task::spawn_blocking(move || pages.assemble(disk.as_deref())));
        }
    }

    async fn on_whole_index(&mut self, index: Index) -> Result<(), ConnectError> {
        self.cache.complete(Arc::new(index));
        if let Some(loader) = &self.loader {
            loader.disk_chunks.refresh();
        }
        self.send_whole().await
    }

    /// Tells the server that the index is complete, after the held chunks.
    async fn send_whole(&mut self) -> Result<(), ConnectError> {
        self.send_held().await?;
        self.ready_callback(&ClientMessage::Whole).await
    }

    fn send_pose(&mut self, pose: Pose) {
        self.sequence = self.sequence.wrapping_add(1);
        let sent_us = self.started.elapsed().as_micros() as u64;
        let datagram = PoseDatagram { sequence: self.sequence, sent_us, pose };
        // A full buffer drops the oldest pose, which is the right one to drop.
        if let Err(e) = self.connection.send_datagram(datagram.encode().to_vec().into()) {
            tracing::debug!("pose: {e}");
        }
    }

    /// Sends a list in parts that fit a message.
    async fn send_list(
        &mut self,
        chunks: Vec<u32>,
        message: impl Fn(Vec<u32>) -> ClientMessage,
    ) -> Result<(), ConnectError> {
        for part in chunks.chunks(MAX_LIST) {
            self.ready_callback(&message(part.to_vec())).await?;
        }
        Ok(())
    }

    async fn ready_callback(&mut self, message: &ClientMessage) -> Result<(), ConnectError> {
        let frame = wire::encode(message).map_err(|e| ConnectError::Protocol(e.to_string()))?;
        self.send.write_all(&frame).await.map_err(|e| match self.connection.close_reason() {
            Some(reason) => handshake::lost(&reason),
            None => ConnectError::Lost(e.to_string()),
        })
    }

    fn on_message(&mut self, message: ServerMessage) {
        match message {
            ServerMessage::Unavailable { chunks } => {
                tracing::warn!("the server cannot read {} chunks, the first is {:?}", chunks.len(), chunks.first());
                chunks.into_iter().for_each(|c| self.cache.mark_damaged(c));
            }
            ServerMessage::Others { walkers } => self.others.set(walkers),
            ServerMessage::Replaced => self.progress.set_replaced(),
            // Handshake messages have no meaning here.
            ServerMessage::Welcome(_) | ServerMessage::Refused { .. } => {}
        }
    }

    /// Tells the server, which checks and logs it.
    async fn on_damage(&mut self, damage: Damage) -> Result<(), ConnectError> {
        let (Damage::Bytes(chunk) | Damage::Content(chunk)) = damage;
        self.send_list(vec![chunk], |chunks| ClientMessage::Damaged { chunks }).await?;
        match damage {
            Damage::Bytes(chunk) => self.retry_damaged(chunk).await,
            Damage::Content(_) => Ok(()),
        }
    }

    async fn retry_damaged(&mut self, chunk: u32) -> Result<(), ConnectError> {
        let tries = self.tries.entry(chunk).or_default();
        *tries += 1;
        if *tries > MAX_RETRIES {
            if self.cache.is_damaged(chunk) {
                return Ok(());
            }
            tracing::warn!(
                chunk,
                "arrived damaged {tries} times and is given up; check the dataset with `ldi-server verify`"
            );
            self.cache.mark_damaged(chunk);
            // Otherwise it would be sent with every pose that needs it.
            return self.send_list(vec![chunk], |chunks| ClientMessage::Have { chunks }).await;
        }
        tracing::info!(chunk, "arrived damaged, asked for again");
        self.send_list(vec![chunk], |chunks| ClientMessage::Want { chunks }).await
    }

    async fn sample(&mut self, pose: Option<Pose>) -> Result<(), ConnectError> {
        self.stats.tick();
        if let Some(p) = pose
            && self.prefetch_m > 0.0
            && self.touched_at.is_none_or(|at| at.distance(p.position) >= TOUCH_STEP_M)
        {
            self.touched_at = Some(p.position);
            let decoded_bytes = (self.cache.usage().cap_bytes as f64 * PREFETCH_SHARE) as u64;
            let reach = Reach { radius_m: self.prefetch_m.min(AROUND_M), decoded_bytes };
            self.around = near_to_far(self.cache.index(), p.position, reach);
            self.cache.touch(self.around.iter().copied());
        }
        if let Some(loader) = &self.loader {
            loader.load_around(&self.around);
        }
        if let Some(news) = self.target.backlog.update_message(self.pool.threads()) {
            self.ready_callback(&news).await?;
        }
        let request_state = self.others.request_state();
        if self.others_requested.is_some_and(|said| said != request_state) {
            self.others_requested = Some(request_state);
            self.ready_callback(&ClientMessage::Others { shown: request_state.wanted }).await?;
        }
        let mut gone = self.cache.take_evicted(Instant::now());
        if let Some(loader) = &self.loader {
            // Evicted chunks that are on disk stay held.
            gone.retain(|c| !loader.disk_chunks.holds(*c));
        }
        gone.extend(self.target.take_abandoned());
        self.send_list(gone, |chunks| ClientMessage::Drop { chunks }).await
    }
}

/// Reads the control stream until it ends.
async fn read_messages(
    mut recv: RecvStream,
    connection: Connection,
    out: mpsc::Sender<Result<ServerMessage, ConnectError>>,
) {
    loop {
        let message = handshake::read_message(&mut recv, &connection).await;
        let last = message.is_err();
        if out.send(message).await.is_err() || last {
            return;
        }
    }
}

/// The complete index, when its task is done.
async fn assembled(assembling: &mut Option<JoinHandle<Result<Index, ConnectError>>>) -> Result<Index, ConnectError> {
    let Some(task) = assembling else { return std::future::pending().await };
    let done = task.await;
    *assembling = None;
    done.unwrap_or_else(|e| Err(ConnectError::Local(e.to_string())))
}

/// The destination of received streams.
struct ChunkReceiver {
    target: Arc<DecodeTarget>,
    pool: Arc<DecodePool>,
    /// Pages that may arrive.
    listed: Vec<PageEntry>,
    page_sender: mpsc::Sender<(u32, Vec<u8>)>,
}

impl ChunkReceiver {
    /// Receives a page for the session, or a chunk for the decoder.
    async fn receive_chunk(self: Arc<Self>, mut stream: RecvStream) {
        match self.receive(&mut stream).await {
            Ok(()) => {}
            Err(StreamError::Off { bytes }) => self.target.stats.broken_off(bytes),
            Err(e @ StreamError::Wrong(_)) => tracing::warn!("a stream was refused: {e}"),
        }
    }

    async fn receive(&self, stream: &mut RecvStream) -> Result<(), StreamError> {
        let DecodeTarget { cache, stats, .. } = &*self.target;
        let header = chunk_stream::header(stream).await?;
        let entry = cache.index().chunks.get(header.number as usize).filter(|_| header.kind == StreamKind::Chunk);
        if entry.is_none_or(|e| e.stored_bytes != header.bytes) && !is_listed(&self.listed, &header) {
            chunk_stream::refuse(stream, code::BAD_STREAM);
            return Err(StreamError::Wrong(format!(
                "{:?} {} is not as the index lists it",
                header.kind, header.number
            )));
        }
        if header.kind == StreamKind::Chunk && cache.holds(header.number) {
            chunk_stream::refuse(stream, code::DUPLICATE);
            stats.duplicate(0);
            return Ok(());
        }
        let bytes = chunk_stream::body(stream, &header).await?;
        if header.kind == StreamKind::Page {
            // Nobody receives pages after the session has ended.
            let _ = self.page_sender.send((header.number, bytes)).await;
            return Ok(());
        }
        let target = self.target.clone();
        self.pool.send(DecodeJob { chunk: header.number, urgency: header.urgency, bytes: Some(bytes), target }).await;
        Ok(())
    }
}

/// Performs a request on its own stream.
async fn fetch(
    connection: Connection,
    request: Request,
    answer: oneshot::Sender<Result<(u32, Vec<u8>), ConnectError>>,
) {
    let fetched = async {
        let (mut send, mut recv) = connection.open_bi().await.map_err(|e| handshake::lost(&e))?;
        let request = wire::encode(&request).map_err(|e| ConnectError::Protocol(e.to_string()))?;
        send.write_all(&request).await.map_err(|e| ConnectError::Lost(e.to_string()))?;
        let _ = send.finish();
        match handshake::read_message::<Answer>(&mut recv, &connection).await? {
            Answer::Error { message } => Err(ConnectError::Protocol(message)),
            Answer::Chunk { number, bytes } => {
                let body = recv.read_to_end(bytes as usize).await.map_err(|e| ConnectError::Lost(e.to_string()))?;
                if body.len() != bytes as usize {
                    return Err(ConnectError::Protocol(format!("{} of {bytes} bytes", body.len())));
                }
                Ok((number, body))
            }
        }
    };
    let _ = answer.send(fetched.await);
}
