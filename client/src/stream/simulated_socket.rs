//! A socket with a simulated link: neither QUIC nor the network notices anything but the link's
//! behaviour.
//!
//! ```text
//!     quinn ── try_send ──▶ queue up ──▶ a task sends when due ──▶ the runtime's socket
//!     quinn ◀─ poll_recv ── queue down ◀── reads as data arrives ◀─ the runtime's socket
//! ```
//!
//! Each segment of a transmit, and of a received buffer, is a packet. Time is the runtime's, whose
//! timers have steps of a millisecond: packets due within one step arrive together, at most a
//! millisecond late. Waiting packets lie in memory, a bounded number per direction
//! ([`PacketQueue`]).

use super::{
    packet_queue::PacketQueue,
    simulated_link::{Direction, LinkCounts, LinkSpec},
};
use quinn::{
    AsyncUdpSocket, UdpPoller,
    udp::{EcnCodepoint, RecvMeta, Transmit},
};
use std::{
    future::poll_fn,
    io::{self, IoSliceMut},
    net::{IpAddr, SocketAddr},
    pin::Pin,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{
            AtomicBool,
            Ordering::{Acquire, Release},
        },
    },
    task::{Context, Poll, ready},
    time::Duration,
};
use tokio::{
    sync::Notify,
    time::{Instant, Sleep, sleep, sleep_until},
};

/// Number of buffers for one read of the inner socket.
const BUFFERS: usize = 8;
/// See [`BUFFERS`].
const BUFFER_BYTES: usize = 1 << 16;
/// Largest number of consecutive reads, before other tasks run.
const READS: usize = 16;

/// A packet in transit.
#[derive(Debug, Clone)]
struct Packet {
    bytes: Vec<u8>,
    /// Source or destination.
    remote: SocketAddr,
    local: Option<IpAddr>,
    ecn: Option<EcnCodepoint>,
}

/// State shared by the sending task and the socket.
#[derive(Debug)]
struct Up {
    packets: Mutex<PacketQueue<Packet>>,
    /// Signals that a packet was added, or the socket dropped.
    changed: Notify,
    gone: AtomicBool,
}

#[derive(Debug)]
struct Down {
    packets: PacketQueue<Packet>,
    timer: Pin<Box<Sleep>>,
    buffers: Vec<Vec<u8>>,
}

