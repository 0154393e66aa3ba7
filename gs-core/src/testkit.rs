//! Help for the tests of several crates (feature `testkit`): shared captures and golden files, an allocator that counts
//! ([`alloc`]), and a disk that fails ([`faults`]).
//!
//! Captures may not be shipped, so a fresh clone has none. The folder is `$GS4D_SHARED`, else `shared` beside the workspace.
//! A test without its data reports that it was skipped, or fails where `GS4D_REQUIRE_SHARED` is 1.

pub mod alloc;
#[cfg(feature = "io")]
pub mod faults;

use std::io::Write;
use std::path::PathBuf;

/// Path of a capture or golden file, given `relative` to the shared folder. `None`, after [`skip`], where it is absent.
///
/// # Panics
/// As [`skip`].
pub fn shared(relative: &str) -> Option<PathBuf> {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let path = std::env::var_os("GS4D_SHARED").map_or_else(beside, PathBuf::from).join(relative);
    if path.exists() {
        return Some(path);
    }
    // The test harness names each thread after its test.
    skip(std::thread::current().name().unwrap_or("a test"), &format!("`{relative}`"));
    None
}

/// Reports that `test` checks nothing: `SKIPPED <test>: <what> is absent`, one line on stderr.
///
/// # Panics
/// If the environment variable `GS4D_REQUIRE_SHARED` is 1.
pub fn skip(test: &str, what: &str) {
    let line = format!("SKIPPED {test}: {what} is absent");
    assert!(std::env::var_os("GS4D_REQUIRE_SHARED").is_none_or(|v| v != "1"), "{line}, but GS4D_REQUIRE_SHARED is 1");
    // Not `eprintln!`, whose output the test harness captures.
    let _ = writeln!(std::io::stderr(), "{line}");
}
