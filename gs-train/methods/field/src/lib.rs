//! Canonical Gaussians, moved by a deformation field or by nothing.
//!
//! | method | field | source |
//! |---|---|---|
//! | [`static3d`] | none | 3D Gaussian Splatting, Kerbl et al. 2023 |
//! | [`defgs`] | one MLP over encoded position and time | Deformable 3D Gaussians, Yang et al. 2024 |
//! | [`fourdgs`] | six feature planes over space and time | 4D Gaussian Splatting, Wu et al. 2024 |
//! | [`grid4d`] | four hash grids over triples of x, y, z, t | Grid4D, Xu et al. 2024 |
//! | [`fags`] | Grid4D with a Fourier branch, a gate, a learnt kernel profile and an amplitude-spectrum loss | FAGS |
//! | [`acutance`] | Grid4D with a sharpness per splat | one part of Deformable Radial Kernels |
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

use gs_train::registry::MethodEntry;

pub mod acutance;
pub mod defgs;
pub mod deformed;
pub mod fags;
pub mod fourdgs;
pub mod grid4d;
pub mod static3d;

/// The methods of this crate.
pub const METHODS: &[MethodEntry] =
    &[static3d::ENTRY, defgs::ENTRY, fourdgs::ENTRY, grid4d::ENTRY, fags::ENTRY, acutance::ENTRY];
