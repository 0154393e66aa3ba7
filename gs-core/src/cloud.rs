//! Trainable Gaussians: unconstrained raw parameters, their activation to [`Splats`], and its backward.
//!
//! ```text
//! scales    = exp(log_scales)                        dL/d log_scales = dL/d scales ⊙ scales
//! opacities = σ(logit_opacities)                     dL/d logit      = dL/d opacity · o (1 − o)
//! sh[k]     = k = 0 ? sh_dc : sh_rest[k − 1]         means and quats pass through as they are
//! ```
//! (3D Gaussian Splatting, Kerbl et al. 2023, section 5.) A cloud may have raw columns of another kernel ([`RawKernel`]);
//! without them its splats are Gaussians. The active SH degree may be below the stored one: coefficients above it are
//! neither rendered nor trained. All loops run over blocks of 2048 rows, so results do not depend on threads.
//!
//! ```
//! use glam::Vec3;
//! use gs_core::{Cloud, Splats, SplatsGrad};
//!
//! let mut cloud = Cloud::from_points(&[Vec3::ONE], &[[0.5; 3]], &[1.0], 0.5, 0)?;
//! let mut splats = Splats::default();
//! cloud.activate(0, &mut splats);
//! assert_eq!((splats.scales[0], splats.opacities[0]), (Vec3::ONE, 0.5));
//! // dL/d opacity = 1 becomes dL/d logit = o (1 − o).
//! let mut d = SplatsGrad::zeros_like(&splats);
//! d.opacities[0] = 1.0;
//! cloud.activate_backward(&splats, &d);
//! assert_eq!(cloud.logit_opacities.grad, [0.25]);
//! # Ok::<(), gs_core::cloud::CloudError>(())
//! ```

mod kernel;

use crate::kernel::Kernel;
use crate::param::{Param, Params, RowEdit, RowEditError};
use crate::sh;
use crate::splats::{Color, Splats, SplatsGrad};
use glam::Vec3;
use rayon::prelude::*;

pub use kernel::{KernelInit, RawKernel};

/// Rows of one parallel block.
const BLOCK: usize = 2048;

/// Raw trainable Gaussians: one row of every block per Gaussian, `n` rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    /// `cloud.means` `[n, 3]`: centres, world units.
    pub means: Param,
    /// `cloud.quats` `[n, 4]`: rotations `(w, x, y, z)`, any length.
    pub quats: Param,
    /// `cloud.log_scales` `[n, 3]`: natural logarithms of the standard deviations.
    pub log_scales: Param,
    /// `cloud.logit_opacities` `[n, 1]`: `ln(o / (1 − o))` of the opacities.
    pub logit_opacities: Param,
    /// `cloud.sh_dc` `[n, 3]`: degree-0 coefficients.
    pub sh_dc: Param,
    /// `cloud.sh_rest` `[n, (K − 1) · 3]` with `K = (degree + 1)²`, coefficient-major; absent at degree 0.
    pub sh_rest: Option<Param>,
    /// Raw columns of another kernel than the Gaussian; absent for Gaussians.
    pub kernel: Option<RawKernel>,
    sh_degree: u8,
}

/// Arguments that no cloud can be made from.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CloudError {
    /// The list of points is empty.
    #[error("a cloud needs at least one point; give a point cloud or choose another initialisation")]
    Empty,
    /// The columns differ in length.
    #[error("{positions} positions, {colors} colours and {sigmas} sigmas were given; one of each per point is needed")]
    Length {
        /// Number of positions that were given.
        positions: usize,
        /// Number of colours that were given.
        colors: usize,
        /// Number of standard deviations that were given.
        sigmas: usize,
    },
    /// A value is not finite or out of its domain.
    #[error("initial point {row}: {what} is out of range")]
    Value {
        /// Index of the point, from 0.
        row: usize,
        /// The column of the value.
        what: &'static str,
    },
    /// An SH degree above 3.
    #[error("SH degree {0} is not supported (0 to 3)")]
    Degree(u8),
    /// The upper end of β is not in `(0.5, 1]`.
    #[error("the upper end of beta is {0}; it must be above 0.5 and at most 1")]
    BetaHi(f32),
}

