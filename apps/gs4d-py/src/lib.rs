//! The Python package `gs4d`: a differentiable Gaussian rasteriser for the CPU, and runs of gs4d.
//!
//! This crate is its native module `gs4d._gs4d`, behind the cargo feature `python`; the package around it is in `python/gs4d`.
//! [`gs_raster`] draws: in `f32` by its production path, in `f64` by its reference. Built without the feature the crate is
//! empty and needs no interpreter.
#![warn(unreachable_pub)]
#![warn(clippy::cast_possible_truncation)]

#[cfg(feature = "python")]
mod batch;
#[cfg(feature = "python")]
mod input;
#[cfg(feature = "python")]
mod metrics;
#[cfg(feature = "python")]
mod precision;
#[cfg(feature = "python")]
mod rendering;
#[cfg(feature = "python")]
mod run;
#[cfg(feature = "python")]
mod threads;

#[cfg(feature = "python")]
#[pyo3::pymodule]
mod _gs4d {
    #[pymodule_export]
    use crate::metrics::{ms_ssim, perceptual_proxy, psnr, ssim};
    #[pymodule_export]
    use crate::rendering::{Rendering, draw};
    #[pymodule_export]
    use crate::run::{Run, open_run};
}
