//! What can go wrong with a dataset directory.

use ldi_protocol::codec::CodecError;
use std::path::{Path, PathBuf};

/// A failure to write, open or read a dataset. Every message names the file and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The directory is no dataset, or not yet.
    #[error("{}: not a dataset: {why}", path.display())]
    NotADataset {
        /// The directory.
        path: PathBuf,
        /// What is missing, and what to do.
        why: &'static str,
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
    #[error("{}: {found} bytes, but the manifest says {expected}; the file was damaged or cut off: copy it again, or build the dataset again", path.display())]
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
            Self::NotADataset { .. } | Self::Format { .. } | Self::PackLength { .. } => true,
            Self::Io { source, .. } => source.kind() == std::io::ErrorKind::NotFound,
            Self::Locked { .. } | Self::Chunk { .. } => false,
        }
    }

    pub(super) fn io<'a>(path: &'a Path, action: &'static str) -> impl FnOnce(std::io::Error) -> Self + 'a {
        move |source| Self::Io { path: path.to_owned(), action, source }
    }

    pub(super) fn format(path: &Path) -> impl FnOnce(CodecError) -> Self + '_ {
        move |source| Self::Format { path: path.to_owned(), source }
    }
}
