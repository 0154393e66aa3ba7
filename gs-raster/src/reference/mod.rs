//! The rasteriser in plain loops: no tiles, no SIMD, generic over the scalar. In `f64` it is the reference for the fast
//! path. Its own gradients are checked by finite differences and by the golden arrays of `tests/golden`.
//!
//! ```
//! use gs_raster::reference::{Cutoff, Scene, render};
//! use gs_raster::{RasterOptions, Workspace, measure};
//!
//! let (splats, camera, options) = (measure::scene(100, 2), measure::camera(24), RasterOptions::default());
//! let exact = render(&Scene::<f64>::new(&splats), &camera, &options, Cutoff::Hard);
//! let fast = gs_raster::render(&splats, &camera, &options, &mut Workspace::new());
//! for (i, want) in exact.alpha.iter().enumerate().filter(|&(i, _)| exact.margin[i] > 1e-5) {
//!     assert!((f64::from(fast.alpha[i]) - want).abs() < 2e-5);
//! }
//! ```
//!
//! Per splat (Zwicker et al. 2001, EWA splatting; Kerbl et al. 2023, 3DGS):
//! ```text
//! t  = R_v m + t_v                              culled unless near < t_z < far
//! u  = (fx t_x/t_z + cx, fy t_y/t_z + cy)
//! J  = | fx/t_z  0       −fx t̃_x/t_z² |         t̃ = t_z · clamp(t/t_z, frustum ± 0.3 of half the image)
//!      | 0       fy/t_z  −fy t̃_y/t_z² |
//! F  = J R_v R diag(s)      Σ2 = F Fᵀ      Σ' = Σ2 + dilation·I      K = Σ'⁻¹
//! o' = o · (antialias ? sqrt(max(|Σ2|/|Σ'|, 0.005²)) : 1)
//! ```
//! Per pixel, front to back by depth (ties by index):
//! ```text
//! d = u − p    q = dᵀ K d    α = min(max_alpha, o' ψ(exp(−q/2)))   skipped if α < min_alpha
//!                            (ψ: [`gs_core::kernel`]; one that never decays is cut at q > kernel_cut)
//! stop before the sample with T (1 − α) ≤ stop;   C += T α c;   D += T α t_z;   T ← T (1 − α)
//! ```
//! Colours are seen from the camera centre `−R_v⁻¹ t_v`, the fast path's from `−R_vᵀ t_v`: the inverse holds while the entries of `R_v`
//! are varied one by one, and on rotations the two are the same.

mod blend;
mod project;

use project::{Projected, project};

use crate::camera_grad::CameraGrad;
use crate::options::RasterOptions;
use gs_core::kernel::{Profile, acutance_vjp, frequency_vjp};
use gs_core::{Camera, Color, Kernel, Real, Splats};

/// Scalar type of the reference: `f32` or `f64`.
pub trait Scalar: Real + PartialOrd + Send + Sync + 'static {
    /// The scalar nearest to `value`.
    fn from_f64(value: f64) -> Self;
    /// The same value in `f64`.
    fn to_f64(self) -> f64;
    /// Natural exponential of `self`.
    fn exp(self) -> Self;
}

impl Scalar for f64 {
    fn from_f64(value: f64) -> Self {
        value
    }
    fn to_f64(self) -> f64 {
        self
    }
    fn exp(self) -> Self {
        f64::exp(self)
    }
}

impl Scalar for f32 {
    fn from_f64(value: f64) -> Self {
        value as f32
    }
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    fn exp(self) -> Self {
        f32::exp(self)
    }
}

/// Splats in the scalar of the reference, or their cotangents. Columns as in [`Splats`].
#[derive(Clone, Debug, PartialEq)]
pub struct Scene<T> {
    /// World-space means, world units.
    pub means: Vec<[T; 3]>,
    /// Quaternions `(w, x, y, z)` of any length.
    pub quats: Vec<[T; 4]>,
    /// Standard deviations, world units.
    pub scales: Vec<[T; 3]>,
    /// Opacities in `[0, 1]`.
    pub opacities: Vec<T>,
    /// `[n, K, 3]` (SH) or `[n, 3]` (RGB), flat.
    pub color: Vec<T>,
    /// SH degree, or `None` for RGB.
    pub degree: Option<u8>,
    /// The kernel's parameters, flat `[n, width]` as in [`gs_core::SplatsGrad::kernel`].
    pub kernel: Vec<T>,
    /// The kernel that `kernel` parametrises.
    pub kernel_kind: KernelKind,
}

