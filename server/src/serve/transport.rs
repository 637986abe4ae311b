//! The QUIC endpoint: TLS by the server's own certificate, socket buffers, windows and limits.

use super::{
    config::{Congestion, ServeConfig},
    error::ServeError,
    identity::Identity,
    meter::MeteredConfig,
    veno::VenoConfig,
};
use ldi_protocol::wire::ALPN;
use quinn::{
    Endpoint, EndpointConfig, IdleTimeout, ServerConfig, TransportConfig, VarInt, congestion,
    congestion::ControllerFactory,
};
use std::{
    net::{SocketAddr, UdpSocket},
    sync::Arc,
    time::Duration,
};

/// A client that says nothing for this long is gone. Longer: dead walkers hold their places;
/// shorter: a bad Wi-Fi moment ends a walk.
const IDLE: Duration = Duration::from_secs(30);
/// Requests by number or name that one client may have open.
const MAX_REQUESTS: u32 = 64;
/// What a client may send ahead on one stream: control frames and requests are small.
const CLIENT_STREAM_WINDOW: u32 = 256 * 1024;
/// Poses that wait in the connection: 64 of 56 bytes; the oldest give way.
const POSE_BUFFER_BYTES: usize = 64 * 56;

/// QUIC's settings with a certificate.
///
/// # Errors
/// A certificate or key that TLS refuses.
pub fn settings(config: &ServeConfig, identity: &Identity) -> Result<ServerConfig, ServeError> {
    let tls = |e: &dyn std::fmt::Display| ServeError::Tls(e.to_string());
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut crypto = rustls::ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(|e| tls(&e))?
        .with_no_client_auth()
        .with_single_cert(identity.certificates.clone(), identity.key.clone_key())
        .map_err(|e| tls(&e))?;
    crypto.alpn_protocols = vec![ALPN.to_vec()];
    // Early data could be replayed; a saved round trip on a LAN is not worth the thought.
    crypto.max_early_data_size = 0;
    let crypto = quinn::crypto::rustls::QuicServerConfig::try_from(crypto).map_err(|e| tls(&e))?;
    let mut server = ServerConfig::with_crypto(Arc::new(crypto));
    server.transport_config(Arc::new(transport(config)));
    // First packets that wait for the accept loop; those beyond are sent again by their clients.
    server.max_incoming(config.max_connections.min(1 << 16));
    Ok(server)
}

/// Binds the socket and opens the endpoint.
///
/// # Errors
/// An address that cannot be bound.
pub fn open(config: &ServeConfig, server: ServerConfig) -> Result<(Endpoint, SocketAddr), ServeError> {
    let bind = |source| ServeError::Bind { what: "QUIC", address: config.listen, source };
    let socket = UdpSocket::bind(config.listen).map_err(bind)?;
    let address = socket.local_addr().map_err(bind)?;
    enlarge_buffers(&socket);
    let runtime = Arc::new(quinn::TokioRuntime);
    let endpoint = Endpoint::new(EndpointConfig::default(), Some(server), socket, runtime).map_err(bind)?;
    Ok((endpoint, address))
}

/// 4 MB each way: the usual 212 KB lose packets as soon as a burst comes. The system may grant
/// less.
fn enlarge_buffers(socket: &UdpSocket) {
    const BYTES: usize = 4 << 20;
    let socket = socket2::SockRef::from(socket);
    if let Err(e) = socket.set_recv_buffer_size(BYTES).and_then(|()| socket.set_send_buffer_size(BYTES)) {
        tracing::warn!("socket buffers stay small ({e}); raise net.core.rmem_max and net.core.wmem_max");
    }
}

fn transport(config: &ServeConfig) -> TransportConfig {
    let mut t = TransportConfig::default();
    t.max_idle_timeout(IdleTimeout::try_from(IDLE).ok())
        .max_concurrent_bidi_streams(VarInt::from_u32(MAX_REQUESTS))
        .max_concurrent_uni_streams(VarInt::from_u32(0))
        .stream_receive_window(VarInt::from_u32(CLIENT_STREAM_WINDOW))
        .receive_window(VarInt::from_u32(4 * CLIENT_STREAM_WINDOW))
        .datagram_receive_buffer_size(Some(POSE_BUFFER_BYTES))
        .send_window(config.send_window)
        // One stream after another: what is half there is of no use.
        .send_fairness(false);
    match config.congestion {
        Congestion::Cubic => control(&mut t, congestion::CubicConfig::default()),
        Congestion::NewReno => control(&mut t, congestion::NewRenoConfig::default()),
        Congestion::Veno => control(&mut t, VenoConfig),
        Congestion::Bbr => control(&mut t, congestion::BbrConfig::default()),
    }
    t
}

/// Sets a controller, with a meter around it.
fn control<F: ControllerFactory + Send + Sync + 'static>(t: &mut TransportConfig, controller: F) {
    t.congestion_controller_factory(Arc::new(MeteredConfig(Arc::new(controller))));
}