/// A socket with a simulated link.
#[derive(Debug)]
pub(super) struct SimulatedSocket {
    inner: Arc<dyn AsyncUdpSocket>,
    start: Instant,
    up: Arc<Up>,
    down: Mutex<Down>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl SimulatedSocket {
    /// Adds a link to a socket. Call within a tokio runtime; the sending task ends when the socket
    /// is dropped and its packets have left.
    pub fn new(inner: Arc<dyn AsyncUdpSocket>, spec: LinkSpec) -> Arc<Self> {
        let start = Instant::now();
        let up = Arc::new(Up {
            packets: Mutex::new(PacketQueue::new(spec, Direction::Up)),
            changed: Notify::new(),
            gone: AtomicBool::new(false),
        });
        let down = Down {
            packets: PacketQueue::new(spec, Direction::Down),
            timer: Box::pin(sleep(Duration::ZERO)),
            buffers: vec![vec![0; BUFFER_BYTES]; BUFFERS],
        };
        tokio::spawn(send_when_due(inner.clone(), up.clone(), start));
        Arc::new(Self { inner, start, up, down: Mutex::new(down) })
    }

    /// Packet counts, up and down.
    pub fn counts(&self) -> [LinkCounts; 2] {
        [lock(&self.up.packets).counts(), lock(&self.down).packets.counts()]
    }
}

impl Drop for SimulatedSocket {
    fn drop(&mut self) {
        self.up.gone.store(true, Release);
        self.up.changed.notify_one();
    }
}

/// Sends packets when they have passed the link.
async fn send_when_due(inner: Arc<dyn AsyncUdpSocket>, up: Arc<Up>, start: Instant) {
    let mut poller = inner.clone().create_io_poller();
    loop {
        let next = lock(&up.packets).next_at();
        match next {
            Some(at) => tokio::select! {
                () = sleep_until(start + at) => {}
                () = up.changed.notified() => {}
            },
            None if up.gone.load(Acquire) => return,
            None => up.changed.notified().await,
        }
        loop {
            let Some(packet) = lock(&up.packets).arrived(start.elapsed()) else { break };
            let transmit = Transmit {
                destination: packet.remote,
                ecn: packet.ecn,
                contents: &packet.bytes,
                segment_size: None,
                src_ip: packet.local,
            };
            while let Err(e) = inner.try_send(&transmit) {
                if e.kind() != io::ErrorKind::WouldBlock {
                    // A link may lose packets.
                    tracing::debug!("a packet could not be sent: {e}");
                    break;
                }
                if poll_fn(|cx| poller.as_mut().poll_writable(cx)).await.is_err() {
                    break;
                }
            }
        }
    }
}

/// Always writable: the link drops what exceeds it.
#[derive(Debug)]
struct AlwaysWritable;

impl UdpPoller for AlwaysWritable {
    fn poll_writable(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

impl AsyncUdpSocket for SimulatedSocket {
    fn create_io_poller(self: Arc<Self>) -> Pin<Box<dyn UdpPoller>> {
        Box::pin(AlwaysWritable)
    }

    fn try_send(&self, transmit: &Transmit<'_>) -> io::Result<()> {
        let now = self.start.elapsed();
        let mut packets = lock(&self.up.packets);
        for segment in segments(transmit.contents, transmit.segment_size) {
            let packet = Packet {
                bytes: segment.to_vec(),
                remote: transmit.destination,
                local: transmit.src_ip,
                ecn: transmit.ecn,
            };
            packets.send(now, segment.len(), packet);
        }
        drop(packets);
        self.up.changed.notify_one();
        Ok(())
    }

    fn poll_recv(
        &self,
        cx: &mut Context<'_>,
        bufs: &mut [IoSliceMut<'_>],
        meta: &mut [RecvMeta],
    ) -> Poll<io::Result<usize>> {
        let mut down = lock(&self.down);
        let down = &mut *down;
        take_in(&*self.inner, cx, down, self.start)?;
        loop {
            let now = self.start.elapsed();
            let mut count = 0;
            for (buf, meta) in bufs.iter_mut().zip(meta.iter_mut()) {
                let Some(packet) = down.packets.arrived(now) else { break };
                let len = packet.bytes.len().min(buf.len());
                buf[..len].copy_from_slice(&packet.bytes[..len]);
                let mut m = RecvMeta::default();
                (m.addr, m.len, m.stride, m.ecn, m.dst_ip) = (packet.remote, len, len, packet.ecn, packet.local);
                *meta = m;
                count += 1;
            }
            if count > 0 {
                return Poll::Ready(Ok(count));
            }
            // Without a packet in transit the inner socket wakes the task.
            let Some(at) = down.packets.next_at() else { return Poll::Pending };
            down.timer.as_mut().reset(self.start + at);
            ready!(down.timer.as_mut().poll(cx));
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.inner.local_addr()
    }

    fn max_transmit_segments(&self) -> usize {
        self.inner.max_transmit_segments()
    }

    fn may_fragment(&self) -> bool {
        self.inner.may_fragment()
    }
}

/// Reads the inner socket and sends its packets through the link.
fn take_in(inner: &dyn AsyncUdpSocket, cx: &mut Context<'_>, down: &mut Down, start: Instant) -> io::Result<()> {
    for _ in 0..READS {
        let mut slices: Vec<IoSliceMut<'_>> = down.buffers.iter_mut().map(|b| IoSliceMut::new(b)).collect();
        let mut metas = [RecvMeta::default(); BUFFERS];
        let Poll::Ready(count) = inner.poll_recv(cx, &mut slices, &mut metas) else { return Ok(()) };
        let now = start.elapsed();
        for (m, buffer) in metas[..count?].iter().zip(&down.buffers) {
            for segment in segments(&buffer[..m.len], Some(m.stride)) {
                let packet = Packet { bytes: segment.to_vec(), remote: m.addr, local: m.dst_ip, ecn: m.ecn };
                down.packets.send(now, segment.len(), packet);
            }
        }
    }
    cx.waker().wake_by_ref();
    Ok(())
}

/// The packets that a buffer holds.
fn segments(bytes: &[u8], size: Option<usize>) -> impl Iterator<Item = &[u8]> {
    bytes.chunks(size.unwrap_or(bytes.len()).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::simulated_link::{Fate, SimulatedLink};

    #[test]
    fn segments_of_a_buffer_are_packets_each() {
        let sizes = |n: usize, s| segments(&vec![0; n], s).map(<[u8]>::len).collect::<Vec<_>>();
        assert_eq!(sizes(2500, Some(1200)), [1200, 1200, 100]);
        assert_eq!(sizes(1200, Some(1200)), [1200]);
        assert_eq!(sizes(700, None), [700]);
        assert_eq!(sizes(0, Some(0)), [0; 0]);
    }

    /// The runtime's clock is virtual: it advances only to its timers.
    #[tokio::test(start_paused = true)]
    async fn two_sockets_over_a_link_see_its_delay_and_its_loss() {
        let runtime = quinn::TokioRuntime;
        let socket = || std::net::UdpSocket::bind("127.0.0.1:0").expect("loopback");
        let far = socket();
        far.set_nonblocking(true).expect("a socket");
        let to = far.local_addr().expect("bound");
        let inner = quinn::Runtime::wrap_udp_socket(&runtime, socket()).expect("a socket");
        let spec = "delay=30ms,loss=50%,seed=3".parse().expect("a link");
        let link = SimulatedSocket::new(inner, spec);
        let mut expected = SimulatedLink::new(spec, Direction::Up);
        let mut arrive = Vec::new();
        for i in 0..64u8 {
            let contents = [i; 100];
            let transmit =
                Transmit { destination: to, ecn: None, contents: &contents, segment_size: Some(50), src_ip: None };
            link.try_send(&transmit).expect("always room");
            for _ in 0..2 {
                if matches!(expected.send(Duration::ZERO, 50), Fate::Arrives(_)) {
                    arrive.push(i);
                }
            }
        }
        assert_eq!(link.counts()[0], expected.counts());
        let mut buffer = [0; 200];
        sleep(Duration::from_millis(29)).await;
        assert!(far.recv(&mut buffer).is_err(), "too early");
        sleep(Duration::from_millis(3)).await;
        let mut got = Vec::new();
        while let Ok(n) = far.recv(&mut buffer) {
            assert_eq!(n, 50);
            got.push(buffer[0]);
        }
        assert_eq!(got, arrive);
    }
}
