//! Options of a frame, with the source of every constant.

/// Gradient of samples whose opacity times kernel exceeds [`RasterOptions::max_alpha`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum ClampGrad {
    /// The true derivative: zero above the cap.
    #[default]
    Exact,
    /// The backward pass ignores the cap, as INRIA's kernels do, so saturated splats still get gradients.
    PassThrough,
}

/// The instruction set of the blend. A choice the machine lacks falls back to the best it has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum SimdLevel {
    /// The best of this machine, detected at run time.
    #[default]
    Auto,
    /// AVX2 with FMA (x86-64-v3), even where AVX-512 exists.
    Avx2,
    /// Only what the compilation target guarantees.
    Portable,
}

/// Options of a frame. `Default` is 3D Gaussian Splatting's choice over a black background.
///
/// ```
/// use gs_raster::RasterOptions;
///
/// let white = RasterOptions { background: [1.0; 3], antialias: true, ..RasterOptions::default() };
/// assert_eq!((white.max_alpha, white.min_alpha, white.dilation), (0.99, 1.0 / 255.0, 0.3));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct RasterOptions {
    /// Colour behind all splats, in the units of the splats' colours. Default: black.
    pub background: [f32; 3],
    /// Splats whose centre has camera depth ≤ `near` are culled, world units. Default: 0.01 (gsplat).
    pub near: f64,
    /// Splats whose centre has camera depth ≥ `far` are culled, world units. Default: 1e10 (gsplat).
    pub far: f64,
    /// Cap of a sample's alpha, below 1. Default: 0.99 (3DGS).
    pub max_alpha: f64,
    /// Samples below this alpha are skipped. Default: 1/255 (3DGS).
    pub min_alpha: f64,
    /// A pixel stops before the sample that would bring its transmittance to this value or below. Default: 1e-4 (3DGS). Less than
    /// [`Self::MIN_STOP`] counts as that; [`mod@crate::reference`] takes it as it is.
    pub stop: f64,
    /// Added to both diagonal entries of the projected covariance, pixels². Default: 0.3 (3DGS).
    pub dilation: f64,
    /// Scales opacity by the square root of (covariance determinant before / after dilation), as Mip-Splatting does.
    /// Default: off.
    pub antialias: bool,
    /// A kernel that never decays (frequency kernel with `β ≥ ½ + λ`) is cut off beyond this squared Mahalanobis
    /// distance, so that the image does not depend on tiles. Default: 9, the three standard deviations that the
    /// published rasteriser's bounding box implies.
    pub kernel_cut: f64,
    /// Pixel blocks farther than this many standard deviations are skipped. Default: infinite, for exact supports. 3 is
    /// the published rasteriser's box; it truncates soft kernels visibly, by an amount that depends on the blocks.
    pub box_sigmas: f64,
    /// Gradient of samples above `max_alpha`. Default: [`ClampGrad::Exact`].
    pub clamp_grad: ClampGrad,
    /// Instruction set of the blend. Default: [`SimdLevel::Auto`].
    pub simd: SimdLevel,
}

/// Smallest anti-aliasing compensation (gsplat, INRIA): `comp = sqrt(max(det0/det, 0.005²))`.
pub(crate) const MIN_COMPENSATION: f64 = 0.005;
/// The projection Jacobian clamps `x/z` this fraction of half the image beyond its border (INRIA's 1.3 tan).
pub(crate) const FRUSTUM_MARGIN: f64 = 0.3;

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

/// An option of the rasteriser outside its domain.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("rasteriser option `{field}` = {value} is out of range: it must be {rule}")]
pub struct OptionError {
    /// Name of the field of [`RasterOptions`].
    pub field: &'static str,
    /// Value met.
    pub value: f64,
    /// The domain in words, after "it must be".
    pub rule: &'static str,
}

impl RasterOptions {
    /// Smallest threshold of transmittance: below it a transmittance in `f32` soon has too few digits for the backward pass to undo a
    /// product.
    pub const MIN_STOP: f64 = 1e-30;

    /// Verifies every field. Rendering with options that do not pass gives pictures without meaning, but no panic.
    ///
    /// ```
    /// use gs_raster::RasterOptions;
    ///
    /// assert!(RasterOptions::default().check().is_ok());
    /// let none = RasterOptions { min_alpha: 0.0, ..RasterOptions::default() };
    /// assert!(none.check().unwrap_err().to_string().contains("`min_alpha` = 0"));
    /// ```
    ///
    /// # Errors
    /// Names the first field that is out of its domain.
    pub fn check(&self) -> Result<(), OptionError> {
        let need = |good: bool, field, value: f64, rule| {
            if good { Ok(()) } else { Err(OptionError { field, value, rule }) }
        };
        for v in self.background {
            need(v.is_finite(), "background", v.into(), "finite")?;
        }
        let (near, far) = (self.near, self.far);
        need(near > 0.0 && near.is_finite(), "near", near, "above 0 and finite")?;
        need(far > near, "far", far, "above `near`")?;
        let (least, most) = (self.min_alpha, self.max_alpha);
        need(most > 0.0 && most < 1.0, "max_alpha", most, "above 0 and below 1")?;
        need((MIN_ALPHA..=most).contains(&least), "min_alpha", least, "from 1e-6 to `max_alpha`")?;
        need((0.0..1.0).contains(&self.stop), "stop", self.stop, "0 or more, below 1")?;
        // Else the first opaque splat would end a pixel before it counts.
        let opaque = 1.0 - most as f32;
        need(opaque > self.stop.max(Self::MIN_STOP) as f32, "max_alpha", most, "below 1 − `stop`")?;
        need(self.dilation >= 0.0 && self.dilation.is_finite(), "dilation", self.dilation, "0 or more, finite")?;
        need(self.kernel_cut > 0.0 && self.kernel_cut.is_finite(), "kernel_cut", self.kernel_cut, "above 0, finite")?;
        need(self.box_sigmas > 0.0, "box_sigmas", self.box_sigmas, "above 0")
    }
}

/// Smallest threshold of alpha: below it the extent of a splat is more than five standard deviations.
const MIN_ALPHA: f64 = 1e-6;

/// Thresholds of the blend, rounded to `f32`; see [`RasterOptions`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub min_alpha: f32,
    pub log2_min_alpha: f32,
    pub max_alpha: f32,
    pub stop: f32,
    /// Whether the backward pass ignores the cap.
    pub pass_through: bool,
}

impl Limits {
    pub(crate) fn new(options: &RasterOptions) -> Self {
        // A threshold of 0 has no logarithm.
        let min_alpha = options.min_alpha.max(MIN_ALPHA);
        Self {
            min_alpha: min_alpha as f32,
            log2_min_alpha: min_alpha.log2() as f32,
            max_alpha: options.max_alpha as f32,
            stop: options.stop.max(RasterOptions::MIN_STOP) as f32,
            pass_through: options.clamp_grad == ClampGrad::PassThrough,
        }
    }
}
