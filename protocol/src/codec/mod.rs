//! Chunk codecs: LDIs, cells and textures to bytes and back. `docs/reference/format.md` gives the
//! byte layout.
//!
//! All of them are planes of prediction residuals in sections, coded by rANS or zstd: like with
//! like, one table each. What is decoded is checked: every length before anything is allocated for
//! it, every number against what it may refer to. A decoder fed with forged bytes returns a
//! [`CodecError`] that names the field; it neither panics nor allocates without bound.

pub(crate) mod bytes;
pub mod cell;
mod colour;
mod error;
mod instances;
pub mod ldi;
mod normal;
mod planes;
mod rans;
mod residual;
mod runs;
mod slivers;
mod surface;
pub mod texture;
pub mod tree;

pub use colour::{ColourMode, ColourProfile};
pub use error::CodecError;
