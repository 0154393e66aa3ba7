//! The drawing side of a step: splats to a frame, the frame against its photograph, the difference back to the splats.

use crate::loss::{ImageLoss, LossTerms, LossWeights};
use crate::non_finite::{Quarantine, quarantine};
use gs_core::{Camera, Image, Splats, SplatsGrad};
use gs_metrics::MetricError;
use gs_raster::{Frame, FrameGrad, RasterOptions, ScreenStats, Workspace, render_backward_into, render_into};
use serde::Serialize;
use std::time::Instant;

/// Milliseconds of the phases of a step.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize)]
pub struct Phases {
    /// Fetching and compositing the photographs.
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

/// One view, ready to be drawn and compared.
pub(super) struct Sheet {
    pub camera: Camera,
    pub options: RasterOptions,
    /// The photograph over the background.
    pub target: Image,
    pub weights: LossWeights,
    /// Share of this view in the loss of the step.
    pub share: f32,
}

/// What drawing found.
#[derive(Default)]
pub(super) struct Drawn {
    pub terms: LossTerms,
    pub quarantine: Quarantine,
    pub error: Option<MetricError>,
    pub ms: Phases,
}

impl Phases {
    /// Adds the phases of another view of the same step.
    fn add(&mut self, other: &Phases) {
        self.data += other.data;
        self.field += other.field;
        self.raster_forward += other.raster_forward;
        self.loss += other.loss;
        self.raster_backward += other.raster_backward;
    }
}

impl Drawn {
    /// Adds one view of a batch of `batch`: terms become means, the quarantine the worst of all.
    pub fn add(&mut self, view: &Drawn, batch: f64) {
        let mean = |sum: Option<f64>, term: Option<f64>| term.map(|t| sum.unwrap_or(0.0) + t / batch);
        let (sum, terms) = (self.terms, view.terms);
        self.terms = LossTerms {
            total: sum.total + terms.total / batch,
            l1: sum.l1 + terms.l1 / batch,
            mse: sum.mse + terms.mse / batch,
            ssim: mean(sum.ssim, terms.ssim),
            fre: mean(sum.fre, terms.fre),
            mrf: mean(sum.mrf, terms.mrf),
        };
        if view.quarantine.rows > self.quarantine.rows {
            self.quarantine = view.quarantine;
        }
        self.ms.add(&view.ms);
    }
}

impl Easel {
    /// An easel with empty buffers.
    pub fn new() -> Self {
        Self { loss: ImageLoss::new(), ..Self::default() }
    }

    /// Draws, compares, and pulls the loss back to the splats, where it counts with its share in the step's loss;
    /// [`Self::stats`] are of the whole loss of this view.
    pub fn draw(&mut self, splats: &Splats, sheet: &Sheet, d: &mut SplatsGrad) -> Drawn {
        let Sheet { camera, options, target, weights, share } = sheet;
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
        if *share != 1.0 {
            self.d_frame.rgb.iter_mut().for_each(|g| *g *= share);
        }
        drawn.ms.loss = ms_since(begun);
        let begun = Instant::now();
        render_backward_into(splats, camera, options, &mut self.workspace, &self.d_frame, d, &mut self.stats);
        if *share != 1.0 {
            self.stats.grad_means2d.as_flattened_mut().iter_mut().for_each(|g| *g /= share);
        }
        drawn.quarantine = quarantine(d);
        drawn.ms.raster_backward = ms_since(begun);
        drawn
    }
}

/// Milliseconds since `begun`.
pub(super) fn ms_since(begun: Instant) -> f64 {
    begun.elapsed().as_secs_f64() * 1e3
}
