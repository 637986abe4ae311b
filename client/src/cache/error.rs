//! Errors of the cache: chunks that cannot be decoded, and waits that end without all chunks.

use ldi_protocol::codec::CodecError;

/// A chunk that cannot be decoded to an object.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// The codec refuses it.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// Nothing in the index refers to it.
    #[error("nothing in the index refers to it")]
    Unreferenced,
}

/// The reason why not all chunks are resident.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Incomplete {
    /// The timeout has passed.
    #[error("{} chunks did not arrive in time, the first is {:?}", .0.len(), .0.first())]
    Timeout(Vec<u32>),
    /// These chunks are damaged on the server; all others are resident.
    #[error("{} chunks are damaged, the first is {}; check the dataset with `ldi-server verify`", .0.len(), .0.first().copied().unwrap_or_default())]
    Damaged(Vec<u32>),
    /// One view needs more than the capacity.
    #[error("the view needs more decoded bytes than the cache may hold ({cap_bytes}); raise --cache-bytes")]
    NoRoom {
        /// The capacity, decoded bytes.
        cap_bytes: u64,
    },
    /// The connection is lost.
    #[error("{0}")]
    Disconnected(String),
}
