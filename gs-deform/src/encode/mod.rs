//! Encoders: from a point and a timestamp to a row of features, forward and backward.

mod backward;
mod config;
pub mod hash;
pub mod hexplane;
mod sample;
mod smooth;

pub use config::HexPlaneConfig;
pub use hash::config::HashGridConfig;
pub use hash::slice::Slice;
pub use hash::{Columns, HashGrid};
pub use hexplane::{GridCells, HexBlock, HexPlane, HexTape};
