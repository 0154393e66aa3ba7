//! The drawing side of a step: splats to a frame, the frame against its photograph, the difference back to the splats.

use crate::guard::{Quarantine, quarantine};
use crate::loss::{ImageLoss, LossTerms, LossWeights};
use gs_core::{Camera, Image, Splats, SplatsGrad};
use gs_metrics::MetricError;
use gs_raster::{Frame, FrameGrad, RasterOptions, ScreenStats, Workspace, render_backward_into, render_into};
use serde::Serialize;
use std::time::Instant;

/// Milliseconds of the phases of a step.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize)]
pub struct Phases {
    /// Fetching and compositing the photograph.
    pub data: f64,
    /// Cloud and field, forward and backward, and penalties.
    pub field: f64,
    /// Drawing.
    pub raster_forward: f64,
    /// Image loss and its gradient.
    pub loss: f64,
    /// Drawing, backward.
    pub raster_backward: f64,
    /// The optimiser.
    pub adam: f64,
    /// Density control.
    pub adapt: f64,
    /// The whole step.
    pub total: f64,
}

/// Scratch of the drawing side, reused between steps.
#[derive(Default)]
pub(super) struct Easel {
    workspace: Workspace,
    frame: Frame,
    d_frame: FrameGrad,
    /// What density control wants to know of the last frame.
    pub stats: ScreenStats,
    loss: ImageLoss,
}

/// What drawing found.
#[derive(Default)]
pub(super) struct Drawn {
    pub terms: LossTerms,
    pub quarantine: Quarantine,
    pub error: Option<MetricError>,
    pub ms: Phases,
}

impl Easel {
    /// An easel with empty buffers.
    pub fn new() -> Self {
        Self { loss: ImageLoss::new(), ..Self::default() }
    }

    /// Draws, compares, and pulls the loss back to the splats.
    pub fn draw(
        &mut self,
        splats: &Splats,
        camera: &Camera,
        options: &RasterOptions,
        target: &Image,
        weights: &LossWeights,
        d: &mut SplatsGrad,
    ) -> Drawn {
        let mut drawn = Drawn::default();
        let begun = Instant::now();
        render_into(splats, camera, options, &mut self.workspace, &mut self.frame);
        drawn.ms.raster_forward = ms_since(begun);
        let begun = Instant::now();
        match self.loss.evaluate(&mut self.frame, target, weights, &mut self.d_frame) {
            Ok(terms) => drawn.terms = terms,
            Err(e) => {
                drawn.error = Some(e);
                return drawn;
            }
        }
        drawn.ms.loss = ms_since(begun);
        let begun = Instant::now();
        render_backward_into(splats, camera, options, &mut self.workspace, &self.d_frame, d, &mut self.stats);
        drawn.quarantine = quarantine(d);
        drawn.ms.raster_backward = ms_since(begun);
        drawn
    }
}

/// Milliseconds since `begun`.
pub(super) fn ms_since(begun: Instant) -> f64 {
    begun.elapsed().as_secs_f64() * 1e3
}
