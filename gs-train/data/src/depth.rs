//! Depth maps: how far the scene is from a view's camera, pixel by pixel.
//!
//! A map is `.npy` `[H, W]` or `[H, W, 1]` of numbers, or PNG with one channel of 16 bit. It has the aspect ratio of the view's stored image, at
//! any size; the centre of each pixel of the view is mapped through the view's lens to the nearest pixel of the map, so nothing is
//! averaged over an edge. Zero, negative and non-finite values say that nothing was measured.

use super::decode::limited;
use super::error::{DataError, Place};
use super::files::read_bytes;
use super::{header, mask, view::View};
use gs_core::io::{Limits, npy};
use gs_core::{Camera, Image, cast};
use image::codecs::png::PngDecoder;
use image::{ColorType, ImageDecoder};
use std::path::{Path, PathBuf};

/// Largest `.npy` map read.
const MAX_BYTES: u64 = 1 << 28;

/// A file with the depth of a view.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// The `.npy` or `.png` file.
    pub file: PathBuf,
    /// World units of camera-space z per unit of the file: 0.001 for a file in millimetres and a world in metres.
    pub unit: f64,
}

impl DepthMap {
    /// A map whose values are in world units.
    pub fn new(file: PathBuf) -> Self {
        Self { file, unit: 1.0 }
    }

    /// Checks that the file is there; what it holds is met when it is read.
    ///
    /// # Errors
    /// `io.read`.
    pub(crate) fn check(&self) -> Result<(), DataError> {
        std::fs::metadata(&self.file).map(drop).map_err(|e| DataError::read(&self.file, e))
    }

    /// Camera-space z in world units, `[H, W, 1]` at the size of `camera`: [`View::camera`], or that camera scaled. 0 where nothing
    /// was measured. `max_bytes` bounds the memory for decoding a PNG, as in [`decode`](super::decode::decode).
    ///
    /// # Errors
    /// `data.image_size` if the aspect ratio is not that of the view, `data.image` and `data.syntax` if the file is damaged or of
    /// another kind, `limits.file` and `io.read` as with images.
    pub(crate) fn read(&self, v: &View, camera: &Camera, max_bytes: Option<u64>) -> Result<Image, DataError> {
        let ([width, height], values) = match self.file.extension() {
            Some(e) if e.eq_ignore_ascii_case("png") => png(&self.file, max_bytes)?,
            _ => array(&self.file)?,
        };
        mask::check_shape(
            &self.file,
            [width, height].map(cast::to_u32),
            v.stored.unwrap_or([v.camera.width, v.camera.height]),
        )?;
        let world = |z: f32| cast::to_f32(f64::from(z) * self.unit);
        let value = |at: Option<[usize; 2]>| at.map_or(0.0, |[x, y]| world(values[y * width + x]));
        let measured = |z: f32| if z > 0.0 && z.is_finite() { z } else { 0.0 };
        let data = mask::nearest([width, height], v, camera).map(value).map(measured).collect();
        Ok(Image { width: camera.width as usize, height: camera.height as usize, channels: 1, data })
    }
}

type Values = ([usize; 2], Vec<f32>);

fn array(file: &Path) -> Result<Values, DataError> {
    let bytes = read_bytes(file, MAX_BYTES)?;
    let limits = Limits { allow_non_finite: true, ..Limits::default() };
    let array = npy::read(&bytes, &file.display().to_string(), &limits)
        .map_err(|e| DataError::syntax(file, "", e.to_string()))?;
    match array.shape[..] {
        [height, width] | [height, width, 1] if height > 0 && width > 0 => Ok(([width, height], array.to_f32())),
        _ => Err(DataError::Field {
            place: Place::new(file, "shape"),
            value: format!("{:?}", array.shape),
            why: "depth is one number per pixel",
            fix: "write an array of [height, width]",
        }),
    }
}

fn png(file: &Path, max_bytes: Option<u64>) -> Result<Values, DataError> {
    let header = header::read(file)?;
    let (reader, limits, _) = limited(file, &header, max_bytes)?;
    let failed = |e: image::ImageError| DataError::decode(file, e);
    let decoder = PngDecoder::with_limits(reader, limits).map_err(failed)?;
    if decoder.color_type() != ColorType::L16 {
        return Err(DataError::Field {
            place: Place::new(file, "colour type"),
            value: format!("{:?}", decoder.color_type()),
            why: "depth is one channel of 16 bit",
            fix: "write a grey PNG of 16 bit, or .npy",
        });
    }
    let [width, height] = [header.width, header.height].map(|side| side as usize);
    let mut bytes = vec![0; 2 * width * height];
    decoder.read_image(&mut bytes).map_err(failed)?;
    let values = bytes.as_chunks::<2>().0.iter().map(|b| f32::from(u16::from_ne_bytes(*b))).collect();
    Ok(([width, height], values))
}
