//! Magnitudes of the learnt motion of particles, in the units of the data.
//!
//! At the time of the particles, with a particle at `x`, `r = x − o` and the twist `(v̄, w)` with its rates `(ā, ε)`:
//! ```text
//! velocity v = v̄ + w × r      acceleration a = ā + ε × r + w × v      spin |w|      change of spin |ε|
//! ```
//! (the derivatives of the path `x' = v̄(τ) + w(τ) × (x − o)`). Splats of opacity below 1/255 are left out.

use super::Clock;
use crate::particles::Particles;
use glam::Vec3;
use gs_core::cast;
use gs_physics::{Integrator, LawForm};
use gs4d_report::inspect::INVISIBLE_OPACITY;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Share of its distance from the axis that a particle may gain or lose in a step.
pub const MOST_GROWTH: f64 = 1e-3;

/// Distribution of a quantity over splats.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct QuantityStats {
    /// `speed`, `spin`, `acceleration` or `change of spin`.
    pub name: &'static str,
    /// Unit of the values below, for example `units/s`.
    pub unit: String,
    /// Median over the visible splats.
    pub median: f64,
    /// 90th percentile over the visible splats.
    pub p90: f64,
    /// 99th percentile over the visible splats.
    pub p99: f64,
    /// Largest value over the visible splats.
    pub max: f64,
}

/// Statistics of the learnt motion of a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Physics {
    /// Normalised time of the particles.
    pub at: f64,
    /// Number of visible splats, those counted.
    pub splats: usize,
    /// Unit of time: `s`, or `sequence` where the data have no clock.
    pub time_unit: &'static str,
    /// Speed, spin, acceleration and change of spin. The last is left out for a flow, whose motions do not say it.
    pub spreads: Vec<QuantityStats>,
    /// Splats that rotate too fast for the integration step, if that is known and there are any.
    pub fast: Option<FastSplats>,
}

/// Splats whose distance from their axis a step of the integration changes by more than [`MOST_GROWTH`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FastSplats {
    /// Number of splats that rotate too fast.
    pub splats: usize,
    /// Largest rotation in a step, radians.
    pub turn: f64,
    /// Integration step, in normalised time.
    pub step: f64,
    /// Largest share of its distance that a splat gains in a step; below 0 where it loses.
    pub growth: f64,
    /// What to set.
    pub remedy: &'static str,
}

/// Integration of particles by a configuration: `physics.step_frames` and `law.integrator`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    /// Longest step, in normalised time.
    pub length: f64,
    /// Rule of every step.
    pub rule: Integrator,
    /// The settings that make steps good enough.
    pub remedy: &'static str,
}

impl Steps {
    /// The steps of a method's [effective](gs_train::registry::MethodEntry::effective()) configuration on data with this normalised
    /// frame interval; `None` without such settings, and where particles follow a closed form.
    pub fn of(config: &toml::Table, frame_interval: f32) -> Option<Self> {
        let length = config.get("physics")?.get("step_frames")?.as_float()? * f64::from(frame_interval);
        // Velocity fields have one rule.
        let Some(law) = config.get("law") else {
            return Some(Self { length, rule: Integrator::Rk2, remedy: "a smaller physics.step_frames" });
        };
        let closed = matches!(setting(law, "form"), Some(LawForm::Gvfi13 | LawForm::Free));
        let remedy = "law.integrator = \"se3_mid\" or a smaller physics.step_frames";
        let rule = setting(law, "integrator").filter(|_| !closed)?;
        Some(Self { length, rule, remedy })
    }
}

/// A setting of a section, if it is there.
fn setting<T: DeserializeOwned>(section: &toml::Value, name: &str) -> Option<T> {
    section.get(name)?.clone().try_into().ok()
}

