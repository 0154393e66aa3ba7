//! What changes over a run: stages, learning rates by parameter name, density control, SH degree and loss weights.
//!
//! Steps count from 1; step `s` is the one being made. Everything here is a pure function of the step, so a resumed run
//! needs no state of its own for it.

use crate::adam::{AdamOptions, Update};
use crate::densify::DensifyRules;
use crate::loss::{Dssim, ExposureConfig, ImageLoss, SpectrumTerm};
use gs_core::Param;
use gs_metrics::spectrum::AmplitudeOptions;
use gs_raster::{ClampGrad, RasterOptions};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

mod background;
mod check;
mod rates;
mod stage;
pub use background::Background;
pub(crate) use rates::complete_rates;
pub use rates::{Decay, LearningRate, rate_fields};
pub use stage::{LATEST_WINDOW, Stage};

/// The plan of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// Steps between two rises of the SH degree, from 0 (3DGS: 1000). 0: the full degree from the start.
    pub sh_every: u32,
    /// What is rendered behind the scene while training.
    pub background: Background,
    /// Weight λ of `1 − SSIM`; L1 has `1 − λ` (3DGS: 0.2; 4DGaussians: 0).
    pub lambda_dssim: f32,
    /// What λ weighs: `ssim`, `ssim_box` over the box of what images show, or `ms_ssim` for images with both sides
    /// above 160 pixels.
    #[serde(default)]
    pub dssim: Dssim,
    /// Weight of L1; `1 − lambda_dssim` if absent (MoDec-GS: 1 beside 0.2).
    #[serde(default)]
    pub lambda_l1: Option<f32>,
    /// Views a step learns from; their losses are averaged (MoDec-GS: 4; others: 1).
    #[serde(default = "one")]
    pub batch: u32,
    /// Views a step that learning rates and `adam_eps` are for; absent: as many as `batch`. Where the two differ, [`Self::update`]
    /// and the decays of Adam follow.
    #[serde(default)]
    pub lr_batch: Option<u32>,
    /// Weight φ of the amplitude-spectrum loss, which every method may use (FAGS: 0.3; others: 0).
    #[serde(default)]
    pub lambda_fre: f32,
    /// How that loss counts: the factor of the transform and the reduction over bins.
    #[serde(default)]
    pub fre: AmplitudeOptions,
    /// Weight of the distance to measured depth, where a view has it (ours; 0: depth maps are not read).
    #[serde(default)]
    pub lambda_depth: f32,
    /// Exposures of the images (Kerbl et al. 2024; others: all alike).
    #[serde(default)]
    pub exposure: ExposureConfig,
    /// Adam updates only splats that received a gradient in this step.
    pub sparse_adam: bool,
    /// A gradient row is refused (not finite) at most for this share of rows; above it the run stops.
    pub max_quarantine: f32,
    /// Splats nearer than this to the camera plane are not rendered, world units (INRIA 0.2, gsplat 0.01).
    pub near: f64,
    /// Opacities are compensated for the dilation of small splats (Mip-Splatting's 2D filter; 3DGS: off).
    pub antialias: bool,
    /// Added to the variances of projected splats, pixels² (3DGS: 0.3; DUT: 0.1).
    #[serde(default = "kerbl_dilation")]
    pub dilation: f64,
    /// Clone, split, prune and opacity reset of methods with a cloud.
    #[serde(default = "DensifyRules::kerbl2023")]
    pub density: DensifyRules,
    /// Adam's ε (3DGS: 1e-15).
    pub adam_eps: f32,
    /// The stages by name, followed in the order they state; their steps add up to the whole run.
    pub stages: BTreeMap<String, Stage>,
    /// Learning rates by the first two parts of a parameter's name: `lr.cloud.means` rules `cloud.means`,
    /// `lr.field.planes` all of `field.planes.…`. What has no rule of its own follows `all` of its first part, if there
    /// is one, else it does not learn.
    pub lr: BTreeMap<String, BTreeMap<String, LearningRate>>,
}

fn one() -> u32 {
    1
}

fn kerbl_dilation() -> f64 {
    RasterOptions::default().dilation
}

/// How the names of a field's parameters begin.
pub(crate) const FIELD: &str = "field.";

/// Where a step lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Position {
    /// Index of the stage.
    pub stage: usize,
    /// The step on the clock that learning rates and density control follow, from 1.
    pub clock: u32,
    /// Whether this is the first step of a stage with its own clock (the optimiser forgets its moments before it).
    pub fresh: bool,
}

