//! The handshake: connects to an address and fetches the manifest.

use super::{
    ConnectConfig, ConnectError, Fingerprint, ResumeState,
    chunk_stream::{self, StreamError},
    index_pages::{IndexPages, is_listed},
    progress::Phase,
    simulated_socket::SimulatedSocket,
    transport,
    trust::PinnedVerifier,
};
use ldi_protocol::{
    index::{ChunkHash, Index},
    manifest::{self, Root},
    wire::{self, ClientMessage, Hello, MAX_MANIFESTS, MAX_ROOT_BYTES, Message, RefusalCode, ServerMessage, Welcome},
};
use quinn::{Connection, ConnectionError, Endpoint, RecvStream, SendStream};
use std::{net::SocketAddr, sync::Arc, time::Duration};
use tokio::time::timeout;

/// How long a busy server is asked again. Longer: a full server is reported later; shorter: a
/// client that comes together with many others is turned away.
const BUSY_PATIENCE: Duration = Duration::from_secs(3);
/// Time between two attempts at a busy server.
const BUSY_PAUSE: Duration = Duration::from_millis(300);

/// An open connection with its manifest.
pub(super) struct Opened {
    pub endpoint: Endpoint,
    pub link: Option<Arc<SimulatedSocket>>,
    pub connection: Connection,
    pub send: SendStream,
    pub recv: RecvStream,
    pub dataset: ChunkHash,
    pub index: Arc<Index>,
    /// The pages that have arrived, if the index is a partial one.
    pub rest: Option<IndexPages>,
    /// Whether the server sends the other walkers' poses.
    pub tells_others: bool,
}

/// Connects to the first address that answers. A busy server is asked again for [`BUSY_PATIENCE`]:
/// newcomers at the same time, or strangers who say nothing, keep it busy for a second at most.
pub(super) async fn open(config: &ConnectConfig) -> Result<Opened, ConnectError> {
    config.progress.enter(Phase::Dialling);
    let addresses = transport::resolve(&config.server)?;
    let began = tokio::time::Instant::now();
    loop {
        let end = open_once(config, &addresses).await;
        if !matches!(end, Err(ConnectError::Busy)) || began.elapsed() + BUSY_PAUSE > BUSY_PATIENCE {
            return end;
        }
        tokio::time::sleep(BUSY_PAUSE).await;
    }
}

async fn open_once(config: &ConnectConfig, addresses: &[SocketAddr]) -> Result<Opened, ConnectError> {
    let mut last = None;
    for &address in addresses {
        match dial(config, address).await {
            Ok(dialed) => return converse(config, dialed).await,
            // Only a missing answer makes another address worth trying.
            Err(e @ ConnectError::Unreachable { .. }) => last = Some(e),
            Err(e) => return Err(e),
        }
    }
    Err(last.unwrap_or_else(|| ConnectError::Local("no address".into())))
}

type Dialed = (Endpoint, Option<Arc<SimulatedSocket>>, Connection);

async fn dial(config: &ConnectConfig, address: SocketAddr) -> Result<Dialed, ConnectError> {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let verifier = PinnedVerifier::new(config.fingerprint, config.next_fingerprint, provider);
    let (endpoint, link) = transport::open(address, verifier.clone(), config.link)?;
    let unreachable = |reason: String| ConnectError::Unreachable { address: address.to_string(), reason };
    let connecting = endpoint.connect(address, "ldi-server").map_err(|e| unreachable(e.to_string()))?;
    match timeout(config.timeout, connecting).await {
        Ok(Ok(connection)) => Ok((endpoint, link, connection)),
        Ok(Err(e)) => Err(verifier.refusal().unwrap_or_else(|| match e {
            ConnectionError::ConnectionClosed(c) if c.error_code == quinn::TransportErrorCode::CONNECTION_REFUSED => {
                ConnectError::Busy
            }
            ConnectionError::VersionMismatch => ConnectError::Protocol("another version of QUIC".into()),
            e => unreachable(e.to_string()),
        })),
        Err(_) => Err(unreachable(format!("no answer within {} s", config.timeout.as_secs_f64()))),
    }
}

/// A step of the conversation with its own timeout: a large manifest takes long over a slow
/// connection, but data keeps arriving.
async fn step<T>(
    config: &ConnectConfig,
    what: impl Future<Output = Result<T, ConnectError>>,
) -> Result<T, ConnectError> {
    let late = || ConnectError::Lost(format!("nothing of the manifest came for {} s", config.timeout.as_secs_f64()));
    timeout(config.timeout, what).await.unwrap_or_else(|_| Err(late()))
}

