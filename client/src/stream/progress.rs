//! Progress of connecting, and what the server says of the dataset, from the streaming thread to
//! the window.

use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering::Relaxed};

/// Phase of connecting.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Phase {
    /// Not started.
    #[default]
    Idle,
    /// Resolving the address and connecting.
    Dialling,
    /// Waiting for the server's acceptance.
    Asking,
    /// Receiving the dataset's index.
    Index,
    /// Assembling the index.
    Assembling,
}

const PHASES: [Phase; 5] = [Phase::Idle, Phase::Dialling, Phase::Asking, Phase::Index, Phase::Assembling];

/// Progress of the current connection.
#[derive(Debug, Default)]
pub struct ConnectProgress {
    phase: AtomicU8,
    bytes: AtomicU64,
    total: AtomicU64,
    replaced: AtomicBool,
}

impl ConnectProgress {
    /// Whether the server has a new build of the dataset of this connection.
    pub fn is_replaced(&self) -> bool {
        self.replaced.load(Relaxed)
    }

    pub(super) fn set_replaced(&self) {
        self.replaced.store(true, Relaxed);
    }

    /// The current phase.
    pub fn phase(&self) -> Phase {
        PHASES[usize::from(self.phase.load(Relaxed)) % PHASES.len()]
    }

    /// Received and total stored bytes of the index; zero until the total is known.
    pub fn index_bytes(&self) -> (u64, u64) {
        (self.bytes.load(Relaxed), self.total.load(Relaxed))
    }

    pub(super) fn enter(&self, phase: Phase) {
        self.phase.store(phase as u8, Relaxed);
        if phase == Phase::Dialling {
            self.bytes.store(0, Relaxed);
            self.total.store(0, Relaxed);
            self.replaced.store(false, Relaxed);
        }
    }

    pub(super) fn pages(&self, total: u64) {
        self.total.store(total, Relaxed);
        self.enter(Phase::Index);
    }

    pub(super) fn page(&self, bytes: u64) {
        self.bytes.fetch_add(bytes, Relaxed);
    }
}
