//! The line to the server, kept up: connects, says why it cannot, connects again by itself.
//!
//! One thread of its own. The window asks for the [`ConnectionState`] and never waits; the drawing thread says where it looks. What was
//! received stays: after a loss frames are drawn from the cache, and the next connection goes on with it.

use crate::{
    cache::{Cache, Usage},
    stream::{ConnectConfig, ConnectError, ConnectProgress, Connection, OtherWalkers, Phase, Stats},
};
use ldi_protocol::{Pose, index::Index, need::Needed};
use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc},
    thread::JoinHandle,
    time::{Duration, Instant},
};

/// How often the line is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// The same while the rest of the index is to come: pictures wait for it.
const LOOK_OFTEN: Duration = Duration::from_millis(10);
/// Without a byte for this long the line is given up. A pose is repeated every 2 s at least and acknowledged, so that a living line
/// is never silent for longer; QUIC itself would notice after 30 s only.
const SILENCE: Duration = Duration::from_secs(6);
/// Pause before the second attempt; doubled up to [`LONGEST_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// See [`FIRST_PAUSE`].
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
/// Time for connecting again: the server was there a moment ago, and may be back at any time.
const AGAIN_TIMEOUT: Duration = Duration::from_secs(4);
/// Window of the shown rate.
const RATE_OVER: Duration = Duration::from_secs(1);

/// How the line is.
#[derive(Debug, Clone, PartialEq)]
pub enum ConnectionState {
    /// Connecting.
    Connecting {
        /// 1 for the first time, 2 and so on after a failure or a loss.
        attempt: u32,
        /// Why the one before failed or was lost.
        after: Option<String>,
    },
    /// There is a connection.
    Up,
    /// There is none, and the next attempt comes then.
    Waiting {
        /// Why.
        reason: String,
        /// When.
        until: Instant,
    },
    /// There is none, and trying again would not help.
    Refused(ConnectError),
}

/// A dataset with what was received of it.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Its index, as far as it is here.
    pub index: Arc<Index>,
    /// Decoded objects.
    pub cache: Arc<Cache>,
}

impl Scene {
    pub(super) fn of(connection: &Connection) -> Self {
        Self { index: connection.index().clone(), cache: connection.cache().clone() }
    }

    /// Whether both are the same cache of the same dataset.
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.cache, &other.cache)
    }
}

/// What the line carried.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ConnectionSummary {
    /// Over the last second.
    pub mbit_per_s: f64,
    /// Of all connections.
    pub bytes: u64,
    /// Round trip.
    pub rtt_ms: f64,
    /// The cache's accounts.
    pub cache: Usage,
}

struct Inner {
    state: ConnectionState,
    /// Since when there has been no connection.
    down_since: Option<Instant>,
    scene: Option<Scene>,
    connection: Option<Connection>,
    summary: ConnectionSummary,
    /// Of the connections before this one.
    before: Stats,
    /// Where the eye looked last and what it needed: the next connection has to know at once.
    looked: Option<(Pose, Needed)>,
}

impl Inner {
    /// The statistics of all connections so far.
    fn all_stats(&self) -> Stats {
        let now = self.connection.as_ref().map(Connection::stats).unwrap_or_default();
        self.before.and_then(&now, self.scene.as_ref().map_or(0, |s| s.cache.usage().useful_bytes))
    }
}

/// The line; stopped when dropped.
pub struct ServerConnection {
    inner: Arc<Mutex<Inner>>,
    progress: Arc<ConnectProgress>,
    others: Arc<OtherWalkers>,
    stop: Option<mpsc::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

fn lock(inner: &Mutex<Inner>) -> MutexGuard<'_, Inner> {
    // Every change is complete before anything can panic.
    inner.lock().unwrap_or_else(PoisonError::into_inner)
}

