//! What a caller may choose about drawing; every constant named and sourced.

/// How a splat behaves where its opacity times kernel exceeds [`RasterOptions::max_alpha`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum ClampGrad {
    /// The true derivative: zero above the cap.
    #[default]
    Exact,
    /// As INRIA's kernels: the cap is ignored on the way back, so saturated splats keep learning.
    PassThrough,
}

/// The instruction set of the blend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum SimdLevel {
    /// The best this machine has.
    #[default]
    Auto,
    /// AVX2 + FMA at most (x86-64-v3), whatever the machine has.
    Avx2,
    /// Baseline instructions only.
    Portable,
}

/// Options of a frame. `Default` is what the golden images use, over a black background.
#[derive(Clone, Debug, PartialEq)]
pub struct RasterOptions {
    /// Colour behind everything.
    pub background: [f32; 3],
    /// Splats whose centre has camera depth ≤ `near` are not drawn, world units.
    pub near: f64,
    /// Splats whose centre has camera depth ≥ `far` are not drawn, world units.
    pub far: f64,
    /// Cap of a sample's alpha (3DGS: 0.99).
    pub max_alpha: f64,
    /// Samples below this alpha are skipped (3DGS: 1/255).
    pub min_alpha: f64,
    /// A pixel stops before the sample that would bring its transmittance to this or below (3DGS: 1e-4).
    pub stop: f64,
    /// Added to both diagonal entries of the projected covariance, pixels² (3DGS: 0.3).
    pub dilation: f64,
    /// Scales opacity by the square root of (covariance determinant before / after dilation), Mip-Splatting style.
    pub antialias: bool,
    /// A fall-off that never decays (frequency kernel with `β ≥ ½ + λ`) is cut off beyond this squared
    /// Mahalanobis distance, so that the picture does not depend on tiles. 9: the three standard deviations that the
    /// published rasteriser's box implies.
    pub kernel_cut: f64,
    /// Blocks of pixels farther than this many standard deviations are not looked at. Infinite: exact supports. 3 is
    /// the published rasteriser's box; it truncates soft kernels visibly, by an amount that depends on the blocks.
    pub box_sigmas: f64,
    /// Gradient above `max_alpha`.
    pub clamp_grad: ClampGrad,
    /// Instruction set.
    pub simd: SimdLevel,
}

/// Smallest anti-aliasing compensation (gsplat, INRIA): `comp = sqrt(max(det0/det, 0.005²))`.
pub const MIN_COMPENSATION: f64 = 0.005;
/// The projection Jacobian clamps `x/z` this fraction of half the image beyond its border (INRIA's 1.3 tan).
pub const FRUSTUM_MARGIN: f64 = 0.3;

impl Default for RasterOptions {
    fn default() -> Self {
        Self {
            background: [0.0; 3],
            near: 0.01,
            far: 1e10,
            max_alpha: 0.99,
            min_alpha: 1.0 / 255.0,
            stop: 1e-4,
            dilation: 0.3,
            antialias: false,
            kernel_cut: 9.0,
            box_sigmas: f64::INFINITY,
            clamp_grad: ClampGrad::Exact,
            simd: SimdLevel::Auto,
        }
    }
}
