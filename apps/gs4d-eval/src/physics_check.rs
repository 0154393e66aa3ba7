//! Learnt motion against the ground truth of a generated scene, body by body.
//!
//! Opaque particles near the surface of a body are compared with it: the velocity field `u(x) = v̄ + w × (x − o)` and the
//! acceleration `ū(x) = v̄' + w' × (x − o) + w × u(x)` at the particle, the twist and its rate, and later positions under the
//! learnt motion (integrated at fourth order, so that the error is that of the motion). Particles with the true motion have
//! errors of `f32` rounding.

use crate::particles::Particles;
use glam::{DVec3, Vec3};
use gs_core::cast;
use gs_physics::{Integrator, Motion, Rollout};
use gs_synth::Truth;
use serde::{Serialize, Serializer};
use std::fmt::Write as _;

/// Longest integration step, normalised time.
const MAX_STEP: f64 = 1.0 / 60.0;
/// Number of later times by default.
const LATER_TIMES: u32 = 3;

/// Which particles are compared, and when.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PhysicsOptions {
    /// Least opacity of a particle, 0..1.
    pub opacity: f32,
    /// Largest distance of a particle from the surface, world units.
    pub tolerance: f64,
    /// Normalised times at which positions are compared, where motions last.
    pub times: Vec<f64>,
}

impl PhysicsOptions {
    /// Opacity 0.5, distance 0.05; the last training time `last` (at least the time of the particles) and three evenly spaced times
    /// from there to the end of the sequence or, if that is reached, to a quarter beyond.
    pub fn of(particles: &Particles, last: f64) -> Self {
        let from = last.max(particles.at);
        let end = if from < 1.0 - 1e-6 { 1.0 } else { from + 0.25 };
        let time = |k: u32| from + (end - from) * f64::from(k) / f64::from(LATER_TIMES);
        Self { opacity: 0.5, tolerance: 0.05, times: (0..=LATER_TIMES).map(time).collect() }
    }
}

/// Distribution over particles of the error `|learnt − true|` of a vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorStats {
    /// Median length of the true vector.
    pub truth: f64,
    /// Median over particles of the error.
    pub median: f64,
    /// 95th percentile of the error.
    pub p95: f64,
}

impl ErrorStats {
    fn of(pairs: impl Iterator<Item = (DVec3, DVec3)>) -> Self {
        let (mut errors, mut truths): (Vec<f64>, Vec<f64>) =
            pairs.map(|(learnt, truth)| (learnt.distance(truth), truth.length())).unzip();
        Self { truth: quantile(&mut truths, 0.5), median: quantile(&mut errors, 0.5), p95: quantile(&mut errors, 0.95) }
    }

    /// Median and 95th percentile relative to the true length; `None` where that is zero, up to rounding.
    pub fn relative(&self) -> Option<[f64; 2]> {
        (self.truth > 1e-9 * (1.0 + self.median)).then(|| [self.median / self.truth, self.p95 / self.truth])
    }
}

impl Serialize for ErrorStats {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Fields {
            truth: f64,
            median: f64,
            p95: f64,
            relative: Option<[f64; 2]>,
        }
        Fields { truth: self.truth, median: self.median, p95: self.p95, relative: self.relative() }.serialize(to)
    }
}

/// Quantile of magnitudes by nearest rank; NaN sorts last, no values give 0.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_unstable_by(|a, b| a.abs().total_cmp(&b.abs()));
    let rank = cast::to_usize((share * values.len() as f64).ceil());
    values.get(rank.max(1) - 1).copied().unwrap_or(0.0)
}

/// Errors of the particles of one body.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BodyErrors {
    /// `u(x)` at the particle, world units per unit of time.
    pub velocity: ErrorStats,
    /// `v̄`: the velocity field at the origin of the twists.
    pub v: ErrorStats,
    /// Rotation vector, radians per unit of time.
    pub w: ErrorStats,
    /// `ū(x)` at the particle, world units per unit of time squared.
    pub acceleration: ErrorStats,
    /// Rate `v̄'` of the velocity `v̄`, per unit of time; absent where motions do not last.
    pub v_rate: Option<ErrorStats>,
    /// Rate `w'` of the rotation vector `w`, per unit of time; absent where motions do not last.
    pub w_rate: Option<ErrorStats>,
    /// Displacement from the time of the particles to each time of [`PhysicsOptions::times`], world units: its error is that of
    /// the position.
    pub way: Vec<ErrorStats>,
}

/// The comparison with one body.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BodyReport {
    /// Name of the body in the generated scene.
    pub name: &'static str,
    /// Number of particles on its surface.
    pub particles: usize,
    /// Their errors; `None` without particles, and for a body that deforms.
    pub errors: Option<BodyErrors>,
}

