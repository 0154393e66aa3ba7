//! Twists: the velocity fields of rigid bodies, and how they change.

use crate::vec3::{add, add_scaled, scale, sub};
use gs_core::real::cross3;
use gs_core::{Real, cast};

/// The velocity field `u(x) = v + w × (x − o)` of a rigid body, about an origin `o` stored elsewhere.
///
/// ```
/// use gs_physics::Twist;
/// let twist = Twist { v: [0.0, 1.0, 0.0], w: [0.0, 0.0, 2.0] };
/// assert_eq!(twist.velocity([3.0, 0.0, 0.0]), [0.0, 7.0, 0.0]);
/// // The same field about another origin: positions shift, velocities stay.
/// assert_eq!(twist.shifted([1.0, 0.0, 0.0]).velocity([2.0, 0.0, 0.0]), [0.0, 7.0, 0.0]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Twist<T> {
    /// Velocity of the body-fixed frame at the origin (`v̄`), world units per unit of time.
    pub v: [T; 3],
    /// Rotation vector (right-hand rule), radians per unit of time.
    pub w: [T; 3],
}

/// A twist as a polynomial of the time `τ` since it was read: `u(τ) = twist + rate τ + ½ jerk τ²`.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Motion<T> {
    /// The twist at `τ = 0`.
    pub twist: Twist<T>,
    /// First derivative `(ā, ε)` by time, at `τ = 0`.
    pub rate: Twist<T>,
    /// Second derivative by time; zero below the third order.
    pub jerk: Twist<T>,
}

/// Number of values in a [`Motion`].
pub(crate) const MOTION: usize = 18;

impl<T: Real> Twist<T> {
    /// `u(x)`, world units per unit of time, at `x` relative to the origin.
    #[inline(always)]
    pub fn velocity(&self, x: [T; 3]) -> [T; 3] {
        add(self.v, cross3(self.w, x))
    }

    /// The same field about an origin displaced by `shift` from this one's.
    #[inline(always)]
    pub fn shifted(&self, shift: [T; 3]) -> Self {
        Self { v: self.velocity(shift), w: self.w }
    }

    /// `self + s other`, term by term.
    #[inline(always)]
    pub fn add_scaled(&self, s: T, other: &Self) -> Self {
        Self { v: add_scaled(self.v, s, other.v), w: add_scaled(self.w, s, other.w) }
    }

    /// `s self`, term by term.
    #[inline(always)]
    pub fn scaled(&self, s: T) -> Self {
        Self { v: scale(self.v, s), w: scale(self.w, s) }
    }

    /// Lie bracket of se(3): `(w₁×v₂ − w₂×v₁, w₁×w₂)`.
    #[inline(always)]
    pub fn bracket(&self, other: &Self) -> Self {
        Self { v: sub(cross3(self.w, other.v), cross3(other.w, self.v)), w: cross3(self.w, other.w) }
    }
}

impl<T: Real> Motion<T> {
    /// The twist at time `τ` since it was read.
    #[inline(always)]
    pub fn at(&self, tau: T) -> Twist<T> {
        self.weighted([tau, tau * tau * tau.lit(0.5)])
    }

    /// `twist + weights₀ rate + weights₁ jerk`.
    #[inline(always)]
    pub(crate) fn weighted(&self, weights: [T; 2]) -> Twist<T> {
        self.twist.add_scaled(weights[0], &self.rate).add_scaled(weights[1], &self.jerk)
    }

    /// The same motion with `τ` counted from `tau`.
    pub fn from(&self, tau: T) -> Self {
        Self { twist: self.at(tau), rate: self.rate.add_scaled(tau, &self.jerk), jerk: self.jerk }
    }

    /// The same motion about an origin displaced by `shift` from this one's.
    pub fn shifted(&self, shift: [T; 3]) -> Self {
        let [twist, rate, jerk] = [&self.twist, &self.rate, &self.jerk].map(|t| t.shifted(shift));
        Self { twist, rate, jerk }
    }

    /// Acceleration at `τ = 0` of the particle at `x`, relative to the origin: `ā + ε×x + w×u(x)`.
    pub fn acceleration(&self, x: [T; 3]) -> [T; 3] {
        add(self.rate.velocity(x), cross3(self.twist.w, self.twist.velocity(x)))
    }

