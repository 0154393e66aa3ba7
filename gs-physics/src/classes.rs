//! Motion classes: particles that rest, translate, or rotate about a fixed axis have closed forms and need no steps.
//!
//! A class replaces a motion by a *model* whose twists commute, so one exponential of its mean twist advances a particle
//! to any time. With `Δ = motion − model` about the particle (`c(τ) = c₀ + c₁τ + ½c₂τ²` the velocity there, `w(τ)` the
//! angular velocity), the error of the model's particle is at most
//!
//! ```text
//! |Δc₀|H + ½|Δc₁|H² + ⅙|Δc₂|H³  +  (|Δw₀|H + ½|Δw₁|H² + ⅙|Δw₂|H³) (D + r)          for |τ| ≤ H
//! ```
//! (the difference `e` obeys `e' = Δu + w×e`, and `w×e` does not lengthen `e`). `D = |c₀|H + ½|c₁|H² + ⅙|c₂|H³` bounds the
//! displacement of the particle, of the motion or of the model, whichever is less; `r` is how much its splat changes per
//! radian ([`rotation_sensitivity`]). A translation follows the particle's own Taylor series to the third order instead: its error is
//! at most `sup|x''''| H⁴/24`, plus `r` times the rotation, which is dropped. All bounds are against the exact path;
//! roll-outs differ from that by the error of their integrator.

use crate::extrapolate::{RowsError, same_rows};
use crate::twist::{Motion, Twist};
use crate::vec3::{add, add_scaled, norm, scale};
use glam::Vec3;
use gs_core::real::{cross3, dot3};
use rayon::prelude::*;

/// Kinds of motion, cheapest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum MotionClass {
    /// At rest: the pose does not change.
    Static,
    /// Translation without rotation: `x + v_p τ + ½ a_p τ² + ⅙ x''' τ³`.
    Translation,
    /// A twist that is constant in time: a screw motion.
    ConstTwist,
    /// Rotation about a fixed axis at any rate, and translation along it.
    FixedAxis,
    /// Any other motion; it is integrated in steps.
    General,
}

/// Error up to which a motion may be replaced by a simpler one.
///
/// ```
/// use gs_physics::{ClassRule, Motion, MotionClass, Twist};
/// let rule = ClassRule { tolerance: 0.01, horizon: 1.0 };
/// let spin = Motion { twist: Twist { v: [0.0; 3], w: [0.0, 0.0, 3.0] }, ..Motion::default() };
/// // On its axis, a round splat does not change at all; an elongated one does.
/// assert_eq!(rule.classify(&spin, [0.0; 3], 0.0).class, MotionClass::Static);
/// assert_eq!(rule.classify(&spin, [0.0; 3], 0.1).class, MotionClass::ConstTwist);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClassRule {
    /// Largest error, world units. 0 allows only exact replacements.
    pub tolerance: f64,
    /// Longest time from when motions were read, in both directions; beyond it, no motion is replaced.
    pub horizon: f64,
}

/// The class of a particle and the closed form that replaces its motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Classified {
    /// The cheapest class within the tolerance.
    pub class: MotionClass,
    /// Bound on the error of the model within the horizon, world units; 0 for [`MotionClass::General`].
    pub bound: f64,
    /// The motion that replaces the particle's own, about the same origin.
    pub model: Motion<f64>,
}

/// World units by which the extent of a splat changes at most per radian of rotation: its largest less its smallest scale.
/// 0 for round splats, whose orientation does not matter.
pub fn rotation_sensitivity(scales: Vec3) -> f32 {
    scales.max_element() - scales.min_element()
}

impl ClassRule {
    /// The class of a particle at `x` (relative to the origin of twists). `reach` is its [`rotation_sensitivity`].
    pub fn classify(&self, motion: &Motion<f64>, x: [f64; 3], reach: f64) -> Classified {
        let local = motion.shifted(x);
        let about = |model: Motion<f64>| model.shifted(scale(x, -1.0));
        let whole = Motion { twist: local.twist, ..Motion::default() };
        let tried = [
            Some((MotionClass::Static, Motion::default(), self.bound(&local, &Motion::default(), reach))),
            Some((MotionClass::Translation, translation(&local), self.translation_bound(&local, reach))),
            Some((MotionClass::ConstTwist, whole, self.bound(&local, &whole, reach))),
            self.fixed_axis(&local).map(|m| (MotionClass::FixedAxis, m, self.bound(&local, &m, reach))),
        ];
        let found = tried.into_iter().flatten().find(|(_, _, bound)| *bound <= self.tolerance);
        match found {
            Some((class, model, bound)) => Classified { class, bound, model: about(model) },
            None => Classified { class: MotionClass::General, bound: 0.0, model: *motion },
        }
    }

