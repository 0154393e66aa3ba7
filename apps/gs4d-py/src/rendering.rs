//! The functions of the native module that draw: numpy arrays in, numpy arrays out.

use crate::batch::Batch;
use crate::input::{Settings, array, finite};
use crate::precision::{Images, Precision, Pulls};
use gs_raster::Screen;
use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Mutex, PoisonError};

/// Images that were drawn, kept for their gradients. It owns a copy of everything it was drawn from.
#[pyclass(frozen)]
pub(crate) struct Rendering {
    batch: Held,
    rows: usize,
}

enum Held {
    F32(Mutex<Batch<f32>>),
    F64(Mutex<Batch<f64>>),
}

/// Draws every camera's images: `colors`, `alphas`, `depths`; of the splats `means2d`, `splat_depths` and `radii`; and, if it
/// is to be kept, the `rendering`.
#[pyfunction]
pub(crate) fn draw<'py>(
    py: Python<'py>,
    arrays: &Bound<'py, PyDict>,
    settings: Settings,
    keep: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let means = arrays.get_item("means")?.ok_or_else(|| PyTypeError::new_err("means is missing"))?;
    if means.cast::<PyArrayDyn<f64>>().is_ok() {
        draw_as::<f64>(py, arrays, &settings, keep, |batch| Held::F64(Mutex::new(batch)))
    } else {
        draw_as::<f32>(py, arrays, &settings, keep, |batch| Held::F32(Mutex::new(batch)))
    }
}

fn draw_as<'py, T: Precision>(
    py: Python<'py>,
    arrays: &Bound<'py, PyDict>,
    settings: &Settings,
    keep: bool,
    hold: impl FnOnce(Batch<T>) -> Held,
) -> PyResult<Bound<'py, PyDict>> {
    let (mut batch, rows, cameras) = Batch::<T>::new(arrays, settings)?;
    let (images, screens) = py.detach(|| batch.draw()).map_err(PyValueError::new_err)?;
    let out = PyDict::new(py);
    let (height, width, channels) = (settings.height as usize, settings.width as usize, settings.channels);
    if channels > 0 {
        out.set_item("colors", shaped(py, images.colors, &[cameras, height, width, channels])?)?;
    }
    out.set_item("alphas", shaped(py, images.alphas, &[cameras, height, width, 1])?)?;
    out.set_item("depths", shaped(py, images.depths, &[cameras, height, width, 1])?)?;
    let of = |part: fn(&Screen) -> &[f32]| screens.iter().flat_map(|s| part(s).iter().copied()).collect::<Vec<f32>>();
    out.set_item("means2d", shaped(py, of(|s| s.means2d.as_flattened()), &[cameras, rows, 2])?)?;
    out.set_item("splat_depths", shaped(py, of(|s| &s.depths), &[cameras, rows])?)?;
    out.set_item("radii", shaped(py, of(|s| &s.radii), &[cameras, rows])?)?;
    if keep {
        out.set_item("rendering", Rendering { batch: hold(batch), rows })?;
    }
    Ok(out)
}

#[pymethods]
impl Rendering {
    /// Gradients of the loss whose cotangents are the arrays `colors`, `alphas` and `depths`, each of which may be missing:
    /// `means`, `quats`, `scales`, `opacities`, `colors` (flat), `viewmats`, `Ks`, `means2d`.
    fn pull_back<'py>(&self, py: Python<'py>, d: &Bound<'py, PyDict>) -> PyResult<Bound<'py, PyDict>> {
        match &self.batch {
            Held::F32(batch) => pull_back(py, batch, self.rows, d),
            Held::F64(batch) => pull_back(py, batch, self.rows, d),
        }
    }
}

fn pull_back<'py, T: Precision>(
    py: Python<'py>,
    batch: &Mutex<Batch<T>>,
    rows: usize,
    d: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyDict>> {
    let d =
        Images { colors: cotangent(d, "colors")?, alphas: cotangent(d, "alphas")?, depths: cotangent(d, "depths")? };
    // The lock is waited for without the interpreter, so that its owner can go on.
    let pulls = py.detach(|| batch.lock().unwrap_or_else(PoisonError::into_inner).pull_back(&d));
    let Pulls { splats, colors, means2d, cameras } = pulls.map_err(PyValueError::new_err)?;
    let out = PyDict::new(py);
    out.set_item("means", shaped(py, splats.means.into_flattened(), &[rows, 3])?)?;
    out.set_item("quats", shaped(py, splats.quats.into_flattened(), &[rows, 4])?)?;
    out.set_item("scales", shaped(py, splats.scales.into_flattened(), &[rows, 3])?)?;
    out.set_item("opacities", shaped(py, splats.opacities, &[rows])?)?;
    out.set_item("colors", PyArray1::from_vec(py, colors.concat()))?;
    let viewmats = cameras.iter().flat_map(|c| c.viewmat.into_iter().chain([[0.0; 4]]).flatten());
    out.set_item("viewmats", shaped(py, viewmats.map(T::from_f64).collect(), &[cameras.len(), 4, 4])?)?;
    let ks = cameras.iter().flat_map(|c| [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0]);
    out.set_item("Ks", shaped(py, ks.map(T::from_f64).collect(), &[cameras.len(), 3, 3])?)?;
    out.set_item("means2d", shaped(py, means2d.into_iter().flatten().flatten().collect(), &[cameras.len(), rows, 2])?)?;
    Ok(out)
}

/// A copy of a cotangent; empty if it is missing.
fn cotangent<T: Precision>(d: &Bound<'_, PyDict>, name: &str) -> PyResult<Vec<T>> {
    if !d.contains(name)? {
        return Ok(Vec::new());
    }
    let array = array::<T>(d, name)?;
    finite(&format!("cotangent of {name}"), array.as_slice()?, 1)?;
    Ok(array.as_slice()?.to_vec())
}

/// An array of a shape that its values fill.
pub(crate) fn shaped<'py, T: Element>(py: Python<'py>, values: Vec<T>, shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    Ok(PyArray1::from_vec(py, values).reshape(shape.to_vec())?.into_any())
}
