//! Deformation fields: canonical splats and a time in, the splats at that time out, with exact gradients back.

pub mod aabb;
pub mod apply;
pub mod encode;
pub mod field;
pub mod reference;

pub use aabb::Aabb;
pub use field::{DefGsConfig, DefMlp, Field, FourDgsConfig, HexPlaneField};
use glam::Vec3;

/// What is wrong with a field's configuration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DeformError {
    /// A key has a value that cannot be built.
    #[error("field setting `{field}` = {value} cannot be built: it must be {rule}")]
    Config {
        /// The key.
        field: &'static str,
        /// The value met.
        value: String,
        /// What it must satisfy.
        rule: &'static str,
    },
    /// The box is not one.
    #[error(
        "the box from {min} to {max} is empty or not finite; give the corners of the scene, or at least one finite point"
    )]
    Aabb {
        /// Lowest corner met.
        min: Vec3,
        /// Highest corner met.
        max: Vec3,
    },
}
