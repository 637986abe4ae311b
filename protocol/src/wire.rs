//! What travels between server and client: control messages, pose datagrams, chunk streams,
//! answers to requests.
//!
//! One QUIC connection carries four things, each in the form that suits it:
//!
//! | what | where | form |
//! |---|---|---|
//! | control ([`ClientMessage`], [`ServerMessage`]) | the first bidirectional stream, opened by the client | frames of MessagePack maps |
//! | poses ([`PoseDatagram`]) | datagrams, latest wins | 56 bytes, fixed |
//! | chunks and pages | one unidirectional stream each | [`StreamHeader`], 12 bytes, then the bytes as stored |
//! | requests by number or by name ([`Request`]) | one bidirectional stream each | a frame; then an [`Answer`] frame and the bytes |
//!
//! A frame is a little-endian u32 length and that many bytes. Every decoder here takes bytes from
//! a stranger: it bounds lengths before it allocates, refuses numbers that are not finite, and
//! never panics.
//!
//! Control messages are maps with field names, so that a later version may add optional fields;
//! what an old peer cannot ignore raises [`VERSION`]. Everything bulky travels raw: MessagePack
//! would copy it.

mod binary;

pub use binary::{PoseDatagram, StreamHeader, StreamKind};

use crate::{
    OutputCamera,
    index::{BuildSettings, ChunkHash},
    room_index::ShowPortals,
    select::FarBy,
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// Raised when a peer of the previous version could not understand the next one. 4: sections of
/// chunks and manifests may be coded by rANS, and tree chunks are of version 2. 2: clients say how
/// far behind their decoding is ([`ClientMessage::Decoding`]) and which manifests they have
/// ([`Hello::manifests`]).
pub const VERSION: u16 = 5;
/// The application protocol that TLS agrees on.
pub const ALPN: &[u8] = b"ldi/1";
/// The port that a client tries when none is given.
pub const DEFAULT_PORT: u16 = 4433;
/// Longest frame that a client may send. Room for [`MAX_LIST`] numbers; larger lets a stranger
/// hold more memory.
pub const MAX_CLIENT_FRAME: usize = 64 * 1024;
/// Longest control frame that a server may send.
pub const MAX_SERVER_FRAME: usize = 64 * 1024;
/// Longest manifest root: twice what a build may write.
pub const MAX_ROOT_BYTES: usize = 512 * 1024;
/// Longest chunk. Longer ones are a broken dataset: the largest real ones, first layers of LDIs,
/// hold a few MiB.
pub const MAX_CHUNK_BYTES: u32 = 256 << 20;
/// Longest list of chunks in one message; longer ones are sent in parts.
pub const MAX_LIST: usize = 8_192;
/// Most manifests that a client names.
pub const MAX_MANIFESTS: usize = 16;
/// Longest text in a message, bytes.
pub const MAX_TEXT: usize = 1_024;
/// Most walkers that a client is told of. More would hide a map.
pub const MAX_OTHERS: usize = 64;
/// Longest name that a server shows, characters: longer ones are cut.
pub const MAX_NAME_CHARS: usize = 64;

/// Why bytes of a peer were refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// A frame announces more bytes than this kind of frame may have.
    #[error("frame of {bytes} bytes, at most {limit} are allowed here")]
    FrameTooLong {
        /// Announced.
        bytes: usize,
        /// Allowed.
        limit: usize,
    },
    /// The bytes are no message.
    #[error("not a {what}: {reason}")]
    Malformed {
        /// What was expected.
        what: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// A value outside its range.
    #[error("{field} is out of range: {reason}")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// The range and the value.
        reason: String,
    },
}

/// The picture that a client draws.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Horizontal field of view in degrees; None: the one that the dataset is made for, which a
    /// client learns only later.
    #[serde(default)]
    pub fov_deg: Option<f64>,
}

impl Picture {
    /// The camera on a dataset.
    pub fn camera(&self, settings: &BuildSettings) -> OutputCamera {
        let fov_deg = self.fov_deg.unwrap_or(settings.camera.fov_deg);
        OutputCamera { width: self.width, height: self.height, fov_deg }
    }
}

