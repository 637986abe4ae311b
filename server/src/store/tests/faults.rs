//! Calls of the file system that fail where a test wants them to.

use std::{cell::RefCell, io};

#[derive(Default)]
struct State {
    calls: u64,
    /// The call that fails, and whether all after it do too, as after a kill.
    fails: Option<(u64, bool)>,
    free_bytes: Option<u64>,
}

thread_local! {
    static STATE: RefCell<State> = RefCell::default();
}

/// Runs something while a call fails, by its number; with `for_good` all later ones do too, so that
/// nothing changes any more.
pub fn failing_at<T>(call: u64, for_good: bool, run: impl FnOnce() -> T) -> T {
    with(State { fails: Some((call, for_good)), ..State::default() }, run).0
}

/// Runs something on a disk with so much room.
pub fn with_free_bytes<T>(bytes: u64, run: impl FnOnce() -> T) -> T {
    with(State { free_bytes: Some(bytes), ..State::default() }, run).0
}

/// How many changes something makes.
pub fn changes_of(run: impl FnOnce()) -> u64 {
    with(State::default(), run).1
}

fn with<T>(state: State, run: impl FnOnce() -> T) -> (T, u64) {
    STATE.replace(state);
    let out = run();
    (out, STATE.take().calls)
}

/// Whether the next change fails.
pub fn is_next() -> bool {
    STATE.with_borrow(|s| s.fails.is_some_and(|(at, for_good)| s.calls == at || (for_good && s.calls > at)))
}

/// Called before every change.
pub fn before_change() -> io::Result<()> {
    let fails = is_next();
    STATE.with_borrow_mut(|s| s.calls += 1);
    match fails {
        true => Err(io::ErrorKind::StorageFull.into()),
        false => Ok(()),
    }
}

/// What a disk says that a test made small.
pub fn free_bytes() -> Option<u64> {
    STATE.with_borrow(|s| s.free_bytes)
}
