//! How far connecting is: written by the streaming thread, read by whoever shows it.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering::Relaxed};

/// What connecting is at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Phase {
    /// Not begun.
    #[default]
    Idle,
    /// Looking for the server.
    Dialling,
    /// The server answered and was asked in.
    Asking,
    /// The dataset's index is coming.
    Index,
    /// It is here and being put together.
    Assembling,
}

const PHASES: [Phase; 5] = [Phase::Idle, Phase::Dialling, Phase::Asking, Phase::Index, Phase::Assembling];

/// Counters of one attempt after another.
#[derive(Debug, Default)]
pub struct ConnectProgress {
    phase: AtomicU8,
    bytes: AtomicU64,
    total: AtomicU64,
}

impl ConnectProgress {
    /// What it is at.
    pub fn phase(&self) -> Phase {
        PHASES[usize::from(self.phase.load(Relaxed)) % PHASES.len()]
    }

    /// Stored bytes of the index that came, and of all of it; 0 of 0 before that is known.
    pub fn index_bytes(&self) -> (u64, u64) {
        (self.bytes.load(Relaxed), self.total.load(Relaxed))
    }

    pub(super) fn enter(&self, phase: Phase) {
        self.phase.store(phase as u8, Relaxed);
        if phase == Phase::Dialling {
            self.bytes.store(0, Relaxed);
            self.total.store(0, Relaxed);
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
