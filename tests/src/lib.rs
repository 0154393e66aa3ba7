//! Tests that need several crates at once live in this package's `tests` folder; it has no code of its own.