/// First message of a client.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// [`VERSION`] of the client.
    pub version: u16,
    /// Shared secret, when the server asks for one.
    #[serde(default)]
    pub token: Option<String>,
    /// The picture that the client draws; its frustum decides what a pose needs.
    pub picture: Picture,
    /// Decoded bytes that the client's cache may hold.
    pub cache_bytes: u64,
    /// How far around the eye the server may push what no view has asked for yet, metres. 0:
    /// nothing.
    pub prefetch_m: f64,
    /// What the client calls itself, for the server's page.
    #[serde(default)]
    pub name: String,
    /// Datasets whose whole manifest the client has from before, at most [`MAX_MANIFESTS`]. If the
    /// served one is among them, nothing is sent until [`ClientMessage::Whole`]: the client says
    /// first what it has of it.
    #[serde(default)]
    pub manifests: Vec<ChunkHash>,
    /// How the client shows portals, which decides what a pose needs in a dataset with rooms. A
    /// server that does not know of it sends what it would show, and the client asks for the rest.
    #[serde(default)]
    pub portals: ShowPortals,
    /// Where the client takes what is far from, which decides what a pose needs too. A server that
    /// does not know of it sends what the dataset offers, and the client asks for the rest.
    #[serde(default)]
    pub far: FarBy,
    /// Name of the dataset to walk in; None: the only one.
    #[serde(default)]
    pub dataset: Option<String>,
    /// The walk begins before the whole manifest is there: until [`ClientMessage::Whole`] only the
    /// LDI tree's coarse levels are sent beside it. A server that does not know of it sends the
    /// pages first.
    #[serde(default)]
    pub early: bool,
    /// Whether the client is told by [`ServerMessage::Replaced`] that its dataset was replaced. A
    /// server that does not know of it says nothing.
    #[serde(default)]
    pub replacements: bool,
}

/// The server's answer to [`Hello`]; a frame with the manifest's root follows it on the control
/// stream, and all pages follow on unidirectional streams.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Welcome {
    /// [`VERSION`] of the server.
    pub version: u16,
    /// BLAKE3 of the manifest's root: two servers with the same hash serve the same dataset.
    pub dataset: ChunkHash,
    /// Bytes of the root that follows. 0: nothing follows, as [`Hello::manifests`] names this
    /// dataset.
    pub root_bytes: u32,
    /// Pages that follow.
    pub pages: u32,
    /// Number of this walker on the server's page.
    pub walker: u64,
    /// Whether [`ClientMessage::Others`] will be answered. A server that does not know of it does
    /// not say so.
    #[serde(default)]
    pub others: bool,
    /// Fingerprint of the certificate that will replace the server's: clients that remember servers
    /// remember it too.
    #[serde(default)]
    pub next_certificate: Option<ChunkHash>,
}

/// Another walker, for the map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Other {
    /// Its number on the server's page.
    pub walker: u64,
    /// What it calls itself, at most [`MAX_NAME_CHARS`].
    pub name: String,
    /// World position, metres.
    pub position: [f64; 3],
    /// Degrees, 0 to 360.
    pub yaw_deg: f32,
}

/// Messages of a client on the control stream, after [`Hello`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ClientMessage {
    /// The first message, once.
    Hello(Hello),
    /// Send these chunks before anything else, even if they were sent before.
    Want {
        /// Numbers of chunks, at most [`MAX_LIST`].
        chunks: Vec<u32>,
    },
    /// These chunks are no longer held: evicted.
    Drop {
        /// Numbers of chunks, at most [`MAX_LIST`].
        chunks: Vec<u32>,
    },
    /// These chunks arrived with bytes that do not match their hash, or cannot be decoded although
    /// they do: the server checks and logs it.
    Damaged {
        /// Numbers of chunks, at most [`MAX_LIST`].
        chunks: Vec<u32>,
    },
    /// These chunks are held from an earlier connection, or given up: they need not come.
    Have {
        /// Numbers of chunks, at most [`MAX_LIST`].
        chunks: Vec<u32>,
    },
    /// How far behind the client's decoding is, so that no more is sent ahead than it can take in.
    /// Told when it changes, ten times per second at most.
    Decoding {
        /// Stored bytes that wait for decoding.
        waiting_bytes: u32,
        /// Stored bytes that are decoded per second while something waits; 0: not known.
        bytes_per_s: u32,
    },
    /// The whole manifest is here and what is held from before is told, after a Hello with
    /// [`Hello::early`].
    Whole,
    /// The client shows where other walkers are, or no longer. Only to a server with
    /// [`Welcome::others`].
    Others {
        /// Whether it does.
        shown: bool,
    },
    /// The client leaves.
    Bye,
}

impl ClientMessage {
    /// How many chunks it lists.
    pub fn listed(&self) -> usize {
        match self {
            Self::Want { chunks } | Self::Drop { chunks } | Self::Damaged { chunks } | Self::Have { chunks } => {
                chunks.len()
            }
            Self::Hello(_) | Self::Decoding { .. } | Self::Whole | Self::Others { .. } | Self::Bye => 0,
        }
    }
}

