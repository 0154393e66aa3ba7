//! An allocator that counts the bytes held: by every thread with their peak, and by all threads. A test binary declares it:
//!
//! ```
//! use gs_core::testkit::alloc::{Counting, held, peak_of};
//!
//! #[global_allocator]
//! static ALLOCATOR: Counting = Counting;
//!
//! let (_, peak) = peak_of(|| vec![0u8; 1 << 20]);
//! assert!(peak >= 1 << 20 && held() > 0);
//! ```
#![allow(unsafe_code, reason = "a global allocator is an unsafe trait")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicIsize, Ordering::Relaxed};

/// The system's allocator, with counters.
#[derive(Debug)]
pub struct Counting;

static HELD_BY_ALL: AtomicIsize = AtomicIsize::new(0);

thread_local! {
    static HELD: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
}

/// Adds to what this thread holds. Memory freed by another thread than the one that took it makes counts drift apart.
fn add(bytes: isize) {
    HELD_BY_ALL.fetch_add(bytes, Relaxed);
    // During thread shut-down the counters may be gone; nothing reads them then.
    let _ = HELD.try_with(|held| {
        held.set(held.get() + bytes);
        let _ = PEAK.try_with(|peak| peak.set(peak.get().max(held.get())));
    });
}

// SAFETY: every method hands its arguments unchanged to the system allocator, which keeps the contract; counting touches
// only an atomic and thread-local cells without destructors, and never allocates.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        add(layout.size() as isize);
        // SAFETY: the caller's contract is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        add(layout.size() as isize);
        // SAFETY: the caller's contract is passed on.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        add(-(layout.size() as isize));
        // SAFETY: the caller's contract is passed on.
        unsafe { System.dealloc(ptr, layout) }
    }

    unsafe fn realloc(&self, ptr: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        // Old and new block exist together during the copy.
        add(new_size as isize);
        add(-(layout.size() as isize));
        // SAFETY: the caller's contract is passed on.
        unsafe { System.realloc(ptr, layout, new_size) }
    }
}

/// Bytes that all threads hold.
pub fn held() -> usize {
    usize::try_from(HELD_BY_ALL.load(Relaxed)).unwrap_or(0)
}

/// Runs `work` on this thread; returns its result and the peak of the bytes held during it beyond those held before.
pub fn peak_of<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = HELD.get();
    PEAK.set(before);
    let result = work();
    (result, usize::try_from(PEAK.get() - before).unwrap_or(0))
}