/// Learnt motion against the ground truth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PhysicsReport {
    /// Name of the generated scene.
    pub scene: &'static str,
    /// Normalised time of the particles.
    pub at: f64,
    /// Options that the comparison was made with; without times where motions do not last.
    pub options: PhysicsOptions,
    /// Number of particles of the model.
    pub particles: usize,
    /// Number of particles of at least the least opacity.
    pub opaque: usize,
    /// Comparisons in the order of the scene's bodies.
    pub bodies: Vec<BodyReport>,
}

/// Compares particles with the ground truth of their scene. Where their motions do not last, those of a flow, rates and later
/// places are left out: a particle goes on into another motion.
pub fn check(particles: &Particles, truth: &Truth, options: &PhysicsOptions) -> PhysicsReport {
    let opaque = (0..particles.motions.len()).filter(|&i| particles.splats.opacities[i] >= options.opacity);
    let opaque: Vec<usize> = opaque.collect();
    let times = if particles.lasting { options.times.clone() } else { Vec::new() };
    let mut rows = vec![Vec::new(); truth.bodies().len()];
    for &i in &opaque {
        let x = particles.splats.means[i].as_dvec3();
        if let Some(body) = body_at(truth, x, particles.at, options.tolerance) {
            rows[body].push(i);
        }
    }
    let report = |(k, rows): (usize, Vec<usize>)| BodyReport {
        name: truth.bodies()[k].name,
        particles: rows.len(),
        errors: Some(rows).filter(|r| !r.is_empty()).and_then(|r| errors(particles, &r, truth, k, &times)),
    };
    let bodies = rows.into_iter().enumerate().map(report).collect();
    PhysicsReport {
        scene: truth.scene(),
        at: particles.at,
        options: PhysicsOptions { times, ..options.clone() },
        particles: particles.motions.len(),
        opaque: opaque.len(),
        bodies,
    }
}

/// The body with the nearest surface, if that is within the tolerance; `None` for a position that is not finite.
fn body_at(truth: &Truth, x: DVec3, t: f64, tolerance: f64) -> Option<usize> {
    if !x.is_finite() {
        return None;
    }
    let distances = truth.bodies().iter().map(|b| b.distance(x, t).abs()).enumerate();
    let (body, distance) = distances.min_by(|a, b| a.1.total_cmp(&b.1))?;
    (distance <= tolerance).then_some(body)
}

/// Errors of some rows against a body; `None` if it deforms.
fn errors(particles: &Particles, rows: &[usize], truth: &Truth, body: usize, times: &[f64]) -> Option<BodyErrors> {
    let origin = particles.origin.as_dvec3();
    let rates = truth.rates_of(body, particles.at)?;
    let true_twist = rates.twist(origin);
    let position = |i: usize| particles.splats.means[i].as_dvec3();
    let learnt: Vec<(DVec3, Motion<f64>)> =
        rows.iter().map(|&i| (position(i), particles.motions[i].to_f64())).collect();
    let twist = |of: fn(&Motion<f64>) -> [f64; 3]| {
        ErrorStats::of(learnt.iter().map(|(_, m)| (of(m).into(), of(&true_twist).into())))
    };
    let arm = |x: DVec3| (x - origin).to_array();
    let velocities = |(x, m): &(DVec3, Motion<f64>)| (m.twist.velocity(arm(*x)).into(), rates.velocity(*x));
    let accelerations = |(x, m): &(DVec3, Motion<f64>)| (m.acceleration(arm(*x)).into(), rates.acceleration(*x));
    Some(BodyErrors {
        velocity: ErrorStats::of(learnt.iter().map(velocities)),
        v: twist(|m| m.twist.v),
        w: twist(|m| m.twist.w),
        acceleration: ErrorStats::of(learnt.iter().map(accelerations)),
        v_rate: particles.lasting.then(|| twist(|m| m.rate.v)),
        w_rate: particles.lasting.then(|| twist(|m| m.rate.w)),
        way: times.iter().map(|&t| displacement(particles, rows, truth, body, t)).collect(),
    })
}

/// Displacements from the time of the particles to `t`: integrated, and true.
fn displacement(particles: &Particles, rows: &[usize], truth: &Truth, body: usize, t: f64) -> ErrorStats {
    let motions: Vec<Motion<f32>> = rows.iter().map(|&i| particles.motions[i]).collect();
    let start: Vec<Vec3> = rows.iter().map(|&i| particles.splats.means[i]).collect();
    let mut means = start.clone();
    let mut rotations = vec![[1.0, 0.0, 0.0, 0.0]; rows.len()];
    let rollout = Rollout { rule: Integrator::Se3Magnus4, dt: MAX_STEP, origin: particles.origin };
    rollout.advance(&motions, [0.0, t - particles.at], &mut means, &mut rotations);
    let poses = [particles.at, t].map(|t| truth.bodies()[body].motion.at(t));
    ErrorStats::of(start.iter().zip(&means).map(|(from, to)| {
        let from = from.as_dvec3();
        (to.as_dvec3() - from, poses[1].apply(poses[0].invert(from)) - from)
    }))
}

