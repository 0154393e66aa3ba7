//! A learning rate runs log-linearly from `start` to `end` over `steps` (3D Gaussian Splatting, Kerbl et al. 2023), or drops
//! from the one to the other:
//! ```text
//! lr(s) = exp((1 − τ) ln start + τ ln end)        τ = clamp(s / steps, 0, 1)        decay = "log"
//! lr(s) = start if s < steps, else end                                            decay = "step"
//! ```

use serde::{Deserialize, Serialize};
use toml::Value;

/// How a learning rate goes from its start to its end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Decay {
    /// Log-linearly.
    #[default]
    Log,
    /// At once, after all its steps.
    Step,
}

/// The learning rate of a group of parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearningRate {
    /// At the first step.
    pub start: f32,
    /// After `steps` steps.
    pub end: f32,
    /// Length of the decay; 0: constant at `start`.
    pub steps: u32,
    /// How it decays.
    #[serde(default)]
    pub decay: Decay,
    /// Multiplied by the extent of the scene (the parameter is a length).
    pub per_extent: bool,
    /// Adam's ε of these parameters; 0: [`adam_eps`](super::Schedule::adam_eps).
    #[serde(default)]
    pub eps: f32,
    /// Values that received no gradient in this step rest (tables of which a step touches hardly anything).
    #[serde(default)]
    pub sparse: bool,
    /// No learning before this step of the clock.
    #[serde(default)]
    pub from: u32,
    /// The rate rises linearly over so many first updates of each block; 0: it begins in full. Adam's first steps are as long as
    /// any others, however little is known by then.
    #[serde(default)]
    pub ramp: u32,
    /// Weight decay of these parameters, times the rate, per step (AdamW).
    #[serde(default)]
    pub weight_decay: f32,
}

impl LearningRate {
    /// A constant rate.
    pub const fn constant(rate: f32) -> Self {
        Self {
            start: rate,
            end: rate,
            steps: 0,
            decay: Decay::Log,
            per_extent: false,
            eps: 0.0,
            sparse: false,
            from: 0,
            ramp: 0,
            weight_decay: 0.0,
        }
    }

    /// A log-linear decay.
    pub const fn decay(start: f32, end: f32, steps: u32) -> Self {
        Self { start, end, steps, ..Self::constant(start) }
    }

    /// The same rate, multiplied by the extent of the scene.
    pub const fn per_extent(mut self) -> Self {
        self.per_extent = true;
        self
    }

    /// The rate at a step, once it has risen, for a scene of the given extent (world units).
    pub fn at(&self, step: u32, extent: f32) -> f32 {
        if step < self.from {
            return 0.0;
        }
        let rate = match self.decay {
            _ if self.steps == 0 => f64::from(self.start),
            Decay::Step => f64::from(if step < self.steps { self.start } else { self.end }),
            Decay::Log if self.start <= 0.0 || self.end <= 0.0 => f64::from(self.start),
            Decay::Log => {
                let tau = (f64::from(step) / f64::from(self.steps)).min(1.0);
                ((1.0 - tau) * f64::from(self.start).ln() + tau * f64::from(self.end).ln()).exp()
            }
        };
        (rate * if self.per_extent { f64::from(extent) } else { 1.0 }) as f32
    }
}

/// Writes out what the rates of a configuration leave out: `end` as `start`, no `steps`, not `per_extent`.
pub(crate) fn complete_rates(config: &mut toml::Table) {
    let groups = config.get_mut("schedule").and_then(|s| s.get_mut("lr")).and_then(Value::as_table_mut);
    let rates = groups.into_iter().flatten().filter_map(|(_, group)| group.as_table_mut()).flatten();
    for rate in rates.filter_map(|(_, rate)| rate.as_table_mut()) {
        let Some(start) = rate.get("start").cloned() else { continue };
        rate.entry("end").or_insert(start);
        rate.entry("steps").or_insert(0.into());
        rate.entry("per_extent").or_insert(false.into());
    }
}

/// The fields that the rates of a configuration may have: key, and the value that changes nothing.
///
/// # Errors
/// None as long as every field can be written as TOML.
pub fn rate_fields(config: &toml::Table) -> Result<Vec<(String, Value)>, toml::ser::Error> {
    let fields = toml::Table::try_from(LearningRate::constant(0.0))?;
    let groups = config.get("schedule").and_then(|s| s.get("lr")).and_then(Value::as_table);
    let rates = groups.into_iter().flatten().flat_map(|(group, rates)| {
        let names = rates.as_table().into_iter().flat_map(toml::Table::keys);
        names.map(move |name| format!("schedule.lr.{group}.{name}"))
    });
    let of = |rate: String| fields.iter().map(move |(field, value)| (format!("{rate}.{field}"), value.clone()));
    Ok(rates.flat_map(of).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_decay_log_linearly() {
        let rate = LearningRate::decay(1e-2, 1e-4, 100);
        for (step, want) in [(0, 1e-2), (50, 1e-3), (100, 1e-4), (1000, 1e-4)] {
            assert!((rate.at(step, 7.0) / want - 1.0).abs() < 1e-6, "step {step}: {}", rate.at(step, 7.0));
        }
        assert!((rate.per_extent().at(50, 3.0) / 3e-3 - 1.0).abs() < 1e-6);
        assert_eq!(LearningRate::constant(0.5).at(9, 1.0), 0.5);
        let dropped = LearningRate { decay: Decay::Step, ..LearningRate::decay(1e-2, 1e-3, 100) };
        assert_eq!([0, 99, 100, 1000].map(|step| dropped.at(step, 1.0)), [1e-2, 1e-2, 1e-3, 1e-3]);
        let late = LearningRate { from: 10, ..LearningRate::constant(0.5) };
        assert_eq!([9, 10, 11].map(|step| late.at(step, 2.0)), [0.0, 0.5, 0.5]);
    }
}
