//! The renderer on a GPU: against the references of gs-raster, and against itself.

mod adapter;
#[path = "../../../tests/raster/common/mod.rs"]
mod common;
mod production;
mod repeat;