impl ServerConnection {
    /// Begins to connect. `changed` is called, on the link's thread, after every change of state.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start(config: ConnectConfig, changed: impl Fn() + Send + 'static) -> std::io::Result<Self> {
        Self::begin(None, config, Box::new(changed))
    }

    /// Keeps up what a connection made with `config` has begun.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn keep_connected(
        connection: Connection,
        config: ConnectConfig,
        changed: impl Fn() + Send + 'static,
    ) -> std::io::Result<Self> {
        Self::begin(Some(connection), config, Box::new(changed))
    }

    fn begin(first: Option<Connection>, config: ConnectConfig, changed: Box<dyn Fn() + Send>) -> std::io::Result<Self> {
        let inner = Arc::new(Mutex::new(Inner {
            state: if first.is_some() {
                ConnectionState::Up
            } else {
                ConnectionState::Connecting { attempt: 1, after: None }
            },
            down_since: first.is_none().then(Instant::now),
            scene: first.as_ref().map(Scene::of),
            connection: None,
            summary: ConnectionSummary::default(),
            before: Stats::default(),
            looked: None,
        }));
        let (progress, others) = (config.progress.clone(), config.others.clone());
        let (stop, stopped) = mpsc::channel();
        let keeper = ConnectionKeeper { config, inner: inner.clone(), stopped, changed };
        let thread = std::thread::Builder::new().name("ldi-link".into()).spawn(move || keeper.run(first))?;
        Ok(Self { inner, progress, others, stop: Some(stop), thread: Some(thread) })
    }

    /// How the line is.
    pub fn state(&self) -> ConnectionState {
        lock(&self.inner).state.clone()
    }

    /// How long there has been no connection; None while there is one.
    pub fn down_for(&self) -> Option<Duration> {
        lock(&self.inner).down_since.map(|since| since.elapsed())
    }

    /// The dataset, once its index is here.
    pub fn scene(&self) -> Option<Scene> {
        lock(&self.inner).scene.clone()
    }

    /// What the line carried.
    pub fn summary(&self) -> ConnectionSummary {
        lock(&self.inner).summary
    }

    /// The statistics of all connections.
    pub fn stats(&self) -> Stats {
        let inner = lock(&self.inner);
        inner.all_stats()
    }

    /// How far connecting is: the phase; stored bytes of the index, and of all of it.
    pub fn progress(&self) -> (Phase, (u64, u64)) {
        (self.progress.phase(), self.progress.index_bytes())
    }

    /// Where other walkers are, if that is wanted and the server tells.
    pub fn others(&self) -> &OtherWalkers {
        &self.others
    }

    /// The eye is here and needs this: it is pinned in the cache, and sent if there is a line.
    pub fn update_view(&self, pose: &Pose, needed: &Needed) {
        let mut inner = lock(&self.inner);
        inner.looked = Some((*pose, needed.clone()));
        match (&inner.connection, &inner.scene) {
            (Some(connection), _) => connection.update_view(pose, needed),
            (None, Some(scene)) => scene.cache.pin(needed.all()),
            (None, None) => {}
        }
    }

    /// Asks for chunks by number.
    pub fn request(&self, chunks: &[u32]) {
        if let Some(connection) = &lock(&self.inner).connection {
            connection.request(chunks);
        }
    }
}

impl Drop for ServerConnection {
    fn drop(&mut self) {
        self.stop = None;
        // While connecting, the thread cannot be told; the process need not wait for a server that does not answer.
        if let (Some(thread), false) = (self.thread.take(), matches!(self.state(), ConnectionState::Connecting { .. }))
        {
            let _ = thread.join();
        }
    }
}

/// The thread.
struct ConnectionKeeper {
    config: ConnectConfig,
    inner: Arc<Mutex<Inner>>,
    stopped: mpsc::Receiver<()>,
    changed: Box<dyn Fn() + Send>,
}

