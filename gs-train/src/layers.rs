//! Settings that several methods share, as layers of TOML beneath a method's own
//! ([`MethodEntry::defaults`](crate::registry::MethodEntry::defaults)). A layer states what differs from those before it, with the
//! source of the value behind it. Of a learning rate, `end = start`, `steps = 0` and `per_extent = false` may be left out.
//!
//! | layer | settings of | with |
//! |---|---|---|
//! | [`BASE`] | all methods | – |
//! | [`CLOUD`] | clouds of Gaussians (3DGS) | [`BASE`] |
//! | [`DEFORMED`] | clouds that a field moves after a warm-up at rest (Deformable 3DGS) | [`CLOUD`] |
//! | [`FOLLOW`] | views let in by time (TRACE), and a stage in which only the field learns (ours) | [`DEFORMED`] |
//! | [`STILL`] | splats left out of the field while training (ours) | [`CLOUD`] |
//! | [`NETWORK`] | the field of Deformable 3DGS | [`DEFORMED`] |
//! | [`PLANES`] | the field of 4DGS | [`CLOUD`] |
//!
//! `FAST` and `TINY` are layers of the presets `fast` and `tiny`.

/// Of all methods.
pub const BASE: &str = include_str!("layers/base.toml");
/// Of clouds of Gaussians.
pub const CLOUD: &str = include_str!("layers/cloud.toml");
/// Of clouds of Gaussians, preset `fast`.
pub const CLOUD_FAST: &str = include_str!("layers/cloud.fast.toml");
/// Of clouds of Gaussians, preset `tiny`.
pub const CLOUD_TINY: &str = include_str!("layers/cloud.tiny.toml");
/// Of clouds that a field moves after a warm-up at rest.
pub const DEFORMED: &str = include_str!("layers/deformed.toml");
/// Of views let in by time, and a stage in which only the field learns.
pub const FOLLOW: &str = include_str!("layers/follow.toml");
/// Of methods compared by what they forecast, preset `fast`: one schedule for all.
pub const MOTION_FAST: &str = include_str!("layers/motion.fast.toml");
/// Of the field of Deformable 3DGS.
pub const NETWORK: &str = include_str!("layers/network.toml");
/// Of the field of Deformable 3DGS, preset `fast`.
pub const NETWORK_FAST: &str = include_str!("layers/network.fast.toml");
/// Of the field of Deformable 3DGS, preset `tiny`.
pub const NETWORK_TINY: &str = include_str!("layers/network.tiny.toml");
/// Of the field of 4DGS.
pub const PLANES: &str = include_str!("layers/planes.toml");
/// Of the field of 4DGS, preset `fast`.
pub const PLANES_FAST: &str = include_str!("layers/planes.fast.toml");
/// Of the field of 4DGS, preset `tiny`.
pub const PLANES_TINY: &str = include_str!("layers/planes.tiny.toml");
/// Of splats that are left out of the field while training.
pub const STILL: &str = include_str!("layers/still.toml");
