//! Ablations: parts of a method to leave out, by the names of its paper's table.
//!
//! A method lists its [`Part`]s; the setting `ablate = "gate,fre"` names those to leave out.

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
    /// If there is no part of that name; says which there are. If the settings have left it out already: the run would be the same as
    /// without the name, and show nothing about the part.
    pub fn apply<C: Clone + PartialEq>(&self, parts: &[Part<C>], config: &mut C) -> Result<(), String> {
        for name in &self.0 {
            let Some((_, leave_out)) = parts.iter().find(|part| part.0 == name) else {
                let known: Vec<&str> = parts.iter().map(|part| part.0).collect();
                return Err(format!("there is no part `{name}` to leave out; choose of {}", known.join(", ")));
            };
            let before = config.clone();
            leave_out(config);
            if *config == before {
                return Err(format!(
                    "the settings leave `{name}` out already: turn it on, or do not name it in `ablate`"
                ));
            }
        }
        Ok(())
    }
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
