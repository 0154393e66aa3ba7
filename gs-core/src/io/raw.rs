//! Splats before activation, as files store them: log-scales, opacity logits, quaternions of any length, SH coefficients.
//!
//! Activation is that of 3D Gaussian Splatting (Kerbl et al. 2023, section 5): `scale = exp(log_scale)`,
//! `opacity = 1 / (1 + exp(−logit))`.

use super::error::Source;
use super::{IoError, Limits};
use crate::cloud::sigmoid;
use crate::kernel::Kernel;
use crate::sh;
use crate::splats::{Color, Splats, SplatsError};
use glam::Vec3;

/// Opacities are clamped to `[margin, 1 − margin]` before their logit is taken, so that it stays finite (±13.8).
const OPACITY_MARGIN: f32 = 1e-6;

/// Splats before activation, `n` rows in every column.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct RawSplats {
    /// Centres of the Gaussians, world units, `[n]`.
    pub means: Vec<Vec3>,
    /// Rotations `(w, x, y, z)` of any length, `[n]`.
    pub quats: Vec<[f32; 4]>,
    /// Natural logarithms of the standard deviations, `[n]`.
    pub log_scales: Vec<Vec3>,
    /// Logits of the opacities, `[n]`.
    pub logit_opacities: Vec<f32>,
    /// SH coefficients `[n, (degree + 1)², 3]`, flat.
    pub sh: Vec<f32>,
    /// SH degree, 0 to 3.
    pub degree: u8,
    /// Kernel with its activated parameters.
    pub kernel: Kernel,
    /// Whether the splats are to be drawn anti-aliased, as they were trained: with opacities scaled by the square root of the determinant of
    /// the projected covariance before dilation over that after it (Yu et al. 2024, Mip-Splatting). `.ply` (in a comment), `.spz` and `.sog`
    /// say it; `.splat` and `.glb` have no place for it. Files that do not say it are read as `false`.
    pub antialiased: bool,
}

/// Logit of an opacity, finite for every opacity in `[0, 1]` (see [`OPACITY_MARGIN`]).
pub(super) fn finite_logit(opacity: f32) -> f32 {
    let o = f64::from(opacity.clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN));
    (o / (1.0 - o)).ln() as f32
}

/// Logarithm of a standard deviation; its sign is ignored, zero counts as the smallest normal number.
pub(super) fn log_scale(scale: f32) -> f32 {
    scale.abs().max(f32::MIN_POSITIVE).ln()
}

impl RawSplats {
    /// Empty columns with capacity for `n` rows of an SH degree.
    pub(super) fn with_capacity(n: usize, degree: u8) -> Self {
        Self {
            means: Vec::with_capacity(n),
            quats: Vec::with_capacity(n),
            log_scales: Vec::with_capacity(n),
            logit_opacities: Vec::with_capacity(n),
            sh: Vec::with_capacity(n * 3 * sh::coeffs(degree)),
            degree,
            kernel: Kernel::Gaussian,
            antialiased: false,
        }
    }

    /// Bytes of a row of an SH degree in all columns.
    pub(super) fn row_bytes(degree: u8) -> usize {
        4 * (11 + 3 * sh::coeffs(degree.min(sh::MAX_DEGREE)))
    }

    /// Number of splats (rows of `means`).
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are no splats.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Number of values in one row of [`RawSplats::sh`]: `3 (degree + 1)²`.
    pub fn sh_width(&self) -> usize {
        3 * sh::coeffs(self.degree)
    }

    /// Verifies that all columns have `len()` rows and the degree is 0 to 3.
    ///
    /// # Errors
    /// The first column of another length, or the degree.
    pub fn check_shape(&self) -> Result<(), SplatsError> {
        if self.degree > sh::MAX_DEGREE {
            return Err(SplatsError::Degree(self.degree));
        }
        let rows = self.len();
        let columns = [
            ("quats", self.quats.len(), rows),
            ("log_scales", self.log_scales.len(), rows),
            ("logit_opacities", self.logit_opacities.len(), rows),
            ("sh", self.sh.len(), rows * self.sh_width()),
        ];
        let kernel = self.kernel.columns().into_iter().map(|(column, values, ..)| (column, values.len(), rows));
        for (column, got, want) in columns.into_iter().chain(kernel) {
            if got != want {
                return Err(SplatsError::Length { column, want, got, rows });
            }
        }
        Ok(())
    }

