//! Drawing a method or a set of splats for people and files.

use crate::data::View;
use crate::evaluate::clamped;
use crate::methods::Method;
use crate::moment::Moment;
use gs_core::{Camera, Image, Splats, Time};
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

    /// Draws a method at a normalised time, as an image in `[0, 1]`.
    pub fn at(&mut self, method: &dyn Method, time: f32, camera: &Camera) -> Image {
        let splats = method.splats(&moment(time), camera);
        clamped(self.draw(&splats, camera))
    }
}
