//! Global-to-local motion decomposition (GLMD): the motion added by each stage of a model, seen by a fixed camera.
//!
//! A two-stage model first moves nearly rigid parts from interval to interval and then deforms the rest. Its stages
//! ([`Model::stages`]: `global`, `local`, `full`; a cloud with a field: `canonical`, `full`) are rendered, and
//! between consecutive stages there are two flows: the exact flow of the model ([`model_motion`]) and Farneback's estimate from
//! the 8-bit renders. If the first stage captures the global motion, its flow lies inside the object mask and has one direction,
//! while that of the second stage is shorter, spread out and without a common direction:
//!
//! | number | meaning |
//! |---|---|
//! | `inside`, `outside` | mean of `|flow| / reference` inside and outside the mask, over covered pixels |
//! | `ratio` | `inside / outside`; absent if nothing moves outside |
//! | `circular_variance` | 0: one direction, 1: all directions; over displacements of at least [`MIN_DISPLACEMENT`] px |
//!
//! MoDec-GS (Kwak et al. 2025), figures 8 and 9. The published figures use a learned flow; the normaliser is not stated there.

mod masks;
mod page;
mod panels;
mod scores;

pub use gs_metrics::flow::Reference;
pub use gs4d_eval::stage_motion::Anchor;
pub use masks::Masks;
pub use page::{Study, html};
pub use panels::strip;
pub use scores::{Mean, Scores, means};

use gs_core::{Camera, Image};
use gs_metrics::MetricError;
use gs_metrics::flow::Flow;
use serde::Serialize;

use gs_train::capabilities::StageView;
use gs_train::evaluate::clamped;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::renderer::Renderer;
use gs_train::timestamp::Timestamp;
use gs4d_eval::stage_motion::{Motion, estimated_motion, model_motion};
use gs4d_report::ReportError;
use gs4d_report::analysis::Histogram;

/// Shorter displacements are left out of the circular variance, pixels.
pub const MIN_DISPLACEMENT: f32 = 0.1;
/// An anchor takes part in the global motion if σ of its logit exceeds this (MoDec-GS).
const GATE_THRESHOLD: f32 = 0.01;

/// Times and flows of a study.
#[derive(Clone, Debug)]
pub struct Options {
    /// Normalised times, at least one.
    pub times: Vec<f32>,
    /// The stage whose pixel grid carries the flows.
    pub anchor: Anchor,
    /// Whether to measure the exact flow of the model.
    pub model: bool,
    /// Whether to measure Farneback's flow.
    pub farneback: bool,
    /// The length that displacements are divided by.
    pub reference: Reference,
}

/// The flow between two consecutive stages.
#[derive(Clone, Debug)]
pub struct Step {
    /// Names of the stages, for example `global-local`.
    pub name: String,
    /// `model` or `farneback`.
    pub by: &'static str,
    /// The flow, pixels; 0 where less than half of a pixel is covered.
    pub flow: Flow,
    /// Statistics of the flow.
    pub scores: Scores,
}

/// Renders and flows of all stages at one time.
#[derive(Clone, Debug)]
pub struct Still {
    /// Normalised time.
    pub time: f32,
    /// Name and RGB render of each stage, in order.
    pub pictures: Vec<(&'static str, Image)>,
    /// Object mask `[H, W, 1]`.
    pub mask: Image,
    /// The flows selected by [`Options::model`] and [`Options::farneback`].
    pub steps: Vec<Step>,
    /// Mean distance between the two flows over covered pixels, pixels, for each pair of stages.
    pub disagreement: Vec<(String, f64)>,
}

/// How anchors take part in the two stages of motion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Switches {
    /// Share of anchors with global motion, 0 to 1; `None` if the method has no quantity `global`.
    pub global: Option<f64>,
    /// Histogram of the local gate `σ(d_L)` over anchors; `None` if the method has no quantity `local`.
    pub local: Option<Histogram>,
}

