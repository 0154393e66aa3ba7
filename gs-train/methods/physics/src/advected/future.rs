//! What is known of the time after the last one the field is read at: field and law are read once, and whole steps on
//! the way are kept, so that a later frame costs a step or two. Splats with a closed form, and bodies whose splats may share
//! one motion, take no steps at all.

use super::carry;
use glam::Vec3;
use gs_core::{Geometry, cast};
use gs_physics::classes::{ClassRule, rotation_sensitivity};
use gs_physics::groups::{Groups, UNGROUPED};
use gs_physics::refit::{Bodies, Body, Tracks};
use gs_physics::segment::{FeatureOptions, KMeansOptions, features, kmeans, radius};
use gs_physics::{Dynamics, Extrapolator, Integrator, Motion, ParticleState, Rollout, Start};
use gs_train::capabilities::RigidBody;

/// The rotation by no angle, `(w, x, y, z)`.
const IDENTITY: [f32; 4] = [1.0, 0.0, 0.0, 0.0];

/// What a forecast may leave out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tolerance {
    /// When a simpler motion serves.
    pub rule: ClassRule,
    /// Most bodies whose splats share one motion; 0: every splat follows its own.
    pub bodies: usize,
}

impl Tolerance {
    /// Particles that take no steps where they need none. Integrators that are not rigid keep theirs: what was learnt makes
    /// up for their errors.
    fn reduced(
        self,
        particles: Extrapolator,
        begin: &Geometry,
        opacities: &[f32],
        rule: Integrator,
        origin: Vec3,
    ) -> Option<Extrapolator> {
        if !rule.is_rigid() {
            return Some(particles);
        }
        let reach: Vec<f32> = begin.scales.iter().map(|s| rotation_sensitivity(*s)).collect();
        let groups = (self.bodies > 0 && !begin.is_empty()).then(|| {
            let motions = particles.motions();
            let radius = radius(&begin.means, origin, Some(opacities));
            let (rows, width) = features(motions, &FeatureOptions { radius, ..FeatureOptions::default() });
            let options = KMeansOptions { k: self.bodies, ..KMeansOptions::default() };
            let found = kmeans(&rows, width, Some(opacities), &options);
            Groups::fit(&self.rule, &found.labels, motions, &begin.means, origin, &reach)
        });
        particles.reduce(&self.rule, &reach, groups.transpose().ok()?).ok()
    }
}

/// Splats that follow refitted paths, beside others whose integrator bends them: these paths were not learnt with its errors.
struct Members {
    rows: Vec<usize>,
    particles: Extrapolator,
}

impl Members {
    /// `None` where no path was refitted, or the integrator is rigid.
    fn new(rollout: Rollout, from: f64, bodies: &Bodies, motions: &[Motion<f32>], means: &[Vec3]) -> Option<Self> {
        let follows = |(row, label): (usize, &u32)| (*label != UNGROUPED).then_some(row);
        let rows: Vec<usize> = bodies.of.iter().enumerate().filter_map(follows).collect();
        if rows.is_empty() || rollout.rule.is_rigid() {
            return None;
        }
        let (motions, means) = rows.iter().map(|row| (motions[*row], means[*row])).unzip();
        let (rigid, still) = (Rollout { rule: Integrator::Se3Mid, ..rollout }, vec![IDENTITY; rows.len()]);
        Some(Self { particles: Extrapolator::new(rigid, from, motions, means, still).ok()?, rows })
    }

    /// Writes where they are at a time to their rows.
    fn place(&mut self, t: f64, moves: &mut ParticleState) {
        let (means, turns) = self.particles.at(t);
        for (row, (x, turn)) in self.rows.iter().zip(means.iter().zip(turns)) {
            (moves.means[*row], moves.rotations[*row]) = (*x, *turn);
        }
    }
}

/// The scene at `T_def`, and how it goes on.
pub(super) struct Future {
    begin: Geometry,
    from: f64,
    /// The middle of what moves then.
    middle: Vec3,
    /// The particles without their own rotations, where twists rule all that follows.
    particles: Option<Extrapolator>,
    /// The bodies whose paths were refitted.
    bodies: Bodies,
    /// Their splats, where the others are not integrated rigidly.
    members: Option<Members>,
}

