//! Counts the memory that is allocated, per thread and for the whole process.
//!
//! A test binary installs it: `#[global_allocator] static ALLOCATOR: Counting = Counting;`. Memory
//! that C libraries allocate is not counted.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    sync::atomic::{AtomicIsize, Ordering::Relaxed},
};

thread_local! {
    static LIVE: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
}
static PROCESS: AtomicIsize = AtomicIsize::new(0);
static PROCESS_PEAK: AtomicIsize = AtomicIsize::new(0);

/// The system's allocator, with counters.
#[derive(Debug)]
pub struct Counting;

fn add(bytes: isize) {
    // Fails while a thread ends: its last bytes are counted for the process alone.
    let _ = LIVE.try_with(|live| {
        live.set(live.get() + bytes);
        let _ = PEAK.try_with(|peak| peak.set(peak.get().max(live.get())));
    });
    let now = PROCESS.fetch_add(bytes, Relaxed) + bytes;
    PROCESS_PEAK.fetch_max(now, Relaxed);
}

// SAFETY: every call goes to the system's allocator as it is. The counters allocate nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        add(layout.size() as isize);
        // SAFETY: the caller keeps the rules of `alloc`.
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        add(layout.size() as isize);
        // SAFETY: the caller keeps the rules of `alloc_zeroed`.
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        add(-(layout.size() as isize));
        // SAFETY: the caller keeps the rules of `dealloc`.
        unsafe { System.dealloc(memory, layout) }
    }
    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        add(bytes as isize - layout.size() as isize);
        // SAFETY: the caller keeps the rules of `realloc`.
        unsafe { System.realloc(memory, layout, bytes) }
    }
}

/// Most bytes that this thread holds at once while `run` runs, beyond those it holds before.
pub fn peak_of<T>(run: impl FnOnce() -> T) -> (T, usize) {
    let before = LIVE.get();
    PEAK.set(before);
    let out = run();
    (out, (PEAK.get() - before).max(0) as usize)
}

/// Most bytes that the process holds at once while `run` runs, beyond those it holds before.
pub fn process_peak_of<T>(run: impl FnOnce() -> T) -> (T, usize) {
    let before = PROCESS.load(Relaxed);
    PROCESS_PEAK.store(before, Relaxed);
    let out = run();
    (out, (PROCESS_PEAK.load(Relaxed) - before).max(0) as usize)
}
