//! A body that moves over ground that cannot: the ground rests, and leaves the field.

use super::*;
use crate::{METHODS, fourdgs};
use gs_core::{SplatsGrad, SplatsRef};
use gs_raster::ScreenStats;
use gs_synth::testkit::scene;
use gs_train::model::Model;
use gs_train::registry::{Registry, own_settings, parse_config};
use gs_train::testkit::{run, short};
use gs_train::trainer::{TrainOptions, Trainer};
use serde_json::Value;
use std::sync::Arc;

/// Splats above this height are the body, the others the ground.
const HEIGHT: f32 = -0.5;

/// The body glides along x at a pace that is learnt. The ground is neither moved nor learnt from.
#[derive(Clone)]
struct Glide {
    pace: Param,
    /// Splats of ground and body in every backward.
    learnt_from: Arc<Mutex<Vec<[usize; 2]>>>,
}

impl Params for Glide {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        f(&self.pace);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        f(&mut self.pace);
    }
}

impl Field for Glide {
    /// The time.
    type Tape = f32;

    fn forward(&self, canonical: GeometryRef<'_>, t: Time, tape: &mut f32, out: &mut Geometry) {
        *tape = t.normalised;
        out.resize(canonical.len());
        out.view_mut().copy_from(canonical);
        out.means.iter_mut().filter(|m| m.z > HEIGHT).for_each(|m| m.x += t.normalised * self.pace.value[0]);
    }

    fn backward(
        &mut self,
        canonical: GeometryRef<'_>,
        tape: &mut f32,
        d_out: GeometryRef<'_>,
        d_canonical: &mut Geometry,
    ) {
        let mut body = 0;
        for (_, d) in canonical.means.iter().zip(d_out.means).filter(|(m, _)| m.z > HEIGHT) {
            self.pace.grad[0] += *tape * d.x;
            body += 1;
        }
        self.learnt_from.lock().unwrap().push([canonical.len() - body, body]);
        d_canonical.means.iter_mut().zip(d_out.means).for_each(|(to, d)| *to += *d);
        d_canonical.scales.iter_mut().zip(d_out.scales).for_each(|(to, d)| *to += *d);
        let quats = d_canonical.quats.as_flattened_mut().iter_mut().zip(d_out.quats.as_flattened());
        quats.for_each(|(to, d)| *to += *d);
    }

    fn regularise(&mut self, _: GeometryRef<'_>, _: Time, _: u32) -> Vec<(&'static str, f32)> {
        Vec::new()
    }
}

/// A method before its first step, and what it was made from.
fn glide(over: &[&str]) -> (Deformed<Glide>, fourdgs::Config, SceneInfo) {
    let (registry, data) = (Registry::new(METHODS.to_vec()), scene("falling", 32, 7));
    let table = short(&registry, "fourdgs", &[&["init = { from = \"random\", bound = 0.9 }"], over].concat());
    let mut config: fourdgs::Config = parse_config("fourdgs", &own_settings(table)).unwrap();
    let info = SceneInfo::of(&data, &config.init, 3).unwrap();
    let field = Glide { pace: Param::shared("field.pace", vec![0.5]), learnt_from: Arc::default() };
    let canonical = Canonical::new(&config.cloud, &mut config.schedule, &info).unwrap();
    let no_anneal = Anneal { strength: 0.0, ..Anneal::default() };
    let method =
        Deformed::new(canonical, field, no_anneal, info.views).resting("fourdgs", config.still, &info).unwrap();
    (method, config, info)
}

/// A run of 30 steps without the field and 30 with it, what it logged, and the splats that each of the latter learnt from.
fn trained(over: &[&str]) -> (Trainer, Vec<Value>, Vec<[usize; 2]>) {
    let (method, config, info) = glide(over);
    let learnt_from = method.field.learnt_from.clone();
    let model = Model::new("glide", method, config.schedule).unwrap();
    let mut trainer = Trainer::with_method(model, scene("falling", 32, 7), info, TrainOptions::default()).unwrap();
    let events = run(&mut trainer, 60).into_iter().flat_map(|report| report.events).collect();
    let learnt_from = learnt_from.lock().unwrap().clone();
    (trainer, events, learnt_from)
}

/// Rows come and go in both runs. A splat that passes the height is found at once: every step decides.
#[test]
fn at_the_tightest_tolerance_the_ground_rests_and_the_run_is_the_same_to_the_bit() {
    let (plain, none, all) = trained(&[]);
    let tightest = "still = { pixels = 1e-20, shape = 0.0, every = 1, turn = 1000, from = 0.0, until = 1.0 }";
    let (resting, events, some) = trained(&[tightest]);
    assert!(none.is_empty() && events[0]["still"].as_u64().unwrap() > 0, "{events:?}");
    assert!(events.iter().any(|e| e["entered"].as_u64().unwrap() > 0), "{events:?}");
    assert!(all.iter().map(|n| n[1]).eq(some.iter().map(|n| n[1])), "the body never rests");
    let [all, some] = [all, some].map(|steps| steps.iter().map(|n| n[0]).sum::<usize>());
    assert!(0 < some && some < 3 * all / 4, "the ground takes part at most in every other step: {some} of {all}");
    let [plain, resting] = [plain, resting].map(|trainer| trainer.state().tensors);
    let tensor = |name: &str| resting.iter().find(|(n, _)| n == name).map(|(_, values)| values).unwrap();
    assert_ne!(tensor("field.pace"), &[0.5], "the field learns");
    for (name, values) in &plain {
        assert!(values == tensor(name), "{name}");
    }
}

