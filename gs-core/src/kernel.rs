//! The fall-off of a splat: what stands between the Gaussian of the distance and alpha.

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
