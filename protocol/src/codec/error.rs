//! The one error of all chunk and manifest decoders.

/// Why bytes could not be decoded (or, rarely, why a value cannot be encoded). `field` names the
/// place in the format as `docs/reference/format.md` calls it. The caller adds which chunk or file
/// it was.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// The data stops before the field does.
    #[error("{field}: the data ends {missing} bytes early; fetch it again, or rebuild the dataset")]
    Truncated {
        /// The field that was being read.
        field: &'static str,
        /// Bytes that are not there.
        missing: usize,
    },
    /// Another kind of data altogether.
    #[error("expected {expected} data, but it starts with {found:02x?}; is this the right file?")]
    Magic {
        /// What was asked for.
        expected: &'static str,
        /// The first bytes that are there.
        found: [u8; 4],
    },
    /// Written by another version of this program.
    #[error(
        "{what} has format version {found}, this program reads version {expected}; rebuild the dataset with this version, or use the version that wrote it"
    )]
    Version {
        /// What was being decoded.
        what: &'static str,
        /// Version in the data.
        found: u32,
        /// Version that is understood.
        expected: u32,
    },
    /// A value that the format does not allow.
    #[error("{field} is {value}; {rule}")]
    Range {
        /// The field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What is allowed.
        rule: &'static str,
    },
    /// A compressed section that zstd rejects, or that has another length than announced.
    #[error("{field}: zstd: {reason}")]
    Compression {
        /// The section.
        field: &'static str,
        /// What zstd says.
        reason: String,
    },
    /// Two parts of the data contradict each other.
    #[error("{field}: {reason}")]
    Mismatch {
        /// The field at which it shows.
        field: &'static str,
        /// How.
        reason: String,
    },
}

impl CodecError {
    /// A [`CodecError::Range`].
    pub(crate) fn range(field: &'static str, value: impl std::fmt::Display, rule: &'static str) -> Self {
        Self::Range { field, value: value.to_string(), rule }
    }
    /// A [`CodecError::Mismatch`].
    pub(crate) fn mismatch(field: &'static str, reason: impl Into<String>) -> Self {
        Self::Mismatch { field, reason: reason.into() }
    }
}
