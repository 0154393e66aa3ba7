//! Scaffold anchors (Lu et al. 2024) and their deformation in two stages (MoDec-GS, Kwak et al. 2025).
//!
//! An anchor is a point on a lattice with a feature; small networks decode it, as a camera sees it, into `k` Gaussians
//! ("neural Gaussians"). Bytes are kept per anchor, not per Gaussian.

pub mod anchors;
pub mod decode;
pub mod local;
pub mod reference;

pub use anchors::{AnchorShape, Anchors};
pub use decode::{DecodeTape, Decoder, DecoderConfig, DecoderError, DistanceInputs, Visible};
pub use local::{Local, LocalGrad};
