//! The layout worker: lays out images on its own thread, so that no frame waits for a layout.
//!
//! Each frame replaces the list of requests, most urgent first, so that outdated requests are never
//! processed.

use super::image_layouts::{ImageLayout, LayoutRequest};
use std::{
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
};

/// The worker's handle. Dropping it ends the thread.
#[derive(Debug)]
pub struct LayoutWorker {
    shared: Arc<(Mutex<Shared>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    wanted: Vec<LayoutRequest>,
    /// Whether layouts are also needed in the GPU's format.
    pack: bool,
    busy: Option<LayoutRequest>,
    done: Vec<ImageLayout>,
    stop: bool,
}

impl Shared {
    fn is_under_way(&self, wanted: &LayoutRequest) -> bool {
        self.busy.iter().chain(self.done.iter().map(|l| &l.of)).any(|w| w.is(wanted))
    }
}

fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    // Every change is complete before anything can panic.
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl LayoutWorker {
    /// Starts the thread.
    ///
    /// # Errors
    /// If the system gives no threads.
    pub fn open() -> std::io::Result<Self> {
        // A pool of its own: in the renderer's pool, layouts would run in the middle of a frame.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(std::io::Error::other)?;
        let shared = Arc::<(Mutex<Shared>, Condvar)>::default();
        let seen = shared.clone();
        let work = move || {
            while let Some((wanted, pack)) = next(&seen) {
                let layout = pool.install(|| ImageLayout::new(wanted, pack));
                let mut shared = lock(&seen.0);
                shared.busy = None;
                shared.done.push(layout);
            }
        };
        let thread = std::thread::Builder::new().name("ldi-layout".into()).spawn(work)?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Takes the layouts finished since the last call.
    pub fn take_finished(&self) -> Vec<ImageLayout> {
        std::mem::take(&mut lock(&self.shared.0).done)
    }

    /// Whether finished layouts are waiting.
    pub fn has_finished(&self) -> bool {
        !lock(&self.shared.0).done.is_empty()
    }

    /// Replaces all requests, most urgent first. `pack`: also in the GPU's format.
    pub fn set_requests(&self, images: Vec<LayoutRequest>, pack: bool) {
        let mut shared = lock(&self.shared.0);
        shared.pack = pack;
        shared.wanted = images.into_iter().filter(|w| !shared.is_under_way(w)).collect();
        self.shared.1.notify_one();
    }
}

/// Waits for a request. None: the worker is to stop.
fn next((shared, changed): &(Mutex<Shared>, Condvar)) -> Option<(LayoutRequest, bool)> {
    let mut shared = lock(shared);
    loop {
        if shared.stop {
            return None;
        }
        if !shared.wanted.is_empty() {
            let first = shared.wanted.remove(0);
            shared.busy = Some(first.clone());
            return Some((first, shared.pack));
        }
        shared = changed.wait(shared).unwrap_or_else(PoisonError::into_inner);
    }
}

impl Drop for LayoutWorker {
    fn drop(&mut self) {
        lock(&self.shared.0).stop = true;
        self.shared.1.notify_one();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
