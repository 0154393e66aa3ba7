//! Rigid bodies described by one of their points and its motion, and the twists they amount to.
//!
//! ```text
//! u(x) = v_c + w × (x − P_c)  =  v̄ + w × x        v̄ = v_c − w × P_c
//! ā = a_c − ε × P_c − w × v_c                      j_v = −2 ε × v_c − w × a_c  (third order)          (1)
//! ```
//! (1) holds the derivatives of `v̄(t) = v_c(t) − w(t) × P_c(t)`. The last term of `ā` is due to the motion of the centre;
//! TRACE's supplement drops it ([`Reduction::Paper`]). Positions are relative to the origin of the twist.

use crate::so3::Rotation;
use crate::twist::{Motion, Twist};
use crate::vec3::{add, add_scaled, scale, sub};
use gs_core::Real;
use gs_core::real::{cross3, dot3};

/// A rigid body at one time, described by the motion of one of its points (its centre).
///
/// A point on the rim of a rolling wheel of radius 0.5 is at rest while it touches the ground:
/// ```
/// use gs_physics::{BodyState, Reduction};
/// let (position, velocity, w) = ([0.0, 0.0, 0.5], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]);
/// let wheel = BodyState { position, velocity, w, ..BodyState::default() };
/// let motion = wheel.motion(2, Reduction::Exact);
/// assert_eq!(motion.twist.velocity([0.0, 0.0, 0.0]), [0.0, 0.0, 0.0]);
/// assert_eq!(motion.acceleration([0.0, 0.0, 0.0]), [0.0, 0.0, 2.0]); // |w|² times the radius, towards the hub
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct BodyState<T> {
    /// Position of the centre (`P_c`) relative to the origin of twists, world units.
    pub position: [T; 3],
    /// Velocity of the centre (`v_c`), world units per unit of time.
    pub velocity: [T; 3],
    /// Acceleration of the centre (`a_c`), world units per unit of time squared.
    pub acceleration: [T; 3],
    /// Rotation vector of the body, radians per unit of time.
    pub w: [T; 3],
    /// Angular acceleration (`ε`), radians per unit of time squared.
    pub angular_acceleration: [T; 3],
}

/// Which formula links `ā` and `a_c`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Reduction {
    /// Equation (1) of the [module](self).
    #[default]
    Exact,
    /// Without `−w × v_c`, as TRACE's supplement prints it (Eq. 14), and without a jerk; for comparison only.
    Paper,
}

impl<T: Real> BodyState<T> {
    /// The motion of every particle of the body; `order` 1: constant twist, 2: with its rate, 3: with its jerk.
    pub fn motion(&self, order: u8, reduction: Reduction) -> Motion<T> {
        let Self { position, velocity, acceleration, w, angular_acceleration } = *self;
        let (zero, exact) = ([w[0].lit(0.0); 3], reduction == Reduction::Exact);
        let printed = sub(acceleration, cross3(angular_acceleration, position));
        let rate = if exact { sub(printed, cross3(w, velocity)) } else { printed };
        let twice = cross3(angular_acceleration, velocity);
        let jerk = scale(add_scaled(cross3(w, acceleration), w[0].lit(2.0), twice), w[0].lit(-1.0));
        Motion {
            twist: Twist { v: sub(velocity, cross3(w, position)), w },
            rate: if order > 1 { Twist { v: rate, w: angular_acceleration } } else { Twist { v: zero, w: zero } },
            jerk: Twist { v: if order > 2 && exact { jerk } else { zero }, w: zero },
        }
    }

    /// Cotangents of the state from those of [`BodyState::motion`]. For `y = a × b`: `g_a = b × g`, `g_b = g × a`.
    pub(crate) fn motion_backward(&self, order: u8, reduction: Reduction, d: &Motion<T>) -> Self {
        let (minus, minus_two) = (self.w[0].lit(-1.0), self.w[0].lit(-2.0));
        let (zero, exact) = ([self.w[0].lit(0.0); 3], reduction == Reduction::Exact);
        let g = d.twist.v;
        let mut out = Self {
            position: cross3(self.w, g),
            velocity: g,
            acceleration: zero,
            w: sub(d.twist.w, cross3(self.position, g)),
            angular_acceleration: zero,
        };
        if order > 1 {
            let g = d.rate.v;
            out.acceleration = g;
            out.angular_acceleration = sub(d.rate.w, cross3(self.position, g));
            out.position = add(out.position, cross3(self.angular_acceleration, g));
            if exact {
                out.w = sub(out.w, cross3(self.velocity, g));
                out.velocity = add(out.velocity, cross3(self.w, g));
            }
        }
        if order > 2 && exact {
            let g = d.jerk.v;
            out.angular_acceleration = add_scaled(out.angular_acceleration, minus_two, cross3(self.velocity, g));
            out.velocity = add_scaled(out.velocity, minus_two, cross3(g, self.angular_acceleration));
            out.w = add_scaled(out.w, minus, cross3(self.acceleration, g));
            out.acceleration = add_scaled(out.acceleration, minus, cross3(g, self.w));
        }
        out
    }
}

