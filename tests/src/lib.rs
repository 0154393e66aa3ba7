//! Tests that need several crates at once live in this package's `tests` folder; it has no code of its own.
//! The Rust code of the user guide is compiled and run here.

#[cfg(doctest)]
#[doc = include_str!("../../docs/guide/library.md")]
pub struct Guide;
