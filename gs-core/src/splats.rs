//! Activated Gaussians, the input of a rasteriser, and their cotangents.
//!
//! ```
//! use glam::Vec3;
//! use gs_core::{Color, Kernel, Splats};
//!
//! let mut splats = Splats {
//!     means: vec![Vec3::ZERO],
//!     quats: vec![[1.0, 0.0, 0.0, 0.0]],
//!     scales: vec![Vec3::splat(0.1)],
//!     opacities: vec![0.9],
//!     color: Color::Rgb(vec![[1.0, 0.0, 0.0]]),
//!     kernel: Kernel::Gaussian,
//! };
//! assert_eq!(splats.check(), Ok(()));
//! splats.opacities[0] = 1.5;
//! let error = splats.check().unwrap_err().to_string();
//! assert_eq!(error, "splats row 0, column `opacities`: 1.5 is out of range (0 to 1)");
//! ```

use crate::geometry::{Geometry, GeometryRef};
use crate::kernel::Kernel;
use crate::sh;
use glam::Vec3;

/// Activated Gaussians: one row per splat, `n` rows in every column.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Splats {
    /// Centres of the Gaussians, world units.
    pub means: Vec<Vec3>,
    /// Rotations `(w, x, y, z)` of any length (normalised where used; zero is the identity).
    pub quats: Vec<[f32; 4]>,
    /// Standard deviations along the three axes, world units. Only their squares matter.
    pub scales: Vec<Vec3>,
    /// Opacities of the splats, in `[0, 1]`.
    pub opacities: Vec<f32>,
    /// Colours: plain RGB or spherical harmonics.
    pub color: Color,
    /// Profile of alpha over the distance.
    pub kernel: Kernel,
}

/// Borrowed [`Splats`]. Columns may come from several places: a field's means beside the cloud's colours, say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplatsRef<'a> {
    /// As [`Splats::means`].
    pub means: &'a [Vec3],
    /// As [`Splats::quats`].
    pub quats: &'a [[f32; 4]],
    /// As [`Splats::scales`].
    pub scales: &'a [Vec3],
    /// As [`Splats::opacities`].
    pub opacities: &'a [f32],
    /// As [`Splats::color`].
    pub color: &'a Color,
    /// As [`Splats::kernel`].
    pub kernel: &'a Kernel,
}

/// Colours of the splats, one row each.
#[derive(Clone, Debug, PartialEq)]
pub enum Color {
    /// One display-encoded colour per splat, the same from every direction. Not clamped: may be any number (overlays, flow).
    Rgb(Vec<[f32; 3]>),
    /// Spherical harmonics, `[n, (degree + 1)², 3]` flat: `rgb = max(0, 0.5 + Σ Y_k sh_k)`.
    Sh {
        /// SH degree, 0 to 3.
        degree: u8,
        /// `n · (degree + 1)² · 3` coefficients.
        coeffs: Vec<f32>,
    },
}

impl Default for Color {
    fn default() -> Self {
        Color::Rgb(Vec::new())
    }
}

/// Cotangents of [`Splats`]: the same columns and rows. A type of its own, so values and cotangents cannot be confused.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct SplatsGrad {
    /// Cotangents of the means, `dL/d means`.
    pub means: Vec<Vec3>,
    /// Cotangents of the raw, unnormalised quaternions.
    pub quats: Vec<[f32; 4]>,
    /// Cotangents of the standard deviations, `dL/d scales`.
    pub scales: Vec<Vec3>,
    /// Cotangents of the opacities, `dL/d opacities`.
    pub opacities: Vec<f32>,
    /// Cotangents of the colours, flat: `[n, 3]` for RGB, `[n, K, 3]` for SH with `K = (degree + 1)²`.
    pub color: Vec<f32>,
    /// Cotangents of the kernel's columns, flat `[n, Kernel::width]`, in the order of the fields of [`Kernel`].
    pub kernel: Vec<f32>,
}

