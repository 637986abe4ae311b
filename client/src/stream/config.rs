//! Settings of a connection.

use super::{
    decoder::DecodePool, disk::DiskCache, known_hosts::KnownHosts, other_walkers::OtherWalkers,
    progress::ConnectProgress, simulated_link::LinkSpec, trust::Fingerprint,
};
use crate::cache::Cache;
use ldi_protocol::{
    index::{ChunkHash, Index},
    select::Show,
    wire::Picture,
};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};
use tokio::sync::mpsc;

/// Settings of a connection.
#[derive(Debug, Clone)]
pub struct ConnectConfig {
    /// HOST or HOST:PORT.
    pub server: String,
    /// Name of the dataset to walk in; None: the only one.
    pub dataset: Option<String>,
    /// Expected certificate. None ends in
    /// [`ConnectError::UnknownServer`](super::ConnectError::UnknownServer), which names the one
    /// found.
    pub fingerprint: Option<Fingerprint>,
    /// The certificate that may replace the expected one.
    pub next_fingerprint: Option<Fingerprint>,
    /// Known servers; learns the certificate that will replace the server's.
    pub known_hosts: Option<Arc<KnownHosts>>,
    /// Shared secret, if the server requires one.
    pub token: Option<String>,
    /// Size and field of view of the pictures.
    pub picture: Picture,
    /// The representation to show, which determines what the server sends.
    pub show: Show,
    /// Capacity of the cache, decoded bytes.
    pub cache_bytes: u64,
    /// Radius around the eye in which the server may push data that no view has needed yet, metres;
    /// 0 for none. Larger: fewer gaps when the walk turns or speeds up; more bytes that no frame
    /// uses.
    pub prefetch_m: f64,
    /// Name shown on the server's page.
    pub name: String,
    /// State of an earlier connection: what it holds of the same dataset is not sent again.
    pub resume: Option<ResumeState>,
    /// Disk cache: chunks and manifests in it are not sent again.
    pub disk: Option<Arc<DiskCache>>,
    /// Whether to start with the part of the index that a first picture needs, if there is an LDI
    /// tree. The rest follows ([`Index::is_whole`]).
    pub early: bool,
    /// The index of an earlier connection, to be shared if it is equal.
    pub index: Option<Arc<Index>>,
    /// Number of decoding threads, without a shared pool.
    pub decode_threads: usize,
    /// Decoding threads shared by several connections.
    pub decode_pool: Option<Arc<DecodePool>>,
    /// Whether chunks are decoded. Without decoding they are only verified and counted as held: for
    /// load tests.
    pub decoding: bool,
    /// Receives every chunk that enters the cache.
    pub arrivals: Option<mpsc::UnboundedSender<(u32, Instant)>>,
    /// Simulated link between client and server.
    pub link: Option<LinkSpec>,
    /// Timeout of connecting, and of each step of fetching the manifest.
    pub timeout: Duration,
    /// Progress of connecting.
    pub progress: Arc<ConnectProgress>,
    /// The other walkers' poses.
    pub others: Arc<OtherWalkers>,
}

impl ConnectConfig {
    /// `HOST[:PORT]`, with `/NAME` where a dataset was named.
    pub fn address(&self) -> String {
        let name = self.dataset.as_ref().map_or(String::new(), |name| format!("/{name}"));
        format!("{}{name}", self.server)
    }

    /// Default settings for `HOST[:PORT][/NAME]`, a server and the name of a dataset there, and a
    /// picture.
    pub fn new(server: impl AsRef<str>, picture: Picture) -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let (server, dataset) = match server.as_ref().split_once('/') {
            Some((server, name)) => (server, Some(name.trim_end_matches('/'))),
            None => (server.as_ref(), None),
        };
        Self {
            server: server.into(),
            dataset: dataset.filter(|name| !name.is_empty()).map(str::to_owned),
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
            // Half of the threads render.
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

/// State that a connection leaves for the next one.
#[derive(Debug, Clone)]
pub struct ResumeState {
    /// Name of the dataset.
    pub dataset: ChunkHash,
    /// Received data.
    pub cache: Arc<Cache>,
}
