//! Anchors that are decoded to Gaussians as a camera sees them.
//!
//! * [`scaffold`]: a static scene (Scaffold-GS, Lu et al. 2024).
//! * [`modec`]: anchors deformed once per interval of time (GAD), their Gaussians once per timestamp (LGD), intervals that
//!   adjust to the motion (MoDec-GS, Kwak et al. 2025).
//! * [`journal`]: the section of the report on intervals and anchors.
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

use gs_train::registry::MethodEntry;

pub mod anchored;
pub mod journal;
pub mod modec;
pub mod scaffold;

/// The methods of this crate.
pub const METHODS: &[MethodEntry] = &[scaffold::ENTRY, modec::ENTRY];
