//! Raw kernel columns of a cloud, their activation to a [`Kernel`], and its backward.
//!
//! ```text
//! λ = σ(lambda)                                          dL/d lambda   = dL/dλ · λ (1 − λ)
//! β = β_hi σ(beta)     β_eff = effective_beta(λ, β)      dL/d beta     = dL/dβ · β (1 − β/β_hi)
//! κ = κ_hi tanh(acutance)                                dL/d acutance = dL/dκ · (κ_hi − κ²/κ_hi)
//! ```
//! `dL/dλ` and `dL/dβ` include the gradient through `β_eff` ([`effective_beta_vjp`]). λ starts at exactly ½ and κ at 0,
//! where the splat is the Gaussian to the bit. λ may be one value shared by all splats: its gradient is the sum over the
//! rows, in `f64` and in row order.

use super::{BLOCK, CloudError, logit, sigmoid};
use crate::kernel::{BetaMode, Kernel, effective_beta, effective_beta_vjp};
use crate::param::Param;
use rayon::prelude::*;

/// Initial β of every splat.
const INITIAL_BETA: f32 = 0.5;
/// Largest magnitude of an acutance κ.
const KAPPA_HI: f32 = 0.999;

/// The kernel of a new cloud, for [`Cloud::with_kernel`](super::Cloud::with_kernel).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum KernelInit {
    /// The frequency-differentiated kernel, [`Kernel::Frequency`].
    Frequency {
        /// How `β ≥ ½ + λ` is avoided.
        mode: BetaMode,
        /// Upper end of β, in `(0.5, 1]`.
        beta_hi: f32,
        /// Whether all splats share one λ instead of one each.
        shared_lambda: bool,
    },
    /// A sharpness per splat, [`Kernel::Acutance`].
    Acutance,
}

/// The raw (unconstrained) columns of a kernel.
#[derive(Clone, Debug, PartialEq)]
pub enum RawKernel {
    /// Raw columns of [`Kernel::Frequency`].
    Frequency {
        /// `cloud.lambda` `[n, 1]`, or one shared value; `λ = σ(lambda)`.
        lambda: Param,
        /// `cloud.beta` `[n, 1]`; `β = beta_hi σ(beta)`.
        beta: Param,
        /// How `β ≥ ½ + λ` is avoided.
        mode: BetaMode,
        /// Upper end of β, in `(0.5, 1]`.
        beta_hi: f32,
    },
    /// Raw column of [`Kernel::Acutance`].
    Acutance {
        /// `cloud.acutance` `[n, 1]`; `κ = 0.999 tanh(acutance)`.
        acutance: Param,
    },
}

impl RawKernel {
    /// The columns of `n` splats, initialised so that they render as Gaussians.
    ///
    /// # Errors
    /// If `beta_hi` is out of its domain.
    pub(super) fn new(init: KernelInit, n: usize) -> Result<Self, CloudError> {
        let zeros = || vec![0.0; n];
        match init {
            KernelInit::Frequency { beta_hi, .. } if !(beta_hi > INITIAL_BETA && beta_hi <= 1.0) => {
                Err(CloudError::BetaHi(beta_hi))
            }
            KernelInit::Frequency { mode, beta_hi, shared_lambda } => {
                let lambda = match shared_lambda {
                    true => Param::shared("cloud.lambda", vec![0.0]),
                    false => Param::rows("cloud.lambda", 1, zeros()),
                };
                let beta = Param::rows("cloud.beta", 1, vec![logit(INITIAL_BETA / beta_hi); n]);
                Ok(Self::Frequency { lambda, beta, mode, beta_hi })
            }
            KernelInit::Acutance => Ok(Self::Acutance { acutance: Param::rows("cloud.acutance", 1, zeros()) }),
        }
    }

    /// The columns, in the order of [`Kernel`].
    pub fn params(&self) -> Vec<&Param> {
        match self {
            Self::Frequency { lambda, beta, .. } => vec![lambda, beta],
            Self::Acutance { acutance } => vec![acutance],
        }
    }

