//! The error of a setting outside its domain.

/// A setting outside its domain.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("`{field}` = {value}: {rule}")]
pub struct SettingError {
    /// Name of the setting with its section: `adapt.every`.
    pub field: &'static str,
    /// The value of the setting, as it would be written.
    pub value: String,
    /// The domain in words: `at least 1 step`.
    pub rule: &'static str,
}

/// An error for `field` = `value` unless `good`.
pub(crate) fn require(
    good: bool,
    field: &'static str,
    value: impl ToString,
    rule: &'static str,
) -> Result<(), SettingError> {
    if good { Ok(()) } else { Err(SettingError { field, value: value.to_string(), rule }) }
}
