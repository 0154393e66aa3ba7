//! Global and local motion made visible (GLMD): what each stage of a two-stage model moves, seen by a camera that stands still
//! while time passes.
//!
//! A model that first moves rigid-like parts from interval to interval and then bends what is left gives pictures of its stages
//! ([`gs_train::method::Method::stages`]: `global`, `local`, `full`; a cloud with a field: `canonical`, `full`). Between each pair
//! there is a flow: the model's own ([`motion::model_motion`], exact) and the one Farneback's estimator sees in the 8-bit
//! pictures. Where the first stage does its work, its flow lies inside the object's mask and has one direction; that of the second is
//! shorter, spread out and goes every way:
//!
//! | number | what |
//! |---|---|
//! | `inside`, `outside` | mean of `|flow| / reference` in the mask and outside, over pixels that show something |
//! | `ratio` | the one over the other; absent if nothing moves outside, or nothing at all |
//! | `circular_variance` | 0: one direction, 1: every direction; over displacements of at least [`LEAST`] px |
//!
//! MoDec-GS (Kwak et al. 2025), figures 8 and 9. The published figures use a learned flow; the normaliser is not stated there.

mod masks;
mod page;
mod picture;
mod scores;

pub use gs_metrics::flow::Reference;
pub use gs4d_eval::stage_motion::{Anchor, LEAST_COVER, Motion, model_motion, seen_motion};
pub use masks::Masks;
pub use page::{Study, html};
pub use picture::strip;
pub use scores::{Mean, Scores, means};

use gs_core::{Camera, Image};
use gs_metrics::MetricError;
use gs_metrics::flow::Flow;
use serde::Serialize;

use gs_train::evaluate::clamped;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::renderer::Renderer;
use gs_train::timestamp::Timestamp;
use gs4d_report::ReportError;
use gs4d_report::analysis::Histogram;

/// Displacements shorter than this have no direction to speak of, pixels.
pub const LEAST: f32 = 0.1;
/// An anchor moves with its scaffold if σ of its logit exceeds this (MoDec-GS).
const MOVES: f32 = 0.01;

/// What is looked at.
#[derive(Clone, Debug)]
pub struct Options {
    /// Normalised times.
    pub times: Vec<f32>,
    /// Where flows are anchored.
    pub anchor: Anchor,
    /// Whether the model's own flow is measured.
    pub model: bool,
    /// Whether Farneback's flow is measured.
    pub farneback: bool,
    /// What lengths are compared with.
    pub reference: Reference,
}

/// The flow between two stages.
#[derive(Clone, Debug)]
pub struct Step {
    /// For example `global-local`.
    pub name: String,
    /// `model` or `farneback`.
    pub by: &'static str,
    /// The flow; 0 where nothing is seen.
    pub flow: Flow,
    /// What is measured of it.
    pub scores: Scores,
}

/// One moment.
#[derive(Clone, Debug)]
pub struct Still {
    /// Normalised time.
    pub time: f32,
    /// Name and picture of each stage, RGB.
    pub pictures: Vec<(&'static str, Image)>,
    /// Where the object is, `[H, W, 1]`.
    pub mask: Image,
    /// The flows asked for.
    pub steps: Vec<Step>,
    /// Mean distance between the model's flow and Farneback's over seen pixels, by step.
    pub disagreement: Vec<(String, f64)>,
}

/// How far anchors take part in the two motions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Switches {
    /// Share of anchors that move with their scaffold; absent if the method has no quantity `global`.
    pub global: Option<f64>,
    /// How strongly they change in other ways, `σ(d_L)`; absent if the method has no quantity `local`.
    pub local: Option<Histogram>,
}

/// Why there is nothing to see.
#[derive(Debug, thiserror::Error)]
pub enum GlmdError {
    /// The method cannot be asked for its splats.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// The method moves nothing.
    #[error("method `{0}` has one stage only: there is no motion between stages")]
    OneStage(String),
    /// A mask does not fit.
    #[error("{0}")]
    Mask(String),
    /// A flow cannot be estimated or measured.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// The page was not made.
    #[error(transparent)]
    Report(#[from] ReportError),
}

/// Looks at every moment, in order, and hands each over.
///
/// # Errors
/// If the method has one stage only, a mask has another size than the camera, or their number fits neither one nor the moments;
/// and whatever `each` returns.
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
        each(look(method, camera, &mut renderer, time, options, |flow| masks.at(k, time, camera, flow))?)?;
    }
    Ok(())
}

