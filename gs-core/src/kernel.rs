//! The fall-off of a splat: what stands between the Gaussian of the distance and alpha.
//!
//! [`Kernel`] holds the columns of a scene; [`Bend`] is the mathematics of one row, the same for every bent kernel;
//! [`BetaMode`] says how far the frequency kernel's β may go.

mod bend;
mod beta;
mod plain;
#[cfg(test)]
mod tests;

pub use bend::{Bend, Partials, acutance_vjp, frequency_vjp};
pub use beta::{BetaMode, MIN_KNOT, effective_beta, effective_beta_vjp};

/// How a splat falls off with the Gaussian `g = exp(−½ d²)` of its Mahalanobis distance `d`: `alpha = opacity · ψ(g)`.
#[derive(Clone, Debug, PartialEq, Default)]
#[non_exhaustive]
pub enum Kernel {
    /// `ψ(g) = g`.
    #[default]
    Gaussian,
    /// The frequency-differentiated kernel (FAGS, eq. 3): `ψ` is piecewise linear through `(0, 0)`, `(p, (1 − β)/2)`,
    /// `(1 − p, (1 + β)/2)`, `(1, 1)` with `p = (½ + λ − β) / (1 + 2λ)`. `λ = ½` or `β = 0` is the Gaussian.
    Frequency {
        /// λ per splat, `[0, 1]`: above ½ sharp edges, below ½ a soft body on a steep foot.
        lambdas: Vec<f32>,
        /// β per splat, `[0, 1]`: how much of the fall-off is bent.
        betas: Vec<f32>,
    },
    /// The kernel of Deformable Radial Kernels: slopes `(1 − κ)/(1 + κ)`, `(1 + κ)/(1 − κ)`, `(1 − κ)/(1 + κ)` with
    /// knots at `(1 + κ)/4` and `(3 − κ)/4`. `κ = 0` is the Gaussian.
    Acutance {
        /// κ per splat, inside `(−1, 1)`: above 0 sharper, below 0 softer.
        acutances: Vec<f32>,
    },
}

/// Domain of λ and β.
const UNIT: [f32; 2] = [0.0, 1.0];
/// Domain of the acutance: the slopes stay within 1 : 2000.
const ACUTANCE: [f32; 2] = [-0.999, 0.999];

impl Kernel {
    /// Parameters per splat: the width of [`SplatsGrad::kernel`](crate::SplatsGrad).
    pub fn width(&self) -> usize {
        match self {
            Kernel::Gaussian => 0,
            Kernel::Frequency { .. } => 2,
            Kernel::Acutance { .. } => 1,
        }
    }

    /// The bend of one row; `None` for the Gaussian.
    #[inline(always)]
    pub fn bend(&self, row: usize) -> Option<Bend<f64>> {
        match self {
            Kernel::Gaussian => None,
            Kernel::Frequency { lambdas, betas } => {
                Some(Bend::frequency(f64::from(lambdas[row]), f64::from(betas[row])))
            }
            Kernel::Acutance { acutances } => Some(Bend::acutance(f64::from(acutances[row]))),
        }
    }

    /// Whether every row draws as the Gaussian does, to the bit (`u = 0`).
    pub fn is_neutral(&self) -> bool {
        match self {
            Kernel::Gaussian => true,
            Kernel::Frequency { lambdas, .. } => lambdas.iter().all(|&l| l == 0.5),
            Kernel::Acutance { acutances } => acutances.iter().all(|&a| a == 0.0),
        }
    }

    /// Cotangents of one row's parameters, `[width]`, from `[Σ v outer, Σ v inner]` with `v = dL/dψ` ([`Partials`]).
    #[inline(always)]
    pub fn vjp(&self, row: usize, sums: [f64; 2], d: &mut [f32]) {
        match self {
            Kernel::Gaussian => {}
            Kernel::Frequency { lambdas, betas } => {
                let v = frequency_vjp(f64::from(lambdas[row]), f64::from(betas[row]), sums);
                d.copy_from_slice(&v.map(|v| v as f32));
            }
            Kernel::Acutance { acutances } => d[0] = acutance_vjp(f64::from(acutances[row]), sums) as f32,
        }
    }

    /// The columns by name, with the closed interval they must lie in and its description.
    pub(crate) fn columns(&self) -> Vec<(&'static str, &[f32], [f32; 2], &'static str)> {
        match self {
            Kernel::Gaussian => Vec::new(),
            Kernel::Frequency { lambdas, betas } => {
                vec![("lambdas", lambdas, UNIT, "0 to 1"), ("betas", betas, UNIT, "0 to 1")]
            }
            Kernel::Acutance { acutances } => vec![("acutances", acutances, ACUTANCE, "-0.999 to 0.999")],
        }
    }
}