impl Future {
    /// The scene that begins as `begin`, with these opacities, at time `from`. With `tracks`, where splats were before, the
    /// paths of rigid bodies are refitted to them.
    pub(super) fn new<D: Dynamics>(
        begin: Geometry,
        opacities: &[f32],
        from: f64,
        middle: Vec3,
        tracks: Option<&Tracks>,
        dynamics: &D,
        tolerance: Tolerance,
    ) -> Self {
        let (mut bodies, mut members) = (Bodies::default(), None);
        let particles = dynamics.motion_rollout().and_then(|rollout| {
            let mut motions = dynamics.motions(Start { x: &begin.means, t: from, middle });
            if let Some(tracks) = tracks {
                bodies = Bodies::fit(tracks, opacities);
                bodies.apply(rollout.origin, &mut motions);
                members = Members::new(rollout, from, &bodies, &motions, &begin.means);
            }
            let still = vec![IDENTITY; begin.len()];
            let all = Extrapolator::new(rollout, from, motions, begin.means.clone(), still).ok()?;
            tolerance.reduced(all, &begin, opacities, rollout.rule, rollout.origin)
        });
        Self { begin, from, middle, particles, bodies, members }
    }

    /// The scene at its begin, and the motion of every splat from there on.
    pub(super) fn particles<D: Dynamics>(&self, dynamics: &D) -> (Geometry, Vec<Motion<f32>>) {
        let motions = self.particles.as_ref().map(|p| p.motions().to_vec());
        let start = Start { x: &self.begin.means, t: self.from, middle: self.middle };
        (self.begin.clone(), motions.unwrap_or_else(|| dynamics.motions(start)))
    }

    /// The bodies whose paths were refitted.
    pub(super) fn bodies(&self, times: &[f64]) -> Vec<RigidBody> {
        let body = |(label, body): (usize, &Body)| {
            let motion = body.motion(body.centroid);
            RigidBody {
                path: body.path.name(),
                splats: self.bodies.of.iter().filter(|l| **l as usize == label).count(),
                centroid: body.centroid.to_array(),
                velocity: motion.twist.v,
                spin: motion.twist.w,
                acceleration: motion.acceleration([0.0; 3]),
                frames: body.times,
                deviations: times.iter().map(|t| body.deviation((t - self.from).max(0.0))).collect(),
            }
        };
        self.bodies.list.iter().enumerate().map(body).collect()
    }

    /// Standard deviation of where each splat is forecast to be at a time, world units: not a number for a splat of no body, of which
    /// nothing is known; none where no path was refitted.
    pub(super) fn deviations(&self, t: f64) -> Option<Vec<f32>> {
        let tau = (t - self.from).max(0.0);
        let all: Vec<f32> = self.bodies.list.iter().map(|b| cast::to_f32(b.deviation(tau))).collect();
        let of = |label: &u32| all.get(*label as usize).copied().unwrap_or(f32::NAN);
        (!all.is_empty()).then(|| self.bodies.of.iter().map(of).collect())
    }

