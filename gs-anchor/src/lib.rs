//! Scaffold anchors (Lu et al. 2024) and their deformation in two stages (MoDec-GS, Kwak et al. 2025).
//!
//! An anchor is a point on a lattice with a feature; small networks decode it, as a camera sees it, into `k` Gaussians
//! ("neural Gaussians"). Bytes are kept per anchor, not per Gaussian.

pub mod adapt;
pub mod anchors;
pub mod decode;
pub mod gad;
pub mod init;
pub mod intervals;
pub mod lattice;
pub mod local;
pub mod neighbours;
pub mod reference;
pub mod rule;
pub mod visible;

pub use adapt::{Adapt, AdaptAt, AdaptRules, AnchorView, Grown};
pub use anchors::{AnchorShape, Anchors};
pub use decode::{DecodeTape, Decoder, DecoderConfig, DecoderError, DistanceInputs, Visible};
pub use gad::{Gad, GadConfig, GadHead, GadTape};
pub use init::{AnchorInit, InitError, Initial, anchors_from_points};
pub use intervals::{Adjustment, IntervalConfig, Intervals};
pub use local::{Local, LocalGrad};
pub use rule::RuleError;
pub use visible::Reach;
