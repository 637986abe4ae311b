//! Clients that break the rules, on bare QUIC.

use ldi_protocol::{
    Pose,
    wire::{self, ALPN, ClientMessage, Hello, PoseDatagram},
};
use quinn::{ClientConfig, Connection, Endpoint, RecvStream, SendStream, VarInt};
use std::{net::SocketAddr, sync::Arc, time::Duration};

/// What [`sends`] writes on the control stream.
#[derive(Debug, Clone, Copy)]
pub enum Nonsense {
    NoHello,
    RandomBytes,
    ForgedLength,
    HelloTwice,
    ListTooLong,
    TooManyMessages,
    OldVersion,
}

pub const NONSENSE: [Nonsense; 7] = [
    Nonsense::NoHello,
    Nonsense::RandomBytes,
    Nonsense::ForgedLength,
    Nonsense::HelloTwice,
    Nonsense::ListTooLong,
    Nonsense::TooManyMessages,
    Nonsense::OldVersion,
];

fn hello(version: u16) -> Vec<u8> {
    wire::encode(&ClientMessage::Hello(Hello {
        version,
        token: None,
        picture: crate::PICTURE,
        cache_bytes: 1 << 30,
        prefetch_m: 1000.0,
        name: "stranger".into(),
        manifests: vec![],
        portals: Default::default(),
        early: false,
    }))
    .unwrap()
}

async fn connect(address: SocketAddr) -> (Endpoint, Connection, SendStream, RecvStream) {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut tls = rustls::ClientConfig::builder_with_provider(provider.clone())
        .with_protocol_versions(&[&rustls::version::TLS13])
        .unwrap()
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(trusting::Everyone(provider)))
        .with_no_client_auth();
    tls.alpn_protocols = vec![ALPN.to_vec()];
    let tls = quinn::crypto::rustls::QuicClientConfig::try_from(tls).unwrap();
    let mut endpoint = Endpoint::client(SocketAddr::from(([127, 0, 0, 1], 0))).unwrap();
    endpoint.set_default_client_config(ClientConfig::new(Arc::new(tls)));
    let connection = endpoint.connect(address, "ldi-server").unwrap().await.unwrap();
    let (send, recv) = connection.open_bi().await.unwrap();
    (endpoint, connection, send, recv)
}

/// Sends nonsense; whether the server ends the connection.
pub async fn sends(address: SocketAddr, what: Nonsense) -> bool {
    let (_endpoint, connection, mut send, _recv) = connect(address).await;
    let hello_bytes = hello(wire::VERSION);
    let want = wire::encode(&ClientMessage::Want { chunks: vec![0] }).unwrap();
    let bytes = match what {
        Nonsense::NoHello => want,
        Nonsense::RandomBytes => [&30u32.to_le_bytes()[..], &[0xc7; 30]].concat(),
        Nonsense::ForgedLength => [255; 8].to_vec(),
        Nonsense::HelloTwice => [&hello_bytes[..], &hello_bytes].concat(),
        Nonsense::ListTooLong => {
            // A frame within the limit, with a list beyond it.
            let mut list = vec![0x81, 0xa4, b'W', b'a', b'n', b't', 0x81, 0xa6];
            list.extend(b"chunks");
            list.extend([0xdc, 0xff, 0xff]);
            list.extend([0; 65_000]);
            [&hello_bytes[..], &(list.len() as u32).to_le_bytes(), &list].concat()
        }
        Nonsense::TooManyMessages => [&hello_bytes[..], &want.repeat(20_000)].concat(),
        Nonsense::OldVersion => hello(wire::VERSION + 1),
    };
    let _ = send.write_all(&bytes).await;
    tokio::time::timeout(Duration::from_secs(20), connection.closed()).await.is_ok()
}

/// Says hello, looks at something large, and never reads a chunk.
pub async fn reads_nothing(address: SocketAddr) -> (Endpoint, Connection, SendStream, RecvStream) {
    let (endpoint, connection, mut send, recv) = connect(address).await;
    send.write_all(&hello(wire::VERSION)).await.unwrap();
    let pose = Pose { position: glam::DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 };
    let datagram = PoseDatagram { sequence: 1, sent_us: 0, pose };
    connection.send_datagram(datagram.encode().to_vec().into()).unwrap();
    (endpoint, connection, send, recv)
}

/// Datagrams that are no poses and requests that are none: the connection stays, and the answers say what is wrong.
pub async fn sends_bad_datagrams_and_requests(address: SocketAddr) {
    let (_endpoint, connection, mut send, _recv) = connect(address).await;
    send.write_all(&hello(wire::VERSION)).await.unwrap();
    for i in 0..100u8 {
        connection.send_datagram(vec![i; usize::from(i)].into()).unwrap();
    }
    for bytes in [vec![], vec![1, 0, 0, 0, 0xc1], vec![255; 4]] {
        let (mut ask, mut answer) = connection.open_bi().await.unwrap();
        ask.write_all(&bytes).await.unwrap();
        ask.finish().unwrap();
        let answer = answer.read_to_end(4096).await.unwrap();
        let answer = wire::decode::<wire::Answer>(&answer[4..]).unwrap();
        assert!(matches!(answer, wire::Answer::Error { .. }), "{bytes:?}: {answer:?}");
    }
    assert!(connection.close_reason().is_none());
    connection.close(VarInt::from_u32(0), b"");
}

mod trusting {
    //! Certificates do not matter to a stranger.

    use rustls::{
        DigitallySignedStruct, Error, SignatureScheme,
        client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
        crypto::CryptoProvider,
        pki_types::{CertificateDer, ServerName, UnixTime},
    };
    use std::sync::Arc;

    #[derive(Debug)]
    pub struct Everyone(pub Arc<CryptoProvider>);

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
}
