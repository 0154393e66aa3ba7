//! Runs of gs4d: splats and images of a trained scene at any time.

use crate::input::camera;
use crate::rendering::shaped;
use crate::threads::pool;
use glam::{DVec3, Vec3};
use gs_core::{Camera, Color, Kernel, Splats, Time, sh};
use gs_train::renderer::Renderer;
use gs_train::timestamp::Timestamp;
use gs4d_run::{Kept, OpenRun};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::OnceLock;

/// A camera as the package passes it: viewmat and K row by row, width, height.
type Matrices = ([f64; 16], [f64; 9], u32, u32);

/// A run, open for reading.
#[pyclass(frozen)]
pub(crate) struct Run {
    run: OpenRun,
    /// Whether the caller said where the data are: if they cannot be read there, that is an error.
    data_given: bool,
    views: OnceLock<Vec<Training>>,
}

/// Name, camera and normalised time of a training view.
type Training = (String, Camera, f32);

/// Opens a run folder, a checkpoint or a compact file; `data` is where its data went.
#[pyfunction]
pub(crate) fn open_run(py: Python<'_>, path: PathBuf, data: Option<PathBuf>) -> PyResult<Run> {
    let run = py.detach(|| OpenRun::open_with(gs_methods::registry(), &path, data.as_deref()));
    let run = run.map_err(|e| PyValueError::new_err(format!("{}: {e}", path.display())))?;
    Ok(Run { run, data_given: data.is_some(), views: OnceLock::new() })
}

fn error(e: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(e.to_string())
}

fn timestamp(t: f64) -> PyResult<Timestamp> {
    let t = Time::new(gs_core::cast::to_f32(t)).map_err(|e| error(format!("t: {e}")))?;
    Ok(Timestamp::new(t))
}

impl Run {
    /// What was read of the data; nothing where they are gone and the caller named no other place.
    fn known<T: Default>(&self, read: Result<T, impl std::fmt::Display>) -> PyResult<T> {
        read.or_else(|e| if self.data_given { Err(error(e)) } else { Ok(T::default()) })
    }

    /// What is known of the data, where they are or were kept.
    fn kept(&self) -> PyResult<Kept> {
        self.known(self.run.kept())
    }

    /// The training views, or those that were kept, as they were learnt; the data are opened once.
    fn views(&self) -> PyResult<&[Training]> {
        if let Some(views) = self.views.get() {
            return Ok(views);
        }
        let (views, placed) = (self.known(self.run.training_views())?, self.run.placed());
        let learnt = views.iter().map(|view| placed.view(view));
        let views = learnt.map(|view| (view.name, view.camera, view.time.normalised)).collect();
        Ok(self.views.get_or_init(|| views))
    }

    /// The camera asked for; else a training camera, or one at the origin.
    fn camera(&self, matrices: Option<Matrices>) -> PyResult<Camera> {
        if let Some((viewmat, k, width, height)) = matrices {
            return camera(0, viewmat, k, width, height);
        }
        match self.views()?.first() {
            Some((_, camera, _)) => Ok(camera.clone()),
            None => Camera::look_at(64, 64, 1.0, DVec3::ZERO, DVec3::Z, DVec3::NEG_Y).map_err(error),
        }
    }
}

#[pymethods]
impl Run {
    /// Name of the method.
    #[getter]
    fn method(&self) -> String {
        self.run.loaded.model.name().to_owned()
    }

    /// Optimizer steps made.
    #[getter]
    fn step(&self) -> u32 {
        self.run.loaded.step
    }

    /// The colour behind the scene that the run is evaluated over.
    #[getter]
    fn background(&self) -> [f32; 3] {
        self.run.background()
    }

    /// Normalised training timestamps; empty if they are not known.
    fn times(&self, py: Python<'_>) -> PyResult<Vec<f32>> {
        Ok(py.detach(|| self.kept())?.times)
    }