    /// [`ClassRule::classify`] for all particles; `means` are in world coordinates.
    ///
    /// # Errors
    /// If the columns differ in length.
    pub fn classify_all(
        &self,
        motions: &[Motion<f32>],
        means: &[Vec3],
        origin: Vec3,
        reach: &[f32],
    ) -> Result<Vec<Classified>, RowsError> {
        same_rows("motions", motions.len(), means.len())?;
        same_rows("reaches", reach.len(), means.len())?;
        let one = |((m, x), r): ((&Motion<f32>, &Vec3), &f32)| {
            self.classify(&m.to_f64(), (*x - origin).as_dvec3().to_array(), f64::from(*r))
        };
        Ok(motions.par_iter().zip(means).zip(reach).with_min_len(256).map(one).collect())
    }

    /// Bound on the distance between particles of `model` and of `motion`, both about the particle, within the horizon.
    pub(crate) fn bound(&self, motion: &Motion<f64>, model: &Motion<f64>, reach: f64) -> f64 {
        let [m, o] = [motion.to_array(), model.to_array()];
        let off = Motion::from_array(std::array::from_fn(|i| m[i] - o[i]));
        let far = self.travel(motion, |t| t.v).min(self.travel(model, |t| t.v));
        self.travel(&off, |t| t.v) + self.travel(&off, |t| t.w) * (far + reach)
    }

    /// `|p₀|H + ½|p₁|H² + ⅙|p₂|H³`.
    fn travel(&self, m: &Motion<f64>, part: impl Fn(&Twist<f64>) -> [f64; 3]) -> f64 {
        let [p0, p1, p2] = [&m.twist, &m.rate, &m.jerk].map(|t| norm(part(t)));
        let h = self.horizon;
        h * (p0 + h * (0.5 * p1 + h * p2 / 6.0))
    }

    /// `sup|x''''| H⁴/24` and the rotation that is dropped, from bounds on `x'` … `x'''` within the horizon.
    fn translation_bound(&self, local: &Motion<f64>, reach: f64) -> f64 {
        let h = self.horizon;
        let [c0, c1, c2] = [&local.twist, &local.rate, &local.jerk].map(|t| norm(t.v));
        let [w0, w1, w2] = [&local.twist, &local.rate, &local.jerk].map(|t| norm(t.w));
        let (w, dw) = (w0 + h * (w1 + 0.5 * h * w2), w1 + h * w2);
        let far = self.travel(local, |t| t.v);
        let first = c0 + h * (c1 + 0.5 * h * c2) + w * far;
        let second = c1 + h * c2 + dw * far + w * first;
        let third = c2 + w2 * far + 2.0 * dw * first + w * second;
        let fourth = 3.0 * (w2 * first + dw * second) + w * third;
        fourth * h.powi(4) / 24.0 + self.travel(local, |t| t.w) * reach
    }

    /// The rotation about and translation along one fixed axis that is nearest to a motion about the particle.
    fn fixed_axis(&self, local: &Motion<f64>) -> Option<Motion<f64>> {
        let (t, r) = (&local.twist, &local.rate);
        let lead = if norm(t.w) >= 0.5 * self.horizon * norm(r.w) { t } else { r };
        let square = dot3(lead.w, lead.w);
        if square == 0.0 {
            return None;
        }
        let n = scale(lead.w, 1.0 / square.sqrt());
        let arm = scale(cross3(lead.w, lead.v), 1.0 / square);
        let along = |t: &Twist<f64>| {
            let w = scale(n, dot3(n, t.w));
            Twist { v: add_scaled(cross3(arm, w), dot3(n, t.v), n), w }
        };
        Some(Motion { twist: along(t), rate: along(r), jerk: along(&local.jerk) })
    }
}

