//! A bare QUIC transfer to compare with: what the transport alone costs its sender, on this
//! machine, in this run.
//!
//! The sender is this program again, in a process of its own ([`serve`]), so that its processor
//! time can be read apart from ours. It has the same socket buffers and windows as `ldi-server`
//! and `ldi-client`, writes one stream from memory, and ends when its standard input does.

use super::{LoadError, process::Process};
use quinn::{ClientConfig, Endpoint, EndpointConfig, ServerConfig, TransportConfig, VarInt};
use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::{SocketAddr, UdpSocket},
    process::{Child, Command, Stdio},
    sync::Arc,
    time::Duration,
};

/// The hidden first argument that starts the sender.
pub const SERVE: &str = "--raw-quic-server";
/// How long bytes flow. Processor time is read to a hundredth of a second: an error below one in a
/// hundred.
const MEASURE: Duration = Duration::from_secs(2);
/// Bytes flow this long before: the congestion window has opened.
const WARM_UP: Duration = Duration::from_millis(300);
/// Time for the sender to start.
const PATIENCE: Duration = Duration::from_secs(10);
/// As `ldi-server` and `ldi-client` have them.
const SOCKET_BUFFER_BYTES: usize = 4 << 20;
const SEND_WINDOW: u64 = 4 << 20;
const STREAM_WINDOW: u32 = 1_250_000;
const WINDOW: u32 = 8 << 20;
const SLICE: usize = 64 * 1024;

/// What the transfer took.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Raw {
    /// Received UDP payload, as of the walkers.
    pub bytes: u64,
    /// The sender's processor seconds.
    pub server_cpu_s: f64,
    /// Wall seconds.
    pub seconds: f64,
}

fn failed(e: impl std::fmt::Display) -> LoadError {
    LoadError::Raw(e.to_string())
}

fn socket() -> Result<UdpSocket, LoadError> {
    let socket = UdpSocket::bind(SocketAddr::from(([127, 0, 0, 1], 0))).map_err(failed)?;
    let buffers = socket2::SockRef::from(&socket);
    // The system may grant less, as it may to the server.
    let _ = buffers.set_recv_buffer_size(SOCKET_BUFFER_BYTES);
    let _ = buffers.set_send_buffer_size(SOCKET_BUFFER_BYTES);
    Ok(socket)
}

fn provider() -> Arc<rustls::crypto::CryptoProvider> {
    Arc::new(rustls::crypto::ring::default_provider())
}

/// The sender: prints its address and certificate, sends to whoever connects, ends with its
/// standard input.
///
/// # Errors
/// What keeps it from listening.
pub fn serve() -> Result<(), LoadError> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(failed)?;
    let _guard = runtime.enter();
    let made = rcgen::generate_simple_self_signed(vec!["localhost".into()]).map_err(failed)?;
    let key = rustls::pki_types::PrivatePkcs8KeyDer::from(made.signing_key.serialize_der());
    let crypto = rustls::ServerConfig::builder_with_provider(provider())
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(failed)?
        .with_no_client_auth()
        .with_single_cert(vec![made.cert.der().clone()], key.into())
        .map_err(failed)?;
    let crypto = quinn::crypto::rustls::QuicServerConfig::try_from(crypto).map_err(failed)?;
    let mut server = ServerConfig::with_crypto(Arc::new(crypto));
    let mut transport = TransportConfig::default();
    transport.send_window(SEND_WINDOW);
    server.transport_config(Arc::new(transport));
    let socket = socket()?;
    let address = socket.local_addr().map_err(failed)?;
    let endpoint = Endpoint::new(EndpointConfig::default(), Some(server), socket, Arc::new(quinn::TokioRuntime))
        .map_err(failed)?;
    let certificate: String = made.cert.der().iter().map(|b| format!("{b:02x}")).collect();
    let mut out = std::io::stdout().lock();
    writeln!(out, "{address} {certificate}").and_then(|()| out.flush()).map_err(failed)?;
    runtime.spawn(async move {
        let bytes = vec![0x5au8; SLICE];
        while let Some(incoming) = endpoint.accept().await {
            let Ok(connection) = incoming.await else { continue };
            let Ok(mut stream) = connection.open_uni().await else { continue };
            while stream.write_all(&bytes).await.is_ok() {}
        }
    });
    let _ = std::io::stdin().read_to_end(&mut Vec::new());
    Ok(())
}

