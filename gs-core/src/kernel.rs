//! Kernel profiles: the function `ψ` from the Gaussian of the distance to alpha.
//!
//! [`Kernel`] holds the columns of a scene; [`Profile`] is the profile of one row, in a form that all kernels other than the
//! Gaussian share; [`BetaMode`] bounds the β of the frequency kernel.
//!
//! ```
//! use gs_core::kernel::Profile;
//!
//! // λ = ½ is the Gaussian, exactly; λ above ½ is steeper around half height.
//! assert_eq!(Profile::frequency(0.5, 0.7).psi(0.3), 0.3);
//! assert!(Profile::frequency(0.9, 0.5).psi(0.3) < 0.3);
//! // The Gaussian meets α = 1/255 at the Mahalanobis distance √(2 ln 255) = 3.33.
//! let g = Profile::acutance(0.0).support(1.0 / 255.0).unwrap();
//! assert!(((-2.0 * g.ln()).sqrt() - 3.329).abs() < 1e-3);
//! ```

mod beta;
mod nearest;
mod profile;
#[cfg(test)]
mod tests;

pub(crate) use beta::effective_beta_vjp;
pub use beta::{BetaMode, effective_beta};
pub use profile::{Partials, Profile, acutance_vjp, frequency_vjp};

/// Kernel of the splats of a scene: `alpha = opacity · ψ(g)` with the Gaussian `g = exp(−½ d²)` of the Mahalanobis
/// distance `d`.
#[derive(Clone, Debug, PartialEq, Default)]
#[non_exhaustive]
pub enum Kernel {
    /// The Gaussian itself, `ψ(g) = g`.
    #[default]
    Gaussian,
    /// The frequency-differentiated kernel (FAGS, eq. 3): `ψ` is piecewise linear through `(0, 0)`, `(p, (1 − β)/2)`,
    /// `(1 − p, (1 + β)/2)`, `(1, 1)` with `p = (½ + λ − β) / (1 + 2λ)`. `λ = ½` or `β = 0` is the Gaussian.
    Frequency {
        /// λ per splat, `[0, 1]`: above ½ the edge is sharper than the Gaussian's, below ½ softer.
        lambdas: Vec<f32>,
        /// β per splat, `[0, 1]`: share of the range of `ψ` in the middle segment.
        betas: Vec<f32>,
    },
    /// A Gaussian with a sharpness κ, as the acutance of Deformable Radial Kernels (Huang et al. 2024); their radial bases are not
    /// here. Slopes `(1 − κ)/(1 + κ)`, `(1 + κ)/(1 − κ)`, `(1 − κ)/(1 + κ)` with
    /// knots at `(1 + κ)/4` and `(3 − κ)/4`. `κ = 0` is the Gaussian.
    Acutance {
        /// κ per splat, inside `(−1, 1)`: above 0 sharper, below 0 softer.
        acutances: Vec<f32>,
    },
}

/// Domain of λ and of β.
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

    /// The profile of one row; `None` for the Gaussian.
    #[inline(always)]
    pub fn bend(&self, row: usize) -> Option<Profile<f64>> {
        match self {
            Kernel::Gaussian => None,
            Kernel::Frequency { lambdas, betas } => {
                Some(Profile::frequency(f64::from(lambdas[row]), f64::from(betas[row])))
            }
            Kernel::Acutance { acutances } => Some(Profile::acutance(f64::from(acutances[row]))),
        }
    }

    /// Whether every row renders as a Gaussian, to the bit (`u = 0`, see [`Profile`]).
    pub fn is_neutral(&self) -> bool {
        match self {
            Kernel::Gaussian => true,
            Kernel::Frequency { lambdas, .. } => lambdas.iter().all(|&l| l == 0.5),
            Kernel::Acutance { acutances } => acutances.iter().all(|&a| a == 0.0),
        }
    }

    /// Cotangents of one row's parameters, `[width]`, from `[Σ v outer, Σ v inner]` with `v = dL/dψ` ([`Partials`]).
    /// Overwrites `d`.
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

    /// Columns as `(name, values, closed domain, domain in words)`.
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
