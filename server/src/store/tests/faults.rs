//! Calls of the file system that fail where a test wants them to: those below a folder of the test,
//! on any thread.

use std::{
    io,
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

struct State {
    folder: PathBuf,
    calls: u64,
    /// The call that fails, and whether all after it do too, as after a kill.
    fails: Option<(u64, bool)>,
    free_bytes: Option<u64>,
}

/// One for each test that runs now.
static STATES: Mutex<Vec<State>> = Mutex::new(Vec::new());

fn states() -> MutexGuard<'static, Vec<State>> {
    STATES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs something while a change below a folder fails, by its number; with `for_good` all later
/// ones do too, so that nothing changes any more.
pub fn failing_at<T>(folder: &Path, call: u64, for_good: bool, run: impl FnOnce() -> T) -> T {
    with(folder, Some((call, for_good)), None, run).0
}

/// Runs something on a disk with so much room.
pub fn with_free_bytes<T>(folder: &Path, bytes: u64, run: impl FnOnce() -> T) -> T {
    with(folder, None, Some(bytes), run).0
}

/// How many changes something makes below a folder.
pub fn changes_of(folder: &Path, run: impl FnOnce()) -> u64 {
    with(folder, None, None, run).1
}

fn with<T>(folder: &Path, fails: Option<(u64, bool)>, free_bytes: Option<u64>, run: impl FnOnce() -> T) -> (T, u64) {
    states().push(State { folder: folder.to_owned(), calls: 0, fails, free_bytes });
    let out = run();
    let mut states = states();
    let at = states.iter().rposition(|s| s.folder == folder).expect("pushed above");
    (out, states.remove(at).calls)
}

fn of<T>(path: &Path, ask: impl FnOnce(&mut State) -> T) -> Option<T> {
    states().iter_mut().find(|s| path.starts_with(&s.folder)).map(ask)
}

impl State {
    fn is_failing(&self) -> bool {
        self.fails.is_some_and(|(at, for_good)| self.calls == at || (for_good && self.calls > at))
    }
}

/// Whether the next change of this path fails.
pub fn is_next(path: &Path) -> bool {
    of(path, |s| s.is_failing()).unwrap_or(false)
}

/// Called before every change.
pub fn before_change(path: &Path) -> io::Result<()> {
    let fails = of(path, |s| {
        let fails = s.is_failing();
        s.calls += 1;
        fails
    });
    match fails {
        Some(true) => Err(io::ErrorKind::StorageFull.into()),
        _ => Ok(()),
    }
}

/// What a disk says that a test made small.
pub fn free_bytes(path: &Path) -> Option<u64> {
    of(path, |s| s.free_bytes).flatten()
}