impl ConnectionKeeper {
    fn run(mut self, mut first: Option<Connection>) {
        let (mut attempt, mut after) = (1, None);
        loop {
            let connected = first.take().map(Ok).unwrap_or_else(|| {
                self.enter(ConnectionState::Connecting { attempt, after: after.take() });
                Connection::connect(self.config.clone())
            });
            let ended = match connected {
                Ok(connection) => {
                    // Whoever loses it knows that the next attempt is another one.
                    attempt = 1;
                    self.keep(connection)
                }
                Err(e) => Some(e),
            };
            match ended {
                None => return,
                Some(e) if e.exit_code() != 1 => return self.enter(ConnectionState::Refused(e)),
                Some(e) => {
                    if attempt == 1 {
                        tracing::warn!("{e}; trying again");
                    }
                    attempt += 1;
                    let pause = (FIRST_PAUSE * (1 << (attempt - 2).min(8))).min(LONGEST_PAUSE);
                    after = Some(e.to_string());
                    self.enter(ConnectionState::Waiting { reason: e.to_string(), until: Instant::now() + pause });
                    if self.stops_within(pause) {
                        return;
                    }
                }
            }
        }
    }

    /// Keeps a connection until it is lost. None when the link is to stop.
    fn keep(&mut self, connection: Connection) -> Option<ConnectError> {
        let cache = connection.cache().clone();
        self.config.resume = Some(connection.kept());
        {
            let mut inner = lock(&self.inner);
            let scene = Scene::of(&connection);
            if inner.scene.replace(scene.clone()).is_some_and(|old| !old.is(&scene)) {
                // Another dataset: what was needed of the old one means nothing here.
                inner.looked = None;
            }
            if let Some((pose, needed)) = &inner.looked {
                connection.update_view(pose, needed);
            }
            inner.connection = Some(connection);
        }
        self.enter(ConnectionState::Up);
        let bytes_before = lock(&self.inner).before.bytes_total;
        let mut heard = (0, Instant::now());
        let mut samples = std::collections::VecDeque::new();
        let reason = loop {
            let whole = lock(&self.inner).scene.as_ref().is_none_or(|s| s.index.is_whole());
            if self.stops_within(if whole { LOOK_EVERY } else { LOOK_OFTEN }) {
                break None;
            }
            if !whole && cache.index().is_whole() {
                let mut inner = lock(&self.inner);
                inner.scene = inner.connection.as_ref().map(Scene::of);
            }
            let now = Instant::now();
            let stats = {
                let inner = lock(&self.inner);
                inner.connection.as_ref().map(|c| (c.received_bytes(), c.rtt_ms(), inner.looked.is_some()))
            };
            let Some((received, rtt_ms, looked)) = stats else { break None };
            // Before the first look nothing needs to be said.
            if received != heard.0 || !looked {
                heard = (received, now);
            }
            samples.push_back((now, received));
            while samples.len() > 2 && samples.front().is_some_and(|s: &(Instant, u64)| now - s.0 > RATE_OVER) {
                samples.pop_front();
            }
            let (since, first) = samples.front().copied().unwrap_or((now, received));
            let seconds = (now - since).as_secs_f64().max(LOOK_EVERY.as_secs_f64());
            lock(&self.inner).summary = ConnectionSummary {
                mbit_per_s: (received - first) as f64 * 8e-6 / seconds,
                bytes: bytes_before + received,
                rtt_ms,
                cache: cache.usage(),
            };
            if let Some(reason) = cache.disconnected() {
                break Some(reason);
            }
            if now - heard.1 > SILENCE {
                break Some(format!("the server has not answered for {} s", SILENCE.as_secs()));
            }
        };
        let connection = {
            let mut inner = lock(&self.inner);
            inner.summary.mbit_per_s = 0.0;
            inner.before = inner.all_stats();
            inner.connection.take()
        };
        // Says goodbye and waits for its threads: with the lock free.
        drop(connection);
        self.config.timeout = AGAIN_TIMEOUT;
        // The cache keeps the words of the same error.
        reason.map(|r| ConnectError::Lost(r.trim_start_matches("the connection ended: ").to_owned()))
    }

    fn enter(&self, state: ConnectionState) {
        {
            let mut inner = lock(&self.inner);
            let since = inner.down_since.unwrap_or_else(Instant::now);
            inner.down_since = (state != ConnectionState::Up).then_some(since);
            inner.state = state;
        }
        (self.changed)();
    }

    fn stops_within(&self, time: Duration) -> bool {
        !matches!(self.stopped.recv_timeout(time), Err(mpsc::RecvTimeoutError::Timeout))
    }
}
