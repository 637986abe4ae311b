//! The other walkers' poses: requested by the map, sent by the server, kept across connections.

use ldi_protocol::{said::escaped, wire::Other};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Shared by the map and the session.
#[derive(Debug, Default)]
pub struct OtherWalkers(Mutex<Known>);

#[derive(Debug, Default)]
struct Known {
    request_state: OthersRequest,
    walkers: Option<Vec<Other>>,
}

/// A request for the other walkers, with its number. A request that is repeated before the server
/// knew of its withdrawal has a new number, as the previous poses are dropped.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct OthersRequest {
    pub wanted: bool,
    number: u64,
}

impl OtherWalkers {
    /// Requests the other walkers' poses, or ends the request.
    pub fn set_wanted(&self, wanted: bool) {
        let mut known = self.lock();
        if known.request_state.wanted != wanted {
            known.request_state = OthersRequest { wanted, number: known.request_state.number + 1 };
            known.walkers = None;
        }
    }

    /// The poses sent last; None before any, or if the server does not send them.
    pub fn list(&self) -> Option<Vec<Other>> {
        self.lock().walkers.clone()
    }

    pub(super) fn request_state(&self) -> OthersRequest {
        self.lock().request_state
    }

    pub(super) fn set(&self, mut walkers: Vec<Other>) {
        walkers.iter_mut().for_each(|w| w.name = escaped(&w.name).into_owned());
        let mut known = self.lock();
        // Poses that arrive after the request has ended would be outdated at the next one.
        if known.request_state.wanted {
            known.walkers = Some(walkers);
        }
    }

    pub(super) fn forget(&self) {
        self.lock().walkers = None;
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        // Every change is complete before anything can panic.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
