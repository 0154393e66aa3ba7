//! Ablations: parts of a method to leave out, by the names of its paper's table.
//!
//! Of [`fags`](super::fags):
//!
//! | name | left out | how |
//! |---|---|---|
//! | `fdgk` | the bent kernel | Gaussian splats |
//! | `hfe` | the Fourier branch | `field.fourier.on = false` |
//! | `gate` | the gate, `η = 1` | `field.gate.on = false` |
//! | `fre` | the loss on spectra | `schedule.lambda_fre = 0` |
//! | `lambda` | λ per splat | one λ that all splats share, learnt (`λ = ½` would be `fdgk`, whatever β is) |
//! | `beta` | β per splat | `β = ½` |
//!
//! All of the first four together are [`grid4d`](super::grid4d). Those of [`modec`](super::modec) stand there.

use crate::methods::grid4d::Config;
use crate::methods::kernel::KernelKind;
use serde::{Deserialize, Serialize};

/// A part by its name, and what leaves it out of a configuration.
pub type Part<C> = (&'static str, fn(&mut C));

/// The parts of everything on the body of Grid4D.
pub(super) const GRID4D: &[Part<Config>] = &[
    ("fdgk", |c| c.cloud.kernel.kind = KernelKind::Gaussian),
    ("hfe", |c| c.field.fourier.on = false),
    ("gate", |c| c.field.gate.on = false),
    ("fre", |c| c.schedule.lambda_fre = 0.0),
    ("lambda", |c| c.cloud.kernel.shared_lambda = true),
    ("beta", |c| c.cloud.kernel.learn_beta = false),
];

/// Parts to leave out: names with commas between them, or nothing.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub struct Ablations(Vec<String>);

impl Ablations {
    /// Leaves the parts out.
    ///
    /// # Errors
    /// If there is no part of that name; says which there are.
    pub fn apply<C>(&self, parts: &[Part<C>], config: &mut C) -> Result<(), String> {
        for name in &self.0 {
            let Some((_, leave_out)) = parts.iter().find(|part| part.0 == name) else {
                let known: Vec<&str> = parts.iter().map(|part| part.0).collect();
                return Err(format!("there is no part `{name}` to leave out; choose of {}", known.join(", ")));
            };
            leave_out(config);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::{MethodEntry, parse_config};

    fn config(method: &'static str, ablate: &str) -> Config {
        let mut table = MethodEntry::find(method).unwrap().config("tiny").unwrap();
        table.insert("ablate".into(), ablate.into());
        let mut config: Config = parse_config(method, &table).unwrap();
        config.ablate.clone().apply(GRID4D, &mut config).unwrap();
        config
    }

    #[test]
    fn without_its_parts_fags_is_grid4d() {
        let (bare, mut plain) = (config("fags", "fdgk, hfe,gate,fre"), config("grid4d", ""));
        plain.ablate = bare.ablate.clone();
        assert_eq!(bare, plain);
        assert_eq!(String::from(bare.ablate), "fdgk,hfe,gate,fre");
        assert_ne!(config("fags", ""), config("grid4d", ""));
    }

    #[test]
    fn lambda_and_beta_are_left_out_each_for_itself() {
        let kernel = |ablate| config("fags", ablate).cloud.kernel;
        let full = kernel("");
        assert_eq!(kernel("lambda"), crate::methods::kernel::KernelConfig { shared_lambda: true, ..full });
        assert_eq!(kernel("beta"), crate::methods::kernel::KernelConfig { learn_beta: false, ..full });
    }

    #[test]
    fn unknown_parts_are_refused_with_the_known_ones() {
        let mut fags = config("fags", "");
        let error = Ablations::from("gate,fdkg".to_owned()).apply(GRID4D, &mut fags).unwrap_err();
        assert!(error.contains("`fdkg`") && error.contains("fdgk, hfe, gate"), "{error}");
        assert_eq!(Ablations::from(String::new()), Ablations::default());
    }
}