/// The variant of [`Kernel`], which decides the width of [`Scene::kernel`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KernelKind {
    /// The Gaussian, which has no parameters.
    Gaussian,
    /// The frequency kernel; two parameters, λ and β.
    Frequency,
    /// The acutance kernel; one parameter, the acutance.
    Acutance,
}

impl<T: Scalar> Scene<T> {
    /// Converts splats to the scalar of the reference.
    pub fn new(splats: &Splats) -> Self {
        let of = |v: f32| T::from_f64(f64::from(v));
        Self {
            means: splats.means.iter().map(|m| m.to_array().map(of)).collect(),
            quats: splats.quats.iter().map(|q| q.map(of)).collect(),
            scales: splats.scales.iter().map(|s| s.to_array().map(of)).collect(),
            opacities: splats.opacities.iter().map(|&o| of(o)).collect(),
            color: splats.color.as_flat().iter().map(|&c| of(c)).collect(),
            degree: match splats.color {
                Color::Rgb(_) => None,
                Color::Sh { degree, .. } => Some(degree),
            },
            kernel: match &splats.kernel {
                Kernel::Frequency { lambdas, betas } => {
                    lambdas.iter().zip(betas).flat_map(|(&l, &b)| [of(l), of(b)]).collect()
                }
                Kernel::Acutance { acutances } => acutances.iter().map(|&a| of(a)).collect(),
                _ => Vec::new(),
            },
            kernel_kind: match splats.kernel {
                Kernel::Frequency { .. } => KernelKind::Frequency,
                Kernel::Acutance { .. } => KernelKind::Acutance,
                _ => KernelKind::Gaussian,
            },
        }
    }

    /// Kernel constants of one splat; `None` for the Gaussian.
    fn kernel_consts(&self, i: usize) -> Option<Profile<T>> {
        match self.kernel_kind {
            KernelKind::Gaussian => None,
            KernelKind::Frequency => Some(Profile::frequency(self.kernel[2 * i], self.kernel[2 * i + 1])),
            KernelKind::Acutance => Some(Profile::acutance(self.kernel[i])),
        }
    }

    /// Writes one splat's kernel cotangents from its sums over pixels.
    fn kernel_backward(&self, i: usize, sums: [T; 2], grad: &mut [T]) {
        match self.kernel_kind {
            KernelKind::Gaussian => {}
            KernelKind::Frequency => {
                let d = frequency_vjp(self.kernel[2 * i], self.kernel[2 * i + 1], sums);
                grad[2 * i..2 * i + 2].copy_from_slice(&d);
            }
            KernelKind::Acutance => grad[i] = acutance_vjp(self.kernel[i], sums),
        }
    }

    /// Cotangents of the same shape, all zero.
    pub fn zeros_like(&self) -> Self {
        let zero = T::from_f64(0.0);
        let n = self.means.len();
        Self {
            means: vec![[zero; 3]; n],
            quats: vec![[zero; 4]; n],
            scales: vec![[zero; 3]; n],
            opacities: vec![zero; n],
            color: vec![zero; self.color.len()],
            degree: self.degree,
            kernel: vec![zero; self.kernel.len()],
            kernel_kind: self.kernel_kind,
        }
    }

    /// Number of colour values per splat.
    fn color_width(&self) -> usize {
        self.degree.map_or(3, |d| 3 * gs_core::sh::coeffs(d))
    }
}

/// Treatment of samples near [`RasterOptions::min_alpha`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Cutoff {
    /// Skipped below `min_alpha`, as published. Not differentiable there.
    #[default]
    Hard,
    /// Faded in by a C¹ ramp between `min_alpha` and twice that; only for checking gradients by finite differences.
    Smooth,
}

