//! Settings that several methods of this crate share ([`gs_train::layers`]).

/// Dynamics that continue past the last training time.
pub(crate) const PHYSICS: &str = include_str!("physics.toml");
/// The same, preset `fast`.
pub(crate) const PHYSICS_FAST: &str = include_str!("physics.fast.toml");
/// The same, preset `tiny`.
pub(crate) const PHYSICS_TINY: &str = include_str!("physics.tiny.toml");
/// The network of place and time as TRACE has it.
pub(crate) const TRACE_NETWORK: &str = include_str!("network.toml");
/// TRACE's law of motion.
pub(crate) const LAW: &str = include_str!("law.toml");
/// The same, preset `fast`.
pub(crate) const LAW_FAST: &str = include_str!("law.fast.toml");
/// The same, preset `tiny`.
pub(crate) const LAW_TINY: &str = include_str!("law.tiny.toml");