    /// The columns to change, in the order of [`Kernel`].
    pub fn params_mut(&mut self) -> Vec<&mut Param> {
        match self {
            Self::Frequency { lambda, beta, .. } => vec![lambda, beta],
            Self::Acutance { acutance } => vec![acutance],
        }
    }

    /// The activated kernel. Reuses the memory of `out`.
    pub(super) fn activate(&self, out: &mut Kernel) {
        match self {
            Self::Frequency { lambda, beta, mode, beta_hi } => {
                let (mut lambdas, mut betas) = match std::mem::take(out) {
                    Kernel::Frequency { lambdas, betas } => (lambdas, betas),
                    _ => Default::default(),
                };
                lambdas.resize(beta.len(), 0.0);
                betas.resize(beta.len(), 0.0);
                match lambda.row_width {
                    Some(_) => map(&mut lambdas, &lambda.value, |l| sigmoid(*l)),
                    None => lambdas.fill(sigmoid(lambda.value[0])),
                }
                betas.par_chunks_mut(BLOCK).enumerate().for_each(|(block, betas)| {
                    let rows = block * BLOCK..block * BLOCK + betas.len();
                    for ((b, raw), l) in betas.iter_mut().zip(&beta.value[rows.clone()]).zip(&lambdas[rows]) {
                        *b = effective_beta(*mode, f64::from(*l), f64::from(beta_hi * sigmoid(*raw))) as f32;
                    }
                });
                *out = Kernel::Frequency { lambdas, betas };
            }
            Self::Acutance { acutance } => {
                let mut acutances = match std::mem::take(out) {
                    Kernel::Acutance { acutances } => acutances,
                    _ => Vec::new(),
                };
                acutances.resize(acutance.len(), 0.0);
                map(&mut acutances, &acutance.value, |a| KAPPA_HI * a.tanh());
                *out = Kernel::Acutance { acutances };
            }
        }
    }

    /// Backward of [`Self::activate`]: adds to the gradients. `kernel` is its result, `d` `[n, width]` the cotangents.
    pub(super) fn activate_backward(&mut self, kernel: &Kernel, d: &[f32]) {
        match (self, kernel) {
            (Self::Frequency { lambda, beta, mode, beta_hi }, Kernel::Frequency { lambdas, .. }) => {
                let d_lambdas = frequency_backward((*mode, *beta_hi), lambdas, beta, d);
                let d_lambdas = d_lambdas.iter().flatten();
                match lambda.row_width {
                    Some(_) => add(&mut lambda.grad, d_lambdas.map(|d| *d as f32)),
                    None => lambda.grad[0] += d_lambdas.sum::<f64>() as f32,
                }
            }
            (Self::Acutance { acutance }, Kernel::Acutance { acutances }) => {
                let d_raw = |(k, d): (&f32, &f32)| d * (KAPPA_HI - k * k / KAPPA_HI);
                add(&mut acutance.grad, acutances.iter().zip(d).map(d_raw));
            }
            _ => debug_assert!(false, "the kernel is that of this cloud"),
        }
    }
}

/// Adds the gradient of raw β; returns `dL/d` raw λ of every row, block by block.
fn frequency_backward((mode, beta_hi): (BetaMode, f32), lambdas: &[f32], beta: &mut Param, d: &[f32]) -> Vec<Vec<f64>> {
    let row_backward = |g: &mut f32, raw: f32, l: f32, d: [f32; 2]| {
        let (l, hi, b) = (f64::from(l), f64::from(beta_hi), f64::from(beta_hi * sigmoid(raw)));
        let [d_l, d_b] = effective_beta_vjp(mode, l, b, f64::from(d[1]));
        *g += (d_b * b * (1.0 - b / hi)) as f32;
        (f64::from(d[0]) + d_l) * l * (1.0 - l)
    };
    (
        beta.grad.par_chunks_mut(BLOCK),
        beta.value.par_chunks(BLOCK),
        lambdas.par_chunks(BLOCK),
        d.as_chunks().0.par_chunks(BLOCK),
    )
        .into_par_iter()
        .map(|(g, raw, l, d)| {
            g.iter_mut().zip(raw).zip(l).zip(d).map(|(((g, raw), l), d)| row_backward(g, *raw, *l, *d)).collect()
        })
        .collect()
}

