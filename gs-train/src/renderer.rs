//! Drawing a method or a set of splats for people and files.

use crate::evaluate::clamped;
use crate::method::Method;
use crate::timestamp::Moment;
use gs_core::speed::median_seconds;
use gs_core::{Camera, Image, Splats, Time};
use gs_data::View;
use gs_raster::{Frame, RasterOptions, Workspace, render_into};

/// The moment of a normalised time.
pub fn moment(t: f32) -> Moment {
    Moment::new(Time { normalised: t, seconds: f64::from(t) })
}

/// Draws one frame after the other, reusing memory.
#[derive(Default)]
pub struct Painter {
    /// How to draw.
    pub options: RasterOptions,
    workspace: Workspace,
    frame: Frame,
}

impl Painter {
    /// A painter with these options.
    pub fn new(options: RasterOptions) -> Self {
        Self { options, ..Self::default() }
    }

    /// Draws splats.
    pub fn draw(&mut self, splats: &Splats, camera: &Camera) -> &Frame {
        render_into(splats, camera, &self.options, &mut self.workspace, &mut self.frame);
        &self.frame
    }

    /// Draws a method at the time of a view, as an image in `[0, 1]`.
    pub fn view(&mut self, method: &dyn Method, view: &View, camera: &Camera) -> Image {
        let splats = method.splats(&Moment::new(view.time), camera);
        clamped(self.draw(&splats, camera))
    }

    /// Seconds from the moment to the picture: the median of five frames of a view.
    pub fn seconds(&mut self, method: &dyn Method, view: &View, camera: &Camera) -> f64 {
        median_seconds(5, || drop(self.view(method, view, camera)))
    }

    /// Draws a method at a normalised time, as an image in `[0, 1]`.
    pub fn at(&mut self, method: &dyn Method, time: f32, camera: &Camera) -> Image {
        let splats = method.splats(&moment(time), camera);
        clamped(self.draw(&splats, camera))
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