    /// Name, camera and normalised time of training views; empty if they are not known.
    fn cameras(&self, py: Python<'_>) -> PyResult<Vec<(String, Matrices, f32)>> {
        let of = |c: &Camera| {
            let k = [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0];
            (c.viewmat().transpose().to_cols_array(), k, c.width, c.height)
        };
        let views = py.detach(|| self.views())?;
        Ok(views.iter().map(|(name, camera, time)| (name.clone(), of(camera), *time)).collect())
    }

    /// All splats at a normalised time, in the same order at every time, and how they are drawn.
    fn splats<'py>(&self, py: Python<'py>, t: f64, camera: Option<Matrices>) -> PyResult<Bound<'py, PyDict>> {
        let (at, camera, pool) = (timestamp(t)?, py.detach(|| self.camera(camera))?, pool(None)?);
        let model = &self.run.loaded.model;
        let splats = py.detach(|| pool.install(|| model.all_splats(&at, &camera))).map_err(error)?;
        let out = columns(py, splats)?;
        let options = model.raster_options([0.0; 3]);
        out.set_item("near_plane", options.near)?;
        out.set_item("eps2d", options.dilation)?;
        out.set_item("rasterize_mode", if options.antialias { "antialiased" } else { "classic" })?;
        Ok(out)
    }

    /// Colour, alpha and depth of an image at a normalised time.
    fn render<'py>(
        &self,
        py: Python<'py>,
        t: f64,
        matrices: Matrices,
        background: Option<[f32; 3]>,
        threads: Option<usize>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (at, camera, pool) = (timestamp(t)?, self.camera(Some(matrices))?, pool(threads)?);
        let model = &self.run.loaded.model;
        let mut renderer = Renderer::new(model.raster_options(background.unwrap_or(self.run.background())));
        renderer.options.check().map_err(error)?;
        let frame = py
            .detach(|| pool.install(|| model.splats(&at, &camera).and_then(|s| renderer.render(&s, &camera).cloned())));
        let (frame, out) = (frame.map_err(error)?, PyDict::new(py));
        let [height, width] = [camera.height as usize, camera.width as usize];
        out.set_item("colors", shaped(py, frame.rgb.data, &[height, width, 3])?)?;
        out.set_item("alphas", shaped(py, frame.alpha, &[height, width, 1])?)?;
        out.set_item("depths", shaped(py, frame.depth, &[height, width, 1])?)?;
        Ok(out)
    }
}

/// Splats as the arguments of `rasterization`; a learnt kernel's columns beside them.
fn columns(py: Python<'_>, splats: Splats) -> PyResult<Bound<'_, PyDict>> {
    let (out, n) = (PyDict::new(py), splats.len());
    let flat = |rows: &[Vec3]| rows.iter().flat_map(|v| v.to_array()).collect::<Vec<f32>>();
    out.set_item("means", shaped(py, flat(&splats.means), &[n, 3])?)?;
    out.set_item("quats", shaped(py, splats.quats.into_flattened(), &[n, 4])?)?;
    out.set_item("scales", shaped(py, flat(&splats.scales), &[n, 3])?)?;
    out.set_item("opacities", shaped(py, splats.opacities, &[n])?)?;
    match splats.color {
        Color::Rgb(rgb) => {
            out.set_item("colors", shaped(py, rgb.into_flattened(), &[n, 3])?)?;
            out.set_item("sh_degree", py.None())?;
        }
        Color::Sh { degree, coeffs } => {
            out.set_item("colors", shaped(py, coeffs, &[n, sh::coeffs(degree), 3])?)?;
            out.set_item("sh_degree", degree)?;
        }
    }
    match splats.kernel {
        Kernel::Gaussian => {}
        Kernel::Frequency { lambdas, betas } => {
            out.set_item("lambdas", shaped(py, lambdas, &[n])?)?;
            out.set_item("betas", shaped(py, betas, &[n])?)?;
        }
        Kernel::Acutance { acutances } => out.set_item("acutances", shaped(py, acutances, &[n])?)?,
        other => return Err(error(format!("the columns of this kernel have no names here: {other:?}"))),
    }
    Ok(out)
}