    /// Activates every column: `exp` of the scales, [`sigmoid`] of the opacities.
    ///
    /// # Errors
    /// As [`Splats::check`]: a row that is not finite after activation (for instance a log-scale above 88).
    pub fn to_splats(&self) -> Result<Splats, SplatsError> {
        self.check_shape()?;
        let splats = Splats {
            means: self.means.clone(),
            quats: self.quats.clone(),
            scales: self.log_scales.iter().map(|s| Vec3::new(s.x.exp(), s.y.exp(), s.z.exp())).collect(),
            opacities: self.logit_opacities.iter().map(|&o| sigmoid(o)).collect(),
            color: Color::Sh { degree: self.degree, coeffs: self.sh.clone() },
            kernel: self.kernel.clone(),
        };
        splats.check()?;
        Ok(splats)
    }

    /// The raw form of splats. Plain RGB becomes SH of degree 0. [`RawSplats::to_splats`] inverts it up to the rounding of
    /// `exp` and `ln` (relative 1e-6 for usual sizes), except that opacities are clamped to `[1e-6, 1 − 1e-6]` and zero
    /// scales become 1.2e-38. [`Self::antialiased`] is off: [`Splats`] do not say how they are drawn.
    ///
    /// # Errors
    /// As [`Splats::check`].
    pub fn from_splats(splats: &Splats) -> Result<Self, SplatsError> {
        splats.check()?;
        let (degree, sh) = match &splats.color {
            Color::Sh { degree, coeffs } => (*degree, coeffs.clone()),
            Color::Rgb(rgb) => (0, rgb.as_flattened().iter().map(|&v| (v - 0.5) / sh::C0 as f32).collect()),
        };
        Ok(Self {
            means: splats.means.clone(),
            quats: splats.quats.clone(),
            log_scales: splats.scales.iter().map(|s| Vec3::from_array(s.to_array().map(log_scale))).collect(),
            logit_opacities: splats.opacities.iter().map(|&o| finite_logit(o)).collect(),
            sh,
            degree,
            kernel: splats.kernel.clone(),
            antialiased: false,
        })
    }

