//! Stage 7: the dataset directory.
//!
//! In: an [`Index`](ldi_protocol::index::Index), encoded chunks, the source ranges of the cells
//! and a report. Out: files that `serve` hands out as they are.
//!
//! ```text
//!   DATASET/
//!     ldi-dataset             the marker of a folder that a build may write to
//!     manifest                root of the manifest; its renaming publishes the dataset
//!     packs-HASH/             files of the manifest of this hash
//!       pack-00000.bin        pages, then chunks, each content once, up to 64 MiB a pack
//!       source                which source triangles each cell holds; for `inspect`, never sent
//!     report.json             what the build did; may differ between equal builds
//!     .build/                 pieces of a build under way; gone when it is complete
//! ```
//!
//! - Where a chunk lies follows from the order of pages and chunks
//!   ([`ldi_protocol::manifest::layout`]), so there is no table of offsets to keep in step.
//! - A build that was stopped at any moment goes on where it was: every finished piece lies in
//!   `.build` under the hash of what it was made from ([`DatasetWriter::cached`]), with a length
//!   and a hash of its own, so that torn files do not count.
//! - Every file is written under another name, synced, and renamed; the same index and chunks give
//!   the same bytes. The files of an old dataset are removed after the manifest of the new one has
//!   its name, so that a stop leaves one of both.
//! - Only what a build named is overwritten or removed, and no link is followed.
//! - [`Dataset`] reads chunks from opened packs and checks their hashes, so that files that change
//!   under it give errors; [`verify()`] checks every byte of them against the manifest, decodes
//!   every chunk and names each fault.
//! - Datasets of earlier versions, with `packs/`, `source` and no marker, are read, and not written
//!   to.

mod dataset;
mod elements;
mod error;
mod files;
mod folder;
mod inspect;
mod packs;
mod report;
mod source;
mod verify;
mod work;
mod writer;

pub use dataset::Dataset;
pub(crate) use error::REPLACE;
pub use error::StoreError;
pub use folder::{is_dataset, manifest_stamp};
pub use inspect::{inspect, inspect_text};
pub use verify::{Fault, Verification, verify, verify_heard};
pub use writer::{DatasetWriter, Written};

#[cfg(test)]
pub(crate) mod tests;
