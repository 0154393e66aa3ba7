//! Scaffold anchors (Lu et al. 2024) and their deformation in two stages (MoDec-GS, Kwak et al. 2025).
//!
//! An anchor is a point on a lattice with a feature; small networks decode it, as a camera sees it, into `k` Gaussians
//! ("neural Gaussians"). Bytes are kept per anchor, not per Gaussian.
//!
//! ```
//! use gs_anchor::{AnchorShape, Anchors, DecodeTape, Decoder, DecoderConfig, Local, Visible};
//! use gs_core::Splats;
//!
//! let shape = AnchorShape { offsets: 10, features: 32, dynamics: 0 };
//! let anchors = Anchors::new(shape, &[glam::Vec3::ZERO], &[-3.0]);
//! let decoder = Decoder::new(&DecoderConfig::default(), shape, 1)?;
//! let (mut local, mut tape, mut splats) = (Local::default(), DecodeTape::default(), Splats::default());
//! anchors.activate(&mut local);
//! decoder.forward(&local, Visible::All, glam::DVec3::NEG_Z, &mut tape, &mut splats);
//! assert_eq!(splats.len(), tape.rows.len());
//! # Ok::<(), gs_anchor::DecoderError>(())
//! ```
//!
//! # The road
//! ```text
//! Anchors ── activate ──▶ Local ── visible, Decoder ──▶ Splats ──▶ (a field per frame) ──▶ picture
//!        └─ Gad at t_c ─┘                                            gs_deform::HexPlaneField
//! ```
//! * [`Anchors`]: positions, offsets, features, scales, dynamics as blocks of parameters; [`init`] makes them from points.
//! * [`Local`]: anchors made concrete, at rest ([`Anchors::activate`]) or in an interval ([`Gad`]). One kept per interval
//!   is an exact cache.
//! * [`visible`]: which anchors to decode, without changing the picture.
//! * [`Decoder`]: from what an anchor says to its Gaussians, and back.
//! * [`Adapt`]: where anchors are grown and pruned; [`Intervals`]: where time is cut, and when the cuts move.
//! * [`storage`]: bytes, as published and as needed. [`mod@reference`]: the `f64` twins of decoding and deformation.
//!
//! Every forward pass has its way back written by hand next to it: gradients are added, never overwritten; tapes are kept
//! by the caller and allocate nothing once warm.
//!
//! # Conventions
//! Those of [`gs_core`]. Positions, scales and displacements are in world units, offsets in units of the first three
//! scales. Scales of a [`Local`] are linear and may be negative; of Gaussians they are sizes. Opacities are the heads' own
//! (`tanh`, positive ones exist); colours are plain RGB, with the direction of view seen by the network. Results are the
//! same bits for any number of threads.
//!
//! # What it leaves out
//! Appearance per camera (one shared vector, as released). The implicit local stage (a second deformation of anchors).
//! Rotations and opacities of anchors, which the released code stores and never reads. The local stage itself, training,
//! pictures: [`gs_deform`] and `gs-train`.

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
pub mod storage;
pub mod visible;

pub use adapt::{Adapt, AdaptAt, AdaptRules, AnchorView, Grown};
pub use anchors::{AnchorShape, Anchors};
pub use decode::{DecodeTape, Decoder, DecoderConfig, DecoderError, DistanceInputs, Visible};
pub use gad::{Gad, GadConfig, GadHead, GadTape};
pub use init::{AnchorInit, InitError, Initial, anchors_from_points};
pub use intervals::{Adjustment, IntervalConfig, Intervals};
pub use local::{Local, LocalGrad};
pub use rule::RuleError;
pub use storage::{StorageSizes, StorageTable};
pub use visible::Reach;
