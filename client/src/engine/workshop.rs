//! Images laid out beside the drawing, on a thread of its own, so that no picture waits for them.
//!
//! What is wanted is said anew with every picture, the most urgent first: nothing is laid out that nobody wants any more.

use super::layouts::{Layout, Wanted};
use std::{
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
};

/// See the module; the thread ends with it.
#[derive(Debug)]
pub struct Workshop {
    desk: Arc<(Mutex<Desk>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Desk {
    wanted: Vec<Wanted>,
    /// Packed for a card as well.
    pack: bool,
    busy: Option<Wanted>,
    done: Vec<Layout>,
    stop: bool,
}

impl Desk {
    fn is_under_way(&self, wanted: &Wanted) -> bool {
        self.busy.iter().chain(self.done.iter().map(|l| &l.of)).any(|w| w.is(wanted))
    }
}

fn lock(desk: &Mutex<Desk>) -> MutexGuard<'_, Desk> {
    // Every change is complete before anything can panic.
    desk.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Workshop {
    /// Begins.
    ///
    /// # Errors
    /// If the system gives no threads.
    pub fn open() -> std::io::Result<Self> {
        // One thread that does not take part in the drawing: the pool of the drawing would wait for layouts in the middle of a picture.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(std::io::Error::other)?;
        let desk = Arc::<(Mutex<Desk>, Condvar)>::default();
        let seen = desk.clone();
        let work = move || {
            while let Some((wanted, pack)) = next(&seen) {
                let layout = pool.install(|| Layout::new(wanted, pack));
                let mut desk = lock(&seen.0);
                desk.busy = None;
                desk.done.push(layout);
            }
        };
        let thread = std::thread::Builder::new().name("ldi-layout".into()).spawn(work)?;
        Ok(Self { desk, thread: Some(thread) })
    }

    /// What was finished since the last time.
    pub fn take(&self) -> Vec<Layout> {
        std::mem::take(&mut lock(&self.desk.0).done)
    }

    /// Whether something was.
    pub fn has_finished(&self) -> bool {
        !lock(&self.desk.0).done.is_empty()
    }

    /// These from now on, in this order, and nothing that was wanted before. `pack`: for a card as well.
    pub fn want(&self, images: Vec<Wanted>, pack: bool) {
        let mut desk = lock(&self.desk.0);
        desk.pack = pack;
        desk.wanted = images.into_iter().filter(|w| !desk.is_under_way(w)).collect();
        self.desk.1.notify_one();
    }
}

/// Waits for something to do. None: stop.
fn next((desk, changed): &(Mutex<Desk>, Condvar)) -> Option<(Wanted, bool)> {
    let mut desk = lock(desk);
    loop {
        if desk.stop {
            return None;
        }
        if !desk.wanted.is_empty() {
            let first = desk.wanted.remove(0);
            desk.busy = Some(first.clone());
            return Some((first, desk.pack));
        }
        desk = changed.wait(desk).unwrap_or_else(PoisonError::into_inner);
    }
}

impl Drop for Workshop {
    fn drop(&mut self) {
        lock(&self.desk.0).stop = true;
        self.desk.1.notify_one();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
