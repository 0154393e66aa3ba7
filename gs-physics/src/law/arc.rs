//! Closed forms of motion: a particle on the exact arc about a moving centre, and a free one on a straight line.
//!
//! ```text
//! x(τ) = x + v_c τ + ½ a_c τ² + (R(φ) − 1)(x − P_c)        q(τ) = q(φ)
//! φ = w (τ + e S / √(|w|² + κ²))        S = ½ τ²           or, as GVFi prints it, Σ τ_k h_k over the steps
//! ```
//! Exact for a fixed axis, where the angle is `|w| τ + ½ e τ²` (GVFi, Eq. 6 and 7, whose angle takes the angular velocity
//! at the start of each step). A free particle is its own centre.

use super::form::{Form, MAX_OUTPUTS, axis};
use crate::scalar::Scalar;
use crate::so3::Rotation;
use crate::vec3::{V3, add, add_scaled, scale, sub};
use gs_core::cast;
use gs_core::real::dot3;

/// Duration of a motion, and the factor of `e`.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub(crate) struct Span<T> {
    pub tau: T,
    /// `S` of the module header, unit of time squared.
    pub spin: T,
}

impl Span<f64> {
    /// Over `tau`; with the `(begin, length)` steps of a roll-out for GVFi's printed angle.
    pub(crate) fn new(tau: f64, steps: Option<&[(f64, f64)]>) -> Self {
        let printed = |steps: &[(f64, f64)]| steps.iter().map(|(begin, h)| begin * h).sum();
        Self { tau, spin: steps.map_or(0.5 * tau * tau, printed) }
    }

    pub(crate) fn to_f32(self) -> Span<f32> {
        Span { tau: cast::to_f32(self.tau), spin: cast::to_f32(self.spin) }
    }
}

/// Index of `e` of gvfi13 among the mapped outputs; that output is zero for the other forms.
const SPIN: usize = 12;

/// Position about the origin and rotation since the start of a particle that started at `x`.
pub(crate) fn advance<T: Scalar>(form: &Form, y: &[T], x: V3<T>, span: Span<T>) -> (V3<T>, [T; 4]) {
    let m = form.mapped(y);
    let body = form.body(&m, x);
    let arm = sub(x, body.position);
    let rotation = Rotation::new(scale(body.w, span.tau + m[SPIN] * span.spin * axis(body.w).0));
    let shift = add_scaled(scale(body.velocity, span.tau), span.tau * span.tau * x[0].lit(0.5), body.acceleration);
    (add(add(x, shift), sub(rotation.rotate(arm), arm)), rotation.quaternion())
}

/// Cotangents of the network's outputs from those of [`advance`].
pub(crate) fn advance_backward<T: Scalar>(
    form: &Form,
    y: &[T],
    x: V3<T>,
    span: Span<T>,
    (lambda, d_q): (V3<T>, [T; 4]),
    d_y: &mut [T],
) {
    let m = form.mapped(y);
    let body = form.body(&m, x);
    let (inverse, unit) = axis(body.w);
    let per_spin = span.spin * inverse;
    let length = span.tau + m[SPIN] * per_spin;
    let rotation = Rotation::new(scale(body.w, length));
    let arm = sub(x, body.position);
    let (d_arm, _, d_phi) = rotation.transform_backward([x[0].lit(0.0); 3], arm, lambda, d_q);
    let d_length = dot3(body.w, d_phi);
    // ∂length/∂w = −e S w / n³
    let d_w = add_scaled(scale(d_phi, length), -d_length * m[SPIN] * per_spin * inverse, unit);
    let d_velocity = scale(lambda, span.tau);
    let d_position = sub(lambda, d_arm);
    let d_acceleration = scale(lambda, span.tau * span.tau * x[0].lit(0.5));
    let mut d = [x[0].lit(0.0); MAX_OUTPUTS];
    let parts: &[V3<T>] = match form.outputs().1 {
        6 => &[d_velocity, d_w],
        _ => &[d_position, d_velocity, d_w, d_acceleration],
    };
    d.iter_mut().zip(parts.iter().flatten()).for_each(|(to, from)| *to = *from);
    if parts.len() > 2 {
        d[SPIN] = d_length * per_spin;
    }
    d_y.iter_mut().zip(d).for_each(|(to, from)| *to = from);
    form.mapped_backward(y, d_y);
}
