//! The client's QUIC endpoint: socket buffers, flow control that bounds memory, the pinned
//! certificate.

use super::{ConnectError, LinkSpec, simulated_socket::SimulatedSocket, trust::PinnedVerifier};
use ldi_protocol::wire::{ALPN, DEFAULT_PORT, PoseDatagram};
use quinn::{ClientConfig, Endpoint, EndpointConfig, IdleTimeout, Runtime as _, TransportConfig, VarInt};
use std::{
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket},
    sync::Arc,
    time::Duration,
};

/// Idle timeout, as the server's.
const IDLE: Duration = Duration::from_secs(30);
/// Interval of keep-alives: address translators forget idle UDP flows.
const KEEP_ALIVE: Duration = Duration::from_secs(8);
/// Largest number of concurrent streams, and thus of chunks per round trip. Smaller: small chunks
/// do not fill a connection with a long round trip; larger: more memory.
pub(super) const MAX_STREAMS: u32 = 512;
/// Flow control window of a stream and of the connection, bytes.
const STREAM_WINDOW: u32 = 1_250_000;
const WINDOW: u32 = 8 << 20;
/// Poses in the send buffer. When it is full the oldest is dropped.
const POSES_WAITING: usize = 4;
const SOCKET_BUFFER_BYTES: usize = 4 << 20;

/// Resolves HOST, HOST:PORT, `[v6]:PORT` or a bare v6 address.
///
/// # Errors
/// If the text is no address, or the name is unknown.
pub fn resolve(text: &str) -> Result<Vec<SocketAddr>, ConnectError> {
    let wrong = |reason: String| ConnectError::Address { address: text.to_owned(), reason };
    let bare_v6 = text.parse::<Ipv6Addr>().is_ok();
    let has_port = !bare_v6 && text.rsplit_once(':').is_some_and(|(host, _)| !host.is_empty() && !text.ends_with(']'));
    let found: Vec<SocketAddr> = if has_port {
        text.to_socket_addrs().map_err(|e| wrong(e.to_string()))?.collect()
    } else {
        let host = text.trim_start_matches('[').trim_end_matches(']');
        (host, DEFAULT_PORT).to_socket_addrs().map_err(|e| wrong(e.to_string()))?.collect()
    };
    if found.is_empty() { Err(wrong("no address".into())) } else { Ok(found) }
}

/// Opens a socket of the right family, with a simulated link if given, and an endpoint. Call within
/// a tokio runtime.
pub(super) fn open(
    remote: SocketAddr,
    verifier: Arc<PinnedVerifier>,
    link: Option<LinkSpec>,
) -> Result<(Endpoint, Option<Arc<SimulatedSocket>>), ConnectError> {
    let local = |e: &dyn std::fmt::Display| ConnectError::Local(e.to_string());
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut crypto = rustls::ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(|e| local(&e))?
        .dangerous()
        .with_custom_certificate_verifier(verifier)
        .with_no_client_auth();
    crypto.alpn_protocols = vec![ALPN.to_vec()];
    let crypto = quinn::crypto::rustls::QuicClientConfig::try_from(crypto).map_err(|e| local(&e))?;
    let mut config = ClientConfig::new(Arc::new(crypto));
    config.transport_config(Arc::new(transport()));

    let any: SocketAddr =
        if remote.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { (Ipv6Addr::UNSPECIFIED, 0).into() };
    let socket = UdpSocket::bind(any).map_err(|e| local(&e))?;
    let buffers = socket2::SockRef::from(&socket);
    if let Err(e) = buffers
        .set_recv_buffer_size(SOCKET_BUFFER_BYTES)
        .and_then(|()| buffers.set_send_buffer_size(SOCKET_BUFFER_BYTES))
    {
        tracing::debug!("socket buffers stay small: {e}");
    }
    let runtime = Arc::new(quinn::TokioRuntime);
    let bare = runtime.wrap_udp_socket(socket).map_err(|e| local(&e))?;
    let link = link.map(|spec| SimulatedSocket::new(bare.clone(), spec));
    let socket = link.clone().map_or(bare, |l| l);
    let mut endpoint =
        Endpoint::new_with_abstract_socket(EndpointConfig::default(), None, socket, runtime).map_err(|e| local(&e))?;
    endpoint.set_default_client_config(config);
    Ok((endpoint, link))
}

fn transport() -> TransportConfig {
    let mut t = TransportConfig::default();
    t.max_idle_timeout(IdleTimeout::try_from(IDLE).ok())
        .keep_alive_interval(Some(KEEP_ALIVE))
        .max_concurrent_uni_streams(VarInt::from_u32(MAX_STREAMS))
        .max_concurrent_bidi_streams(VarInt::from_u32(0))
        .stream_receive_window(VarInt::from_u32(STREAM_WINDOW))
        .receive_window(VarInt::from_u32(WINDOW))
        .datagram_send_buffer_size(POSES_WAITING * PoseDatagram::BYTES);
    t
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_with_and_without_port() {
        let port = |t: &str| resolve(t).map(|a| a[0].port());
        assert_eq!(port("127.0.0.1"), Ok(DEFAULT_PORT));
        assert_eq!(port("127.0.0.1:99"), Ok(99));
        assert_eq!(port("::1"), Ok(DEFAULT_PORT));
        assert_eq!(port("[::1]"), Ok(DEFAULT_PORT));
        assert_eq!(port("[::1]:99"), Ok(99));
        for wrong in ["", "127.0.0.1:port", "127.0.0.1:70000", ":1"] {
            assert!(matches!(resolve(wrong), Err(ConnectError::Address { .. })), "{wrong}");
        }
    }
}