/// Invalid splats: the column, and the row where there is one.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SplatsError {
    /// A column has the wrong number of entries.
    #[error("splats column `{column}` has {got} entries, {want} are needed for {rows} splats")]
    Length {
        /// Name of the column, such as `quats`.
        column: &'static str,
        /// Number of entries that the column needs.
        want: usize,
        /// Number of entries that it has.
        got: usize,
        /// Number of splats (rows of `means`).
        rows: usize,
    },
    /// A value is not finite or out of its domain.
    #[error("splats row {row}, column `{column}`: {value} is out of range ({rule})")]
    Value {
        /// Name of the column, such as `quats`.
        column: &'static str,
        /// Index of the splat, from 0.
        row: usize,
        /// Value that the entry has.
        value: f32,
        /// The domain of the column, in words.
        rule: &'static str,
    },
    /// An SH degree above 3.
    #[error("SH degree {0} is not supported (0 to 3)")]
    Degree(u8),
}

impl Splats {
    /// Number of splats (rows of `means`).
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are no splats.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Verifies lengths, finiteness and domains of all columns. Called once at the border; inside, they are invariants.
    ///
    /// # Errors
    /// The first invalid entry, with column and row.
    pub fn check(&self) -> Result<(), SplatsError> {
        self.view().check()
    }

    /// The rows `kept`, in that order.
    ///
    /// # Panics
    /// If a row is not there.
    pub fn rows(&self, kept: &[usize]) -> Self {
        fn pick<T: Copy>(column: &[T], kept: &[usize]) -> Vec<T> {
            kept.iter().map(|&i| column[i]).collect()
        }
        let color = match &self.color {
            Color::Rgb(rgb) => Color::Rgb(pick(rgb, kept)),
            Color::Sh { degree, coeffs } => {
                let width = self.color.width();
                let row = |&i: &usize| coeffs[i * width..][..width].iter().copied();
                Color::Sh { degree: *degree, coeffs: kept.iter().flat_map(row).collect() }
            }
        };
        let kernel = match &self.kernel {
            Kernel::Gaussian => Kernel::Gaussian,
            Kernel::Frequency { lambdas, betas } => {
                Kernel::Frequency { lambdas: pick(lambdas, kept), betas: pick(betas, kept) }
            }
            Kernel::Acutance { acutances } => Kernel::Acutance { acutances: pick(acutances, kept) },
        };
        Self {
            means: pick(&self.means, kept),
            quats: pick(&self.quats, kept),
            scales: pick(&self.scales, kept),
            opacities: pick(&self.opacities, kept),
            color,
            kernel,
        }
    }

    /// Borrows all columns.
    pub fn view(&self) -> SplatsRef<'_> {
        self.with_geometry(self.geometry())
    }

    /// Borrows means, quaternions and scales.
    pub fn geometry(&self) -> GeometryRef<'_> {
        GeometryRef { means: &self.means, quats: &self.quats, scales: &self.scales }
    }

    /// These splats with other means, quaternions and scales, which have as many rows.
    pub fn with_geometry<'a>(&'a self, geometry: GeometryRef<'a>) -> SplatsRef<'a> {
        let GeometryRef { means, quats, scales } = geometry;
        SplatsRef { means, quats, scales, opacities: &self.opacities, color: &self.color, kernel: &self.kernel }
    }

    /// Replaces means, quaternions and scales by others, which have as many rows.
    pub fn set_geometry(&mut self, geometry: Geometry) {
        debug_assert_eq!(geometry.len(), self.len());
        (self.means, self.quats, self.scales) = (geometry.means, geometry.quats, geometry.scales);
    }
}

impl<'a> From<&'a Splats> for SplatsRef<'a> {
    fn from(splats: &'a Splats) -> Self {
        splats.view()
    }
}

