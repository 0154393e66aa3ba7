//! The penalty on what GAD changes of features, offsets and scales.
//!
//! | property | tolerance |
//! |---|---|
//! | gradient of a view against differences of the value it states | 1 % along the gradient |
//! | a view of one against one of two | 1e-6 |
//! | threads; ranks; a configuration without the setting | same bits |

use crate::{Kept, at, modec, registry, trained};
use glam::Vec3;
use gs_anchor::{AnchorShape, Anchors, Gad, LocalAnchors};
use gs_core::{Param, Params, Time};
use gs_deform::Aabb;
use gs_method_anchor::modec::Config;
use gs_synth::testkit::scene;
use gs_train::conformance::Subject;
use gs_train::method::{LossValue, ViewCtx};
use gs_train::model::Model;
use gs_train::registry::own_settings;
use gs_train::saved;
use gs_train::testkit::{run, start};
use gs_train::trainer::Trainer;
use std::collections::BTreeMap;

/// Two key frames a view.
const BLENDED: &str = "gad.change_l2 = 5.0\nintervals.blend = \"linear\"";
/// A step of the stage in which anchors move.
const STEP: u32 = 46;

/// What a view of a step gives beside its image, which has no gradient.
fn terms(model: &mut Model, trainer: &Trainer) -> Vec<LossValue> {
    model.clear_grads();
    model.begin_step(STEP);
    let camera = &trainer.dataset().train[0].camera;
    let view = ViewCtx { at: at(0.3), camera, draw: 0, last: true };
    model.step(&view, &mut Kept::default()).expect("step")
}

fn penalty(model: &mut Model, trainer: &Trainer) -> f64 {
    let terms = terms(model, trainer);
    assert_eq!(terms.iter().map(|t| t.0).collect::<Vec<_>>(), ["global_change"]);
    f64::from(terms[0].1)
}

fn gradients(model: &Model) -> BTreeMap<String, Vec<f32>> {
    let mut all = BTreeMap::new();
    model.visit(&mut |p| {
        all.insert(p.name.clone(), p.grad.clone());
    });
    all
}

/// The value `by` along a direction through a block.
fn along(model: &mut Model, trainer: &Trainer, name: &str, direction: &[f32], by: f64) -> f64 {
    let mut start = Vec::new();
    model.visit_mut(&mut |p| {
        if p.name == name {
            start.clone_from(&p.value);
            p.value.iter_mut().zip(direction).for_each(|(v, d)| *v = (f64::from(*v) + by * f64::from(*d)) as f32);
        }
    });
    let value = penalty(model, trainer);
    model.visit_mut(&mut |p| {
        if p.name == name {
            p.value.copy_from_slice(&start);
        }
    });
    value
}

#[test]
fn the_gradient_of_a_view_is_that_of_the_value_it_states() {
    let trainer = trained(&modec(BLENDED), STEP - 1);
    let mut model = saved::load(&registry(), &trainer.state(), None).expect("state").model;
    let value = penalty(&mut model, &trainer);
    let all = gradients(&model);
    // Of last layers the value is a square, of logits it is smooth.
    let checked = ["gad.features.", "gad.offsets.", "gad.scales.", "anchors.dynamics"];
    let mut found = 0;
    for (name, grad) in &all {
        let norm = grad.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        if ["gad.positions.", "anchors.log_scales", "anchors.features"].iter().any(|b| name.starts_with(b)) {
            assert_eq!(norm, 0.0, "{name} has no part in it");
        }
        if !checked.iter().any(|b| name.starts_with(b)) {
            continue;
        }
        assert!(norm > 0.0, "{name}");
        // A step over which the value changes by a few per mille.
        let step = 2e-3 * value / norm;
        let direction: Vec<f32> = grad.iter().map(|g| (f64::from(*g) / norm) as f32).collect();
        let [high, low] = [step, -step].map(|by| along(&mut model, &trainer, name, &direction, by));
        let slope = (high - low) / (2.0 * step);
        assert!((slope - norm).abs() <= 0.01 * norm, "{name}: {slope} {norm}");
        found += 1;
    }
    assert_eq!(found, 7, "weights and biases of three heads, and the logits");
}

#[test]
fn a_view_counts_with_its_share_in_the_step() {
    let trainer = trained(&modec(BLENDED), STEP - 1);
    let of = |over: &str| {
        let config = modec(&format!("{BLENDED}\n{over}"));
        let mut model = saved::load(&registry(), &trainer.state(), Some(&config)).expect("state").model;
        penalty(&mut model, &trainer)
    };
    let (one, two) = (of("schedule.batch = 1"), of("schedule.batch = 2"));
    assert!(one > 0.0 && (one - 2.0 * two).abs() <= 1e-6 * one, "{one} {two}");
}