impl BodyState<f64> {
    /// Position after `tau` of the particle at `x` (relative to the origin), and the body's rotation since `(w, x, y, z)`.
    /// Exact for a fixed axis (`ε ∥ w`) and a constant acceleration of the centre: only the part of `ε` along `w` is used
    /// (all of it where `w = 0`).
    pub fn exact_arc(&self, tau: f64, x: [f64; 3]) -> ([f64; 3], [f64; 4]) {
        let (w, e, square) = (self.w, self.angular_acceleration, dot3(self.w, self.w));
        let along = if square > 0.0 { scale(w, dot3(w, e) / square) } else { e };
        let rotation = Rotation::new(add_scaled(scale(w, tau), 0.5 * tau * tau, along));
        let moved = add_scaled(scale(self.velocity, tau), 0.5 * tau * tau, self.acceleration);
        let arm = rotation.rotate(sub(x, self.position));
        (add(add(self.position, moved), arm), rotation.quaternion())
    }
}

/// The point of the instantaneous screw axis nearest to the origin, `(w × v̄) / ‖w‖²`, world units relative to the origin; the
/// origin itself for a body that does not rotate.
pub fn velocity_pole(twist: &Twist<f64>) -> [f64; 3] {
    let square = dot3(twist.w, twist.w);
    match square > 0.0 {
        true => scale(cross3(twist.w, twist.v), 1.0 / square),
        false => [0.0; 3],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vec3::norm;
    use gs_core::Rng;

    fn random(rng: &mut Rng) -> [f64; 3] {
        std::array::from_fn(|_| f64::from(rng.normal()))
    }

    fn body(rng: &mut Rng) -> BodyState<f64> {
        BodyState {
            position: random(rng),
            velocity: random(rng),
            acceleration: random(rng),
            w: random(rng),
            angular_acceleration: random(rng),
        }
    }

    fn near(a: [f64; 3], b: [f64; 3], tolerance: f64) -> bool {
        norm(sub(a, b)) <= tolerance * (1.0 + norm(b))
    }

    /// T11: both forms give the same velocity; rate and jerk are the derivatives of `v_c(t) − w(t) × P_c(t)`.
    #[test]
    fn the_reduction_is_exact() {
        let mut rng = Rng::new(1, "centre", 0, 0);
        for _ in 0..200 {
            let (b, x) = (body(&mut rng), random(&mut rng));
            let m = b.motion(3, Reduction::Exact);
            let want = add(cross3(b.w, sub(x, b.position)), b.velocity);
            assert!(near(m.twist.velocity(x), want, 1e-14));
            let v_bar = |t: f64| {
                let at = add(b.position, add_scaled(scale(b.velocity, t), 0.5 * t * t, b.acceleration));
                let velocity = add_scaled(b.velocity, t, b.acceleration);
                sub(velocity, cross3(add_scaled(b.w, t, b.angular_acceleration), at))
            };
            let h = 1e-5;
            let slope = scale(sub(v_bar(h), v_bar(-h)), 0.5 / h);
            assert!(near(m.rate.v, slope, 1e-8), "{:?} {slope:?}", m.rate.v);
            let h = 1e-3;
            let second = scale(sub(add(v_bar(h), v_bar(-h)), scale(v_bar(0.0), 2.0)), 1.0 / (h * h));
            assert!(near(m.jerk.v, second, 1e-7), "{:?} {second:?}", m.jerk.v);
            let paper = b.motion(3, Reduction::Paper);
            assert!(near(sub(paper.rate.v, m.rate.v), cross3(b.w, b.velocity), 1e-13));
            assert_eq!(paper.jerk, Twist::default());
            assert_eq!(b.motion(1, Reduction::Exact), Motion { twist: m.twist, ..Motion::default() });
        }
    }

    #[test]
    fn the_pole_lies_on_the_screw_axis() {
        let mut rng = Rng::new(3, "centre", 0, 0);
        for _ in 0..200 {
            let twist = body(&mut rng).motion(1, Reduction::Exact).twist;
            let pole = velocity_pole(&twist);
            let pitch = scale(twist.w, dot3(twist.w, twist.v) / dot3(twist.w, twist.w));
            assert!(near(twist.velocity(pole), pitch, 1e-13));
            assert!(dot3(pole, twist.w).abs() < 1e-12);
        }
        assert_eq!(velocity_pole(&Twist { v: [1.0; 3], w: [0.0; 3] }), [0.0; 3]);
    }
}
