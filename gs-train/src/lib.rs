//! Work in progress.

pub mod checkpoint;
pub mod config;
pub mod data;