/// Root mean square of what GAD changes of features, offsets and scales at eight times.
fn changes(trainer: &Trainer, config: &toml::Table) -> [f64; 3] {
    let config: Config = own_settings(config.clone()).try_into().expect("settings");
    let mut values = BTreeMap::new();
    trainer.model().visit(&mut |p| {
        values.insert(p.name.clone(), p.value.clone());
    });
    let shape =
        AnchorShape { offsets: config.anchors.offsets, features: config.anchors.features, dynamics: config.logits };
    let positions: Vec<Vec3> =
        values["anchors.positions"].as_chunks().0.iter().map(|p: &[f32; 3]| Vec3::from_array(*p)).collect();
    let [min, max] = trainer.scene().bounds;
    let margin = config.margin * min.distance(max);
    let mut gad = Gad::new(&config.gad, shape, Aabb::new(min - margin, max + margin).expect("a box"), 0).expect("GAD");
    let mut anchors = Anchors::new(shape, &positions, &vec![0.0; positions.len()]);
    let mut fill = |p: &mut Param| p.value.clone_from(&values[&p.name]);
    anchors.visit_mut(&mut fill);
    gad.visit_mut(&mut fill);
    let (mut rest, mut moved, mut sums) = (LocalAnchors::default(), LocalAnchors::default(), [0.0; 3]);
    anchors.activate(&mut rest);
    for t in (0..8).map(|k| Time::new(k as f32 / 8.0).expect("time")) {
        gad.forward(&anchors, t, &mut Default::default(), &mut moved);
        let columns =
            [(&rest.features, &moved.features), (&rest.offsets, &moved.offsets), (&rest.scales, &moved.scales)];
        for (sum, (rest, moved)) in sums.iter_mut().zip(columns) {
            let squares = rest.iter().zip(moved).map(|(a, b)| f64::from(b - a).powi(2)).sum::<f64>();
            *sum += squares / (8 * rest.len()) as f64;
        }
    }
    sums.map(f64::sqrt)
}

#[test]
fn a_penalty_keeps_changes_small_and_is_logged() {
    let trained = |change_l2: f32| {
        let mut config = modec(&format!("gad.change_l2 = {change_l2:?}"));
        config["schedule"]["stages"]["local"]["steps"] = 120.into();
        let mut trainer = start(&registry(), &scene("sheet", 32, 12), "modec", &config, 0);
        let mut logged = run(&mut trainer, 150);
        logged.retain(|report| report.penalties.iter().any(|p| p.0 == "global_change"));
        (changes(&trainer, &config), logged.iter().map(|report| report.step).collect::<Vec<_>>())
    };
    let ((free, nothing), (small, logged)) = (trained(0.0), trained(100.0));
    println!("features, offsets, scales: {free:?} without, {small:?} with the penalty");
    assert!(nothing.is_empty(), "without it nothing is logged");
    assert_eq!(logged, (31..=150).collect::<Vec<_>>(), "every step in which anchors move");
    for (free, small) in free.into_iter().zip(small) {
        assert!(small > 0.0 && small < 0.5 * free, "{small} of {free}");
    }
}

#[test]
fn threads_and_ranks_change_no_bit() {
    let (registry, data) = (registry(), scene("balls", 32, 6));
    let config = modec(&format!("{BLENDED}\ninit.points = 20\nadapt.max_anchors = 24"));
    let subject = Subject::new(&registry, "modec", &data, &config);
    subject.threads().and_then(|()| subject.ranks()).unwrap_or_else(|e| panic!("{e}"));
}

/// Runs that were made before there was the setting go on as they did.
#[test]
fn a_configuration_without_the_setting_has_none() {
    let config = modec("");
    let mut without = config.clone();
    without["gad"].as_table_mut().expect("section").remove("change_l2").expect("a setting");
    let [with, without] = [config, without].map(|config| trained(&config, 40).state().tensors);
    assert!(with == without);
}

#[test]
fn a_weight_outside_its_domain_is_refused_by_name() {
    for weight in ["-1.0", "nan", "1e5"] {
        let config = modec(&format!("gad.change_l2 = {weight}"));
        let error = Trainer::new(&registry(), scene("sheet", 32, 6), "modec", &config, Default::default());
        assert!(error.err().expect("refused").to_string().contains("gad.change_l2"), "{weight}");
    }
}
