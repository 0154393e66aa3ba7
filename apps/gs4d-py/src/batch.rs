//! Splats, cameras, and what their frames left: the images of all cameras, and the gradients they pull back.

use crate::input::{self, Settings, array};
use crate::precision::{Images, Precision, Pulls, Values};
use crate::threads::pool;
use gs_core::{Camera, sh};
use gs_raster::{RasterOptions, Screen};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::ThreadPool;
use std::sync::Arc;

/// What was drawn, kept for its gradients.
pub(crate) struct Batch<T: Precision> {
    splats: T::Splats,
    /// One for all cameras, or one for each.
    colors: Vec<T::Colors>,
    /// 0 if no colours were given.
    channels: usize,
    options: RasterOptions,
    cameras: Vec<Camera>,
    memory: T::Memory,
    pool: Arc<ThreadPool>,
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
            cameras,
            memory: T::Memory::default(),
            pool: pool(settings.threads)?,
        };
        Ok((batch, rows, count))
    }

    /// The images of all cameras, one after the other, and where the splats lie in each.
    pub(crate) fn draw(&mut self) -> Result<(Images<T>, Vec<Screen>), String> {
        let Self { splats, colors, options, cameras, memory, pool, .. } = self;
        let drawn = pool.install(|| T::draw(splats, colors, cameras, options, memory));
        let (images, screens) = drawn.map_err(|e| e.to_string())?;
        let mut all = Images::default();
        for images in images {
            append(&mut all.colors, images.colors);
            append(&mut all.alphas, images.alphas);
            append(&mut all.depths, images.depths);
        }
        Ok((all, screens))
    }

    /// Gradients of the loss whose cotangents are `d`, which has the layout of [`Batch::draw`]; after that.
    pub(crate) fn pull_back(&mut self, d: &Images<T>) -> Result<Pulls<T>, String> {
        let pixels = self.cameras.first().map_or(0, |c| c.width as usize * c.height as usize);
        let (count, channels) = (self.cameras.len(), self.channels);
        for (name, values, width) in
            [("colors", &d.colors, channels), ("alphas", &d.alphas, 1), ("depths", &d.depths, 1)]
        {
            let (got, want) = (values.len(), count * pixels * width);
            if got != 0 && got != want {
                return Err(format!("the cotangent of {name} has {got} values, {want} are needed"));
            }
        }
        let part = |values: &[T], width: usize, i: usize| {
            values.chunks(pixels * width.max(1)).nth(i).map_or_else(Vec::new, <[T]>::to_vec)
        };
        let of = |i| Images {
            colors: part(&d.colors, channels, i),
            alphas: part(&d.alphas, 1, i),
            depths: part(&d.depths, 1, i),
        };
        let d = (0..count).map(of).collect();
        let Self { splats, colors, options, cameras, memory, pool, .. } = self;
        pool.install(|| T::pull_back(splats, colors, cameras, options, memory, d)).map_err(|e| e.to_string())
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