    /// The splats at a time after the begin.
    pub(super) fn at<D: Dynamics>(&mut self, t: f64, dynamics: &D) -> Geometry {
        let mut moves = ParticleState::default();
        match &mut self.particles {
            Some(particles) => {
                let (means, turns) = particles.at(t);
                (moves.means, moves.rotations) = (means.to_vec(), turns.to_vec());
                self.members.iter_mut().for_each(|members| members.place(t, &mut moves));
            }
            None => {
                let start = Start { x: &self.begin.means, t: self.from, middle: self.middle };
                dynamics.integrate(start, t, &mut D::Tape::default(), &mut moves);
            }
        }
        let mut splats = self.begin.clone();
        carry(&mut splats, &mut moves);
        splats
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;
    use gs_physics::{Law, LawConfig, Twist};

    const FROM: f64 = 0.6;

    fn begin() -> Geometry {
        let mut rng = Rng::new(4, "future", 0, 0);
        let means: Vec<Vec3> = (0..300).map(|_| Vec3::new(rng.normal(), rng.normal(), rng.normal())).collect();
        let n = means.len();
        let scales = (0..n).map(|_| Vec3::new(0.05, 0.02 + 0.03 * rng.uniform(), 0.05)).collect();
        Geometry { means, scales, quats: vec![[1.0, 0.0, 0.0, 0.0]; n] }
    }

    fn law(order: u8, integrator: Integrator) -> Law {
        let config = LawConfig { order, integrator, head_start: 1.0, ..LawConfig::small() };
        Law::new(&config, Vec3::ZERO, 0.05, 1).unwrap()
    }

    fn tolerance(tolerance: f64, bodies: usize) -> Tolerance {
        Tolerance { rule: ClassRule { tolerance, horizon: 1.0 - FROM }, bodies }
    }

    /// How far splats are from where the law carries them, and how many need their steps.
    fn off(law: &Law, tolerance: Tolerance) -> (f32, usize) {
        let (mut worst, start) = (0.0f32, begin());
        let mut future = Future::new(begin(), &[0.8; 300], FROM, Vec3::ZERO, None, law, tolerance);
        for t in [0.95, 0.72, 0.6] {
            let mut moves = ParticleState::default();
            let from = Start { x: &start.means, t: FROM, middle: Vec3::ZERO };
            law.integrate(from, t, &mut Default::default(), &mut moves);
            let drawn = future.at(t, law);
            worst = drawn.means.iter().zip(&moves.means).fold(worst, |w, (a, b)| w.max(a.distance(*b)));
        }
        (worst, future.particles.map_or(0, |p| p.counts().classes[4]))
    }

    #[test]
    fn what_is_left_out_stays_within_the_tolerance() {
        let second = law(2, Integrator::Se3Mid);
        assert_eq!(off(&second, tolerance(0.0, 0)), (0.0, 300), "nothing is left out unasked");
        let (exact, stepped) = off(&law(1, Integrator::Se3Mid), tolerance(0.0, 0));
        assert!(exact < 1e-5 && stepped == 0, "constant twists are one exponential: {exact} {stepped}");
        for bodies in [0, 6] {
            let (far, stepped) = off(&second, tolerance(0.03, bodies));
            assert!(far > 0.0 && far < 0.03 + 1e-4 && stepped < 300, "{bodies}: {far} {stepped}");
        }
        assert_eq!(off(&law(2, Integrator::Rk2), tolerance(0.03, 6)), (0.0, 300), "what is not rigid keeps its steps");
    }

    /// Places of the splats of [`begin`] on a body that turns by `w`, and motions that say so but for noise.
    fn turning(start: &Geometry, w: Vec3) -> Tracks {
        let mut rng = Rng::new(5, "spin", 0, 0);
        let mut motion = |_: &Vec3| {
            let v = [0; 3].map(|_| 0.02 * rng.normal());
            Motion { twist: Twist { v, w: w.to_array() }, ..Motion::default() }
        };
        let taus: Vec<f64> = (0..10).map(|k| -0.02 * f64::from(k)).collect();
        let turned = |tau: &f64| {
            let turn = glam::Quat::from_scaled_axis(w * cast::to_f32(*tau));
            start.means.iter().map(|x| turn * *x).collect()
        };
        Tracks {
            means: taus.iter().map(turned).collect(),
            motions: taus.iter().map(|_| start.means.iter().map(&mut motion).collect()).collect(),
            taus,
            ..Tracks::default()
        }
    }

    #[test]
    fn a_splat_of_no_body_has_no_known_deviation() {
        let (law, tracks) = (law(1, Integrator::Se3Mid), turning(&begin(), Vec3::Z * 6.0));
        let of = |tracks| Future::new(begin(), &[0.8; 300], FROM, Vec3::ZERO, tracks, &law, tolerance(0.0, 0));
        assert_eq!(of(None).deviations(0.95), None, "no path was refitted");
        let mut future = of(Some(&tracks));
        future.bodies.of[7] = UNGROUPED;
        let all = future.deviations(0.95).unwrap();
        let known = future.bodies.of.iter().map(|label| *label != UNGROUPED);
        assert!(all.iter().map(|d| d.is_finite()).eq(known) && all.iter().all(|d| d.is_nan() || *d > 0.0), "{all:?}");
        assert!(all[7].is_nan() && all.iter().filter(|d| d.is_finite()).count() > 200);
    }

    /// Seven steps of a body that turns by 0.3 in each: Euler's would take it a third farther from its axis.
    #[test]
    fn a_refitted_body_stays_rigid_whatever_integrates_the_others() {
        let start = begin();
        let tracks = turning(&start, Vec3::Z * 6.0);
        for rule in [Integrator::Euler, Integrator::Rk2, Integrator::Se3Mid] {
            let law = law(1, rule);
            let mut future =
                Future::new(begin(), &[0.8; 300], FROM, Vec3::ZERO, Some(&tracks), &law, tolerance(0.0, 0));
            assert!(future.bodies.members() > 250, "{rule:?}: {}", future.bodies.members());
            let drawn = future.at(0.95, &law);
            for (i, label) in future.bodies.of.iter().enumerate() {
                let Some(body) = future.bodies.list.get(*label as usize) else { continue };
                let off = drawn.means[i].distance(body.carry(0.35, start.means[i]));
                assert!(off < 2e-3, "{rule:?} {}: {off}", body.path.name());
            }
        }
    }
}
