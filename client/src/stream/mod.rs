//! Streaming: the client's side of the protocol.
//!
//! In: poses and needs from the render thread. Out: decoded objects in the
//! [`Cache`](crate::cache::Cache), statistics. The render thread waits for the network only in
//! [`Connection::wait_until_complete`].
//!
//! One thread runs QUIC in an async runtime; several decoding threads verify and decode chunks,
//! most urgent first. The queues between them are bounded: when decoding falls behind, reading
//! stops, and QUIC's flow control stops the server.
//!
//! Between visits chunks may be kept on disk ([`DiskCache`]); the server counts them as held, and
//! the client loads them itself.
//!
//! A damaged chunk is requested again [`MAX_RETRIES`] times, then given up; the walk continues
//! without it.

mod chunk_stream;
mod config;
mod connection;
mod decode_backlog;
mod decoder;
mod disk;
mod disk_chunks;
mod disk_loader;
mod error;
mod handshake;
mod index_pages;
mod known_hosts;
mod other_walkers;
mod packet_queue;
mod pose_updates;
mod progress;
mod session;
mod simulated_link;
mod simulated_socket;
mod stats;
mod transport;
mod trust;

pub use config::{ConnectConfig, ResumeState};
pub use connection::Connection;
pub use decoder::DecodePool;
pub use disk::{DEFAULT_DISK_BYTES, DiskCache, DiskError};
pub use error::ConnectError;
pub use known_hosts::{Acquaintance, KnownHosts, KnownHostsError};
pub use other_walkers::OtherWalkers;
pub use packet_queue::PacketQueue;
pub use pose_updates::PoseClock;
pub use progress::{ConnectProgress, Phase};
pub use session::MAX_RETRIES;
pub use simulated_link::{Direction, Fate, HEADER_BYTES, LinkCounts, LinkError, LinkSpec, SimulatedLink};
pub use stats::{Arrival, Stats};
pub use transport::resolve;
pub use trust::Fingerprint;
