//! What arrives from Python: the package has checked types and shapes, values are checked here.

use crate::precision::Precision;
use glam::{DMat4, DVec2};
use gs_core::{Camera, cast};
use gs_raster::reference::{KernelKind, Scene};
use gs_raster::{ClampGrad, RasterOptions};
use numpy::{PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Numbers that go with the arrays.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Settings {
    pub width: u32,
    pub height: u32,
    near: f64,
    far: f64,
    dilation: f64,
    max_alpha: f64,
    /// Whether samples above `max_alpha` get gradients.
    pass_through: bool,
    antialias: bool,
    /// SH degree of the colours, or `None` for plain ones.
    pub degree: Option<u8>,
    /// Channels of the colours; 0 if none are given.
    pub channels: usize,
    /// Whether each camera has colours of its own.
    pub colors_per_camera: bool,
    pub threads: Option<usize>,
}

impl Settings {
    pub(crate) fn options(&self) -> PyResult<RasterOptions> {
        let options = RasterOptions {
            near: self.near,
            far: self.far,
            dilation: self.dilation,
            max_alpha: self.max_alpha,
            antialias: self.antialias,
            clamp_grad: if self.pass_through { ClampGrad::PassThrough } else { ClampGrad::Exact },
            ..RasterOptions::default()
        };
        // Python's names of the options.
        let name = |field| match field {
            "near" => "near_plane",
            "far" => "far_plane",
            "dilation" => "eps2d",
            other => other,
        };
        let error = |e: gs_raster::OptionError| format!("{} = {}: it must be {}", name(e.field), e.value, e.rule);
        options.check().map_err(|e| PyValueError::new_err(error(e)))?;
        Ok(options)
    }
}

/// An array of the dictionary, contiguous and of the type `T`.
pub(crate) fn array<'py, T: Precision>(
    arrays: &Bound<'py, PyDict>,
    name: &str,
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    let found = arrays.get_item(name)?.ok_or_else(|| PyTypeError::new_err(format!("{name} is missing")))?;
    let array = found.cast::<PyArrayDyn<T>>();
    let array = array.map_err(|_| PyTypeError::new_err(format!("{name} must have the dtype of means")))?;
    let array = array.try_readonly().map_err(|e| PyValueError::new_err(format!("{name}: {e}")))?;
    array.as_slice().map_err(|_| PyValueError::new_err(format!("{name} must be contiguous")))?;
    Ok(array)
}

/// A copy of an array's values, all of them finite, in rows of `N`.
fn rows<T: Precision, const N: usize>(arrays: &Bound<'_, PyDict>, name: &str) -> PyResult<Vec<[T; N]>> {
    let array = array::<T>(arrays, name)?;
    let values = array.as_slice()?;
    finite(name, values, N)?;
    let (rows, rest) = values.as_chunks::<N>();
    if !rest.is_empty() {
        return Err(PyValueError::new_err(format!("{name} has {} values: rows of {N} are needed", values.len())));
    }
    Ok(rows.to_vec())
}

/// An error that names the first value that is not finite.
pub(crate) fn finite<T: Precision>(name: &str, values: &[T], width: usize) -> PyResult<()> {
    // As an f32: numbers beyond it are of no use to either path.
    match values.iter().position(|v| !cast::to_f32(v.to_f64()).is_finite()) {
        None => Ok(()),
        Some(at) => {
            let value = values[at].to_f64();
            Err(PyValueError::new_err(format!("{name}, row {}: {value} is not finite", at / width.max(1))))
        }
    }
}

/// The splats but for their colours.
pub(crate) fn geometry<T: Precision>(arrays: &Bound<'_, PyDict>) -> PyResult<Scene<T>> {
    let means = rows::<T, 3>(arrays, "means")?;
    let quats = rows::<T, 4>(arrays, "quats")?;
    let scales = rows::<T, 3>(arrays, "scales")?;
    let opacities = rows::<T, 1>(arrays, "opacities")?.into_flattened();
    for (name, got) in [("quats", quats.len()), ("scales", scales.len()), ("opacities", opacities.len())] {
        if got != means.len() {
            return Err(PyValueError::new_err(format!("{name} has {got} rows, means {}", means.len())));
        }
    }
    if let Some(row) = opacities.iter().position(|o| !(0.0..=1.0).contains(&o.to_f64())) {
        let value = opacities[row].to_f64();
        return Err(PyValueError::new_err(format!("opacities, row {row}: {value} is out of range (0 to 1)")));
    }
    let (color, degree) = (Vec::new(), None);
    Ok(Scene { means, quats, scales, opacities, color, degree, kernel: Vec::new(), kernel_kind: KernelKind::Gaussian })
}

/// The cameras of `viewmats` and `Ks`.
pub(crate) fn cameras<T: Precision>(arrays: &Bound<'_, PyDict>, width: u32, height: u32) -> PyResult<Vec<Camera>> {
    let viewmats = rows::<T, 16>(arrays, "viewmats")?;
    let ks = rows::<T, 9>(arrays, "Ks")?;
    if viewmats.len() != ks.len() {
        return Err(PyValueError::new_err(format!("viewmats holds {} cameras, Ks {}", viewmats.len(), ks.len())));
    }
    let pairs = viewmats.iter().zip(&ks).enumerate();
    pairs.map(|(i, (v, k))| camera(i, v.map(T::to_f64), k.map(T::to_f64), width, height)).collect()
}

/// Camera number `index` from its matrices, row by row.
pub(crate) fn camera(index: usize, viewmat: [f64; 16], k: [f64; 9], width: u32, height: u32) -> PyResult<Camera> {
    let [fx, skew, cx, zero, fy, cy, last @ ..] = k;
    if viewmat[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err(PyValueError::new_err(format!("viewmats[{index}]: the last row must be 0, 0, 0, 1")));
    }
    if [skew, zero] != [0.0; 2] || last != [0.0, 0.0, 1.0] {
        let rule = "must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; skew is not supported";
        return Err(PyValueError::new_err(format!("Ks[{index}] {rule}")));
    }
    let viewmat = DMat4::from_cols_array(&viewmat).transpose();
    let camera = Camera::from_viewmat(width, height, DVec2::new(fx, fy), DVec2::new(cx, cy), viewmat);
    camera.map_err(|e| PyValueError::new_err(format!("camera {index} (viewmats, Ks, width, height): {e}")))
}