/// Messages of a server on the control stream.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ServerMessage {
    /// The door is open.
    Welcome(Welcome),
    /// The door stays closed; the connection ends.
    Refused {
        /// Why.
        code: RefusalCode,
        /// In words, with the remedy.
        message: String,
    },
    /// Wanted chunks that do not exist.
    Unavailable {
        /// Their numbers.
        chunks: Vec<u32>,
    },
    /// Where the other walkers are, to clients that said [`ClientMessage::Others`]: when it
    /// changes, twice per second at most.
    Others {
        /// The nearest ones, at most [`MAX_OTHERS`].
        walkers: Vec<Other>,
    },
    /// The dataset of this name was replaced by a new build, which the next connection gets. Only
    /// to clients with [`Hello::replacements`], once.
    Replaced,
}

/// Why a server refuses a client. Also the application code with which it closes the connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u32)]
pub enum RefusalCode {
    /// No token or a wrong one.
    Token = 1,
    /// The versions do not match.
    Version = 2,
    /// Too many connections, in all or from this address.
    Busy = 3,
    /// A message that breaks the protocol or a limit.
    Protocol = 4,
    /// Messages faster than the server accepts.
    Rate = 5,
    /// No dataset of the name that was asked for, or several and no name.
    Dataset = 6,
}

/// Application codes with which streams and connections end, beyond [`RefusalCode`].
pub mod code {
    /// Normal end.
    pub const BYE: u32 = 0;
    /// The server stops.
    pub const SHUTDOWN: u32 = 16;
    /// A chunk's stream was reset because the walker moved on.
    pub const STALE: u32 = 17;
    /// The client holds this chunk already.
    pub const DUPLICATE: u32 = 18;
    /// The stream's header or length is wrong.
    pub const BAD_STREAM: u32 = 19;
}

/// How urgent a chunk is; the order of the variants is the order of sending.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum Urgency {
    /// The client asked for it.
    Asked = 0,
    /// The current view has a gap without it.
    Now = 1,
    /// The current view is coarser without it.
    Fine = 2,
    /// The predicted view needs it.
    Predicted = 3,
    /// Near the walker.
    Around = 4,
}

impl Urgency {
    /// All, most urgent first.
    pub const ALL: [Self; 5] = [Self::Asked, Self::Now, Self::Fine, Self::Predicted, Self::Around];
    /// Whether the view on the screen waits for it.
    pub fn is_pressing(self) -> bool {
        self <= Self::Fine
    }
}

/// A request on its own bidirectional stream: the fallback that always works.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Request {
    /// By position in the index.
    Number(u32),
    /// By hash.
    Name(ChunkHash),
}

/// The answer to a [`Request`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Answer {
    /// The stored bytes follow on the stream.
    Chunk {
        /// Position in the index.
        number: u32,
        /// How many bytes follow.
        bytes: u32,
    },
    /// There is no such chunk, or the request was no request. Only this stream ends.
    Error {
        /// In words.
        message: String,
    },
}

/// Messages that check themselves after decoding.
pub trait Message: Serialize + DeserializeOwned {
    /// For error texts.
    const WHAT: &'static str;
    /// Longest encoding.
    const LIMIT: usize;
    /// Bounds on values.
    ///
    /// # Errors
    /// The field that is out of range.
    fn validate(&self) -> Result<(), WireError>;
}

fn in_range(field: &'static str, value: f64, range: std::ops::RangeInclusive<f64>) -> Result<(), WireError> {
    if range.contains(&value) {
        return Ok(());
    }
    let reason = format!("{value}, from {} to {} is allowed", range.start(), range.end());
    Err(WireError::OutOfRange { field, reason })
}

impl Message for ClientMessage {
    const WHAT: &'static str = "client message";
    const LIMIT: usize = MAX_CLIENT_FRAME;
    fn validate(&self) -> Result<(), WireError> {
        match self {
            Self::Hello(h) => {
                in_range("picture width", f64::from(h.picture.width), 1.0..=32_768.0)?;
                in_range("picture height", f64::from(h.picture.height), 1.0..=32_768.0)?;
                in_range("picture field of view", h.picture.fov_deg.unwrap_or(60.0), 1.0..=170.0)?;
                in_range("prefetch_m", h.prefetch_m, 0.0..=1e9)?;
                in_range("token bytes", h.token.as_ref().map_or(0, String::len) as f64, 0.0..=MAX_TEXT as f64)?;
                in_range("name bytes", h.name.len() as f64, 0.0..=MAX_TEXT as f64)?;
                in_range("dataset bytes", h.dataset.as_ref().map_or(0, String::len) as f64, 0.0..=MAX_TEXT as f64)?;
                in_range("manifests", h.manifests.len() as f64, 0.0..=MAX_MANIFESTS as f64)
            }
            Self::Want { chunks } | Self::Drop { chunks } | Self::Damaged { chunks } | Self::Have { chunks } => {
                in_range("chunks", chunks.len() as f64, 0.0..=MAX_LIST as f64)
            }
            // Any numbers will do: they only shift what is sent ahead, within bounds of the
            // server's own.
            Self::Decoding { .. } | Self::Whole | Self::Others { .. } | Self::Bye => Ok(()),
        }
    }
}