/// The particle's own Taylor series as a motion without rotation:
/// `v_p`, `a_p = c₁ + w×v_p`, `x''' = c₂ + 2ε×v_p + w×a_p`.
fn translation(local: &Motion<f64>) -> Motion<f64> {
    let (v, w, e) = (local.twist.v, local.twist.w, local.rate.w);
    let a = add(local.rate.v, cross3(w, v));
    let third = add(add_scaled(local.jerk.v, 2.0, cross3(e, v)), cross3(w, a));
    let linear = |v| Twist { v, w: [0.0; 3] };
    Motion { twist: linear(v), rate: linear(a), jerk: linear(third) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrator::Integrator;
    use crate::step::{Substep, step};
    use crate::truth;
    use crate::vec3::sub;
    use gs_core::Rng;

    /// Position after `tau` of the particle at `x`, and its rotation since, by the model of a class.
    fn carried(found: &Classified, tau: f64, x: [f64; 3]) -> ([f64; 3], [f64; 4]) {
        step(Integrator::Se3Mid, &found.model, &Substep::averaged(tau), x, [1.0, 0.0, 0.0, 0.0])
    }

    fn off(found: &Classified, motion: &Motion<f64>, tau: f64, x: [f64; 3], reach: f64) -> f64 {
        let (got, q) = carried(found, tau, x);
        let (want, turn) = truth::follow(motion, tau, x);
        let cos: f64 = (0..4).map(|c| q[c] * turn[c]).sum::<f64>().abs().min(1.0);
        norm(sub(got, want)) + 2.0 * cos.acos() * reach
    }

    #[test]
    fn exact_motions_have_their_class_and_reach_their_ends() {
        let rule = |horizon| ClassRule { tolerance: 1e-12, horizon };
        let want = [
            (truth::circle(), MotionClass::ConstTwist),
            (truth::screw(), MotionClass::ConstTwist),
            (truth::spin_up(), MotionClass::FixedAxis),
            (truth::wheel(), MotionClass::General),
            (truth::tumble(), MotionClass::General),
            (truth::throw(), MotionClass::Translation),
        ];
        for (t, class) in want {
            let found = rule(t.span).classify(&t.motion, t.start, 0.1);
            assert_eq!(found.class, class, "{}", t.name);
            if class != MotionClass::General {
                let (x, q) = carried(&found, t.span, t.start);
                assert!(
                    t.position_error(x) < 1e-13 && t.rotation_error(q) < 1e-13,
                    "{}: {}",
                    t.name,
                    t.position_error(x)
                );
            }
        }
        assert_eq!(rule(1.0).classify(&Motion::default(), [1.0; 3], 1.0).class, MotionClass::Static);
        // Spinning up from rest: the axis is that of the rate.
        let mut m = truth::spin_up().motion;
        m.twist = Twist::default();
        assert_eq!(rule(1.0).classify(&m, [0.7, 0.1, 0.0], 0.1).class, MotionClass::FixedAxis);
    }

    /// Random motions from nearly resting to fast: the error of the closed form is never above its bound, and bounds are
    /// tight (the worst case uses at least a third of each).
    #[test]
    fn bounds_hold_and_are_tight() {
        let mut rng = Rng::new(1, "classes", 0, 0);
        let mut used = [0.0f64; 4];
        let mut seen = [0; 5];
        for case in 0..1500 {
            let mut vec = |s: f64| -> [f64; 3] { std::array::from_fn(|_| s * f64::from(rng.normal())) };
            let size = |k: i32| 10f64.powf(-0.5 * f64::from(k));
            let (v, w, rate, jerk) = (size(case % 7), size(case / 7 % 6), size(2 + case / 42 % 5), size(3 + case % 3));
            let w = if case % 5 == 0 { 0.0 } else { w };
            let mut m = Motion {
                twist: Twist { v: vec(v), w: vec(w) },
                rate: Twist { v: vec(rate), w: vec(rate * w) },
                jerk: Twist { v: vec(jerk * rate), w: vec(jerk * rate * w) },
            };
            if case % 3 == 0 {
                m.rate.w = scale(m.twist.w, 0.8);
                m.jerk = Twist::default();
            }
            let (x, reach) = (vec(1.0), 0.05);
            let rule = ClassRule { tolerance: 0.03, horizon: 0.6 };
            let found = rule.classify(&m, x, reach);
            seen[found.class as usize] += 1;
            if found.class == MotionClass::General {
                continue;
            }
            assert!(found.bound <= rule.tolerance);
            for tau in [0.6, 0.31, -0.6] {
                let off = off(&found, &m, tau, x, reach);
                assert!(off <= found.bound + 1e-7, "{found:?} at {tau}: {off}");
                if found.bound > 1e-4 {
                    used[found.class as usize] = used[found.class as usize].max(off / found.bound);
                }
            }
        }
        assert!(seen.iter().all(|n| *n > 20), "{seen:?}");
        assert!(used.iter().all(|u| *u > 0.3), "{used:?}");
    }

    #[test]
    fn round_splats_do_not_change_by_rotation() {
        assert_eq!(rotation_sensitivity(Vec3::new(0.25, 1.0, 0.5)), 0.75);
        assert_eq!(rotation_sensitivity(Vec3::splat(0.3)), 0.0);
        let rule = ClassRule { tolerance: 1e-6, horizon: 1.0 };
        let spins = Motion { twist: Twist { v: [0.0; 3], w: [0.0, 0.0, 5.0] }, ..Motion::default() };
        assert_eq!(rule.classify(&spins, [0.0; 3], 0.0).class, MotionClass::Static, "a ball on its axis");
        assert_eq!(rule.classify(&spins, [0.0; 3], 0.1).class, MotionClass::ConstTwist);
        let error = rule.classify_all(&[], &[Vec3::ZERO], Vec3::ZERO, &[]).unwrap_err();
        assert_eq!(error.what, "motions");
    }
}