async fn converse(config: &ConnectConfig, (endpoint, link, connection): Dialed) -> Result<Opened, ConnectError> {
    let (mut send, mut recv) = connection.open_bi().await.map_err(|e| lost(&e))?;
    let known = config.disk.as_ref().map_or_else(Vec::new, |d| d.manifests());
    // A manifest in memory, from an earlier connection.
    let resumed = config.resume.as_ref().filter(|k| k.cache.index().is_whole());
    let names = resumed.map(|k| k.dataset).into_iter().chain(known.iter().map(|(root, _)| root.hash));
    let names = names.take(MAX_MANIFESTS).collect();
    let hello = ClientMessage::Hello(Hello {
        version: wire::VERSION,
        token: config.token.clone(),
        picture: config.picture,
        cache_bytes: config.cache_bytes,
        prefetch_m: config.prefetch_m,
        name: config.name.clone(),
        manifests: names,
        portals: config.show.portals,
        far: config.show.far,
        dataset: config.dataset.clone(),
        early: config.early,
        replacements: true,
    });
    let hello = wire::encode(&hello).map_err(|e| ConnectError::Local(e.to_string()))?;
    config.progress.enter(Phase::Asking);
    // The server may refuse before the message is sent: reading returns the reason.
    let _ = send.write_all(&hello).await;
    let welcome = match step(config, read_message::<ServerMessage>(&mut recv, &connection)).await? {
        ServerMessage::Welcome(w) => w,
        ServerMessage::Refused { code, message } => return Err(ConnectError::refused(code, message)),
        ServerMessage::Unavailable { .. } | ServerMessage::Others { .. } | ServerMessage::Replaced => {
            return Err(ConnectError::Protocol("no welcome".into()));
        }
    };
    if let (Some(known), Some(next)) = (&config.known_hosts, welcome.next_certificate)
        && let Err(e) = known.learn(&config.server, Fingerprint(next.0))
    {
        tracing::warn!("the server's next certificate is not remembered: {e}");
    }
    let dataset = welcome.dataset;
    let (index, rest) = match welcome.root_bytes {
        0 => (named(resumed, &known, dataset)?, None),
        _ => {
            let (index, rest) = fetch_manifest(config, &welcome, &mut recv, &connection).await?;
            (Arc::new(index), rest)
        }
    };
    Ok(Opened { endpoint, link, connection, send, recv, dataset, index, rest, tells_others: welcome.others })
}

/// The index of a dataset whose manifest was named in the hello.
fn named(
    resumed: Option<&ResumeState>,
    known: &[(Root, Vec<Vec<u8>>)],
    dataset: ChunkHash,
) -> Result<Arc<Index>, ConnectError> {
    if let Some(kept) = resumed.filter(|k| k.dataset == dataset) {
        return Ok(kept.cache.index().clone());
    }
    let unknown = || ConnectError::Protocol("no manifest, and none was named that is this one's".into());
    let (root, pages) = known.iter().find(|(root, _)| root.hash == dataset).ok_or_else(unknown)?;
    manifest::assemble(root, pages).map(Arc::new).map_err(|e| ConnectError::Protocol(e.to_string()))
}

/// Fetches the index, and returns the pages still to come if it is a partial one.
async fn fetch_manifest(
    config: &ConnectConfig,
    welcome: &Welcome,
    recv: &mut RecvStream,
    connection: &Connection,
) -> Result<(Index, Option<IndexPages>), ConnectError> {
    let protocol = |reason: String| ConnectError::Protocol(reason);
    let mut pages = IndexPages::new(step(config, read_frame(recv, connection, MAX_ROOT_BYTES)).await?, welcome)?;
    config.progress.pages(pages.stored_bytes());
    let listed = pages.listed();
    while !pages.are_whole() {
        let page = async {
            let mut stream = connection.accept_uni().await.map_err(|_| StreamError::Off { bytes: 0 })?;
            let header = chunk_stream::header(&mut stream).await?;
            if !is_listed(&listed, &header) {
                return Err(StreamError::Wrong("not a page of the manifest".into()));
            }
            Ok((header.number, chunk_stream::body(&mut stream, &header).await?))
        };
        let page = async {
            page.await.map_err(|e| match connection.close_reason() {
                Some(reason) => lost(&reason),
                None => protocol(e.to_string()),
            })
        };
        let (number, body) = step(config, page).await?;
        config.progress.page(body.len() as u64);
        pages.take(number, body);
        if config.early
            && !pages.are_whole()
            && let Some(index) = pages.early()?
        {
            return Ok((index, Some(pages)));
        }
    }
    config.progress.enter(Phase::Assembling);
    Ok((pages.assemble(config.disk.as_deref())?, None))
}

/// Reads the next message of the control stream.
pub(super) async fn read_message<M: Message>(
    recv: &mut RecvStream,
    connection: &Connection,
) -> Result<M, ConnectError> {
    let body = read_frame(recv, connection, M::LIMIT).await?;
    wire::decode(&body).map_err(|e| ConnectError::Protocol(e.to_string()))
}

async fn read_frame(recv: &mut RecvStream, connection: &Connection, limit: usize) -> Result<Vec<u8>, ConnectError> {
    let mut prefix = [0; 4];
    let mut body = Vec::new();
    let read = async {
        recv.read_exact(&mut prefix).await.map_err(|e| ConnectError::Lost(e.to_string()))?;
        let length = wire::frame_length(prefix, limit).map_err(|e| ConnectError::Protocol(e.to_string()))?;
        body.resize(length, 0);
        recv.read_exact(&mut body).await.map_err(|e| ConnectError::Lost(e.to_string()))
    };
    match read.await {
        Ok(()) => Ok(body),
        Err(e @ ConnectError::Protocol(_)) => Err(e),
        // The stream ends before the connection does, which holds the reason.
        Err(e) => Err(match timeout(Duration::from_millis(500), connection.closed()).await {
            Ok(reason) => lost(&reason),
            Err(_) => e,
        }),
    }
}

/// Converts the end of a connection to an error.
pub(super) fn lost(e: &ConnectionError) -> ConnectError {
    let ConnectionError::ApplicationClosed(close) = e else { return ConnectError::Lost(e.to_string()) };
    let message = String::from_utf8_lossy(&close.reason).into_owned();
    let refusals =
        [RefusalCode::Token, RefusalCode::Version, RefusalCode::Busy, RefusalCode::Protocol, RefusalCode::Rate];
    match refusals.into_iter().find(|c| u64::from(*c as u32) == close.error_code.into_inner()) {
        Some(code) => ConnectError::refused(code, message),
        None => ConnectError::Lost(message),
    }
}
