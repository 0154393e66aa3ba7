//! Rendering a method or a set of splats to images.

use crate::evaluate::clamped;
use crate::method::MethodError;
use crate::model::Model;
use crate::timestamp::Timestamp;
use gs_core::speed::median_seconds;
use gs_core::{Camera, Image, SplatsRef};
use gs_data::View;
use gs_raster::{Frame, RasterOptions, Workspace, render_into};

/// Renders one frame after the other, reusing memory.
#[derive(Default)]
pub struct Renderer {
    /// Options of the rasteriser for every frame.
    pub options: RasterOptions,
    workspace: Workspace,
    frame: Frame,
}

impl Renderer {
    /// A renderer with these options.
    pub fn new(options: RasterOptions) -> Self {
        Self { options, ..Self::default() }
    }

    /// Renders splats; the frame holds until the next call.
    pub fn render<'a>(&mut self, splats: impl Into<SplatsRef<'a>>, camera: &Camera) -> &Frame {
        render_into(splats, camera, &self.options, &mut self.workspace, &mut self.frame);
        &self.frame
    }

    /// A model at the time of a view, as an image in `[0, 1]`.
    ///
    /// # Errors
    /// As [`Method::splats`](crate::method::Method::splats).
    pub fn view(&mut self, model: &Model, view: &View, camera: &Camera) -> Result<Image, MethodError> {
        let splats = model.splats(&Timestamp::new(view.time), camera)?;
        Ok(clamped(self.render(&splats, camera)))
    }

    /// Seconds from the timestamp to the image: the median of five renders of a view.
    ///
    /// # Errors
    /// As [`Method::splats`](crate::method::Method::splats).
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
    /// As [`Method::splats`](crate::method::Method::splats).
    pub fn at(&mut self, model: &Model, time: f32, camera: &Camera) -> Result<Image, MethodError> {
        let splats = model.splats(&Timestamp::normalised(time), camera)?;
        Ok(clamped(self.render(&splats, camera)))
    }
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
