//! The connection of a walk without a window. It is restored after a loss; meanwhile frames are
//! drawn from the cache.

use super::server_connection::{ConnectionState, Scene, ServerConnection};
use crate::{
    cache::Incomplete,
    engine::{DataSource, LOST_FOR, Traffic},
    resident::Resident,
    stream::{ConnectConfig, Connection, Stats},
};
use ldi_protocol::{Pose, index::Index, ldi::Ldi, mesh::CellGeometry, need::Needed, texture::Texture, tree::Brood};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

/// Chunks that have not arrived after this time are requested by number, unless data is arriving.
const ASK_AFTER: Duration = Duration::from_millis(300);
/// Fewer bytes than these do not count as progress: keep-alives and acknowledgements.
const BUSY_BYTES: u64 = 4096;

/// A dataset over a connection that is restored after a loss.
pub struct HeadlessConnection {
    connection: ServerConnection,
    scene: Scene,
    dataset: String,
    stop: Arc<AtomicBool>,
}

impl HeadlessConnection {
    /// Takes over a connection that was made with `config`. Setting `stop` ends all waits.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn new(connection: Connection, config: ConnectConfig, stop: Arc<AtomicBool>) -> std::io::Result<Self> {
        let (scene, dataset) = (Scene::of(&connection), connection.dataset().to_string());
        let connection = ServerConnection::keep_connected(connection, config, || {})?;
        Ok(Self { connection, scene, dataset, stop })
    }

    /// The statistics of all connections.
    pub fn stats(&self) -> Stats {
        self.connection.stats()
    }

    /// The reason why reconnecting cannot help; None while it may.
    fn in_vain(&self) -> Option<String> {
        match self.connection.state() {
            ConnectionState::Refused(e) => Some(e.to_string()),
            _ if self.connection.scene().is_some_and(|s| !s.is(&self.scene)) => {
                Some("the server came back with another dataset".into())
            }
            _ => None,
        }
    }
}

impl Resident for HeadlessConnection {
    fn cell(&self, cell: u32) -> Option<Arc<CellGeometry>> {
        self.scene.cache.cell(cell)
    }
    fn bundle(&self, chunk: u32) -> Option<Arc<CellGeometry>> {
        self.scene.cache.bundle(chunk)
    }
    fn texture(&self, texture: u32) -> Option<Arc<Texture>> {
        self.scene.cache.texture(texture)
    }
    fn ldi(&self, image: u32) -> Option<Arc<Ldi>> {
        self.scene.cache.ldi(image)
    }
    fn brood(&self, chunk: u32) -> Option<Arc<Brood>> {
        self.scene.cache.brood(chunk)
    }
}

impl DataSource for HeadlessConnection {
    fn index(&self) -> &Index {
        self.scene.cache.index()
    }
    fn dataset_hash(&self) -> String {
        self.dataset.clone()
    }
    fn update_view(&self, pose: &Pose, needed: &Needed) {
        self.connection.update_view(pose, needed);
    }
    fn request(&self, chunks: &[u32]) {
        self.connection.request(chunks);
    }
    fn wait_for(&self, chunks: &[u32], patience: Duration) -> Result<(), Incomplete> {
        let deadline = Instant::now() + patience;
        let mut received = self.connection.stats().bytes_total;
        loop {
            let stopped = self.stop.load(Ordering::Relaxed);
            let left = if stopped { Duration::ZERO } else { deadline.saturating_duration_since(Instant::now()) };
            match self.scene.cache.wait(chunks, left.min(ASK_AFTER)) {
                Err(Incomplete::Timeout(missing)) if left > ASK_AFTER => {
                    let before = std::mem::replace(&mut received, self.connection.stats().bytes_total);
                    if received < before + BUSY_BYTES {
                        self.connection.request(&missing);
                    }
                }
                Err(Incomplete::Disconnected(_)) if left > ASK_AFTER => {
                    if let Some(reason) = self.lost_reason(LOST_FOR) {
                        return Err(Incomplete::Disconnected(reason));
                    }
                    std::thread::sleep(ASK_AFTER);
                }
                end => return end,
            }
        }
    }
    fn lost_reason(&self, patience: Duration) -> Option<String> {
        let down_too_long = || self.connection.down_for().is_some_and(|down| down > patience);
        let reason = || self.scene.cache.disconnected().unwrap_or_else(|| "there is no connection".into());
        self.in_vain().or_else(|| down_too_long().then(reason))
    }
    fn holds(&self, chunk: u32) -> bool {
        self.scene.cache.holds(chunk)
    }
    fn traffic(&self) -> Traffic {
        Traffic::of(&self.connection.stats(), &self.scene.cache)
    }
}