impl Physics {
    /// Computes the statistics; without a clock, time is measured in sequences.
    pub fn of(particles: &Particles, clock: Option<Clock>, steps: Option<Steps>) -> Self {
        let visible = particles.splats.opacities.iter().map(|&o| o >= INVISIBLE_OPACITY);
        let rows = particles.splats.means.iter().zip(&particles.motions).zip(visible);
        let seen: Vec<[f64; 4]> = rows
            .filter(|(_, visible)| *visible)
            .map(|((&x, m), _)| {
                let r = (x - particles.origin).to_array();
                let all = [m.twist.velocity(r), m.twist.w, m.acceleration(r), m.rate.w];
                all.map(|q| f64::from(Vec3::from_array(q).length()))
            })
            .collect();
        let (unit, rate) = Clock::unit(clock);
        let names = [
            ("speed", format!("units/{unit}"), 1),
            ("spin", format!("rad/{unit}"), 1),
            ("acceleration", format!("units/{unit}²"), 2),
            ("change of spin", format!("rad/{unit}²"), 2),
        ];
        let spread = |(i, (name, unit, power)): (usize, (&'static str, String, i32))| {
            let mut values: Vec<f64> = seen.iter().map(|row| row[i] / rate.powi(power)).collect();
            values.sort_by(f64::total_cmp);
            let quantile = |q: f64| values.get(cast::to_usize(((values.len() as f64 - 1.0) * q).round())).copied();
            let [median, p90, p99, max] = [0.5, 0.9, 0.99, 1.0].map(|q| quantile(q).unwrap_or(0.0));
            QuantityStats { name, unit, median, p90, p99, max }
        };
        let known = if particles.lasting { names.len() } else { names.len() - 1 };
        let spreads = names.into_iter().take(known).enumerate().map(spread).collect();
        let fast = steps.and_then(|steps| fast(&seen, steps));
        Self { at: particles.at, splats: seen.len(), time_unit: unit, spreads, fast }
    }
}

fn fast(seen: &[[f64; 4]], Steps { length, rule, remedy }: Steps) -> Option<FastSplats> {
    let turns = seen.iter().map(|row| row[1] * length).filter(|turn| rule.growth(*turn).abs() > MOST_GROWTH);
    let turns: Vec<f64> = turns.collect();
    let growth = turns.iter().map(|t| rule.growth(*t)).max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    let turn = turns.iter().copied().fold(0.0, f64::max);
    Some(FastSplats { splats: turns.len(), turn, step: length, growth, remedy })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Splats;
    use gs_physics::{Motion, Twist};
    use gs_train::registry::overlay;

    /// A wheel of radius ½ that rolls along x, half a turn per unit of time: the lowest point rests, the highest is at twice
    /// the speed of the hub.
    fn wheel() -> Particles {
        let pi = std::f32::consts::PI;
        let hub = Vec3::new(0.0, 0.0, 0.5);
        let (v_c, w) = (Vec3::new(0.5 * pi, 0.0, 0.0), Vec3::new(0.0, pi, 0.0));
        let origin = Vec3::new(0.3, -0.2, 0.1);
        let twist = Twist { v: (v_c + w.cross(origin - hub)).to_array(), w: w.to_array() };
        let rate = Twist { v: (-w.cross(v_c)).to_array(), w: [0.0; 3] };
        let motion = Motion { twist, rate, ..Motion::default() };
        let means = vec![Vec3::ZERO, hub, Vec3::new(0.0, 0.0, 1.0), Vec3::new(9.0, 9.0, 9.0)];
        let opacities = vec![1.0, 1.0, 1.0, 0.0];
        let splats = Splats { means, opacities, ..Splats::default() };
        Particles { at: 0.7, splats, motions: vec![motion; 4], origin, lasting: true }
    }

    #[test]
    fn a_rolling_wheel_has_the_speeds_of_its_points() {
        let pi = std::f64::consts::PI;
        let p = Physics::of(&wheel(), None, None);
        assert_eq!(
            (p.splats, p.time_unit, p.fast.is_none()),
            (3, "sequence", true),
            "what cannot be seen does not count"
        );
        let near = |a: f64, b: f64| (a - b).abs() < 1e-5;
        let [speed, spin, acceleration, change] = &p.spreads[..] else { panic!("four quantities") };
        assert!(near(speed.median, 0.5 * pi) && near(speed.max, pi), "{speed:?}");
        assert!(near(spin.median, pi) && near(change.max, 0.0));
        // Towards the hub, w² r: 0 at the hub, π²/2 at the rim.
        assert!(near(acceleration.max, 0.5 * pi * pi) && near(acceleration.median, 0.5 * pi * pi), "{acceleration:?}");
        let clock = Clock { start: 5.0, rate: 2.0 };
        let p = Physics::of(&wheel(), Some(clock), None);
        assert!(near(p.spreads[0].max, 0.5 * pi) && near(p.spreads[2].max, 0.125 * pi * pi) && p.time_unit == "s");
        assert_eq!(p.spreads[2].unit, "units/s²");
        let flow = Physics::of(&Particles { lasting: false, ..wheel() }, None, None);
        assert_eq!(flow.spreads.iter().map(|s| s.name).collect::<Vec<_>>(), ["speed", "spin", "acceleration"]);
    }

    /// The wheel turns by 0.31 in a step of 0.1, by 0.13 in one of 0.04.
    #[test]
    fn turns_too_fast_for_their_steps_are_found() {
        let config = |text: &str| format!("[physics]\nstep_frames = 2.0\n{text}").parse::<toml::Table>().unwrap();
        let fast = |text: &str, frame| Physics::of(&wheel(), None, Steps::of(&config(text), frame)).fast;
        let found = fast("[law]\nintegrator = \"rk2\"", 0.05).unwrap();
        assert!(found.splats == 3 && (found.turn - 0.1 * std::f64::consts::PI).abs() < 1e-6, "{found:?}");
        assert!(
            (found.growth - found.turn.powi(4) / 8.0).abs() < 1e-5 && found.remedy.contains("se3_mid"),
            "{found:?}"
        );
        assert!(fast("[law]\nintegrator = \"rk2\"", 0.02).is_none(), "slow enough for the second order");
        for first in ["euler", "mid_params"] {
            let found = fast(&format!("[law]\nintegrator = \"{first}\""), 0.02).unwrap();
            assert!(found.splats == 3 && (found.growth - 7.9e-3).abs() < 1e-4, "{first}: {found:?}");
        }
        let flow = fast("[velocity]\nhidden = 3", 0.05).unwrap();
        assert!(flow.splats == 3 && flow.remedy == "a smaller physics.step_frames", "{flow:?}");
        let kept = [
            "[law]\nintegrator = \"rk4\"",
            "[law]\nintegrator = \"se3_mid\"",
            "[law]\nintegrator = \"rk2\"\nform = \"gvfi13\"",
            "[law]\nintegrator = \"rk2\"\nform = \"free\"",
        ];
        assert!(kept.iter().all(|text| fast(text, 0.05).is_none()), "these keep radii");
        assert_eq!(Steps::of(&"[field]\nwidth = 3".parse().unwrap(), 0.05), None);
    }

    /// Without rigid motion particles go straight.
    #[test]
    fn without_its_physics_trace_has_no_steps() {
        let entry = gs_methods::registry().find("trace").unwrap();
        let steps = |ablate: &str| {
            let mut config = entry.config("tiny").unwrap();
            let more = format!("ablate = \"{ablate}\"\nlaw.integrator = \"rk2\"");
            overlay(&mut config, more.parse().unwrap());
            Steps::of(&entry.effective(&config).unwrap(), 0.05)
        };
        assert_eq!(steps("field, physics"), None);
        for ablate in ["", "field", "equivalent"] {
            assert_eq!(steps(ablate).map(|s| s.rule), Some(Integrator::Rk2), "{ablate}");
        }
    }
}