fn map(out: &mut [f32], raw: &[f32], f: impl Fn(&f32) -> f32 + Sync) {
    out.par_chunks_mut(BLOCK).zip(raw.par_chunks(BLOCK)).for_each(|(out, raw)| {
        out.iter_mut().zip(raw).for_each(|(o, r)| *o = f(r));
    });
}

fn add(grad: &mut [f32], values: impl Iterator<Item = f32>) {
    grad.iter_mut().zip(values).for_each(|(g, v)| *g += v);
}

#[cfg(test)]
mod tests {
    //! | level | compared | tolerance |
    //! |---|---|---|
    //! | truth | gradient at the start: `dλ/d lambda = ¼`, `dβ/d beta = ½ (1 − ½/β_hi)`, `dκ/d acutance = κ_hi` | 1e-6 relative |
    //! | reference | f64 chain rule against central differences of the f64 definition | 1e-8 |
    //! | production | f32 against the f64 reference | 3e-6 |

    use super::*;
    use crate::cloud::Cloud;
    use crate::param::{Params, RowEdit};
    use crate::rng::Rng;
    use crate::splats::{Splats, SplatsGrad};
    use glam::Vec3;

    const MODES: [BetaMode; 3] = [BetaMode::Capped, BetaMode::Literal, BetaMode::Relative];

    fn plain(n: usize) -> Cloud {
        let positions: Vec<Vec3> = (0..n).map(|i| Vec3::splat(i as f32)).collect();
        Cloud::from_points(&positions, &vec![[0.5; 3]; n], &vec![0.2; n], 0.3, 1).unwrap()
    }

    fn frequency(mode: BetaMode, beta_hi: f32, shared_lambda: bool) -> KernelInit {
        KernelInit::Frequency { mode, beta_hi, shared_lambda }
    }

    /// A cloud with random raw kernel columns.
    fn random_cloud(init: KernelInit, n: usize) -> Cloud {
        let mut rng = Rng::new(5, "kernel", 0, 0);
        let mut cloud = plain(n).with_kernel(init).unwrap();
        let params = cloud.kernel.as_mut().unwrap().params_mut();
        params.into_iter().for_each(|p| p.value.iter_mut().for_each(|v| *v = 2.0 * rng.normal()));
        cloud
    }

    /// The kernel's raw gradients of `Σ weight · column`, column by column.
    fn gradients(cloud: &mut Cloud, weights: &[f32]) -> Vec<Vec<f32>> {
        let mut splats = Splats::default();
        cloud.activate(1, &mut splats);
        assert_eq!(splats.check(), Ok(()));
        let d = SplatsGrad { kernel: weights.to_vec(), ..SplatsGrad::zeros_like(&splats) };
        cloud.activate_backward(&splats, &d);
        cloud.kernel.as_ref().unwrap().params().iter().map(|p| p.grad.clone()).collect()
    }

    fn weights(n: usize) -> Vec<f32> {
        let mut rng = Rng::new(6, "kernel", 0, 0);
        (0..n).map(|_| rng.normal()).collect()
    }

    fn sigma(x: f64) -> f64 {
        1.0 / (1.0 + (-x).exp())
    }

    /// `w₀ λ + w₁ β_eff` of one row, by the definition.
    fn reference(mode: BetaMode, beta_hi: f64, [l, b]: [f64; 2], w: [f64; 2]) -> f64 {
        w[0] * sigma(l) + w[1] * effective_beta(mode, sigma(l), beta_hi * sigma(b))
    }

