//! Velocity and its derivatives at one point, from the coefficients of the basis and their derivatives; with backward.
//!
//! ```text
//! u = v + w × r            r = x − o,  c = (v, w)
//! ∂_j u = ∂_j v + ∂_j w × r + w × e_j          ∂_t u = ∂_t v + ∂_t w × r
//! ω = ½ ∇ × u
//! ```

use crate::vec3::{V3, add, scale, sub};
use gs_core::Real;
use gs_core::real::cross3;

/// Number of basis vectors: three translations, three rotations.
pub(crate) const BASIS: usize = 6;

/// The coefficients at a point, then their derivatives by x, y, z and t; zeros for those not evaluated.
pub(crate) type Coefficients<T> = [[T; BASIS]; 5];

/// Velocity and its derivatives at one point, or the cotangents of that.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Flow<T> {
    pub u: V3<T>,
    /// Derivatives of `u` by x, y, z, t.
    pub by: [V3<T>; 4],
}

fn parts<T: Real>(c: &[T; BASIS]) -> (V3<T>, V3<T>) {
    ([c[0], c[1], c[2]], [c[3], c[4], c[5]])
}

fn unit<T: Real>(like: T, axis: usize) -> V3<T> {
    std::array::from_fn(|k| like.lit(if k == axis { 1.0 } else { 0.0 }))
}

impl<T: Real> Flow<T> {
    /// Zero velocity and derivatives; `like` gives the kind of number.
    pub(crate) fn zero(like: T) -> Self {
        let o = [like.lit(0.0); 3];
        Self { u: o, by: [o; 4] }
    }

    /// The flow of coefficients `c` at `r` relative to the origin.
    pub(crate) fn new(c: &Coefficients<T>, r: V3<T>) -> Self {
        let (v, w) = parts(&c[0]);
        let by = std::array::from_fn(|j| {
            let (v, change) = parts(&c[1 + j]);
            let moved = add(v, cross3(change, r));
            if j < 3 { add(moved, cross3(w, unit(r[0], j))) } else { moved }
        });
        Self { u: add(v, cross3(w, r)), by }
    }

    /// Backward of [`Flow::new`]: cotangents of the coefficients and of `r`, where `self` is the cotangent of the flow.
    pub(crate) fn backward(&self, c: &Coefficients<T>, r: V3<T>) -> (Coefficients<T>, V3<T>) {
        let join = |v: V3<T>, w: V3<T>| [v[0], v[1], v[2], w[0], w[1], w[2]];
        let mut d_w = cross3(r, self.u);
        let mut d_r = cross3(self.u, parts(&c[0]).1);
        let mut out = [[r[0].lit(0.0); BASIS]; 5];
        for (j, d) in self.by.into_iter().enumerate() {
            out[1 + j] = join(d, cross3(r, d));
            d_r = add(d_r, cross3(d, parts(&c[1 + j]).1));
            if j < 3 {
                d_w = add(d_w, cross3(unit(r[0], j), d));
            }
        }
        out[0] = join(self.u, d_w);
        (out, d_r)
    }

    /// Angular velocity `ω` of the fluid at the point.
    pub(crate) fn angular_velocity(&self) -> V3<T> {
        let [x, y, z, _] = self.by;
        scale([y[2] - z[1], z[0] - x[2], x[1] - y[0]], self.u[0].lit(0.5))
    }

    /// Adds the cotangent `g` of [`Flow::angular_velocity`].
    pub(crate) fn add_angular_velocity(&mut self, g: V3<T>) {
        let g = scale(g, self.u[0].lit(0.5));
        for j in 0..3 {
            self.by[j] = add(self.by[j], cross3(g, unit(g[0], j)));
        }
    }

    /// The divergence `∇ · u`.
    pub(crate) fn divergence(&self) -> T {
        self.by[0][0] + self.by[1][1] + self.by[2][2]
    }

    /// The acceleration `∂_t u + (∇u) u` of what flows.
    pub(crate) fn acceleration(&self) -> V3<T> {
        let along = |j: usize| scale(self.by[j], self.u[j]);
        add(self.by[3], add(along(0), add(along(1), along(2))))
    }

    /// Residual `∂_t u + (∇u) u − a` of the equation of motion.
    pub(crate) fn residual(&self, a: V3<T>) -> V3<T> {
        sub(self.acceleration(), a)
    }

    /// Cotangent of the flow from those of [`Flow::divergence`] and [`Flow::residual`]; that of `a` is `−d_residual`.
    pub(crate) fn losses_backward(&self, d_divergence: T, d_residual: V3<T>) -> Self {
        let mut out = Self::zero(d_divergence);
        out.by[3] = d_residual;
        for j in 0..3 {
            out.by[j] = scale(d_residual, self.u[j]);
            out.by[j][j] = out.by[j][j] + d_divergence;
            out.u[j] = gs_core::real::dot3(self.by[j], d_residual);
        }
        out
    }
}