/// Why a study failed.
#[derive(Debug, thiserror::Error)]
pub enum GlmdError {
    /// The method cannot compute its splats.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// The method has a single stage, hence no motion between stages.
    #[error("method `{0}` has one stage only: there is no motion between stages")]
    OneStage(String),
    /// Masks do not fit the camera or the number of times.
    #[error("{0}")]
    Mask(String),
    /// A flow cannot be estimated, or its statistics cannot be computed.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// The report page cannot be written.
    #[error(transparent)]
    Report(#[from] ReportError),
}

/// Renders and measures the stages of `method` at every time of `options`, in order, and passes each result to `each`.
///
/// # Errors
/// If the method has a single stage, a mask differs in size from the camera, or there is neither one mask nor one per time;
/// and any error of `each`.
pub fn study<E: From<GlmdError>>(
    method: &Model,
    camera: &Camera,
    background: [f32; 3],
    masks: &Masks,
    options: &Options,
    mut each: impl FnMut(Still) -> Result<(), E>,
) -> Result<(), E> {
    masks.check(camera, options.times.len())?;
    let mut renderer = Renderer::new(method.raster_options(background));
    for (k, &time) in options.times.iter().enumerate() {
        each(measure(method, camera, &mut renderer, time, options, |flow| masks.at(k, time, camera, flow))?)?;
    }
    Ok(())
}

/// The gates of the method's anchors at a normalised time.
///
/// # Errors
/// If the method cannot compute its quantities.
pub fn switches(method: &Model, time: f32) -> Result<Switches, MethodError> {
    let quantities = method.quantities(&Timestamp::normalised(time))?;
    let find = |name: &str| quantities.iter().find(|q| q.name == name && !q.values.is_empty());
    let share = |values: &[f32]| values.iter().filter(|v| **v > GATE_THRESHOLD).count() as f64 / values.len() as f64;
    Ok(Switches {
        global: find("global").map(|q| share(&q.values)),
        local: find("local").map(|q| Histogram::of("local", Some(time), q.span(), &q.values)),
    })
}

fn measure(
    method: &Model,
    camera: &Camera,
    renderer: &mut Renderer,
    time: f32,
    options: &Options,
    mask: impl FnOnce(&Flow) -> Image,
) -> Result<Still, GlmdError> {
    let stages = method.stages(&Timestamp::normalised(time), camera)?;
    let mut render = |s: &StageView| Ok((s.name, clamped(renderer.render(&s.splats, camera)?)));
    let renders: Vec<(&'static str, Image)> = stages.iter().map(&mut render).collect::<Result<_, MethodError>>()?;
    let motions: Vec<Motion> = stages
        .iter()
        .filter_map(|s| Some(model_motion(renderer, camera, &s.splats, s.before.as_ref()?, options.anchor)))
        .collect::<Result<_, _>>()?;
    let Some(first) = motions.first().filter(|_| motions.len() + 1 == stages.len()) else {
        return Err(GlmdError::OneStage(method.name().to_owned()));
    };
    let mask = mask(&first.flow);
    let (mut steps, mut disagreement) = (Vec::new(), Vec::new());
    for (pair, motion) in renders.windows(2).zip(motions) {
        let name = format!("{}-{}", pair[0].0, pair[1].0);
        let seen = motion.seen();
        let scored = |by, flow: &Flow| Scores::of(by, &name, flow, &seen, &mask, options.reference);
        let estimate =
            options.farneback.then(|| estimated(&pair[0].1, &pair[1].1, &seen, options.anchor)).transpose()?;
        if let (Some(flow), true) = (&estimate, options.model) {
            disagreement.extend(scores::distance(flow, &motion.flow, &seen)?.map(|d| (name.clone(), d)));
        }
        if options.model {
            let scores = scored("model", &motion.flow)?;
            steps.push(Step { name: name.clone(), by: "model", flow: motion.flow, scores });
        }
        if let Some(flow) = estimate {
            let scores = scored("farneback", &flow)?;
            steps.push(Step { name, by: "farneback", flow, scores });
        }
    }
    Ok(Still { time, pictures: renders, mask, steps, disagreement })
}

/// Farneback's flow between two renders; 0 where `seen` is false.
fn estimated(earlier: &Image, later: &Image, seen: &[bool], anchor: Anchor) -> Result<Flow, MetricError> {
    let mut flow = estimated_motion(earlier, later, anchor)?;
    for ((u, v), _) in flow.u.iter_mut().zip(&mut flow.v).zip(seen).filter(|(_, seen)| !**seen) {
        (*u, *v) = (0.0, 0.0);
    }
    Ok(flow)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{self as synth, SynthOptions};
    use gs_train::registry::section;
    use gs_train::scene::SceneInfo;

    const ALL: Options = Options {
        times: Vec::new(),
        anchor: Anchor::Later,
        model: true,
        farneback: true,
        reference: Reference::Longest,
    };

    /// A method at its beginning, its data, and the truth.
    fn begun(name: &str) -> (Model, synth::SynthData) {
        let options = SynthOptions::of_views(48, 4, 1);
        let data = synth::generate("reach", &options).unwrap();
        let entry = gs_methods::registry().find(name).unwrap();
        let config = entry.config("tiny").unwrap();
        let scene = SceneInfo::of(&data.dataset, &section(entry.name, &config, "init").unwrap(), 1).unwrap();
        let mut method = entry.model(&config, &scene).unwrap();
        method.begin_step(100_000);
        (method, data)
    }

    fn stills(method: &Model, data: &synth::SynthData, masks: &Masks, times: &[f32]) -> Result<Vec<Still>, GlmdError> {
        let (mut all, options) = (Vec::new(), Options { times: times.to_vec(), ..ALL });
        study(method, &data.dataset.test[0].camera, [0.0; 3], masks, &options, |still| {
            all.push(still);
            Ok::<(), GlmdError>(())
        })?;
        Ok(all)
    }

    /// Fields begin at rest: a method that has learnt no motion shows none, in any number.
    #[test]
    fn a_field_at_rest_shows_no_motion() {
        let (method, data) = begun("fourdgs");
        let all = stills(&method, &data, &Masks::Truth(Box::new(data.truth.clone()), None), &[0.0, 0.56]).unwrap();
        assert_eq!(all.len(), 2);
        for still in &all {
            let names: Vec<_> = still.pictures.iter().map(|p| p.0).collect();
            assert_eq!(names, ["canonical", "full"]);
            assert!(still.mask.data.contains(&1.0) && still.mask.data.contains(&0.0), "the box is seen");
            assert_eq!(still.steps.iter().map(|s| s.by).collect::<Vec<_>>(), ["model", "farneback"]);
            for step in &still.steps {
                assert!(step.scores.mean < 1e-3 && step.scores.circular_variance.is_none(), "{:?}", step.scores);
            }
            assert_eq!(strip(still).unwrap().shape(), (5 * 288 + 4 * 4, 288, 3));
        }
        let (scores, switches) =
            (means(all.iter().flat_map(|s| s.steps.iter().map(|s| &s.scores))), switches(&method, 0.0).unwrap());
        let page =
            html(&Study { title: "a<b", subtitle: "s", stills: &all, means: &scores, switches: &switches }).unwrap();
        assert!(page.contains("a&lt;b") && page.matches("data:image/png").count() == 10 && !page.contains("<script"));
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let (method, data) = begun("fourdgs");
        let refused = |masks: Vec<Image>| stills(&method, &data, &Masks::Given(masks), &[0.0, 0.5, 1.0]).unwrap_err();
        let mask = |side: usize| Image::zeros(side, side, 1);
        assert!(refused(vec![mask(48); 2]).to_string().contains("2 masks for 3 moments"));
        assert!(refused(vec![mask(48), mask(48), mask(47)]).to_string().contains("mask 2 has 47x47 pixels"));
        let (still, data) = begun("static3d");
        let e = stills(&still, &data, &Masks::Threshold, &[0.0]).unwrap_err();
        assert!(e.to_string().contains("one stage only"), "{e}");
    }
}