    /// Its gradient by the raw values, by the chain rule.
    fn reference_gradient(mode: BetaMode, beta_hi: f64, [l, b]: [f64; 2], w: [f64; 2]) -> [f64; 2] {
        let (lambda, beta) = (sigma(l), beta_hi * sigma(b));
        let [d_l, d_b] = effective_beta_vjp(mode, lambda, beta, w[1]);
        [(w[0] + d_l) * lambda * (1.0 - lambda), d_b * beta * (1.0 - beta / beta_hi)]
    }

    #[test]
    fn a_new_kernel_is_the_gaussian_and_its_gradient_is_known() {
        for beta_hi in [0.98, 1.0] {
            let mut cloud = plain(3).with_kernel(frequency(BetaMode::Capped, beta_hi, false)).unwrap();
            let mut splats = Splats::default();
            cloud.activate(1, &mut splats);
            let Kernel::Frequency { lambdas, betas } = &splats.kernel else { panic!("frequency") };
            assert_eq!(*lambdas, [0.5; 3]);
            assert!(splats.kernel.is_neutral() && betas.iter().all(|b| (b - 0.5).abs() < 1e-7), "{betas:?}");
            let got = gradients(&mut cloud, &[1.0; 6]);
            let want = [0.25, 0.5 * (1.0 - 0.5 / beta_hi)];
            assert!(
                got.iter().zip(want).all(|(g, w)| g.iter().all(|g| (g / w - 1.0).abs() < 1e-6)),
                "{got:?} {want:?}"
            );
        }
        let mut cloud = plain(3).with_kernel(KernelInit::Acutance).unwrap();
        let mut splats = Splats::default();
        cloud.activate(1, &mut splats);
        assert!(splats.kernel == Kernel::Acutance { acutances: vec![0.0; 3] } && splats.kernel.is_neutral());
        assert_eq!(gradients(&mut cloud, &[1.0; 3]), [[KAPPA_HI; 3]]);
    }

    #[test]
    fn the_reference_gradient_matches_central_differences() {
        let mut rng = Rng::new(7, "kernel", 0, 0);
        let mut capped = 0;
        for mode in MODES {
            for _ in 0..2000 {
                let mut value = || f64::from(2.0 * rng.normal());
                let (raw, w) = ([value(), value()], [value(), value()]);
                // β_eff has a kink where β reaches the cap, or the cap reaches 1: no difference is taken across it.
                let branch = |[l, b]: [f64; 2]| {
                    let d = effective_beta_vjp(mode, sigma(l), 0.98 * sigma(b), 1.0);
                    (d[0] != 0.0, d[1] == 1.0)
                };
                let h = 1e-5;
                let got = reference_gradient(mode, 0.98, raw, w);
                for k in 0..2 {
                    let moved = |h: f64| std::array::from_fn(|i| raw[i] + if i == k { h } else { 0.0 });
                    if branch(moved(h)) != branch(moved(-h)) {
                        continue;
                    }
                    capped += u32::from(branch(raw).0);
                    let want = (reference(mode, 0.98, moved(h), w) - reference(mode, 0.98, moved(-h), w)) / (2.0 * h);
                    assert!((got[k] - want).abs() < 1e-8 * (1.0 + want.abs()), "{mode:?} {raw:?}: {got:?} {want}");
                }
            }
        }
        assert!(capped > 500, "{capped} rows under the cap");
    }

