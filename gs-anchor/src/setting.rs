//! A setting outside its domain.

/// A field of a configuration that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("`{field}` = {value}: {rule}")]
pub struct RuleError {
    /// Name of the field, with its section: `adapt.every`.
    pub field: &'static str,
    /// The value met.
    pub value: f64,
    /// What it must be.
    pub rule: &'static str,
}

/// The value of `field` is `value`; `good` says whether it follows `rule`.
pub(crate) fn need(
    good: bool,
    field: &'static str,
    value: impl Into<f64>,
    rule: &'static str,
) -> Result<(), RuleError> {
    if good { Ok(()) } else { Err(RuleError { field, value: value.into(), rule }) }
}
