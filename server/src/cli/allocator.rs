//! The allocator of the program: the system's, memory in a file where a limit is given, and a plain
//! end where neither has more.
//!
//! Rust ends a process without memory by SIGABRT, and some libraries panic. Neither says what to
//! do.

use super::file_memory::{FileMemory, PAGE};
#[cfg(target_os = "linux")]
use super::memory_watch;
use std::{
    alloc::{GlobalAlloc, Layout, System},
    fmt,
    io::{self, Write},
    path::Path,
    sync::OnceLock,
    sync::atomic::{AtomicBool, Ordering},
};

/// Hands out the system's memory, or a file's under `--memory-limit`; without any left the program
/// ends with a message and exit code 42.
#[derive(Debug)]
pub struct ExitingAllocator;

/// Where what is larger than a page comes from under `--memory-limit`.
static IN_FILE: OnceLock<FileMemory> = OnceLock::new();

/// From now on the process holds at most `bytes` bytes of memory, as far as what is not in use may
/// lie in a file in `folder` instead.
///
/// # Errors
/// The file cannot be made.
pub(super) fn limit_memory(bytes: u64, folder: &Path) -> io::Result<()> {
    let memory = FileMemory::new(folder, bytes)?;
    if IN_FILE.set(memory).is_ok()
        && let Some(memory) = IN_FILE.get()
    {
        memory.watch();
    }
    Ok(())
}

/// From now on the program ends with a message where the kernel would soon kill it for want of
/// memory.
///
/// # Errors
/// No thread can be started.
#[cfg(target_os = "linux")]
pub(super) fn watch_memory() -> io::Result<()> {
    memory_watch::watch(|shortage| {
        end(format_args!(
            "{shortage}; give --memory-limit, raise what the group may have, or stop what else runs; the same build goes on where it was"
        ))
    })
}

/// What allocations of this layout come from if not from the system.
fn file_for(layout: Layout) -> Option<&'static FileMemory> {
    IN_FILE.get().filter(|_| layout.size() >= PAGE && layout.align() <= PAGE)
}

/// What handed out an allocation if not the system.
fn file_of(at: *mut u8) -> Option<&'static FileMemory> {
    IN_FILE.get().filter(|memory| memory.holds(at))
}

// SAFETY: memory comes from the system's allocator by the same calls, or from blocks of
// `FileMemory`, which go back to it; where either has none nothing is returned.
unsafe impl GlobalAlloc for ExitingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        match file_for(layout) {
            Some(memory) => taken(memory, layout.size()).0,
            // SAFETY: as the caller promises.
            None => checked(unsafe { System.alloc(layout) }, layout.size()),
        }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        let Some(memory) = file_for(layout) else {
            // SAFETY: as the caller promises.
            return checked(unsafe { System.alloc_zeroed(layout) }, layout.size());
        };
        let (at, zero) = taken(memory, layout.size());
        if !zero {
            // SAFETY: the block has as many bytes.
            unsafe { at.write_bytes(0, layout.size()) };
        }
        at
    }
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller promises that it is valid.
        let new_layout = unsafe { Layout::from_size_align_unchecked(size, layout.align()) };
        let within = |bytes: usize| FileMemory::block_bytes(bytes);
        match (file_of(at), file_for(new_layout)) {
            // SAFETY: as the caller promises.
            (None, None) => checked(unsafe { System.realloc(at, layout, size) }, size),
            (Some(_), Some(_)) if within(size) == within(layout.size()) => at,
            _ => {
                // SAFETY: both allocations have as many bytes, and the old one goes after it.
                unsafe {
                    let new = self.alloc(new_layout);
                    std::ptr::copy_nonoverlapping(at, new, layout.size().min(size));
                    self.dealloc(at, layout);
                    new
                }
            }
        }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        match file_of(at) {
            // SAFETY: it came from there for this layout.
            Some(memory) => unsafe { memory.give(at, layout.size()) },
            // SAFETY: as the caller promises.
            None => unsafe { System.dealloc(at, layout) },
        }
    }
}

/// A block of the file, or the end of the program.
fn taken(memory: &FileMemory, bytes: usize) -> (*mut u8, bool) {
    memory.take(bytes).unwrap_or_else(|| {
        end(format_args!(
            "{bytes} bytes more are not to be had on the disk for what is beyond --memory-limit; free space beside the \
             output, or raise the limit; the same build goes on where it was"
        ))
    })
}

fn checked(at: *mut u8, bytes: usize) -> *mut u8 {
    if at.is_null() {
        end(format_args!(
            "{bytes} bytes more are not to be had of the system: raise the limit of the process (ulimit -v), give \
             --memory-limit, or take a machine with more; the same build goes on where it was"
        ));
    }
    at
}

/// Says that there is no memory, without any, and ends the program.
#[cold]
fn end(what: fmt::Arguments<'_>) -> ! {
    static SAID: AtomicBool = AtomicBool::new(false);
    if !SAID.swap(true, Ordering::Relaxed) {
        let mut text = [0; 640];
        let mut left = &mut text[..];
        let _ = writeln!(left, "ldi-server: out of memory: {what}");
        let free = left.len();
        let _ = rustix::io::write(rustix::stdio::stderr(), &text[..text.len() - free]);
    }
    // A permanent failure, as of all commands.
    std::process::exit(42)
}
