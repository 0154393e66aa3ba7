//! Scaffold anchors (Lu et al. 2024) and their deformation in two stages (MoDec-GS, Kwak et al. 2025).
//!
//! ("neural Gaussians"). Bytes are kept per anchor, not per Gaussian.

pub mod adapt;
pub mod anchors;
pub mod init;
pub mod lattice;
pub mod neighbours;
pub mod rule;

pub use adapt::{Adapt, AdaptAt, AdaptRules, AnchorView, Grown};
pub use anchors::{AnchorShape, Anchors};
pub use init::{AnchorInit, InitError, Initial, anchors_from_points};
pub use rule::RuleError;
