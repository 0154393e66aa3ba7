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
use gs4d_report::inspect::INVISIBLE_OPACITY;
use serde::Serialize;

/// Rotation in one step, radians, above which a second-order step changes radii by more than 0.1 %: `1 + z⁴/8`.
pub(crate) const MAX_ROTATION_PER_STEP: f64 = 0.3;

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
    /// Speed, spin, acceleration and change of spin.
    pub spreads: Vec<QuantityStats>,
    /// Splats that rotate by more than 0.3 radians in a step, if the step is known and its integrator is not rigid.
    pub fast: Option<FastSplats>,
}

/// Splats that rotate too fast for the integration step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FastSplats {
    /// Number of splats that rotate too fast.
    pub splats: usize,
    /// Largest rotation in a step, radians.
    pub turn: f64,
    /// Integration step, in normalised time.
    pub step: f64,
}

/// Integration of particles by a configuration: `physics.step_frames` and `law.integrator`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    /// Longest step, in normalised time.
    pub length: f64,
    /// Whether the integrator's steps are exact rigid motions (`se3…`).
    pub rigid: bool,
}

impl Steps {
    /// The steps of a method's configuration on data with this normalised frame interval; `None` without such settings.
    pub fn of(config: &toml::Table, frame_interval: f32) -> Option<Self> {
        let frames = config.get("physics")?.get("step_frames")?.as_float()?;
        let rule = config.get("law").and_then(|l| l.get("integrator")).and_then(toml::Value::as_str);
        Some(Self { length: frames * f64::from(frame_interval), rigid: rule.is_some_and(|r| r.starts_with("se3")) })
    }
}

impl Physics {
    /// Computes the statistics; without a clock, time is measured in sequences.
    pub fn of(particles: &Particles, clock: Option<Clock>, steps: Option<Steps>) -> Self {
        let visible = particles.splats.opacities.iter().map(|&o| o >= INVISIBLE_OPACITY);
        let rows = particles.splats.means.iter().zip(&particles.motions).zip(visible);
        let seen: Vec<[f64; 4]> = rows
            .filter(|(_, visible)| *visible)
            .map(|((&x, m), _)| {
                let [v, w] = [m.twist.v, m.twist.w].map(Vec3::from_array);
                let [a, e] = [m.rate.v, m.rate.w].map(Vec3::from_array);
                let r = x - particles.origin;
                let velocity = v + w.cross(r);
                let acceleration = a + e.cross(r) + w.cross(velocity);
                [velocity, w, acceleration, e].map(|q| f64::from(q.length()))
            })
            .collect();
        let (unit, rate) = clock.map_or(("sequence", 1.0), |c| ("s", c.rate));
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
        let spreads = names.into_iter().enumerate().map(spread).collect();
        let fast = steps.filter(|s| !s.rigid).and_then(|s| fast(&seen, s.length));
        Self { at: particles.at, splats: seen.len(), time_unit: unit, spreads, fast }
    }
}

fn fast(seen: &[[f64; 4]], step: f64) -> Option<FastSplats> {
    let turns = || seen.iter().map(|row| row[1] * step);
    let splats = turns().filter(|t| *t > MAX_ROTATION_PER_STEP).count();
    (splats > 0).then(|| FastSplats { splats, turn: turns().fold(0.0, f64::max), step })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Splats;
    use gs_physics::{Motion, Twist};

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
    }

    #[test]
    fn turns_too_fast_for_their_steps_are_told() {
        let config = |text: &str| text.parse::<toml::Table>().unwrap();
        let rk2 = config("[physics]\nstep_frames = 2.0\n[law]\nintegrator = \"rk2\"");
        let steps = Steps::of(&rk2, 0.05).unwrap();
        let p = Physics::of(&wheel(), None, Some(steps));
        let fast = p.fast.unwrap();
        assert!(fast.splats == 3 && (fast.turn - 0.1 * std::f64::consts::PI).abs() < 1e-6, "{fast:?}");
        assert!(Physics::of(&wheel(), None, Steps::of(&rk2, 0.02)).fast.is_none(), "slow enough");
        let rigid = config("[physics]\nstep_frames = 2.0\n[law]\nintegrator = \"se3_mid\"");
        assert!(Physics::of(&wheel(), None, Steps::of(&rigid, 0.05)).fast.is_none(), "rigid steps keep radii");
        assert_eq!(Steps::of(&config("[field]\nwidth = 3"), 0.05), None);
    }
}