impl Cloud {
    /// Round Gaussians of standard deviation `sigmas[i]` (world units, > 0) at `positions[i]` with display-encoded
    /// colours `colors[i]` in `[0, 1]`, one `opacity` in `(0, 1)` for all, identity rotations, higher SH zero.
    ///
    /// # Errors
    /// If there is no point, the columns differ in length, or a value is not finite or out of its domain.
    pub fn from_points(
        positions: &[Vec3],
        colors: &[[f32; 3]],
        sigmas: &[f32],
        opacity: f32,
        sh_degree: u8,
    ) -> Result<Self, CloudError> {
        let n = positions.len();
        if n == 0 {
            return Err(CloudError::Empty);
        }
        if colors.len() != n || sigmas.len() != n {
            return Err(CloudError::Length { positions: n, colors: colors.len(), sigmas: sigmas.len() });
        }
        if sh_degree > sh::MAX_DEGREE {
            return Err(CloudError::Degree(sh_degree));
        }
        for row in 0..n {
            let bad = |what| Err(CloudError::Value { row, what });
            if !positions[row].is_finite() {
                return bad("position");
            }
            if !colors[row].iter().all(|c| c.is_finite()) {
                return bad("colour");
            }
            if !(sigmas[row] > 0.0 && sigmas[row].is_finite()) {
                return bad("standard deviation");
            }
            if !(opacity > 0.0 && opacity < 1.0) {
                return bad("opacity");
            }
        }
        let dc = |c: f32| ((f64::from(c) - 0.5) / sh::C0) as f32;
        let rest = 3 * (sh::coeffs(sh_degree) - 1);
        Ok(Self {
            means: Param::rows("cloud.means", 3, positions.iter().flat_map(|p| p.to_array()).collect()),
            quats: Param::rows("cloud.quats", 4, [1.0, 0.0, 0.0, 0.0].repeat(n)),
            log_scales: Param::rows("cloud.log_scales", 3, sigmas.iter().flat_map(|s| [s.ln(); 3]).collect()),
            logit_opacities: Param::rows("cloud.logit_opacities", 1, vec![logit(opacity); n]),
            sh_dc: Param::rows("cloud.sh_dc", 3, colors.iter().flat_map(|c| c.map(dc)).collect()),
            sh_rest: (rest > 0).then(|| Param::rows("cloud.sh_rest", rest, vec![0.0; n * rest])),
            kernel: None,
            sh_degree,
        })
    }

    /// The same cloud with the raw columns of a kernel, initialised so that it renders as Gaussians, to the bit.
    ///
    /// # Errors
    /// If a setting of the kernel is out of its domain.
    pub fn with_kernel(mut self, init: KernelInit) -> Result<Self, CloudError> {
        self.kernel = Some(RawKernel::new(init, self.len())?);
        Ok(self)
    }

    /// Number of Gaussians, the rows of every block.
    pub fn len(&self) -> usize {
        self.logit_opacities.len()
    }

    /// Whether the cloud has no rows.
    pub fn is_empty(&self) -> bool {
        self.logit_opacities.is_empty()
    }

    /// The stored SH degree, 0 to 3.
    pub fn sh_degree(&self) -> u8 {
        self.sh_degree
    }

