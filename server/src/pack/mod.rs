//! Stage 6: near geometry and textures as chunks.
//!
//! In: the scene, its clusters and cells. Out: encoded chunks and the entries that name them. A
//! cluster that only one cell draws goes into that cell's chunk; one that several draw goes into a
//! bundle, stored once. Bundles follow the order in which the cells first need their clusters, so
//! that neighbours in space are neighbours in a bundle. Levels of detail of neighbouring cells lie
//! in one chunk, and what several of those place in bundles of their own.

mod clusters;
mod density;
mod texture;

pub use clusters::{PackedGeometry, pack_geometry};
pub use texture::{PackedTextures, pack_textures};

use ldi_protocol::codec::CodecError;
use ldi_protocol::index::ChunkKind;

/// An encoded chunk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Chunk {
    /// What it holds.
    pub kind: ChunkKind,
    /// As stored and sent.
    pub bytes: Vec<u8>,
    /// Bytes in memory once decoded.
    pub decoded_bytes: usize,
}

/// A part of the scene that the format cannot hold.
#[derive(Debug, thiserror::Error)]
#[error("{what}: {source}; scale the scene to metres, or split what is so large")]
pub struct PackError {
    /// Mesh or texture.
    pub what: String,
    /// Why.
    pub source: CodecError,
}
