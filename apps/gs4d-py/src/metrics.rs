//! Scores of images by gs-metrics.

use crate::threads::pool;
use gs_core::Image;
use gs_metrics::{MetricError, MsSsimOptions, SsimOptions};
use numpy::{PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

type Pixels<'py> = PyReadonlyArray3<'py, f32>;

/// The score of two images `[height, width, channels]`.
fn score(
    py: Python<'_>,
    a: &Pixels<'_>,
    b: &Pixels<'_>,
    of: impl FnOnce(&Image, &Image) -> Result<f64, MetricError> + Send,
) -> PyResult<f64> {
    let image = |pixels: &Pixels<'_>| -> PyResult<Image> {
        let [height, width, channels] = [0, 1, 2].map(|axis| pixels.shape()[axis]);
        let data = pixels.as_slice()?.to_vec();
        Image::from_data(width, height, channels, data).map_err(|e| PyValueError::new_err(e.to_string()))
    };
    let (a, b, pool) = (image(a)?, image(b)?, pool(None)?);
    py.detach(|| pool.install(|| of(&a, &b))).map_err(|e| PyValueError::new_err(e.to_string()))
}

/// Peak signal-to-noise ratio, dB.
#[pyfunction]
pub(crate) fn psnr(py: Python<'_>, a: Pixels<'_>, b: Pixels<'_>) -> PyResult<f64> {
    score(py, &a, &b, gs_metrics::psnr)
}

/// Structural similarity: over the zero-padded image, as losses have it, or over the valid area, as publications have it.
#[pyfunction]
pub(crate) fn ssim(py: Python<'_>, a: Pixels<'_>, b: Pixels<'_>, published: bool) -> PyResult<f64> {
    let options = if published { SsimOptions::published() } else { SsimOptions::default() };
    score(py, &a, &b, |a, b| gs_metrics::ssim(a, b, &options))
}

/// Structural similarity on five scales.
#[pyfunction]
pub(crate) fn ms_ssim(py: Python<'_>, a: Pixels<'_>, b: Pixels<'_>) -> PyResult<f64> {
    score(py, &a, &b, |a, b| gs_metrics::ms_ssim(a, b, &MsSsimOptions::default()))
}

/// Perceptual distance without learnt weights; it is not LPIPS.
#[pyfunction]
pub(crate) fn perceptual_proxy(py: Python<'_>, a: Pixels<'_>, b: Pixels<'_>) -> PyResult<f64> {
    score(py, &a, &b, gs_metrics::perceptual_proxy)
}
