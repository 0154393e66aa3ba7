//! Encoders: from a point and a time to a row of features, and back.

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
pub use hexplane::{HexBlock, HexPlane, HexTape, Places};
