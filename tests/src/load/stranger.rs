//! Bare QUIC to a server, without the client's manners: any certificate is taken, and what is said
//! is up to the caller.

use ldi_protocol::{
    room_index::ShowPortals,
    select::FarBy,
    wire::{self, ALPN, ClientMessage, Hello, Picture},
};
use quinn::{ClientConfig, Connection, Endpoint, RecvStream, SendStream, TransportConfig, VarInt};
use rustls::{
    DigitallySignedStruct, Error, SignatureScheme,
    client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
    crypto::CryptoProvider,
    pki_types::{CertificateDer, ServerName, UnixTime},
};
use std::{
    io,
    net::{IpAddr, SocketAddr},
    sync::Arc,
    time::Duration,
};

/// Streams that the server may have open to a stranger, as to a client.
const STREAMS: u32 = 512;
/// Below the server's patience with silent connections: a stranger goes when it is told to.
const KEEP_ALIVE: Duration = Duration::from_secs(8);

/// An endpoint at an address of this machine, for any number of connections.
///
/// # Errors
/// An address that is not this machine's, or no socket left.
pub fn endpoint(from: IpAddr) -> io::Result<Endpoint> {
    let mut endpoint = Endpoint::client(SocketAddr::from((from, 0)))?;
    endpoint.set_default_client_config(client_config()?);
    Ok(endpoint)
}

fn client_config() -> io::Result<ClientConfig> {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut tls = rustls::ClientConfig::builder_with_provider(provider.clone())
        .with_protocol_versions(&[&rustls::version::TLS13])
        .map_err(io::Error::other)?
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(Everyone(provider)))
        .with_no_client_auth();
    tls.alpn_protocols = vec![ALPN.to_vec()];
    let tls = quinn::crypto::rustls::QuicClientConfig::try_from(tls).map_err(io::Error::other)?;
    let mut config = ClientConfig::new(Arc::new(tls));
    let mut transport = TransportConfig::default();
    transport.max_concurrent_uni_streams(VarInt::from_u32(STREAMS)).keep_alive_interval(Some(KEEP_ALIVE));
    config.transport_config(Arc::new(transport));
    Ok(config)
}

/// First packets of handshakes that nobody finishes.
pub struct Initials {
    endpoint: quinn_proto::Endpoint,
    config: ClientConfig,
    server: SocketAddr,
}

impl Initials {
    /// For a server.
    ///
    /// # Errors
    /// None but those of TLS settings.
    pub fn new(server: SocketAddr) -> io::Result<Self> {
        let endpoint = quinn_proto::Endpoint::new(Arc::default(), None, true, None);
        Ok(Self { endpoint, config: client_config()?, server })
    }

    /// A datagram with the Initial of one more connection, which is forgotten at once.
    ///
    /// # Errors
    /// None for a server's address.
    pub fn initial(&mut self) -> io::Result<Vec<u8>> {
        let now = std::time::Instant::now();
        let connect = self.endpoint.connect(now, self.config.clone(), self.server, "ldi-server");
        let (handle, mut connection) = connect.map_err(io::Error::other)?;
        let mut datagram = Vec::new();
        if connection.poll_transmit(now, 1, &mut datagram).is_none() {
            return Err(io::Error::other("the connection sends no Initial"));
        }
        self.endpoint.handle_event(handle, quinn_proto::EndpointEvent::drained());
        Ok(datagram)
    }
}

/// A connection with its control stream open. Nothing is said yet.
///
/// # Errors
/// A server that does not answer or refuses.
pub async fn connect(endpoint: &Endpoint, server: SocketAddr) -> io::Result<(Connection, SendStream, RecvStream)> {
    let connection = endpoint.connect(server, "ldi-server").map_err(io::Error::other)?.await?;
    let (send, recv) = connection.open_bi().await?;
    Ok((connection, send, recv))
}

/// The first message, as a client says it.
pub fn hello(version: u16, token: Option<String>, picture: Picture) -> ClientMessage {
    ClientMessage::Hello(Hello {
        version,
        token,
        picture,
        cache_bytes: 1 << 30,
        prefetch_m: 1000.0,
        name: "stranger".into(),
        manifests: vec![],
        portals: ShowPortals::default(),
        far: FarBy::default(),
        dataset: None,
        early: false,
        replacements: false,
    })
}

/// What no client says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Nonsense {
    /// Something else first.
    NoHello,
    /// A frame that is no message.
    RandomBytes,
    /// A frame that says it is 4 GB long.
    ForgedLength,
    /// The first message once more.
    HelloTwice,
    /// A frame within the limit, with a list beyond it.
    ListTooLong,
    /// More than the server's rate allows.
    TooManyMessages,
    /// A later version.
    OtherVersion,
}

impl Nonsense {
    /// All kinds.
    pub const ALL: [Self; 7] = [
        Self::NoHello,
        Self::RandomBytes,
        Self::ForgedLength,
        Self::HelloTwice,
        Self::ListTooLong,
        Self::TooManyMessages,
        Self::OtherVersion,
    ];

    /// The bytes of the control stream. `hello`: makes the first message of a version, encoded.
    ///
    /// # Errors
    /// None for messages that can be encoded.
    pub fn bytes(self, hello: impl Fn(u16) -> ClientMessage) -> Result<Vec<u8>, wire::WireError> {
        let first = wire::encode(&hello(wire::VERSION))?;
        let want = wire::encode(&ClientMessage::Want { chunks: vec![0] })?;
        Ok(match self {
            Self::NoHello => want,
            Self::RandomBytes => [&30u32.to_le_bytes()[..], &[0xc7; 30]].concat(),
            Self::ForgedLength => [255; 8].to_vec(),
            Self::HelloTwice => [&first[..], &first].concat(),
            Self::ListTooLong => {
                let mut list = vec![0x81, 0xa4, b'W', b'a', b'n', b't', 0x81, 0xa6];
                list.extend(b"chunks");
                list.extend([0xdc, 0xff, 0xff]);
                list.extend([0; 65_000]);
                [&first[..], &(list.len() as u32).to_le_bytes(), &list].concat()
            }
            Self::TooManyMessages => [&first[..], &want.repeat(20_000)].concat(),
            Self::OtherVersion => wire::encode(&hello(wire::VERSION + 1))?,
        })
    }
}

/// Certificates do not matter to a stranger.
#[derive(Debug)]
struct Everyone(Arc<CryptoProvider>);

impl ServerCertVerifier for Everyone {
    fn verify_server_cert(
        &self,
        _: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        Ok(ServerCertVerified::assertion())
    }
    fn verify_tls12_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        Ok(HandshakeSignatureValid::assertion())
    }
    fn verify_tls13_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        Ok(HandshakeSignatureValid::assertion())
    }
    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.0.signature_verification_algorithms.supported_schemes()
    }
}
