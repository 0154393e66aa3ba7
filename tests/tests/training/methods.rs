//! What every method must keep, run over those of generated scenes: presets, rates, gradients, row edits, odd times.
//!
//! | property | tolerance |
//! |---|---|
//! | directional derivative of the loss, f32, against the gradient | 2 % + the loss's rounding over the step |

use crate::support::*;
use gs_core::{Rng, Time};
use gs_data::Dataset;
use gs_raster::{ClampGrad, RasterOptions, Workspace, render};
use gs_train::method::ViewCtx;
use gs_train::model::Model;
use gs_train::saved;
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainOptions, Trainer};

#[test]
fn presets_parse_and_build() {
    let data = scene("balls", 32, 4);
    for entry in of_scenes() {
        for (preset, _) in entry.presets {
            let mut config = entry.config(preset).expect("preset");
            config["init"].as_table_mut().expect("init").insert("points".into(), 100.into());
            let built =
                Trainer::new(gs_methods::registry(), data.clone(), entry.name, &config, TrainOptions::default());
            let trainer = built.unwrap_or_else(|e| panic!("{} {preset}: {e}", entry.name));
            trainer.model().schedule().check().expect("schedule");
            assert_eq!(trainer.model().name(), entry.name);
        }
        assert!(entry.config("none").is_err());
    }
    assert!(gs_methods::registry().find("none").is_err());
}

#[test]
fn every_parameter_has_a_learning_rate() {
    let data = scene("balls", 32, 4);
    for entry in of_scenes() {
        let trainer = start(entry.name, &data);
        let schedule = trainer.model().schedule();
        trainer.model().visit(&mut |p| assert!(schedule.rule(&p.name).is_some(), "{} {}", entry.name, p.name));
    }
}

/// Drawing without the visible steps at α = 1/255 and T = 1e-4, which a finite difference would trip over.
pub fn smooth(method: &Model) -> RasterOptions {
    let options = method.raster_options([0.2, 0.4, 0.6]);
    RasterOptions { min_alpha: 1e-7, stop: 1e-9, clamp_grad: ClampGrad::Exact, ..options }
}

/// Weights of the functional: one random number per 8×8 patch and channel, so that gradients add up and noise does not.
fn patches() -> Vec<f32> {
    let weight = |i: usize| Rng::new(1, "weights", (i % 3) as u32, (i / 3 / 256 * 4 + i / 3 % 32 / 8) as u64).normal();
    (0..32 * 32 * 3).map(weight).collect()
}

/// Loss of a fixed random functional of the frame, in f64.
fn functional(method: &Model, at: &Timestamp, data: &Dataset, weights: &[f32]) -> f64 {
    let camera = &data.train[0].camera;
    let options = smooth(method);
    let frame = render(&method.splats(at, camera).expect("splats"), camera, &options, &mut Workspace::new());
    frame.rgb.iter().zip(weights).map(|(v, w)| f64::from(*v) * f64::from(*w)).sum()
}

#[test]
fn gradients_match_directional_finite_differences() {
    let data = scene("balls", 32, 6);
    for entry in of_scenes() {
        // Few splats: the fewer pairs, the fewer that change their order in depth.
        let mut config = short(entry.name);
        config["init"].as_table_mut().expect("init").insert("points".into(), 40.into());
        if let Some(density) = config["schedule"].get_mut("density").and_then(toml::Value::as_table_mut) {
            density.insert("max_splats".into(), 60.into());
        }
        let mut trainer =
            Trainer::new(gs_methods::registry(), data.clone(), entry.name, &config, TrainOptions::default())
                .expect("trainer");
        run(&mut trainer, 45);
        let mut method = saved::load(gs_methods::registry(), &trainer.state(), None).expect("state").model;
        let at = Timestamp::new(Time::new(0.3).expect("time"));
        let camera = data.train[0].camera.clone();
        let options = smooth(&method);
        let weights = patches();
        let mut render = GivenCotangent::new(&camera, &options, &weights);
        method.step(&ViewCtx { at, camera: &camera, last: false }, &mut render).expect("step");
        check_blocks(entry.name, trainer.steps_done(), &mut method, &mut |m| functional(m, &at, &data, &weights));
    }
}

/// Rounding of the functional: 3072 values, each drawn to about 2e-7, adding up like a random walk.
const ROUNDING: f64 = 1e-5;