/// What the method says of its anchors at a moment.
///
/// # Errors
/// If the method cannot be asked.
pub fn switches(method: &Model, time: f32) -> Result<Switches, MethodError> {
    let quantities = method.quantities(&Timestamp::normalised(time))?;
    let find = |name: &str| quantities.iter().find(|q| q.name == name && !q.values.is_empty());
    let share = |values: &[f32]| values.iter().filter(|v| **v > MOVES).count() as f64 / values.len() as f64;
    Ok(Switches {
        global: find("global").map(|q| share(&q.values)),
        local: find("local").map(|q| Histogram::of("local", Some(time), q.span(), &q.values)),
    })
}

fn look(
    method: &Model,
    camera: &Camera,
    renderer: &mut Renderer,
    time: f32,
    options: &Options,
    mask: impl FnOnce(&Flow) -> Image,
) -> Result<Still, GlmdError> {
    let stages = method.stages(&Timestamp::normalised(time), camera)?;
    let pictures: Vec<(&'static str, Image)> =
        stages.iter().map(|s| (s.name, clamped(renderer.render(&s.splats, camera)))).collect();
    let motions: Vec<Motion> = stages
        .iter()
        .filter_map(|s| Some(model_motion(renderer, camera, &s.splats, s.before.as_ref()?, options.anchor)))
        .collect();
    let Some(first) = motions.first().filter(|_| motions.len() + 1 == stages.len()) else {
        return Err(GlmdError::OneStage(method.name().to_owned()));
    };
    let mask = mask(&first.flow);
    let (mut steps, mut disagreement) = (Vec::new(), Vec::new());
    for (pair, motion) in pictures.windows(2).zip(motions) {
        let name = format!("{}-{}", pair[0].0, pair[1].0);
        let seen = motion.seen();
        let scored = |by, flow: &Flow| Scores::of(by, &name, flow, &seen, &mask, options.reference);
        let by_eye = options.farneback.then(|| estimated(&pair[0].1, &pair[1].1, &seen, options.anchor)).transpose()?;
        if let (Some(flow), true) = (&by_eye, options.model) {
            disagreement.extend(scores::distance(flow, &motion.flow, &seen)?.map(|d| (name.clone(), d)));
        }
        if options.model {
            let scores = scored("model", &motion.flow)?;
            steps.push(Step { name: name.clone(), by: "model", flow: motion.flow, scores });
        }
        if let Some(flow) = by_eye {
            let scores = scored("farneback", &flow)?;
            steps.push(Step { name, by: "farneback", flow, scores });
        }
    }
    Ok(Still { time, pictures, mask, steps, disagreement })
}

/// Farneback's flow, 0 where nothing is seen.
fn estimated(earlier: &Image, later: &Image, seen: &[bool], anchor: Anchor) -> Result<Flow, MetricError> {
    let mut flow = seen_motion(earlier, later, anchor)?;
    for ((u, v), _) in flow.u.iter_mut().zip(&mut flow.v).zip(seen).filter(|(_, seen)| !**seen) {
        (*u, *v) = (0.0, 0.0);
    }
    Ok(flow)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{self as synth, SynthOptions};
    use gs_train::method::{SceneInfo, section};

    const ALL: Options = Options {
        times: Vec::new(),
        anchor: Anchor::Later,
        model: true,
        farneback: true,
        reference: Reference::Longest,
    };

    /// A method at its beginning, its data, and the truth.
    fn begun(name: &str) -> (Model, synth::SynthData) {
        let options = SynthOptions { size: 48, train_views: 4, val_views: 0, test_views: 1, ..SynthOptions::default() };
        let data = synth::generate("reach", &options).unwrap();
        let entry = gs_methods::registry().find(name).unwrap();
        let config = entry.config("tiny").unwrap();
        let scene = SceneInfo::of(&data.dataset, &section(entry.name, &config, "init").unwrap(), 1).unwrap();
        let mut method = (entry.build)(&config, &scene).unwrap();
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
        let all = stills(&method, &data, &Masks::Truth(Box::new(data.truth.clone())), &[0.0, 0.56]).unwrap();
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
