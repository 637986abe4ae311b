//! Memory that lies in a file, so that a build takes scenes larger than the machine's memory.
//!
//! In: a limit and a folder. Out: blocks of memory for the program's allocator. All lie in one
//! shared mapping of a file without a name in that folder, so the operating system writes to it
//! what there is no room for and reads it again when it is touched. Where the program holds more
//! than its limit, pages of the mapping are given back to the system, oldest address first: they
//! stay in its cache as long as nothing else needs the room.
//!
//! Blocks have one of four sizes per power of two. What was freed is used for the next block of
//! its size; large blocks give their part of the file back at once.

use rustix::{
    fd::OwnedFd,
    fs::{FallocateFlags, Mode, OFlags, fallocate},
    mm::{Advice, MapFlags, ProtFlags, madvise, mmap},
};
use std::{
    ffi::c_void,
    io,
    path::Path,
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

/// Blocks are whole pages. Smaller allocations stay with the system's allocator: they would waste
/// most of a page.
pub(super) const PAGE: usize = 4096;
/// Address space of the mapping, which costs nothing until it is used; less where the process may
/// not have so much.
const ADDRESSES: [usize; 3] = [1 << 42, 1 << 38, 1 << 35];
/// The file grows by this many bytes. Larger: fewer calls; smaller: less disk space that is not
/// used.
const STEP: usize = 64 << 20;
/// Bytes given back to the system at once. More: fewer calls, but more comes back that was in use.
const GIVEN_BACK: usize = 16 << 20;
/// Pages are given back until no more than this share of the limit is held: what comes in until
/// the next look stays below the limit.
const KEPT_SHARE: f64 = 0.75;
/// Time between two looks at what the process holds. Longer: the limit is exceeded by what comes
/// in meanwhile; shorter: the looks themselves take time.
const LOOK: Duration = Duration::from_millis(50);
/// Freed blocks of so many bytes and more give their part of the file back. Smaller: less disk
/// space is held, for a call to the system per block.
const LARGE: usize = 1 << 20;
/// Sizes of blocks: four per power of two.
const CLASSES: usize = 128;

/// A block's class and its size in pages, at least `pages`.
fn class_of(pages: usize) -> (usize, usize) {
    if pages <= 4 {
        return (pages - 1, pages);
    }
    // Steps of a quarter of the power of two below.
    let power = (pages - 1).ilog2() as usize;
    let steps = pages.div_ceil(1 << (power - 2));
    (4 * (power - 1) + steps - 5, steps << (power - 2))
}

/// Memory in a file.
#[derive(Debug)]
pub(super) struct FileMemory {
    file: OwnedFd,
    base: usize,
    addresses: usize,
    limit: u64,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    /// Bytes of the mapping that were ever handed out.
    used: usize,
    /// Bytes of the file.
    backed: usize,
    /// Per class the first free block, 0 if there is none; each holds the address of the next.
    free: [usize; CLASSES],
    /// Where pages are given back next.
    next_back: usize,
}

impl FileMemory {
    /// Makes the file, without a name, in `folder`; `limit`: bytes that the process may hold.
    ///
    /// # Errors
    /// The file or the mapping cannot be made.
    pub fn new(folder: &Path, limit: u64) -> io::Result<Self> {
        let file = rustix::fs::open(folder, OFlags::TMPFILE | OFlags::RDWR | OFlags::CLOEXEC, Mode::RUSR | Mode::WUSR)?;
        let map = |bytes: usize| {
            // SAFETY: the system chooses an address where nothing is.
            unsafe {
                mmap(
                    std::ptr::null_mut(),
                    bytes,
                    ProtFlags::READ | ProtFlags::WRITE,
                    MapFlags::SHARED | MapFlags::NORESERVE,
                    &file,
                    0,
                )
            }
            .map(|at| (at as usize, bytes))
        };
        let mut mapped = map(ADDRESSES[0]);
        for bytes in &ADDRESSES[1..] {
            mapped = mapped.or_else(|_| map(*bytes));
        }
        let (base, addresses) = mapped?;
        let state = State { used: 0, backed: 0, free: [0; CLASSES], next_back: 0 };
        Ok(Self { file, base, addresses, limit, state: Mutex::new(state) })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a block came from here.
    pub fn holds(&self, at: *mut u8) -> bool {
        (self.base..self.base + self.addresses).contains(&(at as usize))
    }

    /// The bytes that a block for `bytes` has.
    pub fn block_bytes(bytes: usize) -> usize {
        class_of(bytes.div_ceil(PAGE).max(1)).1 * PAGE
    }

    /// A block of at least `bytes` bytes, aligned to [`PAGE`], and whether it is zero; None: the
    /// disk is full, or the addresses are used up.
    pub fn take(&self, bytes: usize) -> Option<(*mut u8, bool)> {
        let (class, pages) = class_of(bytes.div_ceil(PAGE).max(1));
        let bytes = pages * PAGE;
        // What follows must not allocate: it would come here again.
        let mut state = self.state();
        let at = state.free[class];
        if at != 0 {
            // SAFETY: a free block of this mapping holds the address of the next.
            state.free[class] = unsafe { *(at as *const usize) };
            drop(state);
            self.back(at - self.base, if bytes >= LARGE { bytes } else { 0 })?;
            return Some((at as *mut u8, false));
        }
        let (from, to) = (state.used, state.used + bytes);
        if to > self.addresses {
            return None;
        }
        let grows = to > state.backed;
        if grows {
            let more = (to - state.backed).next_multiple_of(STEP);
            self.back(state.backed, more)?;
            state.backed += more;
        }
        state.used = to;
        drop(state);
        if grows {
            self.keep_to_limit();
        }
        Some(((self.base + from) as *mut u8, true))
    }

    /// Takes disk space for a part of the file: what is written to memory without any ends the
    /// process by a signal.
    fn back(&self, from: usize, bytes: usize) -> Option<()> {
        if bytes == 0 {
            return Some(());
        }
        loop {
            match fallocate(&self.file, FallocateFlags::empty(), from as u64, bytes as u64) {
                Ok(()) => return Some(()),
                Err(rustix::io::Errno::INTR) => {}
                Err(_) => return None,
            }
        }
    }

    /// Takes a block back.
    ///
    /// # Safety
    /// It came from [`FileMemory::take`] for as many bytes, and nobody uses it any more.
    pub unsafe fn give(&self, at: *mut u8, bytes: usize) {
        let (class, pages) = class_of(bytes.div_ceil(PAGE).max(1));
        if pages * PAGE >= LARGE {
            // All but the page that names the next free block. Where it fails the space stays.
            let (from, bytes) = (at as usize - self.base + PAGE, (pages - 1) * PAGE);
            let hole = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
            let _ = fallocate(&self.file, hole, from as u64, bytes as u64);
        }
        let mut state = self.state();
        // SAFETY: the block is free, at least a page long and aligned.
        unsafe { *at.cast::<usize>() = state.free[class] };
        state.free[class] = at as usize;
    }

    /// Gives pages back to the system until the process holds less than its limit.
    fn keep_to_limit(&self) {
        let Some(mut held) = resident_bytes().filter(|held| *held > self.limit) else { return };
        let kept = (self.limit as f64 * KEPT_SHARE) as u64;
        let mut looked_at = 0;
        while held > kept {
            let mut state = self.state();
            let from = if state.next_back < state.used { state.next_back } else { 0 };
            let bytes = GIVEN_BACK.min(state.used - from);
            looked_at += bytes;
            if bytes == 0 || looked_at > state.used {
                return;
            }
            state.next_back = from + bytes;
            drop(state);
            // SAFETY: a shared mapping of a file: its contents are still there when touched again.
            let _ = unsafe { madvise((self.base + from) as *mut c_void, bytes, Advice::LinuxDontNeed) };
            held = resident_bytes().unwrap_or(0);
        }
    }

    /// Keeps the process to its limit from now on.
    pub fn watch(&'static self) {
        // Without a thread the limit is looked at whenever the file grows.
        let _ = std::thread::Builder::new().name("memory-limit".into()).spawn(move || {
            loop {
                std::thread::sleep(LOOK);
                self.keep_to_limit();
            }
        });
    }
}

/// Memory that the process holds, bytes; None where the system does not say. Allocates nothing.
fn resident_bytes() -> Option<u64> {
    let file = rustix::fs::open("/proc/self/statm", OFlags::RDONLY | OFlags::CLOEXEC, Mode::empty()).ok()?;
    let mut text = [0u8; 128];
    let n = rustix::io::read(&file, &mut text).ok()?;
    let pages = std::str::from_utf8(&text[..n]).ok()?.split(' ').nth(1)?;
    Some(pages.parse::<u64>().ok()? * rustix::param::page_size() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn blocks_are_large_enough_and_waste_at_most_a_quarter() {
        let (mut last, mut sizes) = ((0, 0), HashSet::new());
        for pages in 1..20_000 {
            let (class, size) = class_of(pages);
            assert!(size >= pages && size * 4 <= pages * 5 + 3, "{pages} pages get {size}");
            assert_eq!(class_of(size), (class, size), "a block goes back to where it came from");
            assert!(class == last.0 && size == last.1 || class == last.0 + 1 || pages == 1, "{pages}: classes ascend");
            last = (class, size);
            sizes.insert(class);
        }
        assert!(class_of(ADDRESSES[0] / PAGE).0 < CLASSES);
        assert_eq!(sizes.len(), last.0 + 1);
    }

    /// Random blocks, each filled with its own number: none overlaps another, and none loses
    /// anything when pages are given back. A limit of nothing gives all back whenever it is asked.
    #[test]
    fn blocks_keep_what_was_written() {
        let memory = FileMemory::new(&std::env::temp_dir(), 0).expect("a file");
        let mut seed = 7u64;
        let mut next = move || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 33) as usize
        };
        let mut blocks: Vec<(*mut u8, usize, u8)> = Vec::new();
        // SAFETY: all within blocks that were taken and not given.
        let same = |(at, bytes, with): &(*mut u8, usize, u8)| unsafe {
            std::slice::from_raw_parts(*at, *bytes).iter().all(|b| b == with)
        };
        for round in 0..2_000 {
            let bytes = 1 + next() % if round % 50 == 0 { 3 * LARGE } else { 40_000 };
            let (at, zero) = memory.take(bytes).expect("space");
            assert!(memory.holds(at) && (at as usize).is_multiple_of(PAGE));
            let block = (at, bytes, (round % 251) as u8 + 1);
            assert!(!zero || same(&(at, bytes, 0)));
            // SAFETY: within a block that was taken.
            unsafe { std::slice::from_raw_parts_mut(at, bytes).fill(block.2) };
            blocks.push(block);
            if round % 100 == 99 {
                memory.keep_to_limit();
                assert!(blocks.iter().all(same));
            }
            if next() % 3 > 0 {
                let block = blocks.swap_remove(next() % blocks.len());
                assert!(same(&block));
                // SAFETY: taken above, and no longer in the list.
                unsafe { memory.give(block.0, block.1) };
            }
        }
        assert!(blocks.len() > 100 && blocks.iter().all(same));
        let used = memory.state().used;
        blocks.iter().for_each(|(at, bytes, _)| {
            // SAFETY: taken above, and not used again.
            unsafe { memory.give(*at, *bytes) }
        });
        blocks.iter().for_each(|(_, bytes, _)| assert!(memory.take(*bytes).is_some()));
        assert_eq!(memory.state().used, used, "freed blocks are used again");
        assert!(!memory.holds(std::ptr::from_ref(&used).cast_mut().cast()));
    }
}
