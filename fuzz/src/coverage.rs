//! Which edges of the program an input takes, from the counters that LLVM's SanitizerCoverage adds (coverage.toml).
#![allow(unsafe_code, reason = "the counters are memory that the compiler lays out")]

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};

/// Counters in a word: one byte for each edge.
const IN_WORD: usize = 8;

static START: AtomicUsize = AtomicUsize::new(0);
static END: AtomicUsize = AtomicUsize::new(0);

/// Called before `main` with the range of all counters.
#[unsafe(no_mangle)]
extern "C" fn __sanitizer_cov_8bit_counters_init(start: *mut u8, end: *mut u8) {
    START.store(start.expose_provenance(), Relaxed);
    END.store(end.expose_provenance(), Relaxed);
}

/// The counters; none if the program was built without them. Up to seven edges at either end are left out.
fn counters() -> &'static [AtomicU64] {
    let start = START.load(Relaxed).next_multiple_of(IN_WORD);
    let words = END.load(Relaxed).saturating_sub(start) / IN_WORD;
    if words == 0 {
        return &[];
    }
    // SAFETY: the linker gave this range of plain bytes and it lives as long as the program; the start is aligned above.
    // Everybody writes to it without locks, so it is shared as atomics.
    unsafe { std::slice::from_raw_parts(std::ptr::with_exposed_provenance(start), words) }
}

/// Whether the program was built with counters.
pub fn is_built_in() -> bool {
    !counters().is_empty()
}

/// How often each edge was taken, as classes of counts, over all inputs.
pub struct Coverage {
    counters: &'static [AtomicU64],
    /// A bit for each class of counts that an edge has had.
    seen: Vec<[u8; IN_WORD]>,
}

impl Coverage {
    /// No edge was taken yet. In a program without counters none ever is.
    pub fn new() -> Self {
        let counters = counters();
        Self { counters, seen: vec![[0; IN_WORD]; counters.len()] }
    }

    /// Forgets what was counted.
    pub fn reset(&self) {
        self.counters.iter().filter(|word| word.load(Relaxed) != 0).for_each(|word| word.store(0, Relaxed));
    }

    /// Whether an edge was taken as often as never before.
    pub fn is_new(&mut self) -> bool {
        let mut new = false;
        for (counts, seen) in self.counters.iter().zip(&mut self.seen) {
            let counts = counts.load(Relaxed);
            if counts == 0 {
                continue;
            }
            for (count, seen) in counts.to_ne_bytes().into_iter().zip(seen) {
                let class = class(count);
                new |= *seen & class != class;
                *seen |= class;
            }
        }
        new
    }

    /// Number of edges taken so far.
    pub fn edges(&self) -> u64 {
        self.seen.iter().flatten().filter(|seen| **seen != 0).count() as u64
    }
}

/// The bit of a count: 0 has none, then 1, 2, 3, 4 to 7, 8 to 15, 16 to 31, 32 to 127, more.
fn class(count: u8) -> u8 {
    match count {
        0 => 0,
        1..=3 => 1 << (count - 1),
        4..=7 => 8,
        8..=15 => 16,
        16..=31 => 32,
        32..=127 => 64,
        128.. => 128,
    }
}
