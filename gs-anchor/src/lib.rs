//! Scaffold anchors (Lu et al. 2024) and their deformation in two stages (MoDec-GS, Kwak et al. 2025).
//!
//! An anchor is a point on a lattice with a feature; small MLPs decode it, given the view direction, into `k` Gaussians
//! ("neural Gaussians"). Storage is per anchor, not per Gaussian.
//!
//! ```
//! use gs_anchor::{AnchorShape, Anchors, DecodeTape, Decoder, DecoderConfig, LocalAnchors, Visible};
//! use gs_core::Splats;
//!
//! let shape = AnchorShape { offsets: 10, features: 32, dynamics: 0 };
//! let anchors = Anchors::new(shape, &[glam::Vec3::ZERO], &[-3.0]);
//! let decoder = Decoder::new(&DecoderConfig::default(), shape, 1)?;
//! let (mut local, mut tape, mut splats) = (LocalAnchors::default(), DecodeTape::default(), Splats::default());
//! anchors.activate(&mut local);
//! decoder.forward(&local, Visible::All, glam::DVec3::NEG_Z, &mut tape, &mut splats);
//! assert_eq!(splats.len(), tape.rows.len());
//! # Ok::<(), gs_anchor::DecoderError>(())
//! ```
//!
//! # Data flow
//! ```text
//! Anchors ── activate ──▶ LocalAnchors ── visible, Decoder ──▶ Splats ──▶ (a field per frame) ──▶ render
//!        └─ Gad at t_c ─┘                                            Lgd
//! ```
//! * [`Anchors`]: positions, offsets, features, scales, dynamics as parameter blocks; [`init`] makes them from points.
//! * [`LocalAnchors`]: activated anchors, canonical ([`Anchors::activate`]) or deformed for an interval ([`Gad`]). One kept
//!   per interval is an exact cache.
//! * [`visible`]: which anchors to decode for a camera without changing the image.
//! * [`Decoder`]: from activated anchors to Gaussians, forward and backward.
//! * [`Lgd`]: the field per frame, on feature planes or hash grids.
//! * [`AnchorDensify`]: growing and pruning of anchors; [`Intervals`]: the temporal intervals, and when their boundaries move.
//! * [`storage`]: bytes, as published and as needed. [`mod@reference`]: `f64` references of decoding and deformation.
//!
//! Every forward has an analytic backward: gradients are added, never overwritten; tapes are kept by the caller, and a
//! warm one allocates nothing.
//!
//! # Conventions
//! Those of [`gs_core`]. Positions, scales and displacements are in world units, offsets in units of the first three
//! scales. Scales of a [`LocalAnchors`] are linear and may be negative; those of Gaussians are not. Opacities are the heads'
//! `tanh` (Gaussians with a positive one exist); colours are plain RGB that the network computes from the view
//! direction. Results are the same bits for any number of threads.
//!
//! # What it leaves out
//! Appearance per camera (one shared vector, as in the released code). The implicit local stage (a second deformation
//! of anchors). Rotations and opacities of anchors, which the released code stores and never reads. Training is
//! in `gs-train`, rendering in `gs-raster`.
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

pub mod adapt;
pub mod anchors;
pub mod decode;
pub mod gad;
pub mod init;
pub mod intervals;
mod lattice;
pub mod lgd;
pub mod local;
pub mod reference;
mod setting;
pub mod storage;
pub mod visible;

pub use adapt::{AnchorDensify, AnchorDensifyReport, AnchorDensifyRules, AnchorDensifyStep, AnchorView};
pub use anchors::{AnchorShape, Anchors};
pub use decode::{DecodeTape, Decoder, DecoderConfig, DecoderError, HeadInputs, Visible};
pub use gad::{Gad, GadConfig, GadHead, GadTape};
pub use init::{AnchorInit, InitError, InitialAnchors, anchors_from_points};
pub use intervals::{Adjustment, IntervalConfig, Intervals};
pub use lgd::{Lgd, LgdConfig, LgdEncoder, LgdHashConfig, LgdTape};
pub use local::{LocalAnchors, LocalAnchorsGrad};
pub use setting::SettingError;
pub use storage::{StorageSizes, StorageTable};
pub use visible::VisibilityOptions;
