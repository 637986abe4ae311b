//! Connections that want the server no good, beside the walkers: what they cost the others shows
//! in the walkers' figures.
//!
//! Each behaves in one [`Manner`] until the end of the run; thrown out, it comes again.

use super::{
    stranger::{self, Initials, Nonsense},
    track::Track,
};
use ldi_protocol::wire::{self, ClientMessage, MAX_LIST, Picture, PoseDatagram, Request};
use quinn::{Connection, Endpoint, RecvStream, SendStream, VarInt};
use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr},
    sync::Arc,
    time::{Duration, Instant},
};
use tokio::{
    net::UdpSocket,
    time::{interval, sleep, timeout_at},
};

/// Whoever is thrown out or refused comes again after this time.
const AGAIN: Duration = Duration::from_millis(100);
/// Between two poses of one who floods: far more than the server takes.
const FLOOD_POSES: Duration = Duration::from_millis(1);
/// Between two poses of one who is greedy: just below the server's limit of 250 per second, beyond
/// which it would be thrown out.
const GREEDY_POSES: Duration = Duration::from_millis(5);
/// Between two messages of both: just below the server's usual limit of 500 per second, beyond
/// which it would be thrown out.
const FLOOD_MESSAGES: Duration = Duration::from_micros(2_500);
/// Requests that both have open: as many as the server allows.
const FLOOD_REQUESTS: u32 = 64;
/// Between two bites of one who is slow, and their size.
const SLOW_EVERY: Duration = Duration::from_millis(100);
const SLOW_BYTES: usize = 1024;
/// Between two bursts of one who finishes no handshake, and their packets.
const UNFINISHED_EVERY: Duration = Duration::from_millis(100);
const UNFINISHED: usize = 16;

/// How a hostile connection behaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Manner {
    /// Comes in and says nothing.
    Silent,
    /// Walks and asks for large chunks, but reads a kilobyte now and then.
    Slow,
    /// Asks for everything again and again, as fast as it can, and reads it.
    Flooding,
    /// The same, but breaks no rule: below every limit.
    Greedy,
    /// Says what is no message.
    Malformed,
    /// Sends the first packets of handshakes and never finishes one, from the walkers' address.
    Unfinished,
}

/// What they know of the server.
#[derive(Debug)]
pub struct Siege {
    /// Where it is.
    pub server: SocketAddr,
    /// The secret: whoever has none is refused at the door, which is no danger.
    pub token: Option<String>,
    /// What they say they draw.
    pub picture: Picture,
    /// Its chunks, largest first.
    pub chunks: Vec<u32>,
    /// When everyone stops.
    pub end: Instant,
}

/// What became of the connections of one manner.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Toll {
    /// Connections that stood.
    pub came_in: u64,
    /// Those that the server ended.
    pub thrown_out: u64,
    /// Connections that never stood.
    pub turned_away: u64,
    /// Received on the wire.
    pub bytes: u64,
}

impl std::ops::AddAssign for Toll {
    fn add_assign(&mut self, other: Self) {
        self.came_in += other.came_in;
        self.thrown_out += other.thrown_out;
        self.turned_away += other.turned_away;
        self.bytes += other.bytes;
    }
}

/// Where they come from: on loopback another address than the walkers', as another machine would.
pub fn address(server: SocketAddr) -> IpAddr {
    match server {
        SocketAddr::V4(a) if a.ip().is_loopback() => Ipv4Addr::new(127, 0, 0, 2).into(),
        SocketAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
        SocketAddr::V6(_) => std::net::Ipv6Addr::UNSPECIFIED.into(),
    }
}

impl Siege {
    /// One of them, until the end. `number`: tells it from the others.
    pub async fn send(self: Arc<Self>, endpoint: Endpoint, manner: Manner, number: usize, track: Track) -> Toll {
        let mut toll = Toll::default();
        if manner == Manner::Unfinished {
            toll.turned_away = self.leave_unfinished().await;
            return toll;
        }
        let mut visit = number;
        while Instant::now() < self.end {
            visit += 1;
            match timeout_at(self.end.into(), stranger::connect(&endpoint, self.server)).await {
                Err(_) => break,
                Ok(Err(_)) => toll.turned_away += 1,
                Ok(Ok((connection, send, recv))) => {
                    toll.came_in += 1;
                    let stay = self.behave(manner, &connection, send, recv, &track, visit);
                    let over = timeout_at(self.end.into(), stay).await.is_err();
                    toll.thrown_out += u64::from(!over);
                    toll.bytes += connection.stats().udp_rx.bytes;
                    connection.close(VarInt::from_u32(0), b"");
                }
            }
            sleep(AGAIN).await;
        }
        toll
    }

