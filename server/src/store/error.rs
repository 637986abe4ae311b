//! What can go wrong with a dataset directory.

use ldi_protocol::{codec::CodecError, said::is_lasting};
use std::path::{Path, PathBuf};

/// What to do about a damaged file. Files of a dataset that is served are not to be overwritten:
/// walkers would lack what is in them.
pub(crate) const REPLACE: &str = "build the dataset again, or copy all of it into a new folder and serve that";

/// A failure to write, open or read a dataset. Every message names the file and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The directory is no dataset, or not yet.
    #[error("{}: not a dataset: {why}", path.display())]
    NotADataset {
        /// The directory.
        path: PathBuf,
        /// What is missing, and what to do.
        why: String,
    },
    /// A build does not write there.
    #[error("{}: not written to: {why}", path.display())]
    NotOurs {
        /// The directory or file.
        path: PathBuf,
        /// Why not, and what to do.
        why: String,
    },
    /// The disk has no room for the dataset.
    #[error(
        "{}: the disk has {free} bytes left, and the dataset takes up to {needed}; make room and run the same build again, it goes on \
         where it was (what was there before stays until then)", path.display()
    )]
    NoSpace {
        /// The directory.
        path: PathBuf,
        /// Bytes that the files take at most.
        needed: u64,
        /// Bytes that may be written.
        free: u64,
    },
    /// A pack is missing.
    #[error("{}: the file is missing: {REPLACE}", path.display())]
    NoPack {
        /// The pack.
        path: PathBuf,
    },
    /// There is no page or chunk of this number.
    #[error("there is no {what} {number}")]
    NoSuch {
        /// Page or chunk.
        what: &'static str,
        /// Its number.
        number: u32,
    },
    /// A page or a chunk cannot be read as it was written.
    #[error("{}: {what} {number} at byte {offset}: {why}; the file was damaged or changed: {REPLACE}", path.display())]
    Damaged {
        /// The pack.
        path: PathBuf,
        /// Page or chunk.
        what: &'static str,
        /// Its number.
        number: u32,
        /// First byte of it in the pack.
        offset: u64,
        /// What is wrong.
        why: String,
    },
    /// A file of the dataset cannot be decoded: damaged, or of another version.
    #[error("{}: {source}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// Where in it, and why.
        source: CodecError,
    },
    /// A pack is not as long as the manifest says.
    #[error("{}: {found} bytes, but the manifest says {expected}; the file was damaged or cut off: {REPLACE}", path.display())]
    PackLength {
        /// The pack.
        path: PathBuf,
        /// Its length.
        found: u64,
        /// What it should be.
        expected: u64,
    },
    /// Another build is writing here.
    #[error("{}: another build is writing this dataset; wait for it, or name another directory", path.display())]
    Locked {
        /// The directory.
        path: PathBuf,
    },
    /// The bytes handed over for a chunk are not what the index says.
    #[error(
        "chunk {number}: its bytes are not those that the index lists; delete the dataset's .build folder and build again"
    )]
    Chunk {
        /// Number of the chunk.
        number: u32,
    },
    /// The operating system refused.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// Why not.
        source: std::io::Error,
    },
}

impl StoreError {
    /// Whether trying again cannot help: the dataset is damaged, not there, or of another version.
    pub fn permanent(&self) -> bool {
        match self {
            Self::NotADataset { .. }
            | Self::NotOurs { .. }
            | Self::Format { .. }
            | Self::NoPack { .. }
            | Self::PackLength { .. }
            | Self::NoSuch { .. }
            | Self::Damaged { .. } => true,
            Self::Io { source, .. } => is_lasting(source),
            Self::Locked { .. } | Self::NoSpace { .. } | Self::Chunk { .. } => false,
        }
    }

    /// Whether another process may have made or removed the same file.
    pub(super) fn is_of_a_race(&self) -> bool {
        use std::io::ErrorKind as Kind;
        matches!(self, Self::Io { source, .. } if matches!(source.kind(), Kind::AlreadyExists | Kind::NotFound))
    }

    pub(super) fn io<'a>(path: &'a Path, action: &'static str) -> impl FnOnce(std::io::Error) -> Self + 'a {
        move |source| Self::Io { path: path.to_owned(), action, source }
    }

    pub(super) fn format(path: &Path) -> impl FnOnce(CodecError) -> Self + '_ {
        move |source| Self::Format { path: path.to_owned(), source }
    }
}
