//! What can be wrong with a setting.

/// A law or a field that cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PhysicsError {
    /// A key has a value that cannot be built.
    #[error("physics setting `{field}` = {value} cannot be built: it must be {rule}")]
    Config {
        /// The key.
        field: &'static str,
        /// The value met.
        value: String,
        /// What it must satisfy.
        rule: &'static str,
    },
    /// The box is not one.
    #[error("the box of the scene from {min} to {max} is empty or not finite; give two corners, the lowest first")]
    Bounds {
        /// Lowest corner met.
        min: glam::Vec3,
        /// Highest corner met.
        max: glam::Vec3,
    },
}

/// Refuses a count outside `lo..=hi`.
pub(crate) fn within(
    field: &'static str,
    v: usize,
    lo: usize,
    hi: usize,
    rule: &'static str,
) -> Result<(), PhysicsError> {
    check(field, v, (lo..=hi).contains(&v), rule)
}

/// Refuses a value unless it is `good`.
pub(crate) fn check(
    field: &'static str,
    value: impl std::fmt::Display,
    good: bool,
    rule: &'static str,
) -> Result<(), PhysicsError> {
    if good { Ok(()) } else { Err(PhysicsError::Config { field, value: value.to_string(), rule }) }
}
