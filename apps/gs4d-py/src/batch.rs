//! The images of several cameras, and the gradients they pull back: sums over cameras in order.

use crate::input::{self, Settings, array};
use crate::precision::{Images, Precision, Pulled, Values, add_pulled};
use crate::threads::pool;
use gs_core::{Camera, sh};
use gs_raster::{CameraGrad, RasterOptions, Screen};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::ThreadPool;
use std::sync::Arc;

/// Splats, cameras, and what their frames left.
pub(crate) struct Batch<T: Precision> {
    splats: T::Splats,
    /// One for all cameras, or one for each.
    colors: Vec<T::Colors>,
    /// 0 if no colours were given.
    channels: usize,
    options: RasterOptions,
    cameras: Vec<(Camera, T::Memory)>,
    pool: Arc<ThreadPool>,
}

/// Gradients over all cameras.
pub(crate) struct Pulls<T> {
    /// Those of the splats; `None` without a camera. Colours are here if all cameras share them.
    pub splats: Option<Pulled<T>>,
    /// Colours of each camera, one after the other, if each has its own.
    pub colors: Vec<T>,
    /// `[cameras, n, 2]`: of the projected centres, per pixel.
    pub means2d: Vec<T>,
    /// One of each camera.
    pub cameras: Vec<CameraGrad>,
}

impl<T: Precision> Batch<T> {
    /// Takes and checks what is to be drawn; also returns the number of splats and of cameras.
    pub(crate) fn new(arrays: &Bound<'_, PyDict>, settings: &Settings) -> PyResult<(Self, usize, usize)> {
        let geometry = input::geometry::<T>(arrays)?;
        let cameras = input::cameras::<T>(arrays, settings.width, settings.height)?;
        let (rows, count) = (geometry.means.len(), cameras.len());
        let batch = Self {
            colors: colors::<T>(arrays, settings, rows, count)?,
            splats: T::splats(geometry),
            channels: settings.channels,
            options: settings.options()?,
            cameras: cameras.into_iter().map(|camera| (camera, T::Memory::default())).collect(),
            pool: pool(settings.threads)?,
        };
        Ok((batch, rows, count))
    }

    /// The images of all cameras, one after the other, and where the splats lie in each.
    pub(crate) fn draw(&mut self) -> (Images<T>, Vec<Screen>) {
        let Self { splats, colors, options, cameras, pool, .. } = self;
        let (mut all, mut screens) = (Images::default(), Vec::new());
        pool.install(|| {
            for (i, (camera, memory)) in cameras.iter_mut().enumerate() {
                let (images, screen) = T::draw(splats, &colors[i % colors.len()], camera, options, memory);
                append(&mut all.colors, images.colors);
                append(&mut all.alphas, images.alphas);
                append(&mut all.depths, images.depths);
                screens.push(screen);
            }
        });
        (all, screens)
    }

    /// Gradients of the loss whose cotangents are `d`, which has the layout of [`Batch::draw`]; after that.
    pub(crate) fn pull_back(&mut self, d: &Images<T>) -> Result<Pulls<T>, String> {
        let pixels = self.cameras.first().map_or(0, |(c, _)| c.width as usize * c.height as usize);
        let (count, channels) = (self.cameras.len(), self.channels);
        for (name, values, width) in
            [("colors", &d.colors, channels), ("alphas", &d.alphas, 1), ("depths", &d.depths, 1)]
        {
            let (got, want) = (values.len(), count * pixels * width);
            if got != 0 && got != want {
                return Err(format!("the cotangent of {name} has {got} values, {want} are needed"));
            }
        }
        let Self { splats, colors, options, cameras, pool, .. } = self;
        let mut pulls = Pulls { splats: None, colors: Vec::new(), means2d: Vec::new(), cameras: Vec::new() };
        pool.install(|| {
            for (i, (camera, memory)) in cameras.iter_mut().enumerate() {
                let part = |values: &[T], width: usize| {
                    values.chunks(pixels * width.max(1)).nth(i).map_or_else(Vec::new, <[T]>::to_vec)
                };
                let d = Images {
                    colors: part(&d.colors, channels),
                    alphas: part(&d.alphas, 1),
                    depths: part(&d.depths, 1),
                };
                let mut pulled = T::pull_back(splats, &colors[i % colors.len()], camera, options, memory, &d);
                append(&mut pulls.means2d, std::mem::take(&mut pulled.means2d).into_flattened());
                pulls.cameras.push(pulled.camera);
                if colors.len() > 1 {
                    append(&mut pulls.colors, std::mem::take(&mut pulled.splats.color));
                }
                match &mut pulls.splats {
                    Some(total) => add_pulled(total, &pulled),
                    none => *none = Some(pulled),
                }
            }
        });
        Ok(pulls)
    }
}

/// The colours of all cameras, or of each.
fn colors<T: Precision>(
    arrays: &Bound<'_, PyDict>,
    settings: &Settings,
    rows: usize,
    cameras: usize,
) -> PyResult<Vec<T::Colors>> {
    let error = |e: String| PyValueError::new_err(format!("colors: {e}"));
    let Settings { channels, degree, colors_per_camera, .. } = *settings;
    if channels == 0 {
        // The blend wants some.
        let values = Values { values: &vec![T::default(); rows], channels: 1, degree: None };
        return Ok(vec![T::colors(rows, values).map_err(error)?]);
    }
    let array = array::<T>(arrays, "colors")?;
    let values = array.as_slice()?;
    let (parts, size) = (if colors_per_camera { cameras } else { 1 }, rows * degree.map_or(1, sh::coeffs) * channels);
    if values.len() != parts * size {
        return Err(error(format!("{} values were given, {} are needed", values.len(), parts * size)));
    }
    let part = |i: usize| T::colors(rows, Values { values: &values[i * size..(i + 1) * size], channels, degree });
    (0..parts).map(|i| part(i).map_err(error)).collect()
}

/// Appends; without a copy if there is nothing yet.
fn append<T>(to: &mut Vec<T>, from: Vec<T>) {
    if to.is_empty() {
        *to = from;
    } else {
        to.extend(from);
    }
}
