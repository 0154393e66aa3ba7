//! The common form of the frequency and the acutance kernel, its derivatives, its inverse and its mass.
//!
//! Both profiles are piecewise linear in `g` and point-symmetric about `(½, ½)`: slope `k` up to a knot `p`, slope `1 + u`
//! between `p` and `1 − p`, slope `k` beyond. Folded by the symmetry and written as a residual of the Gaussian,
//! ```text
//! h = min(g, 1 − g)     σ = g ≤ ½ ? +1 : −1     ψ = g + σ u max(−κ h, h − ½)     p = ½/(1 + κ)     k = 1 − u κ
//! ```
//! with no comparison against a knot, so ψ is continuous under rounding, and `u = 0` is `ψ = g` to the bit. The first
//! term of the maximum is the larger one on the two outer segments, the second on the inner segment.
//!
//! | kernel | `u` | `κ` | `k` |
//! |---|---|---|---|
//! | frequency (λ, β), `r = ½ + λ`, `D = r − β` | `λ − ½` | `β/D` | `r(1 − β)/D` |
//! | acutance η | `2η/(1 − η)` | `(1 − η)/(1 + η)` | `(1 − η)/(1 + η)` |
//!
//! Where `D ≤ 0` (FAGS eq. 3 with its knots clamped to 0 and 1) there is only the inner segment: `ψ = ½ + r(g − ½)`
//! starts at `(1 − r)/2 > 0` and never decays, so such a splat has no bounded support.

use crate::Real;

/// A kernel profile `ψ(g)`, `g ∈ [0, 1]`, in the common form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Profile<T> {
    /// Slope of the inner segment less one; 0 is the Gaussian.
    pub u: T,
    /// Steepness of the residual on the outer segments; 1e30 where `D ≤ 0`.
    pub kappa: T,
    /// Slope `k` of the outer segments; that of the inner one where there are none.
    pub foot: T,
}

/// `ψ(g)` and its partial derivatives in the common form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Partials<T> {
    /// Value of the profile, `ψ(g)`.
    pub value: T,
    /// Its slope by `g`, `dψ/dg`.
    pub slope: T,
    /// `σ h` on the outer segments, else 0.
    pub outer: T,
    /// `σ (h − ½)` on the inner segment, else 0.
    pub inner: T,
}

impl<T: Real + PartialOrd> Profile<T> {
    /// κ of a profile without outer segments.
    const CLAMPED: f64 = 1e30;

    /// The frequency-differentiated kernel (FAGS, eq. 3). Domain: `λ, β ∈ [0, 1]`.
    #[inline(always)]
    pub fn frequency(lambda: T, beta: T) -> Self {
        let (zero, half, one) = (lambda.lit(0.0), lambda.lit(0.5), lambda.lit(1.0));
        let (u, r) = (lambda - half, lambda + half);
        let d = r - beta;
        if d > zero {
            Self { u, kappa: beta / d, foot: r * (one - beta) / d }
        } else {
            Self { u, kappa: u.lit(Self::CLAMPED), foot: r }
        }
    }

    /// A Gaussian with a sharpness, the acutance of Deformable Radial Kernels. Domain: `acutance ∈ (−1, 1)`.
    #[inline(always)]
    pub fn acutance(acutance: T) -> Self {
        let one = acutance.lit(1.0);
        let slope = (one - acutance) / (one + acutance);
        Self { u: (acutance + acutance) / (one - acutance), kappa: slope, foot: slope }
    }

    /// Whether the knots are clamped to 0 and 1 (`D ≤ 0`).
    #[inline(always)]
    pub fn is_clamped(&self) -> bool {
        self.kappa >= self.u.lit(Self::CLAMPED)
    }

    /// Whether the profile never decays to 0, so that only a cut-off radius bounds the splat.
    #[inline(always)]
    pub fn is_unbounded(&self) -> bool {
        self.is_clamped() && self.u < self.u.lit(0.0)
    }

    /// The profile `ψ(g)` for `g ∈ [0, 1]`.
    #[inline(always)]
    pub fn psi(&self, g: T) -> T {
        self.partials(g).value
    }

    /// `ψ(g)` and its partial derivatives; at a knot those of the inner segment.
    #[inline(always)]
    pub fn partials(&self, g: T) -> Partials<T> {
        let (zero, half, one) = (g.lit(0.0), g.lit(0.5), g.lit(1.0));
        let h = g.min(one - g);
        let sign = if g > half { -one } else { one };
        let (outer, inner) = (-(self.kappa * h), h - half);
        if outer > inner && !self.is_clamped() {
            Partials { value: g + sign * self.u * outer, slope: self.foot, outer: sign * h, inner: zero }
        } else {
            Partials { value: g + sign * self.u * inner, slope: one + self.u, outer: zero, inner: sign * inner }
        }
    }
}

impl Profile<f64> {
    /// Smallest `g` with `ψ(g) ≥ threshold`: `None` if there is none, 0 where the support is unbounded. The splat
    /// extends to the squared Mahalanobis distance `−2 ln g`.
    #[inline(always)]
    pub fn support(&self, threshold: f64) -> Option<f64> {
        let Self { u, kappa, foot } = *self;
        let r = 1.0 + u;
        let on_inner = 0.5 + (threshold - 0.5) / r;
        if threshold <= 0.0 {
            return Some(0.0);
        }
        if self.is_clamped() {
            return (threshold <= 0.5 * (1.0 + r)).then_some(on_inner.max(0.0));
        }
        let at_knot = foot * 0.5 / (1.0 + kappa);
        match threshold {
            t if t > 1.0 => None,
            t if t <= at_knot => Some(t / foot),
            t if t <= 1.0 - at_knot || foot <= 0.0 => Some(on_inner.clamp(0.0, 1.0)),
            t => Some((1.0 - (1.0 - t) / foot).clamp(0.0, 1.0)),
        }
    }

    /// `∫ψ dA / ∫g dA` over the plane: 1 for the Gaussian, infinite where the support is unbounded.
    pub fn mass(&self) -> f64 {
        let Self { u, kappa, foot } = *self;
        if u == 0.0 {
            return 1.0;
        }
        if self.is_clamped() {
            return f64::INFINITY;
        }
        let low = 0.5 / (1.0 + kappa);
        let high = 1.0 - low;
        1.0 - 0.5 * u * (high / low).ln() - (1.0 - foot) * high.ln()
    }
}

/// `[dL/dλ, dL/dβ]` from `[Σ v outer, Σ v inner]` with `v = dL/dψ` ([`Partials`]).
#[inline(always)]
pub fn frequency_vjp<T: Real + PartialOrd>(lambda: T, beta: T, [outer, inner]: [T; 2]) -> [T; 2] {
    let (zero, half, one) = (lambda.lit(0.0), lambda.lit(0.5), lambda.lit(1.0));
    let (u, r) = (lambda - half, lambda + half);
    let d = r - beta;
    if d <= zero {
        return [inner, zero];
    }
    // β² ≤ 1 and the outer sum shrinks like D: dividing twice keeps the intermediate in range.
    let outer = outer / d / d;
    [inner - beta * (one - beta) * outer, -(u * r * outer)]
}

/// `dL/d acutance` from `[Σ v outer, Σ v inner]` with `v = dL/dψ` ([`Partials`]).
#[inline(always)]
pub fn acutance_vjp<T: Real + PartialOrd>(acutance: T, [outer, inner]: [T; 2]) -> T {
    let (one, two) = (acutance.lit(1.0), acutance.lit(2.0));
    let (rise, fall) = (one - acutance, one + acutance);
    two * (inner / (rise * rise) - outer / (fall * fall))
}