    /// Returns how many handshakes were begun.
    async fn leave_unfinished(&self) -> u64 {
        let any = if self.server.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
        let (Ok(socket), Ok(mut initials)) = (UdpSocket::bind(any).await, Initials::new(self.server)) else {
            return 0;
        };
        let mut begun = 0;
        let mut due = interval(UNFINISHED_EVERY);
        while timeout_at(self.end.into(), due.tick()).await.is_ok() {
            for _ in 0..UNFINISHED {
                let Ok(datagram) = initials.initial() else { continue };
                begun += u64::from(socket.send_to(&datagram, self.server).await.is_ok());
            }
        }
        begun
    }

    /// Until the server ends it.
    async fn behave(
        &self,
        manner: Manner,
        connection: &Connection,
        mut send: SendStream,
        recv: RecvStream,
        track: &Track,
        visit: usize,
    ) {
        let hello = |version| stranger::hello(version, self.token.clone(), self.picture);
        let doing = async {
            match manner {
                Manner::Silent | Manner::Unfinished => std::future::pending().await,
                Manner::Malformed => {
                    if let Ok(bytes) = Nonsense::ALL[visit % Nonsense::ALL.len()].bytes(hello) {
                        let _ = send.write_all(&bytes).await;
                    }
                    std::future::pending().await
                }
                Manner::Slow | Manner::Flooding | Manner::Greedy => {
                    say(&mut send, &hello(wire::VERSION)).await;
                    match manner {
                        Manner::Slow => self.dawdle(connection, track).await,
                        Manner::Greedy => self.flood(connection, send, recv, track, GREEDY_POSES).await,
                        _ => self.flood(connection, send, recv, track, FLOOD_POSES).await,
                    }
                }
            }
        };
        tokio::select! {
            _ = connection.closed() => {}
            () = doing => {}
        }
    }

    async fn dawdle(&self, connection: &Connection, track: &Track) {
        let mut asked = Vec::new();
        for chunk in self.chunks.iter().take(FLOOD_REQUESTS as usize) {
            if let Ok((mut send, recv)) = connection.open_bi().await {
                request(&mut send, *chunk).await;
                asked.push(recv);
            }
        }
        let (mut pushed, mut bite) = (Vec::new(), [0; SLOW_BYTES]);
        let mut due = interval(SLOW_EVERY);
        for n in 0.. {
            due.tick().await;
            pose(connection, track, n);
            while let Ok(Ok(stream)) = tokio::time::timeout(Duration::ZERO, connection.accept_uni()).await {
                pushed.push(stream);
            }
            let all = asked.len() + pushed.len();
            if let Some(stream) = asked.iter_mut().chain(&mut pushed).nth(n % all.max(1)) {
                let _ = tokio::time::timeout(Duration::ZERO, stream.read(&mut bite)).await;
            }
        }
    }

    async fn flood(
        &self,
        connection: &Connection,
        mut send: SendStream,
        recv: RecvStream,
        track: &Track,
        poses_every: Duration,
    ) {
        let poses = async {
            let mut due = interval(poses_every);
            for n in 0.. {
                due.tick().await;
                pose(connection, track, n);
            }
        };
        let messages = async {
            let mut due = interval(FLOOD_MESSAGES);
            for list in self.chunks.chunks(MAX_LIST).cycle() {
                for make in [|chunks| ClientMessage::Drop { chunks }, |chunks| ClientMessage::Want { chunks }] {
                    due.tick().await;
                    say(&mut send, &make(list.to_vec())).await;
                }
            }
        };
        let control = drain(recv);
        let pushed = async {
            let mut open = tokio::task::JoinSet::new();
            while let Ok(stream) = connection.accept_uni().await {
                while open.try_join_next().is_some() {}
                open.spawn(drain(stream));
            }
        };
        let asked = async {
            let mut open = tokio::task::JoinSet::new();
            for chunk in self.chunks.iter().cycle() {
                if open.len() >= FLOOD_REQUESTS as usize {
                    open.join_next().await;
                }
                let Ok((mut send, recv)) = connection.open_bi().await else { return };
                request(&mut send, *chunk).await;
                open.spawn(drain(recv));
            }
        };
        tokio::join!(poses, messages, control, pushed, asked);
    }
}

/// What cannot be said is not: the connection ends, and with it everything here.
async fn say(send: &mut SendStream, message: &ClientMessage) {
    if let Ok(frame) = wire::encode(message) {
        let _ = send.write_all(&frame).await;
    }
}

async fn request(send: &mut SendStream, chunk: u32) {
    if let Ok(frame) = wire::encode(&Request::Number(chunk)) {
        let _ = send.write_all(&frame).await;
        let _ = send.finish();
    }
}

fn pose(connection: &Connection, track: &Track, n: usize) {
    let datagram = PoseDatagram { sequence: n as u32 + 1, sent_us: 0, pose: track.pose(n) };
    let _ = connection.send_datagram(datagram.encode().to_vec().into());
}

async fn drain(mut stream: RecvStream) {
    while let Ok(Some(_)) = stream.read_chunk(usize::MAX, true).await {}
}
