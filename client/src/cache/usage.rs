//! Byte and object counts of the cache.

/// Byte and object counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Usage {
    /// Decoded bytes held.
    pub bytes: u64,
    /// Largest number of decoded bytes held so far.
    pub peak_bytes: u64,
    /// The capacity, decoded bytes.
    pub cap_bytes: u64,
    /// Objects held.
    pub objects: usize,
    /// Objects evicted so far.
    pub evictions: u64,
    /// Stored bytes of chunks that a frame has used since they arrived.
    pub useful_bytes: u64,
}
