//! Where other walkers are: wished for by whoever shows it, told by the server, kept through connections that come and go.

use ldi_protocol::{said::escaped, wire::Other};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// See the module.
#[derive(Debug, Default)]
pub struct OtherWalkers(Mutex<Known>);

#[derive(Debug, Default)]
struct Known {
    request_state: OthersRequest,
    walkers: Option<Vec<Other>>,
}

/// Whether somebody wants to know, and the how manieth wish this is: one that comes back before the server heard that it was gone is a new one, as what was known is forgotten.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct OthersRequest {
    pub wanted: bool,
    number: u64,
}

impl OtherWalkers {
    /// Asks the server to tell, or to stop.
    pub fn set_wanted(&self, wanted: bool) {
        let mut known = self.lock();
        if known.request_state.wanted != wanted {
            known.request_state = OthersRequest { wanted, number: known.request_state.number + 1 };
            known.walkers = None;
        }
    }

    /// As the server said last; None when it has not, or does not tell.
    pub fn list(&self) -> Option<Vec<Other>> {
        self.lock().walkers.clone()
    }

    pub(super) fn request_state(&self) -> OthersRequest {
        self.lock().request_state
    }

    pub(super) fn set(&self, mut walkers: Vec<Other>) {
        walkers.iter_mut().for_each(|w| w.name = escaped(&w.name).into_owned());
        let mut known = self.lock();
        // What comes after the wish is gone is old by the time of the next one.
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