    /// All 18 values: twist, rate, jerk, `v` before `w` in each.
    #[inline(always)]
    pub fn to_array(&self) -> [T; MOTION] {
        let (t, r, j) = (&self.twist, &self.rate, &self.jerk);
        [
            t.v[0], t.v[1], t.v[2], t.w[0], t.w[1], t.w[2], r.v[0], r.v[1], r.v[2], r.w[0], r.w[1], r.w[2], j.v[0],
            j.v[1], j.v[2], j.w[0], j.w[1], j.w[2],
        ]
    }

    /// From the values in the order of [`Motion::to_array`].
    #[inline(always)]
    pub fn from_array(a: [T; MOTION]) -> Self {
        Self {
            twist: Twist { v: [a[0], a[1], a[2]], w: [a[3], a[4], a[5]] },
            rate: Twist { v: [a[6], a[7], a[8]], w: [a[9], a[10], a[11]] },
            jerk: Twist { v: [a[12], a[13], a[14]], w: [a[15], a[16], a[17]] },
        }
    }
}

impl Motion<f32> {
    /// The same motion in `f64`, exactly.
    pub fn to_f64(&self) -> Motion<f64> {
        Motion::from_array(self.to_array().map(f64::from))
    }
}

impl Motion<f64> {
    /// The same motion rounded to `f32`.
    pub fn to_f32(&self) -> Motion<f32> {
        Motion::from_array(self.to_array().map(cast::to_f32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    fn motion(seed: u64) -> Motion<f64> {
        let mut rng = Rng::new(seed, "twist", 0, 0);
        Motion::from_array(std::array::from_fn(|_| f64::from(rng.normal())))
    }

    fn near(a: [f64; 3], b: [f64; 3]) -> bool {
        (0..3).all(|c| (a[c] - b[c]).abs() < 1e-13)
    }

    #[test]
    fn a_motion_is_a_polynomial_from_any_time_and_about_any_origin() {
        let (m, shift, x) = (motion(1), [0.3, -2.0, 5.0], [1.0, 0.5, -0.7]);
        let moved = m.shifted(shift);
        for (tau, later) in [(0.0, 0.4), (0.7, -1.1)] {
            let (a, b) = (m.at(tau + later), m.from(tau).at(later));
            assert!(near(a.v, b.v) && near(a.w, b.w));
            assert!(near(moved.at(tau).velocity(sub(x, shift)), m.at(tau).velocity(x)));
        }
        assert!(near(moved.acceleration(sub(x, shift)), m.acceleration(x)));
        assert_eq!(Motion::from_array(m.to_array()), m);
        assert_eq!(m.to_f32().to_f64().to_f32(), m.to_f32());
    }

    /// Derivatives the path of a particle: velocity and acceleration are its derivatives.
    #[test]
    fn velocity_and_acceleration_are_derivatives_of_the_path() {
        let (m, x, h) = (motion(2), [0.4, -0.3, 0.8], 1e-3);
        let [ahead, behind] = [h, -h].map(|tau| crate::truth::follow(&m, tau, x).0);
        let slope = scale(sub(ahead, behind), 0.5 / h);
        let bend = scale(add(sub(ahead, x), sub(behind, x)), 1.0 / (h * h));
        let (v, a) = (m.twist.velocity(x), m.acceleration(x));
        assert!((0..3).all(|c| (slope[c] - v[c]).abs() < 1e-4 && (bend[c] - a[c]).abs() < 1e-4), "{bend:?} {a:?}");
    }

    #[test]
    fn the_bracket_is_antisymmetric_and_obeys_jacobi() {
        let [a, b, c] = [motion(4).twist, motion(5).twist, motion(6).twist];
        let sum = a.bracket(&b).add_scaled(1.0, &b.bracket(&a));
        assert!(near(sum.v, [0.0; 3]) && near(sum.w, [0.0; 3]));
        let cyclic = a.bracket(&b.bracket(&c)).add_scaled(1.0, &b.bracket(&c.bracket(&a)));
        let jacobi = cyclic.add_scaled(1.0, &c.bracket(&a.bracket(&b)));
        assert!(near(jacobi.v, [0.0; 3]) && near(jacobi.w, [0.0; 3]));
    }
}