    /// Rows with a value that is not finite, in order, each with the name of its first such column.
    pub fn non_finite_rows(&self) -> Vec<(usize, &'static str)> {
        let bad = |values: &[f32]| values.iter().any(|v| !v.is_finite());
        let mut rows: Vec<(usize, &'static str)> = Vec::new();
        let width = self.sh_width();
        rows.extend(self.means.iter().enumerate().filter(|(_, v)| !v.is_finite()).map(|(i, _)| (i, "means")));
        rows.extend(self.quats.iter().enumerate().filter(|(_, v)| bad(*v)).map(|(i, _)| (i, "quats")));
        rows.extend(self.log_scales.iter().enumerate().filter(|(_, v)| !v.is_finite()).map(|(i, _)| (i, "log_scales")));
        rows.extend(
            self.logit_opacities
                .iter()
                .enumerate()
                .filter(|(_, v)| !v.is_finite())
                .map(|(i, _)| (i, "logit_opacities")),
        );
        rows.extend(self.sh.chunks_exact(width).enumerate().filter(|(_, v)| bad(v)).map(|(i, _)| (i, "sh")));
        for (column, values, ..) in self.kernel.columns() {
            rows.extend(values.iter().enumerate().filter(|(_, v)| !v.is_finite()).map(|(i, _)| (i, column)));
        }
        rows.sort_by_key(|(row, _)| *row);
        rows.dedup_by_key(|(row, _)| *row);
        rows
    }

    /// Refuses values that are not finite, or whose scale is none, for formats that store scales themselves.
    pub(super) fn check_storable(&self) -> std::io::Result<()> {
        let wrong = |what: String| Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, what));
        if let Some((row, column)) = self.non_finite_rows().first() {
            return wrong(format!("row {row}, `{column}` is not finite"));
        }
        match self.log_scales.iter().position(|s| !s.exp().is_finite()) {
            Some(row) => {
                wrong(format!("row {row}, `log_scales` is beyond what a scale can be: make it smaller than 88"))
            }
            None => Ok(()),
        }
    }

    /// Refuses kernels that differ from the Gaussian, for formats that cannot store them.
    pub(super) fn refuse_kernel(&self, format: &str) -> std::io::Result<()> {
        if self.kernel.is_neutral() {
            return Ok(());
        }
        let text = format!("{format} cannot store splats with another kernel than the Gaussian; write a .ply");
        Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, text))
    }

    /// An error for the first row with a value that is not finite, unless the limits allow such values.
    pub(super) fn refuse_non_finite(&self, src: Source<'_>, limits: &Limits) -> Result<(), IoError> {
        if limits.allow_non_finite {
            return Ok(());
        }
        match self.non_finite_rows().first() {
            Some(&(row, column)) => Err(src.value(row, column, f64::NAN, "must be finite")),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::rng::Rng;

    /// `n` random splats of realistic scales, opacities and colours.
    pub(in crate::io) fn cloud(n: usize, degree: u8, seed: u64) -> RawSplats {
        let mut out = RawSplats::with_capacity(n, degree);
        for row in 0..n {
            let mut r = Rng::new(seed, "io cloud", 0, row as u64);
            out.means.push(Vec3::new(r.normal(), r.normal(), r.normal()));
            out.quats.push([r.normal(), r.normal(), r.normal(), r.normal()]);
            out.log_scales.push(Vec3::new(r.range(-6.0, 0.0), r.range(-6.0, 0.0), r.range(-6.0, 0.0)));
            out.logit_opacities.push(2.0 * r.normal());
            out.sh.extend((0..3 * sh::coeffs(degree)).map(|_| 0.3 * r.normal()));
        }
        out
    }

    #[test]
    fn activation_round_trip() {
        for degree in 0..=3 {
            let raw = cloud(50, degree, 1);
            let splats = raw.to_splats().unwrap();
            let again = RawSplats::from_splats(&splats).unwrap();
            assert_eq!((&again.means, &again.quats, &again.sh), (&raw.means, &raw.quats, &raw.sh));
            for (a, b) in again.log_scales.iter().zip(&raw.log_scales) {
                assert!((*a - *b).abs().max_element() < 2e-6, "{a} {b}");
            }
            for (a, b) in again.logit_opacities.iter().zip(&raw.logit_opacities) {
                assert!((a - b).abs() < 2e-5 * (1.0 + b.abs().exp()), "{a} {b}");
            }
        }
    }

    #[test]
    fn ends_of_the_domain_stay_finite() {
        assert!((sigmoid(finite_logit(0.25)) - 0.25).abs() < 1e-7);
        assert!((sigmoid(finite_logit(1.0)) - 1.0).abs() < 2e-6 && finite_logit(1.0).is_finite());
        assert!(sigmoid(finite_logit(0.0)) < 2e-6 && finite_logit(0.0).is_finite());
        assert!(log_scale(0.0).is_finite() && log_scale(-2.0) == log_scale(2.0));
        assert_eq!((sigmoid(-1e30), sigmoid(1e30)), (0.0, 1.0));
    }

    #[test]
    fn a_scale_that_overflows_is_named() {
        let mut raw = cloud(3, 0, 2);
        raw.log_scales[2].y = 90.0;
        let text = raw.to_splats().unwrap_err().to_string();
        assert!(text.contains("row 2, column `scales`"), "{text}");
        raw.quats.pop();
        assert!(raw.to_splats().unwrap_err().to_string().contains("`quats` has 2 entries"));
    }

    #[test]
    fn non_finite_rows_are_listed_once() {
        let mut raw = cloud(5, 1, 3);
        raw.means[4].x = f32::NAN;
        raw.quats[1][0] = f32::INFINITY;
        raw.sh[12 + 3] = f32::NAN;
        assert_eq!(raw.non_finite_rows(), vec![(1, "quats"), (4, "means")]);
    }
}