impl SplatsRef<'_> {
    /// Number of splats (rows of `means`).
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are no splats.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Copies every column.
    pub fn to_splats(self) -> Splats {
        Splats {
            means: self.means.to_vec(),
            quats: self.quats.to_vec(),
            scales: self.scales.to_vec(),
            opacities: self.opacities.to_vec(),
            color: self.color.clone(),
            kernel: self.kernel.clone(),
        }
    }

    /// As [`Splats::check`].
    ///
    /// # Errors
    /// The first invalid entry, with column and row.
    pub fn check(&self) -> Result<(), SplatsError> {
        let rows = self.len();
        let length = |column, got: usize, want: usize| {
            if got == want { Ok(()) } else { Err(SplatsError::Length { column, want, got, rows }) }
        };
        length("quats", self.quats.len(), rows)?;
        length("scales", self.scales.len(), rows)?;
        length("opacities", self.opacities.len(), rows)?;
        finite("means", self.means.iter().map(Vec3::as_ref))?;
        finite("quats", self.quats.iter())?;
        finite("scales", self.scales.iter().map(Vec3::as_ref))?;
        for (row, &value) in self.opacities.iter().enumerate() {
            if !(0.0..=1.0).contains(&value) {
                return Err(SplatsError::Value { column: "opacities", row, value, rule: "0 to 1" });
            }
        }
        for (column, values, [low, high], rule) in self.kernel.columns() {
            length(column, values.len(), rows)?;
            if let Some((row, &value)) = values.iter().enumerate().find(|(_, v)| !(low..=high).contains(*v)) {
                return Err(SplatsError::Value { column, row, value, rule });
            }
        }
        match self.color {
            Color::Rgb(rgb) => {
                length("rgb", rgb.len(), rows)?;
                finite("rgb", rgb.iter())
            }
            Color::Sh { degree, coeffs } => {
                if *degree > sh::MAX_DEGREE {
                    return Err(SplatsError::Degree(*degree));
                }
                let width = 3 * sh::coeffs(*degree);
                length("sh", coeffs.len(), rows * width)?;
                finite("sh", coeffs.chunks_exact(width))
            }
        }
    }
}

/// An error for the first row of a column with a non-finite value.
fn finite<R: AsRef<[f32]>>(column: &'static str, rows: impl Iterator<Item = R>) -> Result<(), SplatsError> {
    for (row, values) in rows.enumerate() {
        if let Some(&value) = values.as_ref().iter().find(|v| !v.is_finite()) {
            return Err(SplatsError::Value { column, row, value, rule: "finite" });
        }
    }
    Ok(())
}

impl Color {
    /// Values per splat in the flat layout: 3 for RGB, `3 (degree + 1)²` for SH.
    pub fn width(&self) -> usize {
        match self {
            Color::Rgb(_) => 3,
            Color::Sh { degree, .. } => 3 * sh::coeffs(*degree),
        }
    }

    /// All values as one flat slice, row-major.
    pub fn as_flat(&self) -> &[f32] {
        match self {
            Color::Rgb(rgb) => rgb.as_flattened(),
            Color::Sh { coeffs, .. } => coeffs,
        }
    }
}

impl SplatsGrad {
    /// Zero cotangents of the shape of `splats`.
    pub fn zeros_like<'a>(splats: impl Into<SplatsRef<'a>>) -> Self {
        let mut grad = Self::default();
        grad.reset(splats);
        grad
    }

    /// Sets this to zero cotangents of the shape of `splats`, reusing memory.
    pub fn reset<'a>(&mut self, splats: impl Into<SplatsRef<'a>>) {
        let splats = splats.into();
        let n = splats.len();
        refill(&mut self.means, n, Vec3::ZERO);
        refill(&mut self.quats, n, [0.0; 4]);
        refill(&mut self.scales, n, Vec3::ZERO);
        refill(&mut self.opacities, n, 0.0);
        refill(&mut self.color, n * splats.color.width(), 0.0);
        refill(&mut self.kernel, n * splats.kernel.width(), 0.0);
    }

    /// Borrows the cotangents of means, quaternions and scales.
    pub fn geometry(&self) -> GeometryRef<'_> {
        GeometryRef { means: &self.means, quats: &self.quats, scales: &self.scales }
    }

    /// Exchanges the cotangents of means, quaternions and scales with others, which have as many rows: those at a timestamp
    /// for those that a field pulled back to the canonical splats, say.
    pub fn swap_geometry(&mut self, other: &mut Geometry) {
        debug_assert_eq!(other.len(), self.means.len());
        std::mem::swap(&mut self.means, &mut other.means);
        std::mem::swap(&mut self.quats, &mut other.quats);
        std::mem::swap(&mut self.scales, &mut other.scales);
    }

    /// Adds `factor` times the cotangents of means, quaternions and scales of `from`, which has as many rows.
    pub fn add_geometry(&mut self, factor: f32, from: &Geometry) {
        debug_assert_eq!(from.len(), self.means.len());
        self.means.iter_mut().zip(&from.means).for_each(|(to, from)| *to += factor * *from);
        self.scales.iter_mut().zip(&from.scales).for_each(|(to, from)| *to += factor * *from);
        let quats = self.quats.as_flattened_mut().iter_mut().zip(from.quats.as_flattened());
        quats.for_each(|(to, from)| *to += factor * from);
    }

    /// Column and row of the first non-finite entry, if any; columns in the order of the fields.
    pub fn first_non_finite(&self) -> Option<(&'static str, usize)> {
        let width = |column: &[f32]| (column.len() / self.means.len().max(1)).max(1);
        let checks = [
            finite("d_means", self.means.iter().map(Vec3::as_ref)),
            finite("d_quats", self.quats.iter()),
            finite("d_scales", self.scales.iter().map(Vec3::as_ref)),
            finite("d_opacities", self.opacities.iter().map(std::slice::from_ref)),
            finite("d_color", self.color.chunks_exact(width(&self.color))),
            finite("d_kernel", self.kernel.chunks_exact(width(&self.kernel))),
        ];
        checks.into_iter().find_map(|c| match c {
            Err(SplatsError::Value { column, row, .. }) => Some((column, row)),
            _ => None,
        })
    }
}

