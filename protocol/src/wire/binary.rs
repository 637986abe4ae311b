//! Fixed binary layouts: what is sent so often that MessagePack would cost more than it says.

use super::{MAX_CHUNK_BYTES, Urgency, VERSION, WireError};
use crate::Pose;
use glam::DVec3;

/// What a unidirectional stream carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StreamKind {
    /// Page `number` of the manifest.
    Page,
    /// Chunk `number` of the index.
    Chunk,
}

/// First bytes of a unidirectional stream; the stored bytes follow and the stream ends after them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamHeader {
    /// Page or chunk.
    pub kind: StreamKind,
    /// Why it was sent.
    pub urgency: Urgency,
    /// Position among the pages or the chunks.
    pub number: u32,
    /// Stored bytes that follow, at most [`MAX_CHUNK_BYTES`].
    pub bytes: u32,
}

impl StreamHeader {
    /// Encoded length.
    pub const BYTES: usize = 12;

    /// Kind, urgency, two zeros, number, bytes; little-endian.
    pub fn encode(&self) -> [u8; Self::BYTES] {
        let mut out = [0; Self::BYTES];
        out[0] = match self.kind {
            StreamKind::Page => b'G',
            StreamKind::Chunk => b'C',
        };
        out[1] = self.urgency as u8;
        out[4..8].copy_from_slice(&self.number.to_le_bytes());
        out[8..12].copy_from_slice(&self.bytes.to_le_bytes());
        out
    }

    /// Reads a header.
    ///
    /// # Errors
    /// An unknown kind or urgency, nonzero padding, or too long a chunk.
    pub fn decode(b: &[u8; Self::BYTES]) -> Result<Self, WireError> {
        let malformed = |reason: String| WireError::Malformed { what: "stream header", reason };
        let kind = match b[0] {
            b'G' => StreamKind::Page,
            b'C' => StreamKind::Chunk,
            k => return Err(malformed(format!("unknown kind {k}"))),
        };
        let urgency =
            *Urgency::ALL.get(usize::from(b[1])).ok_or_else(|| malformed(format!("unknown urgency {}", b[1])))?;
        if b[2] != 0 || b[3] != 0 {
            return Err(malformed("padding is not zero".into()));
        }
        let number = u32::from_le_bytes([b[4], b[5], b[6], b[7]]);
        let bytes = u32::from_le_bytes([b[8], b[9], b[10], b[11]]);
        if bytes > MAX_CHUNK_BYTES {
            return Err(WireError::OutOfRange {
                field: "bytes",
                reason: format!("{bytes}, at most {MAX_CHUNK_BYTES}"),
            });
        }
        Ok(Self { kind, urgency, number, bytes })
    }
}

/// A pose on its way up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseDatagram {
    /// Grows by one per pose (wrapping); an older one is ignored.
    pub sequence: u32,
    /// The client's clock, microseconds since it connected: velocities do not depend on the
    /// network's jitter.
    pub sent_us: u64,
    /// The pose.
    pub pose: Pose,
}

impl PoseDatagram {
    /// Encoded length.
    pub const BYTES: usize = 56;
    /// Positions beyond this, metres, are refused: far outside any scene, and safe to square.
    pub const MAX_COORDINATE_M: f64 = 1e9;

    /// `P`, version, two zeros, sequence, time, position, yaw, pitch; little-endian.
    pub fn encode(&self) -> [u8; Self::BYTES] {
        let mut out = [0; Self::BYTES];
        out[0] = b'P';
        out[1] = VERSION as u8;
        out[4..8].copy_from_slice(&self.sequence.to_le_bytes());
        out[8..16].copy_from_slice(&self.sent_us.to_le_bytes());
        let p = self.pose;
        for (i, v) in [p.position.x, p.position.y, p.position.z, p.yaw_deg, p.pitch_deg].into_iter().enumerate() {
            out[16 + 8 * i..24 + 8 * i].copy_from_slice(&v.to_le_bytes());
        }
        out
    }

    /// Reads a datagram.
    ///
    /// # Errors
    /// A wrong length, kind or version, or numbers that are not finite or out of range.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let b: &[u8; Self::BYTES] = bytes.try_into().map_err(|_| WireError::Malformed {
            what: "pose",
            reason: format!("{} bytes instead of {}", bytes.len(), Self::BYTES),
        })?;
        if b[..4] != [b'P', VERSION as u8, 0, 0] {
            return Err(WireError::Malformed { what: "pose", reason: "unknown kind or version".into() });
        }
        let word = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| b[at + i]));
        let v: [f64; 5] = std::array::from_fn(|i| f64::from_bits(word(16 + 8 * i)));
        let limits = [Self::MAX_COORDINATE_M, Self::MAX_COORDINATE_M, Self::MAX_COORDINATE_M, 1e6, 90.0];
        if let Some(i) = (0..5).find(|&i| v[i].is_nan() || v[i].abs() > limits[i]) {
            let field = ["x", "y", "z", "yaw", "pitch"][i];
            return Err(WireError::OutOfRange { field, reason: format!("{}, at most {}", v[i], limits[i]) });
        }
        Ok(Self {
            sequence: u32::from_le_bytes([b[4], b[5], b[6], b[7]]),
            sent_us: word(8),
            pose: Pose { position: DVec3::new(v[0], v[1], v[2]), yaw_deg: v[3], pitch_deg: v[4] },
        })
    }

    /// Whether this one was sent after `other`, sequence numbers wrapping.
    pub fn is_newer_than(&self, other: u32) -> bool {
        (self.sequence.wrapping_sub(other) as i32) > 0
    }
}