/// NVFi's acceleration from its coefficients: a constant, and attraction to the three axes,
/// `a = (α₀ − x (α₄ + α₅), α₁ − y (α₃ + α₅), α₂ − z (α₃ + α₄))`.
pub(crate) fn acceleration<T: Real>(alpha: &[T], [x, y, z]: V3<T>) -> V3<T> {
    let a = alpha;
    [a[0] - x * (a[4] + a[5]), a[1] - y * (a[3] + a[5]), a[2] - z * (a[3] + a[4])]
}

/// Cotangents of the coefficients of [`acceleration`] from the cotangent `g`.
pub(crate) fn acceleration_backward<T: Real>([x, y, z]: V3<T>, g: V3<T>, d_alpha: &mut [T]) {
    let [p, q, s] = [x * g[0], y * g[1], z * g[2]];
    d_alpha.copy_from_slice(&[g[0], g[1], g[2], -(q + s), -(p + s), -(p + q)]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    fn random<const N: usize>(rng: &mut Rng) -> [f64; N] {
        std::array::from_fn(|_| f64::from(rng.normal()))
    }

    /// A rigid body: its twist comes back, the divergence is zero, and with its own acceleration so is the residual.
    #[test]
    fn a_rigid_flow_is_its_twist() {
        let mut rng = Rng::new(1, "flow", 0, 0);
        for _ in 0..20 {
            let (c, rate, r) = (random::<6>(&mut rng), random::<6>(&mut rng), random::<3>(&mut rng));
            let o = [0.0; 6];
            let flow = Flow::new(&[c, o, o, o, rate], r);
            let ((v, w), (a, e)) = (parts(&c), parts(&rate));
            let want = add(v, cross3(w, r));
            assert!(sub(flow.u, want).iter().all(|d| d.abs() < 1e-14));
            assert!(sub(flow.angular_velocity(), w).iter().all(|d| d.abs() < 1e-14));
            assert!(flow.divergence().abs() < 1e-14);
            let acceleration = add(add(a, cross3(e, r)), cross3(w, want));
            assert!(flow.residual(acceleration).iter().all(|d| d.abs() < 1e-13));
        }
    }

    /// Every cotangent against central differences; all of it is at most quadratic, so they are exact.
    #[test]
    fn backward_matches_differences() {
        let mut rng = Rng::new(2, "flow", 0, 0);
        for _ in 0..20 {
            let flat = random::<33>(&mut rng);
            let (g_turn, g_div, g_missing, g_u) =
                (random::<3>(&mut rng), random::<1>(&mut rng)[0], random::<3>(&mut rng), random::<3>(&mut rng));
            let dot = |a: V3<f64>, b: V3<f64>| gs_core::real::dot3(a, b);
            let parse = |flat: &[f64; 33]| {
                let c: Coefficients<f64> = std::array::from_fn(|k| std::array::from_fn(|i| flat[6 * k + i]));
                (c, [flat[30], flat[31], flat[32]])
            };
            let alpha = random::<6>(&mut rng);
            let loss = |flat: &[f64; 33]| {
                let (c, r) = parse(flat);
                let flow = Flow::new(&c, r);
                let residual = flow.residual([0.0; 3]);
                dot(flow.angular_velocity(), g_turn)
                    + flow.divergence() * g_div
                    + dot(residual, g_missing)
                    + dot(flow.u, g_u)
            };
            let (c, r) = parse(&flat);
            let flow = Flow::new(&c, r);
            let mut d = flow.losses_backward(g_div, g_missing);
            d.add_angular_velocity(g_turn);
            d.u = add(d.u, g_u);
            let (d_c, d_r) = d.backward(&c, r);
            for (i, got) in d_c.as_flattened().iter().chain(&d_r).enumerate() {
                let (mut hi, mut lo) = (flat, flat);
                hi[i] += 0.5;
                lo[i] -= 0.5;
                // Third order in r alone.
                let want = if i < 30 { loss(&hi) - loss(&lo) } else { fine(&loss, flat, i) };
                assert!((got - want).abs() < 1e-7 * (1.0 + want.abs()), "{i}: {got} {want}");
            }
            let mut d_alpha = [0.0; 6];
            acceleration_backward(r, g_missing, &mut d_alpha);
            for (i, got) in d_alpha.into_iter().enumerate() {
                let (mut hi, mut lo) = (alpha, alpha);
                hi[i] += 0.5;
                lo[i] -= 0.5;
                let want = dot(acceleration(&hi, r), g_missing) - dot(acceleration(&lo, r), g_missing);
                assert!((got - want).abs() < 1e-12 * (1.0 + want.abs()), "alpha {i}: {got} {want}");
            }
        }
    }

    fn fine(loss: &dyn Fn(&[f64; 33]) -> f64, flat: [f64; 33], i: usize) -> f64 {
        let (mut hi, mut lo) = (flat, flat);
        hi[i] += 1e-5;
        lo[i] -= 1e-5;
        (loss(&hi) - loss(&lo)) / 2e-5
    }
}