/// Stages that have steps, with their names, in the order they are followed.
pub(crate) fn ordered(stages: &BTreeMap<String, Stage>) -> Vec<(&str, &Stage)> {
    let mut stages: Vec<(&str, &Stage)> =
        stages.iter().filter(|s| s.1.steps > 0).map(|(n, s)| (n.as_str(), s)).collect();
    stages.sort_by_key(|(_, s)| s.order);
    stages
}

impl Schedule {
    /// Number of steps of the whole run.
    pub fn steps(&self) -> u32 {
        self.stages.values().map(|s| s.steps).sum()
    }

    /// The stages with their names, in the order they are followed.
    pub fn ordered(&self) -> Vec<(&str, &Stage)> {
        ordered(&self.stages)
    }

    /// Where step `step` (from 1) lies. Steps beyond the end belong to the last stage.
    pub fn position(&self, step: u32) -> Position {
        let mut start = 0;
        let mut clock_start = 0;
        let stages = self.ordered();
        let last = stages.len().saturating_sub(1);
        for (i, (_, stage)) in stages.into_iter().enumerate() {
            if stage.own_clock {
                clock_start = start;
            }
            if step <= start + stage.steps || i == last {
                let fresh = stage.own_clock && start > 0 && step == start + 1;
                return Position { stage: i, clock: step - clock_start, fresh };
            }
            start += stage.steps;
        }
        Position { stage: 0, clock: step, fresh: false }
    }

    /// The stage of step `step`, if there is any.
    pub fn stage(&self, step: u32) -> Option<&Stage> {
        self.ordered().get(self.position(step).stage).map(|s| s.1)
    }

    /// The stage of step `step` and the number of steps made in it before, if there is any.
    pub(crate) fn stage_and_offset(&self, step: u32) -> Option<(&Stage, u32)> {
        let stages = self.ordered();
        let at = self.position(step).stage;
        let before: u32 = stages.iter().take(at).map(|s| s.1.steps).sum();
        stages.get(at).map(|s| (s.1, step - 1 - before))
    }

    /// Whether a stage after that of step `step` does not draw all views from its first step on.
    pub(crate) fn later_is_narrower(&self, step: u32) -> bool {
        let later = self.position(step).stage + 1;
        self.ordered().iter().skip(later).any(|(_, stage)| stage.first_moment || stage.window(0).is_some())
    }

    /// The length of the shortest run of these stages, each with its share of it, in which every one of `views` is drawn.
    pub fn shortest(&self, views: usize) -> u64 {
        let draws = (views as u64).div_ceil(self.batch.max(1).into());
        let (total, stages) = (u64::from(self.steps()), self.ordered());
        let all = stages.into_iter().filter(|(_, stage)| !stage.first_moment);
        let alike = |stage: &Stage| u64::from(stage.steps.saturating_sub(stage.alike_from()).max(1));
        all.map(|(_, stage)| (draws * total).div_ceil(alike(stage))).min().unwrap_or(draws)
    }

    /// Whether the field takes part in step `step`.
    pub fn dynamic(&self, step: u32) -> bool {
        self.stage(step).is_some_and(|s| s.dynamic)
    }

    /// Whether only the field learns in step `step`.
    pub fn field_alone(&self, step: u32) -> bool {
        self.stage(step).is_some_and(|s| s.field_alone)
    }

    /// The SH degree rendered in step `step`, at most `max`.
    pub fn sh_degree(&self, step: u32, max: u8) -> u8 {
        step.checked_div(self.sh_every).map_or(max, |d| d.min(u32::from(max)) as u8)
    }

    /// The rule for a parameter, if it learns.
    pub fn rule(&self, parameter: &str) -> Option<&LearningRate> {
        let mut parts = parameter.split('.');
        let group = self.lr.get(parts.next()?)?;
        parts.next().and_then(|part| group.get(part)).or_else(|| group.get("all"))
    }

    /// How a parameter is updated in a step, if it learns then; `extent` is that of the scene, world units.
    pub fn update(&self, p: &Param, step: u32, extent: f32) -> Option<Update> {
        if self.field_alone(step) && !p.name.starts_with(FIELD) {
            return None;
        }
        let (rule, clock) = (self.rule(&p.name)?, self.position(step).clock);
        let eps = if rule.eps > 0.0 { rule.eps } else { self.adam_eps };
        let sparse = rule.sparse || self.sparse_adam && p.row_width.is_some();
        let (rate, root) = (rule.at(clock, extent), self.batches().sqrt());
        let (rate, eps, weight_decay) = (rate * root, eps / root, rule.weight_decay * root);
        Some(Update { rate, eps, sparse, weight_decay, ramp: rule.ramp }).filter(|u| u.rate > 0.0)
    }