#[test]
fn what_rests_skips_the_field_and_what_moves_does_not() {
    let still = "still = { pixels = 0.1, every = 1, turn = 1000, from = 0.45, until = 0.85 }";
    let none_enters = "schedule.density = { until = 0, grad = 1e3 }";
    let (trainer, events, learnt_from) = trained(&[none_enters, still]);
    // The first decision is after step 14 of 0 … 29; from step 26 on all take part.
    for (step, [ground, body]) in learnt_from.iter().enumerate() {
        assert!(*body > 0 && (*ground == 0) == (15..26).contains(&step), "step {step}: {ground} and {body}");
    }
    assert_eq!((events.len(), learnt_from.len()), (12, 30));
    for (event, [_, body]) in events.iter().zip(&learnt_from[15..26]) {
        assert_eq!(event["splats"].as_u64().unwrap() - event["still"].as_u64().unwrap(), *body as u64);
    }
    let section = trainer.model().report_section(&events).unwrap().unwrap();
    assert_eq!(section.json["still"], events[11]);
    assert_eq!(trainer.model().report_section(&[]).unwrap(), None);
}

/// Screen gradients as of an image that shows these splats.
struct Image {
    shown: Splats,
    stats: ScreenStats,
}

impl RenderView for Image {
    fn render(&mut self, splats: SplatsRef<'_>, grad: &mut SplatsGrad) -> Result<&ScreenStats, MethodError> {
        grad.reset(splats);
        let off = splats.means.iter().zip(&self.shown.means).map(|(mean, shown)| *mean - *shown);
        self.stats = ScreenStats { grad_means2d: off.map(|d| [d.x, d.y]).collect(), radii: vec![1.0; splats.len()] };
        Ok(&self.stats)
    }
}

#[test]
fn a_still_splat_that_the_image_shows_elsewhere_takes_part_again() {
    let still = "still = { pixels = 0.1, every = 1, turn = 1000, from = 0.0, until = 1.0 }";
    let (mut method, data) = (glide(&[still]).0, scene("falling", 32, 7));
    let shown = method.canonical.activated();
    let row = shown.means.iter().position(|m| m.z <= HEIGHT).expect("ground");
    let (splats, ground) = (shown.len(), shown.means.iter().filter(|m| m.z <= HEIGHT).count());
    let mut image = Image { shown, stats: ScreenStats::default() };
    let view = ViewCtx { at: Timestamp::normalised(0.5), camera: &data.train[0].camera, draw: 0, last: true };
    let mut decisions = Vec::new();
    for step in 1..=5 {
        if step == 3 {
            image.shown.means[row].x += 0.1;
        }
        method.begin_step(&StepCtx { step, stage_steps: 100, stage_offset: step, dynamic: true, ..StepCtx::default() });
        method.step(&view, &mut image).unwrap();
        decisions.extend(method.end_step().unwrap().log);
    }
    // From step 3 on the image shows one of them elsewhere: it enters, the probe leaves it out again, and so on.
    let numbers = [(ground, 0), (ground, 0), (ground - 1, 1), (ground, 0), (ground - 1, 1)];
    let expected = (1..).zip(numbers).map(|(step, (still, entered))| Decision { step, still, entered, splats });
    assert!(decisions.iter().eq(&expected.map(|d| serde_json::json!(d)).collect::<Vec<_>>()), "{decisions:?}");
    let learnt_from: Vec<usize> = method.field.learnt_from.lock().unwrap().iter().map(|n| n[0]).collect();
    assert_eq!(learnt_from, [ground, 0, 0, 1, 0]);
}

/// The image asks for nothing: the slope of the pull alone, with the pace of the field.
#[test]
fn a_pull_reaches_the_field_and_not_the_cloud() {
    let pull = "still = { pixels = 0.1, shape = 0.1, from = 0.0, until = 1.0, pull = 1.0 }";
    let (mut method, data) = (glide(&[pull]).0, scene("falling", 32, 7));
    let mut image = Image { shown: method.canonical.activated(), stats: ScreenStats::default() };
    let view = ViewCtx { at: Timestamp::normalised(0.5), camera: &data.train[0].camera, draw: 0, last: true };
    let at = StepCtx { step: 1, stage_steps: 100, dynamic: true, batch: 1, ..StepCtx::default() };
    let pace = method.field.pace.value[0];
    // Seen at its fastest first: how far a shift goes on the screen is then the same for all.
    let [_, (low, _), (value, slope), (high, _)] = [1.01, 0.99, 1.0, 1.01].map(|share| {
        (method.field.pace.value[0], method.field.pace.grad[0]) = (share * pace, 0.0);
        method.begin_step(&at);
        let [("still", value)] = method.step(&view, &mut image).unwrap()[..] else { panic!("one term") };
        (value, method.field.pace.grad[0])
    });
    let (change, want) = (high - low, 0.02 * pace * slope);
    assert!(value > 0.0 && change > 0.0 && (change - want).abs() < 1e-3 * want, "{value}: {change} {want}");
    method.canonical.cloud.visit(&mut |p| assert!(p.grad.iter().all(|g| *g == 0.0), "{}", p.name));
}
