//! Encoders: from a point and a time to a row of features, and back.

mod backward;
mod config;
pub mod hexplane;
mod sample;
mod smooth;

pub use config::HexPlaneConfig;
pub use hexplane::{HexBlock, HexPlane, HexTape};
