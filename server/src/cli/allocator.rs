//! The allocator of the program: the system's, and a plain end where that has no more memory.
//!
//! Rust ends a process without memory by SIGABRT, and some libraries panic. Neither says what to
//! do.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    io::Write,
    sync::atomic::{AtomicBool, Ordering},
};

/// Hands out the system's memory; without any left the program ends with a message and exit code
/// 42.
#[derive(Debug)]
pub struct ExitingAllocator;

// SAFETY: memory comes from the system's allocator alone, by the same calls; where that fails
// nothing is returned.
unsafe impl GlobalAlloc for ExitingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller promises.
        checked(unsafe { System.alloc(layout) }, layout.size())
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller promises.
        checked(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: as the caller promises.
        checked(unsafe { System.realloc(at, layout, size) }, size)
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(at, layout) }
    }
}

fn checked(at: *mut u8, bytes: usize) -> *mut u8 {
    if at.is_null() {
        end(bytes);
    }
    at
}

/// Says that there is no memory, without any, and ends the program.
#[cold]
fn end(bytes: usize) -> ! {
    static SAID: AtomicBool = AtomicBool::new(false);
    if !SAID.swap(true, Ordering::Relaxed) {
        let mut text = [0; 256];
        let mut left = &mut text[..];
        let _ = writeln!(
            left,
            "ldi-server: out of memory: {bytes} bytes more are not to be had; raise the limit of the process (ulimit -v) or take \
             a machine with more; the same build goes on where it was"
        );
        let free = left.len();
        let _ = rustix::io::write(rustix::stdio::stderr(), &text[..text.len() - free]);
    }
    // A permanent failure, as of all commands.
    std::process::exit(42)
}
