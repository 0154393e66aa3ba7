//! Scaffold anchors (Lu et al. 2024) and their deformation in two stages (MoDec-GS, Kwak et al. 2025).
//!
//! An anchor is a point on a lattice with a feature; small networks decode it, as a camera sees it, into `k` Gaussians
//! ("neural Gaussians"). Bytes are kept per anchor, not per Gaussian.

pub mod anchors;

pub use anchors::{AnchorShape, Anchors};