fn refill<T: Copy>(column: &mut Vec<T>, n: usize, value: T) {
    column.clear();
    column.resize(n, value);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two() -> Splats {
        Splats {
            means: vec![Vec3::ZERO, Vec3::ONE],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 2],
            scales: vec![Vec3::ONE; 2],
            opacities: vec![0.5, 1.0],
            color: Color::Sh { degree: 1, coeffs: vec![0.0; 24] },
            kernel: Kernel::Gaussian,
        }
    }

    #[test]
    fn valid_splats_pass() {
        assert_eq!(two().check(), Ok(()));
        assert_eq!(Splats::default().check(), Ok(()));
    }

    #[test]
    fn every_error_names_column_and_row() {
        let error = |f: &dyn Fn(&mut Splats)| {
            let mut s = two();
            f(&mut s);
            s.check().unwrap_err().to_string()
        };
        assert!(error(&|s| s.means[1].y = f32::NAN).contains("row 1, column `means`"));
        assert!(error(&|s| s.quats[0][3] = f32::INFINITY).contains("row 0, column `quats`"));
        assert!(error(&|s| s.scales[1].x = f32::NEG_INFINITY).contains("row 1, column `scales`"));
        assert!(error(&|s| s.opacities[0] = 1.5).contains("row 0, column `opacities`"));
        assert!(error(&|s| s.opacities[0] = f32::NAN).contains("row 0, column `opacities`"));
        assert!(error(&|s| s.opacities.truncate(1)).contains("`opacities` has 1 entries"));
        assert!(error(&|s| s.color = Color::Sh { degree: 4, coeffs: vec![] }).contains("degree 4"));
        assert!(error(&|s| s.color = Color::Rgb(vec![[0.0; 3]])).contains("`rgb` has 1 entries"));
        let bad_sh = |s: &mut Splats| {
            if let Color::Sh { coeffs, .. } = &mut s.color {
                coeffs[13] = f32::NAN;
            }
        };
        assert!(error(&bad_sh).contains("row 1, column `sh`"));
        let kernel = |lambdas: [f32; 2], betas: Vec<f32>| Kernel::Frequency { lambdas: lambdas.into(), betas };
        assert!(error(&|s| s.kernel = kernel([0.5, 1.5], vec![0.5; 2])).contains("row 1, column `lambdas`"));
        assert!(error(&|s| s.kernel = kernel([0.5, f32::NAN], vec![0.5; 2])).contains("row 1, column `lambdas`"));
        assert!(error(&|s| s.kernel = kernel([0.5; 2], vec![0.5])).contains("`betas` has 1 entries"));
        assert!(error(&|s| s.kernel = Kernel::Acutance { acutances: vec![0.0, 1.0] }).contains("`acutances`"));
    }

    #[test]
    fn gradients_mirror_shapes() {
        let mut g = SplatsGrad::zeros_like(&two());
        assert_eq!((g.means.len(), g.color.len()), (2, 24));
        assert_eq!(g.first_non_finite(), None);
        g.color[12] = f32::NAN;
        assert_eq!(g.first_non_finite(), Some(("d_color", 1)));
    }
}