/// Frame of the reference, row-major, origin top left, as [`crate::Frame`].
#[derive(Clone, Debug, PartialEq)]
pub struct Frame<T> {
    /// `[height · width]` colours over the background.
    pub rgb: Vec<[T; 3]>,
    /// `[height · width]`: accumulated alpha `1 − T`.
    pub alpha: Vec<T>,
    /// `[height · width]`: alpha-weighted camera depth `Σ w z`, world units.
    pub depth: Vec<T>,
    /// `[height · width]`: smallest relative distance of any decision (α against `min_alpha`, T against `stop`, `g`
    /// against the kernel's knots and cut) from its threshold. Pixels with a small margin may differ between precisions
    /// by one whole sample.
    pub margin: Vec<f64>,
    /// Number of samples blended over all pixels.
    pub blended_samples: u64,
}

/// Renders a scene. Cost: splats × pixels.
pub fn render<T: Scalar>(scene: &Scene<T>, camera: &Camera, options: &RasterOptions, cutoff: Cutoff) -> Frame<T> {
    let splats = sorted(scene, camera, options);
    let (width, height) = (camera.width as usize, camera.height as usize);
    let zero = T::from_f64(0.0);
    let n = width * height;
    let mut frame = Frame {
        rgb: vec![[zero; 3]; n],
        alpha: vec![zero; n],
        depth: vec![zero; n],
        margin: vec![f64::INFINITY; n],
        blended_samples: 0,
    };
    let background = options.background.map(|v| T::from_f64(f64::from(v)));
    for i in 0..n {
        let pixel = [T::from_f64((i % width) as f64 + 0.5), T::from_f64((i / width) as f64 + 0.5)];
        let (samples, end, margin) = blend::samples(&splats, pixel, options, cutoff);
        for s in &samples {
            let w = s.transmittance * s.alpha;
            let p = &splats[s.splat].1;
            for c in 0..3 {
                frame.rgb[i][c] = frame.rgb[i][c] + w * p.rgb[c];
            }
            frame.depth[i] = frame.depth[i] + w * p.depth;
        }
        for (value, &b) in frame.rgb[i].iter_mut().zip(&background) {
            *value = *value + end * b;
        }
        frame.alpha[i] = T::from_f64(1.0) - end;
        frame.margin[i] = margin;
        frame.blended_samples += samples.len() as u64;
    }
    frame
}

/// Cotangents of one pixel: `d_rgb`, `d_alpha`, `d_depth`.
pub type PixelGrad<T> = ([T; 3], T, T);

/// Gradient of `Σ (d_rgb·rgb + d_alpha·alpha + d_depth·depth)` with respect to every column of the scene, with respect to
/// the projected means, per pixel, and with respect to the camera. `d_frame` has one element per pixel.
pub fn render_backward<T: Scalar>(
    scene: &Scene<T>,
    camera: &Camera,
    options: &RasterOptions,
    cutoff: Cutoff,
    d_frame: &[PixelGrad<T>],
) -> (Scene<T>, Vec<[T; 2]>, CameraGrad) {
    let splats = sorted(scene, camera, options);
    let width = camera.width as usize;
    let mut sums = vec![blend::SplatSums::zero(); splats.len()];
    for (i, d) in d_frame.iter().enumerate() {
        let pixel = [T::from_f64((i % width) as f64 + 0.5), T::from_f64((i / width) as f64 + 0.5)];
        blend::pixel_backward(&splats, pixel, options, cutoff, d, &mut sums);
    }
    let mut grad = scene.zeros_like();
    let mut grad_means2d = vec![[T::from_f64(0.0); 2]; scene.means.len()];
    let mut camera_grad = CameraGrad::default();
    for ((index, _), s) in splats.iter().zip(&sums) {
        grad_means2d[*index] = s.mean2d;
        project::backward(scene, *index, camera, options, s, &mut grad, &mut camera_grad);
        scene.kernel_backward(*index, s.kernel, &mut grad.kernel);
    }
    (grad, grad_means2d, camera_grad)
}

/// Visible splats `(index, projected)`, front to back, ties in index order.
fn sorted<T: Scalar>(scene: &Scene<T>, camera: &Camera, options: &RasterOptions) -> Vec<(usize, Projected<T>)> {
    let mut list: Vec<_> =
        (0..scene.means.len()).filter_map(|i| Some((i, project(scene, i, camera, options)?))).collect();
    list.sort_by(|a, b| a.1.depth.to_f64().total_cmp(&b.1.depth.to_f64()));
    list
}
