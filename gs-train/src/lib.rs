//! Work in progress.

pub mod adam;
pub mod checkpoint;
pub mod config;
pub mod data;
pub mod density;
pub mod moment;
pub mod schedule;
