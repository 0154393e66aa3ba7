//! Errors of the settings of laws and fields.

/// A law or a field that cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PhysicsError {
    /// A setting has a value that cannot be built.
    #[error("physics setting `{field}` = {value} cannot be built: it must be {rule}")]
    Config {
        /// Key of the setting, as in TOML.
        field: &'static str,
        /// The value given, as text.
        value: String,
        /// What the value must satisfy, to follow "it must be".
        rule: &'static str,
    },
    /// The bounding box of the scene is empty or not finite.
    #[error("the box of the scene from {min} to {max} is empty or not finite; give two corners, the lowest first")]
    Bounds {
        /// Lowest corner given, world units.
        min: glam::Vec3,
        /// Highest corner given, world units.
        max: glam::Vec3,
    },
}

/// Fails for a count outside `lo..=hi`.
pub(crate) fn within(
    field: &'static str,
    v: usize,
    lo: usize,
    hi: usize,
    rule: &'static str,
) -> Result<(), PhysicsError> {
    check(field, v, (lo..=hi).contains(&v), rule)
}

/// Fails unless the value is `good`.
pub(crate) fn check(
    field: &'static str,
    value: impl std::fmt::Display,
    good: bool,
    rule: &'static str,
) -> Result<(), PhysicsError> {
    if good { Ok(()) } else { Err(PhysicsError::Config { field, value: value.to_string(), rule }) }
}