    /// The splats of these parameters, with SH up to `active_degree` (at most the stored degree). Reuses `out`'s memory.
    pub fn activate(&self, active_degree: u8, out: &mut Splats) {
        let n = self.len();
        let degree = active_degree.min(self.sh_degree);
        let width = 3 * sh::coeffs(degree);
        let mut coeffs = match std::mem::take(&mut out.color) {
            Color::Sh { coeffs, .. } => coeffs,
            Color::Rgb(_) => Vec::new(),
        };
        out.means.resize(n, Vec3::ZERO);
        out.quats.resize(n, [0.0; 4]);
        out.scales.resize(n, Vec3::ZERO);
        out.opacities.resize(n, 0.0);
        coeffs.resize(n * width, 0.0);
        (
            out.means.par_chunks_mut(BLOCK).zip(self.means.value.par_chunks(3 * BLOCK)),
            out.quats.par_chunks_mut(BLOCK).zip(self.quats.value.par_chunks(4 * BLOCK)),
            out.scales.par_chunks_mut(BLOCK).zip(self.log_scales.value.par_chunks(3 * BLOCK)),
            out.opacities.par_chunks_mut(BLOCK).zip(self.logit_opacities.value.par_chunks(BLOCK)),
            coeffs.par_chunks_mut(width * BLOCK).enumerate(),
        )
            .into_par_iter()
            .for_each(|(means, quats, scales, opacities, (block, sh))| {
                means.0.iter_mut().zip(means.1.as_chunks().0).for_each(|(o, v)| *o = Vec3::from_array(*v));
                quats.0.copy_from_slice(quats.1.as_chunks().0);
                let logs = scales.1.as_chunks().0;
                scales.0.iter_mut().zip(logs).for_each(|(o, v)| *o = Vec3::from_array(v.map(f32::exp)));
                opacities.0.iter_mut().zip(opacities.1).for_each(|(o, v)| *o = sigmoid(*v));
                self.gather_sh(block * BLOCK, width, sh);
            });
        out.color = Color::Sh { degree, coeffs };
        match &self.kernel {
            Some(kernel) => kernel.activate(&mut out.kernel),
            None => out.kernel = Kernel::Gaussian,
        }
    }

    /// SH rows from row `first` on, `width` values each, interleaved from the two blocks.
    fn gather_sh(&self, first: usize, width: usize, out: &mut [f32]) {
        let rest_width = 3 * (sh::coeffs(self.sh_degree) - 1);
        for (i, row) in out.chunks_exact_mut(width).enumerate() {
            let at = first + i;
            row[..3].copy_from_slice(&self.sh_dc.value[3 * at..][..3]);
            if let Some(rest) = self.sh_rest.as_ref().filter(|_| width > 3) {
                row[3..].copy_from_slice(&rest.value[rest_width * at..][..width - 3]);
            }
        }
    }

    /// Backward of [`Cloud::activate`]: adds to every `grad`. `splats` is the activation of the current parameters, `d` its
    /// cotangents.
    pub fn activate_backward(&mut self, splats: &Splats, d: &SplatsGrad) {
        let width = splats.color.width();
        let rest_width = 3 * (sh::coeffs(self.sh_degree) - 1);
        (
            self.means.grad.par_chunks_mut(3 * BLOCK).zip(d.means.par_chunks(BLOCK)),
            self.quats.grad.par_chunks_mut(4 * BLOCK).zip(d.quats.par_chunks(BLOCK)),
            self.log_scales.grad.par_chunks_mut(3 * BLOCK).zip(d.scales.par_chunks(BLOCK)),
            self.logit_opacities.grad.par_chunks_mut(BLOCK).zip(d.opacities.par_chunks(BLOCK)),
            self.sh_dc.grad.par_chunks_mut(3 * BLOCK).enumerate(),
        )
            .into_par_iter()
            .for_each(|(means, quats, scales, opacities, (block, dc))| {
                let first = block * BLOCK;
                add_vec3(means.0, means.1.iter().copied());
                quats.0.iter_mut().zip(quats.1.as_flattened()).for_each(|(g, v)| *g += v);
                add_vec3(scales.0, scales.1.iter().zip(&splats.scales[first..]).map(|(v, s)| *v * *s));
                for ((g, v), o) in opacities.0.iter_mut().zip(opacities.1).zip(&splats.opacities[first..]) {
                    *g += v * o * (1.0 - o);
                }
                let rows = d.color[first * width..].chunks_exact(width);
                dc.chunks_exact_mut(3).zip(rows).for_each(|(g, v)| g.iter_mut().zip(v).for_each(|(g, v)| *g += v));
            });
        if let Some(rest) = self.sh_rest.as_mut().filter(|_| width > 3) {
            rest.grad.par_chunks_mut(rest_width * BLOCK).zip(d.color.par_chunks(width * BLOCK)).for_each(|(g, v)| {
                for (g, v) in g.chunks_exact_mut(rest_width).zip(v.chunks_exact(width)) {
                    g.iter_mut().zip(&v[3..]).for_each(|(g, v)| *g += v);
                }
            });
        }
        if let Some(kernel) = &mut self.kernel {
            kernel.activate_backward(&splats.kernel, &d.kernel);
        }
    }