impl PhysicsReport {
    /// A text table: median errors relative to the true lengths (absolute where those are zero), then errors of positions.
    pub fn to_text(&self) -> String {
        let assigned: usize = self.bodies.iter().map(|b| b.particles).sum();
        let mut out = format!(
            "motion against the truth of \"{}\" at t = {:.3}: {} particles, {} opaque, {assigned} of them on a surface\n\
             median error, 95 % in brackets; % of the true length, or the length where that is zero\n{:14}{:>9}",
            self.scene, self.at, self.particles, self.opaque, "body", "particles"
        );
        ["velocity", "w", "acceleration", "w'"].iter().for_each(|h| {
            let _ = write!(out, "{h:>22}");
        });
        self.options.times.iter().for_each(|t| {
            let _ = write!(out, "{:>20}", format!("place at {t:.3}"));
        });
        out.push('\n');
        for b in &self.bodies {
            let _ = write!(out, "{:14}{:>9}", b.name, b.particles);
            if let Some(e) = &b.errors {
                for s in [Some(&e.velocity), Some(&e.w), Some(&e.acceleration), e.w_rate.as_ref()] {
                    let _ = write!(out, "{:>22}", s.map_or("-".to_owned(), relative_text));
                }
                for s in &e.way {
                    let _ = write!(out, "{:>20}", format!("{:.4} ({:.4})", s.median, s.p95));
                }
            }
            out.push('\n');
        }
        out
    }
}