    #[test]
    fn production_follows_the_reference() {
        let n = 5000;
        let w = weights(2 * n);
        for (mode, beta_hi) in MODES.into_iter().flat_map(|m| [(m, 0.98), (m, 1.0)]) {
            let mut cloud = random_cloud(frequency(mode, beta_hi, false), n);
            let raw: Vec<Vec<f32>> = cloud.kernel.as_ref().unwrap().params().iter().map(|p| p.value.clone()).collect();
            let got = gradients(&mut cloud, &w);
            for i in 0..n {
                let row = [f64::from(raw[0][i]), f64::from(raw[1][i])];
                let want = reference_gradient(mode, beta_hi.into(), row, [w[2 * i].into(), w[2 * i + 1].into()]);
                for k in 0..2 {
                    let error = (f64::from(got[k][i]) - want[k]).abs();
                    assert!(error < 3e-6 * (1.0 + want[k].abs()), "{mode:?} row {i}: {} {}", got[k][i], want[k]);
                }
            }
        }
        let mut cloud = random_cloud(KernelInit::Acutance, n);
        let raw = cloud.kernel.as_ref().unwrap().params()[0].value.clone();
        let got = gradients(&mut cloud, &w[..n]);
        for i in 0..n {
            let want = f64::from(w[i]) * f64::from(KAPPA_HI) / f64::from(raw[i]).cosh().powi(2);
            assert!((f64::from(got[0][i]) - want).abs() < 3e-6 * (1.0 + want.abs()), "row {i}: {} {want}", got[0][i]);
        }
    }

    #[test]
    fn a_shared_lambda_sums_the_gradients_of_all_rows() {
        let n = 5000;
        let (w, raw) = (weights(2 * n), 0.7);
        let set = |cloud: &mut Cloud| cloud.kernel.as_mut().unwrap().params_mut()[0].value.fill(raw);
        let mut each = random_cloud(frequency(BetaMode::Capped, 0.98, false), n);
        let mut one = random_cloud(frequency(BetaMode::Capped, 0.98, true), n);
        let betas = each.kernel.as_ref().unwrap().params()[1].value.clone();
        one.kernel.as_mut().unwrap().params_mut()[1].value.clone_from(&betas);
        [&mut each, &mut one].into_iter().for_each(set);
        let (rows, shared) = (gradients(&mut each, &w), gradients(&mut one, &w));
        let sum: f64 = rows[0].iter().map(|g| f64::from(*g)).sum();
        assert_eq!((shared[0].len(), &shared[1]), (1, &rows[1]));
        assert!((f64::from(shared[0][0]) - sum).abs() < 1e-4, "{} {sum}", shared[0][0]);
        let again = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut fresh = one.clone();
            fresh.clear_grads();
            pool.install(|| gradients(&mut fresh, &w))
        };
        assert!(again(1) == shared && again(3) == shared);
        one.edit(&RowEdit { keep: vec![0, 1], append_from: vec![1] }).unwrap();
        assert_eq!(one.kernel.as_ref().unwrap().params().iter().map(|p| p.len()).collect::<Vec<_>>(), [1, 3]);
    }

    #[test]
    fn row_edits_apply_to_kernel_columns() {
        let mut cloud = random_cloud(frequency(BetaMode::Capped, 0.98, false), 3);
        let before: Vec<Param> = cloud.kernel.as_ref().unwrap().params().into_iter().cloned().collect();
        cloud.visit_mut(&mut |p| p.moment1.fill(1.0));
        cloud.edit(&RowEdit { keep: vec![2], append_from: vec![0] }).unwrap();
        for (p, old) in cloud.kernel.as_ref().unwrap().params().into_iter().zip(&before) {
            assert_eq!(p.value, [old.value[2], old.value[0]]);
            assert_eq!((p.moment1.as_slice(), p.grad.len()), (&[1.0, 0.0][..], 2));
        }
        let mut names = Vec::new();
        cloud.visit(&mut |p| names.push(p.name.clone()));
        assert_eq!(names[names.len() - 2..], ["cloud.lambda", "cloud.beta"]);
    }

    #[test]
    fn the_upper_end_of_beta_is_above_its_initial_value() {
        for beta_hi in [0.5, 1.1, f32::NAN] {
            let error = plain(1).with_kernel(frequency(BetaMode::Capped, beta_hi, false)).unwrap_err();
            assert!(matches!(error, CloudError::BetaHi(_)), "{error}");
        }
    }
}