/// Moves each block along its own gradient and compares the change of the loss with what the gradient promises.
pub fn check_blocks(name: &str, step: u32, method: &mut Model, loss: &mut dyn FnMut(&Model) -> f64) {
    let mut blocks = Vec::new();
    method.visit(&mut |p| blocks.push((p.name.clone(), p.grad.clone())));
    let total: f64 = blocks.iter().flat_map(|b| &b.1).map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
    assert!(total > 0.0, "{name}: there is a gradient");
    for (block, grad) in &blocks {
        let norm = grad.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        // These fields are read at detached centres: their gradient leaves that path out on purpose. A mask of motion has
        // the gradient of the logistic function. Dynamics rest at this moment (their gradients have tests of their own).
        let detached = ["defgs", "grid4d", "fags", "drk", "trace", "trace-4dgs", "defgs-nvfi"].contains(&name);
        let detached = detached && block == "cloud.means";
        let detached =
            detached || name == "modec" && ["anchors.positions", "anchors.dynamics"].contains(&block.as_str());
        if norm < 1e-6 * total || detached {
            continue;
        }
        let mut moved = |h: f64| {
            method.visit_mut(&mut |p| {
                if p.name == *block {
                    let by = (h / norm) as f32;
                    p.value.iter_mut().zip(grad).for_each(|(v, g)| *v += by * g);
                }
            });
            method.begin_step(step);
            loss(method)
        };
        // Two splats that change their order in depth make a step in the loss: it lies on one side, or weighs less over a
        // longer way.
        let mut found = Vec::new();
        for h in [2e-5, 1e-4, 1e-3, 5e-3, 2e-2] {
            let (here, hi) = (moved(0.0), moved(h));
            let lo = moved(-2.0 * h);
            moved(h);
            let tolerance = 0.02 * norm + ROUNDING / h;
            found.extend([(hi - lo) / (2.0 * h), (hi - here) / h, (here - lo) / h].map(|got| (got, tolerance)));
        }
        let fits = found.iter().any(|(got, tolerance)| (got - norm).abs() < *tolerance);
        assert!(fits, "{name} {block}: {found:?}, {norm} expected");
    }
}

#[test]
fn times_outside_the_range_give_finite_splats() {
    let data = scene("balls", 32, 4);
    for entry in of_scenes() {
        let mut trainer = start(entry.name, &data);
        run(&mut trainer, 40);
        for t in [-10.0, -0.5, 0.0, 1.0, 1.5, 1e6] {
            let (at, camera) = (Timestamp::new(Time::new(t).expect("time")), &data.train[0].camera);
            let (drawn, all) = (trainer.model().splats(&at, camera), trainer.model().all_splats(&at, camera));
            let (drawn, all) = (drawn.expect("splats"), all.expect("splats"));
            assert_eq!((drawn.check(), all.check()), (Ok(()), Ok(())), "{} at {t}", entry.name);
            assert_eq!(all.len(), trainer.model().splat_count(), "{}", entry.name);
            let there = all.opacities.iter().filter(|o| **o > 0.0).count();
            assert!(!drawn.is_empty() && drawn.len() <= there, "{} at {t}", entry.name);
        }
    }
}

#[test]
fn growth_edits_every_row_block_together() {
    let data = scene("balls", 32, 4);
    for entry in of_scenes() {
        let mut trainer = start(entry.name, &data);
        let (mut grown, mut removed) = (0, 0);
        for report in (0..60).map(|_| trainer.step().expect("step")).collect::<Vec<_>>() {
            grown += report.adapted.cloned + report.adapted.split;
            removed += report.adapted.pruned;
        }
        assert!(grown > 0, "{} has not grown ({removed} removed)", entry.name);
        check_rows(entry.name, trainer.model());
    }
}

/// Every row block has as many rows as the others, with gradients and moments, and so have the buffers beside them.
fn check_rows(name: &str, method: &Model) {
    let mut rows = None;
    method.visit(&mut |p| {
        if let Some(count) = p.row_count() {
            assert_eq!(*rows.get_or_insert(count), count, "{name} {}", p.name);
            assert!(p.grad.len() == p.len() && p.moment1.len() == p.len() && p.moment2.len() == p.len());
        }
    });
    let rows = rows.expect("row blocks");
    assert!(method.splat_count().is_multiple_of(rows), "{name}");
    method.buffers(&mut |b| {
        let wanted = b.row_width.map_or(b.values.len(), |w| w * rows);
        assert_eq!(b.values.len(), wanted, "{name} {}", b.name);
    });
}