/// Errors in per cent of the true length, or absolute where that is zero.
fn relative_text(s: &ErrorStats) -> String {
    match s.relative() {
        Some([median, p95]) => format!("{:.2} % ({:.2} %)", 100.0 * median, 100.0 * p95),
        None => format!("{:.4} ({:.4})", s.median, s.p95),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::{Color, Splats};
    use gs_physics::Twist;
    use gs_synth::{self as synth, SynthOptions};

    /// What cameras see of a scene at 0.7, with the motion it really has, about `origin`.
    fn seen(scene: &str, origin: Vec3) -> (Particles, Truth) {
        let o = SynthOptions { size: 16, cameras: 6, moments: 2, supersample: 1, ..SynthOptions::default() };
        let data = synth::generate(scene, &o).unwrap();
        let at = 0.7;
        let (mut splats, mut motions) = (Splats::default(), Vec::new());
        for v in data.dataset.train.iter() {
            for k in 0..16 * 16 {
                let (x, y) = (f64::from(k % 16) + 0.5, f64::from(k / 16) + 0.5);
                let Some(hit) = data.truth.hit(&v.camera, at, x, y) else { continue };
                splats.means.push(hit.world.as_vec3());
                let motion = data.truth.twist_of(hit.body, at, origin.as_dvec3()).unwrap_or_default();
                motions.push(motion.to_f32());
            }
        }
        let n = motions.len();
        assert!(n > 100, "{scene}: {n} points");
        splats.quats = vec![[1.0, 0.0, 0.0, 0.0]; n];
        splats.scales = vec![Vec3::splat(0.02); n];
        splats.opacities = vec![0.9; n];
        splats.color = Color::Rgb(vec![[0.5; 3]; n]);
        (Particles { at, splats, motions, origin, lasting: true }, data.truth)
    }

    fn report(particles: &Particles, truth: &Truth) -> PhysicsReport {
        check(particles, truth, &PhysicsOptions::of(particles, 0.75))
    }

    fn errors_of<'a>(report: &'a PhysicsReport, name: &str) -> &'a BodyErrors {
        report.bodies.iter().find(|b| b.name == name).unwrap().errors.as_ref().unwrap()
    }

    #[test]
    fn the_truth_has_errors_of_rounding() {
        for scene in ["falling", "screw", "wheel", "projectile", "hinge", "spinner", "twins"] {
            let (particles, truth) = seen(scene, Vec3::new(0.1, -0.2, 0.3));
            let report = report(&particles, &truth);
            assert_eq!(report.bodies.iter().map(|b| b.particles).sum::<usize>(), particles.motions.len());
            for b in &report.bodies {
                let e = b.errors.as_ref().unwrap();
                let rates = e.v_rate.iter().chain(&e.w_rate);
                assert_eq!(rates.clone().count(), 2);
                for s in [&e.velocity, &e.v, &e.w, &e.acceleration].into_iter().chain(rates).chain(&e.way) {
                    assert!(s.p95 < 2e-6 * (1.0 + s.truth), "{scene}, {}: {e:?}", b.name);
                }
                let moves = b.name != "slab" && b.name != "base";
                assert_eq!(moves, e.velocity.relative().is_some());
            }
            assert_eq!(report.options.times.len(), 4);
            assert!((report.options.times[0] - 0.75).abs() < 1e-12 && (report.options.times[3] - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn wrong_motions_are_told() {
        let (mut particles, truth) = seen("screw", Vec3::ZERO);
        for m in &mut particles.motions {
            m.twist.w = m.twist.w.map(|w| 1.1 * w);
            m.twist.v[0] += 0.2;
            m.rate.v[1] += 0.4;
        }
        let wrong = report(&particles, &truth);
        let e = errors_of(&wrong, "block");
        let [w, v] = [&e.w, &e.v].map(|s| s.relative().unwrap()[0]);
        assert!((w - 0.1).abs() < 1e-5 && (e.v.median - 0.2).abs() < 1e-5 && v > 0.05, "{w} {v}");
        let rate = e.v_rate.unwrap();
        assert!((rate.median - 0.4).abs() < 1e-5 && rate.relative().is_none(), "the truth is zero");
        assert!(e.velocity.relative().unwrap()[0] > 0.05 && e.way[3].median > 0.02);
        // The slab has its own truth: it rests.
        assert!((errors_of(&wrong, "slab").velocity.p95 - 0.2).abs() < 1e-5);
    }

    /// What is left out of a motion is the error after a while: half its acceleration times the time squared, a sixth of its
    /// jerk times the time cubed.
    #[test]
    fn positions_miss_by_what_was_left_out() {
        let (mut particles, truth) = seen("falling", Vec3::ZERO);
        particles.motions.iter_mut().for_each(|m| *m = Motion { twist: m.twist, ..Motion::default() });
        let first = report(&particles, &truth);
        let e = errors_of(&first, "ball");
        assert!((e.way[3].median - 0.5 * 4.4 * 0.3 * 0.3).abs() < 1e-5 && e.acceleration.relative().unwrap()[1] == 1.0);
        assert!(e.velocity.p95 < 1e-6, "velocities are right");
        let (mut particles, truth) = seen("projectile", Vec3::ZERO);
        particles.motions.iter_mut().for_each(|m| m.jerk = Twist::default());
        let second = report(&particles, &truth);
        let e = errors_of(&second, "block");
        let motion = truth.bodies()[0].motion;
        let jerk = (motion.spin_axis.normalize() * motion.spin_rate).cross(motion.gravity).length();
        let want = jerk * 0.3f64.powi(3) / 6.0;
        assert!(e.acceleration.p95 < 1e-5 && (e.way[3].median / want - 1.0).abs() < 0.3, "{} {want}", e.way[3].median);
    }

    #[test]
    fn motions_that_do_not_last_have_no_rates_and_no_way() {
        let (mut particles, truth) = seen("screw", Vec3::ZERO);
        particles.lasting = false;
        let flow = report(&particles, &truth);
        let e = errors_of(&flow, "block");
        assert!([e.velocity, e.acceleration].iter().all(|s| s.p95 < 1e-5 * (1.0 + s.truth)), "where it is: {e:?}");
        assert!(e.v_rate.is_none() && e.w_rate.is_none() && e.way.is_empty() && flow.options.times.is_empty());
        let text = flow.to_text();
        assert!(!text.contains("place at") && text.lines().last().is_some_and(|row| row.ends_with(" -")), "{text}");
    }

    #[test]
    fn only_opaque_particles_near_a_rigid_surface_count() {
        let (mut particles, truth) = seen("falling", Vec3::ZERO);
        let all = particles.motions.len();
        particles.splats.opacities[..10].fill(0.1);
        particles.splats.means[10..14].fill(Vec3::new(1.2, 1.2, 1.2));
        particles.splats.means[14] = Vec3::NAN;
        let some = report(&particles, &truth);
        assert_eq!((some.particles, some.opaque), (all, all - 10));
        assert_eq!(some.bodies.iter().map(|b| b.particles).sum::<usize>(), all - 15);
        let text = some.to_text();
        assert!(text.contains("ball") && text.contains("slab") && text.contains("place at 1.000"), "{text}");
        let json = serde_json::to_value(&some).unwrap();
        assert!(json["bodies"][0]["errors"]["velocity"]["relative"][1].as_f64().unwrap() < 1e-5, "{json}");
        let (cloth, truth) = seen("sheet", Vec3::ZERO);
        let report = report(&cloth, &truth);
        assert!(report.bodies[0].particles > 100 && report.bodies[0].errors.is_none());
    }
}
