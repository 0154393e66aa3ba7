//! Work in progress.

pub mod checkpoint;
