//! The connection to the server: connects, reports problems, reconnects.
//!
//! Runs on its own thread. The window reads the [`ConnectionState`] and never waits; the render
//! thread reports its view. Received data is kept: after a loss frames are drawn from the cache,
//! and the next connection continues with it.

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

/// Interval at which the connection is checked.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// Interval while the rest of the index arrives, as pictures wait for it.
const LOOK_OFTEN: Duration = Duration::from_millis(10);
/// Time without received bytes after which the connection is given up. Longer than the interval at
/// which poses are repeated and acknowledged, and much shorter than QUIC's own timeout.
const SILENCE: Duration = Duration::from_secs(6);
/// Pause before the second attempt, doubled up to [`LONGEST_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// See [`FIRST_PAUSE`].
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
/// Timeout of reconnecting. Short, as the server was available before and may return at any time.
const AGAIN_TIMEOUT: Duration = Duration::from_secs(4);
/// Window over which the displayed rate is measured.
const RATE_OVER: Duration = Duration::from_secs(1);

/// State of the connection.
#[derive(Debug, Clone, PartialEq)]
pub enum ConnectionState {
    /// Connecting.
    Connecting {
        /// 1 for the first attempt, then counted up after each failure or loss.
        attempt: u32,
        /// The reason of the previous failure or loss.
        after: Option<String>,
    },
    /// The connection is established.
    Up,
    /// There is no connection; the next attempt is scheduled.
    Waiting {
        /// The reason of the failure or loss.
        reason: String,
        /// Time of the next attempt.
        until: Instant,
    },
    /// There is no connection, and reconnecting cannot help.
    Refused(ConnectError),
}

/// A dataset and its received data.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The index, as far as it has arrived.
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

/// Transfer rates and counts.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ConnectionSummary {
    /// Received over the last second, Mbit/s.
    pub mbit_per_s: f64,
    /// Received bytes of all connections.
    pub bytes: u64,
    /// Round trip time, milliseconds.
    pub rtt_ms: f64,
    /// Usage of the cache.
    pub cache: Usage,
}

struct Inner {
    state: ConnectionState,
    /// Start of the time without a connection.
    down_since: Option<Instant>,
    scene: Option<Scene>,
    connection: Option<Connection>,
    summary: ConnectionSummary,
    /// Statistics of the previous connections.
    before: Stats,
    /// The last pose and its needs, which the next connection sends at once.
    looked: Option<(Pose, Needed)>,
    /// The connection is to be given up for a new one.
    reconnect: bool,
}

impl Inner {
    /// The statistics of all connections so far.
    fn all_stats(&self) -> Stats {
        let now = self.connection.as_ref().map(Connection::stats).unwrap_or_default();
        self.before.and_then(&now, self.scene.as_ref().map_or(0, |s| s.cache.usage().useful_bytes))
    }
}

/// The connection's handle. Dropping it ends the connection.
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
    /// Starts to connect. `changed` is called on the connection's thread after every change of
    /// state.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start(config: ConnectConfig, changed: impl Fn() + Send + 'static) -> std::io::Result<Self> {
        Self::begin(None, config, Box::new(changed))
    }

    /// Takes over an established connection that was made with `config`.
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
            reconnect: false,
        }));
        let (progress, others) = (config.progress.clone(), config.others.clone());
        let (stop, stopped) = mpsc::channel();
        let keeper = ConnectionKeeper { config, inner: inner.clone(), stopped, changed };
        let thread = std::thread::Builder::new().name("ldi-link".into()).spawn(move || keeper.run(first))?;
        Ok(Self { inner, progress, others, stop: Some(stop), thread: Some(thread) })
    }

    /// State of the connection.
    pub fn state(&self) -> ConnectionState {
        lock(&self.inner).state.clone()
    }

    /// Time without a connection; None while it is established.
    pub fn down_for(&self) -> Option<Duration> {
        lock(&self.inner).down_since.map(|since| since.elapsed())
    }

    /// The dataset, once its index has arrived.
    pub fn scene(&self) -> Option<Scene> {
        lock(&self.inner).scene.clone()
    }

    /// Transfer rates and counts.
    pub fn summary(&self) -> ConnectionSummary {
        lock(&self.inner).summary
    }

    /// The statistics of all connections.
    pub fn stats(&self) -> Stats {
        let inner = lock(&self.inner);
        inner.all_stats()
    }

    /// Progress of connecting: the phase, received and total bytes of the index.
    pub fn progress(&self) -> (Phase, (u64, u64)) {
        (self.progress.phase(), self.progress.index_bytes())
    }

    /// Whether the server has a new build of the dataset, which the next connection gets.
    pub fn is_replaced(&self) -> bool {
        self.progress.is_replaced()
    }

    /// Gives the connection up for a new one.
    pub fn reconnect(&self) {
        lock(&self.inner).reconnect = true;
    }

    /// Other walkers, if requested and sent by the server.
    pub fn others(&self) -> &OtherWalkers {
        &self.others
    }

    /// Reports the eye's pose and needs: pins them in the cache, and sends the pose if there is a
    /// connection.
    pub fn update_view(&self, pose: &Pose, needed: &Needed) {
        let mut inner = lock(&self.inner);
        inner.looked = Some((*pose, needed.clone()));
        match (&inner.connection, &inner.scene) {
            (Some(connection), _) => connection.update_view(pose, needed),
            (None, Some(scene)) => scene.cache.pin(needed.all()),
            (None, None) => {}
        }
    }

    /// Requests chunks by number.
    pub fn request(&self, chunks: &[u32]) {
        if let Some(connection) = &lock(&self.inner).connection {
            connection.request(chunks);
        }
    }
}

impl Drop for ServerConnection {
    fn drop(&mut self) {
        self.stop = None;
        // A thread that is connecting cannot be interrupted; the process does not wait for it.
        if let (Some(thread), false) = (self.thread.take(), matches!(self.state(), ConnectionState::Connecting { .. }))
        {
            let _ = thread.join();
        }
    }
}

/// State of the connection's thread.
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
                    // The connection was established: attempts are counted from one again.
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

    /// Watches a connection until it is lost. None: stop.
    fn keep(&mut self, connection: Connection) -> Option<ConnectError> {
        let cache = connection.cache().clone();
        self.config.resume = Some(connection.kept());
        {
            let mut inner = lock(&self.inner);
            let scene = Scene::of(&connection);
            if inner.scene.replace(scene.clone()).is_some_and(|old| !old.is(&scene)) {
                // The needs refer to the previous dataset.
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
            // Without a view nothing is expected to arrive.
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
            if std::mem::take(&mut lock(&self.inner).reconnect) {
                break Some("it is left for the new version".into());
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
        // Dropping sends a goodbye and waits for threads, so that the lock must be free.
        drop(connection);
        self.config.timeout = AGAIN_TIMEOUT;
        // The cache stores the text of the same error.
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