    /// All blocks with one row per Gaussian, in the order of [`Params::visit`].
    pub fn blocks_mut(&mut self) -> Vec<&mut Param> {
        self.params_mut().into_iter().filter(|p| p.row_width.is_some()).collect()
    }

    fn params_mut(&mut self) -> Vec<&mut Param> {
        let fixed =
            [&mut self.means, &mut self.quats, &mut self.log_scales, &mut self.logit_opacities, &mut self.sh_dc];
        let kernel = self.kernel.iter_mut().flat_map(RawKernel::params_mut);
        fixed.into_iter().chain(&mut self.sh_rest).chain(kernel).collect()
    }

    /// Applies a row edit (clone, split, prune) to every block, or to none.
    ///
    /// # Errors
    /// If the edit names a row that does not exist.
    pub fn edit(&mut self, edit: &RowEdit) -> Result<(), RowEditError> {
        edit.apply(&mut self.blocks_mut())
    }
}

impl Params for Cloud {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        [&self.means, &self.quats, &self.log_scales, &self.logit_opacities, &self.sh_dc].into_iter().for_each(&mut *f);
        self.sh_rest.iter().for_each(&mut *f);
        self.kernel.iter().flat_map(RawKernel::params).for_each(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.params_mut().into_iter().for_each(f);
    }
}

/// The logistic function, `σ(x) = 1 / (1 + e⁻ˣ)`.
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// The inverse of [`sigmoid`], `ln(p / (1 − p))`; infinite at 0 and 1.
pub fn logit(p: f32) -> f32 {
    (p / (1.0 - p)).ln()
}