impl Message for ServerMessage {
    const WHAT: &'static str = "server message";
    const LIMIT: usize = MAX_SERVER_FRAME;
    fn validate(&self) -> Result<(), WireError> {
        match self {
            Self::Welcome(w) => in_range("root bytes", f64::from(w.root_bytes), 0.0..=MAX_ROOT_BYTES as f64),
            Self::Refused { message, .. } => in_range("message", message.len() as f64, 0.0..=MAX_TEXT as f64),
            Self::Unavailable { chunks } => in_range("chunks", chunks.len() as f64, 0.0..=MAX_LIST as f64),
            Self::Others { walkers } => {
                in_range("walkers", walkers.len() as f64, 0.0..=MAX_OTHERS as f64)?;
                for w in walkers {
                    in_range("name characters", w.name.chars().count() as f64, 0.0..=MAX_NAME_CHARS as f64)?;
                    in_range("yaw", f64::from(w.yaw_deg), 0.0..=360.0)?;
                    w.position.iter().try_for_each(|x| in_range("position", *x, -1e9..=1e9))?;
                }
                Ok(())
            }
            Self::Replaced => Ok(()),
        }
    }
}

impl Message for Request {
    const WHAT: &'static str = "request";
    const LIMIT: usize = 256;
    fn validate(&self) -> Result<(), WireError> {
        Ok(())
    }
}

impl Message for Answer {
    const WHAT: &'static str = "answer";
    const LIMIT: usize = 2 * MAX_TEXT;
    fn validate(&self) -> Result<(), WireError> {
        match self {
            Self::Chunk { bytes, .. } => in_range("bytes", f64::from(*bytes), 0.0..=f64::from(MAX_CHUNK_BYTES)),
            Self::Error { message } => in_range("message", message.len() as f64, 0.0..=MAX_TEXT as f64),
        }
    }
}

/// Encodes a message with its frame's length.
///
/// # Errors
/// A value out of range, or too long an encoding.
pub fn encode<M: Message>(message: &M) -> Result<Vec<u8>, WireError> {
    message.validate()?;
    let body =
        rmp_serde::to_vec_named(message).map_err(|e| WireError::Malformed { what: M::WHAT, reason: e.to_string() })?;
    frame(&body, M::LIMIT)
}

/// Puts a length before raw bytes.
///
/// # Errors
/// More than `limit` bytes.
pub fn frame(body: &[u8], limit: usize) -> Result<Vec<u8>, WireError> {
    check_frame_length(body.len(), limit)?;
    let mut out = Vec::with_capacity(4 + body.len());
    out.extend_from_slice(&(body.len() as u32).to_le_bytes());
    out.extend_from_slice(body);
    Ok(out)
}

/// The length that a frame announces, checked against what this kind of frame may have.
///
/// # Errors
/// More than `limit` bytes.
pub fn frame_length(prefix: [u8; 4], limit: usize) -> Result<usize, WireError> {
    let bytes = u32::from_le_bytes(prefix) as usize;
    check_frame_length(bytes, limit)?;
    Ok(bytes)
}

fn check_frame_length(bytes: usize, limit: usize) -> Result<(), WireError> {
    if bytes > limit || u32::try_from(bytes).is_err() {
        return Err(WireError::FrameTooLong { bytes, limit });
    }
    Ok(())
}

/// Decodes the body of a frame and checks its values. Trailing bytes are refused.
///
/// # Errors
/// Anything that is not exactly one message within its bounds.
pub fn decode<M: Message>(body: &[u8]) -> Result<M, WireError> {
    check_frame_length(body.len(), M::LIMIT)?;
    let mut reader = body;
    let message: M =
        rmp_serde::from_read(&mut reader).map_err(|e| WireError::Malformed { what: M::WHAT, reason: e.to_string() })?;
    if !reader.is_empty() {
        return Err(WireError::Malformed { what: M::WHAT, reason: format!("{} trailing bytes", reader.len()) });
    }
    message.validate()?;
    Ok(message)
}

#[cfg(test)]
#[path = "wire/wire_test.rs"]
mod tests;
