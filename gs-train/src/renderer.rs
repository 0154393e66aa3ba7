//! Rendering a method or a set of splats to images.

use crate::device::Device;
use crate::evaluate::clamped;
use crate::method::MethodError;
use crate::model::Model;
use crate::palette::color_scale;
use crate::timestamp::Timestamp;
use gs_core::speed::median_seconds;
use gs_core::{Camera, Image, SplatsRef, cast};
use gs_data::View;
use gs_raster::{Frame, RasterOptions, Rasterizer, Workspace};

/// Renders one frame after the other, reusing memory.
pub struct Renderer {
    /// Options of the rasteriser for every frame.
    pub options: RasterOptions,
    rasterizer: Box<dyn Rasterizer>,
    frame: Frame,
}

impl Renderer {
    /// A renderer on the CPU with these options.
    pub fn new(options: RasterOptions) -> Self {
        Self { options, rasterizer: Box::new(Workspace::new()), frame: Frame::default() }
    }

    /// A renderer on a device with these options.
    ///
    /// # Errors
    /// [`MethodError::Device`] if the device fails.
    pub fn on(device: &Device, options: RasterOptions) -> Result<Self, MethodError> {
        Ok(Self { rasterizer: device.open()?, ..Self::new(options) })
    }

    /// Renders splats; the frame holds until the next call.
    ///
    /// # Errors
    /// [`MethodError::Device`] if the device fails; the CPU does not.
    pub fn render<'a>(&mut self, splats: impl Into<SplatsRef<'a>>, camera: &Camera) -> Result<&Frame, MethodError> {
        self.rasterizer.render_into(splats.into(), camera, &self.options, &mut self.frame)?;
        Ok(&self.frame)
    }

    /// A model at the time of a view, as an image in `[0, 1]`.
    ///
    /// # Errors
    /// As [`Method::splats`](crate::method::Method::splats) and [`Self::render`].
    pub fn view(&mut self, model: &Model, view: &View, camera: &Camera) -> Result<Image, MethodError> {
        let splats = model.splats(&Timestamp::new(view.time), camera)?;
        Ok(clamped(self.render(&splats, camera)?))
    }

    /// Seconds from the timestamp to the image: the median of five renders of a view.
    ///
    /// # Errors
    /// As [`Method::splats`](crate::method::Method::splats) and [`Self::render`].
    pub fn seconds(&mut self, model: &Model, view: &View, camera: &Camera) -> Result<f64, MethodError> {
        let mut result = Ok(());
        let seconds = median_seconds(5, || {
            if let Err(e) = self.view(model, view, camera) {
                result = Err(e);
            }
        });
        result.map(|()| seconds)
    }

    /// A model at a normalised time, as an image in `[0, 1]`.
    ///
    /// # Errors
    /// As [`Method::splats`](crate::method::Method::splats) and [`Self::render`].
    pub fn at(&mut self, model: &Model, time: f32, camera: &Camera) -> Result<Image, MethodError> {
        let splats = model.splats(&Timestamp::normalised(time), camera)?;
        Ok(clamped(self.render(&splats, camera)?))
    }
}

/// Quantiles of the known depths that bound their colour scale.
const DEPTH_QUANTILES: [f64; 2] = [0.02, 0.98];

/// Mean depth of what covers each pixel, world units, `[height, width]`; 0 where alpha is at most ½.
pub fn mean_depth(frame: &Frame) -> Vec<f32> {
    frame.depth.iter().zip(&frame.alpha).map(|(&d, &a)| if a > 0.5 { d / a } else { 0.0 }).collect()
}

/// The span of depths for a colour scale: the quantiles 0.02 and 0.98 of those above 0.
pub fn depth_span(depths: &[f32]) -> [f32; 2] {
    let mut known: Vec<f32> = depths.iter().copied().filter(|d| *d > 0.0).collect();
    known.sort_by(f32::total_cmp);
    let at = |share: f64| known.get(cast::to_usize(known.len().saturating_sub(1) as f64 * share)).copied();
    [at(DEPTH_QUANTILES[0]).unwrap_or(0.0), at(DEPTH_QUANTILES[1]).unwrap_or(1.0)]
}

/// Colours of depths over a span: dark near, bright far, black where nothing is.
pub fn depth_colors(depths: &[f32], [near, far]: [f32; 2]) -> Vec<f32> {
    let color = |d: &f32| if *d > 0.0 { color_scale((d - near) / (far - near).max(1e-9)) } else { [0.0; 3] };
    depths.iter().flat_map(color).collect()
}

/// The name of a camera or view as a file name: the last part of a path, without an image extension and without anything a file system
/// could take amiss.
pub fn file_stem(name: &str) -> String {
    let last = name.rsplit(['/', '\\']).find(|part| !part.is_empty()).unwrap_or("");
    let lower = last.to_ascii_lowercase();
    let cut = [".png", ".jpg", ".jpeg", ".exr"].iter().find(|e| lower.ends_with(**e)).map_or(0, |e| e.len());
    let safe = |c: char| if c.is_alphanumeric() || matches!(c, '-' | '_' | '.' | ' ') { c } else { '_' };
    let stem: String = last.chars().take(last.chars().count() - cut).map(safe).take(100).collect();
    let stem = stem.trim().trim_matches('.');
    if stem.is_empty() { "view".to_owned() } else { stem.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_leave_the_folder() {
        let cases = [
            ("train/r_001.png", "r_001"),
            ("../../etc/passwd", "passwd"),
            ("..", "view"),
            ("", "view"),
            ("C:\\x\\y.JPG", "y"),
            ("a:b*c?", "a_b_c_"),
            ("/", "view"),
            (".hidden", "hidden"),
            ("nul\0l\n", "nul_l_"),
            ("v1.5", "v1.5"),
        ];
        for (name, want) in cases {
            assert_eq!(file_stem(name), want, "{name:?}");
        }
        assert_eq!(file_stem(&"x".repeat(5000)).len(), 100);
    }
}
