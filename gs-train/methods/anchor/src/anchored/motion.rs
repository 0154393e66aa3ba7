//! What moves anchors and their Gaussians: GAD per interval, LGD per frame, and the intervals.

use gs_anchor::gad::Sparsity;
use gs_anchor::{Anchors, Gad, Intervals, Lgd};
use gs_core::{Camera, Param, Params, Time, cast};
use gs_raster::ScreenStats;
use serde::{Deserialize, Serialize};

/// A penalty on the logits of motion, so that anchors rest unless the image needs them to move.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SparsityConfig {
    /// Form of the penalty on a logit.
    pub kind: Sparsity,
    /// Its weight; 0: nothing is penalised.
    pub weight: f32,
}

/// Where LGD is asked about a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Query {
    /// Where GAD has moved it: one place is another part of the scene in each interval (MoDec-GS).
    #[default]
    Moved,
    /// Where it is at rest: one place is the same part at all times.
    Rest,
}

/// The parts of the motion; those that are absent leave the scene as it is.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    /// Global anchor deformation: anchors, per interval.
    pub gad: Option<Gad>,
    /// Local Gaussian deformation: decoded Gaussians, per frame.
    pub lgd: Option<Lgd>,
    /// Where LGD is asked.
    pub query: Query,
    /// The intervals at which GAD is asked.
    pub intervals: Option<Intervals>,
}

impl Motion {
    /// The times GAD is asked for at `t`, with the weights of their results: those of the intervals, or `t` itself without.
    pub fn keys(&self, t: Time) -> Vec<(Time, f32)> {
        let keys = self.intervals.as_ref().map_or_else(|| vec![(t.normalised, 1.0)], |i| i.keys(t.normalised));
        keys.into_iter().map(|(normalised, w)| (Time { normalised, ..t }, w)).collect()
    }

    /// Regularisers of both fields at a time and step: gradients are added, weighted values given.
    pub fn regularise(&mut self, anchors: &Anchors, t: Time, step: u32) -> Vec<(&'static str, f32)> {
        let mut all = Vec::new();
        if let Some(gad) = &mut self.gad {
            let names = ["global_tv", "global_smoothness", "global_l1"];
            all.extend(names.into_iter().zip(gad.regularise().map(|(_, value)| value)));
        }
        if let Some(lgd) = &mut self.lgd {
            all.extend(lgd.regularise(anchors, t, step));
        }
        all
    }

    /// Enters the screen gradients of a view into the statistic of its interval.
    pub fn observe(&mut self, clock: u32, t: Time, seen: &ScreenStats, camera: &Camera) {
        let Some(intervals) = self.intervals.as_mut().filter(|i| i.observes_at(clock)) else { return };
        let (half_w, half_h) = (0.5 * camera.width as f32, 0.5 * camera.height as f32);
        let lengths = seen.grad_means2d.iter().zip(&seen.radii).filter(|(_, radius)| **radius > 0.0);
        let (mut sum, mut visible) = (0.0f64, 0);
        for (g, _) in lengths {
            sum += f64::from((g[0] * half_w).hypot(g[1] * half_h));
            visible += 1;
        }
        intervals.observe(t.normalised, cast::to_f32(sum), visible, 1.0);
    }

    /// How much each anchor takes part in the global and the local deformation, by name.
    pub fn factors(&self, anchors: &Anchors) -> Vec<(&'static str, Vec<f32>)> {
        let (Some(gad), Some(logits)) = (&self.gad, &anchors.dynamics) else { return Vec::new() };
        let dynamics = gad.config().dynamics;
        let rows = logits.value.chunks_exact(anchors.shape().dynamics);
        let (global, local) = rows.map(|d| dynamics.weights(d)).map(|[g, l]| (g.value, l.value)).unzip();
        vec![("global", global), ("local", local)]
    }
}

impl Params for Motion {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.gad.iter().for_each(|gad| gad.visit(f));
        self.lgd.iter().for_each(|lgd| lgd.visit(f));
        self.intervals.iter().for_each(|intervals| intervals.visit(f));
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.gad.iter_mut().for_each(|gad| gad.visit_mut(f));
        self.lgd.iter_mut().for_each(|lgd| lgd.visit_mut(f));
        self.intervals.iter_mut().for_each(|intervals| intervals.visit_mut(f));
    }
}