/// The sender's process; gone with this.
struct Sender {
    child: Child,
    address: SocketAddr,
    certificate: Vec<u8>,
}

impl Sender {
    fn start() -> Result<Self, LoadError> {
        let program = std::env::current_exe().map_err(failed)?;
        let mut child = Command::new(program)
            .arg(SERVE)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .map_err(failed)?;
        let mut line = String::new();
        let read = child.stdout.take().map(|out| BufReader::new(out).read_line(&mut line));
        let mut words = line.split_whitespace();
        let (address, hex) = (words.next().and_then(|w| w.parse().ok()), words.next().unwrap_or_default());
        let certificate: Option<Vec<u8>> = (0..hex.len() / 2)
            .map(|i| hex.get(2 * i..2 * i + 2).and_then(|h| u8::from_str_radix(h, 16).ok()))
            .collect();
        match (read, address, certificate) {
            (Some(Ok(_)), Some(address), Some(certificate)) => Ok(Self { child, address, certificate }),
            _ => {
                let _ = child.kill();
                let _ = child.wait();
                Err(failed("the sending process did not start"))
            }
        }
    }
}

impl Drop for Sender {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Measures.
///
/// # Errors
/// Whatever keeps it from doing so; the report then has null and this reason.
pub async fn measure() -> Result<Raw, LoadError> {
    let sender = tokio::task::spawn_blocking(Sender::start).await.map_err(failed)??;
    let process = Process(sender.child.id());
    let mut roots = rustls::RootCertStore::empty();
    roots.add(sender.certificate.clone().into()).map_err(failed)?;
    let crypto = rustls::ClientConfig::builder_with_provider(provider())
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(failed)?
        .with_root_certificates(roots)
        .with_no_client_auth();
    let crypto = quinn::crypto::rustls::QuicClientConfig::try_from(crypto).map_err(failed)?;
    let mut config = ClientConfig::new(Arc::new(crypto));
    let mut transport = TransportConfig::default();
    transport.stream_receive_window(VarInt::from_u32(STREAM_WINDOW)).receive_window(VarInt::from_u32(WINDOW));
    config.transport_config(Arc::new(transport));
    let endpoint =
        Endpoint::new(EndpointConfig::default(), None, socket()?, Arc::new(quinn::TokioRuntime)).map_err(failed)?;
    let connecting = endpoint.connect_with(config, sender.address, "localhost").map_err(failed)?;
    let connection = tokio::time::timeout(PATIENCE, connecting).await.map_err(failed)?.map_err(failed)?;
    let mut stream = tokio::time::timeout(PATIENCE, connection.accept_uni()).await.map_err(failed)?.map_err(failed)?;
    let sink = tokio::spawn(async move { while let Ok(Some(_)) = stream.read_chunk(usize::MAX, true).await {} });
    tokio::time::sleep(WARM_UP).await;
    let now = || Some((connection.stats().udp_rx.bytes, process.cpu_s()?, std::time::Instant::now()));
    let unknown = || failed("this system does not tell a process's processor time");
    let (bytes, cpu, start) = now().ok_or_else(unknown)?;
    tokio::time::sleep(MEASURE).await;
    let (bytes_then, cpu_then, end) = now().ok_or_else(unknown)?;
    connection.close(VarInt::from_u32(0), b"");
    let _ = sink.await;
    Ok(Raw { bytes: bytes_then - bytes, server_cpu_s: cpu_then - cpu, seconds: (end - start).as_secs_f64() })
}
