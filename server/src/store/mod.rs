//! Stage 7: the dataset directory.
//!
//! In: an [`Index`](ldi_protocol::index::Index), encoded chunks, the source ranges of the cells and a report. Out: files that
//! `serve` hands out as they are.
//!
//! ```text
//!   DATASET/
//!     manifest              root of the manifest; written last, so a dataset is complete or not there
//!     packs/pack-00000.bin  pages, then chunks, each content once, up to 64 MiB a pack
//!     source                which source triangles each cell holds; for `inspect`, never sent
//!     report.json           what the build did and skipped; the only file that may differ between equal builds
//!     .build/               finished pieces of a build under way; gone when the dataset is complete
//! ```
//!
//! - Where a chunk lies follows from the order of pages and chunks ([`ldi_protocol::manifest::layout`]), so there is no table of
//!   offsets to keep in step.
//! - A build that was stopped at any moment goes on where it was: every finished piece lies in `.build` under the hash of what
//!   it was made from ([`DatasetWriter::cached`]), with a length and a hash of its own, so that torn files do not count.
//! - Every file is written under another name, synced, and renamed; the same index and chunks give the same bytes.
//! - [`Dataset`] maps the packs; [`verify()`] checks every byte of them against the manifest, decodes every chunk and names each fault.

mod dataset;
mod error;
mod files;
mod inspect;
mod map;
mod source;
mod verify;
mod work;
mod writer;

pub use dataset::Dataset;
pub use error::StoreError;
pub use inspect::{inspect, inspect_text};
pub use verify::{Fault, Verification, verify};
pub use writer::{DatasetWriter, Written};

#[cfg(test)]
mod tests;
