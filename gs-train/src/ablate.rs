//! Ablations: parts of a method to leave out, by the names of its paper's table.
//!
//! A method lists its [`Part`]s; the setting `ablate = "gate,fre"` names those to leave out.

use crate::error::MethodError;
use crate::registry::parse_config;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// A part by its name, and what leaves it out of a configuration.
pub type Part<C> = (&'static str, fn(&mut C));

/// Parts to leave out: names with commas between them, or nothing.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub struct Ablations(Vec<String>);

impl Ablations {
    /// Leaves the parts out.
    ///
    /// # Errors
    /// If there is no part of that name; says which there are. If the settings or the other names leave it out already: the run would
    /// be the same as without the name, and show nothing about the part.
    pub fn apply<C: Clone + PartialEq>(&self, parts: &[Part<C>], config: &mut C) -> Result<(), String> {
        let leave_out: Vec<fn(&mut C)> = self.0.iter().map(|name| find(parts, name)).collect::<Result<_, _>>()?;
        for (i, name) in self.0.iter().enumerate() {
            let mut others = config.clone();
            (0..leave_out.len()).filter(|&j| j != i).for_each(|j| leave_out[j](&mut others));
            let mut all = others.clone();
            leave_out[i](&mut all);
            if all == others {
                return Err(format!(
                    "the settings or the other parts leave `{name}` out already: turn it on, or do not name it in `ablate`"
                ));
            }
        }
        leave_out.iter().for_each(|f| f(config));
        Ok(())
    }
}

/// Reads a method's configuration and leaves out the `parts` that it names; what is read names none. `names` is where a configuration has
/// its setting `ablate`.
///
/// # Errors
/// Those of [`parse_config`] and of [`Ablations::apply`].
pub fn read_without<C: DeserializeOwned + Clone + PartialEq>(
    method: &'static str,
    table: &toml::Table,
    parts: &[Part<C>],
    names: fn(&mut C) -> &mut Ablations,
) -> Result<C, MethodError> {
    let mut config: C = parse_config(method, table)?;
    let ablate = std::mem::take(names(&mut config));
    ablate.apply(parts, &mut config).map_err(|why| MethodError::Config { method, why })?;
    Ok(config)
}

/// What leaves the part of that name out.
fn find<C>(parts: &[Part<C>], name: &str) -> Result<fn(&mut C), String> {
    parts.iter().find(|part| part.0 == name).map(|part| part.1).ok_or_else(|| {
        let known: Vec<&str> = parts.iter().map(|part| part.0).collect();
        format!("there is no part `{name}` to leave out; choose of {}", known.join(", "))
    })
}

impl From<String> for Ablations {
    fn from(text: String) -> Self {
        Self(text.split(',').map(|n| n.trim().to_owned()).filter(|n| !n.is_empty()).collect())
    }
}

impl From<Ablations> for String {
    fn from(ablations: Ablations) -> String {
        ablations.0.join(",")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without the first part the second has nothing to work on.
    const PARTS: &[Part<[bool; 2]>] = &[("whole", |c| c[0] = false), ("detail", |c| c[1] &= !c[0])];

    #[test]
    fn parts_that_another_leaves_out_are_refused_in_any_order() {
        for names in ["whole,detail", "detail,whole", "detail,detail"] {
            let mut config = [true, true];
            let error = Ablations::from(names.to_owned()).apply(PARTS, &mut config);
            assert_eq!(config, [true, true], "{names}: nothing is left out");
            assert!(error.is_err_and(|e| e.contains("`detail` out already")), "{names}");
        }
        for (name, left) in [("whole", [false, true]), ("detail", [true, false])] {
            let mut config = [true, true];
            Ablations::from(name.to_owned()).apply(PARTS, &mut config).unwrap();
            assert_eq!(config, left, "{name}");
        }
    }
}
