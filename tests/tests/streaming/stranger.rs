//! Clients that break the rules, on bare QUIC.

use ldi_protocol::{
    Pose,
    wire::{self, ClientMessage, PoseDatagram},
};
pub use ldi_tests::load::stranger::Nonsense;
use ldi_tests::load::stranger::{connect, endpoint};
use quinn::{Connection, Endpoint, RecvStream, SendStream, VarInt};
use std::{
    net::{IpAddr, SocketAddr},
    time::{Duration, Instant},
};

fn hello(version: u16) -> ClientMessage {
    ldi_tests::load::stranger::hello(version, None, crate::PICTURE)
}

async fn come(address: SocketAddr) -> (Endpoint, Connection, SendStream, RecvStream) {
    let endpoint = endpoint(IpAddr::from([127, 0, 0, 1])).unwrap();
    let (connection, send, recv) = connect(&endpoint, address).await.unwrap();
    (endpoint, connection, send, recv)
}

/// Sends nonsense; whether the server ends the connection.
pub async fn sends(address: SocketAddr, what: Nonsense) -> bool {
    let (_endpoint, connection, mut send, _recv) = come(address).await;
    let _ = send.write_all(&what.bytes(hello).unwrap()).await;
    tokio::time::timeout(Duration::from_secs(20), connection.closed()).await.is_ok()
}

/// From an address of its own: comes in, breaks a rule, and comes again until it is not let in.
/// Returns how often it was.
pub async fn comes_again(address: SocketAddr) -> usize {
    let endpoint = endpoint(IpAddr::from([127, 0, 0, 2])).unwrap();
    let mut came_in = 0;
    while let Ok((connection, mut send, _recv)) = connect(&endpoint, address).await {
        came_in += 1;
        let _ = send.write_all(&Nonsense::HelloTwice.bytes(hello).unwrap()).await;
        connection.closed().await;
    }
    came_in
}

/// Sends poses as fast as it can. Returns the code with which the server ends that.
pub async fn floods_with_poses(address: SocketAddr) -> Option<u64> {
    let (_endpoint, connection, mut send, _recv) = come(address).await;
    send.write_all(&wire::encode(&hello(wire::VERSION)).unwrap()).await.unwrap();
    let flood = async {
        for sequence in 1.. {
            let position = glam::DVec3::new(f64::from(sequence) * 1e-3, 0.0, 0.0);
            let pose = Pose { position, yaw_deg: 0.0, pitch_deg: 0.0 };
            let datagram = PoseDatagram { sequence, sent_us: 0, pose };
            let _ = connection.send_datagram_wait(datagram.encode().to_vec().into()).await;
            tokio::task::yield_now().await;
        }
    };
    tokio::select! {
        end = connection.closed() => match end {
            quinn::ConnectionError::ApplicationClosed(close) => Some(close.error_code.into_inner()),
            _ => None,
        },
        () = flood => None,
        () = tokio::time::sleep(Duration::from_secs(20)) => None,
    }
}

/// Lists so many numbers of chunks as what it holds, and then sends what is no message. Returns
/// how long the server took to come to that.
pub async fn lists(address: SocketAddr, numbers: usize) -> Duration {
    let (_endpoint, connection, mut send, _recv) = come(address).await;
    let started = Instant::now();
    send.write_all(&wire::encode(&hello(wire::VERSION)).unwrap()).await.unwrap();
    for first in (0..numbers).step_by(wire::MAX_LIST) {
        let chunks = vec![0; wire::MAX_LIST.min(numbers - first)];
        send.write_all(&wire::encode(&ClientMessage::Have { chunks }).unwrap()).await.unwrap();
    }
    send.write_all(&[255; 4]).await.unwrap();
    connection.closed().await;
    started.elapsed()
}

/// Says hello, looks at something large, and never reads a chunk.
pub async fn reads_nothing(address: SocketAddr) -> (Endpoint, Connection, SendStream, RecvStream) {
    let (endpoint, connection, mut send, recv) = come(address).await;
    send.write_all(&wire::encode(&hello(wire::VERSION)).unwrap()).await.unwrap();
    let pose = Pose { position: glam::DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 };
    let datagram = PoseDatagram { sequence: 1, sent_us: 0, pose };
    connection.send_datagram(datagram.encode().to_vec().into()).unwrap();
    (endpoint, connection, send, recv)
}

/// Datagrams that are no poses and requests that are none: the connection stays, and the answers
/// say what is wrong.
pub async fn sends_bad_datagrams_and_requests(address: SocketAddr) {
    let (_endpoint, connection, mut send, _recv) = come(address).await;
    send.write_all(&wire::encode(&hello(wire::VERSION)).unwrap()).await.unwrap();
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