/// Adds vectors into a flat column.
fn add_vec3(flat: &mut [f32], values: impl Iterator<Item = Vec3>) {
    for (g, v) in flat.as_chunks_mut::<3>().0.iter_mut().zip(values) {
        *g = (Vec3::from_array(*g) + v).to_array();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    fn random_cloud(n: usize, degree: u8) -> Cloud {
        let mut rng = Rng::new(3, "cloud", 0, 0);
        let positions: Vec<Vec3> = (0..n).map(|_| Vec3::new(rng.normal(), rng.normal(), rng.normal())).collect();
        let colors: Vec<[f32; 3]> = (0..n).map(|_| std::array::from_fn(|_| rng.uniform())).collect();
        let mut cloud = Cloud::from_points(&positions, &colors, &vec![0.2; n], 0.3, degree).unwrap();
        cloud.visit_mut(&mut |p| p.value.iter_mut().for_each(|v| *v += 0.3 * rng.normal()));
        cloud
    }

    /// A linear functional of the activated columns, in f64.
    fn functional(s: &Splats, weights: &SplatsGrad) -> f64 {
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        let vec3 =
            |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| dot(&a.to_array(), &b.to_array())).sum::<f64>();
        vec3(&s.means, &weights.means)
            + dot(s.quats.as_flattened(), weights.quats.as_flattened())
            + vec3(&s.scales, &weights.scales)
            + dot(&s.opacities, &weights.opacities)
            + dot(s.color.as_flat(), &weights.color)
    }

    #[test]
    fn gradient_matches_finite_differences_at_every_degree() {
        let mut rng = Rng::new(4, "cloud", 0, 0);
        for (stored, active) in [(0u8, 0u8), (1, 0), (2, 1), (3, 3), (3, 2)] {
            let mut cloud = random_cloud(5, stored);
            let mut splats = Splats::default();
            cloud.activate(active, &mut splats);
            let mut weights = SplatsGrad::zeros_like(&splats);
            weights.means.iter_mut().chain(&mut weights.scales).for_each(|v| *v = Vec3::splat(rng.normal()));
            weights.quats.as_flattened_mut().iter_mut().for_each(|v| *v = rng.normal());
            weights.opacities.iter_mut().chain(&mut weights.color).for_each(|v| *v = rng.normal());
            cloud.activate_backward(&splats, &weights);
            let mut names = Vec::new();
            cloud.visit(&mut |p| names.push((p.name.clone(), p.grad.clone())));
            for (block, (name, grad)) in names.iter().enumerate() {
                for (i, got) in grad.iter().enumerate() {
                    let mut shifted = |h: f32| {
                        let p = &mut cloud.blocks_mut()[block].value[i];
                        let old = *p;
                        *p += h;
                        let h = f64::from(*p) - f64::from(old);
                        let mut s = Splats::default();
                        cloud.activate(active, &mut s);
                        cloud.blocks_mut()[block].value[i] = old;
                        (functional(&s, &weights), h)
                    };
                    let ((hi, up), (lo, down)) = (shifted(1e-2), shifted(-1e-2));
                    let want = (hi - lo) / (up - down);
                    let error = (f64::from(*got) - want).abs();
                    assert!(error < 2e-4 * (1.0 + want.abs()), "{stored}/{active} {name}[{i}]: {got} {want}");
                }
            }
        }
    }

    #[test]
    fn activation_gives_the_initial_values() {
        let cloud = Cloud::from_points(&[Vec3::ONE], &[[0.2, 0.5, 0.9]], &[0.25], 0.1, 1).unwrap();
        let mut s = Splats::default();
        cloud.activate(3, &mut s);
        assert_eq!(s.check(), Ok(()));
        assert_eq!((s.means[0], s.quats[0]), (Vec3::ONE, [1.0, 0.0, 0.0, 0.0]));
        assert!((s.scales[0] - Vec3::splat(0.25)).length() < 1e-6 && (s.opacities[0] - 0.1).abs() < 1e-7);
        let Color::Sh { degree: 1, coeffs } = &s.color else { panic!("degree 1") };
        let rgb: Vec<f32> = coeffs[..3].iter().map(|c| 0.5 + c * sh::C0 as f32).collect();
        assert!(rgb.iter().zip([0.2, 0.5, 0.9]).all(|(a, b)| (a - b).abs() < 1e-6));
        assert!(coeffs[3..].iter().all(|&c| c == 0.0));
    }

    #[test]
    fn degree_zero_stores_no_higher_rows_and_edits_keep_blocks_together() {
        let mut cloud = random_cloud(3, 0);
        assert!(cloud.sh_rest.is_none());
        cloud.edit(&RowEdit { keep: vec![2], append_from: vec![0, 2] }).unwrap();
        assert_eq!((cloud.len(), cloud.means.row_count(), cloud.sh_dc.row_count()), (3, Some(3), Some(3)));
        assert_eq!(cloud.means.value[..3], cloud.means.value[6..]);
        assert!(cloud.edit(&RowEdit { keep: vec![3], append_from: vec![] }).is_err());
    }

    #[test]
    fn bad_input_is_named() {
        let make = |p: f32, s: f32, o: f32, d: u8| Cloud::from_points(&[Vec3::splat(p)], &[[0.5; 3]], &[s], o, d);
        assert_eq!(make(f32::NAN, 1.0, 0.1, 0), Err(CloudError::Value { row: 0, what: "position" }));
        assert_eq!(make(0.0, 0.0, 0.1, 0), Err(CloudError::Value { row: 0, what: "standard deviation" }));
        assert_eq!(make(0.0, 1.0, 1.0, 0), Err(CloudError::Value { row: 0, what: "opacity" }));
        assert_eq!(make(0.0, 1.0, 0.5, 4), Err(CloudError::Degree(4)));
        assert_eq!(Cloud::from_points(&[], &[], &[], 0.1, 0), Err(CloudError::Empty));
        assert!(matches!(Cloud::from_points(&[Vec3::ZERO], &[], &[], 0.1, 0), Err(CloudError::Length { .. })));
    }
}