    /// The optimiser's decays: those of 3DGS for the batch that rates are for. Of `r` times as many views, `β^r`; rates and weight
    /// decay then count `√r` times, ε `1/√r` times. So moments forget, and weights decay, by the view as before, and noise moves
    /// parameters as far (the rule of Grendel-GS, Zhao et al. 2025).
    pub(crate) fn adam(&self) -> AdamOptions {
        let AdamOptions { beta1, beta2 } = AdamOptions::default();
        AdamOptions { beta1: beta1.powf(self.batches()), beta2: beta2.powf(self.batches()) }
    }

    /// How many times the batch that rates are for is drawn in a step.
    fn batches(&self) -> f32 {
        self.batch as f32 / self.lr_batch.unwrap_or(self.batch) as f32
    }

    /// The image loss of these weights, without the terms of the method's own.
    pub(crate) fn image_loss(&self) -> ImageLoss {
        ImageLoss::new(self.lambda_l1.unwrap_or(1.0 - self.lambda_dssim))
            .with(self.lambda_dssim, self.dssim.term())
            .with(self.lambda_fre, Box::new(SpectrumTerm::new(self.fre)))
            .with_depth(self.lambda_depth)
    }

    /// How frames are rendered over a background, in training as in evaluation. Saturated splats keep learning, as in
    /// INRIA's kernels.
    pub fn raster_options(&self, background: [f32; 3]) -> RasterOptions {
        RasterOptions {
            background,
            near: self.near,
            antialias: self.antialias,
            dilation: self.dilation,
            clamp_grad: ClampGrad::PassThrough,
            ..RasterOptions::default()
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(super) fn stage(steps: u32, own_clock: bool) -> Stage {
        Stage { steps, dynamic: own_clock, image_scale: 1.0, own_clock, ..Stage::default() }
    }

    /// Stages named so that their names sort the other way round.
    fn named(stages: Vec<Stage>) -> BTreeMap<String, Stage> {
        let name = |i: usize| char::from(b's' - i as u8).to_string();
        stages.into_iter().enumerate().map(|(i, s)| (name(i), Stage { order: i as u32, ..s })).collect()
    }

    pub(crate) fn schedule(stages: Vec<Stage>) -> Schedule {
        let group = |rates: &[(&str, LearningRate)]| rates.iter().map(|(n, r)| ((*n).to_owned(), *r)).collect();
        let means = ("means", LearningRate::decay(1.6e-4, 1.6e-6, 100).per_extent());
        let field = [("all", LearningRate::constant(1e-3)), ("planes", LearningRate::constant(1e-2))];
        let lr = BTreeMap::from([("cloud".to_owned(), group(&[means])), ("field".to_owned(), group(&field))]);
        Schedule {
            sh_every: 1000,
            background: Background::Black,
            lambda_dssim: 0.2,
            lambda_l1: None,
            batch: 1,
            lr_batch: None,
            dssim: Dssim::Ssim,
            lambda_fre: 0.0,
            fre: AmplitudeOptions::default(),
            lambda_depth: 0.0,
            exposure: ExposureConfig::default(),
            sparse_adam: false,
            max_quarantine: 1e-3,
            density: DensifyRules::kerbl2023(),
            adam_eps: 1e-15,
            near: 0.01,
            antialias: false,
            dilation: 0.3,
            stages: named(stages),
            lr,
        }
    }

    #[test]
    fn rates_are_found_by_the_first_two_parts_of_a_name() {
        let s = schedule(vec![stage(10, false)]);
        assert_eq!(s.rule("cloud.means").unwrap().start, 1.6e-4);
        assert_eq!(s.rule("field.planes.xy.0").unwrap().start, 1e-2);
        assert_eq!(s.rule("field.means.0.weight").unwrap().start, 1e-3);
        assert!(s.rule("cloud.quats").is_none());
    }

    #[test]
    fn rates_follow_the_batch() {
        let means = Param::rows("cloud.means", 3, vec![0.0; 3]);
        let of = |batch, lr_batch| {
            let s = Schedule { batch, lr_batch, adam_eps: 1e-8, ..schedule(vec![stage(10, false)]) };
            (s.update(&means, 1, 1.0).unwrap(), s.adam())
        };
        let one = of(1, Some(1));
        assert_eq!((of(4, None), of(4, Some(4))), (one, one));
        let (update, adam) = of(4, Some(1));
        assert_eq!((update.rate, update.eps), (one.0.rate * 2.0, one.0.eps / 2.0));
        assert!((adam.beta1 - 0.9f32.powi(4)).abs() < 1e-6 && (adam.beta2 - 0.999f32.powi(4)).abs() < 1e-6);
    }

    #[test]
    fn groups_have_their_own_epsilon_and_may_rest() {
        let mut s = schedule(vec![stage(10, false)]);
        let (means, table) = (Param::rows("cloud.means", 3, vec![0.0; 3]), Param::shared("field.planes.xy", vec![0.0]));
        let plain = Update { rate: 1e-2, eps: 1e-15, sparse: false, weight_decay: 0.0, ramp: 0 };
        assert_eq!(s.update(&table, 1, 1.0), Some(plain));
        let rule = rate(&mut s, "field", "planes");
        *rule = LearningRate { eps: 1e-8, sparse: true, from: 5, ..*rule };
        assert_eq!(
            (s.update(&table, 4, 1.0), s.update(&table, 5, 1.0).map(|u| (u.eps, u.sparse))),
            (None, Some((1e-8, true)))
        );
        s.sparse_adam = true;
        *rate(&mut s, "field", "planes") = LearningRate::constant(1e-2);
        let sparse = |p| s.update(p, 1, 1.0).map(|u| u.sparse);
        assert_eq!(
            (sparse(&means), sparse(&table)),
            (Some(true), Some(false)),
            "tables only where their group says so"
        );
        *rate(&mut s, "cloud", "means") = LearningRate::constant(0.0);
        assert_eq!((s.update(&means, 1, 1.0), s.update(&Param::shared("other", vec![]), 1, 1.0)), (None, None));
    }

    #[test]
    fn windows_open_by_their_share_of_the_stage_and_runs_may_be_too_short() {
        let windowed = |steps| Stage { window_parts: 8, window_until: 0.7, ..stage(steps, false) };
        for steps in [1, 3, 10, 138, 1000] {
            let stage = windowed(steps);
            let growing: Vec<(f64, u32)> = (0..steps).map_while(|offset| stage.window(offset)).collect();
            assert_eq!(growing.len() as u32, stage.alike_from(), "{steps}");
            assert!(growing.windows(2).all(|w| w[0] <= w[1]) && stage.alike_from() <= steps - steps * 3 / 10);
            assert!(growing.iter().enumerate().all(|(offset, w)| w.1 > offset as u32 && w.1 <= stage.alike_from()));
        }
        let never = Stage { window_until: 0.0, ..windowed(10) };
        assert!(schedule(vec![never]).check().is_err(), "a window that never is");
        let published = Stage { window_until: 7000.0 / 37000.0, ..windowed(37_000) };
        assert_eq!(published.window(999), Some((0.125, 1000)));
        assert_eq!((published.window(1000), published.alike_from()), (Some((0.25, 2000)), 7000));
        // 100 views: 100 steps of the stage's last 30 %, which is half of the run.
        let first = Stage { first_moment: true, ..stage(1000, false) };
        assert_eq!(schedule(vec![first, windowed(1000)]).shortest(100), 667);
        assert_eq!(Schedule { batch: 4, ..schedule(vec![stage(1000, false)]) }.shortest(90), 23);
    }

    #[test]
    fn clocks_restart_only_where_told() {
        let s = schedule(vec![stage(10, false), stage(5, true), stage(5, false)]);
        let at = |step| {
            let p = s.position(step);
            (p.stage, p.clock, p.fresh)
        };
        assert_eq!(at(1), (0, 1, false));
        assert_eq!(at(10), (0, 10, false));
        assert_eq!(at(11), (1, 1, true));
        assert_eq!(at(12), (1, 2, false));
        assert_eq!(at(16), (2, 6, false));
        assert_eq!(at(99), (2, 89, false));
        assert!(!s.dynamic(10) && s.dynamic(11) && !s.dynamic(16));
        assert_eq!((s.steps(), s.sh_degree(999, 3), s.sh_degree(2500, 3), s.sh_degree(9000, 3)), (20, 0, 2, 3));
    }

    pub(super) fn rate<'a>(s: &'a mut Schedule, group: &str, name: &str) -> &'a mut LearningRate {
        s.lr.get_mut(group).and_then(|g| g.get_mut(name)).unwrap()
    }
}
