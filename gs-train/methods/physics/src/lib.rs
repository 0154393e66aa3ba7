//! Gaussians as rigid particles whose motion is learnt, so that it continues past the last training time.
//!
//! * [`trace`], [`trace_4dgs`]: translation-rotation dynamics per particle, beside the field of Deformable 3D Gaussians or of
//!   4D Gaussian Splatting (TRACE, Li et al. 2025).
//! * [`defgs_nvfi`]: the baseline TRACE compares with, a velocity field with a physics-informed loss (NVFi, Li et al. 2023).
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

use gs_train::registry::MethodEntry;

pub mod advected;
pub mod defgs_nvfi;
mod layers;
pub mod trace;
pub mod trace_4dgs;

/// The methods of this crate.
pub const METHODS: &[MethodEntry] = &[trace::ENTRY, trace_4dgs::ENTRY, defgs_nvfi::ENTRY];
