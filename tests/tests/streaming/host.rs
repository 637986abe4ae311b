//! A server over a dataset in memory, on free ports, in the test's own process.

use crate::fixture::Street;
use bytes::Bytes;
use ldi_client::stream::{ConnectConfig, Connection};
use ldi_protocol::{index::Index, manifest, wire::Picture};
use ldi_server::serve::{ChunkSource, NamedSources, ServeConfig, Server};
use ldi_server::store::StoreError;
use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    path::PathBuf,
    sync::Arc,
    time::Duration,
};
use tokio::runtime::Runtime;

pub const PATIENCE: Duration = Duration::from_secs(20);
pub const PICTURE: Picture = Picture { width: 64, height: 36, fov_deg: None };

/// A dataset that lies nowhere but here.
pub struct Memory {
    index: Arc<Index>,
    root: Vec<u8>,
    pages: Vec<Bytes>,
    chunks: Vec<Bytes>,
}

impl Memory {
    pub fn new(street: Street) -> Self {
        let encoded = manifest::encode(&street.index).unwrap();
        let [pages, chunks] = [encoded.pages, street.chunks].map(|list| list.into_iter().map(Bytes::from).collect());
        Self { index: Arc::new(street.index), root: encoded.root, pages, chunks }
    }
}

impl ChunkSource for Memory {
    fn index(&self) -> &Arc<Index> {
        &self.index
    }
    fn root(&self) -> &[u8] {
        &self.root
    }
    fn pages(&self) -> u32 {
        self.pages.len() as u32
    }
    fn page(&self, number: u32) -> Result<Bytes, StoreError> {
        self.pages.get(number as usize).cloned().ok_or(StoreError::NoSuch { what: "page", number })
    }
    fn chunk(&self, number: u32) -> Result<Bytes, StoreError> {
        self.chunks.get(number as usize).cloned().ok_or(StoreError::NoSuch { what: "chunk", number })
    }
}

/// A dataset alone, under the name that all have here.
pub fn named(dataset: impl ChunkSource) -> NamedSources {
    NamedSources::from([("street".to_owned(), Arc::new(dataset) as Arc<dyn ChunkSource>)])
}

/// A server on free ports, with a runtime and an identity of its own.
pub struct Host {
    pub runtime: Runtime,
    server: Option<Server>,
    settings: ServeConfig,
    folder: PathBuf,
}

impl Host {
    pub fn start(name: &str, dataset: impl ChunkSource) -> Self {
        Self::start_with(name, dataset, ServeConfig::default())
    }

    pub fn start_with(name: &str, dataset: impl ChunkSource, config: ServeConfig) -> Self {
        let folder = folder(name);
        let any = SocketAddr::from(([127, 0, 0, 1], 0));
        let config = ServeConfig { listen: any, http: any.into(), identity: Some(folder.join("identity")), ..config };
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let server = runtime.block_on(Server::start(named(dataset), &config)).unwrap();
        Self { runtime, server: Some(server), settings: config, folder }
    }

    /// Offers newcomers these datasets instead.
    pub fn offer(&mut self, datasets: NamedSources) {
        self.server.as_mut().unwrap().reload(datasets, &self.settings).unwrap();
    }

    /// Offers newcomers another dataset, and token and certificate as they are on disk now.
    pub fn reload(&mut self, dataset: Memory) {
        let server = self.server.as_mut().unwrap();
        server.reload(named(dataset), &self.settings).unwrap();
    }

    /// Folder of the server's identity.
    pub fn identity(&self) -> PathBuf {
        self.folder.join("identity")
    }

    pub fn server(&self) -> &Server {
        self.server.as_ref().unwrap()
    }

    pub fn config(&self) -> ConnectConfig {
        let mut config = ConnectConfig::new(self.server().quic().to_string(), PICTURE);
        config.fingerprint = Some(self.server().fingerprint().parse().unwrap());
        config.prefetch_m = 0.0;
        config
    }

    pub fn connect(&self) -> Connection {
        Connection::connect(self.config()).unwrap()
    }

    pub fn get(&self, path: &str) -> (String, String) {
        let mut stream = TcpStream::connect(self.server().http().expect("HTTP is on")).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        (head.to_owned(), body.to_owned())
    }

    pub fn stop(&mut self) {
        if let Some(server) = self.server.take() {
            let stopped = async { tokio::time::timeout(PATIENCE, server.shutdown()).await };
            self.runtime.block_on(stopped).expect("the server stops in time");
        }
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        self.stop();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// A folder of its own for a test.
pub fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("ldi-streaming-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}
